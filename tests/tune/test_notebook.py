# SPDX-License-Identifier: Apache-2.0
"""Sliders in a notebook, without a notebook: moving one draws the frame anew."""

from __future__ import annotations

from pathlib import Path

import pytest

from mr360uw.errors import ParameterError
from mr360uw.scene.model import load_scene
from mr360uw.tune.session import sliders
from mr360uw.video import write_exr
from tests.scenes import gradient_plate

pytest.importorskip("ipywidgets")


@pytest.fixture
def scene(tmp_path: Path, whale: Path) -> Path:
    write_exr(tmp_path / "plate.exr", gradient_plate(128, 64))
    path = tmp_path / "scene.toml"
    path.write_text(
        f'plate = "plate.exr"\n[[object]]\nmesh = "{whale}"\nposition_m = [0.0, 0.0, -3.0]\nscale = 0.5\n'
        "[draw]\nsamples = 1\nsun_samples = 1\nambient_occlusion = false\n"
    )
    return path


def test_a_slider_that_moves_draws_the_frame_anew(scene: Path) -> None:
    before = scene.read_text()
    box = sliders(scene, "object.0.scale", "sea.wind_speed", width=128, backend="reference")
    scale, wind, message, picture = box.children
    assert (scale.value, wind.value) == (0.5, load_scene(scene).sea.wind_speed)
    first = picture.value
    scale.value = 2.0
    assert picture.value != first
    assert load_scene(scene, box.overrides).objects[0].scale == 2.0
    scale.value = 0.5
    assert picture.value == first
    assert message.value == ""
    assert scene.read_text() == before


def test_a_value_that_makes_no_scene_is_told_and_the_picture_stays(scene: Path) -> None:
    box = sliders(scene, "object.0.scale", width=128, backend="reference")
    scale, message, picture = box.children
    first = picture.value
    scene.write_text(scene.read_text().replace("plate.exr", "gone.exr"))
    scale.value = 2.0
    assert "gone.exr" in message.value
    assert picture.value == first


@pytest.mark.parametrize("key", ["water.type", "sea.wind", "object.0.position_m"])
def test_what_has_no_slider_is_refused(scene: Path, key: str) -> None:
    with pytest.raises(ParameterError, match="is no number with a slider"):
        sliders(scene, key, backend="reference")
