# SPDX-License-Identifier: Apache-2.0
"""Parts of the frame in which bodies and lamps can change the water before the plate.

The frame is divided into cells. A ball of radius R around a body shades the points p from which a cone about the sun,
of half angle h, meets it. With a the ball's centre from the camera, l towards the sun, and a', v' the parts of a and of
the view direction v across l, these are on the ray s v between the roots of

    |a' - s v'|^2 = (R/cos h + w s + (a.l - s v.l) tan h)^2        where a.l - s v.l > -R        w: width of a cell

Of the sharp light, h is the sun's, and all of it is taken away there at most; of the light that has turned, h is that
of the wider disc that it comes from, and the fraction of it that the ball covers. Lamps count as if nothing shaded
them.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import Cache
from mr360uw.composite.lighting.surfaces import water_ahead
from mr360uw.composite.shot import PlacedObject, Shot
from mr360uw.medium.shafts.occluders import bodies_of
from mr360uw.medium.shafts.ray_segments import radius_at
from mr360uw.medium.shafts.shaft_scene import ShaftScene
from mr360uw.sphere import effective_half_angle, frame_from_direction, unit
from mr360uw.types import Lamp

Array = NDArray[np.float64]

_ROWS = 64
"""Cells from pole to pole, 2.8 degrees each. Twice as many: fewer pixels for nothing, in four times the time."""
_PARTS = 4
"""Parts of a ray behind a ball, each with the largest fraction of the wider disc that the ball covers from it."""
_HALVINGS = 4
"""Times that a mesh is halved, into 16 balls. None: a long body would shade as wide as it is long."""
_MESHES = 64
"""Meshes whose balls are kept."""
_CELLS = 3.0
"""Width of a lamp's cone, in cells, up to which cells are marked along its axis: it may pass between their centres."""
_AXIS = 128
"""Places on that axis."""
_SEGMENTS = 24
"""Segments of a cell's ray in the light of lamps."""
_ALONG = 1e-9
"""Least square of the sine of the angle between ray and cone at which a ray leaves the cone at all."""


def shaft_pixels(shot: Shot, scene: ShaftScene, range_m: float, threshold: float, kept: Cache) -> NDArray[np.bool_]:
    """Return the mask (H, W) of pixels over which the scene's light may deviate by `threshold` times the veil.

    kept: holds the balls around parts of meshes.
    """
    view = shot.view
    side = max(2 * -(-view.height // (2 * _ROWS)), 2)
    rows, columns = -(-view.height // side), -(-view.width // side)
    x, y = np.meshgrid((np.arange(columns) + 0.5) * side, (np.arange(rows) + 0.5) * side)
    directions = np.asarray(view.directions(x, np.minimum(y, view.height - 0.5)), np.float64).reshape(-1, 3)
    balls = np.concatenate([np.zeros((0, 4)), *(_balls(placed, kept) for placed in shot.casters)])
    most = _most_change(scene, balls, directions, range_m, np.pi * side / view.height)
    _, veil = water_ahead(shot, np.full(len(directions), range_m), directions[:, 1])
    marked = np.any((most > threshold * veil) & (most > 0.0), axis=-1).reshape(rows, columns)
    for lamp in scene.lamps:
        i, j = frame_from_direction(_near_lamp(scene, lamp, range_m) @ view.world_from_camera, view.width, view.height)
        marked[np.minimum(j // side, rows - 1).astype(np.int64), (i // side).astype(np.int64) % columns] = True
    if scene.lamps:
        marked = _with_neighbours(marked)
    return np.repeat(np.repeat(marked, side, axis=0), side, axis=1)[: view.height, : view.width]


def _near_lamp(scene: ShaftScene, lamp: Lamp, range_m: float) -> Array:
    """Return points (n, 3) [m] from the camera on the axis of a lamp's cone, up to where it is several cells wide."""
    away = np.asarray(lamp.position, np.float64) - scene.origin
    if lamp.cos_edge <= 0.0:
        return away[None]
    widening = np.sqrt(1.0 - lamp.cos_edge**2) / lamp.cos_edge
    length = min(_CELLS * np.pi / _ROWS * float(np.linalg.norm(away)) / max(widening, 1e-3), range_m)
    return np.asarray(away + length * np.linspace(0.0, 1.0, _AXIS)[:, None] * lamp.axis)


def _with_neighbours(cells: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return set cells (r, c) and those beside them, across the seam."""
    wide = cells | np.roll(cells, 1, axis=1) | np.roll(cells, -1, axis=1)
    tall = wide.copy()
    tall[1:] |= wide[:-1]
    tall[:-1] |= wide[1:]
    return tall


def _balls(placed: PlacedObject, kept: Cache) -> Array:
    """Return centres and radii (k, 4) [m] in the world of balls that hold a body's parts."""
    own = kept.get(
        "balls", placed.mesh, lambda: _balls_of(placed.mesh.positions.astype(np.float64), _HALVINGS), _MESHES
    )
    return np.concatenate([placed.to_world(own[:, :3]), placed.scale * own[:, 3:]], axis=1)


def _balls_of(triangles: Array, halvings: int) -> Array:
    """Return balls (k, 4) around triangles (T, 3, 3), halved along their longest side so many times."""
    points = triangles.reshape(-1, 3)
    low, high = points.min(axis=0), points.max(axis=0)
    if halvings and len(triangles) > 1:
        middle = triangles.mean(axis=1)[:, int(np.argmax(high - low))]
        order = np.argpartition(middle, len(middle) // 2)
        halves = np.split(triangles[order], [len(middle) // 2])
        return np.concatenate([_balls_of(half, halvings - 1) for half in halves])
    centre = 0.5 * (low + high)
    return np.append(centre, np.linalg.norm(points - centre, axis=-1).max())[None]


def _most_change(scene: ShaftScene, balls: Array, directions: Array, range_m: float, spacing_rad: float) -> Array:
    """Return a bound (n, 3) on the deviation along rays (n, 3) that stand for cells of an angular width."""
    rate, reach = scene.layout(directions[:, 1])
    reach = np.minimum(reach, range_m)
    most = np.zeros((len(directions), 3))
    if scene.pattern is not None:
        most += _most_shade(scene, balls, directions, reach, spacing_rad)
    if scene.lamps:
        lit = dataclasses.replace(scene, pattern=None, bodies=bodies_of(()))
        edge = radius_at(np.arange(_SEGMENTS + 1) / _SEGMENTS, rate[:, None], reach[:, None])
        most += lit.segments(directions, edge).sum(axis=1)
    return most


def _most_shade(scene: ShaftScene, balls: Array, directions: Array, reach: Array, spacing_rad: float) -> Array:
    """Return a bound (n, 3) on the light that bodies take away."""
    assert scene.pattern is not None
    sun, light = unit(scene.pattern.sun.direction), scene.water.averaged()
    disc = scene.pattern.sun.half_angle_rad
    halo = float(effective_half_angle(disc, scene.pattern.spread_rad))
    taken = np.zeros((len(directions), 2, 3))
    for centre, radius in zip(balls[:, :3] - scene.origin, balls[:, 3].tolist(), strict=True):
        edge = _shaded(centre, radius, sun, directions, reach, spacing_rad, disc, 1)
        taken += light.beam_segments(directions[:, 1], edge, scene.depth_m, scene.sun_up)[1][:, 0]
        edge = _shaded(centre, radius, sun, directions, reach, spacing_rad, halo, _PARTS)
        whole, sharp = light.beam_segments(directions[:, 1], edge, scene.depth_m, scene.sun_up)
        behind = centre @ sun - edge * (directions @ sun)[:, None]
        ball = radius + spacing_rad * edge[:, 1:]
        least = np.maximum(np.minimum(behind[:, 1:], behind[:, :-1]), 0.0) * np.tan(halo)
        covered = np.minimum(ball / np.maximum(least, 1e-9), 1.0) ** 2
        taken += np.sum((whole - sharp) * covered[..., None, None], axis=1)
    turned = scene.water.turned(directions @ sun)
    return np.asarray(np.einsum("nj,njc->nc", turned, taken) * scene.pattern.sun.irradiance)


def _shaded(
    centre: Array,
    radius: float,
    sun: Array,
    directions: Array,
    reach: Array,
    spacing_rad: float,
    angle: float,
    parts: int,
) -> Array:
    """Return edges (n, parts + 1) [m] of even parts of rays (n, 3) in the shadow cone of a ball; all equal for none.

    centre: (3,) of the ball from the camera. reach: (n,) [m] of the rays. angle: half angle of the cone.
    """
    up, ball = directions @ sun, radius / np.cos(angle)
    across, aside = directions - up[:, None] * sun, centre - centre @ sun * sun
    first, growth = ball + centre @ sun * np.tan(angle), spacing_rad - up * np.tan(angle)
    square = np.sum(across * across, axis=-1) - growth * growth
    half = across @ aside + first * growth
    root = half * half - square * (aside @ aside - first * first)
    inside = square < _ALONG  # along the cone: all of the ray may be in it
    width = np.sqrt(np.maximum(root, 0.0))
    divisor = np.where(inside, 1.0, square)
    start = np.where(inside, 0.0, (half - width) / divisor)
    end = np.where(inside, reach, (half + width) / divisor)
    # points farther towards the sun than the ball are not behind it
    leaves = (centre @ sun + ball + spacing_rad * reach) / np.where(np.abs(up) > _ALONG, up, _ALONG)
    end = np.where(up > 0.0, np.minimum(end, leaves), end)
    start = np.where(up < 0.0, np.maximum(start, leaves), start)
    start, end = np.clip(start, 0.0, reach), np.clip(end, 0.0, reach)
    length = np.where(inside | (root > 0.0), np.maximum(end - start, 0.0), 0.0)
    return start[:, None] + length[:, None] * (np.arange(parts + 1) / parts)
