# SPDX-License-Identifier: Apache-2.0
"""Water whose parameters are keyed: few tables, right ones, whatever frame is asked for first."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from mr360uw.render.first_pass import first_pass
from mr360uw.render.surroundings import Surroundings, load_surroundings, surroundings_over_time
from mr360uw.scene.model import Scene
from mr360uw.scene.resolved import scene_at, tables_on_the_way, water_between
from mr360uw.types import MediumTable
from mr360uw.video import open_video
from tests.scenes import scene_with

TABLE_ERROR = 0.005
"""Error over the largest value of a table, where values change by 3 % from one table to the next: 3e-4 is measured, but
0.004 in the row of infinite depth, where the light that is left changes its wavelength."""


def scene_of(folder: Path, *keys: dict[str, Any], camera: dict[str, Any] | None = None, **water: Any) -> Scene:
    times = [{"time_s": [0.0, 2.0]} | key for key in keys]
    return scene_with(folder, None, water={"bands": 3} | water, camera=camera or {}, keys=times)


def table(surroundings: Surroundings, time_s: float = 0.0) -> MediumTable:
    medium = surroundings.medium_at(time_s)
    assert medium is not None
    return medium.table


def assert_close(one: MediumTable, other: MediumTable, error: float) -> None:
    assert one.length_m == other.length_m
    assert one.camera_depth_m == other.camera_depth_m
    assert one.refractive_index == other.refractive_index
    for name in ("veil", "attenuation", "diffuse", "beam", "unscattered"):
        exact = getattr(other, name)
        np.testing.assert_allclose(getattr(one, name), exact, rtol=0.0, atol=error * np.abs(exact).max(), err_msg=name)


VISIBILITY = {"parameter": "water.visibility_m", "value": [8.0, 20.0]}


@pytest.mark.parametrize("interpolation", ["linear", "smooth"])
def test_tables_between_keys_are_those_of_their_water(tmp_path: Path, interpolation: str) -> None:
    scene = scene_of(tmp_path, VISIBILITY | {"interpolation": interpolation}, visibility_m=8.0)
    at = surroundings_over_time(scene)
    for time_s in (0.013, 1.09):
        assert water_between(scene, time_s) is not None
        assert_close(table(at(time_s)), table(load_surroundings(scene_at(scene, time_s))), TABLE_ERROR)


def test_tables_of_keys_are_exact(tmp_path: Path) -> None:
    scene = scene_of(tmp_path, VISIBILITY, visibility_m=8.0)
    at = surroundings_over_time(scene)
    for time_s in (-1.0, 0.0, 2.0, 3.0):
        assert_close(table(at(time_s)), table(load_surroundings(scene_at(scene, time_s))), 0.0)


def test_tables_are_made_as_the_water_changes_and_not_for_each_frame(tmp_path: Path) -> None:
    scene = scene_of(tmp_path, VISIBILITY | {"value": [8.0, 8.8]}, visibility_m=8.0)
    assert tables_on_the_way(scene) == int(np.ceil(np.log(8.8 / 8.0) / np.log(1.03))) - 1


def test_the_water_of_a_time_does_not_depend_on_what_came_before(tmp_path: Path) -> None:
    sun = {"parameter": "water.sun_share", "value": [0.2, 0.4]}
    scene = scene_of(tmp_path, VISIBILITY | {"value": [8.0, 9.0]}, sun, visibility_m=8.0)
    after, alone = surroundings_over_time(scene), surroundings_over_time(scene)
    table(after(1.9))
    assert_close(table(after(0.7)), table(alone(0.7)), 0.0)


def test_values_that_are_held_take_no_tables_on_the_way(tmp_path: Path) -> None:
    held = {"parameter": "water.sun_share", "value": [0.2, 0.4], "interpolation": "hold"}
    scene = scene_of(tmp_path, held)
    assert tables_on_the_way(scene) == 0
    assert water_between(scene, 1.0) is None
    moving = scene_of(tmp_path, held, VISIBILITY, visibility_m=8.0)
    between = water_between(moving, 1.0)
    assert between is not None
    first, second, _ = between
    assert first.sun_share == second.sun_share == 0.2
    assert first.visibility_m is not None
    assert second.visibility_m is not None
    assert first.visibility_m < scene_at(moving, 1.0).water.visibility_m < second.visibility_m  # type: ignore[operator]


def test_a_keyed_gain_takes_no_table(tmp_path: Path) -> None:
    scene = scene_of(tmp_path, {"parameter": "water.gain", "value": [[1, 1, 1], [3, 1, 2]]})
    assert tables_on_the_way(scene) == 0
    start, middle = (load_surroundings(scene_at(scene, time_s)) for time_s in (0.0, 1.0))
    np.testing.assert_allclose(table(middle).veil, table(start).veil * np.array([2.0, 1.0, 1.5]), rtol=1e-6)  # float32


def test_a_camera_that_sinks_through_keyed_water(tmp_path: Path) -> None:
    """Tables are mixed over depth and over water: the errors of both."""
    camera = {"depth_m": 5.0, "depth_keys": [[0.0, 5.0], [2.0, 6.0]]}
    scene = scene_of(tmp_path, VISIBILITY | {"value": [8.0, 8.4]}, visibility_m=8.0, camera=camera)
    found = table(surroundings_over_time(scene)(1.0), 1.0)
    assert_close(found, table(load_surroundings(scene_at(scene, 1.0)), 1.0), TABLE_ERROR)
    assert found.camera_depth_m == pytest.approx(5.5)


def test_closed_forms_are_exact_at_all_times(tmp_path: Path) -> None:
    assert water_between(scene_of(tmp_path, VISIBILITY, visibility_m=8.0, mode="kd"), 1.0) is None


def test_the_gain_of_a_clip_is_fitted_with_the_water_of_each_frame(tmp_path: Path) -> None:
    plate = tmp_path / "plate_%04d.png"
    for index in range(3):
        cv2.imwrite(str(plate) % index, np.full((32, 64, 3), 90, np.uint8))
    clear, murky = (load_surroundings(scene_of(tmp_path, mode="kd", visibility_m=v)) for v in (20.0, 5.0))
    with open_video(plate) as video:
        of_murky = first_pass(murky, video, measures=["gain"]).gain
        of_both = first_pass(
            clear, video, measures=["gain"], keyed=lambda time_s: murky if time_s >= 0.0 else clear
        ).gain
        of_clear = first_pass(clear, video, measures=["gain"]).gain
    np.testing.assert_array_equal(of_both, of_murky)
    assert not np.allclose(of_clear, of_murky)
