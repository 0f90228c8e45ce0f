# SPDX-License-Identifier: Apache-2.0
"""Bound on the ambient light that a body can block on level ground."""

from __future__ import annotations

from typing import Any

import numpy as np

from mr360uw.jit import inlined


@inlined
def most_blocked(squared: Any, beside: Any, wide_squared: Any, highest: Any) -> Any:
    """Return a bound on the fraction of uniform light that a body blocks: all azimuths of the circle around its plan,
    up to the largest elevation.

    squared, beside, wide_squared: squares of the horizontal distances to the plan's middle and to the plan, and of the
    circle's radius [m^2]. highest: height of the body's upper end above the ground [m].
    """
    if highest <= 0.0:
        return 0.0
    turn = np.arcsin(np.sqrt(wide_squared / squared)) / np.pi if squared > wide_squared else 1.0
    return turn * highest * highest / (beside + highest * highest)
