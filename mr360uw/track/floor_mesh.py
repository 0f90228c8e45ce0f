# SPDX-License-Identifier: Apache-2.0
"""The floor of a clip as a mesh, from the points of its camera track that lie below the camera and can be trusted."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.errors import ParameterError
from mr360uw.files import write_whole
from mr360uw.output_gate import check_outputs
from mr360uw.reading.input_files import json_of, read_text
from mr360uw.shapes import checked
from mr360uw.threads import one_blas_thread
from mr360uw.track.camera_track import CameraTrack
from mr360uw.track.scattered_heights import ScatteredHeights, fit_height_field
from mr360uw.track.world_axes import fit_floor
from mr360uw.types import Floats

_DEPRESSION = np.sin(np.radians(12.0))
"""Sine of the angle below a camera's horizon under which points are the floor's. Half of it: 9 camera heights away,
where a pixel spans half a metre of floor; twice: a third of the floor that is used now."""
_LARGEST_ERROR_PX = 2.0
"""Mean reprojection error [px] from which on a point is left out: it moved, or was matched wrongly."""
LEAST_POINTS = 30
"""Fewest points of a floor."""


def _floor_points(track: CameraTrack | str | Path) -> tuple[Floats, Floats, float]:
    """Return the points (n, 3) [m] of a track, or of its JSON file, that may lie on the floor; raise `ParameterError`.

    With them the inverse variances (n,) of their heights, 1 straight below the camera, and the median height [m] of the
    nearest camera over a point.
    """
    from scipy.spatial import cKDTree

    where, camera, point, error_px = _read(track)
    if not len(point):
        raise ParameterError(
            f"{where} - has no points (a camera that turns on the spot or stands still sees no distances) - give a "
            'track of a camera that moves, or set [receiver] kind = "plane" and its height_m'
        )
    keep = np.isfinite(point).all(axis=1) & (error_px <= _LARGEST_ERROR_PX)
    kept = point[keep]
    away = kept - camera[cKDTree(camera).query(kept)[1]] if len(kept) else kept
    distance = np.maximum(np.linalg.norm(away, axis=1), 1e-9)
    below = away[:, 1] < -_DEPRESSION * distance
    if not np.any(below):
        raise ParameterError(
            f"{where} - no point is below the camera (got {len(point)} points, all level or above) - is the track "
            "upside down, or does the clip show no floor? Set [receiver] height_m by hand"
        )
    if np.count_nonzero(below) < LEAST_POINTS:
        raise ParameterError(
            f"{where} - too few points are below the camera (got {np.count_nonzero(below)}, at least {LEAST_POINTS} "
            "are needed) - track a clip that shows more of the floor, or set [receiver] height_m by hand"
        )
    height = -away[below, 1]
    # a pixel along the ray at distance d and height h: d^2 / h on the floor, of which the height takes h / d
    weight = np.square(height / distance[below]) / np.square(np.maximum(distance[below] / np.median(height), 1.0))
    return kept[below], weight, float(np.median(height))


def _read(track: CameraTrack | str | Path) -> tuple[str, Floats, Floats, Floats]:
    """Return a name, camera positions (m, 3), points (n, 3) and their errors [px]."""
    if isinstance(track, CameraTrack):
        return "track", track.position, track.points, track.point_error_px
    path = Path(track)
    if path.suffix.lower() == ".csv":
        raise ParameterError(f"{path} - a table of poses has no points - give the .json that is written beside it")
    text = read_text(path, ParameterError)
    try:
        said = json_of(text)
    except ValueError as error:
        raise ParameterError(_no_track(path, f"{error!s:.60}")) from None
    if not isinstance(said, dict) or not str(said.get("format", "")).startswith("mr360uw camera track"):
        raise ParameterError(_no_track(path, "no such format"))
    camera, point = (_table(path, said, key, 3) for key in ("position_m", "points_m"))
    error_px = _table(path, said, "point_error_px", 0)
    if not len(camera) or len(error_px) != len(point) or not np.isfinite(camera).all():
        raise ParameterError(_no_track(path, f"{len(camera)} poses, {len(point)} points, {len(error_px)} errors"))
    return str(path), camera, point, error_px


def _table(path: Path, said: dict[str, Any], key: str, columns: int) -> Floats:
    """Return a list of numbers (n,) or of rows (n, columns)."""
    try:
        values = np.array(said[key], np.float64)
    except (KeyError, ValueError, TypeError):
        raise ParameterError(_no_track(path, f"no numbers at {key!r}")) from None
    shape = (0, columns) if columns else (0,)
    if not values.size:
        return np.zeros(shape)
    if values.ndim != len(shape) or (columns and values.shape[1] != columns):
        raise ParameterError(_no_track(path, f"{key} of shape {values.shape}"))
    return values


def _no_track(path: Path, got: str) -> str:
    return f"{path} - is no camera track (got {got}) - give the track.json that `mr360uw track` writes"


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


@checked
def floor_from_track(track: CameraTrack | str | Path) -> FloorMesh:
    """Return the floor below the camera of a track (or of the JSON file of one).

    A plane where the floor is flat, else a relief; beyond the points it runs out into the plane. Its place is that of
    the track: use it with the same `camera.track`, unmoved and unscaled. Raises `ParameterError` where the track has no
    floor.
    """
    point, weight, camera_m = _floor_points(track)
    plane = normal, offset = _plane(point, camera_m)
    over = point[:, 1] - _on_plane(plane, point[:, 0], point[:, 2])
    x, z = (np.quantile(point[:, axis], [_RIM, 1.0 - _RIM]).tolist() for axis in (0, 2))
    inside = (point[:, 0] >= x[0]) & (point[:, 0] <= x[1]) & (point[:, 2] >= z[0]) & (point[:, 2] <= z[1])
    cell = max(_FINEST * camera_m, max(x[1] - x[0], z[1] - z[0]) / _MOST_NODES)
    relief = np.stack([point[inside, 0], over[inside], point[inside, 2]], axis=1)
    with one_blas_thread():  # many small products
        field = fit_height_field(relief, weight[inside], cell, _LEAST_SPREAD * camera_m)
    flat = field.held_out >= _FLAT * field.held_out_flat
    x_m, z_m, height, confidence = _with_skirt(field, flat, camera_m)
    at_x, at_z = np.meshgrid(x_m, z_m)
    spread = 1.4826 * float(np.median(np.abs(relief[:, 1]))) if flat else field.spread
    far = float(np.mean(np.abs(relief[:, 1]) > 3.0 * spread if flat else field.kept == 0.0))
    return FloorMesh(
        x_m, z_m, height + _on_plane(plane, at_x, at_z), confidence, flat,
        float(np.degrees(np.arccos(np.clip(normal[1], -1.0, 1.0)))), float(offset / normal[1]), camera_m,
        int(np.count_nonzero(inside)), far, spread,
    )  # fmt: skip


def _plane(point: Floats, camera_m: float) -> tuple[Floats, float]:
    """Return normal and offset of the plane that most points lie on, else of the level plane at their median height."""
    up = np.array([0.0, 1.0, 0.0])
    middle = np.median(point, axis=0)
    found = fit_floor(point, middle + camera_m * up, up)
    return found[:2] if found is not None else (up, float(middle[1]))


def _on_plane(plane: tuple[Floats, float], x: Floats, z: Floats) -> Floats:
    normal, offset = plane
    return np.asarray((offset - normal[0] * x - normal[2] * z) / normal[1])


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
