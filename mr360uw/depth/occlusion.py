# SPDX-License-Identifier: Apache-2.0
"""Distances of a plate's frame that bodies are compared with: sure ones alone, at the frame's size.

A map of another size is enlarged along the edges of the picture (`enlarging`), which makes these soft.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.sphere import directions, frame_from_direction
from mr360uw.composite.receiver.shape import ReceiverShape, inverse_distance, running_mean, smoothed, width_px
from mr360uw.composite.shot import Receiver
from mr360uw.depth.depth_files import DepthClip, Kind
from mr360uw.depth.sphere_stereo import SURE, DepthMap
from mr360uw.depth.warping import Map, of_windows, resized
from mr360uw.jit import fast_making, inlined
from mr360uw.track.key_frames import grey_picture
from mr360uw.types import Floats, View
from mr360uw.video import VideoFrame

_NEAR = np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1]), axis=-1).reshape(-1, 2)
"""Pixels (row, column) about a direction whose distances are its own."""
_KEPT = 4
"""Frames whose distances are kept: two, of both eyes."""


def sure_surfaces(found: DepthMap, picture: Map) -> PlateSurfaces:
    """Return the surfaces of a map at the size of a grey picture (H, W), infinitely far where a map is not sure."""
    sure = np.where(found.confidence >= SURE, found.distance_m, np.float32(np.inf)).astype(np.float32)
    return PlateSurfaces(sure) if sure.shape == picture.shape else enlarged(sure, picture)


class PlateDepth(DepthClip):
    """The distances of a plate, in step with its frames, see `DepthClip`.

    right: whether its frames are those of the right eye.
    """

    def __init__(
        self, path: Path, kind: Kind = "metric", scale_m: float = 1.0, right: bool = False,
        size: tuple[int, int] = (2, 1),
    ) -> None:  # fmt: skip
        super().__init__(path, kind, scale_m, size)
        self._right, self._one_thread = right, threading.RLock()

    def surfaces(self, index: int, plate: VideoFrame, eye: int = 0) -> PlateSurfaces:
        """Return the sure surfaces of a frame, the same object for the same picture and map. eye: 1: the right one."""
        with self._one_thread:
            return self._kept.of(_of_frame, self.map_at(index, eye), plate, keep=_KEPT)

    def receiver_at(self, index: int, receiver: Receiver, view: View, eye: int = 0) -> Receiver:
        """Return a receiver as it is in a frame, with the relief of the plate: the same object while nothing changes.

        view: that of the frame. eye: 1 for the right one of two, else 0. For any thread.
        """
        with self._one_thread:
            return self._kept.of(on_relief, receiver, self.map_at(index, eye), view, keep=_KEPT)

    def ground_below(self, index: int, view: View) -> float | None:
        """Return how far [m] the ground is below the camera in a frame, None where the map does not tell (`relief`)."""
        with self._one_thread:
            return self._kept.of(_ground_below, self, index, np.array(view.world_from_camera[1]))

    def toward(self, index: int, directions: Floats) -> Floats:
        """Return the distances (...) [m] of what a frame shows in directions (..., 3) in the camera's axes.

        Each is the median of the sure pixels of the map about it; infinite where there are none.
        """
        found = self.map_at(index)
        height, width = found.distance_m.shape
        x, y = (np.asarray(v).astype(int)[..., None] for v in frame_from_direction(directions, width, height))
        rows, columns = np.clip(y + _NEAR[:, 0], 0, height - 1), (x + _NEAR[:, 1]) % width
        sure = found.confidence[rows, columns] >= SURE
        near = np.where(sure, found.distance_m[rows, columns], np.nan)
        near[~sure.any(axis=-1)] = np.inf
        return np.asarray(np.nanmedian(near, axis=-1))

    def map_at(self, index: int, eye: int = 0) -> DepthMap:
        """Return the map of a frame at its own size. eye: 1 for the right one of two, else 0."""
        with self._one_thread:
            return self.at(index, right=self._right or eye == 1)


def _ground_below(depth: PlateDepth, index: int, up: Floats) -> float | None:
    return ground_below(depth.map_at(index), up)


def _of_frame(found: DepthMap, plate: VideoFrame) -> PlateSurfaces:
    """Return the sure surfaces of a frame."""
    import cv2

    height, width = plate.image_linear.shape[:2] if plate.yuv is None else plate.yuv.y.shape
    grey = grey_picture(plate).astype(np.float32)
    if grey.shape != (height, width):
        grey = np.asarray(cv2.resize(grey, (width, height), interpolation=cv2.INTER_LINEAR), np.float32)
    return sure_surfaces(found, grey)


# The plate's own relief as a receiver: a map of distances that is sure in places, and another surface elsewhere.
#
# Measured distances are off by some tenths of a per cent from pixel to pixel, which would tilt normals by 15 degrees,
# so they are smoothed, by no more than `OFF` of their values. Where a map is not sure, its distance is used if it is
# between the sure ones about it, as beside edges. The inverse distance, which is linear in the picture on a plane, is
# what is averaged.

MOST_COLUMNS = 1024
"""Columns to which larger maps are reduced: what is between is smoothed away."""
OFF, OFF_IN_HOLES = 0.02, 0.1
"""Fractions by which smoothing may change a distance, and one of which the map is not sure."""
_WIDTHS_DEG = (3.9, 1.8, 1.8, 0.7, 0.7)
"""Widths of the running means. Of synthetic dives with distances off by .25 % the normals of floors and rocks
are off by 3 to 6 degrees in the median; wider means bend those of rocks, narrower ones leave more noise."""
_ABOUT_DEG = 7.4
"""Width of the window about a pixel whose sure distances tell whether an unsure one can be right. 5: the middle of a
passing fish is not covered; 11: twice as much open water beside a wall is taken for wall."""
_SUPPORT = 0.1
"""Fraction of the pixels of such a window that must be sure: specks are often wrong."""
_LEAST_GROUND = 0.05
"""Fraction of the pixels far below the horizon that tell how far the ground is."""
_MOSTLY = 0.75
"""Fraction of a pixel of a reduced map that is sure, above which it is."""
_ALIKE = 0.1
"""Largest fraction by which an unsure inverse distance may exceed the sure ones about it."""


def on_relief(receiver: Receiver, found: DepthMap, view: View) -> Receiver:
    """Return a receiver with the shape that a frame's map shows where it is sure; its own shape elsewhere.

    view: that of the frame.
    """
    inverse, sure = inverse_distance(found.distance_m), (found.confidence >= SURE).astype(np.float32)
    if inverse.shape[1] > MOST_COLUMNS:
        seen = resized((inverse > 0.0).astype(np.float32), MOST_COLUMNS)
        inverse = (resized(inverse, MOST_COLUMNS) / np.maximum(seen, _MOSTLY)).astype(np.float32)
        sure = resized(sure, MOST_COLUMNS)
    of_map = (sure > _MOSTLY) & (inverse > 0.0)
    used = of_map | _between_sure(inverse, of_map)
    sees = replace(view, width=inverse.shape[1], height=inverse.shape[0])
    j, i = np.nonzero(~used)
    x, y = i + 0.5, j + 0.5
    elsewhere, _ = ReceiverShape(receiver, view.position).meet(sees, x, y)
    inverse[j, i] = inverse_distance(elsewhere)
    off = np.where(used & ~of_map, np.float32(OFF_IN_HOLES), np.float32(OFF))
    with np.errstate(divide="ignore"):
        shape = np.float32(1.0) / smoothed(inverse, inverse * (1.0 - off), inverse * (1.0 + off), _WIDTHS_DEG)
    return replace(receiver, plane_y=None, mesh=None, distance_m=shape)


def _between_sure(inverse: Map, sure: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the pixels (h, w) whose inverse distance [1/m] is between the sure ones in a window about them."""
    import cv2

    side = width_px(_ABOUT_DEG, sure.shape[1])
    least = of_windows(cv2.erode, np.where(sure, inverse, np.float32(np.inf)), side)
    most = of_windows(cv2.dilate, np.where(sure, inverse, np.float32(0.0)), side)
    enough = running_mean(sure.astype(np.float32), side) > _SUPPORT
    return enough & (inverse > (1.0 - _ALIKE) * least) & (inverse < (1.0 + _ALIKE) * most)


def ground_below(found: DepthMap, up: Floats) -> float | None:
    """Return how far [m] the ground is below the camera, as the median of what a map is sure of 30 degrees below it.

    up: (3,) in the camera's axes. None where less than a twentieth of that is sure.
    """
    rows, columns = found.distance_m.shape
    down = -directions(columns, rows) @ up
    under, sure = down > 0.5, found.confidence >= SURE
    seen = under & sure & np.isfinite(found.distance_m)
    if np.count_nonzero(seen) < _LEAST_GROUND * np.count_nonzero(under):
        return None
    return float(np.median(found.distance_m[seen] * down[seen]))


# Enlarges distance maps along the edges of a picture: soft edges between two surfaces, nothing in between.
#
# Where the nine samples of a map about a pixel lie on one surface, its inverse distance is bilinear. Where they lie on
# two, a distance between these would be a rim around what is in front. Instead the pixel shows both, and its brightness
# says how much of each: it lies between those of the near and of the far surface, as the samples about it have them.
# Where the two look alike, the samples alone say it. This fraction is continuous in the picture, so grain moves it
# little, and it is averaged along the edge, whose direction the map gives: grain cancels, and the edge stays sharp.

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


@fast_making
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


@fast_making
def _average_along(near: Any, far: Any, share: Any, normal: Any, out: Any) -> None:
    """Write fractions of near surfaces (H, W), averaged along edges with the normals (2, H, W), which paths follow.

    near, far: inverse distances (H, W) [1/m]; where they are equal there is one surface.
    """
    # Weigh steps along an edge by a Gaussian; the middle counts once of both ways
    rows, columns = near.shape
    weights = np.exp(np.float32(-0.5) * np.square(np.arange(_REACH + 1) / np.float32(_ALONG_PX))).astype(np.float32)
    weights[0] *= np.float32(0.5)
    for j in range(rows):
        for i in range(columns):
            if near[j, i] == far[j, i]:
                continue
            middle = np.float32(0.5) * (near[j, i] + far[j, i])
            total, whole = np.float32(0.0), np.float32(0.0)
            # Follow the edge both ways, half a pixel's normal ahead (midpoint rule)
            for way in (np.float32(-1.0), np.float32(1.0)):
                x, y = np.float32(i), np.float32(j)
                nx, ny = normal[0, j, i], normal[1, j, i]
                for k in range(_REACH + 1):
                    top, left = int(np.floor(y)), int(np.floor(x))
                    if top < 0 or top + 1 >= rows:
                        break
                    v, u = y - np.float32(top), x - np.float32(left)
                    right, left = (left + 1) % columns, left % columns
                    # Read the fraction between four pixels, of those at this edge alone
                    upper = (1 - u) * _near_at(near, far, share, top, left, middle)
                    upper += u * _near_at(near, far, share, top, right, middle)
                    lower = (1 - u) * _near_at(near, far, share, top + 1, left, middle)
                    lower += u * _near_at(near, far, share, top + 1, right, middle)
                    total += weights[k] * ((1 - v) * upper + v * lower)
                    whole += weights[k]
                    if nx == 0 and ny == 0:
                        break
                    # Turn with the edge, unless its normal jumps
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
