# SPDX-License-Identifier: Apache-2.0
"""Maps of bodies from every direction of the sun's disc and of its halo: visible fractions without a ray a point.

A map is a square across the bounding sphere of a body and holds, for parallel light of one direction, how far up along
that direction the body reaches, seen from the sphere's centre. A point is in shadow where it lies below that: exact but
for the width of a pixel, also between the parts of a body.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mr360uw.medium.shafts.occluders import GOLDEN, Bodies, Occluder
from mr360uw.sphere import basis

Array = NDArray[np.float64]

DISC_PIXELS, HALO_PIXELS = 256, 64
"""Pixels across a body: of the disc's maps, and of the halo's, whose shadows are blurred by degrees."""
DISC_TAPS, HALO_TAPS = 16, 64
"""Points of a segment at which disc and halo are tested, one direction each, in turn."""


@dataclass(frozen=True, slots=True, eq=False)
class ShadowMaps:
    """Maps of k bodies in n directions. frame: (n, 3, 3) rows (u, v, direction). top: (k, n, size, size) float32 [m].

    axis: (3,) mean direction. cosine: of the widest direction from it.
    """

    frame: Array
    top: NDArray[np.float32]
    axis: Array
    cosine: float

    @classmethod
    def of(cls, bodies: Bodies, directions: Array, size: int) -> ShadowMaps:
        """Return the maps of bodies with bounding spheres."""
        frame = np.array([basis(d) for d in directions])
        spheres = zip(bodies.occluders, bodies.centre, bodies.radius, strict=True)
        top = [[_top(body, centre, radius, f, size) for f in frame] for body, centre, radius in spheres]
        axis = directions.mean(axis=0)
        axis = axis / np.linalg.norm(axis)
        return cls(frame, np.array(top, np.float32), axis, min(float(np.min(directions @ axis)), 1.0))


def _top(body: Occluder, centre: Array, radius: float, frame: Array, size: int) -> Array:
    at = radius * (2.0 * (np.arange(size) + 0.5) / size - 1.0)
    u, v = np.meshgrid(at, at)
    inside = u * u + v * v <= radius * radius
    start = centre + u[inside, None] * frame[0] + v[inside, None] * frame[1] + radius * frame[2]
    top = np.full((size, size), -np.inf)
    top[inside] = radius - body.distance(start, np.broadcast_to(-frame[2], start.shape))
    return top


@njit(nogil=True, cache=True, error_model="numpy")  # type: ignore[untyped-decorator, unused-ignore]
def visible_parts(
    origin: Any, directions: Any, start: Any, end: Any, centre: Any, radius: Any, frame: Any, top: Any, axis: Any,
    cosine: Any, taps: Any, seen: Any,
) -> None:  # fmt: skip
    """Write the visible fraction of a disc of light, a mean over each segment of rays, to `seen` (n, count).

    directions: (n, 3). start, end: (n, count) [m] of their segments. centre, radius: (k, 3), (k,) bounding spheres of
    bodies. frame to cosine: of `ShadowMaps`. taps: points of a segment that are tested, with the directions in turn.
    """
    size = top.shape[2]
    tangent = math.sqrt(max(1.0 - cosine * cosine, 0.0)) / cosine
    for n in range(len(directions)):
        d0, d1, d2 = directions[n, 0], directions[n, 1], directions[n, 2]
        for k in range(seen.shape[1]):
            length = end[n, k] - start[n, k]
            middle = start[n, k] + 0.5 * length
            blocked = 0
            near = False
            for body in range(len(radius)):
                x = centre[body, 0] - origin[0] - middle * d0
                y = centre[body, 1] - origin[1] - middle * d1
                z = centre[body, 2] - origin[2] - middle * d2
                along = x * axis[0] + y * axis[1] + z * axis[2]
                wide = radius[body] + 0.5 * length
                reach = wide / cosine + max(along, 0.0) * tangent
                near |= along > -wide and x * x + y * y + z * z - along * along <= reach * reach
            if not near:
                seen[n, k] = 1.0
                continue
            for tap in range(taps):
                m = tap % len(frame)
                s = start[n, k] + (tap * GOLDEN + 0.5) % 1.0 * length
                for body in range(len(radius)):
                    x = origin[0] + s * d0 - centre[body, 0]
                    y = origin[1] + s * d1 - centre[body, 1]
                    z = origin[2] + s * d2 - centre[body, 2]
                    f = frame[m]
                    scale = 0.5 * size / radius[body]
                    i = math.floor((x * f[0, 0] + y * f[0, 1] + z * f[0, 2]) * scale + 0.5 * size)
                    j = math.floor((x * f[1, 0] + y * f[1, 1] + z * f[1, 2]) * scale + 0.5 * size)
                    below = x * f[2, 0] + y * f[2, 1] + z * f[2, 2]
                    if 0 <= i < size and 0 <= j < size and below < top[body, m, j, i]:
                        blocked += 1
                        break
            seen[n, k] = 1.0 - blocked / taps
