# SPDX-License-Identifier: Apache-2.0
"""Textures and uniforms of a shot's light: environment, water, caustics, lights and shadow atlas."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mr360uw.cache import Cache
from mr360uw.caustics.gl.stack import AtlasScratch, upload
from mr360uw.composite.gl.light_slots import lamp_frames, shadow_table, sun_defines, sun_frames, sun_grid, sun_uniforms
from mr360uw.composite.gl.shadow_atlas import ShadowAtlas, slot_size, translucent
from mr360uw.composite.gl.upload import MeshBuffers, write_uniform
from mr360uw.composite.lighting.lamps import lamps_of
from mr360uw.composite.lighting.shadow import wide_pixel_offsets
from mr360uw.composite.lighting.sun import sun_of
from mr360uw.composite.mesh.mesh import Mesh
from mr360uw.composite.shot import Shot
from mr360uw.constants import MAXIMUM_GLOSSY_LEVELS, MAXIMUM_SUN_RAYS, MAXIMUM_SUN_SAMPLES
from mr360uw.gl.context import set_uniforms, texture_array_from_array, texture_from_array
from mr360uw.sphere import disc_offsets
from mr360uw.types import CausticStack, Environment, Floats, MediumTable

if TYPE_CHECKING:
    import moderngl

_NARROW = 512
"""Width of a frame [pixels] below which a pixel's footprint is so large that more rays are cast from it, in proportion:
with 24, noise at the edges of shadows exceeds two code values in one pixel of five hundred at a width of 128."""
_BIASED_SLOT = 256
"""Texels across a slot in which `PlacedObject.bias_m` is 1.5 texels."""

_OF_SIGHT = (
    "sun__direction", "sun__half_angle", "sun__halo_angle", "sun__axes", "sun__slope", "sun__casters",
    "shadows__samples", "shadows__slot_size", "shadows__bias_scale",
)  # fmt: skip
"""Uniforms that what is seen of the sun depends on."""


@dataclass(frozen=True, slots=True, eq=False)
class ShotLight:
    """The light of one shot on the device. textures, uniforms, arrays: by their names in shaders. defines: of these."""

    defines: dict[str, int]
    textures: dict[str, Any]
    uniforms: dict[str, Any]
    arrays: dict[str, Floats]

    @property
    def of_sun(self) -> frozenset[str]:
        """Features of the sun in the shot: SHADOW, CAUSTICS."""
        return frozenset(self.defines) & {"SHADOW", "CAUSTICS"}

    @property
    def of_sight(self) -> tuple[Any, ...]:
        """All that decides what is seen of the sun from a place: textures and uniforms."""
        return self.textures["sun_map"], self.textures["casters"], *map(self.uniforms.get, _OF_SIGHT)

    def set(self, shader: moderngl.Program) -> None:
        """Set the uniforms of the light in a program."""
        set_uniforms(shader, **self.uniforms)
        for name, values in self.arrays.items():
            write_uniform(shader, name, np.asarray(values, np.float32))


class LightTextures:
    """Makes textures and uniforms of the light of shots; unchanged textures come from the cache."""

    def __init__(self, cache: Cache, buffers: Callable[[Mesh], MeshBuffers]) -> None:
        self._cache = cache
        self._atlas, self._caustic_scratch = ShadowAtlas(cache, buffers), AtlasScratch()

    def of(self, shot: Shot) -> ShotLight:
        """Return the light of a shot."""
        levels, lamps = min(len(shot.environment.glossy), MAXIMUM_GLOSSY_LEVELS), lamps_of(shot)
        defines = dict.fromkeys(sorted(sun_defines(shot)), 1)
        defines |= {name: 1 for name, there in (("MEDIUM", shot.medium), ("GLOSSY", levels)) if there}
        defines |= {"LAMPS": len(lamps)} if lamps else {}
        roughness = np.ones(MAXIMUM_GLOSSY_LEVELS)
        roughness[:levels] = shot.environment.glossy_roughness[:levels]
        finer = int(np.clip(round(_NARROW / shot.view.width), 1, MAXIMUM_SUN_RAYS // MAXIMUM_SUN_SAMPLES))
        count = finer * min(shot.draw.sun_samples, MAXIMUM_SUN_SAMPLES)
        rays = np.zeros((MAXIMUM_SUN_RAYS, 4))
        rays[:count, :2], rays[:count, 2:] = disc_offsets(count), wide_pixel_offsets(count)
        uniforms = {
            "view__position": shot.view.position,
            "view__surface_y_m": shot.view.surface_y_m,
            "outside_index": shot.refractive_index,
            "glossy_levels": levels,
            "shadows__samples": count,
            **sun_uniforms(shot),
        }
        # one texture of the ambient irradiance and, in the layers after it, the glossy levels
        textures = {"ambient": self._cache.of(_ambient_texture, shot.environment)}
        light = ShotLight(defines, textures, uniforms, {"glossy_roughness": roughness, "rays": rays})
        self._add_medium(shot, light)
        self._add_caustics(shot.caustics, light)
        self._add_shadows(shot, light)
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
        if stack is None:
            light.textures.update(self._cache.of(_no_caustics))
            return
        light.uniforms.update({"stack__tile_m": stack.tile_m, "stack__sun_direction": stack.sun_direction})
        held = self._cache.of(upload, stack, self._caustic_scratch)
        light.textures.update({"caustic_ratio": held.ratio, "plane_depth": held.plane_depth})

    def _add_shadows(self, shot: Shot, light: ShotLight) -> None:
        sun, lamps = sun_of(shot), lamps_of(shot)
        of_sun, of_lamps = sun_frames(shot), lamp_frames(shot)
        frames = [*of_sun, *(frame for group in of_lamps for frame in group)]
        radii = [lamp.radius_m / frame.middle_m for lamp, g in zip(lamps, of_lamps, strict=True) for frame in g]
        narrowest = min([*radii, *([] if sun is None else [sun.half_angle_rad])], default=0.0)
        size = slot_size(len(frames), _pixels_across(shot), narrowest)
        texture, of_atlas = self._atlas.of(frames, size)
        light.defines.update({"TRANSLUCENT": 1} if translucent(frames) else {})
        slots = np.cumsum([len(of_sun), *(len(group) for group in of_lamps)]).tolist()
        table = shadow_table(shot, of_atlas, frames, slots)
        of_grid, rows = sun_grid(shot, of_atlas, len(table))
        table = np.concatenate([table, rows])
        light.textures.update({"sun_map": texture, "casters": self._cache.of(texture_from_array, table, keep=2)})
        light.uniforms.update(
            {
                "shadows__slot_size": float(size),
                "shadows__bias_scale": max(_BIASED_SLOT / size, 1.0),
                "first_lamp": len(of_atlas),
                **of_grid,
            }
        )


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


def _pixels_across(shot: Shot) -> float:
    """Return the width [pixels] of the body that is largest in the frame."""
    widest = 0.0
    for placed in shot.casters:
        radius = placed.mesh.radius_m * placed.scale
        distance = float(np.linalg.norm(placed.to_world(placed.mesh.center_m) - shot.view.position))
        widest = max(widest, 2.0 * radius / max(distance - radius, 1e-3))
    return widest * shot.view.height / np.pi
