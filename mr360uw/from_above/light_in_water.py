# SPDX-License-Identifier: Apache-2.0
"""Light just below a level surface as bodies in the water need it: one map of radiance, one table of the water.

Pictures of the sea keep the light of the sky and of the sun apart, each with tables of its own.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mr360uw.constants import PI
from mr360uw.ibl.lookup import environment_lookup
from mr360uw.ibl.plate import COARSE_COLUMNS, COARSE_ROWS
from mr360uw.medium.lookup import path_attenuation, veil_lookup
from mr360uw.medium.tabulate import STEP, lengths
from mr360uw.optics import radiance_factor, refract_to_air
from mr360uw.sphere import directions
from mr360uw.surface import SeaScene
from mr360uw.surface.sky import sun_below
from mr360uw.surface.water_light import WaterLight
from mr360uw.types import MediumTable

Array = NDArray[np.float64]


def joined_table(water: WaterLight) -> MediumTable:
    """Return the table for rays from the surface with the veil of sky and sun together, in absolute radiance."""
    assert water.sky is not None
    table = water.sky.from_surface
    up = np.linspace(-1.0, 1.0, table.veil.shape[0])[:, None]
    s = np.maximum(lengths(table.veil.shape[1], table.length_m), STEP * table.length_m)
    s = np.broadcast_to(s, table.veil.shape[:2])
    share = -np.expm1(-s / table.length_m)[..., None]
    # rays that leave the water are not asked for: the veil is that of level ones
    veil = water.sky.below * table.veil
    if water.sun is not None:
        sun = water.sun
        own = np.where((up > 0.0)[..., None], 0.0, veil_lookup(sun.from_surface, s, np.minimum(up, 0.0)) / share)
        veil = veil + sun.below * own
        depth = np.maximum(lengths(len(table.beam), table.length_m), STEP * table.length_m)
        beam, straight = (
            path_attenuation(sun.from_surface, values, depth, 1.0) / depth[:, None]
            for values in (sun.from_surface.beam, sun.from_surface.unscattered)
        )
        table = replace(table, beam=beam.astype(np.float32), unscattered=straight.astype(np.float32))
    return replace(table, veil=veil.astype(np.float32), plate_ratio=water.from_surface_around)


def light_below(sea: SeaScene, floor_depth_m: float) -> Array:
    """Return the radiance (128, 256, 3) just below a level surface by direction, without the sun's beam.

    From above: the sky through Snell's window, and outside of it the mirrored light from below. From below: the floor
    at its mean light, behind the water.
    """
    towards = directions(COARSE_COLUMNS, COARSE_ROWS)
    up = towards[..., 1]
    flat = np.minimum(up, -1e-3).ravel()
    passed, veil = sea.water.along(floor_depth_m / -flat, flat, from_camera=False)
    floor = sea.floor.mean_albedo / PI * _mean_light(sea, floor_depth_m)
    around = sea.water.from_surface_around
    if around is not None:
        veil = veil * environment_lookup(around, towards.reshape(-1, 3))
    below = (passed * floor + veil).reshape(towards.shape)
    window = up > np.sqrt(1.0 - 1.0 / sea.refractive_index**2)
    air = refract_to_air(np.where(window[..., None], towards, [0.0, 1.0, 0.0]), sea.refractive_index)
    factor = radiance_factor(np.clip(air[..., 1], 0.0, 1.0), sea.refractive_index)
    footprint = np.full(up.size, PI / COARSE_ROWS)
    sky = factor[..., None] * sea.dome.look(air.reshape(-1, 3), footprint).reshape(towards.shape)
    lost = np.where(window, 1.0 - factor / sea.refractive_index**2, 1.0)[..., None]
    above = np.where(window[..., None], sky, 0.0) + lost * below[::-1]
    return np.asarray(np.where(up[..., None] > 0.0, above, below))


def _mean_light(sea: SeaScene, depth_m: float) -> Array:
    """Return the irradiance (3,) of the floor under a level sea, without what the surface sends back."""
    parts = [light for light in (sea.water.sky, sea.water.sun) if light is not None]
    if parts:
        return np.asarray(sum((light.down(depth_m) for light in parts), np.zeros(3)))
    return np.asarray(sea.dome.irradiance_below(sea.refractive_index) + sun_below(sea.sun, sea.refractive_index))
