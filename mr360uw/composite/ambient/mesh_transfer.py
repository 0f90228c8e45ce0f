# SPDX-License-Identifier: Apache-2.0
"""Precomputed ambient transfer of a mesh: which of a set of fixed directions its own surface blocks at its samples, and
by which sample (after Sloan et al. 2002; here as a sparse list instead of spherical harmonics, so that bounces are
solved after the lights are known).
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import PartOf, Same
from mr360uw.composite.ambient.sample_points import (
    CoarseSamples,
    Lattice,
    choose_coarse,
    find_nearest_points,
    make_lattice,
    stand_ins,
)
from mr360uw.composite.lighting.shading import dielectric_f0, reflectance
from mr360uw.composite.mesh.material import Material
from mr360uw.composite.mesh.mesh import Mesh
from mr360uw.composite.mesh.normals import welded
from mr360uw.composite.raycast import Geometry, base_color, gather, opacity_key, surfaces_along
from mr360uw.composite.shot import PlacedObject
from mr360uw.ibl.splitsum import split_sum
from mr360uw.rays import RayScene
from mr360uw.reading.disk_cache import Arrays, kept_arrays
from mr360uw.sphere import unit
from mr360uw.types import Environment, Floats

COUNT = 512
"""Directions over the whole sphere. One of those above a surface carries at most 0.8 % of its irradiance, about one
8-bit code value; twice as many double the set-up time."""
SOLID_ANGLE = 4.0 * np.pi / COUNT
"""Solid angle [sr] that each direction stands for."""
_BESIDE_SKY = 0.1
"""Sine of the depression below which no pixel of `blurred` holds light of a sky above a level horizon."""
_SPARSE = ("data", "indices", "indptr")
"""Arrays of a sparse matrix."""
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


Samples = TypeVar("Samples", Lattice, CoarseSamples)


class MetSamples(NamedTuple):
    """Where rays meet a mesh, (m,) each: number of the ray, the sample nearest to the place, the distance, whether the
    back is met, and the fraction of the ray's light that is blocked there.
    """

    ray: NDArray[np.int64]
    sample: NDArray[np.int64]
    distance: Floats
    behind: NDArray[np.bool_]
    part: NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class Blocking:
    """The triangles of a mesh for rays of ambient light, in its own axes. geometry: of these, for what they let
    through.
    """

    mesh: Mesh
    scene: RayScene
    geometry: Geometry

    @property
    def opaque(self) -> bool:
        """Whether they let nothing through."""
        return all(m.alpha_mode == "OPAQUE" for m in self.mesh.materials)

    def passed(self, origins: Floats, directions: Floats) -> Floats:
        """Return the fraction (n,) of the light of rays (n, 3) that the mesh leaves."""
        if self.opaque:
            return np.asarray(~self.scene.occluded(origins, directions), np.float64)
        met = surfaces_along(self.geometry, self.scene, origins, directions, 1e-6 * self.mesh.radius_m)
        return np.maximum(1.0 - np.bincount(met.ray, met.part, len(origins)), 0.0)

    def met(self, lattice: Lattice, origins: Floats, directions: Floats) -> MetSamples:
        """Return where rays (n, 3) meet the mesh: their first triangles, and those behind what lets light through."""
        met = surfaces_along(self.geometry, self.scene, origins, directions, 1e-6 * self.mesh.radius_m)
        sample, distance, behind = _nearest_sample(lattice, self.scene, met.start, directions[met.ray], met.triangle)
        return MetSamples(met.ray, sample, met.gone + distance, behind, met.part.astype(np.float32))


def _nearest_sample(
    lattice: Lattice, scene: RayScene, origin: Floats, direction: Floats, triangle: NDArray[np.int64]
) -> tuple[NDArray[np.int64], Floats, NDArray[np.bool_]]:
    """Return the nearest sample (n,) to where rays meet triangles, the distance, and which meet the back (n,)."""
    count = len(triangle)
    point, distance, behind = np.empty(count, np.int64), np.empty(count), np.empty(count, np.bool_)
    if count:
        find_nearest_points(scene.triangles, triangle, origin, direction, lattice.places, point, distance, behind)
    return lattice.nearest_sample[point + (lattice.points * behind if lattice.two_sided else 0)], distance, behind


@dataclass(frozen=True, slots=True, eq=False)
class OwnView:
    """What a mesh does to its own light. lost: (S, COUNT) float32, irradiance [sr] that its own surface keeps off in
    each direction, None if nothing; samples: (S, C) sparse, what its coarse samples add instead; left: (S, COUNT)
    float32, irradiance [sr] that each direction still adds. plain, direct: (C, COUNT) irradiance that each direction
    adds at the coarse samples, were nothing in the way, and with the mesh itself.
    """

    lost: NDArray[np.float32] | None
    samples: Any
    left: NDArray[np.float32]
    plain: NDArray[np.float32]
    direct: NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class Transfer:
    """What a mesh is to ambient light, in its own axes.

    cosine: (S, COUNT) float32, irradiance [sr] that each direction's radiance adds to a sample; whole: (S,) its sum.
    coarse: the samples that exchange light with other bodies. own: (3, m) numbers of the samples and directions that
    the mesh blocks itself, and of the samples that are seen instead; own_part: (m,) float32, fraction of the direction
    that is blocked. base, emission: (S, 3) mean colour and emission [plate radiance]; metallic, roughness, index: (S,).
    blocking: its triangles for rays. opacity: fraction of light that it blocks where it is met, a mean. area_m2: (3,)
    of its silhouettes along the axes; sides: (6, C) part of each coarse sample in the mean of what is seen from +x, -x,
    +y, -y, +z and -z. tree: places of the samples. corners: (n, 3) distinct ones of the triangles; edges: (E, 2)
    numbers of the corners at the ends of each edge. Meshes of one `shape_of` share the lattice, which stands for all
    that their shape alone decides.
    """

    lattice: Lattice
    coarse: CoarseSamples
    cosine: NDArray[np.float32]
    own: NDArray[np.int64]
    own_part: NDArray[np.float32]
    base: Floats
    emission: Floats
    metallic: Floats
    roughness: Floats
    index: Floats
    whole: Floats
    blocking: Blocking
    opacity: float
    mesh: Mesh
    area_m2: Floats
    sides: NDArray[np.float32]
    tree: Any
    corners: Floats
    edges: NDArray[np.int64]

    def painted(self, mesh: Mesh) -> Transfer:
        """Return the transfer of a mesh of the same `shape_of`."""
        base, emission, metallic, roughness, index = _colors(mesh, self.lattice)
        return replace(
            self, mesh=mesh, base=base, emission=emission, metallic=metallic, roughness=roughness, index=index
        )

    def own_view(self, shadow: bool) -> OwnView:
        """Return what the mesh does to its own light if it casts a `shadow`."""
        from scipy.sparse import csr_matrix

        sample, direction, hit = self.own
        plain = self.cosine[self.coarse.sample]
        shape = (len(self.cosine), len(self.coarse.sample))
        if not shadow or len(sample) == 0:
            return OwnView(None, csr_matrix(np.zeros(shape, np.float32)), self.cosine, plain, plain)
        weight = self.cosine[sample, direction] * self.own_part
        samples = csr_matrix((weight, (sample, self.coarse.of[hit])), shape=shape)
        lost = np.zeros_like(self.cosine)
        np.add.at(lost, (sample, direction), weight)
        return OwnView(lost, samples, self.cosine - lost, plain, plain - lost[self.coarse.sample])

    def reflected(self, medium_index: float) -> Floats:
        """Return the fraction (S, 3) of ambient light that samples send back, the coat's part taken as diffuse.

        At most 1: a base colour above 1 brightens its own picture, but light that grew from wall to wall would have no
        end.
        """
        f0 = dielectric_f0(self.index, medium_index)[:, None] * np.ones(3)
        split = np.stack(split_sum(np.full(len(f0), 1.0), np.full(len(f0), _TYPICAL_COSINE)), axis=-1)
        coat = reflectance(f0, split)
        base = np.minimum(self.base, 1.0)
        return np.where(self.metallic[:, None] > 0.5, base, base + (1.0 - base) * coat)


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

    blocking = Blocking(mesh, RayScene(mesh.positions), _geometry(mesh))
    depends_on = mesh.positions, mesh.normals, mesh.hull, any(m.double_sided for m in mesh.materials)
    clear = () if blocking.opaque else (mesh.material, mesh.uv, mesh.colors, *_alphas(mesh))
    found = kept_arrays("ambient", (*depends_on, *clear), lambda: _samples(blocking))
    lattice, coarse = _from_arrays(Lattice, found), _from_arrays(CoarseSamples, found)
    cosine = _cosines(lattice)
    base, emission, metallic, roughness, index = _colors(mesh, lattice)
    return Transfer(
        lattice, coarse, cosine, found["own"].astype(np.int64), found["own_part"], base, emission, metallic, roughness,
        index, cosine.sum(axis=1), blocking, float(found["opacity"]), mesh, found["area_m2"], found["sides"],
        cKDTree(lattice.position), mesh.positions.reshape(-1, 3)[found["corners"]], found["edges"].astype(np.int64),
    )  # fmt: skip


def _alphas(mesh: Mesh) -> list[object]:
    """Return what materials say of `opacity`."""
    factors = [(m.alpha_mode, m.alpha_cutoff, m.base_color[3]) for m in mesh.materials]
    return [str(factors), *(m.base_map.levels[0] for m in mesh.materials if m.base_map is not None)]


def _samples(blocking: Blocking) -> dict[str, NDArray[Any]]:
    """Return the arrays of lattice and coarse samples, and own, own_part, opacity, area_m2, sides and edges of
    `Transfer`, by their names; corners: (n,) numbers of the distinct ones among all.
    """
    mesh = blocking.mesh
    lattice = make_lattice(mesh)
    cosine = _cosines(lattice)
    lattice, own, own_part, seen = _without_buried_samples(
        lattice, cosine, *_blocked_by_itself(lattice, cosine, blocking)
    )
    coarse = choose_coarse(lattice, float(np.max(mesh.extent_m)), seen)
    area, sides, opacity = _sides(blocking, lattice, coarse)
    found = {"own": _small(own), "own_part": own_part, "area_m2": area, "sides": sides, "opacity": np.array(opacity)}
    corner = welded(mesh.positions).ravel()
    ends = np.sort(np.stack([corner, np.roll(corner.reshape(-1, 3), -1, axis=1).ravel()], axis=-1), axis=1)
    count = int(corner.max()) + 1
    edges = np.stack(np.divmod(np.unique(ends[:, 0] * count + ends[:, 1]), count), axis=-1)
    found |= {"corners": _small(np.unique(corner, return_index=True)[1]), "edges": _small(edges)}
    return {**_arrays_of(lattice), **_arrays_of(coarse), **found}


def _arrays_of(samples: Lattice | CoarseSamples) -> dict[str, NDArray[Any]]:
    """Return the fields of samples as arrays by their names, as they are kept on the disk."""
    arrays: dict[str, NDArray[Any]] = {}
    for field in fields(samples):
        entry, name = getattr(samples, field.name), f"{type(samples).__name__}.{field.name}"
        if hasattr(entry, "indptr"):
            arrays |= {f"{name}.{of}": getattr(entry, of) for of in _SPARSE}
            arrays[f"{name}.shape"] = np.array(entry.shape)
        else:
            arrays[name] = _small(np.asarray(entry))
    return arrays


def _small(array: NDArray[Any]) -> NDArray[Any]:
    """Return numbers of samples, points and triangles in the smallest type that holds them."""
    return array.astype(np.min_scalar_type(int(array.max(initial=0)))) if array.dtype == np.int64 else array


def _from_arrays(kind: type[Samples], arrays: Arrays) -> Samples:
    """Return the samples of which `_arrays_of` returned arrays."""
    from scipy.sparse import csr_matrix

    values: dict[str, Any] = {}
    for field in fields(kind):
        name = f"{kind.__name__}.{field.name}"
        if name in arrays:
            array = arrays[name]
            whole = array.dtype.kind == "u"
            values[field.name] = array.item() if not array.ndim else array.astype(np.int64) if whole else array
        else:
            entries = tuple(arrays[f"{name}.{of}"] for of in _SPARSE)
            values[field.name] = csr_matrix(entries, shape=tuple(arrays[f"{name}.shape"].tolist()))
    return kind(**values)


def _sides(blocking: Blocking, lattice: Lattice, coarse: CoarseSamples) -> tuple[Floats, NDArray[np.float32], float]:
    """Return area_m2, sides and opacity of `Transfer`: the silhouettes of a mesh from six sides."""
    mesh, blocked, rays_that_meet = blocking.mesh, 0.0, 0
    line = ((np.arange(_ACROSS) + 0.5) / _ACROSS * 2.0 - 1.0) * mesh.radius_m
    u, v = (g.ravel() for g in np.meshgrid(line, line, indexing="ij"))
    area, seen = np.zeros(3), np.zeros((6, len(coarse.sample)), np.float32)
    for side in range(6):
        axis, towards = side // 2, 1.0 - 2.0 * (side % 2)
        origin, rays = np.zeros((2, len(u), 3))
        origin[:, axis], origin[:, (axis + 1) % 3], origin[:, (axis + 2) % 3] = 2.0 * towards * mesh.radius_m, u, v
        origin, rays[:, axis] = origin + mesh.center_m, -towards
        met = blocking.met(lattice, origin, rays)
        total = float(met.part.sum())
        np.add.at(seen[side], coarse.of[met.sample], met.part * np.float32(1.0 / max(total, 1e-9)))
        area[axis] = total / len(u) * (2.0 * mesh.radius_m) ** 2
        blocked, rays_that_meet = blocked + total, rays_that_meet + len(np.unique(met.ray))
    return area, seen, blocked / max(rays_that_meet, 1)


def _cosines(lattice: Lattice) -> NDArray[np.float32]:
    """Return the irradiance [sr] (S, COUNT) that each direction's radiance adds to samples."""
    cosine = np.maximum(lattice.normal @ directions().T, 0.0) * SOLID_ANGLE
    # their sum is that of the integral, so that uniform light stays uniform
    return np.asarray(cosine * (np.pi / cosine.sum(axis=1, keepdims=True)), np.float32)


def _without_buried_samples(
    lattice: Lattice,
    cosine: NDArray[np.float32],
    sample: NDArray[np.int64],
    direction: NDArray[np.int64],
    hit: NDArray[np.int64],
    behind: NDArray[np.bool_],
    part: NDArray[np.float32],
) -> tuple[Lattice, NDArray[np.int64], NDArray[np.float32], NDArray[np.bool_]]:
    """Return lattice, own pairs and their parts in which samples inside another part of the mesh, which see its surface
    from behind, take the values of those about them: what is interpolated from them is seen. Last, which samples (S,)
    are not inside.
    """
    count = len(cosine)
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


def _blocked_by_itself(lattice: Lattice, cosine: NDArray[np.float32], blocking: Blocking) -> tuple[NDArray[Any], ...]:
    """Return sample, direction, the sample that is seen instead, whether its back is, and the part of the direction, of
    all rays that meet the mesh itself.
    """
    d = directions()
    sample, direction = np.nonzero(cosine > 0.0)
    found: list[tuple[NDArray[Any], ...]] = []
    for start in range(0, len(sample), _RAYS_AT_ONCE):
        s, k = sample[start : start + _RAYS_AT_ONCE], direction[start : start + _RAYS_AT_ONCE]
        met = blocking.met(lattice, lattice.position[s], d[k])
        found.append((s[met.ray], k[met.ray], met.sample, met.behind, met.part))
    return tuple(np.concatenate(column) for column in zip(*found, strict=True))


def _colors(mesh: Mesh, lattice: Lattice) -> tuple[Floats, ...]:
    """Return base colour (S, 3), emission (S, 3), metallic (S,), roughness (S,) and index (S,) at samples, maps
    averaged about them.
    """
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
    return np.clip(base[:, :3], 0.0, 1.0), emission, *factors[of, 3:].T


def _geometry(mesh: Mesh) -> Geometry:
    """Return the triangles of a mesh in its own axes."""
    return gather([PlacedObject(mesh, np.eye(4))], np.zeros(3))


def _mean_factors(material: Material) -> tuple[float, float]:
    """Return the mean metallic and roughness of a material."""
    map_ = material.metallic_roughness_map
    _, rough, metallic = np.ones(3) if map_ is None else map_.levels[-1].reshape(-1, 4)[0, :3]
    return float(material.metallic * metallic), float(material.roughness * rough)
