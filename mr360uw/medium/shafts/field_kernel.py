# SPDX-License-Identifier: Apache-2.0
"""Nodes of the grid that pixels read, and the cubic reading itself: compiled loops of `froxels`."""

from __future__ import annotations

import math
from typing import Any

from mr360uw.jit import exact, inlined


@inlined
def _wrapped(row: Any, column: Any, rows: Any, columns: Any) -> Any:
    """Return a node's row and column, continued over the poles and about them."""
    if row < 0 or row >= rows:
        row = -1 - row if row < 0 else 2 * rows - 1 - row
        column += columns // 2
    return min(max(row, 0), rows - 1), column % columns


@inlined
def _cubic(f: Any, k: Any) -> Any:
    """Return the weight of neighbour k = 0 to 3 at a fraction f between the inner two (Keys 1981)."""
    if k == 0:
        return 0.5 * f * (f * (2.0 - f) - 1.0)
    if k == 1:
        return 0.5 * (f * f * (3.0 * f - 5.0) + 2.0)
    if k == 2:
        return 0.5 * f * (f * (4.0 - 3.0 * f) + 1.0)
    return 0.5 * f * f * (f - 1.0)


@exact
def mark_nodes(x: Any, y: Any, node: Any) -> None:
    """Set `node` (rows, columns) to 0 where frame coordinates (n,) of the grid read it."""
    rows, columns = node.shape
    for n in range(len(x)):
        i, j = math.floor(x[n] - 0.5), math.floor(y[n] - 0.5)
        for b in range(4):
            for a in range(4):
                row, column = _wrapped(j + b - 1, i + a - 1, rows, columns)
                node[row, column] = 0


@exact
def read_field(table: Any, node: Any, x: Any, y: Any, t: Any, result: Any) -> bool:
    """Write the light of rays at frame coordinates (n,) of the grid to `result` (n, 3).

    t: (n,) fractions of the rays' light, in [0, 1], up to which it is summed. Return whether every node that is read is
    there.
    """
    rows, columns = node.shape
    slices = table.shape[1] - 1
    for n in range(len(x)):
        if not t[n] > 0.0:
            continue
        k = min(int(t[n] * slices), slices - 1)
        f = t[n] * slices - k
        i, j = math.floor(x[n] - 0.5), math.floor(y[n] - 0.5)
        fx, fy = x[n] - 0.5 - i, y[n] - 0.5 - j
        for b in range(4):
            for a in range(4):
                row, column = _wrapped(j + b - 1, i + a - 1, rows, columns)
                m = node[row, column]
                if m < 0:
                    return False
                weight = _cubic(fx, a) * _cubic(fy, b)
                for c in range(3):
                    result[n, c] += weight * (table[m, k, c] + (table[m, k + 1, c] - table[m, k, c]) * f)
    return True
