# SPDX-License-Identifier: Apache-2.0
"""Values of points of a lattice, which shading reads at places of a body, and products of sparse matrices with them.

sample_points.py says how points are numbered.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.jit import exact, inlined
from mr360uw.rays import triple
from mr360uw.types import Floats

CHANNELS = 12
"""Values of a point: ratio of irradiance (3), 0; ratio of glossy light that is kept (3), 0; radiance that is reflected
besides (3), 0."""
FEW_CHANNELS = 4
"""Values of a point that reflects nothing besides and keeps the same ratio of all light: that ratio (3), 0."""
UNTOUCHED = (1.0, 1.0, 1.0, 0.0, 1.0, 1.0, 1.0, *[0.0] * (CHANNELS - 7))
"""Values where nothing is in the way."""


def whole_values(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the values (K, CHANNELS) of points that are given with those or with `FEW_CHANNELS`."""
    if values.shape[1] == CHANNELS:
        return values
    whole = np.zeros((len(values), CHANNELS), np.float32)
    whole[:, :FEW_CHANNELS] = whole[:, FEW_CHANNELS : 2 * FEW_CHANNELS] = values
    return whole


@inlined
def _row(steps: Any, i: Any) -> Any:
    return i * (2 * steps + 3 - i) // 2


@inlined
def _three(place: Any, w0: Any, w1: Any, w2: Any) -> Any:
    """Return three points and their shares at barycentric weights of a triangle with a place (4,).

    Twin: ambient.glsl.
    """
    steps = place[3]
    w0, w1, w2 = max(w0, 0.0), max(w1, 0.0), max(w2, 0.0)
    total = max(w0 + w1 + w2, 1e-12)
    x, y = w1 / total * steps, w2 / total * steps
    i = min(int(x), steps - 1)
    j = min(int(y), steps - 1 - i)
    u, v = x - i, y - j
    upper = u + v > 1.0 and i + j < steps - 1
    row, below = _row(steps, i), _row(steps, i + 1)
    first, second, third = (
        place[0] + (below + j + 1 if upper else row + j),
        place[0] + below + j,
        place[0] + row + j + 1,
    )
    if steps == 1:
        first, second, third = place[0], place[1], place[2]
    rest = u + v - 1.0 if upper else 1.0 - u - v
    return first, second, third, rest, 1.0 - v if upper else u, 1.0 - u if upper else v


@exact
def find_three(places: Any, weights: Any, points: Any, shares: Any) -> None:
    """Set points (n, 3) and shares (n, 3) at barycentric weights (n, 3) of triangles with places (n, 4)."""
    for n in range(len(places)):
        a, b, c, u, v, w = _three(places[n], weights[n, 0], weights[n, 1], weights[n, 2])
        points[n, 0], points[n, 1], points[n, 2] = a, b, c
        shares[n, 0], shares[n, 1], shares[n, 2] = u, v, w


@exact
def find_nearest_points(
    triangles: Any, met: Any, origin: Any, direction: Any, places: Any, point: Any, distance: Any, behind: Any,
) -> None:  # fmt: skip
    """Set the nearest point and the distance of rays (n,) that meet triangles of a scene (T, 3, 3), and if they meet
    the back. met: (n,) numbers of the triangles.
    """
    a, b, c = origin[0].copy(), origin[0].copy(), origin[0].copy()
    for n in range(len(met)):
        d = direction[n]
        for k in range(3):
            a[k] = triangles[met[n], 0, k] - origin[n, k]
            b[k] = triangles[met[n], 1, k] - origin[n, k]
            c[k] = triangles[met[n], 2, k] - origin[n, k]
        u, v, w = triple(d, b, c), triple(d, c, a), triple(d, a, b)
        total = u + v + w  # the normal times the ray, too
        behind[n] = total > 0.0
        total = total if abs(total) >= 1e-300 else 1e-300
        distance[n] = triple(a, b, c) / total
        first, second, third, x, y, z = _three(places[met[n]], u / total, v / total, w / total)
        point[n] = first if x >= y and x >= z else second if y >= z else third


def product(matrix: Any, values: Floats) -> Floats:
    """Return the product (r, 3 k) of a `csr_matrix` (r, n) and values (n, 3 k), in the type of both; it is the same as
    that of `matrix @ values`.
    """
    out = np.empty((matrix.shape[0], values.shape[1]), np.result_type(matrix.dtype, values.dtype))
    _sum_rows(matrix.indptr, matrix.indices, matrix.data, values, out, out.dtype.type(0.0))
    return out


@exact
def _sum_rows(begin: Any, column: Any, weight: Any, values: Any, out: Any, zero: Any) -> None:
    for row in range(len(out)):
        for c in range(0, out.shape[1], 3):
            first, second, third = zero, zero, zero
            for k in range(begin[row], begin[row + 1]):
                n, w = column[k], weight[k]
                first += w * values[n, c]
                second += w * values[n, c + 1]
                third += w * values[n, c + 2]
            out[row, c], out[row, c + 1], out[row, c + 2] = first, second, third
