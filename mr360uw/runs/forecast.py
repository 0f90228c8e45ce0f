# SPDX-License-Identifier: Apache-2.0
"""Forecast of a run's time and disk space, from the rate and the bytes of its first frames."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterable
from pathlib import Path

from mr360uw.reading.numbered_files import numbered
from mr360uw.runs.outputs import Output
from mr360uw.runs.work_folder import WorkFolder

_MEASURED_S = 5.0
"""Time [s] over which the rate is measured at least."""
_LONG_S = 60.0
"""Time left [s] from which on a run gets a forecast; shorter ones are over before it is read."""


def forecaster(tell: Callable[[str], None], output: Output, work: WorkFolder, left: int) -> Callable[[], None]:
    """Return a function that counts a frame, and tells once, after a few seconds, how long the run will take.

    It tells when a part is complete, if the run is a long one. tell: gets the line. left: frames to render.
    """
    done, began, told = 0, 0.0, False

    def frame_done() -> None:
        nonlocal done, began, told
        done += 1
        if done == 1:  # the first frame compiles and uploads: it says nothing about the others
            began = time.perf_counter()
        seconds = time.perf_counter() - began
        if told or seconds < _MEASURED_S:
            return
        written, frames = _written(output, work)
        if frames == 0:
            return
        told, rate = True, (done - 1) / seconds
        if (left - done) / rate >= _LONG_S:
            total = output.span[1] - output.span[0]
            # segments and the file that they are joined into lie side by side at the end
            copies = 1 if output.is_pictures else 2
            size = written / frames * total
            free = shutil.disk_usage(work.path).free
            tell(forecast_line(left - done, rate, size, copies * size - written, free))

    return frame_done


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
