# SPDX-License-Identifier: Apache-2.0
"""Decoders of graphics cards, which are taken where their first picture is that of FFmpeg in software, bit for bit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import av.error
import numpy as np
from av.codec.hwaccel import hwdevices_available

from mr360uw.errors import VideoError
from mr360uw.video.read.probe import first_picture, open_container


def decoding_card(path: Path, track: int | None, first: Any) -> tuple[str, str]:
    """Return the kind of card that decodes a video here, "" where none does, and a line on what was taken and why.

    first: the file's first picture, decoded in software.
    """
    refusals = []
    for card in hwdevices_available():
        reason = _refusal(path, track, card, first)
        if not reason:
            return card, f'plate.decoder = "auto" took {card}, whose first picture is the same'
        refusals.append(f"{card}: {reason}")
    why = f" ({'; '.join(refusals)})" if refusals else ""
    return "", f'plate.decoder = "auto" took software: no card decodes {path.name} here{why}'


def _refusal(path: Path, track: int | None, card: str, first: Any) -> str:
    """Return why a card's pictures are not taken; "" where they are."""
    try:
        with open_container(path, track, card) as (container, stream):
            seen = in_format(first_picture(path, container, stream, alone=False), first.format.name)
        return "" if _same(seen, first) else "its first picture differs"
    except (VideoError, av.error.FFmpegError, RuntimeError, ValueError) as error:
        return str(getattr(error.__cause__, "strerror", None) or error)


def in_format(native: Any, name: str) -> Any:
    """Return a picture of FFmpeg's in a pixel format: cards have Cb and Cr side by side."""
    return native if native.format.name == name else native.reformat(format=name)


def _same(one: Any, other: Any) -> bool:
    if (one.width, one.height, one.pts) != (other.width, other.height, other.pts):
        return False
    return np.array_equal(one.to_ndarray(), other.to_ndarray())
