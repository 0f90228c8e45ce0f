# SPDX-License-Identifier: Apache-2.0
"""Rectangles of the frame that bodies cover, disjoint tiles around them, and how these are laid over the plate.

The longitudes and latitudes of each triangle are bounded exactly: its edges are arcs of great circles that bulge
towards the poles, and a triangle over a pole takes all columns. Rectangles may cross the seam (column + width > W);
`split` cuts them there.

The rectangle of an eye beside the middle of a stereo camera is bounded by that seen from the middle.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.parameters import checked
from mr360uw.base.sphere import frame_from_direction
from mr360uw.base.tile_blend import blended
from mr360uw.composite.shot import PlacedObject, Shot
from mr360uw.errors import ParameterError
from mr360uw.types import Floats, Layer, Rectangle, Tile, View

_TILE_COST_PX = 4096
"""Fixed cost of one tile, in pixels that take as long. Twice as large: fewer tiles, with more untouched pixels."""


def object_rectangles(view: View, objects: Sequence[PlacedObject]) -> list[Rectangle]:
    """Return the frame's rectangle of every visible object, not yet split at the seam; all of it for no panorama."""
    size = view.width, view.height
    if view.projection != "equirectangular":
        return [Rectangle(0, 0, *size)]
    hulls = [placed.to_world(placed.mesh.hull) for placed in objects if placed.visible]
    seen, found = [(hull - view.position) @ view.world_from_camera for hull in hulls], []
    for body, whole in zip(seen, rectangles_of_bodies(seen, *size), strict=True):
        rectangle = seen_rectangle(whole, nearest_m(body), view.eye_m, *size) if view.eye_m else whole
        if rectangle.height > 0:
            found.append(rectangle)
    return found


def rectangles_of_bodies(bodies: Sequence[Floats], width: int, height: int, margin: int = 1) -> list[Rectangle]:
    """Return the rectangle of each body's triangles (T, 3, 3) seen from the origin, `margin` pixels wider."""
    if not bodies:
        return []
    begin = np.cumsum([0, *map(len, bodies)])[:-1]
    corners, begin, in_front = _outermost(np.concatenate(bodies), begin)
    latitudes, over_pole = _latitudes(corners)
    north = np.maximum.reduceat(latitudes.max(axis=1), begin)
    south = np.minimum.reduceat(latitudes.min(axis=1), begin)
    top = np.maximum(np.floor(height * (0.5 - north / np.pi)).astype(np.int64) - margin, 0)
    bottom = np.minimum(np.ceil(height * (0.5 - south / np.pi)).astype(np.int64) + margin, height)
    x, _ = frame_from_direction(corners, width, height)
    step = (np.diff(x, axis=1) + width / 2) % width - width / 2
    unwrapped = x[:, :1] + np.concatenate([np.zeros((len(x), 1)), np.cumsum(step, axis=1)], axis=1)
    left = np.floor(unwrapped.min(axis=1)).astype(np.int64) - margin
    right = np.ceil(unwrapped.max(axis=1)).astype(np.int64) + margin
    around = np.logical_or.reduceat(over_pole | (right - left >= width), begin)
    # bring the triangles of a body in front of the camera to the same turn as its first triangle
    turns = width * np.round((np.repeat(left[begin], np.diff(begin, append=len(left))) - left) / width).astype(np.int64)
    first, last = np.minimum.reduceat(left + turns, begin), np.maximum.reduceat(right + turns, begin)
    rectangles = []
    for k, start in enumerate(begin):
        if in_front[k]:
            columns = int(first[k]) % width, int(last[k] - first[k])
        elif around[k]:
            columns = 0, width
        else:
            part = slice(start, begin[k + 1] if k + 1 < len(begin) else None)
            columns = _covered(left[part], right[part], width)
        rectangles.append(Rectangle(columns[0], int(top[k]), columns[1], int(bottom[k] - top[k])))
    return rectangles


def _covered(left: NDArray[np.int64], right: NDArray[np.int64], width: int) -> tuple[int, int]:
    """Return (column, columns) of the shortest circular interval that contains the intervals [left, right)."""
    starts = np.bincount(left % width, minlength=2 * width + 1)
    ends = np.bincount(left % width + (right - left), minlength=2 * width + 1)
    running: NDArray[np.bool_] = np.cumsum((starts - ends)[:-1]) > 0
    return _interval(running[:width] | running[width:])


def places_in_mask(mask: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return rows and columns (n,) of the set pixels of a mask (h, w): `np.nonzero` takes four times as long."""
    row, column = np.divmod(np.flatnonzero(mask), mask.shape[1])
    return row, column


def rectangles_of_mask(mask: NDArray[np.bool_], spare: int) -> list[Rectangle]:
    """Return disjoint rectangles that cover the set pixels (h, w) of a frame, across the seam where that is shorter.

    The bounding rectangle is cut in two, recursively, wherever that leaves out at least `spare` pixels.
    """
    set_rows = np.flatnonzero(mask.any(axis=1))
    if len(set_rows) == 0:
        return []
    column, columns = _interval(np.asarray(mask.any(axis=0)))
    row, rows = int(set_rows[0]), int(set_rows[-1] - set_rows[0] + 1)
    window = np.roll(mask, -column, axis=1)[row : row + rows, :columns]
    parts = _cut(window, np.arange(columns + 1), np.arange(rows + 1), spare)
    return [Rectangle((column + c) % mask.shape[1], row + r, w, h) for c, r, w, h in parts]


def _cut(cells: NDArray[np.bool_], columns: NDArray[np.int64], rows: NDArray[np.int64], spare: int) -> list[Rectangle]:
    """Return rectangles that cover the set cells (h, w); columns (w + 1,) and rows (h + 1,) are the cells' edges.

    The bounding rectangle is cut in two, recursively, wherever that leaves out at least `spare` pixels.
    """
    high, wide = np.flatnonzero(cells.any(axis=1)), np.flatnonzero(cells.any(axis=0))
    if len(wide) == 0:
        return []
    (r0, r1), (c0, c1) = (high[0], high[-1] + 1), (wide[0], wide[-1] + 1)
    cells, columns, rows = cells[r0:r1, c0:c1], columns[c0 : c1 + 1], rows[r0 : r1 + 1]
    width, height = int(columns[-1] - columns[0]), int(rows[-1] - rows[0])
    whole = [Rectangle(int(columns[0]), int(rows[0]), width, height)]
    if width * height > spare and not cells.all():
        along_x, x = _best_cut(cells, columns, rows)
        along_y, y = _best_cut(cells.T, rows, columns)
        if min(along_x, along_y) <= width * height - spare:
            if along_x <= along_y:
                return _cut(cells[:, :x], columns[: x + 1], rows, spare) + _cut(cells[:, x:], columns[x:], rows, spare)
            return _cut(cells[:y], columns, rows[: y + 1], spare) + _cut(cells[y:], columns, rows[y:], spare)
    return whole


def _best_cut(cells: NDArray[np.bool_], columns: NDArray[np.int64], rows: NDArray[np.int64]) -> tuple[int, int]:
    """Return (area, column) of the cut before a column that gives two rectangles of the least total area.

    Cells (h, w) of the first and the last column are set. With a single column the area is that of all cells.
    """
    filled = cells.any(axis=0)
    top = np.where(filled, rows[np.argmax(cells, axis=0)], rows[-1])
    bottom = np.where(filled, rows[len(cells) - np.argmax(cells[::-1], axis=0)], rows[0])
    last = np.maximum.accumulate(np.where(filled, columns[1:], columns[0]))[:-1]
    first = np.minimum.accumulate(np.where(filled, columns[:-1], columns[-1])[::-1])[::-1][1:]
    left = (np.maximum.accumulate(bottom) - np.minimum.accumulate(top))[:-1] * (last - columns[0])
    right = (np.maximum.accumulate(bottom[::-1]) - np.minimum.accumulate(top[::-1]))[::-1][1:] * (columns[-1] - first)
    if len(left) == 0:
        return int((columns[-1] - columns[0]) * (rows[-1] - rows[0])), 0
    column = int(np.argmin(left + right))
    return int(left[column] + right[column]), column + 1


def split(rectangle: Rectangle, width: int) -> list[Rectangle]:
    """Return the rectangle cut at the seam."""
    column, row, columns, rows = rectangle
    if column + columns <= width:
        return [rectangle]
    return [Rectangle(column, row, width - column, rows), Rectangle(0, row, column + columns - width, rows)]


def even_tiles(rectangles: list[Rectangle], width: int, height: int) -> list[Rectangle]:
    """Return disjoint rectangles within the frame that cover the given ones and little more.

    Origins and sizes are even where the frame's size allows, so that no chroma sample of 4:2:0 video belongs to two.
    """
    whole: list[Rectangle] = []
    for rectangle in rectangles:
        whole += split(rectangle, width)
    parts = np.array(whole, np.int64).reshape(-1, 4)
    start = parts[:, :2] // 2 * 2
    end = np.minimum((parts[:, :2] + parts[:, 2:] + 1) // 2 * 2, (width, height))
    # cells between all their edges, far fewer than pixels
    columns, rows = np.unique([start[:, 0], end[:, 0]]), np.unique([start[:, 1], end[:, 1]])
    left, right = np.searchsorted(columns, start[:, 0]), np.searchsorted(columns, end[:, 0])
    top, bottom = np.searchsorted(rows, start[:, 1]), np.searchsorted(rows, end[:, 1])
    cells = np.zeros((max(len(rows) - 1, 0), max(len(columns) - 1, 0)), bool)
    for k in range(len(parts)):
        cells[top[k] : bottom[k], left[k] : right[k]] = True
    return _cut(cells, columns, rows, _TILE_COST_PX)


def _interval(touched: NDArray[np.bool_]) -> tuple[int, int]:
    """Return (start, length) of the shortest circular interval that contains every set entry."""
    width = len(touched)
    at = np.flatnonzero(touched)
    gap = np.diff(np.concatenate([at, [at[0] + width]])) - 1
    largest = int(np.argmax(gap))
    if gap[largest] == 0:
        return 0, width
    start = int(at[(largest + 1) % len(at)])
    return start, width - int(gap[largest])


def _outermost(corners: Floats, begin: NDArray[np.int64]) -> tuple[Floats, NDArray[np.int64], NDArray[np.bool_]]:
    """Return the triangles that may bound bodies' rectangles, the first of each body, and which bodies lie in front.

    A body lies in front if it is on one side of a vertical plane through the camera. Its extreme longitudes are then
    those of corners. Its extreme latitudes are on edges, which rise above their ends by less than a quarter of their
    squared length over the squared distance. Of other bodies all triangles are kept.
    """
    count = np.diff(begin, append=len(corners))
    place = np.ascontiguousarray(corners.T)  # (3 axes, 3 corners, T)
    x, y, z = place

    body = np.repeat(np.arange(len(begin)), count)  # of each triangle
    middle_x, middle_z = np.add.reduceat(x.sum(axis=0), begin)[body], np.add.reduceat(z.sum(axis=0), begin)[body]
    ahead = x * middle_x + z * middle_z
    nearest = np.minimum.reduceat(ahead.min(axis=0), begin)
    in_front = nearest[body] > 0.0
    beside = (x * middle_z - z * middle_x) / np.where(in_front, ahead, 1.0)
    sine = y / np.sqrt(np.maximum(x * x + y * y + z * z, 1e-60))
    extent = place.max(axis=1) - place.min(axis=1)
    distance = np.maximum(nearest, 1e-30)[body] ** 2 / np.maximum(middle_x**2 + middle_z**2, 1e-60)
    rise = 0.25 * np.sum(extent * extent, axis=0) / distance
    kept = ~in_front
    for values, slack in ((sine, rise), (beside, 0.0)):
        low, high = values.min(axis=0), values.max(axis=0)
        kept |= low - slack <= np.minimum.reduceat(low, begin)[body]
        kept |= high + slack >= np.maximum.reduceat(high, begin)[body]
    return corners[kept], np.cumsum(np.append(0, np.add.reduceat(kept, begin)))[:-1], nearest > 0.0


def _latitudes(corners: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Return latitudes (T, n) whose extremes bound each triangle, and whether it covers a pole (T,)."""
    unit = corners / np.maximum(np.linalg.norm(corners, axis=-1, keepdims=True), 1e-30)
    latitude = np.arcsin(np.clip(unit[..., 1], -1.0, 1.0))
    following = unit[:, [1, 2, 0]]
    normal = np.cross(unit, following)
    # the highest point of an edge's great circle, where the edge holds it: y without its part along the normal
    top = -normal * (normal[..., 1] / np.maximum(np.linalg.norm(normal, axis=-1), 1e-30) ** 2)[..., None]
    top[..., 1] += 1.0
    highest = np.arcsin(np.clip(np.linalg.norm(top, axis=-1), 0.0, 1.0))
    after = np.einsum("...k,...k", np.cross(unit, top), normal)
    before = np.einsum("...k,...k", np.cross(top, following), normal)
    north = np.where((after > 0.0) & (before > 0.0), highest, latitude)
    south = np.where((after < 0.0) & (before < 0.0), -highest, latitude)
    # the pole's ray is inside where it lies on one side of all three edges, and in front
    side = normal[..., 1]
    same = np.all(side >= 0.0, axis=1) | np.all(side <= 0.0, axis=1)
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    ahead = flat[:, 1] * np.einsum("tk,tk->t", corners[:, 0], flat)
    north_pole, south_pole = same & (ahead > 0.0), same & (ahead < 0.0)
    north[north_pole] = np.pi / 2
    south[south_pole] = -np.pi / 2
    return np.concatenate([latitude, north, south], axis=1), north_pole | south_pole


NEAREST = 2.0
"""Distance of a body, in radii of the viewing circle, below which it is taken to reach into any part of the frame."""


def seen_rectangle(rectangle: Rectangle, nearest_m: float, eye_m: float, width: int, height: int) -> Rectangle:
    """Return a rectangle of a width x height frame that holds what an eye sees of a body.

    rectangle: of the body seen from the middle. nearest_m: its least distance from there, or less.
    """
    if not eye_m:
        return rectangle
    ratio = abs(eye_m) / max(nearest_m, 1e-12)
    if ratio > 1.0 / NEAREST:
        return Rectangle(0, 0, width, height)
    beside = math.ceil(width * math.asin(ratio) / (2.0 * math.pi))
    # the sine of a latitude grows by up to 1/sqrt(1 - ratio^2), its cosine falls by up to 1/sqrt(1 + ratio^2)
    over = math.ceil(height * ratio * ratio / math.pi)
    column, row, columns, rows = rectangle
    top, bottom = max(row - over, 0), min(row + rows + over, height)
    columns = min(columns + beside, width)
    return Rectangle((column - (beside if eye_m > 0.0 else 0)) % width, top, columns, bottom - top)


def nearest_m(triangles: Floats) -> float:
    """Return a lower bound of the distance [m] of triangles (T, 3, 3) from the origin."""
    corner = np.sqrt(np.min(np.sum(np.square(triangles), axis=-1), axis=-1))
    edges = triangles - np.roll(triangles, 1, axis=1)
    longest = np.sqrt(np.max(np.sum(np.square(edges), axis=-1), axis=-1))
    normal = np.cross(edges[:, 0], edges[:, 1])
    plane = np.abs(np.sum(normal * triangles[:, 0], -1)) / np.maximum(np.linalg.norm(normal, axis=-1), 1e-30)
    # no point of a triangle is farther from its nearest corner than the circumradius of its longest edge
    return float(np.min(np.maximum(corner - longest / math.sqrt(3.0), plane), initial=np.inf))


# --- Tiles over the plate -------------------------------------------------------------------------------------------

# Composites a layer over the plate: differential rendering below water, then `over`.
#
# The formula stands in `tile_blend`. Holdout mattes keep parts of the plate in front of the objects.


def hold_out(shot: Shot, tile: Tile) -> Tile:
    """Return a tile with the shot's mattes applied to the objects and to the receiver's ratio.

    A distance matte hides the objects behind it. It leaves the receiver, whose distances are of the same surfaces.
    """
    if not shot.has_mattes:
        return tile
    kept = np.ones(tile.alpha.shape, np.float32)
    if shot.holdout is not None:
        kept -= np.clip(shot.holdout[tile.window], 0.0, 1.0).astype(np.float32)
    plate_kept = kept
    ratio = 1.0 + plate_kept[..., None] * (tile.ratio - 1.0)
    if shot.holdout_distance_m is not None:
        kept = kept * _not_behind(shot, tile, shot.holdout_distance_m)
    return replace(
        tile,
        radiance=tile.radiance * kept[..., None],
        alpha=tile.alpha * kept,
        distance_m=np.where(kept > 0.0, tile.distance_m, np.inf).astype(np.float32),
        ratio=ratio.astype(np.float32),
        shafts=None if tile.shafts is None else tile.shafts * plate_kept[..., None],
    )


def _not_behind(shot: Shot, tile: Tile, holdout_distance_m: Floats) -> NDArray[Any]:
    """Return the fraction (h, w) of a tile's objects that distances (H, W) [m] of the shot do not hide."""
    shown = tile.distance_m < holdout_distance_m[tile.window]
    if shot.holdout_beside is not None:
        beside_m, share = (values[tile.window] for values in shot.holdout_beside)
        return (np.float32(1.0) - share) * shown + share * (tile.distance_m < beside_m)
    return _softened(shown, np.isfinite(tile.distance_m)) if shot.holdout_soft else shown


def _softened(shown: NDArray[np.bool_], body: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return the fraction (h, w) of the pixels of objects that is shown, of each and its eight neighbours.

    body: pixels of objects; the others tell nothing of what is in front of these.
    """
    import cv2

    part, whole = (cv2.blur(one.astype(np.float32), (3, 3)) for one in (shown & body, body))
    return np.asarray(part / np.maximum(whole, np.float32(1.0 / 9.0)), np.float32)


@checked
def over_tile(plate_linear: Floats, tile: Tile) -> Floats:
    """Return the composite of the plate's pixels below one tile.

    Tiles cover what a layer changes: all other pixels stay the plate's. Where a tile changes nothing the plate is
    copied bit for bit.

    Parameters
    ----------
    plate_linear : ndarray
        The plate's pixels (h, w, 3) below the tile, linear.
    tile : Tile
        Of a layer.

    Returns
    -------
    ndarray
        Linear pixels (h, w, 3) in the plate's type.

    See Also
    --------
    uw.composite.render_layer : Makes the tiles.
    uw.types.Tile : Fields of a tile.
    uw.render_frame : Makes the whole picture.

    Notes
    -----
    L' = layer + (1 - alpha) (veil + (plate - veil) ratio + shafts): over of Porter & Duff 1984, the plate changed by
    differential rendering (Debevec 1998).

    Examples
    --------
    >>> result = uw.render_frame(plate, scene, backend="reference")
    >>> tile = result.layer.tiles[0]
    >>> uw.composite.over_tile(plate[tile.window], tile).shape == tile.radiance.shape
    True
    """
    return blended(plate_linear, tile)


def over(plate_linear: Floats, layer: Layer) -> Floats:
    """Return the composite (H, W, 3) of a linear plate and a layer; pixels outside the tiles are copied.

    Raises `ParameterError` where the sizes differ.
    """
    if plate_linear.shape != (layer.height, layer.width, 3):
        raise ParameterError(
            f"over - the plate must be as large as the layer (got {plate_linear.shape[:2]} and "
            f"{(layer.height, layer.width)}) - render the layer at the plate's size"
        )
    image = plate_linear.copy()
    for tile in layer.laid().tiles:
        image[tile.window] = blended(plate_linear[tile.window], tile)
    return image


def mean_layer(layers: Sequence[Layer]) -> Layer:
    """Return the mean of layers of one frame at several instants: motion blur by sub-frames.

    Radiance, alpha, ratio and shafts are averaged over all layers, the veil over those that change the pixel; the
    distance is the least.
    """
    height, width, layers = layers[0].height, layers[0].width, [layer.laid() for layer in layers]
    tiles = []
    for rectangle in even_tiles([t.rectangle for layer in layers for t in layer.tiles], width, height):
        stack = [tile_of(layer, rectangle) for layer in layers]
        changed = np.stack([np.any(t.ratio != 1.0, axis=-1) for t in stack])[..., None]
        veil = np.stack([t.veil for t in stack])
        filled = [t.shafts for t in stack if t.shafts is not None]
        mean = {name: np.mean([getattr(t, name) for t in stack], axis=0) for name in ("radiance", "alpha", "ratio")}
        mean["distance_m"] = np.min([t.distance_m for t in stack], axis=0)
        mean["veil"] = (np.where(changed, veil, 0.0).sum(0) / np.maximum(changed.sum(0), 1)).astype(np.float32)
        shafts = np.asarray(np.sum(filled, axis=0) / np.float32(len(stack))) if filled else None
        tiles.append(Tile(rectangle.column, rectangle.row, **mean, shafts=shafts))
    return Layer(height, width, tuple(tiles))


def tile_of(layer: Layer, part: Rectangle) -> Tile:
    """Return the part of a layer's tiles inside a rectangle as one tile, a copy; what none covers changes nothing."""
    column, row = part.column, part.row
    tile = empty_tile(part, bare=layer.ground is not None)
    names = ["radiance", "alpha", "distance_m", "shafts", *(["ratio", "veil"] if layer.ground is None else [])]
    if any(t.shafts is not None for t in layer.tiles):
        tile = replace(tile, shafts=np.zeros_like(tile.radiance))
    for t in layer.tiles:
        r0, c0 = max(t.row, row), max(t.column, column)
        r1 = min(t.row + t.alpha.shape[0], row + part.height)
        c1 = min(t.column + t.alpha.shape[1], column + part.width)
        if r0 >= r1 or c0 >= c1:
            continue
        here = slice(r0 - row, r1 - row), slice(c0 - column, c1 - column)
        there = slice(r0 - t.row, r1 - t.row), slice(c0 - t.column, c1 - t.column)
        for name in names:
            if (values := getattr(t, name)) is not None:
                getattr(tile, name)[here] = values[there]
    return tile


def empty_tile(part: Rectangle, *, bare: bool = False) -> Tile:
    """Return a tile that changes nothing, float32. bare: `Layer.ground` stands for its ratio and veil, which take no
    memory and cannot be written.
    """
    size = part.height, part.width
    radiance, alpha = np.zeros((*size, 3), np.float32), np.zeros(size, np.float32)
    ratio, veil = (np.broadcast_to(np.float32(value), (*size, 3)) for value in (1.0, 0.0))
    if not bare:
        ratio, veil = ratio.copy(), veil.copy()
    return Tile(part.column, part.row, radiance, alpha, np.full(size, np.inf, np.float32), ratio, veil)
