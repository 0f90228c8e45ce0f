# SPDX-License-Identifier: Apache-2.0
"""Deviation of the sun's beam in segments of many rays: what `ShaftScene.segments` returns, by tables and maps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import Cache, PartOf
from mr360uw.medium.shafts.beam_kernel import add_beam
from mr360uw.medium.shafts.beam_pattern import BeamPattern
from mr360uw.medium.shafts.body_shadows import DISC_TAPS, HALO_TAPS, Shadows, shadows_of, visible_parts
from mr360uw.medium.shafts.pattern_lines import PatternMaps
from mr360uw.medium.shafts.ray_segments import radius_at
from mr360uw.medium.shafts.shaft_scene import ShaftScene
from mr360uw.sphere import unit

Array = NDArray[np.float64]

_HEIGHTS = 257
"""Heights of rays at which the light of segments is tabulated."""
_PARTS = 4
"""Parts of a segment that are tested by rays, for bodies without bounds."""
_NO_MAPS = PatternMaps(
    np.zeros((1, 4), np.float32), np.zeros(1, np.int64), 1, np.zeros(0), 1.0, np.zeros(2)
)  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class SunBeam:
    """What rays need. weights: (heights, count, 12) `whole` and `sharp` of `ShaftWater.beam_segments`. maps: of the
    caustics. shadows: of bodies on the disc and the halo, None without bodies or where a body has no bounds.
    """

    scene: ShaftScene
    pattern: BeamPattern
    weights: NDArray[np.float32]
    maps: PatternMaps
    shadows: Shadows | None

    @classmethod
    def of(cls, scene: ShaftScene, pattern: BeamPattern, count: int, cache: Cache) -> SunBeam:
        """Return the beam of a scene for rays of `count` segments. cache: holds weights, and the shadows of bodies."""
        weights = cache.of(_weights, PartOf(scene, scene.water, scene.depth_m, scene.sun_up), count, keep=4)
        shadows = shadows_of(pattern, cache)
        maps = _NO_MAPS if pattern.caustics is None else PatternMaps.of(pattern.caustics)
        return cls(scene, pattern, weights, maps, shadows)

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
        of = self.shadows.outlines
        for k, (maps, taps) in enumerate(((self.shadows.disc, DISC_TAPS), (self.shadows.halo, HALO_TAPS))):
            visible_parts(
                self.scene.origin, rays, start, end, of.centre, of.radius, of.frame, of.apart, maps.frame, maps.top,
                maps.spread, taps, seen[:, :, k],
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
