# SPDX-License-Identifier: Apache-2.0
"""Bodies behind what the plate's depth says is nearer: both renderers, maps of others, edges."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import mr360uw as uw
from mr360uw.depth.depth_files import DepthClip
from mr360uw.depth.occlusion import enlarged, sure_surfaces
from mr360uw.depth.sphere_stereo import DepthMap
from mr360uw.errors import SceneError, VideoError
from mr360uw.scene.model import Scene
from mr360uw.types import Floats
from mr360uw.video.exr import write_exr
from tests.depth import tolerances
from tests.depth.own_maps import write_own_maps
from tests.scenes import BACKENDS, gradient_plate, scene_with

SIZE = (128, 64)
BODY_M = 3.0


def maps(folder: Path, distance_m: Floats, confidence: float = 1.0) -> Path:
    shape = SIZE[::-1]
    sure = np.full(shape, confidence, np.float32)
    write_own_maps(folder, {0: (DepthMap(np.broadcast_to(distance_m, shape).astype(np.float32), sure),)})
    return folder


def alpha_of(scene: Scene, backend: str) -> Floats:
    return np.asarray(uw.render_frame(gradient_plate(*SIZE), scene, backend=backend, sun=None).layer.alpha)


def scene_of(tmp_path: Path, whale: Path, depth: Path | None, **more: Any) -> Scene:
    plate = {"path": str(tmp_path / "plate.png")} | ({} if depth is None else {"depth": str(depth)}) | more
    (tmp_path / "plate.png").touch()
    across = {"mesh": str(whale), "position_m": [0.0, 0.0, -BODY_M], "face": 90.0}
    return scene_with(tmp_path, whale, plate=plate, water={"type": "none"}, object=[across])


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_body_behind_a_wall_is_gone_and_one_in_front_stays(
    backend: str, tmp_path: Path, whale: Path, request: pytest.FixtureRequest
) -> None:
    if backend == "gl":
        request.getfixturevalue("gl")
    free = alpha_of(scene_of(tmp_path, whale, None), backend)
    assert free.max() > 0.9
    wall = maps(tmp_path / "near", np.float32(0.5 * BODY_M))
    assert alpha_of(scene_of(tmp_path, whale, wall), backend).max() == 0.0
    for name, distance, confidence in (("far", 10.0, 1.0), ("doubtful", 0.5 * BODY_M, 0.4)):
        behind = maps(tmp_path / name, np.float32(distance), confidence)
        np.testing.assert_array_equal(alpha_of(scene_of(tmp_path, whale, behind), backend), free)
    half = maps(tmp_path / "half", np.where(np.arange(SIZE[0]) < 64, 1.0, 10.0))
    cut = alpha_of(scene_of(tmp_path, whale, half), backend)
    assert np.all(cut[:, :63] == 0.0)
    np.testing.assert_array_equal(cut[:, 66:], free[:, 66:])
    edge = (free > 0.99)[:, 62:66].all(axis=1)
    assert edge.any()
    soft = cut[edge, 63:65]
    assert np.all((soft > 0.2) & (soft < 0.8))


def test_small_maps_keep_to_the_edges_of_the_picture() -> None:
    """A slanted edge of a near thing, in a map of a quarter of the size: fraction of each pixel against truth."""
    rows, columns = np.mgrid[0:128, 0:256]
    near = columns + 0.4 * rows < 130.0
    near[:, :40] = False
    covered = cv2.blur(near.astype(np.float32), (2, 2))
    middles = cv2.resize(near.astype(np.float32), (64, 32), interpolation=cv2.INTER_AREA) > 0.5
    found = enlarged(np.where(middles, 2.0, 8.0).astype(np.float32), 150.0 - 90.0 * covered)
    assert found.beside_m is not None
    assert found.share is not None
    for metres in (found.distance_m, found.beside_m):
        assert np.all(np.isclose(metres, 2.0) | np.isclose(metres, 8.0))
    part = np.where(found.distance_m < 4.0, 1.0 - found.share, np.where(found.beside_m < 4.0, found.share, 0.0))
    wide = np.ones((9, 9), np.uint8)
    band = cv2.dilate(near.astype(np.uint8), wide) != cv2.erode(near.astype(np.uint8), wide)
    wrong = np.abs(part - covered)[band].mean()
    plain = cv2.resize(middles.astype(np.float32), (256, 128), interpolation=cv2.INTER_LINEAR)
    assert wrong < 0.2 * np.abs(plain - covered)[band].mean()
    assert wrong < tolerances.EDGE


def test_small_maps_are_smooth_where_there_is_one_surface() -> None:
    """A floor that runs away: no steps of the samples, whatever the picture shows."""
    down = np.radians(np.linspace(20.0, 60.0, 64))[:, None] * np.ones(256)
    floor = (1.6 / np.sin(down)).astype(np.float32)
    grain = np.random.default_rng(1).uniform(0.0, 255.0, floor.shape).astype(np.float32)
    found = enlarged(cv2.resize(floor, (64, 16), interpolation=cv2.INTER_AREA), grain)
    assert found.share is not None
    assert not np.any(found.share)
    assert np.abs(found.distance_m / floor - 1.0)[4:-4].max() < 0.01


@pytest.mark.parametrize("kind", ["metric", "inverse"])
@pytest.mark.parametrize("suffix", [".exr", ".png"])
def test_maps_of_other_programs_are_taken(kind: Any, suffix: str, tmp_path: Path) -> None:
    metres = np.linspace(1.0, 8.0, 128, dtype=np.float32)[None].repeat(64, axis=0)
    values, scale = (metres / 10.0, 10.0) if kind == "metric" else (0.5 / metres, 0.5)
    values[5:9, 5:9] = 0.0
    if suffix == ".exr":
        write_exr(tmp_path / "frame7.exr", {"": {"Z": values}})
    else:
        cv2.imwrite(str(tmp_path / "frame7.png"), np.round(65535.0 * values).astype(np.uint16))
    clip = DepthClip(tmp_path, kind, scale)
    found = clip.at(0)
    assert clip.at(0) is found
    assert np.all(np.isinf(found.distance_m[5:9, 5:9]))
    seen = np.isfinite(found.distance_m)
    assert np.allclose(found.distance_m[seen], metres[seen], rtol=2e-3)
    assert np.array_equal(sure_surfaces(found, np.zeros((64, 128), np.float32)).distance_m, found.distance_m)
    with pytest.raises(VideoError, match="no map for frame 1"):
        clip.check(2)


def test_what_is_missing_is_said(tmp_path: Path, whale: Path) -> None:
    with pytest.raises(SceneError, match=r"plate.depth - .*no such file"):
        scene_of(tmp_path, whale, tmp_path / "nowhere")
    folder = maps(tmp_path / "depth", np.float32(5.0))
    with pytest.raises(SceneError, match=r"plate.depth - is of one eye"):
        alpha_of(scene_of(tmp_path, whale, folder, eye="both"), "reference")
    with pytest.raises(VideoError, match=r"depth_00001.exr - is missing"):
        DepthClip(folder).check(2)
    (tmp_path / "empty").mkdir()
    with pytest.raises(VideoError, match="holds no maps"):
        alpha_of(scene_of(tmp_path, whale, tmp_path / "empty"), "reference")
