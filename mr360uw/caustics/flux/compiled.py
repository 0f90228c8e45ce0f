# SPDX-License-Identifier: Apache-2.0
"""Compilation of scalar kernels, kept on disk between runs."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from numba import njit

F = TypeVar("F", bound=Callable[..., object])


def compiled(function: F) -> F:
    """Return a function of numbers and arrays as machine code, compiled at its first call.

    It runs beside other threads; a division by zero gives infinity, as in NumPy.
    """
    kernel: F = njit(cache=True, nogil=True, error_model="numpy")(function)
    return kernel
