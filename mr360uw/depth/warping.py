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

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.sphere import directions
from mr360uw.jit import fast, fast_making, inlined
from mr360uw.types import Floats

Map = NDArray[np.float32]

_SIDE = 3
"""Side [px] of the windows by which pictures are normalised. 5: caustics, which are wider than the grain of the ground,
count for more, and three times as strong ones hide a tenth more of the floor."""
_LEAST_CODES = 0.5
"""Deviation [codes of 255] that is added to that of a window: flat windows stay flat, and do not amplify noise."""
_LARGEST = 3.0
"""Deviations from a window's mean that count, in its own: particles are brighter."""
_NARROW_COS, _WIDE_COS = np.cos(np.radians(25.0)), np.cos(np.radians(50.0))
"""Parallax up to which a picture has its full weight, and from which it has none: windows do not look alike."""
_SUMS = 5
"""Sums that the pictures are reduced to: S, P, Q, W, X."""
_BLOCK = 128
"""Pixels that are warped together."""
_APART = 256
"""Numbers between the places of a block and other arrays: vector instructions, which round otherwise than single ones,
are not taken where what is written lies beside what is read."""
_LEAST_PAIRS = 1e-3
"""Least variance of all pairs that is divided by."""


@dataclass(frozen=True, slots=True, eq=False)
class Panorama:
    """A grey equirectangular picture and its pose.

    grey: (H, W) float32 or uint8, codes in [0, 255]. position: (3,) [m] in the world. rotation: (3, 3), world from
    camera axes.
    """

    grey: Map | NDArray[np.uint8]
    position: Floats
    rotation: Floats


def window_mean(values: Map, side: int) -> Map:
    """Return the means of windows of side x side pixels of a map (H, W); the seam is closed."""
    import cv2

    half = side // 2
    padded = cv2.copyMakeBorder(values, 0, 0, half, half, cv2.BORDER_WRAP)
    mean: Map = cv2.blur(padded, (side, side), borderType=cv2.BORDER_REFLECT_101)[:, half : half + values.shape[1]]
    return mean


def of_windows(extreme: Callable[..., Any], values: Map, side: int) -> Map:
    """Return the extremes of windows of side x side pixels of a map (H, W), by `cv2.erode` or `cv2.dilate`; the seam is
    closed.
    """
    import cv2

    half = side // 2
    wide = cv2.copyMakeBorder(values, 0, 0, half, half, cv2.BORDER_WRAP)
    found = extreme(wide, np.ones((side, side), np.uint8))[:, half : half + values.shape[1]]
    return np.ascontiguousarray(found, np.float32)


def normalised(grey: Map) -> Map:
    """Return a picture (H, W) less the mean of 3 x 3 pixels, over their deviation, within +-3."""
    mean = window_mean(grey, _SIDE)
    variance = np.maximum(window_mean(grey * grey, _SIDE) - mean * mean, 0.0)
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


@fast_making
def _add_warped(pictures: Any, turns: Any, shifts: Any, rays: Any, inverse: Any, sums: Any) -> None:
    """Write the sums (5, h, w) over n pictures that are warped by inverse distances (h, w), 0 or more.

    pictures: (n, (h + 1) * (w + 1)), n pictures with their first column again on the right and their last row again
    below. turns: (n, 3, 3), camera axes of each picture from those of the reference. shifts: (n, 3), positions in the
    axes of the reference [m]. rays: (3, h, w), unit directions of the reference's pixels. All float32.

    The places of a block of pixels in a picture come first, in a loop without branches and with one array that is
    written, which the compiler turns into vector instructions; then the pixels are fetched.
    """
    count, height, width = pictures.shape[0], rays.shape[1], rays.shape[2]
    one, half, zero, least = np.float32(1.0), np.float32(0.5), np.float32(0.0), np.float32(1e-6)
    across, down = np.float32(width / (2.0 * np.pi)), np.float32(height / np.pi)
    middle, level = half * np.float32(width) - half, half * np.float32(height) - half
    right, low = np.float32(width) - np.float32(1e-3), np.float32(height - 1)
    wide, narrower = np.float32(_WIDE_COS), np.float32(1.0 / (_NARROW_COS - _WIDE_COS))
    next_column, next_row = np.uint64(1), np.uint64(width + 1)  # unsigned, which need no check for negative ones
    room = np.empty(4 * _BLOCK + 2 * _APART, np.float32)
    place = room[_APART:-_APART]  # weight, index of the pixel, fractions of a column and of a row
    total = np.empty(_SUMS * _BLOCK, np.float32)
    for j in range(height):
        for begin in range(0, width, _BLOCK):
            block = min(_BLOCK, width - begin)
            total[:] = zero
            for n in range(count):
                sx, sy, sz = shifts[n, 0], shifts[n, 1], shifts[n, 2]
                xx, xy, xz = turns[n, 0, 0], turns[n, 0, 1], turns[n, 0, 2]
                yx, yy, yz = turns[n, 1, 0], turns[n, 1, 1], turns[n, 1, 2]
                zx, zy, zz = turns[n, 2, 0], turns[n, 2, 1], turns[n, 2, 2]
                for i in range(block):
                    q = inverse[j, begin + i]
                    dx, dy, dz = rays[0, j, begin + i], rays[1, j, begin + i], rays[2, j, begin + i]
                    ax, ay, az = dx - q * sx, dy - q * sy, dz - q * sz
                    length = np.sqrt(ax * ax + ay * ay + az * az)
                    cosine = (ax * dx + ay * dy + az * dz) / max(length, least)
                    ex, ey, ez = xx * ax + xy * ay + xz * az, yx * ax + yy * ay + yz * az, zx * ax + zy * ay + zz * az
                    x = _arctangent(ex, -ez) * across + middle
                    y = level - _arctangent(ey, np.sqrt(ex * ex + ez * ez)) * down
                    x = min(x + np.float32(width) if x < zero else x, right)
                    y = min(max(y, zero), low)
                    left, top = np.float32(np.int32(x)), np.float32(np.int32(y))
                    place[i] = max(min((cosine - wide) * narrower, one), zero)
                    place[_BLOCK + i] = top * np.float32(width + 1) + left  # exact below 2^24
                    place[2 * _BLOCK + i] = x - left
                    place[3 * _BLOCK + i] = y - top
                picture = pictures[n]
                for i in range(block):
                    w, u, v = place[i], place[2 * _BLOCK + i], place[3 * _BLOCK + i]
                    k = np.uint64(np.int32(place[_BLOCK + i]))
                    under = k + next_row
                    upper = picture[k] + u * (picture[k + next_column] - picture[k])
                    lower = picture[under] + u * (picture[under + next_column] - picture[under])
                    value = upper + v * (lower - upper)
                    total[i] += w * value
                    total[_BLOCK + i] += w * w * value * value
                    total[2 * _BLOCK + i] += w * value * value
                    total[3 * _BLOCK + i] += w
                    total[4 * _BLOCK + i] += w * w
            for which in range(_SUMS):
                for i in range(block):
                    sums[which, j, begin + i] = total[which * _BLOCK + i]


class Warped:
    """Neighbours of a reference frame at one size, ready to be warped by trial distances.

    width: of the size [px]. count: of neighbours. own: (h, w), the reference's picture. picture: what is made of grey
    pictures (h, w) before they are compared.
    """

    def __init__(
        self,
        reference: Panorama,
        neighbours: Sequence[Panorama],
        width: int,
        picture: Callable[[Map], Map] = normalised,
    ) -> None:
        self.width, self.height, self.count = width, width // 2, len(neighbours)
        self.own = picture(resized(reference.grey, width))
        self._rays = np.ascontiguousarray(np.moveaxis(directions(width, width // 2), -1, 0), np.float32)
        self._pictures: Map = np.empty((len(neighbours), (self.height + 1) * (width + 1)), np.float32)
        for one, into in zip(neighbours, self._pictures, strict=True):
            around = np.pad(picture(resized(one.grey, width)), ((0, 0), (0, 1)), "wrap")
            into[:] = np.pad(around, ((0, 1), (0, 0)), "edge").ravel()
        turns = [one.rotation.T @ reference.rotation for one in neighbours]
        shifts = [reference.rotation.T @ (one.position - reference.position) for one in neighbours]
        self._turns, self._shifts = np.array(turns, np.float32), np.array(shifts, np.float32)

    def part(self, some: slice) -> Warped:
        """Return the same with some of the neighbours."""
        part = copy.copy(self)
        part._pictures, part._turns, part._shifts = self._pictures[some], self._turns[some], self._shifts[some]
        part.count = len(part._shifts)
        return part

    def sums(self, inverse: Map) -> Map:
        """Return S, P, Q, W and X, (5, h, w), of the neighbours warped by inverse distances (h, w) [1/m]."""
        sums: Map = np.empty((_SUMS, self.height, self.width), np.float32)
        _add_warped(self._pictures, self._turns, self._shifts, self._rays, np.maximum(inverse, np.float32(0)), sums)
        return sums

    def cost(self, inverse: Map, side: int) -> Map:
        """Return one minus the mean correlation of all pairs, (h, w) in [0, 2], for inverse distances (h, w) [1/m].

        side: of the windows [px]. 1 where no pair shows anything.
        """
        return self.cost_of(self.sums(inverse), side)

    def cost_of(self, sums: Map, side: int) -> Map:
        """Return the cost of given sums (5, h, w) of the neighbours."""
        one, own = np.float32(1.0), self.own * self.own
        s, p, squares = sums[0] + self.own, sums[1] + own, sums[2] + own
        weights, crossed = sums[3] + one, sums[4] + one
        above = window_mean(s * s - p, side)
        below = window_mean(squares * (weights * weights - crossed) / weights, side)
        return np.where(below > _LEAST_PAIRS, one - above / np.maximum(below, _LEAST_PAIRS), one).astype(np.float32)

    def unwarped(self, side: int) -> Map:
        """Return the mean correlation of all pairs (h, w) as they are: near 1 for what moves with the camera.

        side: of the windows [px].
        """
        pictures = self._pictures.reshape(self.count, self.height + 1, self.width + 1)[:, :-1, :-1]
        total, squares = pictures.sum(axis=0), np.einsum("nij,nij->ij", pictures, pictures)
        count = np.full_like(total, self.count)
        return np.float32(1.0) - self.cost_of(np.stack([total, squares, squares, count, count]), side)

    def shifted(self, inverse: float) -> Map:
        """Return how far what is at an inverse distance [1/m] moves in the camera's axes, (h, w) [rad].

        Root mean square over the neighbours.
        """
        square = np.zeros((self.height, self.width), np.float32)
        for turn, shift in zip(self._turns, self._shifts, strict=True):
            ray = np.tensordot(turn, self._rays - np.float32(inverse) * shift[:, None, None], 1)
            square += np.sum(np.square(ray / np.linalg.norm(ray, axis=0) - self._rays), axis=0)
        return np.sqrt(square / np.float32(self.count))

    def parallax(self, inverse: Map) -> Map:
        """Return the parallax (h, w) [rad]: root mean square over the neighbours, for inverse distances (h, w)."""
        square = np.zeros_like(inverse)
        for shift in self._shifts:
            square += float(shift @ shift) - np.square(np.tensordot(shift, self._rays, 1))
        return np.asarray(inverse * np.sqrt(np.maximum(square / len(self._shifts), 0.0)), np.float32)


def resized(picture: Map | NDArray[np.uint8], width: int) -> Map:
    """Return a picture (H, W) as float32 with another width, averaged."""
    import cv2

    if picture.shape[1] == width:
        return np.ascontiguousarray(picture, np.float32)
    small: Map = cv2.resize(np.asarray(picture, np.float32), (width, width // 2), interpolation=cv2.INTER_AREA)
    return small


def carried(inverse: Map, place: Panorama, reference: Panorama, width: int) -> Map:
    """Return inverse distances (h, w) [1/m] found at a place, as seen from the reference, (width / 2, width).

    The nearest of what falls into a pixel is seen there. Pixels that nothing falls into take the farther of those
    beside them in their row: what comes into view is behind.
    """
    fine = np.repeat(np.repeat(inverse, 2, axis=0), 2, axis=1)
    rays = directions(fine.shape[1], fine.shape[0]) @ (reference.rotation.T @ place.rotation).T
    shift = reference.rotation.T @ (place.position - reference.position)
    seen: Map = np.full((width // 2, width), -1.0, np.float32)
    _carry(fine, rays.astype(np.float32), shift.astype(np.float32), seen)
    _fill_rows(seen)
    return seen


@fast
def _carry(inverse: Any, rays: Any, shift: Any, seen: Any) -> None:
    """Write to seen (H, W) the largest inverse distances of points along rays (h, w, 3) that begin at a shift (3,)."""
    height, width = seen.shape
    for j in range(inverse.shape[0]):
        for i in range(inverse.shape[1]):
            q = inverse[j, i]
            x, y, z = rays[j, i, 0] + q * shift[0], rays[j, i, 1] + q * shift[1], rays[j, i, 2] + q * shift[2]
            length = np.sqrt(x * x + y * y + z * z)
            if length < np.float32(1e-6):
                continue
            column = int(np.float32(width) * (np.float32(0.5) + _arctangent(x, -z) / np.float32(2.0 * np.pi))) % width
            up = _arctangent(y, np.sqrt(x * x + z * z)) / np.float32(np.pi)
            row = min(max(int(np.float32(height) * (np.float32(0.5) - up)), 0), height - 1)
            seen[row, column] = max(seen[row, column], q / length)


@fast_making
def _fill_rows(seen: Any) -> None:
    """Replace negative values (H, W) by the lower of the nearest others to their left and right, 0 in empty rows."""
    height, width = seen.shape
    left = np.empty(width, np.float32)
    for j in range(height):
        last = np.float32(-1.0)
        for i in range(2 * width):  # round twice: rows are closed
            last = seen[j, i % width] if seen[j, i % width] >= 0 else last
            left[i % width] = last
        last = np.float32(-1.0)
        for k in range(2 * width - 1, -1, -1):
            i = k % width
            if seen[j, i] >= 0:
                last = seen[j, i]
            elif k < width:
                seen[j, i] = max(min(left[i], last), np.float32(0.0))
