# SPDX-License-Identifier: Apache-2.0
"""Bodies under and at the surface as a camera in the air sees them: shots of both sides, and the layer over a picture.

Bodies in the water are lit by the solved light just below the surface, by the sun's refracted beam with its caustics,
and from below by the floor. Those in the air are lit by sky and sun, and by the water's light from below.

Shadows of bodies on the sea floor, seen through the waves, scale the floor's light:

    ratio = 1 - E_sun/E (1 - v)

with E the floor's light, E_sun the part of it by the sun's beam with its caustics, and v the fraction of the sun that
bodies leave. Waves tilt the beam: v is the mean over a disc as wide as the sun and the slopes of the sea make it. The
ratio is that of the floor on the ray through a pixel's centre; it scales what the pixel shows of the floor.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.cache import Cache
from mr360uw.base.constants import PI
from mr360uw.base.optics import (
    fresnel,
    fresnel_transmittance,
    radiance_factor,
    reflect,
    refract_clamped,
    refract_to_air,
    refract_to_water,
)
from mr360uw.base.rays import RayScene
from mr360uw.base.sphere import directions, disc_directions
from mr360uw.caustics import CausticSettings, caustic_stack
from mr360uw.composite.raycast import gather
from mr360uw.composite.reference import render_layer
from mr360uw.composite.settings import SurfaceSettings
from mr360uw.composite.shot import PlacedObject, SceneObject, Shot
from mr360uw.composite.surface_layer import cut_at_surface
from mr360uw.composite.surface_rays import WaterSides, balls_around
from mr360uw.composite.tiles import tile_of
from mr360uw.ibl.lighting import assemble
from mr360uw.ibl.plate import COARSE_COLUMNS, COARSE_ROWS
from mr360uw.medium.scattered_light import spread_of
from mr360uw.surface import SeaScene, SurfacePicture
from mr360uw.surface.facet_draws import glitter
from mr360uw.surface.intersection import sigma_at
from mr360uw.surface.ray_kernel import RayStage, disc_of
from mr360uw.types import Array, CausticStack, Floats, Layer, Rectangle, Sun, View


def light_below(sea: SeaScene, floor_depth_m: float) -> Array:
    """Return the radiance (128, 256, 3) just below a level surface by direction, without the sun's beam.

    From above: the sky through Snell's window, and outside of it the mirrored light from below. From below: the floor
    at its mean light, behind the water.
    """
    towards = directions(COARSE_COLUMNS, COARSE_ROWS)
    up = towards[..., 1]
    flat = np.minimum(up, -1e-3).ravel()
    water = sea.light_in_water(floor_depth_m)
    passed, veil = water.along(floor_depth_m / -flat, flat, from_camera=False)
    assert water.floor is not None
    veil = veil * water.about_sun(towards.reshape(-1, 3))
    below = (passed * water.floor + veil).reshape(towards.shape)
    window = up > np.sqrt(1.0 - 1.0 / sea.refractive_index**2)
    air = refract_to_air(np.where(window[..., None], towards, [0.0, 1.0, 0.0]), sea.refractive_index)
    factor = radiance_factor(np.clip(air[..., 1], 0.0, 1.0), sea.refractive_index)
    footprint = np.full(up.size, PI / COARSE_ROWS)
    sky = factor[..., None] * sea.dome.look(air.reshape(-1, 3), footprint).reshape(towards.shape)
    lost = np.where(window, 1.0 - factor / sea.refractive_index**2, 1.0)[..., None]
    above = np.where(window[..., None], sky, 0.0) + lost * below[::-1]
    return np.asarray(np.where(up[..., None] > 0.0, above, below))


_RAYS = 13
"""Directions over the disc."""


def _ratio_on_floor(sea: SeaScene, stage: RayStage, placed: tuple[PlacedObject, ...], floor: FloorSeen) -> Array:
    """Return the floor's light with bodies over that without, (n, 3), in the floor's pixels."""
    # Nothing changes without a sun, bodies, or floor in reach of their shadows
    ratio = np.ones((len(floor.place), 3))
    casters = tuple(one for one in placed if one.casts_shadow)
    if sea.sun is None or sea.sun.direction[1] <= 0.0 or not casters:
        return ratio
    direction = refract_to_water(sea.sun.direction, sea.refractive_index)
    half = _beam_half_angle(sea)
    at = np.flatnonzero(_in_reach(floor.place, direction, half, casters))
    if not len(at):
        return ratio
    # Count the rays to the sun's disc that bodies stop
    scene = RayScene(gather(casters, np.zeros(3)).positions)
    rays = disc_directions(direction, half, _RAYS)
    hidden = np.zeros(len(at))
    for ray in rays:
        hidden += scene.first_hit(floor.place[at], np.broadcast_to(ray, (len(at), 3))) >= 0
    # Take that fraction of the beam away from the floor's light
    x, z, footprint = floor.place[at, 0], floor.place[at, 2], floor.footprint_m[at]
    beam = np.zeros((len(at), 3))
    for pattern, factor in stage.floor_light.patterns[stage.floor_light.skies :]:
        beam += factor * pattern.at(x, z, footprint)
    whole = stage.floor_light.irradiance(x, z, footprint)
    ratio[at] = 1.0 - beam / np.maximum(whole, 1e-30) * (hidden / len(rays))[:, None]
    return ratio


def _beam_half_angle(sea: SeaScene) -> float:
    """Return the angular radius [rad] of a disc with the variance of the beam's directions under the waves."""
    assert sea.sun is not None
    slope = math.sqrt(0.5 * (sea.sea.own_mean_square_slope + sea.sea.detail_rms_slope**2))
    tilt = 2.0 * (1.0 - 1.0 / sea.refractive_index) * slope  # twice the deviation: that of an even disc
    return min(math.hypot(sea.sun.half_angle_rad / sea.refractive_index, tilt), 0.5)


def _in_reach(place: Array, direction: Array, half: float, casters: tuple[PlacedObject, ...]) -> NDArray[np.bool_]:
    """Return which places (n, 3) may lie in the shadow of a body."""
    near = np.zeros(len(place), bool)
    for centre, radius in zip(*balls_around(casters), strict=True):
        to = centre - place
        along = to @ direction
        aside = np.linalg.norm(to - along[:, None] * direction, axis=-1)
        near |= (along > -radius) & (aside < radius + math.tan(half) * np.maximum(along, 0.0))
    return near


_ALL = SurfaceSettings(objects="all")
_PLANES = 3
"""Depths between the highest and the lowest point of the bodies at which their caustics are computed."""
_SHALLOWEST_M = 0.05
"""Depth [m] of the highest of them."""
_GLOSSY = (0.2, 0.5)
"""Roughnesses at which what surfaces mirror is filtered."""


class AerialBodies:
    """Bodies of a scene with the light of both sides, which does not change with time.

    table: of the water for rays from the surface, None for clear water. below, above: light of both sides.
    """

    def __init__(self, sea: SeaScene, objects: Sequence[SceneObject]) -> None:
        depth, sun = -sea.floor.height_m, sea.sun if sea.sun is not None and sea.sun.direction[1] > 0.0 else None
        in_water = light_below(sea, depth)
        wet = None
        if sun is not None:
            direction = refract_to_water(sun.direction, sea.refractive_index)
            passed = float(fresnel_transmittance(sun.direction[1], sea.refractive_index))
            beam = sun.irradiance * passed * sun.direction[1] / direction[1]
            wet = Sun(direction, beam, sun.half_angle_rad / sea.refractive_index, 1.0)
        water = sea.light_in_water(depth)
        self.sea, self.objects = sea, tuple(objects)
        self.table = None if water.sky is None else water.table(from_camera=False)
        self.below = assemble(in_water, wet, _GLOSSY)
        self.above = assemble(_over_water(sea, in_water), sun, _GLOSSY)

    def layer(
        self, stage: RayStage, view: View, floor: FloorSeen, mirrored: Array, time_s: float, frame: int,
        caustics: CausticSettings,
    ) -> Layer:  # fmt: skip
        """Return the layer of the bodies over a picture of the sea at a time [s], as one tile.

        floor: of the pixels of the view. mirrored: (H, W, 3) radiance that the surface reflects.
        """
        placed = tuple(o.at(time_s, frame, view.position, view.world_from_camera) for o in self.objects)
        extent = [o.to_world(o.mesh.hull.reshape(-1, 3))[:, 1] for o in placed]
        lowest, highest = min(float(y.min()) for y in extent), max(float(y.max()) for y in extent)
        wet, dry = (
            Shot(view, placed, light, () if light.sun is None else (light.sun,), table)
            for light, table in ((self.below, self.table), (self.above, None))
        )
        wet = replace(wet, caustics=self._caustics(lowest, highest, time_s, caustics))
        cache = Cache()
        direct = render_layer(dry, cache) if highest > stage.sea.lowest_m else Layer(view.height, view.width, ())
        sides = WaterSides(wet, dry, stage.sea, self.table, False, self.sea.refractive_index)
        ratio, veil = np.ones(mirrored.shape, np.float32), mirrored.astype(np.float32)
        ratio[floor.mask] = _ratio_on_floor(self.sea, stage, placed, floor)
        veil[floor.mask] += floor.veil
        return _with_shadow(cut_at_surface(sides, _ALL, direct, cache)[0], ratio, veil)

    def _caustics(self, lowest: float, highest: float, time_s: float, settings: CausticSettings) -> CausticStack | None:
        """Return the caustics between the bodies' highest and lowest points."""
        sun = self.above.sun
        if sun is None or not settings.enabled or lowest >= -_SHALLOWEST_M:
            return None
        top = max(-highest, _SHALLOWEST_M)
        depths = np.linspace(top, max(-lowest, top + _SHALLOWEST_M), _PLANES)
        beam = self.sea.light_in_water(-self.sea.floor.height_m).sun
        spread = None if beam is None else spread_of(beam.medium)
        settings = settings.model_copy(update={"sun_half_angle_rad": sun.half_angle_rad})
        return caustic_stack(self.sea.sea, sun.direction, depths, time_s, settings, self.sea.refractive_index, spread)


def _over_water(sea: SeaScene, in_water: Array) -> Array:
    """Return the radiance (128, 256, 3) over a level sea: the sky, and its mirror image with the water's light."""
    towards = directions(COARSE_COLUMNS, COARSE_ROWS)
    footprint = np.full(COARSE_COLUMNS * COARSE_ROWS, PI / COARSE_ROWS)
    sky = sea.dome.look(towards.reshape(-1, 3), footprint).reshape(towards.shape)  # with its mirror image
    passed = fresnel_transmittance(np.abs(towards[..., 1]), sea.refractive_index)[..., None]
    under = (1.0 - passed) * sky + passed * in_water[-1, 0] / sea.refractive_index**2
    return np.where(towards[..., 1:2] > 0.0, sky, under)


def _with_shadow(layer: Layer, ratio: Floats, veil: Floats) -> Layer:
    """Return a layer as one tile, with shadows on what is behind it. ratio, veil: (H, W, 3) of the frame."""
    touched = np.any(ratio != 1.0, axis=-1) | (layer.alpha > 0.0) | np.any(layer.radiance != 0.0, axis=-1)
    if not np.any(touched):
        return replace(layer, tiles=())
    rows, columns = np.flatnonzero(touched.any(axis=1)), np.flatnonzero(touched.any(axis=0))
    part = Rectangle(int(columns[0]), int(rows[0]), int(columns[-1] - columns[0] + 1), int(rows[-1] - rows[0] + 1))
    tile = tile_of(layer, part)
    return replace(layer, tiles=(replace(tile, ratio=ratio[tile.window], veil=veil[tile.window]),))


def brightened(layer: Layer, factor: Floats | float) -> Layer:
    """Return a layer with its light times a factor, a number or (3,)."""
    f = np.asarray(factor, np.float32)
    return replace(layer, tiles=tuple(replace(t, radiance=f * t.radiance, veil=f * t.veil) for t in layer.tiles))


# Parts of a picture from above: the floor behind the first surface, and what that surface mirrors.
#
# Both follow the ray through a pixel's centre at its first meeting with the waves; light that meets further waves is in
# the picture alone.


class FloorSeen:
    """The floor where a camera in the air sees it, on the refracted rays of n pixels, and on those that miss the sea.

    directions, origins: (H, W, 3) of the pixels' rays. mask: (H, W) which pixels. place: (n, 3) [m] in the world.
    footprint_m: (n,) of a pixel there. veil: (n, 3) radiance that the water adds, through the surface. radiance:
    (H, W, 3) that leaves the floor towards the camera, before the water, also where it is dry; zero without floor.
    """

    def __init__(self, stage: RayStage, view: View, seen: SurfacePicture, directions: Array, origins: Array) -> None:
        # Follow the refracted rays to the floor
        mask = self.mask = seen.surface & (seen.in_water_m > 0.0) & np.isfinite(seen.in_water_m)
        d, normal, distance, wet = directions[mask], seen.normal[mask], seen.distance_m[mask], seen.in_water_m[mask]
        bent = refract_clamped(d, normal, 1.0 / stage.refractive_index)
        self.place = origins[mask] + distance[:, None] * d + wet[:, None] * bent
        self.footprint_m = view.pixel_m + view.pixel_rad * (distance + wet / stage.refractive_index)
        cosine = np.clip(-np.sum(d * normal, axis=-1), 0.0, 1.0)
        through = (1.0 - fresnel(cosine, stage.refractive_index)) / stage.refractive_index**2
        _, veil = stage.water.along(wet, np.minimum(bent[:, 1], 0.0), from_camera=False)
        self.veil = through[:, None] * np.asarray(veil * stage.water.about_sun(bent))
        # Light the floor, which is on the rays themselves where it is dry
        self.radiance = np.zeros(directions.shape)
        x, z = self.place[:, 0], self.place[:, 2]
        self.radiance[mask] = stage.floor_light.radiance(stage.floor, x, z, self.footprint_m, False)
        dry, distance = seen.floor, seen.distance_m[seen.floor]
        place = origins[dry] + distance[:, None] * directions[dry]
        footprint = view.pixel_m + view.pixel_rad * distance
        self.radiance[dry] = stage.floor_light.radiance(stage.floor, place[:, 0], place[:, 2], footprint, True)


def reflected_radiance(stage: RayStage, view: View, seen: SurfacePicture, directions: Array) -> Array:
    """Return the radiance (H, W, 3) of sky and sun that the surface mirrors towards the camera, once."""
    out = np.zeros(directions.shape)
    met = seen.surface & ~np.array(seen.camera_in_water)
    if not np.any(met):
        return out
    d, normal, distance = directions[met], seen.normal[met], seen.distance_m[met]
    spread = view.pixel_rad
    sigma = np.array([sigma_at(view.pixel_m, spread, t, up) for t, up in zip(distance, d[:, 1], strict=True)])
    lost = stage.sea.unresolved(stage.sea.level_of(sigma))
    cosine = np.clip(-np.sum(d * normal, axis=-1), 0.0, 1.0)
    blur = np.hypot(spread, 2.0 * np.sqrt(np.maximum(lost[:, 0] + lost[:, 2], 0.0)))
    light = fresnel(cosine, stage.refractive_index)[:, None] * stage.dome.look(reflect(d, normal), blur)
    if stage.sun is not None and stage.sun.direction[1] > 0.0:
        disc, _ = disc_of(stage.sun)
        seen_sun = glitter(disc, d, normal, lost, 1.0, stage.refractive_index)
        light = light + seen_sun[:, None] * np.array([disc.red, disc.green, disc.blue])
    out[met] = light
    return out
