# SPDX-License-Identifier: Apache-2.0
"""Shafts on a spherical grid about the camera whose pole is the sun: angle from it, angle about it, distance.

All structure of shafts runs towards the sun. Rays at one angle about it lie in a plane with it and meet the same beams,
and what bodies shade ends along such planes; with the angle from it light changes slowly. Only nodes that the pixels
asked for read are computed (`beam_kernel`), each with its distances divided into slices of equal transmittance of the
clearest wavelength, up to the surface or to where no light is left. The table holds the light from the camera to every
slice. The light of lamps is added on the same nodes; without sun the pole is up.

A pixel reads the sixteen nodes around it (cubic convolution, Keys 1981), periodic about the pole and continued over it,
up to its own end: an object, the ground or the surface. Nodes do not stop at bodies. Their light up to a pixel's
distance is what the pixel's ray sees, so the edges of bodies do not leak and need no search for nodes of like depth.
Rays of different height reach the surface at different distances: a pixel reads its nodes at that fraction of their
light at which its own ray ends (`ray_segments.fraction_at`), so that all end at the surface together.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import Cache
from mr360uw.errors import ParameterError
from mr360uw.medium.shafts.field_kernel import mark_nodes, read_field
from mr360uw.medium.shafts.lamp_field import LampField
from mr360uw.medium.shafts.ray_segments import fraction_at, radius_at
from mr360uw.medium.shafts.shaft_scene import ShaftScene
from mr360uw.medium.shafts.sun_beam import SunBeam
from mr360uw.sphere import basis, direction_from_frame, frame_from_direction, unit

Array = NDArray[np.float64]

_TOGETHER = 1 << 13
"""Nodes computed together, which bounds memory."""


@dataclass(frozen=True, slots=True)
class FroxelGrid:
    """Size of a grid: rows of the angle from the sun, columns about it, slices of distance."""

    rows: int
    columns: int
    slices: int

    def __post_init__(self) -> None:
        if min(self.rows, self.columns, self.slices) < 2 or self.columns % 2:
            raise ParameterError(
                f"grid - needs two rows, columns and slices or more, even columns (got {self}) - enlarge it"
            )


DEFAULT_GRID = FroxelGrid(384, 1024, 32)
"""Error over the rms of the deviation: see docs/medium.md."""


@dataclass(frozen=True, slots=True, eq=False)
class ShaftField:
    """Deviation of the light in the water about a camera.

    table: (n, slices + 1, 3) of n nodes, from the camera up to a slice. node: (rows, columns) index of a node in it, -1
    for those left out. pole: (3, 3) rows right, pole, back of the grid's own axes. scene: its camera and water.
    """

    scene: ShaftScene
    table: NDArray[np.float32]
    node: NDArray[np.int32]
    pole: Array

    def radiance(self, directions: Array, distance_m: Array) -> Array:
        """Return the deviation (m, 3) of rays (m, 3) from the camera up to distances (m,) [m].

        Raises `ParameterError` for rays that the field was not made for.
        """
        rows, columns = self.node.shape
        x, y = frame_from_direction(directions @ self.pole.T, columns, rows)
        rate, reach = self.scene.layout(directions[:, 1])
        t = fraction_at(np.minimum(distance_m, reach), rate, reach) * (reach > 0.0)
        result = np.zeros((len(directions), 3))
        if not read_field(self.table, self.node, x, y, t, result):
            raise ParameterError("directions - the field was made for other rays - give all of them to shaft_field")
        return result


def shaft_field(
    scene: ShaftScene,
    grid: FroxelGrid = DEFAULT_GRID,
    directions: Array | None = None,
    cache: Cache | None = None,
) -> ShaftField:
    """Return the shafts about a scene's camera on a grid, for rays (m, 3); None: for all.

    cache: holds what does not change from frame to frame.
    """
    pole = _pole(scene)
    node = np.full((grid.rows, grid.columns), -1, np.int32)
    if directions is None:
        node[:] = 0
    else:
        mark_nodes(*frame_from_direction(directions @ pole.T, grid.columns, grid.rows), node)
    column, row = np.nonzero(node.T >= 0)
    node[row, column] = np.arange(len(row), dtype=np.int32)
    rays = direction_from_frame(column + 0.5, row + 0.5, grid.columns, grid.rows) @ pole
    rate, reach = scene.layout(rays[:, 1])
    table = np.zeros((len(rays), grid.slices + 1, 3), np.float32)
    beam = (
        None
        if scene.pattern is None
        else SunBeam.of(scene, scene.pattern, grid.slices, Cache() if cache is None else cache)
    )
    lamps = [LampField.of(scene, lamp) for lamp in scene.lamps]
    for start in range(0, len(rays), _TOGETHER):
        part = slice(start, start + _TOGETHER)
        light = np.zeros((len(rays[part]), grid.slices, 3))
        if beam is not None:
            beam.add(rays[part], rate[part], reach[part], column[part], 2.0 * np.pi / grid.columns, light)
        if lamps:
            edge = radius_at(np.arange(grid.slices + 1) / grid.slices, rate[part, None], reach[part, None])
            for lamp in lamps:
                lamp.add(scene, rays[part], edge, light)
        table[part, 1:] = np.cumsum(light, axis=1)
    return ShaftField(scene, table, node, pole)


def _pole(scene: ShaftScene) -> Array:
    """Return the grid's axes; the pole is the sun, or up without one."""
    towards = np.array([0.0, 1.0, 0.0]) if scene.pattern is None else unit(scene.pattern.sun.direction)
    right, back, up = basis(towards)
    return np.stack([right, up, back])
