# SPDX-License-Identifier: Apache-2.0
"""Parts of the frame in which bodies and lamps can change the water before the plate.

The frame is divided into cells. Along the ray of each, segments are tested for whether the cone of the sun's disc, or
of the wider disc that turned light comes from, meets the ball around a body; balls are widened by half a segment and by
the cell. Of the beam's light scattered there at most all is taken away, or the fraction of the wider disc that the ball
covers. Lamps count as if nothing shaded them.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.lighting.surfaces import water_ahead
from mr360uw.composite.shot import Shot
from mr360uw.medium.shafts.occluders import bodies_of
from mr360uw.medium.shafts.ray_segments import radius_at
from mr360uw.medium.shafts.shaft_scene import ShaftScene
from mr360uw.sphere import effective_half_angle, unit

Array = NDArray[np.float64]

_ROWS = 64
"""Cells from pole to pole, 2.8 degrees each. Twice as many: fewer pixels for nothing, in four times the time."""
_SEGMENTS = 24
"""Segments of a cell's ray, of equal light."""


def shaft_pixels(shot: Shot, scene: ShaftScene, range_m: float, threshold: float) -> NDArray[np.bool_]:
    """Return the mask (H, W) of pixels over which the scene's light may deviate by `threshold` times the veil."""
    view = shot.view
    side = max(2 * -(-view.height // (2 * _ROWS)), 2)
    rows, columns = -(-view.height // side), -(-view.width // side)
    x, y = np.meshgrid((np.arange(columns) + 0.5) * side, (np.arange(rows) + 0.5) * side)
    directions = np.asarray(view.directions(x, np.minimum(y, view.height - 0.5)), np.float64).reshape(-1, 3)
    most = _most_change(scene, directions, range_m, np.pi * side / view.height)
    _, veil = water_ahead(shot, np.full(len(directions), range_m), directions[:, 1])
    marked = np.any((most > threshold * veil) & (most > 0.0), axis=-1).reshape(rows, columns)
    return np.repeat(np.repeat(marked, side, axis=0), side, axis=1)[: view.height, : view.width]


def _most_change(scene: ShaftScene, directions: Array, range_m: float, spacing_rad: float) -> Array:
    """Return a bound (n, 3) on the deviation along rays (n, 3) that stand for cells of an angular width."""
    rate, reach = (values[:, None] for values in scene.layout(directions[:, 1]))
    edge = radius_at(np.arange(_SEGMENTS + 1) / _SEGMENTS, rate, np.minimum(reach, range_m))
    most = np.zeros((len(directions), 3))
    if scene.pattern is not None and scene.bodies.occluders:
        most += _most_shade(scene, directions, edge, spacing_rad)
    if scene.lamps:
        lit = dataclasses.replace(scene, pattern=None, bodies=bodies_of(()))
        most += lit.segments(directions, edge).sum(axis=1)
    return most


def _most_shade(scene: ShaftScene, directions: Array, edge: Array, spacing_rad: float) -> Array:
    assert scene.pattern is not None
    sun, light = unit(scene.pattern.sun.direction), scene.water.averaged()
    whole, sharp = light.beam_segments(directions[:, 1], edge, scene.depth_m, scene.sun_up)
    middle, half = 0.5 * (edge[:, 1:] + edge[:, :-1]), 0.5 * np.diff(edge)
    disc = scene.pattern.sun.half_angle_rad
    halo = float(effective_half_angle(disc, scene.pattern.spread_rad))
    dark, dim = np.zeros(middle.shape), np.zeros(middle.shape)
    for centre, radius in zip(scene.bodies.centre, scene.bodies.radius, strict=True):
        away = centre - scene.origin - middle[..., None] * directions[:, None]
        wide = radius + half + spacing_rad * middle
        along = away @ sun
        beside = np.sqrt(np.maximum(np.sum(away * away, axis=-1) - along * along, 0.0))
        behind = np.maximum(along, 0.0)
        dark += (along > -wide) & (beside <= wide / np.cos(disc) + behind * np.tan(disc))
        covered = np.minimum(wide / np.maximum(behind * np.tan(halo), 1e-9), 1.0) ** 2
        dim += covered * ((along > -wide) & (beside <= wide / np.cos(halo) + behind * np.tan(halo)))
    turned = scene.water.turned(directions @ sun)
    taken = sharp * np.minimum(dark, 1.0)[..., None, None] + (whole - sharp) * np.minimum(dim, 1.0)[..., None, None]
    return np.asarray(np.einsum("nj,nkjc->nc", turned, taken) * scene.pattern.sun.irradiance)
