# SPDX-License-Identifier: Apache-2.0
"""Light of a shot on the device: textures and uniforms of environment, water, caustics, sun and lamps; and what hides
sun and lamps, which is found on the processor.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mr360uw.cache import Cache, Scratch
from mr360uw.composite.gl.caustic_atlas import AtlasScratch, StackTextures, upload
from mr360uw.composite.gl.device import write_uniform
from mr360uw.composite.gl.light_visibility import HALO, Visibility, visibility_of
from mr360uw.composite.lighting.light_sources import lamps_of, sun_of, sun_up, widest_half_angle
from mr360uw.composite.shot import Shot
from mr360uw.constants import MAXIMUM_GLOSSY_LEVELS
from mr360uw.gl.context import set_uniforms, texture_array_from_array, texture_from_array
from mr360uw.medium.shafts.single_scattering import nearest_m
from mr360uw.types import CausticStack, Environment, Floats, MediumTable

if TYPE_CHECKING:
    import moderngl


_ROWS_OF_BEAM = 2
"""Rows of the texture `beam` before the lamps' attenuations: the sun's beam, and what of it has not turned."""


@dataclass(frozen=True, slots=True, eq=False)
class ShotLight:
    """The light of one shot on the device. textures, uniforms, arrays: by their names in shaders. defines: of these.
    visibility: of its sun and lamps. caustics: of the shot, held as long as their textures are in use.
    """

    defines: dict[str, int]
    textures: dict[str, Any]
    uniforms: dict[str, Any]
    arrays: dict[str, Floats]
    visibility: Visibility
    caustics: StackTextures | None = None

    @property
    def of_sun(self) -> frozenset[str]:
        """Features of the sun in the shot: SHADOW, CAUSTICS."""
        return frozenset(self.defines) & {"SHADOW", "CAUSTICS"}

    @property
    def lamps(self) -> range:
        """Numbers of the lamps in `Visibility`."""
        return range(HALO + 1, len(self.visibility.lights))

    def set(self, shader: moderngl.Program) -> None:
        """Set the uniforms of the light in a program."""
        set_uniforms(shader, **self.uniforms)
        for name, values in self.arrays.items():
            write_uniform(shader, name, np.asarray(values, np.float32))


class LightTextures:
    """Makes textures and uniforms of the light of shots; unchanged textures come from the cache."""

    def __init__(self, cache: Cache) -> None:
        self._cache, self._caustic_scratch, self._scratch = cache, AtlasScratch(), Scratch()

    def of(self, shot: Shot) -> ShotLight:
        """Return the light of a shot."""
        levels, lamps = min(len(shot.environment.glossy), MAXIMUM_GLOSSY_LEVELS), lamps_of(shot)
        defines = dict.fromkeys(sorted(sun_defines(shot)), 1)
        defines |= {name: 1 for name, there in (("MEDIUM", shot.medium), ("GLOSSY", levels)) if there}
        defines |= {"LAMPS": len(lamps)} if lamps else {}
        roughness = np.ones(MAXIMUM_GLOSSY_LEVELS)
        roughness[:levels] = shot.environment.glossy_roughness[:levels]
        uniforms = {
            "view__position": shot.view.position,
            "view__surface_y_m": shot.view.surface_y_m,
            "outside_index": shot.refractive_index,
            "glossy_levels": levels,
            **_sun_uniforms(shot),
        }
        # one texture of the ambient irradiance and, in the layers after it, the glossy levels
        textures: dict[str, Any] = {"ambient": self._cache.of(_ambient_texture, shot.environment)}
        caustics = None if shot.caustics is None else self._cache.of(upload, shot.caustics, self._caustic_scratch)
        textures["lamps"] = self._cache.of(texture_from_array, _lamp_rows(shot), keep=2)
        visibility = visibility_of(shot, self._cache, self._scratch)
        light = ShotLight(defines, textures, uniforms, {"glossy_roughness": roughness}, visibility, caustics)
        self._add_medium(shot, light)
        self._add_caustics(shot.caustics, light)
        return light

    def _add_medium(self, shot: Shot, light: ShotLight) -> None:
        medium, lamps = shot.medium, lamps_of(shot)
        light.textures.update(self._cache.of(_medium_textures, medium))
        if medium is None:
            return
        light.uniforms.update({"medium__camera_depth_m": medium.camera_depth_m, "medium__length_m": medium.length_m})
        if lamps:
            of_lamps = (lamp.attenuation for lamp in lamps if lamp.attenuation is not None)
            rows = np.stack([medium.beam, medium.unscattered, *of_lamps])
            light.textures["beam"] = self._cache.of(texture_from_array, rows, keep=2)

    def _add_caustics(self, stack: CausticStack | None, light: ShotLight) -> None:
        if stack is None or light.caustics is None:
            light.textures.update(self._cache.of(_no_caustics))
            return
        light.uniforms.update({"stack__tile_m": stack.tile_m, "stack__sun_direction": stack.sun_direction})
        held = light.caustics
        light.textures.update({"caustic_ratio": held.ratio, "plane_depth": held.plane_depth})


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
    blank = np.zeros((1, 1, 3))
    ratio = np.ones((1, 2, 3)) if medium is None or medium.plate_ratio is None else medium.plate_ratio
    tables = {
        "veil": blank if medium is None else medium.veil,
        "attenuation": blank if medium is None else medium.attenuation,
        "diffuse": blank if medium is None else medium.diffuse,
        "beam": blank if medium is None else np.stack([medium.beam, medium.unscattered]),
    }
    textures = {name: texture_from_array(table) for name, table in tables.items()}
    return textures | {"plate_ratio": texture_array_from_array(ratio[None])}


def sun_defines(shot: Shot) -> frozenset[str]:
    """Return the shader switches of a shot's sun."""
    sun = sun_of(shot)
    if sun is None:
        return frozenset()
    has = {
        "SUN": True, "SHADOW": len(shot.casters) > 0, "CAUSTICS": shot.caustics is not None,
        "SOFT": shot.caustics is not None and shot.caustics.softened,
        "HALO": widest_half_angle(shot) > sun.half_angle_rad,
    }  # fmt: skip
    return frozenset(name for name, there in has.items() if there)


def _sun_uniforms(shot: Shot) -> dict[str, Any]:
    """Return the uniforms of `Sun` in sun.glsl."""
    sun = sun_of(shot)
    if sun is None:
        return {"sun__direction": (0.0, 1.0, 0.0)}
    return {
        "sun__irradiance": sun.irradiance,
        "sun__direction": sun.direction,
        "sun__up": sun_up(sun),
        "sun__half_angle": sun.half_angle_rad,
        "sun__halo_angle": widest_half_angle(shot),
    }


def _lamp_rows(shot: Shot) -> Floats:
    """Return the texture `lamps` (lamps, 4, 4), as lamps.glsl reads it."""
    rows = [
        ((*(lamp.position - shot.view.position), lamp.radius_m), (*lamp.axis, lamp.cos_core),
         (*lamp.intensity, lamp.cos_edge), (_ROWS_OF_BEAM + number, nearest_m(lamp), 0.0, 0.0))
        for number, lamp in enumerate(lamps_of(shot))
    ]  # fmt: skip
    return np.array(rows or np.zeros((1, 4, 4)), np.float64)
