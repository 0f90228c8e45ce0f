# SPDX-License-Identifier: Apache-2.0
"""Ambient light on the receiver; on level ground in nested squares around bodies, fine where it changes fast.

A square's samples, 3 x 3, are predicted from those of the square that it is a quarter of. The error of a biquadratic
falls with the third power of its size, so a square is off by an eighth of what its prediction misses. Where a square
meets a larger one, its samples on their common side that the larger one lacks take the larger one's value, so values
are continuous. Squares at the end of refinement, across a jump, are bilinear. What is sampled and how fine does not
depend on the light: it is kept while bodies stand still, and while they move together along the ground by less than the
camera's place is rounded to.
"""

from __future__ import annotations

import weakref
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.cache import Cache
from mr360uw.composite.ambient.blocked_light import (
    UNNOTICED,
    Occluders,
    Occlusion,
    glow_table,
    joined,
    most_blocked,
    shown,
)
from mr360uw.composite.ambient.solver import AmbientLight, free_of_bodies
from mr360uw.composite.shot import Shot
from mr360uw.jit import fast, inlined
from mr360uw.types import Floats

NOTHING, SMOOTH_PATCH, JUMP_PATCH = 0, 1, 2
"""Kinds of cells: where no light is blocked, biquadratic, and bilinear between samples."""

TOLERANCE = 0.004
"""Fraction of the light, a code value, above which what a body may block asks for squares no larger than it."""
_MISSED = 0.024
"""Most that a prediction may miss: squares within it are off by an eighth of that where light changes evenly, and by a
code value as it does. With 0.016 there are twice as many; the largest error, at thin parts of bodies, stays as it is.
"""
_ROOTS = 4
"""Squares along the longer side of the ground around all bodies, before they are quartered."""
_ASIDE = np.array([1.0 / 3.0, 1.0 / 5.0])
"""Place of a corner of the largest squares beside the first body's origin, over their side. At the origin itself, light
at the corner of a box that hangs above the ground rises by .002 outwards.
"""
_DEEPEST = 16
"""Most times that a square is quartered."""
_STEP, _APART = 0.03, 4.0
"""Steps of the blocked fraction below the first are not followed to samples nearer than so many pixels: scans make such
steps where rays begin to meet a thin part of a body. With 0.1, light is off by as much beside bodies just above ground.
"""
_FINEST = 0.5
"""Least distance of samples, in pixels across the frame: light that jumps between such is that of each place."""
_CAMERA_STEP, _LOWEST_M = 0.25, 1e-3
"""Part of its height above the ground to which the camera's place is rounded, and the least height [m]."""
_AT = 0.25 * np.arange(3) + 0.5 * np.arange(2)[:, None]
_ALONG = np.stack([(1.0 - _AT) * (1.0 - 2.0 * _AT), 4.0 * _AT * (1.0 - _AT), _AT * (2.0 * _AT - 1.0)], axis=-1)
_QUARTERS = np.einsum("aiu,bjv->abijuv", _ALONG, _ALONG).reshape(36, 9)
"""Weights of a square's samples at those of its quarters, one after the other."""
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
    blocked: Occlusion
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


def make_quadtree(bodies: Occluders, camera: Floats, pixel_rad: float, extent_m: float) -> Quadtree:
    """Return the patches of the ground around bodies, as far from a camera as `extent_m`.

    camera: (3,) of `camera_place`. pixel_rad: width of its pixels, which samples are not much finer than.
    """
    # Lay the largest squares over all ground of which bodies may block enough
    plans = bodies.plans()
    wide = np.hypot(plans[:, 4], plans[:, 5])
    reach = (wide + np.cbrt(wide * plans[:, 7] ** 2 * len(plans) / (2.0 * UNNOTICED)))[:, None]
    low, high = (plans[:, :2] - reach).min(axis=0), (plans[:, :2] + reach).max(axis=0)
    root_m = 2.0 ** np.ceil(np.log2(max(float((high - low).max()), 1e-6) / _ROOTS))
    first = np.floor(low / root_m - _ASIDE)
    roots = (np.floor(high / root_m - _ASIDE) + 1.0 - first).astype(np.int64)
    low = (first + _ASIDE) * root_m
    square: NDArray[Any] = np.stack(np.meshgrid(*map(np.arange, roots), indexing="ij"), axis=-1).reshape(-1, 2)
    samples = _Samples(bodies, 1.0 if camera[1] >= 0.0 else -1.0, low, root_m)
    predicted, count = np.full((len(square), 9, len(glow_table().T)), np.inf), len(square)
    levels: list[tuple[NDArray[Any], ...]] = []
    for depth in range(_DEEPEST + 1):
        # Sample those that the camera may see and of whose light bodies block some
        size = root_m / 2**depth
        bound, coarsest, seen_m = np.zeros((3, len(square)))
        survey(low + square * size, size, plans, camera, TOLERANCE, bound, coarsest, seen_m)
        there = np.flatnonzero((bound > UNNOTICED) & (seen_m <= extent_m + np.abs(camera[1])))
        numbers, kind = np.full((len(square), 9), -1, np.int32), np.full(len(square), NOTHING, np.int8)
        numbers[there], value = samples.at(square[there], depth)
        missed = np.abs(value - predicted[there]).max(axis=(1, 2), initial=0.0)
        spacing_px = 0.25 * size / (pixel_rad * seen_m[there])  # of its quarters
        jump = missed > np.where(spacing_px < _APART, _STEP, _MISSED)
        kind[there] = np.where(jump, JUMP_PATCH, SMOOTH_PATCH)
        # Quarter those that were not foreseen, and those that are large for what is near
        split = (jump | (size > coarsest[there])) & (spacing_px >= _FINEST) & (depth < _DEEPEST)
        child = np.full(len(square), -1, np.int32)
        child[there[split]] = count + 4 * np.arange(np.count_nonzero(split))
        levels.append((numbers, kind, child))
        square = (2 * square[there[split], None] + [[0, 0], [0, 1], [1, 0], [1, 1]]).reshape(-1, 2)
        predicted = (_QUARTERS @ value[split]).reshape(len(square), *value.shape[1:])
        count += len(square)
        if len(square) == 0:
            break
    # Find the samples on the sides of larger squares, those squares, and the places in them
    sample, kind, child = (np.concatenate(column) for column in zip(*levels, strict=True))
    leaf, at = np.zeros((len(samples.place), 2), np.int64), np.zeros((len(samples.place), 2))
    find_hanging((samples.place[:, [0, 2]] - low) / root_m, roots, child, kind, 0.25 / 2 ** (_DEEPEST + 1), leaf, at)
    hanging = np.flatnonzero(leaf[:, 0] >= 0)
    hanging = hanging[np.argsort(leaf[hanging, 1], kind="stable")]
    of_larger = hanging, leaf[hanging, 0], at[hanging]
    return Quadtree(low, root_m, roots, child, kind, sample, samples.place, joined(samples.parts), *of_larger)


class _Samples:
    """Places at which it is found what bodies block: each once, whichever squares share it. up: 1, or -1 for ground
    that is seen from below.
    """

    def __init__(self, bodies: Occluders, up: float, low: Floats, root_m: float) -> None:
        self._bodies, self._low, self._finest_m = bodies, low, root_m / 2 ** (_DEEPEST + 1)
        self._up, self._glow = up, (glow_table() * up).astype(np.float32)
        self._keys, self._number = np.zeros(0, np.int64), np.zeros(0, np.int64)
        self.place, self._value = np.zeros((0, 3)), np.zeros((0, self._glow.shape[1]))
        none = bodies.blocked(self.place, self.place)  # light of the bodies may nowhere be noticed
        self.parts = [none]

    def at(self, square: NDArray[np.int64], depth: int) -> tuple[NDArray[np.int64], Floats]:
        """Return the numbers (n, 9) of the samples of squares (n, 2) of one depth, and their values (n, 9, k)."""
        # Number the places by the finest squares, and find those that are new
        nine = (2 * square[:, None] + np.stack(np.divmod(np.arange(9), 3), axis=-1)) << (_DEEPEST - depth)
        key = (nine[..., 0] << 32) + nine[..., 1]
        asked = np.unique(key)
        new = asked[~np.isin(asked, self._keys, assume_unique=True)]
        if len(new):
            # Scan what bodies block there, and what that is of five skies
            place = np.zeros((len(new), 3))
            place[:, [0, 2]] = self._low + self._finest_m * np.stack([new >> 32, new & 0xFFFFFFFF], axis=-1)
            found = self._bodies.blocked(place, np.tile([0.0, self._up, 0.0], (len(new), 1)))
            value = shown(found.share.sum(axis=0))[:, None] * (found.weights @ self._glow) / np.pi
            # Keep the keys in order, so that they are found again
            keys = np.concatenate([self._keys, new])
            numbers = np.concatenate([self._number, len(self.place) + np.arange(len(new))])
            order = np.argsort(keys, kind="stable")
            self._keys, self._number = keys[order], numbers[order]
            self.place, self._value = np.concatenate([self.place, place]), np.concatenate([self._value, value])
            self.parts.append(found)
        number = self._number[np.searchsorted(self._keys, key)]
        return number, self._value[number]


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


_PART_OF_HEIGHT = 0.25
"""Most that a body may move to the first one between two samples in time, over its height above level ground, for what
it blocks there to be interpolated."""


@dataclass(frozen=True, slots=True, eq=False)
class GroundField:
    """Ambient light that the bodies of a shot leave on its receiver.

    origin: (3,) in the world of level ground below the first body. patches: quadtrees of that ground, from there, each
    with the values of its samples and its weight; none where the receiver is not level or bodies block nothing, where
    light is that of each place. gap_m: height above it of the lowest body: light hardly changes over a part of that.
    cache: keeps what bodies block there; it may keep the field too, which does not hold it.
    """

    shot: Shot
    light: AmbientLight | None
    cache: weakref.ref[Cache]
    origin: Floats
    patches: tuple[tuple[Quadtree, Floats, float], ...]
    gap_m: float

    def at(self, point: Floats, normal: Floats) -> NDArray[np.float32]:
        """Return what `free_of_bodies` does; of patches within `TOLERANCE`.

        Where the light jumps between samples, at the outline of a body that stands on the ground, it is that of each
        place.
        """
        point, normal = np.asarray(point, np.float64), np.asarray(normal, np.float64)
        if not self.patches:
            return free_of_bodies(self.shot, self.light, point, normal, self.cache()).astype(np.float32)
        place = point.reshape(-1, 3)
        free, jump = np.zeros(place.shape), np.zeros(len(place), np.bool_)
        for tree, values, share in self.patches:
            found, jumps = tree.between(values, place + (self.shot.view.position - self.origin), 1.0)
            free, jump = free + share * found, jump | jumps
        if np.any(jump):
            each = place[jump], normal.reshape(-1, 3)[jump]
            free[jump] = free_of_bodies(self.shot, self.light, *each, self.cache())
        return np.maximum(free, 0.0).reshape(point.shape).astype(np.float32)  # parabolas of steep samples dip below

    def jumps(self) -> Floats:
        """Return places (n, 3) of level ground, from the camera, a few pixels apart at most, all along the lines at
        which the light jumps.
        """
        places = [np.zeros((0, 3))]
        for tree, _, _ in self.patches:  # the samples of the smallest squares
            leaf = (tree.kind == JUMP_PATCH) & (tree.child < 0)
            places.append(tree.place[np.unique(tree.sample[leaf])])
        return np.concatenate(places) + (self.origin - self.shot.view.position)


def ground_field(shot: Shot, light: AmbientLight | None, cache: Cache) -> GroundField:
    """Return the ambient light on a shot's receiver. cache: keeps quadtrees while bodies stand still to each other."""
    receiver = shot.receiver
    if light is None or receiver is None or receiver.plane_y is None or not light.layout.ground_bodies:
        return GroundField(shot, light, weakref.ref(cache), np.zeros(3), (), 0.0)
    origin, patches = light.layout.below(receiver.plane_y), []
    camera, pixel_rad, gap_m = shot.view.position - origin, 2.0 * np.pi / shot.view.width, np.inf
    # From a place rounded to about a quarter of its height patches are as fine, and are kept for longer
    step = 2.0 ** np.round(np.log2(max(abs(camera[1]), _LOWEST_M))) * _CAMERA_STEP
    camera = np.asarray(np.round(camera / step) * step + 0.0)
    for solved, share in _samples(light, receiver.plane_y):
        below = solved.layout.below(receiver.plane_y)
        occluders = solved.layout.occluders_from(below)
        tree = cache.of(make_quadtree, occluders, camera, pixel_rad, receiver.extent_m, keep=2)
        for k in solved.layout.ground_bodies:
            gap_m = min(gap_m, _height(solved, k, receiver.plane_y))
        patches.append((tree, cache.of(_at_samples, solved, tree, below, keep=2), share))
    return GroundField(shot, light, weakref.ref(cache), origin, tuple(patches), gap_m)


def _samples(light: AmbientLight, ground_y: float) -> list[tuple[AmbientLight, float]]:
    """Return the solutions between which light on level ground is interpolated, as seen from below the first body, with
    their weights: the light itself where it is solved, or bodies move by much of their height above the ground.

    What bodies block varies along the ground as slowly as they are high above it. A straight line between two places a
    quarter of that apart then misses 1/8 (1/4)^2 of it, less than a hundredth.
    """
    if not light.samples:
        return [(light, 1.0)]
    (before, _), (after, _) = light.samples
    first, last = before.layout.below(ground_y), after.layout.below(ground_y)
    for k in before.layout.ground_bodies:
        a, b = before.layout.bodies[k], after.layout.bodies[k]
        turned_m = a.radius * np.linalg.norm(b.rotation - a.rotation, 2)
        moved_m = np.linalg.norm((b.origin - last) - (a.origin - first)) + turned_m
        if moved_m > _PART_OF_HEIGHT * _height(before, k, ground_y):
            return [(light, 1.0)]
    return [sample for sample in light.samples if sample[1] > 0.0]


def _height(light: AmbientLight, number: int, ground_y: float) -> float:
    """Return the height [m] of the lower end of a body above level ground, 0 at least."""
    body = light.layout.bodies[number]
    return max(float(body.field.heights[0] + body.origin[1]) - ground_y, 0.0)


def _at_samples(light: AmbientLight, tree: Quadtree, origin: Floats) -> Floats:
    """Return the light at the samples of a quadtree whose origin (3,) is given."""
    return tree.joined(light.free(tree.blocked, tree.place + origin))
