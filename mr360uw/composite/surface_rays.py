# SPDX-License-Identifier: Apache-2.0
"""The moving surface as the pixels of a frame see it: one ray a pixel, how the surface turns from pixel to pixel, and
the light on its two sides.

The surface is smooth at the size of a pixel's footprint, by which it is filtered: rays between the centres meet the
tangent plane, with a normal that changes linearly. Waves smaller than the footprint are facets (`surface.slopes`),
drawn from a fixed set of slopes. Rays that the surface sends on end at the first solid surface of a body.

Pixels in which the moving surface can show a body are found on a coarse grid of rays. One ray a cell meets the surface,
filtered to the size of the cell. A body is in reach where the mirrored or refracted ray comes within a ball around a
part of it, widened by `_DEVIATIONS` standard deviations of what the waves that the filter took turn such rays by.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from mr360uw.base.constants import PI
from mr360uw.base.optics import fresnel_transmittance, reflect, refract_clamped, refract_to_air, refract_to_water
from mr360uw.base.sphere import directions
from mr360uw.composite.light_sources import sun_of, sun_up
from mr360uw.composite.raycast import MAXIMUM_HITS, Geometry, Hits, next_surfaces, surface
from mr360uw.composite.sampling import PIXEL_FILTER, WHOLE_PIXEL, Pattern
from mr360uw.composite.shading import veil_ahead, water_ahead
from mr360uw.composite.shot import FAINTEST, PlacedObject, Shot
from mr360uw.ibl.lighting import assemble
from mr360uw.ibl.lookup import environment_lookup
from mr360uw.ibl.plate import COARSE_COLUMNS, COARSE_ROWS
from mr360uw.medium.lookup import ambient_ratio, beam_ratio, transmittance_lookup
from mr360uw.surface.facet_draws import facets_at
from mr360uw.surface.intersection import first_hits
from mr360uw.surface.sampled_sea import SampledSea
from mr360uw.types import Floats, Light, MediumTable, Sun

Indices = NDArray[np.int64]


def first_surfaces(geometry: Geometry, origin: Floats, direction: Floats) -> tuple[Indices, Floats]:
    """Return the triangle (n,) that each ray meets first, -1 for none, and the distance (n,) [m], infinity for none.

    origin, direction: (n, 3), from the camera. Rays pass through back faces of one-sided materials, and through masks
    where they are open; masks are read at their finest level.
    """
    found, distance = np.full(len(origin), -1, np.int64), np.full(len(origin), np.inf)
    active, behind_m = np.arange(len(origin)), np.zeros(len(origin))
    for _ in range(MAXIMUM_HITS):
        active, triangle, along, solid = next_surfaces(geometry, (origin, direction), active, behind_m)
        if len(active) == 0:
            break
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
    return surface(geometry, triangle, (origin, direction, beside), area, PIXEL_FILTER, PI / width_rad)


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
    # pairs of independent normal numbers that fill the plane evenly, other ones for each of `TURNS` squared neighbours
    number = (columns % TURNS + TURNS * (rows % TURNS))[:, None] + TURNS * TURNS * np.arange(count)
    step = np.arange(TURNS * TURNS * count)[:, None] + 0.5
    drawn = ndtri(np.remainder(0.5 + step * np.array(_PLASTIC), 1.0))[number].reshape(-1, 2)
    facet, seen_as = facets_at(direction.reshape(-1, 3), normal.reshape(-1, 3), lost, sides.in_water, drawn)
    return SurfaceSamples(direction, away, point, facet.reshape(direction.shape), seen_as.reshape(-1, count))


_CELLS = 128
"""Rows of the coarse grid."""
_DEVIATIONS = 2.7
"""Standard deviations of slopes along their steeper axis that are looked for: images are fainter than a code value
beyond."""
_LENGTHS_M = np.geomspace(0.01, 1e4, 400)
"""Lengths [m] among which the farthest path is looked up, 4 % apart."""
_MOST_PARTS = 8
"""Balls along the longest side of a body."""
_MIRRORED, _LEAST_BENT, _MOST_BENT = 2.0, 0.5, 3.0
"""Turn of a ray over that of the facet: of mirrored rays exactly, of refracted ones at the least and at the most, which
is reached 5 degrees from the edge of Snell's window."""


def balls_around(objects: tuple[PlacedObject, ...]) -> tuple[Floats, Floats]:
    """Return centres (m, 3) in the world and radii (m,) [m] of balls that hold the bodies."""
    centres: list[Floats] = [np.zeros((0, 3))]
    radii: list[Floats] = [np.zeros(0)]
    for placed in objects:
        extent, axis = placed.mesh.extent_m, int(np.argmax(placed.mesh.extent_m))
        across = np.linalg.norm(np.delete(extent, axis))
        parts = int(np.clip(np.ceil(extent[axis] / max(float(across), 1e-9)), 1, _MOST_PARTS))
        middle = np.tile(placed.mesh.center_m, (parts, 1))
        middle[:, axis] += extent[axis] * ((np.arange(parts) + 0.5) / parts - 0.5)
        centres.append(placed.to_world(middle))
        radius = placed.mesh.radius_m if parts == 1 else 0.5 * np.hypot(across, extent[axis] / parts)
        radii.append(np.full(parts, placed.scale * radius))
    return np.concatenate(centres), np.concatenate(radii)


def find_reach(sides: WaterSides, objects: tuple[PlacedObject, ...]) -> Mask:
    """Return the pixels (2, H, W) that can show a body mirrored in the surface, and refracted through it."""
    view = sides.wet.view
    step = max(view.height // _CELLS, 1)
    rows, columns = -(-view.height // step), -(-view.width // step)
    y, x = (k.ravel() for k in np.mgrid[0:rows, 0:columns] * step + 0.5 * step)
    sign = 1.0 if sides.in_water else -1.0
    towards = sign * view.directions(x, y)[:, 1] > -PI * step / view.height
    at = np.flatnonzero(towards)
    seen = cast(sides, x[at], y[at], float(step))
    met = np.isfinite(seen.distance_m)
    at, seen = at[met], seen.of(met)
    found = np.zeros((2, rows * columns), bool)
    if len(at):
        found[:, at] = in_reach(sides, seen, *balls_around(objects), PI * step / view.height)
    return np.stack([_pixels(one.reshape(rows, columns), step)[: view.height, : view.width] for one in found])


def in_reach(sides: WaterSides, seen: SeenSurface, centres: Floats, radii: Floats, cell_rad: float) -> Mask:
    """Return whether (2, n) rays, each for a cell of an angle, are in reach of a ball (m,), mirrored and refracted."""
    view, m = sides.wet.view, sides.relative_index
    against = -seen.normal if sides.in_water else seen.normal
    point = seen.distance_m[:, None] * seen.direction
    xx, xz, zz = seen.lost.T
    variance = 0.5 * (xx + zz) + np.hypot(0.5 * (xx - zz), xz)  # along the steeper axis
    spread = _DEVIATIONS * np.sqrt(np.maximum(variance, 0.0))
    mirrored, bent = reflect(seen.direction, against), refract_clamped(seen.direction, against, 1.0 / m)
    to = centres - view.position - point[:, None]  # (n, m, 3)
    away = np.linalg.norm(to, axis=-1)
    # neighbouring rays part all the way from the camera: seen from the surface a cell is wider than from there
    cell = cell_rad * (1.0 + seen.distance_m[:, None] / np.maximum(away, 1e-9))
    size = np.arcsin(np.clip(radii / np.maximum(away, 1e-9), 0.0, 1.0)) + 2.0 * cell
    over, nearest = centres[:, 1] - view.surface_y_m, np.maximum(away - radii, 0.0)
    wet, dry = over - radii < sides.sea.highest_m, over + radii > sides.sea.lowest_m
    first = np.broadcast_to(seen.distance_m[:, None] if sides.in_water else 0.0, away.shape)
    farthest_m = _farthest_m(sides.wet.medium)
    bends, passes = _bending(seen.direction, against, m, spread)
    found = []
    for ray, wide, in_same in ((mirrored, _MIRRORED * spread, True), (bent, bends * spread, False)):
        body_is_wet = in_same == sides.in_water
        cosine = np.einsum("nk,nmk->nm", ray, to) / np.maximum(away, 1e-9)
        near = np.arccos(np.clip(cosine, -1.0, 1.0)) < size + wide[:, None]
        seen_there = (near | (away < radii)) & (wet if body_is_wet else dry)
        seen_there &= (first + nearest if body_is_wet else first) < farthest_m
        found.append(np.any(seen_there, axis=1) & (in_same | passes))
    return np.stack(found)


def _farthest_m(medium: MediumTable | None) -> float:
    """Return the length [m] of a level path in water that leaves `FAINTEST` of the light; infinity without water."""
    if medium is None:
        return np.inf
    left = transmittance_lookup(medium, _LENGTHS_M, 0.0).max(axis=-1)
    return float(_LENGTHS_M[np.argmin(left > FAINTEST)]) if left[-1] <= FAINTEST else np.inf


def _bending(travel: Floats, against: Floats, m: float, spread: Floats) -> tuple[Floats, Mask]:
    """Return the turn (n,) of refracted rays over that of facets, cos/(m cos') - 1, within `spread` (n,) [rad] of the
    mean facet, and whether any facet lets light pass.
    """
    angle = np.arccos(np.clip(-np.einsum("nk,nk->n", travel, against), 0.0, 1.0))
    steeper = np.minimum(angle + spread, 0.5 * PI)
    behind = np.sqrt(np.maximum(1.0 - (np.sin(steeper) / m) ** 2, 0.0))
    turn = np.abs(np.cos(steeper) / np.maximum(m * behind, 1e-6) - 1.0)
    turn = np.where(behind > 0.0, turn, _MOST_BENT)
    return np.clip(turn, _LEAST_BENT, _MOST_BENT), np.sin(np.maximum(angle - spread, 0.0)) < m


def _pixels(cells: Mask, step: int) -> Mask:
    """Return the pixels of marked cells and of those beside them."""
    wide = cells | np.roll(cells, 1, axis=1) | np.roll(cells, -1, axis=1)
    tall = wide.copy()
    tall[1:] |= wide[:-1]
    tall[:-1] |= wide[1:]
    return np.repeat(np.repeat(tall, step, axis=0), step, axis=1)


# --- The two sides of the surface -----------------------------------------------------------------------------------

# The two sides of the moving surface of a shot: the light of each, the water between them and the camera.
#
# What stands out of the water above an underwater plate is lit by the sky that the plate shows through the surface:
#
#     symbol  meaning
#     n       refractive index of the water
#     t, R    transmittance and reflectance of a level surface for irradiance (Fresnel), at an angle in the air
#     L_w     radiance just below the surface: the plate's, with what the water above the camera has taken
#
# Radiance over the squared index is kept but for reflection, so the sky is L = (L_w - R D)/(n^2 t), seen in the
# refracted direction, with D the water's light that the surface mirrors there. From below comes R L + t D/n^2. The
# sun's beam has the power per level area that passes the surface, E cos = E_w cos_w/t.


_LOWEST_SUN = 0.05
"""Sine of the sun's elevation in the air below which it gives no light: nearly all of it is reflected."""
_LEAST_PASSED = 0.05
"""Least transmittance that the sky is divided by: at the horizon, where hardly any of its light is left."""


def in_air(shot: Shot) -> Shot:
    """Return a shot of the same bodies in the light of the air, without water and caustics.

    shot: of a camera in the water.
    """
    if shot.medium is None:
        return shot
    sun = _sun_in_air(shot)
    roughness = tuple(shot.environment.glossy_roughness.tolist()) if len(shot.environment.glossy) else ()
    light = assemble(_sky(shot), sun, roughness)
    lamps: tuple[Light, ...] = tuple(one for one in shot.lights if not isinstance(one, Sun))
    lights = lamps if sun is None else (sun, *lamps)
    return replace(shot, environment=light, lights=lights, medium=None, caustics=None, between=None)


def _sky(shot: Shot) -> Floats:
    """Return the radiance (128, 256, 3) of all directions in the air, without the sun."""
    n, medium = shot.refractive_index, shot.medium
    assert medium is not None
    towards = directions(COARSE_COLUMNS, COARSE_ROWS)
    up = towards * np.array([1.0, 0.0, 1.0]) + np.abs(towards) * np.array([0.0, 1.0, 0.0])
    passed = fresnel_transmittance(up[..., 1], n)[..., None]
    below = refract_to_water(up, n)
    at_surface = ambient_ratio(medium, 0.0)
    residual = shot.environment.residual
    deep = environment_lookup(residual, below * np.array([1.0, -1.0, 1.0])) * at_surface
    sent = environment_lookup(residual, below) * at_surface - (1.0 - passed) * deep
    sky = np.maximum(sent, 0.0) / (n * n * np.maximum(passed, _LEAST_PASSED))
    under = (1.0 - passed) * sky + passed * deep / (n * n)
    return np.where(towards[..., 1:2] > 0.0, sky, under).astype(np.float32)


def _sun_in_air(shot: Shot) -> Sun | None:
    sun, n = sun_of(shot), shot.refractive_index
    if sun is None or shot.medium is None:
        return None
    direction = refract_to_air(sun.direction, n)
    if direction[1] < _LOWEST_SUN:
        return None
    below = sun.irradiance * beam_ratio(shot.medium, 0.0, sun_up(sun)) * sun.direction[1]
    irradiance = below / (direction[1] * float(fresnel_transmittance(direction[1], n)))
    return Sun(direction, np.asarray(irradiance, np.float64), sun.half_angle_rad * n, sun.confidence)


@dataclass(frozen=True, slots=True, eq=False)
class WaterSides:
    """What both sides of the surface show to a camera on one of them.

    wet, dry: the shot in the light of the water and of the air; same view, same objects. sea: waves of the instant.
    from_surface: the water's table for rays that start at the surface; None for clear water. in_water: whether the
    camera is below the waves. refractive_index: of the water.
    """

    wet: Shot
    dry: Shot
    sea: SampledSea
    from_surface: MediumTable | None
    in_water: bool
    refractive_index: float

    @property
    def relative_index(self) -> float:
        """Index behind the surface over that on the camera's side."""
        return 1.0 / self.refractive_index if self.in_water else self.refractive_index

    @property
    def camera_over_m(self) -> float:
        """Height [m] of the camera over the mean surface, negative below."""
        return float(self.wet.view.position[1] - self.wet.view.surface_y_m)

    def to_surface(self, distance_m: Floats, direction: Floats) -> tuple[Floats, Floats]:
        """Return transmittance and veil (n, 3) from the camera to the surface."""
        if self.in_water:
            return water_ahead(self.wet, distance_m, direction)
        return np.ones((len(distance_m), 3)), np.zeros((len(distance_m), 3))

    def below_surface(self, distance_m: Floats, direction: Floats) -> tuple[Floats, Floats]:
        """Return transmittance and veil (n, 3) of rays from the surface down into the water."""
        table = self.from_surface
        if table is None:
            return np.ones((len(distance_m), 3)), np.zeros((len(distance_m), 3))
        level = np.stack([direction[:, 0], np.minimum(direction[:, 1], 0.0), direction[:, 2]], axis=-1)
        # a ray that a wave turns up stays in the water until the body
        return transmittance_lookup(table, distance_m, level[:, 1]), veil_ahead(table, distance_m, level)


def camera_in_water(shot: Shot, sea: SampledSea) -> bool:
    """Return whether a shot's camera is below the waves."""
    position = np.asarray(shot.view.position, np.float64)
    return bool(position[1] - shot.view.surface_y_m < sea.heights(position[[0]], position[[2]])[0])


def table_at_surface(camera: MediumTable, unit_camera: MediumTable, unit_surface: MediumTable) -> MediumTable:
    """Return a water's table for rays from the surface with the veil's gain of a frame's table, and its plate's light.

    camera: the frame's. unit_camera, unit_surface: without gain, for the camera's depth and for the surface.
    """
    whole = np.maximum(unit_camera.veil.sum(axis=1), 1e-12)
    gain = camera.veil.sum(axis=1) / whole
    veil = (unit_surface.veil * gain[:, None]).astype(np.float32)
    return replace(unit_surface, veil=veil, plate_ratio=camera.plate_ratio)
