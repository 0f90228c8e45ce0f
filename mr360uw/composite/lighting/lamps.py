# SPDX-License-Identifier: Apache-2.0
"""Lamps on surfaces: inverse square, dimmed by the water on the way there and back, shadowed by bodies.

    E = I spot(angle) T(r + S)/(r^2 T_object(S)) V

with I the intensity, r the distance from the lamp, S that from the camera, T the transmittance of the water for the
lamp's own spectrum over a whole path, and T_object the one that shading applies to everything on the way to the camera:
the water takes more from light that has lost less before, so the way there and the way back are one path. V is the
visible fraction of the ball that shines. On the device: lamps.glsl.
"""

from __future__ import annotations

import numpy as np

from mr360uw.composite.lighting.arrival import Arrival
from mr360uw.composite.lighting.blockers import Blockers
from mr360uw.composite.lighting.shadow import basis, disc_offsets
from mr360uw.composite.lighting.sun import REFERENCE_SUN_FACTOR
from mr360uw.composite.shot import Shot
from mr360uw.medium.lookup import linear, optical_length, table_coordinate
from mr360uw.types import Floats, Lamp

NEAREST_M = 1e-3
"""Least distance from a lamp that is told apart: nearer, the inverse square would have no bound."""


def lamps_of(shot: Shot) -> tuple[Lamp, ...]:
    """Return the lamps of a shot that shine."""
    return tuple(light for light in shot.lights if isinstance(light, Lamp) and np.any(light.intensity > 0.0))


def nearest_m(lamp: Lamp) -> float:
    """Return the distance [m] from a lamp's middle within which nothing is lit more, and nothing shades."""
    return max(lamp.radius_m, NEAREST_M)


def spot_factor(lamp: Lamp, towards: Floats) -> Floats:
    """Return the share (n,) of the intensity that leaves a lamp against unit directions `towards` it (n, 3).

    1 within the core of the cone, 0 beyond its edge, a smooth step of the cosine between.
    """
    if lamp.cos_edge <= -1.0:
        return np.ones(len(towards))
    cosine = -(towards @ lamp.axis)
    t = np.clip((cosine - lamp.cos_edge) / max(lamp.cos_core - lamp.cos_edge, 1e-6), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


class LampSource:
    """One lamp of a shot, as `LightSource` says. blockers: what shades; None for nothing."""

    variable = "lamps"
    in_plate = False

    def __init__(self, lamp: Lamp, shot: Shot, blockers: Blockers | None) -> None:
        self._lamp, self._shot = lamp, shot
        self._blockers = blockers if lamp.casts_shadow else None
        self._place = lamp.position - shot.view.position

    def arrival(self, point: Floats) -> Arrival:
        """Return the light at places (n, 3), as the camera sees it through the water that shading applies."""
        away = self._place - point
        distance = np.maximum(np.linalg.norm(away, axis=-1), nearest_m(self._lamp))
        towards = away / distance[:, None]
        irradiance = self._lamp.intensity * (spot_factor(self._lamp, towards) / distance**2)[:, None]
        sine = np.minimum(self._lamp.radius_m / distance, 1.0)
        return Arrival(towards, irradiance * self._through(point, distance), np.arcsin(sine))

    def _through(self, point: Floats, distance: Floats) -> Floats:
        """Return the transmittance (n, 3) there and back over that of an object's own light on the way back."""
        medium = self._shot.medium
        if medium is None or self._lamp.attenuation is None:
            return np.ones((len(point), 3))
        back = np.linalg.norm(point, axis=-1)
        up = point[:, 1] / np.maximum(back, 1e-9)
        path = distance + back
        lost = linear(self._lamp.attenuation, table_coordinate(path, medium.length_m)) * path[:, None]
        return np.exp(optical_length(medium, back, up) - lost)

    def pattern(self, point: Floats, footprint_m: Floats) -> Floats:  # noqa: ARG002 - what the sun needs
        """Return 1: the waves do not bend this light."""
        return np.ones((len(point), 3))

    def visibility(self, start: Floats) -> Floats:
        """Return the visible fraction (n,) of the ball, as a disc that faces each place."""
        if self._blockers is None or not self._blockers.there:
            return np.ones(len(start))
        offsets = self._lamp.radius_m * disc_offsets(self._samples)
        away = self._place - start
        axes = _axes(away)
        seen = np.zeros(len(start))
        for across, along in offsets:
            to = away + across * axes[:, 0] + along * axes[:, 1]
            length = np.linalg.norm(to, axis=-1)
            reach = np.maximum(length - nearest_m(self._lamp), 0.0)
            seen += ~self._blockers.block(start, to / np.maximum(length, 1e-9)[:, None], reach)
        return seen / len(offsets)

    @property
    def _samples(self) -> int:
        return REFERENCE_SUN_FACTOR * self._shot.draw.sun_samples if self._lamp.radius_m > 0.0 else 1


def _axes(away: Floats) -> Floats:
    """Return two unit vectors (n, 2, 3) across each vector (n, 3)."""
    w = away / np.maximum(np.linalg.norm(away, axis=-1, keepdims=True), 1e-9)
    level = np.stack([w[:, 2], np.zeros(len(w)), -w[:, 0]], axis=-1)
    length = np.linalg.norm(level, axis=-1, keepdims=True)
    u = np.where(length > 1e-9, level / np.maximum(length, 1e-9), basis([0.0, 1.0, 0.0])[0])
    return np.stack([u, np.cross(w, u)], axis=1)
