# SPDX-License-Identifier: Apache-2.0
"""Linear light as 8-bit sRGB, by a table, in one compiled pass."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.color import encode
from mr360uw.jit import exact

_STEPS = 1 << 14
"""Steps of the table over the square root of light: 45 for the narrowest code value, so that one pixel in 45 at most
differs from exact rounding, by one code value."""


@cache
def _table() -> NDArray[np.uint8]:
    light = (np.arange(_STEPS + 1) / _STEPS) ** 2
    return np.round(255.0 * encode(light, "srgb")).astype(np.uint8)


def screen_codes(linear: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return linear light (H, W, 3) as 8-bit sRGB; light above 1 is white, below 0 black."""
    codes = np.empty(linear.shape, np.uint8)
    _encode(np.ascontiguousarray(linear, np.float32).reshape(-1), _table(), codes.reshape(-1))
    return codes


@exact
def _encode(linear: Any, table: Any, codes: Any) -> None:
    steps = np.float32(_STEPS)
    for i in range(linear.size):
        light = min(max(linear[i], np.float32(0.0)), np.float32(1.0))
        codes[i] = table[int(math.sqrt(light) * steps + np.float32(0.5))]
