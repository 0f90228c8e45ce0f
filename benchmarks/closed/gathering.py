# SPDX-License-Identifier: Apache-2.0
"""Light at points in the water of a dive, from sea, sky, sun and floor, gathered ray by ray.

    E(p, n) = sum over rays about n of L + E_beam,  L = V + T (sky through the level surface, floor or body)

V, T: veil and transmittance of the solved fields of sky and sun, for a camera at the point. E_beam: the sun's beam, in
a part that has not turned, with the sea's caustics, and one that has turned by small angles, with their blurred
pattern. Each has the visibility of its own directions.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from benchmarks.closed.bodies import Body
from benchmarks.closed.dives import Dive
from mr360uw.base.caustic_lookup import caustic_lookup, mip_levels
from mr360uw.base.constants import PI, REFRACTIVE_INDEX_SEA
from mr360uw.base.optics import diffuse_reflectance_from_below, fresnel_from_below, fresnel_transmittance
from mr360uw.base.sphere import basis, directions, disc_directions, row_solid_angle, unit
from mr360uw.caustics import CausticSettings, caustic_stack
from mr360uw.ibl.lookup import environment_lookup
from mr360uw.medium import Medium, Water
from mr360uw.medium.lookup import beam_fraction, transmittance_lookup, veil_lookup
from mr360uw.medium.scattered_light import spread_of
from mr360uw.types import CausticStack, Floats, MediumTable

N = REFRACTIVE_INDEX_SEA
RAYS = 192
"""Rays about a normal: the light on a point has a noise of 1 to 2 %, different at every point."""
_SUN_RAYS, _TURNED_RAYS = 32, 64
_STEP_M = 0.1
"""Interval of depths that tables are made for: 1 % of the light in the murkiest water."""
_JUST_BELOW_M = 0.01
_AT_ONCE = 1 << 19


@dataclass(frozen=True, eq=False)
class WaterTables:
    """Light of sky and sun in the water of a dive, without bodies."""

    dive: Dive

    @functools.cached_property
    def parts(self) -> tuple[tuple[Floats, Medium], tuple[Floats, Medium]]:
        """Irradiance (3,) just below the surface and its medium: of the sky, and of the sun."""
        dive, water = self.dive, Water.jerlov(self.dive.water)
        rows = directions(128, 64)[:32, :, 1]
        weight = rows * row_solid_angle(128, 64)[:32, None] * fresnel_transmittance(rows, N)
        sky = np.einsum("hwc,hw->c", dive.dome[:32], weight)
        up = float(dive.sun_in_air[1])
        sun = dive.sun.irradiance * up * fresnel_transmittance(up, N)
        of_sun = Medium(water, camera_depth_m=_JUST_BELOW_M, sky=("sun", float(dive.sun_in_water[1]), 1.0))
        return (sky, Medium(water, camera_depth_m=_JUST_BELOW_M)), (sun, of_sun)

    @functools.cache  # noqa: B019 - lives as long as the dive
    def tables(self, step: int) -> tuple[MediumTable, MediumTable]:
        """Return the tables of sky and sun for a point at a depth of so many steps."""
        depth = max(step * _STEP_M, _JUST_BELOW_M)
        return tuple(m.at_depth(depth).unit_table for _, m in self.parts)  # type: ignore[return-value]

    def along(self, step: int, distance_m: Floats, up: Floats) -> tuple[Floats, Floats]:
        """Return transmittance and veil (n, 3) of rays (n,) from that depth."""
        tables = self.tables(step)
        veil = sum(below * veil_lookup(t, distance_m, up) for (below, _), t in zip(self.parts, tables, strict=True))
        return transmittance_lookup(tables[0], distance_m, up), np.asarray(veil)

    def down(self, depth_m: float) -> Floats:
        """Return the irradiance (3,) on a level plane, all light."""
        return sum((b * m.light.display(m.model.irradiance(depth_m, 1.0)) for b, m in self.parts), np.zeros(3))

    def beam(self, depth_m: Floats) -> tuple[Floats, Floats]:
        """Return the irradiance (n, 3) on a level plane by light of the sun that has not turned, and that has a bit."""
        below, medium = self.parts[1]
        up = float(self.dive.sun_in_water[1])
        depth = np.asarray(depth_m, np.float64)
        sharp = below * medium.light.display(np.exp(-medium.model.attenuation * depth[..., None] / up))
        return sharp, np.maximum(below * beam_fraction(medium.unit_table, depth, up) - sharp, 0.0)

    @functools.cached_property
    def echo(self) -> Floats:
        """Factor (3,) on the floor's light by what the surface sends back of it."""
        depth = self.dive.floor_depth_m
        twice = transmittance_lookup(self.tables(0)[0], np.array([depth]), np.array([-1.0]))[0] ** 2
        back = diffuse_reflectance_from_below(N, -np.log(twice))
        return 1.0 / (1.0 - self.dive.floor.mean_albedo * back)

    @functools.cached_property
    def on_floor(self) -> tuple[Floats, Floats, Floats]:
        """Irradiance (3,) of the floor, means over the waves: ambient, of the beam that has not turned, that has."""
        sharp, turned = self.beam(np.array([self.dive.floor_depth_m]))
        ambient = self.down(self.dive.floor_depth_m) - sharp[0] - turned[0]
        return self.echo * np.maximum(ambient, 0.0), self.echo * sharp[0], self.echo * turned[0]

    @functools.cached_property
    def sun_directions(self) -> tuple[Floats, Floats]:
        """Directions (n, 3) that light comes from that has not turned, and that has, at the floor's depth.

        Light turned by theta on the way arrives within theta of the sun; Gaussians of its place over a plane have 3 of
        its angle's variance in 1, as it turns anywhere on the path.
        """
        sun, spread = self.dive.sun_in_water, spread_of(self.parts[1][1])
        sharp = disc_directions(sun, self.dive.sun.half_angle_rad / N, _SUN_RAYS)
        if spread is None:
            return sharp, sharp
        weight = spread.weights(self.dive.floor_depth_m / float(sun[1]))
        radius = np.linspace(0.0, 1.2, 4001)
        spreads = np.sqrt(3.0) * spread.angle_rad
        below = weight @ -np.expm1(-0.5 * (radius / spreads[:, None]) ** 2)
        at = np.interp((np.arange(_TURNED_RAYS) + 0.5) / _TURNED_RAYS * below[-1], below, radius)
        turn = 2.399963229728653 * np.arange(_TURNED_RAYS)
        u, v, w = basis(sun)
        turned = unit(w + np.tan(at)[:, None] * (np.cos(turn)[:, None] * u + np.sin(turn)[:, None] * v))
        return sharp, turned[turned[:, 1] > 0.02]


@dataclass(frozen=True, eq=False)
class Caustics:
    """Patterns of the sun's light over the depths of body and floor at one time."""

    stack: CausticStack

    @classmethod
    def of(cls, dive: Dive, water: WaterTables, shallowest_m: float, time_s: float, planes: int = 6) -> Caustics:
        """Return the patterns from a depth down to the floor."""
        depths = np.linspace(max(shallowest_m, 0.05), dive.floor_depth_m, planes)
        settings = CausticSettings(sun_half_angle_rad=dive.sun.half_angle_rad)
        return cls(caustic_stack(dive.sea, dive.sun_in_air, depths, time_s, settings, N, spread_of(water.parts[1][1])))

    @functools.cached_property
    def _levels(self) -> tuple[list[Floats], list[Floats] | None]:
        return mip_levels(self.stack.ratio), None if self.stack.soft is None else mip_levels(self.stack.soft)

    def at(self, point: Floats, depth_m: Floats, footprint_m: Floats) -> tuple[Floats, Floats]:
        """Return both patterns (n, 3), mean 1, at points (n, 3) of the world."""
        sharp, soft = (
            np.ones((len(point), 3))
            if levels is None
            else caustic_lookup(self.stack, levels, point[:, 0], depth_m, point[:, 2], footprint_m)
            for levels in self._levels
        )
        return sharp, soft


@dataclass(frozen=True, eq=False)
class GroundPatch:
    """Light on the floor about a body, on a grid: what the body leaves of each kind, 1 far away.

    middle: (2,) over (x, z). half_m: half its side. ambient: (g, g, 3); sharp, turned: (g, g).
    """

    middle: Floats
    half_m: float
    ambient: Floats
    sharp: Floats
    turned: Floats

    def left(self, values: Floats, x: Floats, z: Floats) -> Floats:
        """Return values of the grid at places (n,), bilinear, 1 outside."""
        g = len(values)
        u, v = ((a - m + self.half_m) / (2.0 * self.half_m) * (g - 1) for a, m in zip((x, z), self.middle, strict=True))
        inside = (u > 0.0) & (u < g - 1) & (v > 0.0) & (v < g - 1)
        u, v = np.where(inside, u, 0.0), np.where(inside, v, 0.0)
        i, j = np.minimum(u.astype(int), g - 2), np.minimum(v.astype(int), g - 2)
        fu, fv = ((a - k).reshape(-1, *(1,) * (values.ndim - 2)) for a, k in ((u, i), (v, j)))
        near = (values[j, i] * (1 - fu) + values[j, i + 1] * fu) * (1 - fv) + (
            values[j + 1, i] * (1 - fu) + values[j + 1, i + 1] * fu
        ) * fv
        return np.where(inside.reshape(fu.shape), near, 1.0)


def seen(body: Body | None, start: Floats, rays: Floats) -> Floats:
    """Return which (n, r) of directions (r, 3) the body leaves free at points (n, 3)."""
    if body is None:
        return np.ones((len(start), len(rays)))
    origin = np.repeat(start, len(rays), axis=0)
    return ~body.rays.occluded(origin, np.tile(rays, (len(start), 1))).reshape(len(start), -1)


@dataclass(frozen=True, eq=False)
class Gathering:
    """Light gathered by rays, with a body and the floor about it, or without.

    body_radiance: (V, 3) of the body's vertices, None for a black one.
    """

    dive: Dive
    water: WaterTables
    body: Body | None = None
    body_radiance: Floats | None = None
    ground: GroundPatch | None = None

    def depth(self, point: Floats) -> Floats:
        """Return the depth (n,) of points (n, 3) below the mean surface."""
        return self.dive.camera_depth_m - point[..., 1]

    def ambient(self, start: Floats, normal: Floats, rays: int = RAYS) -> Floats:
        """Return the irradiance (n, 3) of points by all light but the sun's beam."""
        out = np.empty((len(start), 3))
        steps = np.rint(self.depth(start) / _STEP_M).astype(int)
        for step in np.unique(steps):
            which = np.flatnonzero(steps == step)
            for begin in range(0, len(which), max(_AT_ONCE // rays, 1)):
                part = which[begin : begin + max(_AT_ONCE // rays, 1)]
                out[part] = self._gathered(int(step), start[part], normal[part], rays, part)
        return out

    def _gathered(self, step: int, start: Floats, normal: Floats, rays: int, number: Floats) -> Floats:
        """Cosine-weighted rays in a Fibonacci spiral, turned by the golden ratio from point to point."""
        k = np.arange(rays)
        radius, height = np.sqrt((k + 0.5) / rays), np.sqrt(1.0 - (k + 0.5) / rays)
        turn = 2.399963229728653 * k + 2.0 * PI * np.remainder(0.754877666 * number, 1.0)[:, None]
        frames = np.stack([basis(n) if abs(n[1]) < 1.0 - 1e-9 else _level(n) for n in normal])
        local = np.stack([radius * np.cos(turn), radius * np.sin(turn), np.broadcast_to(height, turn.shape)], axis=-1)
        direction = np.einsum("nrk,nkc->nrc", local, frames).reshape(-1, 3)
        light = self.radiance(step, np.repeat(start, rays, axis=0), direction)
        return PI * light.reshape(len(start), rays, 3).mean(axis=1)

    def radiance(self, step: int, start: Floats, direction: Floats) -> Floats:
        """Return the radiance (n, 3) from directions (n, 3), the sun's beam left out."""
        dive, up = self.dive, direction[:, 1]
        depth = max(step * _STEP_M, _JUST_BELOW_M)
        rising = up > 0.0
        slope = np.maximum(np.abs(up), 1e-5)
        far = np.where(rising, depth, np.maximum(dive.floor_depth_m - depth, 1e-3)) / slope
        end = np.zeros((len(up), 3))
        end[rising] = self._from_surface(start[rising], direction[rising], far[rising])
        falling = ~rising
        place = start[falling] + far[falling, None] * direction[falling]
        end[falling] = self._floor(place[:, 0], place[:, 2])
        if self.body is not None:
            met, corners, weights = self.body.hit(start, direction)
            point = np.einsum("hk,hkc->hc", weights, self.body.points[corners])
            far[met] = np.linalg.norm(point - start[met], axis=-1)
            shown = 0.0 if self.body_radiance is None else self.body_radiance[corners]
            end[met] = 0.0 if self.body_radiance is None else np.einsum("hk,hkc->hc", weights, shown)
        passed, veil = self.water.along(step, far, up)
        return veil + passed * end

    def _from_surface(self, start: Floats, direction: Floats, far: Floats) -> Floats:
        """Return the radiance (n, 3) that comes down from the level surface: sky, and the floor's mirror image."""
        up = direction[:, 1]
        mirrored = fresnel_from_below(up, N)
        across = N * direction[:, [0, 2]]
        high = np.sqrt(np.maximum(1.0 - np.sum(across**2, axis=-1), 0.0))
        in_air = np.stack([across[:, 0], high, across[:, 1]], axis=-1)
        sky = environment_lookup(self.dive.dome, in_air) * ((1.0 - mirrored) * N * N)[:, None]
        down = self.dive.floor_depth_m / np.maximum(up, 1e-4)
        place = start + far[:, None] * direction + down[:, None] * direction * np.array([1.0, -1.0, 1.0])
        passed, veil = self.water.along(0, np.minimum(down, 1e5), -up)
        return sky + mirrored[:, None] * (veil + passed * self._floor(place[:, 0], place[:, 2]))

    def _floor(self, x: Floats, z: Floats) -> Floats:
        """Return the floor's radiance (n, 3), means over waves and sand, with the body's shade."""
        ambient, sharp, turned = self.water.on_floor
        albedo, ground = self.dive.floor.mean_albedo / PI, self.ground
        if ground is None:
            return np.broadcast_to(albedo * (ambient + sharp + turned), (len(x), 3))
        light = ambient * ground.left(ground.ambient, x, z)
        light += sharp * ground.left(ground.sharp, x, z)[:, None]
        return albedo * (light + turned * ground.left(ground.turned, x, z)[:, None])

    def map(self, columns: int) -> Floats:
        """Return the radiance (columns/2, columns, 3) about the camera, the sun's beam left out."""
        view = directions(columns, columns // 2).reshape(-1, 3)
        step = self.dive.camera_depth_m / _STEP_M
        low = int(step)
        a, b = (self.radiance(k, np.zeros_like(view), view) for k in (low, low + 1))
        return (a + (step - low) * (b - a)).reshape(columns // 2, columns, 3)

    def beam(self, start: Floats, normal: Floats, pattern: tuple[Floats, Floats] | None = None) -> Floats:
        """Return the irradiance (n, 3) of points by the sun's beam. pattern: caustics there, each (n, 3)."""
        sums = []
        for rays in self.water.sun_directions:
            cosine = np.maximum(normal @ rays.T, 0.0)
            lit = np.flatnonzero(cosine.max(axis=1) > 0.0)
            cosine[lit] *= seen(self.body, start[lit], rays)
            sums.append(cosine.sum(axis=1) / rays[:, 1].sum())
        sharp, turned = self.water.beam(self.depth(start))
        a, b = (1.0, 1.0) if pattern is None else pattern
        return sharp * a * sums[0][:, None] + turned * b * sums[1][:, None]

    def ground_patch(self, cells: int = 48) -> GroundPatch:
        """Return what the body leaves of the light on the floor about it."""
        assert self.body is not None
        dive, body = self.dive, self.body
        low, high = body.points.min(axis=0), body.points.max(axis=0)
        middle, reach = 0.5 * (low + high)[[0, 2]], float(np.linalg.norm(high - low))
        half = 2.0 * reach
        place = np.linspace(-half, half, cells)
        x, z = (g.ravel() for g in np.meshgrid(place + middle[0], place + middle[1]))
        start = np.stack([x, np.full_like(x, -dive.above_floor_m + 1e-4), z], axis=-1)
        normal = np.broadcast_to([0.0, 1.0, 0.0], start.shape)
        free = Gathering(dive, self.water)
        ratio = self.ambient(start, normal) / free.ambient(start, normal)
        light = [seen(body, start, rays) @ rays[:, 1] / rays[:, 1].sum() for rays in self.water.sun_directions]
        grid = (cells, cells)
        return GroundPatch(middle, half, ratio.reshape(*grid, 3), light[0].reshape(grid), light[1].reshape(grid))


def _level(normal: Floats) -> Floats:
    """Return axes about an upright normal."""
    return np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -np.sign(normal[1])], normal])
