# SPDX-License-Identifier: Apache-2.0
"""Level ground around bodies in nested squares, fine where the light that they block changes fast.

A square's samples, 3 x 3, are predicted from those of the square that it is a quarter of. The error of a biquadratic
falls with the third power of its size, so where a prediction misses by up to eight times the tolerance the square
itself is within it. Where a square meets a larger one, its samples on their common side that the larger one lacks take
the larger one's value, so values are continuous. Squares at the end of refinement, across a jump, are bilinear. What is
sampled and how fine does not depend on the light: it is kept while bodies stand still, and while they move together
along the ground by less than the camera's place is rounded to.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.ambient.blocked_light import UNNOTICED, BlockedLight, Occluders, joined, shown
from mr360uw.composite.ambient.horizon_scan import most_blocked
from mr360uw.composite.ambient.sky_table import glow_table
from mr360uw.jit import fast, inlined
from mr360uw.types import Floats

NOTHING, SMOOTH_PATCH, JUMP_PATCH = 0, 1, 2
"""Kinds of cells: where no light is blocked, biquadratic, and bilinear between samples."""

TOLERANCE = 0.004
"""Largest error of the blocked fraction between samples: a code value. With half of it there are a third more."""
_PREDICTED = 4.0
"""Most that a prediction may miss, over the tolerance: half of what it falls by, as light changes unevenly."""
_ROOTS = 4
"""Squares along the longer side of the ground around all bodies, before they are quartered."""
_ASIDE = np.array([1.0 / 3.0, 1.0 / 5.0])
"""Place of a corner of the largest squares beside the first body's origin, over their side. At the origin itself, light
at the corner of a box that hangs above the ground rises by .002 outwards.
"""
_DEEPEST = 16
"""Most times that a square is quartered."""
_FINEST = 0.5
"""Least distance of samples, in pixels across the frame."""
_FAINT, _FAINT_APART, _FAINT_RAD = 0.03, 4.0, 0.0131
"""Steps of the blocked fraction below the first number, half of which is a code value where ambient light is half of
all, are not followed to samples nearer than so many pixels, nor nearer than 0.75 degrees where pixels are wider. Sweeps
make such steps where rays begin to meet a thin part of a body: squares along them were four fifths of all.
"""
_CAMERA_STEP, _LOWEST_M = 0.25, 1e-3
"""Part of its height above the ground to which the camera's place is rounded, and the least height [m]."""
_AT = 0.25 * np.arange(3) + 0.5 * np.arange(2)[:, None]
_QUARTERS = np.stack([(1.0 - _AT) * (1.0 - 2.0 * _AT), 4.0 * _AT * (1.0 - _AT), _AT * (2.0 * _AT - 1.0)], axis=-1)
"""Weights (2, 3, 3) of a side's three samples at those of its halves."""
_LARGEST = 1.6
"""Largest side of a square over its distance to a body: twice as large, squares pass over what bodies block."""


@dataclass(frozen=True, slots=True, eq=False)
class Quadtree:
    """Nested squares of ground around bodies, fine where it changes; places are from the point of the ground that those
    of the bodies are from.

    low: (2,) x and z [m] of the lowest corner; root_m: side of the largest squares; roots: (2,) of them. child:
    (nodes,) first of four quarters, or -1; kind: (nodes,) one of the three kinds above; sample: (nodes, 9).

    place: (samples, 3) [m]; blocked: there. hanging, leaf, at: of `set_hanging`.
    """

    low: Floats
    root_m: float
    roots: NDArray[np.int64]
    child: NDArray[np.int32]
    kind: NDArray[np.int8]
    sample: NDArray[np.int32]
    place: Floats
    blocked: BlockedLight
    hanging: NDArray[np.int64]
    leaf: NDArray[np.int64]
    at: Floats

    def joined(self, values: Floats) -> Floats:
        """Return values (samples, k) for `between`, without steps between patches."""
        values = values.copy()
        set_hanging(self.hanging, self.leaf, self.at, self.kind, self.sample, values)
        return values

    def between(self, values: Floats, points: Floats, elsewhere: float) -> tuple[Floats, NDArray[np.bool_]]:
        """Return joined values at points (n, 3) of the ground, (n, k), and whether they jump near there, (n,).

        elsewhere: the value where bodies block nothing.
        """
        out, jump = np.full((len(points), values.shape[-1]), elsewhere), np.zeros(len(points), np.bool_)
        place = (points[:, [0, 2]] - self.low) / self.root_m
        look_up(place, self.roots, self.child, self.kind, self.sample, values, out, jump)
        return out, jump

    def jumps(self) -> Floats:
        """Return the places (n, 3) of the samples of the smallest squares, within which the blocked light jumps."""
        leaf = (self.kind == JUMP_PATCH) & (self.child < 0)
        return self.place[np.unique(self.sample[leaf])]


def make_quadtree(bodies: Occluders, camera: Floats, pixel_rad: float, extent_m: float) -> Quadtree:
    """Return the patches of the ground around bodies, as far from a camera as `extent_m`.

    camera: (3,) of `camera_place`. pixel_rad: width of its pixels, which samples are not much finer than.
    """
    return _Builder(bodies, camera, pixel_rad, extent_m).build()


def camera_place(camera: Floats) -> Floats:
    """Return the place (3,) of a camera from a point of the ground, rounded to about a quarter of its height: from
    there patches are as fine.
    """
    step = 2.0 ** np.round(np.log2(max(abs(camera[1]), _LOWEST_M))) * _CAMERA_STEP
    return np.asarray(np.round(camera / step) * step + 0.0)


class _Builder:
    """Quarters squares, one depth after the other."""

    def __init__(self, bodies: Occluders, camera: Floats, pixel_rad: float, extent_m: float) -> None:
        self._bodies, self._normal = bodies, np.array([0.0, 1.0 if camera[1] >= 0.0 else -1.0, 0.0])
        self._camera, self._pixel_rad, self._extent_m = camera, pixel_rad, extent_m
        self._plans = plans = bodies.plans()
        wide = np.hypot(plans[:, 4], plans[:, 5])
        reach = (wide + np.cbrt(wide * plans[:, 7] ** 2 * len(plans) / (2.0 * UNNOTICED)))[:, None]
        low, high = ((plans[:, :2] + way * reach) for way in (-1.0, 1.0))
        low, high = low.min(axis=0), high.max(axis=0)
        self._root_m = 2.0 ** np.ceil(np.log2(max(float((high - low).max()), 1e-6) / _ROOTS))
        first = np.floor(low / self._root_m - _ASIDE)
        self._roots = (np.floor(high / self._root_m - _ASIDE) + 1.0 - first).astype(np.int64)
        self._low = (first + _ASIDE) * self._root_m
        self._keys, self._number = np.zeros(0, np.int64), np.zeros(0, np.int64)
        self._place, self._value = np.zeros((0, 3)), np.zeros((0, glow_table().shape[1]))
        self._parts: list[BlockedLight] = []

    def build(self) -> Quadtree:
        """Return the patches."""
        square = np.stack(np.meshgrid(*(np.arange(n) for n in self._roots), indexing="ij"), axis=-1).reshape(-1, 2)
        predicted = np.full((len(square), 9, self._value.shape[1]), np.inf)
        levels, count = [], len(square)
        for depth in range(_DEEPEST + 1):
            sample, kind, split, square, predicted = self._one_depth(square, predicted, depth)
            child = np.full(len(kind), -1, np.int32)
            child[split] = count + 4 * np.arange(len(split))
            levels.append((sample, kind, child))
            count += len(square)
            if len(square) == 0:
                break
        sample, kind, child = (np.concatenate(column) for column in zip(*levels, strict=True))
        hanging, leaf, at = self._hanging(child, kind)
        none = self._bodies.blocked(np.zeros((0, 3)), np.zeros((0, 3)))  # light of the bodies may nowhere be noticed
        blocked = joined([none, *self._parts])
        squares = self._low, self._root_m, self._roots, child, kind, sample, self._place
        return Quadtree(*squares, blocked, hanging, leaf, at)

    def _one_depth(self, square: NDArray[np.int64], predicted: Floats, depth: int) -> tuple[NDArray[Any], ...]:
        """Return of the squares (n, 2) of one depth samples, kinds and the numbers of those to be quartered; and the
        quarters with what is predicted (m, 9, k) at their samples.
        """
        size = self._root_m / 2**depth
        bound, coarsest, seen_m = np.zeros((3, len(square)))
        survey(self._low + square * size, size, self._plans, self._camera, TOLERANCE, bound, coarsest, seen_m)
        there = np.flatnonzero((bound > UNNOTICED) & (seen_m <= self._extent_m + np.abs(self._camera[1])))
        sample, kind = np.full((len(square), 9), -1, np.int32), np.full(len(square), NOTHING, np.int8)
        sample[there] = self._sampled(square[there], depth)
        value = self._value[sample[there]]
        missed = np.abs(value - predicted[there]).max(axis=(1, 2), initial=0.0)
        few = 0.25 * size < min(_FAINT_APART * self._pixel_rad, _FAINT_RAD) * seen_m[there]
        jump = missed > np.where(few, _FAINT, _PREDICTED * TOLERANCE)
        kind[there] = np.where(jump, JUMP_PATCH, SMOOTH_PATCH)
        wanted = (jump | (size > coarsest[there])) & (0.25 * size >= _FINEST * self._pixel_rad * seen_m[there])
        split = there[wanted & (depth < _DEEPEST)]
        quarters = (2 * square[split][:, None] + [[0, 0], [0, 1], [1, 0], [1, 1]]).reshape(-1, 2)
        corners = value[wanted & (depth < _DEEPEST)].reshape(-1, 3, 3, value.shape[-1])
        of_quarters = np.einsum("aiu,bjv,nuvk->nabijk", _QUARTERS, _QUARTERS, corners, optimize=True)
        return sample, kind, split, quarters, of_quarters.reshape(len(quarters), 9, value.shape[-1])

    def _sampled(self, square: NDArray[np.int64], depth: int) -> NDArray[np.int64]:
        """Return the numbers (n, 9) of the samples of squares; sweeps what bodies block at new ones."""
        nine = 2 * square[:, None] + np.stack(np.divmod(np.arange(9), 3), axis=-1)
        nine <<= _DEEPEST - depth
        key = (nine[..., 0] << 32) + nine[..., 1]
        asked, first = np.unique(key, return_index=True)
        new = ~np.isin(asked, self._keys, assume_unique=True)
        if np.any(new):
            place = np.zeros((np.count_nonzero(new), 3))
            place[:, [0, 2]] = self._low + nine.reshape(-1, 2)[first[new]] * (self._root_m / 2 ** (_DEEPEST + 1))
            found = self._bodies.blocked(place, np.tile(self._normal, (len(place), 1)))
            blocked = found.weights @ (glow_table() * self._normal[1]).astype(np.float32)
            value = shown(found.share.sum(axis=0))[:, None] * blocked / np.pi
            numbers = np.concatenate([self._number, len(self._place) + np.arange(len(place))])
            self._keys = np.concatenate([self._keys, asked[new]])
            order = np.argsort(self._keys)
            self._keys, self._number = self._keys[order], numbers[order]
            self._place, self._value = np.concatenate([self._place, place]), np.concatenate([self._value, value])
            self._parts.append(found)
        return self._number[np.searchsorted(self._keys, key)]

    def _hanging(self, child: NDArray[np.int32], kind: NDArray[np.int8]) -> tuple[NDArray[Any], ...]:
        """Return the samples on the sides of larger patches, those patches, and the places in them."""
        leaf, at = np.zeros((len(self._place), 2), np.int64), np.zeros((len(self._place), 2))
        place = (self._place[:, [0, 2]] - self._low) / self._root_m
        find_hanging(place, self._roots, child, kind, 0.25 / 2 ** (_DEEPEST + 1), leaf, at)
        hanging = np.flatnonzero(leaf[:, 0] >= 0)
        hanging = hanging[np.argsort(leaf[hanging, 1], kind="stable")]
        return hanging, leaf[hanging, 0], at[hanging]


@inlined
def _find(x: Any, z: Any, roots: Any, child: Any) -> Any:
    """Return the leaf at a place in root squares, -1 outside, and the place (u, v) in it, 0 to 1; and its depth."""
    i, j = int(np.floor(x)), int(np.floor(z))
    node, depth, u, v = -1, 0, 0.0, 0.0
    if 0 <= i < roots[0] and 0 <= j < roots[1]:
        node, u, v = i * roots[1] + j, x - i, z - j
        while child[node] >= 0:
            a, b = int(u >= 0.5), int(v >= 0.5)
            u, v = 2.0 * u - a, 2.0 * v - b
            node, depth = child[node] + 2 * a + b, depth + 1
    return node, u, v, depth


@inlined
def _along(u: Any, kind: Any) -> Any:
    """Return the weights of three samples along a side."""
    if kind == JUMP_PATCH:
        return max(1.0 - 2.0 * u, 0.0), 1.0 - abs(2.0 * u - 1.0), max(2.0 * u - 1.0, 0.0)
    return (1.0 - u) * (1.0 - 2.0 * u), 4.0 * u * (1.0 - u), u * (2.0 * u - 1.0)


@inlined
def _value(sample: Any, kind: Any, u: Any, v: Any, values: Any, c: Any) -> Any:
    """Return channel c at (u, v) of a patch with samples (9,)."""
    a0, a1, a2 = _along(u, kind)
    b0, b1, b2 = _along(v, kind)
    first = b0 * values[sample[0], c] + b1 * values[sample[1], c] + b2 * values[sample[2], c]
    second = b0 * values[sample[3], c] + b1 * values[sample[4], c] + b2 * values[sample[5], c]
    third = b0 * values[sample[6], c] + b1 * values[sample[7], c] + b2 * values[sample[8], c]
    return a0 * first + a1 * second + a2 * third


@fast
def look_up(place: Any, roots: Any, child: Any, kind: Any, sample: Any, values: Any, out: Any, jump: Any) -> None:
    """Set `out` (n, k) to values (samples, k) at places (n, 2) in root squares; it stays where nothing is blocked.

    jump: (n,) set to whether values jump in the square.
    """
    for n in range(len(place)):
        node, u, v, _ = _find(place[n, 0], place[n, 1], roots, child)
        jump[n] = node >= 0 and kind[node] == JUMP_PATCH
        if node >= 0 and kind[node] != NOTHING:
            for c in range(out.shape[1]):
                out[n, c] = _value(sample[node], kind[node], u, v, values, c)


@fast
def find_hanging(place: Any, roots: Any, child: Any, kind: Any, eps: Any, leaf: Any, at: Any) -> None:
    """Find the largest patch around each sample at a place (n, 2) in root squares.

    leaf: (n, 2) set to its node, -1 if the sample is one of its own, and its depth. at: (n, 2) set to the place in it.
    eps: a length below half the finest spacing.
    """
    for n in range(len(place)):
        best = 1 << 30
        leaf[n, 0] = -1
        for corner in range(4):
            x = place[n, 0] + (eps if corner & 1 else -eps)
            z = place[n, 1] + (eps if corner & 2 else -eps)
            node, u, v, depth = _find(x, z, roots, child)
            if node < 0 or kind[node] == NOTHING or depth >= best:
                continue
            best = depth
            size = float(1 << depth)
            u, v = u + (-eps if corner & 1 else eps) * size, v + (-eps if corner & 2 else eps) * size
            own = abs(2.0 * u - np.floor(2.0 * u + 0.5)) < 1e-6 and abs(2.0 * v - np.floor(2.0 * v + 0.5)) < 1e-6
            leaf[n, 0], leaf[n, 1] = -1 if own else node, depth
            at[n, 0], at[n, 1] = u, v


@fast
def set_hanging(hanging: Any, leaf: Any, at: Any, kind: Any, sample: Any, values: Any) -> None:
    """Set values (samples, k) of samples (h,) that lie on the side of a larger patch, largest patches first."""
    for h in range(len(hanging)):
        node = leaf[h]
        for c in range(values.shape[1]):
            values[hanging[h], c] = _value(sample[node], kind[node], at[h, 0], at[h, 1], values, c)


@fast
def survey(low: Any, size: Any, bodies: Any, camera: Any, least: Any, bound: Any, coarsest: Any, seen_m: Any) -> None:
    """Find what bodies ask of squares of ground with low corners (n, 2) and one size [m].

    bodies: (m, 8), middle x and z of the plan, unit vector along its first side, both half sides, and the heights of
    lower and upper end above the ground, at least 0. camera: (3,), its height above the ground.
    bound: (n,) set to a bound on the blocked fraction. coarsest: (n,) to the largest size [m] of a square near
    bodies that may block more than `least` there. seen_m: (n,) to the distance from the camera.
    """
    for n in range(len(low)):
        x0, z0 = low[n, 0], low[n, 1]
        dx = max(x0 - camera[0], camera[0] - x0 - size, 0.0)
        dz = max(z0 - camera[2], camera[2] - z0 - size, 0.0)
        seen_m[n] = np.sqrt(dx * dx + dz * dz + camera[1] * camera[1])
        total, wanted = 0.0, 1e30
        for m in range(len(bodies)):
            b = bodies[m]
            dx, dz = max(x0 - b[0], b[0] - x0 - size, 0.0), max(z0 - b[1], b[1] - z0 - size, 0.0)
            x, z = x0 + 0.5 * size - b[0], z0 + 0.5 * size - b[1]
            along, across = abs(x * b[2] + z * b[3]) - b[4], abs(z * b[2] - x * b[3]) - b[5]
            along, across = max(along - 0.7072 * size, 0.0), max(across - 0.7072 * size, 0.0)
            beside = along * along + across * across
            share = most_blocked(dx * dx + dz * dz, beside, b[4] * b[4] + b[5] * b[5], b[7])
            total += share
            if share > least:
                wanted = min(wanted, max(_LARGEST * np.sqrt(beside + b[6] * b[6]), 0.5 * min(b[4], b[5])))
        bound[n], coarsest[n] = total, wanted
