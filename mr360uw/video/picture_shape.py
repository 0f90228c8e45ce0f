# SPDX-License-Identifier: Apache-2.0
"""Tells from a picture whether it is a panorama, two of them, half of one, fisheye circles, cube faces, or flat.

Panoramas are constant along the top or bottom row (a pole is one direction) and meet at their left and right edges.
Their left and right halves, and their upper and lower ones, show other things; those of a stereo frame show the same.
False alarms are worse than misses: each kind needs two signs that a panorama does not show. Halves are compared as they
are and in their fine structure.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mr360uw.types import Floats, YuvImage
from mr360uw.video.clip import DOUBLED_STRIP, PICTURE_SUFFIXES, Projection, second_lens, turned_by_ffmpeg
from mr360uw.video.demux import track_sizes
from mr360uw.video.spherical import Stereo

Shape = Literal[
    "panorama", "dual fisheye", "fisheye", "circles", "alike circles", "EAC", "EAC track", "flat", "half", "halves",
    "side by side", "one above the other",
]  # fmt: skip
"""What a picture looks like; "panorama" where nothing speaks against it."""

_SMALL_ROWS, _SMALL_COLUMNS = 128, 256
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
_OF_ONE_PLACE = 0.55
"""Correlation of two halves, about the mean of each row, from which they show the same: of 29 panoramas up to 0.2 (side
by side) and 0.1 (above each other), of the same ones as two eyes 0.59 and more, mostly 0.9."""
_SHIFT, _SMOOTH, _NOISE = 6, 6.0, 1.0
"""Disparity up to which halves are compared, blur that is taken off for fine structure [pixels], and noise [codes]."""
_OPEN, _FADED = 1.8, 0.35
"""Step across the edges of a half, over that between columns, above which it is no whole turn (1.8 and less in full
panoramas), and light of its edges over its own below which they are faded to black."""
_INSIDE = slice(round(0.2 * _SMALL_ROWS), round(0.8 * _SMALL_ROWS))
"""Rows and columns of the square in a circle that is compared: its corners are 0.85 of the radius out."""
_HALVES = 3.6
"""Step between the two middle rows, over the mean step between rows, of two rows of cube faces that lie one above the
other: geometric mean of the picture's left and right third. Flat pictures: up to 2.6."""


SHOWN_PROJECTIONS: dict[Shape, Projection] = {"dual fisheye": "dual_fisheye", "EAC": "eac"}
"""Projections that a picture shows and that clips are read from."""
_OF_TWO: dict[Shape, Projection] = {"fisheye": "dual_fisheye", "EAC track": "eac"}
"""Projections of clips of which a picture shows one of two tracks or files."""
ONE_PICTURE: tuple[Shape, ...] = ("fisheye", "half")
"""What square frames show that are not two eyes."""
_EXPORT = "export it as equirectangular 2:1"
_SHOWS: dict[Shape, str] = {"dual fisheye": "two fisheye circles side by side", "EAC": "six faces of a cube (EAC)"}
_MAKERS = f"{_EXPORT} by the camera maker's program"
_WAYS_OUT: dict[Shape, str] = {
    "fisheye": (
        "shows the circle of one lens: give the camera's own file with both (.insv, .osv; of two files, _00_ and _10_ "
        f"beside each other), or {_MAKERS}"
    ),
    "circles": f"shows two fisheye circles in a frame that is not 2:1: crop it to the circles, or {_MAKERS}",
    "side by side": (
        'shows two panoramas side by side, an eye each: set plate.layout = "left-right" and plate.eye = "left" '
        '("right", "both")'
    ),
    "one above the other": (
        'shows two panoramas one above the other, an eye each: set plate.layout = "top-bottom" and plate.eye = "left" '
        '("right", "both")'
    ),
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
    small = _reduced(luma, white)
    aspect = columns / rows
    # Circles on black, which nothing else has
    if 1.9 < aspect < 2.1 and _are_circles(small):
        insides = [half[_INSIDE, _INSIDE] for half in np.split(small, 2, axis=1)]
        return "alike circles" if _correlation(*insides) > _OF_ONE_PLACE else "dual fisheye"
    if 1.7 < aspect <= 1.9 and _are_circles(_reduced(luma[: columns // 2], white)):
        return "circles"
    if 0.95 < aspect < 1.05 and _is_circle(cv2.resize(small, (_SMALL_ROWS, _SMALL_ROWS), interpolation=cv2.INTER_AREA)):
        return "fisheye"
    # Two pictures that show the same
    if 1.4 < aspect < 2.1 and (twice := _twice(small)) is not None:
        return twice
    # One picture: whether it closes around, and has poles
    ends_differ, no_pole = _seam_step(small) > [_SEAM, _SEAM_CODES], _pole_spread(small) > [_POLE, _POLE_CODES]
    if not (np.all(ends_differ) and np.all(no_pole)):
        alone = 0.9 < aspect < 1.1 and _correlation(*np.split(small, 2, axis=0)) < _OF_ONE_PLACE  # no eye above another one
        return "half" if np.all(ends_differ) and alone else "panorama"
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
    if shape in _HALF_SPHERES:
        return f"shows {_HALF_SPHERES[shape][0]}: {padded(path, *_HALF_SPHERES[shape][1:])}"
    projection = shown_projection(shape, path)
    if projection is None:
        return _WAYS_OUT.get(shape, "")
    if shape in _OF_TWO:
        return f'{_WAYS_OUT[shape].partition(":")[0]}, of two: set plate.projection = "{projection}", or {_MAKERS}'
    still = path.suffix.lower() in PICTURE_SUFFIXES
    turn = f"turn it by {turned_by_ffmpeg(path, projection)}" if still else f'set plate.projection = "{projection}"'
    return f"shows {_SHOWS[shape]}: {turn}, or {_EXPORT}"


_HALF_SPHERES: dict[Shape, tuple[str, Stereo, str]] = {
    "half": ("half a panorama (180 degrees)", "mono", ""),
    "halves": ("two pictures of 180 degrees side by side (VR180), an eye each", "left-right", ""),
    "alike circles": (
        "two fisheye circles of the same direction, an eye each (VR180)", "left-right",
        "v360=fisheye:hequirect:ih_fov=190:iv_fov=190",
    ),
}  # fmt: skip
"""What shows the half of the sphere in front: in words, arrangement of its eyes, FFmpeg's filter that makes it one."""
_LEFT_EYE = {"left-right": "crop=iw/2:ih:0:0", "top-bottom": "crop=iw:ih/2:0:0"}


def padded(path: Path, stereo: Stereo, turned: str = "") -> str:
    """Return how a picture of 180 degrees becomes a plate, in words. turned: FFmpeg's filter that an eye needs."""
    filters = ",".join(filter(None, [_LEFT_EYE.get(stereo, ""), turned, "pad=2*iw:ih:iw/2:0"]))
    end = ".png" if path.suffix.lower() in PICTURE_SUFFIXES else ".mp4"
    return (
        "plates are full spheres: export it as 360, or make one of an eye, black behind the camera, by ffmpeg -i "
        f"{path.name} -vf {filters} {path.stem}_360{end}"
    )


def shown_projection(shape: Shape, path: Path) -> Projection | None:
    """Return the projection that a clip is read from whose picture has a shape; None where it is none of them."""
    if shape in _OF_TWO and path.is_file() and path.suffix.lower() not in PICTURE_SUFFIXES:
        sizes = track_sizes(path)
        paired = len(sizes) > 1 and sizes[1] == sizes[0]
        return _OF_TWO[shape] if paired or (shape == "fisheye" and second_lens(path) is not None) else None
    return SHOWN_PROJECTIONS.get(shape)


def _reduced(luma: NDArray[Any], white: float) -> Floats:
    """Return a picture of luma codes as (128, 256), in codes of 8 bits."""
    import cv2

    small = cv2.resize(np.ascontiguousarray(luma), (_SMALL_COLUMNS, _SMALL_ROWS), interpolation=cv2.INTER_AREA)
    return np.asarray(small, np.float64) * 255.0 / white


def _twice(small: Floats) -> Shape | None:
    """Return how a picture holds two that show the same, None where it does not."""
    left, right = np.split(small, 2, axis=1)
    beside = _correlation(left, right)
    if max(beside, _correlation(*np.split(small, 2, axis=0))) < _OF_ONE_PLACE:
        return None
    if beside < _OF_ONE_PLACE:
        return "one above the other"
    steps = np.mean([_seam_step(half) for half in (left, right)], axis=0)
    edges = np.mean([half[:, [0, -1]].mean() / max(half.mean(), 1.0) for half in (left, right)])
    return "halves" if steps[0] > _OPEN or edges < _FADED else "side by side"


def _correlation(one: Floats, other: Floats) -> float:
    """Return how much two pictures show the same: the lesser correlation of them and of their fine structure.

    It is the largest of all disparities, without the means of rows, which all panoramas of a place share.
    """
    import cv2

    def correlation(a: Floats, b: Floats) -> float:
        found = []
        for shift in range(-_SHIFT, _SHIFT + 1):
            left, right = a[:, _SHIFT:-_SHIFT], b[:, _SHIFT + shift : b.shape[1] - _SHIFT + shift]
            left, right = left - left.mean(axis=1, keepdims=True), right - right.mean(axis=1, keepdims=True)
            power = float(np.sqrt(np.sum(left**2) * np.sum(right**2)))
            found.append(float(np.sum(left * right)) / (power + _NOISE**2 * left.size))
        return max(found)

    fine = [np.asarray(image - cv2.GaussianBlur(image, (0, 0), _SMOOTH)) for image in (one, other)]
    return min(correlation(one, other), correlation(*fine))


def _seam_step(small: Floats) -> Floats:
    """Return the mean step from the right edge to the left: over that between neighbouring columns, and in codes."""
    step = float(np.mean(np.abs(small[:, 0] - small[:, -1])))
    return np.array([step / max(float(np.mean(np.abs(np.diff(small, axis=1)))), 0.5), step])


def _pole_spread(small: Floats) -> Floats:
    """Return the smaller standard deviation of the top and bottom rows: over that of the median row, and in codes."""
    spread = small.std(axis=1)
    ends = float(min(spread[0], spread[-1]))
    return np.array([ends / max(float(np.median(spread)), 1.0), ends])


def _are_circles(small: Floats) -> bool:
    """Whether a picture of 2:1 is two bright circles on black."""
    return all(_is_circle(half) for half in np.split(small, 2, axis=1))


def _is_circle(half: Floats) -> bool:
    """Whether a square picture is a bright circle on black."""
    at = (np.arange(_SMALL_ROWS) + 0.5) * 2.0 / _SMALL_ROWS - 1.0
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
