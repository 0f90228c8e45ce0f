# SPDX-License-Identifier: Apache-2.0
"""Products of sparse matrices and colours: the three sums of a row are kept at once, unlike in a general product."""

from __future__ import annotations

from typing import Any

import numpy as np

from mr360uw.jit import exact
from mr360uw.types import Floats


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
