# SPDX-License-Identifier: Apache-2.0
"""Limits on the size of what input files hold, checked before it is decoded: a small file may ask for any memory.

Every limit is an environment variable, in millions; the message that refuses a file names it.
"""

from __future__ import annotations

import os
from dataclasses import dataclass

from mr360uw.errors import Mr360uwError, ParameterError

_MILLION = 1_000_000


@dataclass(frozen=True, slots=True)
class Limit:
    """A limit. variable: environment variable that sets it; default: in millions of `unit`; covers: for the manual."""

    variable: str
    default: float
    unit: str
    covers: str

    def value(self) -> int:
        """Return the limit in units; raise `ParameterError` where the variable holds no positive number."""
        text = os.environ.get(self.variable, "").strip()
        if not text:
            return round(self.default * _MILLION)
        try:
            value = round(float(text) * _MILLION)
        except (ValueError, OverflowError):
            value = 0
        if value < 1:
            raise ParameterError(
                f"{self.variable} - is no limit (got {text!r:.40}) - set millions of {self.unit}, or unset it"
            )
        return value

    def check(self, where: str, amount: int, wrong: type[Mr360uwError]) -> None:
        """Raise `wrong` where an amount, in units, is larger; where: what holds it, with the name of its file."""
        if amount > (most := self.value()):
            raise wrong(
                f"{where} - is too large (got {amount / _MILLION:.6g} million {self.unit}, at most "
                f"{most / _MILLION:.6g}) - make it smaller, or set {self.variable} to allow more"
            )


PICTURE = Limit("MR360UW_MAX_PICTURE", 150, "pixels", "a picture or a frame of a video: 16384 x 8192 fit")
TEXTURE = Limit("MR360UW_MAX_TEXTURE", 70, "pixels", "a texture: 8192 x 8192 fit")
DATA = Limit("MR360UW_MAX_DATA", 1000, "bytes", "a mesh file, one of its arrays, or an EXR picture, unpacked")
TRIANGLES = Limit("MR360UW_MAX_TRIANGLES", 10, "triangles", "a mesh file, each repetition counted")
TEXT = Limit("MR360UW_MAX_TEXT", 10, "bytes", "a scene, a table, a track or a material library")
FRAMES = Limit("MR360UW_MAX_FRAMES", 1, "frames", "frames made of a still: nine hours at 30 a second")
OBJECTS = Limit("MR360UW_MAX_OBJECTS", 0.001, "objects", "the objects of a scene")
PRIMS = Limit("MR360UW_MAX_PRIMS", 1, "prims", "a USD stage, each reference to a prim counted")
PARTICLES = Limit("MR360UW_MAX_PARTICLES", 10, "particles", "marine snow about the camera in one frame")
LIMITS = (PICTURE, TEXTURE, DATA, TRIANGLES, TEXT, FRAMES, OBJECTS, PRIMS, PARTICLES)
