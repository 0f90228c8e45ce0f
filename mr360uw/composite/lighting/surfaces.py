# SPDX-License-Identifier: Apache-2.0
"""Radiance of surfaces towards the camera, from ambient light and all light sources (reference renderer).

    ambient  E = ambient(N) ambient_ratio(d, N) R        L = T L_surface + veil

with d the depth, R what bodies leave of it and add (ambient/solver.py), T and veil those of the water in front. On the
device: layer.frag.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mr360uw.composite.lighting.shading import (
    PIXEL_POINTS,
    dielectric_f0,
    highlight,
    lobe_axis,
    reflectance,
    resolved_alpha,
)
from mr360uw.composite.lighting.sun import Arrival, LightSource
from mr360uw.composite.raycast.geometry import Hits
from mr360uw.composite.shot import Shot
from mr360uw.constants import INV_PI
from mr360uw.ibl.lookup import environment_lookup, glossy_lookup
from mr360uw.ibl.splitsum import split_sum
from mr360uw.medium.lookup import ambient_ratio, transmittance_lookup, veil_lookup
from mr360uw.types import Floats, MediumTable


@dataclass(frozen=True, slots=True, eq=False)
class Reflected:
    """Light of one source that surfaces reflect to the camera, before attenuation by the water, each (n, 3).

    variable: its output variable. pattern: the change of diffuse and glossy by the waves, of either sign.
    """

    variable: str
    diffuse: Floats
    glossy: Floats
    pattern: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Radiance:
    """Radiance of surfaces towards the camera, before attenuation by the water and with their trim, each (n, 3).

    diffuse, glossy: reflected ambient light. direct: reflected light of every source.
    """

    diffuse: Floats
    glossy: Floats
    direct: tuple[Reflected, ...]
    emission: Floats

    @property
    def total(self) -> Floats:
        """Sum of all light. Patterns are contained in the reflected light, so they are not added again."""
        total = self.diffuse + self.glossy
        for light in self.direct:
            total = total + light.diffuse + light.glossy
        return total + self.emission

    def of(self, variable: str) -> Floats:
        """Return the direct light (n, 3) of an output variable."""
        zero = np.zeros_like(self.diffuse)
        return sum((light.diffuse + light.glossy for light in self.direct if light.variable == variable), zero)

    @property
    def caustics(self) -> Floats:
        """Change of the direct light by the waves, (n, 3), of either sign."""
        return sum((light.pattern for light in self.direct), np.zeros_like(self.diffuse))


@dataclass(frozen=True, slots=True, eq=False)
class _Coat:
    """Reflection of surfaces (n, 3): direction to the camera, reflectance at normal incidence, diffuse albedo."""

    view: Floats
    f0: Floats
    albedo: Floats


def ambient_irradiance(shot: Shot, point: Floats, normal: Floats) -> Floats:
    """Return the unoccluded ambient irradiance (n, 3) on surfaces."""
    return environment_lookup(shot.environment.ambient, normal) * _ambient_factor(shot, point, normal)


def _ambient_factor(shot: Shot, point: Floats, normal: Floats) -> Floats:
    if shot.medium is None:
        return np.ones((len(point), 3))
    return ambient_ratio(shot.medium, shot.view.depth_of(point), normal[:, 1])


def surface_radiance(shot: Shot, sources: Sequence[LightSource], hits: Hits, among_bodies: Floats) -> Radiance:
    """Return the radiance of surfaces towards the camera. among_bodies: (n, CHANNELS) of `ambient_at`."""
    environment, view = shot.environment, -hits.direction
    n_dot_v = np.clip(np.sum(hits.normal * view, -1), 1e-3, 1.0)
    dielectric = dielectric_f0(hits.refractive_index, shot.refractive_index)[:, None]
    metal = hits.metallic[:, None]
    split = np.stack(split_sum(hits.roughness, n_dot_v), axis=-1)
    varnish = reflectance(np.broadcast_to(dielectric, hits.base.shape), split)
    mirrors = varnish * (1.0 - metal) + reflectance(hits.base, split) * metal
    albedo = hits.base * (1.0 - metal) * (1.0 - varnish)
    axis = lobe_axis(hits.normal, view, n_dot_v, hits.roughness)
    ratio = among_bodies[:, :3]
    if len(environment.glossy):
        reflected = glossy_lookup(environment.glossy, environment.glossy_roughness, axis, hits.roughness)
        reflected = reflected * among_bodies[:, 4:7] + among_bodies[:, 8:11]
    else:
        reflected = environment_lookup(environment.ambient, axis) * INV_PI * ratio
    occlusion = hits.occlusion[:, None]
    coat = _Coat(view, dielectric * (1.0 - metal) + hits.base * metal, albedo)
    bias_m = np.array([placed.bias_m for placed in shot.objects if placed.visible])[hits.object]
    return Radiance(
        diffuse=hits.trim * albedo * INV_PI * ambient_irradiance(shot, hits.point, hits.normal) * ratio * occlusion,
        glossy=hits.trim * mirrors * reflected * _ambient_factor(shot, hits.point, axis) * occlusion,
        direct=tuple(_reflected(source, hits, coat, bias_m) for source in sources),
        emission=hits.trim * hits.emission,
    )


def _reflected(source: LightSource, hits: Hits, coat: _Coat, bias_m: Floats) -> Reflected:
    """Return the light of one source that surfaces reflect to the camera."""
    arrival = source.arrival(hits.point)
    n_dot_l = np.sum(hits.normal * arrival.direction, -1)
    lit = np.flatnonzero((n_dot_l > 0.0) & (np.sum(hits.geometric_normal * arrival.direction, -1) > 0.0))
    seen = np.zeros(len(n_dot_l))
    area = hits.footprint.some(lit)
    seen[lit] = source.visibility(area.middle + bias_m[lit, None] * hits.geometric_normal[lit], area.sides)
    waves = source.pattern(hits.point, hits.footprint_m)
    irradiance = hits.trim * arrival.irradiance * seen[:, None] * waves
    n_dot_l = np.maximum(n_dot_l, 0.0)
    diffuse, glossy = coat.albedo * INV_PI * irradiance * n_dot_l[:, None], _highlight(arrival, hits, coat) * irradiance
    pattern = (diffuse + glossy) * (1.0 - 1.0 / np.maximum(waves, 1e-6))
    return Reflected(source.variable, diffuse, glossy, pattern)


def _highlight(arrival: Arrival, hits: Hits, coat: _Coat) -> Floats:
    """Return the mean highlight (n, 3) of pixels for an irradiance of 1."""
    half = coat.view + arrival.direction
    half = half / np.maximum(np.linalg.norm(half, axis=-1, keepdims=True), 1e-9)
    v_dot_h, alpha = np.clip(np.sum(coat.view * half, -1), 0.0, 1.0), resolved_alpha(hits.roughness, hits.normal_change)
    total = np.zeros_like(hits.normal)
    for place in PIXEL_POINTS:
        normal = hits.normal + np.einsum("k,nkc->nc", place, hits.normal_change)
        normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
        n_dot_v = np.clip(np.sum(normal * coat.view, -1), 1e-3, 1.0)
        n_dot_l = np.maximum(np.sum(normal * arrival.direction, -1), 0.0)
        n_dot_h = np.clip(np.sum(normal * half, -1), 0.0, 1.0)
        total += highlight(coat.f0, alpha, n_dot_v, n_dot_l, n_dot_h, v_dot_h, arrival.half_angle_rad)
    return total / len(PIXEL_POINTS)


def water_ahead(shot: Shot, distance_m: Floats, direction: Floats) -> tuple[Floats, Floats]:
    """Return (transmittance, veil), each (n, 3), of camera rays of lengths `distance_m` in directions (n, 3)."""
    if shot.medium is None:
        return np.ones((len(distance_m), 3)), np.zeros((len(distance_m), 3))
    through = transmittance_lookup(shot.medium, distance_m, direction[:, 1])
    return through, veil_ahead(shot.medium, distance_m, direction)


def veil_ahead(table: MediumTable, distance_m: Floats, direction: Floats) -> Floats:
    """Return the veil (..., 3) of camera rays of lengths (...,) in directions (..., 3), matched to the plate."""
    veil = veil_lookup(table, distance_m, direction[..., 1])
    return veil if table.plate_ratio is None else veil * environment_lookup(table.plate_ratio, direction)
