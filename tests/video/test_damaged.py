# SPDX-License-Identifier: Apache-2.0
"""Clips that end early or hold damaged data: what is usable is used, and what is not is told."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mr360uw.errors import DamagedFrameError, VideoError
from mr360uw.video import VideoFrame, VideoReader, open_video
from mr360uw.video.reader import Damaged
from tests.video.clips import decoded, write_clip

FRAMES = 36
CUTS = 20
CLOSED = {"g": "12", "bf": "2", "crf": "10"}
"""Groups of twelve pictures, each decodable on its own, with pictures out of order; large beside their index."""


def clip(folder: Path, name: str, **options: object) -> Path:
    return write_clip(folder / name, FRAMES, size=(64, 32), options=CLOSED, **options)


def cuts(whole: Path, folder: Path) -> list[Path]:
    """The file, cut at places spread over all of it."""
    data, paths = whole.read_bytes(), []
    for k in range(CUTS):
        paths.append(folder / f"cut_{k}{whole.suffix}")
        paths[-1].write_bytes(data[: len(data) * (k + 1) // (CUTS + 1)])
    return paths


def opened(path: Path, damaged: Damaged = "stop") -> VideoReader | None:
    """The clip, or None where it is refused: it is cut before its index, its header or its first picture ends."""
    try:
        return open_video(path, damaged=damaged)
    except VideoError as error:
        refused = str(error)
    assert any(why in refused for why in ("is cut short", "pictures cannot be decoded", "FFmpeg can read"))
    return None


def same(frame: VideoFrame, expected: tuple[int, list[np.ndarray]]) -> bool:
    assert frame.yuv is not None
    return frame.pts == expected[0] and np.array_equal(frame.yuv.y, expected[1][0])


def test_a_clip_with_its_index_in_front_is_used_up_to_where_it_was_cut(tmp_path: Path) -> None:
    whole = clip(tmp_path, "a.mp4", container_options={"movflags": "faststart"})
    expected, counts = decoded(whole), []
    for path in cuts(whole, tmp_path):
        video = opened(path)
        if video is None:
            continue
        intact = video.intact_frames
        assert intact is not None
        assert all(map(same, video.frames(0, intact), expected))
        with pytest.raises(VideoError, match=rf"cut short .* or take frames 0:{intact}$"):
            video.frames()
        held = list(open_video(path, damaged="hold").frames())
        assert [frame.damage for frame in held] == ["none"] * intact + ["held"] * (FRAMES - intact)
        assert [frame.pts for frame in held] == [pts for pts, _ in expected]
        assert same(held[intact - 1], expected[intact - 1])
        assert held[intact - 1].yuv is not None
        np.testing.assert_array_equal(held[-1].pixels.y, held[intact - 1].yuv.y)
        counts.append(intact)
    assert counts == sorted(counts)
    assert len(counts) > CUTS // 2
    assert counts[-1] >= FRAMES - 6  # a twentieth of the bytes, and two pictures out of order


def test_a_clip_with_its_index_at_the_end_says_that_it_is_cut(tmp_path: Path) -> None:
    for path in cuts(clip(tmp_path, "a.mp4"), tmp_path):
        with pytest.raises(VideoError, match=r"the file is cut short .* - copy it again"):
            open_video(path)


@pytest.mark.parametrize(("name", "options"), [("a.mkv", {}), ("a.mp4", {"movflags": "frag_keyframe+empty_moov"})])
def test_a_clip_without_an_index_is_used_up_to_where_it_was_cut(
    tmp_path: Path, name: str, options: dict[str, str]
) -> None:
    whole = clip(tmp_path, name, container_options=options)
    expected = {pts: planes[0] for pts, planes in decoded(whole)}
    counts = []
    for path in cuts(whole, tmp_path):
        video = opened(path, "hold")
        if video is None:
            continue
        frames = list(video.frames())
        assert len(frames) == video.frame_count
        assert bool(video.doubts) == (whole.suffix == ".mkv" and frames[-1].index < FRAMES - 24)  # by a second
        good = [frame for frame in frames if frame.damage == "none"]
        assert all(np.array_equal(frame.pixels.y, expected[frame.pts]) for frame in good)
        assert len(good) >= len(frames) - 1
        counts.append(len(good))
    assert len(counts) > CUTS // 2
    assert counts[-1] >= FRAMES // 2


@pytest.fixture(scope="module")
def hurt(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[tuple[int, list[np.ndarray]]], range]:
    """A clip whose second group of pictures cannot be decoded, what it was, and the frames of that group."""
    folder = tmp_path_factory.mktemp("hurt")
    whole = clip(folder, "whole.mp4")
    with open_video(whole) as video:
        ends = video.index.end_byte
    data = bytearray(whole.read_bytes())
    data[ends[11] : ends[23]] = bytes(int(ends[23] - ends[11]))
    (folder / "hurt.mp4").write_bytes(data)
    return folder / "hurt.mp4", decoded(whole), range(12, 24)


def test_the_first_lost_frame_ends_a_clip_that_stops(hurt: tuple[Path, list[tuple[int, list]], range]) -> None:
    path, expected, lost = hurt
    video = open_video(path)
    frames = video.frames()
    assert all(same(next(frames), expected[k]) for k in range(lost.start))
    with pytest.raises(DamagedFrameError, match=f"after frame 11 of {FRAMES} .*take frames 0:12") as caught:
        next(frames)
    assert caught.value.index == lost.start
    # the frames behind the damage keep their numbers
    assert all(map(same, video.frames(lost.stop), expected[lost.stop :]))


def test_lost_frames_are_held_wherever_a_range_begins(hurt: tuple[Path, list[tuple[int, list]], range]) -> None:
    path, expected, lost = hurt
    video = open_video(path, damaged="hold")
    frames = list(video.frames())
    assert [frame.pts for frame in frames] == [pts for pts, _ in expected]
    assert [frame.index for frame in frames if frame.damage == "held"] == list(lost)
    for frame, (_, planes) in zip(frames, expected, strict=True):
        shown = expected[lost.start - 1][1] if frame.index in lost else planes
        np.testing.assert_array_equal(frame.pixels.y, shown[0])
    for start in (5, 12, 18, 24, 30):
        alone = next(iter(video.frames(start, start + 1)))
        assert (alone.pts, alone.damage) == (frames[start].pts, frames[start].damage)
        np.testing.assert_array_equal(alone.pixels.y, frames[start].pixels.y)


def test_pictures_that_the_decoder_guesses_in_part_are_marked(tmp_path: Path) -> None:
    whole = clip(tmp_path, "a.mp4")
    data = bytearray(whole.read_bytes())
    with open_video(whole) as video:
        start, end = map(int, video.index.end_byte[11:13])
    middle = (start + end) // 2
    data[middle : middle + 40] = bytes(range(100, 140))
    whole.write_bytes(data)
    damage = [frame.damage for frame in open_video(whole).frames()]
    assert "concealed" in damage
    assert "held" not in damage
