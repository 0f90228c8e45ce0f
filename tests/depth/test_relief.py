# SPDX-License-Identifier: Apache-2.0
"""The plate's relief as a receiver: shapes of noisy maps, what stands where they are not sure, shadows on a rock."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mr360uw as uw
from mr360uw.base.sphere import directions, unit
from mr360uw.composite.receiver.shape import touching_planes
from mr360uw.composite.shot import Receiver
from mr360uw.depth.occlusion import MOST_COLUMNS, OFF, on_relief
from mr360uw.depth.sphere_stereo import DepthMap
from mr360uw.render.loaded import load
from mr360uw.types import Floats, View
from tests.depth import tolerances
from tests.depth.own_maps import write_own_maps
from tests.scenes import BACKENDS, scene_with

WIDTH, FLOOR_Y, FAR_M = 512, -1.5, 12.0
ROCK, RADIUS_M = np.array([0.3, -1.5, -2.6]), 0.8
NOISE = 0.0025


def scene_m(width: int) -> tuple[Floats, Floats]:
    """Return distances (H, W) [m] of a floor with a round rock, infinite beyond 12 m, and normals (H, W, 3)."""
    d = directions(width, width // 2)
    with np.errstate(divide="ignore"):
        floor = np.where(d[..., 1] < 0.0, FLOOR_Y / d[..., 1], np.inf)
    floor = np.where(floor < FAR_M, floor, np.inf)
    along = d @ ROCK
    inside = along**2 - ROCK @ ROCK + RADIUS_M**2
    rock = np.where((inside > 0.0) & (along > 0.0), along - np.sqrt(np.maximum(inside, 0.0)), np.inf)
    on_rock = rock < floor
    distance = np.where(on_rock, rock, floor)
    point = d * np.where(np.isfinite(distance), distance, 0.0)[..., None]
    return distance, np.where(on_rock[..., None], unit(point - ROCK), [0.0, 1.0, 0.0])


def found(distance_m: Floats, sure: Floats | float = 1.0) -> DepthMap:
    known = np.isfinite(distance_m)
    return DepthMap(distance_m.astype(np.float32), np.where(known, sure, 0.0).astype(np.float32))


def view(width: int = WIDTH) -> View:
    return View(width, width // 2)


def shape_of(map_: DepthMap, extent_m: float = 30.0) -> Floats:
    shape = on_relief(Receiver(plane_y=FLOOR_Y, extent_m=extent_m), map_, view()).distance_m
    assert shape is not None
    return np.asarray(shape, np.float64)


def test_normals_of_a_noisy_map_are_those_of_floor_and_rock() -> None:
    true, normal = scene_m(1024)
    noisy = true * (1.0 + NOISE * np.random.default_rng(1).standard_normal(true.shape))
    shape = shape_of(found(noisy))
    seen = np.isfinite(true)
    assert np.abs(shape[seen] / noisy[seen] - 1.0).max() < 1.03 * OFF
    near = seen & (true < 6.0)
    for distance, least, most in ((noisy, 10.0, 90.0), (shape, 0.0, tolerances.NORMAL_DEG)):
        planes = touching_planes(distance)[near]
        turned = np.degrees(np.arccos(np.clip(np.sum(unit(-planes) * normal[near], -1), -1.0, 1.0)))
        for of in (normal[near][:, 1] > 0.999, normal[near][:, 1] < 0.99):
            assert least < np.median(turned[of]) < most


def test_what_is_not_sure_is_used_between_sure_distances_alone() -> None:
    true, _ = scene_m(WIDTH)
    own, sure = true.copy(), np.isfinite(true).astype(np.float64)
    beside, fish, above = np.s_[175:185, 230:260], np.s_[170:176, 60:66], np.s_[20:30, 200:220]
    sure[beside] = sure[fish] = 0.0
    own[fish] = 0.6  # nearer than all about it
    own[above], sure[above] = 3.0, 0.3  # open water, far from anything
    shape = shape_of(found(own, sure))
    assert np.median(np.abs(shape[beside] / true[beside] - 1.0)) < OFF
    assert np.abs(shape[fish] / true[fish] - 1.0).max() < 0.1  # the plane's, smoothed with what is about it
    assert np.all(np.isinf(shape[above]))
    # where the map knows nothing the receiver's own shape stands, which reaches as far as it does
    nothing = shape_of(found(np.full_like(true, np.inf)), FAR_M)
    floor, _ = scene_m(WIDTH)
    height = directions(WIDTH, WIDTH // 2)[..., 1] * np.where(np.isfinite(floor), floor, 0.0)
    plain = np.abs(height - FLOOR_Y) < 1e-6
    assert np.abs(nothing[plain] / floor[plain] - 1.0).max() < 1.03 * OFF


def test_large_maps_are_reduced_without_a_shift() -> None:
    """A tilted plane: half a pixel beside it would be a per cent off."""
    down = unit([0.3, 1.0, -0.2])
    shape, true = (
        np.where(d @ down < -0.15, FLOOR_Y / np.minimum(d @ down, -1e-9), np.inf)
        for d in (directions(n, n // 2) for n in (2 * MOST_COLUMNS, MOST_COLUMNS))
    )
    receiver = on_relief(Receiver(plane_y=FLOOR_Y), found(shape), view())
    assert receiver.distance_m is not None
    assert receiver.distance_m.shape == true.shape
    inside = true < 8.0
    assert np.median(np.abs(receiver.distance_m[inside] / true[inside] - 1.0)) < 0.001


def test_an_eye_sees_the_relief_from_its_own_place() -> None:
    left = replace(view(), eye_m=-0.3)
    nothing = found(np.full((WIDTH // 2, WIDTH), np.inf))
    seen = on_relief(Receiver(plane_y=FLOOR_Y), nothing, left).distance_m
    assert seen is not None
    d = directions(WIDTH, WIDTH // 2)
    point = left.points(d, np.where(np.isfinite(seen), seen, 1.0))
    near = np.isfinite(seen) & (np.asarray(seen) < 6.0)
    assert np.abs(point[near][:, 1] / FLOOR_Y - 1.0).max() < 1.03 * OFF


def triangles() -> Floats:
    """Return the floor and the rock as triangles (T, 3, 3)."""
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=5, radius=RADIUS_M)
    a, b, c, d = (np.array([x, FLOOR_Y, z]) for x, z in ((-12, -12), (-12, 12), (12, 12), (12, -12)))
    return np.concatenate([np.asarray(ball.triangles) + ROCK, np.array([[a, b, c], [a, c, d]])])


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_shadow_falls_on_the_rock(backend: str, tmp_path: Path, whale: Path, request: pytest.FixtureRequest) -> None:
    """Against a mesh of floor and rock; on the level floor alone it is elsewhere."""
    if backend == "gl":
        request.getfixturevalue("gl")
    import trimesh

    mesh = tmp_path / "ground.ply"
    corners = triangles()
    trimesh.Trimesh(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3), process=False).export(mesh)
    depth = tmp_path / "depth"
    noisy = scene_m(2 * WIDTH)[0] * (1.0 + NOISE * np.random.default_rng(2).standard_normal((WIDTH, 2 * WIDTH)))
    write_own_maps(depth, {0: (found(noisy),)})
    body = {"mesh": str(whale), "position_m": [0.2, 0.3, -2.5], "size_m": 1.2}
    image = np.full((WIDTH // 2, WIDTH, 3), 0.3, np.float32)

    def ratio(receiver: dict[str, Any], **plate: Any) -> Floats:
        scene = scene_with(
            tmp_path, whale, plate={"path": str(tmp_path / "plate.png")} | plate, water={"type": "none"},
            object=[body], receiver=receiver,
            light={"sun": "given", "sun_azimuth_deg": 20.0, "sun_elevation_deg": 75.0, "direct_to_diffuse": 1.5},
        )  # fmt: skip
        made = np.ones((*image.shape,))
        for tile in uw.render_frame(image, scene, backend=backend, index=0).layer.tiles:
            made[tile.window] = tile.ratio
        return made.mean(axis=-1)

    plane = {"height_m": FLOOR_Y}
    truth, relief, level = ratio({"kind": "mesh", "path": str(mesh)}), ratio(plane, depth=str(depth)), ratio(plane)
    shaded = truth < 0.9
    assert shaded.sum() > 200
    assert np.abs(relief - truth)[shaded].mean() < tolerances.RELIEF_RATIO
    assert np.abs(level - truth)[shaded].mean() > 4.0 * tolerances.RELIEF_RATIO


def test_a_floor_far_from_the_depth_of_the_plate_is_said(tmp_path: Path, whale: Path) -> None:
    depth = tmp_path / "depth"
    write_own_maps(depth, {0: (found(scene_m(WIDTH)[0]),)})
    for height_m, said in ((FLOOR_Y, False), (1.1 * FLOOR_Y, False), (0.7 * FLOOR_Y, True), (2.0 * FLOOR_Y, True)):
        scene = scene_with(
            tmp_path, whale, plate={"path": str(tmp_path / "plate.png"), "depth": str(depth)}, water={"type": "none"},
            receiver={"height_m": height_m},
        )  # fmt: skip
        notes = [note for note in load(scene, WIDTH, WIDTH // 2).notes if "plate.depth" in note]
        assert bool(notes) == said
        if said:
            assert "receiver.height_m" in notes[0]
