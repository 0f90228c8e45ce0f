# SPDX-License-Identifier: Apache-2.0
"""Radiance of surfaces towards the camera, from ambient light and all light sources (reference renderer).

    ambient  E = ambient(N) ambient_ratio(d, N) R        L = T L_surface + veil

with d the depth, R what bodies leave of it and add (ambient/solver.py), T and veil those of the water in front. On the
device: layer.frag.
"""

from __future__ import annotations

from collections.abc import Sequence

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


def ambient_irradiance(shot: Shot, point: Floats, normal: Floats) -> Floats:
    """Return the unoccluded ambient irradiance (n, 3) on surfaces."""
    return environment_lookup(shot.environment.ambient, normal) * _ambient_factor(shot, point, normal)


def _ambient_factor(shot: Shot, point: Floats, normal: Floats) -> Floats:
    if shot.medium is None:
        return np.ones((len(point), 3))
    return ambient_ratio(shot.medium, shot.view.depth_of(point), normal[:, 1])


def surface_radiance(
    shot: Shot, sources: Sequence[LightSource], hits: Hits, among_bodies: Floats, *, footprints: bool = True
) -> tuple[Floats, dict[str, Floats]]:
    """Return the radiance (n, 3) of surfaces towards the camera, before attenuation by the water and with their trim,
    and its parts by output variable.

    Parts: reflected ambient light, diffuse and glossy; reflected light of the sun and of lamps; emission; and caustics,
    the change of the reflected light by the waves, of either sign, which it contains. among_bodies: (n, CHANNELS) of
    `ambient_at`. footprints: whether shadows are averaged over the pixels' footprints, or those of points.
    """
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
    coat = view, dielectric * (1.0 - metal) + hits.base * metal, albedo
    bias_m = np.array([placed.bias_m for placed in shot.visible])[hits.object]
    diffuse = hits.trim * albedo * INV_PI * ambient_irradiance(shot, hits.point, hits.normal) * ratio * occlusion
    glossy = hits.trim * mirrors * reflected * _ambient_factor(shot, hits.point, axis) * occlusion
    emission = hits.trim * hits.emission
    total, direct = diffuse + glossy, {name: np.zeros_like(diffuse) for name in ("sun", "lamps", "caustics")}
    for source in sources:
        matt, shiny, pattern = _reflected(source, hits, coat, bias_m, footprints)
        total = total + matt + shiny
        direct[source.variable] = direct[source.variable] + (matt + shiny)
        direct["caustics"] = direct["caustics"] + pattern
    return total + emission, {"diffuse": diffuse, "glossy": glossy, "emission": emission, **direct}


def _reflected(
    source: LightSource, hits: Hits, coat: tuple[Floats, Floats, Floats], bias_m: Floats, footprints: bool
) -> tuple[Floats, Floats, Floats]:
    """Return the light (n, 3) of one source that surfaces reflect to the camera, diffuse and glossy, and the change of
    both by the waves.

    coat: (n, 3) direction to the camera, reflectance at normal incidence, diffuse albedo.
    """
    arrival = source.arrival(hits.point)
    towards, arriving, _ = arrival
    n_dot_l = np.sum(hits.normal * towards, -1)
    lit = np.flatnonzero((n_dot_l > 0.0) & (np.sum(hits.geometric_normal * towards, -1) > 0.0))
    seen = np.zeros(len(n_dot_l))
    start = hits.area_middle[lit] + bias_m[lit, None] * hits.geometric_normal[lit]
    seen[lit] = source.visibility(start, hits.area_sides[lit] if footprints else None)
    waves = source.pattern(hits.point, hits.footprint_m)
    irradiance = hits.trim * arriving * seen[:, None] * waves
    n_dot_l = np.maximum(n_dot_l, 0.0)
    view, f0, albedo = coat
    diffuse, glossy = albedo * INV_PI * irradiance * n_dot_l[:, None], _highlight(arrival, hits, view, f0) * irradiance
    return diffuse, glossy, (diffuse + glossy) * (1.0 - 1.0 / np.maximum(waves, 1e-6))


def _highlight(arrival: Arrival, hits: Hits, view: Floats, f0: Floats) -> Floats:
    """Return the mean highlight (n, 3) of pixels for an irradiance of 1. view: to the camera. f0: as of `highlight`."""
    towards, _, half_angle_rad = arrival
    half = view + towards
    half = half / np.maximum(np.linalg.norm(half, axis=-1, keepdims=True), 1e-9)
    v_dot_h, alpha = np.clip(np.sum(view * half, -1), 0.0, 1.0), resolved_alpha(hits.roughness, hits.normal_change)
    total = np.zeros_like(hits.normal)
    for place in PIXEL_POINTS:
        normal = hits.normal + np.einsum("k,nkc->nc", place, hits.normal_change)
        normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
        n_dot_v = np.clip(np.sum(normal * view, -1), 1e-3, 1.0)
        n_dot_l = np.maximum(np.sum(normal * towards, -1), 0.0)
        n_dot_h = np.clip(np.sum(normal * half, -1), 0.0, 1.0)
        total += highlight(f0, alpha, n_dot_v, n_dot_l, n_dot_h, v_dot_h, half_angle_rad)
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
