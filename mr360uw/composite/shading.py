# SPDX-License-Identifier: Apache-2.0
"""Radiance of surfaces towards the camera: metallic-roughness, a split-sum environment, and directed lights.

    symbol          here            unit     meaning
    alpha           alpha           1        width of the GGX lobe, roughness^2
    F0              f0              1        reflectance at normal incidence, (..., 3)
    A, B            split           1        integrals of the split sum: reflectance = F0 A + B

GGX distribution (Walter et al. 2007 eq. 33), Smith visibility with correlated heights (Heitz 2014), Schlick's Fresnel
term, split sum (Karis 2013), its energy for several bounces (Fdez-Aguera 2019). The diffuse part gets the light that
the coat does not reflect, so a white body in white light is white. Below water the Fresnel term is that of the surface
against water, an eighth of that in air. Twin: shading.glsl.

`surface_radiance` of the reference renderer sums them up:

    ambient  E = ambient(N) ambient_ratio(d, N) R        L = T L_surface + veil

with d the depth, R what bodies leave of it and add (ambient/solver.py), T and veil those of the water in front. On the
device: layer.frag.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from mr360uw.base.constants import INV_PI
from mr360uw.composite.light_sources import Arrival, LightSource
from mr360uw.composite.raycast import Hits
from mr360uw.composite.shot import Shot
from mr360uw.ibl.filters import split_sum
from mr360uw.ibl.lookup import environment_lookup, glossy_lookup
from mr360uw.medium.lookup import ambient_ratio, transmittance_lookup, veil_lookup
from mr360uw.types import Floats, MediumTable


def ambient_there(shot: Shot, light: Floats, point: Floats, normal: Floats) -> Floats:
    """Return the ambient light (n, 3) that falls on normals (n, 3) at points (n, 3), of that at the camera."""
    if shot.medium is None:
        return light
    return light * ambient_ratio(shot.medium, shot.view.depth_of(point), normal[:, 1])


def surface_radiance(
    shot: Shot, sources: Sequence[LightSource], hits: Hits, among_bodies: Floats, *, footprints: bool = True
) -> tuple[Floats, dict[str, Floats]]:
    """Return the radiance (n, 3) of surfaces towards the camera, before attenuation by the water and with their trim,
    and its parts by output variable.

    Parts: reflected ambient light, diffuse and glossy; reflected light of the sun and of lamps; emission; and caustics,
    the change of the reflected light by the waves, of either sign, which it contains. among_bodies: (n, CHANNELS) of
    `ambient_at`. footprints: whether shadows are averaged over the pixels' footprints, or those of points.
    """
    # Split the surface into a mirror of dielectric and metal, and a matt base below it
    environment, view = shot.environment, -hits.direction
    n_dot_v = np.clip(np.sum(hits.normal * view, -1), 1e-3, 1.0)
    dielectric = dielectric_f0(hits.refractive_index, shot.refractive_index)[:, None]
    metal = hits.metallic[:, None]
    split = np.stack(split_sum(hits.roughness, n_dot_v), axis=-1)
    varnish = reflectance(np.broadcast_to(dielectric, hits.base.shape), split)
    mirrors = varnish * (1.0 - metal) + reflectance(hits.base, split) * metal
    albedo = hits.base * (1.0 - metal) * (1.0 - varnish)
    # Look up the ambient light, as far as other bodies leave it
    axis = lobe_axis(hits.normal, view, n_dot_v, hits.roughness)
    ratio = among_bodies[:, :3]
    if len(environment.glossy):
        reflected = glossy_lookup(environment.glossy, environment.glossy_roughness, axis, hits.roughness)
        reflected = reflected * among_bodies[:, 4:7] + among_bodies[:, 8:11]
    else:
        reflected = environment_lookup(environment.ambient, axis) * INV_PI * ratio
    occlusion = hits.occlusion[:, None]
    coat = view, dielectric * (1.0 - metal) + hits.base * metal, albedo
    # Reflect it, and add what glows
    bias_m = np.array([placed.bias_m for placed in shot.visible])[hits.object]
    irradiance = environment_lookup(shot.environment.ambient, hits.normal)
    diffuse = hits.trim * albedo * INV_PI * ambient_there(shot, irradiance, hits.point, hits.normal) * ratio * occlusion
    glossy = hits.trim * mirrors * ambient_there(shot, reflected, hits.point, axis) * occlusion
    emission = hits.trim * hits.emission
    # Add sun and lamps, one after the other
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


MINIMUM_ALPHA = 0.002
"""Least width of a lobe: narrower ones are not resolved in single precision."""
LEAST_COSINE = 0.001
"""Least cosine between view and half vector that a light's disc is spread by, where it grazes."""
PIXEL_POINT = 0.28867513
"""1/sqrt(12)."""
PIXEL_POINTS = PIXEL_POINT * np.array([[-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]])
"""Places (4, 2) in a pixel, from its middle, of the Gauss-Legendre quadrature that is exact for cubic functions."""


def dielectric_f0(refractive_index: ArrayLike, medium_index: float) -> Floats:
    """Return the reflectance (...,) at normal incidence of dielectrics of index (...,) in a medium (Fresnel)."""
    index = np.asarray(refractive_index, np.float64)
    return np.square((index - medium_index) / (index + medium_index))


def ggx_distribution(n_dot_h: Floats, alpha: Floats) -> Floats:
    """Return the GGX density of microfacets D [1/sr]."""
    squared = alpha * alpha
    d = n_dot_h * n_dot_h * (squared - 1.0) + 1.0
    return squared * INV_PI / (d * d)


def smith_visibility(n_dot_v: Floats, n_dot_l: Floats, alpha: Floats) -> Floats:
    """Return G/(4 n.v n.l), Smith masking and shadowing with correlated heights."""
    squared = alpha * alpha
    v = n_dot_l * np.sqrt(n_dot_v * n_dot_v * (1.0 - squared) + squared)
    s = n_dot_v * np.sqrt(n_dot_l * n_dot_l * (1.0 - squared) + squared)
    return 0.5 / np.maximum(v + s, 1e-6)


def grazing_reflectance(f0: Floats) -> Floats:
    """Return Schlick's grazing reflectance F90 (..., 3): 1, less for surfaces whose index is close to the medium's.

    (F0/.04)^(1/5), capped: least squares to Fresnel's equations, weighted by the cosine, give .35, .60, .76 for index
    ratios of 1.05, 1.12 and 1.2; this gives .43, .60, .73. With F90 = 1 a body of the water's index would have a
    bright rim.
    """
    return np.minimum(np.power(np.maximum(f0, 0.0) / 0.04, 0.2), 1.0)


def lobe_axis(normal: Floats, view: Floats, n_dot_v: Floats, roughness: Floats) -> Floats:
    """Return the mean unit direction (..., 3) of the light that a coat reflects to the viewer (dominant direction).

    normal, view: (..., 3); n_dot_v: their cosine, positive. A smooth surface reflects the mirrored direction; with
    roughness, masking tilts the lobe to the normal, completely at roughness 1. The tilt is fitted to the lobe's mean
    direction: the error is 2.2 degrees rms over roughness and n.v, against 33 for the mirrored direction and 5 for
    the fit of Lagarde & de Rousiers 2014.
    """
    mirror = 2.0 * np.sum(normal * view, axis=-1, keepdims=True) * normal - view
    lean = (1.0 - roughness) * (1.0 + roughness * (1.01 - 1.86 * roughness + n_dot_v * (1.15 + 1.27 * roughness)))
    axis = normal + (mirror - normal) * np.minimum(lean, 1.0)[..., None]
    return axis / np.maximum(np.linalg.norm(axis, axis=-1, keepdims=True), 1e-6)


def reflectance(f0: Floats, split: Floats) -> Floats:
    """Return the fraction (..., 3) of uniform light that the coat reflects; split: (..., 2) of the split sum.

    One bounce reflects F0 A + F90 B; light of further bounces between facets is added with the mean colour.
    """
    single = f0 * split[..., :1] + grazing_reflectance(f0) * split[..., 1:]
    return single * (1.0 + f0 * (1.0 / np.maximum(split[..., :1] + split[..., 1:], 1e-3) - 1.0))


def resolved_alpha(roughness: Floats, change: Floats) -> Floats:
    """Return the width (n,) of a lobe whose normals change by `change` (n, 2, 3) over a pixel: at least half of what
    the normals at `PIXEL_POINTS` are apart, or a highlight could fall between them.
    """
    return np.sqrt(np.minimum(np.maximum(roughness**4, np.sum(change**2, axis=(-1, -2)) / 24.0), 1.0))


def highlight(
    f0: Floats, alpha: Floats, n_dot_v: Floats, n_dot_l: Floats, n_dot_h: Floats, v_dot_h: Floats, half_angle: ArrayLike
) -> Floats:
    """Return the radiance (..., 3) of a light's specular reflection for an irradiance of 1 perpendicular to its beam.

    half_angle: angular radius [rad] of the light. Over its disc, half vectors fill an ellipse of half axes
    r = half_angle/2 and r/c, c = v.h. Near its peak GGX is alpha^2/(pi (alpha^2 + t^2)^2) at an angle t of the half
    vector, and its mean over a disc of the ellipse's area, s^2 = r^2/c,

        1/(pi s^2) int_0^s alpha^2/(pi (alpha^2 + t^2)^2) 2 pi t dt = 1/(pi (alpha^2 + s^2)),

    is the peak of a lobe of width sqrt(alpha^2 + s^2), which stands for the mean at all angles.
    """
    spread = 0.5 * np.asarray(half_angle) / np.sqrt(np.maximum(v_dot_h, LEAST_COSINE))
    wide = np.minimum(np.hypot(np.maximum(alpha, MINIMUM_ALPHA), spread), 1.0)
    lobe = ggx_distribution(n_dot_h, wide) * smith_visibility(n_dot_v, n_dot_l, wide) * n_dot_l
    grazing = np.power(np.clip(1.0 - v_dot_h, 0.0, 1.0), 5.0)[..., None]
    return lobe[..., None] * (f0 + (grazing_reflectance(f0) - f0) * grazing)
