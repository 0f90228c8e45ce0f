# SPDX-License-Identifier: Apache-2.0
"""The self-test of a device: what it tells of right and of wrong pictures, and what a card is trusted with."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from mr360uw.base.disk_cache import FOLDER
from mr360uw.composite.gl import self_test
from mr360uw.composite.gl.layer_renderer import LayerRenderer
from mr360uw.composite.shot import Shot
from mr360uw.errors import GlError
from mr360uw.render.frame import make_backend
from mr360uw.types import Layer

pytestmark = pytest.mark.usefixtures("gl")


@pytest.fixture(autouse=True)
def _drawn_once_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """The time of a picture is of one drawing, not of the median of five."""
    monkeypatch.setattr(self_test, "_DRAWN", 1)


@pytest.fixture
def dark(monkeypatch: pytest.MonkeyPatch) -> None:
    """A device that draws half of the light."""
    real = LayerRenderer.render

    def render(self: LayerRenderer, shot: Shot) -> Layer:
        layer = real(self, shot)
        return replace(layer, tiles=tuple(replace(tile, radiance=0.5 * tile.radiance) for tile in layer.tiles))

    monkeypatch.setattr(LayerRenderer, "render", render)


@pytest.fixture
def card(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """This device as if it were a card, and nothing known of it."""
    # of a version of its own, for a process asks once for each
    device = replace(self_test.gl_device(), software=False, version=str(tmp_path))
    monkeypatch.setattr(self_test, "gl_device", lambda: device)
    monkeypatch.setenv(FOLDER, str(tmp_path))


def test_pictures_agree_and_take_time() -> None:
    trials = self_test.run_trials(("zenith", "shadow"))
    assert [trial.problem for trial in trials] == ["", ""]
    assert all(min(trial.first_s, trial.again_s, trial.reference_s) > 0.0 for trial in trials)
    assert "all 2 pictures agree" in self_test.report(trials)


@pytest.mark.usefixtures("dark")
def test_a_wrong_picture_is_told() -> None:
    (trial,) = self_test.run_trials(("zenith",))
    assert "PSNR" in trial.problem
    assert "1 of 1 pictures are wrong" in self_test.report([trial])


def test_a_shader_that_does_not_compile_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def render(self: LayerRenderer, shot: Shot) -> Layer:  # noqa: ARG001 - arguments of what it stands for
        raise GlError("shader - does not compile - layer.frag:77")

    monkeypatch.setattr(LayerRenderer, "render", render)
    (trial,) = self_test.run_trials(("zenith",))
    assert "layer.frag:77" in trial.problem


@pytest.mark.usefixtures("card", "dark")
def test_a_card_that_draws_wrong_is_left_alone_and_asked_once(monkeypatch: pytest.MonkeyPatch) -> None:
    backend, why = make_backend("auto")
    assert backend.name == "reference"
    assert "fails its first trial" in why
    assert make_backend("gl")[0].name == "gl", "who asks for it has it"
    monkeypatch.setattr(self_test, "run_trials", None)
    assert make_backend("auto")[0].name == "reference"


@pytest.mark.usefixtures("card")
def test_a_card_that_draws_right_is_taken() -> None:
    assert make_backend("auto")[0].name == "gl"


@pytest.mark.usefixtures("dark")
def test_the_report_is_written_and_the_exit_code_tells(
    tmp_path: Path, run: Callable[..., tuple[int, str, str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(self_test, "run_trials", partial(self_test.run_trials, width=64))
    code, out, _ = run("info", "--gpu", "--report", tmp_path / "card.txt")
    assert code == 1
    text = (tmp_path / "card.txt").read_text("utf-8")
    assert text.strip() == out.strip()
    assert np.all([f"trial     {name}" in text for name in ("materials", "alpha", "holdout")])
