# SPDX-License-Identifier: Apache-2.0
"""A run that was stopped goes on where it ended, and its output is that of a run that was not."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import mr360uw as uw
from mr360uw.base.files import work_path
from mr360uw.errors import OutputExistsError
from mr360uw.runs import work_folder
from mr360uw.runs.work_folder import joined_bounds, segment_bounds, stale_work
from mr360uw.sample import SampleDive
from mr360uw.scene import Scene
from mr360uw.scene.model import load_scene
from mr360uw.video.writer import decoding_stamps

Run = Callable[..., tuple[int, str, str]]
TWO_FRAMES = "output.segment_s=0.08"
"""Segments of two frames at the 24 frames a second of the sample dive: eight frames make four."""


class _StopError(Exception):
    """Stands for whatever ends a run."""


def scene_of(dive: SampleDive, *more: str) -> Scene:
    return load_scene(dive.scene, [TWO_FRAMES, *more])


def stopped(scene: Scene, out: Path, after: int, **options: object) -> None:
    """Run until `after` frames are rendered, then end by an exception."""

    def stop(done: int, total: int | None) -> None:
        # the first pass reports frames too, before there is anything to stop
        if done == after and total == 8 and (work_path(out) / "analysis.npz").exists():
            raise _StopError

    with pytest.raises(_StopError):
        uw.composite_video(scene, out, backend="reference", progress=stop, **options)  # type: ignore[arg-type]


@pytest.mark.parametrize("suffix", [".mp4", ".mkv"])
@pytest.mark.parametrize("codec", ["h264", "h265", "ffv1"])
def test_a_stopped_run_goes_on_and_its_output_is_the_same_byte_for_byte(
    dive: SampleDive, tmp_path: Path, codec: str, suffix: str
) -> None:
    if codec == "ffv1" and suffix == ".mp4":
        pytest.skip("mp4 does not hold ffv1")
    # the order in which x265's own threads finish changes its choices
    scene = scene_of(dive, f"output.codec={codec}")
    whole, part = tmp_path / f"whole{suffix}", tmp_path / f"part{suffix}"
    uw.composite_video(scene, whole, backend="reference")
    stopped(scene, part, 6)
    assert not part.exists()
    assert work_path(part).is_dir()
    report = uw.composite_video(scene, part, backend="reference")
    assert report.frames == 8
    assert report.kept_frames >= 2
    assert "first pass" not in report.stage_s
    assert not work_path(part).exists()
    assert _packets(whole) == _packets(part)


def _packets(path: Path) -> list[tuple[int, int | None, int | None, bytes]]:
    import av

    with av.open(str(path)) as container:
        return [(p.stream_index, p.pts, p.dts, bytes(p)) for p in container.demux() if p.size]


def test_pictures_that_are_complete_are_not_made_again(dive: SampleDive, tmp_path: Path) -> None:
    out, layers = tmp_path / "out_%02d.png", tmp_path / "layers_%02d.exr"
    stopped(scene_of(dive), out, 5, layers=layers)
    before = {path.name: path.stat().st_mtime_ns for path in tmp_path.glob("out_*.png")}
    assert before
    report = uw.composite_video(scene_of(dive), out, backend="reference", layers=layers)
    assert report.kept_frames == len(before)
    after = {path.name: path.stat().st_mtime_ns for path in tmp_path.glob("out_*.png")}
    assert len(after) == 8
    assert {name: after[name] for name in before} == before
    assert len(list(tmp_path.glob("layers_*.exr"))) == 8


@pytest.mark.parametrize("name", ["out_%02d.png", "out.mp4"])
def test_a_frame_is_finished_with_its_layers(dive: SampleDive, tmp_path: Path, name: str) -> None:
    """Another pattern, a layer that was removed and one that was cut: none is missing in the end."""
    out, first, second = tmp_path / name, tmp_path / "first_%02d.exr", tmp_path / "second_%02d.exr"
    stopped(scene_of(dive), out, 6, layers=first)
    made = {path: path.read_bytes() for path in tmp_path.glob("first_*.exr")}
    assert len(made) >= 2
    stopped(scene_of(dive), out, 6, layers=second)
    assert len(list(tmp_path.glob("second_*.exr"))) >= 2
    (tmp_path / "first_00.exr").unlink()
    (tmp_path / "first_01.exr").write_bytes(made[tmp_path / "first_01.exr"][:1000])
    report = uw.composite_video(scene_of(dive), out, backend="reference", layers=first)
    assert len(list(tmp_path.glob("first_*.exr"))) == 8
    assert {path: path.read_bytes() for path in made} == made
    assert any("no part of this one" in note and "second_00.exr" in note for note in report.notes)


def test_pictures_that_were_cut_or_removed_are_made_again(dive: SampleDive, tmp_path: Path) -> None:
    out = tmp_path / "out_%02d.png"
    stopped(scene_of(dive), out, 6)
    made = {path: path.read_bytes() for path in sorted(tmp_path.glob("out_*.png"))}
    one, other, third, *kept = made
    one.write_bytes(b"")
    other.write_bytes(made[other][:500])
    third.unlink()
    report = uw.composite_video(scene_of(dive), out, backend="reference")
    assert report.kept_frames == len(kept)
    assert {path: path.read_bytes() for path in made} == made


@pytest.mark.parametrize("name", ["out_01.png", "out_07.png", "layers_00.exr", "layers_07.exr"])
def test_files_of_others_that_appeared_after_a_stop_are_kept(dive: SampleDive, tmp_path: Path, name: str) -> None:
    """Under the name of a frame that was finished and of one to come, of pictures and of layers."""
    out, layers = tmp_path / "out_%02d.png", tmp_path / "layers_%02d.exr"
    stopped(scene_of(dive), out, 4, layers=layers)
    (tmp_path / name).write_text("mine")
    with pytest.raises(OutputExistsError, match=f"{name} - is there already"):
        uw.composite_video(scene_of(dive), out, backend="reference", layers=layers)
    assert (tmp_path / name).read_text() == "mine"
    uw.composite_video(scene_of(dive), out, backend="reference", layers=layers, overwrite=True)
    assert (tmp_path / name).stat().st_size > 100


def test_files_that_appear_or_vanish_during_a_run_are_said(dive: SampleDive, tmp_path: Path) -> None:
    """One of others is not replaced, and a run that lacks one in the end is none that succeeded."""
    out, mine = tmp_path / "out_%02d.png", tmp_path / "out_07.png"

    def appear(done: int, _total: int | None) -> None:
        if done == 1:
            mine.write_text("mine")

    with pytest.raises(OutputExistsError, match="meanwhile"):
        uw.composite_video(scene_of(dive), out, backend="reference", progress=appear)
    assert mine.read_text() == "mine"
    mine.unlink()

    def vanish(done: int, _total: int | None) -> None:
        if done == 8:
            (tmp_path / "out_01.png").unlink(missing_ok=True)

    with pytest.raises(uw.VideoError, match=r"or removed [(]got 7 of 8 whole"):
        uw.composite_video(scene_of(dive), out, backend="reference", progress=vanish)
    assert uw.composite_video(scene_of(dive), out, backend="reference").kept_frames == 7
    assert len(list(tmp_path.glob("out_*.png"))) == 8


def test_pictures_of_a_scene_that_changed_are_replaced(dive: SampleDive, tmp_path: Path) -> None:
    out = tmp_path / "out_%02d.png"
    stopped(scene_of(dive), out, 6)
    before = (tmp_path / "out_00.png").read_bytes()
    changed = scene_of(dive, "object.0.scale=1.5")
    stopped(changed, out, 3)
    report = uw.composite_video(changed, out, backend="reference")
    assert report.kept_frames >= 1
    assert (tmp_path / "out_00.png").read_bytes() != before


def test_layers_that_hold_nothing_are_said_not_to_be_written(dive: SampleDive, tmp_path: Path) -> None:
    bare = scene_of(dive).model_copy(update={"objects": ()})
    report = uw.composite_video(bare, tmp_path / "o.mp4", backend="reference", layers=tmp_path / "l_%02d.exr")
    assert any("is not written, as nothing is drawn" in note for note in report.notes)


def test_a_changed_scene_is_made_again_and_keeps_its_first_pass(dive: SampleDive, tmp_path: Path) -> None:
    out = tmp_path / "out.mp4"
    stopped(scene_of(dive), out, 6)
    changed = scene_of(dive, "object.0.scale=1.5")
    report = uw.composite_video(changed, out, backend="reference")
    assert report.kept_frames == 0
    assert "first pass" not in report.stage_s
    assert any("scene changed" in note for note in report.notes)


def test_a_changed_plate_light_changes_everything(dive: SampleDive, tmp_path: Path) -> None:
    out = tmp_path / "out.mp4"
    stopped(scene_of(dive), out, 6)
    report = uw.composite_video(scene_of(dive, "camera.depth_m=9"), out, backend="reference")
    assert report.kept_frames == 0
    assert "first pass" in report.stage_s


def test_fresh_uses_nothing(dive: SampleDive, tmp_path: Path) -> None:
    out = tmp_path / "out.mp4"
    stopped(scene_of(dive), out, 6)
    report = uw.composite_video(scene_of(dive), out, backend="reference", fresh=True)
    assert report.kept_frames == 0
    assert "first pass" in report.stage_s


def test_damaged_parts_are_made_again(dive: SampleDive, tmp_path: Path) -> None:
    """Cut, zeroed, with one bit turned, two segments in each other's place, another's packets: none is joined."""
    whole = tmp_path / "whole.mp4"
    scene = scene_of(dive)
    uw.composite_video(scene, whole, backend="reference")
    first, second = ("00000000-00000002", "00000002-00000004")

    def cut(work: Path, name: str) -> None:
        content = (work / name).read_bytes()
        (work / name).write_bytes(content[: len(content) // 2])

    def turned(work: Path) -> None:
        content = bytearray((work / f"{first}.packets").read_bytes())
        content[len(content) // 2] ^= 1
        (work / f"{first}.packets").write_bytes(content)

    def zeroed(work: Path) -> None:
        (work / f"{first}.packets").write_bytes(bytes((work / f"{first}.packets").stat().st_size))

    def swapped(work: Path) -> None:
        for suffix in (".packets", ".npz"):
            one, other = work / (first + suffix), work / (second + suffix)
            held = one.read_bytes()
            one.write_bytes(other.read_bytes())
            other.write_bytes(held)

    def replaced(work: Path) -> None:
        (work / f"{first}.packets").write_bytes((work / f"{second}.packets").read_bytes())

    damages: list[tuple[Callable[[Path], None], int]] = [
        (lambda work: cut(work, f"{first}.npz"), 1), (lambda work: cut(work, f"{first}.packets"), 1), (zeroed, 1),
        (turned, 1), (swapped, 2), (replaced, 1), (lambda work: cut(work, "analysis.npz"), 0),
    ]  # fmt: skip
    out, intact = tmp_path / "out.mp4", tmp_path / "intact"
    stopped(scene, out, 6)
    kept = len(list(work_path(out).glob("*.packets")))
    shutil.copytree(work_path(out), intact)
    for damage, lost in damages:
        damage(work_path(out))
        report = uw.composite_video(scene, out, backend="reference")
        assert report.kept_frames == 2 * (kept - lost)
        assert ("first pass" in report.stage_s) == (lost == 0)
        assert _packets(out) == _packets(whole)
        assert not work_path(out).exists()
        out.unlink()
        shutil.copytree(intact, work_path(out))


def test_parts_that_are_damaged_during_the_run_do_not_reach_the_output(dive: SampleDive, tmp_path: Path) -> None:
    out, damaged = tmp_path / "out.mp4", tmp_path / "out.mp4.mr360uw" / "00000000-00000002.packets"

    def damage(done: int, _total: int | None) -> None:
        if damaged.exists() and damaged.read_bytes()[:4] != bytes(4) and done > 4:
            damaged.write_bytes(bytes(damaged.stat().st_size))

    with pytest.raises(uw.VideoError, match="damaged before they could be joined"):
        uw.composite_video(scene_of(dive), out, backend="reference", progress=damage)
    assert not out.exists()
    assert uw.composite_video(scene_of(dive), out, backend="reference").kept_frames == 6


def test_after_an_edit_of_the_sources_all_is_made_again(
    dive: SampleDive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out.mp4"
    stopped(scene_of(dive), out, 6)
    monkeypatch.setattr(work_folder, "sources_stamp", lambda: "edited")
    report = uw.composite_video(scene_of(dive), out, backend="reference")
    assert report.kept_frames == 0
    assert "first pass" in report.stage_s


def test_an_output_that_appears_meanwhile_is_not_replaced(dive: SampleDive, tmp_path: Path) -> None:
    out = tmp_path / "out.mp4"

    def foreign(done: int, total: int | None) -> None:
        if done == total:
            out.write_text("mine")

    with pytest.raises(OutputExistsError, match="meanwhile"):
        uw.composite_video(scene_of(dive), out, backend="reference", progress=foreign)
    assert out.read_text() == "mine"
    report = uw.composite_video(scene_of(dive), out, backend="reference", overwrite=True)
    assert report.kept_frames == 8


def test_a_second_run_to_the_same_output_is_refused(dive: SampleDive, tmp_path: Path) -> None:
    out = tmp_path / "out.mp4"
    refused: list[str] = []

    def again(done: int, total: int | None) -> None:
        if done == 4 and total == 8 and not refused and (work_path(out) / "analysis.npz").exists():
            with pytest.raises(OutputExistsError, match="another run") as error:
                uw.composite_video(scene_of(dive), out, backend="reference")
            refused.append(str(error.value))

    report = uw.composite_video(scene_of(dive), out, backend="reference", progress=again)
    assert refused
    assert report.frames == 8


def test_files_with_names_like_temporary_ones_are_left_alone(dive: SampleDive, tmp_path: Path) -> None:
    out = tmp_path / "out.mp4"
    victim = tmp_path / "victim.txt"
    victim.write_text("precious")
    (tmp_path / "out.mp4.part").symlink_to(victim)
    uw.composite_video(scene_of(dive), out, backend="reference", frames=(0, 1))
    assert victim.read_text() == "precious"
    assert (tmp_path / "out.mp4.part").is_symlink()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["out.mp4", "out.mp4.part", "victim.txt"]


def test_several_frames_into_one_still_are_refused_before_rendering(dive: SampleDive, tmp_path: Path) -> None:
    with pytest.raises(uw.VideoError, match="one picture cannot hold several frames"):
        uw.composite_video(scene_of(dive), tmp_path / "out.png", backend="reference")
    assert list(tmp_path.iterdir()) == []


_KILLED = """
import os, pathlib, signal, sys, time
import mr360uw as uw
from mr360uw.scene.model import load_scene

scene, setting, out, work = sys.argv[1:]

class Killing:
    def phase(self, name):
        self.name = name

    def __call__(self, done, total):
        if self.name == "rendering" and done == 6:
            while len(list(pathlib.Path(work).glob("0*.npz"))) < 2:  # written by another thread
                time.sleep(0.01)
            os.kill(os.getpid(), signal.SIGKILL)

uw.composite_video(load_scene(scene, [setting]), out, backend="reference", progress=Killing())
"""
"""Renders six frames, waits for two segments, and kills itself."""


@pytest.mark.skipif(sys.platform == "win32", reason="kills a process")
def test_a_killed_run_loses_at_most_one_segment(dive: SampleDive, tmp_path: Path, run: Run) -> None:
    out, whole = tmp_path / "out.mp4", tmp_path / "whole.mp4"
    options = ("--backend", "reference", "--set", TWO_FRAMES)
    killed = [sys.executable, "-c", _KILLED, str(dive.scene), TWO_FRAMES, str(out), str(work_path(out))]
    assert subprocess.run(killed, capture_output=True, check=False).returncode == -signal.SIGKILL
    assert stale_work(tmp_path) == [work_path(out)]
    code, said, _ = run("composite", dive.scene, out, *options)
    assert code == 0
    assert "of them were there already" in said
    assert run("composite", dive.scene, whole, *options)[0] == 0
    assert _packets(out) == _packets(whole)


def test_clean_removes_what_stopped_runs_left(dive: SampleDive, tmp_path: Path, run: Run) -> None:
    stopped(scene_of(dive), tmp_path / "out.mp4", 6)
    code, listed, _ = run("clean", tmp_path, "--dry-run")
    assert code == 0
    assert "found" in listed
    assert work_path(tmp_path / "out.mp4").is_dir()
    assert run("clean", tmp_path)[0] == 0
    assert list(tmp_path.iterdir()) == []


def test_bounds_are_cut_at_the_same_places_whatever_the_range() -> None:
    assert segment_bounds(3, 11, 4) == [(3, 4), (4, 8), (8, 11)]
    assert segment_bounds(4, 8, 4) == [(4, 8)]
    assert segment_bounds(0, 3, 4) == [(0, 3)]
    assert joined_bounds([(0, 2), (2, 4), (6, 8)]) == [(0, 4), (6, 8)]


@pytest.mark.parametrize("order", [[0, 1, 2, 3], [0, 3, 1, 2, 5, 4], [0, 4, 2, 1, 3, 8, 6, 5, 7]])
def test_decoding_stamps_rise_and_never_come_after_presentation(order: list[int]) -> None:
    pts = 1001 * np.array(order) + 77
    dts = decoding_stamps(pts)
    assert np.all(np.diff(dts) > 0)
    assert np.all(dts <= pts)
    assert np.any(dts == pts)
