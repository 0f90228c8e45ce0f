# SPDX-License-Identifier: Apache-2.0
"""Values on level ground between samples on nested squares: biquadratic on a square of 3 x 3 samples.

Where a square meets a larger one, its samples on their common side that the larger one lacks take the larger one's
value, so values are continuous. Squares at the end of refinement, across a jump, are bilinear between samples.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mr360uw.composite.ambient.on_ground.horizon_scan import most_blocked
from mr360uw.jit import fast, inlined

NOTHING, SMOOTH_PATCH, JUMP_PATCH = 0, 1, 2
"""Kinds of cells: where no light is blocked, biquadratic, and bilinear between samples."""

_LARGEST = 1.6
"""Largest side of a square over its distance to a body: twice as large, squares pass over what bodies block."""


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
