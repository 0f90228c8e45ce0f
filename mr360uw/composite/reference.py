# SPDX-License-Identifier: Apache-2.0
"""Reference renderer: the layer of a frame by ray casting in double precision, which the gl renderer is held to.

Every pixel sends the rays of its pattern; each group of its samples (`raycast.pixel_samples`) is shaded once.
Transparent surfaces form at most `BLEND_LAYERS` layers in front of the opaque one, nearest first, and the layers of a
pixel are composited by `over`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import Cache
from mr360uw.composite.ambient.solver import AmbientLight, ambient_at, ambient_light, free_of_bodies
from mr360uw.composite.aovs import AovFrame, Aovs
from mr360uw.composite.lighting.blockers import Blockers
from mr360uw.composite.lighting.lamps import light_sources
from mr360uw.composite.lighting.shadow import pixel_footprint
from mr360uw.composite.lighting.sun import LightSource
from mr360uw.composite.lighting.surfaces import surface_radiance, water_ahead
from mr360uw.composite.over import empty_tile, hold_out
from mr360uw.composite.raycast.geometry import Geometry, gather, object_rectangles
from mr360uw.composite.raycast.pixel_samples import group_samples, trace_samples
from mr360uw.composite.receiver.blocks import rectangles_of_blocks, touched_ground
from mr360uw.composite.receiver.ratio import receiver_ratio
from mr360uw.composite.receiver.shape import ReceiverShape
from mr360uw.composite.sampling import WHOLE_PIXEL, Gaps, find_gaps, join_gaps, pattern
from mr360uw.composite.shot import Shot
from mr360uw.composite.tiles import even_tiles, split
from mr360uw.rays import RayScene
from mr360uw.shapes import checked
from mr360uw.types import Layer, Rectangle, Tile

_RAYS_AT_ONCE = 200_000
"""Rays traced in one batch. It bounds the memory: twice as many take twice as much."""


@checked
def render_layer(shot: Shot, cache: Cache | None = None) -> Layer:
    """Return the layer of a shot, by the reference renderer.

    This renderer is float64 on the processor and defines what the OpenGL one must draw, which is faster. Nothing is
    measured here: light and water are those of the shot.

    Parameters
    ----------
    shot : Shot
        Everything that one frame shows: view, lights, water, objects, receiver.
    cache : Cache, optional
        Kept among shots.

    Returns
    -------
    Layer
        Tiles, float32, of everything that objects cover or change.

    See Also
    --------
    uw.render_frame : Makes the shot from a scene and a plate.
    uw.composite.Shot : The input.
    uw.composite.over_tile : Lays a tile over the plate.

    Examples
    --------
    >>> view, light = uw.types.View(64, 32), uw.ibl.environment(plate)
    >>> uw.composite.render_layer(uw.composite.Shot(view, (), light)).tiles
    ()
    """
    return _render(shot, None, cache or Cache())


def render_aovs(shot: Shot, cache: Cache | None = None) -> tuple[Layer, Aovs]:
    """Return the layer of a shot and its output variables."""
    frame = AovFrame(shot)
    layer = _render(shot, frame, cache or Cache())
    return layer, frame.finish(shot, layer)


def _render(shot: Shot, frame: AovFrame | None, cache: Cache) -> Layer:
    geometry = gather(shot.visible, shot.view.position)
    shape = ReceiverShape(shot.receiver, shot.view.position) if shot.receiver is not None else None
    object_parts = object_rectangles(shot.view, shot.objects)
    receiver_parts: list[Rectangle] = []
    touched = touched_ground(shot, cache)
    if touched is not None:
        receiver_parts = rectangles_of_blocks(touched.blocks, shot.view)
    tiles = even_tiles(object_parts + receiver_parts, shot.view.width, shot.view.height)
    if not tiles:
        return Layer(shot.view.height, shot.view.width, ())
    sources = light_sources(shot, Blockers(shot))
    scene = RayScene(geometry.positions)
    light = ambient_light(shot, cache)
    drawn = []
    for rectangle in tiles:
        tile = empty_tile(rectangle)
        gaps = draw_objects(
            shot, geometry, scene, sources, light, tile, _inside(object_parts, rectangle, shot.view.width), frame
        )
        if shape is not None:
            draw_receiver(shot, shape, sources, light, tile, _inside(receiver_parts, rectangle, shot.view.width), gaps)
        drawn.append(hold_out(shot, tile))
    return Layer(shot.view.height, shot.view.width, tuple(drawn))


def _inside(parts: list[Rectangle], tile: Rectangle, width: int) -> NDArray[np.bool_]:
    """Return the mask (h, w) of pixels of a tile that lie in one of the rectangles."""
    mask = np.zeros((tile[3], tile[2]), bool)
    for column, row, w, h in (piece for part in parts for piece in split(part, width)):
        c0, r0 = max(column - tile[0], 0), max(row - tile[1], 0)
        c1, r1 = column + w - tile[0], row + h - tile[1]
        if c1 > 0 and r1 > 0:
            mask[r0:r1, c0:c1] = True
    return mask


# --- objects -------------------------------------------------------------------------------------------------------


def draw_objects(
    shot: Shot,
    geometry: Geometry,
    scene: RayScene,
    sources: Sequence[LightSource],
    light: AmbientLight | None,
    tile: Tile,
    where: NDArray[np.bool_],
    frame: AovFrame | None,
) -> Gaps:
    """Composite the objects into the marked pixels (h, w) of a tile, and into a frame of output variables if given.

    Returns the uncovered parts of pixels that opaque surfaces cover partly.
    """
    gaps: list[Gaps] = []
    samples = pattern(shot.draw.samples)
    rows, columns = np.nonzero(where)
    step = max(_RAYS_AT_ONCE // samples.count, 1)
    opaque = np.array([m.alpha_mode != "BLEND" for m in geometry.materials])
    for first in range(0, len(rows), step):
        j, i = rows[first : first + step], columns[first : first + step]
        x, y = i + tile.column, j + tile.row
        radiance, alpha = np.zeros((len(i), 3)), np.zeros(len(i))
        distance = np.full(len(i), np.inf)
        layers = trace_samples(shot, geometry, scene, samples, x, y)
        gaps.append(find_gaps(samples, y, x, layers[-1][0] >= 0))
        for triangle, seen_m in layers:
            through = (1.0 - alpha).copy()
            for p, weight, hits in group_samples(shot, geometry, samples, x, y, triangle, seen_m):
                passed, veil = water_ahead(shot, hits.distance_m, hits.direction)
                sent, parts = surface_radiance(shot, sources, hits, ambient_at(shot, light, hits))
                cover = np.where(opaque[geometry.material[hits.triangle]], 1.0, hits.alpha)
                share = through[p] * weight * cover
                radiance[p] += share[:, None] * (passed * sent + veil)
                if frame is not None:
                    values: dict[str, Any] = {name: passed * part for name, part in parts.items()}
                    values |= {"veil": veil, "transmittance": passed, "normal": hits.normal}
                    values["position"] = hits.point + shot.view.position
                    frame.add((y[p], x[p]), share, values, hits.object)
                alpha[p] += share
                np.minimum.at(distance, p, hits.distance_m)
        tile.radiance[j, i], tile.alpha[j, i], tile.distance_m[j, i] = radiance, alpha, distance
    return join_gaps(gaps)


# --- receivers -----------------------------------------------------------------------------------------------------


def draw_receiver(
    shot: Shot,
    shape: ReceiverShape,
    sources: Sequence[LightSource],
    light: AmbientLight | None,
    tile: Tile,
    where: NDArray[np.bool_],
    gaps: Gaps,
) -> None:
    """Write the receiver's ratio and veil into the marked pixels (h, w) of a tile.

    Each pixel takes those at its centre, or in its gap: where bodies cover the centre the receiver is not visible.
    """
    assert shot.receiver is not None
    rows, columns = np.nonzero(where)
    if len(rows) == 0:
        return
    number = np.full(where.shape, -1)
    number[gaps.row - tile.row, gaps.column - tile.column] = np.arange(len(gaps.row))
    gap = number[rows, columns]
    place = np.stack([columns + tile.column, rows + tile.row], axis=-1) + 0.5
    place[gap >= 0] = gaps.place[gap[gap >= 0]]
    area = np.tile(WHOLE_PIXEL, (len(rows), 1))
    area[gap >= 0] = gaps.area[gap[gap >= 0]]
    distance, normal = shape.meet(shot, *place.T)
    hit = np.isfinite(distance)
    rows, columns, distance, normal, area = rows[hit], columns[hit], distance[hit], normal[hit], area[hit]
    x, y = place[hit].T
    direction = shot.view.directions(x, y)
    _, veil = water_ahead(shot, distance, direction)
    plate = None
    if shot.pattern is not None:
        shown, calm = (picture[rows, columns].astype(np.float64) for picture in shot.pattern.light(tile.rectangle))
        plate = shown, calm, veil
    point = shot.view.points(direction, distance)
    free = free_of_bodies(shot, light, point, normal, Cache())
    sides = pixel_footprint(shot.view, x, y, point, normal, area)
    ratio = receiver_ratio(shot, sources, free, point, normal, distance, plate, sides)
    changed = np.any(np.abs(ratio - 1.0) > 1e-4, axis=-1)
    tile.ratio[rows[changed], columns[changed]] = ratio[changed]
    tile.veil[rows[changed], columns[changed]] = veil[changed]
