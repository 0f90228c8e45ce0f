# SPDX-License-Identifier: Apache-2.0
"""Pictures for a screen: the view of an ordinary camera into a panorama, and light as 8-bit sRGB in PNG or JPEG."""

from __future__ import annotations

import math
from functools import cache
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.base.color import encode
from mr360uw.base.sphere import frame_from_direction, yaw_matrix
from mr360uw.errors import ParameterError
from mr360uw.ibl.tilt import level_matrix
from mr360uw.jit import exact
from mr360uw.types import Floats, View

_MARGIN = 4
"""Pixels that are repeated around the panorama, for the cubic filter and the step over its seam."""


def perspective(
    yaw_deg: float = 0.0, pitch_deg: float = 0.0, fov_deg: float = 75.0, width: int = 1280, height: int = 720
) -> View:
    """Return the view of an ordinary camera, without distortion, in a panorama's axes: it is pitched, then turned.

    yaw_deg: of its centre, 0 = ahead, + = right. pitch_deg: + = up. fov_deg: from its left to its right edge. Raises
    `ParameterError`.
    """
    for name, value, low, high, unit in (
        ("yaw_deg", yaw_deg, -360.0, 360.0, "deg"),
        ("pitch_deg", pitch_deg, -90.0, 90.0, "deg"),
        ("fov_deg", fov_deg, 1.0, 150.0, "deg"),
        ("width", width, 16, 16384, "pixels"),
        ("height", height, 16, 16384, "pixels"),
    ):
        if not low <= value <= high:
            raise ParameterError(f"view.{name} - must be in [{low:g}, {high:g}] {unit} (got {value}) - change it")
    rotation = yaw_matrix(math.radians(yaw_deg)) @ level_matrix(0.0, math.radians(pitch_deg))
    return View(width, height, world_from_camera=rotation, projection="perspective", fov_rad=math.radians(fov_deg))


def look(panorama: Floats, view: View) -> Floats:
    """Return the view (height, width, 3) float32 of a panorama (H, 2 H, 3) of linear light.

    Cubic interpolation; where the view is coarser than the panorama, the panorama is reduced first. Values are not
    less than 0.
    """
    import cv2

    factor = min(1.0, (np.pi / panorama.shape[0]) / view.pixel_rad)  # at the centre, where pixels are largest
    image = np.asarray(panorama, np.float32)
    if factor < 1.0:
        rows = max(8, round(factor * panorama.shape[0]))
        image = np.asarray(cv2.resize(image, (2 * rows, rows), interpolation=cv2.INTER_AREA))
    height, width = image.shape[:2]
    x, y = frame_from_direction(view.pixel_directions(), width, height)
    # beyond a pole a panorama goes on half a turn away
    over = np.roll(image, width // 2, axis=1)
    tall = np.concatenate([over[:_MARGIN][::-1], image, over[-_MARGIN:][::-1]])
    around = cv2.copyMakeBorder(tall, 0, 0, _MARGIN, _MARGIN, cv2.BORDER_WRAP)
    where = ((x + _MARGIN - 0.5).astype(np.float32), (y + _MARGIN - 0.5).astype(np.float32))
    seen = cv2.remap(around, *where, cv2.INTER_CUBIC)
    return np.maximum(seen, np.float32(0.0))


_STEPS = 1 << 14
"""Steps of the table over the square root of light: 45 for the narrowest code value, so that one pixel in 45 at most
differs from exact rounding, by one code value."""


@cache
def _table() -> NDArray[np.uint8]:
    light = (np.arange(_STEPS + 1) / _STEPS) ** 2
    return np.round(255.0 * encode(light, "srgb")).astype(np.uint8)


def screen_codes(linear: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return linear light (H, W, 3) as 8-bit sRGB; light above 1 is white, below 0 black."""
    codes = np.empty(linear.shape, np.uint8)
    _encode(np.ascontiguousarray(linear, np.float32).reshape(-1), _table(), codes.reshape(-1))
    return codes


@exact
def _encode(linear: Any, table: Any, codes: Any) -> None:
    steps = np.float32(_STEPS)
    for i in range(linear.size):
        light = min(max(linear[i], np.float32(0.0)), np.float32(1.0))
        codes[i] = table[int(math.sqrt(light) * steps + np.float32(0.5))]


LARGEST_WIDTH = 1024
"""Most pixels across a frame in a notebook."""
_QUALITY = 90
"""Quality of JPEG: twice the compression of 95, without visible blocks."""


def screen_picture(linear: ArrayLike, suffix: Literal[".jpg", ".png"] = ".jpg", *, width: int | None = None) -> bytes:
    """Return linear light (H, W, 3) as a picture file in 8-bit sRGB; light above 1 is white.

    width: the most pixels across; None leaves them all.
    """
    image = np.asarray(linear, np.float32)
    return encoded(screen_codes(image if width is None else narrowed(image, width)), suffix)


def narrowed(image: NDArray[Any], most: int) -> NDArray[Any]:
    """Return a picture (H, W, ...) of at most so many pixels across, in its own proportions."""
    import cv2

    height, width = image.shape[:2]
    if width <= most:
        return image
    size = (most, max(1, round(height * most / width)))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), image.dtype)


def encoded(codes: NDArray[np.uint8], suffix: str) -> bytes:
    """Return codes (h, w, 3) as a picture file of the kind that a suffix names."""
    import cv2

    options = [cv2.IMWRITE_JPEG_QUALITY, _QUALITY] if suffix in (".jpg", ".jpeg") else [cv2.IMWRITE_PNG_COMPRESSION, 1]
    done, data = cv2.imencode(suffix, cv2.cvtColor(np.ascontiguousarray(codes), cv2.COLOR_RGB2BGR), options)
    assert done
    return bytes(data)
