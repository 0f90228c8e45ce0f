# SPDX-License-Identifier: Apache-2.0
"""Finds the panoramas in a frame: the whole of it, one eye of a stereo pair, or both, and which eye is which."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.color import luminance
from mr360uw.errors import VideoError
from mr360uw.types import Array, Floats, YuvImage
from mr360uw.video.picture_shape import ONE_PICTURE, Shape, padded, way_out
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


@dataclass(frozen=True, slots=True)
class Crop:
    """A rectangle of a frame of `frame_size` (width, height)."""

    column: int
    row: int
    width: int
    height: int
    frame_size: tuple[int, int]

    @property
    def is_whole(self) -> bool:
        """Whether nothing is cut away."""
        return (self.width, self.height) == self.frame_size

    def window(self, image: NDArray[Any], scale_x: int = 1, scale_y: int = 1) -> NDArray[Any]:
        """Return the part of an image that is subsampled by the scales."""
        rows = slice(self.row // scale_y, (self.row + self.height) // scale_y)
        return image[rows, self.column // scale_x : (self.column + self.width) // scale_x]

    def apply(self, image: YuvImage) -> YuvImage:
        """Return the part of the planes, as views."""
        scale_x, scale_y = image.y.shape[1] // image.u.shape[1], image.y.shape[0] // image.u.shape[0]
        u, v = (self.window(plane, scale_x, scale_y) for plane in (image.u, image.v))
        return YuvImage(self.window(image.y), u, v, image.spec)


def panorama_crops(
    path: Path,
    size: tuple[int, int],
    spherical: SphericalMetadata | None,
    eye: Eye | None,
    rotation: int = 0,
    equirectangular: bool = True,
    layout: Layout | None = None,
    look: Callable[[], Shape] = lambda: "panorama",
    pixel_aspect: float = 1.0,
) -> tuple[Crop, Crop | None, Stereo]:
    """Return the part of a frame that is one full equirectangular panorama, that of the right eye beside it where
    `eye` is "both", and the arrangement of the eyes. Raises `VideoError`.

    size: (width, height) of the frame. layout: arrangement of the eyes; None takes it from the metadata or, without
    any, from the frame's shape: 1:1 is top-bottom, 4:1 is left-right. Panoramas are 2:1 unless the layout or the
    metadata say that the frame is one: then their pixels may be wider or higher. equirectangular False accepts a mono
    frame of any shape. look: says what the picture shows, where its size does not fit. pixel_aspect: width of a pixel
    over its height; frames that players show as 2:1 by it are one panorama, whatever their size.
    """
    # Refuse turns that are not done here; take other projections whole
    if rotation not in (0, 180) or (rotation and eye == "both"):
        raise VideoError(
            f"{path} - asks to be turned by {rotation} degrees - turn the pictures upright before "
            "(only 180 is done here, and not for both eyes)"
        )
    width, height = size
    whole = Crop(0, 0, width, height, size)
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


def _may_be_squeezed(crop: Crop) -> bool:
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


def _eye_crop(path: Path, width: int, height: int, stereo: Stereo, eye: Literal["left", "right"]) -> Crop:
    across, down = (1, 2) if LEFT_FIRST.get(stereo, stereo) == "top-bottom" else (2, 1)
    if width % (2 * across) or height % (2 * down):
        raise VideoError(
            f"{path} - cannot be divided into two eyes, {stereo} (got {width}x{height}) - export it with a "
            f"{'height' if down == 2 else 'width'} that is a multiple of 4 and the other side even"
        )
    first = (eye == "left") == (stereo not in LEFT_FIRST)
    column, row = (0, height // 2) if down == 2 else (width // 2, 0)
    return Crop(0 if first else column, 0 if first else row, width // across, height // down, (width, height))


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


@dataclass(frozen=True, slots=True)
class EyesSeen:
    """What two pictures show. order: of the eyes. disparity_deg: of the ground less that of the distance, median.

    alike: correlation of the two. floor_m: height of the camera over the ground, None where none is told.
    """

    order: Order
    disparity_deg: float
    alike: float
    floor_m: float | None

    def doubt(self, layout: str) -> str:
        """Return what is wrong with the arrangement in which the pictures were read, and what to do; "" if nothing."""
        if self.alike < _ALIKE:
            return (
                f"the two pictures of {layout} stereo are not alike (got a correlation of {self.alike:.2f}) - if they "
                'are one panorama, set plate.layout = "mono"'
            )
        if self.order == "swapped":
            return (
                f"its eyes look swapped: the ground's disparity is {self.disparity_deg:.1f} degrees less than that of "
                f'what is farther - set plate.layout = "{_OPPOSITE[layout]}"'
            )
        return ""


def eyes_seen(left: Floats, right: Floats) -> EyesSeen:
    """Return what the panoramas (h, w, 3) of two eyes, in linear light, show."""
    one, other = _structure(left), _structure(right)
    near, far = (_median(_shifts(one, other, elevations)) for elevations in (_NEAR_DEG, _FAR_DEG))
    order, difference = _order(near - far)
    floor = _floor(_shifts(one, other, _GROUND_DEG)) if order == "right" else None
    return EyesSeen(order, difference, _alike(one, other), floor)


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
