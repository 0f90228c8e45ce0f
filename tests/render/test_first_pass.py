# SPDX-License-Identifier: Apache-2.0
"""The sun of a clip: one direction in the world, whatever frame is asked for and wherever a run begins."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from mr360uw.base.disk_cache import write_arrays
from mr360uw.base.sphere import direction_from_angles
from mr360uw.composite.grading.settings import PlateGrade
from mr360uw.errors import DamagedFrameError
from mr360uw.render.first_pass import ClipAnalysis, first_pass, measured_range
from mr360uw.render.surroundings import CameraPath, load_surroundings
from mr360uw.runs.work_folder import arrays_of_analysis, load_analysis
from mr360uw.scene.model import Scene
from mr360uw.scene.resolved import open_plate
from mr360uw.types import Sun
from mr360uw.video import VideoFrame, write_exr
from mr360uw.video.reader import Chosen
from tests.ibl import tolerances as tol
from tests.ibl.plates import clipped, sky
from tests.scenes import scene_with
from tests.tolerances import FLOAT64

FRAMES, RATE = 10, 20


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A clip whose sun goes to and fro by two degrees, as waves make it."""
    folder = tmp_path_factory.mktemp("clip")
    for k in range(FRAMES):
        place = direction_from_angles(0.5 + 0.04 * np.sin(1.9 * k), 1.0 + 0.03 * np.cos(2.3 * k))
        write_exr(folder / f"plate_{k:04d}.exr", clipped(sky(place, width=256)))
    return folder


def scene_of(folder: Path, water: dict[str, object] | None = None, **camera: object) -> Scene:
    plate = {"path": str(folder / "plate_%04d.exr"), "frame_rate": RATE}
    return scene_with(folder, None, camera={"depth_m": 4.0, **camera}, object=[], plate=plate, water=water or {})


def suns_of(scene: Scene) -> list[Sun]:
    with open_plate(scene) as video:
        analysis = first_pass(load_surroundings(scene), video, measures=["sun"])
    suns = [analysis.sun_at(k) for k in range(FRAMES)]
    assert all(isinstance(sun, Sun) for sun in suns)
    return [sun for sun in suns if isinstance(sun, Sun)]


def test_a_standing_camera_has_one_sun_in_every_frame(folder: Path) -> None:
    suns = suns_of(scene_of(folder))
    assert all(np.array_equal(sun.direction, suns[0].direction) for sun in suns)
    assert np.degrees(np.arccos(suns[0].direction @ direction_from_angles(0.5, 1.0))) < 1.0
    again = suns_of(scene_of(folder))
    assert all(np.array_equal(a.irradiance, b.irradiance) for a, b in zip(suns, again, strict=True))


def test_a_doubtful_sun_has_the_same_share_over_a_clip_as_in_one_frame(tmp_path: Path) -> None:
    """What is not taken for its beam stays in the sky, in a clip as in a still."""
    wide = clipped(sky(direction_from_angles(0.5, 1.0), width=256, half_angle_rad=np.radians(12.5)))
    for k in range(FRAMES):
        write_exr(tmp_path / f"plate_{k:04d}.exr", wide)
    scene = scene_of(tmp_path, water={"type": "none"})
    with open_plate(scene) as video:
        surroundings = load_surroundings(scene)
        analysis = first_pass(surroundings, video, measures=["sun"])
        frame = next(iter(video.frames(4, 5)))
    alone = surroundings.light.of(frame.pixels, time_s=frame.time_s)
    tracked = surroundings.light.of(frame.pixels, analysis.sun_at(4), time_s=frame.time_s)
    assert alone.sun is not None
    assert tracked.sun is not None
    share = alone.sun.share
    assert 0.2 < share < 0.8
    assert tracked.sun.share == pytest.approx(share, rel=tol.TRACKED_SHARE)
    for found, expected in ((tracked.irradiance, alone.irradiance), (tracked.ambient, alone.ambient)):
        np.testing.assert_allclose(found, expected, rtol=tol.TRACKED_SHARE)


def test_frames_of_a_range_take_the_sun_of_the_whole_clip(folder: Path) -> None:
    scene = scene_of(folder)
    with open_plate(scene) as video:
        whole = first_pass(load_surroundings(scene), video, measures=["sun"])
        for _ in video.frames(6, 8):  # a reader that has been used elsewhere
            pass
        later = first_pass(load_surroundings(scene), video, measures=["sun"])
    for k in (0, 6, 9):
        a, b = whole.sun_at(k), later.sun_at(k)
        assert isinstance(a, Sun)
        assert isinstance(b, Sun)
        np.testing.assert_array_equal(a.direction, b.direction)
        np.testing.assert_array_equal(a.irradiance, b.irradiance)


def test_a_range_is_measured_with_a_margin_and_no_more(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene, read = scene_of(folder), list[tuple[int, int]]()
    monkeypatch.setattr("mr360uw.render.first_pass.MARGIN_S", 2.1 / RATE)
    with open_plate(scene) as video:
        sampled = video.sampled
        monkeypatch.setattr(video, "sampled", lambda a, b, chosen: read.append((a, b)) or sampled(a, b, chosen))
        analysis = first_pass(load_surroundings(scene), video, measures=["sun"], frames=(5, 6))
        assert read == [(2, 9)]
        assert (analysis.first, len(analysis.sun)) == (2, 7)
        assert analysis.sun_at(5) is not None
        assert analysis.sun_at(0).direction == pytest.approx(analysis.sun_at(2).direction, abs=0)
        assert [measured_range(video, *span) for span in ((0, 1), (9, 10))] == [(0, 4), (6, 10)]
    gain = ClipAnalysis(gain=np.arange(6.0).reshape(2, 3), first=4)
    assert [gain.gain_at(k)[0] for k in (0, 4, 5, 9)] == [0.0, 0.0, 3.0, 3.0]


def test_a_stored_track_is_read_by_the_frames_of_the_clip(folder: Path, tmp_path: Path) -> None:
    scene = scene_of(folder)
    with open_plate(scene) as video:
        track = first_pass(load_surroundings(scene), video, measures=["sun"]).sun
    later = track.since(3)
    assert len(later) == FRAMES - 3
    np.testing.assert_array_equal(later.at(2).irradiance, track.at(5).irradiance)
    grade = PlateGrade(1.2, columns=512)
    write_arrays(tmp_path / "analysis.npz", arrays_of_analysis(ClipAnalysis(later, first=3, grade=grade)))
    analysis = load_analysis(tmp_path / "analysis.npz")
    assert analysis.grade == grade
    np.testing.assert_array_equal(analysis.sun_at(5).irradiance, track.at(5).irradiance)


def test_a_margin_ends_where_frames_cannot_be_decoded(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = scene_of(folder)
    with open_plate(scene) as video:
        sampled = video.sampled

        def damaged(start: int, stop: int, chosen: Chosen) -> Iterator[VideoFrame]:
            for frame in sampled(start, stop, chosen):
                if frame.index in (1, 8):
                    raise DamagedFrameError("lost", frame.index)
                yield frame

        monkeypatch.setattr(video, "sampled", damaged)
        analysis = first_pass(load_surroundings(scene), video, measures=["sun"], frames=(3, 6))
        assert (analysis.first, len(analysis.sun)) == (2, 6)
        with pytest.raises(DamagedFrameError):
            first_pass(load_surroundings(scene), video, measures=["sun"], frames=(3, 9))


def test_a_tracked_camera_turns_under_one_sun(folder: Path, tmp_path: Path) -> None:
    """The plate's sun stands still in the picture while the track says that the camera turns: the world decides."""
    rows = ["time_s,x,y,z,qx,qy,qz,qw"]
    for k in range(FRAMES):
        half = 0.5 * np.radians(2.0 * k)
        rows.append(f"{k / RATE},0,0,0,0,{np.sin(half)},0,{np.cos(half)}")
    (tmp_path / "camera.csv").write_text("\n".join(rows) + "\n")
    scene = scene_of(folder, track=str(tmp_path / "camera.csv"))
    assert CameraPath.of(scene).rotation_known == "tracked"
    suns = suns_of(scene)
    assert all(np.array_equal(sun.direction, suns[0].direction) for sun in suns)


def test_what_is_known_of_the_camera(folder: Path) -> None:
    assert CameraPath.of(scene_of(folder)).rotation_known == "unknown"
    assert CameraPath.of(scene_of(folder, roll_deg=3.0)).rotation_known == "unknown"
    keys = [[0.0, 1.0, 2.0], [0.4, -1.0, 0.0]]
    level = scene_of(folder, tilt_keys=keys)
    assert CameraPath.of(level).rotation_known == "levelled"
    suns = suns_of(level)
    assert np.ptp([sun.direction[1] for sun in suns]) < FLOAT64
