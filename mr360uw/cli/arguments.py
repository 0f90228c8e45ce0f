# SPDX-License-Identifier: Apache-2.0
"""Text of the command line as values."""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from enum import StrEnum
from typing import TYPE_CHECKING, Literal

from mr360uw.errors import ParameterError

if TYPE_CHECKING:
    from mr360uw.preview.perspective import Perspective


class EyeName(StrEnum):
    """Eyes of a stereo plate."""

    left = "left"
    right = "right"


class ImageFormat(StrEnum):
    """File formats of exported maps."""

    png = "png"
    exr = "exr"


def frame_range(text: str | None) -> tuple[int, int | None]:
    """Return (start, stop) of 'a:b'; a single number k means k:k+1."""
    if text is None:
        return 0, None
    head, colon, tail = text.partition(":")
    try:
        start = int(head) if head or not colon else 0
        stop = (int(tail) if tail else None) if colon else start + 1
    except ValueError:
        raise ParameterError(f"--frames - is not a range (got {text!r}) - write a:b, as in 0:48") from None
    if start < 0 or (stop is not None and stop <= start):
        raise ParameterError(f"--frames - is empty or negative (got {text!r}) - write a:b with 0 <= a < b")
    return start, stop


def worker_count(text: str) -> int | Literal["auto"]:
    """Return the number of processes of `--workers`."""
    if text == "auto":
        return "auto"
    if not text.isdecimal() or int(text) < 1:
        raise ParameterError(f"--workers - is no number of processes (got {text!r}) - give 1 or more, or auto")
    return int(text)


def view_of(text: str | None, size: str) -> Perspective | None:
    """Return the view of 'yaw,pitch,fov' in degrees, whose end may be left out, and of a size '1280x720'."""
    if text is None:
        return None
    from mr360uw.preview.perspective import Perspective

    try:
        angles = [float(part) for part in text.split(",")]
        width, height = (int(part) for part in size.lower().split("x"))
    except ValueError:
        raise ParameterError(
            f"--view, --size - are no view (got {text!r}, {size!r}) - write yaw,pitch,fov in degrees, as in 30,-10,75, "
            "and 1280x720"
        ) from None
    if len(angles) > 3:
        raise ParameterError(f"--view - has too many numbers (got {text!r}) - write yaw,pitch,fov, as in 30,-10,75")
    return Perspective(
        **dict(zip(("yaw_deg", "pitch_deg", "fov_deg"), angles, strict=False)), width=width, height=height
    )


def variants(overrides: Sequence[str]) -> list[tuple[str, ...]]:
    """Return the combinations of 'key=a,b,c' overrides; the last key varies fastest, commas within [ ] do not split."""
    choices = []
    for text in overrides:
        key, equals, values = text.partition("=")
        if not equals or not values.strip():
            raise ParameterError(
                f"--set - is no override (got {text!r}) - write key=value,value, as in water.type=IB,II"
            )
        choices.append([f"{key}={value.strip()}" for value in re.split(r",(?![^\[]*\])", values)])
    return list(itertools.product(*choices))
