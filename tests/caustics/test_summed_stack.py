# SPDX-License-Identifier: Apache-2.0
"""Caustics summed from points: nearer to those of a finer surface than coverage is, and coverage where points show."""

from __future__ import annotations

import numpy as np
import pytest

from mr360uw.base.caustic_lookup import mip_levels
from mr360uw.base.optics import refract_to_water
from mr360uw.base.sphere import direction_from_angles
from mr360uw.caustics import CausticSettings, GerstnerSea, caustic_stack, irradiance
from mr360uw.caustics.irradiance import refracted_rays
from mr360uw.caustics.settings import grid_of
from mr360uw.caustics.summed_stack import cell_corners, cell_flux, sum_cells, summed_stack, vertex_rays
from mr360uw.composite.gl.device import mip_atlas
from mr360uw.types import BeamSpread
from tests.caustics import tolerances as tol
from tests.caustics.seas import SEAS

SUN = direction_from_angles(0.7, np.radians(50.0))
SPREAD = BeamSpread(0.2, np.array([0.01, 0.05, 0.2]), np.array([0.0, 4.0]), np.full((2, 3), 1.0 / 3.0))
BREEZE = GerstnerSea(wind_speed=8.0)


def rays_and_flux(sea, cells):
    rays, flux = np.empty((8, cells + 1, cells + 1)), np.empty((cells, cells))
    towards = refract_to_water(SUN, 1.34)
    travel = -towards[[0, 2]] / towards[1]
    vertex_rays(tuple(sea.grid_fields(cells, 0.5)), sea.tile_m, SUN, 1.34, travel, rays)
    return rays, flux, travel, cell_flux(rays, SUN, flux)


@pytest.mark.parametrize("name", ["gerstner", "phillips"])
def test_compiled_rays_are_those_of_the_reference(name):
    sea, cells = SEAS[name], 24
    rays, flux, travel, least = rays_and_flux(sea, cells)
    surface = sea.grid_surface(cells, 0.5)
    origin, slope, transmittance = refracted_rays(surface, SUN, 1.34)
    inner = rays[:, :-1, :-1]
    for got, of in (
        (inner[:3], surface.position),
        (inner[3:5], origin),
        (inner[5:7], slope - travel),
        (inner[7:], transmittance[..., None]),
    ):
        np.testing.assert_allclose(np.moveaxis(got, 0, -1), of, rtol=tol.FLOAT64, atol=tol.FLOAT64)
    light = irradiance.cell_flux(surface, transmittance, SUN, sea.tile_m)
    np.testing.assert_allclose(flux, light.sum(axis=-1), rtol=tol.FLOAT64, atol=tol.SHARED_CELL)
    assert least > 0.0


def test_cells_lie_where_their_light_is_in_the_mean():
    """A wave along x: the mean place of a cell's light is that of the wave between its edges, to fourth order."""
    cells, k = 32, 2.0 * np.pi / 8.0
    x = np.broadcast_to(np.arange(cells + 1) * 8.0 / cells, (cells + 1, cells + 1))
    rays = np.zeros((8, cells + 1, cells + 1))
    rays[3], rays[4], rays[5] = x, x.T, np.sin(k * x)
    corners = np.empty((4, cells + 1, cells + 1), np.float32)
    cell_corners(rays, corners)
    np.testing.assert_allclose(corners[:2], rays[3:5], atol=tol.SUMMED_POINTS)
    mean = 0.25 * (corners[2, :-1, :-1] + corners[2, 1:, :-1] + corners[2, :-1, 1:] + corners[2, 1:, 1:])
    edge = -np.cos(k * x[0]) / k
    expected = np.diff(edge) * cells / 8.0
    linear = 0.5 * (rays[5, 0, 1:] + rays[5, 0, :-1])
    off, before = np.abs(mean - expected).max(), np.abs(linear - expected).max()
    assert off < tol.FOURTH_ORDER * before


def test_sums_close_on_themselves_and_keep_the_light(rng):
    """A sheet of even light, shifted: each cell that is cut by the map's edge comes back on its other side."""
    cells, size, tile_m = 12, 16, 8.0
    at = np.arange(cells + 1) * tile_m / cells
    corners = np.zeros((4, cells + 1, cells + 1), np.float32)
    corners[0], corners[1] = at + rng.uniform(-20.0, 20.0), at[:, None] + rng.uniform(-20.0, 20.0)
    flux, out = np.full((cells, cells), 1.0 / cells**2, np.float32), np.empty((size, size), np.float32)
    # a point a quarter of a pixel apart: bilinear shares of whole numbers of points a pixel are even
    sum_cells(corners, flux, 0.0, tile_m, float(size * size), size / cells / 4.0 + 1e-6, out)
    np.testing.assert_allclose(out, 1.0, atol=tol.SUMMED_SHEET)
    corners[2:, :-1, :-1] = rng.normal(0.0, 1.0, (2, cells, cells))
    corners[2:, -1], corners[2:, :, -1] = corners[2:, 0], corners[2:, :, 0]
    sum_cells(corners, flux, 3.0, tile_m, float(size * size), 0.5, out)
    assert out.mean(dtype=np.float64) == pytest.approx(1.0, abs=tol.SUMMED_POINTS)


@pytest.mark.parametrize("chromatic", [1, 3])
def test_planes_are_nearer_to_those_of_a_finer_surface_than_by_coverage(chromatic):
    """The finer one has four times the cells, and pixels of half the width."""
    s, depths = CausticSettings(size=128, chromatic=chromatic), np.array([0.05, 0.5, 1.0, 4.0, 8.0])
    rest = 0.5, s, 1.34, SPREAD
    got, covered = summed_stack(BREEZE, SUN, depths, *rest), caustic_stack(BREEZE, SUN, depths, *rest)
    fine = s.model_copy(update={"size": 256, "grid": 4 * grid_of(s, BREEZE)})
    finer = caustic_stack(BREEZE, SUN, depths, 0.5, fine, 1.34, SPREAD)
    np.testing.assert_array_equal(got.ratio[0], covered.ratio[0].astype(np.float32))
    np.testing.assert_allclose(got.ratio.mean(axis=(1, 2), dtype=np.float64), 1.0, atol=tol.SUMMED_POINTS)
    for mine, theirs, of_finer in (
        (got.ratio, covered.ratio, finer.ratio),
        (got.soft, covered.soft, finer.soft),
    ):
        truth = of_finer.reshape(len(depths), 128, 2, 128, 2, -1).mean(axis=(2, 4))
        for plane in range(1, len(depths)):
            off, of_coverage = (np.sqrt(np.mean((one[plane] - truth[plane]) ** 2)) for one in (mine, theirs))
            assert off <= max(of_coverage, tol.SUMMED_POINTS), plane


@pytest.mark.parametrize(
    ("sea", "changes", "sun"),
    [
        (SEAS["ripples"], {}, SUN),
        (BREEZE, {"method": "ratio"}, SUN),
        (BREEZE, {"grid": 8}, SUN),
        (GerstnerSea(detail_slope=0.0), {"grid": None, "sun_half_angle_rad": 0.0}, SUN),
        (BREEZE, {}, direction_from_angles(0.7, np.radians(4.0))),
    ],
)
def test_what_points_do_not_represent_is_drawn_by_coverage(sea, changes, sun):
    """Ripples, other methods, cells too coarse for the sea, no blur, waves in the shadow of others."""
    s = CausticSettings(**{"size": 64, "grid": 32, **changes})
    arguments = sea, sun, np.array([6.0]), 0.5, s, 1.34, None
    expected = caustic_stack(*arguments).ratio
    np.testing.assert_allclose(summed_stack(*arguments).ratio, expected, rtol=tol.FLOAT32_TWIN, atol=0.0)


def test_stacks_follow_each_other_in_an_atlas(rng):
    one, two = (mip_levels(rng.random((3, 8, 8, colours))) for colours in (3, 1))
    together, apart = mip_atlas(one, two), [mip_atlas(one), mip_atlas(two)]
    np.testing.assert_array_equal(together, np.concatenate(apart))
