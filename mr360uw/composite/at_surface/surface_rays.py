# SPDX-License-Identifier: Apache-2.0
"""The moving surface as the pixels of a frame see it: one ray a pixel, and how the surface turns from pixel to pixel.

The surface is smooth at the size of a pixel's footprint, by which it is filtered: rays between the centres meet the
tangent plane, with a normal that changes linearly. Waves smaller than the footprint are facets (`surface.slopes`),
drawn from a fixed set of slopes. Rays that the surface sends on end at the first solid surface of a body.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from mr360uw.composite.at_surface.water_sides import WaterSides
from mr360uw.composite.raycast import MAXIMUM_HITS, Geometry, Hits, base_color, surface_along
from mr360uw.composite.sampling import PIXEL_FILTER, WHOLE_PIXEL, Pattern
from mr360uw.constants import PI
from mr360uw.optics import reflect, refract_clamped
from mr360uw.rays import RayScene, barycentric
from mr360uw.surface.intersection import first_hits
from mr360uw.surface.tracing.facet_draws import FacetsOfRays, normal_of
from mr360uw.types import Floats

Indices = NDArray[np.int64]


def first_surfaces(geometry: Geometry, scene: RayScene, origin: Floats, direction: Floats) -> tuple[Indices, Floats]:
    """Return the triangle (n,) that each ray meets first, -1 for none, and the distance (n,) [m], infinity for none.

    origin, direction: (n, 3), from the camera. Rays pass through back faces of one-sided materials, and through masks
    where they are open; masks are read at their finest level.
    """
    found, distance = np.full(len(origin), -1, np.int64), np.full(len(origin), np.inf)
    two_sided = np.array([m.double_sided for m in geometry.materials] or [True])
    masked = np.array([m.alpha_mode == "MASK" for m in geometry.materials] or [False])
    cutoff = np.array([m.alpha_cutoff for m in geometry.materials] or [0.5])
    active, start = np.arange(len(origin)), np.zeros(len(origin))
    for _ in range(MAXIMUM_HITS):
        rays = direction[active]
        triangle = scene.first_hit(origin[active] + start[active, None] * rays, rays)
        active, triangle, rays = active[triangle >= 0], triangle[triangle >= 0], rays[triangle >= 0]
        if len(active) == 0:
            break
        corners = geometry.positions[triangle] - origin[active, None]
        weights, along = barycentric(corners, rays)
        start[active] = np.maximum(along, start[active]) * (1.0 + 4e-6) + 1e-7
        material = geometry.material[triangle]
        solid = two_sided[material] | (np.einsum("nk,nk->n", scene.normals[triangle], rays) < 0.0)
        holed = np.flatnonzero(solid & masked[material])
        if len(holed):
            alpha = base_color(geometry, triangle[holed], weights[holed], np.zeros((len(holed), 2, 2)))[:, 3]
            solid[holed] = alpha >= cutoff[material[holed]]
        found[active[solid]], distance[active[solid]] = triangle[solid], along[solid]
        active = active[~solid]
    return found, distance


def surfaces_met(
    geometry: Geometry, triangle: Indices, point: Floats, direction: Floats, path_m: Floats, width_rad: Floats
) -> Hits:
    """Return the surfaces of triangles (n,) at points (n, 3) that rays of direction (n, 3) meet.

    path_m: (n,) length of the whole way from the camera. width_rad: (n,) angle between the rays of neighbouring pixels.
    Mirrored and refracted bodies are shaded as if a camera at the end of the straightened way saw them.
    """
    side = PIXEL_FILTER * np.tan(np.minimum(width_rad, 0.5))[:, None]
    right = np.cross(direction, [0.0, 1.0, 0.0])
    length = np.linalg.norm(right, axis=-1, keepdims=True)
    right = np.where(length > 1e-6, right / np.maximum(length, 1e-6), [1.0, 0.0, 0.0])
    down = np.cross(direction, right)
    beside = np.stack([direction + side * right, direction + side * down], axis=1)
    beside /= np.linalg.norm(beside, axis=-1, keepdims=True)
    area = np.tile(WHOLE_PIXEL, (len(triangle), 1))
    origin = point - path_m[:, None] * direction
    return surface_along(geometry, triangle, origin, direction, beside, area, PIXEL_FILTER, PI / width_rad)


Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

FARTHEST_M = 1e4
"""Length [m] of the longest ray to the surface."""
_JUMP = 0.1
"""Change of the distance from a pixel to the next, over it, beyond which they show different waves."""
TURNS = 3
"""Side of the square of pixels whose facets differ."""
_PLASTIC = (0.7548776662466927, 0.5698402909980532)
"""Steps of the additive sequence in two dimensions of least discrepancy (1/g and 1/g^2, g^3 = g + 1)."""


@dataclass(frozen=True, slots=True, eq=False)
class SeenSurface:
    """The surface in n pixels.

    direction: (n, 3) of the pixels' centres. distance_m: (n,), infinity where they do not meet it. normal: (n, 3), up.
    turn: (n, 2, 3) change of the normal to the next column and row. lost: (n, 3) covariance xx, xz, zz of the slopes
    that are smaller than a pixel.
    """

    direction: Array
    distance_m: Array
    normal: Array
    turn: Array
    lost: Array

    def of(self, chosen: Mask | Indices | slice) -> SeenSurface:
        """Return some of the pixels."""
        return SeenSurface(*(getattr(self, name)[chosen] for name in self.__slots__))


def cast(sides: WaterSides, x: Floats, y: Floats, width: float) -> SeenSurface:
    """Return the surface along rays of frame coordinates (n,), as means over `width` pixels; turns are zero."""
    view, sea = sides.wet.view, sides.sea
    direction = np.ascontiguousarray(view.directions(x, y), np.float64)
    origin = np.empty_like(direction)
    origin[:] = view.position[0], sides.camera_over_m, view.position[2]
    count = len(direction)
    hits = first_hits(
        sea, origin, direction, sides.in_water, np.zeros(count), np.full(count, view.pixel_rad * width),
        np.full(count, FARTHEST_M),
    )  # fmt: skip
    normal, rippled = sea.with_ripples(hits.normal, hits.rest, hits.sigma_m)
    lost = sea.unresolved(hits.level) + rippled[:, None] * np.array([1.0, 0.0, 1.0])
    return SeenSurface(direction, hits.distance, normal, np.zeros((count, 2, 3)), lost)


def see_surface(sides: WaterSides, where: Mask) -> tuple[Indices, Indices, SeenSurface]:
    """Return the rows and columns of marked pixels (H, W) that meet the surface, and the surface there."""
    beside = where | np.roll(where, 1, axis=1) | np.roll(where, -1, axis=1)
    beside[1:] |= where[:-1]
    beside[:-1] |= where[1:]
    rows, columns = np.nonzero(beside)
    seen = cast(sides, columns + 0.5, rows + 0.5, 1.0)
    number = np.full(where.shape, -1, np.int32)
    number[rows, columns] = np.arange(len(rows))
    kept = where[rows, columns] & np.isfinite(seen.distance_m)
    rows, columns = rows[kept], columns[kept]
    middle = seen.of(kept)
    height, width = where.shape
    across = number[rows, (columns - 1) % width], number[rows, (columns + 1) % width]
    down = number[np.maximum(rows - 1, 0), columns], number[np.minimum(rows + 1, height - 1), columns]
    for axis, (before, after) in enumerate((across, down)):
        near = [np.abs(seen.distance_m[k] / middle.distance_m - 1.0) < _JUMP for k in (before, after)]
        first = np.where(near[0][:, None], seen.normal[before], middle.normal)
        last = np.where(near[1][:, None], seen.normal[after], middle.normal)
        middle.turn[:, axis] = (last - first) / np.maximum(near[0].astype(np.int64) + near[1], 1)[:, None]
    return rows, columns, middle


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceSamples:
    """s rays in each of n pixels. direction, point, normal: (n, s, 3); points on the surface, from the camera [m];
    normals of facets. distance_m: (n, s). weight: (n, s) of facets, as the camera sees them.
    """

    direction: Array
    distance_m: Array
    point: Array
    normal: Array
    weight: Array

    def sent_on(self, relative_index: float, *, in_water: bool) -> tuple[Array, Array, Array]:
        """Return the directions (n, s, 3) of mirrored and of refracted rays, and the cosine (n, s) of incidence."""
        against = -self.normal if in_water else self.normal
        cosine = np.clip(-np.einsum("nsk,nsk->ns", self.direction, against), 0.0, 1.0)
        bent = np.asarray(refract_clamped(self.direction, against, 1.0 / relative_index), np.float64)
        bent /= np.maximum(np.linalg.norm(bent, axis=-1, keepdims=True), 1e-12)
        return reflect(self.direction, against), bent, cosine


def sample_surface(
    sides: WaterSides, rows: Indices, columns: Indices, seen: SeenSurface, samples: Pattern
) -> SurfaceSamples:
    """Return the rays of pixels (n,) and the facets of the surface that they meet."""
    place = samples.positions
    seen_at = columns[:, None] + place[:, 0], rows[:, None] + place[:, 1]
    direction = np.asarray(sides.wet.view.directions(*seen_at), np.float64)
    off = place - 0.5
    normal = seen.normal[:, None] + np.einsum("sk,nkc->nsc", off, seen.turn)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    height = np.einsum("nk,nk->n", seen.direction, seen.normal) * seen.distance_m
    facing = np.einsum("nsk,nk->ns", direction, seen.normal)
    away = height[:, None] / np.where(np.abs(facing) > 1e-9, facing, np.inf)
    away = np.clip(away, 0.5 * seen.distance_m[:, None], 2.0 * seen.distance_m[:, None])
    point = away[..., None] * direction
    count = samples.count
    lost = np.repeat(seen.lost, count, axis=0)
    facets = FacetsOfRays(direction.reshape(-1, 3), normal.reshape(-1, 3), lost, sides.in_water)
    # pairs of independent normal numbers that fill the plane evenly, other ones for each of `TURNS` squared neighbours
    number = (columns % TURNS + TURNS * (rows % TURNS))[:, None] + TURNS * TURNS * np.arange(count)
    step = np.arange(TURNS * TURNS * count)[:, None] + 0.5
    drawn = ndtri(np.remainder(0.5 + step * np.array(_PLASTIC), 1.0))[number].reshape(-1, 2)
    slope = facets.at(drawn)
    seen_as = np.maximum(facets.facing(slope), 0.0).reshape(-1, count)
    shape = direction.shape
    return SurfaceSamples(direction, away, point, normal_of(slope).reshape(shape), seen_as)
