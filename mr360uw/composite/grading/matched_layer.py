# SPDX-License-Identifier: Apache-2.0
"""Gives the bodies of a layer the look of the plate: blur and unsharp mask of premultiplied radiance and coverage.

Shadows, caustics and shafts change the plate itself, which has its look already; they stay as they are.

    blur      C' = G C, a' = G a                       G: Gaussian, over the panorama's seam
    mask      C" = C' + k (C' - U C') + (a' - a) P     a = a' + k (a' - U a'), U: Gaussian of the mask

C" over a' is the masked composite where the plate P is smooth beside the body; only pixels of coverage change.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mr360uw.composite.grading.settings import PlateGrade, ceil_px
from mr360uw.composite.over import merge, tile_of
from mr360uw.types import Floats, Layer, Rectangle, Tile

Plate = Callable[[Rectangle], Floats]
"""Part of the plate, linear (h, w, 3)."""
_FAINTEST = 1e-4
"""Coverage below which the blur leaves none: a fiftieth of a code on white."""


def matched_layer(layer: Layer, grade: PlateGrade, plate: Plate) -> Layer:
    """Return a layer whose bodies have a look; the layer itself where the look changes nothing or there are no bodies.

    plate: gives the plate that the layer is laid over.
    """
    reach = grade.reach_px
    bodies = [tile for tile in layer.tiles if np.any(tile.alpha > 0.0)]
    if reach == 0 or not bodies:
        return layer
    grown = [part for tile in bodies for part in _grown(tile.rectangle, reach, layer)]
    parts = merge([*grown, *(tile.rectangle for tile in layer.tiles)])
    return replace(layer, tiles=tuple(_matched(layer, part, grade, plate) for part in parts))


def _matched(layer: Layer, part: Rectangle, grade: PlateGrade, plate: Plate) -> Tile:
    """Return one tile of the matched layer."""
    tile, reach = tile_of(layer, part), grade.reach_px
    around = _around(layer, part, reach)
    if not np.any(around[..., 3] > 0.0):
        return tile
    soft = _blurred(around, grade.softness_px)
    inside = slice(reach, reach + part.height), slice(reach, reach + part.width)
    inner = soft[inside]
    alpha = np.where(inner[..., 3] < _FAINTEST, 0.0, np.minimum(inner[..., 3], 1.0)).astype(np.float32)
    radiance = np.where(alpha[..., None] > 0.0, inner[..., :3], 0.0)
    if grade.sharpening > 0.0:
        masked = (soft + grade.sharpening * (soft - _blurred(soft, grade.sharpening_px)))[inside]
        shown = masked[..., :3] + (alpha - masked[..., 3])[..., None] * plate(part)
        least = -(1.0 - alpha)[..., None] * plate(part)  # no light is negative
        radiance = np.where(alpha[..., None] > 0.0, np.maximum(shown, least), radiance)
    return replace(tile, radiance=radiance.astype(np.float32), alpha=alpha)


def _grown(part: Rectangle, reach: int, layer: Layer) -> list[Rectangle]:
    """Return a rectangle grown on all sides, in pieces where it crosses the panorama's seam."""
    first, last = max(part.row - reach, 0), min(part.row + part.height + reach, layer.height)
    column, width = part.column - reach, part.width + 2 * reach
    if width >= layer.width:
        return [Rectangle(0, first, layer.width, last - first)]
    column %= layer.width
    here = min(width, layer.width - column)
    pieces = [(column, here), (0, width - here)]
    return [Rectangle(start, first, size, last - first) for start, size in pieces if size > 0]


def _around(layer: Layer, part: Rectangle, reach: int) -> Floats:
    """Return radiance and coverage (h + 2 reach, w + 2 reach, 4) about a rectangle; the edge rows are repeated."""
    first, last = max(part.row - reach, 0), min(part.row + part.height + reach, layer.height)
    pieces, column, left = [], part.column - reach, part.width + 2 * reach
    while left > 0:
        start = column % layer.width
        size = min(left, layer.width - start)
        tile = tile_of(layer, Rectangle(start, first, size, last - first))
        pieces.append(np.concatenate([tile.radiance, tile.alpha[..., None]], axis=-1))
        column, left = column + size, left - size
    found = np.concatenate(pieces, axis=1)
    lacks = first - (part.row - reach), part.row + part.height + reach - last
    return np.pad(found, (lacks, (0, 0), (0, 0)), mode="edge")


def _blurred(image: Floats, deviation_px: float) -> Floats:
    """Return a picture (h, w, 4) blurred by a Gaussian cut off at three standard deviations."""
    if deviation_px <= 0.0:
        return image
    import cv2

    size = 2 * ceil_px(deviation_px) + 1
    found: Floats = cv2.GaussianBlur(image, (size, size), deviation_px, borderType=cv2.BORDER_REPLICATE)
    return found
