# SPDX-License-Identifier: Apache-2.0
"""Sound, data, subtitles, time code and chapters of a plate's file: which an output can keep, and copies of them.

Sound and data are copied packet by packet, without decoding them.

MP4 and QuickTime keep tracks of data (GoPro's GPMF) packet by packet, the time code (tmcd) and the chapters; Matroska
keeps the time code as a tag, and the chapters. Subtitles are kept in containers that hold their kind. Each track that
is lost has a note.

Spatial audio has marks of how the channels of a track are ambisonics: SA3D says the order and how channels are sorted,
SAND that two more are head-locked stereo (Google, "Spatial Audio RFC"). Players take a track of four channels for
loudspeakers without them; FFmpeg does not copy them.
"""

from __future__ import annotations

import io
import itertools
import re
import struct
from collections.abc import Iterator
from contextlib import ExitStack
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import av.error
import av.stream

from mr360uw.base.cache import shared
from mr360uw.errors import VideoError
from mr360uw.video.clip import CONTAINERS, PICTURE_SUFFIXES, Clip, not_copied
from mr360uw.video.demux import fraction, open_packets
from mr360uw.video.spherical import Box, parse_boxes, read_moov, sample_table, tracks_of

_ADVISED = (".mp4", ".mov", ".mkv")
_TRIAL_PACKETS = 16


def check_sound(source: Path, target: Path) -> None:
    """Raise `VideoError` where the kind of output that `target` names cannot hold the sound of `source`."""
    if _holds_sound(source, target.suffix.lower()):
        return
    with open_packets(source) as container:
        known = [s.codec_context for s in container.streams.audio if s.codec_context is not None]
        kinds = sorted({f"{context.codec.canonical_name}, {context.layout.name}" for context in known}) or ["unknown"]
    others = [suffix for suffix in _ADVISED if _holds_sound(source, suffix)]
    better = f"write {' or '.join(others)}, or set output.sound = false" if others else "set output.sound = false"
    raise VideoError(
        f"{target} - {target.suffix} cannot hold the sound of {source.name} (got {', '.join(kinds)}) - {better}"
    )


def _holds_sound(source: Path, suffix: str) -> bool:
    """Return whether a container takes the first packets of a file's sound."""
    with open_packets(source) as container:
        return _holds(CONTAINERS[suffix], *container.streams.audio, packets=_TRIAL_PACKETS)


def _holds(kind: str, *streams: Any, packets: int = 0) -> bool:
    """Return whether a kind of container takes tracks of a file, and so many of their first packets.

    It does not take those that FFmpeg has no name for. It is completed, in memory: some sound is refused only then, as
    PCM without a layout of its channels by MP4.
    """
    try:
        with av.open(io.BytesIO(), "w", format=kind) as trial:
            made = {stream.index: trial.add_stream_from_template(stream) for stream in streams}
            trial.start_encoding()
            for packet in itertools.islice(streams[0].container.demux(streams), packets) if packets else ():
                if packet.dts is not None:
                    packet.stream = made[packet.stream_index]
                    trial.mux(packet)
    except (av.error.FFmpegError, ValueError):
        return False
    return True


class TrackCopy:
    """Copies packets of one file into an output container, in step with the pictures: of its sound, or of some tracks.

    Times are in seconds on the clock of the input file. All packets of a whole clip keep their time stamps; of a part,
    those that begin within it are kept and moved with the pictures. The target must be able to hold them: see
    `check_sound`. tracks: numbers of the tracks; None: all of the sound.
    """

    def __init__(self, source: Path, target: Any, tracks: tuple[int, ...] | None = None) -> None:
        self._closing = ExitStack()
        self._container = self._closing.enter_context(open_packets(source))
        self._target = target
        self._streams: dict[int, Any] = {}
        streams = self._container.streams
        for stream in streams.audio if tracks is None else [streams[index] for index in tracks]:
            self._streams[stream.index] = target.add_stream_from_template(stream)
            self._streams[stream.index].metadata.update(stream.metadata)
            self._streams[stream.index].disposition = stream.disposition
        self._packets: Iterator[Any] = iter(())
        self._pending: Any = None
        self._shift_s = Fraction(0)

    def begin(self, start_s: Fraction | None, shift_s: Fraction) -> None:
        """Start with the packets from `start_s` on, or with the first; subtract `shift_s` from all time stamps."""
        self._shift_s = shift_s
        streams = [self._container.streams[index] for index in self._streams]
        if start_s is not None:
            self._container.seek(int(start_s * av.time_base), backward=True)
        self._packets = (
            packet
            for packet in self._container.demux(streams)
            if packet.dts is not None and (start_s is None or packet.pts * fraction(packet.time_base) >= start_s)
        )
        self._pending = next(self._packets, None)

    def advance(self, until_s: Fraction | None) -> None:
        """Copy the packets that begin before `until_s`, or all that are left."""
        while self._pending is not None and (
            until_s is None or self._pending.dts * fraction(self._pending.time_base) < until_s
        ):
            packet, self._pending = self._pending, next(self._packets, None)
            ticks = round(self._shift_s / fraction(packet.time_base))
            packet.pts -= ticks
            packet.dts -= ticks
            packet.stream = self._streams[packet.stream_index]
            self._target.mux(packet)

    def close(self) -> None:
        """Close the input file."""
        self._closing.close()


_MADE_ANEW = (b"tmcd", b"text")
"""Kinds of tracks that FFmpeg writes from the time code and the chapters."""
_TIMECODE = re.compile(r"(\d\d):(\d\d):(\d\d)([:;.])(\d\d)$")


OtherTracks = tuple[tuple[int, ...], str, tuple[dict[str, Any], ...], tuple[bytes, ...], tuple[str, ...]]


def other_tracks(like: Clip, kind: str, *, wanted: bool, sound: Path | None, frames: tuple[int, int]) -> OtherTracks:
    """Return what an output of a kind ("mp4", "mov", "matroska") keeps of the other parts of a plate's file.

    These are the numbers of the tracks of data and of subtitles that are copied; the time code of the first frame that
    is written, or ""; the chapters as PyAV has them, moved with the pictures; the marks of the audio tracks; and the
    plate's notes, without those on tracks that are kept, with those on what is lost.

    wanted: whether data, time code and chapters are asked for. sound: the file of the sound that is copied, or None.
    frames: (start, stop) of the frames that are written.
    """
    boxes = kind in ("mp4", "mov")
    moov = read_moov(sound) if sound is not None and sound.is_file() else None
    spatial = () if moov is None else tuple(_marks(entry) for entry in _audio_entries(moov))
    notes = list(like.notes)
    if any(spatial) and not boxes:
        notes.append(f"{sound} - its mark of spatial audio (SA3D) is kept in .mp4 and .mov alone")
        spatial = ()
    if not wanted or not like.pixel_format or not like.path.is_file():
        return (), "", (), spatial, tuple(notes)
    with open_packets(like.path) as container:
        data = [(s.index, s.id, boxes and _holds(kind, s)) for s in container.streams if s.type == "data"]
        texts = [s.index for s in container.streams if s.type == "subtitle" and _holds(kind, s)]
        pictures = [s.index for s in container.streams if s.disposition & av.stream.Disposition.attached_pic]
        lines = {s.index: not_copied(like.path, s.type, s.index, s.metadata) for s in container.streams}
        found = {s.index: text for s in container.streams if (text := _timecode_of(s))}
        chapters = _moved(container.chapters(), like, frames)
    kinds = _kinds(like.path)
    anew = {index for index, number, _ in data if kinds.get(number) in _MADE_ANEW}
    timecode = next(iter(found.values()), "")
    copied = (*(index for index, _, held in data if held and index not in anew), *texts)
    kept = {*copied, *(i for i in anew if (timecode if i in found else chapters))}
    covers = kinds and boxes  # pictures of an album's kind are among the tags, which are copied
    gone = {lines[index] for index in (*kept, *(pictures if covers else ()))}
    notes = [note for note in notes if note not in gone]
    start = later_timecode(timecode, frames[0], like.frame_rate)
    return copied, start, chapters, spatial, tuple(notes)


def _kinds(path: Path) -> dict[int, bytes]:
    """Return the four letters of the first sample entry of each track of an mp4 or mov, by the track's number."""
    moov = read_moov(path)
    found: dict[int, bytes] = {}
    for track in moov.children if moov is not None else ():
        header, table = track.find(b"tkhd"), sample_table(track)
        if header is not None and table is not None:
            at = 20 if header.payload[:1] == b"\1" else 12  # after times of 8 or 4 bytes each
            number = int.from_bytes(header.payload[at : at + 4], "big")
            found[number] = table.children[0].kind if table.children else table.payload[12:16]
    return found


def _moved(chapters: list[Any], like: Clip, frames: tuple[int, int]) -> tuple[dict[str, Any], ...]:
    """Return the chapters of a part of a clip, in milliseconds from its first frame."""
    begin, end = (Fraction(frame) / like.frame_rate for frame in frames)
    found: list[dict[str, Any]] = []
    for chapter in chapters:
        first, last = (
            max(begin, min(end, chapter[name] * fraction(chapter["time_base"]))) for name in ("start", "end")
        )
        if first < last:
            place = {"start": round(1000 * (first - begin)), "end": round(1000 * (last - begin))}
            found.append({**chapter, **place, "id": len(found) + 1, "time_base": Fraction(1, 1000)})
    return tuple(found)


def timecode_of(path: Path) -> str:
    """Return the time code of a video's first frame, "" where it has none or is no video."""
    if not path.is_file() or path.suffix.lower() in PICTURE_SUFFIXES:
        return ""
    return _timecode(path, path.stat().st_mtime_ns)


@shared(keep=8)
def _timecode(path: Path, written_ns: int) -> str:  # noqa: ARG001 - another file under the same name has another
    with open_packets(path) as container:
        return next(filter(None, map(_timecode_of, container.streams)), "")


def _timecode_of(stream: Any) -> str:
    """Return the time code of a track, "" without one; Matroska has its name in capitals."""
    return next((text for name, text in stream.metadata.items() if name.lower() == "timecode"), "")


def exr_attributes(like: Clip, index: int) -> dict[str, Any]:
    """Return the entries of an EXR header that say which frame of a clip it is, by the clip's own time code."""
    number, rate = index + like.first_number, like.frame_rate
    return frame_attributes(number, rate, later_timecode(timecode_of(like.path), index, rate))


def frame_attributes(index: int, frame_rate: Fraction, timecode: str = "") -> dict[str, Any]:
    """Return the header entries of a frame of a clip: frameNumber, framesPerSecond and timeCode.

    timecode: "hh:mm:ss:ff" of the frame, with ";" for drop frames; without one it is counted from 0 at frame 0. The
    entry holds frames up to 59: of faster clips it is left out.
    """
    import OpenEXR

    rate = frame_rate.limit_denominator(1001)
    found: dict[str, Any] = {"frameNumber": index, "framesPerSecond": rate}
    base = round(rate)
    if not 1 <= base <= _MOST_FRAMES or index < 0:
        return found
    told = timecode or later_timecode("00:00:00:00", index, rate)
    numbers = [int(told[at : at + 2]) for at in (0, 3, 6, 9)]
    drop = told[8] == ";"
    return {**found, "timeCode": OpenEXR.TimeCode(*numbers, drop, *[0] * 13)}


_MOST_FRAMES = 60
"""Frames a second that a time code counts (SMPTE ST 12-1)."""


def later_timecode(timecode: str, frames: int, rate: Fraction) -> str:
    """Return the time code of a later frame; "" where it is none.

    Frames are counted by the whole rate. With drop frames (";") two numbers of each minute, four of 60 a second, are
    left out, but of every tenth (SMPTE ST 12-1).
    """
    found = _TIMECODE.match(timecode)
    if found is None:
        return ""
    if not frames:
        return timecode
    hours, minutes, seconds, frame = (int(found[k]) for k in (1, 2, 3, 5))
    base = round(rate)
    dropped = round(base / 15) if found[4] == ";" else 0
    minute = 60 * hours + minutes
    count = (60 * minute + seconds) * base + frame - dropped * (minute - minute // 10) + frames
    ten = 600 * base - 9 * dropped
    tens, rest = divmod(count, ten)
    if dropped and rest >= 60 * base:
        count += dropped * (1 + (rest - 60 * base) // (60 * base - dropped))
    count += 9 * dropped * tens
    whole, frame = divmod(count, base)
    return f"{whole // 3600 % 24:02d}:{whole // 60 % 60:02d}:{whole % 60:02d}{found[4]}{frame:02d}"


_MARKS = (b"SA3D", b"SAND")
_ENTRY_HEADS = {0: 28, 1: 44, 2: 64}
"""Bytes of an audio sample entry before its boxes, by version (ISO/IEC 14496-12; QuickTime File Format: 1 and 2)."""
_VERSION_AT = 8


def embed_spatial(moov: Box, marks: tuple[bytes, ...]) -> None:
    """Put the marks of each audio track into a parsed 'moov' box that has the same tracks, where it has none."""
    for entry, mark in zip(_audio_entries(moov), marks, strict=False):
        if mark and not _marks(entry):
            entry.payload += mark


def _audio_entries(moov: Box) -> list[Box]:
    """Return the first sample entry of each audio track."""
    tables = map(sample_table, tracks_of(moov, b"soun"))
    return [table.children[0] for table in tables if table is not None and table.children]


def _marks(entry: Box) -> bytes:
    """Return the marks in an audio sample entry, as the bytes of their boxes; b"" for one without."""
    if len(entry.payload) < _ENTRY_HEADS[0]:
        return b""
    head = _ENTRY_HEADS.get(struct.unpack_from(">H", entry.payload, _VERSION_AT)[0], len(entry.payload))
    try:
        boxes = parse_boxes(entry.payload[head:])
    except ValueError:
        return b""
    return b"".join(box.serialised() for box in boxes if box.kind in _MARKS)
