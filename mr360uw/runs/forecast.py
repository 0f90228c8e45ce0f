# SPDX-License-Identifier: Apache-2.0
"""Forecast of a run's time and disk space, from the rate and the bytes of its first frames."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from mr360uw.reading.numbered_files import numbered
from mr360uw.runs.outputs import Output
from mr360uw.runs.work_folder import WorkFolder

_MEASURED_S = 5.0
"""Time [s] over which the rate is measured at least."""
_LONG_S = 60.0
"""Time left [s] from which on a run gets a forecast; shorter ones are over before it is read."""


@dataclass(slots=True)
class Forecast:
    """Tells once how long a run will take and what it will write; tell: gets the line. left: frames to render."""

    tell: Callable[[str], None]
    output: Output
    work: WorkFolder
    left: int
    _done: int = 0
    _began: float = 0.0
    _told: bool = False

    def frame_done(self) -> None:
        """Count a frame; after a few seconds, when a part is complete, tell the forecast if the run is a long one."""
        self._done += 1
        if self._told:
            return
        if self._done == 1:  # the first frame compiles and uploads: it says nothing about the others
            self._began = time.perf_counter()
            return
        seconds = time.perf_counter() - self._began
        if seconds < _MEASURED_S:
            return
        written, frames = _written(self.output, self.work)
        if frames == 0:
            return
        self._told = True
        rate = (self._done - 1) / seconds
        if (self.left - self._done) / rate >= _LONG_S:
            total = self.output.span[1] - self.output.span[0]
            # segments and the file that they are joined into lie side by side at the end
            copies = 1 if self.output.is_pictures else 2
            size = written / frames * total
            free = shutil.disk_usage(self.work.path).free
            self.tell(forecast_line(self.left - self._done, rate, size, copies * size - written, free))


def forecast_line(left: int, rate: float, size: float, needed: float, free: float) -> str:
    """Return a forecast in words. left: frames. rate: frames/s. size: of the output, needed, free: bytes on disk."""
    space = f"needs {_bytes(needed)} more while it is made"
    space += f", and only {_bytes(free)} are free" if needed > free else f" ({_bytes(free)} are free)"
    return f"about {_duration(left / rate)} for {left} frames at {rate:.2g} frames/s; writes {_bytes(size)}, {space}"


def _written(output: Output, work: WorkFolder) -> tuple[int, int]:
    """Return the bytes of the frames that are complete, and their number."""
    layers = output.layers
    if output.is_pictures:
        done = work.pictures()
        files = [output.picture(index) for index in done]
    else:
        segments = work.segments()
        files = [segment.data for segment in segments]
        done = {index for segment in segments for index in range(segment.start, segment.stop)}
    if layers is not None:
        files += [numbered(layers, index) for index in done]
    return _total(files), len(done)


def _total(files: Iterable[Path]) -> int:
    return sum(file.stat().st_size for file in files if file.exists())


def _bytes(size: float) -> str:
    return f"{size / 1e9:.1f} GB" if size >= 1e9 else f"{max(size, 0.0) / 1e6:.0f} MB"


def _duration(seconds: float) -> str:
    minutes = round(seconds / 60.0)
    return f"{minutes // 60} h {minutes % 60} min" if minutes >= 60 else f"{minutes} min"
