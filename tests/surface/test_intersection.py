# SPDX-License-Identifier: Apache-2.0
"""Sampled seas and rays that meet them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import ndtri

from mr360uw.base.sphere import unit
from mr360uw.caustics import GerstnerSea, SpectralSea
from mr360uw.surface import SampledSea
from mr360uw.surface.facet_draws import Facets, drawn, facets_of, facing, next_key, normal_quantile
from mr360uw.surface.intersection import first_hits
from mr360uw.surface.ray_kernel import level_slopes, ripples_of, tilted
from tests.surface import tolerances as tol

SEAS = {
    "gerstner": GerstnerSea(wind_speed=6.0, detail_slope=0.0, wave_count=8),
    "sharp": GerstnerSea.from_waves([[2.0 * np.pi / 4.0, 0.0]], 0.5, 0.9, 0.3, tile_m=8.0),
    "spectral": SpectralSea(wind_speed=5.0, resolution=32, choppiness=0.9, detail_slope=0.0),
}


def cast(
    sea: SampledSea, origins: np.ndarray, directions: np.ndarray, from_below: bool, width: float = 0.0
) -> np.ndarray:
    n = len(origins)
    return first_hits(sea, origins, directions, from_below, np.full(n, width), np.zeros(n), np.full(n, 1e3)).distance


@pytest.mark.parametrize("name", SEAS)
def test_a_sampled_sea_is_the_sea(name: str, rng: np.random.Generator) -> None:
    x, z = rng.uniform(-20.0, 20.0, (2, 100))
    exact = SEAS[name].surface(x, z, 1.3)
    sampled = SampledSea.of(SEAS[name], 1.3)
    np.testing.assert_allclose(
        sampled.heights(exact.position[:, 0], exact.position[:, 2]), exact.position[:, 1], atol=tol.SPLINE_HEIGHT_M
    )
    # rays straight at those points find them, and their normals
    down = np.broadcast_to([0.0, -1.0, 0.0], (100, 3))
    start = exact.position - 5.0 * down
    n = np.zeros(100)
    hits = first_hits(sampled, start, np.ascontiguousarray(down), False, n, n, n + 1e3)
    np.testing.assert_allclose(hits.distance, 5.0, atol=tol.SPLINE_HEIGHT_M)
    np.testing.assert_allclose(hits.normal, exact.normal, atol=1e3 * tol.SPLINE_HEIGHT_M)  # a derivative over a step


def test_ripples_tilt_the_surface_or_are_kept_as_slopes() -> None:
    sea = GerstnerSea(wind_speed=2.0, detail_slope=0.05, detail_kind="ripples", wave_count=4)
    x = np.linspace(0.0, 5.0, 50)
    exact, sampled = sea.surface(x, 2.0 * x, 0.0), SampledSea.of(sea, 0.0)
    n, down = np.zeros(50), np.tile([0.0, -1.0, 0.0], (50, 1))
    hits = first_hits(sampled, exact.position - 5.0 * down, down, False, n, n, n + 1e3)
    ripples = ripples_of(sampled)
    for k, rest in enumerate(hits.rest):
        normal, lost = tilted(ripples, tuple(hits.normal[k]), *rest, 0.0)
        np.testing.assert_allclose(normal, exact.normal[k], atol=1e3 * tol.SPLINE_HEIGHT_M)
        assert lost == 0.0
        normal, lost = tilted(ripples, tuple(hits.normal[k]), *rest, 10.0)
        np.testing.assert_allclose(normal, hits.normal[k], atol=tol.SPLINE_HEIGHT_M)
        assert lost == pytest.approx(0.5 * 0.05**2, rel=tol.SPLINE_HEIGHT_M)


@pytest.mark.parametrize("from_below", [False, True])
@pytest.mark.parametrize("name", SEAS)
def test_the_first_of_several_hits(name: str, from_below: bool, rng: np.random.Generator) -> None:
    """Rays down to two degrees: on the surface at the hit, and on their own side everywhere before."""
    sea, side = SampledSea.of(SEAS[name], 0.4), -1.0 if from_below else 1.0
    flat = unit(rng.standard_normal((60, 3)) * [1.0, 0.0, 1.0])
    d = unit(flat - side * np.array([0.0, 1.0, 0.0]) * np.tan(rng.uniform(0.035, 0.6, (60, 1))))
    o = np.column_stack([rng.uniform(0.0, 8.0, 60), np.full(60, 2.0 * side), rng.uniform(0.0, 8.0, 60)])
    distance = cast(sea, o, d, from_below)
    assert np.all(np.isfinite(distance))
    at = o + distance[:, None] * d
    np.testing.assert_allclose(sea.heights(at[:, 0], at[:, 2]), at[:, 1], atol=tol.ON_SURFACE_M)
    share = np.linspace(0.0, 1.0 - 1e-6, 400)
    before = o[:, None] + (share * distance[:, None])[..., None] * d[:, None]
    flat_points = before.reshape(-1, 3)
    over = side * (flat_points[:, 1] - sea.heights(flat_points[:, 0], flat_points[:, 2]))
    assert over.min() > -1e-4  # crests thinner than a step may be missed by less than this


def test_rays_that_do_not_reach_the_surface_are_free() -> None:
    sea = SampledSea.of(SEAS["gerstner"], 0.0)
    o = np.array([[0.0, -2.0, 0.0], [0.0, 2.0, 0.0], [0.0, -2.0, 0.0]])
    d = np.array([[0.6, -0.8, 0.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    assert np.all(np.isinf(cast(sea, o[:1], d[:1], True)))
    assert np.all(np.isinf(cast(sea, o[1:2], d[1:2], False)))
    assert np.all(np.isinf(cast(sea, o[2:], d[2:], True)))


def test_wide_footprints_see_a_level_sea_and_lose_no_slope() -> None:
    sea = SampledSea.of(SEAS["gerstner"], 0.0)
    hits = first_hits(
        sea, np.array([[0.3, 5.0, 0.2]]), np.array([[0.0, -1.0, 0.0]]), False, np.array([100.0]), np.zeros(1),
        np.array([1e3]),
    )  # fmt: skip
    assert hits.distance[0] == pytest.approx(5.0, abs=tol.ON_SURFACE_M)
    fields = SEAS["gerstner"].grid_fields(128, 0.0)
    lost = level_slopes(ripples_of(sea), hits.level[0])
    assert lost[0] == pytest.approx(np.mean(fields.slope_x**2), rel=tol.SPLINE_HEIGHT_M)
    assert lost[2] == pytest.approx(np.mean(fields.slope_z**2), rel=tol.SPLINE_HEIGHT_M)


def test_quantiles_of_the_normal_distribution() -> None:
    share = np.linspace(2.0**-25, 1.0 - 2.0**-25, 301)
    np.testing.assert_allclose([normal_quantile(p) for p in share.tolist()], ndtri(share), atol=tol.FLOAT64)


@pytest.mark.parametrize("up", [-2.0, -0.15, 0.3])
def test_facets_are_drawn_as_they_are_seen(up: float) -> None:
    """In proportion to density times max(f, 0), against a sum over slopes."""
    count, side, mean = 100_000, -1.0 if up > 0.0 else 1.0, unit([0.05, 1.0, -0.02])
    travel = tuple(unit([0.8, up, 0.3]).tolist())
    f: Facets = facets_of(travel, tuple(mean.tolist()), (0.02, 0.004, 0.01), side)
    normal = np.array([drawn(f, next_key(k, 3)) for k in range(count)])
    found = -normal[:, [0, 2]] / normal[:, 1:2]
    g = np.linspace(-6.0, 6.0, 201)
    a, b = (v.ravel() for v in np.meshgrid(g, g))
    root = np.linalg.cholesky([[0.02, 0.004], [0.004, 0.01]])
    slope = -mean[[0, 2]] / mean[1] + np.stack([a, b], axis=-1) @ root.T
    faced = np.maximum(np.vectorize(facing)(*travel, slope[:, 0], slope[:, 1], side), 0.0)
    weight = np.exp(-0.5 * (a * a + b * b)) * faced
    assert f.seen == pytest.approx(weight.sum() * (g[1] - g[0]) ** 2 / (2.0 * np.pi), rel=tol.FACET_LIGHT)
    expected = np.average(slope, axis=0, weights=weight)
    np.testing.assert_allclose(found.mean(axis=0), expected, atol=tol.DRAWN_SLOPES * np.sqrt(0.02))
    np.testing.assert_allclose(np.cov(found.T), np.cov(slope.T, aweights=weight, ddof=0), atol=tol.DRAWN_SLOPES * 0.02)
