# SPDX-License-Identifier: Apache-2.0
"""Plates in other projections, read as equirectangular frames through FFmpeg's filter v360.

Dual fisheye: two circles side by side in one frame, in two tracks, or in two files (Insta360's _00_ and _10_). EAC
(equi-angular cubemap): six cube faces in two rows of three, in one frame, or one row in each of GoPro's two tracks.
v360 samples each frame by itself, so that a frame depends on its own pictures alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import fields, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import av.filter
import numpy as np
from numpy.typing import NDArray

from mr360uw.color import Primaries, Transfer
from mr360uw.errors import VideoError
from mr360uw.types import YuvImage
from mr360uw.video.clip import Clip
from mr360uw.video.container import ContainerReader
from mr360uw.video.demux import track_sizes
from mr360uw.video.formats import (
    FFMPEG_NAMES,
    PICTURE_SUFFIXES,
    Projection,
    joined_row,
    second_lens,
    turned_by_ffmpeg,
)
from mr360uw.video.pixels.planes import native_frame, plane_views
from mr360uw.video.reader import Damaged, Decoder, Seeker, VideoReader
from mr360uw.video.video_frame import VideoFrame


def open_unwrapped(
    path: Path,
    projection: Projection,
    fov_deg: float,
    transfer: Transfer | None,
    primaries: Primaries | None,
    damaged: Damaged,
    decoder: Decoder = "software",
) -> VideoReader:
    """Open a video in a projection other than equirectangular; raise `VideoError`.

    fov_deg: angle across one half of a dual-fisheye frame.
    """
    if path.suffix.lower() in PICTURE_SUFFIXES:
        raise VideoError(
            f"{path} - pictures are read as equirectangular only (got {projection}) - turn them by "
            + turned_by_ffmpeg(path, projection)
        )
    sizes = track_sizes(path)
    width, height = sizes[0]
    paths = [(path, 0)]
    if len(sizes) > 1 and sizes[1] == sizes[0]:
        paths.append((path, 1))
    elif projection == "dual_fisheye" and width == height and (other := second_lens(path)) is not None:
        paths.append((other, 0))
    if projection == "eac":
        _check_eac(path, width, height, len(paths))
    elif len(paths) * width != 2 * height:
        raise VideoError(
            f"{path} - two fisheye circles side by side make a frame of 2:1 (got {width}x{height}"
            f"{'' if len(paths) == 1 else ', twice'}) - crop it to the circles, give both of the camera's files "
            "(_00_ and _10_) their names again, or export it as equirectangular 2:1"
        )
    tracks = [
        ContainerReader(p, transfer, primaries, equirectangular=False, damaged=damaged, track=k, decoder=decoder)
        for p, k in paths
    ]
    return _UnwrappedReader(tracks, projection, fov_deg)


def _check_eac(path: Path, width: int, height: int, tracks: int) -> None:
    if tracks == 2 or 1.4 < width / height < 1.8:
        return
    raise VideoError(
        f"{path} - EAC is two tracks of three cube faces, or one frame of 3:2 to 16:9 (got one of {width}x{height}) - "
        "give the camera's .360 file with both tracks, or export it as equirectangular 2:1 in GoPro Player"
    )


class _UnwrappedReader(VideoReader):
    """The frames of one or two tracks, joined and turned to equirectangular. Index and time stamps are the first's."""

    def __init__(self, tracks: list[ContainerReader], projection: Projection, fov_deg: float) -> None:
        first = tracks[0]
        height = first.height if projection == "dual_fisheye" else 2 * first.height // (3 - len(tracks))
        height -= height % 2
        kept: dict[str, Any] = {field.name: getattr(first, field.name) for field in fields(Clip)}
        note = f"{first.path} - {projection} is turned to equirectangular by FFmpeg's v360"
        note += f", {fov_deg:g} degrees across a circle" if projection == "dual_fisheye" else ""
        note += "; the camera maker's program stitches better, above all what is near"
        changed = {
            "width": 2 * height, "height": height, "spherical": None, "panorama": True, "pixel_aspect": Fraction(0),
        }  # fmt: skip
        super().__init__(**(kept | changed | {"notes": (*first.notes, note)}))
        self._tracks, self._projection, self._fov_deg = tracks, projection, fov_deg

    @property
    def frame_count(self) -> int:
        """Number of frames that all tracks have."""
        return min(track.frame_count for track in self._tracks)

    @property
    def intact_frames(self) -> int:
        """Number of frames whose data are there; see `VideoReader`."""
        return min(track.intact_frames for track in self._tracks)

    @property
    def doubts(self) -> tuple[str, ...]:
        """Notes on signs that the plate is not all there."""
        counts = [track.frame_count for track in self._tracks]
        uneven = f"{self.path} - its two lenses have unequal numbers of frames (got {counts}): is it cut short?"
        return tuple(dict.fromkeys(d for track in self._tracks for d in track.doubts)) + (
            (uneven,) if min(counts) < max(counts) else ()
        )

    def check_range(self, start: int = 0, stop: int | None = None) -> tuple[int, int]:
        """Return (start, stop) with stop filled in; see `VideoReader`."""
        start, stop = self._tracks[0].check_range(start, stop if stop is not None else self.frame_count)
        for track in self._tracks[1:]:
            track.check_range(start, stop)
        return start, stop

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[VideoFrame]:
        """Return an iterator over the frames; see `VideoReader`."""
        start, stop = self.check_range(start, stop)
        return self._turned([track.frames(start, stop) for track in self._tracks], self._filter())

    @contextmanager
    def seeker(self) -> Iterator[Seeker]:
        """Yield a function of a start that reads on from there in open files; see `VideoReader`."""
        turn = self._filter()
        with ExitStack() as opened:
            seekers = [opened.enter_context(track.seeker()) for track in self._tracks]
            yield lambda start: self._turned([seek(start) for seek in seekers], turn)

    def entry_before(self, index: int) -> int:
        """Return the last frame up to another at which decoding may start."""
        return self._tracks[0].entry_before(index)

    def _turned(self, tracks: list[Iterator[VideoFrame]], turn: Callable[[Any], Any]) -> Iterator[VideoFrame]:
        for pictures in zip(*tracks, strict=False):  # a seeker's tracks may differ in length
            first = pictures[0]
            out = turn(native_frame(self._joined([_planes(p) for p in pictures])))
            planes = plane_views(out, self.spec)
            for plane in (planes.y, planes.u, planes.v):
                plane.flags.writeable = False
            damage = next((p.damage for p in pictures if p.damage != "none"), "none")
            yield replace(first, yuv=planes, native=None, wrap=True, damage=damage)

    def _joined(self, images: list[YuvImage]) -> YuvImage:
        """Return one picture of all tracks: circles side by side, or rows of cube faces below each other."""
        if len(images) == 1:
            return images[0]
        size = images[0].y.shape[1], images[0].y.shape[0]

        def both(planes: list[NDArray[Any]]) -> NDArray[Any]:
            if self._projection == "eac":
                return np.concatenate([joined_row(plane, size) for plane in planes], axis=0)
            return np.concatenate(planes, axis=1)

        y, u, v = (both([getattr(image, name) for image in images]) for name in ("y", "u", "v"))
        return YuvImage(y, u, v, self.spec)

    def _filter(self) -> Callable[[Any], Any]:
        """Return a function that turns a picture of the tracks, as PyAV's frame, to equirectangular."""
        graph: list[Any] = []
        options = f"{FFMPEG_NAMES[self._projection]}:e:cubic:w={self.width}:h={self.height}"
        if self._projection == "dual_fisheye":
            options += f":ih_fov={self._fov_deg:g}:iv_fov={self._fov_deg:g}"

        def turn(native: Any) -> Any:
            if not graph:
                made = av.filter.Graph()
                source = made.add_buffer(
                    width=native.width, height=native.height, format=native.format, time_base=self.time_base
                )
                ends = (source, made.add("v360", options), made.add("buffersink"))
                made.link_nodes(*ends).configure()
                graph.append(made)
            native.pts, native.time_base = 0, self.time_base
            graph[0].push(native)
            return graph[0].pull()

        return turn


def _planes(frame: VideoFrame) -> YuvImage:
    assert frame.yuv is not None  # videos have planes
    return frame.yuv
