# SPDX-License-Identifier: Apache-2.0
"""Waves smaller than a pixel, by the statistics of their slopes.

    symbol   meaning
    s        slope over (x, z) of a facet; its normal is (-s_x, 1, -s_z) scaled to length 1
    p(s)     Gaussian density of slopes about that of the surface that is drawn (Cox & Munk 1954)
    f(s)     -d.(-s_x, 1, -s_z), the area of a facet that a ray of direction d meets, per unit level area

A ray sees facets in proportion to p(s) max(f(s), 0), whose integral is that of Smith 1967: `tracing/facet_draws.py`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SHARP = 0.05
"""Spread of slopes over the width of the sun's image in them below which the sun's edge is drawn."""
LEAST = 1e-12
FARTHEST = 8.0
"""Standard deviations of slope beyond which there are no facets."""
HALVINGS = 24
"""Bisections of that range: a slope is right to a millionth of its standard deviation."""


@dataclass(frozen=True, slots=True, eq=False)
class FacetsOfRays:
    """Facets that n rays meet. travel, normal: (n, 3), the normal up; covariance: (n, 3) of slopes, xx, xz, zz.
    from_below: whether the rays run in the water.
    """

    travel: Array
    normal: Array
    covariance: Array
    from_below: bool

    @property
    def slope(self) -> Array:
        """Mean slopes (n, 2)."""
        return -self.normal[:, [0, 2]] / np.maximum(self.normal[:, 1:2], LEAST)

    def facing(self, slope: Array) -> Array:
        """Return f (n,) of slopes (n, 2), positive on the side that the ray comes from."""
        d = self.travel
        turned = d[:, 0] * slope[:, 0] + d[:, 2] * slope[:, 1] - d[:, 1]
        return -turned if self.from_below else turned

    def at(self, normal_numbers: Array) -> Array:
        """Return the slopes (n, 2) that two independent normal numbers (n, 2) stand for."""
        c, (g, h) = self.covariance, normal_numbers.T
        xx = np.sqrt(np.maximum(c[:, 0], 0.0))
        zx = c[:, 1] / np.maximum(xx, LEAST)
        zz = np.sqrt(np.maximum(c[:, 2] - zx * zx, 0.0))
        return np.asarray(self.slope + np.stack([xx * g, zx * g + zz * h], axis=-1))


def normal_of(slope: Array) -> Array:
    """Return unit normals (n, 3) up of slopes (n, 2)."""
    normal = np.stack([-slope[:, 0], np.ones(len(slope)), -slope[:, 1]], axis=-1)
    return np.asarray(normal / np.linalg.norm(normal, axis=-1, keepdims=True))
