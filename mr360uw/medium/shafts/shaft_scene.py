# SPDX-License-Identifier: Apache-2.0
"""What shafts depend on in one view, and their light in segments of camera rays.

A segment takes its visibility and caustics from one point and the exact integral of everything that is smooth along it
(Hillaire 2015): no light is lost in thick segments, and a ray in full shadow loses exactly the beam's part of the veil.

Geometry is marched once. Wavelengths enter through sums that depend on the height v_y of the view direction and on the
distance alone, so that a point in the water costs the same for 3 wavelengths or 61. With the conventions of
`shaft_field`, for a segment of a ray, channel k, and the two kinds j of scattering (molecules, particles):

    whole_jk = sum_i w_ki b_ij int exp(-c'_i s) exp(c'_i s v_y/l_y) ds
    sharp_jk = sum_i w_ki b_ij exp(-(c_i - c'_i) p) int exp(-c'_i s) exp(c_i s v_y/l_y) ds

p is the beam's path to the camera, and w_ki = weight_ki exp(-c'_i p)/sum_i(...) the spectrum of the beam at the camera,
whose sum is 1: the sun's irradiance is known there in RGB, not by wavelength. The weights are `Bands.lobes`.

`beam_share` is the fraction of the veil that shafts can change.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mr360uw.base.cache import Parts, shared
from mr360uw.base.color import luminance
from mr360uw.base.constants import LONGEST_RAY_M, MINIMUM_SUN_UP
from mr360uw.base.parameters import checked, exactly
from mr360uw.base.sphere import unit
from mr360uw.errors import ParameterError
from mr360uw.medium.closed_form import exponential_integral
from mr360uw.medium.lookup import HIGH_SUN_UP, beam_fraction, linear, table_coordinate
from mr360uw.medium.medium import Medium
from mr360uw.medium.models import CLOSED_FORMS
from mr360uw.medium.phase import Mixture
from mr360uw.medium.shafts.occluders import Bodies, bodies_of
from mr360uw.medium.shafts.single_scattering import BeamPattern, camera_depth_m, lamp_segments, segment_points
from mr360uw.types import Array, CausticStack, Floats, Lamp, Light, Sun, View

SPREAD_RAD = float(np.radians(5.0))
"""Standard deviation of the directions of light that has turned by small angles, where no scene says it
(`draw.sun_spread_deg`)."""
_WIDEST_RAD = float(np.radians(30.0)) + 1e-9
"""Widest spread, the most that `draw.sun_spread_deg` allows."""
SUN_SAMPLES = 4
"""Directions over the sun's disc: its shadow's edge is 7 cm wide 10 m behind a body, less than a segment."""
_LAMP_POINTS = 2
"""Points of a segment at which a lamp's light is evaluated."""
_PATHS = 1024
"""Lengths at which a lamp's light is tabulated over wavelength, uniform in S/(S + length)."""
_DARK_REACH = 12.0
"""Optical length after which rays end: 6e-6 of their light is left."""
_SLOWEST = 0.02
"""Least rate of fading over c' that segments are laid out for: rays along a low beam hardly fade at all."""


@dataclass(frozen=True, eq=False)
class ShaftScene(Parts):
    """What the shafts of one view depend on.

    water: of the medium. origin: (3,) [m] of the camera in the world. depth_m: of the camera. bodies: that take light
    away. pattern: of the sun's beam, None where it deviates nowhere. lamps: with light. length_m: of their tables.
    """

    water: ShaftWater
    origin: Array
    depth_m: float
    bodies: Bodies
    pattern: BeamPattern | None
    lamps: tuple[Lamp, ...]
    length_m: float

    @classmethod
    @checked
    def of(
        cls,
        view: View,
        medium: Medium,
        lights: Sequence[Light],
        bodies: Sequence[Any] | Bodies = (),
        caustics: CausticStack | None = None,
        spread_rad: float = SPREAD_RAD,
        sun_samples: int = SUN_SAMPLES,
    ) -> ShaftScene:
        """Return the scene of a view; see `shaft_field.shaft_deviation` for the arguments. Raises `ParameterError`.

        lights: a sun, which counts above the horizon, and lamps.
        """
        if sun_samples < 1 or not 0.0 <= spread_rad <= _WIDEST_RAD:
            raise ParameterError(
                f"shafts - sun_samples must be 1 or more, spread_rad in [0, {_WIDEST_RAD:.3f}] (got {sun_samples}, "
                f"{spread_rad}) - correct them"
            )
        solid, pattern = bodies_of(bodies), None
        sun = next((light for light in lights if isinstance(light, Sun) and light.direction[1] > 0.0), None)
        if sun is not None:
            exactly("sun.irradiance", sun.irradiance, (3,))
            pattern = BeamPattern(sun, solid, caustics, view.surface_y_m, sun_samples, spread_rad)
        return cls(
            shaft_water(medium), np.asarray(view.position, np.float64), camera_depth_m(view, view.surface_y_m), solid,
            None if pattern is None or pattern.even else pattern,
            tuple(one for one in lights if isinstance(one, Lamp) and np.any(one.intensity > 0.0)), medium.length_m,
        )  # fmt: skip

    @property
    def dark(self) -> bool:
        """Whether nothing deviates anywhere."""
        return (self.pattern is None and not self.lamps) or not self.water.scatters

    @property
    def parts(self) -> tuple[ShaftScene, ...]:
        """The same scene with the sun alone and with the lamps alone; what it does not have is left out."""
        of_sun, of_lamps = replace(self, lamps=()), replace(self, pattern=None)
        return tuple(part for part in (of_sun, of_lamps) if not part.dark)

    @property
    def per_unit(self) -> ShaftScene:
        """The same scene under a sun of unit irradiance at the camera."""
        if self.pattern is None:
            return self
        return replace(self, pattern=replace(self.pattern, sun=replace(self.pattern.sun, irradiance=np.ones(3))))

    @functools.cached_property
    def sun_up(self) -> float:
        """Sine of the sun's elevation in the water; 1 without sun."""
        return 1.0 if self.pattern is None else max(float(unit(self.pattern.sun.direction)[1]), MINIMUM_SUN_UP)

    def layout(self, up: Array) -> tuple[Array, Array]:
        """Return the rate [1/m] at which the light of rays of height `up` (...,) fades, and their reach [m]."""
        slowest = float(self.water.extinction.min())
        rate = np.maximum(slowest * (1.0 - np.asarray(up) / self.sun_up), _SLOWEST * slowest)
        surface = np.divide(self.depth_m, up, out=np.full(np.shape(up), np.inf), where=np.asarray(up) > 0.0)
        return rate, np.minimum(surface, _DARK_REACH / rate)

    def segments(self, directions: Array, edge_m: Array, at: float = 0.5, spacing_rad: float = 0.0) -> Array:
        """Return the deviating radiance (m, k, 3) of segments of rays (m, 3) from the camera.

        edge_m: (m, k + 1), or (1, k + 1) for rays of one height. at: where in a segment the point is that stands for
        it, as a fraction. spacing_rad: angle between neighbouring rays, over which caustics are averaged. Of a segment
        in which its ray meets a body, the part before the body stands for all of it.
        """
        count = len(directions), edge_m.shape[1] - 1
        result = np.zeros((*count, 3))
        if self.pattern is not None:
            sun = unit(self.pattern.sun.direction)
            up = directions[: len(edge_m), 1]
            whole, sharp = self.water.beam_segments(up, edge_m, self.depth_m, self.sun_up)
            turned = self.water.phase.parts(directions @ sun)
            point, along = segment_points(self.origin, directions, self._before_bodies(directions, edge_m), at)
            across = spacing_rad * np.linalg.norm(point - self.origin, axis=-1)
            soft = self.pattern.soft(point, along, across).reshape(*count, 3)
            crisp = self.pattern.sharp(point, along, across).reshape(*count, 3)
            for kind in range(2):
                light = whole[:, :, kind] * (soft - 1.0) + sharp[:, :, kind] * (crisp - soft)
                result += turned[:, None, kind, None] * light
            result *= self.pattern.sun.irradiance
        return result + self.lamp_light(directions, np.broadcast_to(edge_m, (count[0], count[1] + 1)))

    def lamp_light(self, directions: Array, edge_m: Array) -> Array:
        """Return the light of lamps (m, k, 3) in segments of rays (m, 3) with edges (m, k + 1)."""
        result = np.zeros((len(directions), edge_m.shape[1] - 1, 3))
        for lamp in self.lamps:
            light, cosine, path_m = lamp_segments(lamp, self.origin, directions, edge_m, _LAMP_POINTS, self.bodies)
            x = table_coordinate(path_m, self.length_m) * (_PATHS - 1)
            i = np.minimum(x.astype(np.int64), _PATHS - 2)
            table = self.path_light(lamp)
            log = table[i] + (table[i + 1] - table[i]) * (x - i)[..., None, None]
            radiance = np.einsum("msp,mspj,mspjk->msk", light, self.water.phase.parts(cosine), np.exp(log))
            result += lamp.intensity * radiance
        return result

    def _before_bodies(self, directions: Array, edge_m: Array) -> Array:
        """Return edges (m, k + 1); the one behind a ray's first body is put to that body."""
        if not self.bodies.occluders:
            return edge_m
        hit = self.bodies.first_hit_m(self.origin, directions)[:, None]
        edge = np.broadcast_to(edge_m, (len(directions), edge_m.shape[1])).copy()
        meets = (edge[:, :-1] < hit) & (hit < edge[:, 1:])
        edge[:, 1:][meets] = np.broadcast_to(hit, meets.shape)[meets]
        return edge

    def path_light(self, lamp: Lamp) -> Array:
        """Return logarithms (paths, 2, 3) of `ShaftWater.over_path` for the light of a lamp, for paths S from it to the
        camera at even steps of S/(S + length_m).
        """
        t = np.arange(_PATHS) / (_PATHS - 1)
        path = self.length_m * t / np.maximum(1.0 - t, 1e-4)
        log = np.log(np.maximum(self.water.over_path(path), 1e-300))
        if lamp.attenuation is None:
            return np.asarray(log)
        white = np.exp(-self.water.extinction * path[:, None]) @ self.water.weight
        coloured = -np.log(np.maximum(white, 1e-300)) - linear(lamp.attenuation, t) * path[:, None]
        return np.asarray(log + np.clip(coloured, -40.0, 40.0)[:, None])


_ANGLES = 2049
"""Angles at which phase functions are tabulated, uniform from 0 to pi."""


@dataclass(frozen=True, slots=True, eq=False)
class ShaftWater:
    """Coefficients of n wavelengths; one object for all frames of a medium (`shaft_water`).

    extinction: c' (n,), attenuation: c (n,) [1/m], see `shaft_field`. scattering: (n, 2) [1/m] of molecules and of
    particles. phase: of both, without small angles where they are cut off. weight: (n, 3), columns of sum 1. table:
    (angles, 2) of `phase.parts` at even angles from 0 to pi.
    """

    extinction: Array
    attenuation: Array
    scattering: Array
    phase: Mixture
    weight: Array
    table: Array

    @property
    def scatters(self) -> bool:
        """Whether it scatters at all."""
        return bool(np.any(self.scattering > 0.0))

    def beam_segments(self, up: Array, edge_m: Array, camera_depth_m: float, sun_up: float) -> tuple[Array, Array]:
        """Return (`whole`, `sharp`), (m, k, 2, 3), of the segments between edges (m, k + 1) of rays.

        up: (m,) height of their directions. Per unit irradiance (3,) at the camera.
        """
        sun_up = max(sun_up, MINIMUM_SUN_UP)
        path = camera_depth_m / sun_up
        # Spectrum (n, 3) of the beam at the camera, columns of sum 1, and what of it is scattered (n, 6)
        log = np.log(np.maximum(self.weight, 1e-300)) - self.extinction[:, None] * path
        light = np.exp(log - log.max(axis=0))
        scattered = self._scattered(light / light.sum(axis=0))
        # Integrals of the smooth light over each segment, of all of the beam and of that which has not turned
        start, end, steeper = edge_m[:, :-1, None], edge_m[:, 1:, None], (up / sun_up)[:, None, None]
        whole = exponential_integral(self.extinction * (1.0 - steeper), start, end) @ scattered
        unturned = np.exp(-(self.attenuation - self.extinction) * path)
        sharp = exponential_integral(self.extinction - self.attenuation * steeper, start, end) * unturned @ scattered
        shape = (*edge_m[:, 1:].shape, 2, 3)
        return whole.reshape(shape), np.minimum(sharp, whole).reshape(shape)

    def over_path(self, path_m: Array) -> Array:
        """Return sums (..., 2, 3) of w b exp(-c' path) for white light over paths (...,) [m]."""
        light = np.exp(-self.extinction * path_m[..., None]) @ self._scattered(self.weight)
        return light.reshape(*path_m.shape, 2, 3)

    def _scattered(self, weight: Array) -> Array:
        """Return what molecules and particles scatter (n, 6) of weights (n, 3)."""
        return (self.scattering[:, :, None] * weight[:, None]).reshape(len(weight), 6)


@shared(keep=4)
def shaft_water(medium: Medium) -> ShaftWater:
    """Return the water of a medium, as its veil scatters; in layers, that of the camera's."""
    nm, water, model = medium.bands.wavelength_nm, medium.water, medium.model
    b, molecules = np.asarray(water.scattering(nm), np.float64), np.zeros(len(nm))
    phase = Mixture("isotropic", molecules)
    if medium.mode not in CLOSED_FORMS:
        phase = water.phases(nm, wide_angle=True)
        molecules = molecules if water.molecular is None else np.asarray(water.molecular(nm), np.float64)
    table = phase.parts(np.cos(np.linspace(0.0, np.pi, _ANGLES)))
    scattering = np.stack([molecules, b - molecules], axis=-1)
    return ShaftWater(model.extinction, model.attenuation, scattering, phase, medium.bands.lobes, table)


_DIRECT = 0.75
"""Fraction of the irradiance below the surface that is the beam, for a high sun in a clear sky. Under other skies the
beam's share of the veil is less."""
_DARKEST = 1e-30
"""Least veil that is divided by."""


def beam_share(medium: Medium, depth_m: float) -> float:
    """Return the fraction of a level veil's luminance that the beam's first scattering adds, under a high sun.

    It is the contrast of a shaft in full shadow that fills the view of a camera at depth_m [m], and falls with depth.
    Zero in water that does not scatter.
    """
    water = shaft_water(medium)
    if not water.scatters:
        return 0.0
    level = np.zeros(1)
    beam = _DIRECT / HIGH_SUN_UP * beam_fraction(medium.unit_table, depth_m, HIGH_SUN_UP)
    lit = float(
        luminance(beam * unoccluded(water, level, level, level, np.array([LONGEST_RAY_M]), depth_m, HIGH_SUN_UP)[0])
    )
    veil = float(luminance(medium.light.display(medium.model.radiance(depth_m, level))[0]))
    return lit / max(veil, lit, _DARKEST)


def unoccluded(
    water: ShaftWater, cosine: Array, up: Array, start_m: Array, end_m: Array, camera_depth_m: float, sun_up: float
) -> Floats:
    """Return the beam's light scattered once (n, 3) between two distances (n,) of rays, per unit irradiance at the
    camera.

    The smooth part of `single_scattering`, over an open, flat sea, with the water's wide angles. cosine: (n,) of the
    angle by which light turns. up: (n,) height of the rays' directions. start_m, end_m: within the water.
    """
    place = np.arccos(np.clip(cosine, -1.0, 1.0)) * ((_ANGLES - 1) / np.pi)
    first = np.minimum(place.astype(np.int64), _ANGLES - 2)
    lower = water.table[first]
    turned = lower + (water.table[first + 1] - lower) * (place - first)[:, None]
    whole, _ = water.beam_segments(up, np.stack([start_m, end_m], axis=-1), camera_depth_m, sun_up)
    return np.asarray(np.einsum("nj,njk->nk", turned, whole[:, 0]))
