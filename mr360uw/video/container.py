# SPDX-License-Identifier: Apache-2.0
"""Reads the frames of a video file.

Every pass over the frames opens the file anew: passes do not disturb each other, and memory does not grow with the
length of the clip. Decoding runs on all cores, outside Python's lock.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import Any

import av
import av.error
import numpy as np
from av.codec.hwaccel import hwdevices_available
from av.sidedata.sidedata import Type

from mr360uw.errors import DamagedFrameError, VideoError
from mr360uw.types import Rectangle, YuvImage
from mr360uw.video.clip import ColorTags, NamedColors, color_notes, color_spec, hdr_from_side_data, not_copied
from mr360uw.video.demux import (
    FrameIndex,
    StoredPicture,
    container_index,
    first_picture,
    fraction,
    open_container,
    pictures,
    scanned_index,
)
from mr360uw.video.layout import EyeChoice, output_layout, panorama_crops, planes_of, shape_of_codes
from mr360uw.video.planes import plane_views, side_data_of
from mr360uw.video.reader import Chosen, Damaged, Decoder, Seeker, VideoFrame, VideoReader, check_range
from mr360uw.video.spherical import SphericalMetadata, from_side_data, from_tag, read_spherical

_SOUND_LONGER_S = 1.0
"""Time [s] by which the sound of a complete file may be longer than its pictures; twice as large, shorter cuts pass."""


def _turn_of(path: Path, first: Any, *, both: bool) -> int:
    """Return the degrees by which a file asks its pictures to be turned; `VideoError` where that is not done here.

    both: whether both eyes are read.
    """
    matrix = side_data_of(first).get(Type.DISPLAYMATRIX)
    a, b, _, c, d = struct.unpack_from("=5i", bytes(matrix)) if matrix is not None else (1, 0, 0, 0, 1)
    if a * d < b * c:
        raise VideoError(
            f"{path} - asks to be shown as in a mirror (its display matrix) - turn its pictures before, as by ffmpeg "
            f"-i {path.name} -c:a copy {path.stem}_turned{path.suffix}"
        )
    turn = int(first.rotation) % 360
    if turn not in (0, 180) or (turn and both):
        raise VideoError(
            f"{path} - asks to be turned by {turn} degrees - turn the pictures upright before "
            "(only 180 is done here, and not for both eyes)"
        )
    return turn


def _unused(path: Path, stream: Any, first: Any, crop: Rectangle) -> Iterator[str]:
    """Yield lines on what a track of pictures says and is not used."""
    aspect = float(stream.sample_aspect_ratio or 1)
    if abs(aspect - 1.0) > _SQUARE and crop.width == 2 * crop.height:
        yield (
            f"{path} - says that its pixels are not square (got {aspect:.4g}), which is not used: the frame is the "
            "whole sphere - set the pixel aspect to 1 if it is, else export 2:1"
        )
    if stream.metadata.get("alpha_mode") == "1":
        yield f"{path} - has transparency (alpha_mode), which is left out - flatten it if that is wrong"
    if first.interlaced_frame:
        yield (
            f"{path} - is interlaced, and read as it is stored: what moves has combs - deinterlace it before, as by "
            f"ffmpeg -i {path.name} -vf bwdif {path.stem}_frames{path.suffix}"
        )
    if path.suffix.lower() == ".lrv":
        yield f"{path} - is the small preview that a camera writes beside a clip - name the clip for its full size"


_SQUARE = 1e-3
_OF_TRACK = ("language", "title", "handler_name")


class ContainerReader(VideoReader):
    """A video file as a plate; made by `open_video`. Pictures are turned by 180 degrees where the file says so."""

    def __init__(
        self,
        path: Path,
        named: NamedColors,
        eyes: EyeChoice = (None, None),
        equirectangular: bool = True,
        damaged: Damaged = "stop",
        track: int | None = None,
        decoder: Decoder = "software",
    ) -> None:
        self._damaged, self._track = damaged, track
        self._card, taken = "", ""
        with open_container(path, track) as (container, stream):
            listed = container_index(container, stream)
            first = first_picture(path, container, stream)
            if decoder == "auto":
                self._card, taken = _decoding_card(path, track, first)
            self._listed = None if listed is None else listed.begun_at(first.pts)
            context = stream.codec_context
            tags = ColorTags.of(context)
            spherical = read_spherical(path) or _spherical_of(stream, first)
            spec = color_spec(path, first.format.name, tags, first.height, named)
            self._rotation = _turn_of(path, first, both=eyes[0] == "both")
            # Find the panoramas in the first picture
            self._size = first.width, first.height
            self._crop, self._beside, stereo = panorama_crops(
                path, self._size, spherical, eyes, equirectangular,
                lambda: shape_of_codes(plane_views(first, spec), spec.bits), float(stream.sample_aspect_ratio or 1),
            )  # fmt: skip
            self._announced_s = None if container.duration is None else float(container.duration / av.time_base)
            self._reorder = int(context.reorder_depth)
            self._wrap = equirectangular
            beside = () if track is None else ("video",)  # that were asked for one by one
            others = [s for s in container.streams if s.type not in ("audio", *beside) and s.index != stream.index]
            lost = (not_copied(path, s.type, s.index, s.metadata) for s in others)
            odd = () if spherical is None else (f"{path} - {problem}" for problem in spherical.problems)
            aspect = stream.sample_aspect_ratio
            super().__init__(
                path=path,
                width=self._crop.width,
                height=self._crop.height,
                frame_rate=fraction(stream.average_rate or stream.guessed_rate or Fraction(30)),
                time_base=fraction(stream.time_base),
                start_pts=first.pts,
                spec=spec,
                tags=tags,
                codec_name=context.name,
                pixel_format=first.format.name,
                sound=path if container.streams.audio else None,
                spherical=spherical,
                notes=(
                    *lost,
                    *odd,
                    *_unused(path, stream, first, self._crop),
                    *color_notes(path, tags, named),
                    *filter(None, [taken]),
                ),
                words=_words(container.metadata),
                track_words={name: text for name, text in stream.metadata.items() if name in _OF_TRACK},
                pixel_aspect=Fraction(0) if aspect is None else fraction(aspect),
                panorama=equirectangular,
                hdr=hdr_from_side_data(side_data_of(first)),
                stereo=output_layout(stereo) if self._beside is not None else "mono",
            )

    @cached_property
    def index(self) -> FrameIndex:
        """The packets of the stream; reads the file through once where the container does not list them."""
        if self._listed is not None:
            return self._listed
        with open_container(self.path, self._track) as (container, stream):
            return scanned_index(container, stream)

    @property
    def frame_count(self) -> int:
        """Number of frames in the clip."""
        return self.index.frame_count

    @property
    def intact_frames(self) -> int:
        """Number of frames from the first on whose data are in the file; see `VideoReader`."""
        complete = self.index.complete_frames(self.path.stat().st_size)
        return complete if complete == self.frame_count else max(0, complete - self._reorder)

    @property
    def doubts(self) -> tuple[str, ...]:
        """A note where the pictures end well before the header says; see `VideoReader`."""
        if self._listed is not None or self._announced_s is None or not self.frame_count:
            return ()
        short_s = self._announced_s - float((int(self.index.stamp.max()) - self.start_pts) * self.time_base)
        if short_s < _SOUND_LONGER_S:
            return ()
        return (
            f"{self.path} - its pictures end {short_s:.1f} s before the end that its header names: is it cut short?",
        )

    def check_range(self, start: int = 0, stop: int | None = None) -> tuple[int, int]:
        """Return (start, stop) with stop filled in; VideoError where the clip does not hold all of these frames."""
        start, stop = check_range(self.path, start, stop, self.frame_count)
        if stop > self.intact_frames and self._damaged == "stop":
            raise VideoError(
                f"{self.path} - the file is cut short (its data end at frame {self.intact_frames} of "
                f'{self.frame_count}) - get the complete file, set plate.damaged = "hold", or take frames '
                f"0:{self.intact_frames}"
            )
        return start, stop

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[VideoFrame]:
        """Return an iterator over the frames start <= index < stop (to the end by default); see `VideoReader`."""
        start, stop = self.check_range(start, stop)
        return self._held(start, stop) if self._damaged == "hold" else self._decoded(start, stop)

    def sampled(self, start: int, stop: int, chosen: Chosen) -> Iterator[VideoFrame]:
        """Return an iterator over the frames, some without codes; see `VideoReader`."""
        start, stop = self.check_range(start, stop)
        held = self._damaged == "hold"
        return self._held(start, stop) if held else self._decoded(start, stop, chosen)

    @contextmanager
    def seeker(self) -> Iterator[Seeker]:
        """Yield a function of a start that reads on from there in the same open file; see `VideoReader`."""
        if self._damaged == "hold":
            yield self.frames
            return
        with open_container(self.path, self._track, self._card) as (container, stream):
            yield lambda start: self._read(container, stream, *self.check_range(start), rewound=False)

    def entry_before(self, index: int) -> int:
        """Return the last frame up to another at which decoding may start."""
        return self.index.entry_before(index)

    def _decoded(self, start: int, stop: int, chosen: Chosen | None = None) -> Iterator[VideoFrame]:
        """Yield frames of a pass of its own."""
        with open_container(self.path, self._track, self._card) as (container, stream):
            yield from self._read(container, stream, start, stop, chosen=chosen)

    def _read(
        self,
        container: Any,
        stream: Any,
        start: int,
        stop: int,
        *,
        rewound: bool = True,
        chosen: Chosen | None = None,
    ) -> Iterator[VideoFrame]:
        """Yield frames; `DamagedFrameError` at the first that is lost. chosen: None for all."""
        reached, reason = start, ""
        all_of = pictures(container, stream, self.index, start, self._reorder, rewound=rewound, chosen=chosen)
        for index, pts, native, why in all_of:
            if index < start:
                continue
            reached, reason = index, why
            if native is None and (chosen is None or why):
                break
            if native is None or (chosen is not None and not chosen(index)):
                yield self._passed_over(index, pts)
            else:
                yield self._frame(index, pts, native)
            reached += 1
            if reached == stop:
                return
        raise DamagedFrameError(
            f"{self.path} - cannot be decoded after frame {reached - 1} of {self.frame_count} (got "
            f"{reason or 'no picture'}) - the file is damaged; get an intact copy, take frames 0:{reached}, or set "
            'plate.damaged = "hold"',
            reached,
        )

    def _held(self, start: int, stop: int) -> Iterator[VideoFrame]:
        """Yield frames; the last good one, wherever it is, stands for those that are lost."""
        entry, held = min(start, max(self.intact_frames - 1, 0)), None
        while held is None:
            first = entry
            for index, pts, native, _ in self._every_picture(entry):
                first = min(first, index)
                held = native if native is not None else held
                if index < start:
                    continue
                if held is None:
                    break
                yield self._frame(index, pts, held, lost=native is None)
                if index + 1 == stop:
                    return
            if first == 0:
                raise DamagedFrameError(f"{self.path} - no picture can be decoded - get an intact copy", 0)
            entry = first - 1

    def _every_picture(self, start: int) -> Iterator[StoredPicture]:
        """Yield the pictures from one at or before `start` on, those too that are beyond the end of a cut file.

        Decoded by one thread: what a decoder makes of damaged data depends on the order in which its threads run.
        """
        last = None
        with open_container(self.path, self._track) as (container, stream):
            stream.thread_type = "NONE"
            for picture in pictures(container, stream, self.index, start):
                # pictures after a cut are decoded before those that are shown ahead of them, which are missing
                if picture[0] >= self.intact_frames:
                    break
                last = picture
                yield picture
        if last is not None:
            step = max(1, round(1 / (self.frame_rate * self.time_base)))
            index, pts, _, _ = last
            for beyond in range(1, self.frame_count - index):
                yield index + beyond, pts + step * beyond, None, ""

    def _passed_over(self, index: int, pts: int) -> VideoFrame:
        time_s = float((pts - self.start_pts) * self.time_base)
        return VideoFrame(index, pts, self.time_base, time_s, 0, self.spec, wrap=self._wrap)

    def _frame(self, index: int, pts: int, native: Any, *, lost: bool = False) -> VideoFrame:
        # Check that the format is that of the first frame
        if self._card:
            native = _in_format(native, self.pixel_format)
        if (native.width, native.height, native.format.name) != (*self._size, self.pixel_format):
            raise VideoError(
                f"{self.path} - the picture format changes at frame {index} (got {native.width}x{native.height} "
                f"{native.format.name}) - cut the clip there"
            )
        # Cut out the panorama, and the right eye's, upright
        planes = plane_views(native, self.spec, locked=True)
        beside = None if self._beside is None else planes_of(planes, self._beside)
        untouched = self._crop[2:] == self._size and not self._rotation
        if not untouched:
            planes = planes_of(planes, self._crop)
        if self._rotation:
            planes = YuvImage(planes.y[::-1, ::-1], planes.u[::-1, ::-1], planes.v[::-1, ::-1], planes.spec)
        # Keep the decoder's own frame where nothing was cut or turned
        frame = replace(
            self._passed_over(index, pts),
            duration=native.duration or 0,
            yuv=planes,
            native=native if untouched else None,
            damage="held" if lost else "concealed" if native.is_corrupt else "none",
        )
        return frame if beside is None else replace(frame, right=replace(frame, yuv=beside))


def _words(tags: Mapping[str, str]) -> dict[str, str]:
    """Return the text tags of a container. FFmpeg 8.1 joins the time of the movie's header and that of a key."""
    return {name: text.partition(";")[0] if name == "creation_time" else text for name, text in tags.items()}


def _spherical_of(stream: Any, first: Any) -> SphericalMetadata | None:
    """Return the spherical metadata of a container other than MP4 by its stream and first picture; None without."""
    told, tag = from_side_data(side_data_of(first)), from_tag(stream)
    return tag if told is None else told if tag is None else replace(told, view_deg=tag.view_deg)


def stated_pose(path: Path) -> tuple[float, float, float]:
    """Return yaw, pitch and roll [deg] of the panorama in a video, as its metadata state them; zeros without."""
    found = read_spherical(path)
    if found is None and path.suffix.lower() in (".mkv", ".webm"):
        with open_container(path) as (container, stream):
            found = _spherical_of(stream, first_picture(path, container, stream))
    return SphericalMetadata().pose_deg if found is None else found.pose_deg


# Decoders of graphics cards, which are taken where their first picture is that of FFmpeg in software, bit for bit.


def _decoding_card(path: Path, track: int | None, first: Any) -> tuple[str, str]:
    """Return the kind of card that decodes a video here, "" where none does, and a line on what was taken and why.

    first: the file's first picture, decoded in software.
    """
    refusals = []
    for card in hwdevices_available():
        reason = _refusal(path, track, card, first)
        if not reason:
            return card, f'plate.decoder = "auto" took {card}, whose first picture is the same'
        refusals.append(f"{card}: {reason}")
    why = f" ({'; '.join(refusals)})" if refusals else ""
    return "", f'plate.decoder = "auto" took software: no card decodes {path.name} here{why}'


def _refusal(path: Path, track: int | None, card: str, first: Any) -> str:
    """Return why a card's pictures are not taken; "" where they are."""
    try:
        with open_container(path, track, card) as (container, stream):
            seen = _in_format(first_picture(path, container, stream, alone=False), first.format.name)
        return "" if _same(seen, first) else "its first picture differs"
    except (VideoError, av.error.FFmpegError, RuntimeError, ValueError) as error:
        return str(getattr(error.__cause__, "strerror", None) or error)


def _in_format(native: Any, name: str) -> Any:
    """Return a picture of FFmpeg's in a pixel format: cards have Cb and Cr side by side."""
    return native if native.format.name == name else native.reformat(format=name)


def _same(one: Any, other: Any) -> bool:
    if (one.width, one.height, one.pts) != (other.width, other.height, other.pts):
        return False
    return np.array_equal(one.to_ndarray(), other.to_ndarray())
