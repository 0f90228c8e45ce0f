# SPDX-License-Identifier: Apache-2.0
"""What bodies see of each other while they move: continuous, the same anew as from a cache, kept where they rest."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mr360uw.base.cache import Cache
from mr360uw.composite.ambient.mesh_transfer import make_transfer
from mr360uw.composite.ambient.solver import ambient_light, free_of_bodies
from mr360uw.composite.mesh.material import Material
from mr360uw.composite.shot import BetweenSamples, PlacedObject, Receiver, Shot
from mr360uw.types import Floats
from tests.composite import tolerances as tol
from tests.composite.scenes import box, environment, placed, shot, sphere
from tests.tolerances import FLOAT32

GREY = Material(base_color=(0.6, 0.5, 0.4, 1.0), roughness=1.0)
BALL, OTHER, BOX = (
    sphere(16, GREY),
    sphere(24, replace(GREY, base_color=(0.0, 0.0, 0.0, 1.0))),
    box((0.5, 0.4, 0.6), GREY),
)


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MR360UW_CACHE", str(tmp_path))


def ratios(along_m: Floats) -> Floats:
    """Return the light of a ball (places, points) over that in the open, with another at places along a line."""
    cache, found, points = Cache(), [], make_transfer(BALL).lattice.points
    for x in along_m:
        scene = shot(
            placed(BALL, (0.0, 0.0, -2.0)), placed(OTHER, (x, 0.1, -2.0)), environment=environment(0.5), sun=None
        )
        light = ambient_light(scene, cache)
        known = None if light is None else light.values[0]
        found.append(np.ones(points) if known is None else known[:, :3].mean(axis=-1))
    return np.array(found)


def test_a_body_that_swims_away_fades() -> None:
    light = ratios(np.linspace(6.0, 9.0, 31))
    assert np.abs(np.diff(light.mean(axis=1))).max() < tol.SWIMMING_BY
    assert light[0].min() < light[-1].min() - tol.SWIMMING_BY
    alone = ratios(np.array([30.0, 40.0]))
    np.testing.assert_array_equal(alone[0], alone[1])


def test_a_far_body_hides_what_rays_find_of_it() -> None:
    """A black ball in even light, seen from another: the part of the light that its solid angle takes."""
    center, radius = np.array([5.0, 0.1, 0.0]), 0.5
    light = ratios(center[:1])[0]
    lattice = make_transfer(BALL).lattice
    normal = lattice.from_samples @ lattice.normal
    to = center - radius * normal
    apart = np.linalg.norm(to, axis=-1)
    cosine = np.sum(normal * to, axis=-1) / apart
    facing = cosine > 0.5
    want = 1.0 - cosine * (radius / apart) ** 2
    assert np.abs(light - want)[facing].max() < tol.FAR_BODY


def test_a_body_that_passes_changes_light_in_small_steps() -> None:
    light = ratios(np.linspace(3.0, 3.25, 11))
    assert np.abs(np.diff(light, axis=0)).max() < tol.ONE_STEP
    assert light.min() < 1.0 - tol.ONE_STEP


def reef(shift: tuple[float, float, float], turn_deg: float = 0.0, swim_m: float = 0.0) -> Shot:
    """Return a ball, a box and a small ball that swims over them, all shifted; turn_deg: of the box."""
    x, y, z = shift
    things: list[PlacedObject] = [
        placed(BALL, (x - 0.5, y - 0.4, z - 2.0)),
        placed(BOX, (x + 0.4, y - 0.7, z - 2.1), (turn_deg, 0.0, 0.0)),
        placed(OTHER, (x - 0.8 + swim_m, y + 0.3, z - 2.0), scale=0.4),
    ]
    return shot(*things, receiver=Receiver(plane_y=-1.0 + y))


def test_a_used_cache_gives_what_a_fresh_one_gives() -> None:
    used = Cache()
    for k in range(4):
        scene = reef((0.01 * k, 0.0, 0.0), 5.0 * (k // 2), 0.1 * k)
        one, other = ambient_light(scene, used), ambient_light(scene, Cache())
        assert one is not None
        assert other is not None
        for kept, fresh in zip((*one.values, *one.sent), (*other.values, *other.sent), strict=True):
            np.testing.assert_array_equal(kept, fresh)


def test_light_solved_at_samples_in_time_is_interpolated() -> None:
    scene, cache = reef((0.0, 0.0, 0.0)), Cache()
    samples = [replace(scene, environment=environment(level)) for level in (0.4, 0.6)]
    first, last = (ambient_light(replace(scene, environment=sample.environment), Cache()) for sample in samples)
    assert first is not None
    assert last is not None
    for share in (0.0, 0.25, 1.0):
        light = ambient_light(replace(scene, between=BetweenSamples(samples[0], samples[1], share)), cache)
        assert light is not None
        parts = [(*one.values, *one.sent, one.table, one.ambient) for one in (light, first, last)]
        for found, a, b in zip(*parts, strict=True):
            np.testing.assert_allclose(found, (1.0 - share) * a + share * b, rtol=FLOAT32, atol=FLOAT32)


def between_samples(share: float, swim_m: float, turn_deg: float) -> tuple[Shot, Shot]:
    """Return the shot at a share of the way between two samples, and the same without samples."""
    places = [reef((0.0, 0.0, 0.0), at * turn_deg, at * swim_m) for at in (0.0, 1.0, share)]
    return replace(places[2], between=BetweenSamples(places[0], places[1], share)), places[2]


def test_light_of_bodies_that_move_slowly_is_interpolated_between_samples() -> None:
    cache = Cache()
    for share in (0.3, 0.6):
        between, alone = between_samples(share, 0.02, 5.0)
        found, want = ambient_light(between, cache), ambient_light(alone, Cache())
        assert found is not None
        assert want is not None
        pairs = list(zip(found.values, want.values, strict=True))
        assert any(np.any(a != b) for a, b in pairs)
        for a, b in pairs:
            assert np.sqrt(np.mean((a - b) ** 2)) < tol.INTERPOLATED_MOTION
        below = np.array([[0.1, -1.0, -2.0], [-0.6, -1.0, -2.1]])
        up = np.tile([0.0, 1.0, 0.0], (2, 1))
        pair = [free_of_bodies(alone, light, below, up, Cache()) for light in (found, want)]
        np.testing.assert_allclose(pair[0], pair[1], atol=tol.INTERPOLATED_MOTION)


@pytest.mark.parametrize(("swim_m", "turn_deg"), [(0.3, 0.0), (0.0, 20.0)])
def test_light_of_fast_bodies_is_solved_in_every_frame(swim_m: float, turn_deg: float) -> None:
    between, alone = between_samples(0.5, swim_m, turn_deg)
    found, want = ambient_light(between, Cache()), ambient_light(alone, Cache())
    assert found is not None
    assert want is not None
    for a, b in zip(found.values, want.values, strict=True):
        np.testing.assert_array_equal(a, b)


def test_objects_that_shade_nothing_have_no_part_in_ambient_light() -> None:
    scene = reef((0.0, 0.0, 0.0))
    alone = replace(
        scene, objects=tuple(replace(o, casts_shadow=False) for o in scene.objects),
        draw=scene.draw.model_copy(update={"ambient_occlusion": False}),
    )  # fmt: skip
    assert ambient_light(alone, Cache()) is None


def test_coarse_samples_interpolate_a_ball() -> None:
    transfer = make_transfer(OTHER)
    lattice, spread = transfer.lattice, transfer.spread
    assert len(transfer.coarse) < len(lattice.position)
    np.testing.assert_allclose(spread.sum(axis=1), 1.0, atol=tol.FLOAT32_LOOKUP)
    between = spread @ lattice.normal[transfer.coarse]
    assert np.abs(between - lattice.normal).max() < tol.LOOKOUT_PLANE
