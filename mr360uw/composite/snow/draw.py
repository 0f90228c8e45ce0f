# SPDX-License-Identifier: Apache-2.0
"""Adds a shot's snow to its layer: before bodies where particles are nearer, behind them through what bodies let pass.

Both renderers use this code; it needs the distances of the layer's bodies and nothing else of theirs.

    symbol  meaning                                      unit
    d, s    diameter, distance of a particle             m
    a, F    aperture, distance in focus                  m

The disc over which a particle's light is spread has the squared radius (d/(2 s))^2 + (a/2 (1/s - 1/F))^2: the second
moments of the particle and of the disc of confusion add up.

Radiance towards the camera is that of sun under the waves, lamps and ambient light, scattered once:

    L = T a (sum over lights E C V p(angle) + int L_ambient p(angle)) + veil

with a the albedo and p the phase function [1/sr] of a particle, E the irradiance, C the caustic ratio, V the visible
fraction of the light, T and veil those of the water in front. L is the mean over the disc that a particle shows; alpha
is the fraction of a pixel that particles cover. A white ball's phase function is that of a Lambert sphere (van de Hulst
1980). Bodies take away sun and lamps, not ambient light; masks of their textures are not read.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace

import numpy as np

from mr360uw.cache import Cache, Parts, shared
from mr360uw.caustics.settings import Sea
from mr360uw.composite.aovs import Aovs
from mr360uw.composite.lighting.light_sources import LampSource, SunSource, lamps_of, sun_of
from mr360uw.composite.lighting.shading import water_ahead
from mr360uw.composite.lighting.shadow import casting_bodies
from mr360uw.composite.receiver.shape import plate_distance
from mr360uw.composite.settings import NEAREST_M, SnowPhase, SnowSettings
from mr360uw.composite.shot import Shot
from mr360uw.composite.snow.particles import LEAST_COVER, Reach, orbits_of, particles_near, seen_up_to, size_classes
from mr360uw.composite.snow.splat import draw_particles, empty_picture, merged
from mr360uw.constants import PI
from mr360uw.ibl.lookup import environment_lookup
from mr360uw.medium.lookup import ambient_ratio, linear, transmittance_lookup
from mr360uw.medium.phase import phase_function
from mr360uw.medium.shafts.single_scattering import nearest_m
from mr360uw.sphere import directions, disc_directions, row_solid_angle
from mr360uw.texels import smoothstep
from mr360uw.types import Floats, Layer, View

_LEAST_CONTRAST = 0.005
"""Transmittance of the water, in its clearest channel, at which the range ends."""
_FADE_FROM, _FULL_FROM = 0.8, 1.25
"""Fraction of the range from which on particles fade out, multiple of the least distance up to which they fade in."""
_PUPIL_M, _FOCUS_M = 0.6e-3, 1.0
"""Diameter of the lens's entrance pupil a and distance in focus F: an action camera's. A pupil twice as large: twice
the blur of what is near."""
_STEPS = 129
"""Distances at which the water's transmittance is read, 3 cm apart within 4 m."""


@dataclass(frozen=True, slots=True, eq=False)
class Snow(Parts):
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


def with_particles(
    snow: Snow, shot: Shot, layer: Layer, variables: Aovs | None, cache: Cache
) -> tuple[Layer, Aovs | None]:
    """Return a shot's layer and its variables with its snow. cache: holds what is the same in other frames."""
    # Find the particles in view, before what the plate shows, the farthest first
    view = shot.view
    position, velocity, diameter, fade = particles_in_view(snow, shot)
    point = position - view.position
    distance = np.linalg.norm(point, axis=-1)
    x, y = view.places(point)
    plate_m = plate_distance(shot, x, y, point / np.maximum(distance, 1e-9)[:, None], cache)
    there = np.flatnonzero(distance < plate_m)
    there = there[np.argsort(-distance[there], kind="stable")]
    if len(there) == 0:
        return layer, variables
    position, velocity, diameter, fade = position[there], velocity[there], diameter[there], fade[there]
    point, distance = point[there], distance[there]
    # Blur them by lens and shutter, and light them
    radius = np.hypot(0.5 * diameter / distance, 0.5 * _PUPIL_M * (1.0 / distance - 1.0 / _FOCUS_M))
    half = 0.5 * snow.exposure_s
    radiance = particle_radiance(shot, snow.settings.albedo, snow.settings.phase, point, cache)
    # Draw their paths before and behind the bodies, and lay these pictures together
    before, behind = empty_picture(view), empty_picture(view)
    begin, end = position - half * velocity, position + half * velocity
    arcs = snow.opens.seen(begin - snow.opens.position), snow.closes.seen(end - snow.closes.position)
    solid_angle = 0.25 * PI * (diameter / distance) ** 2 * fade
    draw_particles(arcs, radius, solid_angle, distance, radiance, layer.distance_m, before, behind)
    covered = merged(shot, layer, before, behind, cache)
    if variables is not None:
        clear = 1.0 - before[1]
        light = before[0] + (clear * (1.0 - layer.alpha))[..., None] * behind[0]
        variables = replace(variables.cut(clear), snow=light)
    return covered, variables


def particles_in_view(snow: Snow, shot: Shot) -> tuple[Floats, Floats, Floats, Floats]:
    """Return the particles about a shot's camera that its frame resolves, below the surface of the water.

    Position (n, 3) [m] in the world at the instant, velocity (n, 3) [m/s], diameter (n,) [m], and the fraction (n,) in
    which they are drawn, by their distance and their size in pixels.
    """
    settings, view = snow.settings, shot.view
    classes = size_classes(settings, snow.scattering)
    # transmittance of the water before particles, in its clearest channel and along level rays
    away, left = np.linspace(0.0, settings.range_m, _STEPS), np.ones(_STEPS)
    if shot.medium is not None:
        left = transmittance_lookup(shot.medium, away, 0.0).max(axis=-1)
    hidden = np.flatnonzero(left < _LEAST_CONTRAST)
    farthest = float(away[hidden[0] if len(hidden) else -1])

    def contrast(diameter_m: Floats, distance_m: Floats) -> Floats:
        """Return the fraction (n,) of a pixel that particles cover, times the transmittance."""
        cover = 0.25 * PI * (diameter_m / np.maximum(distance_m, 1e-9) * view.height / PI) ** 2
        return np.asarray(cover * np.interp(distance_m, away, left))

    per_diameter, depth_m = seen_up_to(view.height), view.surface_y_m - float(view.position[1])
    reach_m = [min(farthest, per_diameter * size.high_m) for size in classes]
    orbits = orbits_of(snow.sea, depth_m - reach_m[-1])
    whole = 0.0 if orbits is None else orbits.reach_m(depth_m - reach_m[-1])
    margins = [0.0 if orbits is None else orbits.reach_m(depth_m - far_m - whole) for far_m in reach_m]
    reaches = [Reach(NEAREST_M, farthest, per_diameter, margin_m) for margin_m in margins]
    current = np.asarray(settings.current_m_s, np.float64)
    speeds = [current - np.array([0.0, size.sinking_m_s, 0.0]) for size in classes]
    position, diameter, number = particles_near(
        classes, settings.exponent, snow.sea.seed, view.position, [snow.time_s * speed for speed in speeds], reaches
    )
    velocity, margin = np.asarray(speeds)[number], np.asarray(margins)[number]
    kept = position[:, 1] < view.surface_y_m
    mean_m = np.linalg.norm(position - view.position, axis=-1)
    kept &= contrast(diameter, np.maximum(mean_m - margin, NEAREST_M)) > LEAST_COVER
    position, velocity, diameter = position[kept], velocity[kept], diameter[kept]
    if orbits is not None:
        offset, change = orbits.at(position, view.surface_y_m, snow.time_s, velocity)
        position, velocity = position + offset, velocity + change
    distance = np.linalg.norm(position - view.position, axis=-1)
    fade = (
        smoothstep(distance / NEAREST_M, 1.0, _FULL_FROM)
        * smoothstep(contrast(diameter, distance) / LEAST_COVER, 1.0, 2.0)
        * (1.0 - smoothstep(distance / farthest, _FADE_FROM, 1.0))
    )
    kept = fade > 0.0
    return position[kept], velocity[kept], diameter[kept], fade[kept]


_SUN_DIRECTIONS = 4
"""Directions over the sun's disc. Particles are a pixel large: a shadow's edge is told by many of them."""
_DEPTHS = 97
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
    ladder, place, points = np.linspace(low, high, _DEPTHS), (depth - low) / (high - low), np.zeros((_DEPTHS, 3))
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
    def _levels(self) -> tuple[list[Floats], list[Floats]]:
        ratio, soft = (None, None) if (stack := self._shot.caustics) is None else (stack.ratio, stack.soft)
        return [] if ratio is None else [ratio], [] if soft is None else [soft]


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
