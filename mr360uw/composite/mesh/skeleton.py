# SPDX-License-Identifier: Apache-2.0
"""The nodes of a mesh file as a tree of transforms, at rest and at a time of a clip."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from mr360uw.composite.affine import composed
from mr360uw.composite.mesh.curve import Animation
from mr360uw.types import Floats


@dataclass(frozen=True, slots=True, eq=False)
class SkeletonPose:
    """Where nodes are. world: (n, 4, 4) from each node to the file's axes. weights: of morph targets, by node, where
    a clip sets them.
    """

    world: Floats
    weights: Mapping[int, Floats] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class Skeleton:
    """n nodes, each after its parent.

    parent: (n,) numbers, -1 for roots. local: (n, 4, 4) transforms to the parent at rest. translation (n, 3), rotation
    (n, 4) quaternions x, y, z, w, and scale (n, 3): what clips replace, at rest. numbers: of the nodes in the file.
    """

    parent: tuple[int, ...]
    local: Floats
    translation: Floats
    rotation: Floats
    scale: Floats
    numbers: tuple[int, ...]

    def at_rest(self) -> SkeletonPose:
        """Return the pose that the file's nodes have."""
        return SkeletonPose(self._world(self.local))

    def at(self, clip: Animation, time_s: float) -> SkeletonPose:
        """Return the pose at a time [s] of a clip, counted from the clip's own zero."""
        columns = {"translation": self.translation.copy(), "rotation": self.rotation.copy(), "scale": self.scale.copy()}
        weights: dict[int, Floats] = {}
        for channel in clip.channels:
            if channel.target == "weights":
                weights[channel.node] = channel.curve.at(time_s)
            else:
                columns[channel.target][channel.node] = channel.curve.at(time_s)
        moved = sorted({channel.node for channel in clip.channels if channel.target != "weights"})
        local = self.local.copy()
        local[moved] = composed(**{name: column[moved] for name, column in columns.items()})
        return SkeletonPose(self._world(local), weights)

    def _world(self, local: Floats) -> Floats:
        world = np.empty_like(local)
        for number, parent in enumerate(self.parent):
            world[number] = local[number] if parent < 0 else world[parent] @ local[number]
        return world
