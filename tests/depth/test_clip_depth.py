# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import os
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

import mr360uw as uw
from mr360uw.cli import app
from mr360uw.depth import clip_depth
from mr360uw.errors import OutputExistsError, ParameterError
from mr360uw.video.exr import read_exr
from tests.depth import tolerances
from tests.depth.hazy_scene import HazyScene, relative_error

WIDTH, FRAMES, RATE = 128, 8, 30.0
SLOW = 12.0
"""The scene's time runs this much faster than that of the clip, so that few frames make a baseline."""


@pytest.fixture(scope="module")
def scene() -> HazyScene:
    return HazyScene(seed=21, caustics=1.0)


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory, scene: HazyScene) -> Path:
    folder = tmp_path_factory.mktemp("clip")
    for k in range(FRAMES):
        grey = scene.grey(WIDTH, SLOW * k / RATE).astype(np.uint8)
        cv2.imwrite(str(folder / f"plate_{k:04d}.png"), cv2.merge([grey] * 3))
    write_track(folder / "track.csv", [scene.pose(SLOW * k / RATE) for k in range(FRAMES)])
    return folder / "plate_%04d.png"


def write_track(path: Path, poses: list[tuple[np.ndarray, np.ndarray]], rate: float = RATE) -> None:
    rows = ["time_s,x,y,z,qx,qy,qz,qw"]
    for k, (position, rotation) in enumerate(poses):
        rows.append(",".join(map(str, (k / rate, *position, *Rotation.from_matrix(rotation).as_quat()))))
    path.write_text("\n".join(rows) + "\n", "utf-8")


def test_a_clip_gets_a_map_for_each_frame_and_a_stopped_run_goes_on(
    tmp_path: Path, clip: Path, scene: HazyScene, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(clip_depth, "LEAST_WIDTH", WIDTH)
    track, out = clip.parent / "track.csv", tmp_path / "depth"
    steps: list[tuple[int, int | None]] = []
    report = uw.depth_of_clip(clip, out, track=track, width=WIDTH, progress=lambda *step: steps.append(step))
    files = sorted(out.glob("depth_*.exr"))
    assert (report.written, report.kept, len(files), steps[-1]) == (FRAMES, 0, FRAMES, (FRAMES, FRAMES))
    assert {one.name for one in out.iterdir()} == {"depth.json", *(one.name for one in files)}
    channels = next(iter(read_exr(files[5]).values()))
    sure = channels["confidence"] >= 0.5
    truth = scene.see(WIDTH, SLOW * 5 / RATE)[1]
    assert np.median(relative_error(channels["Z"], truth)[sure & np.isfinite(truth)]) < tolerances.TINY

    before = {one: one.read_bytes() for one in files}
    files[3].unlink()
    files[6].unlink()
    again = uw.depth_of_clip(clip, out, track=track, width=WIDTH)
    assert (again.written, again.kept) == (2, FRAMES - 2)
    assert {one: one.read_bytes() for one in files} == before

    (tmp_path / "theirs").mkdir()
    (tmp_path / "theirs" / files[0].name).write_bytes(b"another program's")
    with pytest.raises(OutputExistsError, match="did not make"):
        uw.depth_of_clip(clip, tmp_path / "theirs", track=track, width=WIDTH, overwrite=True)
    assert (tmp_path / "theirs" / files[0].name).read_bytes() == b"another program's"
    other = tmp_path / "other.csv"
    write_track(other, [(2.0 * place, turn) for place, turn in map(scene.pose, np.arange(FRAMES) * SLOW / RATE)])
    with pytest.raises(OutputExistsError, match="maps of another clip, track or width"):
        uw.depth_of_clip(clip, out, track=other, width=WIDTH)
    assert {one: one.read_bytes() for one in files} == before


def test_the_command_says_what_it_wrote(tmp_path: Path, clip: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clip_depth, "LEAST_WIDTH", WIDTH)
    short = tmp_path / "plate_%04d.png"
    for k in range(3):
        (tmp_path / f"plate_{k:04d}.png").write_bytes((clip.parent / f"plate_{k:04d}.png").read_bytes())
    options = ["--track", str(clip.parent / "track.csv"), "--width", str(WIDTH)]
    done = CliRunner().invoke(app, ["depth", str(short), "-o", str(tmp_path / "maps"), *options])
    assert done.exit_code == 0, done.output
    assert "3 maps written, 0 kept" in done.output
    assert len(list((tmp_path / "maps").glob("depth_*.exr"))) == 3


def test_cameras_that_show_no_distances_are_answered_in_words(tmp_path: Path, clip: Path) -> None:
    turning = [(np.zeros(3), Rotation.from_euler("y", 3.0 * k, degrees=True).as_matrix()) for k in range(FRAMES)]
    for name, poses, words in (
        ("still", [(np.zeros(3), np.eye(3))] * FRAMES, "stands still"),
        ("turning", turning, "turns on the spot"),
    ):
        write_track(tmp_path / f"{name}.csv", poses)
        with pytest.raises(ParameterError, match=words):
            uw.depth_of_clip(clip, tmp_path / "depth", track=tmp_path / f"{name}.csv")
    with pytest.raises(ParameterError, match="multiple of 8"):
        uw.depth_of_clip(clip, tmp_path / "depth", track=clip.parent / "track.csv", width=100)
    with pytest.raises(ParameterError, match="one picture"):
        uw.depth_of_clip(clip.parent / "plate_0000.png", tmp_path / "depth", track=clip.parent / "track.csv")
    assert not (tmp_path / "depth").exists()


def test_shots_of_a_cut_clip_have_tracks_of_their_own(
    tmp_path: Path, clip: Path, scene: HazyScene, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(clip_depth, "LEAST_WIDTH", WIDTH)
    half = FRAMES // 2
    poses = [scene.pose(SLOW * k / RATE) for k in range(FRAMES)]
    write_track(tmp_path / "track.shot1.csv", poses[:half])
    report = uw.depth_of_clip(clip, tmp_path / "depth", track=tmp_path / "track.csv", width=WIDTH)
    assert report.without == FRAMES - half
    assert "without a pose" in str(report)
    last = next(iter(read_exr(tmp_path / "depth" / f"depth_{FRAMES - 1:05d}.exr").values()))
    assert not np.any(last["confidence"])


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clip_depth, "LEAST_WIDTH", WIDTH)


def contents(folder: Path) -> dict[str, bytes]:
    return {one.name: one.read_bytes() for one in folder.iterdir()}


@pytest.mark.usefixtures("small")
@pytest.mark.parametrize("content", ["{}", "", '{"method": "distances 3"}\n', '["depth"]', "\0"])
def test_a_note_of_others_is_not_replaced(tmp_path: Path, clip: Path, content: str) -> None:
    (tmp_path / "depth.json").write_text(content)
    for overwrite in (False, True):
        with pytest.raises(OutputExistsError, match=r"did not make.*got depth.json"):
            uw.depth_of_clip(clip, tmp_path, track=clip.parent / "track.csv", width=WIDTH, overwrite=overwrite)
    assert contents(tmp_path) == {"depth.json": content.encode()}


@pytest.mark.usefixtures("small")
def test_a_run_knows_its_own_maps_by_their_content(tmp_path: Path, clip: Path, scene: HazyScene) -> None:
    """Cut maps are made again, and those of others are neither kept as finished, nor replaced, nor removed."""
    track, out = clip.parent / "track.csv", tmp_path / "depth"
    uw.depth_of_clip(clip, out, track=track, width=WIDTH)
    before = contents(out)
    names = sorted(name for name in before if name.endswith(".exr"))
    (out / names[1]).write_bytes(b"")
    (out / names[2]).write_bytes(before[names[2]][:2000])
    again = uw.depth_of_clip(clip, out, track=track, width=WIDTH)
    assert (again.written, again.kept) == (2, FRAMES - 2)
    assert {name: contents(out)[name] for name in names} == {name: before[name] for name in names}

    mine = before[names[4]][:-1] + b"mine"
    (out / names[3]).write_bytes(mine)
    for overwrite in (False, True):
        with pytest.raises(OutputExistsError, match=f"changed since .got {names[3]}"):
            uw.depth_of_clip(clip, out, track=track, width=WIDTH, overwrite=overwrite)
    assert (out / names[3]).read_bytes() == mine
    (out / names[3]).write_bytes(before[names[3]])

    for name in ("depth_99999.exr", "depth_mine.exr", "notes.txt"):
        (out / name).write_text("mine")
    other = tmp_path / "other.csv"
    write_track(other, [(2.0 * place, turn) for place, turn in map(scene.pose, np.arange(FRAMES) * SLOW / RATE)])
    with pytest.raises(OutputExistsError, match="got another track"):
        uw.depth_of_clip(clip, out, track=other, width=WIDTH)
    assert uw.depth_of_clip(clip, out, track=other, width=WIDTH, overwrite=True).written == FRAMES
    after = contents(out)
    assert set(after) == {*before, "depth_99999.exr", "depth_mine.exr", "notes.txt"}
    assert {after[name] for name in set(after) - set(before)} == {b"mine"}
    assert all(after[name] != before[name] for name in names)


@pytest.mark.usefixtures("small")
def test_a_clip_is_known_by_its_content(tmp_path: Path, clip: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Touched, named by a relative path or a link, or moved, it is the same clip; with one other byte it is not."""
    for k in range(3):
        (tmp_path / f"p_{k:04d}.png").write_bytes((clip.parent / f"plate_{k:04d}.png").read_bytes())
    track, out = clip.parent / "track.csv", tmp_path / "maps"
    assert uw.depth_of_clip(tmp_path / "p_%04d.png", out, track=track, width=WIDTH).written == 3
    os.utime(tmp_path / "p_0001.png", (1.0, 1.0))
    (tmp_path / "link").symlink_to(tmp_path, target_is_directory=True)
    monkeypatch.chdir(tmp_path)
    for name in (tmp_path / "p_%04d.png", "p_%04d.png", "p_####.png", "./link/p_%04d.png"):
        assert uw.depth_of_clip(name, out, track=track, width=WIDTH).kept == 3
    (tmp_path / "p_0001.png").write_bytes((tmp_path / "p_0000.png").read_bytes())
    with pytest.raises(OutputExistsError, match="got another clip"):
        uw.depth_of_clip("p_%04d.png", out, track=track, width=WIDTH)


@pytest.mark.usefixtures("small")
def test_two_runs_into_one_folder_are_refused(tmp_path: Path, clip: Path) -> None:
    refused: list[str] = []

    def again(done: int, _total: int | None) -> None:
        if done == 1 and not refused:
            with pytest.raises(OutputExistsError, match="another run is writing it") as error:
                uw.depth_of_clip(clip, tmp_path / "maps", track=clip.parent / "track.csv", width=WIDTH)
            refused.append(str(error.value))

    uw.depth_of_clip(clip, tmp_path / "maps", track=clip.parent / "track.csv", width=WIDTH, progress=again)
    assert refused
