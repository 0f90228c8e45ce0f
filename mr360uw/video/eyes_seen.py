# SPDX-License-Identifier: Apache-2.0
"""What the two pictures of a stereo plate show: whether they are eyes, which is which, how far down the ground is.

The left eye sees what is near farther to the right than the right eye does. The disparity, the longitude in the left
picture less that in the right one, therefore grows from the horizon down over the ground; where it shrinks, the eyes
are swapped. An offset that is the same everywhere (convergence) tells nothing. Over level ground it is

    (2 e/h) tan(angle below the horizon) + offset

2 e: distance of the eyes, h: height of the camera (viewing circle of one radius; sin instead of tan where the circle
shrinks towards the poles, see types.py).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mr360uw.color import luminance
from mr360uw.types import Array, Floats
from mr360uw.video.read.layout import LEFT_FIRST

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
