# SPDX-License-Identifier: Apache-2.0
"""Matching of caustics: unprojection, measures of patterns, refusals, a fit of made seas."""

from __future__ import annotations

import contextlib
import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mr360uw.base.constants import GRAVITY_M_S2
from mr360uw.base.sphere import direction_from_angles, directions, yaw_matrix
from mr360uw.caustics import GerstnerSea, SpectralSea
from mr360uw.cli.tools import match
from mr360uw.errors import ParameterError
from mr360uw.match import CausticMatch, caustic_match, match_caustics, spectral_distance
from mr360uw.match.floor_series import FloorGrid, FloorView, ModelledFloor, bands, pattern_measures, relative_light
from mr360uw.preview.screen import encoded
from mr360uw.scene import load_scene
from mr360uw.video import VideoFrame

PIXEL_M, STEP_S = 0.06, 0.15
HEIGHT_M = 2.0


def checkerboard(position: np.ndarray, rotation: np.ndarray, square_m: float) -> VideoFrame:
    """Return the frame of a floor of squares at y = 0, red to the north (-z) and green to the east of (0, 0)."""
    d = directions(1024, 512) @ rotation.T
    reach = position[1] / np.maximum(-d[..., 1], 1e-3)
    x, z = position[0] + reach * d[..., 0], position[2] + reach * d[..., 2]
    dark = (np.floor(x / square_m) + np.floor(z / square_m)) % 2.0
    image = np.stack([np.where(z < 0.0, 0.8, 0.2), np.where(x > 0.0, 0.8, 0.2), dark], axis=-1)
    return VideoFrame.of_linear(np.where(d[..., 1:2] < 0.0, image, 0.5).astype(np.float32))


@pytest.mark.parametrize("place", [(0.0, 0.0), (0.4, -0.3)])
@pytest.mark.parametrize("yaw_deg", [0.0, 90.0, 200.0])
def test_a_floor_is_seen_from_above_wherever_the_camera_is_and_looks(
    place: tuple[float, float], yaw_deg: float
) -> None:
    tilt = np.radians(12.0)
    pitch = np.array([[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]])
    position, rotation = np.array([place[0], HEIGHT_M, place[1]]), yaw_matrix(np.radians(yaw_deg)) @ pitch
    grid = FloorGrid(0.0, 0.0, 3.2, 0.0, 64)
    view = FloorView(grid, position, rotation, 1024, 512)
    seen = view.read(checkerboard(position, rotation, 0.4).image_linear[view.rows])
    x, z = grid.places()
    dark = (np.floor(x / 0.4) + np.floor(z / 0.4)) % 2.0
    # squares of eight pixels; those at an edge mix, which a bilinear read of 1.2 cm to 3 cm footprints widens
    inside = (np.abs(np.remainder(x, 0.4) - 0.2) < 0.12) & (np.abs(np.remainder(z, 0.4) - 0.2) < 0.12)
    np.testing.assert_allclose(seen[inside, 2], dark[inside], atol=0.02)
    # pixels of the plate lie where the world has them: each at the place of its own, x over its column
    picture = np.stack([view.x_m, view.z_m], axis=-1)
    np.testing.assert_allclose(view.read(picture)[8:-8, 8:-8], np.stack([x, z], -1)[8:-8, 8:-8], atol=0.03)
    assert seen[5, 32, 0] == pytest.approx(0.8, abs=0.01)  # north is the top
    assert seen[32, 58, 1] == pytest.approx(0.8, abs=0.01)  # east is the right


def wave(length_m: float, azimuth_deg: float, speed_m_s: float, frames: int = 24) -> np.ndarray:
    """Return the light (T, n, n) of a plane wave of 20 % that travels to an azimuth."""
    n = 96
    x, z = np.meshgrid(*(np.arange(n) * PIXEL_M,) * 2)
    along = x * np.sin(np.radians(azimuth_deg)) - z * np.cos(np.radians(azimuth_deg))
    time_s = np.arange(frames)[:, None, None] * STEP_S
    return 1.0 + 0.2 * np.sin(2.0 * np.pi / length_m * (along - speed_m_s * time_s))


@pytest.mark.parametrize(
    ("length_m", "azimuth_deg", "speed_m_s"), [(0.5, 0.0, 0.9), (0.8, 75.0, 1.1), (1.2, 200.0, 1.4), (0.6, 300.0, 0.7)]
)
def test_a_plane_wave_is_measured(length_m: float, azimuth_deg: float, speed_m_s: float) -> None:
    sand = 1.0 + 0.5 * np.random.default_rng(1).random((96, 96))
    relative = relative_light(sand * wave(length_m, azimuth_deg, speed_m_s))
    found = pattern_measures(relative, PIXEL_M, STEP_S, bands(96 * PIXEL_M, 0.3))
    assert found.contrast == pytest.approx(0.2 / np.sqrt(2.0), rel=0.05)  # 3.6 s are no whole number of periods
    assert np.hypot(*found.direction) > 0.95
    assert abs((found.azimuth_deg - azimuth_deg + 180.0) % 360.0 - 180.0) < 2.0
    # a window's edges and what goes into broader bands lose some of the variance
    assert np.sqrt(found.power.sum()) == pytest.approx(found.contrast, rel=0.15)
    strongest = int(np.argmax(found.power))
    # bands are half an octave wide
    assert abs(np.log2(found.wavelength_m[strongest] / length_m)) <= 0.26
    rate = 2.0 * np.pi * speed_m_s / length_m
    # mean over the line of the time window, 2 pi/T = 1.7 rad/s wide on either side
    assert found.frequency_rad_s[strongest] == pytest.approx(rate, rel=0.06)


def test_waves_of_deep_water_have_a_dispersion_of_one() -> None:
    """In their own band; a pattern that is drawn past at another speed has another."""
    edges = np.array([0.7, 0.9])
    speed = np.sqrt(GRAVITY_M_S2 * 0.8 / (2.0 * np.pi))
    for factor in (1.0, 0.4):
        relative = relative_light(wave(0.8, 30.0, factor * speed))
        found = pattern_measures(relative, PIXEL_M, STEP_S, edges).dispersion
        # the time window is 1.7 rad/s wide, against 8.8 rad/s of this wave
        assert found == pytest.approx(factor, rel=0.05)


def test_the_texture_of_the_floor_and_a_change_of_exposure_leave_no_pattern() -> None:
    sand = 0.5 + np.random.default_rng(2).random((64, 64))
    light = sand * np.linspace(0.9, 1.1, 12)[:, None, None]
    assert relative_light(light).std() < 1e-5  # float32


def test_bands_end_at_what_is_seen() -> None:
    edges = bands(8.0, 0.3)
    assert edges[0] >= 0.3
    assert edges[-1] == pytest.approx(8.0 / 3.0)
    with pytest.raises(ParameterError, match="region - is too small"):
        bands(1.0, 0.5)


def floor(depth_m: float = 5.0) -> ModelledFloor:
    """Return a small floor under a high sun."""
    grid = FloorGrid(0.0, 0.0, 6.0, 0.0, 48)
    times = np.arange(6) / 6.0
    view = FloorView(grid, np.array([0.0, 1.5, 0.0]), np.eye(3), 128, 64)
    return ModelledFloor((view,) * 6, grid.pixel_m, times, depth_m, direction_from_angles(0.5, 1.1), 0.6, 1.0)


def test_a_made_sea_is_found_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Few seas, so wide bounds: the regression's own error is several times that of 116."""
    monkeypatch.setattr(caustic_match, "SEAS", (12, 14))
    sea = GerstnerSea(tile_m=8.0, detail_slope=0.02, shortest_wavelength_m=0.5)
    truth = sea.model_copy(
        update={"wind_speed": 2.0, "dominant_wavelength_m": 3.0, "wind_direction_deg": 120.0, "seed": 7}
    )
    measure = caustic_match.measurer(0.125, 1.0 / 6.0, bands(6.0, 0.4))
    plate, features = measure(floor().light(truth))
    fit = caustic_match.fit_sea(sea, floor(), measure, plate, features)
    assert abs(np.log(fit.value[1] / 3.0)) < 0.5
    assert abs(np.log(fit.value[0] / 2.0)) < 0.8
    assert abs((fit.direction_deg - 120.0 + 180.0) % 360.0 - 180.0) < 30.0
    assert fit.misfit < 2.0


def test_what_is_fitted_of_a_sea() -> None:
    assert [name for name, *_ in caustic_match.fitted_parameters(GerstnerSea())] == [
        "wind_speed",
        "dominant_wavelength_m",
    ]
    assert [name for name, *_ in caustic_match.fitted_parameters(SpectralSea())] == ["wind_speed", "fetch_m"]


def test_more_wind_makes_a_larger_distance_and_pictures_show_it() -> None:
    sea = GerstnerSea(tile_m=8.0, detail_slope=0.02, shortest_wavelength_m=0.5)
    edges, shown = bands(6.0, 0.4), []
    for wind in (1.0, 1.3, 4.0):
        light = floor().light(sea.model_copy(update={"wind_speed": wind}))
        relative = relative_light(light)
        shown.append(pattern_measures(relative, 0.125, 1.0 / 6.0, edges))
    match = CausticMatch("", plate=shown[0], before=shown[2], after=shown[1], pixel_m=0.125)
    assert spectral_distance(shown[0], shown[0]) == 0.0
    assert match.distance_after < match.distance_before
    pictures = match.pictures()
    assert set(pictures) == {"floor", "spectra"}
    assert all(p.dtype == np.uint8 and p.ndim == 3 and p.std() > 5.0 for p in pictures.values())


def test_more_of_a_beam_makes_more_contrast() -> None:
    sea = GerstnerSea(tile_m=8.0, detail_slope=0.02, shortest_wavelength_m=0.5)
    thin, thick = (replace(floor(), beam=beam).light(sea).std() for beam in (0.2, 0.4))
    assert thick == pytest.approx(2.0 * thin, rel=1e-4)  # float32


def test_a_codec_takes_detail_and_most_of_it_from_few_code_values() -> None:
    """Of 2 codes no more than the 4 % of amplitude that were measured, of many codes nothing to speak of."""
    sea = GerstnerSea(tile_m=8.0, detail_slope=0.02, shortest_wavelength_m=0.5)
    whole = floor().light(sea)
    few, many = (replace(floor(), codes=codes).as_coded(1.0, 1.0).light(sea) for codes in (2.0, 200.0))
    assert 0.9 < few.std() / whole.std() < 0.98  # 3.5 % of amplitude, and some by a blur of 0.3 pixels
    assert np.abs(np.diff(few)).mean() / few.std() < np.abs(np.diff(whole)).mean() / whole.std()
    # 0.03 % of amplitude; a blur of 0.003 pixels takes 1e-5
    np.testing.assert_allclose(many - 1.0, whole - 1.0, atol=1e-3 * float(np.abs(whole - 1.0).max()))


def test_a_floor_lost_in_the_veil_is_refused(still_floor: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is left of it without the water's light is noise about nothing."""
    random = np.random.default_rng(4)
    monkeypatch.setattr(FloorGrid, "light", lambda *_: 0.01 + 0.1 * random.standard_normal((128, 128, 3)))
    match = match_caustics(load_scene(still_floor))
    assert "no brighter than the water" in match.sentence
    assert not match.changes


def test_a_moving_camera_sees_the_same_floor() -> None:
    """Through other pixels, each an average over its own footprint: nearly the same pattern."""
    grid = FloorGrid(0.0, 0.0, 6.0, 0.0, 48)
    here, there = (
        FloorView(grid, np.array([x, 1.5, 0.0]), yaw_matrix(turn), 256, 128) for x, turn in ((0.0, 0.0), (0.3, 1.0))
    )
    sea = GerstnerSea(tile_m=8.0, detail_slope=0.02, shortest_wavelength_m=0.8)
    one, other = (
        ModelledFloor((view,), 0.125, np.zeros(1), 5.0, direction_from_angles(0.5, 1.1), 0.6, 1.0).light(sea)[0]
        for view in (here, there)
    )
    assert np.corrcoef(one[8:-8, 8:-8].ravel(), other[8:-8, 8:-8].ravel())[0, 1] > 0.98


@pytest.fixture(scope="module")
def still_floor(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The scene of a clip whose floor has a texture, grain of one code, and no caustics."""
    folder = tmp_path_factory.mktemp("still_floor")
    random = np.random.default_rng(3)
    up = directions(128, 64)[..., 1:2]
    sand = np.where(up > 0.0, 90.0 + 60.0 * up, 100.0 + 60.0 * random.random((64, 128, 1)))
    for k in range(12):
        codes = sand * np.array([0.5, 1.0, 1.1]) + random.integers(0, 2, (64, 128, 3))
        (folder / f"plate_{k:04d}.png").write_bytes(encoded(codes.astype(np.uint8), ".png"))
    scene = folder / "scene.toml"
    scene.write_text(
        """
        plate = { path = "plate_%04d.png", frame_rate = 6.0 }
        receiver = { height_m = -2.0 }
        light = { sun = "given", sun_elevation_deg = 50.0 }
        """
    )
    return scene


def test_a_floor_without_caustics_is_refused_with_the_reason(still_floor: Path) -> None:
    match = match_caustics(load_scene(still_floor))
    assert not match.changes
    assert match.confidence == 0.0
    assert "no caustics" in match.sentence
    assert match.plate is not None
    assert match.plate.contrast < 0.03


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ("receiver.height_m=3.0", "not below the camera"),
        ('water.type="none"', "no water"),
        ('light.sun="none"', "No sun"),
    ],
)
def test_a_scene_that_cannot_be_matched_says_why(still_floor: Path, change: str, reason: str) -> None:
    match = match_caustics(load_scene(still_floor, [change]))
    assert reason in match.sentence
    assert match.pictures() == {}


@pytest.mark.parametrize(
    ("caustics", "water", "words"),
    [(False, None, "one thing"), (True, "0,5,10", "one thing"), (False, "0,5", "no patch")],
)
def test_the_command_says_what_is_wrong(still_floor: Path, caustics: bool, water: str | None, words: str) -> None:
    with pytest.raises(ParameterError, match=words):
        lines_of(still_floor, caustics=caustics, water=water)


def test_the_command_prints_what_was_found(still_floor: Path) -> None:
    assert "too short" in lines_of(still_floor, caustics=True, water=None)[0]


def lines_of(path: Path, *, caustics: bool, water: str | None) -> list[str]:
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        match(path, caustics=caustics, water=water, frames="0:5")
    return said.getvalue().splitlines()


def test_too_few_frames_are_refused(still_floor: Path) -> None:
    assert "too short" in match_caustics(load_scene(still_floor), (0, 5)).sentence
