# SPDX-License-Identifier: Apache-2.0
"""Metres from a length in the picture or a dive computer's log."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mr360uw.base.sphere import unit
from mr360uw.errors import ParameterError
from mr360uw.track.camera_track import Measure, looks_of, parse_length, scale_from_depths, scale_from_length, world_of

TIME = np.arange(0.0, 20.0, 0.04)
HEIGHT = 0.5 * np.sin(0.7 * TIME) - 0.02 * TIME
"""Of a path in a scene of half the true size."""


def log(folder: Path, start_s: float) -> Path:
    """Write the log of a dive in which the clip of `HEIGHT` starts at a time, 8 m deep."""
    times = np.arange(0.0, 120.0, 1.0)
    depth = 8.0 - 2.0 * np.interp(times - start_s, TIME, HEIGHT)
    path = folder / "dive.csv"
    path.write_text("time_s,depth_m\n" + "".join(f"{t},{d:.2f}\n" for t, d in zip(times, depth, strict=True)), "utf-8")
    return path


@pytest.mark.parametrize("given", [None, 30.5])
def test_a_depth_log_tells_scale_depth_and_start(tmp_path: Path, given: float | None) -> None:
    scale, depth, start = scale_from_depths(log(tmp_path, 30.5), given, TIME, HEIGHT)
    # one sample a second cuts the crests of a wave of 9 s by (2 pi/9)^2/8 = 6 % at the most, 4 % rms
    assert scale == pytest.approx(2.0, rel=0.04)
    assert depth == pytest.approx(8.0, abs=0.05)
    assert start == pytest.approx(30.5, abs=0.25)  # the step of the search


def test_a_log_of_another_dive_is_refused(tmp_path: Path) -> None:
    path = log(tmp_path, 30.5)
    with pytest.raises(ParameterError, match="do not fit the camera's path"):
        scale_from_depths(path, 90.0, TIME, HEIGHT)
    path.write_text("time_s,deep\n0,1\n1,2\n", "utf-8")
    with pytest.raises(ParameterError, match="got no depth_m"):
        scale_from_depths(path, None, TIME, HEIGHT)


def test_a_length_between_two_pixels_tells_the_scale() -> None:
    given = parse_length("512, 256:640,256=3")
    looks = looks_of(given, 1024, np.eye(3))
    np.testing.assert_allclose(looks[0], unit(np.array([0.0, 0.0, -1.0])), atol=1e-12)
    points = np.repeat(looks * [[2.0], [2.0 * np.sqrt(0.5)]], 3, axis=0)
    # the corners of a right triangle 2 and sqrt(2) from the camera, 45 degrees apart: sqrt(2) apart
    assert scale_from_length(points, np.zeros(3), looks, given[2]) == pytest.approx(3.0 / np.sqrt(2.0))
    world = world_of(
        np.zeros((4, 3)), np.repeat(np.eye(3)[None], 4, axis=0), points, None,
        measure=Measure(length=given, frame_width=1024),
    )  # fmt: skip
    assert world.scale == pytest.approx(3.0 / np.sqrt(2.0))
    assert "3 m apart, as given" in world.scale_from


@pytest.mark.parametrize("text", ["", "1,2:3=4", "1,2:3,4=", "a,2:3,4=5", "1,2:3,4=0", "-1,2:3,4=1"])
def test_lengths_that_are_none(text: str) -> None:
    with pytest.raises(ParameterError, match="--length"):
        parse_length(text)


def test_pixels_without_points_are_refused() -> None:
    looks = looks_of(((512, 256), (0, 256), 1.0), 1024, np.eye(3))
    with pytest.raises(ParameterError, match="no point was solved near its second pixel"):
        scale_from_length(np.array([[0.0, 0.0, -2.0]]), np.zeros(3), looks, 1.0)
    with pytest.raises(ParameterError, match="outside of the frame"):
        looks_of(((512, 600), (0, 256), 1.0), 1024, np.eye(3))
    with pytest.raises(ParameterError, match="given twice"):
        Measure(height_m=2.0, depth_log=Path("a.csv"))
