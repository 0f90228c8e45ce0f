# SPDX-License-Identifier: Apache-2.0
"""Irradiance of lamps: inverse square, attenuated by the water there and back, shadowed; and all sources of a shot.

    E = I spot(angle) T(r + S)/(r^2 T_object(S)) V

with I the intensity, r the distance from the lamp, S that from the camera, T the transmittance of the water for the
lamp's own spectrum over the whole path, and T_object the transmittance that shading applies to everything on the way to
the camera. Attenuation depends on the light already lost, so the way there and the way back are taken as one path. V is
the visible fraction of the luminous ball. On the device: lamps.glsl.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.lighting.blockers import Blockers
from mr360uw.composite.lighting.shadow import visible_fraction
from mr360uw.composite.lighting.sun import REFERENCE_SUN_FACTOR, Arrival, LightSource, SunSource, sun_of
from mr360uw.composite.shot import Shot
from mr360uw.medium.lookup import linear, optical_length, table_coordinate
from mr360uw.medium.shafts.single_scattering import nearest_m, spot_factor
from mr360uw.sphere import basis, disc_offsets
from mr360uw.types import Floats, Lamp


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
