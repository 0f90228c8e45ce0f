# SPDX-License-Identifier: Apache-2.0
"""What the rays of one picture can meet, and the arrays and numbers of it that compiled rays read.

Rays part at the surface: each hit sends one on by reflection and one by refraction, in water and in air.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.optics import refract_to_water
from mr360uw.surface.intersection import waves_of
from mr360uw.surface.sampled_sea import SampledSea
from mr360uw.surface.sea_floor import Floor, FloorLight
from mr360uw.surface.sky import Dome
from mr360uw.surface.tracing.facet_draws import Disc
from mr360uw.surface.tracing.floor_light import LitFloor, Relief
from mr360uw.surface.tracing.ray_kernel import Murk, RayWorld, Ripples
from mr360uw.surface.tracing.table_reads import WaterTable, packed
from mr360uw.surface.water_light import WaterLight
from mr360uw.types import Sun


@dataclass(frozen=True, slots=True, eq=False)
class RayStage:
    """What rays can meet. samples: rays of one pixel, which take different facets. floor_y_m: over the mean surface.
    camera_in_water: on which side of the waves the camera is. planes: depths of an uneven floor and the light there.
    """

    sea: SampledSea
    dome: Dome
    floor: Floor
    floor_y_m: float
    floor_light: FloorLight
    water: WaterLight
    sun: Sun | None
    refractive_index: float
    samples: int
    camera_in_water: bool
    planes: tuple[tuple[float, FloorLight], ...] = ()


def ray_world(stage: RayStage) -> RayWorld:
    """Return what compiled rays read of a stage."""
    disc, half_angle = disc_of(stage.sun)
    murk = _water(stage.water)
    texels, levels = packed([level[None] for level in stage.dome.levels])
    maps = stage.water.sun_maps
    if maps:
        first, size = len(texels), maps[0].shape[0] * maps[0].shape[1]
        murk = murk._replace(around=(first, first + size * (len(maps) - 1), maps[0].shape[1], maps[0].shape[0]))
        texels = np.concatenate([texels, *(around.reshape(-1, 3) for around in maps)])
    return RayWorld(
        waves_of(stage.sea), ripples_of(stage.sea), _ground(stage), disc, half_angle, stage.refractive_index,
        stage.samples, murk, texels, levels,
    )  # fmt: skip


def ripples_of(sea: SampledSea) -> Ripples:
    """Return the ripples of a sea, and the slopes that its splines lack."""
    detail, lost = sea.detail, sea.lost_slope
    if detail is None:
        none = np.zeros((1, 1, 2))
        return Ripples(sea.tile_m, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, sea.blur_variance, none, lost)
    (a, b), ((ax, az), (bx, bz)) = detail.repeats.tolist(), detail.offset.tolist()
    wave, variance, slopes = sea.ripple_wave, sea.ripple_variance, np.ascontiguousarray(detail.slopes)
    return Ripples(detail.tile_m, a, b, ax, az, bx, bz, wave, variance, sea.blur_variance, slopes, lost)


def _ground(stage: RayStage) -> LitFloor:
    floor, sea = stage.floor, stage.sea
    planes = [(depth, light.even, _merged(light)) for depth, light in stage.planes or ((1.0, stage.floor_light),)]
    pictures = [floor.image.levels, *(levels for _, _, patterns in planes for _, levels in patterns)]
    texels, table = packed([level for levels in pictures for level in levels])
    counts = np.array([len(levels) for levels in pictures])
    rows = np.stack([np.cumsum(counts) - counts, counts], axis=-1)
    even = np.array([[depth, *even, *(v for place, _ in patterns for v in place)] for depth, even, patterns in planes])
    dry, dry_sun = stage.floor_light.dry, stage.floor_light.dry_sun
    wet, air = (0.0, 1.0, 0.0), (0.0, 1.0, 0.0)
    if stage.sun is not None and stage.sun.direction[1] > 0.0:
        wet = tuple(refract_to_water(stage.sun.direction, stage.refractive_index).tolist())
        air = tuple(stage.sun.direction.tolist())
    below = _BELOW * (floor.highest_m - floor.lowest_m)
    relief = Relief(
        floor.tile_m, stage.floor_y_m, floor.lowest_m - below, floor.highest_m, floor.steepest, floor.relief,
        floor.cells,
    )  # fmt: skip
    sky, sun = tuple((dry - dry_sun).tolist()), tuple(dry_sun.tolist())
    return LitFloor(relief, floor.image.tile_m, sea.tile_m, sky, sun, wet, air, texels, table, rows, even)


def _merged(light: FloorLight) -> list[tuple[tuple[float, float, float], list[NDArray[Any]]]]:
    """Return origin, whether it is the sun's, and levels of the patterns times their factors; those of one place, kind
    and size are one."""
    sums: dict[tuple[float, float, float, int], list[NDArray[Any]]] = {}
    for k, (tiled, factor) in enumerate(light.patterns):
        lit = [level * factor for level in tiled.levels]
        key = (*tiled.origin, float(k >= light.skies), len(lit))
        sums[key] = [a + b for a, b in zip(sums[key], lit, strict=True)] if key in sums else lit
    return [(key[:3], levels) for key, levels in sums.items()]


def disc_of(sun: Sun | None) -> tuple[Disc, float]:
    """Return the sun and its angular radius."""
    if sun is None or sun.direction[1] <= 0.0:
        return Disc(0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0), 0.0
    solid_angle = 2.0 * math.pi * (1.0 - math.cos(sun.half_angle_rad))
    (x, y, z), (red, green, blue) = sun.direction.tolist(), (sun.irradiance / solid_angle).tolist()
    half = float(sun.half_angle_rad)
    return Disc(x, y, z, math.cos(half), solid_angle, red, green, blue), half


_BELOW = 1e-6
"""How far below an uneven floor the plane lies that all rays down have met it above, over the floor's height."""
_DRY = WaterTable(0, 1.0, 1.0)


def _water(water: WaterLight) -> Murk:
    if water.sky is None:
        nothing = np.zeros((1, 2, 2, 3), np.float32)
        return Murk(False, (_DRY, _DRY), (0, 0, 0, 0), nothing, nothing)
    tables = [water.table(from_camera) for from_camera in (False, True)]
    veils, attenuations = (
        np.stack([getattr(table, name) for table in tables]).astype(np.float32) for name in ("veil", "attenuation")
    )
    surface, camera = (WaterTable(k, float(t.length_m), float(t.camera_depth_m)) for k, t in enumerate(tables))
    return Murk(True, (surface, camera), (0, 0, 0, 0), veils, attenuations)
