# SPDX-License-Identifier: Apache-2.0
"""Textures and uniforms of what the rays of a picture can meet besides the surface: sky, floor and water."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import Cache, Same
from mr360uw.gl.context import gl_context, texture_array_from_array, texture_from_array
from mr360uw.surface.ray_stage import FARTHEST_M, RayStage
from mr360uw.surface.sampled_sea import SampledSea
from mr360uw.surface.sea_floor import FloorLight, Tiled
from mr360uw.surface.water_light import WaterLight
from mr360uw.types import Floats, View

if TYPE_CHECKING:
    import moderngl

Array = NDArray[np.float64]


_PROJECTIONS = ("equirectangular", "perspective", "orthographic")


@dataclass(frozen=True, slots=True, eq=False)
class Inputs:
    """Inputs of the shaders, by name. Names of uniforms have two underscores for a dot."""

    textures: dict[str, Any]
    uniforms: dict[str, Any]
    defines: dict[str, Any]


def stage_inputs(stage: RayStage, view: View, cache: Cache) -> Inputs:
    """Return the inputs of a picture but for the atlas of heights. cache: of textures."""
    sea = stage.sea
    lost = sea.lost_slope + sea.blur_variance * np.array([1.0, 0.0, 1.0])
    found = Inputs(
        {"lost_slopes": cache.get("lost slopes", sea, lambda: texture_from_array(lost[None]))},
        {**_camera(view), **_waves(sea), "floor_y_m": stage.floor_y_m, "refractive_index": stage.refractive_index},
        {"CAMERA_IN_WATER": "true" if stage.camera_in_water else "false",
         "WATER_ENDS": 1.0 if stage.water.sky is None else 0.0},
    )  # fmt: skip
    sun, detail = stage.sun, sea.detail
    if sun is not None and sun.direction[1] > 0.0:
        found.defines["SUN"] = 1
        for name in ("direction", "irradiance", "half_angle_rad"):
            found.uniforms[f"sun__{name}"] = getattr(sun, name)
    if detail is not None:
        found.defines["RIPPLES"] = 1
        found.textures["ripples"] = cache.get(
            "ripples", detail.slopes.tobytes(), lambda: texture_from_array(detail.slopes)
        )
        found.uniforms.update({
            "detail__repeats": detail.repeats, "detail__offset": detail.offset,
            "ripple_wave": sea.ripple_wave, "ripple_variance": sea.ripple_variance,
        })  # fmt: skip
    _add_sky(found, stage, cache)
    _add_floor(found, stage, cache)
    if stage.water.sky is not None:
        found.defines["WATER"] = 1
        for name, from_camera in (("from_camera", True), ("from_surface", False)):
            _add_water(found, stage.water, name, cache, from_camera=from_camera)
        _add_around_sun(found, stage.water, cache)
    return found


def _camera(view: View) -> dict[str, Any]:
    half = {"equirectangular": 0.0, "perspective": np.tan(0.5 * view.fov_rad), "orthographic": 0.5 * view.width_m}
    return {
        "camera__size": (float(view.width), float(view.height)),
        "camera__position": view.position - np.array([0.0, view.surface_y_m, 0.0]),
        "camera__world_from_camera": view.world_from_camera.T,  # column after column
        "camera__projection": _PROJECTIONS.index(view.projection),
        "camera__half_width": float(half[view.projection]),
        "pixel_rad": view.pixel_rad,
        "pixel_m": view.pixel_m,
    }


def _waves(sea: SampledSea) -> dict[str, Any]:
    names = ("tile_m", "step_m", "lowest_m", "highest_m", "steepest")
    numbers = {f"waves__{name}": getattr(sea, name) for name in names}
    return {**numbers, "waves__points": int(sea.size[0]), "waves__last": len(sea.size) - 1}


def _add_sky(found: Inputs, stage: RayStage, cache: Cache) -> None:
    levels = stage.dome.levels
    height, width = levels[0].shape[:2]
    found.textures["sky"] = cache.get("sky", stage.dome, lambda: texture_from_array(sky_atlas(levels), nearest=False))
    found.uniforms.update({"dome__size": (width, height), "dome__levels": len(levels)})


def _add_floor(found: Inputs, stage: RayStage, cache: Cache) -> None:
    light, image = stage.floor_light, stage.floor.image
    patterns, textures = cache.get("patterns", light, lambda: _pattern_textures(light))
    found.defines["PATTERNS"] = len(patterns)
    found.textures["albedo"] = cache.get("albedo", image, lambda: tiled_texture(image.levels))
    for k, (pattern, texture) in enumerate(zip(patterns, textures, strict=True)):
        found.textures[f"pattern_{k}"] = texture
        found.uniforms.update(_place(f"pattern_tile[{k}]", pattern))
    lost = np.zeros(3)
    if stage.water.sky is None:  # level rays in clear water: the floor and its mirror image, far away
        lost = light.radiance(stage.floor, lost[:1], lost[:1], np.array([FARTHEST_M]), False)[0]
    found.uniforms.update(
        {"even_light": light.even, "dry_light": light.dry, "lost_light": lost, **_place("albedo_tile", image)}
    )


def _place(name: str, tiled: Tiled) -> dict[str, Any]:
    return {f"{name}__tile_m": tiled.tile_m, f"{name}__origin": tiled.origin}


def _pattern_textures(light: FloorLight) -> tuple[list[Tiled], list[moderngl.Texture]]:
    patterns = light_patterns(light)
    return patterns, [tiled_texture(pattern.levels) for pattern in patterns]


def _add_water(found: Inputs, water: WaterLight, name: str, cache: Cache, *, from_camera: bool) -> None:
    table = water.table(from_camera)
    veil, attenuation = cache.get(
        name, table, lambda: (texture_from_array(table.veil), texture_from_array(table.attenuation))
    )
    found.textures[f"veil_{name}"], found.textures[f"attenuation_{name}"] = veil, attenuation
    found.uniforms.update({f"{name}__{k}": getattr(table, k) for k in ("camera_depth_m", "length_m")})


def _add_around_sun(found: Inputs, water: WaterLight, cache: Cache) -> None:
    maps = water.sun_maps
    if not maps:
        return
    found.defines["AROUND_SUN"] = 1
    found.textures["around"] = cache.get(
        "around", tuple(map(Same, maps)), lambda: texture_array_from_array(np.stack([maps[0], maps[-1]]))
    )


def sky_atlas(levels: Sequence[Floats]) -> NDArray[np.float32]:
    """Return levels (h, w, 3) below each other, each with a border of the pixels beyond the seam and the poles."""
    width = levels[0].shape[1]
    atlas = np.zeros((sum(len(level) + 2 for level in levels), width + 2, 3), np.float32)
    top = 0
    for level in levels:
        h, w = level.shape[:2]
        square = atlas[top : top + h + 2, : w + 2]
        square[1:-1, 1:-1] = level
        for edge, row in ((0, level[0]), (-1, level[-1])):
            square[edge, 1:-1] = np.roll(row, w // 2, axis=0)
        square[:, 0], square[:, -1] = square[:, w], square[:, 1]
        top += h + 2
    return atlas


def tiled_texture(levels: Sequence[Floats]) -> moderngl.Texture:
    """Return a picture that repeats, with its halves: levels (1, size, size, 1 or 3)."""
    context, size = gl_context(), levels[0].shape[1]
    texture = context.texture((size, size), 3, dtype="f4", alignment=1)
    texture.build_mipmaps(0, len(levels) - 1)
    for k, level in enumerate(levels):
        image = np.broadcast_to(level[0], (*level.shape[1:3], 3))
        texture.write(np.ascontiguousarray(image, np.float32), level=k, alignment=1)
    texture.filter = (context.LINEAR_MIPMAP_LINEAR, context.LINEAR)
    return texture


def light_patterns(light: FloorLight) -> list[Tiled]:
    """Return the patterns of a floor's light times their factors, those in one place summed."""
    groups: dict[tuple[float, tuple[float, float], int], list[tuple[Tiled, Array]]] = {}
    for pattern, factor in light.patterns:
        groups.setdefault((pattern.tile_m, pattern.origin, len(pattern.levels)), []).append((pattern, factor))
    sums = []
    for (tile_m, origin, count), group in groups.items():
        levels: list[Floats] = []
        for k in range(count):
            level = np.zeros((1, 1, 1, 3), np.float32)
            for pattern, factor in group:
                level = level + factor.astype(np.float32) * pattern.levels[k].astype(np.float32)
            levels.append(level)
        sums.append(Tiled(levels, tile_m, origin))
    return sums
