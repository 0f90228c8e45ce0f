# SPDX-License-Identifier: Apache-2.0
"""Light of many modes along rays, compiled: most of the time that the tables of a new water take."""

from __future__ import annotations

from typing import Any

import numpy as np

from mr360uw.jit import exact, fast

_LEAST = 0.02
"""Exponent from which on 1 - exp(-x) keeps 14 digits; below, seven terms of its series have 16."""
_LOG2_E = 1.4426950408889634
_LN2_HIGH = 0.693147180369123816490
"""ln(2) but for `_LN2_LOW`, with so few digits that its products with whole numbers are exact."""
_LN2_LOW = 1.90821492927058770002e-10
_ROUNDS = 1.5 * 2.0**52
"""A number so large that a whole number added to it stands in its last bits."""


@exact
def _mean(x: float) -> float:
    """Return the mean of exp(-x t) for t from 0 to 1: (1 - exp(-x))/x for a small x."""
    return 1.0 - x / 2.0 * (1.0 - x / 3.0 * (1.0 - x / 4.0 * (1.0 - x / 5.0 * (1.0 - x / 6.0 * (1.0 - x / 7.0)))))


@exact
def _exp(x: float) -> float:
    """Return exp(x) to the last digit or two, for x below 700; 1e-304 from -700 down.

    2^k exp(r) with r below ln(2)/2, without a branch or a call, so that it runs for several modes at a time.
    """
    x = max(x, -700.0)
    k = np.floor(x * _LOG2_E + 0.5)
    r = (x - k * _LN2_HIGH) - k * _LN2_LOW
    high = 1.0 / 40320.0 + r * (1.0 / 362880.0 + r * (1.0 / 3628800.0 + r * (1.0 / 39916800.0 + r / 479001600.0)))
    low = 1.0 / 24.0 + r * (1.0 / 120.0 + r * (1.0 / 720.0 + r * (1.0 / 5040.0 + r * high)))
    power: Any = np.int64((np.float64(k + _ROUNDS).view(np.int64) + np.int64(1023)) << np.int64(52))
    return (1.0 + r * (1.0 + r * (1.0 / 2.0 + r * (1.0 / 6.0 + r * low)))) * power.view(np.float64)


@fast
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
                    begun[n, j] = _exp(power[n, j])
        for n in range(len(extinction)):
            total = 0.0
            for j in range(len(origin_m)):
                lost = (extinction[n] - rate[n, j] * mu[d]) * s
                small = abs(lost) < _LEAST
                change = (begun[n, j] - _exp(power[n, j] - lost)) / (1.0 if small else lost)
                total += source[d, n, j] * (begun[n, j] * _mean(lost) if small else change)
            result[r, n] = total * s
