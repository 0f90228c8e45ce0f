# SPDX-License-Identifier: Apache-2.0
"""Sound, copied packet by packet: not decoded, not encoded again."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import av.error

from mr360uw.errors import VideoError


class AudioCopy:
    """Moves the audio packets of one file into an output container, as far as the pictures have come.

    Times are in seconds on the clock of the input file. All packets of a whole clip keep their time stamps; of a part,
    those that begin within it are kept and moved with the pictures.
    """

    def __init__(self, source: Path, target: Any) -> None:
        self._closing = ExitStack()
        self._container = self._closing.enter_context(av.open(str(source), metadata_errors="replace"))
        self._target = target
        self._streams: dict[int, Any] = {}
        try:
            for stream in self._container.streams.audio:
                self._streams[stream.index] = target.add_stream_from_template(stream)
                self._streams[stream.index].metadata.update(stream.metadata)
        except (av.error.FFmpegError, ValueError) as error:
            self.close()
            raise VideoError(
                f"{source} - its sound does not fit this kind of output (got {error}) - write .mov or .mkv"
            ) from error
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
