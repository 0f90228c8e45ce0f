# SPDX-License-Identifier: Apache-2.0
"""Converts FFmpeg's colour tags and pixel formats to a `ColorSpec`.

Untagged clips are read by the usual convention: BT.709 from 720 rows up, BT.601 below; limited range unless the pixel
format is one of the full-range `yuvj` kinds. A tagged transfer curve is *not* followed by default: cameras tag BT.709
and apply their own rendering for a display, so the inverse of the display curve (sRGB here) gives the light that a
display would show; name another curve to override it. PQ and HLG are followed: they hold light above white.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mr360uw.color import ColorSpec, Matrix, Primaries, Transfer
from mr360uw.errors import VideoError

# Values of ITU-T H.273, as FFmpeg numbers them.
_MATRICES: dict[int, Matrix] = {1: "bt709", 5: "bt601", 6: "bt601", 9: "bt2020"}
_UNSPECIFIED = 2
_HDR_CURVES: dict[int, Transfer] = {16: "pq", 18: "hlg"}
_FULL_RANGE = 2
HD_ROWS = 720
"""Untagged clips with at least this many rows are BT.709."""

_PIXEL_FORMAT = re.compile(r"yuv(j?)(420|422|444)p(\d+)?(le)?$")


@dataclass(frozen=True, slots=True)
class ColorTags:
    """The numbers of H.273 that a container or codec carries: range, matrix, primaries, transfer curve."""

    color_range: int
    colorspace: int
    color_primaries: int
    color_trc: int

    @classmethod
    def of(cls, native: Any) -> ColorTags:
        """Read them from a PyAV codec context or frame."""
        names = ("color_range", "colorspace", "color_primaries", "color_trc")
        return cls(*(int(getattr(native, name)) for name in names))

    def write_to(self, native: Any) -> None:
        """Set them on a PyAV codec context or frame."""
        native.color_range = self.color_range
        native.colorspace = self.colorspace
        native.color_primaries = self.color_primaries
        native.color_trc = self.color_trc


BT709_TAGS = ColorTags(color_range=1, colorspace=1, color_primaries=1, color_trc=1)
"""Tags of video made from stills: BT.709, limited range."""


def color_spec(
    path: Path,
    pixel_format: str,
    tags: ColorTags,
    rows: int,
    transfer: Transfer | None,
    primaries: Primaries | None = None,
) -> ColorSpec:
    """Return matrix, range, curve, depth and primaries of a clip's codes; VideoError for unsupported formats.

    transfer, primaries: named by the user; without, they follow the tags.
    """
    found = _PIXEL_FORMAT.match(pixel_format)
    if not found:
        raise VideoError(
            f"{path} - pixel format not supported (got {pixel_format}) - convert the clip to planar Y'CbCr, such as "
            "yuv420p, yuv422p10le or yuv444p"
        )
    if tags.colorspace == _UNSPECIFIED:
        matrix: Matrix = "bt709" if rows >= HD_ROWS else "bt601"
    elif tags.colorspace in _MATRICES:
        matrix = _MATRICES[tags.colorspace]
    else:
        raise VideoError(
            f"{path} - colour matrix not supported (got H.273 matrix {tags.colorspace}) - convert the clip to BT.709"
        )
    full_range = bool(found[1]) or tags.color_range == _FULL_RANGE
    curve: Transfer = transfer or _HDR_CURVES.get(tags.color_trc, "srgb")
    return ColorSpec(matrix, full_range, curve, int(found[3] or 8), primaries)
