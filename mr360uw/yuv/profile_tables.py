# SPDX-License-Identifier: Apache-2.0
"""The tables of an ICC profile as a map to light, in floats: pictures of 16 bits keep all of them.

Kinds of tables: lut8, lut16 and lutAToB (ICC.1:2022, 10.10 to 10.12), from RGB to CIE XYZ or CIE L*a*b* under D50.
"""

from __future__ import annotations

import hashlib
import math
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.color import encode, rec709_from_xyz
from mr360uw.yuv.cube_lut import LutTable

Array = NDArray[np.float64]
Curve = Callable[[Array], Array]

_D50 = np.array([0.9642, 1.0, 0.8249])
_WHOLE_XYZ = 1.0 + 32767.0 / 32768.0
"""Largest value of an XYZ table (6.3.4.2)."""
_NODES = 33
"""Samples along each channel, behind the first curves, of the table by which values are found from light."""
_CORRECTIONS = 3
"""Times that values found from light are put right by their own light: each leaves a tenth of the error or less."""
_CURVE_NODES = 4096


@dataclass(frozen=True)
class TableProfile:
    """The map of a profile's tables; see `color.PlateMapping`.

    digest: of the profile. first: curves of the values. steps: what follows, to linear Rec.709. light: (33, 33, 33, 3)
    the light of a grid behind the first curves, as sRGB, by which values are looked for.
    """

    digest: str
    first: LutTable = field(compare=False)
    steps: tuple[Curve, ...] = field(compare=False)
    light: LutTable = field(compare=False)
    on_file_codes: bool = False
    is_wide: bool = False

    def to_light(self, values: NDArray[Any]) -> Array:
        """Return the linear Rec.709 light (..., 3) of values (..., 3)."""
        found = self.first.forward(np.asarray(values, np.float64).reshape(-1, 3))
        return _followed(self.steps, found).reshape(values.shape)

    def to_values(self, light: NDArray[Any]) -> Array:
        """Return the values (..., 3) of linear Rec.709 light (..., 3), the closest of light that no value has."""
        wanted = np.asarray(encode(np.asarray(light, np.float64).reshape(-1, 3), "srgb"), np.float64)
        about = wanted
        for _ in range(_CORRECTIONS):
            found = self.light.inverse(about)
            about = about + wanted - encode(_followed(self.steps, found), "srgb")
        return self.first.inverse(self.light.inverse(about)).reshape(light.shape)


def _followed(steps: Sequence[Curve], values: Array) -> Array:
    for step in steps:
        values = step(values)
    return values


def table_profile(data: bytes, tags: Mapping[bytes, bytes], curve: Callable[[bytes], Curve]) -> TableProfile:
    """Return the map of a profile's tables, those for relative colours where it has some.

    data: the profile; tags: its tags by their signatures. curve: returns the function of a tag of kind curv or para.
    Raises `ValueError` for tables of another kind.
    """
    tag = tags.get(b"A2B1", tags.get(b"A2B0", b""))
    if tag[:4] not in (b"mft1", b"mft2", b"mAB ") or tag[8:10] != b"\3\3":
        raise ValueError("tables of a kind that is not known")
    first, steps = _packed(tag, curve) if tag.startswith(b"mAB ") else _plain(tag)
    # Go on from the profile's XYZ or L*a*b* to light
    matrix, old = rec709_from_xyz(_D50).T, tag.startswith(b"mft2")
    if data[20:24] == b"XYZ ":
        steps.append(lambda codes: codes * _WHOLE_XYZ @ matrix)
    else:
        steps.append(lambda codes: _xyz_of_lab(codes, old=old) @ matrix)
    # Sample it, for the way back
    axis = np.linspace(0.0, 1.0, _NODES)
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)
    light = np.asarray(encode(_followed(steps, grid.reshape(-1, 3)).reshape(grid.shape), "srgb"), np.float64)
    if not np.all(np.isfinite(light)):
        raise ValueError("a broken profile")
    unit = np.zeros(3), np.ones(3)
    return TableProfile(
        hashlib.sha256(data).hexdigest(),
        LutTable(first, *unit),
        tuple(steps),
        LutTable(np.ascontiguousarray(light), *unit),
    )


def _plain(tag: bytes) -> tuple[Array, list[Curve]]:
    """Return the first curves (n, 3) of a tag of kind lut8 or lut16, and the steps behind them."""
    grid, wide = tag[10], tag.startswith(b"mft2")
    entries, exits = struct.unpack_from(">2H", tag, 48) if wide else (256, 256)
    counts = 3 * entries, 3 * grid**3, 3 * exits
    kind = np.dtype(">u2" if wide else "u1")
    values = np.frombuffer(tag, kind, sum(counts), 52 if wide else 48) / np.iinfo(kind).max
    first, cube, last = np.split(values, np.cumsum(counts)[:2])
    steps = _table(cube.reshape(grid, grid, grid, 3)), _table(last.reshape(3, exits).T)
    return first.reshape(3, entries).T, list(steps)


def _packed(tag: bytes, curve: Callable[[bytes], Curve]) -> tuple[Array, list[Curve]]:
    """Return the first curves (n, 3) of a tag of kind lutAToB, and the steps behind them."""
    b, matrix, m, cube, a = struct.unpack_from(">5I", tag, 12)
    x = np.linspace(0.0, 1.0, _CURVE_NODES)
    groups = [_curves(tag, place, curve) for place in (a, m, b) if place]
    # The curves that stand first are sampled; without a cube in between all others follow at once
    first = groups[0](np.repeat(x[:, None], 3, axis=1))
    steps = groups[1:]
    if cube:
        grid, wide = tuple(tag[cube : cube + 3]), tag[cube + 16] == 2
        kind = np.dtype(">u2" if wide else "u1")
        values = np.frombuffer(tag, kind, 3 * math.prod(grid), cube + 20) / np.iinfo(kind).max
        if len(set(grid)) != 1:
            raise ValueError("a table of unlike sides")
        steps.insert(0, _table(values.reshape(*grid, 3)))
    if matrix:
        terms = np.array(struct.unpack_from(">12i", tag, matrix)) / 65536.0
        steps.insert(len(steps) - (1 if a or m else 0), lambda v: v @ terms[:9].reshape(3, 3).T + terms[9:])
    return np.clip(first, 0.0, 1.0), steps


def _curves(tag: bytes, place: int, curve: Callable[[bytes], Curve]) -> Curve:
    """Return the function of the three curves that lie one behind the other at a place, each on a multiple of 4."""
    found = []
    for _ in range(3):
        found.append(curve(tag[place:]))
        size = (12 + 2 * struct.unpack_from(">I", tag, place + 8)[0]) if tag[place : place + 4] == b"curv" else (
            12 + 4 * (1, 3, 4, 5, 7)[struct.unpack_from(">H", tag, place + 8)[0]])  # fmt: skip
        place += -(-size // 4) * 4
    return lambda values: np.stack([one(values[:, k]) for k, one in enumerate(found)], axis=-1)


def _table(values: Array) -> Curve:
    """Return the function of a table (n, 3) or (n, n, n, 3) over [0, 1]."""
    return LutTable(np.ascontiguousarray(values, np.float64), np.zeros(3), np.ones(3)).forward


def _xyz_of_lab(values: Array, *, old: bool) -> Array:
    """Return XYZ of coded L*a*b* (m, 3), of which `old` is the code of lut16 tables (6.3.4.2 and 10.11)."""
    codes = values * (65535.0 / 65280.0 if old else 1.0)
    lightness, a, b = codes[:, 0] * 100.0, codes[:, 1] * 255.0 - 128.0, codes[:, 2] * 255.0 - 128.0
    y = (lightness + 16.0) / 116.0
    roots = np.stack([y + a / 500.0, y, y - b / 200.0], axis=-1)
    edge = 6.0 / 29.0
    return _D50 * np.where(roots > edge, roots**3, 3.0 * edge**2 * (roots - 4.0 / 29.0))
