# SPDX-License-Identifier: Apache-2.0
"""Metadata of high dynamic range: the display that a clip was graded on, and the brightest light in it.

SMPTE ST 2086 and CTA-861.3. FFmpeg gives them as data beside the first picture; encoders take them as text.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from mr360uw.video.settings import Codec

_RATIONALS = struct.Struct("<20i2i")  # AVMasteringDisplayMetadata: ten fractions, two flags
_CONTENT = struct.Struct("<2I")  # AVContentLightMetadata
_PER_CHROMATICITY, _PER_CD_M2 = 50_000, 10_000  # units of ST 2086: 0.00002 and 0.0001 cd/m^2


@dataclass(frozen=True, slots=True)
class MasteringDisplay:
    """The display of ST 2086. red, green, blue, white: chromaticities (x, y); luminance: (least, most) [cd/m^2]."""

    red: tuple[float, float]
    green: tuple[float, float]
    blue: tuple[float, float]
    white: tuple[float, float]
    luminance: tuple[float, float]


@dataclass(frozen=True, slots=True)
class HdrMetadata:
    """display: that the clip was graded on. content: brightest pixel and brightest mean of a frame [cd/m^2]."""

    display: MasteringDisplay | None = None
    content: tuple[int, int] | None = None

    def encoder_options(self, codec: Codec) -> dict[str, str]:
        """Return what carries the metadata: names and values of the parameters of x264, x265 or SVT-AV1; else none."""
        names = {"h264": ("mastering-display", "cll"), "h265": ("master-display", "max-cll"),
                 "av1": ("mastering-display", "content-light")}.get(codec)  # fmt: skip
        if names is None:
            return {}
        found = {}
        if self.display is not None:
            found[names[0]] = _written(self.display, whole=codec != "av1")
        if self.content is not None:
            found[names[1]] = f"{self.content[0]},{self.content[1]}"
        return found


def hdr_from_side_data(side_data: Iterable[Any]) -> HdrMetadata | None:
    """Return what the data beside a decoded picture tell; None where they tell nothing."""
    display, content = None, None
    for entry in side_data:
        kind, data = entry.type.name, bytes(entry)
        if kind == "MASTERING_DISPLAY_METADATA" and len(data) >= _RATIONALS.size:
            display = _display(data)
        elif kind == "CONTENT_LIGHT_LEVEL" and len(data) >= _CONTENT.size:
            content = _CONTENT.unpack_from(data)
    return None if display is None and content is None else HdrMetadata(display, content)


def _display(data: bytes) -> MasteringDisplay | None:
    *terms, has_primaries, has_luminance = _RATIONALS.unpack_from(data)
    if not (has_primaries and has_luminance) or 0 in terms[1::2]:
        return None
    value = [numerator / denominator for numerator, denominator in zip(terms[::2], terms[1::2], strict=True)]
    red, green, blue, white, luminance = ((value[k], value[k + 1]) for k in range(0, 10, 2))
    return MasteringDisplay(red, green, blue, white, luminance)


def _written(display: MasteringDisplay, *, whole: bool) -> str:
    """Return G(x,y)B(x,y)R(x,y)WP(x,y)L(most,least), in the whole units of ST 2086 or as decimals."""

    def pair(x: float, y: float, units: int) -> str:
        return f"({round(x * units)},{round(y * units)})" if whole else f"({x:.5f},{y:.5f})"

    places = zip("GBR", (display.green, display.blue, display.red), strict=True)
    colours = "".join(name + pair(*at, _PER_CHROMATICITY) for name, at in places)
    least, most = display.luminance
    return f"{colours}WP{pair(*display.white, _PER_CHROMATICITY)}L{pair(most, least, _PER_CD_M2)}"
