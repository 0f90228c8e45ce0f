# SPDX-License-Identifier: Apache-2.0
"""Light of many modes along rays, compiled: most of the time that the tables of a new water take."""

from __future__ import annotations

from typing import Any

import numpy as np

from mr360uw.jit import exact

_LEAST = 0.02
"""Exponent from which on 1 - exp(-x) keeps 14 digits; below, seven terms of its series have 16."""


@exact
def _mean(x: float) -> float:
    """Return the mean of exp(-x t) for t from 0 to 1: (1 - exp(-x))/x for a small x."""
    return 1.0 - x / 2.0 * (1.0 - x / 3.0 * (1.0 - x / 4.0 * (1.0 - x / 5.0 * (1.0 - x / 6.0 * (1.0 - x / 7.0)))))


@exact
def sum_modes(
    source: Any, rate: Any, origin_m: Any, extinction: Any, mu: Any, which: Any, depth_m: Any, distance_m: Any,
    result: Any,
) -> None:  # fmt: skip
    """Set `result` (r, n) to the sum over the modes of `source` (d, n, j) times `closed_form.path_integral`.

    rate: (n, j), origin_m: (j,), extinction: (n,), mu: (d,). which: (r,) direction of each ray. depth_m, distance_m:
    (r,) of its start, and from there to its end. Depth and distance are in one exponential: by themselves, one may
    underflow where the other overflows. Rays of one depth that follow one another are the fastest.
    """
    begun, power = np.empty(rate.shape), np.empty(rate.shape)
    for r in range(len(distance_m)):
        s, d = distance_m[r], which[r]
        if r == 0 or depth_m[r] != depth_m[r - 1]:
            for n in range(rate.shape[0]):
                for j in range(rate.shape[1]):
                    power[n, j] = -rate[n, j] * (depth_m[r] - origin_m[j])
                    begun[n, j] = np.exp(power[n, j])
        for n in range(len(extinction)):
            total = 0.0
            for j in range(len(origin_m)):
                if source[d, n, j] != 0.0:
                    lost = (extinction[n] - rate[n, j] * mu[d]) * s
                    if abs(lost) < _LEAST:
                        total += source[d, n, j] * begun[n, j] * _mean(lost)
                    else:
                        total += source[d, n, j] * (begun[n, j] - np.exp(power[n, j] - lost)) / lost
            result[r, n] = total * s
