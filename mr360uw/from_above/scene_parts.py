# SPDX-License-Identifier: Apache-2.0
"""Floor, water, sea and sky of a scene's settings, as pictures through the surface take them."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mr360uw.constants import CLEAR_SKY_B, CLEAR_SKY_G, CLEAR_SKY_R, PI
from mr360uw.from_above.settings import AerialFloorSettings, AerialScene, AerialWaterSettings
from mr360uw.medium import Medium, Water
from mr360uw.medium.medium import RGB_NM, Mode
from mr360uw.medium.spectral.sensor import named_sensor
from mr360uw.medium.tabulate import FormationModel
from mr360uw.published.aerial_look import blended_albedo
from mr360uw.sample.dive_settings import DiveSettings
from mr360uw.sample.sea_bed import sea_bed
from mr360uw.sphere import direction_from_angles, directions, row_solid_angle
from mr360uw.surface import Floor, SeaScene
from mr360uw.surface.sky import CLEAR, OVERCAST, standard_sky
from mr360uw.types import Sun
from mr360uw.video.opening import open_video
from mr360uw.video.read.picture_file import read_picture

Array = NDArray[np.float64]

_MOST_ROWS = 512
"""Rows that maps are reduced to: what waves mirror is blurred more."""
_SHAPES = {"overcast": OVERCAST, "clear": CLEAR}
_SHARE = {"overcast": 0.5, "clear": 0.2}
"""Irradiance of level ground over that of the sun's beam across itself. A clear sky gives 10 to 20 % of all light with
the sun high."""


def sun_of(scene: AerialScene) -> Sun | None:
    """Return the sun of a scene; None where it has none."""
    given = scene.sun.irradiance
    irradiance = np.full(3, 1.0 if scene.sky.kind == "clear" else 0.0) if given is None else np.array(given)
    if not np.any(irradiance > 0.0):
        return None
    return Sun(_sun_direction(scene), irradiance, scene.sun.half_angle_rad, 1.0)


def sky_of(scene: AerialScene) -> Array:
    """Return the radiance (h, 2 h, 3) of a scene's sky, without its sun; raise `VideoError` for maps that cannot be
    read.
    """
    sky = scene.sky
    if sky.kind == "map":
        assert sky.map is not None
        return _scaled(_map(sky.map, sky.turn_deg), sky.irradiance)
    color = np.array([CLEAR_SKY_R, CLEAR_SKY_G, CLEAR_SKY_B]) if sky.kind == "clear" else np.ones(3)
    dome = standard_sky(_SHAPES[sky.kind], _sun_direction(scene))
    return _scaled(dome[..., None] * color, _SHARE[sky.kind] if sky.irradiance is None else sky.irradiance)


def _sun_direction(scene: AerialScene) -> Array:
    return direction_from_angles(math.radians(scene.sun.azimuth_deg), math.radians(scene.sun.elevation_deg))


def _map(path: Path, turn_deg: float) -> Array:
    """Return the radiance (h, 2 h, 3) of a picture of the sky, turned to the right."""
    import cv2

    light = _light(path)
    rows = min(max(light.shape[0] // 2 * 2, 2), _MOST_ROWS)
    light = np.asarray(cv2.resize(light, (2 * rows, rows), interpolation=cv2.INTER_AREA), np.float64)
    light = np.maximum(np.nan_to_num(light, posinf=0.0, neginf=0.0), 0.0)
    return np.roll(light, round(turn_deg / 360.0 * 2 * rows), axis=1)


def _light(path: Path) -> Array:
    """Return the linear Rec.709 light (h, w, 3) of a picture, by its profile or its primaries where it states any."""
    with open_video(path, equirectangular=False) as picture:
        return np.asarray(next(picture.frames(1)).image_linear, np.float64)


def _scaled(dome: Array, irradiance: float | None) -> Array:
    """Return a dome with a mean irradiance of level ground; the dome itself for None or a dark one."""
    height, width = dome.shape[:2]
    weight = row_solid_angle(width, height) * np.maximum(directions(width, height)[:, 0, 1], 0.0)
    total = float(np.mean(np.einsum("hwc,h->c", dome, weight)))
    return dome if irradiance is None or total <= 0.0 else dome * (irradiance / total)


_SEEN_FROM_M = 0.01
"""Depth [m] of the medium's camera, just below the surface."""
_MOST_PIXELS = 2048
"""Side that pictures of the ground are reduced to."""
_SAND_SEED = 1


def sea_scene_of(scene: AerialScene) -> SeaScene:
    """Return a scene with its water solved and its files read; raise `ParameterError` or `VideoError`."""
    index, sea = scene.water.refractive_index, scene.sea
    if "water_depth_m" not in sea.model_fields_set:
        sea = sea.model_copy(update={"water_depth_m": scene.floor.depth_m})  # waves feel the scene's floor
    return SeaScene(
        sea, sky_of(scene), floor_of(scene.floor, scene.water), water_of(scene.water), sun=sun_of(scene),
        refractive_index=index, caustics=scene.caustics,
    )  # fmt: skip


def floor_of(floor: AerialFloorSettings, water: AerialWaterSettings) -> Floor:
    """Return the floor with its picture, mixed with the water's colour in mode blended."""
    albedo = np.broadcast_to(np.asarray(floor.albedo, np.float64), (3,))
    image: Array = albedo[None, None]
    if floor.ground == "sand":
        sand = sea_bed(DiveSettings(seed=_SAND_SEED, rocks=0.0, grass=0.0))[1]
        image = sand / sand.mean(axis=(0, 1)) * albedo
    elif floor.ground == "picture":
        assert floor.picture is not None
        image = _square(_light(floor.picture)) * albedo
    image = np.clip(image, 0.0, 1.0)
    if water.mode == "blended":
        per_m, color = blend_of(water)
        image = blended_albedo(image, floor.depth_m, per_m, color)
    if floor.relief is None:
        return Floor(-floor.depth_m, image, floor.tile_m)
    heights = floor.relief_m * _square(_heights(floor.relief))
    return Floor(-floor.depth_m, image, floor.relief_tile_m, relief=heights, albedo_tile_m=floor.tile_m)


def _heights(path: Path) -> Array:
    """Return heights (h, w), black 0 and white 1, of a picture; those of EXR and HDR files as they are."""
    codes = read_picture(path)
    scale = 1.0 if codes.dtype.kind == "f" else float(np.iinfo(codes.dtype).max)
    return codes.mean(axis=-1, dtype=np.float64) / scale


def water_of(settings: AerialWaterSettings) -> Medium | None:
    """Return the medium of a scene; None for clear water, which mode blended has too."""
    water = settings.water()
    if water is None or settings.mode == "blended":
        return None
    if settings.mode != "koschmieder":
        return _medium(settings, water)
    beta = np.array(settings.attenuation_per_m or water.attenuation(np.array(RGB_NM)))
    far = _deep_radiance(settings, water) if settings.far_radiance is None else np.array(settings.far_radiance)
    formation = FormationModel(beta, np.asarray(water.diffuse_attenuation(np.array(RGB_NM))), beta, far)
    return Medium(
        water, named_sensor(str(settings.sensor)), "koschmieder", _SEEN_FROM_M, illuminant=settings.illuminant,
        refractive_index=settings.refractive_index, formation=formation,
    )  # fmt: skip


def blend_of(settings: AerialWaterSettings) -> tuple[Array, Array]:
    """Return k (3,) [1/m] and the colour (3,) of mode blended."""
    water = settings.water()
    per_m, color = settings.blend_per_m, settings.blend_color
    if water is None:
        return np.array(per_m or (0.0, 0.0, 0.0)), np.array(color or (0.0, 0.0, 0.0))
    k = 2.0 * water.diffuse_attenuation(np.array(RGB_NM)) if per_m is None else np.array(per_m)
    own = np.clip(PI * _deep_radiance(settings, water), 0.0, 1.0) if color is None else np.array(color)
    return np.asarray(k), own


def _medium(settings: AerialWaterSettings, water: Water) -> Medium:
    mode: Mode = "kd" if settings.mode == "kd" else "table"
    return Medium(
        water, named_sensor(str(settings.sensor)), mode, _SEEN_FROM_M, illuminant=settings.illuminant,
        refractive_index=settings.refractive_index,
    )  # fmt: skip


def _deep_radiance(settings: AerialWaterSettings, water: Water) -> Array:
    """Return the radiance (3,) [1/sr] that comes up from deep water per unit irradiance just below the surface."""
    solved = settings.model_copy(update={"mode": "table"})
    return np.asarray(_medium(solved, water).level_radiance(np.array([-1.0]))[0])


def _square(image: Array) -> Array:
    """Return a picture as a square whose side is a power of two, which repeats as the picture does."""
    import cv2

    side = 2 ** round(math.log2(min(max(image.shape[:2]), _MOST_PIXELS)))
    return np.asarray(cv2.resize(image, (side, side), interpolation=cv2.INTER_AREA))
