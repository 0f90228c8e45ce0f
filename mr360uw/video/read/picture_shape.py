# SPDX-License-Identifier: Apache-2.0
"""Tells from a picture whether it is a panorama, two fisheye circles, cube faces, or a flat picture.

Panoramas are constant along the top or bottom row (a pole is one direction) and meet at their left and right edges.
False alarms are worse than misses: each kind needs two signs that a panorama does not show.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mr360uw.types import Floats, YuvImage
from mr360uw.video.read.projection import DOUBLED_STRIP, PICTURE_SUFFIXES, Projection, turned_by_ffmpeg

Shape = Literal["panorama", "dual fisheye", "fisheye", "EAC", "EAC track", "flat"]
"""What a picture looks like; "panorama" where nothing speaks against it."""

_ROWS, _COLUMNS = 128, 256
"""Size to which pictures are reduced: edges and poles are judged by what is larger than grain and codec blocks."""
_SEAM, _SEAM_CODES = 2.5, 6.0
"""Step from the right to the left edge, over the mean step between neighbouring columns and in codes of 8 bits, above
which the edges do not meet: twice the largest of the panoramas it was chosen on (1.1). Flat pictures: 1.7 to 33."""
_POLE, _POLE_CODES = 0.18, 4.0
"""Standard deviation along the top and the bottom row, over that of the median row and in codes, above which neither
is a pole: 1.5 times the largest of the panoramas that it was chosen on (0.12). Flat pictures: 0.21 to 1.1."""
_CORNER, _RING = 1.12, (0.84, 0.94)
"""Radii, over half the height, outside of which a fisheye circle leaves the frame black, and of a ring well inside."""
_BLACK_CODES, _EVEN_CODES, _BRIGHTER_CODES = 32.0, 8.0, 16.0
"""Largest code and spread of the black around circles, and how much brighter the ring is."""
_RING_SHARE, _POLE_SHARE = 0.55, 0.8
"""Least share of the ring that is brighter, and of its upper or its lower quarter. A panorama whose corners are black
is black all along its top and bottom rows, in both of these quarters."""
_HALVES = 3.6
"""Step between the two middle rows, over the mean step between rows, of two rows of cube faces that lie one above the
other: geometric mean of the picture's left and right third. Flat pictures: up to 2.6."""


SHOWN_PROJECTIONS: dict[Shape, Projection] = {"dual fisheye": "dual_fisheye", "EAC": "eac"}
"""Projections that a picture shows and that clips are read from."""
_EXPORT = "export it as equirectangular 2:1"
_SHOWS: dict[Shape, str] = {"dual fisheye": "two fisheye circles side by side", "EAC": "six faces of a cube (EAC)"}
_WAYS_OUT: dict[Shape, str] = {
    "fisheye": f"shows the circle of one lens: give the camera's .insv file with both, or {_EXPORT}",
    "EAC track": (
        "shows three faces of a cube, one of the two tracks of a GoPro's .360 file: give that file itself, or "
        f"{_EXPORT} in GoPro Player"
    ),
    "flat": (
        "looks like the flat picture of an ordinary camera (its left and right edges do not meet, top and bottom are "
        "no poles): give a clip of a 360 camera, exported as equirectangular 2:1"
    ),
}


def picture_shape(luma: NDArray[Any], white: float = 255.0) -> Shape:
    """Return what a picture of luma codes (h, w) looks like. white: the largest code.

    Pictures too dark or too even to tell are "panorama".
    """
    import cv2

    rows, columns = luma.shape
    reduced = cv2.resize(np.ascontiguousarray(luma), (_COLUMNS, _ROWS), interpolation=cv2.INTER_AREA)
    small = np.asarray(reduced, np.float64) * 255.0 / white
    aspect = columns / rows
    if 1.9 < aspect < 2.1 and all(_is_circle(half) for half in np.split(small, 2, axis=1)):
        return "dual fisheye"
    if 0.95 < aspect < 1.05 and _is_circle(cv2.resize(small, (_ROWS, _ROWS), interpolation=cv2.INTER_AREA)):
        return "fisheye"
    ends_differ, no_pole = seam_step(small) > [_SEAM, _SEAM_CODES], pole_spread(small) > [_POLE, _POLE_CODES]
    if not (np.all(ends_differ) and np.all(no_pole)):
        return "panorama"
    if (columns, rows) in DOUBLED_STRIP:
        return "EAC track"
    return "EAC" if 1.4 < aspect < 2.1 and _has_halves(luma) else "flat"


def shape_of_codes(picture: YuvImage | NDArray[Any], bits: int) -> Shape:
    """Return what planes or RGB codes (h, w, 3) of `bits` look like; float pictures are linear, 1 is white."""
    if isinstance(picture, YuvImage):
        return picture_shape(picture.y, float((1 << bits) - 1))
    green = picture[..., 1]
    if green.dtype.kind == "f":
        return picture_shape(np.sqrt(np.clip(np.nan_to_num(green), 0.0, 1.0)), 1.0)
    return picture_shape(green, float((1 << bits) - 1))


def way_out(shape: Shape, path: Path) -> str:
    """Return what a file's picture that is no panorama shows and what to do, "" for panoramas."""
    if shape not in SHOWN_PROJECTIONS:
        return _WAYS_OUT.get(shape, "")
    projection = SHOWN_PROJECTIONS[shape]
    still = path.suffix.lower() in PICTURE_SUFFIXES
    turn = f"turn it by {turned_by_ffmpeg(path, projection)}" if still else f'set plate.projection = "{projection}"'
    return f"shows {_SHOWS[shape]}: {turn}, or {_EXPORT}"


def seam_step(small: Floats) -> Floats:
    """Return the mean step from the right edge to the left: over that between neighbouring columns, and in codes."""
    step = float(np.mean(np.abs(small[:, 0] - small[:, -1])))
    return np.array([step / max(float(np.mean(np.abs(np.diff(small, axis=1)))), 0.5), step])


def pole_spread(small: Floats) -> Floats:
    """Return the smaller standard deviation of the top and bottom rows: over that of the median row, and in codes."""
    spread = small.std(axis=1)
    ends = float(min(spread[0], spread[-1]))
    return np.array([ends / max(float(np.median(spread)), 1.0), ends])


def _is_circle(half: Floats) -> bool:
    """Whether a square picture is a bright circle on black."""
    at = (np.arange(_ROWS) + 0.5) * 2.0 / _ROWS - 1.0
    radius = np.hypot(at[:, None], at[None, :])
    around = half[radius > _CORNER]
    black = float(np.median(around))
    even = float(np.percentile(around, 95)) - black <= _EVEN_CODES
    if black > _BLACK_CODES or not even:
        return False
    inside = (radius > _RING[0]) & (radius < _RING[1])
    bright = half > black + _BRIGHTER_CODES
    poles = [float(np.mean(bright[inside & (side * at[:, None] > np.sqrt(0.5) * radius)])) for side in (-1.0, 1.0)]
    return float(np.mean(bright[inside])) >= _RING_SHARE and max(poles) >= _POLE_SHARE


def _has_halves(luma: NDArray[Any]) -> bool:
    """Whether the picture breaks along its middle row."""
    codes = np.asarray(luma, np.float32)
    middle = len(codes) // 2
    step = np.abs(np.diff(codes, axis=0))
    parts = (step[:, : step.shape[1] // 3], step[:, -(step.shape[1] // 3) :])
    sharper = [float(part[middle - 1].mean()) / max(float(part.mean()), 1e-9) for part in parts]
    return float(np.sqrt(np.prod(sharper))) > _HALVES
