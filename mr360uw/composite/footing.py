# SPDX-License-Identifier: Apache-2.0
"""Footing: sets objects down so that their lowest point is on the receiver."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mr360uw.composite.motion import Motion
from mr360uw.composite.objects import SceneObject
from mr360uw.composite.shot import Receiver
from mr360uw.errors import MeshError
from mr360uw.types import Floats


def on_the_floor(placed: SceneObject, receiver: Receiver | None) -> SceneObject:
    """Return an object that stands on a receiver if its settings say so, else itself.

    At every key its lowest point is as high as the receiver is under the middle of its foot; of an object that plays a
    clip, the lowest point at rest. Raises `MeshError` where no receiver of known shape is under it.
    """
    if placed.settings.stand_on is None:
        return placed
    mesh = placed.meshes[0]
    points = (mesh.hull if placed.playback is None else mesh.positions).reshape(-1, 3)
    return replace(placed, motion=_stood(placed, points, receiver))


def _stood(placed: SceneObject, points: Floats, receiver: Receiver | None) -> Motion:
    """Return the motion of an object of these points (n, 3) at the heights at which it stands."""
    motion = placed.motion
    position = motion.position.copy()
    for number, (rotation, scale) in enumerate(zip(motion.rotation, motion.scale, strict=True)):
        corners = scale * points @ rotation.T + position[number]
        low, high = corners.min(axis=0), corners.max(axis=0)
        x, z = 0.5 * (low + high)[[0, 2]]
        height = None if receiver is None else receiver_height(receiver, float(x), float(z))
        if height is None:
            raise MeshError(
                f"{placed.settings.mesh} - stands on nothing (got no receiver under x {x:.2f}, z {z:.2f} m) - move it, "
                "or give a receiver of kind plane, mesh or height_map that reaches there"
            )
        position[number, 1] += height - low[1]
    return replace(motion, position=position)


def receiver_height(receiver: Receiver, x_m: float, z_m: float) -> float | None:
    """Return the height [m] in the world of the highest point of a receiver at (x, z); None where there is none.

    The shape of a distance map is known along the rays of a frame only: None.
    """
    if receiver.plane_y is not None:
        return receiver.plane_y
    if receiver.mesh is None:
        return None
    a, b, c = (receiver.mesh[:, k] for k in range(3))
    u, v = b - a, c - a
    area = u[:, 0] * v[:, 2] - u[:, 2] * v[:, 0]
    there = np.abs(area) > 0.0
    a, u, v, area = a[there], u[there], v[there], area[there]
    dx, dz = x_m - a[:, 0], z_m - a[:, 2]
    along_u, along_v = (dx * v[:, 2] - dz * v[:, 0]) / area, (dz * u[:, 0] - dx * u[:, 2]) / area
    inside = (along_u >= 0.0) & (along_v >= 0.0) & (along_u + along_v <= 1.0)
    heights = (a[:, 1] + along_u * u[:, 1] + along_v * v[:, 1])[inside]
    return float(heights.max()) if len(heights) else None
