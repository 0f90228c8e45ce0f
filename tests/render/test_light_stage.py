# SPDX-License-Identifier: Apache-2.0
"""Light at samples in time: linear between them, measured where it is not, the same for a frame alone and in a run."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mr360uw as uw
from mr360uw.base.cache import Cache
from mr360uw.errors import DamagedFrameError
from mr360uw.render.first_pass import ClipAnalysis
from mr360uw.render.loaded import load
from mr360uw.render.match_stage import ungraded
from mr360uw.render.plate_light import FrameLight, LightSamples, plate_light
from mr360uw.scene.model import Scene
from mr360uw.scene.resolved import open_plate
from mr360uw.types import Floats, sample_step
from mr360uw.video import VideoFrame, write_exr
from tests.scenes import gradient_plate, scene_with
from tests.tolerances import FLOAT32

RATE, COUNT = 32, 15
"""Samples are the frames 0, 4, 8 and 12 of fourteen."""
PLATE = 0.4 * gradient_plate(64, 32, sun=None)


@pytest.fixture
def bodies(whale: Path) -> list[dict[str, Any]]:
    return [
        {"mesh": str(whale), "position_m": [0.3, -0.4, -3.0]},
        {"mesh": str(whale), "position_m": [0.3, 0.4, -3.2], "scale": 0.5},
    ]


def clip(folder: Path, levels: Floats, bodies: list[dict[str, Any]], **tables: Any) -> Scene:
    """Return a scene without water over a clip of frames with these levels."""
    for k, level in enumerate(levels):
        write_exr(folder / f"plate_{k:04d}.exr", (level * PLATE).astype(np.float32))
    plate = {"path": str(folder / "plate_%04d.exr"), "frame_rate": RATE}
    usual = {"light": {"sun": "none", "operator": "none"}, "water": {"type": "none"}, "object": bodies}
    return scene_with(folder, None, **(usual | tables), plate=plate)


def lit(scene: Scene, start: int = 0, stop: int = COUNT) -> tuple[list[FrameLight | None], list[FrameLight]]:
    """Return the light of a scene's frames as a run has it, and measured in each frame alone."""
    with open_plate(scene) as video:
        loaded, analysis = load(scene, video.width, video.height), ClipAnalysis()
        frames = list(LightSamples(loaded, analysis, video, video.frames).frames(start, stop))
        assert [plate.index for plate, _ in frames] == list(range(start, stop))
        own = [ungraded(loaded.at(plate.time_s), analysis.grade, plate, Cache()) for plate, _ in frames]
        return [light for _, light in frames], [plate_light(loaded.at(p.time_s), analysis, p) for p in own]


def alone(levels: Floats, bodies: list[dict[str, Any]], folder: Path, **tables: Any) -> list[int]:
    """Return the frames whose light is measured in each alone; that of the others is held against their own."""
    found, own = lit(clip(folder, levels, bodies, **tables))
    for light, expected in zip(found, own, strict=True):
        if light is not None:
            for name in ("radiance", "irradiance", "ambient", "glossy"):
                a, b = getattr(light.environment, name), getattr(expected.environment, name)
                np.testing.assert_allclose(a, b, rtol=10.0 * FLOAT32, atol=FLOAT32)  # means of 2048 pixels, filtered
    return [k for k, light in enumerate(found) if light is None]


@pytest.mark.parametrize(("rate", "step"), [(1.0, 1), (24.0, 3), (29.97, 4), (60.0, 8)])
def test_light_is_sampled_eight_times_a_second(rate: float, step: int) -> None:
    assert sample_step(rate) == step


def test_a_linear_change_is_reproduced_exactly(tmp_path: Path, bodies: list[dict[str, Any]]) -> None:
    assert alone(1.0 + 0.03 * np.arange(COUNT), bodies, tmp_path) == []  # the last frame of a clip is a sample


@pytest.mark.parametrize("step", [5, 6, 8])
def test_a_step_of_the_level_is_followed_to_the_frame(step: int, tmp_path: Path, bodies: list[dict[str, Any]]) -> None:
    levels = np.where(np.arange(COUNT) < step, 1.0, 0.7)
    sample = (step - 1) // 4 * 4
    assert alone(levels, bodies, tmp_path) == [*range(sample + 1, sample + 4)]


def test_a_flash_between_samples_is_measured(tmp_path: Path, bodies: list[dict[str, Any]]) -> None:
    assert alone(np.where(np.arange(COUNT) == 6, 1.5, 1.0), bodies, tmp_path) == [6]


def test_a_cut_between_pictures_of_one_level_is_not_smeared(tmp_path: Path, bodies: list[dict[str, Any]]) -> None:
    scene = clip(tmp_path, np.ones(COUNT), bodies)
    checks = np.kron(np.indices((8, 16)).sum(axis=0) % 2, np.ones((4, 4)))[..., None]
    for k in range(6, COUNT):
        write_exr(tmp_path / f"plate_{k:04d}.exr", (PLATE * (0.2 + 1.6 * checks)).astype(np.float32))
    assert [k for k, light in enumerate(lit(scene)[0]) if light is None] == [5, 6, 7]


def test_light_is_read_without_the_plates_grade(tmp_path: Path, bodies: list[dict[str, Any]]) -> None:
    assert alone(np.ones(COUNT), bodies, tmp_path, match={"gamma": 0.8, "saturation": 1.3}) == []


def test_keys_between_samples_are_followed(tmp_path: Path, bodies: list[dict[str, Any]]) -> None:
    """A parameter is the same in frames 4 and 8, and another between them."""
    times, values = [4 / RATE, 6 / RATE, 8 / RATE], [12.0, 14.0, 12.0]
    keys = [{"parameter": "light.peak", "time_s": times, "value": values}]
    tables: dict[str, Any] = {"light": {"sun": "none", "operator": "landis", "region": "all"}, "keys": keys}
    assert alone(np.ones(COUNT), bodies, tmp_path, **tables) == [5, 6, 7]


def test_light_of_a_range_is_that_of_the_clip(tmp_path: Path, bodies: list[dict[str, Any]]) -> None:
    levels = 1.0 + 0.05 * np.sin(np.arange(COUNT))
    scene = clip(tmp_path, levels, bodies)
    whole = lit(scene)[0]
    for start, stop in [(6, 7), (3, 10), (12, 14), (13, 15)]:
        for light, expected in zip(lit(scene, start, stop)[0], whole[start:stop], strict=True):
            assert (light is None) == (expected is None)
            if light is not None and expected is not None:
                np.testing.assert_array_equal(light.environment.ambient, expected.environment.ambient)


def test_a_frame_alone_is_that_of_the_run(tmp_path: Path, bodies: list[dict[str, Any]]) -> None:
    scene = clip(tmp_path, 1.0 + 0.02 * np.arange(9), bodies[:1], draw={"samples": 5})
    uw.composite_video(scene, tmp_path / "run_%02d.exr", frames=(5, 8), backend="reference")
    uw.composite_video(scene, tmp_path / "one_%02d.exr", frames=(6, 7), backend="reference")
    assert (tmp_path / "one_06.exr").read_bytes() == (tmp_path / "run_06.exr").read_bytes()


def test_suns_that_are_found_frame_by_frame_stay_so(tmp_path: Path, bodies: list[dict[str, Any]]) -> None:
    scene = clip(tmp_path, np.ones(COUNT), bodies, light={"smooth": False})
    assert lit(scene)[0] == [None] * COUNT


@pytest.mark.parametrize("lost", [6, 7])
def test_frames_before_a_damaged_one_are_given(lost: int, tmp_path: Path, bodies: list[dict[str, Any]]) -> None:
    scene = clip(tmp_path, np.ones(COUNT), bodies)
    with open_plate(scene) as video:

        def read(start: int, stop: int) -> Iterator[VideoFrame]:
            for plate in video.frames(start, stop):
                if plate.index == lost:
                    raise DamagedFrameError("plate - is damaged", lost)
                yield plate

        loaded = load(scene, video.width, video.height)
        samples, seen = LightSamples(loaded, ClipAnalysis(), video, read), []
        with pytest.raises(DamagedFrameError):
            seen += (plate.index for plate, _ in samples.frames(0, 8))
        whole = [plate.index for plate, _ in samples.frames(0, lost)]
        after = [plate.index for plate, _ in samples.frames(lost + 1, 10)]
    assert whole == list(range(lost))
    assert after == list(range(lost + 1, 10))
