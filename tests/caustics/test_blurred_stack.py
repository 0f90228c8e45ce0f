# SPDX-License-Identifier: Apache-2.0
"""Caustics summed from points: the same light as by coverage where short waves blur it, and coverage elsewhere."""

from __future__ import annotations

import numpy as np
import pytest

from mr360uw.caustic_lookup import mip_levels
from mr360uw.caustics import CausticSettings, GerstnerSea, caustic_stack
from mr360uw.caustics.flux.blurred_stack import blurred_stack
from mr360uw.caustics.flux.irradiance import beam_slope, cell_flux
from mr360uw.caustics.flux.point_kernels import edge_points, sum_points, triangle_flux, vertex_rays
from mr360uw.caustics.flux.refracted_rays import refracted_rays
from mr360uw.caustics.gl.stack import mip_atlas
from mr360uw.optics import refract_to_water
from mr360uw.sphere import direction_from_angles
from mr360uw.types import BeamSpread
from tests.caustics import tolerances as tol
from tests.caustics.seas import SEAS

SUN = direction_from_angles(0.7, np.radians(50.0))
SPREAD = BeamSpread(0.2, np.array([0.01, 0.05, 0.2]), np.array([0.0, 4.0]), np.full((2, 3), 1.0 / 3.0))
BREEZE = GerstnerSea(wind_speed=8.0)


def rays_and_flux(sea, cells):
    rays, flux = np.empty((8, cells + 1, cells + 1)), np.empty((2, cells + 1, cells + 1))
    travel = beam_slope(refract_to_water(SUN, 1.34))
    vertex_rays(np.stack(sea.grid_fields(cells, 0.5)), sea.tile_m, SUN, 1.34, travel, rays)
    return rays, flux, travel, triangle_flux(rays, SUN, flux)


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
    light = cell_flux(surface, transmittance, SUN, sea.tile_m)
    np.testing.assert_allclose(np.moveaxis(flux[:, 1:, 1:], 0, -1), light, rtol=tol.FLOAT64, atol=tol.SHARED_CELL)
    assert least == flux[:, 1:, 1:].min() > 0.0


def test_points_have_the_flux_the_centre_and_the_variance_of_their_triangles():
    """Judged by the lowest frequency of the light along x, to which every place of the tile adds."""
    rays, flux, _, _ = rays_and_flux(BREEZE, 96)
    points = np.empty((5, 3, 96, 96), np.float32)
    total, *edge = edge_points(rays, flux, points)
    assert total == pytest.approx(flux[:, 1:, 1:].sum(), rel=tol.FLOAT64)
    at, light, depth = points[:2] + 3.0 * points[2:4], points[4], 3.0
    a, b, c, d = (
        (rays[3:5] + depth * rays[5:7])[:, j : j + 96, i : i + 96] for j, i in ((0, 0), (0, 1), (1, 1), (1, 0))
    )
    turn = 2.0 * np.pi / BREEZE.tile_m
    spectrum = 0.0
    for part, corners in zip(flux[:, 1:, 1:], ((a, b, c), (a, c, d)), strict=True):
        phase = [turn * corner[0] for corner in corners]
        mean = sum(phase) / 3.0
        variance = sum((p - mean) ** 2 for p in phase) / 12.0
        spectrum += np.sum(part * np.exp(1j * mean) * (1.0 - 0.5 * variance))
    got = np.sum(light.astype(np.float64) * np.exp(1j * turn * at[0].astype(np.float64)))
    assert abs(got - spectrum) < tol.FLOAT32_TWIN * total
    length = np.sum(edge * np.array([1.0, depth, depth**2]))
    pairs = ((a, b), (a, c), (a, d))
    squares = np.stack([np.sum((p - q) ** 2, axis=0) for p, q in pairs])
    assert length == pytest.approx(np.sum(squares * light) / light.sum(), rel=tol.FLOAT32_TWIN)


def test_sums_of_points_close_on_themselves(rng):
    points = np.zeros((5, 40), np.float32)
    points[:2], points[4] = rng.uniform(-20.0, 20.0, (2, 40)), 1.0
    size, tile_m, out = 16, 8.0, np.empty((16, 16), np.float32)
    sum_points(points, 0.0, tile_m, 1.0, np.empty((18, 18), np.float32), out)
    x, z = (points[:2].astype(np.float64) * size / tile_m - 0.5) % size
    expected = np.zeros((size, size))
    for i, j in zip(x, z, strict=True):
        for dj in (0, 1):
            for di in (0, 1):
                weight = abs(1 - di - i % 1.0) * abs(1 - dj - j % 1.0)
                expected[(int(j) + dj) % size, (int(i) + di) % size] += weight
    np.testing.assert_allclose(out, expected, atol=tol.SUMMED_POINTS)


@pytest.mark.parametrize("chromatic", [1, 3])
def test_blurred_planes_are_those_by_coverage(chromatic):
    s, depths = CausticSettings(size=128, chromatic=chromatic), np.array([1.0, 4.0, 8.0])
    arguments = BREEZE, SUN, depths, 0.5, s, 1.34, SPREAD
    got, expected = blurred_stack(*arguments), caustic_stack(*arguments)
    np.testing.assert_array_equal(got.ratio[0], expected.ratio[0].astype(np.float32))
    np.testing.assert_allclose(got.ratio[1:].mean(axis=(1, 2)), 1.0, atol=tol.SUMMED_POINTS)
    for mine, theirs in ((got.ratio, expected.ratio), (got.soft, expected.soft)):
        for plane in (1, 2):
            off = mine[plane] - theirs[plane]
            assert np.sqrt(np.mean(off**2)) < tol.SUMMED_OVER_COVERED * theirs[plane].std()
            assert np.abs(off).max() < tol.SUMMED_PIXEL
    np.testing.assert_allclose(got.soft[0], expected.soft[0], atol=tol.SUMMED_POINTS)


@pytest.mark.parametrize(
    ("sea", "changes", "sun"),
    [
        (SEAS["gerstner"], {}, SUN),
        (SEAS["ripples"], {}, SUN),
        (BREEZE, {"method": "ratio"}, SUN),
        (BREEZE, {"grid": 8}, SUN),
        (BREEZE, {}, direction_from_angles(0.7, np.radians(4.0))),
    ],
)
def test_what_points_do_not_represent_is_drawn_by_coverage(sea, changes, sun):
    """No blur, ripples, other methods, cells wider than the blur, waves in the shadow of others."""
    s = CausticSettings(**{"size": 64, "grid": 32, **changes})
    arguments = sea, sun, np.array([6.0]), 0.5, s, 1.34, None
    np.testing.assert_array_equal(blurred_stack(*arguments).ratio, caustic_stack(*arguments).ratio)


def test_stacks_follow_each_other_in_an_atlas(rng):
    one, two = (mip_levels(rng.random((3, 8, 8, colours))) for colours in (3, 1))
    together, apart = mip_atlas(one, two), [mip_atlas(one), mip_atlas(two)]
    np.testing.assert_array_equal(together, np.concatenate(apart))
