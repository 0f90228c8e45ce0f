# SPDX-License-Identifier: Apache-2.0
"""A click on what the plate shows at a known distance: there stands the object."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mr360uw.depth.sphere_stereo import DepthMap
from mr360uw.errors import ParameterError
from mr360uw.preview.live import LivePreview
from mr360uw.tune import placing
from mr360uw.tune.placing import Point
from mr360uw.tune.situation import Situation
from tests.depth.own_maps import write_own_maps
from tests.scenes import scene_with
from tests.test_stereo import two_eyes

WITHIN = 0.02
"""Relative error of the distance at which an object stands: what the project asks."""


def test_an_object_stands_on_the_rock_that_is_clicked(tmp_path: Path, whale: Path) -> None:
    folder, plate = tmp_path / "depth", two_eyes(tmp_path / "pair.png", 128, 64)
    far = np.broadcast_to(np.linspace(2.0, 4.0, 128, dtype=np.float32), (64, 128)).copy()
    sure = np.ones(far.shape, np.float32)
    sure[:, :40] = 0.2
    write_own_maps(folder, {0: (DepthMap(far, sure),)})
    scene = scene_with(
        tmp_path, whale, plate={"path": str(plate), "eye": "left", "depth": str(folder)}, water={"type": "none"}
    )
    here = Situation(LivePreview(), scene, 0, 0.0)
    for longitude in (-0.4, 0.9, 2.5):
        point = Point(longitude, -0.35)
        body = here.bodies[0]
        foot = here.standing(0, point) + placing.foot(*body.shape)
        shown, distance = placing.shown_at(here.camera, foot)
        true_m = np.interp(placing.pixel_of_point(point, 128, 64)[0] - 0.5, np.arange(128), far[0])
        assert abs(distance / true_m - 1.0) < WITHIN
        assert (shown.longitude, shown.latitude) == pytest.approx((longitude, -0.35), abs=1e-6)
    with pytest.raises(ParameterError, match="add the sea floor first"):
        here.standing(0, Point(-2.5, -0.35))


@pytest.mark.parametrize(
    ("said", "sizes"),
    [
        ({}, {"scale": 1.0}),
        ({"size_m": 0.402}, {"size_m": 0.402}),
        ({"scale": 2.0, "key": [{"time_s": 0.0}, {"time_s": 1.0, "scale": 3.0}]}, {"scale": 2.0, "key.1.scale": 3.0}),
        (
            {"key": [{"time_s": 0.0, "scale": 0.5}, {"time_s": 1.0, "scale": 3.0}]},
            {"key.0.scale": 0.5, "key.1.scale": 3.0},
        ),
    ],
)
def test_sizes_are_what_the_scene_says(
    tmp_path: Path, whale: Path, said: dict[str, Any], sizes: dict[str, float]
) -> None:
    """All numbers that a drag of the scale handle multiplies."""
    plate = two_eyes(tmp_path / "pair.png", 128, 64)
    body = {"mesh": str(whale), "position_m": [0.3, -0.4, -3.0], **said}
    table = {"path": str(plate), "eye": "left"}
    scene = scene_with(tmp_path, None, plate=table, water={"type": "none"}, object=[body])
    with LivePreview("reference") as preview:
        assert Situation(preview, scene, 0, 0.0).bodies[0].sizes == sizes


def test_what_stands_is_dragged_along_the_floor_and_found_by_a_click(tmp_path: Path, whale: Path) -> None:
    """Its middle stays at its height where a ray meets that, as far away as it was where none does."""
    plate = two_eyes(tmp_path / "pair.png", 128, 64)
    body = {"mesh": str(whale), "azimuth_deg": 20.0, "distance_m": 4.0, "stand_on": "receiver"}
    table, floor = {"path": str(plate), "eye": "left"}, {"height_m": -2.0}
    scene = scene_with(tmp_path, None, plate=table, water={"type": "none"}, receiver=floor, object=[body])
    with LivePreview("reference") as preview:
        here = Situation(preview, scene, 0, 0.0)
    (one,), away = here.bodies, here.bodies[0].center - here.camera.position
    for latitude, farther in ((-0.5, 1.0), (-0.5, 1.5), (0.3, 1.0)):
        moved = here.swimming(0, Point(-1.0, latitude), farther, level=True) + one.center - one.position
        beside = -away[1] / np.tan(0.5) if latitude < 0.0 else np.hypot(*away[::2])
        np.testing.assert_allclose(moved[1], one.center[1], atol=1e-9)
        np.testing.assert_allclose(np.hypot(*moved[::2]), farther * beside, rtol=1e-9)
    shown, _ = placing.shown_at(here.camera, one.center)
    assert here.at(shown) == 0
    assert here.at(Point(shown.longitude + 1.5, shown.latitude)) is None
    said = here.words(0, level=True)
    assert (said["azimuth_deg"], said["distance_m"]) == (20.0, 4.0)
