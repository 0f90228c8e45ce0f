# SPDX-License-Identifier: Apache-2.0
"""The light that reaches a place in the water, and what surfaces send back to the camera (reference renderer).

    ambient  E = ambient(N) ambient_ratio(d)
    beam     E = irradiance beam_ratio(d) (1 + (C - 1) s(d)) V
    V = s(d) V_disc + (1 - s(d)) V_halo

with d the depth, C the caustic ratio, s the share of the beam that the water has not scattered, V_disc the part of the
sun's disc that is seen and V_halo that of the wider disc from which the rest of the beam comes; the radiance of the
surface then goes through the water, L = T L_surface + veil. The gl renderer's layer.frag follows the same order.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mr360uw.caustics.lookup import caustic_lookup, mip_levels
from mr360uw.composite.lighting.occlusion import ambient_blocked, surfel_table
from mr360uw.composite.lighting.shading import dielectric_f0, lobe_axis, reflectance, sun_highlight
from mr360uw.composite.lighting.shadow import disc_directions, effective_half_angle
from mr360uw.composite.raycast.geometry import Hits
from mr360uw.composite.raycast.masked import MaskedScene
from mr360uw.composite.raycast.rays import RayScene
from mr360uw.composite.shot import Shot
from mr360uw.constants import INV_PI, REFRACTIVE_INDEX_SEA
from mr360uw.ibl.lookup import environment_lookup, glossy_lookup
from mr360uw.ibl.splitsum import split_sum
from mr360uw.medium.lookup import (
    ambient_ratio,
    beam_ratio,
    transmittance_lookup,
    unscattered_share,
    veil_lookup,
)
from mr360uw.types import Floats, Sun

UNNOTICED = 0.02
"""A body that blocks less than this part of the ambient light leaves it: two code values of 8 bits over metres."""
FADE_FROM = 0.8
"""Part of its extent from which the receiver fades out: no line across the ground where shadow or waves end."""
REFERENCE_SUN_FACTOR = 4
"""The reference takes so many more directions over the sun's disc than asked for: it stands for the limit."""
MINIMUM_SUN_UP = 0.05
"""Lower suns are treated as this high: their path through the water would be infinite."""


@dataclass(frozen=True, slots=True, eq=False)
class Radiance:
    """What a surface sends to the camera before the water takes its part, each (n, 3)."""

    diffuse: Floats
    glossy: Floats
    sun_diffuse: Floats
    sun_glossy: Floats
    caustics: Floats
    emission: Floats

    @property
    def total(self) -> Floats:
        """The sum; `caustics` is the part of the sun's that the waves added or took, so it is not added again."""
        return self.diffuse + self.glossy + self.sun_diffuse + self.sun_glossy + self.emission


class Light:
    """The light of one shot, with the opaque triangles (T, 3, 3) that shade; it finds those with a mask itself."""

    def __init__(self, shot: Shot, occluders: Floats) -> None:
        self.shot = shot
        self.sun = shot.sun if shot.sun is not None and shot.sun.direction[1] > 0.0 else None
        self._scene = RayScene(occluders)
        self._masked = MaskedScene(shot.objects, shot.camera_position)
        self._bias = np.array([placed.bias_m for placed in shot.objects if placed.visible])
        self._levels = mip_levels(shot.caustics.ratio) if shot.caustics is not None else []
        if self.sun is not None:
            self.sun_up = sun_up(self.sun)

    def depth(self, point: Floats) -> Floats:
        """Return the depth (n,) of points (n, 3) from the camera."""
        return depth_of(self.shot, point)

    def ambient(self, point: Floats, normal: Floats) -> Floats:
        """Return the ambient irradiance (n, 3) on a surface."""
        return environment_lookup(self.shot.environment.ambient, normal) * self._ambient_ratio(point)

    def _ambient_ratio(self, point: Floats) -> Floats:
        medium = self.shot.medium
        return np.ones((len(point), 3)) if medium is None else ambient_ratio(medium, self.depth(point))

    def beam(self, point: Floats) -> Floats:
        """Return the irradiance (n, 3) across the sun's beam without shadow and caustics."""
        if self.sun is None:
            return np.zeros((len(point), 3))
        medium = self.shot.medium
        ratio = 1.0 if medium is None else beam_ratio(medium, self.depth(point), self.sun_up)
        return np.broadcast_to(self.sun.irradiance, (len(point), 3)) * ratio

    def caustics(self, point: Floats, footprint_m: Floats) -> Floats:
        """Return the factor (n, 3) of the waves on the beam."""
        shot = self.shot
        if shot.caustics is None or self.sun is None:
            return np.ones((len(point), 3))
        depth, world = self.depth(point), point + shot.camera_position
        ratio = caustic_lookup(shot.caustics, self._levels, world[:, 0], depth, world[:, 2], footprint_m)
        contrast = 1.0 if shot.medium is None else unscattered_share(shot.medium, depth, self.sun_up)
        return 1.0 + (ratio - 1.0) * contrast

    def visibility(self, start: Floats) -> Floats:
        """Return the part (n,) of the sun's beam that reaches places (n, 3): of its disc and of the halo about it."""
        if self.sun is None or not (len(self._scene.triangles) or self._masked.there):
            return np.ones(len(start))
        seen, scattered = self._disc_seen(start, self.sun.half_angle_rad), scattered_share(self.shot, start)
        if np.any(scattered):
            seen = seen + scattered * (self._disc_seen(start, widest_half_angle(self.shot)) - seen)
        return seen

    def _disc_seen(self, start: Floats, half_angle_rad: float) -> Floats:
        """Return the part (n,) of a disc about the sun that is seen from places (n, 3)."""
        assert self.sun is not None
        seen = np.zeros(len(start))
        directions = disc_directions(self.sun.direction, half_angle_rad, REFERENCE_SUN_FACTOR * self.shot.sun_samples)
        for direction in directions:
            rays = np.broadcast_to(direction, start.shape)
            seen += ~(self._scene.occluded(start, rays) | self._masked.occluded(start, rays))
        return seen / len(directions)

    def surface(self, hits: Hits) -> Radiance:
        """Return the light that surfaces send towards the camera."""
        shot = self.shot
        view = -hits.direction
        n_dot_v = np.clip(np.sum(hits.normal * view, -1), 1e-3, 1.0)
        index = 1.0 if shot.medium is None else REFRACTIVE_INDEX_SEA
        dielectric = dielectric_f0(hits.refractive_index, index)[:, None]
        metal = hits.metallic[:, None]
        split = np.stack(split_sum(hits.roughness, n_dot_v), axis=-1)
        varnish = reflectance(np.broadcast_to(dielectric, hits.base.shape), split)
        coat = varnish * (1.0 - metal) + reflectance(hits.base, split) * metal
        albedo = hits.base * (1.0 - metal) * (1.0 - varnish)
        ambient = self.ambient(hits.point, hits.normal)
        axis = lobe_axis(hits.normal, view, n_dot_v, hits.roughness)
        environment = shot.environment
        if len(environment.glossy):
            reflected = glossy_lookup(environment.glossy, environment.glossy_roughness, axis, hits.roughness)
        else:
            reflected = environment_lookup(environment.ambient, axis) * INV_PI
        occlusion = hits.occlusion[:, None]
        diffuse = albedo * INV_PI * ambient * occlusion
        glossy = coat * reflected * self._ambient_ratio(hits.point) * occlusion
        zero = np.zeros_like(diffuse)
        if self.sun is None:
            return Radiance(diffuse, glossy, zero, zero, zero, hits.emission)
        n_dot_l = np.sum(hits.normal * self.sun.direction, -1)
        lit = np.flatnonzero((n_dot_l > 0.0) & (np.sum(hits.geometric_normal * self.sun.direction, -1) > 0.0))
        seen = np.zeros(len(n_dot_l))
        off = self._bias[hits.object[lit], None] * hits.geometric_normal[lit]
        seen[lit] = self.visibility(hits.point[lit] + off)
        waves = self.caustics(hits.point, hits.footprint_m)
        irradiance = self.beam(hits.point) * seen[:, None] * waves
        n_dot_l = np.maximum(n_dot_l, 0.0)
        half = view + self.sun.direction
        half = half / np.maximum(np.linalg.norm(half, axis=-1, keepdims=True), 1e-9)
        n_dot_h, v_dot_h = (np.clip(np.sum(a * half, -1), 0.0, 1.0) for a in (hits.normal, view))
        f0 = dielectric * (1.0 - metal) + hits.base * metal
        spread = shot.sun_spread_rad * np.sqrt(scattered_share(shot, hits.point))
        half_angle = effective_half_angle(self.sun.half_angle_rad, spread)
        highlight = sun_highlight(f0, hits.roughness**2, n_dot_v, n_dot_l, n_dot_h, v_dot_h, half_angle)
        sun_diffuse = albedo * INV_PI * irradiance * n_dot_l[:, None]
        sun_glossy = highlight * irradiance
        added = (sun_diffuse + sun_glossy) * (1.0 - 1.0 / np.maximum(waves, 1e-6))
        return Radiance(diffuse, glossy, sun_diffuse, sun_glossy, added, hits.emission)

    def receiver_share(self, point: Floats, normal: Floats) -> Floats:
        """Return the ambient part (n, 3) of what falls on the receiver without objects and waves; 0 in the dark."""
        ambient, beam = self.ambient(point, normal), self.beam(point)
        if self.sun is not None:
            beam = beam * np.maximum(normal @ self.sun.direction, 0.0)[:, None]
        return ambient / np.maximum(ambient + beam, 1e-9)

    def receiver_ratio(self, point: Floats, normal: Floats, distance_m: Floats) -> Floats:
        """Return E_with/E_without (n, 3) at points of the receiver, 1 where it ends."""
        shot, receiver = self.shot, self.shot.receiver
        assert receiver is not None
        free: Floats = np.ones(len(point))
        waves: Floats = np.ones((len(point), 3))
        if receiver.occlusion:
            casters = [placed for placed in shot.objects if placed.casts_shadow]
            free = unblocked(ambient_blocked(point, normal, surfel_table(casters, shot.camera_position)))
        seen = self.visibility(point) if receiver.shadow else np.ones(len(point))
        if receiver.caustics:
            waves = self.caustics(point, distance_m * np.pi / shot.height)
        share = self.receiver_share(point, normal)
        ratio = share * free[:, None] + (1.0 - share) * seen[:, None] * waves
        return 1.0 + receiver_weight(distance_m, receiver.extent_m)[:, None] * (ratio - 1.0)

    def water(self, distance_m: Floats, up: Floats) -> tuple[Floats, Floats]:
        """Return (transmittance, veil), each (n, 3), over camera rays of these lengths."""
        medium = self.shot.medium
        if medium is None:
            return np.ones((len(distance_m), 3)), np.zeros((len(distance_m), 3))
        return transmittance_lookup(medium, distance_m, up), veil_lookup(medium, distance_m, up)


def depth_of(shot: Shot, point: Floats) -> Floats:
    """Return the depth (n,) of points (n, 3) from the camera."""
    return shot.camera_depth_m - (point[:, 1] + shot.camera_position[1])


def sun_up(sun: Sun) -> float:
    """Return the sine of the sun's elevation in the water, at least `MINIMUM_SUN_UP`."""
    return max(float(sun.direction[1]), MINIMUM_SUN_UP)


def scattered_share(shot: Shot, point: Floats) -> Floats:
    """Return the part (n,) of the beam that the water has scattered into the halo, at points (n, 3) from the camera."""
    if shot.medium is None or shot.sun is None or shot.sun_spread_rad == 0.0:
        return np.zeros(len(point))
    return 1.0 - unscattered_share(shot.medium, depth_of(shot, point), sun_up(shot.sun)).mean(axis=-1)


def widest_half_angle(shot: Shot) -> float:
    """Return the angular radius [rad] of the disc that a shot's sunlight comes from: with water, that of its halo."""
    if shot.sun is None:
        return 0.0
    spread = shot.sun_spread_rad if shot.medium is not None else 0.0
    return float(effective_half_angle(shot.sun.half_angle_rad, spread))


def unblocked(blocked: Floats) -> Floats:
    """Return the part (...,) of the ambient light that bodies leave.

    What is blocked fades to nothing at `UNNOTICED`, so that a body changes a bounded part of the receiver.
    """
    return 1.0 - np.maximum(np.minimum(blocked, 1.0) - UNNOTICED, 0.0) / (1.0 - UNNOTICED)


def receiver_weight(distance_m: Floats, extent_m: float) -> Floats:
    """Return how much (...,) of its change the receiver shows: 1, and from `FADE_FROM` of its extent on less, to 0."""
    t = np.clip((np.asarray(distance_m) / extent_m - FADE_FROM) / (1.0 - FADE_FROM), 0.0, 1.0)
    return 1.0 - t * t * (3.0 - 2.0 * t)
