# SPDX-License-Identifier: Apache-2.0
"""Light of a shot on the device: textures and uniforms of environment, water, caustics, sun and lamps; and what hides
sun and lamps, which is found on the processor.
"""

from __future__ import annotations

import functools
import weakref
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import Cache, Scratch
from mr360uw.caustic_lookup import mip_levels
from mr360uw.composite.gl.light_visibility import Visibility, visibility_of
from mr360uw.composite.lighting.light_sources import lamps_of, sun_of, sun_up, widest_half_angle
from mr360uw.composite.shot import Shot
from mr360uw.constants import MAXIMUM_GLOSSY_LEVELS
from mr360uw.gl.context import texture_array_from_array, texture_from_array
from mr360uw.jit import exact
from mr360uw.medium.shafts.single_scattering import nearest_m
from mr360uw.types import CausticStack, Environment, Floats, MediumTable

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
        defines |= {"EYE": 1} if shot.view.eye_m else {}  # rays start on the viewing circle (eyes.glsl)
        # The camera, the environment and the sun (sun.glsl)
        roughness = np.ones(MAXIMUM_GLOSSY_LEVELS)
        roughness[:levels] = environment.glossy_roughness[:levels]
        uniforms: dict[str, Any] = {
            "view__position": shot.view.position, "view__surface_y_m": shot.view.surface_y_m,
            "world_from_camera": shot.view.world_from_camera.T, "eye_m": shot.view.eye_m,
            "frame_size": (shot.view.width, shot.view.height),
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
        held = None if stack is None else cache.of(upload_stack, stack, self._caustic_scratch)
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


# A stack of caustic maps in textures for caustic_lookup.glsl: planes in channels, mip levels below each other.

_NEW_PLANES = 3
"""New planes per layer of the atlas, in channels 1 to 3; channel 0 repeats the last plane of the layer before.

Two neighbouring planes then always share a texel.
"""


@functools.cache
def layer_planes(count: int) -> NDArray[np.int64]:
    """Return the planes (layers, 1, 2 or 4) in the channels of each layer of `count` planes; the last is repeated."""
    first = np.arange(0, max(count - 1, 1), _NEW_PLANES)
    channels = count if count < _NEW_PLANES else _NEW_PLANES + 1
    return np.minimum(first[:, None] + np.arange(channels), count - 1)


def mip_atlas(*stacks: Sequence[Floats], scratch: NDArray[np.float32] | None = None) -> NDArray[np.float32]:
    """Return the levels (D, size, size, C) of stacks in the texture's layout, (layers C, 2 size + 2 levels, size + 2,
    1, 2 or 4).

    A pixel holds up to four planes, of one colour; colours follow each other as layers, and stacks after each other.
    The levels lie below each other, each with the pixels of its other side around it, so that one filtered fetch is
    right at its edges. They all lie in level 0 of the texture: drivers may take the level of a fetch from one pixel of
    each 2 x 2 block. scratch: an earlier atlas, written over if its shape fits: pages of new memory take longer to get
    than to fill.
    """
    count, size = stacks[0][0].shape[:2]
    planes, colours = layer_planes(count), 0
    for levels in stacks:
        colours += levels[0].shape[3]
    shape = (len(planes) * colours, 2 * size + 2 * len(stacks[0]), size + 2, planes.shape[1])
    atlas, first = (scratch if scratch is not None and scratch.shape == shape else np.zeros(shape, np.float32)), 0
    for levels in stacks:
        top, layers = 0, len(planes) * levels[0].shape[3]
        for level in levels:
            write_level(level, planes, atlas[first : first + layers], top)
            top += level.shape[1] + 2
        first += layers
    return atlas


@exact
def write_level(level: Floats, planes: NDArray[np.int64], atlas: NDArray[np.float32], top: int) -> None:
    """Write a level (D, side, side, C) with its border of one pixel into layers of an atlas, from row `top` on."""
    side, colours = level.shape[1], level.shape[3]
    for layer in range(planes.shape[0]):
        for colour in range(colours):
            for row in range(side + 2):
                j = side - 1 if row == 0 else row - 1 if row <= side else 0
                out = atlas[layer * colours + colour, top + row]
                for k in range(planes.shape[1]):
                    line = level[planes[layer, k], j]
                    for i in range(side):
                        out[i + 1, k] = line[i, colour]
                    out[0, k], out[side + 1, k] = out[side, k], out[1, k]


@dataclass(frozen=True, slots=True, weakref_slot=True, eq=False)
class StackTextures:
    """A `CausticStack` on the device. ratio: its `mip_atlas`. plane_depth: (1, steps, 2) of each interval between its
    planes: its depth, and one over its width (0 for one plane).
    """

    ratio: moderngl.TextureArray
    plane_depth: moderngl.Texture


class AtlasScratch:
    """Memory for the atlases of stacks, and textures of stacks that nobody holds any more, to be written over: getting
    pages of either takes the processor ten times as long as writing them.
    """

    def __init__(self) -> None:
        self.atlas: NDArray[np.float32] | None = None
        self.lent: list[tuple[weakref.ref[StackTextures], moderngl.TextureArray]] = []


def upload_stack(stack: CausticStack, scratch: AtlasScratch | None = None) -> StackTextures:
    """Return a stack's textures, with its mip levels. scratch: None takes new memory."""
    # One colour for all three where they are the same, and the light that has turned
    ratio = np.asarray(stack.ratio, np.float32)
    grey = ratio.strides[3] == 0 or bool(np.all(ratio[..., :1] == ratio[..., 1:]))
    stacks = [mip_levels(ratio[..., :1] if grey else ratio)]
    if stack.soft is not None:
        stacks.append(mip_levels(np.asarray(stack.soft, np.float32)))
    scratch = AtlasScratch() if scratch is None else scratch
    scratch.atlas = mip_atlas(*stacks, scratch=scratch.atlas)
    # Into a texture of the same size that nobody holds any more, or a new one
    layers, height, width, channels = scratch.atlas.shape
    lent, texture = scratch.lent, None
    scratch.lent = []
    for holder, free in lent:
        if holder() is not None:
            scratch.lent.append((holder, free))
        elif texture is None and (*free.size, free.components) == (width, height, layers, channels):
            texture = free
    if texture is None:
        texture = texture_array_from_array(scratch.atlas)
    else:
        texture.write(scratch.atlas, alignment=1)
    # graphics hardware filters with weights of 8 bits: an error of up to 1/512 of the difference of two pixels
    texture.filter = (moderngl.LINEAR, moderngl.LINEAR)
    depth = np.asarray(stack.depth_m, np.float64)
    inverse = 1.0 / np.diff(depth) if len(depth) > 1 else np.zeros(1)
    steps = np.stack([depth[: len(inverse)], inverse], axis=-1)[None].astype(np.float32)
    textures = StackTextures(texture, texture_from_array(steps))
    scratch.lent.append((weakref.ref(textures), texture))
    return textures
