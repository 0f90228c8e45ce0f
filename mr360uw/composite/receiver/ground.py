# SPDX-License-Identifier: Apache-2.0
"""Receiver geometry on blocks of BLOCK x BLOCK pixels, for interpolation of light between block corners.

Light on the ground mostly varies slowly, so pixels of a block are interpolated from its corners. A block is *rough* if
its corners do not represent the pixels inside: at an edge or end of the receiver, in the belt in which it fades out,
and in small frames, where a block spans a large angle. Rough blocks are evaluated pixel by pixel.
"""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.composite.receiver.ratio import FADE_FROM
from mr360uw.composite.receiver.shape import ReceiverShape
from mr360uw.composite.sampling import Gaps
from mr360uw.composite.shot import Shot
from mr360uw.jit import exact
from mr360uw.types import Floats


@exact
def survey_blocks(j: Any, i: Any, corner: Any, middle: Any, reach_m: Any, balls: Any, change: Any, near: Any) -> None:
    """Find how values change over blocks (n,), and which blocks reach into a ball.

    corner: (R + 1, C + 1, k). middle: (R, C, 3) and reach_m: (R, C) of the blocks, balls: (b, 4) middle and radius, all
    [m]. change: (n,) set to the largest difference of two corners in any channel; near: (n,) set.
    """
    for n in range(len(j)):
        r, c = j[n], i[n]
        change[n], near[n] = 0.0, False
        for k in range(corner.shape[2]):
            v00, v01, v10, v11 = corner[r, c, k], corner[r, c + 1, k], corner[r + 1, c, k], corner[r + 1, c + 1, k]
            change[n] = max(change[n], max(v00, v01, v10, v11) - min(v00, v01, v10, v11))
        for b in range(len(balls)):
            x, y, z = middle[r, c, 0] - balls[b, 0], middle[r, c, 1] - balls[b, 1], middle[r, c, 2] - balls[b, 2]
            far = balls[b, 3] + reach_m[r, c]
            near[n] |= x * x + y * y + z * z < far * far


@exact
def measure_blocks(
    j: Any, i: Any, corner: Any, middle: Any, limit: Any, factor: Any, rough: Any, reach_m: Any
) -> None:  # fmt: skip
    """Mark blocks (n,) as rough whose corners or middle do not lie on the receiver, or farther away than `limit` [m].

    corner: (R + 1, C + 1, 3), middle: (R, C, 3), from the camera. reach_m: (R, C) set to `factor` times the distance of
    the farthest corner from the middle.
    """
    for n in range(len(j)):
        r, c = j[n], i[n]
        u, v, w = np.float64(middle[r, c, 0]), np.float64(middle[r, c, 1]), np.float64(middle[r, c, 2])
        far = u * u + v * v + w * w
        off, longest = far == 0.0, 0.0
        for k in range(4):
            p = corner[r + k // 2, c + k % 2]
            x, y, z = np.float64(p[0]), np.float64(p[1]), np.float64(p[2])
            squared = x * x + y * y + z * z
            off |= squared == 0.0
            far = max(far, squared)
            longest = max(longest, (x - u) ** 2 + (y - v) ** 2 + (z - w) ** 2)
        rough[r, c] |= off or far > limit * limit
        reach_m[r, c] = factor * np.sqrt(longest)


@exact
def mark_changed(j: Any, i: Any, corner: Any, middle: Any, reach_m: Any, balls: Any, least: Any, marks: Any) -> None:
    """Set the marks (n,) of blocks that reach into a ball, or where a factor at a corner is not 1 by more than `least`.

    corner: (R + 1, C + 1, k) factors; the others are those of `survey_blocks`.
    """
    one = corner.dtype.type(1)
    for n in range(len(j)):
        r, c = j[n], i[n]
        for k in range(corner.shape[2]):
            v00, v01, v10, v11 = corner[r, c, k], corner[r, c + 1, k], corner[r + 1, c, k], corner[r + 1, c + 1, k]
            marks[n] |= max(abs(v00 - one), abs(v01 - one), abs(v10 - one), abs(v11 - one)) > least
        for b in range(len(balls)):
            x, y, z = middle[r, c, 0] - balls[b, 0], middle[r, c, 1] - balls[b, 1], middle[r, c, 2] - balls[b, 2]
            far = balls[b, 3] + reach_m[r, c]
            marks[n] |= x * x + y * y + z * z < far * far


BLOCK = 8
"""Pixels along a block."""
_EVEN_DISTANCE = 0.01
_EVEN_NORMAL = 0.005
"""Interpolation errors of distance (relative) and normal above which a block is rough: below a code value each."""
_UNBROKEN = 0.05
"""That error of distance above which a block has an edge. On rubble it is 1 to 4 %."""

_REACH, _REACH_OF_SHAPE = 1.1, 1.5
"""Factors on the distance to the farthest corner, and on the largest step in distance, to bound all of a block."""
_WIDEST_TURN = 1.0 / 48.0
"""Fraction of a turn that a block may span. In frames narrower than 384 pixels it spans more, and may contain the whole
shadow of a small body, which corners and middle then miss: all blocks are rough."""

Indices = NDArray[np.int64]


class Ground:
    """Points and normals of the receiver for one camera pose, on the blocks given to `load_blocks`, on any thread.

    corner_point, corner_normal: (R + 1, C + 1, 3) float32, middle_point, middle_normal: (R, C, 3), from the camera [m];
    corner (j, i) is at frame coordinates (8 i, 8 j). reach_m: (R, C) radius of a ball about the middle that contains
    the block. rough: (R, C). broken: (R, C) rough, and with an edge: light that varies slowly on a surface jumps there.
    """

    def __init__(self, shot: Shot, shape: ReceiverShape) -> None:
        self._shape, self._lock = shape, threading.RLock()
        self._height = shot.view.height
        self.rows, self.columns = -(-shot.view.height // BLOCK), -(-shot.view.width // BLOCK)
        corners, blocks = (self.rows + 1, self.columns + 1), (self.rows, self.columns)
        self.corner_point, self.corner_normal = np.zeros((2, *corners, 3), np.float32)
        self.middle_point, self.middle_normal = np.zeros((2, *blocks, 3), np.float32)
        self.reach_m = np.zeros(blocks, np.float32)
        self.broken = np.full(blocks, _WIDEST_TURN * shot.view.width < BLOCK)
        self.rough = self.broken.copy()
        self._loaded_corner, self._loaded_block = np.zeros(corners, np.bool_), np.zeros(blocks, np.bool_)
        self._image_at = np.full(blocks, -1, np.int64)
        self._images = np.zeros((0, BLOCK, BLOCK, 4), np.float32)

    def corners_of(self, blocks: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return the corners (R + 1, C + 1) of a set of blocks (R, C)."""
        corners = np.zeros((self.rows + 1, self.columns + 1), np.bool_)
        for down in (0, 1):
            for right in (0, 1):
                corners[down : self.rows + down, right : self.columns + right] |= blocks
        return corners

    def load_blocks(self, shot: Shot, blocks: NDArray[np.bool_]) -> None:
        """Compute points and normals of a set of blocks (R, C) and their corners, unless they are loaded already."""
        with self._lock:
            new = blocks & ~self._loaded_block
            if np.any(new):
                self._load(shot, new)

    def _load(self, shot: Shot, new: NDArray[np.bool_]) -> None:
        """Compute points and normals of blocks (R, C) that are not loaded."""
        receiver, corners = shot.receiver, self.corners_of(new)
        level = receiver is not None and receiver.plane_y is not None
        # Of a plane, all places in the rectangle around the blocks cost less than it takes to pick them
        corner, j, i = _places(corners if level else corners & ~self._loaded_corner, around=level)
        self.corner_point[corner], self.corner_normal[corner] = self.meet(
            shot, BLOCK * i, np.minimum(BLOCK * j, self._height)
        )
        middle, j, i = _places(new, around=level)
        below = np.minimum(BLOCK * (j + 1), self._height)
        self.middle_point[middle], self.middle_normal[middle] = self.meet(
            shot, BLOCK * (i + 0.5), 0.5 * (BLOCK * j + below)
        )
        # Find which of them their corners represent, and how far they reach
        j, i = np.nonzero(new)
        limit = FADE_FROM * receiver.extent_m if receiver is not None else np.inf
        measure_blocks(j, i, self.corner_point, self.middle_point, limit, _REACH, self.broken, self.reach_m)
        self.rough[j, i] |= self.broken[j, i]
        if not level:
            self._classify(shot, j, i)
        self._loaded_corner |= corners
        self._loaded_block |= new

    def meet(self, shot: Shot, x: ArrayLike, y: ArrayLike) -> tuple[Floats, Floats]:
        """Return points and normals (..., 3) of the receiver at frame coordinates, zero where there is no receiver."""
        x, y = np.asarray(x, np.float64), np.asarray(y, np.float64)
        direction = shot.view.directions(x, y)
        distance, normal = self._shape.meet_along(shot.view, x, y, direction)
        there = np.isfinite(distance)
        point = np.where(there[..., None], shot.view.points(direction, np.where(there, distance, 0.0)), 0.0)
        return point, np.where(there[..., None], normal, 0.0)

    def _classify(self, shot: Shot, j: Indices, i: Indices) -> None:
        """Set `rough`, `broken` and `reach_m` of blocks from all their pixels."""
        pixels = self.pixels(shot, j, i)
        distance, normal = pixels[..., 3], pixels[..., :3]
        interpolated = self.between(self.corner_point, j, i), self.between(self.corner_normal, j, i)
        expected = np.linalg.norm(interpolated[0], axis=-1)
        missed = np.abs(distance - expected)
        uneven = missed > _EVEN_DISTANCE * expected
        uneven |= np.abs(normal - interpolated[1]).max(axis=-1) > _EVEN_NORMAL
        self.rough[j, i] |= np.any(uneven, axis=(1, 2))
        self.broken[j, i] |= np.any(missed > _UNBROKEN * expected, axis=(1, 2))
        beyond = np.abs(distance - np.linalg.norm(self.middle_point[j, i], axis=-1)[:, None, None]).max(axis=(1, 2))
        self.reach_m[j, i] = np.maximum(self.reach_m[j, i], _REACH_OF_SHAPE * beyond)

    def pixels(self, shot: Shot, j: Indices, i: Indices) -> NDArray[np.float32]:
        """Return (normal, distance) of the pixels of blocks, (n, BLOCK, BLOCK, 4); distance 0 where there is none."""
        with self._lock:
            return self._pixels(shot, j, i)

    def _pixels(self, shot: Shot, j: Indices, i: Indices) -> NDArray[np.float32]:
        new = self._image_at[j, i] < 0
        if np.any(new):
            nj, ni = j[new], i[new]
            inside = np.arange(BLOCK) + 0.5
            x = BLOCK * ni[:, None, None] + inside
            y = np.minimum(BLOCK * nj[:, None, None] + inside[:, None], self._height - 0.5)
            distance, normal = self._shape.meet(shot, x, y)
            there = np.isfinite(distance)[..., None]
            found = np.where(there, np.concatenate([normal, distance[..., None]], axis=-1), 0.0)
            self._image_at[nj, ni] = len(self._images) + np.arange(len(nj))
            self._images = np.concatenate([self._images, found.astype(np.float32)])
        return self._images[self._image_at[j, i]]

    def gaps_in(self, gaps: Gaps, j: Indices, i: Indices) -> tuple[Gaps, Indices]:
        """Return the gaps within blocks (n,), and for each the number of its block among these."""
        number = np.full((self.rows, self.columns), -1)
        number[j, i] = np.arange(len(j))
        block = number[gaps.row // BLOCK, gaps.column // BLOCK]
        return gaps.some(np.flatnonzero(block >= 0)), block[block >= 0]

    def between(self, corner: Floats, j: Indices, i: Indices) -> Floats:
        """Return corner values (R + 1, C + 1, k) interpolated to the pixels of blocks, (n, BLOCK, BLOCK, k)."""
        t = ((np.arange(BLOCK) + 0.5) / BLOCK).astype(np.float32)
        down = np.minimum((np.arange(BLOCK) + 0.5) / np.minimum(self._height - BLOCK * j, BLOCK)[:, None], 1.0)
        down = down.astype(np.float32)[:, :, None, None]
        four = self.four(corner, j, i)
        left = four[:, None, 0] * (1.0 - down[..., 0]) + four[:, None, 2] * down[..., 0]
        right = four[:, None, 1] * (1.0 - down[..., 0]) + four[:, None, 3] * down[..., 0]
        return left[:, :, None] * (1.0 - t[:, None]) + right[:, :, None] * t[:, None]

    @staticmethod
    def four(corner: Floats, j: Indices, i: Indices) -> Floats:
        """Return the corners of blocks, (n, 4, ...): above left and right, below left and right."""
        return np.stack([corner[j, i], corner[j, i + 1], corner[j + 1, i], corner[j + 1, i + 1]], axis=1)

    def middle_between(self, corner: Floats, j: Indices, i: Indices) -> Floats:
        """Return corner values (R + 1, C + 1) interpolated to the middles of blocks, (n,)."""
        return np.asarray(self.four(corner, j, i).mean(axis=1))


def _places(mask: NDArray[np.bool_], *, around: bool) -> tuple[Any, Indices, Indices]:
    """Return an index of the set places of a mask (h, w), and their rows and columns; around: of all places in the
    smallest rectangle about them. At least one is set.
    """
    if not around:
        j, i = np.nonzero(mask)
        return (j, i), j, i
    (top, bottom), (left, right) = (np.flatnonzero(mask.any(axis=axis))[[0, -1]] for axis in (1, 0))
    rows, columns = np.arange(top, bottom + 1), np.arange(left, right + 1)
    return (slice(top, bottom + 1), slice(left, right + 1)), rows[:, None], columns
