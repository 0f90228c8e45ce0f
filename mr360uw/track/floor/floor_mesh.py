# SPDX-License-Identifier: Apache-2.0
"""The floor of a clip as a mesh, from the points of its camera track."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mr360uw.errors import ParameterError
from mr360uw.files import write_whole
from mr360uw.output_gate import check_outputs
from mr360uw.threads import one_blas_thread
from mr360uw.track.camera_track import CameraTrack
from mr360uw.track.floor.floor_points import FloorPoints, floor_points
from mr360uw.track.floor.scattered_heights import ScatteredHeights, fit_height_field
from mr360uw.track.world_axes import fit_floor
from mr360uw.types import Floats

MESH_SUFFIXES = (".glb", ".ply")
_FINEST, _MOST_NODES = 0.06, 80
"""Spacing of the nodes over the camera's height, and most nodes along a side: finer shows the points' own noise."""
_RIM = 0.02
"""Share of the points at each end of both axes that the grid leaves out: few points, far away."""
_SKIRT = (1.0, 4.0, 20.0)
"""Distances of the rings about the grid, in camera heights, over which the floor runs out into its plane."""
_FLAT = 0.8
"""Median error of a relief at points that it was not fitted to, over that of the plane, from which on it is flat:
by chance that of a plane's own points is 0.9 to 1.1."""
_LEAST_SPREAD = 0.002
"""Least spread of points about the relief, in camera heights: what tracking of good clips leaves."""


@dataclass(frozen=True, slots=True, eq=False)
class FloorMesh:
    """A floor in the world of its track: heights (r, c) [m] at z_m (r,), x_m (c,), which ascend unevenly.

    confidence (r, c): 0 where no point is near, towards 1 where there are many. flat: the floor is a plane. tilt_deg:
    of its plane against the horizontal. plane_y_m: the plane's height at the origin, where the first camera is above.
    camera_m: height of the camera over the floor. points: number of points used, outliers: share left out. spread_m:
    standard deviation of the points about the floor.
    """

    x_m: Floats
    z_m: Floats
    height_m: Floats
    confidence: Floats
    flat: bool
    tilt_deg: float
    plane_y_m: float
    camera_m: float
    points: int
    outliers: float
    spread_m: float

    @property
    def vertices(self) -> Floats:
        """Vertices (r c, 3) [m]."""
        x, z = np.meshgrid(self.x_m, self.z_m)
        return np.stack([x, self.height_m, z], axis=-1).reshape(-1, 3)

    @property
    def faces(self) -> NDArray[np.int64]:
        """Triangles (t, 3) as numbers of vertices, their front up."""
        rows, columns = self.height_m.shape
        a = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
        b, c, d = a + 1, a + columns + 1, a + columns
        return np.concatenate([np.stack([a, d, c], axis=1), np.stack([a, c, b], axis=1)])

    def height_at(self, x_m: Floats, z_m: Floats) -> Floats:
        """Return heights [m] at places on the floor, NaN beyond its end."""
        from scipy.interpolate import RegularGridInterpolator

        look = RegularGridInterpolator((self.z_m, self.x_m), self.height_m, bounds_error=False)
        return np.asarray(look(np.stack(np.broadcast_arrays(z_m, x_m), axis=-1)))

    @property
    def known_m2(self) -> float:
        """Area of the floor [m2] whose confidence is a half or more."""
        area = np.gradient(self.z_m)[:, None] * np.gradient(self.x_m)
        return float(area[self.confidence >= 0.5].sum())

    def save(self, out: str | Path, *, overwrite: bool = False) -> Path:
        """Write a mesh (.glb or .ply) and return its path; the grey of its vertices is the confidence.

        Raises `ParameterError` or `OutputExistsError`.
        """
        import trimesh

        path = check_mesh_output(out, overwrite=overwrite)
        grey = np.round(255.0 * self.confidence.reshape(-1, 1)).astype(np.uint8)
        colors = np.concatenate([np.repeat(grey, 3, axis=1), np.full_like(grey, 255)], axis=1)
        mesh = trimesh.Trimesh(self.vertices, self.faces, process=False)
        mesh.visual = trimesh.visual.ColorVisuals(mesh, vertex_colors=colors)
        whole = trimesh.Scene(mesh) if path.suffix.lower() == ".glb" else mesh
        write_whole(path, whole.export(file_type=path.suffix.lower().lstrip(".")))
        return path


def check_mesh_output(out: str | Path, *, overwrite: bool) -> Path:
    """Return the path of a mesh to write; raise where it cannot be written."""
    path = Path(out)
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise ParameterError(f"{path} - is no name of a mesh (got {path.suffix!r}) - end it in .glb or .ply")
    check_outputs([path], overwrite=overwrite)
    return path


def floor_from_track(track: CameraTrack | str | Path) -> FloorMesh:
    """Return the floor below the camera of a track (or of the JSON file of one).

    A plane where the floor is flat, else a relief; beyond the points it runs out into the plane. Its place is that of
    the track: use it with the same `camera.track`, unmoved and unscaled. Raises `ParameterError` where the track has no
    floor.
    """
    seen = floor_points(track)
    plane = _plane(seen)
    normal, offset = plane
    over = seen.point[:, 1] - _on_plane(plane, seen.point[:, 0], seen.point[:, 2])
    x, z = (_middle(seen.point[:, axis]) for axis in (0, 2))
    inside = (
        (seen.point[:, 0] >= x[0])
        & (seen.point[:, 0] <= x[1])
        & (seen.point[:, 2] >= z[0])
        & (seen.point[:, 2] <= z[1])
    )
    cell = max(_FINEST * seen.height_m, max(x[1] - x[0], z[1] - z[0]) / _MOST_NODES)
    relief = np.stack([seen.point[inside, 0], over[inside], seen.point[inside, 2]], axis=1)
    with one_blas_thread():  # many small products
        field = fit_height_field(relief, seen.weight[inside], cell, _LEAST_SPREAD * seen.height_m)
    flat = field.held_out >= _FLAT * field.held_out_flat
    x_m, z_m, height, confidence = _with_skirt(field, flat, seen.height_m)
    at_x, at_z = np.meshgrid(x_m, z_m)
    spread = 1.4826 * float(np.median(np.abs(relief[:, 1]))) if flat else field.spread
    far = float(np.mean(np.abs(relief[:, 1]) > 3.0 * spread if flat else field.kept == 0.0))
    return FloorMesh(
        x_m, z_m, height + _on_plane(plane, at_x, at_z), confidence, flat,
        float(np.degrees(np.arccos(np.clip(normal[1], -1.0, 1.0)))), float(offset / normal[1]), seen.height_m,
        int(np.count_nonzero(inside)), far, spread,
    )  # fmt: skip


def _plane(seen: FloorPoints) -> tuple[Floats, float]:
    """Return normal and offset of the plane that most points lie on, else of the level plane at their median height."""
    up = np.array([0.0, 1.0, 0.0])
    middle = np.median(seen.point, axis=0)
    found = fit_floor(seen.point, middle + seen.height_m * up, up)
    return (found.normal, found.offset) if found is not None else (up, float(middle[1]))


def _on_plane(plane: tuple[Floats, float], x: Floats, z: Floats) -> Floats:
    normal, offset = plane
    return np.asarray((offset - normal[0] * x - normal[2] * z) / normal[1])


def _middle(values: Floats) -> tuple[float, float]:
    low, high = np.quantile(values, [_RIM, 1.0 - _RIM])
    return float(low), float(high)


def _with_skirt(field: ScatteredHeights, flat: bool, height_m: float) -> tuple[Floats, Floats, Floats, Floats]:
    """Return x, z, heights over the plane and confidence, with rings in which the relief runs out."""
    rings = len(_SKIRT)
    out = np.array(_SKIRT) * height_m
    x_m, z_m = (np.concatenate([v[0] - out[::-1], v, v[-1] + out]) for v in (field.x_m, field.z_m))
    relief = np.zeros_like(field.height) if flat else field.height
    height = np.pad(relief, rings, mode="edge")
    ends = np.concatenate([np.zeros(rings - 1), [0.5]])  # half at the first ring, none beyond
    for axis, count in enumerate(field.height.shape):
        fade = np.concatenate([ends, np.ones(count), ends[::-1]])
        height *= fade[:, None] if axis == 0 else fade[None, :]
    return x_m, z_m, height, np.pad(field.confidence, rings)
