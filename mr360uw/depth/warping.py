# SPDX-License-Identifier: Apache-2.0
"""Agreement of neighbouring panoramas that are warped to a reference frame by trial distances.

Every picture is normalised by the mean and the deviation of a window around each pixel, which takes away the veil and
the slow part of the light. The cost of a trial distance is one minus the mean correlation of all pairs of warped
pictures within a window. With weights w of pictures v, sums over the pictures, and means <> over the window,

    S = sum w v    P = sum w^2 v^2    Q = sum w v^2    W = sum w    X = sum w^2
    cost = 1 - <S^2 - P> / <Q (W^2 - X) / W>

so that the pairs cost as little as a sum. Light that moves over the ground (caustics, particles) is uncorrelated from
picture to picture: it adds noise to the reference's own pairs, but little to the mean of all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.jit import fast, inlined
from mr360uw.sphere import directions
from mr360uw.types import Floats

Map = NDArray[np.float32]

_LEAST_CODES = 1.0
"""Deviation [codes of 255] that is added to that of a window: flat windows stay flat, and do not amplify noise."""
_LARGEST = 3.0
"""Deviations from a window's mean that count, in its own: particles are brighter."""
_NARROW_COS, _WIDE_COS = np.cos(np.radians(25.0)), np.cos(np.radians(50.0))
"""Parallax up to which a picture has its full weight, and from which it has none: windows do not look alike."""
_SUMS = 5
"""Sums that the pictures are reduced to: S, P, Q, W, X."""
_LEAST_PAIRS = 1e-3
"""Least variance of all pairs that is divided by."""


@dataclass(frozen=True, slots=True, eq=False)
class Panorama:
    """A grey equirectangular picture and its pose.

    grey: (H, W) float32, codes in [0, 255]. position: (3,) [m] in the world. rotation: (3, 3), world from camera axes.
    """

    grey: Map
    position: Floats
    rotation: Floats


def window_mean(values: Map, side: int) -> Map:
    """Return the means of windows of side x side pixels of a map (H, W); the seam is closed."""
    import cv2

    half = side // 2
    padded = cv2.copyMakeBorder(values, 0, 0, half, half, cv2.BORDER_WRAP)
    mean: Map = cv2.blur(padded, (side, side), borderType=cv2.BORDER_REFLECT_101)[:, half:-half]
    return mean


def normalised(grey: Map, side: int) -> Map:
    """Return a picture (H, W) less the mean of a window, over its deviation, within +-3."""
    mean = window_mean(grey, side)
    variance = np.maximum(window_mean(grey * grey, side) - mean * mean, 0.0)
    return np.clip((grey - mean) / (np.sqrt(variance) + np.float32(_LEAST_CODES)), -_LARGEST, _LARGEST)


@inlined
def _arctangent(y: Any, x: Any) -> Any:
    """Return the angle of (x, y) within 4e-6 rad, by a polynomial of the smaller over the larger."""
    across, along = abs(y), abs(x)
    large = max(across, along)
    a = min(across, along) / max(large, np.float32(1e-20))
    s = a * a
    r = np.float32(-0.01172120) * s + np.float32(0.05265332)
    r = r * s - np.float32(0.11643287)
    r = r * s + np.float32(0.19354346)
    r = r * s - np.float32(0.33262347)
    r = (r * s + np.float32(0.99997726)) * a
    r = np.float32(1.57079637) - r if across > along else r
    r = np.float32(3.14159274) - r if x < 0 else r
    return -r if y < 0 else r


@fast
def add_warped(pictures: Any, turns: Any, shifts: Any, rays: Any, inverse: Any, offset: Any, sums: Any) -> None:
    """Add pictures (n, h, w), warped by the inverse distances inverse + offset, each (h, w), to sums (h, w, 5).

    turns: (n, 3, 3), camera axes of each picture from those of the reference. shifts: (n, 3), positions in the axes of
    the reference [m]. rays: (h, w, 3), unit directions of the reference's pixels. All float32.
    """
    count, height, width = pictures.shape
    one, half, zero = np.float32(1.0), np.float32(0.5), np.float32(0.0)
    across, down = np.float32(width / (2.0 * np.pi)), np.float32(height / np.pi)
    narrow, wide = np.float32(_NARROW_COS), np.float32(_WIDE_COS)
    for j in range(height):
        for i in range(width):
            q = max(inverse[j, i] + offset[j, i], zero)
            dx, dy, dz = rays[j, i, 0], rays[j, i, 1], rays[j, i, 2]
            s, p, squares, weights, crossed = zero, zero, zero, zero, zero
            for n in range(count):
                ax, ay, az = dx - q * shifts[n, 0], dy - q * shifts[n, 1], dz - q * shifts[n, 2]
                length = np.sqrt(ax * ax + ay * ay + az * az)
                cosine = (ax * dx + ay * dy + az * dz) / max(length, np.float32(1e-6))
                w = min((cosine - wide) / (narrow - wide), one)
                if w <= zero:
                    continue
                ex = turns[n, 0, 0] * ax + turns[n, 0, 1] * ay + turns[n, 0, 2] * az
                ey = turns[n, 1, 0] * ax + turns[n, 1, 1] * ay + turns[n, 1, 2] * az
                ez = turns[n, 2, 0] * ax + turns[n, 2, 1] * ay + turns[n, 2, 2] * az
                x = _arctangent(ex, -ez) * across + half * np.float32(width) - half
                y = half * np.float32(height) - half - _arctangent(ey, np.sqrt(ex * ex + ez * ez)) * down
                x = x + np.float32(width) if x < zero else x
                y = min(max(y, zero), np.float32(height - 1))
                left, top = int(x), int(y)
                u, v = x - np.float32(left), y - np.float32(top)
                left = left - width if left >= width else left
                right, low = left + 1 if left + 1 < width else 0, min(top + 1, height - 1)
                value = (one - v) * ((one - u) * pictures[n, top, left] + u * pictures[n, top, right]) + v * (
                    (one - u) * pictures[n, low, left] + u * pictures[n, low, right]
                )
                s += w * value
                p += w * w * value * value
                squares += w * value * value
                weights += w
                crossed += w * w
            sums[j, i, 0] += s
            sums[j, i, 1] += p
            sums[j, i, 2] += squares
            sums[j, i, 3] += weights
            sums[j, i, 4] += crossed


class Warped:
    """Neighbours of a reference frame at one size, ready to be warped by trial distances.

    width: of the size [px]. side: of the windows [px].
    """

    def __init__(self, reference: Panorama, neighbours: Sequence[Panorama], width: int, side: int) -> None:
        self.width, self.height, self.side = width, width // 2, side
        self._own = normalised(resized(reference.grey, width), side)
        self._rays = directions(width, width // 2).astype(np.float32)
        self._pictures = np.stack([normalised(resized(one.grey, width), side) for one in neighbours])
        turns = [one.rotation.T @ reference.rotation for one in neighbours]
        shifts = [reference.rotation.T @ (one.position - reference.position) for one in neighbours]
        self._turns, self._shifts = np.array(turns, np.float32), np.array(shifts, np.float32)

    def cost(self, inverse: Map, offset: Map) -> Map:
        """Return one minus the mean correlation of all pairs, (h, w) in [0, 2], for inverse distances [1/m].

        inverse, offset: (h, w), whose sum is tried. 1 where no pair shows anything.
        """
        sums: Map = np.zeros((self.height, self.width, _SUMS), np.float32)
        add_warped(self._pictures, self._turns, self._shifts, self._rays, inverse, offset, sums)
        own = self._own * self._own
        sums += np.stack([self._own, own, own, np.ones_like(own), np.ones_like(own)], axis=-1)
        s, p, squares, weights, crossed = np.moveaxis(sums, -1, 0)
        above = window_mean(s * s - p, self.side)
        below = window_mean(squares * (weights * weights - crossed) / weights, self.side)
        return np.where(below > _LEAST_PAIRS, 1.0 - above / np.maximum(below, _LEAST_PAIRS), 1.0).astype(np.float32)

    def parallax(self, inverse: Map) -> Map:
        """Return the parallax (h, w) [rad]: root mean square over the neighbours, for inverse distances (h, w)."""
        square = np.zeros_like(inverse)
        for shift in self._shifts:
            square += float(shift @ shift) - np.square(self._rays @ shift)
        return np.asarray(inverse * np.sqrt(np.maximum(square / len(self._shifts), 0.0)), np.float32)


def resized(picture: Map, width: int) -> Map:
    """Return a picture (H, W) as float32 with another width, averaged."""
    import cv2

    if picture.shape[1] == width:
        return np.ascontiguousarray(picture, np.float32)
    small: Map = cv2.resize(np.asarray(picture, np.float32), (width, width // 2), interpolation=cv2.INTER_AREA)
    return small
