# SPDX-License-Identifier: Apache-2.0
"""The floor of a clip as a mesh, from the points of its camera track that lie below the camera and can be trusted."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import NdBSpline, RegularGridInterpolator
from scipy.linalg import solveh_banded
from scipy.ndimage import gaussian_filter
from scipy.sparse import diags, identity, kron, triu
from scipy.spatial import cKDTree

from mr360uw.base.files import check_outputs, write_whole
from mr360uw.base.input_files import json_of, read_text
from mr360uw.base.parameters import checked
from mr360uw.base.progress import one_blas_thread
from mr360uw.errors import ParameterError
from mr360uw.track.camera_track import CameraTrack, fit_floor
from mr360uw.types import Floats

_DEPRESSION = np.sin(np.radians(12.0))
"""Sine of the angle below a camera's horizon under which points are the floor's. Half of it: 9 camera heights away,
where a pixel spans half a metre of floor; twice: a third of the floor that is used now."""
_LARGEST_ERROR_PX = 2.0
"""Mean reprojection error [px] from which on a point is left out: it moved, or was matched wrongly."""
_LEAST_POINTS = 30
"""Fewest points of a floor."""


def _floor_points(track: CameraTrack | str | Path) -> tuple[Floats, Floats, float]:
    """Return the points (n, 3) [m] of a track, or of its JSON file, that may lie on the floor; raise `ParameterError`.

    With them the inverse variances (n,) of their heights, 1 straight below the camera, and the median height [m] of the
    nearest camera over a point.
    """
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
    if np.count_nonzero(below) < _LEAST_POINTS:
        raise ParameterError(
            f"{where} - too few points are below the camera (got {np.count_nonzero(below)}, at least {_LEAST_POINTS} "
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


_MESH_SUFFIXES = (".glb", ".ply")
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
    if path.suffix.lower() not in _MESH_SUFFIXES:
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


# Robust height field through scattered points: a smoothing spline on a grid, without outliers.
#
# Minimises sum w_i (h(x_i, z_i) - y_i)^2 + lambda |second differences of h|^2 + a weak pull to 0, with h bilinear
# between nodes (thin-plate energy on a grid; Terzopoulos 1988). The weights are Tukey's biweight of the residuals,
# found by iteration (Holland & Welsch 1977) from a stiff sheet to a soft one. Cross-validation chooses lambda.

_STIFFNESS = (1000.0, 100.0, 30.0, 10.0, 3.0, 1.0, 0.3, 0.1)
"""Weights of the second differences that are tried, per mean weight of a point, from stiff to soft."""
_ROUNDS = 2
"""Iterations of the weights at each stiffness, which start from those before; four change heights by a few per cent of
their error."""
_TUKEY = 4.685
"""Residual over the spread from which on a point counts nothing: 95 % efficiency for normal errors."""
_PULL = 1e-3
"""Weight of the pull to 0, over that of the second differences at a stiffness of 1: holes relax over some six cells."""
_FOLDS, _SEED = 5, 1
_SUPPORT = 1.0
"""Weighted points about a node at which its confidence is 1 - 1/e. Twice as large: half the floor counts as guessed."""


@dataclass(frozen=True, slots=True, eq=False)
class ScatteredHeights:
    """Heights (r, c) at nodes z_m (r,), x_m (c,), with confidence (r, c) in [0, 1].

    kept (n,): weight of each point, 0 for outliers. held_out, held_out_flat: median absolute residuals of points that
    were left out of the fit, about the sheet and about 0. spread: standard deviation about the sheet, by the median.
    """

    x_m: Floats
    z_m: Floats
    height: Floats
    confidence: Floats
    kept: Floats
    held_out: float
    held_out_flat: float
    spread: float


def fit_height_field(points: Floats, weight: Floats, cell_m: float, least_spread: float) -> ScatteredHeights:
    """Return the height field of points (n, 3): y over (x, z), as metres or any other unit.

    weight (n,): inverse variances, relative. cell_m: spacing of the nodes. least_spread: floor of the points' spread,
    below which nothing counts as an outlier.
    """
    x, y, z = points.T
    x_m, z_m = (np.arange(v.min() - cell_m, v.max() + 2.0 * cell_m, cell_m) for v in (x, z))
    at = _bilinear(x_m, z_m, x, z)
    bend = _bending(len(z_m), len(x_m))
    weight = weight / weight.mean()
    fold = np.random.default_rng(_SEED).permutation(len(y)) % _FOLDS
    sheet = _Sheets(at, bend, y, weight, least_spread)
    apart = _Sheets(at[fold > 0], bend, y[fold > 0], weight[fold > 0], least_spread)
    best = (np.inf, _STIFFNESS[0])
    for stiffness in _STIFFNESS:
        error = float(np.median(np.abs(at[fold == 0] @ apart.relaxed(stiffness) - y[fold == 0])))
        if error > 1.1 * best[0]:
            break
        best = min(best, (error, stiffness))
    for stiffness in _STIFFNESS[: _STIFFNESS.index(best[1]) + 1]:
        height = sheet.relaxed(stiffness)
    confidence = 1.0 - np.exp(-_support(at, sheet.robust * np.minimum(weight, 1.0), (len(z_m), len(x_m))) / _SUPPORT)
    return ScatteredHeights(
        x_m, z_m, height.reshape(len(z_m), len(x_m)), confidence, sheet.robust, best[0],
        float(np.median(np.abs(y[fold == 0]))), sheet.spread,
    )  # fmt: skip


class _Sheets:
    """The sheet through one set of points, made softer step by step: each fit starts from the weights of the last."""

    def __init__(self, at: Any, bend: Any, y: Floats, weight: Floats, least_spread: float) -> None:
        self._at, self._bend, self._y, self._weight = at, bend, y, weight
        self._least = least_spread
        self.robust = np.ones(len(y))
        self.spread = float(np.inf)

    def relaxed(self, stiffness: float) -> Floats:
        """Return the heights of the nodes, flat, at a stiffness."""
        height = np.zeros(self._at.shape[1])
        smooth = stiffness * self._bend + _PULL * min(stiffness, 1.0) * identity(len(height))
        for _ in range(_ROUNDS):
            data = self._at.T.multiply(self.robust * self._weight).tocsr()
            height = _solved(data @ self._at + smooth, data @ self._y)
            residual = (self._at @ height - self._y) * np.sqrt(np.minimum(self._weight, 1.0))
            self.spread = max(1.4826 * float(np.median(np.abs(residual))), self._least)
            far = np.minimum(np.abs(residual) / (_TUKEY * self.spread), 1.0)
            self.robust = np.square(1.0 - np.square(far))
        return np.asarray(height)


def _solved(matrix: Any, right: Floats) -> Floats:
    """Return the solution of a banded symmetric positive definite system."""
    upper = triu(matrix).todia()
    bands = np.zeros((int(upper.offsets.max()) + 1, len(right)))
    bands[-1 - upper.offsets] = upper.data
    return np.asarray(solveh_banded(bands, right, overwrite_ab=True, check_finite=False))


def _bilinear(x_m: Floats, z_m: Floats, x: Floats, z: Floats) -> Any:
    """Return the sparse matrix (n, r c) of bilinear interpolation at points inside of the grid."""
    knots = tuple(np.pad(nodes, 1, mode="edge") for nodes in (z_m, x_m))
    at: Any = NdBSpline.design_matrix(np.stack([z, x], axis=1), knots, 1)
    at.resize(len(x), len(x_m) * len(z_m))  # it leaves out the last nodes where no point is near them
    return at


def _bending(rows: int, columns: int) -> Any:
    """Return the matrix (r c, r c) of the thin-plate energy: h_xx^2 + 2 h_xz^2 + h_zz^2 in units of cells."""

    def difference(n: int, *taps: float) -> Any:
        return diags(taps, range(len(taps)), shape=(n - len(taps) + 1, n))

    second, first = (1.0, -2.0, 1.0), (-1.0, 1.0)
    across = kron(identity(rows), difference(columns, *second))
    along = kron(difference(rows, *second), identity(columns))
    twist = kron(difference(rows, *first), difference(columns, *first))
    return (across.T @ across + along.T @ along + 2.0 * twist.T @ twist).tocsr()


def _support(at: Any, weight: Floats, shape: tuple[int, int]) -> Floats:
    """Return the weighted number of points about each node, (r, c): Gaussian of one cell, 1 in the middle."""
    return np.asarray(2.0 * np.pi * gaussian_filter((at.T @ weight).reshape(shape), 1.0, mode="constant"))
