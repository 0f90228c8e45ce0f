# SPDX-License-Identifier: Apache-2.0
"""Lamps of a shot on the device: slots of the shadow atlas and the table that lamps.glsl reads."""

from __future__ import annotations

import numpy as np

from mr360uw.composite.gl.shadow_atlas import ROW_TEXELS, Atlas, LightFrame
from mr360uw.composite.lighting.lamps import lamps_of
from mr360uw.composite.shot import PlacedObject, Shot
from mr360uw.medium.shafts.ray_segments import nearest_m
from mr360uw.sphere import basis
from mr360uw.types import Floats, Lamp

_FARTHER = 1.25
"""Least distance of a body, in its radii, to fit one slot: it is then within 53 degrees of the slot's axis."""
_MOST_BODIES = 16
"""Most bodies with a slot of their own for a lamp; more share the six faces of a cube. Slots are bits of an integer."""
_FACES = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], np.float64)
_CORNER_RAD = float(np.arccos(3.0**-0.5))
"""Angle between the axis of a cube's face and its corners."""

_ROWS_OF_BEAM = 2
"""Rows of the texture `beam` before the lamps' attenuations: the sun's beam, and what of it has not turned."""


def lamp_frames(shot: Shot) -> list[list[LightFrame]]:
    """Return the light frames of each lamp: one for each body in its cone, or faces of a cube for bodies around it."""
    return [_frames(lamp, shot.casters) if lamp.casts_shadow else [] for lamp in lamps_of(shot)]


def _frames(lamp: Lamp, casters: tuple[PlacedObject, ...]) -> list[LightFrame]:
    alone: list[LightFrame] = []
    around: list[PlacedObject] = []
    for placed in casters:
        center = placed.to_world(placed.mesh.center_m) - lamp.position
        distance, radius = float(np.linalg.norm(center)), placed.mesh.radius_m * placed.scale
        if distance <= _FARTHER * radius:
            around.append(placed)
        elif _in_cone(lamp, center / distance, float(np.arcsin(radius / distance))):
            axes = basis(center)
            alone.append(LightFrame((placed,), axes, lamp.position, distance, nearest_m(lamp)))
    if len(alone) > _MOST_BODIES - len(_FACES) * bool(around):
        alone, around = [], list(casters)
    return alone + _faces(lamp, tuple(around))


def _faces(lamp: Lamp, bodies: tuple[PlacedObject, ...]) -> list[LightFrame]:
    """Return the faces of a cube around a lamp that its cone reaches."""
    if not bodies:
        return []
    centers = np.stack([placed.to_world(placed.mesh.center_m) for placed in bodies]) - lamp.position
    reach = np.linalg.norm(centers, axis=-1) + [placed.mesh.radius_m * placed.scale for placed in bodies]
    middle = 0.5 * max(float(reach.max()), 2.0 * nearest_m(lamp))
    return [
        LightFrame(bodies, basis(axis), lamp.position, middle, nearest_m(lamp), face=True)
        for axis in _FACES
        if _in_cone(lamp, axis, _CORNER_RAD)
    ]


def _in_cone(lamp: Lamp, direction: Floats, radius_rad: float) -> bool:
    """Return whether a disc about a unit direction, 1.5 times as wide as `radius_rad`, overlaps the lamp's cone."""
    if lamp.cos_edge <= -1.0:
        return True
    apart = float(np.arccos(np.clip(direction @ lamp.axis, -1.0, 1.0)))
    return apart <= float(np.arccos(lamp.cos_edge)) + 1.5 * radius_rad


def shadow_table(shot: Shot, atlas: Atlas, slots: list[int]) -> Floats:
    """Return the texture `casters` (rows, ROW_TEXELS, 4): the slots of an atlas, then the lamps.

    slots: index of each lamp's first slot, and the end.
    """
    lamps = lamps_of(shot)
    table = np.zeros((len(atlas.table) + len(lamps), ROW_TEXELS, 4))
    table[: len(atlas.table)] = atlas.table
    for row, frame in zip(table, atlas.frames, strict=False):
        if frame.origin is not None:
            row[2:5, :3] = frame.axes
            row[2:5, 3] = frame.axes @ (shot.view.position - frame.origin)
            row[5, 0] = frame.middle_m
    for number, lamp in enumerate(lamps):
        at = _ROWS_OF_BEAM + number
        count = slots[number + 1] - slots[number]
        table[len(atlas.table) + number, :4] = (
            (*(lamp.position - shot.view.position), lamp.radius_m), (*lamp.axis, lamp.cos_core),
            (*lamp.intensity, lamp.cos_edge), (slots[number], count, at, nearest_m(lamp)),
        )  # fmt: skip
    return table
