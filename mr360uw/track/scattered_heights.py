# SPDX-License-Identifier: Apache-2.0
"""Robust height field through scattered points: a smoothing spline on a grid, without outliers.

Minimises sum w_i (h(x_i, z_i) - y_i)^2 + lambda |second differences of h|^2 + a weak pull to 0, with h bilinear between
nodes (thin-plate energy on a grid; Terzopoulos 1988). The weights are Tukey's biweight of the residuals, found by
iteration (Holland & Welsch 1977) from a stiff sheet to a soft one. Cross-validation chooses lambda.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.types import Floats

STIFFNESS = (1000.0, 100.0, 30.0, 10.0, 3.0, 1.0, 0.3, 0.1)
"""Weights of the second differences that are tried, per mean weight of a point, from stiff to soft."""
_ROUNDS = 2
"""Iterations of the weights at each stiffness, which start from those before; four change heights by a few per cent of
their error."""
_TUKEY = 4.685
"""Residual over the spread from which on a point counts nothing: 95 % efficiency for normal errors."""
_PULL = 1e-3
"""Weight of the pull to 0, over that of the second differences at a stiffness of 1: holes relax over some six cells."""
_FOLDS, _SEED = 5, 1
_SUPPORT = 1.0
"""Weighted points about a node at which its confidence is 1 - 1/e. Twice as large: half the floor counts as guessed."""


@dataclass(frozen=True, slots=True, eq=False)
class ScatteredHeights:
    """Heights (r, c) at nodes z_m (r,), x_m (c,), with confidence (r, c) in [0, 1].

    kept (n,): weight of each point, 0 for outliers. held_out, held_out_flat: median absolute residuals of points that
    were left out of the fit, about the sheet and about 0. spread: standard deviation about the sheet, by the median.
    """

    x_m: Floats
    z_m: Floats
    height: Floats
    confidence: Floats
    kept: Floats
    held_out: float
    held_out_flat: float
    spread: float


def fit_height_field(points: Floats, weight: Floats, cell_m: float, least_spread: float) -> ScatteredHeights:
    """Return the height field of points (n, 3): y over (x, z), as metres or any other unit.

    weight (n,): inverse variances, relative. cell_m: spacing of the nodes. least_spread: floor of the points' spread,
    below which nothing counts as an outlier.
    """
    x, y, z = points.T
    x_m, z_m = (np.arange(v.min() - cell_m, v.max() + 2.0 * cell_m, cell_m) for v in (x, z))
    at = _bilinear(x_m, z_m, x, z)
    bend = _bending(len(z_m), len(x_m))
    weight = weight / weight.mean()
    fold = np.random.default_rng(_SEED).permutation(len(y)) % _FOLDS
    sheet = _Sheets(at, bend, y, weight, least_spread)
    apart = _Sheets(at[fold > 0], bend, y[fold > 0], weight[fold > 0], least_spread)
    best = (np.inf, STIFFNESS[0])
    for stiffness in STIFFNESS:
        error = float(np.median(np.abs(at[fold == 0] @ apart.relaxed(stiffness) - y[fold == 0])))
        if error > 1.1 * best[0]:
            break
        best = min(best, (error, stiffness))
    for stiffness in STIFFNESS[: STIFFNESS.index(best[1]) + 1]:
        height = sheet.relaxed(stiffness)
    confidence = 1.0 - np.exp(-_support(at, sheet.robust * np.minimum(weight, 1.0), (len(z_m), len(x_m))) / _SUPPORT)
    return ScatteredHeights(
        x_m, z_m, height.reshape(len(z_m), len(x_m)), confidence, sheet.robust, best[0],
        float(np.median(np.abs(y[fold == 0]))), sheet.spread,
    )  # fmt: skip


class _Sheets:
    """The sheet through one set of points, made softer step by step: each fit starts from the weights of the last."""

    def __init__(self, at: Any, bend: Any, y: Floats, weight: Floats, least_spread: float) -> None:
        self._at, self._bend, self._y, self._weight = at, bend, y, weight
        self._least = least_spread
        self.robust = np.ones(len(y))
        self.spread = float(np.inf)

    def relaxed(self, stiffness: float) -> Floats:
        """Return the heights of the nodes, flat, at a stiffness."""
        from scipy.sparse import identity

        height = np.zeros(self._at.shape[1])
        smooth = stiffness * self._bend + _PULL * min(stiffness, 1.0) * identity(len(height))
        for _ in range(_ROUNDS):
            data = self._at.T.multiply(self.robust * self._weight).tocsr()
            height = _solved(data @ self._at + smooth, data @ self._y)
            residual = (self._at @ height - self._y) * np.sqrt(np.minimum(self._weight, 1.0))
            self.spread = max(1.4826 * float(np.median(np.abs(residual))), self._least)
            far = np.minimum(np.abs(residual) / (_TUKEY * self.spread), 1.0)
            self.robust = np.square(1.0 - np.square(far))
        return np.asarray(height)


def _solved(matrix: Any, right: Floats) -> Floats:
    """Return the solution of a banded symmetric positive definite system."""
    from scipy.linalg import solveh_banded

    entries = matrix.tocoo()
    upper = entries.col >= entries.row
    row, column = entries.row[upper], entries.col[upper]
    width = int(np.max(column - row))
    bands = np.zeros((width + 1, len(right)))
    bands[width + row - column, column] = entries.data[upper]
    return np.asarray(solveh_banded(bands, right, overwrite_ab=True, check_finite=False))


def _bilinear(x_m: Floats, z_m: Floats, x: Floats, z: Floats) -> Any:
    """Return the sparse matrix (n, r c) of bilinear interpolation at points inside of the grid."""
    from scipy.sparse import csr_matrix

    column, u = _cell(x_m, x)
    row, v = _cell(z_m, z)
    count = len(x_m)
    nodes = np.stack([row * count + column, row * count + column + 1, (row + 1) * count + column,
                      (row + 1) * count + column + 1], axis=1)  # fmt: skip
    share = np.stack([(1 - u) * (1 - v), u * (1 - v), (1 - u) * v, u * v], axis=1)
    number = np.repeat(np.arange(len(x)), 4)
    return csr_matrix((share.ravel(), (number, nodes.ravel())), shape=(len(x), len(x_m) * len(z_m)))


def _cell(nodes: Floats, at: Floats) -> tuple[NDArray[np.int64], Floats]:
    place = (at - nodes[0]) / (nodes[1] - nodes[0])
    cell = np.clip(np.floor(place).astype(np.int64), 0, len(nodes) - 2)
    return cell, place - cell


def _bending(rows: int, columns: int) -> Any:
    """Return the matrix (r c, r c) of the thin-plate energy: h_xx^2 + 2 h_xz^2 + h_zz^2 in units of cells."""
    from scipy.sparse import diags, identity, kron

    def second(n: int) -> Any:
        return diags([1.0, -2.0, 1.0], [0, 1, 2], shape=(n - 2, n))

    def first(n: int) -> Any:
        return diags([-1.0, 1.0], [0, 1], shape=(n - 1, n))

    across, along = kron(identity(rows), second(columns)), kron(second(rows), identity(columns))
    twist = kron(first(rows), first(columns))
    return (across.T @ across + along.T @ along + 2.0 * twist.T @ twist).tocsr()


def _support(at: Any, weight: Floats, shape: tuple[int, int]) -> Floats:
    """Return the weighted number of points about each node, (r, c): Gaussian of one cell, 1 in the middle."""
    from scipy.ndimage import gaussian_filter

    return np.asarray(2.0 * np.pi * gaussian_filter((at.T @ weight).reshape(shape), 1.0, mode="constant"))
