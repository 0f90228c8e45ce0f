# SPDX-License-Identifier: Apache-2.0
"""The light field against published slabs and another solver's."""

from __future__ import annotations

import numpy as np
import pytest

from mr360uw.medium import LightField, Water, transfer
from mr360uw.medium.models import FieldModel, spectral_model
from mr360uw.medium.ray_field import Sky
from tests.medium.slabs import Slab, errors, slabs
from tests.medium.tolerances import (
    AZIMUTH_ORDERS,
    PRINTED_IRRADIANCE,
    PRINTED_RADIANCE,
    SLAB_IRRADIANCE,
    SLAB_RADIANCE,
    SLAB_SMOOTH_RADIANCE,
    WINDOW_RADIANCE,
)

COMPUTED, PRINTED = slabs("slabs.csv"), slabs("slabs_printed.csv")


@pytest.mark.parametrize("slab", COMPUTED, ids=str)
def test_slabs_are_those_of_another_solver(slab: Slab) -> None:
    radiance, irradiance = errors(slab, COMPUTED[slab], transfer.STREAMS_PER_HEMISPHERE)
    peaked = slab.phase not in ("isotropic", "rayleigh") and 0.0 < slab.sun_up < 1.0
    assert radiance < (SLAB_RADIANCE if peaked else SLAB_SMOOTH_RADIANCE)
    assert irradiance < SLAB_IRRADIANCE


@pytest.mark.parametrize("slab", PRINTED, ids=str)
def test_slabs_are_those_in_print(slab: Slab) -> None:
    """With as many streams as the printed values were made with: six figures."""
    radiance, irradiance = errors(slab, PRINTED[slab], 8)
    assert radiance < PRINTED_RADIANCE
    assert irradiance < PRINTED_IRRADIANCE


def solved(name: str, streams: int, sky: Sky = "uniform") -> FieldModel:
    """Return the light of a water at three wavelengths, solved anew."""
    water, w = Water.jerlov(name), np.array([450.0, 550.0, 650.0])
    field = LightField(water.absorption(w), water.scattering(w), water.phases(w), sky=sky, streams=streams)
    return FieldModel(field, water.phases(w, wide_angle=True))


@pytest.mark.parametrize("name", ["IB", "5C"])
@pytest.mark.parametrize("sun_up", [0.67, 0.9])
def test_no_order_of_the_azimuth_is_missed(monkeypatch: pytest.MonkeyPatch, name: str, sun_up: float) -> None:
    """A low sun stands just above the edge of Snell's window: beside it light changes fast with the azimuth."""
    up, azimuth = np.array([-0.8, 0.0, 0.4, 0.58, 0.62]), np.radians([0.0, 10.0, 45.0, 90.0, 180.0])
    some, every = (solved(name, 32, ("sun", sun_up, 0.8)) for _ in range(2))
    seen = some.around_sun(5.0, up, azimuth)
    monkeypatch.setattr(transfer, "_NEGLIGIBLE", 0.0)
    np.testing.assert_allclose(seen, every.around_sun(5.0, up, azimuth), rtol=AZIMUTH_ORDERS)
    assert len(some.field.azimuth_orders) < len(every.field.azimuth_orders)


@pytest.mark.parametrize("name", ["IB", "1C", "5C"])
def test_streams_do_for_the_veil_of_a_uniform_sky(name: str) -> None:
    """Just below the edge of Snell's window too, where its bright light is scattered by small angles."""
    up = np.linspace(-1.0, 0.66, 40)
    few = spectral_model(Water.jerlov(name), [450.0, 550.0, 650.0], "table").radiance(5.0, up)
    many = solved(name, 96).radiance(5.0, up)
    assert np.max(np.abs(few - many) / many.max(axis=0)) < WINDOW_RADIANCE
