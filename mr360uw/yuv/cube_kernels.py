# SPDX-License-Identifier: Apache-2.0
"""Compiled loops of three-dimensional lookup tables: tetrahedral interpolation and its inverse; serial.

A cell of the table is cut into six tetrahedra along its diagonal. In each the map is linear; for the order a, b, c of
the falling fractions f_a >= f_b >= f_c:

    y = V_000 + f_a (V_a - V_000) + f_b (V_ab - V_a) + f_c (V_111 - V_ab)

Source: the tetrahedral scheme of Kasson 1995. Positions are in cells, 0 to n - 1.

The inverse takes Gauss-Newton steps J dx = y - f(x) from tetrahedron to tetrahedron. It is exact, to rounding, once it
is in the one that holds the value. Steps are halved until the distance falls; a coordinate that leaves the table is
held at its edge. Where the table is flat, a coordinate stays where it started.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mr360uw.jit import fast

_STEPS = 60  # of the inverse; camera tables take 3 to 8
_HALVINGS = 12  # of a step: down to 1/4096 of a cell's crossing
_COARSE = 8  # vertices along an edge of the first scan for a new start
_DAMPING = 1e-13  # of the normal equations, relative to their trace: it matters in flat directions alone


@fast
def _linear_part(table: Any, x: Any, value: Any, jacobian: Any) -> None:
    """Write value (3,) and Jacobian (3, 3) of the tetrahedron that holds the position x (3,)."""
    n = table.shape[0]
    cell, part = np.empty(3, np.int64), np.empty(3)
    for i in range(3):
        cell[i] = min(int(x[i]), n - 2)
        part[i] = x[i] - cell[i]
    a, c = 0, 0
    for i in range(1, 3):
        if part[i] > part[a]:
            a = i
        if part[i] <= part[c]:
            c = i
    if a == c:  # only where all are equal
        a, c = 0, 2
    b = 3 - a - c
    low = table[cell[0], cell[1], cell[2]]
    for i in range(3):
        value[i] = low[i]
    for axis in (a, b, c):
        cell[axis] += 1
        high = table[cell[0], cell[1], cell[2]]
        for i in range(3):
            jacobian[i, axis] = high[i] - low[i]
            value[i] += part[axis] * jacobian[i, axis]
        low = high


@fast
def interpolate(table: Any, x: Any, out: Any) -> None:
    """Write the values (m, 3) of a table (n, n, n, 3) at positions (m, 3) in 0 .. n - 1."""
    jacobian = np.empty((3, 3))
    for k in range(len(x)):
        _linear_part(table, x[k], out[k], jacobian)


@fast
def _step(jacobian: Any, missing: Any, held: Any, out: Any) -> None:
    """Write the damped least-squares step (3,) that takes away `missing` (3,), with the `held` coordinates fixed."""
    m, r = np.zeros((3, 3)), np.zeros(3)
    for i in range(3):
        for k in range(3):
            r[i] += jacobian[k, i] * missing[k]
            for j in range(3):
                m[i, j] += jacobian[k, i] * jacobian[k, j]
    floor = _DAMPING * (m[0, 0] + m[1, 1] + m[2, 2]) + 1e-300
    for i in range(3):
        m[i, i] += floor
    for i in range(3):
        if held[i]:
            r[i] = 0.0
            for j in range(3):
                m[i, j] = 0.0
                m[j, i] = 0.0
            m[i, i] = 1.0
    # Cholesky: m is positive definite
    l00 = np.sqrt(m[0, 0])
    l10, l20 = m[1, 0] / l00, m[2, 0] / l00
    l11 = np.sqrt(max(m[1, 1] - l10 * l10, 1e-300))
    l21 = (m[2, 1] - l20 * l10) / l11
    l22 = np.sqrt(max(m[2, 2] - l20 * l20 - l21 * l21, 1e-300))
    p = r[0] / l00
    q = (r[1] - l10 * p) / l11
    s = (r[2] - l20 * p - l21 * q) / l22
    out[2] = s / l22
    out[1] = (q - l21 * out[2]) / l11
    out[0] = (p - l10 * out[1] - l20 * out[2]) / l00


@fast
def _held_step(jacobian: Any, missing: Any, at: Any, top: float, out: Any) -> None:
    """Write the step (3,) from `at`, with the coordinates held at the edges 0 and `top` that it would leave."""
    held = np.zeros(3, np.bool_)
    for _ in range(4):
        _step(jacobian, missing, held, out)
        free = True
        for i in range(3):
            leaves = (at[i] <= 0.0 and out[i] < 0.0) or (at[i] >= top and out[i] > 0.0)
            if leaves and not held[i]:
                held[i], free = True, False
        if free:
            break


@fast
def _search(table: Any, wanted: Any, tolerance: float, at: Any) -> float:
    """Move a position (3,) to where the table has the value `wanted` (3,); return the square of the distance left."""
    # Measure the distance of the first guess
    top = table.shape[0] - 1.0
    value, jacobian, there = np.empty(3), np.empty((3, 3)), np.empty(3)
    missing, step, trial = np.empty(3), np.empty(3), np.empty(3)
    _linear_part(table, at, value, jacobian)
    distance = 0.0
    for i in range(3):
        missing[i] = wanted[i] - value[i]
        distance += missing[i] * missing[i]
    # Step towards the value, shorter until the distance falls
    for _ in range(_STEPS):
        if distance <= tolerance * tolerance:
            break
        _held_step(jacobian, missing, at, top, step)
        size, left = 1.0, distance
        for _ in range(_HALVINGS):
            for i in range(3):
                trial[i] = min(max(at[i] + size * step[i], 0.0), top)
            _linear_part(table, trial, there, jacobian)
            left = 0.0
            for i in range(3):
                left += (wanted[i] - there[i]) ** 2
            if left < distance:
                break
            size *= 0.5
        if left >= distance:
            break
        distance = left
        for i in range(3):
            at[i] = trial[i]
            missing[i] = wanted[i] - there[i]
    return distance


@fast
def _nearest(table: Any, wanted: Any, stride: int, out: Any) -> None:
    """Write the vertex (3,) closest in value to `wanted` (3,), of every `stride`-th; of equals the middle one."""
    n = table.shape[0]
    middle = 0.5 * (n - 1)
    least, off = 1e300, 1e300
    for i in range(0, n, stride):
        for j in range(0, n, stride):
            for k in range(0, n, stride):
                distance = 0.0
                for c in range(3):
                    distance += (wanted[c] - table[i, j, k, c]) ** 2
                if distance <= least:
                    aside = (i - middle) ** 2 + (j - middle) ** 2 + (k - middle) ** 2
                    if distance < least or aside < off:
                        least, off = distance, aside
                        out[0], out[1], out[2] = i, j, k


@fast
def invert(table: Any, wanted: Any, tolerance: float, x: Any) -> None:
    """Move the positions x (m, 3), first guesses, to where the table has the values `wanted` (m, 3).

    tolerance: of the distance in each value, where the search ends. Where a search stops short, it begins anew at the
    vertex with the closest value, first of a few and then of all. Values that the table lacks get the closest found.
    """
    stride = max(1, (table.shape[0] - 1) // _COARSE)
    best = np.empty(3)
    for k in range(len(x)):
        least = _search(table, wanted[k], tolerance, x[k])
        for again in (stride, 1):
            if least <= tolerance * tolerance:
                break
            _nearest(table, wanted[k], again, best)
            found = _search(table, wanted[k], tolerance, best)
            if found < least:
                least = found
                for i in range(3):
                    x[k, i] = best[i]
