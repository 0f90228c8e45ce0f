# SPDX-License-Identifier: Apache-2.0
"""Surfaces given as distances along the rays of a camera: an equirectangular map (h, w) [m]; 0, inf and NaN: none.

On a plane n.x = c the inverse distance is linear in the direction d, so it is what is differentiated and interpolated:

    1/r = g.d        g = n/c        the normal towards the camera is -g/|g|
    u = 1/r          g = u d + (du/dlon / cos lat) e_lon + (du/dlat) e_lat        at any direction d

Each texel represents the tangent plane of the surface there. Differences over 2 sin of the step, not the step, are
exact on planes; along a row they span more texels towards the poles, where columns lie close together. If the
differences to the two sides of a texel are far apart, there is an edge, and the smaller difference alone counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.jit import exact
from mr360uw.types import Floats

JUMP = 4.0
"""Ratio of the differences to the two sides of a texel above which the larger one is an edge ..."""
LEAST_JUMP = 0.04
"""... if it is at least this fraction of the inverse distance."""
WIDEST = 16
"""A difference along a row spans at most 1/16 of a turn to each side."""
SMOOTHING_DEG = (21.0, 10.5, 10.5, 5.2, 5.2, 5.2, 2.6, 2.6, 2.6, 1.05, 1.05, 1.05)
"""Widths [degrees] of the running means that smooth the steps of a rounded map. More narrow and fewer wide ones leave
terraces; two boxes a pass, or a Gaussian, mix more across edges."""


def inverse_distance(distance_m: Floats) -> NDArray[np.float32]:
    """Return 1/distance [1/m] of a map, 0 where it holds no surface."""
    distance = np.asarray(distance_m, np.float32)
    seen = np.isfinite(distance) & (distance > 0.0)
    return np.where(seen, 1.0 / np.where(seen, distance, 1.0), 0.0).astype(np.float32)


@exact
def _difference(before: Any, here: Any, after: Any) -> Any:
    """Return the change from one texel to the next: the mean of both sides, or that of the side without an edge."""
    if before <= 0.0 and after <= 0.0:
        return 0.0
    if before <= 0.0:
        return after - here
    if after <= 0.0:
        return here - before
    left, right = here - before, after - here
    small, large = min(abs(left), abs(right)), max(abs(left), abs(right))
    if large <= max(JUMP * small, LEAST_JUMP * here):
        return 0.5 * (left + right)
    return left if abs(left) < abs(right) else right


@exact
def _touching(inverse: NDArray[np.float32], out: NDArray[np.float32]) -> None:
    rows, columns = inverse.shape
    longitude = 2.0 * np.pi * ((np.arange(columns) + 0.5) / columns - 0.5)
    right, ahead = np.sin(longitude), np.cos(longitude)
    for j in range(rows):
        latitude = np.pi * (0.5 - (j + 0.5) / rows)
        c, s = np.cos(latitude), np.sin(latitude)
        wide = min(max(int(0.5 / c + 0.5), 1), max(columns // WIDEST, 1))
        across, down = 1.0 / (np.sin(wide * 2.0 * np.pi / columns) * c), 1.0 / np.sin(np.pi / rows)
        for i in range(columns):
            u = inverse[j, i]
            if u > 0.0:
                east = across * _difference(inverse[j, (i - wide) % columns], u, inverse[j, (i + wide) % columns])
                below = inverse[j + 1, i] if j + 1 < rows else np.float32(0.0)
                above = inverse[j - 1, i] if j > 0 else np.float32(0.0)
                north = down * _difference(below, u, above)
                forward = u * c - north * s
                out[j, i, 0] = forward * right[i] + east * ahead[i]
                out[j, i, 1] = u * s + north * c
                out[j, i, 2] = east * right[i] - forward * ahead[i]


def touching_planes(distance_m: Floats) -> NDArray[np.float32]:
    """Return g [1/m] of a map, (h, w, 3) in the camera's axes, 0 where it holds no surface."""
    inverse = inverse_distance(distance_m)
    planes = np.zeros((*inverse.shape, 3), np.float32)
    _touching(inverse, planes)
    return planes


def without_steps(distance_m: Floats, step_m: float) -> Floats:
    """Return a map that was rounded to steps [m], smoothed, everywhere within half a step of its values."""
    inverse = inverse_distance(distance_m)
    seen = inverse > 0.0
    rows = np.flatnonzero(seen.any(axis=1))
    if len(rows) == 0:
        return distance_m
    part = slice(rows[0], rows[-1] + 1)
    inverse, mask, weight = inverse[part], seen[part], seen[part].astype(np.float32)
    distance = np.where(mask, np.asarray(distance_m, np.float32)[part], 1.0)
    low = weight / (distance + 0.5 * step_m)
    high = weight / np.maximum(distance - 0.5 * step_m, 0.1 * step_m)
    smooth = smoothed(inverse, low, high, SMOOTHING_DEG)
    out = np.array(distance_m)
    out[part] = np.where(mask, 1.0 / np.where(mask, smooth, 1.0), out[part])
    return out


def smoothed(
    inverse: NDArray[np.float32], low: Floats, high: Floats, widths_deg: Sequence[float]
) -> NDArray[np.float32]:
    """Return inverse distances (h, w) [1/m], 0 where there is no surface, smoothed within bounds low and high (h, w).

    Running means of these widths [degrees], each clipped to the bounds, which preserves every edge.
    """
    weight = (inverse > 0.0).astype(np.float32)
    widths = [width_px(width_deg, inverse.shape[1]) for width_deg in widths_deg]
    shares = {width: np.maximum(running_mean(weight, width), np.float32(1e-9)) for width in set(widths)}
    for width in widths:
        inverse = np.clip(running_mean(inverse, width) / shares[width], low, high)
    return inverse


def width_px(width_deg: float, columns: int) -> int:
    """Return the odd number of pixels of a panorama with so many columns that is nearest to a width [degrees]."""
    return 2 * round(width_deg / 720.0 * columns) + 1


def running_mean(values: NDArray[np.float32], width: int) -> NDArray[np.float32]:
    """Return the means (h, w) over squares of a panorama, periodic over the seam, edge rows repeated."""
    import cv2

    pad = width // 2
    wide = cv2.copyMakeBorder(values, 0, 0, pad, pad, cv2.BORDER_WRAP)
    return np.asarray(cv2.blur(wide, (width, width), borderType=cv2.BORDER_REPLICATE)[:, pad : pad + values.shape[1]])
