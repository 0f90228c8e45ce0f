# SPDX-License-Identifier: Apache-2.0
"""Light scattered once: from the sun's beam and from lamps towards the camera, with what bodies and waves take away.

    L(v) = int_0^Z b p(v . l) E(s) C V exp(-c s) ds        E(s) = E_camera exp(c s v_y/l_y)

    symbol  unit    meaning
    v, l    1       direction of the view, and towards the sun in the water
    Z       m       length of the ray: to the surface, the first body, or a given distance
    b, c    1/m     scattering and beam attenuation c = a + b
    p       1/sr    phase function; v . l is the cosine of the angle by which light turns, forward = +1
    E       -       irradiance perpendicular to the beam
    C, V    1       caustic ratio, and visible fraction of the sun's disc

`types.Sun.irradiance` is that at the camera: at a depth d the beam is E_camera exp(-c (d - d_camera)/l_y), and just
below the surface E_camera exp(c d_camera/l_y). Over an open, flat sea C V = 1, and with eps = c (1 - v_y/l_y)

    L_smooth = b p(v . l) E_camera (1 - exp(-eps Z))/eps

in a form that is stable for every eps (`closed_form.exponential_integral`). Only the rest, with C V - 1 in place of
C V, is summed over segments of the ray. Every segment has the exact integral of its smooth light (Hillaire 2015), so a
ray in full shadow is dark to rounding.

A lamp at distance r has E = I spot(angle) exp(-c r)/r^2. Its segments are even in the angle under which the lamp sees
the ray (Kulla & Fajardo 2012), which takes the inverse square out of the sum.

Only light that has not been scattered before counts as the beam here; for what to add to a veil see `shaft_field`.

Camera rays are divided into segments of equal transmittance, with edges uniform in t over [0, 1] and x = rate reach.
Beyond an optical length of `_STEEPEST` no light is left; reach is bounded so that |x| is no more:

    r(t) = -reach log(1 - t (1 - exp(-x)))/x        t(r) = (1 - exp(-x r/reach))/(1 - exp(-x))

For the light of a lamp, rays are divided where the lamp sees equal angles of them. With s0 the foot of the
perpendicular from the lamp to the ray and h the lamp's distance from it,

    s = s0 + w tan(u)        w^2 = h^2 + r_min^2        ds/r^2 = w (1 + tan(u)^2)/r^2 du <= 2/w du

(Kulla & Fajardo 2012, with a width that does not vanish for rays through the lamp). r is never less than r_min, the
lamp's radius or `NEAREST_LAMP_M`.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mr360uw.base.cache import Parts
from mr360uw.base.caustic_lookup import caustic_lookup, levels_of
from mr360uw.base.constants import LONGEST_RAY_M, MINIMUM_SUN_UP, NEAREST_LAMP_M
from mr360uw.base.parameters import checked, common_shape, exactly, numbers
from mr360uw.base.sphere import disc_directions, effective_half_angle, unit
from mr360uw.errors import ParameterError
from mr360uw.medium.closed_form import exponential_integral, ray_in_water
from mr360uw.medium.phase import Phase, check_phase, phase_function
from mr360uw.medium.shafts.occluders import Bodies, bodies_of
from mr360uw.types import Array, CausticStack, Floats, Lamp, Sun, View

STEPS = 256
"""Segments of a ray: the shadow of a ball is within 2 % of the exact integral. The error is inverse to them."""
_MOST_STEPS = 1 << 14


@checked
def single_scattering(
    view: View,
    absorption: ArrayLike,
    scattering: ArrayLike,
    phase: Phase,
    sun: Sun | None,
    bodies: Sequence[Any] = (),
    caustics: CausticStack | None = None,
    surface_y_m: float | None = None,
    *,
    lamps: Sequence[Lamp] = (),
    end_m: ArrayLike | None = None,
    steps: int = STEPS,
    tolerance: float | None = None,
    sun_samples: int = 8,
) -> Floats:
    """Return the radiance that a view receives of light scattered once by the water.

    Shafts of waves, shadows of bodies and lamps are in it. Light of the sky, and light that is scattered more than
    once, are not: the water of a picture is brighter.

    Parameters
    ----------
    view : View
        The camera.
    absorption, scattering : array_like
        Coefficients [1/m], numbers for a result (H, W), or (n,) for (H, W, n).
    phase : Phase
        Phase function, see `Water`.
    sun : Sun or None
        Its direction in the water, and its irradiance at the camera: one value for all coefficients, or one for each.
        Below the horizon, or None: no beam.
    bodies : sequence
        Triangles (T, 3, 3) [m] in the world, objects with such `triangles` (placed objects, trimesh), or `Occluder`s.
    caustics : CausticStack, optional
        Of the same sun; with three coefficients its channels are theirs, else their mean is taken.
    surface_y_m : float, optional
        Height [m] of the mean surface in the world instead of the view's.
    lamps : sequence of Lamp
        In the world; their intensities like the sun's irradiance.
    end_m : array_like, optional
        Distance [m], (H, W) or a number, at which rays end besides the surface and the bodies.
    steps : int
        Segments of a ray, 1 or more.
    tolerance : float, optional
        Double the steps until no pixel changes by more than this fraction of the brightest smooth light.
    sun_samples : int
        Directions over the sun's disc.

    Returns
    -------
    ndarray
        Radiance (H, W) or (H, W, n).

    Raises
    ------
    ParameterError
        If a coefficient, a shape or a count is out of its domain.

    See Also
    --------
    uw.medium.shaft_deviation : The change of the veil, as composites draw it.
    uw.medium.LightField.inscatter : All orders of scattering, under a flat sea.
    uw.types.Lamp : A point or spot light.

    Notes
    -----
    L(v) = int_0^Z b p(v . l) E(s) C V exp(-c s) ds; the smooth part in closed form, the rest by segments (Hillaire
    2015).

    Examples
    --------
    >>> sun = uw.Sun(np.array([0.0, 1.0, 0.0]), np.ones(3), 0.00465, 1.0)
    >>> view = uw.types.View(8, 4, surface_y_m=5.0)
    >>> uw.medium.single_scattering(view, 0.1, 0.2, "isotropic", sun).shape
    (4, 8)
    """
    # Check the numbers
    a, b = _coefficients(absorption, scattering)
    check_phase(phase)
    surface = view.surface_y_m if surface_y_m is None else surface_y_m
    if steps < 1 or sun_samples < 1 or (tolerance is not None and not tolerance > 0.0):
        raise ParameterError(
            f"steps - steps and sun_samples must be 1 or more, tolerance above 0 (got {steps}, {sun_samples}, "
            f"{tolerance}) - correct them"
        )
    # End the rays at bodies and the surface
    solid, directions = bodies_of(bodies), view_directions(view)
    ends = ray_ends_m(view, directions, surface, solid, end_m)
    beam = _Beam(np.atleast_1d(a + b), np.atleast_1d(b), phase, np.asarray(view.position, np.float64), directions, ends)
    radiance = np.zeros((len(directions), beam.attenuation.size))
    # Add the sun: the smooth part in closed form, waves and shadows by steps
    if sun is not None and sun.direction[1] > 0.0:
        light = _each("sun.irradiance", sun.irradiance, a.shape)
        pattern = BeamPattern(sun, solid, caustics, surface, sun_samples)
        smooth = beam.smooth(unit(sun.direction))
        scale = (tolerance or 0.0) * float(np.max(smooth, initial=0.0))
        radiance += light * smooth
        if not pattern.even:
            radiance += light * _refined(functools.partial(beam.changed, pattern), steps, scale)
    # Add the lamps by steps
    for lamp in lamps:
        light = _each("lamp.intensity", lamp.intensity, a.shape)
        scale = (tolerance or 0.0) * float(np.max(beam.lamp(lamp, bodies_of(()), steps), initial=0.0))
        radiance += light * _refined(functools.partial(beam.lamp, lamp, solid), steps, scale)
    return radiance.reshape(view.height, view.width, *a.shape)


def _coefficients(absorption: ArrayLike, scattering: ArrayLike) -> tuple[Array, Array]:
    shape = common_shape(absorption=absorption, scattering=scattering)
    a, b = (np.broadcast_to(np.asarray(x, np.float64), shape) for x in (absorption, scattering))
    if len(shape) > 1 or not np.all(a >= 0.0) or not np.all(b >= 0.0):
        raise ParameterError(
            f"absorption, scattering - must be numbers or (n,), at least zero (got the shape {shape}, least "
            f"{np.min(a, initial=0.0):g} and {np.min(b, initial=0.0):g} 1/m) - give one of each for every wavelength"
        )
    return a, b


def _each(name: str, values: ArrayLike, shape: tuple[int, ...]) -> Array:
    """Return one value for each coefficient (n,) or for all of them; raise `ParameterError` where there are others."""
    given = numbers(name, values).astype(np.float64, copy=False)
    if given.size and np.all(given == given.flat[0]):
        return given.ravel()[:1]
    return np.asarray(exactly(name, given, shape), np.float64)


def _refined(summed: Callable[[int], Array], steps: int, scale: float) -> Array:
    """Return a sum over `steps` segments, doubled until it changes by `scale` at most; 0: as it is."""
    found = summed(steps)
    while scale > 0.0 and steps < _MOST_STEPS:
        steps, before, found = 2 * steps, found, summed(2 * steps)
        if np.max(np.abs(found - before), initial=0.0) <= scale:
            break
    return found


class _Beam:
    """Rays of one view in water of n coefficients. attenuation, scattering: (n,). directions: (m, 3), ends: (m,)."""

    def __init__(
        self, attenuation: Array, scattering: Array, phase: Phase, origin: Array, directions: Array, ends: Array
    ) -> None:
        self.attenuation, self.scattering, self.phase = attenuation, scattering, phase
        self.origin, self.directions, self.ends = origin, directions, ends

    def smooth(self, towards_sun: Array) -> Array:
        """Return the closed form (m, n) per unit irradiance at the camera."""
        length = exponential_integral(self._rate(towards_sun), 0.0, self.ends[:, None])
        return self._turned(towards_sun)[:, None] * self.scattering * length

    def changed(self, pattern: BeamPattern, steps: int) -> Array:
        """Return what C V - 1 adds (m, n) to the closed form."""
        towards_sun = unit(pattern.sun.direction)
        rate, t = self._rate(towards_sun), np.arange(steps + 1) / steps
        leading = rate[:, np.argmin(np.abs(self.attenuation))]
        result = np.zeros((len(self.ends), len(self.attenuation)))
        for part in np.array_split(np.arange(len(self.ends)), -(-len(self.ends) * steps // MOST_POINTS)):
            edge = radius_at(t, leading[part, None], self.ends[part, None])
            edge[:, -1] = self.ends[part]
            point, along = segment_points(self.origin, self.directions[part], edge)
            change = pattern.sharp(point, along).reshape(len(part), steps, 3) - 1.0
            if len(self.attenuation) != 3:
                change = change.mean(axis=-1, keepdims=True)
            for n in range(len(self.attenuation)):
                light = exponential_integral(rate[part, n, None], edge[:, :-1], edge[:, 1:])
                result[part, n] = np.sum(light * change[..., min(n, change.shape[-1] - 1)], axis=-1)
        return self._turned(towards_sun)[:, None] * self.scattering * result

    def lamp(self, lamp: Lamp, bodies: Bodies, steps: int) -> Array:
        """Return the light of a lamp (m, n) per unit intensity."""
        result = np.zeros((len(self.ends), len(self.attenuation)))
        for part in np.array_split(np.arange(len(self.ends)), -(-len(self.ends) * steps // MOST_POINTS)):
            whole = np.stack([np.zeros(len(part)), self.ends[part]], axis=-1)
            light, cosine, path_m = lamp_segments(lamp, self.origin, self.directions[part], whole, steps, bodies)
            light *= phase_function(self.phase, np.arccos(np.clip(cosine, -1.0, 1.0)))
            for n, c in enumerate(self.attenuation):
                result[part, n] = np.sum(light * np.exp(-c * path_m), axis=(1, 2))
        return self.scattering * result

    def _rate(self, towards_sun: Array) -> Array:
        return self.attenuation * (1.0 - self.directions[:, 1:2] / max(float(towards_sun[1]), MINIMUM_SUN_UP))

    def _turned(self, towards_sun: Array) -> Array:
        return phase_function(self.phase, np.arccos(np.clip(self.directions @ towards_sun, -1.0, 1.0)))


MOST_POINTS = 1 << 18
"""Points looked up together, which bounds memory at some tens of megabytes."""


@dataclass(frozen=True, eq=False)
class BeamPattern(Parts):
    """Bodies and waves between the sun and points in the world: what they leave of its beam there, over that under an
    open, flat sea.

    Light that has not turned:                    sharp = C V       C caustic ratio, V visible fraction of the disc
    Light that has turned by small angles:        soft = B V_halo   B blurred caustic ratio (1 without), V_halo visible
                                                                    fraction of the wider disc that it comes from

    surface_y_m: height of the mean water surface. samples: directions over the sun's disc. spread_rad: standard
    deviation of the directions of light that has turned by small angles; eight times as many directions sample it.
    """

    sun: Sun
    bodies: Bodies
    caustics: CausticStack | None
    surface_y_m: float
    samples: int
    spread_rad: float = 0.0

    @property
    def even(self) -> bool:
        """Whether nothing takes light away or moves it."""
        return not self.bodies.occluders and self.caustics is None

    def sharp(self, point: Array, along: Array, footprint_m: Floats | float = 0.0) -> Array:
        """Return C V (n, 3) at points (n, 3) in the world.

        V is a mean over the segments `along` (n, 3) [m] about the points, C over footprints (n,) [m].
        """
        return self._ratio(self._levels[0], point, footprint_m) * self._seen(point, self.disc, along)[:, None]

    def soft(self, point: Array, along: Array, footprint_m: Floats | float = 0.0) -> Array:
        """Return B V_halo (n, 3) at points (n, 3) in the world; arguments as for `sharp`."""
        return self._ratio(self._levels[1], point, footprint_m) * self._seen(point, self.halo, along)[:, None]

    def _ratio(self, levels: list[Floats], point: Array, footprint_m: Floats | float) -> Array:
        if self.caustics is None or not levels:
            return np.ones((len(point), 3))
        depth = np.maximum(self.surface_y_m - point[:, 1], 0.0)
        ratio = caustic_lookup(self.caustics, levels, point[:, 0], depth, point[:, 2], footprint_m)
        # waves have not focused anything at the surface: contrast grows from there to the first plane
        focused = np.minimum(depth / self.caustics.depth_m[0], 1.0)[:, None]
        return 1.0 + (ratio - 1.0) * focused

    def _seen(self, point: Array, directions: Array, along: Array) -> Array:
        return self.bodies.visible(point, directions, along) if self.bodies.occluders else np.ones(len(point))

    @functools.cached_property
    def _levels(self) -> tuple[list[Floats], list[Floats]]:
        return levels_of(self.caustics)

    @functools.cached_property
    def disc(self) -> Array:
        """Directions (samples, 3) over the sun's disc."""
        return disc_directions(unit(self.sun.direction), self.sun.half_angle_rad, self.samples)

    @functools.cached_property
    def halo(self) -> Array:
        """Directions (8 samples, 3) that light which has turned by small angles comes from."""
        wide = float(effective_half_angle(self.sun.half_angle_rad, self.spread_rad))
        return disc_directions(unit(self.sun.direction), wide, 8 * self.samples)


_STEEPEST = 30.0
_STRAIGHT = 1e-6
"""Below this optical length segments are even; the next term of the series is half of it."""


def radius_at(t: ArrayLike, rate: ArrayLike, reach_m: ArrayLike) -> Array:
    """Return distances (...,) [m] along rays at fractions t of their light. rate: [1/m] at which that light fades."""
    t, x, reach = _coordinates(t, rate, reach_m)
    curved = np.where(np.abs(x) > _STRAIGHT, x, 1.0)
    return np.where(np.abs(x) > _STRAIGHT, -reach * np.log1p(t * np.expm1(-curved)) / curved, reach * t)


def fraction_at(radius_m: ArrayLike, rate: ArrayLike, reach_m: ArrayLike) -> Array:
    """Return the fractions (...,) in [0, 1] at distances [m], the inverse of `radius_at`."""
    r, x, reach = _coordinates(radius_m, rate, reach_m)
    part = np.clip(np.divide(r, reach, out=np.zeros(r.shape), where=reach > 0.0), 0.0, 1.0)
    curved = np.where(np.abs(x) > _STRAIGHT, x, 1.0)
    return np.where(np.abs(x) > _STRAIGHT, np.expm1(-curved * part) / np.expm1(-curved), part)


def _coordinates(first: ArrayLike, rate: ArrayLike, reach_m: ArrayLike) -> tuple[Array, Array, Array]:
    first, rate, reach = np.broadcast_arrays(*(np.asarray(a, np.float64) for a in (first, rate, reach_m)))
    reach = np.minimum(reach, _STEEPEST / np.maximum(np.abs(rate), 1e-30))
    return first, rate * reach, reach


def segment_points(origin: Array, directions: Array, edge_m: Array, at: float = 0.5) -> tuple[Array, Array]:
    """Return a point of each segment (m k, 3) in the world, and the vector (m k, 3) [m] along it.

    directions: (m, 3). edge_m: (m, k + 1), or (1, k + 1) for all. at: where in a segment the point is, as a fraction.
    """
    length = np.diff(edge_m)
    point = origin + (edge_m[:, :-1] + at * length)[..., None] * directions[:, None]
    along = length[..., None] * directions[:, None]
    return point.reshape(-1, 3), along.reshape(-1, 3)


def camera_depth_m(view: View, surface_y_m: float) -> float:
    """Return the depth [m] of a view's camera; raise `ParameterError` for a camera above the water."""
    depth = surface_y_m - float(view.position[1])
    if not depth >= 0.0:
        raise ParameterError(
            f"view - the camera is above the water (got a depth of {depth:g} m) - lower it, or give surface_y_m"
        )
    return depth


def ray_ends_m(view: View, directions: Array, surface_y_m: float, bodies: Bodies, end_m: ArrayLike | None) -> Array:
    """Return the length (n,) [m] of camera rays (n, 3): to the surface, the first body, or `end_m`, scalar or (H, W).

    Raises `ParameterError` for a camera above the water and distances that are negative or no numbers.
    """
    depth = camera_depth_m(view, surface_y_m)
    given: Array = np.full(len(directions), LONGEST_RAY_M)
    if end_m is not None:
        ends = numbers("end_m", end_m, infinite=True).astype(np.float64, copy=False)
        if ends.shape not in ((), (view.height, view.width)) or not np.all(ends >= 0.0):
            raise ParameterError(
                f"end_m - must be distances >= 0 of shape () or {(view.height, view.width)} "
                f"(got {ends.shape}, least {np.min(ends, initial=np.inf):g}) - give metres along the rays"
            )
        given = np.broadcast_to(ends, (view.height, view.width)).ravel()
    nearest = np.minimum(given, bodies.first_hit_m(np.asarray(view.position, np.float64), directions))
    return ray_in_water(nearest, depth, np.clip(directions[:, 1], -1.0, 1.0))


def view_directions(view: View) -> Array:
    """Return the unit directions (H W, 3) of a view's pixel centres in the world, row by row."""
    x, y = np.meshgrid(np.arange(view.width) + 0.5, np.arange(view.height) + 0.5)
    return np.asarray(view.directions(x, y), np.float64).reshape(-1, 3)


def nearest_m(lamp: Lamp) -> float:
    """Return the distance [m] from a lamp's centre within which irradiance is constant and nothing casts a shadow."""
    return max(lamp.radius_m, NEAREST_LAMP_M)


def spot_factor(lamp: Lamp, towards: Floats) -> Array:
    """Return the fraction (...,) of the axial intensity that a lamp emits against unit directions `towards` it.

    1 within the core of the cone, 0 beyond its edge, a smooth step of the cosine between.
    """
    return np.asarray(spot_of(lamp.beam, *np.moveaxis(-towards, -1, 0)))


def spot_of(beam: Any, x: Any, y: Any, z: Any) -> Any:
    """Return `spot_factor` of numbers or arrays, in directions (x, y, z) of travel. beam: of `types.Lamp`."""
    axial = x * beam[1, 0] + y * beam[1, 1] + z * beam[1, 2]
    t = np.minimum((axial - beam[0, 1]) / max(beam[0, 0] - beam[0, 1], 1e-6), 1.0)
    t = np.maximum(t, 1.0 if beam[0, 1] <= -1.0 else 0.0)
    return t * t * (3.0 - 2.0 * t)


def lamp_segments(
    lamp: Lamp, origin: Array, directions: Array, edge_m: Array, count: int, bodies: Bodies
) -> tuple[Array, Array, Array]:
    """Return the light of a lamp at `count` points of segments of rays (m, 3) from one point, (m, k, count) each.

    edge_m: (m, k + 1) of the segments. The light is the integral of spot(angle)/r^2 over a point's part of its segment
    [1/m], 0 in bodies and in their shadow. Beside it: cosine of the angle by which it turns, and its path [m] from the
    lamp over the point to the rays' origin.
    """
    # Divide segments evenly in the angle under which the lamp sees them
    position, least = np.asarray(lamp.position, np.float64), nearest_m(lamp)
    foot = directions @ (position - origin)
    beside = np.linalg.norm(position - origin - foot[:, None] * directions, axis=-1)
    foot, width = foot[:, None, None], np.sqrt(beside * beside + least * least)[:, None, None]
    edge = np.arctan2(edge_m[..., None] - foot, width)
    step = np.diff(edge, axis=1) / count
    tangent = np.tan(edge[:, :-1] + (np.arange(count) + 0.5) * step)
    # Light at the points, turned to the rays' origin
    s = np.maximum(foot + width * tangent, 0.0)
    point = origin + s[..., None] * directions[:, None, None]
    away = position - point
    r = np.maximum(np.linalg.norm(away, axis=-1), least)
    towards = away / r[..., None]
    light = spot_factor(lamp, towards) / (r * r) * width * (1.0 + tangent * tangent) * step
    # Take away what bodies keep off
    if lamp.casts_shadow and bodies.occluders:
        enter, leave = (m[:, None, None] for m in bodies.inside_m(origin, directions))
        light[(s > enter) & (s < leave)] = 0.0
        lit = light > 0.0
        light[lit] *= bodies.visible_from(point[lit], position, least)
    return light, np.einsum("mkpc,mc->mkp", towards, directions), r + s
