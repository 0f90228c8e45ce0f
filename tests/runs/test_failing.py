# SPDX-License-Identifier: Apache-2.0
"""Runs that fail late, or cannot begin: what is finished is playable, and nothing is left half written."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mr360uw as uw
from mr360uw.base.files import work_path
from mr360uw.errors import DamagedFrameError, GlError, OutputError, VideoError
from mr360uw.render.first_pass import ClipAnalysis
from mr360uw.render.frame import Backend, make_backend
from mr360uw.runs import outputs
from mr360uw.runs.job import Job, OpenJob
from mr360uw.runs.outputs import forecast_line
from mr360uw.runs.work_folder import work_folder
from mr360uw.scene import Scene
from mr360uw.scene.model import scene_from_dict
from tests.video.clips import write_clip

FRAMES, LOST = 30, 20
SEGMENTS = {"codec": "ffv1", "segment_s": 0.32}
"""Of eight frames at 25 frames a second, lossless."""


def bare(plate: Path, **more: object) -> Scene:
    """A scene without objects: frames go through it, so a run costs decoding and encoding alone."""
    table = {"plate": {"path": str(plate), **more}, "water": {"type": "none"}, "output": SEGMENTS}
    return scene_from_dict(table, plate.parent)


def luma(path: Path) -> list[Any]:
    with uw.open_video(path) as video:
        return [frame.pixels.y.copy() for frame in video.frames()]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A clip of 30 frames with sound."""
    path = tmp_path_factory.mktemp("plate") / "whole.mp4"
    return write_clip(path, FRAMES, size=(64, 32), options={"g": "10", "bf": "0"}, audio_s=1.2)


@pytest.fixture(scope="module")
def hurt(whole: Path) -> Path:
    """The clip with nothing left of the pictures from frame 20 on."""
    with uw.open_video(whole) as video:
        ends = video.index.end_byte
        spans = [(int(ends[k] - 60), int(ends[k])) for k in range(LOST, FRAMES)]
    data = bytearray(whole.read_bytes())
    for start, stop in spans:
        data[start:stop] = bytes(stop - start)
    data[int(ends[LOST]) - 200 : int(ends[LOST])] = bytes(200)
    path = whole.with_name("hurt.mp4")
    path.write_bytes(data)
    return path


@pytest.fixture
def out(tmp_path: Path) -> Path:
    return tmp_path / "out.mkv"


def test_what_is_finished_before_a_lost_frame_is_playable(whole: Path, hurt: Path, out: Path) -> None:
    with pytest.raises(DamagedFrameError, match=r"take frames 0:(\d+)") as caught:
        uw.composite_video(bare(hurt), out)
    count = caught.value.index
    assert 8 < count <= LOST + 1
    finished = work_path(out) / "finished.mkv"
    again = "the same command does not make them again"
    assert caught.value.__notes__ == [f"finished: frames 0:{count} ({count} frames), playable as {finished} - {again}"]
    assert not out.exists()
    np.testing.assert_array_equal(luma(finished), luma(whole)[:count])
    with pytest.raises(DamagedFrameError):  # once more: finished parts are kept, and the file is made again
        uw.composite_video(bare(hurt), out)
    np.testing.assert_array_equal(luma(finished), luma(whole)[:count])


def test_lost_frames_are_held_and_counted(hurt: Path, out: Path) -> None:
    report = uw.composite_video(bare(hurt, damaged="hold"), out)
    assert report.frames == len(luma(out)) == FRAMES
    assert report.held_frames > 0
    assert f"{report.held_frames} frames of the plate could not be decoded" in str(report)


def test_the_intact_part_of_a_clip_that_is_cut_is_used(out: Path, tmp_path: Path) -> None:
    options, front = {"g": "10", "crf": "10"}, {"movflags": "faststart"}
    fast = write_clip(tmp_path / "fast.mp4", FRAMES, size=(64, 32), options=options, container_options=front)
    cut = tmp_path / "cut.mp4"
    cut.write_bytes(fast.read_bytes()[:-2000])
    with pytest.raises(VideoError, match=r"is cut short .* take frames 0:\d+") as caught:
        uw.composite_video(bare(cut), out)
    assert not list(tmp_path.glob("out*"))
    usable = int(str(caught.value).rsplit("0:", 1)[1])
    assert uw.composite_video(bare(cut), out, frames=(0, usable)).frames == usable


class _FullDisk:
    """A file on a disk that is full after some bytes."""

    def __init__(self, file: Any, room: list[int]) -> None:
        self._file, self._room = file, room

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)

    def write(self, data: bytes) -> int:
        self._room[0] -= len(data)
        if self._room[0] < 0:
            raise OSError(28, "No space left on device")
        return int(self._file.write(data))


def test_a_full_disk_ends_the_run_and_it_goes_on_with_space(
    whole: Path, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened, room = Path.open, [24_000]

    def limited(path: Path, mode: str = "r", *args: Any, **options: Any) -> Any:
        file = opened(path, mode, *args, **options)
        return _FullDisk(file, room) if path.suffix == ".packets" and "w" in mode else file

    with monkeypatch.context() as full:
        full.setattr(Path, "open", limited)
        with pytest.raises(VideoError, match=r"cannot be written .got No space left on device. - check the space"):
            uw.composite_video(bare(whole), out)
    assert not out.exists()
    report = uw.composite_video(bare(whole), out)
    assert report.kept_frames > 0
    np.testing.assert_array_equal(luma(out), luma(whole))
    assert [path.name for path in out.parent.iterdir()] == [out.name]


def test_a_full_disk_while_joining_keeps_the_parts(whole: Path, out: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from mr360uw.video import container_writer

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(container_writer, "publish", lambda *_, **__: full())
        with pytest.raises(VideoError, match="No space left"):
            uw.composite_video(bare(whole), out)
    assert not out.exists()
    assert not list(work_path(out).glob("*.part*"))
    assert uw.composite_video(bare(whole), out).kept_frames == FRAMES


@pytest.mark.parametrize("stage", ["before", "rendering"])
def test_a_folder_that_vanishes_is_an_error(whole: Path, tmp_path: Path, stage: str) -> None:
    folder = tmp_path / "there"
    folder.mkdir()
    out = folder / "out.mkv"

    def vanish(done: int, total: int | None) -> None:  # noqa: ARG001 - as progress is called
        if done == 12:
            folder.rename(tmp_path / "gone")

    if stage == "before":
        folder.rmdir()
    with pytest.raises((VideoError, OSError), match=r"No such file|folder is missing"):
        uw.composite_video(bare(whole), out, progress=vanish)
    assert not folder.exists()
    assert not list(tmp_path.rglob("out.mkv"))


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="everything may be written by root")
def test_a_read_only_folder_is_an_error(whole: Path, tmp_path: Path) -> None:
    tmp_path.chmod(0o555)
    with pytest.raises(VideoError, match="Permission denied"):
        uw.composite_video(bare(whole), tmp_path / "out.mkv")
    assert list(tmp_path.iterdir()) == []


# --- names ---


@pytest.mark.parametrize("kind", ["same", "link", "hard link", "folder"])
def test_layers_under_the_output_s_names_are_refused(whole: Path, tmp_path: Path, kind: str) -> None:
    out, layers = tmp_path / "out_%04d.exr", tmp_path / "layers_%04d.exr"
    if kind == "same":
        layers = tmp_path / "out_####.exr"
    elif kind == "folder":
        (tmp_path / "again").symlink_to(tmp_path)
        layers = tmp_path / "again" / "out_%04d.exr"
    else:
        (tmp_path / "out_0001.exr").write_bytes(b"old")
        link = os.link if kind == "hard link" else os.symlink
        link(tmp_path / "out_0001.exr", tmp_path / "layers_0001.exr")
    before = sorted(path.name for path in tmp_path.iterdir())
    with pytest.raises(OutputError, match="is the name of another output too"):
        uw.composite_video(bare(whole), out, layers=layers, frames=(0, 3), overwrite=True)
    assert sorted(path.name for path in tmp_path.iterdir()) == before


@pytest.mark.parametrize("name", ["a:b c", "50%d", "[x]*?", "ünïcode 日本"])
def test_odd_names_of_the_sample_dive_s_clip(tmp_path: Path, name: str) -> None:
    from fractions import Fraction

    from mr360uw.sample.dive import record

    (tmp_path / name).mkdir()
    path = tmp_path / name / "dive.mp4"
    assert record(path, [np.full((32, 64, 3), 0.2, np.float32)] * 2, Fraction(24), 1) == 2
    with uw.open_video(path) as video:
        assert video.frame_count == 2


# --- renderers and forecasts ---


def test_a_worker_without_the_renderer_of_the_others_ends_the_run(
    whole: Path, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def without_gl(name: str, _eyes: int) -> tuple[Backend, str]:
        if name == "gl":
            raise GlError("no display")
        return make_backend("reference")

    monkeypatch.setattr("mr360uw.runs.job.make_backend", without_gl)
    scene = bare(whole)
    out.parent.mkdir(exist_ok=True)
    from mr360uw.runs.work_folder import WorkKeys

    with work_folder(out, WorkKeys("", "")) as work:
        work.keep_analysis(ClipAnalysis())
        with pytest.raises(
            GlError, match=r"has no OpenGL, which the run renders with .*--backend reference, or --mixed"
        ):
            OpenJob(Job(scene, out, work, "gl", None, ((0, 8),)))
        assert OpenJob(Job(scene, out, work, "auto", None, ((0, 8),))).backend.name == "reference"


def test_mixed_renderers_are_reported(whole: Path, out: Path) -> None:
    report = uw.composite_video(bare(whole), out, backend="reference", mixed=True)
    assert sum(report.renderers.values()) == FRAMES
    assert list(report.renderers) == ["reference (processor, float64)"]


def test_a_forecast_is_told_once_when_a_part_is_complete(
    whole: Path, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[str] = []
    uw.composite_video(bare(whole), out, tell=told.append)
    assert told == []  # a run of seconds needs none
    monkeypatch.setattr(outputs, "_LONG_S", 0.0)
    monkeypatch.setattr(outputs, "_MEASURED_S", 0.0)
    uw.composite_video(bare(whole), out, tell=told.append, overwrite=True)
    assert len(told) == 1
    assert "frames/s; writes " in told[0]


def test_a_forecast_in_words() -> None:
    line = forecast_line(1800, 0.5, 2.5e9, 4.9e9, 3e9)
    assert line.startswith("about 1 h 0 min for 1800 frames at 0.5 frames/s; writes 2.5 GB, needs 4.9 GB more")
    assert line.endswith("and only 3.0 GB are free")
    assert forecast_line(240, 2.0, 4e7, 8e7, 3e9).startswith("about 2 min for 240 frames at 2 frames/s; writes 40 MB")
