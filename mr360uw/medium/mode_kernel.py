# SPDX-License-Identifier: Apache-2.0
"""Light of many modes along rays, compiled: most of the time that the tables of a new water take."""

from __future__ import annotations

from typing import Any

import numpy as np

from mr360uw.jit import exact

_ALL = 40.0
"""Exponent from which on what is left of 1 is below rounding."""


@exact
def sum_modes(
    source: Any, rate: Any, origin_m: Any, extinction: Any, mu: Any, which: Any, depth_m: Any, distance_m: Any,
    result: Any,
) -> None:  # fmt: skip
    """Set `result` (r, n) to the sum over the modes of `source` (d, n, j) times `closed_form.path_integral`.

    rate: (n, j), origin_m: (j,), extinction: (n,), mu: (d,). which: (r,) direction of each ray. depth_m, distance_m:
    (r,) of its start, and from there to its end. Depth and distance are in one exponential: by themselves, one may
    underflow where the other overflows.
    """
    for r in range(len(distance_m)):
        s, d = distance_m[r], which[r]
        for n in range(len(extinction)):
            total = 0.0
            for j in range(len(origin_m)):
                if source[d, n, j] != 0.0:
                    lost = (extinction[n] - rate[n, j] * mu[d]) * s
                    brightest = np.exp(-rate[n, j] * (depth_m[r] - origin_m[j]) - min(lost, 0.0))
                    lost = abs(lost)
                    mean = (1.0 if lost > _ALL else -np.expm1(-lost)) / lost if lost > 0.0 else 1.0
                    total += source[d, n, j] * brightest * mean
            result[r, n] = total * s
