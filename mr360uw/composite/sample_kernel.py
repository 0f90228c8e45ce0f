# SPDX-License-Identifier: Apache-2.0
"""Means and second moments of groups of samples, compiled: see `sampling`."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mr360uw.jit import exact

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@exact
def find_nearest(cells: Array, member: Mask, among: Mask, found: NDArray[np.int64]) -> None:
    """Write the index (n,) of the sample of `among` (n, s) nearest to the mean of members (n, s).

    cells: (s, 2) whole numbers, so that ties are exact; the first of equals is taken.
    """
    for n in range(len(member)):
        count, sum_x, sum_y = 0.0, 0.0, 0.0
        for k in range(len(cells)):
            if member[n, k]:
                count += 1.0
                sum_x += cells[k, 0]
                sum_y += cells[k, 1]
        least, found[n] = math.inf, 0
        for k in range(len(cells)):
            if among[n, k]:
                x, y = cells[k, 0], cells[k, 1]
                value = count * (x * x + y * y) - 2.0 * (sum_x * x + sum_y * y)
                if value < least:
                    least, found[n] = value, k


@exact
def write_areas(positions: Array, member: Mask, nearest: NDArray[np.int64], areas: Array) -> None:
    """Write `sampling.frame_areas` (n, 5) of members (n, s) at positions (s, 2)."""
    own = 1.0 / (12.0 * len(positions))
    for n in range(len(member)):
        count, sum_x, sum_y, sum_xx, sum_xy, sum_yy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(len(positions)):
            if member[n, k]:
                x, y = positions[k, 0], positions[k, 1]
                count += 1.0
                sum_x += x
                sum_y += y
                sum_xx += x * x
                sum_xy += x * y
                sum_yy += y * y
        mean_x, mean_y = sum_x / count, sum_y / count
        xx, yy = sum_xx / count - mean_x * mean_x + own, sum_yy / count - mean_y * mean_y + own
        xy = sum_xy / count - mean_x * mean_y
        root = math.sqrt(max(xx * yy - xy * xy, own * own))
        scale = math.sqrt(12.0 / (xx + yy + 2.0 * root))
        areas[n, 0], areas[n, 1] = mean_x - positions[nearest[n], 0], mean_y - positions[nearest[n], 1]
        areas[n, 2], areas[n, 3], areas[n, 4] = (xx + root) * scale, xy * scale, (yy + root) * scale


@exact
def read_groups(
    shown: NDArray[np.float32], word_bits: int, pixel: NDArray[np.int64], number: NDArray[np.int64], member: Mask,
    weight: Array, first: NDArray[np.int64], covered: Mask,
) -> None:  # fmt: skip
    """Write the groups (m,) of pixels (n, groups, 1 + words), a number plus 1, or 0 for none, and words of `word_bits`
    bits each: their pixel, number, members (m, s) and share of the samples; and of the p pixels that have any the first
    group (p,) and the covered samples (p, s).
    """
    found, there, samples = 0, 0, member.shape[1]
    for n in range(len(shown)):
        begun = found
        for group in range(shown.shape[1]):
            if shown[n, group, 0] == 0.0:
                continue
            pixel[found], number[found], count = n, np.int64(shown[n, group, 0]) - 1, 0
            for word in range(shown.shape[2] - 1):
                bits = np.int64(shown[n, group, 1 + word])
                for k in range(word * word_bits, min((word + 1) * word_bits, samples)):
                    inside = bits & 1 == 1
                    bits >>= 1
                    member[found, k] = inside
                    count += inside
                    covered[there, k] = inside or (found > begun and covered[there, k])
            weight[found] = count / samples
            found += 1
        if found > begun:
            first[there] = begun
            there += 1


@exact
def find_clear(free: Mask, near: Mask, clear: Mask) -> None:
    """Write which of the free samples (n, s) have the fewest others around them that are not, `near` (s, s)."""
    samples = free.shape[1]
    around = np.empty(samples, np.int64)
    for n in range(len(free)):
        least = samples + 1
        for k in range(samples):
            around[k] = samples + 1
            if free[n, k]:
                around[k] = 0
                for other in range(samples):
                    around[k] += near[k, other] and not free[n, other]
                least = min(least, around[k])
        for k in range(samples):
            clear[n, k] = free[n, k] and around[k] == least
