# SPDX-License-Identifier: Apache-2.0
"""Radiance of particles towards the camera: sun under the waves, lamps and ambient light, scattered once.

    L = T a (sum over lights E C V p(angle) + int L_ambient p(angle)) + veil

with a the albedo and p the phase function [1/sr] of a particle, E the irradiance, C the caustic ratio, V the visible
fraction of the light, T and veil those of the water in front. L is the mean over the disc that a particle shows; alpha
is the fraction of a pixel that particles cover. A white ball's phase function is that of a Lambert sphere (van de Hulst
1980). Bodies take away sun and lamps, not ambient light; masks of their textures are not read.
"""

from __future__ import annotations

import functools

import numpy as np

from mr360uw.cache import Cache, shared
from mr360uw.composite.lighting.light_sources import LampSource, SunSource, lamps_of, sun_of
from mr360uw.composite.lighting.shading import water_ahead
from mr360uw.composite.lighting.shadow import casting_bodies
from mr360uw.composite.shot import Shot
from mr360uw.composite.snow.settings import SnowPhase
from mr360uw.constants import PI
from mr360uw.ibl.lookup import environment_lookup
from mr360uw.medium.lookup import ambient_ratio, linear
from mr360uw.medium.phase import phase_function
from mr360uw.medium.shafts.ray_segments import nearest_m
from mr360uw.sphere import directions, disc_directions, row_solid_angle
from mr360uw.types import Floats

_SUN_DIRECTIONS = 4
"""Directions over the sun's disc. Particles are a pixel large: a shadow's edge is told by many of them."""
_STEPS = 97
"""Depths at which smooth light is evaluated: at most 0.13 m apart within 6 m, over which red light curves by 3e-4."""
_LEAST_SPAN_M = 1e-3
"""Least span [m] of these depths, for points that are all at one."""
_ROWS = 16
"""Rows of the map of scattered ambient light: 11 degrees, over which the white ball's phase function is straight."""


def particle_radiance(shot: Shot, albedo: float, phase: SnowPhase, point: Floats, cache: Cache) -> Floats:
    """Return the radiance (n, 3) of particles as the camera sees it through the water.

    point: (n, 3) from the camera, world axes [m]. cache: holds the bodies of other frames.
    """
    distance = np.linalg.norm(point, axis=-1)
    direction = point / distance[:, None]
    residual = np.asarray(shot.environment.residual, np.float32)
    # what particles of albedo 1 send to the camera, a map over directions
    scattered = (_weights(phase, *residual.shape[:2]) @ residual.reshape(-1, 3)).reshape(_ROWS, 2 * _ROWS, 3)
    light = environment_lookup(scattered, direction)
    # smooth light is evaluated on a ladder of depths and interpolated to the points'
    depth = shot.view.depth_of(point)
    low, high = float(depth.min()), max(float(depth.max()), float(depth.min()) + _LEAST_SPAN_M)
    ladder, place, points = np.linspace(low, high, _STEPS), (depth - low) / (high - low), np.zeros((_STEPS, 3))
    points[:, 1] = shot.view.surface_y_m - ladder - shot.view.position[1]
    if shot.medium is not None:
        light = light * linear(ambient_ratio(shot.medium, ladder), place)
    bodies = casting_bodies(shot, cache)
    world = point + shot.view.position
    if (sun := sun_of(shot)) is not None:
        source = _SunOnPoints(sun, shot, None)
        _, irradiance, half_angle_rad = source.arrival(points)
        half_angle = float(np.mean(half_angle_rad))
        seen = bodies.visible(world, disc_directions(sun.direction, half_angle, _SUN_DIRECTIONS))
        turned: Floats = particle_phase(phase, direction @ sun.direction) * seen
        light = light + linear(irradiance, place) * source.pattern(point, np.zeros(len(point))) * turned[:, None]
    for lamp in lamps_of(shot):
        towards, irradiance, _ = LampSource(lamp, shot, None).arrival(point)
        turned = particle_phase(phase, np.sum(direction * towards, axis=-1))
        lit = np.flatnonzero(np.any(irradiance > 0.0, axis=-1))
        if lamp.casts_shadow:
            turned[lit] *= bodies.visible_from(world[lit], np.asarray(lamp.position, np.float64), nearest_m(lamp))
        light = light + irradiance * turned[:, None]
    through, veil = water_ahead(shot, distance, direction)
    return np.asarray(through * albedo * light + veil)


class _SunOnPoints(SunSource):
    """The sun on points: caustics as the map has them, whose pixels are larger than particles."""

    @functools.cached_property
    def _levels(self) -> list[Floats]:
        stack = self._shot.caustics
        return [] if stack is None else [stack.ratio]

    @functools.cached_property
    def _soft_levels(self) -> list[Floats]:
        stack = self._shot.caustics
        return [] if stack is None or stack.soft is None else [stack.soft]


def particle_phase(phase: SnowPhase, cosine: Floats) -> Floats:
    """Return the phase function [1/sr] of particles at cosines of the angle by which light turns."""
    theta = np.arccos(np.clip(cosine, -1.0, 1.0))
    if phase == "grain":
        return 2.0 / (3.0 * PI * PI) * (np.sin(theta) - theta * np.cos(theta))
    return phase_function(phase, theta)


@shared(keep=4)
def _weights(phase: SnowPhase, rows: int, columns: int) -> Floats:
    """Return the fraction (m, rows columns) of a particle's light that comes from each pixel; rows of sum 1.

    m: directions in which it is seen. They add up to 1, so that a white particle vanishes in even light.
    """
    seen, sources = directions(2 * _ROWS, _ROWS).reshape(-1, 3), directions(columns, rows).reshape(-1, 3)
    weights = particle_phase(phase, seen @ sources.T) * np.repeat(row_solid_angle(columns, rows), columns)
    return (weights / weights.sum(axis=1, keepdims=True)).astype(np.float32)
