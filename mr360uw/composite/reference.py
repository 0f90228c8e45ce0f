# SPDX-License-Identifier: Apache-2.0
"""Reference renderer: the layer of a frame by ray casting in double precision, which the gl renderer is held to.

Every pixel sends the rays of its pattern; each group of its samples is shaded once. Transparent surfaces form at most
`BLEND_LAYERS` layers in front of the opaque one, nearest first, and the layers of a pixel are composited by `over`.

A group holds the samples of one pixel that hit the same smooth piece of surface near the plane of the first of them. It
is shaded once, at the sample nearest to its mean; `shading = "sample"` makes every sample a group of its own.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.cache import Cache
from mr360uw.base.parameters import checked
from mr360uw.composite.ambient.solver import AmbientLight, ambient_at, ambient_light, free_of_bodies
from mr360uw.composite.aovs import AovFrame, Aovs
from mr360uw.composite.light_sources import Blockers, LightSource, light_sources
from mr360uw.composite.raycast import (
    MAXIMUM_HITS,
    Geometry,
    Hits,
    gather,
    next_surfaces,
    pixel_footprint,
    surface,
    uv_change,
    weights_beside,
)
from mr360uw.composite.receiver.blocks import rectangles_of_blocks, touched_ground
from mr360uw.composite.receiver.ratio import receiver_ratio
from mr360uw.composite.receiver.shape import ReceiverShape
from mr360uw.composite.sampling import (
    BLEND_LAYERS,
    GROUPS,
    PIXEL_FILTER,
    PLANE_TOLERANCE,
    WHOLE_PIXEL,
    Gaps,
    Pattern,
    filter_width,
    find_gaps,
    frame_areas,
    join_gaps,
    nearest_to_mean,
    pattern,
)
from mr360uw.composite.shading import surface_radiance, water_ahead
from mr360uw.composite.shot import Shot
from mr360uw.composite.tiles import empty_tile, even_tiles, hold_out, object_rectangles, split
from mr360uw.types import Floats, Layer, Rectangle, Tile

_RAYS_AT_ONCE = 200_000
"""Rays traced in one batch. It bounds the memory: twice as many take twice as much."""
_Lit = tuple[Shot, Sequence[LightSource], AmbientLight | None]
"""A shot, its lights, and the solved ambient light among its bodies."""
_Seen = tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], Floats]
"""Columns and rows (n,) of pixels; triangles and distances (n, s) [m] that their samples show, -1 for none."""


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
        receiver_parts = rectangles_of_blocks(touched[1], shot.view)
    tiles = even_tiles(object_parts + receiver_parts, shot.view.width, shot.view.height)
    if not tiles:
        return Layer(shot.view.height, shot.view.width, ())
    lit, drawn = (shot, light_sources(shot, Blockers(shot)), ambient_light(shot, cache)), []
    for rectangle in tiles:
        tile = empty_tile(rectangle)
        gaps = draw_objects(lit, geometry, tile, _inside(object_parts, rectangle, shot.view.width), frame)
        if shape is not None:
            draw_receiver(lit, shape, tile, _inside(receiver_parts, rectangle, shot.view.width), gaps)
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


def draw_objects(lit: _Lit, geometry: Geometry, tile: Tile, where: NDArray[np.bool_], frame: AovFrame | None) -> Gaps:
    """Composite the objects into the marked pixels (h, w) of a tile, and into a frame of output variables if given.

    Returns the uncovered parts of pixels that opaque surfaces cover partly.
    """
    # Trace the samples of so many pixels at once as fit in memory
    (shot, sources, light), gaps = lit, list[Gaps]()
    samples = pattern(shot.draw.samples)
    rows, columns = np.nonzero(where)
    step = max(_RAYS_AT_ONCE // samples.count, 1)
    opaque = np.array([m.alpha_mode != "BLEND" for m in geometry.materials])
    for first in range(0, len(rows), step):
        j, i = rows[first : first + step], columns[first : first + step]
        x, y = i + tile.column, j + tile.row
        radiance, alpha = np.zeros((len(i), 3)), np.zeros(len(i))
        distance = np.full(len(i), np.inf)
        layers = trace_samples(shot, geometry, samples, x, y)
        gaps.append(find_gaps(samples, y, x, layers[-1][0] >= 0))
        # Lay what is blended over the opaque, the nearest first, each shaded once a group
        for triangle, seen_m in layers:
            through = (1.0 - alpha).copy()
            for p, weight, hits in group_samples(shot, geometry, samples, (x, y, triangle, seen_m)):
                passed, veil = water_ahead(shot, hits.distance_m, hits.direction)
                sent, parts = surface_radiance(shot, sources, hits, ambient_at(shot, light, hits))
                cover = np.where(opaque[geometry.material[hits.triangle]], 1.0, hits.alpha)
                share = through[p] * weight * cover
                radiance[p] += share[:, None] * (passed * sent + veil)
                if frame is not None:
                    values: dict[str, Any] = {name: passed * part for name, part in parts.items()}
                    values |= {"veil": veil, "transmittance": passed, "normal": hits.normal}
                    values["position"] = hits.point + shot.view.position
                    frame.add((y[p], x[p]), share, values, hits.triangle)
                alpha[p] += share
                np.minimum.at(distance, p, hits.distance_m)
        tile.radiance[j, i], tile.alpha[j, i], tile.distance_m[j, i] = radiance, alpha, distance
    return join_gaps(*gaps)


# --- receivers -----------------------------------------------------------------------------------------------------


def draw_receiver(lit: _Lit, shape: ReceiverShape, tile: Tile, where: NDArray[np.bool_], gaps: Gaps) -> None:
    """Write the receiver's ratio and veil into the marked pixels (h, w) of a tile.

    Each pixel takes those at its centre, or in its gap: where bodies cover the centre the receiver is not visible.
    """
    # Take the centre of each pixel, or its gap beside bodies
    shot, sources, light = lit
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
    # Meet the receiver there
    distance, normal = shape.meet(shot.view, *place.T)
    hit = np.isfinite(distance)
    rows, columns, distance, normal, area = rows[hit], columns[hit], distance[hit], normal[hit], area[hit]
    x, y = place[hit].T
    direction = shot.view.directions(x, y)
    # Look up the veil, and what the plate shows of its own waves
    _, veil = water_ahead(shot, distance, direction)
    plate = None
    if shot.pattern is not None:
        shown, calm = (picture[rows, columns].astype(np.float64) for picture in shot.pattern.light(tile.rectangle))
        plate = shown, calm, veil
    # Divide the light with bodies by that without them, and write where it differs
    point = shot.view.points(direction, distance)
    free = free_of_bodies(shot, light, point, normal)
    sides = pixel_footprint(shot.view, x, y, point, normal, area)
    ratio = receiver_ratio(shot, sources, free, point, normal, distance, plate, sides)
    changed = np.any(np.abs(ratio - 1.0) > 1e-4, axis=-1)
    tile.ratio[rows[changed], columns[changed]] = ratio[changed]
    tile.veil[rows[changed], columns[changed]] = veil[changed]


def trace_samples(
    shot: Shot, geometry: Geometry, samples: Pattern, x: NDArray[np.int64], y: NDArray[np.int64]
) -> list[tuple[NDArray[np.int64], Floats]]:
    """Return layers (triangle (n, s), distance (n, s) [m]) hit by the samples of pixels; triangle -1 for no hit.

    x, y: (n,) columns and rows of the pixels. Layers of blended surfaces come first, the nearest first; the last layer
    holds the opaque surfaces, even if there are none. Rays pass through masked-out texels and back faces of one-sided
    materials.
    """
    # Aim a ray at each sample
    count, n = len(x), samples.count
    fx = (x[:, None] + samples.positions[None, :, 0]).ravel()
    fy = (y[:, None] + samples.positions[None, :, 1]).ravel()
    direction = shot.view.directions(fx, fy)
    from_middle = shot.view.starts(direction)
    layers = [np.full(count * n, -1, np.int64) for _ in range(BLEND_LAYERS + 1)]
    distances = [np.full(count * n, np.inf) for _ in range(BLEND_LAYERS + 1)]
    filled = np.zeros(count * n, np.int64)
    blends = np.array([m.alpha_mode == "BLEND" for m in geometry.materials], np.bool_)
    active, behind_m = np.arange(count * n), np.zeros(count * n)
    pixel = n**-0.5

    def change_of(ray: NDArray[np.int64], corners: Floats, triangle: NDArray[np.int64], weights: Floats) -> Floats:
        """Return the change of (u, v) over the width of a sample at which masks are read."""
        x, y = fx[ray], fy[ray]
        around = np.stack([shot.view.directions(x + pixel, y), shot.view.directions(x, y + pixel)], axis=1)
        return uv_change(geometry.uv[triangle], weights, weights_beside(corners, around))

    # Follow the rays from hit to hit, until all end on what is opaque
    for _ in range(MAXIMUM_HITS):
        rays = from_middle, direction
        active, triangle, distance, solid = next_surfaces(geometry, rays, active, behind_m, change_of)
        if len(active) == 0:
            break
        # Write what is blended to the next free layer, what is opaque to the last
        blended = solid & blends[geometry.material[triangle]]
        for k in range(BLEND_LAYERS):
            to = blended & (filled[active] == k)
            layers[k][active[to]], distances[k][active[to]] = triangle[to], distance[to]
        filled[active[blended]] += 1
        opaque = solid & ~blended
        layers[-1][active[opaque]], distances[-1][active[opaque]] = triangle[opaque], distance[opaque]
        active = active[~opaque]
    found = [(t.reshape(count, n), d.reshape(count, n)) for t, d in zip(layers, distances, strict=True)]
    return [layer for layer in found[:-1] if np.any(layer[0] >= 0)] + found[-1:]


def group_samples(
    shot: Shot, geometry: Geometry, samples: Pattern, seen: _Seen
) -> Iterator[tuple[NDArray[np.int64], Floats, Hits]]:
    """Yield (pixels (n,), fraction of their samples (n,), surface at the representative sample) until none is left.

    A group starts at the ungrouped sample nearest to the pixel's centre. The last of `GROUPS` takes all that are left.
    The representative is the sample nearest to the mean position of its group.
    """
    # Group until no sample is left, or shade each by itself
    view, width = shot.view, filter_width(samples.count, shot.draw.shading)
    left = seen[2] >= 0
    rounds = samples.count if shot.draw.shading == "sample" else GROUPS
    for number in range(rounds):
        pixel = np.flatnonzero(left.any(axis=1))
        if len(pixel) == 0:
            return
        # Gather what lies near the plane of the first sample that is left, in the last round all
        of_pixels = x, y, triangle, _ = seen[0][pixel], seen[1][pixel], seen[2][pixel], seen[3][pixel]
        every, chosen = np.arange(len(pixel)), np.argmax(left[pixel], axis=1)
        member = left[pixel] & (shot.draw.shading == "pixel")
        if shot.draw.shading == "pixel" and number < rounds - 1:
            member &= _near_plane(shot, geometry, samples, of_pixels, chosen)
        member[every, chosen] = True
        left[pixel] &= ~member
        # Let the sample nearest to the middle stand for all
        middle = nearest_to_mean(samples.cells, member, member)
        column, row = x + samples.positions[middle, 0], y + samples.positions[middle, 1]
        direction = view.directions(column, row)
        beside = np.stack([view.directions(column + width, row), view.directions(column, row + width)], axis=1)
        rays, area = (view.starts(direction), direction, beside), frame_areas(samples.positions, member, middle)
        yield pixel, member.mean(axis=1), surface(geometry, triangle[every, middle], rays, area, width, view.height)


def _near_plane(
    shot: Shot, geometry: Geometry, samples: Pattern, seen: _Seen, chosen: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Return the mask (n, s) of samples that hit the chosen sample's smooth piece, near its triangle's plane."""
    x, y, triangle, distance = seen
    rows = np.arange(len(chosen))
    first = triangle[rows, chosen]
    corners = geometry.positions[first]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    fx, fy = x[:, None] + samples.positions[:, 0], y[:, None] + samples.positions[:, 1]
    point = shot.view.points(shot.view.directions(fx, fy), np.where(triangle >= 0, distance, 0.0))
    off = np.einsum("nsk,nk->ns", point - corners[:, :1], normal)
    tolerance = PLANE_TOLERANCE * PIXEL_FILTER * np.pi / shot.view.height * distance[rows, chosen]
    same = geometry.patch[triangle] == geometry.patch[first][:, None]
    return same & (np.abs(off) <= tolerance[:, None])
