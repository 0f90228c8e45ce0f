# SPDX-License-Identifier: Apache-2.0
"""Open water over a clip: looked for every two seconds, averaged over some more, interpolated in between.

What swims by hides other directions in the next seconds, so that the mean over a few looks knows more of them than one.
The gain of the veil has the clip's exposure; the ratio to it changes slowly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mr360uw.medium.fit.open_water import OpenWater, mean_log_ratio
from mr360uw.types import Floats

_STEP_S = 2.0
"""Time [s] between two looks: the sea's colour in a direction lasts longer, unless the camera turns unknown."""
_KERNEL = np.array([1.0, 2.0, 3.0, 2.0, 1.0]) / 3.0
"""Weights of neighbouring looks: over 4 s on either side, within the margin that the first pass reads."""


@dataclass(frozen=True, slots=True, eq=False)
class OpenWaterTrack:
    """Ratio of a clip's open water to its veil.

    index: (K,) frames of the clip, ascending. log_ratio: (K, ROWS, COLUMNS, 3) its logarithm there, float16. cuts: (C,)
    frames of the clip that begin a shot.
    """

    index: NDArray[np.int64]
    log_ratio: NDArray[np.float16]
    cuts: NDArray[np.int64]

    def ratio_at(self, index: int) -> NDArray[np.float32] | None:
        """Return the ratio (ROWS, COLUMNS, 3) of a frame, None in a shot that was not looked at."""
        here = np.flatnonzero(self._shot(self.index) == self._shot(np.array([index])))
        if len(here) == 0:
            return None
        place = float(np.interp(index, self.index[here], np.arange(len(here))))
        before = int(place)
        after, share = min(before + 1, len(here) - 1), np.float32(place - before)
        one, other = (self.log_ratio[here[k]].astype(np.float32) for k in (before, after))
        return np.exp((1.0 - share) * one + share * other)

    def _shot(self, index: NDArray[np.int64]) -> NDArray[np.int64]:
        return np.searchsorted(self.cuts, index, side="right")


class OpenWaterLooks:
    """Looks at the open water of a clip, in its frames' order."""

    def __init__(self, frame_rate: float) -> None:
        self._step = max(round(_STEP_S * frame_rate), 1)
        self._index: list[int] = []
        self._looks: list[OpenWater] = []

    def due(self, index: int) -> bool:
        """Return whether frame `index` of the clip is looked at; that depends on the index alone."""
        return index % self._step == 0

    def add(self, index: int, look: OpenWater) -> None:
        """Add the open water of a frame that is due."""
        self._index.append(index)
        self._looks.append(look)

    def track(self, gain: Floats, first: int, cuts: NDArray[np.int64]) -> OpenWaterTrack | None:
        """Return the track for a steady gain (N, 3) of frames `first` and on; None without a look.

        cuts: (C,) places in it that begin a shot.
        """
        if not self._index:
            return None
        index, cuts = np.array(self._index), cuts + first
        shot, half = np.searchsorted(cuts, index, side="right"), len(_KERNEL) // 2
        maps = []
        for k in range(len(index)):
            near = [j for j in range(max(k - half, 0), min(k + half + 1, len(index))) if shot[j] == shot[k]]
            share = [_KERNEL[j - k + half] for j in near]
            looks, gains = [self._looks[j] for j in near], [gain[index[j] - first] for j in near]
            maps.append(mean_log_ratio(looks, gains, share))
        return OpenWaterTrack(index, np.array(maps, np.float16), cuts)
