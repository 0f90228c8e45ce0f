# SPDX-License-Identifier: Apache-2.0
"""Opens video files, with a message on the cause where one does not open, and decodes their pictures in order.

Frames are numbered in order of presentation. MP4 and MOV hold an index of all packets; packets that an edit list cuts
away are marked and do not count. Other containers are read through once (packets only, nothing is decoded).

Every packet that is to be shown announces a time stamp. Decoders hand out pictures in the order of these stamps, so a
stamp that is passed over is a picture that could not be decoded, whether the decoder reported an error or not.
"""

from __future__ import annotations

import functools
import heapq
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import chain
from pathlib import Path
from typing import Any

import av
import av.codec.codec
import av.error
import av.stream
import numpy as np
from av.codec.hwaccel import HWAccel
from numpy.typing import NDArray

from mr360uw.base.input_files import PICTURE, not_read, note_read, read_data, unreadable, wrapped
from mr360uw.errors import VideoError
from mr360uw.video.spherical import cut_short

_LOCAL_VIDEO = {
    "protocol_whitelist": "file",
    "format_whitelist": "mov,mp4,matroska,webm,avi,mpegts,mpeg,mxf,nut,ogg,flv,asf,ivf,h264,hevc,av1,obu,m4v",
}
"""Names are names of files, never addresses; playlists and scripts, which name other files, are no videos."""


_TAGS: dict[str, Any] = {"metadata_errors": "surrogateescape"} if int(av.__version__.split(".")[0]) < 19 else {}
"""Tags that are not UTF-8 are read and written as the bytes that they are; PyAV 19 does so unasked."""

_COPY_AGAIN = "copy it again; a recording that was interrupted needs a repair tool"


def open_local(path: Path, card: str = "") -> Any:
    """Return FFmpeg's container of a file; raise `FFmpegError` or `OSError`.

    card: FFmpeg's name of the kind of device that decodes its pictures, "" for none; `RuntimeError` where it cannot.
    """
    device = HWAccel(device_type=card, allow_software_fallback=False) if card else None
    return av.open(f"file:{path}", **_TAGS, options=_LOCAL_VIDEO, hwaccel=device)


def open_packets(path: Path) -> Any:
    """Return FFmpeg's container of a file whose sound or data are copied; raise `FFmpegError` or `OSError`.

    It opens no decoder of pictures: `open_local` decodes a first picture, which takes 20 ms at 2048 x 1024.
    """
    options = {**_LOCAL_VIDEO, "codec_whitelist": _decoders_without_pictures()}
    return av.open(f"file:{path}", **_TAGS, options=options)


@functools.cache
def _decoders_without_pictures() -> str:
    """Return FFmpeg's names of all decoders but those of pictures, separated by commas."""
    names = []
    for name in sorted(av.codecs_available):
        with suppress(av.codec.codec.UnknownCodecError):  # it encodes alone
            if av.Codec(name, "r").type != "video":
                names.append(name)
    return ",".join(names)


def create_local(path: Path, kind: str, options: dict[str, str] | None = None) -> Any:
    """Return FFmpeg's container of a new file of a kind such as "mp4"; raise `FFmpegError` or `OSError`."""
    return av.open(f"file:{path}", "w", format=kind, options=options or {}, **_TAGS)


def fraction(rational: Any) -> Fraction:
    """Return a rate or a time base of PyAV as a fraction; from PyAV 19 on they are a type of its own."""
    return Fraction(rational.numerator, rational.denominator)


def check_file(path: Path) -> None:
    """Raise VideoError where there is no file with something in it; note that it is read."""
    if path.is_dir():
        raise VideoError(f"{path} - is a folder - name a video, a picture, or a pattern such as {path}/frame_%04d.png")
    if reason := unreadable(path):
        raise VideoError(f"{path} - {reason}")
    if path.stat().st_size == 0:
        raise VideoError(f"{path} - the file is empty (got 0 bytes) - copy or record it again")
    note_read(path)


@contextmanager
def open_container(path: Path, track: int | None = None, card: str = "") -> Iterator[tuple[Any, Any]]:
    """Open a file for one pass of decoding; yields (container, its video stream number `track`).

    track: None is the file's default one, or else its first. card: see `open_local`.
    """
    check_file(path)
    try:
        container = open_local(path, card)
    except (av.error.FFmpegError, OSError) as error:
        raise VideoError(_why_not(path, error)) from error
    with container:
        streams = _video_streams(container)
        if not streams and (short := cut_short(path)):
            raise VideoError(f"{path} - the file is cut short ({short}) - {_COPY_AGAIN}")
        if not streams:
            kinds = ", ".join(sorted({s.type for s in container.streams})) or "nothing"
            raise VideoError(f"{path} - has no video stream that can be decoded (got {kinds}) - name a video file")
        shown = (s for s in streams if s.disposition & av.stream.Disposition.default)
        stream = next(shown, streams[0]) if track is None else streams[track]
        PICTURE.check(str(path), stream.width * stream.height, VideoError)
        stream.thread_type = "AUTO"
        yield container, stream


def track_sizes(path: Path) -> list[tuple[int, int]]:
    """Return the width and height of each video stream of a file; VideoError where there is none."""
    with open_container(path) as (container, _):
        return [(s.width, s.height) for s in _video_streams(container)]


def _video_streams(container: Any) -> list[Any]:
    """Return the video streams that can be decoded, without pictures of an album's kind."""
    decoded = (s for s in container.streams.video if s.codec_context is not None)
    return [s for s in decoded if not s.disposition & av.stream.Disposition.attached_pic]


_PICTURES = {
    b"\xff\xd8\xff": ".jpg", b"\x89PNG": ".png", b"II*\0": ".tif", b"MM\0*": ".tif", b"v/1\x01": ".exr", b"#?": ".hdr",
    b"BM": ".bmp", b"SDPX": ".dpx", b"XPDS": ".dpx",
}  # fmt: skip
"""Endings of pictures by their first bytes."""


def _why_not(path: Path, error: Exception) -> str:
    if isinstance(error, PermissionError):
        return f"{path} - may not be read (got {error.strerror}) - check the file's permissions"
    short = cut_short(path)
    if short:
        return f"{path} - the file is cut short ({short}) - {_COPY_AGAIN}"
    with path.open("rb") as file:
        head = file.read(32)
    if why := wrapped(head) or not_read("raw video").get(path.suffix.lower()):
        return f"{path} - {why}"
    if (kind := next((end for mark, end in _PICTURES.items() if head.startswith(mark)), "")) != "":
        return f"{path} - is a picture by its content - let its name end in {kind}"
    if not any(head):
        return f"{path} - begins with zeros: it was never written, or its disk failed - copy it again from the camera"
    reason = getattr(error, "strerror", None) or error
    return f"{path} - is not a video that FFmpeg can read (got {reason}) - name an mp4, mov, mkv or webm file"


_AHEAD = 18
"""Packets among which that of the first picture is: as many as H.264 and HEVC may reorder, and it."""


def _decoded_first(container: Any, stream: Any) -> Iterator[Any]:
    """Yield the pictures of a stream from its first on, which is decoded alone if no packet after it is shown before.

    A decoder would hold it back until it has others, and further threads would decode what follows, for nothing.
    """
    stream.thread_type = "NONE"
    packets: list[Any] = []
    with suppress(av.error.FFmpegError):  # what is there may do
        for packet in container.demux(stream):
            packets.append(packet)
            if len(packets) == _AHEAD:
                break
    stamps = [packet.pts for packet in packets]
    if len(stamps) == _AHEAD and None not in stamps and min(stamps) == stamps[0]:
        yield from packets[0].decode()
        yield from stream.codec_context.decode(None)
        stream.codec_context.flush_buffers()
    for packet in packets:
        yield from packet.decode()
    if len(packets) == _AHEAD:
        yield from container.decode(stream)


def first_picture(path: Path, container: Any, stream: Any, *, alone: bool = True) -> Any:
    """Return the first frame of a file that has just been opened; VideoError where there is none.

    alone: whether no other frame is decoded, where none must be.
    """
    reason = "no picture"
    try:
        for frame in _decoded_first(container, stream) if alone else container.decode(stream):
            if frame.pts is not None:
                return frame
            raise VideoError(f"{path} - the pictures have no time stamps - remux the clip to mp4 or mkv first")
    except av.error.FFmpegError as error:
        reason = error.strerror or str(error)
    short = cut_short(path)
    if short:
        raise VideoError(f"{path} - the file is cut short before its first picture ({short}) - {_COPY_AGAIN}")
    raise VideoError(f"{path} - its pictures cannot be decoded (got {reason}) - get an intact copy")


def gpmf_payloads(path: str | Path) -> bytes:
    """Return the GPMF payloads of a video's metadata track one after the other, or a file that holds just these.

    Raises `VideoError` where the video has no such track.
    """
    import av.error

    path = Path(path)
    if path.suffix.lower() in (".bin", ".gpmf"):
        return read_data(path, VideoError)
    check_file(path)
    try:
        with open_packets(path) as container:
            tracks = [s for s in container.streams if s.type == "data" and "GoPro MET" in str(s.metadata)]
            if tracks:
                return b"".join(bytes(packet) for packet in container.demux(tracks[0]) if packet.size)
    except (av.error.FFmpegError, OSError) as error:
        raise VideoError(f"{path} - cannot be read as a video (got {error}) - give the camera's own file") from error
    raise VideoError(f"{path} - has no GoPro metadata track (got none named 'GoPro MET') - give the camera's own file")


@dataclass(frozen=True)
class FrameIndex:
    """One entry for each packet, in decoding order.

    stamp: the time stamp by which a packet is found: that of decoding (MP4) or else of presentation. keyframe:
    decoding can start here. shown: False for packets that an edit list cuts away. end_byte: first byte after the
    packet in the file, 0 where unknown. by_dts: whether `stamp` is that of decoding. delay: time from the decoding of
    the first picture to its presentation, for `stamp` of decoding.
    """

    stamp: NDArray[np.int64]
    keyframe: NDArray[np.bool_]
    shown: NDArray[np.bool_]
    end_byte: NDArray[np.int64]
    by_dts: bool
    delay: int = 0

    def begun_at(self, pts: int) -> FrameIndex:
        """Return the index of a clip whose first picture is presented at a time stamp."""
        first = int(np.argmax(self.shown))
        return replace(self, delay=pts - int(self.stamp[first]) if self.by_dts and len(self.stamp) else 0)

    def presentation(self, position: int) -> int:
        """Return the time stamp of presentation of a keyframe, by which containers are sought; it may be late."""
        return int(self.stamp[position]) + self.delay

    def entry_before(self, frame: int) -> int:
        """Return the last frame up to another at which decoding may start."""
        entries = self.entry_points(frame)
        return self.shown_before(entries[0]) if entries else 0

    @property
    def frame_count(self) -> int:
        """Number of frames that are presented."""
        return int(self.shown.sum())

    def shown_before(self, position: int) -> int:
        """Number of presented frames among the packets before `position`."""
        return int(self.shown[:position].sum())

    def entry_points(self, frame: int) -> list[int]:
        """Positions of keyframes at which decoding may start to reach a frame, the nearest first."""
        before = np.concatenate([[0], np.cumsum(self.shown)[:-1]])
        return [int(p) for p in np.flatnonzero(self.keyframe & (before <= frame))[::-1]]

    def position(self, packet: Any) -> int | None:
        """Position of a packet, None where it is not in the index."""
        stamp = packet.dts if self.by_dts else packet.pts
        found = np.flatnonzero(self.stamp == stamp)
        return int(found[0]) if found.size else None

    def complete_frames(self, file_size: int) -> int:
        """Number of frames that a file of this size holds; less than `frame_count` when it is cut short."""
        missing = np.flatnonzero(self.end_byte > file_size)
        return self.shown_before(int(missing[0])) if missing.size else self.frame_count


def container_index(container: Any, stream: Any) -> FrameIndex | None:
    """Return the index that an MP4 or MOV holds; None where a container does not list every packet."""
    if "mp4" not in container.format.name or stream.frames <= 0 or len(stream.index_entries) == 0:
        return None
    entries = [(e.timestamp, e.is_keyframe, not e.is_discard, e.pos + e.size) for e in stream.index_entries]
    stamp, keyframe, shown, end = zip(*entries, strict=True)
    return FrameIndex(np.array(stamp), np.array(keyframe, bool), np.array(shown, bool), np.array(end), by_dts=True)


def scanned_index(container: Any, stream: Any) -> FrameIndex:
    """Read all packets of a container that has just been opened, and return their index."""
    packets = [(p.pts, p.is_keyframe, not p.is_discard) for p in container.demux(stream) if p.pts is not None]
    stamp, keyframe, shown = zip(*packets, strict=True) if packets else ((), (), ())
    unknown = np.zeros(len(packets), np.int64)
    return FrameIndex(np.array(stamp, np.int64), np.array(keyframe, bool), np.array(shown, bool), unknown, by_dts=False)


_ANY_TIME = -(1 << 62)
"""A time stamp before all others."""


StoredPicture = tuple[int, int, Any, str]
"""One picture of a file: its number in order of presentation; its time stamp; the decoder's frame, None where it is
lost; and the decoder's reason for that, "" where it gave none."""


def pictures(
    container: Any,
    stream: Any,
    index: FrameIndex,
    start: int,
    reorder: int | None = None,
    *,
    rewound: bool = True,
    chosen: Callable[[int], bool] | None = None,
) -> Iterator[StoredPicture]:
    """Yield the pictures of an open file, from one at or before `start` on, lost ones too.

    reorder: most pictures by which decoding runs ahead of presentation; pictures before `start` that no other refers to
    are then left out as if lost. None decodes all. rewound: whether nothing of the file has been read yet. chosen:
    whether a number is; of the others, pictures that no other refers to are left out too.

    After a seek, pictures that are shown before the keyframe but decoded after it (an open group of pictures) count
    as frames before it and are dropped: their references may be missing.
    """
    at_start = start == 0 and rewound
    entry = (_demuxed(container, stream), 0, _ANY_TIME) if at_start else _entry(container, stream, index, start)
    packets, number, first = entry
    announced: list[int] = []
    reason, context = "", stream.codec_context
    needed = number if reorder is None else start - reorder
    for place, packet in enumerate(packets, number):
        if packet.pts is not None and packet.pts >= first and not packet.is_discard:
            heapq.heappush(announced, packet.pts)
        skipped = place < needed
        if chosen is not None and packet.pts is not None:
            # Before one that no other refers to, all that are shown earlier have come
            skipped = skipped or not chosen(number + sum(pts < packet.pts for pts in announced))
        context.skip_frame = "NONREF" if skipped else "DEFAULT"
        try:
            frames = () if packet.is_corrupt else packet.decode()  # one that is cut short shows half a picture
        except av.error.FFmpegError as error:
            reason = error.strerror or str(error)
            continue
        for frame in frames:
            if frame.pts is None or frame.pts < first:
                continue
            while announced and announced[0] < frame.pts:
                yield number, heapq.heappop(announced), None, reason
                number += 1
            if announced and announced[0] == frame.pts:
                heapq.heappop(announced)
            yield number, frame.pts, frame, ""
            number += 1
    while announced:
        yield number, heapq.heappop(announced), None, reason
        number += 1


def _demuxed(container: Any, stream: Any) -> Iterator[Any]:
    """Yield packets up to where the file cannot be read on: what is missing there shows as lost pictures."""
    try:
        yield from container.demux(stream)
    except av.error.FFmpegError:
        return


def _entry(container: Any, stream: Any, index: FrameIndex, start: int) -> tuple[Iterable[Any], int, int]:
    """Seek so that decoding reaches frame `start`.

    Returns the packets from there on, the number of the first picture, and its time stamp.
    """
    for entry in index.entry_points(start):
        container.seek(index.presentation(entry), stream=stream, backward=True)
        packets = _demuxed(container, stream)
        head: list[Any] = []
        for packet in packets:
            head.append(packet)
            key = head[0]
            if len(head) > 1 and (packet.is_keyframe or packet.pts is None or (packet.dts or 0) >= key.pts):
                break
        position = index.position(head[0]) if head else None
        if position is None or not head[0].is_keyframe:
            continue
        leading = sum(p.pts is not None and p.pts < key.pts and not p.is_discard for p in head)
        number = index.shown_before(position) + leading
        if number <= start:
            return chain(head, packets), number, key.pts
    container.seek(index.presentation(0), stream=stream, backward=True)
    return _demuxed(container, stream), 0, _ANY_TIME
