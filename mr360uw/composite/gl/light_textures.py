# SPDX-License-Identifier: Apache-2.0
"""Light of a shot on the device: textures and uniforms of environment, water, caustics, sun and lamps.

A grid over the space about the bodies lists which of them may occlude part of the sun from a place in each cell: a
place tests the few bodies of its cell instead of all. It is held to sun.glsl, which reads it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import Cache
from mr360uw.composite.gl.caustic_atlas import AtlasScratch, StackTextures, upload
from mr360uw.composite.gl.device import MeshBuffers, write_uniform
from mr360uw.composite.gl.shadow_atlas import ROW_TEXELS, LightFrame, ShadowAtlas, slot_size, translucent
from mr360uw.composite.lighting.light_sources import lamps_of, sun_of, sun_up, widest_half_angle
from mr360uw.composite.lighting.shadow import wide_pixel_offsets
from mr360uw.composite.mesh.mesh import Mesh
from mr360uw.composite.shot import PlacedObject, Shot
from mr360uw.constants import MAXIMUM_GLOSSY_LEVELS, MAXIMUM_SUN_RAYS, MAXIMUM_SUN_SAMPLES
from mr360uw.gl.context import set_uniforms, texture_array_from_array, texture_from_array
from mr360uw.medium.shafts.single_scattering import nearest_m
from mr360uw.sphere import basis, disc_offsets
from mr360uw.types import CausticStack, Environment, Floats, Lamp, MediumTable, Sun

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
    """The light of one shot on the device. textures, uniforms, arrays: by their names in shaders. defines: of these.
    caustics: of the shot, held as long as their textures are in use.
    """

    defines: dict[str, int]
    textures: dict[str, Any]
    uniforms: dict[str, Any]
    arrays: dict[str, Floats]
    caustics: StackTextures | None = None

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
        caustics = None if shot.caustics is None else self._cache.of(upload, shot.caustics, self._caustic_scratch)
        light = ShotLight(defines, textures, uniforms, {"glossy_roughness": roughness, "rays": rays}, caustics)
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
        if stack is None or light.caustics is None:
            light.textures.update(self._cache.of(_no_caustics))
            return
        light.uniforms.update({"stack__tile_m": stack.tile_m, "stack__sun_direction": stack.sun_direction})
        held = light.caustics
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


CELLS = (16, 16, 8)
"""Cells across, across and along the sun's direction: twice as many along each side take eight times the memory, 16 kB,
and save twenty small bodies less than a tenth of their tests."""
HALF_BITS = 15
"""Bodies are the bits of two whole numbers, which single floats hold exactly up to 24 bits."""
_ROW_TEXELS = 4
"""Texels of a row of the table that are used: powers of two divide by shifts."""
_BELOW = 0.5
"""How far the grid reaches below the bodies, over its extent across; everything lower counts as its lowest cells."""
_RADIUS = 0.25
"""Largest ball about a place for which a cell's list is enough, over the side of a cell."""
MAXIMUM_SLOTS = 2 * HALF_BITS
"""Most slots of the sun; the last holds all further bodies. The shader keeps slots as the bits of an integer."""
_STEPS = 64.0
"""Slots are drawn along the sun's direction rounded to 1/64 in each component, within 0.8 degrees of it, so that those
of bodies at rest stay valid while the sun's track moves a little. Twice as large: redrawn twice as often."""


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


def sun_frames(shot: Shot) -> list[LightFrame]:
    """Return the light frames of the sun, one for each body."""
    sun, casters = sun_of(shot), shot.casters
    if sun is None or not casters:
        return []
    axes, _ = _axes_and_slope(sun)
    groups: list[tuple[PlacedObject, ...]] = [(placed,) for placed in casters[: MAXIMUM_SLOTS - 1]]
    if len(casters) >= MAXIMUM_SLOTS:
        groups.append(casters[MAXIMUM_SLOTS - 1 :])
    return [LightFrame(group, axes) for group in groups]


def sun_uniforms(shot: Shot) -> dict[str, Any]:
    """Return the uniforms of `Sun` in sun.glsl."""
    sun = sun_of(shot)
    if sun is None:
        return {"sun__direction": (0.0, 1.0, 0.0), "sun__casters": 0}
    axes, slope = _axes_and_slope(sun)
    return {
        "sun__irradiance": sun.irradiance,
        "sun__direction": sun.direction,
        "sun__up": sun_up(sun),
        "sun__half_angle": sun.half_angle_rad,
        "sun__halo_angle": widest_half_angle(shot),
        "sun__axes": axes.T,
        "sun__slope": slope,
        "sun__casters": min(len(shot.casters), MAXIMUM_SLOTS),
    }


def sun_grid(shot: Shot, slots: Floats, first_row: int) -> tuple[dict[str, Any], Floats]:
    """Return the uniforms of the grid of bodies that may occlude the sun, and its rows (n, texels, 4) of `casters`.

    slots: table of the shadow atlas. first_row: of those rows.
    """
    sun = sun_of(shot)
    if sun is None or not shot.casters:
        return {}, np.zeros((0, *slots.shape[1:]))
    slots = slots[: min(len(shot.casters), MAXIMUM_SLOTS)]
    _, slope = _axes_and_slope(sun)
    spread = float(np.tan(widest_half_angle(shot)) + np.linalg.norm(slope))
    low, scale, radius_m, table = make_caster_grid(np.append(slots[:, 0], slots[:, 1, :2], axis=1), spread)
    rows = np.zeros((len(table), *slots.shape[1:]))
    rows[:, : table.shape[1]] = table
    uniforms = {
        "sun__grid_low": low,
        "sun__grid_scale": scale,
        "sun__grid_last": tuple(float(count - 1) for count in CELLS),
        "sun__grid_steps": (1.0, float(CELLS[0]), float(CELLS[0] * CELLS[1])),
        "sun__grid_radius": radius_m,
        "sun__grid_row": first_row,
    }
    return uniforms, rows


def _axes_and_slope(sun: Sun) -> tuple[Floats, Floats]:
    """Return the axes (3, 3) of the sun's slots, and the slope (2,) of its direction in them, across over along."""
    axes = basis(np.round(_STEPS * np.asarray(sun.direction)))
    across, along = (axes @ sun.direction)[:2], float(axes[2] @ sun.direction)
    return axes, across / along


def make_caster_grid(extents: Floats, spread: float) -> tuple[Floats, Floats, float, Floats]:
    """Return the grid of bodies, at most 2 `HALF_BITS`, in the sun's axes.

    Its corner (3,) [m], cells per metre (3,), the radius [m] of the largest ball about a place for which the lists
    hold, and the table (rows, 4, 4): two cells a texel, two numbers of `HALF_BITS` bits each.

    extents: (m, 6) of `LightFrame.extents` about the world's origin: centre across, half size across, ends along, two
    numbers each [m]. spread: tangent of the largest angle between the axis along and a ray towards the sun.
    """
    center, half, (bottom, top) = extents[:, :2], extents[:, 2:4], extents[:, 4:].T
    across = max(float(np.ptp(np.concatenate([center - half, center + half]), axis=0).max()), 1e-3)
    below = float(bottom.min()) - _BELOW * across
    wider = spread * (float(top.max()) - below)
    low = np.append((center - half).min(axis=0) - wider, below)
    high = np.append((center + half).max(axis=0) + wider, top.max())
    side = np.maximum((high - low) / CELLS, 1e-6)
    radius = _RADIUS * float(side.min())
    # the outermost cells hold everything beyond; rounding moves places by far less than the margin
    begins, ends = (_sides(low, side, shift) for shift in (0, 1))
    margin = 1.01 * radius
    height = np.maximum(top - begins[2][:, None] + margin, 0.0)
    reach = np.where(top - begins[2][:, None] + margin > 0.0, margin + spread * height, -np.inf)
    near: NDArray[np.bool_] = np.ones((*CELLS[::-1], len(extents)), np.bool_)
    for axis, shape in ((0, (1, 1, -1)), (1, (1, -1, 1))):
        apart = np.maximum(begins[axis][:, None] - center[:, axis], center[:, axis] - ends[axis][:, None])
        near &= (apart - half[:, axis]).reshape(*shape, len(extents)) <= reach[:, None, None]
    bits = np.zeros((near[..., 0].size, 2 * HALF_BITS))
    bits[:, : len(extents)] = near.reshape(-1, len(extents))
    halves = bits.reshape(-1, 2, HALF_BITS) @ np.exp2(np.arange(HALF_BITS))
    return low, 1.0 / side, radius, np.asarray(halves.reshape(-1, _ROW_TEXELS, 4))


def _sides(low: Floats, side: Floats, shift: int) -> list[Floats]:
    """Return where the cells of each axis begin (shift 0) or end (1), the outermost at infinity."""
    found = []
    for axis, count in enumerate(CELLS):
        places = low[axis] + side[axis] * (np.arange(count, dtype=np.float64) + shift)
        places[-1 if shift else 0] = np.inf if shift else -np.inf
        found.append(places)
    return found


_FARTHER = 1.25
"""Least distance of a body, in its radii, to fit one slot: it is then within 53 degrees of the slot's axis."""
_MOST_BODIES = 16
"""Most bodies with a slot of their own for a lamp; more share the six faces of a cube. Slots are bits of an integer."""
_FACES = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], np.float64)
_CORNER_RAD = float(np.arccos(3.0**-0.5))
"""Angle between the axis of a cube's face and its corners."""
_ROWS_OF_BEAM = 2
"""Rows of the texture `beam` before the lamps' attenuations: the sun's beam, and what of it has not turned."""


def lamp_frames(shot: Shot) -> list[list[LightFrame]]:
    """Return the light frames of each lamp: one for each body in its cone, or faces of a cube for bodies around it."""
    return [_frames(lamp, shot.casters) if lamp.casts_shadow else [] for lamp in lamps_of(shot)]


def _frames(lamp: Lamp, casters: tuple[PlacedObject, ...]) -> list[LightFrame]:
    alone: list[LightFrame] = []
    around: list[PlacedObject] = []
    for placed in casters:
        center = placed.to_world(placed.mesh.center_m) - lamp.position
        distance, radius = float(np.linalg.norm(center)), placed.mesh.radius_m * placed.scale
        if distance <= _FARTHER * radius:
            around.append(placed)
        elif _in_cone(lamp, center / distance, float(np.arcsin(radius / distance))):
            axes = basis(center)
            alone.append(LightFrame((placed,), axes, lamp.position, distance, nearest_m(lamp)))
    if len(alone) > _MOST_BODIES - len(_FACES) * bool(around):
        alone, around = [], list(casters)
    return alone + _faces(lamp, tuple(around))


def _faces(lamp: Lamp, bodies: tuple[PlacedObject, ...]) -> list[LightFrame]:
    """Return the faces of a cube around a lamp that its cone reaches."""
    if not bodies:
        return []
    centers = np.stack([placed.to_world(placed.mesh.center_m) for placed in bodies]) - lamp.position
    reach = np.linalg.norm(centers, axis=-1) + [placed.mesh.radius_m * placed.scale for placed in bodies]
    middle = 0.5 * max(float(reach.max()), 2.0 * nearest_m(lamp))
    return [
        LightFrame(bodies, basis(axis), lamp.position, middle, nearest_m(lamp), face=True)
        for axis in _FACES
        if _in_cone(lamp, axis, _CORNER_RAD)
    ]


def _in_cone(lamp: Lamp, direction: Floats, radius_rad: float) -> bool:
    """Return whether a disc about a unit direction, 1.5 times as wide as `radius_rad`, overlaps the lamp's cone."""
    if lamp.cos_edge <= -1.0:
        return True
    apart = float(np.arccos(np.clip(direction @ lamp.axis, -1.0, 1.0)))
    return apart <= float(np.arccos(lamp.cos_edge)) + 1.5 * radius_rad


def shadow_table(shot: Shot, of_atlas: Floats, frames: Sequence[LightFrame], first: list[int]) -> Floats:
    """Return the texture `casters` (rows, ROW_TEXELS, 4): the slots of an atlas, then the lamps.

    of_atlas: its table; frames: those of its slots. first: index of each lamp's first slot, and the end.
    """
    lamps = lamps_of(shot)
    table = np.zeros((len(of_atlas) + len(lamps), ROW_TEXELS, 4))
    table[: len(of_atlas)] = of_atlas
    for row, frame in zip(table, frames, strict=False):
        if frame.origin is not None:
            row[2:5, :3] = frame.axes
            row[2:5, 3] = frame.axes @ (shot.view.position - frame.origin)
            row[5, 0] = frame.middle_m
    for number, lamp in enumerate(lamps):
        at = _ROWS_OF_BEAM + number
        count = first[number + 1] - first[number]
        table[len(of_atlas) + number, :4] = (
            (*(lamp.position - shot.view.position), lamp.radius_m), (*lamp.axis, lamp.cos_core),
            (*lamp.intensity, lamp.cos_edge), (first[number], count, at, nearest_m(lamp)),
        )  # fmt: skip
    return table
