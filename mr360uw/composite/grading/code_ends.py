# SPDX-License-Identifier: Apache-2.0
"""Black and white of a grade from codes that pile up at one level: where the camera clipped before the grade.

A camera's codes end at black and white, and light beyond is held there. A grade moves both ends, and the held codes
with them: where the sun or its glow clip, or a channel is black, many pixels share one code while their other channels
differ. An evenly lit sky piles up in all channels at once, and says nothing. Neither does a pile that codes lie beyond,
as near 0 as files go: red of dim green water gathers about one level, and is not black there.

Saturation is told by nothing in a plate: it passes for another white balance of a camera.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mr360uw.types import Floats

LEAST_PILE = 1e-3
"""Least fraction of a picture's pixels in a pile. Half of it finds specular glints."""
STEEP = 3.0
"""Least ratio of a pile to what the codes below it would make of it."""
_HALF = 2
"""Half width [8-bit codes] of a pile: rounding, the encoder and chroma at half resolution spread it."""
_BESIDE = 10
"""Number of 8-bit codes below a pile that it is compared with, two codes away from it."""
_REACH = 12
"""Distance [8-bit codes] of a pile from a channel's last codes: overshoot of chroma reaches so far."""
_OVER = 2e-4
"""Fraction of a channel's values that are taken for specks beyond its end."""
_OTHERS = 0.02
"""Largest fraction of another channel's values beyond the end: all channels have one, but chroma overshoots."""
LEAST_SPREAD = 8.0
"""Least difference [8-bit codes] between the quartiles of another channel within a pile."""
LEAST_MOVE = 6.0
"""Distance [8-bit codes] from 0 and 255 from which an end has been moved: above it is overshoot."""
_MOST_MOVE = 110.0
"""Distance [8-bit codes] beyond which a pile is no end of the codes."""


def code_ends(pictures: Sequence[Floats]) -> tuple[float | None, float | None]:
    """Return the codes, 0 to 1, of black and of white where a clip's codes end away from 0 and 1; None where not told.

    pictures: R'G'B' (n, 3) of pixels of its frames, 0 black and 1 white, not clipped.
    """
    codes = 255.0 * np.concatenate(pictures)
    black_kept, white_kept = ends_kept(pictures)
    low, high = None if black_kept else _moved_end(255.0 - codes), None if white_kept else _moved_end(codes)
    return None if low is None else 1.0 - low / 255.0, None if high is None else high / 255.0


def ends_kept(pictures: Sequence[Floats]) -> tuple[bool, bool]:
    """Return whether codes near 0 show that black was not lifted, and codes near 255 that white was not lowered.

    pictures: as of `code_ends`. False says nothing: water lifts what is far away, and few dives hold anything white.
    """
    codes = 255.0 * np.concatenate(pictures)
    lowest, highest = np.quantile(codes, (LEAST_PILE, 1.0 - LEAST_PILE), axis=0)
    return bool(lowest.min() < LEAST_MOVE), bool(highest.max() > 255.0 - LEAST_MOVE)


def _moved_end(codes: Floats) -> float | None:
    """Return the 8-bit code at which values (n, 3) pile up at their upper end, away from 255."""
    steepness, end = max(_pile(codes, channel) for channel in range(3))
    if steepness < STEEP or not LEAST_MOVE <= 255.0 - end <= _MOST_MOVE:
        return None
    beyond = np.mean(codes > end + 2 * _REACH, axis=0)
    return end if float(beyond.max()) <= _OTHERS else None


def _pile(codes: Floats, channel: int) -> tuple[float, float]:
    """Return how steep the pile at the upper end of a channel of values (n, 3) is, 0 for none, and its 8-bit code."""
    own = codes[:, channel]
    top = round(float(np.quantile(own, 1.0 - _OVER)))
    first = top - _REACH - _HALF - 2 - _BESIDE
    counts = np.histogram(own, np.arange(first, top + _HALF + 2) - 0.5)[0]
    held = np.convolve(counts, np.ones(2 * _HALF + 1), "same")
    begin = _BESIDE + _HALF + 2
    place = begin + int(np.argmax(held[begin:]))
    below = counts[place - _HALF - 2 - _BESIDE : place - _HALF - 2]
    expected = max(float(below.sum()) * (2 * _HALF + 1) / _BESIDE, 1.0)
    inside = np.abs(own - (first + place)) <= _HALF + 0.5
    if held[place] < LEAST_PILE * len(own):
        return 0.0, 0.0
    quartiles = np.quantile(np.delete(codes[inside], channel, axis=1), (0.25, 0.75), axis=0)
    spread = float((quartiles[1] - quartiles[0]).max())
    return (float(held[place]) / expected if spread >= LEAST_SPREAD else 0.0), float(np.median(own[inside]))
