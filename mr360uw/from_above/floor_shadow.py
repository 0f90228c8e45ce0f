# SPDX-License-Identifier: Apache-2.0
"""Shadows of bodies on the sea floor as a camera in the air sees them through the waves.

    ratio = 1 - E_sun/E (1 - v)

with E the floor's light, E_sun the part of it by the sun's beam with its caustics, and v the fraction of the sun that
bodies leave. Waves tilt the beam: v is the mean over a disc as wide as the sun and the slopes of the sea make it. The
ratio is that of the floor on the ray through a pixel's centre; it scales what the pixel shows of the floor.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.at_surface.image_reach import balls_around
from mr360uw.composite.raycast.geometry import gather
from mr360uw.composite.shot import PlacedObject
from mr360uw.from_above.first_surface import FloorSeen
from mr360uw.optics import refract_to_water
from mr360uw.rays import RayScene
from mr360uw.sphere import disc_directions
from mr360uw.surface import SeaScene
from mr360uw.surface.ray_stage import RayStage

Array = NDArray[np.float64]

_RAYS = 13
"""Directions over the disc."""


def ratio_on_floor(sea: SeaScene, stage: RayStage, placed: tuple[PlacedObject, ...], floor: FloorSeen) -> Array:
    """Return the floor's light with bodies over that without, (n, 3), in the floor's pixels."""
    ratio = np.ones((len(floor.place), 3))
    casters = tuple(one for one in placed if one.casts_shadow)
    if sea.sun is None or sea.sun.direction[1] <= 0.0 or not casters:
        return ratio
    direction = refract_to_water(sea.sun.direction, sea.refractive_index)
    half = _beam_half_angle(sea)
    at = np.flatnonzero(_in_reach(floor.place, direction, half, casters))
    if not len(at):
        return ratio
    scene = RayScene(gather(casters, np.zeros(3)).positions)
    rays = disc_directions(direction, half, _RAYS)
    hidden = np.zeros(len(at))
    for ray in rays:
        hidden += scene.first_hit(floor.place[at], np.broadcast_to(ray, (len(at), 3))) >= 0
    x, z, footprint = floor.place[at, 0], floor.place[at, 2], floor.footprint_m[at]
    beam = np.zeros((len(at), 3))
    for pattern, factor in stage.floor_light.patterns[stage.floor_light.skies :]:
        beam += factor * pattern.at(x, z, footprint)
    whole = stage.floor_light.irradiance(x, z, footprint)
    ratio[at] = 1.0 - beam / np.maximum(whole, 1e-30) * (hidden / len(rays))[:, None]
    return ratio


def _beam_half_angle(sea: SeaScene) -> float:
    """Return the angular radius [rad] of a disc with the variance of the beam's directions under the waves."""
    assert sea.sun is not None
    slope = math.sqrt(0.5 * (sea.sea.own_mean_square_slope + sea.sea.detail_rms_slope**2))
    tilt = 2.0 * (1.0 - 1.0 / sea.refractive_index) * slope  # twice the deviation: that of an even disc
    return min(math.hypot(sea.sun.half_angle_rad / sea.refractive_index, tilt), 0.5)


def _in_reach(place: Array, direction: Array, half: float, casters: tuple[PlacedObject, ...]) -> NDArray[np.bool_]:
    """Return which places (n, 3) may lie in the shadow of a body."""
    near = np.zeros(len(place), bool)
    for centre, radius in zip(*balls_around(casters), strict=True):
        to = centre - place
        along = to @ direction
        aside = np.linalg.norm(to - along[:, None] * direction, axis=-1)
        near |= (along > -radius) & (aside < radius + math.tan(half) * np.maximum(along, 0.0))
    return near
