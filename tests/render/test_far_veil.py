# SPDX-License-Identifier: Apache-2.0
"""What is far away becomes what the plate shows there, in both renderers, whatever type of water is named."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mr360uw as uw
from mr360uw.base.color import encode
from mr360uw.base.sphere import directions
from tests.medium.tolerances import OPEN_WATER_CODES
from tests.scenes import BACKENDS, scene_with
from tests.tolerances import RENDERERS_CODES

SIZE = (256, 128)


def plate(exposure: float = 1.0) -> np.ndarray:
    """Return teal water, lighter and redder on one side, over a rough bright ground."""
    ray = directions(*SIZE)
    light = np.exp(1.2 * ray[..., 1:2] + ray[..., :1] * [0.6, 0.3, 0.1]) * [0.03, 0.2, 0.22]
    rough = np.random.default_rng(1).uniform(0.2, 0.9, (*SIZE[::-1], 3))
    return (exposure * np.where(ray[..., 1:2] < -0.45, rough, light)).astype(np.float32)


def codes(image: np.ndarray) -> np.ndarray:
    return 255.0 * encode(np.clip(image, 0.0, 1.0), "srgb")


def far_body(folder: Path, whale: Path, backend: str, distance_m: float = 4000.0, **water: Any) -> tuple[Any, Any]:
    """Return the picture of a whale 50 degrees long, 10 below the horizon to the right, and where it is whole."""
    away = np.array([0.7, -0.17, -0.7]) * distance_m
    body = {"mesh": str(whale), "position_m": away.tolist(), "size_m": distance_m, "rotation_deg": [45.0, 0.0, 0.0]}
    scene = scene_with(folder, None, object=[body], light={"sun": "none"}, camera={"depth_m": 8.0}, water=water)
    frame = uw.render_frame(plate(), scene, backend=backend)
    whole = np.zeros(SIZE[::-1], bool)
    for tile in frame.layer.tiles:
        whole[tile.window] = tile.alpha > 0.999
    assert whole.sum() > 30
    return frame.image_linear, whole


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("water", [{"type": "IB"}, {"type": "5C"}, {"type": "II", "visibility_m": 12.0}])
def test_a_body_far_away_is_the_plate_s_water(tmp_path: Path, whale: Path, backend: str, water: dict[str, Any]) -> None:
    picture, whole = far_body(tmp_path, whale, backend, **water)
    assert np.abs(codes(picture) - codes(plate()))[whole].max() < OPEN_WATER_CODES
    flat, whole = far_body(tmp_path, whale, backend, mode="table", **water)
    assert np.abs(codes(flat) - codes(plate()))[whole].max() > 4.0 * OPEN_WATER_CODES  # one colour all round


def test_solved_veils_vary_less_about_the_sun_over_a_bright_floor(tmp_path: Path, whale: Path) -> None:
    """A floor's light is alike on all sides, also in scenes that take nothing from the plate's open water."""
    water = {"type": "1C", "mode": "table", "sun_share": 0.6, "sun_elevation_deg": 45.0}
    light = {"sun": "given", "sun_azimuth_deg": 0.0, "sun_elevation_deg": 45.0}
    spread = []
    for floor in (0.0, 1.0):
        shown = np.where(directions(*SIZE)[..., 1:2] < -0.1, floor * np.array([0.03, 0.2, 0.22]), plate())
        scene = scene_with(
            tmp_path, whale, camera={"depth_m": 5.0}, receiver={"height_m": -2.0}, light=light, water=water
        )
        medium = uw.render_frame(shown.astype(np.float32), scene, backend="reference").medium
        assert medium is not None
        assert medium.plate_ratio is not None
        below = medium.plate_ratio[round(0.55 * len(medium.plate_ratio))]  # 9 degrees below the horizon
        spread.append(np.log(below.max(axis=0) / below.min(axis=0)))
    assert np.all(spread[1] < 0.8 * spread[0])
    assert np.all(spread[1] > 0.05)


def test_both_renderers_veil_alike(tmp_path: Path, whale: Path) -> None:
    pictures = [far_body(tmp_path, whale, backend, 8.0, type="II", visibility_m=15.0) for backend in BACKENDS]
    (one, inside), (other, _) = pictures
    assert np.abs(codes(one) - codes(other))[inside].mean() < RENDERERS_CODES


def test_a_type_of_one_visibility_hardly_changes_a_body(tmp_path: Path, whale: Path) -> None:
    found = []
    for name in ("IB", "II", "1C", "5C"):
        picture, whole = far_body(tmp_path, whale, "reference", 6.0, type=name, visibility_m=15.0)
        found.append(codes(picture)[whole].mean(axis=0))
    assert np.ptp(found, axis=0).max() < 15.0
