# SPDX-License-Identifier: Apache-2.0
"""Distances by the disparity of two eyes, their files, and bodies behind what both eyes see nearer."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

import mr360uw as uw
from mr360uw.base.sphere import directions
from mr360uw.cli import app
from mr360uw.depth import clip_eyes
from mr360uw.depth.clip_eyes import eye_distances
from mr360uw.depth.depth_files import DepthClip
from mr360uw.depth.sphere_stereo import DepthMap
from mr360uw.errors import ParameterError
from mr360uw.types import ray_starts
from tests.depth import tolerances
from tests.depth.own_maps import write_own_maps
from tests.depth.test_occlusion import BODY_M, SIZE
from tests.scenes import scene_with
from tests.test_stereo import two_eyes

WIDTH = 512
CENTRE = np.array([0.3, 0.1, -0.2])
"""Of a mottled ball of radius 1.1 m around the camera: distances from 0.7 to 1.5 m."""


def eye(eye_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the grey picture of an eye within the ball, and its distances."""
    rays = directions(WIDTH, WIDTH // 2)
    start = ray_starts(rays, np.array([0.0, 1.0, 0.0]), eye_m) - CENTRE
    along = (rays * start).sum(axis=-1)
    far = np.sqrt(along**2 + 1.1**2 - (start * start).sum(axis=-1)) - along
    waves = np.random.default_rng(1).normal(0.0, 30.0, (3, 60))
    grey = 128.0 + 8.0 * np.cos((start + far[..., None] * rays) @ waves).sum(axis=-1)
    return np.clip(grey, 0.0, 255.0).astype(np.float32), far


def test_eyes_tell_distances_within_three_per_cent() -> None:
    (left, far_left), (right, far_right) = eye(-0.032), eye(0.032)
    for found, far in zip(eye_distances(left, right), (far_left, far_right), strict=True):
        sure = found.confidence >= 0.5
        assert sure.mean() > 0.4
        error = np.abs(found.distance_m / far - 1.0)[sure]
        assert np.median(error) < tolerances.EYES
        assert np.mean(error < tolerances.WITHIN) > tolerances.RIGHT
    apart = eye_distances(left, right, 0.128)[0].distance_m[100, 100]
    assert apart == pytest.approx(2.0 * eye_distances(left, right)[0].distance_m[100, 100])
    swapped = eye_distances(right, left)[0]
    assert np.mean(swapped.confidence >= 0.5) < 0.05


def test_a_stereo_picture_gets_the_maps_of_both_eyes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plate = tmp_path / "stereo.png"
    both = np.concatenate([eye(-0.032)[0], eye(0.032)[0]]).astype(np.uint8)
    cv2.imwrite(str(plate), cv2.merge([both] * 3))
    done = CliRunner().invoke(app, ["depth", str(plate), "-o", str(tmp_path / "depth"), "--eye", "both"])
    assert done.exit_code == 0, done.output
    assert "1 maps written" in done.output
    clip = DepthClip(tmp_path / "depth")
    assert clip.of_both_eyes
    left, right = clip.at(0), clip.at(0, right=True)
    assert np.median(np.abs(right.distance_m / eye(0.032)[1] - 1.0)[right.confidence >= 0.5]) < tolerances.EYES
    assert not np.array_equal(left.distance_m, right.distance_m)
    again = uw.depth.depth_of_eyes(plate, tmp_path / "depth")
    assert (again.written, again.kept) == (0, 1)
    with pytest.raises(ParameterError, match="multiple of 8"):
        uw.depth.depth_of_eyes(plate, tmp_path / "other", width=100)
    for wrong in (["--eye", "left", "--ipd", "0.06"], ["--eye", "both", "--track", str(plate)]):
        refused = CliRunner().invoke(app, ["depth", str(plate), "-o", str(tmp_path / "o"), *wrong])
        assert isinstance(refused.exception, ParameterError)
    monkeypatch.setattr(clip_eyes, "_METHOD", "another")
    with pytest.raises(uw.errors.OutputExistsError):
        uw.depth.depth_of_eyes(plate, tmp_path / "depth")


def test_a_body_is_hidden_in_the_eye_that_sees_something_nearer(tmp_path: Path, whale: Path) -> None:
    folder = tmp_path / "depth"
    shape = SIZE[::-1]
    near, far = (DepthMap(np.full(shape, m, np.float32), np.ones(shape, np.float32)) for m in (0.5 * BODY_M, 9.0))
    write_own_maps(folder, {0: (near, far)})
    plate = two_eyes(tmp_path / "pair.png", *SIZE)
    scene = scene_with(
        tmp_path, whale, plate={"path": str(plate), "eye": "both", "depth": str(folder)}, water={"type": "none"}
    )
    uw.composite_video(scene, tmp_path / "out.png", backend="reference")
    before, after = (np.split(cv2.imread(str(path)), 2) for path in (plate, tmp_path / "out.png"))
    assert np.array_equal(before[0], after[0])
    assert np.any(before[1] != after[1], axis=-1).mean() > 0.001
