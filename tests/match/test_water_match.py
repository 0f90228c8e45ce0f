# SPDX-License-Identifier: Apache-2.0
"""Matching of water: types, visibilities and gains of patches of open water that a water's own light fills."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from mr360uw.base.sphere import directions
from mr360uw.errors import ParameterError
from mr360uw.match import WaterPatch, match_water
from mr360uw.medium import WaterSettings
from mr360uw.scene import Scene
from mr360uw.scene.model import PlateSettings
from mr360uw.video import write_exr

PATCH = WaterPatch(40.0, 4.0, 16.0)


def plate(path: Path, water: WaterSettings, factor: float = 0.4) -> Path:
    """Write a plate that shows a water alone, as far as 30 degrees from the horizon."""
    medium = water.model_copy(update={"gain": (1.0, 1.0, 1.0)}).medium(6.0)
    assert medium is not None
    up = directions(128, 64)[:, 0, 1]
    rows = factor * medium.level_radiance(up)
    write_exr(path, np.broadcast_to(rows[:, None], (64, 128, 3)).astype(np.float32))
    return path


def scene_of(path: Path, **water: object) -> Scene:
    return Scene.model_validate({"plate": PlateSettings(path=path), "camera": {"depth_m": 6.0}, "water": water})


@pytest.mark.parametrize("name", ["I", "1C", "7C"])
def test_a_type_is_found_again(tmp_path: Path, name: str) -> None:
    path = plate(tmp_path / "plate.exr", WaterSettings(type=name))  # type: ignore[arg-type]
    match = match_water(scene_of(path, type="III"), PATCH)
    assert match.changes == {"water.type": name}
    assert match.overrides == (f"water.type={name}",)
    assert match.candidates[0][0] == name
    assert match.rms_after < 0.5  # rows of the plate are 3 degrees high, those of the fit 1
    assert match.rms_after < match.rms_before
    assert name in match.sentence


def test_frames_that_differ_name_the_same_water_in_a_part_of_their_draws(tmp_path: Path) -> None:
    for number, name in enumerate(["I", "I", "I", "7C"]):
        plate(tmp_path / f"plate_{number:04d}.exr", WaterSettings(type=name))  # type: ignore[arg-type]
    scene = scene_of(tmp_path / "plate_%04d.exr", type="III")
    same, mixed = match_water(scene, PATCH, (0, 3)), match_water(scene, PATCH, (0, 4))
    assert same.agreement == 1.0
    assert "100 % of draws" in same.sentence
    assert 0.1 < mixed.agreement < 0.95
    assert math.isnan(match_water(scene, PATCH, 0).agreement)


def test_a_visibility_is_found_again(tmp_path: Path) -> None:
    path = plate(tmp_path / "plate.exr", WaterSettings(visibility_m=10.0))
    assert match_water(scene_of(path, visibility_m=40.0), PATCH).changes == {"water.visibility_m": 10.0}


def test_a_fixed_gain_is_fitted_too(tmp_path: Path) -> None:
    path = plate(tmp_path / "plate.exr", WaterSettings(type="II"), 0.4)
    match = match_water(scene_of(path, type="II", gain=(1.0, 1.0, 1.0)), PATCH)
    assert set(match.changes) == {"water.gain"}
    np.testing.assert_allclose(match.changes["water.gain"], 0.4, rtol=0.01)  # type: ignore[arg-type]


@pytest.mark.parametrize("mode", ["plate", "kd"])
@pytest.mark.parametrize("gain", ["auto", "fitted"])
@pytest.mark.parametrize(
    ("shown", "given", "balance", "tilt"),
    [
        ("5C", "7C", (1.0, 1.0, 1.0), 0.4),  # falls off with the height as in no water
        ("1C", "5C", (0.6, 4.0, 0.8), 0.0),  # a colour that no water has
        ("IB", "II", (1.1, 0.95, 1.0), -0.3),
    ],
)
def test_no_change_makes_the_veil_worse(
    tmp_path: Path, shown: str, given: str, balance: tuple[float, ...], tilt: float, gain: str, mode: str
) -> None:
    up = directions(128, 64)[:, 0, 1]
    light, own = (
        WaterSettings(type=name, mode=m, gain=(1.0, 1.0, 1.0)).medium(6.0).level_radiance(up)  # type: ignore
        for name, m in ((shown, "table"), (given, mode))
    )
    light = light * np.array(balance) * np.exp(tilt * up)[:, None]
    light *= 0.4 / light.max()
    write_exr(tmp_path / "plate.exr", np.broadcast_to(light[:, None], (64, 128, 3)).astype(np.float32))
    known = tuple(np.exp(np.log(light / own)[28:33].mean(axis=0)).tolist())
    water = {"type": given, "mode": mode, "gain": "auto" if gain == "auto" else known}
    match = match_water(scene_of(tmp_path / "plate.exr", **water), PATCH)
    changed = {key.removeprefix("water."): value for key, value in match.changes.items()}
    again = match_water(scene_of(tmp_path / "plate.exr", **(water | changed)), PATCH)
    assert again.rms_before <= match.rms_before
    assert again.rms_before == pytest.approx(match.rms_after)


def test_patches_that_show_no_water_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "plate.exr"
    for color, words in (((0.0, 0.0, 0.0), "is black"), ((0.4, 0.3, 0.2), "redder than water")):
        write_exr(path, np.broadcast_to(np.array(color, np.float32), (64, 128, 3)))
        with pytest.raises(ParameterError, match=words):
            match_water(scene_of(path, type="II"), PATCH)
    assert "no water" in match_water(scene_of(path, type="none"), PATCH).sentence
    with pytest.raises(ParameterError, match="patch"):
        match_water(scene_of(path, type="II"), [])  # type: ignore[arg-type]


def test_a_color_whose_red_is_lost_names_no_water(tmp_path: Path) -> None:
    path = tmp_path / "plate.exr"
    write_exr(path, np.broadcast_to(np.array([0.0, 0.185, 0.387], np.float32), (64, 128, 3)))
    match = match_water(scene_of(path, type="II"), PATCH)
    assert "water.type" not in match.changes
    assert "No water has the colour" in match.sentence


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ((0.0, 0.0, 0.0), r"^water - is no patch \(got 0,0,0\)"),
        ((0.0, 85.0, 20.0), r"^water - is no patch \(got 0,85,20\)"),
        ((float("nan"), 0.0, 10.0), r"^yaw_deg - must be a finite number \(got nan\)"),
    ],
)
def test_a_patch_is_a_square_on_the_sphere(values: tuple[float, float, float], says: str) -> None:
    with pytest.raises(ParameterError, match=says):
        WaterPatch(*values)
