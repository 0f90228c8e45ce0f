# SPDX-License-Identifier: Apache-2.0
"""Deviation of the sun's beam in segments of many rays: what `ShaftScene.segments` returns, by tables and maps.

Rays of one column share a plane through the sun and with it the running sums of the caustics. A segment takes the
mean of the caustics over its part of the line, at the depth of its middle, and the exact integral of its smooth light
(Hillaire 2015, eq. of slices). The loops are compiled.

Along straight lines of the beam's footprint caustics are running sums, so that the mean over any part costs two reads.

A camera ray meets beams whose places on the mean surface lie on a straight line, and all rays in one plane through the
sun share that line: at a distance s and an angle alpha from the sun a ray is r = s sin(alpha) along it. One set of
running sums over r, one for each plane of a `CausticStack`, thus serves every ray of that plane ("epipolar" slices of
Engelhardt & Dachsbacher 2010; the sums are those of Crow 1984 in one dimension).

Steps of r are as wide as a pixel of the maps, and as wide as the distance to the next line where that is more. The maps
are read at the mip level of a step.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.cache import Cache, PartOf
from mr360uw.base.sphere import unit
from mr360uw.jit import fast, fast_making, inlined
from mr360uw.medium.shafts.occluders import DISC_TAPS, HALO_TAPS, Outlines, ShadowMaps, shadows_in, visible_parts
from mr360uw.medium.shafts.shaft_scene import ShaftScene
from mr360uw.medium.shafts.single_scattering import BeamPattern, radius_at
from mr360uw.types import Array, CausticStack

_HEIGHTS = 257
"""Heights of rays at which the light of segments is tabulated."""
_SMALL_RAD = 0.01
"""Radius of a disc up to which one direction stands for it: 10 m behind a body its shadow's edge is then 20 cm wide at
most, less than half a segment."""
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
        self.shadows, self.maps = shadows_of(pattern, cache), pattern_maps(pattern.caustics)

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
        turned = self.scene.water.phase.parts(cosine)
        of_rays = _Rays(np.ascontiguousarray(rays[:, 1]), sine, rate, reach, turned)
        columns = _Columns(np.append(first, len(rays)), course, place, widening_rad)
        seen, beam = self._seen(rays, rate, reach, light.shape[1]), np.zeros_like(light)
        add_beam(of_rays, columns, maps, self.weights, seen, self.scene.depth_m, beam)
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
        *both, outlines = self.shadows
        for k, (maps, taps) in enumerate(zip(both, (DISC_TAPS, HALO_TAPS), strict=True)):
            visible_parts((self.scene.origin, rays), start, end, outlines, maps, taps, seen[:, :, k])
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


def shadows_of(pattern: BeamPattern, cache: Cache) -> tuple[ShadowMaps, ShadowMaps, Outlines] | None:
    """Return `shadows_in` of a beam's bodies, None without bodies or where one has no bounds. cache: holds them."""
    bodies, towards = pattern.bodies, unit(pattern.sun.direction)
    if not bodies.occluders or not np.all(np.isfinite(bodies.radius)):
        return None
    wide = pattern.sun.half_angle_rad > _SMALL_RAD
    return cache.of(shadows_in, bodies, towards, pattern.disc if wide else None, pattern.halo, cache)


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
    """Write the edges (count + 1,) [m] of a ray's segments: `single_scattering.radius_at`."""
    x = rate * reach
    for k in range(count + 1):
        t = k / count
        edge[k] = reach * t if abs(x) < 1e-6 else -reach * math.log1p(t * math.expm1(-x)) / x


class _Rays(NamedTuple):
    """Rays sorted by column. up, sine: (n,) their height, and the sine of their angle from the sun. rate, reach: (n,)
    of `ShaftScene.layout`. turned: (n, 2) phase functions.
    """

    up: Array
    sine: Array
    rate: Array
    reach: Array
    turned: Array


class _Columns(NamedTuple):
    """Planes through the sun. starts: (columns + 1,) first ray of each. place: (2,) of the camera on the mean surface
    [m]. course: (columns, 2) its change per metre of a column's line. widening: angle between columns [rad].
    """

    starts: NDArray[np.int64]
    course: Array
    place: Array
    widening: float


@fast_making
def add_beam(rays: Any, columns: Any, maps: Any, weights: Any, seen: Any, depth_m: Any, light: Any) -> None:
    """Add the deviation of each segment to `light` (n, count, 3) for `_Rays` of `_Columns`.

    maps: `PatternMaps`, of no planes without caustics. weights: (m, count, 12) of `SunBeam`. seen: (n, count, 2)
    visible fractions of disc and halo, or (0, 0, 2). depth_m: of the camera.
    """
    count, planes = light.shape[1], maps.depth_m
    ratio = np.zeros((count, 4))
    sums = np.empty((len(planes), 1, 4))
    used = np.empty((len(planes), 2), np.int64)
    for column in range(len(columns.starts) - 1):
        first, end = columns.starts[column], columns.starts[column + 1]
        if len(planes) == 0:
            for n in range(first, end):
                _add_node(rays.up[n], rays.turned[n], weights, seen, n, ratio, light[n])
            continue
        # Sum the caustics along the line that the column's rays share, as far as they read it
        course = columns.course[column]
        step = maps.tile_m / maps.size / math.hypot(course[0], course[1])
        edge = line_steps(step, columns.widening, _line_end(rays, first, end, count))
        line = (edge, step, columns.widening)
        if sums.shape[1] < len(edge):
            sums = np.empty((len(planes), len(edge), 4))
        _find_used(rays, first, end, count, depth_m, planes, line, used)
        fill_line(maps, used, columns.place, course, edge, sums)
        for n in range(first, end):
            _find_ratio(rays, n, depth_m, planes, line, sums, ratio)
            _add_node(rays.up[n], rays.turned[n], weights, seen, n, ratio, light[n])


@fast_making
def _line_end(rays: Any, first: Any, end: Any, count: Any) -> Any:
    """Return how far along a line [m] rays need it: over a part at least of the last segment, mostly far and faint."""
    edge = np.empty(count + 1)
    farthest = 0.0
    for n in range(first, end):
        node_edges(rays.rate[n], rays.reach[n], count, edge)
        farthest = max(farthest, min(edge[count], _LAST * edge[count - 1]) * rays.sine[n])
    return farthest


@fast_making
def _find_used(rays: Any, first: Any, end: Any, count: Any, depth_m: Any, planes: Any, line: Any, used: Any) -> None:
    """Write the first and last step of a line that rays read of each plane to `used` (planes, 2)."""
    edge = np.empty(count + 1)
    for plane in range(len(planes)):
        used[plane, 0], used[plane, 1] = len(line[0]), -1
    for n in range(first, end):
        node_edges(rays.rate[n], rays.reach[n], count, edge)
        i0 = 0
        for k in range(count):
            i1, _ = _position(edge[k + 1] * rays.sine[n], line)
            plane, between = _plane(planes, depth_m - 0.5 * (edge[k] + edge[k + 1]) * rays.up[n])
            for p in range(plane, plane + 2 if between > 0.0 else plane + 1):
                used[p, 0], used[p, 1] = min(used[p, 0], i0), max(used[p, 1], i1)
            i0 = i1


@fast_making
def _find_ratio(rays: Any, n: Any, depth_m: Any, planes: Any, line: Any, sums: Any, ratio: Any) -> None:
    """Write the caustics' deviation from 1 on ray n to `ratio` (count, 4): sharp red, green, blue and soft."""
    count = len(ratio)
    edge = np.empty(count + 1)
    node_edges(rays.rate[n], rays.reach[n], count, edge)
    i0, f0 = 0, 0.0
    for k in range(count):
        i1, f1 = _position(edge[k + 1] * rays.sine[n], line)
        middle = max(depth_m - 0.5 * (edge[k] + edge[k + 1]) * rays.up[n], 0.0)
        plane, between = _plane(planes, middle)
        # waves have not focused anything at the surface: contrast grows from there to the first plane
        focused = min(middle / planes[0], 1.0)
        ratio[k] = 0.0
        _add_mean(sums[plane], line[0], i0, f0, i1, f1, (1.0 - between) * focused, ratio[k])
        if between > 0.0:
            _add_mean(sums[plane + 1], line[0], i0, f0, i1, f1, between * focused, ratio[k])
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
def _position(r: Any, line: Any) -> Any:
    """Return the step that r lies in, and where in it as a fraction. line: its edges, first step [m] and widening."""
    edge, step, widening = line
    last = len(edge) - 2
    even = min(math.ceil(1.0 / widening), last + 1)
    i = int(r / step)
    if i >= even:
        i = even + int(math.log(r / edge[even]) / math.log1p(widening))
    i = min(max(i, 0), last)
    return i, min(max((r - edge[i]) / (edge[i + 1] - edge[i]), 0.0), 1.0)


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


_HALF_WAY = math.sqrt(6.0)
"""Width of a step [pixels] at which the next level is as near: sqrt(3) sqrt(2), see `caustic_lookup` for the first."""


class PatternMaps(NamedTuple):
    """Mip levels of a `CausticStack` in one array, down to the first of odd size, as deviations from 1.

    values: (pixels of all levels, 4) float32, level after level, each (planes, rows, columns); sharp red, green, blue,
    and soft. start: (levels,) first pixel of each. size: of the finest. depth_m: (planes,). tile_m: side of a map.
    lean: (2,) x and z of the sun's direction over its y, which places points on the mean surface.
    """

    values: NDArray[np.float32]
    start: NDArray[np.int64]
    size: int
    depth_m: Array
    tile_m: float
    lean: Array


def pattern_maps(stack: CausticStack | None) -> PatternMaps:
    """Return the maps of a stack, None for no planes."""
    if stack is None:
        return PatternMaps(np.zeros((1, 4), np.float32), np.zeros(1, np.int64), 1, np.zeros(0), 1.0, np.zeros(2))
    planes, size = stack.ratio.shape[:2]
    halvings = (size & -size).bit_length()
    start = np.concatenate([[0], np.cumsum([planes * (size >> k) ** 2 for k in range(halvings)])])
    values = np.zeros((start[-1], 4), np.float32)
    soft = np.ones((1, 1, 1, 1)) if stack.soft is None else stack.soft
    _fill_levels(stack.ratio, soft, start[:-1], values)
    x, y, z = stack.sun_direction
    depth_m = np.asarray(stack.depth_m, np.float64)
    return PatternMaps(values, start[:-1], size, depth_m, float(stack.tile_m), np.array([x, z]) / y)


@fast
def _fill_levels(sharp: Any, soft: Any, start: Any, values: Any) -> None:
    """Write maps (planes, size, size, 3) and (planes, size, size, 1), or (1, 1, 1, 1), with all their halves."""
    planes, size = sharp.shape[:2]
    step = 1 if soft.shape[1] == size else 0
    for plane in range(planes):
        for j in range(size):
            for i in range(size):
                p = (plane * size + j) * size + i
                for c in range(3):
                    values[p, c] = sharp[plane, j, i, c] - 1.0
                values[p, 3] = soft[plane * step, j * step, i * step, 0] - 1.0
    for level in range(1, len(start)):
        fine = size >> (level - 1)
        for row in range(planes * (fine // 2)):
            plane, j = row // (fine // 2), row % (fine // 2)
            above = start[level - 1] + (plane * fine + 2 * j) * fine
            for i in range(fine // 2):
                p, q = above + 2 * i, above + fine + 2 * i
                for c in range(4):
                    total = values[p, c] + values[p + 1, c] + values[q, c] + values[q + 1, c]
                    values[start[level] + row * (fine // 2) + i, c] = 0.25 * total


@fast_making
def line_steps(pixel_m: Any, widening: Any, reach_m: Any) -> Any:
    """Return the edges (n + 1,) [m] of the steps of a line: `pixel_m` wide, or `widening` times the distance."""
    even = max(math.ceil(min(reach_m / pixel_m, 1.0 / widening)), 1)
    wide = max(math.ceil(math.log(max(reach_m / (even * pixel_m), 1.0)) / math.log1p(widening)), 0)
    edge = np.empty(even + wide + 1)
    for i in range(even + 1):
        edge[i] = i * pixel_m
    for i in range(wide):
        edge[even + 1 + i] = edge[even] * math.exp((i + 1) * math.log1p(widening))
    return edge


@fast
def fill_line(maps: Any, used: Any, place: Any, course: Any, edge: Any, sums: Any) -> None:
    """Write running sums of the maps along a line to `sums` (planes, n + 1, 4), each plane from its first step used on.

    used: (planes, 2) first and last step. place, course: (2,) where the line starts [m], and its change per metre of r.
    edge: (n + 1,) of `line_steps`.
    """
    values, start, size = maps.values, maps.start, maps.size
    scale, most = size / maps.tile_m, len(start) - 1
    u, v, du, dv = place[0] * scale, place[1] * scale, course[0] * scale, course[1] * scale
    speed = math.hypot(du, dv)
    for plane in range(len(used)):
        if used[plane, 1] >= 0:
            sums[plane, used[plane, 0]] = 0.0
        level, widest = 0, _HALF_WAY / speed
        for n in range(used[plane, 0], used[plane, 1] + 1):
            width = edge[n + 1] - edge[n]
            r = 0.5 * (edge[n] + edge[n + 1])
            while width > widest and level < most:
                level, widest = level + 1, 2.0 * widest
            x, y = (u + r * du) / (1 << level), (v + r * dv) / (1 << level)
            a0, a1, a2, a3 = _bilinear(values, start[level], size >> level, plane, x, y)
            sums[plane, n + 1, 0] = sums[plane, n, 0] + a0 * width
            sums[plane, n + 1, 1] = sums[plane, n, 1] + a1 * width
            sums[plane, n + 1, 2] = sums[plane, n, 2] + a2 * width
            sums[plane, n + 1, 3] = sums[plane, n, 3] + a3 * width


@inlined
def _bilinear(values: Any, start: Any, size: Any, plane: Any, x: Any, y: Any) -> Any:
    """Return the four values of a level of a plane, periodic and bilinear, at pixels (x, y) of that level."""
    x -= 0.5
    y -= 0.5
    i, j = math.floor(x), math.floor(y)
    fx, fy = x - i, y - j
    i0, j0, i1, j1 = i % size, j % size, (i + 1) % size, (j + 1) % size
    top, low = start + (plane * size + j0) * size, start + (plane * size + j1) * size
    w00, w10, w01, w11 = (1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy
    p, q, s, t = top + i0, top + i1, low + i0, low + i1
    return (
        values[p, 0] * w00 + values[q, 0] * w10 + values[s, 0] * w01 + values[t, 0] * w11,
        values[p, 1] * w00 + values[q, 1] * w10 + values[s, 1] * w01 + values[t, 1] * w11,
        values[p, 2] * w00 + values[q, 2] * w10 + values[s, 2] * w01 + values[t, 2] * w11,
        values[p, 3] * w00 + values[q, 3] * w10 + values[s, 3] * w01 + values[t, 3] * w11,
    )
