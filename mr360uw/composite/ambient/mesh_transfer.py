# SPDX-License-Identifier: Apache-2.0
"""Precomputed ambient transfer of a mesh: which directions its own surface blocks at its sites, and by which site
(after Sloan et al. 2002; here as a sparse list instead of spherical harmonics, so that bounces are solved
after the lights are known).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.ambient.directions import COUNT, SOLID_ANGLE, directions
from mr360uw.composite.ambient.lattice import Lattice, knots_at, make_lattice, stand_ins
from mr360uw.composite.ambient.store import kept_on_disk
from mr360uw.composite.lighting.shading import dielectric_f0, reflectance
from mr360uw.composite.mesh.material import Material
from mr360uw.composite.mesh.mesh import Mesh
from mr360uw.composite.raycast.geometry import base_color, gather
from mr360uw.composite.raycast.rays import RayScene, barycentric
from mr360uw.composite.shot import PlacedObject
from mr360uw.ibl.splitsum import split_sum
from mr360uw.types import Floats

_RAYS_AT_ONCE = 200_000
_TYPICAL_COSINE = 2.0 / 3.0
"""Mean cosine at which diffuse light arrives: what a coat reflects of it is taken there."""
_VERSION = 2
_BURIED = 0.5
"""A site that sees backs of surfaces in more than this part of its directions lies inside a part of the mesh."""


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """m directions that something blocks: numbers of the site, the direction, and the site that is seen instead."""

    site: NDArray[np.int64]
    direction: NDArray[np.int64]
    hit: NDArray[np.int64]

    def of(self, which: NDArray[Any]) -> Pairs:
        """Return some of the pairs."""
        return Pairs(self.site[which], self.direction[which], self.hit[which])


@dataclass(frozen=True, slots=True, eq=False)
class Transfer:
    """What a mesh is to ambient light, in its own axes.

    cosine: (S, COUNT) float32, irradiance [sr] that each direction's radiance adds to a site; whole: (S,) its sum. own:
    pairs that the mesh blocks itself. base, emission: (S, 3) mean colour and emission [plate radiance]; metallic,
    roughness, index: (S,). scene, solid: its opaque triangles for rays, and their numbers.
    """

    lattice: Lattice
    cosine: NDArray[np.float32]
    own: Pairs
    base: Floats
    emission: Floats
    metallic: Floats
    roughness: Floats
    index: Floats
    whole: Floats
    scene: RayScene
    solid: NDArray[np.int64]
    mesh: Mesh

    def reflected(self, medium_index: float) -> Floats:
        """Return the fraction (S, 3) of ambient light that sites send back, the coat's part taken as diffuse."""
        f0 = dielectric_f0(self.index, medium_index)[:, None] * np.ones(3)
        split = np.stack(split_sum(np.full(len(f0), 1.0), np.full(len(f0), _TYPICAL_COSINE)), axis=-1)
        coat = reflectance(f0, split)
        return np.where(self.metallic[:, None] > 0.5, self.base, self.base + (1.0 - self.base) * coat)

    def sites_at(self, triangle: NDArray[np.int64], weights: Floats, behind: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Return the nearest site (n,) to places on opaque triangles; behind: those met from the back."""
        knots, shares = knots_at(self.lattice.places[self.solid[triangle]], weights)
        knot = knots[np.arange(len(knots)), np.argmax(shares, axis=1)]
        return self.lattice.knot_site[knot + (self.lattice.knots * behind if self.lattice.two_sided else 0)]


def make_transfer(mesh: Mesh) -> Transfer:
    """Return the transfer of a mesh; its rays are shot once, and kept on the disk."""
    lattice = make_lattice(mesh)
    solid = np.flatnonzero(np.array([m.alpha_mode == "OPAQUE" for m in mesh.materials])[mesh.material])
    scene = RayScene(mesh.positions[solid])
    cosine = np.maximum(lattice.normal @ directions().T, 0.0) * SOLID_ANGLE
    # their sum is that of the integral, so that uniform light stays uniform
    cosine = (cosine * (np.pi / cosine.sum(axis=1, keepdims=True))).astype(np.float32)
    base, emission, metallic, roughness, index = _colors(mesh, lattice)
    bare = Transfer(lattice, cosine, Pairs(*np.zeros((3, 0), np.int64)), base, emission, metallic, roughness, index,
                    cosine.sum(axis=1), scene, solid, mesh)  # fmt: skip
    own = kept_on_disk(
        (mesh.positions, mesh.normals, solid, np.array([COUNT, _VERSION])), ("site", "direction", "hit", "behind"),
        (len(cosine), COUNT, len(cosine), 2), lambda: _blocked_by_itself(bare),
    )  # fmt: skip
    return _without_buried_sites(replace(bare, own=Pairs(*own[:3])), own[3])


def _without_buried_sites(transfer: Transfer, behind: NDArray[np.int64]) -> Transfer:
    """Return a transfer in which sites inside another part of the mesh, which see its surface from behind, take the
    values of those about them: what is interpolated from them is seen.
    """
    own, lattice = transfer.own, transfer.lattice
    count = len(transfer.cosine)
    inside = np.bincount(own.site, behind, count)
    buried = inside > _BURIED * np.count_nonzero(transfer.cosine, axis=1)
    if lattice.two_sided or not np.any(buried) or np.all(buried):
        return transfer
    stand_in, mixed = stand_ins(lattice, buried)
    kept = ~buried[own.site]
    return replace(
        transfer,
        own=Pairs(own.site[kept], own.direction[kept], stand_in[own.hit[kept]]),
        lattice=replace(lattice, knot_site=stand_in[lattice.knot_site], from_sites=lattice.from_sites @ mixed),
    )


def _blocked_by_itself(transfer: Transfer) -> tuple[NDArray[np.int64], ...]:
    lattice, d = transfer.lattice, directions()
    site, direction = np.nonzero(transfer.cosine > 0.0)
    found = [np.zeros((4, 0), np.int64)]
    for start in range(0, len(site), _RAYS_AT_ONCE):
        s, k = site[start : start + _RAYS_AT_ONCE], direction[start : start + _RAYS_AT_ONCE]
        triangle = transfer.scene.first_hit(lattice.position[s], d[k])
        hit = np.flatnonzero(triangle >= 0)
        s, k, triangle = s[hit], k[hit], triangle[hit]
        met, _, behind = met_sites(transfer, lattice.position[s], d[k], triangle)
        found.append(np.stack([s, k, met, behind]))
    return tuple(np.concatenate(found, axis=1))


def met_sites(
    transfer: Transfer, origin: Floats, direction: Floats, triangle: NDArray[np.int64]
) -> tuple[NDArray[np.int64], Floats, NDArray[np.bool_]]:
    """Return the nearest site (n,) to where rays meet opaque triangles, the distance, and which meet the back (n,)."""
    corners = transfer.scene.triangles[triangle]
    weights, distance = barycentric(corners - origin[:, None], direction)
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    behind = np.sum(flat * direction, axis=-1) > 0.0
    return transfer.sites_at(triangle, weights, behind), distance, behind


def _colors(mesh: Mesh, lattice: Lattice) -> tuple[Floats, ...]:
    """Return base colour (S, 3), emission (S, 3), metallic (S,), roughness (S,) and index (S,) at sites, maps averaged
    about them.
    """
    geometry = gather([PlacedObject(mesh, np.eye(4))], np.zeros(3))
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


def _mean_factors(material: Material) -> tuple[float, float]:
    """Return the mean metallic and roughness of a material."""
    map_ = material.metallic_roughness_map
    _, rough, metallic = np.ones(3) if map_ is None else map_.levels[-1].reshape(-1, 4)[0, :3]
    return float(material.metallic * metallic), float(material.roughness * rough)
