# SPDX-License-Identifier: Apache-2.0
"""The veil's gain over a clip, measured a few times a second: it follows the exposure, and else moves over seconds.

Between two measured frames that show the same at the same exposure, those in between are taken to lie on the way; where
exposure or picture change, all of them are measured, so that steps and cuts are found to the frame.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from mr360uw.medium.fit.exposure import UNCHANGED, exposure_change, picture_change, shot_starts, steady_gain
from mr360uw.types import Floats
from mr360uw.types.light_samples import sample_step

Frame = TypeVar("Frame")


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredGain:
    """The gain (3,) of one frame and the residual of its fit (`level.fit_level`). shown: small linear map (h, w, 3)."""

    gain: Floats
    residual: float
    shown: Floats


class GainSeries(Generic[Frame]):
    """Gains of successive frames. measure: measures one."""

    def __init__(self, measure: Callable[[Frame], MeasuredGain], frame_rate: float) -> None:
        self._measure, self._rate, self._step = measure, frame_rate, sample_step(frame_rate)
        self._last: MeasuredGain | None = None
        self._waiting: list[Frame] = []
        self._gains: list[Floats] = []
        self._changes: list[tuple[float, float]] = []
        self.residuals: list[float] = []
        """Residual of each frame, after `steady`."""

    def add(self, frame: Frame, index: int) -> None:
        """Add the next frame, of an index in the clip; that alone says which frames are measured, after the first."""
        if self._last is not None and index % self._step:
            self._waiting.append(frame)
            return
        here = self._measure(frame)
        if self._waiting and self._last is not None:
            last, count = self._last, len(self._waiting) + 1
            moved = picture_change(last.shown, here.shown)
            if moved > UNCHANGED or exposure_change(last.shown, here.shown) != 0.0:
                self._measure_waiting()
            else:
                for share in np.arange(1, count) / count:
                    gain = (1.0 - share) * last.gain + share * here.gain
                    self._append(gain, (1.0 - share) * last.residual + share * here.residual, (0.0, moved / count))
                self._append(here.gain, here.residual, (0.0, moved / count))
                self._last, self._waiting = here, []
                return
        self._append_measured(here)

    def steady(self) -> Floats:
        """Return the smoothed gain (N, 3) of every frame; see `exposure.steady_gain`."""
        self._measure_waiting()
        exposure, picture = zip(*self._changes, strict=True)
        return steady_gain(self._gains, exposure, picture, self._rate)

    def cuts(self) -> NDArray[np.int64]:
        """Return the frames that begin a shot, counted from the first one; after `steady`."""
        return shot_starts([picture for _, picture in self._changes])

    def _measure_waiting(self) -> None:
        for frame in self._waiting:
            self._append_measured(self._measure(frame))
        self._waiting = []

    def _append_measured(self, here: MeasuredGain) -> None:
        before = here if self._last is None else self._last
        changes = exposure_change(before.shown, here.shown), picture_change(before.shown, here.shown)
        self._append(here.gain, here.residual, changes)
        self._last = here

    def _append(self, gain: Floats, residual: float, changes: tuple[float, float]) -> None:
        self._gains.append(gain)
        self.residuals.append(residual)
        self._changes.append(changes)
