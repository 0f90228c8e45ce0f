# SPDX-License-Identifier: Apache-2.0
"""Which files are the distance maps of a plate, in which order, and what is said where they do not fit it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import mr360uw as uw
from mr360uw.depth.depth_files import DepthClip
from mr360uw.depth.sphere_stereo import DepthMap
from mr360uw.errors import SceneError, VideoError
from mr360uw.render.check import check_scene
from mr360uw.render.loaded import load
from mr360uw.scene.model import Scene
from mr360uw.video.exr import write_exr
from tests.depth.own_maps import write_own_maps
from tests.scenes import scene_with
from tests.video.clips import exr_windows

WIDTH, HEIGHT, FRAMES = 64, 32, 3


def write_map(path: Path, metres: float = 5.0, size: tuple[int, int] = (WIDTH, HEIGHT), **options: Any) -> None:
    write_exr(path, {"": {"Z": np.full(size[::-1], metres, np.float32)}}, **options)


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-9])


def colours(size: tuple[int, int] = (WIDTH, HEIGHT)) -> np.ndarray:
    return np.random.default_rng(3).uniform(0.0, 255.0, (size[1], size[0], 3)).astype(np.uint8)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder of maps, one for each frame of the plate beside it."""
    made = tmp_path / "maps"
    made.mkdir()
    for k in range(FRAMES):
        write_map(made / f"d_{k:04d}.exr", 3.0 + k)
        cv2.imwrite(str(tmp_path / f"plate_{k:04d}.png"), np.full((HEIGHT, WIDTH, 3), 90, np.uint8))
    return made


def scene_of(folder: Path, whale: Path, depth: Path | None = None, **more: Any) -> Scene:
    plate = {"path": str(folder.parent / "plate_%04d.png"), "depth": str(depth or folder)} | more
    return scene_with(folder.parent, whale, plate=plate, water={"type": "none"})


def said_by_check(scene: Scene) -> list[str]:
    with pytest.raises(SceneError) as caught:
        check_scene(scene, backend="reference")
    return list(caught.value.problems)


def test_maps_that_fit_are_taken(folder: Path, whale: Path) -> None:
    assert "plate.depth" not in check_scene(scene_of(folder, whale), backend="reference")
    assert [DepthClip(folder).at(k).distance_m[0, 0] for k in range(FRAMES)] == [3.0, 4.0, 5.0]
    pattern = scene_of(folder, whale, folder / "d_####.exr")
    report = uw.composite_video(pattern, folder.parent / "out_%02d.png", backend="reference")
    assert report.frames == FRAMES


_WRONG: dict[str, tuple[Callable[[Path], object], str]] = {
    "portrait": (lambda f: [write_map(f / f"d_{k:04d}.exr", size=(32, 64)) for k in range(3)], "no panorama.*32x64"),
    "wide": (lambda f: [write_map(f / f"d_{k:04d}.exr", size=(500, 100)) for k in range(3)], "no panorama.*500x100"),
    "mixed": (lambda f: write_map(f / "d_0001.exr", size=(128, 64)), "several sizes.*128x64"),
    "coloured": (lambda f: write_exr(f / "d_0002.exr", colours().astype(np.float32)), "three different channels"),
    "shifted": (
        lambda f: write_map(f / "d_0001.exr", attributes=exr_windows((8, 0), (WIDTH, HEIGHT), frame=(WIDTH, HEIGHT))),
        "data window is not the display",
    ),
    "more": (lambda f: write_map(f / "d_0003.exr"), "more maps than the plate has frames .got 4 for 3"),
    "fewer": (lambda f: (f / "d_0002.exr").unlink(), "no map for frame 2"),
    "gap": (lambda f: (f / "d_0002.exr").rename(f / "d_0003.exr"), "lacks map 2 .got d_0001.exr before d_0003.exr"),
    "twice": (lambda f: (f / "d_0002.exr").rename(f / "d_1.exr"), "number of another map"),
    "series": (lambda f: write_map(f / "e_0000.exr"), "several series of pictures .got 3 of d_%d.exr, 1 of e_%d.exr"),
    "cut": (lambda f: cut(f / "d_0001.exr"), "d_0001.exr - is cut short"),
    "empty": (lambda f: (f / "d_0001.exr").write_bytes(b""), "d_0001.exr - is not an EXR file"),
}  # fmt: skip


@pytest.mark.parametrize("kind", _WRONG)
def test_maps_that_do_not_fit_are_refused_by_check_and_before_a_run(folder: Path, whale: Path, kind: str) -> None:
    spoil, words = _WRONG[kind]
    spoil(folder)
    scene = scene_of(folder, whale)
    assert len(said := said_by_check(scene)) == 1
    with pytest.raises(VideoError, match=words) as caught:
        uw.composite_video(scene, folder.parent / "out.mp4", backend="reference")
    assert str(caught.value) == said[0]
    assert not list(folder.parent.glob("out.mp4*"))


def test_all_problems_are_said_at_once(folder: Path, whale: Path) -> None:
    write_map(folder / "d_0000.exr", size=(32, 64))
    cut(folder / "d_0001.exr")
    write_exr(folder / "d_0002.exr", colours().astype(np.float32))
    write_map(folder / "d_0005.exr")
    said = said_by_check(scene_of(folder, whale))
    words = ("lacks map 3", "cut short", "no panorama", "several sizes", "more maps than", "three different")
    assert len(said) == len(words)
    for word, line in zip(words, said, strict=True):
        assert word in line
    with pytest.raises(VideoError) as caught:
        uw.composite_video(scene_of(folder, whale), folder.parent / "out.mp4", backend="reference")
    assert str(caught.value).splitlines() == said


def test_png_maps_are_grey_and_whole(tmp_path: Path) -> None:
    grey = np.full((HEIGHT, WIDTH), 30000, np.uint16)
    cv2.imwrite(str(tmp_path / "0.png"), grey)
    cv2.imwrite(str(tmp_path / "1.png"), cv2.merge([grey] * 3))
    DepthClip(tmp_path, scale_m=10.0).check_all(2, 2)
    cv2.imwrite(str(tmp_path / "2.png"), colours())
    with pytest.raises(VideoError, match=r"2.png - is a picture in colours"):
        DepthClip(tmp_path).check_all(3, 3)
    (tmp_path / "2.png").write_bytes((tmp_path / "1.png").read_bytes()[:-20])
    with pytest.raises(VideoError, match=r"2.png - is no PNG that can be read, or it is cut short"):
        DepthClip(tmp_path).check(3)


def test_maps_are_in_the_order_of_their_numbers_and_odd_files_are_none(tmp_path: Path) -> None:
    """Without leading zeros; a hidden file of a file manager is not looked at, another picture is said."""
    for number in (1, 10, *range(2, 10)):
        write_map(tmp_path / f"d_{number}.exr", float(number))
    (tmp_path / "._d_1.exr").write_bytes(b"hidden")
    (tmp_path / ".d_3.1234.part.exr").touch()
    cv2.imwrite(str(tmp_path / "contact_sheet.png"), colours((100, 100)))
    clip = DepthClip(tmp_path)
    clip.check_all(10, 10)
    assert [clip.at(k).distance_m[0, 0] for k in range(10)] == list(range(1, 11))
    assert [note for note in clip.notes if "contact_sheet.png - has no number" in note] == list(clip.notes)


def test_maps_that_begin_late_are_said(tmp_path: Path) -> None:
    for number in (7, 8):
        write_map(tmp_path / f"d_{number}.exr")
    assert "d_7.exr is taken as the map of the plate's frame 0" in DepthClip(tmp_path).notes[0]


@pytest.mark.parametrize("content", ["", "{}", '{"method": "distances 3"}\n', "[1]"])
def test_a_note_of_others_does_not_make_maps_ours(tmp_path: Path, content: str) -> None:
    """Kind and scale count, by whatever names the maps have."""
    write_map(tmp_path / "depth_00000.exr", 0.25)
    (tmp_path / "depth.json").write_text(content)
    clip = DepthClip(tmp_path, "inverse", 2.0)
    assert clip.at(0).distance_m[0, 0] == 8.0
    assert "depth.json - is not of mr360uw depth" in clip.notes[0]


def test_own_maps_are_checked_and_settings_without_effect_are_said(folder: Path, whale: Path, tmp_path: Path) -> None:
    own = tmp_path / "own"
    found = DepthMap(np.full((HEIGHT, WIDTH), 4.0, np.float32), np.ones((HEIGHT, WIDTH), np.float32))
    write_own_maps(own, dict.fromkeys(range(FRAMES), (found,)))
    write_map(own / "z_0000.exr", size=(32, 64))  # of others, which is not looked at
    scene = scene_of(folder, whale, own, depth_scale=3.0)
    assert any("plate.depth_kind, plate.depth_scale - change nothing" in n for n in load(scene, WIDTH, HEIGHT).notes)
    assert DepthClip(own, scale_m=3.0).at(0).distance_m[0, 0] == 4.0
    write_map(own / "depth_00001.exr")
    assert ["depth_00001.exr - is not as mr360uw depth wrote it" in line for line in said_by_check(scene)] == [True]
    (own / "depth_00002.exr").unlink()
    assert len(said_by_check(scene)) == 1 + len(["missing"])
    with pytest.raises(VideoError, match="not as mr360uw depth wrote it"):
        DepthClip(own).at(1)
