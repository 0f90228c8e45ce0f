# SPDX-License-Identifier: Apache-2.0
"""A plate without expansion, small and levelled, to which the colour of its water is fitted: a map, and its horizon."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.cache import shared
from mr360uw.constants import ENVIRONMENT_COLUMNS, ENVIRONMENT_ROWS
from mr360uw.ibl.lookup import reduce_map
from mr360uw.ibl.plate import COARSE_COLUMNS, COARSE_ROWS, coarse_directions, remap
from mr360uw.ibl.tilt import is_level, level_matrix, roll_pitch, upward
from mr360uw.medium.open_water import BAND_RAD, SECTORS, LevelView
from mr360uw.sphere import direction_from_frame, directions, frame_from_direction
from mr360uw.types import Floats, YuvImage

_SAMPLES = (6, 12)
"""Rows above and below the horizon, and columns of each azimuth, at which a plate's horizon is read."""
_FINER = 8
"""Planes are averaged as code values to cells this many times finer than the map, before they are decoded to light."""


def plate_map(plate: Floats | YuvImage, up: ArrayLike | None = None) -> Floats:
    """Return the (32, 64, 3) means of a linear plate (H, W, 3) or of decoded planes over exact solid angles.

    Codes outside the gamut (deep blue water in red) give negative light; means are clipped at 0. up: direction (3,) of
    the world's up in the plate's axes; the map is levelled and its heading kept.
    """
    fine, up = small_picture(plate), upward(up)
    if not is_level(up):
        fine = reduce_map(fine, COARSE_COLUMNS, COARSE_ROWS)
        seen = coarse_directions() @ level_matrix(*map(float, roll_pitch(up)))
        fine = remap(fine, *frame_from_direction(seen, COARSE_COLUMNS, COARSE_ROWS))
    return np.maximum(reduce_map(fine, ENVIRONMENT_COLUMNS, ENVIRONMENT_ROWS), 0.0)


def world_view(plate: Floats | YuvImage, world_from_camera: Floats) -> Floats:
    """Return the light (h, w, 3) of a linear plate or of decoded planes, at most 512 x 256, in the world's axes."""
    fine = np.ascontiguousarray(small_picture(plate))
    if not np.allclose(world_from_camera, np.eye(3), atol=1e-9):
        height, width = fine.shape[:2]
        fine = remap(fine, *frame_from_direction(directions(width, height) @ world_from_camera, width, height))
    return fine


def level_view(plate: Floats | YuvImage, up: ArrayLike | None = None) -> LevelView:
    """Return the light of a linear plate (H, W, 3) or of decoded planes just above and below the horizon.

    Pixels are read at full resolution, up to `_SAMPLES` an azimuth. up: as for `plate_map`.
    """
    height, width = (plate.y if isinstance(plate, YuvImage) else plate).shape[:2]
    column, row = _places(width, height, upward(up).tobytes())
    rows, columns = _SAMPLES
    light = _pixels(plate, row, column).reshape(2, rows, SECTORS, columns, 3).mean(axis=(1, 3))
    half = float(np.sin(0.5 * _reach(height)))
    return LevelView(np.array([half, -half]), light)


def _reach(height: int) -> float:
    """Return the half height [rad] of the band about the horizon that is read of a frame: one row at least."""
    return float(max(BAND_RAD, np.pi / height))


@shared(keep=2)
def _places(width: int, height: int, up: bytes) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the columns and rows (2 `_SAMPLES[0]`, n) of the pixels about the horizon. up: of `upward`, float64."""
    rows, columns = _SAMPLES
    elevation = _reach(height) * (1.0 - (np.arange(2 * rows) + 0.5) / rows)
    turn = (np.arange(SECTORS * columns) + 0.5) / (SECTORS * columns)
    level = direction_from_frame(turn[None, :], 0.5 - elevation[:, None] / np.pi, 1, 1)
    seen = level @ level_matrix(*map(float, roll_pitch(np.frombuffer(up))))
    x, y = frame_from_direction(seen, width, height)
    return x.astype(np.int64) % width, np.clip(y.astype(np.int64), 0, height - 1)


def _pixels(plate: Floats | YuvImage, row: NDArray[np.int64], column: NDArray[np.int64]) -> Floats:
    """Return the linear light (h, w, 3) of pixels, not clipped."""
    if not isinstance(plate, YuvImage):
        return np.asarray(plate[row, column], np.float64)
    from mr360uw.yuv.decoding import linear_from_planes

    ratio = [-(-a // b) for a, b in zip(plate.y.shape, plate.u.shape, strict=True)]
    coarse = row // ratio[0], column // ratio[1]
    picked = YuvImage(plate.y[row, column], plate.u[coarse], plate.v[coarse], plate.spec)
    return linear_from_planes(picked, wrap=False)


def small_picture(plate: Floats | YuvImage) -> Floats:
    """Return the light of decoded planes, at most 512 x 256; of a linear plate itself."""
    if not isinstance(plate, YuvImage):
        return np.asarray(plate, np.float32)
    import cv2

    from mr360uw.yuv.decoding import linear_from_planes

    height, width = plate.y.shape
    size = min(width, _FINER * ENVIRONMENT_COLUMNS), min(height, _FINER * ENVIRONMENT_ROWS)
    y, u, v = (
        cv2.resize(_by_whole_factor(plane, size), size, interpolation=cv2.INTER_AREA)
        for plane in (plate.y, plate.u, plate.v)
    )
    return linear_from_planes(YuvImage(y, u, v, plate.spec))


def _by_whole_factor(plane: NDArray[Any], size: tuple[int, int]) -> NDArray[Any]:
    """Return a plane that is reduced by the largest whole factor that leaves it a size or more: that is fast."""
    import cv2

    height, width = plane.shape
    factors = range(min(width // size[0], height // size[1]), 1, -1)
    factor = next((f for f in factors if width % f == 0 and height % f == 0), 1)
    if factor == 1:
        return plane
    return np.asarray(cv2.resize(plane, (width // factor, height // factor), interpolation=cv2.INTER_AREA))
