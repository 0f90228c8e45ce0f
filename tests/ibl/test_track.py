# SPDX-License-Identifier: Apache-2.0
"""The track of the sun, its files and its page; levelling; the solar position."""

from __future__ import annotations

import re
from datetime import datetime, timedelta, timezone
from pathlib import Path

import numpy as np
import pytest

import mr360uw.ibl as ibl
from mr360uw.base.sphere import direction_from_angles, directions, unit
from mr360uw.errors import ParameterError
from mr360uw.ibl.settings import parse_time, refraction, sun_angles
from mr360uw.ibl.sun.track import smooth
from mr360uw.ibl.tilt import keyed_level, level_at, level_from_gpmf, level_matrix, roll_pitch, streams
from mr360uw.preview.pages import frame_section, light_report
from mr360uw.types import Sun
from tests.gpmf import payloads, tilted_up
from tests.ibl.plates import angle_deg, clipped, sky
from tests.ibl.tolerances import ACCELEROMETER, FLOAT64, GRAVITY_RAD, SOLAR_DEG, TRACK_RMS_DEG


def clip(rng: np.random.Generator, frames: int = 300, cut: int = 140) -> tuple[np.ndarray, list[Sun | None]]:
    t = np.arange(frames) / 30.0
    azimuth = np.radians(8.0 * np.sin(2 * np.pi * t / 18.0) + np.where(np.arange(frames) >= cut, 60.0, 0.0))
    true = np.stack([direction_from_angles(a, 0.9) for a in azimuth])
    seen = unit(true + rng.normal(size=(frames, 3)) * np.radians(2.0) / np.sqrt(2.0))
    lost = rng.random(frames) < 0.1
    lost[cut - 2 : cut + 2] = False
    return true, [None if lost[k] else Sun(seen[k], np.full(3, 2.0), 0.01, 0.9) for k in range(frames)]


def test_track_is_smooth_without_lag_and_finds_the_cut(rng: np.random.Generator) -> None:
    true, suns = clip(rng)
    track = ibl.track_suns(suns)
    error = np.degrees(np.arccos(np.clip(np.sum(track.direction * true, axis=1), -1.0, 1.0)))
    assert np.sqrt(np.mean(error**2)) < TRACK_RMS_DEG
    assert track.cuts == (140,)
    np.testing.assert_allclose(track.irradiance, 2.0)


def test_smoothing_a_signal_backwards_gives_the_same(rng: np.random.Generator) -> None:
    values, weight = rng.normal(size=(80, 2)).cumsum(axis=0), rng.uniform(0.2, 1.0, 80)
    np.testing.assert_allclose(smooth(values[::-1], weight[::-1])[::-1], smooth(values, weight), atol=FLOAT64**0.5)


def test_a_parabola_passes_through_unchanged() -> None:
    t = np.linspace(-1, 1, 50)[:, None]
    values = np.hstack([t, t * t])
    got = smooth(values, np.where(np.arange(50) % 7 == 3, 0.0, 1.0))
    np.testing.assert_allclose(got, values, atol=FLOAT64**0.5)


@pytest.mark.parametrize("seen", [[40, 41, 42, 43, 44], [0, 1, 2, 119], [3, 60, 61, 118], [119, 118, 117, 116, 7]])
def test_a_signal_stays_what_it_is_before_its_first_and_after_its_last_sample(
    seen: list[int], rng: np.random.Generator
) -> None:
    first, last = min(seen), max(seen)
    weight = np.zeros(120)
    weight[seen] = rng.uniform(0.02, 1.0, len(seen))
    got = smooth(rng.normal(size=(120, 3)), weight, 1e9)  # singular to rounding at the greatest strengths
    assert np.all(np.isfinite(got))
    np.testing.assert_array_equal(got[:first], np.broadcast_to(got[first], (first, 3)))
    np.testing.assert_array_equal(got[last:], np.broadcast_to(got[last], (120 - last, 3)))


def test_gaps_are_bridged_and_lose_confidence(rng: np.random.Generator) -> None:
    true, suns = clip(rng)
    for k in range(60, 90):
        suns[k] = Sun(np.array([0.0, 0.0, -1.0]), np.ones(3), 0.01, 0.1)  # a wrong guess of little confidence
    track = ibl.track_suns(suns)
    assert angle_deg(track.direction[75], true[75]) < 2.0
    assert track.confidence[75] < track.confidence[30]
    assert track.at(75) is not None


def test_a_shot_without_a_sun_has_none() -> None:
    track = ibl.track_suns([None] * 12)
    assert track.at(3) is None
    assert track.at(time_s=0.1) is None
    with pytest.raises(ParameterError, match="either"):
        track.at()
    with pytest.raises(ParameterError, match="at least one"):
        ibl.track_suns([])


def test_cuts_show_in_the_picture() -> None:
    light = [ibl.environment(clipped(sky(unit([0.2, 0.8, z]), width=128))) for z in (0.1, 0.12)]
    other = ibl.environment(np.clip(0.5 + 0.45 * directions(128, 64)[..., :1] * np.ones(3), 0, 1))
    frames = [ibl.measure_sun(light[k % 2] if k < 7 else other, k / 25.0) for k in range(12)]
    assert ibl.track_suns(frames).cuts == (7,)


@pytest.mark.parametrize("name", ["track.json", "track.csv"])
def test_files_hold_the_track(tmp_path: Path, rng: np.random.Generator, name: str) -> None:
    _, suns = clip(rng)
    track = ibl.track_suns(suns)
    ibl.save_track(track, tmp_path / name)
    back = ibl.load_track(tmp_path / name)
    assert back.cuts == track.cuts
    for field in ("direction", "raw_direction", "irradiance", "half_angle_rad", "confidence", "times_s", "share"):
        np.testing.assert_allclose(getattr(back, field), getattr(track, field), atol=1e3 * FLOAT64**0.75)
    with pytest.raises(ParameterError, match="not a name"):
        ibl.save_track(track, tmp_path / "track.txt")
    earlier = (tmp_path / name).read_text().replace(",share", "").replace('"share"', '"unknown"')
    (tmp_path / name).write_text(re.sub(r",1\.0\n", "\n", earlier) if name.endswith("csv") else earlier)
    np.testing.assert_array_equal(ibl.load_track(tmp_path / name).share, 1.0)
    (tmp_path / name).write_text("nonsense")
    with pytest.raises(ParameterError, match=r"sun track|columns"):
        ibl.load_track(tmp_path / name)


def test_the_page_is_one_file(rng: np.random.Generator) -> None:
    _, suns = clip(rng)
    plate = clipped(sky(unit([0.2, 0.8, 0.1]), width=128))
    frame = frame_section(0.5, plate, ibl.environment(plate))
    page = light_report("a <dive>", ibl.track_suns(suns), [frame, ("Water", "<p>clear</p>")])
    assert page.startswith("<!doctype html>")
    assert "a &lt;dive&gt;" in page
    assert page.count("data:image/png;base64,") == 4
    assert page.count("<svg") == page.count("</svg>") == 5
    assert "<p>clear</p>" in page
    assert "http" not in page


def test_level_matrix_and_its_inverse() -> None:
    for roll, pitch in ((0.1, -0.3), (-0.4, 0.2), (0.0, 0.0)):
        up = level_matrix(roll, pitch).T @ np.array([0.0, 1.0, 0.0])
        np.testing.assert_allclose(roll_pitch(up), (roll, pitch), atol=FLOAT64)
    nose_up = level_matrix(0.0, 0.2) @ np.array([0.0, 0.0, -1.0])
    assert nose_up[1] > 0.0
    right_down = level_matrix(0.2, 0.0) @ np.array([1.0, 0.0, 0.0])
    assert right_down[1] < 0.0


def test_keys_are_joined_by_lines() -> None:
    track = keyed_level([(0.0, 0.0, 0.1), (2.0, 0.2, 0.3)])
    np.testing.assert_allclose(level_at(track, 1.0), level_matrix(0.1, 0.2), atol=FLOAT64)
    np.testing.assert_allclose(level_at(track, 9.0), level_matrix(0.2, 0.3), atol=FLOAT64)
    with pytest.raises(ParameterError, match="ascending"):
        keyed_level([(1.0, 0.0, 0.0), (0.0, 0.0, 0.0)])


def test_gravity_of_a_gopro() -> None:
    roll, pitch = 0.4 * np.sin(0.1 * np.arange(75)), 0.3 * np.cos(0.07 * np.arange(75)) - 0.1
    up = tilted_up(roll, pitch)
    data = b"".join(payloads(up, (30, 30, 15)))
    assert [part.shape for part in streams(data, "GRAV")] == [(30, 3), (30, 3), (15, 3)]
    # two sensors of one body: the accelerometer's reading is stored as left, back, up
    reading = unit(np.concatenate(list(streams(data, "ACCL")))[::7])
    np.testing.assert_allclose(reading @ [[-1, 0, 0], [0, 0, 1], [0, 1, 0]], up, atol=ACCELEROMETER)
    track = level_from_gpmf(data, 29.97)
    np.testing.assert_allclose(track[:, 0], np.arange(75) / 29.97, atol=FLOAT64)
    np.testing.assert_allclose(track[:, 1:].T, (roll, pitch), atol=GRAVITY_RAD)
    level = level_matrix(*track[20, 1:])
    assert angle_deg(level @ up[20], np.array([0.0, 1.0, 0.0])) < np.degrees(2.0 * GRAVITY_RAD)
    with pytest.raises(ParameterError, match="cut off"):
        list(streams(data[:200], "GRAV"))
    with pytest.raises(ParameterError, match="no gravity"):
        level_from_gpmf(b"", 30.0)


@pytest.mark.parametrize(("elevation_deg", "minutes"), [(0.0, 28.98), (10.0, 5.41), (45.0, 1.01)])
def test_air_lifts_a_low_sun(elevation_deg: float, minutes: float) -> None:
    """Minutes of arc by the formula of Saemundsson (1986), reckoned apart."""
    assert np.degrees(refraction(np.radians(elevation_deg))) * 60.0 == pytest.approx(minutes, abs=0.02)


def test_solar_position_of_the_published_example() -> None:
    """NREL/TP-560-34302 (Reda & Andreas 2008), appendix A.5: azimuth 194.34024, zenith 50.11162 degrees."""
    time = datetime(2003, 10, 17, 12, 30, 30, tzinfo=timezone(timedelta(hours=-7)))
    azimuth, elevation = np.degrees(sun_angles(time, 39.742476, -105.1786))
    assert azimuth == pytest.approx(194.34024, abs=SOLAR_DEG)
    assert 90.0 - elevation == pytest.approx(50.11162, abs=SOLAR_DEG)
    with pytest.raises(ParameterError, match="zone"):
        parse_time("2026-06-21T12:00:00")
