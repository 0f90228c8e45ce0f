# SPDX-License-Identifier: Apache-2.0
"""Directed lights of a shot: the sun, its beam through the water with caustics, and lamps; visibility behind bodies.

The sun:

    E = irradiance beam_ratio(d) (s(d) C + (1 - s(d)) B) V        V = s(d) V_disc + (1 - s(d)) V_halo

with d the depth, C the caustic ratio, B that of the light that has turned by small angles (1 where it is not computed),
s the unscattered fraction of the beam, V_disc the visible fraction of the sun's disc and V_halo that of the wider disc
from which forward-scattered light comes. On the device: sun.glsl.

Lamps: inverse square, attenuated by the water there and back.

    E = I spot(angle) T(r + S)/(r^2 T_object(S)) V

with I the intensity, r the distance from the lamp, S that from the camera, T the transmittance of the water for the
lamp's own spectrum over the whole path, and T_object the transmittance that shading applies to everything on the way to
the camera. Attenuation depends on the light already lost, so the way there and the way back are taken as one path. V is
the visible fraction of the luminous ball. On the device: lamps.glsl.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.cache import Cache, PartOf, Same
from mr360uw.base.caustic_lookup import (
    along_beam,
    caustic_lookup,
    levels_of,
    mean_slopes,
    mip_level,
    periodic_trilinear,
    soft_caustic_lookup,
)
from mr360uw.base.constants import MINIMUM_SUN_UP
from mr360uw.base.rays import PlacedScene, RayScene
from mr360uw.base.sphere import basis, disc_directions, disc_offsets, effective_half_angle, unit
from mr360uw.composite.mesh.mesh import Mesh
from mr360uw.composite.raycast import Geometry, gather, opacity_key, surfaces_along
from mr360uw.composite.shot import PlacedObject, Shot
from mr360uw.medium.lookup import beam_ratio, linear, optical_length, table_coordinate, unscattered_share
from mr360uw.medium.shafts.occluders import Bodies
from mr360uw.medium.shafts.single_scattering import nearest_m, spot_factor
from mr360uw.types import Floats, Lamp, Sun

Arrival = tuple[Floats, Floats, Floats | float]
"""Light of one source at n points, without shadows and caustics: unit direction (n, 3), or (3,) for all, towards the
light; irradiance (n, 3) perpendicular to it, in plate radiance times sr; angular radius [rad] of the source, (n,) or
one for all."""


REFERENCE_SUN_FACTOR = 4
"""Factor on the directions over a light's disc in the reference renderer, which approximates the limit of many."""


def sun_of(shot: Shot) -> Sun | None:
    """Return the sun of a shot; None where there is none above the horizon."""
    for light in shot.lights:
        if isinstance(light, Sun) and light.direction[1] > 0.0:
            return light
    return None


def sun_up(sun: Sun) -> float:
    """Return the sine of the sun's elevation in the water, at least `MINIMUM_SUN_UP`."""
    return max(float(sun.direction[1]), MINIMUM_SUN_UP)


def spread_rad(shot: Shot) -> float:
    """Return the standard deviation [rad] of the directions of forward-scattered light; 0 without water."""
    return float(np.radians(shot.draw.sun_spread_deg)) if shot.medium is not None else 0.0


def scattered_share(shot: Shot, point: Floats) -> Floats:
    """Return the fraction (n,) of the beam that the water has scattered into the halo, at points (n, 3)."""
    sun = sun_of(shot)
    if shot.medium is None or sun is None or spread_rad(shot) == 0.0:
        return np.zeros(len(point))
    return 1.0 - unscattered_share(shot.medium, shot.view.depth_of(point), sun_up(sun)).mean(axis=-1)


def widest_half_angle(shot: Shot) -> float:
    """Return the angular radius [rad] of the widest disc of a shot's sunlight: that of the halo in water."""
    sun = sun_of(shot)
    return 0.0 if sun is None else float(effective_half_angle(sun.half_angle_rad, spread_rad(shot)))


def ground_slopes(shot: Shot, point: Floats, sides: Floats | None = None) -> Floats:
    """Return how waves turn the beam at points (n, 3) of the ground, `mean_slopes` (n, 3) over footprints; (0, 3) where
    they do not.

    sides: (n, 2, 3) [m] of the footprints; None for points.
    """
    stack = shot.caustics
    if stack is None or not stack.slopes:
        return np.zeros((0, 3))
    width_m = np.zeros(len(point))
    if sides is not None:
        (ax, ay, az), (bx, by, bz) = np.moveaxis(sides, 0, -1)
        width_m = np.sqrt(np.sqrt((ay * bz - az * by) ** 2 + (az * bx - ax * bz) ** 2 + (ax * by - ay * bx) ** 2))
    # Read the level whose pixels are as wide, where the beam crosses the mean surface
    level = mip_level(width_m, stack.tile_m / stack.slopes[0].shape[1], len(stack.slopes) - 1.0)
    world = point + shot.view.position
    u, v = along_beam(stack, world[:, 0], shot.view.depth_of(point), world[:, 2])
    return mean_slopes(periodic_trilinear(stack.slopes, np.zeros(len(point), np.int64), u, v, level))


_BOUND, _ENOUGH = 0.02, 64
"""Step of `steepest_slope`, for one that changed with every frame would let nothing be kept from frame to frame; and
pixels across the map that it is taken from, at most."""


def steepest_slope(shot: Shot) -> float:
    """Return how far waves turn all but a twentieth of the beam on the ground, in metres across for each along it."""
    if shot.caustics is None or not shot.caustics.slopes:
        return 0.0
    coarse = next(level for level in shot.caustics.slopes if level.shape[1] <= _ENOUGH)
    mean_x, mean_z, radius = np.moveaxis(mean_slopes(coarse), -1, 0)
    return _BOUND * math.ceil(float(np.quantile(np.hypot(mean_x, mean_z) + radius, 0.95)) / _BOUND)


class SunSource:
    """The sun of a shot as a `LightSource`. blockers: None for no shadows."""

    variable = "sun"
    in_plate = True

    def __init__(self, sun: Sun, shot: Shot, blockers: Blockers | None) -> None:
        self._sun, self._shot, self._blockers = sun, shot, blockers
        self._up = sun_up(sun)

    def arrival(self, point: Floats) -> Arrival:
        """Return the beam at points (n, 3); its disc has the second moment of sun and halo together."""
        shot, sun = self._shot, self._sun
        depth = shot.view.depth_of(point)
        ratio = 1.0 if shot.medium is None else beam_ratio(shot.medium, depth, self._up)
        spread = spread_rad(shot) * np.sqrt(scattered_share(shot, point))
        irradiance = np.broadcast_to(sun.irradiance, (len(point), 3)) * ratio
        return sun.direction, irradiance, effective_half_angle(sun.half_angle_rad, spread)

    def pattern(self, point: Floats, footprint_m: Floats) -> Floats:
        """Return the caustic factor (n, 3), faded and blurred by scattering, as a mean over footprints (n,) [m]."""
        shot = self._shot
        if shot.caustics is None:
            return np.ones((len(point), 3))
        depth, world = shot.view.depth_of(point), point + shot.view.position
        place = world[:, 0], depth, world[:, 2], footprint_m
        contrast = 1.0 if shot.medium is None else unscattered_share(shot.medium, depth, self._up)
        if shot.medium is not None and shot.caustics.soft is not None:
            return soft_caustic_lookup(shot.caustics, *self._levels, *place, contrast)
        ratio = caustic_lookup(shot.caustics, self._levels[0], *place)
        return 1.0 + (ratio - 1.0) * contrast

    @functools.cached_property
    def _levels(self) -> tuple[list[Floats], list[Floats]]:
        return levels_of(self._shot.caustics)

    def visibility(self, start: Floats, sides: Floats | None = None, *, on_ground: bool = False) -> Floats:
        """Return the visible fraction (n,) of the beam: of the disc and the halo, by their fractions of the light."""
        if self._blockers is None or not self._blockers.there:
            return np.ones(len(start))
        slopes = ground_slopes(self._shot, start, sides) if on_ground else np.zeros((0, 3))
        seen = self._disc_seen(start, sides, self._sun.half_angle_rad, slopes)
        scattered = scattered_share(self._shot, start)
        if np.any(scattered):
            halo = self._disc_seen(start, sides, widest_half_angle(self._shot), np.zeros((0, 3)))
            seen = seen + scattered * (halo - seen)
        return seen

    def _disc_seen(self, start: Floats, sides: Floats | None, half_angle_rad: float, slopes: Floats) -> Floats:
        """Return the visible fraction (n,) of a disc about the sun. slopes: (n, 3) of `ground_slopes`, or (0, 3)."""
        blockers, sun = self._blockers, self._sun.direction
        assert blockers is not None
        count = REFERENCE_SUN_FACTOR * self._shot.draw.sun_samples
        if not len(slopes):
            directions = disc_directions(sun, half_angle_rad, count)
            return visible_fraction(lambda k, begin, _: blockers.passed(begin, directions[k]), start, sides, count)
        # Rays about the mean direction at each point, over a disc that is wider by the spread there
        bent = unit(sun / sun[1] - np.insert(slopes[:, :2], 1, 0.0, axis=1))
        radius, offsets = np.hypot(np.tan(half_angle_rad), slopes[:, 2] * sun[1]), disc_offsets(count) @ basis(sun)[:2]

        def passed(k: NDArray[np.int64], begin: Floats, of: NDArray[np.int64]) -> Floats:
            return blockers.passed(begin, unit(bent[of] + radius[of, None] * offsets[k]))

        return visible_fraction(passed, start, sides, count)


def lamps_of(shot: Shot) -> tuple[Lamp, ...]:
    """Return the lamps of a shot with any intensity."""
    return tuple(light for light in shot.lights if isinstance(light, Lamp) and np.any(light.intensity > 0.0))


class LampSource:
    """One lamp of a shot as a `LightSource`. blockers: None for no shadows."""

    variable = "lamps"
    in_plate = False

    def __init__(self, lamp: Lamp, shot: Shot, blockers: Blockers | None) -> None:
        self._lamp, self._shot = lamp, shot
        self._blockers = blockers if lamp.casts_shadow else None
        self._place = lamp.position - shot.view.position

    def arrival(self, point: Floats) -> Arrival:
        """Return the light at points (n, 3), such that shading's transmittance to the camera completes the path."""
        away = self._place - point
        distance = np.maximum(np.linalg.norm(away, axis=-1), nearest_m(self._lamp))
        towards = away / distance[:, None]
        irradiance = self._lamp.intensity * (spot_factor(self._lamp, towards) / distance**2)[:, None]
        sine = np.minimum(self._lamp.radius_m / distance, 1.0)
        return towards, irradiance * self._path_ratio(point, distance), np.arcsin(sine)

    def _path_ratio(self, point: Floats, distance: Floats) -> Floats:
        """Return the ratio (n, 3) of the transmittance there and back to that of an object's light on the way back."""
        medium = self._shot.medium
        if medium is None or self._lamp.attenuation is None:
            return np.ones((len(point), 3))
        back = np.linalg.norm(point, axis=-1)
        up = point[:, 1] / np.maximum(back, 1e-9)
        path = distance + back
        lost = linear(self._lamp.attenuation, table_coordinate(path, medium.length_m)) * path[:, None]
        return np.exp(optical_length(medium, back, up) - lost)

    def pattern(self, point: Floats, footprint_m: Floats) -> Floats:  # noqa: ARG002 - arguments of the interface
        """Return 1: waves do not refract this light."""
        return np.ones((len(point), 3))

    def visibility(
        self,
        start: Floats,
        sides: Floats | None = None,
        *,
        on_ground: bool = False,  # noqa: ARG002 - waves do not turn this light
    ) -> Floats:
        """Return the visible fraction (n,) of the ball, taken as a disc that faces each point."""
        if self._blockers is None or not self._blockers.there:
            return np.ones(len(start))
        count = REFERENCE_SUN_FACTOR * self._shot.draw.sun_samples
        offsets = self._lamp.radius_m * disc_offsets(count)
        axes = _axes(self._place - start)
        blockers, place, least = self._blockers, self._place, nearest_m(self._lamp)

        def passed(k: NDArray[np.int64], begin: Floats, of: NDArray[np.int64]) -> Floats:
            to = place - begin + np.einsum("rp,rpk->rk", offsets[k], axes[of])
            length = np.linalg.norm(to, axis=-1)
            return blockers.passed(begin, to / np.maximum(length, 1e-9)[:, None], np.maximum(length - least, 0.0))

        return visible_fraction(passed, start, sides, count)


def _axes(away: Floats) -> Floats:
    """Return two unit vectors (n, 2, 3) perpendicular to each vector (n, 3) and to each other."""
    w = away / np.maximum(np.linalg.norm(away, axis=-1, keepdims=True), 1e-9)
    level = np.stack([w[:, 2], np.zeros(len(w)), -w[:, 0]], axis=-1)
    length = np.linalg.norm(level, axis=-1, keepdims=True)
    u = np.where(length > 1e-9, level / np.maximum(length, 1e-9), basis([0.0, 1.0, 0.0])[0])
    return np.stack([u, np.cross(w, u)], axis=1)


LightSource = SunSource | LampSource
"""One light in one shot. Points are from the camera, in the world's axes [m].

variable: name of the output variable of its light. in_plate: whether it already lights the plate. `arrival`: its light
at points (n, 3). `pattern`: the caustic factor (n, 3), a mean over footprints (n,) [m]. `visibility`: the fraction (n,)
of the source that bodies leave visible from points (n, 3); with the sides (n, 2, 3) [m] of parallelograms about these,
the means over them; on the ground waves turn the sun's beam.
"""


def light_sources(shot: Shot, blockers: Blockers | None = None) -> tuple[LightSource, ...]:
    """Return a source for the sun and every lamp of a shot. blockers: None for no shadows."""
    sun = sun_of(shot)
    suns = [] if sun is None else [SunSource(sun, shot, blockers)]
    return (*suns, *(LampSource(lamp, shot, blockers) for lamp in lamps_of(shot)))


# --- What hides them ------------------------------------------------------------------------------------------------

# Fraction of a light's disc that bodies leave visible, along rays of the reference renderer, and bodies in the water.
#
# Visibility is the mean over directions that fill the disc, each from a place of its own in the footprint. Light that
# the water has scattered forwards comes from a wider disc: a Gaussian spread of standard deviation sigma is taken as a
# disc of the same second moment (`sphere.effective_half_angle`). The device traces the same rays through filtered
# columns (gl/light_visibility.py).
#
# A surface of alpha a lets 1 - a of the light through, n of them the product (glTF 2.0, section 3.9.4); a mask all or
# nothing. In the water a body's clear triangles let the same fraction through everywhere, the mean over the body.


_GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)
_STRIDE = 0.24
"""Step through the lattice of places, as a fraction of its points: of those tried, the one of least error at straight
edges whose penumbra is as wide as a pixel, 0.015 by 24 rays. Neighbours in the lattice (1/n) have twice that error."""
_WIDE_STRIDE = 0.54
"""The same for wide rays: edges at all angles, penumbrae of 0.03 to 3 pixels. RMS error 0.015 by 24 rays, 0.021
by 12; with `pixel_offsets` 0.018 and 0.027."""

_ROUNDS = 4
"""Places for each direction at the edge of a shadow. RMS error at straight edges: 0.006 of the
light; with one place 0.014."""
_TURN_OF_PLACES = np.array([0.7549, 0.5698])
"""Shift of the places from round to round: the additive sequence in two dimensions of least discrepancy (1/g and 1/g^2,
g^3 = g + 1)."""


def pixel_offsets(count: int) -> Floats:
    """Return places (count, 2) in [-0.5, 0.5]^2, one for each of `disc_offsets`, that fill a footprint evenly.

    A Fibonacci lattice, in an order in which every ring of the disc meets places all over the footprint: rays of
    direction k from place k sample the disc and the footprint at once.
    """
    k = _strided(count, _STRIDE)
    return np.stack([(k + 0.5) / count, np.remainder(0.5 + k * _GOLDEN, 1.0)], axis=-1) - 0.5


def wide_pixel_offsets(count: int) -> Floats:
    """Return what `pixel_offsets` does, for rays as wide as the part of the footprint that they represent.

    Wide rays fill the gaps of a grid. It has half as many columns as rows, because most footprints on the ground are
    twice as long as wide; every place has a row of its own.
    """
    k, columns = _strided(count, _WIDE_STRIDE), max(round(np.sqrt(0.5 * count)), 1)
    return np.stack([(k % columns + 0.5) / columns, (k + 0.5) / count], axis=-1) - 0.5


def _strided(count: int, stride: float) -> NDArray[np.int64]:
    """Return the numbers below `count` in steps of about a fraction of it, each once."""
    step = next(n for n in range(max(round(stride * count), 1), 2 * count + 2) if math.gcd(n, count) == 1)
    return np.arange(count) * step % count


Passed = Callable[[NDArray[np.int64], Floats, NDArray[np.int64]], Floats]
"""Fraction (m,) of the light that is left of rays in directions of given numbers from starts (m, 3), moved points of
indices (m,)."""
_RAYS_AT_ONCE = 1 << 16
"""Rays traced together, which bounds memory."""


def visible_fraction(passed: Passed, start: Floats, sides: Floats | None, count: int) -> Floats:
    """Return the fraction (n,) of the light of rays in `count` directions that is left, each from its own place of the
    footprint.

    start: (n, 3) middles, sides: (n, 2, 3) of the footprints; None for points. At the edge of a shadow,
    every direction is taken from `_ROUNDS` places.
    """
    every, directions, places = np.arange(len(start)), np.arange(count), pixel_offsets(count)
    foot = start, np.zeros((len(start), 2, 3)) if sides is None else sides
    seen = _free(passed, foot, (directions, places), every)
    if sides is None:
        return seen / count
    partly = (seen > 0) & (seen < count)
    fine = np.flatnonzero(partly | _reaches_edge(passed, foot, seen, count))
    turns = np.arange(1, _ROUNDS)[:, None, None] * _TURN_OF_PLACES
    more = (np.remainder(places + 0.5 + turns, 1.0) - 0.5).reshape(-1, 2)
    fraction = seen / count
    again = _free(passed, foot, (np.tile(directions, _ROUNDS - 1), more), fine)
    fraction[fine] = (seen[fine] + again) / (_ROUNDS * count)
    return np.asarray(fraction)


def _free(
    passed: Passed, foot: tuple[Floats, Floats], rays: tuple[NDArray[np.int64], Floats], chosen: NDArray[np.int64]
) -> Floats:
    """Return how many (m,) of the rays from chosen footprints (m,) are free, each by the fraction of its light that is
    left. foot: middles and sides of all. rays: numbers of their directions (r,), and places (r, 2) in [-0.5, 0.5]^2 of
    their footprints at which they start.
    """
    seen, (directions, places) = np.zeros(len(chosen)), rays
    begin, across, at_once = foot[0][chosen], foot[1][chosen], max(_RAYS_AT_ONCE // max(len(chosen), 1), 1)
    for first in range(0, len(places), at_once):
        some, number = places[first : first + at_once], directions[first : first + at_once]
        begins = begin + np.tensordot(some, across, axes=(1, 1))
        free = passed(np.repeat(number, len(chosen)), begins.reshape(-1, 3), np.tile(chosen, len(some)))
        seen += free.reshape(len(some), -1).sum(axis=0)
    return seen


def _reaches_edge(passed: Passed, foot: tuple[Floats, Floats], seen: Floats, count: int) -> NDArray[np.bool_]:
    """Return where (n,) all rays were free, or all blocked, but one from a corner of the footprint is not."""
    other = np.zeros(len(seen), np.bool_)
    same = np.flatnonzero((seen == 0) | (seen == count))
    outermost = count - 1 - np.arange(4) * max(count // 13, 1)
    corners = np.repeat([(-0.5, -0.5), (0.5, -0.5), (-0.5, 0.5), (0.5, 0.5)], len(outermost), axis=0)
    free = _free(passed, foot, (np.tile(outermost, 4), corners), same)
    other[same] = free != np.where(seen[same] > 0, len(corners), 0)
    return other


def casting_bodies(shot: Shot, cache: Cache) -> Bodies:
    """Return the bodies of a shot's objects that cast shadows, in the world. cache: holds them."""
    return cache.of(_in_world, shot.casters, cache)


def _in_world(casters: tuple[PlacedObject, ...], cache: Cache) -> Bodies:
    keep = 2 * len(casters)
    found: list[tuple[RayScene, PlacedObject, float]] = []
    for placed in casters:
        solid, clear = cache.of(_scenes, _shape(placed.mesh), keep=keep)
        found.append((solid, placed, 0.0))
        if len(clear.triangles):
            found.append((clear, placed, cache.of(_mean_passed, _shape(placed.mesh.still), keep=keep)))
    found = [(scene, placed, passed) for scene, placed, passed in found if len(scene.triangles) and passed < 1.0]
    return Bodies(
        tuple(PlacedScene(scene, placed.world_from_object) for scene, placed, _ in found),
        np.array([placed.to_world(placed.mesh.center_m) for _, placed, _ in found]).reshape(-1, 3),
        np.array([placed.mesh.radius_m * placed.scale for _, placed, _ in found]),
        np.array([passed for *_, passed in found]),
    )


def _shape(mesh: Mesh) -> PartOf[Mesh]:
    return PartOf(mesh, Same(mesh.positions), Same(mesh.material), opacity_key(mesh))


def _scenes(shape: PartOf[Mesh]) -> tuple[RayScene, RayScene]:
    """Return the opaque triangles of a mesh and the others."""
    mesh = shape.whole
    opaque = np.array([m.alpha_mode == "OPAQUE" for m in mesh.materials])[mesh.material]
    return RayScene(mesh.positions[opaque]), RayScene(mesh.positions[~opaque])


_ACROSS = 48
"""Parallel rays along each side of the square around a mesh that find what its clear triangles let through."""


def _mean_passed(shape: PartOf[Mesh]) -> float:
    """Return the mean fraction of light that a mesh's clear triangles let through, of rays along its axes that meet
    them.
    """
    mesh = shape.whole
    clear = ClearScene(gather([PlacedObject(mesh, np.eye(4))], np.zeros(3)))
    line = ((np.arange(_ACROSS) + 0.5) / _ACROSS * 2.0 - 1.0) * mesh.radius_m
    u, v = (g.ravel() for g in np.meshgrid(line, line))
    origin = np.concatenate([np.roll(np.stack([u, v, 0 * u - 2.0 * mesh.radius_m], -1), k, -1) for k in range(3)])
    rays = np.repeat([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], len(u), axis=0)
    passed, met = clear.passed(origin + mesh.center_m, rays, np.inf)
    return float(passed[met].mean()) if np.any(met) else 1.0


_SHORTEST_M = 1e-6
"""Shortest step [m] behind a surface that lets light through."""


class ClearScene:
    """Those of some triangles that let light through, of MASK and BLEND materials."""

    def __init__(self, every: Geometry) -> None:
        self._geometry = every.some(np.flatnonzero(~_opaque(every)))

    @property
    def there(self) -> bool:
        """Whether there are any such triangles."""
        return len(self._geometry.positions) > 0

    def passed(self, origins: Floats, directions: Floats, reach_m: Floats | float) -> tuple[Floats, NDArray[np.bool_]]:
        """Return the fraction (n,) of the light of rays that they leave within `reach_m` [m], and which rays (n,) meet
        any.
        """
        met = surfaces_along(self._geometry, origins, directions, _SHORTEST_M, reach_m)
        passed = np.maximum(1.0 - np.bincount(met.ray, met.part, len(origins)), 0.0)
        return passed, np.bincount(met.ray, minlength=len(origins)) > 0


def _opaque(geometry: Geometry) -> NDArray[np.bool_]:
    """Return which triangles (T,) let no light through."""
    return np.array([m.alpha_mode == "OPAQUE" for m in geometry.materials], np.bool_)[geometry.material]


class Blockers:
    """The triangles of a shot that cast shadows."""

    def __init__(self, shot: Shot) -> None:
        every = gather(shot.casters, shot.view.position)
        self._opaque, self._clear = RayScene(every.positions[_opaque(every)]), ClearScene(every)

    @property
    def there(self) -> bool:
        """Whether there is any such triangle."""
        return len(self._opaque.triangles) > 0 or self._clear.there

    def passed(self, start: Floats, directions: Floats, reach_m: Floats | float = np.inf) -> Floats:
        """Return the fraction (n,) of the light of rays that is left within `reach_m` [m] of their start, (n, 3) from
        the camera.
        """
        passed: Floats = np.asarray(~self._opaque.occluded(start, directions, reach_m), np.float64)
        if self._clear.there:
            free = np.flatnonzero(passed)
            reach = np.broadcast_to(reach_m, len(start))[free]
            passed[free] = self._clear.passed(start[free], directions[free], reach)[0]
        return passed
