# SPDX-License-Identifier: Apache-2.0
"""Ambient light that bodies block on the ground, as weights on the sky: new light then costs one product.

    E_blocked = sum_a da sum_c n_c (P(a, hi) - P(a, lo))_c = sum_(c, node) n_c w_node P_(node, c)

    P(a, e) = int_{-pi/2}^e L(a, e') d(a, e') cos e' de'

with P the light of the environment integrated over elevation, at the nodes of a table, d the unit direction at azimuth
a and elevation e, L the radiance, lo and hi the intervals of elevation that a horizon scan finds (height_field.py), cut
at the place's own horizon, n its normal, and w interpolation between nodes. Where bodies stand behind each other, a
later one adds what the earlier ones leave of its interval.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import Parts
from mr360uw.composite.ambient.height_field import AZIMUTHS, HeightField, as_rectangle, place_beside, scan
from mr360uw.constants import BRIGHTEST, DARK
from mr360uw.ibl.lookup import lookup_matrix
from mr360uw.jit import fast, inlined
from mr360uw.texels import smoothstep
from mr360uw.types import Environment, Floats

UNNOTICED, NOTICED = 0.012, 0.036
"""A body that blocks less than the first fraction of the ambient light leaves it: a code value of 8 bits over metres;
from the second on it shows whole."""
_PIECES = 8
_MOST_CORNERS = 64
ROWS, COLUMNS = 32, 24
"""Azimuths and steps of elevation of the table."""
NODES = ROWS * (COLUMNS + 1)
_FINER = 2
"""Cells along each side of one of the table over which light is summed: pixels of the map."""
_GLOW, _GLOW_POWER, _GLOW_SIDE = 2.0, 8, np.sqrt(0.5)
"""Glow of `glow_table` over the rest of its sky, power of the cosine to its middle (half as bright at 23 degrees), and
its middle at half height: about the glow around a sun in clear air."""


def shown(blocked: Floats) -> Floats:
    """Return the part (...,) of a change on the ground that is shown where bodies block a fraction `blocked`.

    It fades to nothing at `UNNOTICED`, so that a body changes a bounded part of the receiver.
    """
    return smoothstep(blocked, UNNOTICED, NOTICED)


def fraction_left(blocked: Floats, lost: Floats, whole: Floats) -> Floats:
    """Return the fraction (n, 3) of the ambient irradiance `whole` that is left on the ground without `lost`.

    blocked: (n,) fraction of uniform light that bodies block. `lost` and `whole` are sums over different pixels, so
    that under bodies that block all of a spotted sky more may be lost than there was: nothing is left then. Bodies that
    shine add `BRIGHTEST` times the plate's light at most.
    """
    left = 1.0 - shown(blocked)[:, None] * lost / np.maximum(whole, DARK)
    return np.asarray(np.clip(left, 0.0, BRIGHTEST))


@dataclass(frozen=True, slots=True, eq=False)
class BlockedLight:
    """What bodies block at n places. normal: (n, 3). weights: (n, NODES) float32 on the nodes of a sky table, all
    bodies together. share: (bodies, n) float32, fraction of uniform light that each blocks.
    """

    normal: Floats
    weights: NDArray[np.float32]
    share: NDArray[np.float32]

    def irradiance(self, table: Floats) -> Floats:
        """Return the irradiance (n, k) that is blocked of a sky with a table P (NODES, 3, k)."""
        if len(self.normal) and np.all(self.normal == self.normal[0]):
            return np.asarray(self.weights @ np.einsum("nck,c->nk", table, self.normal[0]).astype(np.float32), float)
        found = self.weights @ table.reshape(NODES, -1).astype(np.float32)
        return np.einsum("nck,nc->nk", found.reshape(len(found), *table.shape[1:]), self.normal)


def joined(parts: Sequence[BlockedLight]) -> BlockedLight:
    """Return what is blocked at the places of several parts, one after the other."""
    normal, weights = (np.concatenate([getattr(part, name) for part in parts]) for name in ("normal", "weights"))
    return BlockedLight(normal, weights, np.concatenate([part.share for part in parts], axis=1))


@dataclass(frozen=True, eq=False)
class Occluders(Parts):
    """Bodies that the ground sees. fields: m height fields. origin: (m, 3) places of their bodies' origins [m]."""

    fields: tuple[HeightField, ...]
    origin: Floats

    def blocked(self, points: Floats, normal: Floats) -> BlockedLight:
        """Return what the bodies block at places (n, 3) with normals (n, 3)."""
        points, normal = (np.ascontiguousarray(a, np.float64) for a in (points, normal))
        weights = np.zeros((len(points), NODES), np.float32)
        share = np.zeros((len(self.fields), len(points)), np.float32)
        if self.fields:
            _block(points, normal, self.origin, *self._packed, weights, share)
        return BlockedLight(normal, weights, share)

    def plans(self) -> Floats:
        """Return what `quadtree.survey` takes of the bodies, (m, 8)."""
        plans = np.zeros((len(self.fields), 8))
        for plan, field, origin in zip(plans, self.fields, self.origin, strict=True):
            plan[:6] = field.frame
            plan[:2] += origin[[0, 2]]
            plan[6:] = np.maximum(field.heights + origin[1], 0.0)
        return plans

    @cached_property
    def _packed(self) -> tuple[Any, Any, Any, Any, Any, Any, Any, Any]:
        """Arrays of the fields for `_block`; each field once, with the number (m,) of that of each body."""
        number = {id(field): k for k, field in enumerate({id(field): field for field in self.fields}.values())}
        fields = list({id(field): field for field in self.fields}.values())
        outlines, corners = np.zeros((len(fields), _MOST_CORNERS, 2)), np.zeros(len(fields), np.int64)
        for k, field in enumerate(fields):
            corners[k] = len(field.outline)
            outlines[k, : corners[k]] = field.outline
        of = np.array([number[id(field)] for field in self.fields])
        frame, heights, filled, cells = (
            np.array([getattr(field, name) for field in fields]) for name in ("frame", "heights", "filled", "cells")
        )
        return of, frame, heights, filled, np.array([field.opacity for field in fields]), outlines, corners, cells


@inlined
def _at_azimuth(begin: Any, azimuth: Any) -> Any:
    """Return the number of a body's azimuth within which another lies, -1 for none."""
    turn = azimuth - begin[0]
    turn -= 2.0 * np.pi * np.floor(turn / (2.0 * np.pi))
    place = turn / begin[1] if begin[1] > 0.0 else 1e9
    return int(place) if place < begin[2] else -1


@inlined
def _cut(piece: Any, low: Any, high: Any, begins: Any, blocked: Any, before: Any, azimuth: Any) -> Any:
    """Set the pieces of an interval that the bodies `before` leave at an azimuth; return how many there are."""
    piece[0, 0], piece[0, 1] = low, high
    pieces = 1
    for j in range(before):
        q = _at_azimuth(begins[j], azimuth)
        for i in range(2 if q >= 0 else 0):
            taken, until, share = blocked[j, q, 2 * i], blocked[j, q, 2 * i + 1], blocked[j, q, 4]
            middle = 0.5 * (taken + until)
            taken, until = middle + share * (taken - middle), middle + share * (until - middle)
            if until <= taken:
                continue
            for p in range(pieces):
                a, b = piece[p, 0], piece[p, 1]
                if taken < b and until > a:
                    if taken > a:
                        piece[p, 1] = taken
                        if until < b and pieces < _PIECES:
                            piece[pieces, 0], piece[pieces, 1] = until, b
                            pieces += 1
                    else:
                        piece[p, 0] = min(until, b)
    return pieces


@inlined
def _above_horizon(normal: Any, level: Any, low: Any, high: Any) -> Any:
    """Return the part of an interval of elevations above the horizon of a place with a normal (3,); level: what that
    has along the azimuth.
    """
    if normal[1] > 1e-9:
        low = max(low, np.arctan(-level / normal[1]))
    elif normal[1] < -1e-9:
        high = min(high, np.arctan(-level / normal[1]))
    elif level <= 0.0:
        high = low
    return low, high


@inlined
def _add_node(weights: Any, azimuth: Any, elevation: Any, factor: Any) -> None:
    """Add a factor to the weights (NODES,) of the four nodes about an azimuth and an elevation, linear in the azimuth
    and in the squared sine of the elevation, as even light on level ground is.
    """
    across = azimuth / (2.0 * np.pi) * ROWS - 0.5
    i = int(np.floor(across))
    u = across - i
    i = i % ROWS
    j = i + 1 if i + 1 < ROWS else 0
    along = min(max((elevation / np.pi + 0.5) * COLUMNS, 0.0), COLUMNS - 1e-6)
    e = int(along)
    low, high = np.sin((e / COLUMNS - 0.5) * np.pi) ** 2, np.sin(((e + 1) / COLUMNS - 0.5) * np.pi) ** 2
    v = (np.sin(elevation) ** 2 - low) / (high - low)
    i, j = i * (COLUMNS + 1) + e, j * (COLUMNS + 1) + e
    weights[i] += factor * (1.0 - u) * (1.0 - v)
    weights[i + 1] += factor * (1.0 - u) * v
    weights[j] += factor * u * (1.0 - v)
    weights[j + 1] += factor * u * v


@inlined
def _add(normal: Any, begins: Any, blocked: Any, m: Any, before: Any, piece: Any, weights: Any) -> Any:
    """Add what the m-th body blocks behind those `before` to weights (NODES,); return its share of uniform light."""
    share, first, step = 0.0, begins[m, 0], begins[m, 1]
    for number in range(2 * int(begins[m, 2])):
        q, part = number // 2, 2 * (number & 1)
        low, high, filled = blocked[m, q, part], blocked[m, q, part + 1], blocked[m, q, 4]
        if filled <= 0.0 or high <= low:
            continue
        azimuth = first + (q + 0.5) * step
        level = normal[0] * np.cos(azimuth) + normal[2] * np.sin(azimuth)
        low, high = _above_horizon(normal, level, low, high)
        for p in range(_cut(piece, low, high, begins, blocked, before, azimuth)):
            a, b = piece[p, 0], piece[p, 1]
            if b > a:
                _add_node(weights, azimuth, b, filled * step)
                _add_node(weights, azimuth, a, -filled * step)
                sine, other = np.sin(b), np.sin(a)
                upward = sine * sine - other * other
                beside = b - a + sine * np.cos(b) - other * np.cos(a)
                share += filled * step * (normal[1] * upward + level * beside) / (2.0 * np.pi)
    return share


@fast
def _block(
    point: Any, normal: Any, origin: Any, of: Any, frame: Any, heights: Any, filled: Any, opacity: Any, outline: Any,
    corners: Any, cells: Any, weights: Any, share: Any,
) -> None:  # fmt: skip
    """Add the weights (n, NODES) and set the shares (m, n) of bodies at places (n, 3); the fields are those of `of`."""
    begins, blocked = np.zeros((len(origin) + 1, 3)), np.zeros((len(origin) + 1, AZIMUTHS, 5))
    piece, found = np.zeros((_PIECES, 2)), np.zeros((2, 2))
    near, far = np.zeros((2, len(origin)), np.int64)
    for k in range(len(point)):
        scanned, others = 0, 0
        for m in range(len(origin)):
            f = of[m]
            x, y, z = point[k, 0] - origin[m, 0], point[k, 1] - origin[m, 1], point[k, 2] - origin[m, 2]
            a, b, seen, close = place_beside(x, y, z, frame[f], heights[f, 1])
            if seen and close:
                edges = outline[f, : corners[f]]
                scan(a, b, y, frame[f], edges, cells[f], heights[f], begins[scanned], blocked[scanned], found)
                near[scanned] = m
                scanned += 1
            elif seen:
                far[others] = m
                others += 1
        for n in range(scanned + others):
            m, slot = near[n] if n < scanned else far[n - scanned], min(n, scanned)
            f = of[m]
            if n >= scanned:
                x, y, z = point[k, 0] - origin[m, 0], point[k, 1] - origin[m, 1], point[k, 2] - origin[m, 2]
                a, b, _, _ = place_beside(x, y, z, frame[f], heights[f, 1])
                edges = outline[f, : corners[f]]
                as_rectangle(a, b, y, frame[f], edges, heights[f], filled[f], begins[slot], blocked[slot])
            if opacity[f] < 1.0:
                blocked[slot, :, 4] *= opacity[f]
            share[m, k] = _add(normal[k], begins, blocked, slot, slot, piece, weights[k])


def sky_table(environment: Environment) -> Floats:
    """Return P (NODES, 3, 3), component and channel, of the environment without its sun."""
    map_ = environment.residual
    light = _lookup(map_.shape) @ map_.reshape(-1, 3)
    return _table_of(np.asarray(light).reshape(_FINER * ROWS, _FINER * COLUMNS, 3))


@functools.cache
def glow_table() -> Floats:
    """Return the upward component of P (NODES, 5) of uniform light and of four skies that glow on one side.

    Each has an irradiance of pi on level ground. What bodies block of them bends where it does in other smooth light.
    """
    d, _ = _directions()
    light = np.ones((*d.shape[:2], 5))
    for k, (x, z) in enumerate(((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))):
        towards = np.maximum(d @ [x * _GLOW_SIDE, _GLOW_SIDE, z * _GLOW_SIDE], 0.0)
        light[..., k + 1] += _GLOW * towards**_GLOW_POWER
    table = _table_of(light)[:, 1].reshape(ROWS, COLUMNS + 1, 5)
    whole = (table[:, -1] - table[:, COLUMNS // 2]).sum(axis=0) * (2.0 * np.pi / ROWS)
    return np.asarray(table * (np.pi / whole)).reshape(NODES, 5)


def _table_of(light: Floats) -> Floats:
    """Return P (NODES, 3, k) of radiances (_FINER ROWS, _FINER COLUMNS, k)."""
    cells = _directions()[1][..., None] * light[:, :, None, :]
    rows = cells.reshape(ROWS, _FINER, *cells.shape[1:]).mean(axis=1)
    table = np.zeros((ROWS, COLUMNS + 1, 3, light.shape[-1]))
    table[:, 1:] = np.cumsum(rows, axis=1)[:, _FINER - 1 :: _FINER]
    return table.reshape(NODES, 3, -1)


@functools.cache
def _lookup(shape: tuple[int, ...]) -> Any:
    """Return the lookup of the cells in maps of a shape (H, W, 3)."""
    return lookup_matrix(shape, _directions()[0].reshape(-1, 3))


@functools.cache
def _directions() -> tuple[Floats, Floats]:
    """Return the middles of the cells, and the same times their solid angle over a row."""
    rows, columns = _FINER * ROWS, _FINER * COLUMNS
    azimuth = (np.arange(rows) + 0.5) * 2.0 * np.pi / rows
    elevation = ((np.arange(columns) + 0.5) / columns - 0.5) * np.pi
    e, a = np.meshgrid(elevation, azimuth)
    d = np.stack([np.cos(e) * np.cos(a), np.sin(e), np.cos(e) * np.sin(a)], axis=-1)
    return d, d * (np.cos(e) * np.pi / columns)[..., None]
