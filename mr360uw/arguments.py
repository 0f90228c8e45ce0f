# SPDX-License-Identifier: Apache-2.0
"""Text of the command line as values."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from mr360uw.errors import ParameterError

if TYPE_CHECKING:
    from mr360uw.scene.model import Scene


class Eye(StrEnum):
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
        start = int(head) if head else 0
        stop = (int(tail) if tail else None) if colon else start + 1
    except ValueError:
        raise ParameterError(f"--frames - is not a range (got {text!r}) - write a:b, as in 0:48") from None
    if start < 0 or (stop is not None and stop <= start):
        raise ParameterError(f"--frames - is empty or negative (got {text!r}) - write a:b with 0 <= a < b")
    return start, stop


def check_report(path: Path | None, scene: Scene) -> None:
    """Raise `ParameterError` or `VideoError` where a report may not be written; None: there is none."""
    from mr360uw.scene.inputs import keep_inputs

    if path is None:
        return
    keep_inputs(scene, path)
    if path.is_dir() or not path.parent.is_dir():
        raise ParameterError(f"--report - cannot be written (got {path}) - name a file in a folder that is there")


def worker_count(text: str) -> int | Literal["auto"]:
    """Return the number of processes of `--workers`."""
    if text == "auto":
        return "auto"
    if not text.isdecimal() or int(text) < 1:
        raise ParameterError(f"--workers - is no number of processes (got {text!r}) - give 1 or more, or auto")
    return int(text)
