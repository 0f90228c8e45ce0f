# SPDX-License-Identifier: Apache-2.0
"""Meshes as the renderers want them: triangles with everything of their corners, in metres.

Corners are not shared between triangles, so flat, creased and smooth surfaces, seams of the texture and several
materials need no special cases. Besides the triangles a mesh carries what is asked of it every frame: its convex hull
(where it is in the frame) and a few surfels (how much ambient light it keeps off a receiver).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.material import Material
from mr360uw.composite.mesh_file import Part, read_parts
from mr360uw.composite.settings import Unit
from mr360uw.errors import MeshError
from mr360uw.types import Floats

_METRES: dict[Unit, float] = {"auto": 1.0, "m": 1.0, "cm": 0.01, "mm": 0.001}
_CREASE_COSINE = 0.5
"""Edges sharper than 60 degrees stay sharp in meshes without normals."""
_LARGE_M = 20.0
_SMALL_M = 0.02
SURFELS = 32


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """Triangles in the object's own axes [m]; arrays are (T, ...) by triangle and (T, 3, ...) by corner.

    positions, normals: (T, 3, 3), normals unit, outwards. uv: (T, 3, 2), right and down from the image's top left.
    colors: (T, 3, 4) linear factor on the base colour. material: (T,) index into `materials`. patch: (T,) number of
    the smooth piece that a triangle belongs to. hull: (h, 3, 3) triangles of the convex hull. surfel_position (s, 3)
    and surfel_area (s, 3): discs of the surface as area vectors; those of closed parts count half, because a line
    through them crosses two. notes: what looked odd, for the user.
    """

    positions: Floats
    normals: Floats
    uv: Floats
    colors: Floats
    material: NDArray[np.int32]
    patch: NDArray[np.int32]
    materials: tuple[Material, ...]
    hull: Floats
    surfel_position: Floats
    surfel_area: Floats
    notes: tuple[str, ...] = ()

    @property
    def extent_m(self) -> Floats:
        """Size of the bounding box (3,)."""
        return np.ptp(self.hull.reshape(-1, 3), axis=0)

    @property
    def center_m(self) -> Floats:
        """Centre of the bounding box (3,)."""
        points = self.hull.reshape(-1, 3)
        return 0.5 * (points.min(axis=0) + points.max(axis=0))

    @property
    def radius_m(self) -> float:
        """Radius about `center_m` that holds every vertex."""
        return float(np.max(np.linalg.norm(self.hull.reshape(-1, 3) - self.center_m, axis=-1)))

    @property
    def glossy(self) -> bool:
        """Whether a material is smoother than diffuse."""
        return any(m.roughness < 0.95 or m.metallic_roughness_map is not None for m in self.materials)


def load_mesh(path: str | Path, unit: Unit = "auto", part: str = "") -> Mesh:
    """Return the mesh of a glTF, GLB, OBJ, PLY or STL file, all its parts placed as the file says.

    unit: of the file; "auto" takes metres and notes sizes that look wrong. part: keep the parts whose name contains it.
    Raises `MeshError` where the file cannot be read, has no triangles, vertices that are not finite, no extent, or
    names a texture that is not there.
    """
    path = Path(path)
    parts, materials = read_parts(path)
    named = [p for p in parts if part in p.name]
    if part and not named:
        names = ", ".join(sorted({p.name for p in parts}))
        raise MeshError(f"{path} - no part of that name (got {part!r}) - there are: {names}")
    return make_mesh(named, materials, where=str(path), scale=_METRES[unit], suspicious=unit == "auto")


def make_mesh(
    parts: list[Part], materials: list[Material], *, where: str = "mesh", scale: float = 1.0, suspicious: bool = False
) -> Mesh:
    """Return the mesh of indexed parts; `scale` metres a unit. Raises `MeshError` as `load_mesh` does."""
    parts = [p for p in parts if len(p.faces)]
    if not parts:
        raise MeshError(f"{where} - has no triangles (got 0) - export the surface as triangles")
    corners = [_corners(p) for p in parts]
    positions, normals, uv, colors = (np.concatenate(arrays) for arrays in zip(*corners, strict=True))
    if not np.all(np.isfinite(positions)):
        bad = int(np.count_nonzero(~np.isfinite(positions).all(axis=(1, 2))))
        raise MeshError(f"{where} - vertices are not finite (got {bad} such triangles) - export the mesh again")
    positions = positions * scale
    extent = np.ptp(positions.reshape(-1, 3), axis=0)
    if np.max(extent) <= 0.0:
        raise MeshError(f"{where} - has no extent (got all vertices in one place) - export it without compression")
    area = 0.5 * np.linalg.norm(np.cross(positions[:, 1] - positions[:, 0], positions[:, 2] - positions[:, 0]), axis=-1)
    keep = area > 1e-14 * np.max(extent) ** 2
    if not np.any(keep):
        raise MeshError(f"{where} - all triangles are degenerate (got {len(area)}) - export the surface again")
    material = np.concatenate([np.full(len(p.faces), p.material, np.int32) for p in parts])[keep]
    piece = np.concatenate([np.full(len(p.faces), k, np.int32) for k, p in enumerate(parts)])[keep]
    positions, normals, uv, colors = positions[keep], normals[keep], uv[keep], colors[keep]
    surfel_position, surfel_area = _surfels(positions, piece)
    return Mesh(
        positions=positions,
        normals=normals,
        uv=uv,
        colors=colors,
        material=material,
        patch=_patches(positions, normals, piece),
        materials=tuple(materials),
        hull=_hull(positions),
        surfel_position=surfel_position,
        surfel_area=surfel_area,
        notes=_size_notes(where, extent) if suspicious else (),
    )


def _size_notes(where: str, extent: Floats) -> tuple[str, ...]:
    longest = float(np.max(extent))
    if longest > _LARGE_M:
        guess = "cm" if longest < 100.0 * _LARGE_M else "mm"
    elif longest < _SMALL_M:
        return (f"{where} - is only {1000 * longest:.3g} mm large - a scale for the object may be missing",)
    else:
        return ()
    return (f"{where} - is {longest:.3g} m long - centimetres or millimetres? then set unit = {guess!r}",)


def _corners(part: Part) -> tuple[Floats, Floats, Floats, Floats]:
    """Return positions, normals, uv, colours of the corners of one part."""
    faces = part.faces
    positions = np.asarray(part.positions, np.float64)[faces]
    if part.normals is None or not np.all(np.isfinite(part.normals)):
        normals = crease_normals(positions) if np.all(np.isfinite(positions)) else np.zeros_like(positions)
    else:
        normals = np.asarray(part.normals, np.float64)[faces]
        length = np.linalg.norm(normals, axis=-1, keepdims=True)
        flat = _face_normals(positions)[:, None, :]
        normals = np.where(length > 1e-6, normals / np.maximum(length, 1e-6), flat)
    uv = np.zeros((*faces.shape, 2)) if part.uv is None else np.asarray(part.uv, np.float64)[faces]
    colors = np.ones((*faces.shape, 4)) if part.colors is None else np.asarray(part.colors, np.float64)[faces]
    return positions, normals, uv, colors


def _face_normals(positions: Floats) -> Floats:
    cross = np.cross(positions[:, 1] - positions[:, 0], positions[:, 2] - positions[:, 0])
    return cross / np.maximum(np.linalg.norm(cross, axis=-1, keepdims=True), 1e-30)


def _welded(points: Floats, resolution: float) -> NDArray[np.int64]:
    """Return the number (n,) of the place that each point (n, k) is at, places being `resolution` apart."""
    grid = np.round(points / resolution).astype(np.int64)
    order = np.lexsort(grid.T)
    different = np.any(np.diff(grid[order], axis=0) != 0, axis=1)
    label = np.empty(len(grid), np.int64)
    label[order] = np.concatenate([[0], np.cumsum(different)])
    return label


def crease_normals(positions: Floats) -> Floats:
    """Return unit corner normals (T, 3, 3): the mean, weighted by corner angle, of the faces about a vertex that
    meet this one at less than 60 degrees (Thuermer & Wuethrich 1998 for the weights).
    """
    face = _face_normals(positions)
    before, after = np.roll(positions, 1, axis=1) - positions, np.roll(positions, -1, axis=1) - positions
    cosine = np.sum(before * after, -1) / np.maximum(
        np.linalg.norm(before, axis=-1) * np.linalg.norm(after, axis=-1), 1e-30
    )
    weight = np.arccos(np.clip(cosine, -1.0, 1.0)).ravel()
    extent = max(float(np.max(np.ptp(positions.reshape(-1, 3), axis=0))), 1e-30)
    vertex = _welded(positions.reshape(-1, 3), 1e-6 * extent)
    order = np.argsort(vertex, kind="stable")
    start = np.searchsorted(vertex[order], np.arange(vertex.max() + 2))
    count = np.diff(start)
    triangle = np.repeat(np.arange(len(positions)), 3)
    total = np.zeros((len(vertex), 3))
    for k in range(int(count.max())):  # the k-th face about every vertex
        has = count[vertex] > k
        other = order[start[vertex[has]] + k]
        n = face[triangle[other]]
        near = np.sum(n * face[triangle[has]], -1) > _CREASE_COSINE
        total[has] += np.where(near, weight[other], 0.0)[:, None] * n
    length = np.linalg.norm(total, axis=-1, keepdims=True)
    total = np.where(length > 1e-12, total / np.maximum(length, 1e-12), face[triangle])
    return total.reshape(positions.shape)


def _patches(positions: Floats, normals: Floats, piece: NDArray[np.int32]) -> NDArray[np.int32]:
    """Number the smooth pieces: triangles are of one piece where they share a corner's place and normal."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    extent = float(np.max(np.ptp(positions.reshape(-1, 3), axis=0)))
    key = np.concatenate(
        [
            positions.reshape(-1, 3) / (1e-6 * extent),
            normals.reshape(-1, 3) / 0.01,
            np.repeat(piece, 3)[:, None].astype(np.float64),
        ],
        axis=1,
    )
    corner = _welded(key, 1.0)
    count = len(positions)
    graph = coo_matrix(
        (np.ones(len(corner), np.int8), (np.repeat(np.arange(count), 3), count + corner)),
        shape=(count + corner.max() + 1,) * 2,
    )
    labels = connected_components(graph, directed=False)[1][:count]
    return np.unique(labels, return_inverse=True)[1].astype(np.int32)


def _hull(positions: Floats) -> Floats:
    """Return the triangles of the convex hull, or of the bounding box where the mesh is flat."""
    from scipy.spatial import ConvexHull, QhullError

    points = positions.reshape(-1, 3)
    try:
        hull = ConvexHull(points)
        return points[hull.simplices]
    except QhullError:
        low, high = points.min(axis=0), points.max(axis=0)
        box = np.stack(np.meshgrid(*zip(low, high, strict=True), indexing="ij"), axis=-1).reshape(8, 3)
        sides = [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]
        return box[[t for a, b, c, d in sides for t in ((a, b, c), (a, c, d))]]


def _surfels(positions: Floats, piece: NDArray[np.int32]) -> tuple[Floats, Floats]:
    """Return at most `SURFELS` discs (position, area vector): halves of equal area along the longest axis, again and
    again, over place and facing.
    """
    vector = 0.5 * np.cross(positions[:, 1] - positions[:, 0], positions[:, 2] - positions[:, 0])
    area = np.linalg.norm(vector, axis=-1)
    center = positions.mean(axis=1)
    weight = np.empty(len(area))
    for k in np.unique(piece):
        of = piece == k
        closed = np.linalg.norm(vector[of].sum(axis=0)) < 0.2 * area[of].sum()
        weight[of] = 0.5 if closed else 1.0
    extent = float(np.max(np.ptp(center, axis=0))) or 1.0
    feature = np.concatenate([center / extent, 0.5 * vector / area[:, None]], axis=1)
    clusters = [np.arange(len(area))]
    while len(clusters) < SURFELS:
        halves = []
        for cluster in clusters:
            axis = int(np.argmax(np.ptp(feature[cluster], axis=0)))
            order = cluster[np.argsort(feature[cluster, axis], kind="stable")]
            cut = int(np.searchsorted(np.cumsum(area[order]), 0.5 * area[order].sum()))
            halves += [part for part in (order[: cut + 1], order[cut + 1 :]) if len(part)]
        if len(halves) == len(clusters):
            break
        clusters = halves
    place = np.stack([np.average(center[c], axis=0, weights=area[c]) for c in clusters])
    total = np.array([np.sum(weight[c] * area[c]) for c in clusters])
    facing = np.stack([vector[c].sum(axis=0) for c in clusters])
    facing = facing / np.maximum(np.linalg.norm(facing, axis=-1, keepdims=True), 1e-30)
    return place, facing * total[:, None]
