# SPDX-License-Identifier: Apache-2.0
"""Visible surfaces of a shot's pixels, as fragments that are shaded once each.

Triangles are listed, nearest first, by the blocks of 4 x 4 pixels that they may cover (triangles.py). Rays through the
corners and centres of a block's pixels find those that one smooth piece fills: one fragment each. In the others all
samples are traced, and those of a smooth piece near one plane form a fragment, as in reference.py. The loops are
compiled, on the processor: a driver in software takes three times as long for the same, and the lists have to come from
the processor in any case.
"""

from __future__ import annotations

import operator
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.cache import Cache, PartOf, room, shared
from mr360uw.composite.gl.triangles import (
    BLENDED,
    BLOCK,
    MASKED,
    MeshLooks,
    make_blocks,
    mesh_looks,
    seen_triangles,
)
from mr360uw.composite.mesh.material import WRAPS, Texture, alpha_at
from mr360uw.composite.sampling import (
    BLEND_LAYERS,
    GROUPS,
    NO_GAPS,
    PIXEL_FILTER,
    PLANE_TOLERANCE,
    WHOLE_PIXEL,
    Gaps,
    Pattern,
    find_gaps,
    join_gaps,
    pattern,
    root_of_moments,
)
from mr360uw.composite.shot import PlacedObject, Shot
from mr360uw.jit import exact, fast, inlined
from mr360uw.types import Floats, View

_KEPT = 64
"""Objects and meshes of which the triangles are kept between frames."""


@dataclass(frozen=True, slots=True, eq=False)
class Fragments:
    """n pieces of surface in p pixels, the pieces of a pixel in sequence.

    row, column: (p,) of the pixels, each once. first: (p,) index of the first piece of each. triangle: (n,) numbers.
    place: (n, 2) frame coordinates at which each piece is shaded. area: (n, 5) of the frame that it represents
    (`sampling.frame_areas`). weight: (n,) fraction of the pixel's samples. gaps: of the pixels covered partly.
    """

    row: NDArray[np.int64]
    column: NDArray[np.int64]
    first: NDArray[np.int64]
    triangle: NDArray[np.int64]
    place: Floats
    area: Floats
    weight: Floats
    gaps: Gaps = NO_GAPS

    def pixel(self) -> NDArray[np.int64]:
        """Return the pixel (n,) of each piece."""
        return np.repeat(np.arange(len(self.row)), np.diff(np.append(self.first, len(self.triangle))))


_NONE = np.zeros(0, np.int64)
_NOTHING = Fragments(_NONE, _NONE, _NONE, _NONE, np.zeros((0, 2)), np.zeros((0, 5)), np.zeros(0))
_FRAGMENTS_AT_ONCE = 1 << 22
"""Fragments that there is room for at once: bounds the memory."""


@dataclass(frozen=True, slots=True, eq=False)
class Surfaces:
    """The visible surfaces of objects.

    layers: of fragments, nearest first, opaque ones last. first: number of each object's first triangle. facets: (T,
    10) of the triangles by number, three vectors as the module says, and the side that is shown. cache: of what is made
    of them, and goes with them.
    """

    layers: list[Fragments]
    first: NDArray[np.int64]
    facets: NDArray[np.float32]
    cache: Cache = field(default_factory=Cache)


def find_surfaces(sampled: PartOf[Shot], objects: list[PlacedObject], cache: Cache) -> Surfaces:
    """Return the visible surfaces of objects. cache: what is kept of meshes and objects."""
    shot, keep = sampled.whole, max(_KEPT, len(objects))
    view = shot.view
    # Gather the triangles of all objects, and their smooth pieces, numbered one after the other
    of_view, looks, seen, numbers, pieces = PartOf(view, view), [], [], [0], 0
    for placed in objects:
        look = cache.of(mesh_looks, placed.mesh.still, keep=keep)
        seen_by_camera = cache.of(seen_triangles, placed, of_view, look, keep=keep)
        seen.append((*seen_by_camera, look.kind, placed.mesh.patch + pieces))
        looks.append(look)
        numbers.append(numbers[-1] + len(look.kind))
        pieces += look.pieces
    first = np.array(numbers)
    if first[-1] == 0:
        return Surfaces([], first[:-1], np.zeros((0, 10), np.float32))
    facets, nearest, rectangle, kind, piece = map(np.concatenate, zip(*seen, strict=True))
    scene = facets, nearest, kind, piece.astype(np.int32), cutouts(looks, first)
    # List them by block, nearest first, and see which pixels they fill
    corner, bounds, members, masks = make_blocks(rectangle, nearest, view)
    tables, by_sample = _ray_tables(view.width, view.height), shot.draw.shading == "sample"
    slack, step = PLANE_TOLERANCE * PIXEL_FILTER * np.pi / view.height, shot.draw.samples**-0.5
    optics = np.float32(view.eye_m), np.float32(slack), np.float32(step), by_sample
    shown, reach = np.empty((len(corner), BLOCK * BLOCK), np.int32), np.zeros(len(members), np.uint16)
    most = int(np.diff(bounds).max(initial=1))
    work = *room((3, _PROBES), (3, _PROBES), (most, _PROBES), _PROBES, _PROBES, BLOCK * _WIDE), _mask_room()
    _classify((corner, bounds, members, masks), scene, tables, optics, work, shown, reach)
    # Trace the samples of the others; blended surfaces layer by layer, wherever they reach
    inputs = (corner, bounds, members, reach), scene, tables, optics
    layers: list[Fragments] = []
    blended = np.zeros(0, np.int64)
    if np.any(kind == BLENDED):
        clear = np.zeros((len(corner), BLOCK * BLOCK), np.bool_)
        _mark(bounds, members, reach, kind, clear)
        blended = np.flatnonzero(clear)
    while len(layers) < BLEND_LAYERS and len(blended):
        found = _traced(view, shot.draw.samples, blended, inputs, len(layers))
        if len(found.triangle) == 0:
            break
        layers.append(found)
    whole, rest = np.flatnonzero(shown.reshape(-1) > 0), np.flatnonzero(shown.reshape(-1) < 0)
    traced = _traced(view, shot.draw.samples, rest, inputs, -1)
    layers.append(_joined(_whole(corner, shown, whole), traced))
    return Surfaces(layers, first[:-1], facets)


def cutouts(looks: Sequence[MeshLooks], first: NDArray[np.int64]) -> tuple[Any, ...]:
    """Return the tables of masks that kernels read: rows of `cuts` by triangle, those, alphas of all levels of maps,
    and the place of each map among them: address, width, height, wrap along both.
    """
    cut, cuts = np.full(int(first[-1]), -1, np.int32), [np.zeros((0, 11))]
    places: dict[Texture, tuple[int, ...]] = {}
    alphas, address, row = [np.zeros(1, np.float32)], 1, 0
    for look, begin in zip(looks, first, strict=False):
        if len(look.cuts) == 0:
            continue
        cut[begin : begin + len(look.cut)] = np.where(look.cut >= 0, look.cut + row, -1)
        cuts.append(look.cuts.copy())
        row += len(look.cuts)
        # Number the maps of all meshes, each once
        for texture in look.maps:
            if texture not in places:
                places[texture] = len(places), address, *texture.size, *map(WRAPS.index, texture.wrap)
                alphas += [level[..., 3].astype(np.float32).ravel() for level in texture.levels]
                address += sum(map(len, alphas[-len(texture.levels) :]))
        number = np.array([*(places[texture][0] for texture in look.maps), -1])
        cuts[-1][:, 10] = number[look.cuts[:, 10].astype(np.int64)]
    rows = np.array([place[1:] for place in places.values()] or np.zeros((1, 5)), np.int64)
    return cut, np.concatenate(cuts if row else [np.zeros((1, 11))]), np.concatenate(alphas), rows


@shared(keep=4)
def _ray_tables(width: int, height: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return (cosine, sine) of the longitudes of the left sides of columns, then of their middles, (2, 2, W + 8), and
    of the latitudes of rows (2, 2, H + 8).
    """
    column, row = (np.arange(n + 2 * BLOCK) + np.array([[0.0], [0.5]]) for n in (width, height))
    angles = 2.0 * np.pi * (column / width - 0.5), np.pi * (0.5 - row / height)
    longitude, latitude = (np.stack([np.cos(a), np.sin(a)]).astype(np.float32) for a in angles)
    return longitude, latitude


def _whole(corner: NDArray[np.int64], shown: NDArray[np.int32], at: NDArray[np.int64]) -> Fragments:
    """Return the fragments of pixels that one smooth piece fills. at: (p,) 16 times their block, and place in it."""
    block, within = at // (BLOCK * BLOCK), at % (BLOCK * BLOCK)
    column, row = corner[block, 0] + within % BLOCK, corner[block, 1] + within // BLOCK
    place, number = np.stack([column, row], axis=-1) + 0.5, shown.reshape(-1)[at].astype(np.int64) - 1
    area, weight = np.tile(WHOLE_PIXEL, (len(at), 1)), np.ones(len(at))
    return Fragments(row, column, np.arange(len(at)), number, place, area, weight)


def _traced(view: View, count: int, at: NDArray[np.int64], inputs: Any, layer: int) -> Fragments:
    """Return the fragments of pixels of which all samples are traced. at: as of `_whole`. inputs: lists, scene, tables
    and optics of `_trace`. layer: of blended surfaces, -1 for the others.
    """
    samples, pattern_ = _sample_tables(view.width, view.height, count)
    (_, bounds, *_), _, _, (*_, by_sample) = inputs
    most, found = count if by_sample else GROUPS, _NOTHING
    work = _sample_room(pattern_[0].shape[2], int(np.diff(bounds).max(initial=1)))
    for start in range(0, len(at), _FRAGMENTS_AT_ONCE // most):
        # Room for as many fragments as there may be: memory that is not written is not taken
        some = at[start : start + _FRAGMENTS_AT_ONCE // most]
        capacity = len(some) * most
        pixels, first = np.empty((2, len(some)), np.int64), np.empty(len(some), np.int64)
        triangle, place = np.empty(capacity, np.int64), np.empty((capacity, 2))
        area, weight = np.empty((capacity, 5)), np.empty(capacity)
        filled, covered = np.empty(len(some), np.int64), np.empty((len(some), count), np.bool_)
        outputs = pixels, first, triangle, place, area, weight, filled, covered
        there, total = _trace(some, inputs, pattern_, (count, layer), work, outputs)
        row, column = pixels[:, :there].copy()
        partly = np.flatnonzero(filled[:there] < count)
        gaps = find_gaps(samples, row[partly], column[partly], covered[partly])
        n = slice(0, total)
        of_pieces = triangle[n].copy(), place[n].copy(), area[n].copy(), weight[n].copy()
        found = _joined(found, Fragments(row, column, first[:there].copy(), *of_pieces, gaps))
    return found


@shared(keep=4)
def _sample_tables(width: int, height: int, count: int) -> tuple[Pattern, tuple[NDArray[Any], ...]]:
    """Return the pattern of `count` samples, and its tables for `_trace`: rotations, cells and their products,
    positions, which of them are real, and the step.
    """
    # Pad the samples with copies of the last one, to whole vectors of eight
    samples, padded = pattern(count), np.minimum(np.arange(-(-count // 8) * 8), count - 1)
    angles = samples.positions[padded] * (2.0 * np.pi / width, -np.pi / height)
    turns = np.stack([np.cos(angles), np.sin(angles)], axis=0).astype(np.float32).transpose(2, 0, 1)
    positions, (x, y) = samples.positions[padded].T.astype(np.float32), samples.cells[padded].T
    cells = np.stack([x, y, x * x, x * y, y * y]).astype(np.float32)
    real = (np.arange(len(x)) < count).astype(np.float32)
    return samples, (turns, cells, positions, real, np.array(samples.step))


def _joined(one: Fragments, other: Fragments) -> Fragments:
    """Return the fragments of two disjoint sets of pixels."""
    if not len(one.triangle) or not len(other.triangle):
        return other if len(other.triangle) else one
    pairs = zip(_columns(one), _columns(other), strict=True)
    row, column, first, triangle, place, area, weight = map(np.concatenate, pairs)
    first[len(one.first) :] += len(one.triangle)
    return Fragments(row, column, first, triangle, place, area, weight, join_gaps(one.gaps, other.gaps))


_columns = operator.attrgetter("row", "column", "first", "triangle", "place", "area", "weight")
"""Returns the arrays of fragments in the order of the fields."""


# --- pixels that one smooth piece fills ------------------------------------------------------------------------------

_WIDE = 8
"""Numbers in a row of a block's grid of rays: corners and centres of pixels, of which the others are not used."""
_CORNERS = (BLOCK + 1) * _WIDE
_PROBES = _CORNERS + BLOCK * _WIDE
_APART = np.float32(4.0)
"""Tolerances in front of a piece from which on a surface of the same piece is another part of it."""


@inlined
def _meet(rays: Any, facet: Any, eye: Any, met: Any) -> None:
    """Set `met` (3, n): products of a facet's vectors with rays (3, n). Rays of an eye start on the viewing circle
    (types.py): their start, over their distance, is added to their direction.
    """
    ax, ay, az, bx, by, bz = facet[0], facet[1], facet[2], facet[3], facet[4], facet[5]
    cx, cy, cz, side = facet[6], facet[7], facet[8], facet[9]
    if eye == np.float32(0.0):
        for i in range(rays.shape[1]):
            x, y, z = rays[0, i], rays[1, i], rays[2, i]
            met[0, i] = ax * x + ay * y + az * z
            met[1, i] = bx * x + by * y + bz * z
            met[2, i] = cx * x + cy * y + cz * z
    else:
        px, py, pz = ax + bx + cx, ay + by + cy, az + bz + cz
        for i in range(rays.shape[1]):
            x, y, z = rays[0, i], rays[1, i], rays[2, i]
            divisor = np.float32(1.0) - eye * (pz * x - px * z)
            if abs(divisor) < np.float32(1e-9):
                divisor = np.float32(1e-9) if divisor >= np.float32(0.0) else np.float32(-1e-9)
            along = eye * (px * x + py * y + pz * z) / divisor
            # turned away from where it would meet the back, if only one side is shown
            shown = np.float32(1.0) if side * divisor <= np.float32(0.0) else np.float32(-1.0)
            x, y, z = shown * (x - along * z), shown * y, shown * (z + along * x)
            met[0, i] = ax * x + ay * y + az * z
            met[1, i] = bx * x + by * y + bz * z
            met[2, i] = cx * x + cy * y + cz * z


@inlined
def _keep_nearest(met: Any, number: Any, best: Any, who: Any) -> None:
    """Note a triangle's number in a list as the hit of the rays (n,) for which it is the nearest."""
    zero = np.float32(0.0)
    for i in range(met.shape[1]):
        value = met[0, i] + met[1, i] + met[2, i] if min(met[0, i], met[1, i], met[2, i]) >= zero else zero
        before = best[i]
        who[i] = number if value > before else who[i]
        best[i] = max(value, before)


@inlined
def _off(facet: Any, x: Any, y: Any, z: Any, eye: Any, near: Any) -> Any:
    """Return how far the end of a ray of one over its length `near` is from a facet's plane, over that."""
    px, py, pz = facet[0] + facet[3] + facet[6], facet[1] + facet[4] + facet[7], facet[2] + facet[5] + facet[8]
    along = eye * near
    return abs(px * (x - along * z) + py * y + pz * (z + along * x) - near)


@inlined
def _tolerance(facet: Any, slack: Any, near: Any) -> Any:
    """Return the distance from a facet's plane within which hits are shaded together, over the length of rays."""
    px, py, pz = facet[0] + facet[3] + facet[6], facet[1] + facet[4] + facet[7], facet[2] + facet[5] + facet[8]
    return slack / near * np.sqrt(px * px + py * py + pz * pz)


@exact
def alpha_of(cuts: Any, alphas: Any, places: Any, weights: Any, change: Any) -> Any:
    """Return the alpha of a masked triangle at weights (3,) of its corners. change: (2, 2) of (u, v) over a pixel."""
    total = max(weights[0] + weights[1] + weights[2], 1e-30)
    alpha = u = v = 0.0
    for k in range(3):
        w = min(max(weights[k] / total, 0.0), 1.0)
        u, v, alpha = u + w * cuts[2 * k], v + w * cuts[2 * k + 1], alpha + w * cuts[6 + k]
    if cuts[10] >= 0.0:
        alpha *= alpha_at(alphas, places[int(cuts[10])], u, v, change)
    return alpha


def _mask_room() -> tuple[NDArray[Any], ...]:
    """Return room of masked triangles: three rays and what they meet, their first (u, v), weights, change of (u, v)."""
    return *room((3, 3), (3, 3)), *room(2, 3, (2, 2), dtype=np.float64)


@exact
def _set_uv_change(cuts: Any, facet: Any, eye: Any, x: Any, y: Any, step: Any, size: Any, work: Any) -> None:
    """Set the change (2, 2) of (u, v) of a masked triangle from a place in the frame to those `step` pixels to the
    right and below. size: width and height of the frame. work: of `_mask_room`, of which the change is part.
    """
    ray, near, here, _, change = work
    for n in range(3):
        lon = 2.0 * np.pi * ((x + (step if n == 1 else 0.0)) / size[0] - 0.5)
        lat = np.pi * (0.5 - (y + (step if n == 2 else 0.0)) / size[1])
        ray[0, n], ray[1, n], ray[2, n] = np.cos(lat) * np.sin(lon), np.sin(lat), -np.cos(lat) * np.cos(lon)
    _meet(ray, facet, eye, near)
    for n in range(3):
        total = near[0, n] + near[1, n] + near[2, n]
        total = total if abs(total) > 1e-30 else np.float32(1e-30)
        for j in range(2):
            value = 0.0
            for k in range(3):
                value += near[k, n] / total * cuts[2 * k + j]
            if n == 0:
                here[j] = value
            else:
                change[n - 1, j] = min(max(value - here[j], -1e3), 1e3)


@exact
def _close_masked(met: Any, best: Any, cuts: Any, alphas: Any, places: Any, work: Any, least: Any) -> None:
    """Make the rays (n,) miss a masked triangle whose alpha is below `least` where it would be their nearest hit."""
    _, _, _, weights, change = work
    for i in range(len(best)):
        inside = min(met[0, i], met[1, i], met[2, i]) >= 0.0
        if inside and met[0, i] + met[1, i] + met[2, i] > best[i]:
            for k in range(3):
                weights[k] = met[k, i]
            if alpha_of(cuts, alphas, places, weights, change) < least:
                met[0, i] = np.float32(-1.0)


@fast
def _classify(lists: Any, scene: Any, tables: Any, optics: Any, work: Any, shown: Any, reach: Any) -> None:
    """Set what the pixels of blocks show, (n, 16): the number of a triangle + 1 where its smooth piece fills the pixel,
    0 where nothing reaches into it, -1 otherwise; and the bits of the pixels that each member of a list reaches into.

    lists: of `make_blocks`. scene: facets, least inverse distances, kinds and smooth pieces of triangles, and tables of
    `cutouts`. tables: of `_ray_tables`. optics: the eye's distance from the middle, the slack of `_tolerance`, the
    distance [pixels] of samples, and whether none is filled, for each is shaded. work: rays and what they meet, (3, n),
    of each member its distance; nearest distance, whose it is, and bits; and `_mask_room`.
    """
    (corner, bounds, members, masks), (longitude, latitude), (eye, slack, step, by_sample) = lists, tables, optics
    facets, _, kind, piece, (cut, cuts, alphas, places) = scene
    (rays, met, near, best, who, bit, of_mask), zero = work, np.float32(0.0)
    size = longitude.shape[2] - 2 * BLOCK, latitude.shape[2] - 2 * BLOCK
    for p in range(BLOCK * BLOCK):
        bit[_WIDE * (p // BLOCK) + p % BLOCK] = np.float32(1 << p)
    for b in range(len(corner)):
        # Aim rays at the corners of pixels and at their centres
        for r in range(BLOCK + 1):
            for c in range(_WIDE):
                i, column, row = _WIDE * r + c, corner[b, 0] + c, corner[b, 1] + r
                rays[0, i] = latitude[0, 0, row] * longitude[1, 0, column]
                rays[1, i] = latitude[1, 0, row]
                rays[2, i] = -latitude[0, 0, row] * longitude[0, 0, column]
                if r < BLOCK:
                    i += _CORNERS
                    rays[0, i] = latitude[0, 1, row] * longitude[1, 1, column]
                    rays[1, i] = latitude[1, 1, row]
                    rays[2, i] = -latitude[0, 1, row] * longitude[0, 1, column]
        for i in range(_PROBES):
            best[i] = zero
        # Intersect them with the members; note which pixels each reaches into
        touched = 0
        for m in range(bounds[b], bounds[b + 1]):
            t, k = members[m], m - bounds[b]
            number = np.float32(k)
            _meet(rays, facets[t], eye, met)
            for i in range(_CORNERS):
                near[k, i] = max(met[0, i] + met[1, i] + met[2, i], zero)
            bits = zero
            for i in range(BLOCK * _WIDE):
                u = max(met[0, i], met[0, i + 1], met[0, i + _WIDE], met[0, i + _WIDE + 1])
                v = max(met[1, i], met[1, i + 1], met[1, i + _WIDE], met[1, i + _WIDE + 1])
                w = max(met[2, i], met[2, i + 1], met[2, i + _WIDE], met[2, i + _WIDE + 1])
                bits += bit[i] if min(u, v, w) >= zero else zero
            reach[m] = int(bits) & masks[m]
            if kind[t] == BLENDED:
                continue
            touched |= int(reach[m])
            if kind[t] == MASKED:  # solid for all samples around: well above its cutoff
                own, middle = cuts[cut[t]], 0.5 * BLOCK
                _set_uv_change(own, facets[t], eye, corner[b, 0] + middle, corner[b, 1] + middle, step, size, of_mask)
                _close_masked(met, best, own, alphas, places, of_mask, 0.5 * (1.0 + own[9]))
            _keep_nearest(met, number, best, who)
        # A pixel is filled if its corners show the plane of its centre, and nothing else reaches in before it
        for p in range(BLOCK * BLOCK):
            shown[b, p] = -((touched >> p) & 1)
            i = _WIDE * (p // BLOCK) + p % BLOCK
            depth = best[_CORNERS + i]
            if by_sample or shown[b, p] == 0 or depth == zero:
                continue
            k = int(who[_CORNERS + i])
            t, whole = members[bounds[b] + k], True
            margin = _tolerance(facets[t], slack, depth)
            for j in range(4):
                at = i + j % 2 + _WIDE * (j // 2)
                if (
                    best[at] == zero
                    or piece[members[bounds[b] + int(who[at])]] != piece[t]
                    or _off(facets[t], rays[0, at], rays[1, at], rays[2, at], eye, best[at]) > margin * best[at]
                ):
                    whole = False
            if not whole:
                continue
            thinner = np.float32(1.0) - _APART * margin
            a0, a1, a2, a3 = near[k, i], near[k, i + 1], near[k, i + _WIDE], near[k, i + _WIDE + 1]
            for m in range(bounds[b], bounds[b + 1]):
                j = m - bounds[b]
                if (reach[m] >> p) & 1 == 0 or j == k or kind[members[m]] == BLENDED:
                    continue
                factor = thinner if piece[members[m]] == piece[t] else np.float32(1.0)
                if (near[j, i] * factor > a0 or near[j, i + 1] * factor > a1 or near[j, i + _WIDE] * factor > a2
                        or near[j, i + _WIDE + 1] * factor > a3):  # fmt: skip
                    whole = False
                    break
            if whole:
                shown[b, p] = t + 1


@exact
def _mark(bounds: Any, members: Any, reach: Any, kind: Any, clear: Any) -> None:
    """Mark the pixels (n, 16) of blocks that blended surfaces reach into."""
    for b in range(len(bounds) - 1):
        for m in range(bounds[b], bounds[b + 1]):
            if kind[members[m]] == BLENDED:
                for p in range(BLOCK * BLOCK):
                    clear[b, p] |= (reach[m] >> p) & 1 == 1


# --- pixels with edges -----------------------------------------------------------------------------------------------


def _sample_room(samples: int, members: int) -> tuple[Any, ...]:
    """Return room of `_trace` for the samples of a pixel, and for the most members of a list."""
    of_sample, numbers = room(*(samples,) * 7), np.arange(samples, dtype=np.float32)
    return room((3, samples), (3, samples)), of_sample, *room(members), numbers, _mask_room()


@fast
def _trace(at: Any, inputs: Any, pattern_: Any, asked: Any, work: Any, outputs: Any) -> Any:
    """Write the fragments of pixels at (p,), as of `_whole`, and return the number of pixels that have any and of
    fragments.

    inputs: lists, scene, tables and optics of `_classify`, with what members reach into for masks. pattern_: (cosine,
    sine) of the angles of longitude and latitude of samples from a pixel's corner, (2, 2, s), s a multiple of 8; cells
    (5, s) with their products, positions (2, s), 1 for those that are no copies, and axes of `_set_area`. asked: number
    of samples, and of the blended surface from the front, -1 for the nearest of the others. work: of `_sample_room`.
    outputs: arrays of `Fragments`, then (p,) number of covered samples, and (p, count) which, where that is not all.
    """
    (corner, bounds, members, reach), scene, (longitude, latitude), (eye, slack, step, by_sample) = inputs
    facets, nearest, kind, piece, (cut, cuts, alphas, places) = scene
    (turns, cells, positions, real, axes), (count, layer) = pattern_, asked
    pixels, first, triangle, place, area, weight, filled, covered = outputs
    (rays, met), (best, wall, limit, who, part, free, mine), pieces, numbers, of_mask = work
    n, zero, big, block = turns.shape[2], np.float32(0.0), np.float32(1e30), -1
    size = longitude.shape[2] - 2 * BLOCK, latitude.shape[2] - 2 * BLOCK
    there = found = 0
    for e in range(len(at)):
        b, p = at[e] // (BLOCK * BLOCK), at[e] % (BLOCK * BLOCK)
        column, row = corner[b, 0] + p % BLOCK, corner[b, 1] + p // BLOCK
        # Aim a ray at every sample
        lon_c, lon_s = longitude[0, 0, column], longitude[1, 0, column]
        lat_c, lat_s = latitude[0, 0, row], latitude[1, 0, row]
        turn_c, turn_s, tip_c, tip_s = turns[0, 0], turns[0, 1], turns[1, 0], turns[1, 1]
        for i in range(n):
            rays[1, i] = lat_s * tip_c[i] + lat_c * tip_s[i]
        for i in range(n):
            rays[0, i] = (lat_c * tip_c[i] - lat_s * tip_s[i]) * (lon_s * turn_c[i] + lon_c * turn_s[i])
        for i in range(n):
            rays[2, i] = (lat_s * tip_s[i] - lat_c * tip_c[i]) * (lon_c * turn_c[i] - lon_s * turn_s[i])
        # Find the nearest solid surface, then as many blended ones in front of it as the layer asks for
        for turn in range(layer + 2):
            for i in range(n):
                who[i] = zero
                behind = best[i] / (np.float32(1.0 + 4e-6) + np.float32(1e-7) * best[i])
                limit[i] = big if turn < 2 else (behind if best[i] > wall[i] else zero)
                wall[i] = best[i] if turn == 1 else wall[i]
                best[i] = wall[i] if turn > 0 else zero
            for m in range(bounds[b], bounds[b + 1]):
                t = members[m]
                if (reach[m] >> p) & 1 == 0 or (kind[t] == BLENDED) != (turn > 0):
                    continue
                _meet(rays, facets[t], eye, met)
                if kind[t] == MASKED:
                    own_cuts, x, y = cuts[cut[t]], column + positions[0, 0], row + positions[1, 0]
                    _set_uv_change(own_cuts, facets[t], eye, x, y, step, size, of_mask)
                    _close_masked(met, best, own_cuts, alphas, places, of_mask, own_cuts[9])
                if turn > 0:
                    for i in range(n):
                        met[0, i] = met[0, i] if met[0, i] + met[1, i] + met[2, i] <= limit[i] else np.float32(-1.0)
                _keep_nearest(met, np.float32(m - bounds[b]), best, who)
                if turn == 0:
                    farther = zero
                    for i in range(n):
                        farther += np.float32(1.0) if best[i] < nearest[t] else zero
                    if farther == zero:
                        break  # those that follow are farther away
        # Group the samples that show a smooth piece near a plane
        if b != block:
            block = b
            for m in range(bounds[b], bounds[b + 1]):
                pieces[m - bounds[b]] = np.float32(piece[members[m]])
        seen = zero
        for i in range(n):
            least = wall[i] if layer >= 0 else zero
            free[i] = real[i] if best[i] > least else zero
            seen += free[i]
        left = int(seen)
        if left == 0:
            continue
        for i in range(n):
            part[i] = pieces[int(who[i])]
        pixels[0, there], pixels[1, there], first[there], filled[there] = row, column, found, left
        if left < count:
            for i in range(count):
                covered[there, i] = free[i] > zero
        there += 1
        seed, number = 0, 0
        while left > 0:
            while free[seed] == zero:
                seed += 1
            t, own = members[bounds[b] + int(who[seed])], part[seed]
            margin, last = _tolerance(facets[t], slack, best[seed]), number == GROUPS - 1
            px = facets[t, 0] + facets[t, 3] + facets[t, 6]
            py = facets[t, 1] + facets[t, 4] + facets[t, 7]
            pz = facets[t, 2] + facets[t, 5] + facets[t, 8]
            rank = seed
            if by_sample:
                free[seed] = zero
                left -= 1
                weight[found] = 1.0 / count
                area[found, 0] = area[found, 1] = area[found, 3] = 0.0
                area[found, 2] = area[found, 4] = 1.0 / np.sqrt(np.float64(count))
            else:
                for i in range(n):
                    along = eye * best[i]
                    x, y, z = rays[0, i] - along * rays[2, i], rays[1, i], rays[2, i] + along * rays[0, i]
                    near = abs(px * x + py * y + pz * z - best[i]) <= margin * best[i]
                    mine[i] = free[i] if near & (part[i] == own) else zero
                if last:
                    for i in range(n):
                        mine[i] = free[i]
                mine[seed] = np.float32(1.0)  # whatever the rounding
                total = sum_x = sum_y = xx = xy = yy = zero
                for i in range(n):
                    w = mine[i]
                    free[i] -= w
                    total += w
                    sum_x += w * cells[0, i]
                    sum_y += w * cells[1, i]
                    xx += w * cells[2, i]
                    xy += w * cells[3, i]
                    yy += w * cells[4, i]
                left -= int(total)
                # The sample nearest to the mean stands for the group; in whole numbers, of which the last seven bits
                # are the sample's: single floats hold them exactly
                lowest = np.int32(1 << 30)
                for i in range(n):
                    value = total * (cells[2, i] + cells[4, i]) - np.float32(2.0) * (
                        sum_x * cells[0, i] + sum_y * cells[1, i]
                    )
                    value = np.float32(128.0) * value + numbers[i] if mine[i] > zero else np.float32(1 << 30)
                    lowest = min(lowest, np.int32(value))
                rank = int(lowest) & 127
                t = members[bounds[b] + int(who[rank])]
                weight[found] = total / count
                sums = np.float64(total), np.float64(sum_x), np.float64(sum_y), xx, xy, yy
                _set_area(sums, axes, cells[0, rank], cells[1, rank], area[found])
            triangle[found] = t
            place[found, 0], place[found, 1] = column + positions[0, rank], row + positions[1, rank]
            found += 1
            number += 1
    return there, found


@exact
def _set_area(sums: Any, axes: Any, at_x: Any, at_y: Any, area: Any) -> None:
    """Set the area (5,) of `sampling.frame_areas` of samples with these sums of powers of their cells, 1, x, y, xx, xy
    and yy. axes: `Pattern.step`. at_x, at_y: cell of the sample that stands for all.
    """
    total, x, y, xx, xy, yy = sums
    a, b = axes
    x, y = x / total, y / total
    xx, xy, yy = xx / total - x * x, xy / total - x * y, yy / total - y * y
    own = 1.0 / 12.0 * (a * a + b * b)
    # Turn the moments from the grid's axes to the frame's: x = a X - b Y, y = b X + a Y
    frame_xx = a * a * xx - 2.0 * a * b * xy + b * b * yy + own
    frame_yy = b * b * xx + 2.0 * a * b * xy + a * a * yy + own
    frame_xy = a * b * (xx - yy) + (a * a - b * b) * xy
    x, y = x - at_x, y - at_y
    area[0], area[1] = a * x - b * y, b * x + a * y
    area[2], area[3], area[4] = root_of_moments(frame_xx, frame_xy, frame_yy, own)
