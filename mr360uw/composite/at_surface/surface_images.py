# SPDX-License-Identifier: Apache-2.0
"""Images of bodies in the moving surface, sample by sample: mirrored and refracted rays to the bodies, and their light.

    symbol    meaning
    R         reflectance of the facet (Fresnel)
    T, V      transmittance and veil of the water: 1 from the camera to the surface, 2 from there to a body
    B         radiance of a body towards the surface
    n         refractive index

    camera in the water   mirrored R (V1 + T1 (V2 + T2 B))      refracted (1 - R) (V1 + T1 n^2 B)
    camera in the air     mirrored R (B - S)                    refracted (1 - R) ((V2 + T2 B)/n^2 + R S)

The plate shows what bodies hide: it keeps 1 - R or R of itself below water, exact in total reflection and off by R
times the mirrored water inside Snell's window. From above it is made of R S, with S the sky in the mirrored direction,
and of the water's light, of which a body in the water takes 1 - R.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.ambient.light import ambient_at
from mr360uw.composite.ambient.solver import AmbientLight
from mr360uw.composite.at_surface.settings import FAINTEST
from mr360uw.composite.at_surface.surface_rays import SeenSurface, SurfaceSamples, first_surfaces, surfaces_met
from mr360uw.composite.at_surface.water_sides import WaterSides
from mr360uw.composite.lighting.light_sources import LightSource
from mr360uw.composite.lighting.shading import surface_radiance
from mr360uw.composite.raycast import Geometry, Hits
from mr360uw.composite.shot import Shot
from mr360uw.ibl.lookup import environment_lookup
from mr360uw.optics import fresnel
from mr360uw.rays import RayScene
from mr360uw.surface.tracing.ray_kernel import OFF_M
from mr360uw.texels import smoothstep
from mr360uw.types import Floats

Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]

_LEAST_PASSED = 1e-4
"""Fraction of light below which a facet's refracted ray is not followed."""
_FULL_FROM = 10.0 * FAINTEST
"""Transmittance of the whole way from which on an image is drawn in full; below it fades to nothing at `FAINTEST`."""


@dataclass(frozen=True, slots=True, eq=False)
class RayBodies:
    """Visible bodies of a shot for rays.

    wet, dry: the shot in the light of the water and of the air, each with its sources. ambient: solved among the bodies
    in the water, or None. presence: for each visible object the fraction in which its images are drawn.
    """

    geometry: Geometry
    scene: RayScene
    wet: tuple[Shot, Sequence[LightSource]]
    dry: tuple[Shot, Sequence[LightSource]]
    ambient: AmbientLight | None
    presence: Floats

    def radiance(self, hits: Hits, *, in_water: bool) -> Floats:
        """Return the radiance (n, 3) of surfaces on one side against the rays that meet them.

        Shadows are those of points: images in waves are too small and restless for more.
        """
        shot, sources = self.wet if in_water else self.dry
        among = ambient_at(shot, self.ambient if in_water else None, hits)
        return surface_radiance(shot, sources, hits, among, footprints=False)[0]


def surface_images(
    sides: WaterSides,
    bodies: RayBodies,
    samples: SurfaceSamples,
    seen: SeenSurface,
    open_: Mask,
    shows: tuple[Mask, Mask],
) -> tuple[Floats, Floats, Floats]:
    """Return what n pixels show of bodies in the surface: premultiplied radiance (n, 3), which can be negative above
    water, the fraction alpha (n,) of the plate that it replaces, and the blur (n,) [rad] of mirrored bodies by facets.

    open_: (n, s) samples that reach the surface. shows: (n,) pixels in reach of mirrored and of refracted bodies.
    """
    count = len(open_)
    weight = samples.weight * open_
    share = weight / np.maximum(weight.sum(axis=1, keepdims=True), 1e-30)
    mirrored, bent, cosine = samples.sent_on(sides.relative_index, in_water=sides.in_water)
    reflected = fresnel(cosine.ravel(), sides.relative_index).reshape(cosine.shape)
    total, alpha, blur = np.zeros((count, 3)), np.zeros(count), np.zeros(count)
    width = sides.wet.view.pixel_rad
    lobe = 2.0 * np.sqrt(np.maximum(seen.lost[:, 0] + seen.lost[:, 2], 0.0))
    for ray, part, shown, same in ((mirrored, reflected, shows[0], True), (bent, 1.0 - reflected, shows[1], False)):
        followed = shown[:, None] & (share > 0.0) & (part > _LEAST_PASSED)
        pixel, sample = np.nonzero(followed)
        direction = ray[pixel, sample]
        start = samples.point[pixel, sample] + OFF_M * direction
        triangle, further = first_surfaces(bodies.geometry, bodies.scene, start, direction)
        met = np.flatnonzero(triangle >= 0)
        if len(met) == 0:
            continue
        pixel, sample, triangle, further = pixel[met], sample[met], triangle[met], further[met]
        direction, start = direction[met], start[met]
        first_m = samples.distance_m[pixel, sample]
        amount = (share * part)[pixel, sample]
        chosen, group_amount, scatter = _grouped(
            pixel, bodies.geometry.object[triangle], start + further[:, None] * direction, amount
        )
        path = (first_m + further)[chosen]
        hits = surfaces_met(
            bodies.geometry, triangle[chosen], (start + further[:, None] * direction)[chosen], direction[chosen],
            path, np.hypot(width, scatter / path),
        )  # fmt: skip
        at = pixel[chosen]
        in_water = same == sides.in_water
        light, passed = _towards_camera(
            sides, bodies, hits, samples.direction[at, sample[chosen]], first_m[chosen], further[chosen], in_water
        )
        reflectance = reflected[at, sample[chosen]]
        covers = group_amount * hits.alpha * bodies.presence[hits.object] * _fade(passed)
        light, kept = _in_plate(sides, light, mirrored[at, sample[chosen]], reflectance, same=same)
        for c in range(3):
            total[:, c] += np.bincount(at, weights=covers * light[:, c], minlength=count)
        alpha += np.bincount(at, weights=covers * kept, minlength=count)
        np.maximum.at(blur, at, lobe[at] * further[chosen] / path)
    return total, np.minimum(alpha, 1.0), blur


def _grouped(pixel: Indices, body: Indices, point: Floats, amount: Floats) -> tuple[Indices, Floats, Floats]:
    """Return, for the hits (n,) of each body in each pixel, the one nearest to their mean, the sum of their amounts
    and their distance from the mean (root mean square) [m].
    """
    order = np.lexsort((body, pixel))
    same = (np.diff(pixel[order]) == 0) & (np.diff(body[order]) == 0)
    group = np.empty(len(pixel), np.int64)
    group[order] = np.concatenate([[0], np.cumsum(~same)])
    count = int(group.max()) + 1
    sums = np.bincount(group, weights=amount, minlength=count)
    inverse = 1.0 / np.maximum(sums, 1e-30)
    mean = np.stack([np.bincount(group, weights=amount * p, minlength=count) * inverse for p in point.T], axis=-1)
    square = np.sum((point - mean[group]) ** 2, axis=-1)
    nearest = np.lexsort((square, group))
    first = nearest[np.concatenate([[True], np.diff(group[nearest]) != 0])]
    scatter = np.sqrt(np.bincount(group, weights=amount * square, minlength=count) * inverse)
    return np.asarray(first, np.int64), np.asarray(sums, np.float64), np.asarray(scatter, np.float64)


def _towards_camera(
    sides: WaterSides, bodies: RayBodies, hits: Hits, seen: Floats, first_m: Floats, further_m: Floats, in_water: bool
) -> tuple[Floats, Floats]:
    """Return the radiance (n, 3) of bodies at the camera if the surface let all light pass, and the transmittance.

    seen: (n, 3) directions of the camera's rays. in_water: whether the bodies are on the water's side.
    """
    through, veil = sides.to_surface(first_m, seen)
    square = sides.refractive_index**2
    if in_water:
        passed, added = sides.below_surface(further_m, hits.direction)
        light = passed * bodies.radiance(hits, in_water=True) + added
        return veil + through * (light if sides.in_water else light / square), through * passed
    above = bodies.radiance(hits, in_water=False) * (square if sides.in_water else 1.0)
    return veil + through * above, through


def _in_plate(
    sides: WaterSides, light: Floats, mirrored: Floats, reflectance: Floats, *, same: bool
) -> tuple[Floats, Floats]:
    """Return light (n, 3) as it is added to the plate, and the fraction (n,) of the plate that it replaces."""
    if sides.in_water:
        return light, np.ones(len(light))
    sky = environment_lookup(sides.dry.environment.residual, mirrored)
    if same:
        return light - sky, np.zeros(len(light))
    return light + reflectance[:, None] * sky, np.ones(len(light))


def _fade(passed: Floats) -> Floats:
    """Return the fraction (n,) in which images are drawn whose light is nearly all taken by the water."""
    return smoothstep(passed.max(axis=-1), FAINTEST, _FULL_FROM)
