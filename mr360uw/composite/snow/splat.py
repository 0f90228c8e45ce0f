# SPDX-License-Identifier: Apache-2.0
"""Draws particles into an equirectangular frame: discs of confusion, drawn out by motion, of exact solid angle.

A particle covers the pixels about the arc from where it is when the shutter opens to where it is when it closes. With r
the distance [rad] of a pixel's centre from that arc, R the radius of the disc and h half a pixel's height,

    f = clamp((R + h - r)/(2 h), 0, 1)        coverage = f omega/sum(f Omega)

Omega is a pixel's solid angle and omega the particle's, so its light is the same however it is blurred, wherever it is.
R is at least `LEAST_RADIUS` pixels. Distances are chords between unit vectors, so poles and seam are like any place.
Particles are composited by `over`, the farthest first: before bodies into one picture, behind them into another. The
pictures are laid over and under the tiles of a layer, and fill the rest of the frame with tiles of snow.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from mr360uw.cache import Cache
from mr360uw.composite.over import empty_tile
from mr360uw.composite.shot import Shot
from mr360uw.jit import exact
from mr360uw.sphere import row_solid_angle
from mr360uw.types import Floats, Layer, Rectangle, Tile, View


def merged(shot: Shot, layer: Layer, before: Picture, behind: Picture, cache: Cache) -> Layer:
    """Return a layer with snow before its bodies and behind them; pictures are used up. cache: what frames share.

    Mattes without distances hide snow as they hide bodies, of which they know no more.
    """
    if shot.holdout is not None:
        left = (1.0 - np.clip(shot.holdout, 0.0, 1.0)).astype(np.float32)
        for radiance, alpha in (before, behind):
            radiance[...] *= left[..., None]
            alpha[...] *= left
    # Lay it over and under the bodies of tiles
    tiles = []
    for tile in layer.tiles:
        radiance, alpha = np.empty(tile.radiance.shape, np.float32), np.empty(tile.alpha.shape, np.float32)
        front, back = ((image[tile.window], covered[tile.window]) for image, covered in (before, behind))
        _lay(front, (tile.radiance, tile.alpha), back, (radiance, alpha))
        tiles.append(replace(tile, radiance=radiance, alpha=alpha))
    # Fill the rest of the frame with tiles of snow
    whole = Rectangle(0, 0, layer.width, layer.height)
    blank = cache.of(_blank, whole)
    for part in rest_of([tile.rectangle for tile in layer.tiles], layer.width, layer.height):
        at = slice(part.row, part.row + part.height), slice(part.column, part.column + part.width)
        alpha = before[1][at]
        if np.any(alpha):
            clear = blank.distance_m[at], blank.ratio[at], blank.veil[at]
            tiles.append(Tile(part.column, part.row, before[0][at], alpha, *clear))
    return Layer(layer.height, layer.width, tuple(tiles))


def _blank(whole: Rectangle) -> Tile:
    tile = empty_tile(whole)
    for values in (tile.distance_m, tile.ratio, tile.veil):
        values.flags.writeable = False
    return tile


def rest_of(parts: Sequence[Rectangle], width: int, height: int) -> list[Rectangle]:
    """Return disjoint rectangles of all pixels of a frame that are outside of some, which do not cross the seam."""
    edges = sorted({0, height, *(p.row for p in parts), *(p.row + p.height for p in parts)})
    rest = []
    for top, bottom in itertools.pairwise(edges):
        column = 0
        for p in sorted(p for p in parts if p.row <= top and bottom <= p.row + p.height):
            if p.column > column:
                rest.append(Rectangle(column, top, p.column - column, bottom - top))
            column = p.column + p.width
        if column < width:
            rest.append(Rectangle(column, top, width - column, bottom - top))
    return rest


@exact
def _lay(before: Any, bodies: Any, behind: Any, out: Any) -> None:
    """Write a picture over another over a third into `out`, premultiplied radiance (h, w, 3) and alpha (h, w) each."""
    (front, front_alpha), (body, body_alpha), (back, back_alpha), (radiance, alpha) = before, bodies, behind, out
    for j in range(alpha.shape[0]):
        for i in range(alpha.shape[1]):
            clear, through = np.float32(1.0) - front_alpha[j, i], np.float32(1.0) - body_alpha[j, i]
            for c in range(3):
                radiance[j, i, c] = front[j, i, c] + clear * (body[j, i, c] + through * back[j, i, c])
            covered = body_alpha[j, i] + through * back_alpha[j, i]
            alpha[j, i] = front_alpha[j, i] + clear * covered


LEAST_RADIUS = 0.75
"""Least radius of a disc in pixels: a centre is never farther than 0.71 from a pixel's, so every disc has weight there.
Twice as large: particles are blurred. Half as large: they flicker as they move from pixel to pixel."""


Picture = tuple[Floats, Floats]
"""Snow in a frame: premultiplied radiance (H, W, 3) and alpha (H, W), float32. Both are drawn into."""


def empty_picture(view: View) -> Picture:
    """Return a picture without particles, of a view's size."""
    return np.zeros((view.height, view.width, 3), np.float32), np.zeros((view.height, view.width), np.float32)


def draw_particles(
    arcs: tuple[Floats, Floats], radius: Floats, solid_angle: Floats, distance_m: Floats, radiance: Floats,
    body_m: Floats, before: Picture, behind: Picture,
) -> None:  # fmt: skip
    """Composite n particles, in their order, over two pictures.

    arcs: (n, 3) unit directions in the camera's axes as the shutter opens, and as it closes. radius: (n,) [rad] of
    their discs. solid_angle: (n,) [sr] that they cover. distance_m: (n,). radiance: (n, 3). body_m: (H, W) distance of
    the nearest body; a particle beyond it is drawn into `behind`, others into `before`.
    """
    height, width = body_m.shape
    latitude = np.pi * (0.5 - (np.arange(height) + 0.5) / height)
    longitude = 2.0 * np.pi * ((np.arange(width) + 0.5) / width - 0.5)
    least = LEAST_RADIUS * np.pi / height
    particles = (*arcs, np.maximum(radius, least), solid_angle, distance_m, radiance)
    rows = np.sin(latitude), np.cos(latitude), row_solid_angle(width, height)
    _draw(particles, body_m, rows, (np.sin(longitude), np.cos(longitude)), before, behind)


@exact
def _columns(row_sine: Any, row_cosine: Any, sine: Any, cosine: Any, cos_reach: Any, x: Any, width: Any) -> Any:
    """Return (first column, number of columns) of a row within an angle of a direction; columns may pass the seam."""
    across = cosine * row_cosine
    nearest = cos_reach - sine * row_sine
    if nearest >= across:
        return 0, 0
    if nearest <= -across:
        return 0, width
    half = np.arccos(nearest / across) * width / (2.0 * np.pi)
    first = int(np.ceil(x - half - 0.5))
    return first, min(int(np.floor(x + half - 0.5)) - first + 1, width)


@exact
def _share(a: Any, v: Any, b: Any, outer: Any, soft: Any, dx: Any, dy: Any, dz: Any) -> Any:
    """Return f of the pixel in direction (dx, dy, dz). v: unit, along the arc at its begin a. b: cosine and sine of the
    arc. outer: R + h, soft: 2 h.
    """
    x, y = dx * a[0] + dy * a[1] + dz * a[2], dx * v[0] + dy * v[1] + dz * v[2]
    if y > 0.0:  # past the begin: nearest to the arc itself, or to its end
        x = np.sqrt(x * x + y * y) if x * b[1] > y * b[0] else x * b[0] + y * b[1]
    return min(max((outer - np.sqrt(max(2.0 - 2.0 * x, 0.0))) / soft, 0.0), 1.0)


@exact
def _draw(particles: Any, body: Any, rows: Any, columns: Any, before: Any, behind: Any) -> None:
    """Composite particles, the arguments of `draw_particles`, over two pictures.

    rows: sine and cosine of the latitude, and the solid angle of a pixel, each (H,). columns: sine and cosine of the
    longitude, each (W,).
    """
    start, end, radius, solid_angle, distance, radiance = particles
    (row_sine, row_cosine, row_solid_angle), (column_sine, column_cosine) = rows, columns
    height, width = body.shape
    soft = np.pi / height
    a, v, m, b = np.empty(3), np.empty(3), np.empty(3), np.empty(2)
    for n in range(len(start)):
        b[0] = start[n, 0] * end[n, 0] + start[n, 1] * end[n, 1] + start[n, 2] * end[n, 2]
        chord = length = across = 0.0
        for c in range(3):
            a[c], m[c], v[c] = start[n, c], start[n, c] + end[n, c], end[n, c] - b[0] * start[n, c]
            length += m[c] * m[c]
            across += v[c] * v[c]
            chord += (end[n, c] - start[n, c]) ** 2
        length, b[1] = np.sqrt(length), np.sqrt(across)
        if length <= 0.0:
            continue  # drawn out over half a turn: it has no middle
        for c in range(3):
            v[c] = v[c] / b[1] if b[1] > 0.0 else 0.0
        outer = radius[n] + 0.5 * soft
        half_arc, wide = np.arcsin(min(0.5 * np.sqrt(chord), 1.0)), 2.0 * np.arcsin(min(0.5 * outer, 1.0))
        reach = min(half_arc + wide + 1e-9, np.pi)
        sine = min(max(m[1] / length, -1.0), 1.0)
        cosine, cos_reach = np.sqrt(1.0 - sine * sine), np.cos(reach)
        latitude = np.arcsin(sine)
        x = width * (np.arctan2(m[0], -m[2]) / (2.0 * np.pi) + 0.5)
        top = max(int(np.ceil(height * (0.5 - (latitude + reach) / np.pi) - 0.5)), 0)
        bottom = min(int(np.floor(height * (0.5 - (latitude - reach) / np.pi) - 0.5)), height - 1)
        total = 0.0
        for j in range(top, bottom + 1):
            first, count = _columns(row_sine[j], row_cosine[j], sine, cosine, cos_reach, x, width)
            across = 0.0
            for i in range(first, first + count):
                k = i % width
                dx, dz = row_cosine[j] * column_sine[k], -row_cosine[j] * column_cosine[k]
                across += _share(a, v, b, outer, soft, dx, row_sine[j], dz)
            total += across * row_solid_angle[j]
        if total <= 0.0:
            continue
        for j in range(top, bottom + 1):
            first, count = _columns(row_sine[j], row_cosine[j], sine, cosine, cos_reach, x, width)
            for i in range(first, first + count):
                k = i % width
                dx, dz = row_cosine[j] * column_sine[k], -row_cosine[j] * column_cosine[k]
                share = _share(a, v, b, outer, soft, dx, row_sine[j], dz)
                if share > 0.0:
                    w = min(share * solid_angle[n] / total, 1.0)
                    nearer = distance[n] < body[j, k]
                    light, alpha = before if nearer else behind
                    for c in range(3):
                        light[j, k, c] = w * radiance[n, c] + (1.0 - w) * light[j, k, c]
                    alpha[j, k] = w + (1.0 - w) * alpha[j, k]
