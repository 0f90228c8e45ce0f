# SPDX-License-Identifier: Apache-2.0
"""Adds the moving surface to a layer that is drawn: cuts bodies at the waterline, and lays their images behind them.

    layer = k D over S        alpha = k a_D + (1 - k a_D) a_S

with D the bodies as drawn without a surface, k the fraction of their samples that is nearer than the surface, and S the
images of bodies in it (`surface_images`), the mean over the samples that no body hides. Both renderers share it: it
needs the layer's coverage and distances alone.

Images are made sample by sample: mirrored and refracted rays to the bodies, and their light.

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
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.cache import Cache, PartOf
from mr360uw.base.optics import fresnel
from mr360uw.base.texels import smoothstep
from mr360uw.caustics.sea import SeaParameters
from mr360uw.composite.ambient.solver import AmbientLight, ambient_at, ambient_light
from mr360uw.composite.light_sources import Blockers, LightSource, light_sources
from mr360uw.composite.raycast import Geometry, Hits, gather
from mr360uw.composite.sampling import pattern
from mr360uw.composite.settings import SurfaceSettings
from mr360uw.composite.shading import surface_radiance
from mr360uw.composite.shot import FAINTEST, PlacedObject, Shot, object_presence, tops
from mr360uw.composite.snow import rest_of
from mr360uw.composite.surface_rays import (
    TURNS,
    SeenSurface,
    SurfaceSamples,
    WaterSides,
    balls_around,
    camera_in_water,
    find_reach,
    first_surfaces,
    in_air,
    in_reach,
    sample_surface,
    see_surface,
    surfaces_met,
)
from mr360uw.composite.tiles import empty_tile, even_tiles, hold_out, rectangles_of_mask
from mr360uw.ibl.lookup import environment_lookup
from mr360uw.surface.ray_kernel import OFF_M
from mr360uw.surface.sampled_sea import SampledSea
from mr360uw.types import Floats, Layer, MediumTable, Rectangle, Tile

Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]

_SLACK = 1.05
"""Factor on distances that are compared with those of the highest and lowest waves: a pixel's are of its centre."""
_RAYS_AT_ONCE = 200_000
"""Rays traced in one batch. It bounds the memory: twice as many take twice as much."""
_SAMPLES = 17
"""Rays of a pixel that meet the surface. Twice as many take twice as long; with fewer, edges in waves are grainy."""
_SUN_SAMPLES = 2
"""Directions over a light's disc in images, of which the reference takes four times as many."""
_SMOOTH_FROM, _SMOOTH_FULL = 2.0, 6.0
"""Blur [pixels] of an image from which on it is averaged over neighbours, whose facets differ, and where wholly."""


def with_bodies(
    shot: Shot,
    sea: SeaParameters,
    time_s: float,
    from_surface: MediumTable,
    settings: SurfaceSettings,
    layer: Layer,
    cache: Cache,
) -> tuple[Layer, Floats | None]:
    """Return the layer of a shot of a camera in the water with the surface at a time [s], as `cut_at_surface` does.

    from_surface: the water's table for rays that start there. cache: holds what shots share.
    """
    waves = cache.of(SampledSea.of, sea, time_s)
    if not camera_in_water(shot, waves):
        return layer, None
    highest_m = max((float(top) for top in tops(shot)), default=-np.inf) - shot.view.surface_y_m
    dry = in_air(shot) if highest_m > waves.lowest_m else shot  # of what is wholly under water it is never asked for
    sides = WaterSides(shot, dry, waves, from_surface, True, shot.refractive_index)
    return cut_at_surface(sides, settings, layer, cache)


def cut_at_surface(
    sides: WaterSides, settings: SurfaceSettings, layer: Layer, cache: Cache
) -> tuple[Layer, Floats | None]:
    """Return a layer with the surface, and the fraction (H, W) of the bodies' samples that is before it.

    Where it shows no body and cuts none they are the layer itself and None. cache: holds what shots of the same bodies
    share.
    """
    shot = sides.wet
    presence = object_presence(shot, settings)
    near = tuple(o for o, share in zip(shot.visible, presence, strict=True) if share > 0.0)
    if not near:
        return layer, None
    picture = _picture(sides, layer, presence, near, cache)
    return (layer, None) if picture is None else (laid_over(shot, layer, *picture), picture[1])


def _picture(
    sides: WaterSides, layer: Layer, presence: Floats, near: tuple[PlacedObject, ...], cache: Cache
) -> tuple[Images, Floats] | None:
    """Return the images of bodies in the surface, and the fraction (H, W) of the bodies' samples before it; None where
    it shows no body and cuts none.
    """
    # Bound the pixels whose surface may show a body, and then test each
    mirrors, refracts = find_reach(sides, near)
    kept, cut = _before_surface(sides, layer)
    radiance, opacity, met = images = _no_images(layer)
    nothing = None if np.all(kept == 1.0) else (images, kept)
    where = mirrors | refracts | cut
    if not np.any(where):
        return nothing
    rows, columns, seen = see_surface(sides, where)
    mirrored, refracted = in_reach(sides, seen, *balls_around(near), sides.wet.view.pixel_rad)
    shown = mirrored | refracted | cut[rows, columns]
    rows, columns, seen = rows[shown], columns[shown], seen.of(shown)
    mirrored, refracted = mirrored[shown], refracted[shown]
    if len(rows) == 0:
        return nothing
    # Follow rays from the surface to the bodies, so many at once as fit in memory
    bodies = _bodies(sides, presence, cache)
    samples = pattern(_SAMPLES)
    alpha, distance = layer.alpha[rows, columns], layer.distance_m[rows, columns]
    covered = (alpha > 0.0) & (kept[rows, columns] > 0.0)
    found, step = [], max(_RAYS_AT_ONCE // samples.count, 1)
    for first in range(0, len(rows), step):
        part = slice(first, first + step)
        j, i = rows[part], columns[part]
        rays = sample_surface(sides, j, i, seen.of(part), samples)
        hidden, share = _hidden(bodies, rays, covered[part], distance[part])
        kept[j, i] = np.where(covered[part], share, kept[j, i])
        shows = mirrored[part], refracted[part]
        found.append(surface_images(sides, bodies, rays, seen.of(part), ~hidden, shows))
    # Smooth over the samples, and write the picture
    light, share = _smoothed(sides, rows, columns, found)
    radiance[rows, columns], opacity[rows, columns], met[rows, columns] = light, share, seen.distance_m
    return images, kept


def _bodies(sides: WaterSides, presence: Floats, cache: Cache) -> RayBodies:
    shot = sides.wet
    geometry, blockers = cache.of(_in_rays, PartOf(shot, shot.view.position, shot.objects))
    draw = shot.draw.model_copy(update={"sun_samples": _SUN_SAMPLES})
    wet, dry = ((side, light_sources(replace(side, draw=draw), blockers)) for side in (shot, sides.dry))
    return RayBodies(geometry, wet, dry, ambient_light(shot, cache), presence)


def _in_rays(of_bodies: PartOf[Shot]) -> tuple[Geometry, Blockers]:
    shot = of_bodies.whole
    return gather(shot.visible, shot.view.position), Blockers(shot)


def _before_surface(sides: WaterSides, layer: Layer) -> tuple[Floats, Mask]:
    """Return 1 (H, W) where bodies can be before the surface, 0 where all are behind its waves, and the mask (H, W) of
    pixels in which bodies are among the waves or behind them in part.
    """
    view, over, sea = sides.wet.view, sides.camera_over_m, sides.sea
    kept, cut = np.ones((layer.height, layer.width), np.float32), np.zeros((layer.height, layer.width), bool)
    side = 1.0 if sides.in_water else -1.0
    nearest, farthest = (sea.lowest_m, sea.highest_m) if sides.in_water else (sea.highest_m, sea.lowest_m)
    for tile in layer.tiles:
        rows, columns = np.nonzero(tile.alpha > 0.0)
        at = rows + tile.row, columns + tile.column
        rise = side * view.directions(at[1] + 0.5, at[0] + 0.5)[:, 1]
        distance = tile.distance_m[rows, columns]
        with np.errstate(divide="ignore"):
            first = np.where(rise > 0.0, max(side * (nearest - over), 0.0) / rise, np.inf)
            last = np.where(rise > 0.0, max(side * (farthest - over), 0.0) / rise, np.inf)
        if side * (nearest - over) <= 0.0:
            first[:] = 0.0
        cut[at] = (_SLACK * distance > first) & (distance <= _SLACK * last)
        kept[at] = np.where(distance > _SLACK * last, 0.0, 1.0)
    return kept, cut


def _hidden(bodies: RayBodies, rays: SurfaceSamples, covered: Mask, distance_m: Floats) -> tuple[Mask, Floats]:
    """Return which samples (n, s) bodies hide from the surface, and the fraction (n,) of the bodies' samples that do.

    covered: (n,) pixels with bodies, at distances (n,).
    """
    hidden, share = np.zeros(rays.distance_m.shape, bool), np.ones(len(covered))
    at = np.flatnonzero(covered)
    if len(at) == 0:
        return hidden, share
    direction = rays.direction[at]
    flat = np.ascontiguousarray(direction.reshape(-1, 3))
    _, met = first_surfaces(bodies.geometry, np.zeros_like(flat), flat)
    met = met.reshape(direction.shape[:2])
    before = met < rays.distance_m[at]
    bodies_samples = np.isfinite(met).sum(axis=1)
    middle = (distance_m[at] < rays.distance_m[at].mean(axis=1)).astype(np.float64)
    share[at] = np.where(bodies_samples > 0, before.sum(axis=1) / np.maximum(bodies_samples, 1), middle)
    hidden[at] = before
    return hidden, share


def _smoothed(
    sides: WaterSides, rows: Indices, columns: Indices, images: Sequence[tuple[Floats, Floats, Floats]]
) -> tuple[Floats, Floats]:
    """Return radiance (n, 3) and alpha (n,) of pixels, averaged over neighbours where facets blur them widely."""
    values = np.concatenate([np.append(radiance, alpha[:, None], axis=-1) for radiance, alpha, _ in images])
    blur = np.concatenate([blur_rad for _, _, blur_rad in images]) / sides.wet.view.pixel_rad
    height, width = sides.wet.view.height, sides.wet.view.width
    number = np.full((height, width), -1, np.int32)
    number[rows, columns] = np.arange(len(rows))
    total, widest, half = np.zeros_like(values), np.zeros(len(rows)), TURNS // 2
    for down in range(-half, half + 1):
        for right in range(-half, half + 1):
            beside = number[np.clip(rows + down, 0, height - 1), (columns + right) % width]
            there = beside >= 0
            total[there] += values[beside[there]]
            widest[there] = np.maximum(widest[there], blur[beside[there]])
    t = np.clip((widest - _SMOOTH_FROM) / (_SMOOTH_FULL - _SMOOTH_FROM), 0.0, 1.0)[:, None]
    values = values + t * (total / TURNS**2 - values)
    return values[:, :3], values[:, 3]


_SPARE_PX = 4096
"""Pixels that a rectangle of images must save to be cut in two."""


Images = tuple[Floats, Floats, Floats]
"""Images of bodies in the surface, for a whole frame: premultiplied radiance (H, W, 3), alpha (H, W), and distance
(H, W) [m] of the surface, 0 where it is not known."""


def _no_images(layer: Layer) -> Images:
    size = layer.height, layer.width
    return np.zeros((*size, 3), np.float32), np.zeros(size, np.float32), np.zeros(size, np.float32)


def laid_over(shot: Shot, layer: Layer, images: Images, kept: Floats) -> Layer:
    """Return a layer with its bodies cut, over the images. kept: (H, W) fraction of the bodies' samples before the
    surface.
    """
    tiles = [_over_images(tile, _images_tile(shot, images, tile.rectangle), kept[tile.window]) for tile in layer.tiles]
    shown = np.any(images[0] != 0.0, axis=-1) | (images[1] > 0.0)
    parts = even_tiles(rectangles_of_mask(shown, _SPARE_PX), layer.width, layer.height)
    free = rest_of([tile.rectangle for tile in layer.tiles], layer.width, layer.height)
    for part in parts:
        tiles += [_images_tile(shot, images, both) for one in free if (both := _common(part, one)) is not None]
    return replace(layer, tiles=tuple(tiles))


def _common(a: Rectangle, b: Rectangle) -> Rectangle | None:
    """Return the rectangle that two have in common, if any."""
    column, row = max(a.column, b.column), max(a.row, b.row)
    width = min(a.column + a.width, b.column + b.width) - column
    height = min(a.row + a.height, b.row + b.height) - row
    return Rectangle(column, row, width, height) if min(width, height) > 0 else None


def _images_tile(shot: Shot, images: Images, part: Rectangle) -> Tile:
    """Return the images in a part of the frame as a tile of their own, behind the shot's mattes."""
    blank = empty_tile(part)
    radiance, alpha, distance_m = (image[blank.window] for image in images)
    distance = np.where(alpha > 0.0, distance_m, np.inf).astype(np.float32)
    return hold_out(shot, replace(blank, radiance=radiance.copy(), alpha=alpha.copy(), distance_m=distance))


def _over_images(tile: Tile, images: Tile, kept: Floats) -> Tile:
    """Return a tile of which a fraction (h, w) is left, over its images."""
    alpha = kept * tile.alpha
    through = 1.0 - alpha
    return replace(
        tile,
        radiance=kept[..., None] * tile.radiance + through[..., None] * images.radiance,
        alpha=alpha + through * images.alpha,
        distance_m=np.where(alpha > 0.0, tile.distance_m, images.distance_m),
    )


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
        triangle, further = first_surfaces(bodies.geometry, start, direction)
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
        covers = group_amount * hits.alpha * bodies.presence[hits.object]
        covers *= smoothstep(passed.max(axis=-1), FAINTEST, _FULL_FROM)  # nearly all is taken by the water
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
