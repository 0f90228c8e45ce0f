# SPDX-License-Identifier: Apache-2.0
"""Finds the panoramas in a frame: the whole of it, one eye of a stereo pair, or both, and which eye is which."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.color import luminance
from mr360uw.errors import VideoError
from mr360uw.types import Array, Floats, Rectangle, YuvImage
from mr360uw.video.clip import DOUBLED_STRIP, PICTURE_SUFFIXES, Projection, second_lens, turned_by_ffmpeg
from mr360uw.video.demux import track_sizes
from mr360uw.video.spherical import SphericalMetadata, Stereo

Eye = Literal["left", "right", "both"]
Layout = Literal["mono", "top-bottom", "bottom-top", "left-right", "right-left"]
"""Arrangement of the eyes in a frame, the left one named first: it is above, below, at the left or at the right."""
LEFT_FIRST: dict[str, Stereo] = {"right-left": "left-right", "bottom-top": "top-bottom"}
"""Arrangements whose first eye is the right one, and what they are with the left one first."""
_WIDEST = 5.0
"""Largest ratio of width to height of a squeezed panorama: 32:9 is usual (two eyes, one above the other, in 16:9)."""


_CUBES = {"c3x2": (3, 2), "c6x1": (6, 1), "c1x6": (1, 6)}
"""Arrangements of the six faces of a cube by FFmpeg's names, and their width to height."""
_CUBE = "; if it is the six faces of a cube, turn it by ffmpeg -i {} -vf v360={}:e OUT"


EyeChoice = tuple[Eye | None, Layout | None]
"""The eye of a stereo frame that is taken, None of one that is not, and the arrangement of the eyes, None to find it.
"""


def part_of(image: NDArray[Any], crop: Rectangle, scale_x: int = 1, scale_y: int = 1) -> NDArray[Any]:
    """Return the part of an image that is subsampled by the scales."""
    rows = slice(crop.row // scale_y, (crop.row + crop.height) // scale_y)
    return image[rows, crop.column // scale_x : (crop.column + crop.width) // scale_x]


def planes_of(image: YuvImage, crop: Rectangle) -> YuvImage:
    """Return the part of the planes, as views."""
    scales = image.y.shape[1] // image.u.shape[1], image.y.shape[0] // image.u.shape[0]
    u, v = (part_of(plane, crop, *scales) for plane in (image.u, image.v))
    return YuvImage(part_of(image.y, crop), u, v, image.spec)


def panorama_crops(
    path: Path,
    size: tuple[int, int],
    spherical: SphericalMetadata | None,
    eyes: EyeChoice,
    equirectangular: bool,
    look: Callable[[], Shape],
    pixel_aspect: float = 1.0,
) -> tuple[Rectangle, Rectangle | None, Stereo]:
    """Return the part of a frame that is one full equirectangular panorama, that of the right eye beside it where
    both eyes are chosen, and the arrangement of the eyes. Raises `VideoError`.

    size: (width, height) of the frame. Without a layout it is taken from the metadata or, without any, from the frame's
    shape: 1:1 is top-bottom, 4:1 is left-right. Panoramas are 2:1 unless the layout or the metadata say that the frame
    is one: then their pixels may be wider or higher. equirectangular False accepts a mono frame of any shape. look:
    says what the picture shows, where its size does not fit. pixel_aspect: width of a pixel over its height; frames
    that players show as 2:1 by it are one panorama, whatever their size.
    """
    (eye, layout), (width, height) = eyes, size
    whole = Rectangle(0, 0, width, height)
    if not equirectangular and eye is None:
        return whole, None, "mono"
    if spherical is not None and equirectangular:
        _check_projection(path, spherical)
    # Take the layout that is named, tagged, or told by the shape of the frame
    stereo = layout or _stereo(width, height, spherical)
    if layout is None and spherical is None and _is_squeezed(width, height, pixel_aspect):
        layout = stereo = "mono"
    said = layout is not None or spherical is not None
    # Refuse an eye of what is not stereo, and stereo without an eye
    if stereo == "mono" and eye is not None:
        raise VideoError(
            f'{path} - is not stereo (got {width}x{height}), so it has no "{eye}" eye - leave out the eye, or say with '
            'plate.layout = "top-bottom" or "left-right" how its eyes lie'
        )
    if stereo != "mono" and not said and (shape := look()) in ONE_PICTURE:
        raise VideoError(f"{path} - {way_out(shape, path)}; if it is two eyes, say with plate.layout how they lie")
    if stereo == "custom":
        raise VideoError(f"{path} - its stereo layout is not known (got {stereo}) - export one eye as mono")
    if stereo != "mono" and eye is None:
        raise VideoError(
            f"{path} - is {stereo} stereo (got {width}x{height}), and its eyes are not chosen - take "
            'plate.eye = "left", "right" or "both" in a scene, --eye left on the command line, eye="left" in Python'
        )
    # Check that what is cut out has the shape of a panorama
    crop = whole if stereo == "mono" else _eye_crop(path, width, height, stereo, "right" if eye == "right" else "left")
    if equirectangular and crop.width != 2 * crop.height and not (said and _may_be_squeezed(crop)):
        what = f"the picture is not a 360 degree panorama of 2:1 (got {crop.width}x{crop.height})"
        out = way_out(look(), path) or "export it as equirectangular 2:1, or tag it as the full sphere"
        out += next(
            (_CUBE.format(path.name, name) for name, ratio in _CUBES.items() if width * ratio[1] == height * ratio[0]),
            "",
        )
        raise VideoError(f"{path} - {what} - {out}")
    return crop, _eye_crop(path, width, height, stereo, "right") if eye == "both" else None, stereo


def output_layout(stereo: Stereo) -> Stereo:
    """Return the arrangement of outputs with both eyes: that of the plate, but the left one first: metadata cannot
    say bottom-top, V1 not even right-left, and players that know no other would show them crossed.
    """
    return LEFT_FIRST.get(stereo, stereo)


def _may_be_squeezed(crop: Rectangle) -> bool:
    """Return whether a picture of a shape other than 2:1 can be a whole panorama, squeezed or stretched."""
    return crop.width <= _WIDEST * crop.height and crop.height <= crop.width and crop.width % 2 == crop.height % 2 == 0


def _is_squeezed(width: int, height: int, pixel_aspect: float) -> bool:
    """Return whether a frame is not 2:1, but is shown so by the shape of its pixels."""
    return width != 2 * height and abs(pixel_aspect * width / height - 2.0) < _SQUEEZED


_SQUEEZED = 0.02
"""Difference from 2:1 of a frame's shown shape that rounding of its pixel aspect makes."""


def _stereo(width: int, height: int, spherical: SphericalMetadata | None) -> Stereo:
    if spherical is not None and spherical.stereo != "mono":
        return spherical.stereo
    if width == height:
        return "top-bottom"
    return "left-right" if width == 4 * height else "mono"


def _eye_crop(path: Path, width: int, height: int, stereo: Stereo, eye: Literal["left", "right"]) -> Rectangle:
    across, down = (1, 2) if LEFT_FIRST.get(stereo, stereo) == "top-bottom" else (2, 1)
    if width % (2 * across) or height % (2 * down):
        raise VideoError(
            f"{path} - cannot be divided into two eyes, {stereo} (got {width}x{height}) - export it with a "
            f"{'height' if down == 2 else 'width'} that is a multiple of 4 and the other side even"
        )
    first = (eye == "left") == (stereo not in LEFT_FIRST)
    column, row = (0, height // 2) if down == 2 else (width // 2, 0)
    return Rectangle(0 if first else column, 0 if first else row, width // across, height // down)


def _check_projection(path: Path, spherical: SphericalMetadata) -> None:
    # Another projection, half a sphere, or a part of it: name the way out of each
    if spherical.projection != "equirectangular":
        raise VideoError(
            f"{path} - projection not supported (got {spherical.projection}) - "
            + (
                padded(path, spherical.stereo)
                if spherical.projection in ("half equirectangular", "mesh")
                else "export the clip as equirectangular, or turn it with FFmpeg's filter v360"
            )
        )
    if spherical.is_half:
        eyes = "an eye each of " if spherical.stereo != "mono" else ""
        raise VideoError(
            f"{path} - is VR180 by its tags, {eyes}the half of the sphere in front - {padded(path, spherical.stereo)}"
        )
    if any(spherical.bounds):
        cut = ", ".join(f"{100 * part:.3g} %" for part in spherical.bounds)
        raise VideoError(
            f"{path} - is only part of the sphere (cropped by {cut} at top, bottom, left, right) - "
            "export the full sphere"
        )


# The left eye sees what is near farther to the right than the right eye does. The disparity, the longitude in the left
# picture less that in the right one, therefore grows from the horizon down over the ground; where it shrinks, the eyes
# are swapped. An offset that is the same everywhere (convergence) tells nothing. Over level ground it is
#
#     (2 e/h) tan(angle below the horizon) + offset
#
# 2 e: distance of the eyes, h: height of the camera (viewing circle of one radius; sin instead of tan where the circle
# shrinks towards the poles, see types.py).

Order = Literal["right", "swapped", "unclear"]

_COLUMNS, _ROWS = 2048, 1024
_WINDOW = (128, 64)
"""Width and height [pixels] of the parts that are compared, 22 by 11 degrees."""
_COARSE = 12.0
"""Standard deviation [pixels] of the blur that is taken off: what changes slowly tells no shift."""
_DARK = 0.01
_TRUSTED = 0.25
"""Peak of the phase correlation, 0 to 1, from which a shift is believed; parts without structure have 0.05."""
_NEAR_DEG, _FAR_DEG = (-50, -40, -30), (-10, 0, 10, 20)
"""Elevations of the ground and of what is farther."""
_CLEAR_DEG, _AGREED, _FEWEST = 0.12, 0.75, 4
"""Least median difference of near and far, share of azimuths that agree on its sign, and number of them."""
_ALIKE = 0.4
"""Correlation of what is seen along the horizon below which two pictures are no two eyes; those of one place: 0.8."""
_EVEN = 1e-3
"""Power below which pictures have no structure, and are as alike as any."""
EYES_APART_M = 0.064
"""Distance of the eyes [m] that heights are told with: the mean of people, and of most cameras."""
_GROUND_DEG = (-55, -50, -45, -40, -35, -30, -25, -20)
_HEIGHTS_M, _SCATTER, _PARTS = (0.3, 8.0), 0.12, 40
"""Heights that are believed, greatest scatter about the line over its rise from 20 to 55 degrees, parts needed."""
_OPPOSITE = LEFT_FIRST | {first: other for other, first in LEFT_FIRST.items()}


def eyes_seen(left: Floats, right: Floats, layout: str) -> tuple[str, float | None]:
    """Return what the panoramas (h, w, 3) of two eyes, in linear light, show.

    These are what is wrong with the layout in which they were read, and what to do, "" if nothing; and the height [m]
    of the camera over the ground, None where it is not told.
    """
    one, other = _structure(left), _structure(right)
    near, far = (_median(_shifts(one, other, elevations)) for elevations in (_NEAR_DEG, _FAR_DEG))
    order, difference = _order(near - far)
    floor, alike, doubt = None, _alike(one, other), ""
    if order == "right":
        floor = _floor(_shifts(one, other, _GROUND_DEG))
    if alike < _ALIKE:
        doubt = (
            f"the two pictures of {layout} stereo are not alike (got a correlation of {alike:.2f}) - if they "
            'are one panorama, set plate.layout = "mono"'
        )
    elif order == "swapped":
        doubt = (
            f"its eyes look swapped: the ground's disparity is {difference:.1f} degrees less than that of "
            f'what is farther - set plate.layout = "{_OPPOSITE[layout]}"'
        )
    return doubt, floor


def _structure(image: Floats) -> NDArray[np.float32]:
    """Return the fine structure of the logarithm of light, (1024, 2048)."""
    import cv2

    light = np.log(np.maximum(luminance(np.nan_to_num(image)), 0.0) + _DARK).astype(np.float32)
    light = cv2.resize(light, (_COLUMNS, _ROWS), interpolation=cv2.INTER_AREA)
    return np.asarray(light - cv2.GaussianBlur(light, (0, 0), _COARSE), np.float32)


def _alike(left: NDArray[np.float32], right: NDArray[np.float32]) -> float:
    """Return the correlation of two structures at a size at which disparities of near things are a pixel or two."""
    import cv2

    size = (_COLUMNS // 16, _ROWS // 16)
    rows = slice(size[1] // 4, -size[1] // 4)
    one, other = (
        cv2.resize(cv2.GaussianBlur(image, (0, 0), 0.5 * _COARSE), size, interpolation=cv2.INTER_AREA)[rows]
        for image in (left, right)
    )
    one, other = one - one.mean(), other - other.mean()
    power = float(np.sqrt(np.sum(one**2) * np.sum(other**2)))
    return float(np.sum(one * other)) / power if power > _EVEN else 1.0


def _shifts(left: NDArray[np.float32], right: NDArray[np.float32], elevations_deg: tuple[int, ...]) -> Array:
    """Return the disparity [deg] (elevations, azimuths) of parts around the sphere; NaN where it cannot be told."""
    import cv2

    width, height = _WINDOW
    window = cv2.createHanningWindow(_WINDOW, cv2.CV_32F)
    found = np.full((len(elevations_deg), _COLUMNS // width), np.nan)
    for number, elevation in enumerate(elevations_deg):
        row = round(_ROWS * (90 - elevation) / 180)
        strips = [image[row - height // 2 : row + height // 2] for image in (left, right)]
        for part in range(found.shape[1]):
            one, other = (np.ascontiguousarray(strip[:, part * width : (part + 1) * width]) for strip in strips)
            (shift, _), peak = cv2.phaseCorrelate(one, other, window)
            if peak > _TRUSTED:
                found[number, part] = -shift * 360.0 / _COLUMNS
    return found


def _median(shifts: Array) -> Array:
    """Return the medians (azimuths,) of what is told; NaN where nothing is."""
    found = np.full(shifts.shape[1], np.nan)
    told = np.any(np.isfinite(shifts), axis=0)
    found[told] = np.nanmedian(shifts[:, told], axis=0)
    return found


def _order(difference: Array) -> tuple[Order, float]:
    """Return the order of the eyes by the differences of near and far (azimuths,) [deg], and their median."""
    told = difference[np.isfinite(difference)]
    if len(told) < _FEWEST:
        return "unclear", 0.0
    middle = float(np.median(told))
    agreed = float(np.mean(np.sign(told) == np.sign(middle)))
    if abs(middle) < _CLEAR_DEG or agreed < _AGREED:
        return "unclear", middle
    return ("right" if middle > 0.0 else "swapped"), middle


def _floor(shifts: Array) -> float | None:
    """Return the height [m] of the camera over level ground by disparities (elevations, azimuths); None without one."""
    there = np.isfinite(shifts)
    if int(there.sum()) < _PARTS:
        return None
    below = np.radians(-np.array(_GROUND_DEG, np.float64))
    shift = np.radians(shifts[there])
    fits = []
    for law in (np.tan(below), np.sin(below)):
        terms = np.broadcast_to(law[:, None], shifts.shape)[there]
        slope, offset = np.polyfit(terms, shift, 1)
        scatter = float(np.median(np.abs(shift - slope * terms - offset))) * 1.48
        fits.append((scatter, float(slope), float(np.ptp(law))))
    scatter, slope, rise = min(fits)
    if slope <= 0.0 or scatter > _SCATTER * slope * rise:
        return None
    height = EYES_APART_M / slope
    return height if _HEIGHTS_M[0] <= height <= _HEIGHTS_M[1] else None


# --- What a picture shows of its layout -----------------------------------------------------------------------------

# Tells from a picture whether it is a panorama, two of them, half of one, fisheye circles, cube faces, or flat.
#
# Panoramas are constant along the top or bottom row (a pole is one direction) and meet at their left and right edges.
# Their left and right halves, and their upper and lower ones, show other things; those of a stereo frame show the same.
# False alarms are worse than misses: each kind needs two signs that a panorama does not show. Halves are compared as
# they are and in their fine structure.


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
        # Half of one has no eye above another one
        alone = 0.9 < aspect < 1.1 and _correlation(*np.split(small, 2, axis=0)) < _OF_ONE_PLACE
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
