# SPDX-License-Identifier: Apache-2.0
"""Surfaces that follow nodes: rigidly, by morph targets and by skins (glTF 2.0 specification, sections 3.7.2.2, 3.7.3),
and the clips that move these: values over time between keys (section 3.11 and appendix C).

Tangents are not morphed: the renderers find them from positions and texture coordinates.
Nodes are a tree of transforms, at rest and at a time of a clip.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.mesh.polygons import cofactors, composed, crease_normals, placed
from mr360uw.types import Floats

Interpolation = Literal["LINEAR", "STEP", "CUBICSPLINE"]
Target = Literal["translation", "rotation", "scale", "weights"]
_STRAIGHT = 1.0 - 1e-10
"""Cosine between quaternions above which the arc is taken as straight; its error there is below 1e-15."""


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """Values (k, w) at ascending times (k,) [s]; before the first and after the last they stay.

    tangents: of CUBICSPLINE, (k, 2, w), into and out of each key, per second. turns: whether the values are unit
    quaternions x, y, z, w.
    """

    time_s: Floats
    values: Floats
    interpolation: Interpolation = "LINEAR"
    tangents: Floats | None = None
    turns: bool = False

    def at(self, time_s: float) -> Floats:
        """Return the value (w,) at a time: STEP, LINEAR (quaternions: the shortest arc), or a cubic Hermite spline."""
        key = int(np.searchsorted(self.time_s, time_s, side="right")) - 1
        if key < 0 or key == len(self.time_s) - 1 or self.interpolation == "STEP":
            return np.asarray(self.values[max(key, 0)])
        span = float(self.time_s[key + 1] - self.time_s[key])
        t, before, after = (time_s - float(self.time_s[key])) / span, self.values[key], self.values[key + 1]
        if self.tangents is not None:
            leaving, arriving = span * self.tangents[key, 1], span * self.tangents[key + 1, 0]
            value = (
                (2 * t**3 - 3 * t**2 + 1) * before
                + (t**3 - 2 * t**2 + t) * leaving
                + (3 * t**2 - 2 * t**3) * after
                + (t**3 - t**2) * arriving
            )
            return np.asarray(value / np.linalg.norm(value) if self.turns else value)
        return slerp(before, after, t) if self.turns else np.asarray((1.0 - t) * before + t * after)


def slerp(before: Floats, after: Floats, t: float) -> Floats:
    """Return the unit quaternion (4,) a fraction t along the shortest arc between two (Shoemake 1985)."""
    cosine = float(before @ after)
    if cosine < 0.0:
        after, cosine = -after, -cosine
    if cosine > _STRAIGHT:
        value = (1.0 - t) * before + t * after
        return np.asarray(value / np.linalg.norm(value))
    angle = np.arccos(cosine)
    return np.asarray((np.sin((1.0 - t) * angle) * before + np.sin(t * angle) * after) / np.sin(angle))


Channel = tuple[int, Target, Curve]
"""A curve that moves one thing: number of a skeleton's node, what of it, and its values."""


@dataclass(frozen=True, slots=True, eq=False)
class Animation:
    """An animation: channels that are played together."""

    name: str
    channels: tuple[Channel, ...]

    @property
    def first_s(self) -> float:
        """Time of the first key [s]."""
        return min((float(curve.time_s[0]) for _, _, curve in self.channels), default=0.0)

    @property
    def duration_s(self) -> float:
        """Time from the first key to the last [s]."""
        return max((float(curve.time_s[-1]) for _, _, curve in self.channels), default=0.0) - self.first_s


Pose = tuple[Floats, Mapping[int, Floats]]
"""Where nodes are: transforms (n, 4, 4) from each node to the file's axes, and the weights of morph targets, by node,
where a clip sets them."""
MorphTarget = tuple[Floats | None, Floats | None]
"""What is added at weight 1 to positions (V, 3) and normals (V, 3); None adds nothing."""


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

    def at_rest(self) -> Pose:
        """Return the pose that the file's nodes have."""
        return self._world(self.local), {}

    @property
    def folded(self) -> bool:
        """Whether a node has a scale of 0 at rest: what hangs on it is a plane, a line or a point."""
        return bool(np.any(self.scale == 0.0))

    def unfolded(self) -> Pose:
        """Return the pose at rest with scales of 0 taken as 1."""
        local, flat = self.local.copy(), np.any(self.scale == 0.0, axis=1)
        scale = np.where(self.scale == 0.0, 1.0, self.scale)
        local[flat] = composed(self.translation[flat], self.rotation[flat], scale[flat])
        return self._world(local), {}

    def at(self, clip: Animation, time_s: float) -> Pose:
        """Return the pose at a time [s] of a clip, counted from the clip's own zero."""
        columns = {"translation": self.translation.copy(), "rotation": self.rotation.copy(), "scale": self.scale.copy()}
        weights: dict[int, Floats] = {}
        for node, target, curve in clip.channels:
            if target == "weights":
                weights[node] = curve.at(time_s)
            else:
                columns[target][node] = curve.at(time_s)
        moved = sorted({node for node, target, _ in clip.channels if target != "weights"})
        local = self.local.copy()
        local[moved] = composed(**{name: column[moved] for name, column in columns.items()})
        return self._world(local), weights

    def _world(self, local: Floats) -> Floats:
        world = np.empty_like(local)
        for number, parent in enumerate(self.parent):
            world[number] = local[number] if parent < 0 else world[parent] @ local[number]
        return world


@dataclass(frozen=True, slots=True, eq=False)
class Skin:
    """Joints that vertices follow, blended linearly.

    joints: (J,) numbers of nodes. inverse_bind: (J, 4, 4) from the mesh's axes to each joint's as they were bound.
    weights: sparse (V, J), rows sum to 1.
    """

    joints: NDArray[np.int64]
    inverse_bind: Floats
    weights: Any

    def bent(
        self, world: Floats, positions: Floats, normals: Floats | None, faces: NDArray[np.int64]
    ) -> tuple[Floats, Floats | None, NDArray[np.int64]]:
        """Return positions, normals and faces that follow the joints, as `affine.placed` does.

        world: (n, 4, 4) of all nodes. Mirrored is a surface most of whose weight is on joints that mirror.
        """
        joints = world[self.joints] @ self.inverse_bind
        blend = (self.weights @ joints[:, :3].reshape(-1, 12)).reshape(-1, 3, 4)
        linear = blend[..., :3]
        share = np.asarray(self.weights.sum(axis=0)).ravel()
        mirrored = bool(share @ np.sign(np.linalg.det(joints[:, :3, :3])) < 0.0)
        if normals is not None:
            normals = np.einsum("vij,vj->vi", cofactors(linear), normals) * (-1.0 if mirrored else 1.0)
        positions = np.einsum("vij,vj->vi", linear, positions) + blend[..., 3]
        return positions, normals, faces[:, ::-1] if mirrored else faces


@dataclass(frozen=True, slots=True, eq=False)
class UnplacedSurface:
    """A surface of a mesh file before its node places it: positions (V, 3), normals (V, 3) or None, faces (T, 3).

    node: its number in the skeleton. weights: (m,) of its morph targets at rest. skin: None where it is rigid; a body
    with a skin follows its joints and not its node.
    """

    node: int
    positions: Floats
    normals: Floats | None
    faces: NDArray[np.int64]
    targets: tuple[MorphTarget, ...] = ()
    weights: Floats | None = None
    skin: Skin | None = None

    def at(self, pose: Pose) -> tuple[Floats, Floats | None, NDArray[np.int64]]:
        """Return positions, normals (of any length) and faces in the file's axes."""
        (world, set_weights), positions, normals = pose, self.positions, self.normals
        weights = set_weights.get(self.node, self.weights)
        for weight, (moved, turned) in zip([] if weights is None else weights.tolist(), self.targets, strict=True):
            if weight != 0.0 and moved is not None:
                positions = positions + weight * moved
            if weight != 0.0 and turned is not None and normals is not None:
                normals = normals + weight * turned
        if self.skin is not None:
            return self.skin.bent(world, positions, normals, self.faces)
        return placed(world[self.node], positions, normals, self.faces)


def smoothed_body(body: UnplacedSurface, crease_cosine: float) -> UnplacedSurface:
    """Return a body with a vertex for every corner of its triangles and new normals, those of `crease_normals`."""
    corners = body.positions[body.faces]
    if not len(corners) or not np.all(np.isfinite(corners)):
        return body
    order = body.faces.ravel()
    return replace(
        body,
        positions=body.positions[order],
        normals=crease_normals(corners, crease_cosine).reshape(-1, 3),
        faces=np.arange(len(order)).reshape(-1, 3),
        targets=tuple((None if moved is None else moved[order], None) for moved, _ in body.targets),
        skin=None if body.skin is None else replace(body.skin, weights=body.skin.weights[order]),
    )
