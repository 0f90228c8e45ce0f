# SPDX-License-Identifier: Apache-2.0
"""Footprints: areas of surfaces that pixels show, over which shadows are averaged.

A shadow's edge may be narrower than a pixel. Its mean over the pixel is the mean over rays that start from the whole
footprint, a parallelogram in the plane of the surface. Its sides come from the derivatives of the visible point P by
the frame coordinates, taken as differences over a step s:

    side_k = dP/dx m_xk + dP/dy m_yk        dP/dx = (P(x + s, y) - P(x, y))/s

with m the symmetric matrix (2, 2) of an area in the frame (see sampling.py); the unit matrix is a whole pixel. On the
device: footprint.glsl.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mr360uw.constants import LONGEST_FOOTPRINT
from mr360uw.types import Floats, View


@dataclass(frozen=True, slots=True, eq=False)
class Footprint:
    """Parallelograms on surfaces. middle: (n, 3) from the camera, sides: (n, 2, 3), both [m] in the world's axes."""

    middle: Floats
    sides: Floats

    def some(self, chosen: NDArray[np.int64]) -> Footprint:
        """Return the footprints of some indices."""
        return Footprint(self.middle[chosen], self.sides[chosen])


def pixel_steps(point: Floats, normal: Floats, neighbours: Floats, step: float) -> Floats:
    """Return the derivatives (n, 2, 3) [m] of points (n, 3) on planes by the frame's columns and rows.

    neighbours: (n, 2, 3) directions that lie `step` pixels to the right and below. On slanted planes a derivative is at
    most `LONGEST_FOOTPRINT` times as long as across the ray; beyond the plane's horizon it is the one across the ray.
    """
    distance = np.linalg.norm(point, axis=-1)[:, None, None]
    cosine, height = (np.einsum("nk,n...k->n...", normal, a) for a in (neighbours, point))
    along = height[:, None] / np.where(np.abs(cosine) > 1e-6, cosine, np.inf)
    flat = neighbours * distance - point[:, None]
    slanted = neighbours * along[..., None] - point[:, None]
    longest = LONGEST_FOOTPRINT * np.linalg.norm(flat, axis=-1)
    shorter = np.minimum(longest / np.maximum(np.linalg.norm(slanted, axis=-1), 1e-30), 1.0)
    steps = np.where(along[..., None] > 0.0, slanted * shorter[..., None], flat)
    return np.asarray(steps / step)


def pixel_footprint(
    view: View, x: Floats, y: Floats, point: Floats, normal: Floats, area: Floats | None = None
) -> Footprint:
    """Return the footprints of areas (n, 5) of the frame about frame coordinates (n,), whole pixels if not given.

    point, normal: (n, 3) of the surface seen there.
    """
    neighbours = np.stack([view.directions(x + 1.0, y), view.directions(x, y + 1.0)], axis=1)
    seen = point - view.starts(view.directions(x, y)) if view.eye_m else point
    steps = pixel_steps(seen, normal, neighbours, 1.0)
    return Footprint(point, steps) if area is None else footprint(point, steps, area)


def footprint(point: Floats, steps: Floats, area: Floats) -> Footprint:
    """Return the footprints of areas (n, 5) of the frame (`sampling.frame_areas`) about points (n, 3).

    steps: (n, 2, 3) of `pixel_steps`.
    """
    x, y = steps[:, 0], steps[:, 1]
    ox, oy, xx, xy, yy = area.T[..., None]
    return Footprint(point + ox * x + oy * y, np.stack([xx * x + xy * y, xy * x + yy * y], axis=1))


def moved(middle: Floats, sides: Floats | None, place: Floats) -> Floats:
    """Return the points (n, 3) at a place (2,) in [-0.5, 0.5]^2 of parallelograms; the middles if `sides` is None."""
    return middle if sides is None else middle + place @ sides
