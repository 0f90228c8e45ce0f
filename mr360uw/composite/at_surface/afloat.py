# SPDX-License-Identifier: Apache-2.0
"""Floating: the pose of an object that heaves and tilts with the waves under it.

The plane h + s.(x, z) that fits the surface best (least squares) over the object's own length and width gives its heave
h and tilt: waves that are shorter than the object do not move it. There is no inertia and no drift.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mr360uw.caustics.settings import Sea
from mr360uw.composite.mesh.mesh import Mesh
from mr360uw.types import Floats

_POINTS = 13
"""Points along each side of the footprint: waves of a sixth of its length are still averaged, not aliased."""
_LEAST_M = 0.05
"""Least length [m] of a footprint's side."""


@dataclass(frozen=True, slots=True, eq=False)
class Afloat:
    """The sea that an object floats on. surface_y_m: height of its mean surface in the world."""

    sea: Sea
    surface_y_m: float

    def pose(self, calm: Floats, mesh: Mesh, time_s: float) -> Floats:
        """Return the transform (4, 4) at a time [s] of an object that has the transform `calm` on a level sea."""
        middle = calm[:3, :3] @ mesh.center_m + calm[:3, 3]
        sides = [_level(mesh.extent_m[axis] * calm[:3, axis], axis) for axis in (0, 2)]
        heave, slope = self.plane(middle[[0, 2]], np.array(sides), time_s)
        foot = np.array([middle[0], self.surface_y_m, middle[2]])
        turn = _upright_to(np.array([-slope[0], 1.0, -slope[1]]) / np.sqrt(1.0 + slope @ slope))
        pose = np.array(calm)
        pose[:3, :3] = turn @ calm[:3, :3]
        pose[:3, 3] = foot + [0.0, heave, 0.0] + turn @ (calm[:3, 3] - foot)
        return pose

    def plane(self, middle: Floats, sides: Floats, time_s: float) -> tuple[float, Floats]:
        """Return the height [m] over the mean surface and the slopes (2,) over (x, z) of the plane that fits the waves.

        middle: (2,) of a parallelogram on the mean surface, where the height is taken; sides: (2, 2), [m] over (x, z).
        """
        place = (np.arange(_POINTS) + 0.5) / _POINTS - 0.5
        u, v = (k.ravel() for k in np.meshgrid(place, place))
        rest = middle + u[:, None] * sides[0] + v[:, None] * sides[1]
        point = self.sea.surface(rest[:, 0], rest[:, 1], time_s).position
        columns = np.stack([np.ones(len(u)), point[:, 0] - middle[0], point[:, 2] - middle[1]], axis=-1)
        height, *slope = np.linalg.lstsq(columns, point[:, 1], rcond=None)[0]
        return float(height), np.array(slope)


def _level(side: Floats, axis: int) -> Floats:
    """Return the horizontal part (2,) of a side of a body, lengthened to the least one."""
    flat = side[[0, 2]]
    length = float(np.linalg.norm(flat))
    if length >= _LEAST_M:
        return np.asarray(flat)
    return _LEAST_M * (flat / length if length > 0.0 else np.array([1.0, 0.0] if axis == 0 else [0.0, 1.0]))


def _upright_to(normal: Floats) -> Floats:
    """Return the least rotation (3, 3) that turns up, (0, 1, 0), to a unit normal with y > 0."""
    x, y, z = normal
    k = 1.0 / (1.0 + y)
    return np.array([[1.0 - k * x * x, x, -k * x * z], [-x, y, -z], [-k * x * z, z, 1.0 - k * z * z]])
