# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import cv2
import numpy as np
import pytest

from mr360uw.errors import VideoError
from mr360uw.video import open_video
from tests.video.other_projections import dual_fisheye, eac_row, equirectangular, world, write_tracks

SIZE, FRAMES, FOV_DEG = 96, 2, 195.0
LEAST_DB = 40.0
"""Of codes rounded to 8 bits twice (53 dB) and sampled between 96 pixels across 90 to 195 degrees; a face that is
turned, mirrored or shifted by two pixels is below 30."""


def psnr(found: np.ndarray, true: np.ndarray) -> float:
    return float(10.0 * np.log10(255.0**2 / np.mean(np.square(found - true))))


def clip(folder, kind: str):
    """A clip in a projection by its name, the options to open it with, and its panorama's height."""
    frames = range(FRAMES)
    pair = [dual_fisheye(SIZE, FOV_DEG, k) for k in frames]
    halves = [[[np.split(plane, 2, axis=1)[lens] for plane in frame] for frame in pair] for lens in (0, 1)]
    rows = [[eac_row(SIZE, row, overlap, k) for k in frames] for row in (0, 1) for overlap in (0, 8)]
    both = zip(rows[0], rows[2], strict=True)
    whole = [[np.concatenate(planes) for planes in zip(*pairs, strict=True)] for pairs in both]
    fov = {"fisheye_fov_deg": FOV_DEG}
    if kind == "dual fisheye":
        return write_tracks(folder / "a.mp4", [pair]), fov | {"projection": "dual_fisheye"}, SIZE
    if kind == "two tracks of Insta360":
        return write_tracks(folder / "a.insv", halves), fov, SIZE
    if kind == "two files of Insta360":
        write_tracks(folder / "VID_10_001.insv", halves[1:])
        return write_tracks(folder / "VID_00_001.insv", halves[:1]), fov, SIZE
    if kind == "EAC in one frame":
        return write_tracks(folder / "a.mp4", [whole]), {"projection": "eac"}, 2 * SIZE
    return write_tracks(folder / "a.360", [rows[1], rows[3]]), {}, 2 * SIZE


KINDS = ("dual fisheye", "two tracks of Insta360", "two files of Insta360", "EAC in one frame", "tracks of GoPro")


@pytest.mark.parametrize("kind", KINDS)
def test_other_projections_are_read_as_panoramas(tmp_path, kind) -> None:
    path, options, height = clip(tmp_path, kind)
    with open_video(path, **options) as video:
        assert (video.width, video.height, video.frame_count) == (2 * height, height, FRAMES)
        assert video.panorama
        frames = list(video.frames())
        last = next(iter(video.frames(FRAMES - 1)))
        with video.seeker() as seek:
            sought = next(iter(seek(1)))
    for index, frame in enumerate(frames):
        assert frame.index == index
        for k, plane in enumerate((frame.yuv.y, frame.yuv.u, frame.yuv.v)):
            true = world(equirectangular(plane.shape[1]), index)[k]
            assert psnr(plane, true) > LEAST_DB
    np.testing.assert_array_equal(last.yuv.y, frames[-1].yuv.y)
    np.testing.assert_array_equal(sought.yuv.u, frames[1].yuv.u)


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("a.360", {}, "EAC is two tracks.*GoPro Player"),
        ("VID_00_001.insv", {}, "side by side.*_10_"),
        ("a.mp4", {"projection": "dual_fisheye", "eye": "left"}, "no left eye"),
    ],
)
def test_parts_of_a_projection_are_refused(tmp_path, name, options, message) -> None:
    path = write_tracks(tmp_path / name, [[[np.full((32 // k, 32 // k), 90.0) for k in (1, 2, 2)]]])
    with pytest.raises(VideoError, match=message):
        open_video(path, **options)


def test_a_picture_in_another_projection_is_refused(tmp_path) -> None:
    path = tmp_path / "a.png"
    cv2.imwrite(str(path), np.zeros((8, 16, 3), np.uint8))
    with pytest.raises(VideoError, match=r"equirectangular only.*v360=dfisheye:e"):
        open_video(path, projection="dual_fisheye")
