# SPDX-License-Identifier: Apache-2.0
"""Shafts on a spherical grid about the camera: longitude, latitude and distance (Hillaire 2015, on a sphere).

Nodes lie in the middle of the pixels of a coarse equirectangular frame in the world's axes. Along each, distances are
divided into slices of equal transmittance of the clearest wavelength, up to the surface or to where no light is left,
and each slice into `samples` segments (`ShaftScene.segments`). The table holds the light from the camera to every
slice.

A pixel reads the sixteen nodes around it (cubic convolution, Keys 1981), periodic in longitude and continued over the
poles, up to its own end: an object, the ground or the surface. Nodes do not stop at bodies. Their light up to a pixel's
distance is what the pixel's ray sees, so the edges of bodies do not leak and need no search for nodes of like depth.
Rays of different height reach the surface at different distances: at the fraction x of its own way there a pixel reads
a node farther by x^2 of the difference, so that both end at the surface.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mr360uw.errors import ParameterError
from mr360uw.medium.shafts.beam_pattern import MOST_POINTS
from mr360uw.medium.shafts.ray_segments import fraction_at, radius_at
from mr360uw.medium.shafts.shaft_scene import ShaftScene
from mr360uw.sphere import direction_from_frame, frame_from_direction

Array = NDArray[np.float64]

_SHIFTS = np.array([0.7549, 0.5698])
"""Steps of the samples' places from frame to frame, in columns and segments: the additive sequence in two dimensions
of least discrepancy (1/g and 1/g^2, g^3 = g + 1)."""


@dataclass(frozen=True, slots=True)
class FroxelGrid:
    """Size of a grid: rows of latitude, columns of longitude, slices of distance kept, samples in each slice."""

    rows: int
    columns: int
    slices: int
    samples: int = 1

    def __post_init__(self) -> None:
        if min(self.rows, self.columns, self.slices) < 2 or self.samples < 1 or self.columns % 2:
            raise ParameterError(
                f"grid - needs two rows, columns and slices or more, a sample, even columns (got {self}) - enlarge it"
            )


DEFAULT_GRID = FroxelGrid(256, 512, 96, 2)
"""Error over the rms of the deviation: see docs/medium.md. Half as many rows and columns: two to three times the
error, an eighth of the time."""


@dataclass(frozen=True, slots=True, eq=False)
class ShaftField:
    """Deviation of the light in the water about a camera. table: (rows + 4, columns, slices + 1, 3), from the camera up
    to a slice; two rows more at each pole. scene: its camera and water. shift: of the nodes in columns.
    """

    scene: ShaftScene
    table: Array
    shift: float

    def radiance(self, directions: Array, distance_m: Array) -> Array:
        """Return the deviation (m, 3) of rays (m, 3) from the camera up to distances (m,) [m]."""
        rows, columns, slices = self.table.shape[0] - 4, self.table.shape[1], self.table.shape[2] - 1
        x, y = frame_from_direction(directions, columns, rows)
        x, y = x - 0.5 - self.shift, y + 1.5
        i, j = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
        _, reach = self.scene.layout(directions[:, 1])
        s = np.minimum(distance_m, reach)
        part = np.divide(s, reach, out=np.zeros(len(s)), where=reach > 0.0)
        result = np.zeros((len(directions), 3))
        for row_weight, dj in zip(_cubic(y - j), range(-1, 3), strict=True):
            row = np.clip(j + dj, 0, rows + 3)
            rate, own = self.scene.layout(_row_up(row, rows))
            t = fraction_at(np.clip(s + part * part * (own - reach), 0.0, own), rate, own) * slices
            k = np.minimum(t.astype(np.int64), slices - 1)
            f = (t - k)[:, None]
            for column_weight, di in zip(_cubic(x - i), range(-1, 3), strict=True):
                column = (i + di) % columns
                near, far = self.table[row, column, k], self.table[row, column, k + 1]
                result += (row_weight * column_weight)[:, None] * (near + (far - near) * f)
        return result


def _cubic(f: Array) -> tuple[Array, Array, Array, Array]:
    """Return the weights (n,) of four neighbours at a fraction f between the inner two (Keys 1981)."""
    return (
        0.5 * f * (f * (2.0 - f) - 1.0), 0.5 * (f * f * (3.0 * f - 5.0) + 2.0),
        0.5 * f * (f * (4.0 - 3.0 * f) + 1.0), 0.5 * f * f * (f - 1.0),
    )  # fmt: skip


def _row_up(row: NDArray[np.int64], rows: int) -> Array:
    """Return the height of the directions of table rows (n,); the rows beyond the poles mirror those before them."""
    inside = np.minimum(np.abs(row - 1.5), rows - np.abs(row - 1.5 - rows))
    return np.asarray(np.sin(np.pi * (0.5 - inside / rows)))


def shaft_field(scene: ShaftScene, grid: FroxelGrid = DEFAULT_GRID, frame: int = 0) -> ShaftField:
    """Return the shafts about a scene's camera on a grid. frame: index that places the samples; 0 is the middle."""
    turn, along = np.remainder(0.5 + frame * _SHIFTS, 1.0) - 0.5
    count = grid.slices * grid.samples
    table = np.zeros((grid.rows + 4, grid.columns, grid.slices + 1, 3))
    t = np.arange(count + 1) / count
    batch = max(MOST_POINTS // count, 1)
    for row in range(grid.rows):
        directions = direction_from_frame(np.arange(grid.columns) + 0.5 + turn, row + 0.5, grid.columns, grid.rows)
        rate, reach = scene.layout(directions[:1, 1])
        edge = radius_at(t, rate[:, None], reach[:, None])
        for start in range(0, grid.columns, batch):
            part = slice(start, start + batch)
            light = scene.segments(directions[part], edge, 0.5 + along, np.pi / grid.rows)
            slices = light.reshape(len(light), grid.slices, grid.samples, 3).sum(axis=2)
            table[row + 2, part, 1:] = np.cumsum(slices, axis=1)
    half = grid.columns // 2
    for beyond in range(2):
        table[1 - beyond] = np.roll(table[2 + beyond], half, axis=0)
        table[-2 + beyond] = np.roll(table[-3 - beyond], half, axis=0)
    return ShaftField(scene, table, float(turn))
