# SPDX-License-Identifier: Apache-2.0
"""The written track, the report, and clips that cannot be tracked."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import mr360uw as uw
from mr360uw.composite import read_camera_track
from mr360uw.errors import Mr360uwError, OutputExistsError, ParameterError
from mr360uw.sample.dive import record
from mr360uw.track.camera_track import CameraTrack, FittedFloor
from mr360uw.track.colmap import pairs_to_match
from mr360uw.track.key_frames import fixed_pixels
from mr360uw.track.tracking import report_lines, verdict


def made(residual_px: float = 0.3, interpolated: int = 0) -> CameraTrack:
    """Return a track of ten frames whose quaternions change their sign."""
    rotation = Rotation.from_euler("y", np.linspace(150.0, 210.0, 10)[:, None], degrees=True).as_matrix()
    residual = np.full(10, residual_px)
    residual[:interpolated] = np.nan
    return CameraTrack(
        "moving", np.arange(10) / 24.0, np.outer(np.arange(10.0), [0.1, 0.0, -0.2]), rotation, residual,
        residual * 360.0 / 1280, np.arange(10), np.ones((3, 3)), np.full(3, 0.2), 0.5, 1280,
        FittedFloor(-1.98, 1.5, 0.8, 321), "gravity", "as given",
    )  # fmt: skip


def test_a_scene_reads_what_is_written(tmp_path: Path) -> None:
    track = made(interpolated=2)
    csv, beside = track.save(tmp_path / "track.json")
    motion = read_camera_track(csv)
    # nine digits are written
    np.testing.assert_allclose(motion.position, track.position, atol=1e-8)
    np.testing.assert_allclose(motion.rotation, track.rotation, atol=1e-8)
    np.testing.assert_allclose(motion.time_s, track.time_s, atol=1e-8)
    assert np.all(np.sum(track.quaternion[1:] * track.quaternion[:-1], axis=1) > 0.9)
    written = json.loads(beside.read_text("utf-8"))
    assert written["residual_px"][:3] == [None, None, 0.3]
    assert written["floor"]["height_m"] == -1.98
    with pytest.raises(OutputExistsError, match="overwrite"):
        track.save(tmp_path / "track.csv")


def test_the_report_says_how_good_it_is() -> None:
    # 0.3 px of 1280 are 0.084 degrees, at 5 m 7.4 mm
    assert verdict(made()) == ("good: objects stay in place to 0.7 cm at 5 m; 10 of 10 frames solved; residual 0.30 px")
    assert verdict(made(0.9)).startswith("usable")
    lost = made()
    assert verdict(replace(lost, position=1e4 * lost.position)).startswith("doubtful")
    for agreed, word in ((0.9, "good"), (0.77, "usable"), (0.7, "doubtful")):
        drifting = replace(made(), agreed=agreed)
        assert verdict(drifting).startswith(word)
        assert any("light that drifts" in line for line in report_lines(drifting)) == (word != "good")
    assert verdict(made(interpolated=6)).startswith("doubtful: objects stay in place to 0.7 cm at 5 m; 4 of 10")
    assert any("[receiver] height_m = -1.98" in line for line in report_lines(made()))


def test_all_neighbours_and_some_far_frames_are_matched() -> None:
    pairs = set(pairs_to_match(100))
    assert {(i, i + 1) for i in range(99)} <= pairs
    assert (0, 99) in pairs
    assert len(pairs) < 12 * 100


def test_what_stands_still_in_a_moving_picture_is_left_out(rng: np.random.Generator) -> None:
    pictures, moving = [], rng.integers(0, 255, (96, 400)).astype(np.uint8)
    rig = rng.integers(0, 255, (20, 192)).astype(np.uint8)
    for k in range(10):
        picture = moving[:, 8 * k : 8 * k + 192].copy()
        picture[70:90] = rig
        pictures.append(picture)
    mask = fixed_pixels(pictures)
    assert mask[72:88, 4:-4].all()
    assert not mask[:60].any()


WIDTH = 128
NOISE = np.random.default_rng(0).random((6, WIDTH // 2, WIDTH, 3))
CLIPS = {
    "one colour": (np.full((6, WIDTH // 2, WIDTH, 3), 0.3), "is of one colour"),
    "no texture": (
        np.linspace(0.05, 0.6, WIDTH // 2)[None, :, None, None] * np.ones((6, 1, WIDTH, 3)),
        "has no texture",
    ),
    "two frames": (NOISE[:2], "is too short"),
    "noise": (NOISE, "too few features"),
}


@pytest.mark.parametrize("name", sorted(CLIPS))
def test_clips_that_cannot_be_tracked(tmp_path: Path, name: str) -> None:
    pytest.importorskip("pycolmap")
    images, words = CLIPS[name]
    record(tmp_path / "clip.mp4", iter(images), Fraction(24), seed=1)
    with pytest.raises(ParameterError, match=words):
        uw.track_camera(tmp_path / "clip.mp4")


def test_the_command_refuses_and_leaves_nothing(tmp_path: Path, run: Callable[..., tuple[int, str, str]]) -> None:
    pytest.importorskip("pycolmap")
    record(tmp_path / "clip.mp4", iter(CLIPS["one colour"][0]), Fraction(24), seed=1)
    clip, out = tmp_path / "clip.mp4", tmp_path / "track.csv"
    for arguments, words in {
        (): "is of one colour",
        ("--depth-offset", "3"): "without --depth-log",
        ("--height", "2", "--length", "1,1:2,2=3"): "given twice",
        ("--length", "1,1=3"): "--length - must be two pixels",
        ("--fps", "24"): "for --from alone",
    }.items():
        code, _, errors = run("track", clip, "-o", out, *arguments)
        assert (code, words in errors, errors.count("error:")) == (2, True, 1), errors
    assert [path.name for path in tmp_path.iterdir()] == ["clip.mp4"]


def test_a_path_of_another_program_has_no_verdict() -> None:
    track = replace(made(), residual_px=np.full(10, np.nan), points=np.zeros((0, 3)))
    assert not any("doubtful" in line for line in report_lines(track))
    assert any(line.startswith("path ") for line in report_lines(track))


def test_other_mistakes(tmp_path: Path) -> None:
    pytest.importorskip("pycolmap")
    still, mask = tmp_path / "still.png", tmp_path / "mask.png"
    cv2.imwrite(str(still), np.zeros((64, 128, 3), np.uint8))
    cv2.imwrite(str(mask), np.zeros((32, 64), np.uint8))
    with pytest.raises(ParameterError, match="one picture"):
        uw.track_camera(still)
    with pytest.raises(ParameterError, match=r"got 64x32\) - make it 128x64"):
        uw.track_camera(still, mask=mask)
    with pytest.raises(ParameterError, match="--height"):
        uw.track_camera(still, height_m=0.0)


def test_without_pycolmap_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "pycolmap", None)
    with pytest.raises(Mr360uwError, match=r"pip install 'mr360uw\[track\]'"):
        uw.track_camera("dive.mp4")
