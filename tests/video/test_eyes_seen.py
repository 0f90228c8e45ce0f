# SPDX-License-Identifier: Apache-2.0
"""The order of two eyes and the height of the ground, from panoramas of a room whose shape is known."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates

from mr360uw.base.color import encode
from mr360uw.base.sphere import directions
from mr360uw.types import Floats, ray_starts
from mr360uw.video.layout import EYES_APART_M, eyes_seen

Run = Callable[..., tuple[int, str, str]]
ROWS = 512
WALL_M = 15.0
CELL_M = 0.05


def eye(side: float, floor_m: float, *, circle: bool, seed: int = 0) -> Floats:
    """Return what the right (side +1) or the left (-1) eye sees (512, 1024, 3) of a rough floor and a round wall.

    circle: whether its rays start on a circle of one radius, instead of one that shrinks towards the poles.
    """
    ray = directions(2 * ROWS, ROWS)
    start = ray_starts(ray, np.array([0.0, 1.0, 0.0]), 0.5 * side * EYES_APART_M)
    if circle:
        start /= np.hypot(ray[..., 0], ray[..., 2])[..., None]
    down = ray[..., 1] < -0.1
    floor = start + ray * (floor_m / np.where(down, -ray[..., 1], 1.0))[..., None]
    wall = start + ray * (WALL_M / np.hypot(ray[..., 0], ray[..., 2]))[..., None]
    rng = np.random.default_rng(seed)
    rough = np.exp(0.5 * gaussian_filter(rng.standard_normal((512, 512)), 1.0, mode="wrap") / 0.28)
    at_floor = np.stack([floor[..., 0], floor[..., 2]]) / CELL_M
    turn = np.arctan2(wall[..., 0], -wall[..., 2])
    at_wall = np.stack([turn * 512.0 / (2.0 * np.pi) * 1.0, wall[..., 1] * 12.0])
    light = np.where(
        down,
        map_coordinates(rough, at_floor, order=1, mode="grid-wrap"),
        map_coordinates(rough, at_wall, order=1, mode="grid-wrap"),
    )
    return np.repeat(0.15 * light[..., None], 3, axis=-1)


@pytest.mark.parametrize(("floor_m", "circle"), [(1.2, False), (1.6, True)])
def test_the_order_of_the_eyes_and_the_floor(floor_m: float, *, circle: bool) -> None:
    left, right = (eye(side, floor_m, circle=circle) for side in (-1.0, 1.0))
    doubt, seen_m = eyes_seen(left, right, "top-bottom")
    assert doubt == ""
    assert seen_m == pytest.approx(floor_m, rel=0.1)  # a tenth of a pixel of 6 to 11, and the law's choice
    swapped, none = eyes_seen(right, left, "left-right")
    assert "its eyes look swapped" in swapped
    assert 'plate.layout = "right-left"' in swapped
    assert none is None
    turned = np.roll(right, 4, axis=1)  # an offset of 3 degrees everywhere is no order
    assert eyes_seen(left, turned, "top-bottom")[0] == ""
    assert "its eyes look swapped" in eyes_seen(turned, left, "top-bottom")[0]


def test_pictures_that_are_no_two_eyes() -> None:
    one, other = (eye(1.0, 1.5, circle=False, seed=seed) for seed in (1, 2))
    assert 'plate.layout = "mono"' in eyes_seen(one, other, "top-bottom")[0]
    even = np.full((64, 128, 3), 0.2)
    assert eyes_seen(even, even, "top-bottom") == ("", None)


def test_check_and_new_say_that_eyes_are_swapped(tmp_path: Path, run: Run) -> None:
    pictures = [np.round(255.0 * encode(np.clip(eye(s, 1.3, circle=False), 0.0, 1.0), "srgb")) for s in (1.0, -1.0)]
    cv2.imwrite(str(tmp_path / "plate.png"), np.concatenate(pictures).astype(np.uint8))
    scene = tmp_path / "scene.toml"
    scene.write_text('[plate]\npath = "plate.png"\neye = "left"\n[water]\ntype = "none"\n')
    code, said, _ = run("check", scene, "--backend", "reference")
    assert code == 0
    assert "its eyes look swapped" in said
    assert 'set plate.layout = "bottom-top"' in said
    code, said, _ = run("check", scene, "--backend", "reference", "--set", 'plate.layout="bottom-top"')
    assert code == 0
    assert "swapped" not in said
