# SPDX-License-Identifier: Apache-2.0
"""Slopes of the beam below waves, and the shadows that they bend, beside single rays and photons."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mr360uw.base.caustic_lookup import mean_slopes
from mr360uw.base.sphere import unit
from mr360uw.caustics import CausticSettings, GerstnerSea, caustic_stack, refract_to_water
from mr360uw.caustics.irradiance import ray_slope
from mr360uw.caustics.summed_stack import summed_stack
from mr360uw.composite.light_sources import Blockers, SunSource, ground_slopes
from mr360uw.composite.shot import Shot
from mr360uw.types import CausticStack, Floats, Sun
from tests.caustics import tolerances as tol
from tests.composite.scenes import placed, shot, sphere

INDEX = 1.34
SUN = unit([0.35, 0.9, 0.2])
SETTINGS = CausticSettings()
RADIUS_M, HEIGHT_M, DEPTH_M = 0.5, 2.0, 6.0
"""Of a ball over the ground, and of the ground below the surface."""


def stack_over(sea: GerstnerSea, depth_m: float, time_s: float = 0.0) -> CausticStack:
    return caustic_stack(sea, SUN, [depth_m], time_s, SETTINGS, INDEX, None, depth_m)


def test_a_flat_sea_turns_nothing() -> None:
    sea = GerstnerSea.from_waves([[0.8, 0.0]], 0.0, 0.0, 0.0, tile_m=8.0)
    still = stack_over(sea.model_copy(update={"detail_slope": 0.0}), 4.0)
    for level in still.slopes:
        np.testing.assert_allclose(mean_slopes(level), 0.0, atol=tol.SLOPE_ROUNDING)


def test_before_waves_focus_a_place_has_the_slope_of_its_ray() -> None:
    """Half a metre below a long, low wave no rays cross: each place has one, whose slope is that of its facet."""
    sea = GerstnerSea.from_waves([[2.0 * np.pi / 8.0, 0.0]], 0.05, 0.0, 0.0, tile_m=8.0)
    sea, depth_m = sea.model_copy(update={"detail_slope": 0.0}), 0.5
    scene = with_stack(stack_over(sea, depth_m), depth_m)
    surface = sea.surface(np.linspace(0.0, 8.0, 40), np.full(40, 2.0), 0.0)
    slope = ray_slope(surface.normal, SUN, INDEX)
    straight = -refract_to_water(SUN, INDEX)[[0, 2]] / refract_to_water(SUN, INDEX)[1]
    hit = surface.position[:, [0, 2]] + slope * (surface.position[:, 1:2] + depth_m)
    points = np.insert(hit, 1, -depth_m, axis=1) - scene.view.position
    found = ground_slopes(scene, points)
    assert np.abs(slope - straight).max() > 10.0 * tol.SLOPE_OF_A_RAY
    np.testing.assert_allclose(found[:, :2], slope - straight, atol=tol.SLOPE_OF_A_RAY)


def test_single_precision_has_the_same_slopes() -> None:
    sea = GerstnerSea(wind_speed=3.0, seed=5)
    summed = summed_stack(sea, SUN, np.array([DEPTH_M]), 0.3, SETTINGS, INDEX, None, DEPTH_M)
    for one, other in zip(stack_over(sea, DEPTH_M, 0.3).slopes, summed.slopes, strict=True):
        assert np.sqrt(np.mean((mean_slopes(one) - mean_slopes(other)) ** 2)) < tol.SLOPES_SUMMED
    assert summed_stack(sea, SUN, np.array([DEPTH_M]), 0.3, SETTINGS, INDEX, None).slopes == ()


def with_stack(stack: CausticStack, depth_m: float) -> Shot:
    """Return a shot with a ball over ground that lies `depth_m` below the surface, and the sun in the water."""
    sun = Sun(refract_to_water(SUN, INDEX), np.ones(3), 0.00465 / INDEX, 1.0)
    ball = placed(sphere(32, radius=RADIUS_M), (0.0, HEIGHT_M - depth_m, 0.0))
    scene = shot(ball, width=512, sun=sun, sun_samples=16)
    return replace(scene, view=replace(scene.view, surface_y_m=0.0), caustics=stack)


def photons(sea: GerstnerSea, points: Floats, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return the light (n, n) in squares about points (n, n, 3) of the ground, without the ball and with it."""
    side, n = float(points[0, 1, 0] - points[0, 0, 0]), len(points)
    down, corner = -refract_to_water(SUN, INDEX), points[0, 0, [0, 2]] - 0.5 * side
    every, kept = np.zeros((2, n * n))
    wide, entry = n * side + 1.6, corner - down[[0, 2]] * (DEPTH_M / -down[1])
    for _ in range(12):
        x, z = (entry[k] - 0.8 + wide * rng.random(400_000) for k in range(2))
        surface = sea.surface(x, z, 0.0)
        slope = ray_slope(surface.normal, SUN, INDEX)
        light = np.abs(surface.jacobian) * np.maximum(surface.normal @ SUN / surface.normal[:, 1], 0.0)
        hit = surface.position[:, [0, 2]] + slope * (surface.position[:, 1:2] + DEPTH_M)
        i, j = np.floor((hit - corner) / side).astype(np.int64).T
        there = (i >= 0) & (i < n) & (j >= 0) & (j < n)
        way, ball = unit(np.insert(slope, 1, -1.0, axis=1)), np.array([0.0, HEIGHT_M - DEPTH_M, 0.0])
        apart = np.linalg.norm(np.cross(ball - np.insert(hit, 1, -DEPTH_M, axis=1), way), axis=-1)
        every += np.bincount((j * n + i)[there], light[there], n * n)
        free = there & (apart > RADIUS_M)
        kept += np.bincount((j * n + i)[free], light[free], n * n)
    return every.reshape(n, n), kept.reshape(n, n)


def test_shadows_are_bent_as_photons_say(rng: np.random.Generator) -> None:
    """Within 0.2 m of the edge of a ball's shadow, 2 m below it: the light is that of photons which it stops."""
    sea = GerstnerSea(wind_speed=3.0, wind_direction_deg=30.0, tile_m=16.0, seed=5, detail_slope=0.0)
    scene = with_stack(stack_over(sea, DEPTH_M), DEPTH_M)
    down = -refract_to_water(SUN, INDEX)
    foot, at = down[[0, 2]] * (HEIGHT_M / -down[1]), (np.arange(54) - 26.5) * 0.03
    x, z = np.meshgrid(foot[0] + at, foot[1] + at)
    points = np.stack([x, np.full_like(x, -DEPTH_M), z], axis=-1)
    every, kept = photons(sea, points, rng)
    source = SunSource(scene.lights[0], scene, Blockers(scene))
    near = (points - scene.view.position).reshape(-1, 3)
    bent, straight = (source.visibility(near, on_ground=waves).reshape(x.shape) for waves in (True, False))
    ball = np.array([0.0, HEIGHT_M - DEPTH_M, 0.0])
    edge = np.abs(np.linalg.norm(np.cross(ball - points, -down), axis=-1) - RADIUS_M) < 0.2 * -down[1]
    truth = kept / np.maximum(every, 1e-9)
    off = [float(np.sqrt(np.mean((seen - truth)[edge] ** 2))) for seen in (bent, straight)]
    assert off[0] < tol.BENT_SHADOW < 0.5 * off[1], off
