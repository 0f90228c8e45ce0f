# SPDX-License-Identifier: Apache-2.0
"""Phase functions as series of Legendre polynomials: the moments that streams resolve, and functions given by them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mr360uw.constants import INV_4PI
from mr360uw.errors import ParameterError
from mr360uw.medium.phase import Mixture
from mr360uw.medium.ray_field import legendre_polynomials
from mr360uw.shapes import exactly

Array = NDArray[np.float64]


def phase_moments(phase: Mixture | Array, count: int, least: int) -> Array:
    """Return Legendre moments (count, l), as many as are given, or the `least`."""
    if isinstance(phase, Mixture):
        return np.broadcast_to(phase.moments(least), (count, least))
    length = phase.shape[-1]
    moments = np.broadcast_to(exactly("phase", phase, (length,), (count, length)), (count, length))
    if moments.shape[1] < least or not np.allclose(moments[:, 0], 1.0):
        raise ParameterError(f"phase - needs {least} Legendre moments from 1 on (got {phase.shape}) - give more")
    return np.array(moments, np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class PhaseSeries:
    """Phase functions of n wavelengths by their Legendre moments (n, l + 1); light of the last is unscattered."""

    moments: Array

    @property
    def shares(self) -> Array:
        """Coefficients (l, n) of `parts`."""
        degree = np.arange(self.moments.shape[1] - 1)[:, None]
        return np.asarray((2 * degree + 1) * INV_4PI * (self.moments[:, :-1] - self.moments[:, -1:]).T)

    def parts(self, cosine: Array) -> Array:
        """Return the Legendre polynomials (..., l)."""
        return legendre_polynomials(cosine, self.moments.shape[1] - 1)
