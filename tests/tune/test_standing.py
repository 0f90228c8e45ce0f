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
