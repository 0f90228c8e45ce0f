# SPDX-License-Identifier: Apache-2.0
"""The light of a shot on the device: environment, water, caustics, and what shades, as light.glsl reads them."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from mr360uw.caustics.gl.stack import upload
from mr360uw.composite.gl.sun_map import MAXIMUM_SLOTS, SunMaps, slot_size
from mr360uw.composite.gl.upload import MeshBuffers, write_uniform
from mr360uw.composite.lighting.light import sun_up, widest_half_angle
from mr360uw.composite.lighting.shadow import basis, disc_offsets
from mr360uw.composite.mesh.mesh import Mesh
from mr360uw.composite.shot import PlacedObject, Shot
from mr360uw.gl.context import (
    set_uniforms,
    texture_array_from_array,
    texture_from_array,
)
from mr360uw.ibl.settings import MAXIMUM_GLOSSY_LEVELS
from mr360uw.types import CausticStack, Floats

if TYPE_CHECKING:
    import moderngl

_BIASED_SLOT = 256
"""Texels across a sun map of which `PlacedObject.bias_m` is one and a half."""
_MAXIMUM_SUN_SAMPLES = 32
_SUN_STEPS = 64.0
"""Sun maps are drawn along directions whose components are so many parts of one, within 0.8 degrees of the sun's: those
of bodies that stand still serve many frames while the sun's track moves a little."""


class LightTextures:
    """Textures and uniforms of the light; `update` before a frame, `set` before every draw."""

    def __init__(self) -> None:
        self.textures: dict[str, Any] = {}
        self.defines: dict[str, int] = {}
        self._keys: dict[str, object] = {}
        self._uniforms: dict[str, Any] = {}
        self._arrays: dict[str, Floats] = {}
        self._sun_maps = SunMaps()

    def update(self, shot: Shot, buffers: Callable[[Mesh], MeshBuffers]) -> None:
        """Bring everything to the state of a shot; what it shares with the one before is kept."""
        sun = shot.sun if shot.sun is not None and shot.sun.direction[1] > 0.0 else None
        casters = [placed for placed in shot.objects if placed.casts_shadow]
        levels = len(shot.environment.glossy)
        self._uniforms = {
            "lights__camera_position": shot.camera_position,
            "lights__camera_depth_m": shot.camera_depth_m,
            "lights__glossy_levels": min(levels, MAXIMUM_GLOSSY_LEVELS),
            "lights__sun_direction": (0.0, 1.0, 0.0),
            "lights__casters": 0,
        }
        has = {
            "MEDIUM": shot.medium is not None, "SUN": sun is not None, "GLOSSY": levels > 0,
            "SHADOW": sun is not None and len(casters) > 0, "CAUSTICS": sun is not None and shot.caustics is not None,
        }  # fmt: skip
        self.defines = {name: 1 for name, there in has.items() if there}
        roughness = np.ones(MAXIMUM_GLOSSY_LEVELS)
        roughness[:levels] = shot.environment.glossy_roughness[:MAXIMUM_GLOSSY_LEVELS]
        self._arrays = {"glossy_roughness": roughness, "slopes": np.zeros((_MAXIMUM_SUN_SAMPLES, 2))}
        self._update_environment(shot)
        self._update_medium(shot)
        self._update_caustics(shot.caustics)
        if sun is None:
            self._hold("sun_map", "none", lambda: texture_from_array(np.zeros((1, 1, 2))))
            self._hold("casters", "none", lambda: texture_from_array(np.zeros((1, 2, 4))))
            return
        half_angle, halo = sun.half_angle_rad, widest_half_angle(shot)
        if halo > half_angle:
            self.defines["HALO"] = 1
        axes = basis(np.round(_SUN_STEPS * np.asarray(sun.direction)))
        across, along = (axes @ sun.direction)[:2], float(axes[2] @ sun.direction)
        size = slot_size(casters, _pixels_across(shot, casters), half_angle)
        count = min(shot.sun_samples, _MAXIMUM_SUN_SAMPLES)
        self._uniforms |= {
            "lights__sun_irradiance": sun.irradiance,
            "lights__sun_direction": sun.direction,
            "lights__sun_up": sun_up(sun),
            "lights__half_angle": half_angle,
            "lights__halo_angle": halo,
            "lights__slot_size": float(size),
            "lights__bias_scale": max(_BIASED_SLOT / size, 1.0),
            "lights__sun_axes": axes.T,
            "lights__sun_slope": across / along,
            "lights__sun_count": count,
            "lights__casters": min(len(casters), MAXIMUM_SLOTS),
        }
        self._arrays["slopes"][:count] = disc_offsets(count)
        key = (size, axes.tobytes(), tuple((id(p.mesh), p.world_from_object.tobytes()) for p in casters))
        if self._keys.get("sun_map") != key:
            maps = self._sun_maps.draw(casters, axes, size, buffers)
            self.textures["sun_map"], self.textures["casters"] = maps
            self._keys["sun_map"] = key

    def set(self, shader: moderngl.Program) -> None:
        """Give a program the numbers of the light."""
        set_uniforms(shader, **self._uniforms)
        for name, values in self._arrays.items():
            write_uniform(shader, name, np.asarray(values, np.float32))

    def _hold(self, name: str, key: object, make: Callable[[], Any]) -> None:
        """Make a texture where its key has changed."""
        if self._keys.get(name) != key:
            self.textures[name] = make()
            self._keys[name] = key

    def _update_environment(self, shot: Shot) -> None:
        environment = shot.environment
        self._kept_environment = environment  # so that its identity stays its own
        self._hold("ambient", id(environment), lambda: texture_array_from_array(environment.ambient[None]))
        glossy = environment.glossy[:MAXIMUM_GLOSSY_LEVELS] if len(environment.glossy) else environment.ambient[None]
        self._hold("glossy", id(environment), lambda: texture_array_from_array(glossy))

    def _update_medium(self, shot: Shot) -> None:
        medium = shot.medium
        self._kept_medium = medium
        blank = np.zeros((1, 1, 3))
        tables = {
            "veil": blank if medium is None else medium.veil,
            "attenuation": blank if medium is None else medium.attenuation,
            "diffuse": blank if medium is None else medium.diffuse[None],
            "beam": blank if medium is None else np.stack([medium.beam, medium.unscattered]),
        }
        for name, table in tables.items():
            self._hold(name, id(medium), functools.partial(texture_from_array, table))
        if medium is not None:
            self._uniforms |= {"medium__camera_depth_m": medium.camera_depth_m, "medium__length_m": medium.length_m}

    def _update_caustics(self, stack: Any) -> None:
        self._kept_caustics = stack
        if stack is None:
            self._hold("caustic_ratio", None, lambda: texture_array_from_array(np.ones((1, 2, 1, 3))))
            self._hold("plane_depth", None, lambda: texture_from_array(np.zeros((1, 1, 1))))
            if "caustic_ratio" not in self.textures:
                self.textures["caustic_ratio"] = texture_array_from_array(np.ones((1, 2, 1, 3)))
                self.textures["plane_depth"] = texture_from_array(np.zeros((1, 1, 1)))
            return
        self._uniforms |= {"stack__tile_m": stack.tile_m, "stack__sun_direction": stack.sun_direction}
        if self._keys.get("caustic_ratio") != id(stack):
            held = upload(stack) if isinstance(stack, CausticStack) else stack
            self.textures |= {"caustic_ratio": held.texture, "plane_depth": held.plane_depth}
            self._keys |= {"caustic_ratio": id(stack), "plane_depth": id(stack)}


def _pixels_across(shot: Shot, casters: list[PlacedObject]) -> float:
    """Return how many pixels of the frame the largest body is wide."""
    widest = 0.0
    for placed in casters:
        radius = placed.mesh.radius_m * placed.scale
        distance = float(np.linalg.norm(placed.to_world(placed.mesh.center_m) - shot.camera_position))
        widest = max(widest, 2.0 * radius / max(distance - radius, 1e-3))
    return widest * shot.height / np.pi
