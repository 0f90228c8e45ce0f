# SPDX-License-Identifier: Apache-2.0
"""Adds a shot's snow to its layer: before bodies where particles are nearer, behind them through what bodies let pass.

Both renderers use this code; it needs the distances of the layer's bodies and nothing else of theirs.

    symbol  meaning                                      unit
    d, s    diameter, distance of a particle             m
    a, F    aperture, distance in focus                  m

The disc over which a particle's light is spread has the squared radius (d/(2 s))^2 + (a/2 (1/s - 1/F))^2: the second
moments of the particle and of the disc of confusion add up.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mr360uw.cache import Cache
from mr360uw.caustics.settings import Sea
from mr360uw.composite.receiver.shape import ReceiverShape
from mr360uw.composite.shot import Shot
from mr360uw.composite.snow.drift import orbits_of
from mr360uw.composite.snow.merge import merged
from mr360uw.composite.snow.particle_light import particle_radiance
from mr360uw.composite.snow.particles import Reach, particles_near
from mr360uw.composite.snow.settings import SnowSettings
from mr360uw.composite.snow.size_spectrum import LEAST_COVER, seen_up_to, size_classes
from mr360uw.composite.snow.splat import Picture, draw_particles
from mr360uw.constants import PI
from mr360uw.medium.lookup import transmittance_lookup
from mr360uw.sphere import frame_from_direction
from mr360uw.types import Floats, Layer, View

_LEAST_CONTRAST = 0.005
"""Transmittance of the water, in its clearest channel, at which the range ends."""
_FADE_FROM, _FULL_FROM = 0.8, 1.25
"""Fraction of the range from which on particles fade out, multiple of the least distance up to which they fade in."""
_STEPS = 64
"""Distances at which the water's transmittance is read to find the range."""


@dataclass(frozen=True, slots=True, eq=False)
class Snow:
    """The snow of one instant of a frame.

    scattering: by the water's particles [1/m]. sea: whose waves move it. opens, closes: views as the shutter does so,
    half of `exposure_s` before and after `time_s`.
    """

    settings: SnowSettings
    scattering: float
    sea: Sea
    time_s: float
    exposure_s: float
    opens: View
    closes: View


@dataclass(frozen=True, slots=True, eq=False)
class Cloud:
    """Particles about a camera. position: (n, 3) [m] in the world at an instant, velocity: (n, 3) [m/s], diameter_m,
    fade: (n,), the latter in [0, 1], by their distance and their size in pixels.
    """

    position: Floats
    velocity: Floats
    diameter_m: Floats
    fade: Floats


def with_particles(snow: Snow, shot: Shot, layer: Layer, kept: Cache) -> Layer:
    """Return a shot's layer with its snow. kept: holds what is the same in other frames."""
    view = shot.view
    cloud = particles_in_view(snow, shot)
    point = cloud.position - view.position
    distance = np.linalg.norm(point, axis=-1)
    there = np.flatnonzero(distance < _plate_m(shot, point, distance, kept))
    there = there[np.argsort(-distance[there], kind="stable")]
    if len(there) == 0:
        return layer
    position, velocity, diameter = cloud.position[there], cloud.velocity[there], cloud.diameter_m[there]
    point, distance = point[there], distance[there]
    radius = _disc_radius(snow.settings, diameter, distance)
    half = 0.5 * snow.exposure_s
    radiance = particle_radiance(shot, snow.settings.albedo, snow.settings.phase, point, kept)
    before, behind = Picture.empty(view), Picture.empty(view)
    draw_particles(
        _seen(snow.opens, position - half * velocity), _seen(snow.closes, position + half * velocity), radius,
        0.25 * PI * (diameter / distance) ** 2 * cloud.fade[there], distance, radiance, layer.distance_m, before,
        behind,
    )  # fmt: skip
    return merged(shot, layer, before, behind, kept)


def particles_in_view(snow: Snow, shot: Shot) -> Cloud:
    """Return the particles about a shot's camera that its frame resolves, below the surface of the water."""
    settings, view = snow.settings, shot.view
    classes = size_classes(settings, snow.scattering)
    farthest = min(settings.range_m, contrast_range_m(shot))
    reach_m = min(farthest, seen_up_to(view.height) * classes[-1].high_m)
    shallowest = max(view.surface_y_m - float(view.position[1]) - reach_m, 0.0)
    orbits = orbits_of(snow.sea, shallowest) if settings.orbits else None
    margin = 0.0 if orbits is None else orbits.reach_m(shallowest)
    reach = Reach(settings.nearest_m, farthest, seen_up_to(view.height), margin)
    current = np.asarray(settings.current_m_s, np.float64)
    speeds = [current - np.array([0.0, size.sinking_m_s, 0.0]) for size in classes]
    found = particles_near(
        classes, settings.exponent, settings.seed, view.position, [snow.time_s * speed for speed in speeds], reach
    )
    number = np.searchsorted([size.high_m for size in classes[:-1]], found.diameter_m)
    velocity = np.asarray(speeds)[number]
    position, diameter = found.position, found.diameter_m
    kept = position[:, 1] < view.surface_y_m
    mean_m = np.linalg.norm(position - view.position, axis=-1)
    kept &= _contrast(shot, diameter, np.maximum(mean_m - margin, settings.nearest_m)) > LEAST_COVER
    position, velocity, diameter = position[kept], velocity[kept], diameter[kept]
    if orbits is not None:
        offset, change = orbits.at(position, view.surface_y_m, snow.time_s, velocity)
        position, velocity = position + offset, velocity + change
    distance = np.linalg.norm(position - view.position, axis=-1)
    fade = (
        smooth(distance / settings.nearest_m, 1.0, _FULL_FROM)
        * smooth(_contrast(shot, diameter, distance) / LEAST_COVER, 1.0, 2.0)
        * (1.0 - smooth(distance / farthest, _FADE_FROM, 1.0))
    )
    kept = fade > 0.0
    return Cloud(position[kept], velocity[kept], diameter[kept], fade[kept])


def _contrast(shot: Shot, diameter_m: Floats, distance_m: Floats) -> Floats:
    """Return the fraction (n,) of a pixel that particles cover, times the transmittance of the water before them."""
    cover = 0.25 * PI * (diameter_m / np.maximum(distance_m, 1e-9)) ** 2 / (np.pi / shot.view.height) ** 2
    if shot.medium is None:
        return np.asarray(cover)
    return np.asarray(cover * transmittance_lookup(shot.medium, distance_m, 0.0).max(axis=-1))


def contrast_range_m(shot: Shot) -> float:
    """Return the distance [m] along a level ray beyond which water hides particles, infinity without water."""
    if shot.medium is None:
        return float(np.inf)
    distance = shot.medium.length_m * np.geomspace(0.01, 100.0, _STEPS)
    left = transmittance_lookup(shot.medium, distance, 0.0).max(axis=-1)
    hidden = np.flatnonzero(left < _LEAST_CONTRAST)
    return float(distance[hidden[0]]) if len(hidden) else float(np.inf)


def smooth(x: Floats, low: float, high: float) -> Floats:
    """Return the cubic step from 0 at `low` to 1 at `high`."""
    t = np.clip((x - low) / (high - low), 0.0, 1.0)
    return np.asarray(t * t * (3.0 - 2.0 * t))


def _disc_radius(settings: SnowSettings, diameter_m: Floats, distance_m: Floats) -> Floats:
    confusion = 0.5e-3 * settings.aperture_mm * (1.0 / distance_m - 1.0 / settings.focus_m)
    return np.asarray(np.hypot(0.5 * diameter_m / distance_m, confusion))


def _seen(view: View, position: Floats) -> Floats:
    """Return the unit directions (n, 3), in a camera's axes, of points (n, 3) in the world."""
    point = (position - view.position) @ view.world_from_camera
    return np.asarray(point / np.maximum(np.linalg.norm(point, axis=-1, keepdims=True), 1e-12))


def _plate_m(shot: Shot, point: Floats, distance_m: Floats, kept: Cache) -> Floats:
    """Return the distance (n,) [m] of the plate's surfaces behind points (n, 3), infinity where none is known."""
    receiver, matte, view = shot.receiver, shot.holdout_distance_m, shot.view
    nearest = np.full(len(point), np.inf)
    if receiver is None and matte is None:
        return nearest
    direction = point / np.maximum(distance_m, 1e-9)[:, None]
    x, y = frame_from_direction(direction @ view.world_from_camera, view.width, view.height)
    if receiver is not None:
        key = receiver, view.position.tobytes()
        shape = kept.get("snow receiver", key, lambda: ReceiverShape(receiver, view.position))
        nearest = shape.meet_along(view, x, y, direction)[0]
    if matte is not None:
        found = matte[np.minimum(y.astype(np.int64), view.height - 1), x.astype(np.int64) % view.width]
        nearest = np.minimum(nearest, found)
    return nearest
