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
import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mr360uw.base.cache import Cache, Parts, shared
from mr360uw.base.constants import PI
from mr360uw.base.sphere import directions, disc_directions, row_solid_angle
from mr360uw.base.texels import smoothstep
from mr360uw.caustics.settings import Sea
from mr360uw.composite.aovs import Aovs
from mr360uw.composite.light_sources import LampSource, SunSource, casting_bodies, lamps_of, sun_of
from mr360uw.composite.receiver.shape import plate_distance
from mr360uw.composite.settings import NEAREST_M, SnowPhase, SnowSettings
from mr360uw.composite.shading import water_ahead
from mr360uw.composite.shot import Shot
from mr360uw.composite.snow_particles import (
    LEAST_COVER,
    largest_offset_m,
    offsets_in_waves,
    orbiting_waves,
    particles_near,
    seen_up_to,
    size_classes,
)
from mr360uw.composite.tiles import empty_tile
from mr360uw.ibl.lookup import environment_lookup
from mr360uw.jit import exact, exact_making
from mr360uw.medium.lookup import ambient_ratio, linear, transmittance_lookup
from mr360uw.medium.phase import phase_function
from mr360uw.medium.shafts.single_scattering import nearest_m
from mr360uw.types import Floats, Layer, Rectangle, Tile, View

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
    bottom_m, waves = snow.sea.water_depth_m, orbiting_waves(snow.sea, depth_m - reach_m[-1])
    whole = largest_offset_m(waves, depth_m - reach_m[-1], bottom_m)
    margins = [largest_offset_m(waves, depth_m - far_m - whole, bottom_m) for far_m in reach_m]
    current = np.asarray(settings.current_m_s, np.float64)
    speeds = [current - np.array([0.0, size.sinking_m_s, 0.0]) for size in classes]
    position, diameter, number = particles_near(
        classes, settings.exponent, snow.sea.seed, view.position, [snow.time_s * speed for speed in speeds],
        (NEAREST_M, farthest, per_diameter), margins,
    )  # fmt: skip
    velocity, margin = np.asarray(speeds)[number], np.asarray(margins)[number]
    kept = position[:, 1] < view.surface_y_m
    mean_m = np.linalg.norm(position - view.position, axis=-1)
    kept &= contrast(diameter, np.maximum(mean_m - margin, NEAREST_M)) > LEAST_COVER
    position, velocity, diameter = position[kept], velocity[kept], diameter[kept]
    if waves is not None:
        below_m = view.surface_y_m - position[:, 1]
        offset, change = offsets_in_waves(waves, bottom_m, snow.time_s, position, below_m, velocity)
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


# --- particles in the frame -----------------------------------------------------------------------------------------

# Draws particles into an equirectangular frame: discs of confusion, drawn out by motion, of exact solid angle.
#
# A particle covers the pixels about the arc from where it is when the shutter opens to where it is when it closes. With
# r the distance [rad] of a pixel's centre from that arc, R the radius of the disc and h half a pixel's height,
#
#     f = clamp((R + h - r)/(2 h), 0, 1)        coverage = f omega/sum(f Omega)
#
# Omega is a pixel's solid angle and omega the particle's, so its light is the same however it is blurred, and wherever.
# R is at least `LEAST_RADIUS` pixels. Distances are chords between unit vectors, so poles and seam are like any place.
# Particles are composited by `over`, the farthest first: before bodies into one picture, behind them into another. The
# pictures are laid over and under the tiles of a layer, and fill the rest of the frame with tiles of snow.


def merged(shot: Shot, layer: Layer, before: Picture, behind: Picture, cache: Cache) -> Layer:
    """Return a layer with snow before its bodies and behind them; pictures are used up. cache: what frames share.

    Mattes without distances hide snow as they hide bodies, of which they know no more.
    """
    if shot.holdout is not None:
        left = (1.0 - np.clip(shot.holdout, 0.0, 1.0)).astype(np.float32)
        for radiance, alpha in (before, behind):
            radiance[...] *= left[..., None]
            alpha[...] *= left
    # Lay it over and under the bodies of tiles
    layer, tiles = layer.laid(), []
    for tile in layer.tiles:
        radiance, alpha = np.empty(tile.radiance.shape, np.float32), np.empty(tile.alpha.shape, np.float32)
        front, back = ((image[tile.window], covered[tile.window]) for image, covered in (before, behind))
        _lay(front, (tile.radiance, tile.alpha), back, (radiance, alpha))
        tiles.append(replace(tile, radiance=radiance, alpha=alpha))
    # Fill the rest of the frame with tiles of snow
    whole = Rectangle(0, 0, layer.width, layer.height)
    blank = cache.of(_blank, whole)
    for part in rest_of([tile.rectangle for tile in layer.tiles], layer.width, layer.height):
        at = slice(part.row, part.row + part.height), slice(part.column, part.column + part.width)
        alpha = before[1][at]
        if np.any(alpha):
            clear = blank.distance_m[at], blank.ratio[at], blank.veil[at]
            tiles.append(Tile(part.column, part.row, before[0][at], alpha, *clear))
    return Layer(layer.height, layer.width, tuple(tiles))


def _blank(whole: Rectangle) -> Tile:
    tile = empty_tile(whole)
    for values in (tile.distance_m, tile.ratio, tile.veil):
        values.flags.writeable = False
    return tile


def rest_of(parts: Sequence[Rectangle], width: int, height: int) -> list[Rectangle]:
    """Return disjoint rectangles of all pixels of a frame that are outside of some, which do not cross the seam."""
    edges = sorted({0, height, *(p.row for p in parts), *(p.row + p.height for p in parts)})
    rest = []
    for top, bottom in itertools.pairwise(edges):
        column = 0
        for p in sorted(p for p in parts if p.row <= top and bottom <= p.row + p.height):
            if p.column > column:
                rest.append(Rectangle(column, top, p.column - column, bottom - top))
            column = p.column + p.width
        if column < width:
            rest.append(Rectangle(column, top, width - column, bottom - top))
    return rest


@exact
def _lay(before: Any, bodies: Any, behind: Any, out: Any) -> None:
    """Write a picture over another over a third into `out`, premultiplied radiance (h, w, 3) and alpha (h, w) each."""
    (front, front_alpha), (body, body_alpha), (back, back_alpha), (radiance, alpha) = before, bodies, behind, out
    for j in range(alpha.shape[0]):
        for i in range(alpha.shape[1]):
            clear, through = np.float32(1.0) - front_alpha[j, i], np.float32(1.0) - body_alpha[j, i]
            for c in range(3):
                radiance[j, i, c] = front[j, i, c] + clear * (body[j, i, c] + through * back[j, i, c])
            covered = body_alpha[j, i] + through * back_alpha[j, i]
            alpha[j, i] = front_alpha[j, i] + clear * covered


LEAST_RADIUS = 0.75
"""Least radius of a disc in pixels: a centre is never farther than 0.71 from a pixel's, so every disc has weight there.
Twice as large: particles are blurred. Half as large: they flicker as they move from pixel to pixel."""


Picture = tuple[Floats, Floats]
"""Snow in a frame: premultiplied radiance (H, W, 3) and alpha (H, W), float32. Both are drawn into."""


def empty_picture(view: View) -> Picture:
    """Return a picture without particles, of a view's size."""
    return np.zeros((view.height, view.width, 3), np.float32), np.zeros((view.height, view.width), np.float32)


def draw_particles(
    arcs: tuple[Floats, Floats], radius: Floats, solid_angle: Floats, distance_m: Floats, radiance: Floats,
    body_m: Floats, before: Picture, behind: Picture,
) -> None:  # fmt: skip
    """Composite n particles, in their order, over two pictures.

    arcs: (n, 3) unit directions in the camera's axes as the shutter opens, and as it closes. radius: (n,) [rad] of
    their discs. solid_angle: (n,) [sr] that they cover. distance_m: (n,). radiance: (n, 3). body_m: (H, W) distance of
    the nearest body; a particle beyond it is drawn into `behind`, others into `before`.
    """
    height, width = body_m.shape
    latitude = np.pi * (0.5 - (np.arange(height) + 0.5) / height)
    longitude = 2.0 * np.pi * ((np.arange(width) + 0.5) / width - 0.5)
    least = LEAST_RADIUS * np.pi / height
    particles = (*arcs, np.maximum(radius, least), solid_angle, distance_m, radiance)
    rows = np.sin(latitude), np.cos(latitude), row_solid_angle(width, height)
    _draw(particles, body_m, rows, (np.sin(longitude), np.cos(longitude)), before, behind)


@exact
def _columns(row_sine: Any, row_cosine: Any, sine: Any, cosine: Any, cos_reach: Any, x: Any, width: Any) -> Any:
    """Return (first column, number of columns) of a row within an angle of a direction; columns may pass the seam."""
    across = cosine * row_cosine
    nearest = cos_reach - sine * row_sine
    if nearest >= across:
        return 0, 0
    if nearest <= -across:
        return 0, width
    half = np.arccos(nearest / across) * width / (2.0 * np.pi)
    first = int(np.ceil(x - half - 0.5))
    return first, min(int(np.floor(x + half - 0.5)) - first + 1, width)


@exact
def _share(a: Any, v: Any, b: Any, outer: Any, soft: Any, dx: Any, dy: Any, dz: Any) -> Any:
    """Return f of the pixel in direction (dx, dy, dz). v: unit, along the arc at its begin a. b: cosine and sine of the
    arc. outer: R + h, soft: 2 h.
    """
    x, y = dx * a[0] + dy * a[1] + dz * a[2], dx * v[0] + dy * v[1] + dz * v[2]
    if y > 0.0:  # past the begin: nearest to the arc itself, or to its end
        x = np.sqrt(x * x + y * y) if x * b[1] > y * b[0] else x * b[0] + y * b[1]
    return min(max((outer - np.sqrt(max(2.0 - 2.0 * x, 0.0))) / soft, 0.0), 1.0)


@exact_making
def _draw(particles: Any, body: Any, rows: Any, columns: Any, before: Any, behind: Any) -> None:
    """Composite particles, the arguments of `draw_particles`, over two pictures.

    rows: sine and cosine of the latitude, and the solid angle of a pixel, each (H,). columns: sine and cosine of the
    longitude, each (W,).
    """
    start, end, radius, solid_angle, distance, radiance = particles
    (row_sine, row_cosine, row_solid_angle), (column_sine, column_cosine) = rows, columns
    height, width = body.shape
    soft = np.pi / height
    a, v, m, b = np.empty(3), np.empty(3), np.empty(3), np.empty(2)
    for n in range(len(start)):
        b[0] = start[n, 0] * end[n, 0] + start[n, 1] * end[n, 1] + start[n, 2] * end[n, 2]
        chord = length = across = 0.0
        for c in range(3):
            a[c], m[c], v[c] = start[n, c], start[n, c] + end[n, c], end[n, c] - b[0] * start[n, c]
            length += m[c] * m[c]
            across += v[c] * v[c]
            chord += (end[n, c] - start[n, c]) ** 2
        length, b[1] = np.sqrt(length), np.sqrt(across)
        if length <= 0.0:
            continue  # drawn out over half a turn: it has no middle
        for c in range(3):
            v[c] = v[c] / b[1] if b[1] > 0.0 else 0.0
        outer = radius[n] + 0.5 * soft
        half_arc, wide = np.arcsin(min(0.5 * np.sqrt(chord), 1.0)), 2.0 * np.arcsin(min(0.5 * outer, 1.0))
        reach = min(half_arc + wide + 1e-9, np.pi)
        sine = min(max(m[1] / length, -1.0), 1.0)
        cosine, cos_reach = np.sqrt(1.0 - sine * sine), np.cos(reach)
        latitude = np.arcsin(sine)
        x = width * (np.arctan2(m[0], -m[2]) / (2.0 * np.pi) + 0.5)
        top = max(int(np.ceil(height * (0.5 - (latitude + reach) / np.pi) - 0.5)), 0)
        bottom = min(int(np.floor(height * (0.5 - (latitude - reach) / np.pi) - 0.5)), height - 1)
        total = 0.0
        for j in range(top, bottom + 1):
            first, count = _columns(row_sine[j], row_cosine[j], sine, cosine, cos_reach, x, width)
            across = 0.0
            for i in range(first, first + count):
                k = i % width
                dx, dz = row_cosine[j] * column_sine[k], -row_cosine[j] * column_cosine[k]
                across += _share(a, v, b, outer, soft, dx, row_sine[j], dz)
            total += across * row_solid_angle[j]
        if total <= 0.0:
            continue
        for j in range(top, bottom + 1):
            first, count = _columns(row_sine[j], row_cosine[j], sine, cosine, cos_reach, x, width)
            for i in range(first, first + count):
                k = i % width
                dx, dz = row_cosine[j] * column_sine[k], -row_cosine[j] * column_cosine[k]
                share = _share(a, v, b, outer, soft, dx, row_sine[j], dz)
                if share > 0.0:
                    w = min(share * solid_angle[n] / total, 1.0)
                    nearer = distance[n] < body[j, k]
                    light, alpha = before if nearer else behind
                    for c in range(3):
                        light[j, k, c] = w * radiance[n, c] + (1.0 - w) * light[j, k, c]
                    alpha[j, k] = w + (1.0 - w) * alpha[j, k]
