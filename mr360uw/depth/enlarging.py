# SPDX-License-Identifier: Apache-2.0
"""Enlarges distance maps along the edges of a picture: soft edges between two surfaces, nothing in between.

Where the nine samples of a map about a pixel lie on one surface, its inverse distance is bilinear. Where they lie on
two, a distance between these would be a rim around what is in front. Instead the pixel shows both, and its brightness
says how much of each: it lies between those of the near and of the far surface, as the samples about it have them.
Where the two look alike, the samples alone say it. This fraction is continuous in the picture, so grain moves it
little, and it is averaged along the edge, whose direction the map gives: grain cancels, and the edge stays sharp.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mr360uw.depth.warping import Map, resized
from mr360uw.jit import fast, inlined

_SAME = np.float32(0.87)
"""Ratio of inverse distances above which they are of one surface. Nearer to 1: slanted floors count as two."""
_MIXED = np.float32(0.03)
"""Weight, in the brightness of a surface, of samples beside the other one, which show both."""
_SPREAD = np.float32(0.25)
"""Of the Gaussian weights exp(-spread d^2) of samples d apart from a pixel."""
_GRAIN, _PATTERN = np.float32(100.0), np.float32(2.0)
"""Variance of grain [codes^2], and factor of the variance of a surface's own pattern: where the square of the step
between two surfaces equals their sum, half of the fraction comes from the picture and half from the samples. Twice as
large: less flicker and more error in pictures of little contrast."""
_DEAD = np.float32(0.15)
"""Fraction up to which another surface does not count, nor is missed: patterns make no holes. .1: with maps of a
quarter of the size a tenth more error; .2: a tenth more flicker."""
_ALONG_PX = 5.0
"""Deviation [px] of the Gaussian weights along an edge. 3: grain moves alpha by half more."""
_REACH = 10
"""Pixels to either side along an edge that are averaged."""


@dataclass(frozen=True, slots=True, eq=False)
class PlateSurfaces:
    """One or two surfaces in each pixel of a picture, arrays (H, W) float32.

    distance_m: of the surface that covers most of the pixel [m], infinite where it is not known. beside_m: of that
    which covers the rest. share: the fraction that the latter covers, 0 to 0.5. None: there is one in each.
    """

    distance_m: Map
    beside_m: Map | None = None
    share: Map | None = None


def enlarged(distance_m: Map, picture: Map) -> PlateSurfaces:
    """Return distances (h, w) [m] at the size of a grey picture (H, W), codes in [0, 255], along its edges."""
    with np.errstate(divide="ignore"):
        inverse = np.ascontiguousarray(np.float32(1.0) / distance_m, np.float32)
        near, far, share = (np.zeros(picture.shape, np.float32) for _ in range(3))
        normal = np.zeros((2, *picture.shape), np.float32)
        _split(inverse, resized(picture, inverse.shape[1]), picture, near, far, share, normal)
        _average_along(near, far, share.copy(), normal, share)
        mostly = share >= 0.5
        main, beside = (1.0 / np.where(mostly, *two) for two in ((near, far), (far, near)))
        return PlateSurfaces(main.astype(np.float32), beside.astype(np.float32), np.minimum(share, 1.0 - share))


@inlined
def _between(values: Any, y: Any, x: Any, cut: Any) -> Any:
    """Return values (h, w) at (y, x), bilinear with closed rows; for a cut of 0 or more, of whether they exceed it."""
    height, width = values.shape
    top, left = int(np.floor(y)), int(np.floor(x))
    v, u = np.float32(y - top), np.float32(x - left)
    upper, lower = min(max(top, 0), height - 1), min(max(top + 1, 0), height - 1)
    a, b = values[upper, left % width], values[upper, (left + 1) % width]
    c, d = values[lower, left % width], values[lower, (left + 1) % width]
    if cut >= 0:
        a, b, c, d = np.float32(a > cut), np.float32(b > cut), np.float32(c > cut), np.float32(d > cut)
    return (1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * c + u * d)


@inlined
def _cut(nine: Any) -> Any:
    """Return the inverse distance between two surfaces that nine sorted samples lie on; -1 for one alone."""
    cut, gap = np.float32(-1.0), np.float32(0.0)
    for k in range(8):
        if nine[k + 1] - nine[k] > gap and nine[k] < _SAME * nine[k + 1]:
            gap, cut = nine[k + 1] - nine[k], np.float32(0.5) * (nine[k] + nine[k + 1])
    return cut


@fast
def _split(inverse: Any, small: Any, large: Any, near: Any, far: Any, share: Any, normal: Any) -> None:
    """Write inverse distances of near and far surfaces, the fraction of the near, and normals of edges (2, H, W).

    inverse: (h, w) [1/m]. large: the picture (H, W); small: its mean (h, w). Where there is one surface both are its
    distance and the fraction is 1; normals, (x, y) towards the near surface, are 0 there.
    """
    height, width = inverse.shape
    rows, columns = large.shape
    nine = np.empty(9, np.float32)
    sums = np.empty((2, 7), np.float32)  # of far and near samples, see below
    for j in range(rows):
        y = np.float32((j + 0.5) * height / rows - 0.5)
        middle = int(np.rint(y))
        for i in range(columns):
            x = np.float32((i + 0.5) * width / columns - 0.5)
            centre = int(np.rint(x))
            least, most = np.float32(1e9), np.float32(0.0)
            for b in range(3):
                row = min(max(middle + b - 1, 0), height - 1)
                for a in range(3):
                    q = inverse[row, (centre + a - 1) % width]
                    nine[3 * b + a] = q
                    least, most = min(least, q), max(most, q)
            cut = np.float32(-1.0) if least >= _SAME * most else _cut(np.sort(nine))
            share[j, i] = np.float32(1.0)
            if cut < 0:
                near[j, i] = far[j, i] = _between(inverse, y, x, np.float32(-1.0))
                continue
            sums[:] = np.float32(0.0)
            for b in range(-2, 3):
                row = min(max(middle + b, 0), height - 1)
                above, below = max(row - 1, 0), min(row + 1, height - 1)
                for a in range(-2, 3):
                    column = (centre + a) % width
                    q, code = inverse[row, column], small[row, column]
                    side = int(q > cut)
                    pure = (
                        int(inverse[above, column] > cut) == side
                        and int(inverse[below, column] > cut) == side
                        and int(inverse[row, (column + 1) % width] > cut) == side
                        and int(inverse[row, column - 1] > cut) == side
                    )
                    dx, dy = np.float32(centre + a - x), np.float32(middle + b - y)
                    w = np.exp(-_SPREAD * (dx * dx + dy * dy))
                    sums[side, 0] += w
                    sums[side, 1] += w * q
                    sums[side, 2] += w * dx
                    sums[side, 3] += w * dy
                    w = w if pure else _MIXED * w
                    sums[side, 4] += w
                    sums[side, 5] += w * code
                    sums[side, 6] += w * code * code
            far[j, i], near[j, i] = sums[0, 1] / sums[0, 0], sums[1, 1] / sums[1, 0]
            dx = sums[1, 2] / sums[1, 0] - sums[0, 2] / sums[0, 0]
            dy = sums[1, 3] / sums[1, 0] - sums[0, 3] / sums[0, 0]
            length = np.sqrt(dx * dx + dy * dy)
            if length > np.float32(0.5):
                normal[0, j, i], normal[1, j, i] = dx / length, dy / length
            dark, bright = sums[0, 5] / sums[0, 4], sums[1, 5] / sums[1, 4]
            pattern = sums[0, 6] / sums[0, 4] - dark * dark + sums[1, 6] / sums[1, 4] - bright * bright
            step = bright - dark
            spread = _GRAIN + np.float32(0.5) * _PATTERN * max(pattern, np.float32(0.0))
            told = step * step / (step * step + spread)
            alike = (large[j, i] - dark) / step if abs(step) > 1 else np.float32(0.0)
            alike = min(max(alike, np.float32(0.0)), np.float32(1.0))
            part = told * alike + (1 - told) * _between(inverse, y, x, cut)
            part = min(max((part - _DEAD) / (1 - 2 * _DEAD), np.float32(0.0)), np.float32(1.0))
            share[j, i] = part * part * (3 - 2 * part)


@fast
def _average_along(near: Any, far: Any, share: Any, normal: Any, out: Any) -> None:
    """Write fractions of near surfaces (H, W), averaged along edges with the normals (2, H, W), which paths follow.

    near, far: inverse distances (H, W) [1/m]; where they are equal there is one surface.
    """
    rows, columns = near.shape
    weights = np.exp(np.float32(-0.5) * np.square(np.arange(_REACH + 1) / np.float32(_ALONG_PX))).astype(np.float32)
    weights[0] *= np.float32(0.5)
    for j in range(rows):
        for i in range(columns):
            if near[j, i] == far[j, i]:
                continue
            middle = np.float32(0.5) * (near[j, i] + far[j, i])
            total, whole = np.float32(0.0), np.float32(0.0)
            for way in (np.float32(-1.0), np.float32(1.0)):
                x, y = np.float32(i), np.float32(j)
                nx, ny = normal[0, j, i], normal[1, j, i]
                for k in range(_REACH + 1):
                    top, left = int(np.floor(y)), int(np.floor(x))
                    if top < 0 or top + 1 >= rows:
                        break
                    v, u = y - np.float32(top), x - np.float32(left)
                    right, left = (left + 1) % columns, left % columns
                    upper = (1 - u) * _near_at(near, far, share, top, left, middle)
                    upper += u * _near_at(near, far, share, top, right, middle)
                    lower = (1 - u) * _near_at(near, far, share, top + 1, left, middle)
                    lower += u * _near_at(near, far, share, top + 1, right, middle)
                    total += weights[k] * ((1 - v) * upper + v * lower)
                    whole += weights[k]
                    if nx == 0 and ny == 0:
                        break
                    half = np.float32(0.5) * way
                    row = min(max(int(np.rint(y + half * nx)), 0), rows - 1)
                    column = int(np.rint(x - half * ny)) % columns
                    mx, my = normal[0, row, column], normal[1, row, column]
                    if mx * nx + my * ny > np.float32(0.5):
                        nx, ny = mx, my
                    x, y = x - way * ny, y + way * nx
            out[j, i] = total / whole if whole > 0 else share[j, i]


@inlined
def _near_at(near: Any, far: Any, share: Any, row: Any, column: Any, middle: Any) -> Any:
    """Return the fraction of a pixel that near surfaces cover; 0 or 1 where one alone is beyond or before `middle`."""
    if near[row, column] != far[row, column]:
        return share[row, column]
    return np.float32(1.0) if near[row, column] > middle else np.float32(0.0)
