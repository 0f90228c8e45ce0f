# SPDX-License-Identifier: Apache-2.0
"""Reads the frames of a video file.

Every pass over the frames opens the file anew: passes do not disturb each other, and memory does not grow with the
length of the clip. Decoding runs on all cores, outside Python's lock.
"""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import Any

import av.error

from mr360uw.color import Transfer
from mr360uw.errors import VideoError
from mr360uw.types import YuvImage
from mr360uw.video.metadata.spherical import V1_TAG, SphericalMetadata, from_side_data, from_xml, read_spherical
from mr360uw.video.metadata.tags import ColorTags, color_spec
from mr360uw.video.pixels.native import plane_views
from mr360uw.video.read.index import FrameIndex, container_index, has_full_index, scanned_index
from mr360uw.video.read.layout import Eye, panorama_crop
from mr360uw.video.read.probe import open_container
from mr360uw.video.read.reader import VideoReader, check_range
from mr360uw.video.video_frame import VideoFrame


class ContainerReader(VideoReader):
    """A video file as a plate; made by `open_video`.

    `frames` turns the pictures by 180 degrees where the file's metadata says so.
    """

    def __init__(
        self, path: Path, transfer: Transfer | None = None, eye: Eye | None = None, equirectangular: bool = True
    ) -> None:
        with open_container(path) as (container, stream):
            self._listed = container_index(stream) if has_full_index(container, stream) else None
            first = _first_frame(path, container, stream)
            context = stream.codec_context
            tags = ColorTags.of(context)
            spherical = read_spherical(path) or from_side_data(first.side_data) or _from_tag(stream)
            self._rotation = int(first.rotation) % 360
            self._crop = panorama_crop(path, first.width, first.height, spherical, eye, self._rotation, equirectangular)
            self._reorder = int(context.reorder_depth)
            self._wrap = equirectangular
            others = [s for s in container.streams if s.type not in ("video", "audio")]
            super().__init__(
                path=path,
                width=self._crop.width,
                height=self._crop.height,
                frame_rate=stream.average_rate or stream.guessed_rate or Fraction(30),
                time_base=stream.time_base,
                start_pts=first.pts,
                spec=color_spec(path, first.format.name, tags, first.height, transfer),
                tags=tags,
                codec_name=context.name,
                pixel_format=first.format.name,
                sound=path if container.streams.audio else None,
                spherical=spherical,
                notes=tuple(f"the {s.type} track {s.index} is not copied" for s in others),
                words=dict(container.metadata),
            )

    @cached_property
    def index(self) -> FrameIndex:
        """The packets of the stream; reads the file through once where the container does not list them."""
        if self._listed is not None:
            return self._listed
        with open_container(self.path) as (container, stream):
            return scanned_index(container, stream)

    @property
    def frame_count(self) -> int:
        """Number of frames in the clip."""
        return self.index.frame_count

    def check_range(self, start: int = 0, stop: int | None = None) -> tuple[int, int]:
        """Return (start, stop) with stop filled in; VideoError where the clip does not hold all of these frames."""
        start, stop = check_range(self.path, start, stop, self.frame_count)
        complete = self.index.complete_frames(self.path.stat().st_size)
        if stop > complete:
            usable = max(0, complete - self._reorder)
            raise VideoError(
                f"{self.path} - the file is cut short (its data end at frame {complete} of {self.frame_count}) - "
                f"get the complete file, or take frames 0:{usable}"
            )
        return start, stop

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[VideoFrame]:
        """Return an iterator over the frames start <= index < stop (to the end by default); see `VideoReader`."""
        start, stop = self.check_range(start, stop)
        return self._decode(start, stop)

    def _decode(self, start: int, stop: int) -> Iterator[VideoFrame]:
        index = start - 1
        try:
            with open_container(self.path) as (container, stream):
                for index, native in _numbered(container, stream, self.index, start):
                    if index >= stop:
                        return
                    if index >= start:
                        yield self._frame(index, native)
                    if index == stop - 1:
                        return
        except av.error.FFmpegError as error:
            raise VideoError(
                f"{self.path} - cannot be decoded after frame {index} (got {error.strerror}) - the file is damaged; "
                "get an intact copy or end the range there"
            ) from error
        raise VideoError(
            f"{self.path} - the pictures end early (got {index + 1} of {self.frame_count} frames) - the file is "
            f"damaged; get an intact copy or take frames 0:{index + 1}"
        )

    def _frame(self, index: int, native: Any) -> VideoFrame:
        if (native.width, native.height, native.format.name) != (*self._crop.frame_size, self.pixel_format):
            raise VideoError(
                f"{self.path} - the picture format changes at frame {index} (got {native.width}x{native.height} "
                f"{native.format.name}) - cut the clip there"
            )
        planes = plane_views(native, self.spec)
        for plane in (planes.y, planes.u, planes.v):
            plane.flags.writeable = False
        untouched = self._crop.is_whole and not self._rotation
        if not untouched:
            planes = _turned(self._crop.apply(planes), self._rotation)
        return VideoFrame(
            index=index,
            pts=native.pts,
            time_base=self.time_base,
            time_s=float((native.pts - self.start_pts) * self.time_base),
            duration=native.duration or 0,
            spec=self.spec,
            yuv=planes,
            native=native if untouched else None,
            wrap=self._wrap,
        )


def _turned(image: YuvImage, rotation: int) -> YuvImage:
    if not rotation:
        return image
    return YuvImage(image.y[::-1, ::-1], image.u[::-1, ::-1], image.v[::-1, ::-1], image.spec)


def _numbered(container: Any, stream: Any, index: FrameIndex, start: int) -> Iterator[tuple[int, Any]]:
    """Yield (index, frame) in order of presentation from a frame at or before `start`.

    After a seek, pictures that are shown before the keyframe but decoded after it (an open group of pictures) count
    as frames before it and are dropped: their references may be missing.
    """
    if start == 0:
        yield from enumerate(frame for frame in container.decode(stream) if frame.pts is not None)
        return
    for entry in index.entry_points(start):
        container.seek(int(index.stamp[entry]), stream=stream, backward=True)
        packets = container.demux(stream)
        head = []
        for packet in packets:
            head.append(packet)
            key = head[0]
            if len(head) > 1 and (packet.is_keyframe or packet.pts is None or (packet.dts or 0) >= key.pts):
                break
        position = index.position(head[0])
        if position is None or not head[0].is_keyframe:
            continue
        leading = sum(p.pts is not None and p.pts < key.pts and not p.is_discard for p in head)
        number = index.shown_before(position) + leading
        if number <= start:
            break
    else:
        container.seek(int(index.stamp[0]), stream=stream, backward=True)
        yield from enumerate(frame for frame in container.decode(stream) if frame.pts is not None)
        return
    for packet in (*head, *packets):
        for frame in packet.decode():
            if frame.pts is not None and frame.pts >= key.pts:
                yield number, frame
                number += 1


def _from_tag(stream: Any) -> SphericalMetadata | None:
    """V1 metadata as Matroska and WebM hold it: a tag of the track."""
    xml = next((text for key, text in stream.metadata.items() if key.upper() == V1_TAG), None)
    return from_xml(xml.encode()) if xml else None


def _first_frame(path: Path, container: Any, stream: Any) -> Any:
    try:
        for frame in container.decode(stream):
            if frame.pts is not None:
                return frame
            raise VideoError(f"{path} - the pictures have no time stamps - remux the clip to mp4 or mkv first")
    except av.error.FFmpegError as error:
        raise VideoError(
            f"{path} - its pictures cannot be decoded (got {error.strerror}) - get an intact copy"
        ) from error
    raise VideoError(f"{path} - holds no picture that can be decoded - get an intact copy")
