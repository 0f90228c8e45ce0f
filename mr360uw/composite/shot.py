# SPDX-License-Identifier: Apache-2.0
"""Everything that the layer of one frame depends on."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from mr360uw.composite.mesh.mesh import Mesh
from mr360uw.composite.settings import DrawSettings
from mr360uw.types import Environment, Floats, MediumTable, Sun

SHADOW_BIAS = 0.006

_DRAW = DrawSettings()


@dataclass(frozen=True, slots=True, eq=False)
class PlacedObject:
    """A mesh in the world. world_from_object: (4, 4), rotation, uniform scale and translation."""

    mesh: Mesh
    world_from_object: Floats
    casts_shadow: bool = True
    visible: bool = True

    @property
    def scale(self) -> float:
        """Metres in the world for a metre of the mesh."""
        return float(abs(np.linalg.det(self.world_from_object[:3, :3])) ** (1.0 / 3.0))

    @property
    def bias_m(self) -> float:
        """How far off its own surface the shadow rays of the body start: a texel and a half of its shadow map."""
        return SHADOW_BIAS * float(np.max(self.mesh.extent_m)) * self.scale

    def to_world(self, points: Floats) -> Floats:
        """Return points (..., 3) of the object in the world."""
        return points @ self.world_from_object[:3, :3].T + self.world_from_object[:3, 3]


@dataclass(frozen=True, slots=True, eq=False)
class Receiver:
    """The surface of the plate that catches shadows: exactly one of the three shapes.

    plane_y: height [m] of a horizontal plane in the world. mesh: triangles (T, 3, 3) in the world. distance_m: (h, w)
    distances along the camera's rays, a frame of any size, 0, infinite or NaN where there is none. shadow, occlusion,
    caustics: what falls on it. extent_m: how far from the camera it is changed.
    """

    plane_y: float | None = None
    mesh: Floats | None = None
    distance_m: Floats | None = None
    shadow: bool = True
    occlusion: bool = True
    caustics: bool = False
    extent_m: float = 30.0


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """One frame: its size, camera, objects, light and water.

    camera_position: (3,) in the world. world_from_camera: (3, 3) rotation. camera_depth_m: height of the mean water
    surface above the world's origin, the depth of a point being camera_depth_m - y. caustics: a `types.CausticStack`,
    or for the gl renderer what `mr360uw.caustics.gl.renderer` keeps on the device. medium: None without water.
    holdout: (H, W) in [0, 1], how much of the plate stays in front. holdout_distance_m: (H, W) distance of what is in
    front of everything farther away. samples, shading, sun_samples, sun_spread_rad: see `DrawSettings`.
    """

    width: int
    height: int
    objects: tuple[PlacedObject, ...]
    environment: Environment
    sun: Sun | None = None
    camera_position: Floats = field(default_factory=lambda: np.zeros(3))
    world_from_camera: Floats = field(default_factory=lambda: np.eye(3))
    camera_depth_m: float = 5.0
    medium: MediumTable | None = None
    caustics: Any = None
    receiver: Receiver | None = None
    holdout: Floats | None = None
    holdout_distance_m: Floats | None = None
    samples: int = _DRAW.samples
    shading: Literal["pixel", "sample"] = _DRAW.shading
    sun_samples: int = _DRAW.sun_samples
    sun_spread_rad: float = 0.0
