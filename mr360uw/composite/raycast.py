# SPDX-License-Identifier: Apache-2.0
"""Camera-centred triangles of a shot, and the surface at the intersection of a ray: normals, material, footprint.

A footprint is the area of a surface that a pixel shows. A shadow's edge may be narrower than a pixel. Its mean over the
pixel is the mean over rays that start from the whole footprint, a parallelogram in the plane of the surface. Its sides
come from the derivatives of the visible point P by the frame coordinates, taken as differences over a step s:

    side_k = dP/dx m_xk + dP/dy m_yk        dP/dx = (P(x + s, y) - P(x, y))/s

with m the symmetric matrix (2, 2) of an area in the frame (see sampling.py); the unit matrix is a whole pixel. On the
device: light_visibility.py.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.cache import Same
from mr360uw.base.constants import LONGEST_FOOTPRINT
from mr360uw.base.rays import RayScene, barycentric
from mr360uw.composite.mesh.material import Material, Texture, texture_lookup
from mr360uw.composite.mesh.mesh import Mesh
from mr360uw.composite.shot import PlacedObject
from mr360uw.types import Floats, View

MAXIMUM_HITS = 64
"""Surfaces that one ray passes through at most; what lies behind that many is not drawn."""
LARGEST_CHANGE = 1.0
"""Most that a normal is taken to change over a pixel: at a silhouette the next pixel does not show the triangle's
plane."""


@dataclass(frozen=True, eq=False)
class Geometry:
    """Triangles of several objects, one array each (T, ...); positions from the camera, axes of the world.

    more_uv: (T, 3, m, 2), m the most of any object. object, material, patch: indices, unique in the whole shot;
    `material` is an index into `materials`.
    """

    positions: Floats
    normals: Floats
    uv: Floats
    more_uv: Floats
    colors: Floats
    object: NDArray[np.int64]
    material: NDArray[np.int64]
    patch: NDArray[np.int64]
    materials: tuple[Material, ...]

    @cached_property
    def scene(self) -> RayScene:
        """The triangles for rays, made when it is first asked for."""
        return RayScene(self.positions)

    def some(self, triangles: NDArray[np.int64]) -> Geometry:
        """Return some of the triangles, with all materials."""
        arrays = {field.name: getattr(self, field.name) for field in fields(self) if field.name != "materials"}
        return Geometry(**{name: array[triangles] for name, array in arrays.items()}, materials=self.materials)


def gather(objects: Sequence[PlacedObject], camera_position: Floats) -> Geometry:
    """Return the triangles of objects in world axes, from the camera."""
    further, number = max((placed.mesh.more_uv.shape[2] for placed in objects), default=0), np.zeros(0, np.int64)
    found: list[tuple[NDArray[Any], ...]] = [
        (*np.zeros((2, 0, 3, 3)), np.zeros((0, 3, 2)), np.zeros((0, 3, further, 2)), np.zeros((0, 3, 4)), *[number] * 3)
    ]
    materials: list[Material] = []
    patches = 0
    for index, placed in enumerate(objects):
        mesh, linear = placed.mesh, placed.world_from_object[:3, :3]
        more_uv = np.pad(mesh.more_uv, ((0, 0), (0, 0), (0, further - mesh.more_uv.shape[2]), (0, 0)))
        numbers = np.full(len(mesh.positions), index), mesh.material + len(materials), mesh.patch + patches
        positions, normals = placed.triangles - camera_position, mesh.normals @ linear.T / placed.scale
        found.append((positions, normals, mesh.uv, more_uv, mesh.colors, *(n.astype(np.int64) for n in numbers)))
        materials += mesh.materials
        patches += int(mesh.patch.max()) + 1
    columns: list[Any] = [np.concatenate(column) for column in zip(*found, strict=True)]
    return Geometry(*[*columns, tuple(materials)])


@dataclass(frozen=True, slots=True, eq=False)
class Hits:
    """Surfaces at the intersections of n rays and triangles.

    triangle, object: indices. weights: (n, 3) barycentric. behind: hit from the back. point: (n, 3) [m] from the
    camera. distance_m, direction: of the ray. geometric_normal, normal: unit, on the camera's side; the second is
    interpolated and bumped by the normal map. base: (n, 3) linear, alpha: (n,). footprint_m: width of the textures'
    filter at that distance. normal_change: (n, 2, 3) of the interpolated normal over a pixel, along its columns and
    rows. area_middle: (n, 3), area_sides: (n, 2, 3) [m] of the parallelogram over which shadows are averaged.
    """

    triangle: NDArray[np.int64]
    object: NDArray[np.int64]
    weights: Floats
    behind: NDArray[np.bool_]
    point: Floats
    distance_m: Floats
    direction: Floats
    geometric_normal: Floats
    normal: Floats
    base: Floats
    alpha: Floats
    metallic: Floats
    roughness: Floats
    emission: Floats
    occlusion: Floats
    refractive_index: Floats
    trim: Floats
    footprint_m: Floats
    normal_change: Floats
    area_middle: Floats
    area_sides: Floats


def base_color(geometry: Geometry, triangle: NDArray[np.int64], weights: Floats, level_scale: Floats) -> Floats:
    """Return the base colour (n, 4), factor x vertex colour x map, at barycentric weights (n, 3).

    level_scale: (n, 2, 2) changes of (u, v) from a pixel to the next, along both axes.
    """
    uv = np.einsum("nc,nck->nk", weights, geometry.uv[triangle])
    color = np.einsum("nc,nck->nk", weights, geometry.colors[triangle])
    for number, material in enumerate(geometry.materials):
        of = np.flatnonzero(geometry.material[triangle] == number)
        color[of] *= material.base_color
        if material.base_map is not None:
            color[of] *= _texels(material.base_map, (uv, level_scale), of)
    return color


def opacity(geometry: Geometry, triangle: NDArray[np.int64], weights: Floats) -> Floats:
    """Return the fraction (n,) of light that triangles block at barycentric weights (n, 3): all where a material is
    OPAQUE or its mask closed, alpha where it is BLEND. Maps are read at their finest level: a ray has no width.
    """
    blocked, materials = np.ones(len(triangle)), geometry.material[triangle]
    partial = np.flatnonzero(np.array([m.alpha_mode != "OPAQUE" for m in geometry.materials], np.bool_)[materials])
    alpha = base_color(geometry, triangle[partial], weights[partial], np.zeros((len(partial), 2, 2)))[:, 3]
    least = np.array([m.alpha_cutoff if m.alpha_mode == "MASK" else np.nan for m in geometry.materials])
    cutoff = least[materials[partial]]
    blocked[partial] = np.where(np.isnan(cutoff), np.clip(alpha, 0.0, 1.0), alpha >= cutoff)
    return blocked


def opacity_key(mesh: Mesh) -> tuple[object, ...]:
    """Return what decides `opacity` on a mesh's triangles, as a part of a cache's key."""
    modes = tuple(m.alpha_mode for m in mesh.materials)
    if set(modes) <= {"OPAQUE"}:
        return modes
    alphas = tuple((m.alpha_cutoff, m.base_color[3], Same(m.base_map)) for m in mesh.materials)
    return modes, alphas, Same(mesh.uv), Same(mesh.colors)


class MetSurfaces(NamedTuple):
    """Surfaces that rays meet, (m,) each: number of the ray and of the triangle; start: (m, 3) from where the ray meets
    it first, gone: the distance to there from its own start; part: fraction of the ray's light that is blocked.
    """

    ray: NDArray[np.int64]
    triangle: NDArray[np.int64]
    start: Floats
    gone: Floats
    part: Floats


_MOST_SURFACES, _DARK = 64, 1e-4
"""Surfaces that a ray meets at most, and the fraction of its light below which it is not followed further."""


def surfaces_along(
    geometry: Geometry, origins: Floats, directions: Floats, least: float, reach_m: Floats | float = np.inf
) -> MetSurfaces:
    """Return what rays (n, 3) meet of the triangles of a geometry: the first, and those behind surfaces that let light
    through. least: length of the shortest step behind one. reach_m: (n,), or a number, how far they go.
    """
    scene = geometry.scene
    start = np.asarray(origins, np.float64)
    # Rays of no end among opaque surfaces meet the first alone
    if np.all(np.isinf(reach_m)) and all(m.alpha_mode == "OPAQUE" for m in geometry.materials):
        triangle = scene.first_hit(start, directions)
        ray = np.flatnonzero(triangle >= 0)
        return MetSurfaces(ray, triangle[ray], start[ray], np.zeros(len(ray)), np.ones(len(ray)))
    # Others are followed from one to the next
    ray, left, gone = np.arange(len(origins)), np.ones(len(origins)), np.zeros(len(origins))
    reach = np.broadcast_to(reach_m, len(origins))
    found = [MetSurfaces(ray[:0], ray[:0], start[:0], gone[:0], left[:0])]
    for _ in range(_MOST_SURFACES):
        triangle = scene.first_hit(start, directions[ray])
        hit = np.flatnonzero(triangle >= 0)
        ray, start, triangle = ray[hit], start[hit], triangle[hit]
        weights, distance = barycentric(geometry.positions[triangle] - start[:, None], directions[ray])
        near = np.flatnonzero(gone[ray] + distance < reach[ray])
        ray, start, triangle, distance = ray[near], start[near], triangle[near], distance[near]
        part = left[ray] * opacity(geometry, triangle, weights[near])
        found.append(MetSurfaces(ray, triangle, start, gone[ray], part))
        left[ray] -= part
        onwards = np.maximum(distance, 0.0) * (1.0 + 4e-6) + least
        gone[ray] += onwards
        on = np.flatnonzero(left[ray] > _DARK)
        ray, start = ray[on], start[on] + onwards[on, None] * directions[ray[on]]
        if len(ray) == 0:
            break
    return MetSurfaces(*(np.concatenate(column) for column in zip(*found, strict=True)))


def next_surfaces(
    geometry: Geometry,
    rays: tuple[Floats, Floats],
    active: NDArray[np.int64],
    behind_m: Floats,
    uv_change_of: Callable[[NDArray[np.int64], Floats, NDArray[np.int64], Floats], Floats] | None = None,
) -> tuple[NDArray[np.int64], NDArray[np.int64], Floats, NDArray[np.bool_]]:
    """Return those of the active rays (m,) that meet a triangle behind what they met before, its number, its distance
    [m], and whether it is seen there: not where it is the back of a one-sided material, or masked out.

    rays: origins and directions (n, 3) of all. behind_m: (n,) from where on each is followed, which moves behind what
    it meets. uv_change_of: returns the change (k, 2, 2) of (u, v) over a pixel at which masks are read, of numbers of
    rays, corners, triangles and weights; None for their finest level.
    """
    # Find the next triangle of each
    origin, direction = (a[active] for a in rays)
    triangle = geometry.scene.first_hit(origin + behind_m[active, None] * direction, direction)
    hit = triangle >= 0
    active, triangle, origin, direction = active[hit], triangle[hit], origin[hit], direction[hit]
    corners = geometry.positions[triangle] - origin[:, None]
    weights, distance = barycentric(corners, direction)
    behind_m[active] = np.maximum(distance, behind_m[active]) * (1.0 + 4e-6) + 1e-7
    # Let rays through backs of one-sided faces and texels that are masked out
    material = geometry.material[triangle]
    two_sided = np.array([m.double_sided for m in geometry.materials], np.bool_)[material]
    masked = np.array([m.alpha_mode == "MASK" for m in geometry.materials], np.bool_)[material]
    solid = two_sided | (np.sum(geometry.scene.normals[triangle] * direction, -1) < 0.0)
    holed = np.flatnonzero(solid & masked)
    if len(holed):
        of = active[holed], corners[holed], triangle[holed], weights[holed]
        change = np.zeros((len(holed), 2, 2)) if uv_change_of is None else uv_change_of(*of)
        cutoff = np.array([m.alpha_cutoff for m in geometry.materials])[material[holed]]
        solid[holed] = base_color(geometry, of[2], of[3], change)[:, 3] >= cutoff
    return active, triangle, distance, solid


_Places = tuple[Floats, Floats]
"""Where n pixels lie on a map: (u, v), (n, 2), and its change (n, 2, 2) over a pixel, see `uv_change`."""


def _texels(texture: Texture, places: _Places, some: NDArray[np.int64]) -> Floats:
    """Return the values (m, 4) of a map at some of n pixels."""
    uv, change = (values[some] for values in places)
    return texture_lookup(texture, uv, change[:, 0], change[:, 1])


def weights_beside(triangles: Floats, neighbours: Floats) -> list[Floats]:
    """Return the barycentric weights (n, 3) at which the rays (n, 2, 3) of the next column and row meet planes."""
    return [barycentric(triangles, neighbours[:, k])[0] for k in range(2)]


def uv_change(uv: Floats, weights: Floats, beside: Sequence[Floats]) -> Floats:
    """Return the change (n, 2, 2) of (u, v) from weights (n, 3) to those of `weights_beside`."""
    here = np.einsum("nc,nck->nk", weights, uv)
    change = np.stack([np.einsum("nc,nck->nk", there, uv) - here for there in beside], axis=1)
    # a neighbour beyond the plane's horizon has no hit: use the coarsest level
    return np.where(np.isfinite(change), np.clip(change, -1e3, 1e3), 1e3)


def normal_change(normals: Floats, normal: Floats, beside: Sequence[Floats]) -> Floats:
    """Return the change (n, 2, 3) over a pixel of interpolated unit normals (n, 3), along its columns and rows.

    normals: (n, 3, 3) of the corners. beside: of `weights_beside`, half a pixel away: as the textures' filter.
    """
    change = np.empty((len(normal), 2, 3))
    for k, weights in enumerate(beside):
        there = np.einsum("nc,nck->nk", weights, normals)
        change[:, k] = 2.0 * (there / np.maximum(np.linalg.norm(there, axis=-1, keepdims=True), 1e-12) - normal)
    size = np.linalg.norm(change, axis=-1, keepdims=True)
    return change * np.minimum(1.0, LARGEST_CHANGE / np.maximum(size, 1e-12))


def surface(
    geometry: Geometry,
    triangle: NDArray[np.int64],
    rays: tuple[Floats, Floats, Floats],
    area: Floats,
    pixel: float,
    height: Floats | int,
) -> Hits:
    """Return the surfaces (n,) that rays meet on given triangles.

    rays: their origins (n, 3) from the camera [m], directions (n, 3), and those (n, 2, 3) `pixel` pixels to the right
    and below, in a frame of `height` rows, a number or (n,). area: (n, 5) of the frame that each represents
    (`sampling.frame_areas`). pixel: filter width of textures [pixels].
    """
    # Find where rays meet their triangles, and their places on the maps
    origin, direction, neighbours = rays
    corners = geometry.positions[triangle] - origin[:, None]
    weights, distance = barycentric(corners, direction)
    beside = weights_beside(corners, neighbours)
    of_sets = geometry.uv[triangle], *np.moveaxis(geometry.more_uv[triangle], 2, 0)
    places = [(np.einsum("nc,nck->nk", weights, uv), uv_change(uv, weights, beside)) for uv in of_sets]
    color = base_color(geometry, triangle, weights, places[0][1])
    # Turn the normals to the camera: the flat one, and the smooth one of the corners
    e1, e2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    flat = np.cross(e1, e2)
    flat /= np.linalg.norm(flat, axis=-1, keepdims=True)
    side = -np.sign(np.sum(flat * direction, -1, keepdims=True))
    point = distance[:, None] * direction
    normal = np.einsum("nc,nck->nk", weights, geometry.normals[triangle])
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
    turning = normal_change(geometry.normals[triangle], normal, beside)
    # Read the maps; those of normals change the smooth one
    values = _material_values(geometry, triangle, places)
    for number, material in enumerate(geometry.materials):
        if material.normal_map is not None:
            of, on_normal = np.flatnonzero(geometry.material[triangle] == number), material.sets[2]
            bump = 2.0 * _texels(material.normal_map, places[on_normal], of)[:, :3] - 1.0
            bump[:, :2] *= material.normal_scale
            normal[of] = bumped(normal[of], e1[of], e2[of], of_sets[on_normal][of], bump)
    # Measure the part of the surface that a pixel covers
    area_middle, area_sides = footprint(origin + point, pixel_steps(point, flat, neighbours, pixel), area)
    return Hits(
        triangle=triangle,
        object=geometry.object[triangle],
        weights=weights,
        behind=side[:, 0] < 0.0,
        point=origin + point,
        distance_m=distance,
        direction=direction,
        geometric_normal=flat * side,
        normal=normal * side,
        base=color[:, :3],
        alpha=color[:, 3],
        trim=np.array([material.trim for material in geometry.materials])[geometry.material[triangle]],
        **values,
        footprint_m=distance * np.pi / height * pixel,
        normal_change=turning * side[..., None],
        area_middle=area_middle,
        area_sides=area_sides,
    )


def _material_values(geometry: Geometry, triangle: NDArray[np.int64], places: Sequence[_Places]) -> dict[str, Floats]:
    """Return metallic, roughness, occlusion and refractive_index, each (n,), and emission (n, 3), as `Hits` names them.
    places: of each set of texture coordinates.
    """
    (metallic, roughness, occlusion, index), emission = np.empty((4, len(triangle))), np.empty((len(triangle), 3))
    for number, material in enumerate(geometry.materials):
        of = np.flatnonzero(geometry.material[triangle] == number)
        _, on_metallic_roughness, _, on_occlusion, on_emission = (places[n] for n in material.sets)
        metallic[of], roughness[of], occlusion[of] = material.metallic, material.roughness, 1.0
        index[of], emission[of] = material.refractive_index, material.emission
        if material.metallic_roughness_map is not None:
            texel = _texels(material.metallic_roughness_map, on_metallic_roughness, of)
            metallic[of], roughness[of] = metallic[of] * texel[:, 2], roughness[of] * texel[:, 1]
        if material.occlusion_map is not None:
            texel = _texels(material.occlusion_map, on_occlusion, of)
            occlusion[of] = 1.0 + material.occlusion_strength * (texel[:, 0] - 1.0)
        if material.emission_map is not None:
            emission[of] *= _texels(material.emission_map, on_emission, of)[:, :3]
    both = {"metallic": metallic, "roughness": roughness, "occlusion": occlusion}
    return both | {"refractive_index": index, "emission": emission}


def bumped(normal: Floats, e1: Floats, e2: Floats, uv: Floats, bump: Floats) -> Floats:
    """Return unit normals (n, 3) turned by a tangent space normal (n, 3) whose y points up the image.

    The tangents are those of the triangle's own texture coordinates (n, 3, 2), made perpendicular to the normal.
    """
    d1, d2 = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    determinant = (d1[:, 0] * d2[:, 1] - d2[:, 0] * d1[:, 1])[:, None]
    sign = np.sign(determinant)
    tangent = sign * (e1 * d2[:, 1:] - e2 * d1[:, 1:])
    up = -sign * (e2 * d1[:, :1] - e1 * d2[:, :1])
    tangent = tangent - normal * np.sum(normal * tangent, -1, keepdims=True)
    up = up - normal * np.sum(normal * up, -1, keepdims=True)
    tangent = tangent / np.maximum(np.linalg.norm(tangent, axis=-1, keepdims=True), 1e-20)
    up = up / np.maximum(np.linalg.norm(up, axis=-1, keepdims=True), 1e-20)
    turned = bump[:, :1] * tangent + bump[:, 1:2] * up + bump[:, 2:] * normal
    length = np.linalg.norm(turned, axis=-1, keepdims=True)
    return np.where(length > 1e-6, turned / np.maximum(length, 1e-6), normal)


def pixel_steps(point: Floats, normal: Floats, neighbours: Floats, step: float) -> Floats:
    """Return the derivatives (n, 2, 3) [m] of points (n, 3) on planes by the frame's columns and rows.

    neighbours: (n, 2, 3) directions that lie `step` pixels to the right and below. On slanted planes a derivative is at
    most `LONGEST_FOOTPRINT` times as long as across the ray; beyond the plane's horizon it is the one across the ray.
    """
    distance = np.linalg.norm(point, axis=-1)[:, None, None]
    cosine, height = (np.einsum("nk,n...k->n...", normal, a) for a in (neighbours, point))
    along = height[:, None] / np.where(np.abs(cosine) > 1e-6, cosine, np.inf)
    flat = neighbours * distance - point[:, None]
    slanted = neighbours * along[..., None] - point[:, None]
    longest = LONGEST_FOOTPRINT * np.linalg.norm(flat, axis=-1)
    shorter = np.minimum(longest / np.maximum(np.linalg.norm(slanted, axis=-1), 1e-30), 1.0)
    steps = np.where(along[..., None] > 0.0, slanted * shorter[..., None], flat)
    return np.asarray(steps / step)


def pixel_footprint(view: View, x: Floats, y: Floats, point: Floats, normal: Floats, area: Floats) -> Floats:
    """Return the sides (n, 2, 3) [m] of the footprints of areas (n, 5) of the frame about frame coordinates (n,).

    point, normal: (n, 3) of the surface seen there.
    """
    neighbours = np.stack([view.directions(x + 1.0, y), view.directions(x, y + 1.0)], axis=1)
    seen = point - view.starts(view.directions(x, y)) if view.eye_m else point
    return footprint(point, pixel_steps(seen, normal, neighbours, 1.0), area)[1]


def footprint(point: Floats, steps: Floats, area: Floats) -> tuple[Floats, Floats]:
    """Return the middles (n, 3) and the sides (n, 2, 3) [m] of the parallelograms that areas (n, 5) of the frame
    (`sampling.frame_areas`) have about points (n, 3), from the camera in the world's axes.

    steps: (n, 2, 3) of `pixel_steps`.
    """
    x, y = steps[:, 0], steps[:, 1]
    ox, oy, xx, xy, yy = area.T[..., None]
    return point + ox * x + oy * y, np.stack([xx * x + xy * y, xy * x + yy * y], axis=1)
