# SPDX-License-Identifier: Apache-2.0
"""Copies sound and data packet by packet, without decoding them."""

from __future__ import annotations

import io
import itertools
from collections.abc import Iterator
from contextlib import ExitStack
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import av.error

from mr360uw.errors import VideoError
from mr360uw.video.read.probe import open_packets

CONTAINERS = {".mp4": "mp4", ".m4v": "mp4", ".mov": "mov", ".mkv": "matroska", ".webm": "webm"}
"""FFmpeg's names of the kinds of output, by suffix."""
_ADVISED = (".mp4", ".mov", ".mkv")
_TRIAL_PACKETS = 16


def check_sound(source: Path, target: Path) -> None:
    """Raise `VideoError` where the kind of output that `target` names cannot hold the sound of `source`."""
    if _holds(source, target.suffix.lower()):
        return
    with open_packets(source) as container:
        contexts = [stream.codec_context for stream in container.streams.audio]
        kinds = sorted({f"{context.codec.canonical_name}, {context.layout.name}" for context in contexts})
    others = [suffix for suffix in _ADVISED if _holds(source, suffix)]
    better = f"write {' or '.join(others)}, or set output.sound = false" if others else "set output.sound = false"
    raise VideoError(
        f"{target} - {target.suffix} cannot hold the sound of {source.name} (got {', '.join(kinds)}) - {better}"
    )


def _holds(source: Path, suffix: str) -> bool:
    """Return whether a container takes the first packets of a file's sound.

    It is completed, in memory: some sound is refused only then, as PCM without a layout of its channels by MP4.
    """
    try:
        with ExitStack() as closing:
            container = closing.enter_context(open_packets(source))
            trial = closing.enter_context(av.open(io.BytesIO(), "w", format=CONTAINERS[suffix]))
            streams = {s.index: trial.add_stream_from_template(s) for s in container.streams.audio}
            trial.start_encoding()
            for packet in itertools.islice(container.demux(audio=list(range(len(streams)))), _TRIAL_PACKETS):
                if packet.dts is not None:
                    packet.stream = streams[packet.stream_index]
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
            if packet.dts is not None and (start_s is None or packet.pts * packet.time_base >= start_s)
        )
        self._pending = next(self._packets, None)

    def advance(self, until_s: Fraction | None) -> None:
        """Copy the packets that begin before `until_s`, or all that are left."""
        while self._pending is not None and (until_s is None or self._pending.dts * self._pending.time_base < until_s):
            packet, self._pending = self._pending, next(self._packets, None)
            ticks = round(self._shift_s / packet.time_base)
            packet.pts -= ticks
            packet.dts -= ticks
            packet.stream = self._streams[packet.stream_index]
            self._target.mux(packet)

    def close(self) -> None:
        """Close the input file."""
        self._closing.close()
