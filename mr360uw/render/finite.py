# SPDX-License-Identifier: Apache-2.0
"""Refuses results of a frame that hold a NaN or an infinity, before they reach a file."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from typing import TypeVar

import numpy as np

from mr360uw.errors import RenderError

T = TypeVar("T")


def finite(stage: str, index: int, result: T) -> T:
    """Return a stage's result; raise `RenderError` if `not_finite` finds anything in it."""
    refuse(stage, index, not_finite(result))
    return result


def refuse(stage: str, index: int, found: str) -> None:
    """Raise `RenderError` for the result of a frame in which `not_finite` found something."""
    if found:
        raise RenderError(
            f"frame {index} - the {stage} has numbers that are not finite (got {found}) - please report it with the "
            "scene file"
        )


def not_finite(result: object) -> str:
    """Return where an array of floats in a result has a NaN or an infinity; "" where none has. Distances may.

    result: a dataclass or a tuple, which may hold others. Sums are tested first: 13 ms for a layer that covers all of
    3840 x 1920.
    """
    if isinstance(result, tuple):
        return next(filter(None, map(not_finite, result)), "")
    for field in fields(result) if is_dataclass(result) else ():
        values = getattr(result, field.name)
        if (is_dataclass(values) or isinstance(values, tuple)) and (inner := not_finite(values)):
            return inner
        if not isinstance(values, np.ndarray) or values.dtype.kind != "f" or field.name == "distance_m":
            continue
        with np.errstate(all="ignore"):
            total = values.sum()
        if not np.isfinite(total) and not np.all(np.isfinite(values)):
            return f"{np.sum(~np.isfinite(values))} of {values.size} in {field.name}"
    return ""
