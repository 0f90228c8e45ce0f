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
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.constants import MINIMUM_SUN_UP
from mr360uw.errors import ParameterError
from mr360uw.medium.closed_form import exponential_integral
from mr360uw.medium.phase import Phase, check_phase, phase_function
from mr360uw.medium.shafts.occluders import Bodies, bodies_of
from mr360uw.medium.shafts.ray_segments import lamp_segments, radius_at, ray_ends_m, segment_points, view_directions
from mr360uw.medium.shafts.shaft_scene import MOST_POINTS, BeamPattern
from mr360uw.shapes import checked, common_shape, exactly, number, numbers
from mr360uw.sphere import unit
from mr360uw.types import CausticStack, Floats, Lamp, Sun, View

Array = NDArray[np.float64]

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
    a, b = _coefficients(absorption, scattering)
    check_phase(phase)
    surface = view.surface_y_m if surface_y_m is None else number("surface_y_m", surface_y_m)
    if steps < 1 or sun_samples < 1 or (tolerance is not None and not tolerance > 0.0):
        raise ParameterError(
            f"steps - steps and sun_samples must be 1 or more, tolerance above 0 (got {steps}, {sun_samples}, "
            f"{tolerance}) - correct them"
        )
    solid, directions = bodies_of(bodies), view_directions(view)
    ends = ray_ends_m(view, directions, surface, solid, end_m)
    beam = _Beam(np.atleast_1d(a + b), np.atleast_1d(b), phase, np.asarray(view.position, np.float64), directions, ends)
    radiance = np.zeros((len(directions), beam.attenuation.size))
    if sun is not None and sun.direction[1] > 0.0:
        light = _each("sun.irradiance", sun.irradiance, a.shape)
        pattern = BeamPattern(sun, solid, caustics, surface, sun_samples)
        smooth = beam.smooth(unit(sun.direction))
        scale = (tolerance or 0.0) * float(np.max(smooth, initial=0.0))
        radiance += light * smooth
        if not pattern.even:
            radiance += light * _refined(functools.partial(beam.changed, pattern), steps, scale)
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
            at = lamp_segments(lamp, self.origin, self.directions[part], np.zeros(len(part)), self.ends[part], steps)
            light = at.light * phase_function(self.phase, np.arccos(np.clip(at.cosine, -1.0, 1.0)))
            if lamp.casts_shadow:
                point = at.point.reshape(-1, 3)
                light = light * bodies.visible_from(point, np.asarray(lamp.position, np.float64), at.least_m).reshape(
                    light.shape
                )
            for n, c in enumerate(self.attenuation):
                result[part, n] = np.sum(light * np.exp(-c * at.path_m), axis=-1)
        return self.scattering * result

    def _rate(self, towards_sun: Array) -> Array:
        return self.attenuation * (1.0 - self.directions[:, 1:2] / max(float(towards_sun[1]), MINIMUM_SUN_UP))

    def _turned(self, towards_sun: Array) -> Array:
        return phase_function(self.phase, np.arccos(np.clip(self.directions @ towards_sun, -1.0, 1.0)))
