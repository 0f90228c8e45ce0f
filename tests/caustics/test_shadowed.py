# SPDX-License-Identifier: Apache-2.0
"""Waves in the shadow of other waves, against the light that comes in and against traced rays."""

from __future__ import annotations

import numpy as np
import pytest

from mr360uw.base.optics import fresnel_transmittance
from mr360uw.base.sphere import direction_from_angles
from mr360uw.caustics import GerstnerSea, SpectralSea
from mr360uw.caustics.irradiance import cell_flux, lit_corners, refracted_rays, shadow_steps
from tests.caustics import tolerances as tol

SEAS = {"gerstner 5": GerstnerSea(wind_speed=5.0), "gerstner 10": GerstnerSea(wind_speed=10.0),
        "jonswap": SpectralSea(wind_speed=8.0)}  # fmt: skip


@pytest.mark.parametrize("elevation_deg", [5.0, 10.0, 20.0, 60.0])
@pytest.mark.parametrize("name", SEAS)
def test_all_light_that_comes_in_meets_the_surface_once(name, elevation_deg):
    sun, surface = direction_from_angles(0.4, np.radians(elevation_deg)), SEAS[name].grid_surface(128, 0.0)
    met = cell_flux(surface, np.ones(surface.jacobian.shape), sun, 8.0).sum() / (64.0 * sun[1])
    assert met == pytest.approx(1.0, abs=tol.SHADOWED_FLUX)


def test_low_suns_leave_waves_in_shadow():
    surface = SEAS["gerstner 10"].grid_surface(96, 0.0)
    lit = [lit_corners(surface, direction_from_angles(0.4, np.radians(e)), 8.0).mean() for e in (5.0, 10.0, 20.0, 90.0)]
    assert 0.5 < lit[0] < 0.75 < lit[1] < lit[2] <= lit[3] == 1.0
    assert shadow_steps(0.3, np.array([0.0, 1.0, 0.0]), 8.0, 96) == 0


@pytest.mark.parametrize("elevation_deg", [5.0, 10.0])
def test_light_that_passes_is_that_of_traced_rays(elevation_deg):
    """Rays to a long crest's surface, followed to their first meeting with it in small steps."""
    k, height = 2.0 * np.pi / 1.6, 0.05
    sea = GerstnerSea.from_waves([[k, 0.0]], height, 0.0, 0.0, tile_m=8.0)
    sun = direction_from_angles(np.pi / 2, np.radians(elevation_deg))  # over +x
    start = np.linspace(0.0, 1.6, 4000, endpoint=False)
    down = np.linspace(height, -height, 6001)[:, None]
    x = start + (height - down) * -sun[0] / sun[1]
    first = np.argmax(height * np.sin(k * x) >= down, axis=0)
    slope = height * k * np.cos(k * x[first, np.arange(len(start))])
    cosine = (sun[1] - slope * sun[0]) / np.sqrt(1.0 + slope**2)
    traced = float(np.mean(fresnel_transmittance(cosine, 1.34)))
    surface = sea.grid_surface(192, 0.0)
    passed = cell_flux(surface, refracted_rays(surface, sun, 1.34)[2], sun, 8.0).sum() / (64.0 * sun[1])
    assert passed == pytest.approx(traced, rel=tol.SHADOWED_FLUX)
