# SPDX-License-Identifier: Apache-2.0
"""Deviation of the sun's beam in segments of many rays: what `ShaftScene.segments` returns, by tables and maps.

Rays of one column share a plane through the sun and with it the running sums of `pattern_lines`. A segment takes the
mean of the caustics over its part of the line, at the depth of its middle, and the exact integral of its smooth light
(Hillaire 2015, eq. of slices). The loops are compiled.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import Cache, PartOf
from mr360uw.jit import fast, inlined
from mr360uw.medium.shafts.beam_pattern import BeamPattern
from mr360uw.medium.shafts.body_shadows import DISC_TAPS, HALO_TAPS, shadows_of, visible_parts
from mr360uw.medium.shafts.pattern_lines import PatternMaps, fill_line, line_steps
from mr360uw.medium.shafts.ray_segments import radius_at
from mr360uw.medium.shafts.shaft_scene import ShaftScene
from mr360uw.sphere import unit

Array = NDArray[np.float64]

_HEIGHTS = 257
"""Heights of rays at which the light of segments is tabulated."""
_PARTS = 4
"""Parts of a segment that are tested by rays, for bodies without bounds."""


class SunBeam:
    """The sun's beam in a scene, for rays of `count` segments. cache: holds weights, and the shadows of bodies.

    weights: (heights, count, 12) `whole` and `sharp` of `ShaftWater.beam_segments`. maps: of the caustics. shadows: of
    bodies on the disc and the halo, None without bodies or where a body has no bounds.
    """

    def __init__(self, scene: ShaftScene, pattern: BeamPattern, count: int, cache: Cache) -> None:
        self.scene, self.pattern = scene, pattern
        self.weights = cache.of(_weights, PartOf(scene, scene.water, scene.depth_m, scene.sun_up), count, keep=4)
        self.shadows, self.maps = shadows_of(pattern, cache), PatternMaps(pattern.caustics)

    def add(
        self, rays: Array, rate: Array, reach: Array, column: NDArray[np.int64], widening_rad: float, light: Array
    ) -> None:
        """Add the light of segments to `light` (n, count, 3) for rays (n, 3) sorted by their plane through the sun.

        rate, reach: (n,) of `ShaftScene.layout`. column: (n,) number of the plane. widening_rad: angle between planes.
        """
        sun, origin, maps = unit(self.pattern.sun.direction), self.scene.origin, self.maps
        cosine = rays @ sun
        sine = np.sqrt(np.maximum(1.0 - cosine * cosine, 0.0))
        first = np.flatnonzero(np.diff(column, prepend=-1))
        across = rays[first] - cosine[first, None] * sun
        across = across / np.maximum(np.linalg.norm(across, axis=1), 1e-12)[:, None]
        course = across[:, [0, 2]] - across[:, 1:2] * maps.lean
        place = origin[[0, 2]] + maps.lean * self.scene.depth_m
        beam = np.zeros_like(light)
        add_beam(
            np.append(first, len(rays)), np.ascontiguousarray(rays[:, 1]), sine, rate, reach,
            self.scene.water.turned(cosine), self.weights, self._seen(rays, rate, reach, light.shape[1]),
            self.scene.depth_m, maps.values, maps.start, maps.size, maps.depth_m, maps.tile_m, place, course,
            widening_rad, beam,
        )  # fmt: skip
        light += beam * self.pattern.sun.irradiance

    def _seen(self, rays: Array, rate: Array, reach: Array, count: int) -> Array:
        """Return the visible fractions (n, count, 2) of disc and halo, (0, 0, 2) where nothing is in the way."""
        if not self.pattern.bodies.occluders:
            return np.zeros((0, 0, 2))
        edge = radius_at(np.arange(count + 1) / count, rate[:, None], reach[:, None])
        hit = self.pattern.bodies.first_hit_m(self.scene.origin, rays)[:, None]
        start, end = edge[:, :-1], edge[:, 1:]
        end = np.where((start < hit) & (hit < end), hit, end)
        if self.shadows is None:
            return self._seen_by_rays(rays, start, end)
        seen = np.empty((len(rays), count, 2))
        of, bodies = self.shadows, self.pattern.bodies
        for k, (maps, taps) in enumerate(((of.disc, DISC_TAPS), (of.halo, HALO_TAPS))):
            visible_parts(
                self.scene.origin, rays, start, end, bodies.centre, bodies.radius, of.frame, of.apart, maps.frame,
                maps.top, maps.spread, bodies.passed, taps, seen[:, :, k],
            )  # fmt: skip
        return seen

    def _seen_by_rays(self, rays: Array, start: Array, end: Array) -> Array:
        bodies, pattern = self.pattern.bodies, self.pattern
        result = np.zeros((*start.shape, 2))
        for part in range(_PARTS):
            along = ((end - start) / _PARTS)[..., None] * rays[:, None]
            point = self.scene.origin + start[..., None] * rays[:, None] + (part + 0.5) * along
            for k, directions in enumerate((pattern.disc, pattern.halo)):
                seen = bodies.visible(point.reshape(-1, 3), directions, along.reshape(-1, 3))
                result[..., k] += seen.reshape(start.shape) / _PARTS
        return result


def _weights(of_water: PartOf[ShaftScene], count: int) -> NDArray[np.float32]:
    scene = of_water.whole
    up = np.linspace(-1.0, 1.0, _HEIGHTS)
    rate, reach = (x[:, None] for x in scene.layout(up))
    edge = radius_at(np.arange(count + 1) / count, rate, reach)
    light = scene.water.beam_segments(up, edge, scene.depth_m, scene.sun_up)
    return np.concatenate([part.reshape(_HEIGHTS, count, 6) for part in light], axis=-1).astype(np.float32)


_LAST = 1.2
"""Distance up to which the last segment of a ray has a pattern, over that of its start."""
SHORTEST_M = 1e-6
"""Part of a line [m] over which the difference of two sums is still free of roundings."""


@inlined
def node_edges(rate: Any, reach: Any, count: Any, edge: Any) -> None:
    """Write the edges (count + 1,) [m] of a ray's segments: `ray_segments.radius_at`."""
    x = rate * reach
    for k in range(count + 1):
        t = k / count
        edge[k] = reach * t if abs(x) < 1e-6 else -reach * math.log1p(t * math.expm1(-x)) / x


@fast
def add_beam(
    starts: Any, up: Any, sine: Any, rate: Any, reach: Any, turned: Any, weights: Any, seen: Any, depth_m: Any,
    values: Any, level_start: Any, size: Any, planes: Any, tile_m: Any, place: Any, course: Any, widening: Any,
    light: Any,
) -> None:  # fmt: skip
    """Add the deviation of each segment to `light` (n, count, 3) for rays sorted by column.

    starts: (columns + 1,) first ray of each column. up, sine: (n,) height of rays, and sine of their angle from the
    sun. rate, reach: (n,) of `ShaftScene.layout`. turned: (n, 2) phase functions. weights: (m, count, 12) of
    `SunBeam`. seen: (n, count, 2) visible fractions of disc and halo, or (0, 0, 2). depth_m: of the camera.
    values to tile_m: `PatternMaps`, planes (0,) without caustics. place: (2,) of the camera on the mean surface [m].
    course: (columns, 2) its change per metre of a line. widening: angle between columns.
    """
    count = light.shape[1]
    ratio = np.zeros((count, 4))
    scale = size / tile_m
    sums = np.empty((len(planes), 1, 4))
    used = np.empty((len(planes), 2), np.int64)
    for column in range(len(starts) - 1):
        first, end = starts[column], starts[column + 1]
        if len(planes):
            step = tile_m / size / math.hypot(course[column, 0], course[column, 1])
            line = line_steps(step, widening, _line_end(sine[first:end], rate[first:end], reach[first:end], count))
            if sums.shape[1] < len(line):
                sums = np.empty((len(planes), len(line), 4))
            _find_used(up[first:end], sine[first:end], rate[first:end], reach[first:end], count, depth_m, planes, line,
                       step, widening, used)  # fmt: skip
            fill_line(
                values, level_start, size, used, place[0] * scale, place[1] * scale, course[column, 0] * scale,
                course[column, 1] * scale, line, sums,
            )  # fmt: skip
            for n in range(first, end):
                _find_ratio(up[n], sine[n], rate[n], reach[n], depth_m, planes, line, step, widening, sums, ratio)
                _add_node(up[n], turned[n], weights, seen, n, ratio, light[n])
        else:
            for n in range(first, end):
                _add_node(up[n], turned[n], weights, seen, n, ratio, light[n])


@fast
def _line_end(sine: Any, rate: Any, reach: Any, count: Any) -> Any:
    """Return how far along a line [m] rays need it: over a part at least of the last segment, mostly far and faint."""
    edge = np.empty(count + 1)
    farthest = 0.0
    for n in range(len(sine)):
        node_edges(rate[n], reach[n], count, edge)
        farthest = max(farthest, min(edge[count], _LAST * edge[count - 1]) * sine[n])
    return farthest


@fast
def _find_used(
    up: Any, sine: Any, rate: Any, reach: Any, count: Any, depth_m: Any, planes: Any, line: Any, step: Any,
    widening: Any, used: Any,
) -> None:  # fmt: skip
    """Write the first and last step of a line that rays read of each plane to `used` (planes, 2)."""
    edge = np.empty(count + 1)
    for plane in range(len(planes)):
        used[plane, 0], used[plane, 1] = len(line), -1
    for n in range(len(up)):
        node_edges(rate[n], reach[n], count, edge)
        i0 = 0
        for k in range(count):
            i1, _ = _position(edge[k + 1] * sine[n], line, step, widening)
            plane, between = _plane(planes, depth_m - 0.5 * (edge[k] + edge[k + 1]) * up[n])
            for p in range(plane, plane + 2 if between > 0.0 else plane + 1):
                used[p, 0], used[p, 1] = min(used[p, 0], i0), max(used[p, 1], i1)
            i0 = i1


@fast
def _find_ratio(
    up: Any, sine: Any, rate: Any, reach: Any, depth_m: Any, planes: Any, line: Any, step: Any, widening: Any,
    sums: Any, ratio: Any,
) -> None:  # fmt: skip
    """Write the caustics' deviation from 1 to `ratio` (count, 4): sharp red, green, blue and soft."""
    count = len(ratio)
    edge = np.empty(count + 1)
    node_edges(rate, reach, count, edge)
    i0, f0 = 0, 0.0
    for k in range(count):
        i1, f1 = _position(edge[k + 1] * sine, line, step, widening)
        middle = max(depth_m - 0.5 * (edge[k] + edge[k + 1]) * up, 0.0)
        plane, between = _plane(planes, middle)
        # waves have not focused anything at the surface: contrast grows from there to the first plane
        focused = min(middle / planes[0], 1.0)
        ratio[k] = 0.0
        _add_mean(sums[plane], line, i0, f0, i1, f1, (1.0 - between) * focused, ratio[k])
        if between > 0.0:
            _add_mean(sums[plane + 1], line, i0, f0, i1, f1, between * focused, ratio[k])
        i0, f0 = i1, f1


@fast
def _add_node(up: Any, turned: Any, weights: Any, seen: Any, n: Any, ratio: Any, light: Any) -> None:
    """Add the deviation of ray n in each segment to `light` (count, 3)."""
    x = (up + 1.0) * 0.5 * (len(weights) - 1)
    row = min(int(x), len(weights) - 2)
    part = x - row
    for k in range(len(light)):
        disc, halo = (seen[n, k, 0], seen[n, k, 1]) if len(seen) else (1.0, 1.0)
        soft = (1.0 + ratio[k, 3]) * halo
        for j in range(3):
            whole = sharp = 0.0
            for kind in range(2):
                a, b = 3 * kind + j, 6 + 3 * kind + j
                lower, upper = weights[row, k, a], weights[row + 1, k, a]
                whole += turned[kind] * (lower + (upper - lower) * part)
                lower, upper = weights[row, k, b], weights[row + 1, k, b]
                sharp += turned[kind] * (lower + (upper - lower) * part)
            light[k, j] += whole * (soft - 1.0) + sharp * ((1.0 + ratio[k, j]) * disc - soft)


@inlined
def _plane(planes: Any, depth: Any) -> Any:
    """Return the plane above a depth and the fraction of the way to the next one, 0 beyond the first and the last."""
    last = len(planes) - 1
    if depth <= planes[0] or last == 0:
        return 0, 0.0
    if depth >= planes[last]:
        return last, 0.0
    low, high = 0, last
    while high - low > 1:
        middle = (low + high) // 2
        if planes[middle] <= depth:
            low = middle
        else:
            high = middle
    return low, (depth - planes[low]) / (planes[high] - planes[low])


@inlined
def _position(r: Any, line: Any, step: Any, widening: Any) -> Any:
    """Return the step of a line that r lies in, and where in it as a fraction."""
    last = len(line) - 2
    even = min(math.ceil(1.0 / widening), last + 1)
    i = int(r / step)
    if i >= even:
        i = even + int(math.log(r / line[even]) / math.log1p(widening))
    i = min(max(i, 0), last)
    return i, min(max((r - line[i]) / (line[i + 1] - line[i]), 0.0), 1.0)


@inlined
def _add_mean(sums: Any, line: Any, i0: Any, f0: Any, i1: Any, f1: Any, weight: Any, ratio: Any) -> None:
    """Add `weight` times the mean over the part of a line between two positions to `ratio` (4,)."""
    start, end = line[i0] + f0 * (line[i0 + 1] - line[i0]), line[i1] + f1 * (line[i1 + 1] - line[i1])
    if end - start < SHORTEST_M:
        width = line[i0 + 1] - line[i0]
        for j in range(4):
            ratio[j] += weight * (sums[i0 + 1, j] - sums[i0, j]) / width
        return
    scale = weight / (end - start)
    for j in range(4):
        before = sums[i0, j] + f0 * (sums[i0 + 1, j] - sums[i0, j])
        behind = sums[i1, j] + f1 * (sums[i1 + 1, j] - sums[i1, j])
        ratio[j] += scale * (behind - before)
