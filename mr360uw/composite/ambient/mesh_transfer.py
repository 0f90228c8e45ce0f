# SPDX-License-Identifier: Apache-2.0
"""Precomputed ambient transfer of a mesh: which of a set of fixed directions its own surface blocks at its samples, and
by which sample (after Sloan et al. 2002; here as a sparse list instead of spherical harmonics, so that bounces are
solved after the lights are known).

*Points* are what shading reads: the vertices, and on triangles that are large for the mesh a barycentric lattice.
*Samples* are where rays start: the points with those of equal place and normal joined, or of dense meshes a sample of
them, from which a point takes a weighted mean. A lattice of n steps lists its points by rows: place (i, j), with i
steps towards the second corner and j towards the third, has the number i (2 n + 3 - i)/2 + j.

*Coarse samples* are those of the samples at which a mesh sees other bodies and the ground, and exchanges light with
them. Light that comes from other bodies changes slowly over a surface, so a few hundred samples, chosen one after the
other as the farthest from those before (Gonzalez 1985), stand for all; the others interpolate between them by moving
least squares (Levin 1998).
"""

from __future__ import annotations

import functools
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.cache import PartOf, Same
from mr360uw.base.disk_cache import Arrays, kept_arrays
from mr360uw.base.rays import triple
from mr360uw.base.sphere import unit
from mr360uw.composite.mesh.material import Material
from mr360uw.composite.mesh.mesh import Mesh
from mr360uw.composite.mesh.polygons import welded
from mr360uw.composite.raycast import Geometry, base_color, gather, opacity_key, surfaces_along
from mr360uw.composite.shading import dielectric_f0, reflectance
from mr360uw.composite.shot import PlacedObject
from mr360uw.ibl.filters import split_sum
from mr360uw.jit import exact, exact_making, inlined
from mr360uw.types import Environment, Floats

_STEPS_ACROSS = 24.0
"""A lattice edge is at most this part (1/n) of the mesh's longest side, unless that makes more samples than wanted."""
_WANTED_SAMPLES = 3000
"""Samples that a mesh gets at most, about: each costs 256 rays once and 2 kB."""
_LONGEST = 1.3
"""The longest edge of a lattice's triangles may be this many spacings: halves of squares have legs of one."""
_MOST_STEPS = 64
_INSET = 0.1
"""Samples move towards the middle of their triangles by this part of the way: rays from an edge do not start within the
wall that meets it there."""
_LIFT = 3e-4
"""Distance of samples off their surface as a part of the longest side."""
_NEAREST, _STAND_INS = 8, 4
_SPACING = 0.09
"""Every sample has a coarse sample nearer than this part of the longest side, a sixth of a ball's radius, unless that
makes more coarse samples than `_MOST`."""
_MOST = 600
_TURN = 4.0
"""A normal that turns by one radian counts as so many spacings of distance."""
_NEIGHBOURS = 8
_SHARP = 0.2
"""Part of the distance between neighbours within which a sample takes the value of a coarse sample itself."""
_STRAIGHT = 1e-4
"""Weight of the slope's penalty: coarse samples in a row do not fix the slope across it."""
CHANNELS = 12
"""Values of a point: ratio of irradiance (3), 0; ratio of glossy light that is kept (3), 0; radiance that is reflected
besides (3), 0."""
FEW_CHANNELS = 4
"""Values of a point that reflects nothing besides and keeps the same ratio of all light: that ratio (3), 0. Twice, and
as many zeros, they are those of `CHANNELS`."""
UNTOUCHED = (1.0, 1.0, 1.0, 0.0, 1.0, 1.0, 1.0, *[0.0] * (CHANNELS - 7))
"""Values where nothing is in the way."""


@dataclass(frozen=True, slots=True, eq=False)
class Lattice:
    """Points and samples of a mesh, in its own axes [m].

    places: (T, 4) for every triangle three points and 1, or the first point of its lattice, two zeros and the number of
    steps. points: their number on the front; as many again follow for the back where `two_sided`. position, normal:
    (S, 3) of the samples. triangle: (S,) one that holds it, weights:
    (S, 3) where. nearest_sample: (K,) the sample nearest to each point. from_samples: (K, S) sparse, rows of sum 1.
    """

    places: NDArray[np.int64]
    points: int
    two_sided: bool
    position: Floats
    normal: Floats
    triangle: NDArray[np.int64]
    weights: Floats
    nearest_sample: NDArray[np.int64]
    from_samples: Any


def make_lattice(mesh: Mesh) -> Lattice:
    """Return the points and samples of a mesh."""
    from scipy.sparse import block_diag, csr_matrix

    # Choose the spacing of samples: so many over the whole surface, on both sides of sheets
    corners = mesh.positions
    extent = float(np.max(mesh.extent_m))
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=-1)
    two_sided = any(m.double_sided for m in mesh.materials) and _is_open(corners)
    sides = 2 if two_sided else 1
    even = float(np.sqrt(area.sum() * sides / _WANTED_SAMPLES))
    spacing = max(extent / _STEPS_ACROSS, even)
    # Spread points over the triangles, and join those that lie together
    edge = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1).max(axis=1)
    steps = np.clip(np.ceil(edge / (_LONGEST * spacing)), 1, _MOST_STEPS).astype(np.int64)
    triangle, weights, first = _spread(steps)
    position, normal = (np.einsum("nc,nck->nk", weights, a[triangle]) for a in (corners, mesh.normals))
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
    joined = _joined(position, normal, extent)
    count = int(joined.max()) + 1
    one = np.empty(count, np.int64)
    one[joined[::-1]] = np.arange(len(joined))[::-1]
    # Keep a sample of each place, or, of too many, of each neighbourhood
    inwards = _inwards(corners[triangle].mean(axis=1) - position, joined, normal[one], spacing)
    kept, mixed = np.arange(count), None
    if count * sides > 1.6 * _WANTED_SAMPLES:
        kept, mixed = _sampled(position[one], normal[one], even)
    places, sample_of = _numbered(steps, first, joined)
    one_each = np.ones(len(sample_of)), sample_of, np.arange(len(sample_of) + 1)
    from_samples = csr_matrix(one_each, shape=(len(sample_of), count)) if mixed is None else mixed[sample_of]
    # Lift them off the surface, on the other side too where that is seen
    facing, at = normal[one][kept], (position[one] + inwards)[kept]
    turned = [facing, -facing][:sides]
    nearest = np.asarray(from_samples.argmax(axis=1)).ravel()
    return Lattice(
        places=places,
        points=len(sample_of),
        two_sided=two_sided,
        position=np.concatenate([at + _LIFT * extent * n for n in turned]),
        normal=np.concatenate(turned),
        triangle=np.tile(triangle[one][kept], sides),
        weights=np.tile(weights[one][kept], (sides, 1)),
        nearest_sample=np.concatenate([nearest + k * len(kept) for k in range(sides)]),
        from_samples=block_diag([from_samples] * sides, format="csr") if two_sided else from_samples,
    )


def _spread(steps: NDArray[np.int64]) -> tuple[NDArray[np.int64], Floats, NDArray[np.int64]]:
    """Return triangle (m,) and weights (m, 3) of all lattice points, and the first point (T,) of each triangle."""
    triangles, weights = [np.zeros(0, np.int64)], [np.zeros((0, 3))]
    first, begun = np.zeros(len(steps), np.int64), 0
    for n in np.unique(steps)[::-1].tolist():  # triangles without a lattice come last
        of = np.flatnonzero(steps == n)
        i, j = np.nonzero(np.add.outer(np.arange(n + 1), np.arange(n + 1)) <= n)
        triangles.append(np.repeat(of, len(i)))
        weights.append(np.tile(np.stack([n - i - j, i, j], axis=-1) / n, (len(of), 1)))
        first[of] = begun + len(i) * np.arange(len(of))
        begun += len(i) * len(of)
    return np.concatenate(triangles), np.concatenate(weights), first


def _numbered(
    steps: NDArray[np.int64], first: NDArray[np.int64], joined: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the places (T, 4) of triangles and the joined point (K,) that each point is.

    Those of lattices are their own; the corners of the other triangles share the joined points.
    """
    plain = steps == 1
    own = int(first[plain].min()) if np.any(plain) else len(joined)
    corner, of_corner = np.unique(joined[own:], return_inverse=True)
    places = np.stack([first, np.zeros_like(first), np.zeros_like(first), steps], axis=-1)
    # the points of one step stand in the order (0, 0), (0, 1), (1, 0): first, third, second corner
    for column, point in enumerate((0, 2, 1)):
        places[plain, column] = own + of_corner[first[plain] + point - own]
    return places, np.concatenate([joined[:own], corner])


def _inwards(towards: Floats, joined: NDArray[np.int64], normal: Floats, spacing: float) -> Floats:
    """Return how far (c, 3) joined points move along their surface towards the middle of the triangles about them."""
    count = len(normal)
    shift: Floats = np.stack([np.bincount(joined, towards[:, k], count) for k in range(3)], axis=-1)
    shift = np.asarray(shift) / np.bincount(joined, minlength=count)[:, None]
    shift -= normal * np.sum(normal * shift, axis=-1, keepdims=True)
    return _INSET * shift * np.minimum(1.0, spacing / np.maximum(np.linalg.norm(shift, axis=-1, keepdims=True), 1e-12))


def _joined(position: Floats, normal: Floats, extent: float) -> NDArray[np.int64]:
    """Return numbers (m,) of points, the same for those of one place and normal."""
    place = np.round(position / (1e-5 * extent)).astype(np.int64)
    facing = np.round(normal / 0.05).astype(np.int64)
    key = np.concatenate([place, facing], axis=1)
    return np.asarray(np.unique(_hashed(key), return_inverse=True)[1])


def _hashed(key: NDArray[np.int64]) -> NDArray[np.uint64]:
    """Return one integer (m,) for each row of integers."""
    mixed = np.zeros(len(key), np.uint64)
    for column in key.T.astype(np.uint64):
        mixed = (mixed ^ column) * np.uint64(0x9E3779B97F4A7C15)
        mixed ^= mixed >> np.uint64(29)
    return mixed


def _sampled(position: Floats, normal: Floats, spacing: float) -> tuple[NDArray[np.int64], Any]:
    """Return which points (s,) of a dense mesh stand for all, and how all take means of them (c, s), sparse."""
    cell = np.concatenate([np.floor(position / spacing), np.round(normal)], axis=1).astype(np.int64)
    label = np.unique(_hashed(cell), return_inverse=True)[1]
    count = np.bincount(label)
    middle = np.stack([np.bincount(label, position[:, k]) for k in range(3)], axis=-1) / count[:, None]
    off = np.sum((position - middle[label]) ** 2, axis=-1)
    order = np.lexsort((off, label))
    kept = order[np.flatnonzero(np.diff(label[order], prepend=-1))]
    feature = np.append(position, spacing * normal, axis=1)
    distance, at = _nearest(feature, feature[kept], _NEAREST)
    weight = np.exp(-((distance / spacing) ** 2))
    weight[:, 0] += 1e-9
    weight /= weight.sum(axis=1, keepdims=True)
    return kept, _means(weight, at, len(kept))


def _nearest(feature: Floats, among: Floats, count: int) -> tuple[Floats, NDArray[np.int64]]:
    """Return for points (n, k) distances and numbers (n, `count`) of the nearest of others (m, k), all if they are
    fewer.
    """
    from scipy.spatial import cKDTree

    count = min(count, len(among))
    distance, number = (np.reshape(a, (-1, count)) for a in cKDTree(among).query(feature, count))
    return distance, number


def _means(weight: Floats, number: NDArray[np.int64], count: int) -> Any:
    """Return the sparse matrix (n, `count`) with weights (n, k) of the columns of some numbers (n, k)."""
    from scipy.sparse import csr_matrix

    rows = np.repeat(np.arange(len(weight)), weight.shape[1])
    return csr_matrix((weight.ravel(), (rows, number.ravel())), shape=(len(weight), count))


def stand_ins(lattice: Lattice, without: NDArray[np.bool_]) -> tuple[NDArray[np.int64], Any]:
    """Return for samples (S,), of which some have no light of their own, the nearest that has, and their means (S,
    S)."""
    from scipy.sparse import csr_matrix

    good, bad = np.flatnonzero(~without), np.flatnonzero(without)
    size = float(np.ptp(lattice.position, axis=0).max())
    feature = np.append(lattice.position, size * lattice.normal, axis=1)
    distance, at = _nearest(feature[bad], feature[good], _STAND_INS)
    weight = 1.0 / (distance**4 + (1e-3 * size) ** 4)
    weight /= weight.sum(axis=1, keepdims=True)
    rows = np.concatenate([good, np.repeat(bad, at.shape[1])])
    columns = np.concatenate([good, good[at].ravel()])
    count = len(without)
    nearest = np.arange(count)
    nearest[bad] = good[at[:, 0]]
    values = np.concatenate([np.ones(len(good)), weight.ravel()])
    return nearest, csr_matrix((values, (rows, columns)), shape=(count, count))


def _is_open(corners: Floats) -> bool:
    """Return whether more than a hundredth of the edges of triangles (T, 3, 3) belong to one triangle alone."""
    vertex = welded(corners).reshape(-1, 3)
    ends = np.stack([vertex, np.roll(vertex, -1, axis=1)], axis=-1).reshape(-1, 2)
    key = ends.min(axis=1) * (int(vertex.max()) + 1) + ends.max(axis=1)
    return bool(np.mean(np.unique(key, return_counts=True)[1] == 1) > 0.01)


def points_at(places: NDArray[np.int64], weights: Floats) -> tuple[NDArray[np.int64], Floats]:
    """Return three points (n, 3) and their shares (n, 3) at weights (n, 3) in triangles with places (n, 4)."""
    points, shares = np.empty((len(places), 3), np.int64), np.empty((len(places), 3))
    find_three(places, np.asarray(weights, np.float64), points, shares)
    return points, shares


def choose_coarse(lattice: Lattice, size_m: float, seen: NDArray[np.bool_]) -> dict[str, Any]:
    """Return coarse, nearest_coarse, spread and spacing_m of `Transfer` by their names, for a lattice on a mesh of a
    longest side `size_m`. Coarse samples are among those that are `seen` (S,).
    """
    spacing = _SPACING * size_m
    feature = np.append(lattice.position, _TURN * spacing * lattice.normal, axis=1)
    candidates = np.flatnonzero(seen)
    chosen, spacing = _farthest(feature[candidates].astype(np.float32), spacing)
    sample = np.sort(candidates[chosen])
    distance, at = _nearest(feature, feature[sample], _NEIGHBOURS)
    spread = _means(_least_squares(lattice, sample[at], distance).astype(np.float32), at, len(sample))
    return {"coarse": sample, "nearest_coarse": at[:, 0].astype(np.int64), "spread": spread, "spacing_m": spacing}


def _farthest(feature: NDArray[np.float32], spacing: float) -> tuple[NDArray[np.int64], float]:
    """Return numbers of points (n, 6), each the farthest from those before, and how far all are from one at most."""
    chosen = [0]
    squared = np.sum((feature - feature[0]) ** 2, axis=-1)
    while len(chosen) < min(_MOST, len(feature)):
        farthest = int(np.argmax(squared))
        if squared[farthest] <= spacing * spacing:
            break
        chosen.append(farthest)
        np.minimum(squared, np.sum((feature - feature[farthest]) ** 2, axis=-1), out=squared)
    return np.array(chosen, np.int64), max(float(np.sqrt(squared.max())), spacing)


def _least_squares(lattice: Lattice, neighbours: NDArray[np.int64], distance: Floats) -> Floats:
    """Return weights (S, n) of neighbours at distances (S, n): those of a plane fitted along the surface."""
    normal = lattice.normal
    aside = np.eye(3)[np.argmin(np.abs(normal), axis=1)]
    u = np.cross(normal, aside)
    u /= np.linalg.norm(u, axis=-1, keepdims=True)
    v = np.cross(normal, u)
    reach = np.maximum(distance[:, -1:], 1e-12)
    off = (lattice.position[neighbours] - lattice.position[:, None]) / reach[..., None]
    terms = np.stack([np.ones_like(distance), np.sum(off * u[:, None], -1), np.sum(off * v[:, None], -1)], axis=-1)
    relative = distance / reach
    near = np.maximum(1.0 - relative, 1e-3) ** 2 / (relative**2 + _SHARP**2) ** 2
    moments = np.einsum("sn,sni,snj->sij", near, terms, terms)
    moments[:, [1, 2], [1, 2]] += _STRAIGHT * near.sum(axis=1)[:, None]
    first = np.linalg.solve(moments, np.broadcast_to(np.eye(3)[:, :1], (len(near), 3, 1)))[..., 0]
    return np.asarray(near * np.einsum("sni,si->sn", terms, first))


@inlined
def _row(steps: Any, i: Any) -> Any:
    return i * (2 * steps + 3 - i) // 2


@inlined
def _three(place: Any, w0: Any, w1: Any, w2: Any) -> Any:
    """Return three points and their shares at barycentric weights of a triangle with a place (4,).

    Twin: ambient.glsl.
    """
    steps = place[3]
    w0, w1, w2 = max(w0, 0.0), max(w1, 0.0), max(w2, 0.0)
    total = max(w0 + w1 + w2, 1e-12)
    x, y = w1 / total * steps, w2 / total * steps
    i = min(int(x), steps - 1)
    j = min(int(y), steps - 1 - i)
    u, v = x - i, y - j
    upper = u + v > 1.0 and i + j < steps - 1
    row, below = _row(steps, i), _row(steps, i + 1)
    first = place[0] + (below + j + 1 if upper else row + j)
    second, third = place[0] + below + j, place[0] + row + j + 1
    if steps == 1:
        first, second, third = place[0], place[1], place[2]
    rest = u + v - 1.0 if upper else 1.0 - u - v
    return first, second, third, rest, 1.0 - v if upper else u, 1.0 - u if upper else v


@exact
def find_three(places: Any, weights: Any, points: Any, shares: Any) -> None:
    """Set points (n, 3) and shares (n, 3) at barycentric weights (n, 3) of triangles with places (n, 4)."""
    for n in range(len(places)):
        a, b, c, u, v, w = _three(places[n], weights[n, 0], weights[n, 1], weights[n, 2])
        points[n, 0], points[n, 1], points[n, 2] = a, b, c
        shares[n, 0], shares[n, 1], shares[n, 2] = u, v, w


@exact_making
def find_nearest_points(
    triangles: Any, met: Any, origin: Any, direction: Any, places: Any, point: Any, distance: Any, behind: Any,
) -> None:  # fmt: skip
    """Set the nearest point and the distance of rays (n,) that meet triangles of a scene (T, 3, 3), and if they meet
    the back. met: (n,) numbers of the triangles.
    """
    a, b, c = origin[0].copy(), origin[0].copy(), origin[0].copy()
    for n in range(len(met)):
        d = direction[n]
        for k in range(3):
            a[k] = triangles[met[n], 0, k] - origin[n, k]
            b[k] = triangles[met[n], 1, k] - origin[n, k]
            c[k] = triangles[met[n], 2, k] - origin[n, k]
        u, v, w = triple(d, b, c), triple(d, c, a), triple(d, a, b)
        total = u + v + w  # the normal times the ray, too
        behind[n] = total > 0.0
        total = total if abs(total) >= 1e-300 else 1e-300
        distance[n] = triple(a, b, c) / total
        first, second, third, x, y, z = _three(places[met[n]], u / total, v / total, w / total)
        point[n] = first if x >= y and x >= z else second if y >= z else third


COUNT = 512
"""Directions over the whole sphere. One of those above a surface carries at most 0.8 % of its irradiance, about one
8-bit code value; twice as many double the set-up time."""
SOLID_ANGLE = 4.0 * np.pi / COUNT
"""Solid angle [sr] that each direction stands for."""
_BESIDE_SKY = 0.1
"""Sine of the depression below which no pixel of `blurred` holds light of a sky above a level horizon."""
_SPARSE = ("data", "indices", "indptr", "shape")
"""What makes a sparse matrix."""
_RAYS_AT_ONCE = 200_000
_TYPICAL_COSINE = 2.0 / 3.0
"""Mean cosine at which diffuse light arrives: what a coat reflects of it is taken there."""
_ACROSS = 32
"""Rays along each side of the square around a mesh that find a silhouette: those of balls are then within 1 %."""
_BURIED = 0.5
"""A sample that sees backs of surfaces in more than this part of its directions lies inside a part of the mesh."""


@functools.cache
def directions() -> Floats:
    """Return unit directions (COUNT, 3) that cover the sphere evenly: a spherical Fibonacci lattice (Keinert 2015)."""
    k = np.arange(COUNT) + 0.5
    height, angle = 1.0 - 2.0 * k / COUNT, k * np.pi * (3.0 - np.sqrt(5.0))
    level = np.sqrt(1.0 - height * height)
    return np.stack([level * np.cos(angle), height, level * np.sin(angle)], axis=-1)


def blurred(environment: Environment) -> Floats:
    """Return the environment without its sun, (H/2, W/2, 3): its pixels are about as wide as a direction's share."""
    map_ = np.asarray(environment.residual, np.float64)
    rows, columns = map_.shape[0] // 2, map_.shape[1] // 2
    return map_[: 2 * rows, : 2 * columns].reshape(rows, 2, columns, 2, 3).mean(axis=(1, 3))


def seen_by_camera(away: Floats, direction: Floats) -> Floats:
    """Return unit directions (n, 3) in which a camera sees the places of level ground that others see.

    away: (n, 3) of the places from the camera; direction: (n, 3) in which the others see them, down. Of ground far off,
    which the camera sees beside its sky in one pixel of the environment, that nearer by is taken.
    """
    from_camera, down = unit(away), unit(direction)[:, 1:2]
    highest = np.minimum(from_camera[:, 1:2], np.maximum(down, -_BESIDE_SKY))
    level = from_camera[:, [0, 2]] * np.sqrt((1.0 - highest**2) / np.maximum(1.0 - from_camera[:, 1:2] ** 2, 1e-12))
    return np.stack([level[:, 0], highest[:, 0], level[:, 1]], axis=-1)


class MetSamples(NamedTuple):
    """Where rays meet a mesh, (m,) each: number of the ray, the sample nearest to the place, the distance, whether the
    back is met, and the fraction of the ray's light that is blocked there.
    """

    ray: NDArray[np.int64]
    sample: NDArray[np.int64]
    distance: Floats
    behind: NDArray[np.bool_]
    part: NDArray[np.float32]


def met_samples(
    geometry: Geometry, lattice: Lattice, least_m: float, origins: Floats, directions: Floats
) -> MetSamples:
    """Return where rays (n, 3) meet a mesh: their first triangles, and those behind what lets light through.

    least_m: length of the shortest step behind one.
    """
    met = surfaces_along(geometry, origins, directions, least_m)
    count, rays = len(met.ray), (met.triangle, met.start, directions[met.ray])
    point, distance, behind = np.empty(count, np.int64), np.empty(count), np.empty(count, np.bool_)
    if count:
        find_nearest_points(geometry.positions, *rays, lattice.places, point, distance, behind)
    sample = lattice.nearest_sample[point + (lattice.points * behind if lattice.two_sided else 0)]
    return MetSamples(met.ray, sample, met.gone + distance, behind, met.part.astype(np.float32))


Irradiance = NDArray[np.float32]
"""Irradiance [sr] that each direction adds to samples, (n, COUNT)."""


class SampledMaterial(NamedTuple):
    """Material of a mesh at its samples, maps averaged about them: base colour (S, 3), emission (S, 3)
    [plate radiance], metallic (S,), roughness (S,) and refractive index (S,).
    """

    base: Floats
    emission: Floats
    metallic: Floats
    roughness: Floats
    refractive_index: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Transfer:
    """What a mesh is to ambient light, in its own axes.

    coarse: (C,) numbers of the samples that exchange light with other bodies; nearest_coarse: (S,) which of them is
    nearest to each sample; spread: (S, C) sparse float32, rows of sum 1, interpolation between them to all samples;
    spacing_m: largest distance of a sample to one. cosine: (S, COUNT) float32, irradiance [sr] that each direction's
    radiance adds to a sample. own: (3, m) numbers of the samples and directions that the mesh blocks itself, and of the
    samples that are seen instead; own_part: (m,) float32, fraction of the direction that is blocked. material: at
    samples. geometry: its triangles. opacity: fraction of light that it blocks where it is met, a mean. area_m2: (3,)
    of its silhouettes along the axes; sides: (6, C) part of each coarse sample in the mean of what is seen from +x, -x,
    +y, -y, +z and -z. tree: places of the samples. corners: (n, 3) distinct ones of the triangles; box: (2, 3) around
    them; edges: (E, 2) numbers of the corners at the ends of each edge. Meshes of one `shape_of` share the lattice,
    which stands for all that their shape alone decides.
    """

    lattice: Lattice
    coarse: NDArray[np.int64]
    nearest_coarse: NDArray[np.int64]
    spread: Any
    spacing_m: float
    cosine: NDArray[np.float32]
    own: NDArray[np.int64]
    own_part: NDArray[np.float32]
    material: SampledMaterial
    geometry: Geometry
    opacity: float
    mesh: Mesh
    area_m2: Floats
    sides: NDArray[np.float32]
    tree: Any
    corners: Floats
    box: Floats
    edges: NDArray[np.int64]

    def painted(self, mesh: Mesh) -> Transfer:
        """Return the transfer of a mesh of the same `shape_of`."""
        return replace(self, mesh=mesh, material=_sampled_material(mesh, self.lattice))

    def coarse_means(self, values: Floats) -> Floats:
        """Return means (C, n) of values (S, n) over the samples that are nearest to each coarse sample."""
        of, count = self.nearest_coarse, len(self.coarse)
        total = np.stack([np.bincount(of, column, count) for column in values.T], axis=-1)
        return np.asarray(total / np.bincount(of, minlength=count)[:, None])

    def passed(self, origins: Floats, directions: Floats) -> Floats:
        """Return the fraction (n,) of the light of rays (n, 3) that the mesh leaves."""
        if _opaque(self.mesh):
            return np.asarray(~self.geometry.scene.occluded(origins, directions), np.float64)
        met = surfaces_along(self.geometry, origins, directions, 1e-6 * self.mesh.radius_m)
        return np.maximum(1.0 - np.bincount(met.ray, met.part, len(origins)), 0.0)

    def met(self, origins: Floats, directions: Floats) -> MetSamples:
        """Return where rays (n, 3) meet the mesh."""
        return met_samples(self.geometry, self.lattice, 1e-6 * self.mesh.radius_m, origins, directions)

    def own_light(self, shadow: bool) -> tuple[Irradiance | None, Any, Irradiance, Irradiance, Irradiance]:
        """Return lost, inside, left, plain and direct of `Body`: what the mesh does to its own light if it casts a
        `shadow`.
        """
        from scipy.sparse import csr_matrix

        sample, direction, hit = self.own
        plain = self.cosine[self.coarse]
        shape = (len(self.cosine), len(self.coarse))
        if not shadow or len(sample) == 0:
            return None, csr_matrix(np.zeros(shape, np.float32)), self.cosine, plain, plain
        weight = self.cosine[sample, direction] * self.own_part
        samples = csr_matrix((weight, (sample, self.nearest_coarse[hit])), shape=shape)
        lost = np.zeros_like(self.cosine)
        np.add.at(lost, (sample, direction), weight)
        return lost, samples, self.cosine - lost, plain, plain - lost[self.coarse]

    def reflected(self, medium_index: float) -> Floats:
        """Return the fraction (S, 3) of ambient light that samples send back, the coat's part taken as diffuse.

        At most 1: a base colour above 1 brightens its own picture, but light that grew from wall to wall would have no
        end.
        """
        f0 = dielectric_f0(self.material.refractive_index, medium_index)[:, None] * np.ones(3)
        split = np.stack(split_sum(np.full(len(f0), 1.0), np.full(len(f0), _TYPICAL_COSINE)), axis=-1)
        coat = reflectance(f0, split)
        base = np.minimum(self.material.base, 1.0)
        return np.where(self.material.metallic[:, None] > 0.5, base, base + (1.0 - base) * coat)


def shape_of(mesh: Mesh) -> PartOf[Mesh]:
    """Return a mesh's shape: its arrays, what light it lets through, and which materials are seen from both sides."""
    sides = tuple(material.double_sided for material in mesh.materials)
    arrays = Same(mesh.positions), Same(mesh.normals), Same(mesh.material), Same(mesh.hull)
    return PartOf(mesh, *arrays, sides, opacity_key(mesh))


def shape_transfer(shape: PartOf[Mesh]) -> Transfer:
    """Return the transfer of a mesh, of which what is not its shape is not to be used."""
    return make_transfer(shape.whole)


def make_transfer(mesh: Mesh) -> Transfer:
    """Return the transfer of a mesh; its samples are chosen and its rays are shot once, and kept on the disk."""
    from scipy.spatial import cKDTree

    geometry = _geometry(mesh)
    depends_on = mesh.positions, mesh.normals, mesh.hull, any(m.double_sided for m in mesh.materials)
    clear = () if _opaque(mesh) else (mesh.material, mesh.uv, mesh.colors, *_alphas(mesh))
    found = _unpacked(kept_arrays("ambient", (*depends_on, *clear), lambda: _packed(_samples(mesh, geometry))))
    lattice = Lattice(**{field.name: found.pop(field.name) for field in fields(Lattice)})
    corners = mesh.positions.reshape(-1, 3)[found.pop("corners")]
    return Transfer(
        lattice, cosine=_cosines(lattice), material=_sampled_material(mesh, lattice), geometry=geometry, mesh=mesh,
        tree=cKDTree(lattice.position), corners=corners, box=np.stack([corners.min(axis=0), corners.max(axis=0)]),
        **found,
    )  # fmt: skip


def _opaque(mesh: Mesh) -> bool:
    """Return whether a mesh lets nothing through."""
    return all(m.alpha_mode == "OPAQUE" for m in mesh.materials)


def _alphas(mesh: Mesh) -> list[object]:
    """Return what materials say of `opacity`."""
    factors = [(m.alpha_mode, m.alpha_cutoff, m.base_color[3]) for m in mesh.materials]
    return [str(factors), *(m.base_map.levels[0] for m in mesh.materials if m.base_map is not None)]


def _samples(mesh: Mesh, geometry: Geometry) -> dict[str, Any]:
    """Return the fields of a mesh's lattice, and of its `Transfer` those that take rays, by their names; corners: (n,)
    numbers of the distinct ones among all.
    """
    lattice, least_m = make_lattice(mesh), 1e-6 * mesh.radius_m
    cosine = _cosines(lattice)
    blocked = _blocked_by_itself(lattice, cosine, geometry, least_m)
    lattice, own, own_part, seen = _without_buried_samples(lattice, cosine, blocked)
    coarse = choose_coarse(lattice, float(np.max(mesh.extent_m)), seen)
    area, sides, opacity = _sides(mesh, geometry, lattice, coarse["nearest_coarse"], len(coarse["coarse"]))
    # Join the corners that lie together, and find the edges between them
    corner = welded(mesh.positions).ravel()
    ends = np.sort(np.stack([corner, np.roll(corner.reshape(-1, 3), -1, axis=1).ravel()], axis=-1), axis=1)
    count = int(corner.max()) + 1
    edges = np.stack(np.divmod(np.unique(ends[:, 0] * count + ends[:, 1]), count), axis=-1)
    found = {"own": own, "own_part": own_part, "area_m2": area, "sides": sides, "opacity": opacity, "edges": edges}
    found["corners"] = np.unique(corner, return_index=True)[1]
    return {field.name: getattr(lattice, field.name) for field in fields(lattice)} | coarse | found


def _packed(values: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
    """Return values as the arrays that are kept on the disk: the parts of sparse matrices, and numbers of samples,
    points and triangles in the smallest type that holds them.
    """
    arrays: dict[str, NDArray[Any]] = {}
    for name, value in values.items():
        parts = {f"{name}.{of}": getattr(value, of) for of in _SPARSE} if hasattr(value, "indptr") else {name: value}
        for key, array in zip(parts, map(np.asarray, parts.values()), strict=True):
            numbers = array.dtype == np.int64
            arrays[key] = array.astype(np.min_scalar_type(int(array.max(initial=0)))) if numbers else array
    return arrays


def _unpacked(arrays: Arrays) -> dict[str, Any]:
    """Return the values of which `_packed` returned arrays."""
    from scipy.sparse import csr_matrix

    values: dict[str, Any] = {}
    sparse = defaultdict[str, dict[str, Any]](dict)
    for key, kept in arrays.items():
        array = kept.astype(np.int64) if kept.dtype.kind == "u" else kept
        name, _, part = key.partition(".")
        if part:
            sparse[name][part] = array
        else:
            values[name] = array if array.ndim else array.item()
    for name, of in sparse.items():
        values[name] = csr_matrix((of["data"], of["indices"], of["indptr"]), shape=tuple(of["shape"].tolist()))
    return values


def _sides(
    mesh: Mesh, geometry: Geometry, lattice: Lattice, nearest_coarse: NDArray[np.int64], count: int
) -> tuple[Floats, NDArray[np.float32], float]:
    """Return area_m2, sides and opacity of `Transfer`: the silhouettes of a mesh from six sides. count: of all coarse
    samples.
    """
    blocked, rays_that_meet = 0.0, 0
    line = ((np.arange(_ACROSS) + 0.5) / _ACROSS * 2.0 - 1.0) * mesh.radius_m
    u, v = (g.ravel() for g in np.meshgrid(line, line, indexing="ij"))
    area, seen = np.zeros(3), np.zeros((6, count), np.float32)
    for side in range(6):
        axis, towards = side // 2, 1.0 - 2.0 * (side % 2)
        origin, rays = np.zeros((2, len(u), 3))
        origin[:, axis], origin[:, (axis + 1) % 3], origin[:, (axis + 2) % 3] = 2.0 * towards * mesh.radius_m, u, v
        origin, rays[:, axis] = origin + mesh.center_m, -towards
        met = met_samples(geometry, lattice, 1e-6 * mesh.radius_m, origin, rays)
        total = float(met.part.sum())
        np.add.at(seen[side], nearest_coarse[met.sample], met.part * np.float32(1.0 / max(total, 1e-9)))
        area[axis] = total / len(u) * (2.0 * mesh.radius_m) ** 2
        blocked, rays_that_meet = blocked + total, rays_that_meet + len(np.unique(met.ray))
    return area, seen, blocked / max(rays_that_meet, 1)


def _cosines(lattice: Lattice) -> NDArray[np.float32]:
    """Return the irradiance [sr] (S, COUNT) that each direction's radiance adds to samples."""
    cosine = lattice.normal.astype(np.float32) @ directions().T.astype(np.float32)
    np.maximum(cosine, 0.0, out=cosine)
    # their sum is that of the integral, so that uniform light stays uniform
    cosine *= np.pi / cosine.sum(axis=1, keepdims=True)
    return cosine


def _without_buried_samples(
    lattice: Lattice, cosine: NDArray[np.float32], blocked: tuple[NDArray[Any], ...]
) -> tuple[Lattice, NDArray[np.int64], NDArray[np.float32], NDArray[np.bool_]]:
    """Return lattice, own pairs and their parts in which samples inside another part of the mesh, which see its surface
    from behind, take the values of those about them: what is interpolated from them is seen. Last, which samples (S,)
    are not inside. blocked: of `_blocked_by_itself`.
    """
    (sample, direction, hit, behind, part), count = blocked, len(cosine)
    inside = np.bincount(sample, behind * part, count)
    buried = inside > _BURIED * np.count_nonzero(cosine, axis=1)
    if lattice.two_sided or not np.any(buried) or np.all(buried):
        return lattice, np.stack([sample, direction, hit]), part, np.ones(count, np.bool_)
    stand_in, mixed = stand_ins(lattice, buried)
    kept = ~buried[sample]
    lattice = replace(
        lattice, nearest_sample=stand_in[lattice.nearest_sample], from_samples=lattice.from_samples @ mixed
    )
    return lattice, np.stack([sample[kept], direction[kept], stand_in[hit[kept]]]), part[kept], ~buried


def _blocked_by_itself(
    lattice: Lattice, cosine: NDArray[np.float32], geometry: Geometry, least_m: float
) -> tuple[NDArray[Any], ...]:
    """Return sample, direction, the sample that is seen instead, whether its back is, and the part of the direction, of
    all rays that meet the mesh itself.
    """
    d = directions()
    sample, direction = np.nonzero(cosine > 0.0)
    found: list[tuple[NDArray[Any], ...]] = []
    for start in range(0, len(sample), _RAYS_AT_ONCE):
        s, k = sample[start : start + _RAYS_AT_ONCE], direction[start : start + _RAYS_AT_ONCE]
        met = met_samples(geometry, lattice, least_m, lattice.position[s], d[k])
        found.append((s[met.ray], k[met.ray], met.sample, met.behind, met.part))
    return tuple(np.concatenate(column) for column in zip(*found, strict=True))


def _sampled_material(mesh: Mesh, lattice: Lattice) -> SampledMaterial:
    """Return the material of a mesh at its samples."""
    geometry = _geometry(mesh)
    uv = mesh.uv[lattice.triangle]
    steps = lattice.places[lattice.triangle, 3].astype(np.float64)[:, None]
    change = np.stack([uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]], axis=1) / steps[..., None]
    base = base_color(geometry, lattice.triangle, lattice.weights, change)
    of = mesh.material[lattice.triangle]
    factors = np.array([(*m.emission, *_mean_factors(m), m.refractive_index) for m in mesh.materials])
    emission = factors[of, :3]
    for number, m in enumerate(mesh.materials):
        if m.emission_map is not None:
            emission[of == number] *= m.emission_map.levels[-1].reshape(-1, 4)[0, :3]
    return SampledMaterial(np.clip(base[:, :3], 0.0, 1.0), emission, *factors[of, 3:].T)


def _geometry(mesh: Mesh) -> Geometry:
    """Return the triangles of a mesh in its own axes."""
    return gather([PlacedObject(mesh, np.eye(4))], np.zeros(3))


def _mean_factors(material: Material) -> tuple[float, float]:
    """Return the mean metallic and roughness of a material."""
    map_ = material.metallic_roughness_map
    _, rough, metallic = np.ones(3) if map_ is None else map_.levels[-1].reshape(-1, 4)[0, :3]
    return float(material.metallic * metallic), float(material.roughness * rough)
