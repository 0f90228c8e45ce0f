# SPDX-License-Identifier: Apache-2.0
"""The gain of the veil over a clip: steady, and with the plate's exposure at once."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mr360uw as uw
from mr360uw.base.color import decode, encode, luminance
from mr360uw.base.sphere import directions
from mr360uw.medium import Medium, Water, exposure_change, picture_change, steady_gain
from mr360uw.medium.open_water import ROWS, row_up
from mr360uw.medium.scattered_light import typical_level
from mr360uw.medium.spectra import named_sensor
from mr360uw.medium.veil_gain import SECTORS, GainSeries, MeasuredGain, fit_level
from mr360uw.medium.water import JerlovType
from mr360uw.render.first_pass import ClipAnalysis, first_pass
from mr360uw.render.lights import level_view
from mr360uw.render.surroundings import load_surroundings
from mr360uw.sample.dive import record
from mr360uw.sample.rendered_dive import SENSOR, Dive
from mr360uw.scene.model import Scene
from mr360uw.scene.resolved import open_plate
from mr360uw.video import VideoFrame, read_picture, write_exr
from mr360uw.video.reader import ReaderOver
from tests.dives import over_sand
from tests.scenes import scene_with
from tests.tolerances import CHROMA_STEP, FLOAT32, FLOAT64, GAIN, GAIN_FLICKER, GAIN_OF_CLEAR, GAIN_OF_DIVE

FRAMES, RATE = 60, 20
PASSES = range(25, 37)
DEPTH = 5.0
EXPOSURE = np.array([0.5, 0.4, 0.3])
SIZE = (64, 32)


def water(exposure: np.ndarray = EXPOSURE) -> np.ndarray:
    """A plate (32, 64, 3) of the default water."""
    medium = Medium(Water.jerlov("IB"), camera_depth_m=DEPTH)
    rows = medium.light.display(medium.model.radiance(DEPTH, row_up(SIZE[1])))
    return np.broadcast_to(exposure * rows[:, None, :], (SIZE[1], SIZE[0], 3)).copy()


def write_clip(folder: Path, exposure: dict[int, float], body: range) -> Path:
    """Write frames of water whose pixels move by 15 %, and return their folder.

    exposure: from the frame of its key on. body: frames in which something bright passes, 45 of the 64 columns wide.
    """
    rng, now = np.random.default_rng(360), 1.0
    for k in range(FRAMES):
        plate = water() * np.exp(rng.normal(0.0, 0.15, (SIZE[1], SIZE[0], 1)))
        if k in body:
            head = 9 * (k - body.start + 1)
            plate[6:26, max(head - 45, 0) : head] = [0.5, 0.4, 0.35]
        now = exposure.get(k, now)
        write_exr(folder / f"plate_{k:04d}.exr", (now * plate).astype(np.float32))
    return folder


def scene_of(folder: Path, **tables: Any) -> Scene:
    plate = {"path": str(folder / "plate_%04d.exr"), "frame_rate": RATE}
    usual = {"light": {"sun": "none"}, "camera": {"depth_m": DEPTH}, "object": [], "water": {"bands": 61}}
    return scene_with(folder, None, **(usual | tables), plate=plate)


@pytest.fixture(scope="module")
def reef(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A clip in which something bright passes within a second."""
    return write_clip(tmp_path_factory.mktemp("reef"), {}, PASSES)


@pytest.fixture
def body(whale: Path) -> list[dict[str, Any]]:
    return [{"mesh": str(whale), "position_m": [0.3, -0.4, -3.0]}]


def gain_of(scene: Scene) -> np.ndarray:
    """Return the gain (N, 3) that the clip's frames are rendered with."""
    with open_plate(scene) as video:
        gain = first_pass(load_surroundings(scene), video, measures=["gain"]).gain
    assert gain is not None
    assert gain.shape == (FRAMES, 3)
    return gain


def each_alone(scene: Scene) -> np.ndarray:
    """Return the gain (N, 3) of every frame fitted to its own plate."""
    medium = scene.water.medium(DEPTH)
    assert medium is not None
    with open_plate(scene) as video:
        return np.array([fit_level(medium, level_view(frame.image_linear))[0] for frame in video.frames()])


def flicker(gain: np.ndarray) -> np.ndarray:
    """Return the rms (3,) of the change of log gain from frame to frame."""
    return np.sqrt(np.mean(np.diff(np.log(gain), axis=0) ** 2, axis=0))


def test_what_swims_by_does_not_move_the_gain(reef: Path) -> None:
    scene = scene_of(reef)
    gain, alone = gain_of(scene), each_alone(scene)
    assert np.all(np.abs(np.log(alone[PASSES] / EXPOSURE)).max(axis=0) > 10.0 * GAIN)
    np.testing.assert_allclose(gain, np.broadcast_to(EXPOSURE, gain.shape), rtol=GAIN)
    assert np.all(flicker(gain) < GAIN_FLICKER * flicker(alone))
    background = np.delete(alone, PASSES, axis=0)
    assert np.all(flicker(gain) < GAIN_FLICKER * flicker(background))


def test_a_step_of_exposure_is_followed_at_once_and_a_flash_is_none(tmp_path: Path) -> None:
    scene = scene_of(write_clip(tmp_path, {0: 0.6, 15: 1.8, 16: 0.6, 45: 1.0}, PASSES))
    truth = np.where(np.arange(FRAMES) < 45, 0.6, 1.0)[:, None] * EXPOSURE
    np.testing.assert_allclose(gain_of(scene), truth, rtol=2.0 * GAIN)


def test_exposure_is_what_all_channels_do() -> None:
    plate = water()
    np.testing.assert_allclose(exposure_change(plate, 1.3 * plate), np.log(1.3), rtol=FLOAT64)
    np.testing.assert_allclose(exposure_change(plate, plate * [1.5, 1.2, 1.3]), np.log(1.2), rtol=FLOAT64)
    assert exposure_change(plate, plate * [1.5, 1.2, 0.9]) == 0.0
    covered = plate.copy()
    covered[:, :30] *= 1.5
    assert exposure_change(plate, covered) == 0.0
    black = plate * [0.0, 1.0, 1.0]
    np.testing.assert_allclose(exposure_change(black, 0.7 * black), np.log(0.7), rtol=FLOAT64)
    assert exposure_change(0.0 * plate, plate) == 0.0
    np.testing.assert_allclose([picture_change(plate, m) for m in (covered, 1.3 * plate)], 0.0, atol=FLOAT64)
    assert picture_change(plate, plate[::-1]) > 0.25
    assert picture_change(0.0 * plate, plate) == np.inf
    assert picture_change(0.0 * plate, 1e-4 * plate) == 0.0


def test_a_shot_knows_nothing_of_the_next() -> None:
    gain = np.where(np.arange(90) < 40, 1.0, 3.0)[:, None] * EXPOSURE
    gain[:, 0] = 0.0  # a channel that is black
    np.testing.assert_allclose(steady_gain(gain, np.zeros(90), 1.0 * (np.arange(90) == 40), 30.0), gain, rtol=FLOAT64)
    single = steady_gain(gain[:3], np.zeros(3), np.array([0.0, 0.5, 2.0]), 30.0)
    np.testing.assert_allclose(single, gain[:3], rtol=FLOAT64)


def test_a_frame_alone_has_the_gain_of_the_clip(tmp_path: Path, reef: Path, body: list[dict[str, Any]]) -> None:
    scene, k = scene_of(reef, object=body), PASSES[5]
    for name, frames in (("alone", (k, k + 1)), ("range", (k - 1, k + 1))):
        (tmp_path / name).mkdir()
        uw.composite_video(scene, tmp_path / name / "out_%02d.exr", frames=frames, backend="reference")
    made = read_picture(tmp_path / "alone" / f"out_{k}.exr")
    np.testing.assert_array_equal(made, read_picture(tmp_path / "range" / f"out_{k}.exr"))
    with open_plate(scene) as video:
        frame = next(iter(video.frames(k, k + 1)))

        analysis = first_pass(load_surroundings(scene), video, measures=["gain", "open_water"])

    def render(analysis: ClipAnalysis | None) -> np.ndarray:
        done = uw.render_frame(frame.image_linear, scene, frame.time_s, "reference", index=k, analysis=analysis)
        return done.image_linear

    assert analysis.open_water is not None
    np.testing.assert_allclose(render(analysis), made, atol=FLOAT32)
    assert np.abs(render(None) - made).max() > 100.0 * FLOAT32


@pytest.mark.parametrize(
    ("tables", "passes"),
    [
        ({}, 2),
        ({"water": {"gain": [0.5, 0.4, 0.3]}}, 1),
        ({"water": {"mode": "table"}}, 2),
        ({"water": {"type": "none"}}, 1),
        ({"light": {"sun": "none", "smooth": False}}, 1),
    ],
)
def test_the_clip_is_read_twice_only_where_the_gain_is_sought(
    tables: dict[str, Any], passes: int, tmp_path: Path, reef: Path, body: list[dict[str, Any]]
) -> None:
    seen: list[tuple[int, int | None]] = []
    uw.composite_video(
        scene_of(reef, object=body, **tables),
        tmp_path / "out_%02d.exr",
        frames=(0, 1),
        backend="reference",
        progress=lambda *step: seen.append(step),
        fresh=True,
    )
    assert len(seen) == (passes - 1) * FRAMES + 1


def test_a_camera_that_sinks_is_fitted_at_each_frame_s_depth(reef: Path) -> None:
    camera = {"depth_m": DEPTH, "depth_keys": [[0.0, 2.0], [FRAMES / RATE, DEPTH]]}
    gain = gain_of(scene_of(reef, camera=camera))
    medium = scene_of(reef).water.medium(DEPTH)
    assert medium is not None
    # one plate at every depth: the gain makes up for the light that the model loses on the way down
    half = medium.at_depth(0.5 * (2.0 + DEPTH)).level_radiance(np.zeros(1))[0]
    lost = medium.level_radiance(np.zeros(1))[0] / half
    assert lost[0] < 1.0 - 5.0 * GAIN
    np.testing.assert_allclose(gain[FRAMES // 2], EXPOSURE * lost, rtol=2.0 * GAIN)


@pytest.mark.parametrize(("water_type", "right"), [("IB", GAIN_OF_CLEAR), ("II", GAIN_OF_DIVE), ("1C", GAIN_OF_DIVE)])
def test_the_gain_of_a_dive_over_sand_is_that_of_its_water(
    tmp_path: Path, water_type: JerlovType, right: float
) -> None:
    # in IB sand shows through 40 m of water: with rows within 12 degrees of the horizon the gain was 1.4 times too high
    settings = over_sand(depth_m=8.0, floor_m=11.5, water=water_type)
    plate = Dive(settings, 1024, 512)
    record(tmp_path / "dive.mp4", [plate.radiance(0.0)], Fraction(24), 1)
    with uw.open_video(tmp_path / "dive.mp4") as video:
        frame = next(iter(video.frames()))
    medium = Medium(Water.jerlov(water_type), named_sensor(SENSOR), camera_depth_m=8.0)
    gain, residual = fit_level(medium, level_view(frame.pixels))
    seen = gain * medium.level_radiance(np.array([0.0]))[0]
    around = plate.water.seen_from(8.0).sun_maps[1]
    rows = around[ROWS // 2 - 1 : ROWS // 2 + 1].mean(axis=0)
    level = plate.level_radiance * typical_level(around)
    step = decode(encode(level, "srgb") + CHROMA_STEP, "srgb") - level
    assert np.all(np.abs(seen - level) < np.maximum(right * level, step)), (seen / level, step / level)
    varies = luminance(plate.level_radiance * rows) / luminance(level) - 1.0  # about the sun
    assert residual < np.hypot(0.1, np.sqrt(np.mean(varies**2)))


def test_a_plate_without_open_water_is_doubted(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    for k in range(3):
        rocks = np.repeat(rng.uniform(0.01, 1.0, (SIZE[1], SIZE[0] // 8, 3)) ** 2, 8, axis=1)
        write_exr(tmp_path / f"plate_{k:04d}.exr", rocks.astype(np.float32))
    scene = scene_of(tmp_path)
    with open_plate(scene) as video:
        assert "gain is not known" in first_pass(load_surroundings(scene), video, measures=["gain"]).notes[0]


def test_the_horizon_is_read_level() -> None:
    # a camera that rolls by 20 degrees sees the same band, from planes and from light
    up = np.array([-np.sin(0.35), np.cos(0.35), 0.0])
    direction = directions(512, 256) @ up
    plate = np.clip(0.2 + 0.5 * direction, 0.0, 1.0)[..., None] * np.array([0.3, 0.6, 1.0])
    rows_up, light = level_view(plate.astype(np.float32), up)
    expected = (0.2 + 0.5 * rows_up)[:, None, None] * np.broadcast_to([0.3, 0.6, 1.0], (2, SECTORS, 3))
    np.testing.assert_allclose(light, expected, rtol=0.02)  # a pixel is 0.7 degrees, 3 % of this slope


@pytest.mark.parametrize(("begin", "step_at"), [(0, None), (0, 14), (5, 14), (2, 17)])
def test_a_few_frames_a_second_give_the_gain_of_all(begin: int, step_at: int | None) -> None:
    """Whatever frame the series begins with, and with the exposure's step at its frame."""
    rate, count, measured = 24.0, 40, list[int]()
    shape = np.linspace(0.05, 0.4, 8 * 16 * 3).reshape(8, 16, 3)

    def measure(index: int) -> MeasuredGain:
        measured.append(index)
        bright = 1.3 if step_at is not None and index >= step_at else 1.0
        slow = 1.0 + 0.02 * np.sin(2.0 * np.pi * index / 120.0)
        return MeasuredGain(np.array([1.0, 0.8, 0.5]) * bright * slow, 0.01 * index, shape * bright)

    series = GainSeries(measure, rate)
    for index in range(begin, count):
        series.add(index, index)
    found, counted = series.steady(), list(measured)
    every = [measure(index) for index in range(begin, count)]
    changes = [(exposure_change(a.shown, b.shown), picture_change(a.shown, b.shown)) for a, b in pairwise(every)]
    exposure, picture = np.transpose([(0.0, 0.0), *changes])
    expected = steady_gain([one.gain for one in every], exposure, picture, rate)
    np.testing.assert_allclose(found, expected, rtol=1e-4)  # lines between samples of a wave of 5 s: (pi/40)^2/8 .02
    np.testing.assert_allclose(series.residuals, [one.residual for one in every], atol=FLOAT64)
    apart = {index for index in range(begin, count) if index % 3 and index != begin and index < 39}
    around = set() if step_at is None else set(range(step_at // 3 * 3, step_at // 3 * 3 + 3))
    assert apart - set(counted) == apart - around


class ReadWhole(ReaderOver):
    """A plate of which every frame is read."""

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[VideoFrame]:
        return self._plate.frames(start, stop)


def test_frames_that_a_pass_goes_by_are_read_where_the_light_changes(reef: Path) -> None:
    """Something passes, between samples too: gain and sun are those of a pass that reads all."""
    scene = scene_of(reef, light={"sun": "detect"})
    with open_plate(scene) as video:
        seen = list(video.sampled(0, FRAMES, lambda index: index % 2 == 0))
        some, every = (first_pass(load_surroundings(scene), one) for one in (video, ReadWhole(video)))
    assert sum(frame.is_read for frame in seen) == FRAMES / 2
    np.testing.assert_array_equal(some.gain, every.gain)
    np.testing.assert_array_equal(some.sun.raw_direction, every.sun.raw_direction)


def test_water_whose_blue_is_clipped_keeps_its_colour() -> None:
    """Blue is clipped from somewhat below the horizon up: its light there is found by the colour of what is below."""
    up = directions(512, 256)[..., 1]
    light = np.exp(0.8 * up)[..., None] * np.array([0.1, 0.5, 1.15])
    _, shown = level_view(np.minimum(light, 1.0).astype(np.float32))
    np.testing.assert_allclose(
        shown.mean(axis=(0, 1)), [0.1, 0.5, 1.15], rtol=0.04
    )  # means about the limit hold clipped pixels
    _, whole = level_view((0.5 * light).astype(np.float32))
    np.testing.assert_allclose(whole.mean(axis=(0, 1)), [0.05, 0.25, 0.575], rtol=1e-3)  # nothing of it is clipped
