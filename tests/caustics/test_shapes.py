# SPDX-License-Identifier: Apache-2.0
"""Shapes at the calls of `mr360uw.caustics`."""

from __future__ import annotations

import pytest

from mr360uw import caustics
from mr360uw.caustics import CausticSettings, GerstnerSea, SpectralSea
from tests.shapes import Batch, Refused, Returns, called, check_refused, check_returned, filled, functions_of, towards

UP = (0.0, 1.0, 0.0)
SEA = GerstnerSea(wave_count=4)
SMALL = CausticSettings(size=16, grid=8)


def surface(batch: Batch) -> dict[str, Batch]:
    return {"position": (*batch, 3), "normal": (*batch, 3), "jacobian": batch}


RETURNS: Returns = {
    "GerstnerSea.surface": (lambda b: SEA.surface(filled(*b), 0.5, 0.0), surface),
    "SpectralSea.surface": (lambda b: SpectralSea(resolution=16).surface(0.5, filled(*b), 0.0), surface),
    "GerstnerSea.from_waves": (
        lambda _: GerstnerSea.from_waves(filled(5, 2), filled(5, value=1e-3), 0.5, filled(5)).waves.wave_vector,
        lambda _: (5, 2),
    ),
    "caustic_map": (lambda _: caustics.caustic_map(SEA, UP, 3.0, 0.0, 16, 8), lambda _: (16, 16)),
    "caustic_stack": (
        lambda _: caustics.caustic_stack(SEA, UP, [2.0, 3.0, 4.0], 0.0, SMALL),
        lambda _: {"ratio": (3, 16, 16, 3), "depth_m": (3,), "sun_direction": (3,)},
    ),
    "stack_depths": (lambda _: caustics.stack_depths(2.0, 5.0, 4), lambda _: (4,)),
    "refract_to_air": (lambda b: caustics.refract_to_air(towards(b)), lambda b: (*b, 3)),
    "refract_to_water": (lambda b: caustics.refract_to_water(towards(b)), lambda b: (*b, 3)),
    "fresnel_reflectance": (lambda b: caustics.fresnel_reflectance(filled(*b)), lambda b: b),
    "fresnel_transmittance": (lambda b: caustics.fresnel_transmittance(filled(*b), 1.34), lambda b: b),
    "sea_water_index": (lambda b: caustics.sea_water_index(filled(*b, value=500.0)), lambda b: b),
}
REFUSED: Refused = {
    "GerstnerSea.surface": lambda: SEA.surface(filled(4), filled(3), 0.0),
    "GerstnerSea.from_waves": lambda: GerstnerSea.from_waves(filled(5, 3), 1e-3, 0.5, 0.0),
    "GerstnerSea.from_waves, amplitudes": lambda: GerstnerSea.from_waves(filled(5, 2), filled(4), 0.5, 0.0),
    "caustic_map": lambda: caustics.caustic_map(SEA, towards((2,)), 3.0, 0.0, 16, 8),
    "caustic_map, a plane": lambda: caustics.caustic_map(SEA, (0.0, 1.0), 3.0, 0.0, 16, 8),
    "caustic_stack": lambda: caustics.caustic_stack(SEA, UP, filled(2, 2), 0.0, SMALL),
    "refract_to_air": lambda: caustics.refract_to_air(filled(4, 2)),
    "refract_to_water": lambda: caustics.refract_to_water(filled(4, 4)),
    "export_tiles": lambda: caustics.export_tiles(SEA, towards((2,)), 3.0, "nowhere"),
}


def test_every_public_function_is_here() -> None:
    assert functions_of(caustics) <= called(RETURNS) | called(REFUSED)


def test_what_comes_out(subtests: pytest.Subtests) -> None:
    check_returned(RETURNS, subtests)


def test_other_shapes_are_refused(subtests: pytest.Subtests) -> None:
    check_refused(REFUSED, subtests)
