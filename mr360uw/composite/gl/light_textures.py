# SPDX-License-Identifier: Apache-2.0
"""Light of a shot on the device: textures and uniforms of environment, water, caustics, sun and lamps; and what hides
sun and lamps, which is found on the processor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mr360uw.cache import Cache, Scratch
from mr360uw.composite.gl.caustic_atlas import AtlasScratch, StackTextures, upload
from mr360uw.composite.gl.light_visibility import Visibility, visibility_of
from mr360uw.composite.lighting.light_sources import lamps_of, sun_of, sun_up, widest_half_angle
from mr360uw.composite.shot import Shot
from mr360uw.constants import MAXIMUM_GLOSSY_LEVELS
from mr360uw.gl.context import texture_array_from_array, texture_from_array
from mr360uw.medium.shafts.single_scattering import nearest_m
from mr360uw.types import Environment, Floats, MediumTable

if TYPE_CHECKING:
    import moderngl


_ROWS_OF_BEAM = 2
"""Rows of the texture `beam` before the lamps' attenuations: the sun's beam, and what of it has not turned."""


@dataclass(frozen=True, slots=True, eq=False)
class ShotLight:
    """The light of one shot on the device. textures, uniforms: by their names in shaders. defines: of these.
    visibility: of its sun and lamps. caustics: of the shot, held as long as their textures are in use.
    """

    defines: dict[str, int]
    textures: dict[str, Any]
    uniforms: dict[str, Any]
    visibility: Visibility
    caustics: StackTextures | None = None


class LightTextures:
    """Makes textures and uniforms of the light of shots; unchanged textures come from the cache."""

    def __init__(self, cache: Cache) -> None:
        self._cache, self._caustic_scratch, self._scratch = cache, AtlasScratch(), Scratch()

    def of(self, shot: Shot) -> ShotLight:
        """Return the light of a shot."""
        environment, medium, stack, cache = shot.environment, shot.medium, shot.caustics, self._cache
        sun, lamps, widest = sun_of(shot), lamps_of(shot), widest_half_angle(shot)
        levels = min(len(environment.glossy), MAXIMUM_GLOSSY_LEVELS)
        # The features that shaders have
        defines: dict[str, int] = {}
        if sun is not None:
            of_sun = {
                "SUN": True, "SHADOW": len(shot.casters) > 0, "CAUSTICS": stack is not None,
                "SOFT": stack is not None and stack.softened, "HALO": widest > sun.half_angle_rad,
            }  # fmt: skip
            defines = dict.fromkeys(filter(of_sun.get, of_sun), 1)
        defines |= {"MEDIUM": 1} if medium is not None else {}
        defines |= {"GLOSSY": 1} if levels else {}
        defines |= {"LAMPS": len(lamps)} if lamps else {}
        # The camera, the environment and the sun (sun.glsl)
        roughness = np.ones(MAXIMUM_GLOSSY_LEVELS)
        roughness[:levels] = environment.glossy_roughness[:levels]
        uniforms: dict[str, Any] = {
            "view__position": shot.view.position, "view__surface_y_m": shot.view.surface_y_m,
            "outside_index": shot.refractive_index, "glossy_levels": levels, "glossy_roughness": roughness,
            "sun__direction": (0.0, 1.0, 0.0),
        }  # fmt: skip
        if sun is not None:
            uniforms |= {
                "sun__irradiance": sun.irradiance, "sun__direction": sun.direction, "sun__up": sun_up(sun),
                "sun__half_angle": sun.half_angle_rad, "sun__halo_angle": widest,
            }  # fmt: skip
        # One texture of the ambient irradiance and the glossy levels after it, one of lamps (lamps.glsl)
        textures: dict[str, Any] = {"ambient": cache.of(_ambient_texture, environment)}
        rows = np.zeros((max(len(lamps), 1), 4, 4))
        for number, (row, lamp) in enumerate(zip(rows, lamps, strict=False)):
            row[:3, :3] = lamp.position - shot.view.position, lamp.axis, lamp.intensity
            row[:3, 3] = lamp.radius_m, lamp.cos_core, lamp.cos_edge
            row[3, :2] = _ROWS_OF_BEAM + number, nearest_m(lamp)
        textures["lamps"] = cache.of(texture_from_array, rows, keep=2)
        # The water, with the attenuation of lamps' own light
        textures |= cache.of(_medium_textures, medium)
        if medium is not None:
            uniforms |= {"medium__camera_depth_m": medium.camera_depth_m, "medium__length_m": medium.length_m}
            if lamps:
                of_lamps = (lamp.attenuation for lamp in lamps if lamp.attenuation is not None)
                beam = np.stack([medium.beam, medium.unscattered, *of_lamps])
                textures["beam"] = cache.of(texture_from_array, beam, keep=2)
        # The caustics
        held = None if stack is None else cache.of(upload, stack, self._caustic_scratch)
        if stack is None or held is None:
            textures |= cache.of(_no_caustics)
        else:
            uniforms |= {"stack__tile_m": stack.tile_m, "stack__sun_direction": stack.sun_direction}
            textures |= {"caustic_ratio": held.ratio, "plane_depth": held.plane_depth}
        return ShotLight(defines, textures, uniforms, visibility_of(shot, cache, self._scratch), held)


def _ambient_texture(environment: Environment) -> moderngl.TextureArray:
    glossy = environment.glossy[:MAXIMUM_GLOSSY_LEVELS]
    return texture_array_from_array(np.stack([environment.ambient, *glossy]))


def _no_caustics() -> dict[str, Any]:
    return {
        "caustic_ratio": texture_array_from_array(np.ones((1, 2, 1, 3))),
        "plane_depth": texture_from_array(np.zeros((1, 1, 1))),
    }


def _medium_textures(medium: MediumTable | None) -> dict[str, Any]:
    """Return the tables of a medium in the layout of medium/lookup.glsl, and the plate's ratio."""
    ratio: Floats = np.ones((1, 2, 3))
    tables: Sequence[Floats] = [np.zeros((1, 1, 3))] * 4
    if medium is not None:
        ratio = ratio if medium.plate_ratio is None else medium.plate_ratio
        tables = medium.veil, medium.attenuation, medium.diffuse, np.stack([medium.beam, medium.unscattered])
    textures = dict(zip(("veil", "attenuation", "diffuse", "beam"), map(texture_from_array, tables), strict=True))
    return textures | {"plate_ratio": texture_array_from_array(ratio[None])}
