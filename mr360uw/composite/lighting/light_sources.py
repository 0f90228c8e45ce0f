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
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mr360uw.caustic_lookup import caustic_lookup, levels_of, soft_caustic_lookup
from mr360uw.composite.lighting.shadow import Blockers, visible_fraction
from mr360uw.composite.shot import LightSample, Shot
from mr360uw.constants import MINIMUM_SUN_UP
from mr360uw.medium.lookup import beam_ratio, linear, optical_length, table_coordinate, unscattered_share
from mr360uw.medium.shafts.single_scattering import nearest_m, spot_factor
from mr360uw.sphere import basis, disc_directions, disc_offsets, effective_half_angle
from mr360uw.types import Floats, Lamp, Sun

Arrival = tuple[Floats, Floats, Floats | float]
"""Light of one source at n points, without shadows and caustics: unit direction (n, 3), or (3,) for all, towards the
light; irradiance (n, 3) perpendicular to it, in plate radiance times sr; angular radius [rad] of the source, (n,) or
one for all."""


class LightSource(Protocol):
    """One light in one shot. Points are from the camera, in the world's axes [m]."""

    @property
    def variable(self) -> str:
        """Name of the output variable of its light."""

    @property
    def in_plate(self) -> bool:
        """Whether it already lights the plate."""

    def arrival(self, point: Floats) -> Arrival:
        """Return its light at points (n, 3)."""

    def pattern(self, point: Floats, footprint_m: Floats) -> Floats:
        """Return the caustic factor (n, 3), a mean over footprints (n,) [m]; 1 for light that waves do not refract."""

    def visibility(self, start: Floats, sides: Floats | None = None) -> Floats:
        """Return the fraction (n,) of the source that bodies leave visible from points (n, 3).

        sides: (n, 2, 3) [m] of parallelograms about the points, for the means over them; None for the points alone.
        """


REFERENCE_SUN_FACTOR = 4
"""Factor on the directions over a light's disc in the reference renderer, which approximates the limit of many."""


def sun_of(shot: Shot | LightSample) -> Sun | None:
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
        if shot.medium is not None and shot.caustics.softened:
            return soft_caustic_lookup(shot.caustics, *self._levels, *place, contrast)
        ratio = caustic_lookup(shot.caustics, self._levels[0], *place)
        return 1.0 + (ratio - 1.0) * contrast

    @functools.cached_property
    def _levels(self) -> tuple[list[Floats], list[Floats]]:
        return levels_of(self._shot.caustics)

    def visibility(self, start: Floats, sides: Floats | None = None) -> Floats:
        """Return the visible fraction (n,) of the beam: of the disc and the halo, by their fractions of the light."""
        if self._blockers is None or not self._blockers.there:
            return np.ones(len(start))
        seen, scattered = self._disc_seen(start, sides, self._sun.half_angle_rad), scattered_share(self._shot, start)
        if np.any(scattered):
            seen = seen + scattered * (self._disc_seen(start, sides, widest_half_angle(self._shot)) - seen)
        return seen

    def _disc_seen(self, start: Floats, sides: Floats | None, half_angle_rad: float) -> Floats:
        blockers = self._blockers
        assert blockers is not None
        count = REFERENCE_SUN_FACTOR * self._shot.draw.sun_samples
        directions = disc_directions(self._sun.direction, half_angle_rad, count)
        return visible_fraction(lambda k, begin, _: blockers.passed(begin, directions[k]), start, sides, count)


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

    def visibility(self, start: Floats, sides: Floats | None = None) -> Floats:
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


def light_sources(shot: Shot, blockers: Blockers | None = None) -> tuple[LightSource, ...]:
    """Return a source for the sun and every lamp of a shot. blockers: None for no shadows."""
    sun = sun_of(shot)
    suns = [] if sun is None else [SunSource(sun, shot, blockers)]
    return (*suns, *(LampSource(lamp, shot, blockers) for lamp in lamps_of(shot)))
