# SPDX-License-Identifier: Apache-2.0
"""Compiled loops of `grain`: white noise and block statistics; serial, outside Python's lock.

Noise is a hash of the pixel's place, its plane and the frame's index, so any rectangle of any frame can be had by
itself (counter-based, as Salmon 2011). The hash is the finaliser of SplitMix64 (Steele 2014, variant 13). Four of its
16-bit pieces add up to a nearly normal number that is never beyond 3.5 standard deviations.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mr360uw.jit import fast, inlined

_DEVIATION = np.float32(np.sqrt((2.0**32 - 1.0) / 3.0))
"""Standard deviation of the sum of four independent integers, each even over [0, 2^16)."""


@inlined
def _mixed(z: Any) -> Any:
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@fast
def white_noise(frame: int, plane: int, row: int, column: int, columns: int, out: Any) -> None:
    """Write noise of mean 0 and variance 1 into `out` (h, w); it repeats after `columns` columns."""
    step, low = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xFFFF)
    stream = _mixed(np.uint64(frame) * step + np.uint64(plane + 1))
    for r in range(out.shape[0]):
        along = _mixed(stream + np.uint64(row + r + (1 << 32)) * step)
        for c in range(out.shape[1]):
            z = _mixed(along + np.uint64((column + c) % columns) * step)
            total = (z & low) + ((z >> np.uint64(16)) & low) + ((z >> np.uint64(32)) & low) + (z >> np.uint64(48))
            out[r, c] = (np.float32(total) - np.float32(131070.0)) / _DEVIATION


@fast
def survey(blocks: Any, out: Any) -> None:
    """Write (lowest value, highest value, mean, roughness) of blocks (n, h, w) into `out` (n, 4).

    Roughness is the energy of the second differences, lags 1, 2 and 4, both ways.
    """
    count, height, width = blocks.shape
    for n in range(count):
        block = blocks[n]
        low, high, total, rough = block[0, 0], block[0, 0], np.float32(0.0), np.float32(0.0)
        for r in range(height):
            for c in range(width):
                low, high, total = min(low, block[r, c]), max(high, block[r, c]), total + block[r, c]
        for lag in (1, 2, 4):
            for r in range(lag, height - lag):
                for c in range(lag, width - lag):
                    twice = np.float32(2.0) * block[r, c]
                    across = block[r, c - lag] - twice + block[r, c + lag]
                    down = block[r - lag, c] - twice + block[r + lag, c]
                    rough += across * across + down * down
        out[n, 0], out[n, 1], out[n, 2], out[n, 3] = low, high, total / np.float32(height * width), rough
