# SPDX-License-Identifier: Apache-2.0
"""The layer of a frame by ray casting in double precision: it defines what is right.

Every pixel sends the rays of its pattern. Rays of one pixel that meet the same smooth piece of surface, near the plane
of the first of them, are a group; it is lit once, where the ray in its middle met it (`shading = "sample"` lights every
ray by itself). Transparent surfaces form layers of their own in front of the opaque one, nearest first, at most
`BLEND_LAYERS`; the layers of a pixel are laid over each other.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import Cache
from mr360uw.composite.ambient.at_hits import ambient_at
from mr360uw.composite.ambient.light import ambient_light, free_of_bodies
from mr360uw.composite.ambient.solver import AmbientLight
from mr360uw.composite.aovs import SUMS, AovFrame, Aovs
from mr360uw.composite.holdout import hold_out
from mr360uw.composite.lighting.arrival import LightSource
from mr360uw.composite.lighting.blockers import Blockers
from mr360uw.composite.lighting.sources import light_sources
from mr360uw.composite.lighting.surfaces import surface_radiance, water_ahead
from mr360uw.composite.over import empty_tile
from mr360uw.composite.raycast.geometry import (
    Geometry,
    Hits,
    base_color,
    gather,
    object_rectangles,
    surface,
    uv_change,
)
from mr360uw.composite.raycast.rays import RayScene, barycentric
from mr360uw.composite.receiver.ratio import receiver_ratio
from mr360uw.composite.receiver.shape import ReceiverShape, coarse_grid, receiver_rectangles, touched_cells
from mr360uw.composite.sampling import (
    BLEND_LAYERS,
    GROUPS,
    PIXEL_FILTER,
    PLANE_TOLERANCE,
    Pattern,
    filter_width,
    pattern,
)
from mr360uw.composite.shot import Shot
from mr360uw.composite.tiles import even_tiles, split
from mr360uw.types import Floats, Layer, Rectangle, Tile

_MAXIMUM_HITS = 64
_RAYS_AT_ONCE = 200_000


@dataclass(frozen=True, slots=True, eq=False)
class Fragment:
    """What one surface adds to pixels: numbers (n,) of the pixels, the part of their samples, and its light.

    values: radiance (n, 3) as the camera sees it, and the aovs' where they are wanted.
    """

    pixel: NDArray[np.int64]
    weight: Floats
    alpha: Floats
    distance_m: Floats
    object: NDArray[np.int64]
    values: dict[str, Floats]


def render_layer(shot: Shot, cache: Cache | None = None) -> Layer:
    """Return the layer of a shot: float32 tiles of everything that objects cover or change. cache: kept among shots."""
    return _render(shot, None, cache or Cache())


def render_aovs(shot: Shot, cache: Cache | None = None) -> tuple[Layer, Aovs]:
    """Return the layer of a shot and its output variables."""
    frame = AovFrame(shot)
    layer = _render(shot, frame, cache or Cache())
    return layer, frame.finish(shot, layer)


def _render(shot: Shot, frame: AovFrame | None, cache: Cache) -> Layer:
    visible = tuple(o for o in shot.objects if o.visible)
    geometry = gather(visible, shot.view.position)
    shape = ReceiverShape(shot.receiver, shot.view.position) if shot.receiver is not None else None
    object_parts = object_rectangles(shot)
    receiver_parts: list[Rectangle] = []
    if shape is not None:
        grid = coarse_grid(shot, shape)
        receiver_parts = receiver_rectangles(shot, grid, touched_cells(shot, grid))
    tiles = even_tiles(object_parts + receiver_parts, shot.view.width, shot.view.height)
    if not tiles:
        return Layer(shot.view.height, shot.view.width, ())
    sources = light_sources(shot, Blockers(shot))
    scene = RayScene(geometry.positions)
    light = ambient_light(shot, cache)
    drawn = []
    for rectangle in tiles:
        tile = empty_tile(rectangle)
        draw_objects(
            shot, geometry, scene, sources, light, tile, _inside(object_parts, rectangle, shot.view.width), frame
        )
        if shape is not None:
            draw_receiver(shot, shape, sources, light, tile, _inside(receiver_parts, rectangle, shot.view.width))
        drawn.append(hold_out(shot, tile))
    return Layer(shot.view.height, shot.view.width, tuple(drawn))


def _inside(parts: list[Rectangle], tile: Rectangle, width: int) -> NDArray[np.bool_]:
    """Return which pixels of a tile lie in one of the rectangles."""
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
) -> None:
    """Add the objects to the pixels of a tile, and to a frame of output variables where there is one."""
    samples = pattern(shot.draw.samples)
    rows, columns = np.nonzero(where)
    step = max(_RAYS_AT_ONCE // samples.count, 1)
    for first in range(0, len(rows), step):
        j, i = rows[first : first + step], columns[first : first + step]
        x, y = i + tile.column, j + tile.row
        radiance, alpha = np.zeros((len(i), 3)), np.zeros(len(i))
        distance = np.full(len(i), np.inf)
        for layer in trace(shot, geometry, scene, samples, x, y):
            through = (1.0 - alpha).copy()
            for fragment in light_up(shot, geometry, sources, light, samples, x, y, *layer, parts=frame is not None):
                p = fragment.pixel
                share = through[p] * fragment.weight * fragment.alpha
                radiance[p] += share[:, None] * fragment.values["radiance"]
                if frame is not None:
                    add_to_frame(frame, y[p], x[p], share, fragment)
                alpha[p] += share
                np.minimum.at(distance, p, fragment.distance_m)
        tile.radiance[j, i], tile.alpha[j, i], tile.distance_m[j, i] = radiance, alpha, distance


def add_to_frame(
    frame: AovFrame, rows: NDArray[np.int64], columns: NDArray[np.int64], share: Floats, fragment: Fragment
) -> None:
    """Add a surface's share of pixels to the output variables."""
    for name in SUMS:
        frame.sums[name][rows, columns] += (share[:, None] * fragment.values[name]).astype(np.float32)
    largest = share > frame.share[rows, columns]
    frame.share[rows[largest], columns[largest]] = share[largest]
    frame.object_id[rows[largest], columns[largest]] = fragment.object[largest] + 1


def trace(
    shot: Shot, geometry: Geometry, scene: RayScene, samples: Pattern, x: NDArray[np.int64], y: NDArray[np.int64]
) -> list[tuple[NDArray[np.int64], Floats]]:
    """Return layers (triangle (n, s), distance (n, s)) of the samples of pixels, nearest first; triangle -1 for none.

    The last layer holds the opaque surfaces. Masked texels are passed, and back faces of one-sided materials.
    """
    count, n = len(x), samples.count
    fx = (x[:, None] + samples.positions[None, :, 0]).ravel()
    fy = (y[:, None] + samples.positions[None, :, 1]).ravel()
    direction = shot.view.directions(fx, fy)
    layers = [np.full(count * n, -1, np.int64) for _ in range(BLEND_LAYERS + 1)]
    distances = [np.full(count * n, np.inf) for _ in range(BLEND_LAYERS + 1)]
    filled = np.zeros(count * n, np.int64)
    mode = np.array([m.alpha_mode for m in geometry.materials] or ["OPAQUE"])
    two_sided = np.array([m.double_sided for m in geometry.materials] or [True])
    cutoff = np.array([m.alpha_cutoff for m in geometry.materials] or [0.5])
    active, start = np.arange(count * n), np.zeros(count * n)
    pixel = n**-0.5
    for _ in range(_MAXIMUM_HITS):
        if len(active) == 0:
            break
        rays = direction[active]
        triangle = scene.first_hit(start[active, None] * rays, rays)
        active, triangle, rays = active[triangle >= 0], triangle[triangle >= 0], rays[triangle >= 0]
        if len(active) == 0:
            break
        corners = geometry.positions[triangle]
        weights, distance = barycentric(corners, rays)
        start[active] = np.maximum(distance, start[active]) * (1.0 + 4e-6) + 1e-7
        material = geometry.material[triangle]
        flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        solid = two_sided[material] | (np.sum(flat * rays, -1) < 0.0)
        masked = np.flatnonzero(solid & (mode[material] == "MASK"))
        if len(masked):
            at = active[masked]
            around = np.stack(
                [shot.view.directions(fx[at] + pixel, fy[at]), shot.view.directions(fx[at], fy[at] + pixel)], axis=1
            )
            change = uv_change(corners[masked], geometry.uv[triangle[masked]], weights[masked], around)
            alpha = base_color(geometry, triangle[masked], weights[masked], change)[:, 3]
            solid[masked] = alpha >= cutoff[material[masked]]
        blended = solid & (mode[material] == "BLEND")
        for k in range(BLEND_LAYERS):
            to = blended & (filled[active] == k)
            layers[k][active[to]], distances[k][active[to]] = triangle[to], distance[to]
        filled[active[blended]] += 1
        opaque = solid & ~blended
        layers[-1][active[opaque]], distances[-1][active[opaque]] = triangle[opaque], distance[opaque]
        active = active[~opaque]
    return [
        (t.reshape(count, n), d.reshape(count, n)) for t, d in zip(layers, distances, strict=True) if np.any(t >= 0)
    ]


def light_up(
    shot: Shot,
    geometry: Geometry,
    sources: Sequence[LightSource],
    light: AmbientLight | None,
    samples: Pattern,
    x: NDArray[np.int64],
    y: NDArray[np.int64],
    triangle: NDArray[np.int64],
    distance: Floats,
    *,
    parts: bool = False,
) -> Iterator[Fragment]:
    """Yield the surfaces of one layer: samples grouped as the module says, each group lit once."""
    for pixel, weight, hits in groups(shot, geometry, samples, x, y, triangle, distance):
        through, veil = water_ahead(shot, hits.distance_m, hits.direction[:, 1])
        opaque = np.array([m.alpha_mode != "BLEND" for m in geometry.materials])
        alpha = np.where(opaque[geometry.material[hits.triangle]], 1.0, hits.alpha)
        sent = surface_radiance(shot, sources, hits, ambient_at(shot, light, hits))
        values: dict[str, Floats] = {"radiance": through * sent.total + veil}
        if parts:
            values |= {
                "diffuse": through * sent.diffuse, "glossy": through * sent.glossy,
                "sun": through * sent.of("sun"), "lamps": through * sent.of("lamps"),
                "caustics": through * sent.caustics,
                "emission": through * sent.emission, "veil": veil, "transmittance": through, "normal": hits.normal,
                "position": hits.point + shot.view.position,
            }  # fmt: skip
        yield Fragment(pixel, weight, alpha, hits.distance_m, hits.object, values)


def groups(
    shot: Shot,
    geometry: Geometry,
    samples: Pattern,
    x: NDArray[np.int64],
    y: NDArray[np.int64],
    triangle: NDArray[np.int64],
    distance: Floats,
) -> Iterator[tuple[NDArray[np.int64], Floats, Hits]]:
    """Yield (pixels, part of their samples, surface at the sample that stands for them) until no sample is left.

    A group starts at the sample that is left nearest to the pixel's centre; its last is the one of `GROUPS` that takes
    all. The sample nearest to the mean of a group's stands for it.
    """
    left = triangle >= 0
    width = filter_width(samples.count, shot.draw.shading)
    rounds = samples.count if shot.draw.shading == "sample" else GROUPS
    for number in range(rounds):
        pixel = np.flatnonzero(left.any(axis=1))
        if len(pixel) == 0:
            return
        chosen = np.argmax(left[pixel], axis=1)
        member = np.zeros((len(pixel), samples.count), bool)
        if shot.draw.shading == "pixel":
            member = left[pixel] & (
                _near_plane(shot, geometry, samples, x[pixel], y[pixel], triangle[pixel], distance[pixel], chosen)
                if number < rounds - 1
                else True
            )
        member[np.arange(len(pixel)), chosen] = True
        left[pixel] &= ~member
        middle = _middle(samples, member)
        at = samples.positions[middle]
        yield (
            pixel,
            member.mean(axis=1),
            surface(shot, geometry, triangle[pixel, middle], x[pixel] + at[:, 0], y[pixel] + at[:, 1], width),
        )


def _near_plane(
    shot: Shot,
    geometry: Geometry,
    samples: Pattern,
    x: NDArray[np.int64],
    y: NDArray[np.int64],
    triangle: NDArray[np.int64],
    distance: Floats,
    chosen: NDArray[np.int64],
) -> NDArray[np.bool_]:
    """Return which samples (n, s) lie on the smooth piece of the chosen one's triangle (n,), near its plane."""
    rows = np.arange(len(chosen))
    first = triangle[rows, chosen]
    corners = geometry.positions[first]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    seen = np.where(triangle >= 0, distance, 0.0)[..., None]
    fx, fy = x[:, None] + samples.positions[:, 0], y[:, None] + samples.positions[:, 1]
    off = np.einsum("nsk,nk->ns", shot.view.directions(fx, fy) * seen - corners[:, :1], normal)
    tolerance = PLANE_TOLERANCE * PIXEL_FILTER * np.pi / shot.view.height * distance[rows, chosen]
    same = geometry.patch[triangle] == geometry.patch[first][:, None]
    return same & (np.abs(off) <= tolerance[:, None])


def _middle(samples: Pattern, member: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the member (n,) nearest to the mean of members (n, s); in whole numbers, so that ties are ties."""
    count = member.sum(axis=1)
    away = count[:, None, None] * samples.cells - (member @ samples.cells)[:, None]
    return np.argmin(np.where(member, np.sum(away**2, axis=-1), np.iinfo(np.int64).max), axis=1)


# --- receivers -----------------------------------------------------------------------------------------------------


def draw_receiver(
    shot: Shot,
    shape: ReceiverShape,
    sources: Sequence[LightSource],
    light: AmbientLight | None,
    tile: Tile,
    where: NDArray[np.bool_],
) -> None:
    """Set ratio and veil of the pixels of a tile."""
    assert shot.receiver is not None
    rows, columns = np.nonzero(where)
    if len(rows) == 0:
        return
    x, y = columns + tile.column + 0.5, rows + tile.row + 0.5
    distance, normal = shape.meet(shot, x, y)
    hit = np.isfinite(distance)
    rows, columns, distance, normal = rows[hit], columns[hit], distance[hit], normal[hit]
    direction = shot.view.directions(x[hit], y[hit])
    point = direction * distance[:, None]
    free = free_of_bodies(shot, light, point, normal, Cache())
    ratio = receiver_ratio(shot, sources, free, point, normal, distance)
    changed = np.any(np.abs(ratio - 1.0) > 1e-4, axis=-1)
    _, veil = water_ahead(shot, distance, direction[:, 1])
    tile.ratio[rows[changed], columns[changed]] = ratio[changed]
    tile.veil[rows[changed], columns[changed]] = veil[changed]
