# SPDX-License-Identifier: Apache-2.0
"""The sun of a clip's frames, measured a few times a second: waves move it with periods of seconds.

Between two measured frames that show the same, those in between are taken to lie on the way; where the picture changes,
all of them are measured, so that cuts are found to the frame.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, TypeVar

import numpy as np

from mr360uw.ibl.sun.track import PICTURE_CHANGE, SunMeasurement
from mr360uw.types.light_samples import sample_step

Frame = TypeVar("Frame")

_UNCHANGED = 0.5 * PICTURE_CHANGE
"""Change of the thumbnail up to which two measured frames show the same: half of that of a cut."""


class SunSeries(Generic[Frame]):
    """Measurements of successive frames. measure: measures one."""

    def __init__(self, measure: Callable[[Frame], SunMeasurement], frame_rate: float) -> None:
        self._measure, self._step = measure, sample_step(frame_rate)
        self._found: list[SunMeasurement] = []
        self._waiting: list[tuple[Frame, float]] = []

    def add(self, frame: Frame, index: int, time_s: float) -> None:
        """Add the next frame, of an index in the clip, shown at a time [s].

        Which frames are measured depends on the index alone, but that the first is.
        """
        if self._found and index % self._step:
            self._waiting.append((frame, time_s))
            return
        here = self._measure(frame)
        if self._waiting and _change(self._found[-1], here) > _UNCHANGED:
            self._measure_waiting()
        before = self._found[-1] if self._found else here
        self._found += [_between(before, here, passed_s) for _, passed_s in self._waiting]
        self._found.append(here)
        self._waiting = []

    def every(self) -> list[SunMeasurement]:
        """Return one measurement for each frame; those on the way between two have no sun of their own."""
        self._measure_waiting()
        return self._found

    def _measure_waiting(self) -> None:
        self._found += [self._measure(frame) for frame, _ in self._waiting]
        self._waiting = []


def _change(a: SunMeasurement, b: SunMeasurement) -> float:
    """Return the mean change of two frames' thumbnails."""
    return float(np.mean(np.abs(np.asarray(b.thumbnail) - np.asarray(a.thumbnail))))


def _between(a: SunMeasurement, b: SunMeasurement, time_s: float) -> SunMeasurement:
    """Return what a frame between two measured ones would show, without its sun."""
    share = (time_s - a.time_s) / (b.time_s - a.time_s)
    exposure = a.exposure ** (1.0 - share) * b.exposure**share
    thumbnail = (1.0 - share) * np.asarray(a.thumbnail) + share * np.asarray(b.thumbnail)
    return SunMeasurement(time_s, None, exposure, thumbnail)
