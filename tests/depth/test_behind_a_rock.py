# SPDX-License-Identifier: Apache-2.0
"""A body that passes behind a rock of known distance: its alpha against that of a picture four times as fine."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import mr360uw as uw
from mr360uw.base.sphere import directions
from mr360uw.depth.sphere_stereo import DepthMap
from mr360uw.types import Floats
from tests.depth import tolerances
from tests.depth.own_maps import write_own_maps
from tests.scenes import BACKENDS, scene_with

WIDTH, FINER, FRAMES = 512, 4, 4
ROCK, RADIUS_M = np.array([0.15, -0.25, -1.8]), 0.45
BEHIND: dict[str, Any] = {"rotation_deg": [-60.0, 5.0, 0.0]}
PLACES = ([-0.5, -0.2, -3.0], [-0.1, -0.2, -3.0], [0.3, -0.2, -3.0], [0.7, -0.2, -3.0])


def rock(width: int) -> Floats:
    """Return the distances (H, W) [m] of a ball, infinite beside it."""
    along = directions(width, width // 2) @ ROCK
    inside = along**2 - ROCK @ ROCK + RADIUS_M**2
    with np.errstate(invalid="ignore"):
        return np.where((inside > 0.0) & (along > 0.0), along - np.sqrt(np.maximum(inside, 0.0)), np.inf)


def plate(frame: int) -> Floats:
    """Return the picture (H, W, 3) of the rock before water, grained, under light that changes from frame to frame."""
    r = np.random.default_rng(frame)
    fine = np.where(np.isfinite(rock(FINER * WIDTH))[..., None], [0.09, 0.08, 0.05], [0.05, 0.22, 0.28])
    spots = cv2.resize(np.random.default_rng(0).uniform(0.7, 1.3, (64, 128)), (FINER * WIDTH, FINER * WIDTH // 2))
    lit = 1.0 + 0.1 * np.sin(1.3 * frame)
    image = cv2.resize(fine * spots[..., None] * lit, (WIDTH, WIDTH // 2), interpolation=cv2.INTER_AREA)
    return (image + r.normal(0.0, 0.002, image.shape)).astype(np.float32)


def maps(folder: Path, width: int) -> Path:
    """Write maps of the rock, those of small ones as the middle of each pixel has it."""
    far = rock(width).astype(np.float32)
    write_own_maps(folder, {k: (DepthMap(far, np.isfinite(far).astype(np.float32)),) for k in range(FRAMES)})
    return folder


def alpha(scene: Any, image: Floats, backend: str, index: int = 0, time_s: float = 0.0) -> Floats:
    made = uw.render_frame(image, scene, index=index, time_s=time_s, backend=backend, sun=None)
    return np.asarray(made.layer.alpha, np.float64)


def band(wide: int = 9) -> np.ndarray:
    """Return the pixels (H, W) about the outline of the rock."""
    near, ones = np.isfinite(rock(WIDTH)).astype(np.uint8), np.ones((wide, wide))
    return np.asarray(cv2.dilate(near, ones) != cv2.erode(near, ones))


def fine_truth(tmp_path: Path, whale: Path, **body: Any) -> Floats:
    """Return the true alpha (H, W): of a body in a fine picture, where the rock is not before it."""
    scene = scene_with(tmp_path, whale, water={"type": "none"}, object=[BEHIND | body | {"mesh": str(whale)}])
    far = FINER * WIDTH
    free = alpha(scene, np.full((far // 2, far, 3), 0.2, np.float32), "reference") * np.isinf(rock(far))
    return np.asarray(cv2.resize(free, (WIDTH, WIDTH // 2), interpolation=cv2.INTER_AREA))


@pytest.mark.parametrize("small", [1, 2, 4])
@pytest.mark.parametrize("backend", BACKENDS)
def test_alpha_along_the_rock(
    backend: str, small: int, tmp_path: Path, whale: Path, request: pytest.FixtureRequest
) -> None:
    if backend == "gl":
        request.getfixturevalue("gl")
    folder = maps(tmp_path / "depth", WIDTH // small)
    for k, place in enumerate(PLACES[1:3]):
        scene = scene_with(
            tmp_path, whale, plate={"path": str(tmp_path / "plate.png"), "depth": str(folder)},
            water={"type": "none"}, object=[BEHIND | {"mesh": str(whale), "position_m": place}],
        )  # fmt: skip
        truth, found = fine_truth(tmp_path, whale, position_m=place), alpha(scene, plate(k), backend, k)
        assert truth.max() > 0.9
        touched = band() & (cv2.dilate(truth, np.ones((9, 9))) > 0.5)
        assert np.abs(found - truth)[touched].mean() < tolerances.EDGE
        assert np.all(found[np.isfinite(rock(WIDTH)) & ~band(4 * small + 5)] == 0.0)


def test_a_body_that_moves_is_blurred_behind_the_rock(tmp_path: Path, whale: Path) -> None:
    samples, shutter_s, speed = 4, 0.2, 1.0
    start = np.array(PLACES[0])
    keys = [{"time_s": t, "position_m": [start[0] + speed * t, *start[1:]]} for t in (0.0, 1.0)]
    body = BEHIND | {"mesh": str(whale), "key": keys, "interpolation": "linear"}
    scene = scene_with(
        tmp_path, whale, plate={"path": str(tmp_path / "plate.png"), "depth": str(maps(tmp_path / "depth", WIDTH))},
        water={"type": "none"}, object=[body], draw={"motion_samples": samples},
    )  # fmt: skip
    made = uw.render_frame(
        plate(0), scene, time_s=0.5, index=0, backend="reference", sun=None, shutter_s=shutter_s
    ).layer.alpha
    times = 0.5 + ((np.arange(samples) + 0.5) / samples - 0.5) * shutter_s
    truth = np.mean([fine_truth(tmp_path, whale, position_m=[start[0] + speed * t, *start[1:]]) for t in times], axis=0)
    touched = band() & (cv2.dilate(truth, np.ones((9, 9))) > 0.5)
    assert np.abs(made - truth)[touched].mean() < tolerances.EDGE


def test_alpha_does_not_flicker_with_grain_and_light(tmp_path: Path, whale: Path) -> None:
    body = BEHIND | {"mesh": str(whale), "position_m": PLACES[1]}
    for small, most in ((1, 0.0), (2, tolerances.FLICKER), (4, tolerances.FLICKER)):
        folder = maps(tmp_path / f"depth{small}", WIDTH // small)
        scene = scene_with(
            tmp_path, whale, plate={"path": str(tmp_path / "plate.png"), "depth": str(folder)}, object=[body],
            water={"type": "none"},
        )  # fmt: skip
        series = [alpha(scene, plate(k), "reference", k) for k in range(FRAMES)]
        assert max(np.abs(a - b)[band()].max() for a, b in pairwise(series)) <= most
