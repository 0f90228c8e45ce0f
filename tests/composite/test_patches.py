# SPDX-License-Identifier: Apache-2.0
"""Blocked light between samples on level ground, against the sweep of every place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mr360uw.base.cache import Cache
from mr360uw.composite.ambient.blocked_light import most_blocked
from mr360uw.composite.ambient.ground_light import SMOOTH_PATCH, ground_field, make_quadtree
from mr360uw.composite.ambient.solver import ambient_light, free_of_bodies
from mr360uw.composite.shot import BetweenSamples, Receiver, Shot
from mr360uw.types import Floats
from tests.composite import tolerances as tol
from tests.composite.scenes import box, changed, environment, placed, shot, sphere

FLOOR_Y_M = -1.2


@pytest.fixture(scope="module")
def scene() -> Shot:
    """A ball on the ground, one above it that hides the first from some places, and a turned box."""
    bodies = (
        placed(sphere(radius=0.3), (0.4, -0.9, -1.8)),
        placed(sphere(radius=0.2), (0.5, -0.4, -1.3)),
        placed(box((0.5, 0.3, 0.4)), (-0.6, -1.0, -1.7), (25, 0, 0)),
    )
    return shot(*bodies, width=1024, environment=environment(), receiver=Receiver(plane_y=FLOOR_Y_M))


def places(rng: np.random.Generator, count: int) -> tuple[Floats, Floats]:
    """Return points of the ground around the bodies, and normals, each (count, 3)."""
    x, z = rng.uniform(-2.5, 2.5, count), rng.uniform(-4.0, 0.5, count)
    return np.stack([x, np.full(count, FLOOR_Y_M), z], axis=-1), np.tile([0.0, 1.0, 0.0], (count, 1))


def test_values_between_samples_are_those_of_every_place(scene: Shot, rng: np.random.Generator) -> None:
    """Also where one body hides another; places at the box's outline, where light jumps, are few."""
    cache, (point, normal) = Cache(), places(rng, 8000)
    light = ambient_light(scene, cache)
    each = free_of_bodies(scene, light, point, normal, cache)
    wrong = np.abs(ground_field(scene, light, cache).at(point, normal) - each).max(axis=-1)
    assert np.abs(1.0 - each).max() > 0.5
    assert np.sqrt(np.mean(wrong**2)) < tol.BETWEEN_SAMPLES
    assert np.mean(wrong > 4.0 * tol.BETWEEN_SAMPLES) < tol.AT_OUTLINES


def test_ground_beyond_its_extent_keeps_all_of_its_light(rng: np.random.Generator) -> None:
    """No square of it is near enough to be sampled."""
    far = shot(
        placed(sphere(radius=0.3), (0.0, -0.8, -60.0)), width=256, environment=environment(),
        receiver=Receiver(plane_y=FLOOR_Y_M, extent_m=2.0),
    )  # fmt: skip
    cache, (point, normal) = Cache(), places(rng, 100)
    np.testing.assert_array_equal(ground_field(far, ambient_light(far, cache), cache).at(point, normal), 1.0)


def test_patches_of_different_size_meet_without_a_step(scene: Shot, rng: np.random.Generator) -> None:
    """Any values at the samples: to both sides of the lines of all squares they are the same."""
    light = ambient_light(scene, Cache())
    assert light is not None
    origin = light.layout.below(FLOOR_Y_M)
    patches = make_quadtree(light.layout.occluders_from(origin), -origin, 2.0 * np.pi / 256, 8.0)
    assert len(patches.hanging) > 0
    patches.kind[patches.kind > 0] = SMOOTH_PATCH
    values = patches.joined(rng.uniform(size=(len(patches.place), 1)))
    size = patches.root_m / 2**5
    across = patches.low[0] + size * np.arange(1, int(patches.roots[0]) * 2**5)
    along = patches.low[1] + patches.root_m * patches.roots[1] * rng.uniform(size=400)
    x, z = (g.ravel() for g in np.meshgrid(across, along, indexing="ij"))
    point, step = np.stack([x, np.zeros_like(x), z], axis=-1), np.array([1e-9, 0.0, 0.0])
    beside = [patches.between(values, point + way * step, np.nan)[0] for way in (-1.0, 1.0)]
    there = np.isfinite(beside[0]) & np.isfinite(beside[1])
    assert np.count_nonzero(there) > 1000
    np.testing.assert_allclose(beside[0][there], beside[1][there], atol=1e-5)


def test_new_light_on_what_is_kept_gives_what_it_gives_with_nothing_kept(scene: Shot, rng: np.random.Generator) -> None:
    cache, (point, normal) = Cache(), places(rng, 200)
    ground_field(scene, ambient_light(scene, cache), cache).at(point, normal)
    new = changed(scene, environment=environment(0.3))
    expected = ground_field(new, ambient_light(new, Cache()), Cache()).at(point, normal)
    np.testing.assert_array_equal(ground_field(new, ambient_light(new, cache), cache).at(point, normal), expected)


def test_bodies_that_move_together_have_the_light_that_they_have_with_nothing_kept(
    scene: Shot, rng: np.random.Generator
) -> None:
    cache, (point, normal) = Cache(), places(rng, 200)
    ground_field(scene, ambient_light(scene, cache), cache).at(point, normal)
    step = np.eye(4)
    step[[0, 2], 3] = 0.013, 0.021
    moved = changed(
        scene, objects=tuple(replace(o, world_from_object=step @ o.world_from_object) for o in scene.objects)
    )
    expected = ground_field(moved, ambient_light(moved, Cache()), Cache()).at(point, normal)
    found = ground_field(moved, ambient_light(moved, cache), cache).at(point, normal)
    np.testing.assert_array_equal(found, expected)


def test_between_samples_in_time_bodies_high_above_the_ground_block_what_they_do_then(rng: np.random.Generator) -> None:
    """Two that move, one to the other and upwards, and turn: each place's light is that of the time itself."""
    cache, (point, normal) = Cache(), places(rng, 4000)
    long, ball = box((0.3, 0.2, 0.9)), sphere(radius=0.2)

    def at(share: float) -> Shot:
        swimming = placed(long, (0.05 * share, -0.5 + 0.02 * share, -1.8), (4.0 * share, 0, 0))
        bodies = swimming, placed(ball, (-0.6, -0.7, -1.5 + 0.02 * share))
        return shot(*bodies, width=1024, environment=environment(), receiver=Receiver(plane_y=FLOOR_Y_M))

    then = at(0.4)
    samples = [at(0.0), at(1.0)]
    between = replace(then, between=BetweenSamples(samples[0], samples[1], 0.4))
    field = ground_field(between, ambient_light(between, cache), cache)
    assert len(field.patches) == 2
    want = free_of_bodies(then, ambient_light(then, Cache()), point, normal, Cache())
    wrong = np.abs(field.at(point, normal) - want).max(axis=-1)
    assert want.min() < 0.9
    assert np.sqrt(np.mean(wrong**2)) < tol.BETWEEN_SAMPLES
    assert np.mean(wrong > 4.0 * tol.BETWEEN_SAMPLES) < tol.AT_OUTLINES


@pytest.mark.parametrize("height", [0.002, 0.3, 2.0])
def test_no_light_is_lost_beyond_the_bound(rng: np.random.Generator, height: float) -> None:
    """A flat card reaches to its corners; a tall box far."""
    card = placed(box((1.0, height, 0.4)), (0.0, FLOOR_Y_M + 0.5 * height, -1.5), (30, 0, 0))
    scene = shot(card, width=1024, environment=environment(1.0), receiver=Receiver(plane_y=FLOOR_Y_M))
    light = ambient_light(scene, Cache())
    assert light is not None
    point, normal = places(rng, 3000)
    (field,) = (body.field for body in light.layout.bodies if body.field is not None)
    away = point[:, [0, 2]] - light.layout.bodies[0].origin[[0, 2]] - field.frame[:2]
    along, across = away @ field.frame[2:4], away @ [-field.frame[3], field.frame[2]]
    beside = sum(
        np.maximum(np.abs(a) - half, 0.0) ** 2 for a, half in zip((along, across), field.frame[4:], strict=True)
    )
    share = light.layout.occluders.blocked(point, normal).share[0]
    wide, top = float(field.frame[4] ** 2 + field.frame[5] ** 2), height
    bound = [most_blocked(float(s), float(b), wide, top) for s, b in zip(along**2 + across**2, beside, strict=True)]
    assert share.max() > 0.9
    assert np.all(share <= np.array(bound) + tol.QUADRATURE)
