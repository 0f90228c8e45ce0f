# SPDX-License-Identifier: Apache-2.0
"""The map between a picture's values and light that its file names: an ICC profile, or chromaticities and a curve.

Profiles of a matrix and curves are evaluated from their tags, in floats, so that pictures of 16 bits keep all of them.
Those of tables: `profile_tables`. Tags: ICC.1:2022, sections 9 and 10.
"""

from __future__ import annotations

import hashlib
import math
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.cache import shared
from mr360uw.base.color import REC709_XY, PlateMapping, encode, rec709_from_chromaticities, rec709_from_xyz
from mr360uw.yuv.ocio_transform import cube_function, unit_grid

Array = NDArray[np.float64]

_SAME_XY = 1e-3
"""Difference of chromaticities that are written with three digits or more, below which they are the same."""
_SAME_CODE = 1e-3
"""Difference of values of 0 to 1, a quarter of an 8-bit code, below which a profile is that of sRGB."""


@dataclass(frozen=True, slots=True)
class ToneCurve:
    """A curve from values to light, odd about zero: a table over [0, 1], or, without one, (a x + b)^g + e from x = d on
    and c x + f below.
    """

    gamma: float = 1.0
    a: float = 1.0
    b: float = 0.0
    c: float = 0.0
    d: float = 0.0
    e: float = 0.0
    f: float = 0.0
    table: tuple[float, ...] = ()

    def to_light(self, values: Array) -> Array:
        """Return the light of values."""
        x = np.abs(values)
        if self.table:
            light = np.interp(x, np.linspace(0.0, 1.0, len(self.table)), self.table)
        else:
            power = np.maximum(self.a * x + self.b, 0.0) ** self.gamma + self.e
            light = np.where(x >= self.d, power, self.c * x + self.f)
        return np.copysign(light, values)

    def to_values(self, light: Array) -> Array:
        """Return the values of light, the inverse of `to_light`."""
        y = np.abs(light)
        if self.table:
            rising = np.maximum.accumulate(self.table)
            values = np.interp(y, rising, np.linspace(0.0, 1.0, len(self.table)))
        else:
            power = (np.maximum(y - self.e, 0.0) ** (1.0 / self.gamma) - self.b) / self.a
            below = (y - self.f) / self.c if self.c else np.zeros_like(y)
            knee = max(self.a * self.d + self.b, 0.0) ** self.gamma + self.e
            values = np.where(y >= knee, power, np.minimum(below, self.d))
        return np.copysign(np.maximum(values, 0.0), light)


SRGB = ToneCurve(2.4, 1.0 / 1.055, 0.055 / 1.055, 1.0 / 12.92, 0.04045)
"""The curve of IEC 61966-2-1."""


@dataclass(frozen=True, slots=True)
class FileProfile:
    """The map of a matrix and a curve for each channel; see `color.PlateMapping`.

    matrix: rows of the (3, 3) matrix from the file's light to linear Rec.709. xy: x and y of red, green, blue and white
    where the file states these and nothing else, else empty.
    """

    matrix: tuple[tuple[float, ...], ...]
    curves: tuple[ToneCurve, ToneCurve, ToneCurve]
    xy: tuple[float, ...] = ()
    on_file_codes: bool = False
    is_wide: bool = False

    def to_light(self, values: NDArray[Any]) -> Array:
        """Return the linear Rec.709 light (..., 3) of values (..., 3)."""
        own = np.asarray(values, np.float64)
        light = np.stack([curve.to_light(own[..., k]) for k, curve in enumerate(self.curves)], axis=-1)
        return np.asarray(light @ np.array(self.matrix).T)

    def to_values(self, light: NDArray[Any]) -> Array:
        """Return the values (..., 3) of linear Rec.709 light (..., 3)."""
        own = np.asarray(light, np.float64) @ np.linalg.inv(np.array(self.matrix)).T
        return np.stack([curve.to_values(own[..., k]) for k, curve in enumerate(self.curves)], axis=-1)


def _profile(matrix: Array, curves: Sequence[ToneCurve], xy: tuple[float, ...] = ()) -> FileProfile:
    red, green, blue = curves
    return FileProfile(tuple(map(tuple, matrix.tolist())), (red, green, blue), xy)


def linear_profile(matrix: Array, gain: Array) -> FileProfile:
    """Return the map of linear values by a (3, 3) matrix to linear Rec.709; gain (3,): by which they are too weak."""
    if not np.all(np.isfinite(gain) & (gain > 0.0)):
        raise ValueError("an exposure of 0 or less")
    return _profile(matrix * gain, [ToneCurve()] * 3)


def chromatic_profile(
    xy: Sequence[float], curve: ToneCurve | None = None, gain: Array | None = None
) -> FileProfile | None:
    """Return the map of chromaticities, x and y of red, green, blue and white; None where it changes nothing.

    curve: of the values, by default they are linear. gain: (3,) see `linear_profile`. Raises `ValueError` where no
    light has such primaries.
    """
    known, stronger = np.asarray(xy, np.float64), gain is not None and bool(np.any(gain != 1.0))
    plain = known.shape == (8,) and bool(np.all(np.abs(known - REC709_XY) < _SAME_XY))
    if plain and curve is None and not stronger:
        return None
    try:
        with np.errstate(all="ignore"):
            matrix = np.eye(3) if plain else rec709_from_chromaticities(known.reshape(4, 2))
            usable = bool(np.all(np.isfinite(np.linalg.inv(matrix))))
    except (np.linalg.LinAlgError, ValueError):
        usable = False
    if not usable:
        raise ValueError("primaries that no light has")
    if stronger and gain is not None:
        return linear_profile(matrix, gain)
    return _profile(matrix, [curve or ToneCurve()] * 3, tuple(known.tolist()) if curve is None else ())


@shared(keep=4)
def icc_profile(data: bytes) -> PlateMapping | None:
    """Return the map of an ICC profile of RGB or grey pictures; None for that of sRGB, to a quarter of an 8-bit code.

    Raises `ValueError` with the reason where it cannot be read.
    """
    try:
        found = _matrix_and_curves(data) or table_profile(data)
    except (struct.error, IndexError, np.linalg.LinAlgError, UnicodeDecodeError) as error:
        raise ValueError("a broken profile") from error
    if isinstance(found, TableProfile):
        return found
    values = unit_grid(5)
    greys = np.repeat(np.linspace(0.0, 1.0, 256)[:, None], 3, axis=1)
    shown = [np.abs(encode(found.to_light(some), "srgb") - some).max() for some in (values, greys)]
    if not np.all(np.isfinite(found.to_values(found.to_light(values)))):
        raise ValueError("a broken profile")
    return None if max(shown) < _SAME_CODE else found


def icc_name(data: bytes) -> str:
    """Return the description of an ICC profile, "ICC profile" where it has none that can be read."""
    try:
        text = _tags(data).get(b"desc", b"")
        if text.startswith(b"desc"):
            name = text[12 : 12 + struct.unpack_from(">I", text, 8)[0]].split(b"\0")[0].decode("ascii")
        else:
            length, at = struct.unpack_from(">II", text, 20)
            name = text[at : at + length].decode("utf-16-be").split("\0")[0]
    except (struct.error, UnicodeDecodeError, IndexError):
        return "ICC profile"
    return name.strip() or "ICC profile"


def _tags(data: bytes) -> dict[bytes, bytes]:
    """Return the tags of a profile by their signatures."""
    (count,) = struct.unpack_from(">I", data, 128)
    entries = (struct.unpack_from(">4sII", data, 132 + 12 * k) for k in range(min(count, 200)))
    return {name: data[at : at + size] for name, at, size in entries}


def _matrix_and_curves(data: bytes) -> FileProfile | None:
    """Return the map of a profile's matrix and curves, or of a grey one's curve; None where it has tables alone."""
    tags, kind = _tags(data), data[16:20]
    if kind == b"GRAY" and b"kTRC" in tags:
        return _profile(np.eye(3), [_curve(tags[b"kTRC"])] * 3)
    if kind != b"RGB ":
        raise ValueError(f"a profile of {kind.decode('latin-1').strip() or 'no colours'}")
    names = ("r", "g", "b")
    if not all(f"{one}XYZ".encode() in tags and f"{one}TRC".encode() in tags for one in names):
        return None
    columns = [struct.unpack_from(">3i", tags[f"{one}XYZ".encode()], 8) for one in names]
    xyz = np.array(columns, np.float64).T / 65536.0
    curves = [_curve(tags[f"{one}TRC".encode()]) for one in names]
    # The sum of the colorants is the white: D50 by the standard, that of the display in some old profiles
    return _profile(rec709_from_xyz(xyz.sum(axis=1)) @ xyz, curves)


def _curve(tag: bytes) -> ToneCurve:
    """Return the curve of a tag of kind curv or para (ICC.1:2022, 10.6 and 10.18)."""
    if tag.startswith(b"curv"):
        (count,) = struct.unpack_from(">I", tag, 8)
        if count < 2:
            (gamma,) = struct.unpack_from(">H", tag, 12) if count else (256,)
            if gamma == 0:
                raise ValueError("a broken profile")
            return ToneCurve(gamma / 256.0)
        table = np.frombuffer(tag, ">u2", count, 12) if len(tag) >= 12 + 2 * count else np.zeros(0)
        if not len(table) or table[0] == table[-1]:
            raise ValueError("a broken profile")
        return ToneCurve(table=tuple((table / 65535.0).tolist()))
    (kind,) = struct.unpack_from(">H", tag, 8)
    if not tag.startswith(b"para") or kind > 4:
        raise ValueError("a curve of a kind that is not known")
    number = (1, 3, 4, 5, 7)[kind]
    g, a, b, c, d, e, f = [v / 65536.0 for v in struct.unpack_from(f">{number}i", tag, 12)] + [0.0] * (7 - number)
    if g <= 0.0 or (kind and a == 0.0):
        raise ValueError("a broken profile")
    if kind == 0:
        return ToneCurve(g)
    if kind < 3:
        return ToneCurve(g, a, b, 0.0, -b / a, c if kind == 2 else 0.0, c if kind == 2 else 0.0)
    return ToneCurve(g, a, b, c, d, e, f)


# The tables of an ICC profile as a map to light, in floats: pictures of 16 bits keep all of them.
#
# Kinds of tables: lut8, lut16 and lutAToB (ICC.1:2022, 10.10 to 10.12), from RGB to CIE XYZ or CIE L*a*b* under D50.

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

    digest: of the profile. first: curves (n, 3) of the values. steps: what follows, to linear Rec.709. inverse: of the
    steps, by a grid of 33 x 33 x 33: from light, as sRGB, to values behind the first curves.
    """

    digest: str
    first: Array = field(compare=False)
    steps: tuple[Curve, ...] = field(compare=False)
    inverse: Curve = field(compare=False)
    on_file_codes: bool = False
    is_wide: bool = False

    def to_light(self, values: NDArray[Any]) -> Array:
        """Return the linear Rec.709 light (..., 3) of values (..., 3)."""
        found = _table(self.first)(np.asarray(values, np.float64).reshape(-1, 3))
        return _followed(self.steps, found).reshape(values.shape)

    def to_values(self, light: NDArray[Any]) -> Array:
        """Return the values (..., 3) of linear Rec.709 light (..., 3), the closest of light that no value has."""
        wanted = np.asarray(encode(np.asarray(light, np.float64).reshape(-1, 3), "srgb"), np.float64)
        about = wanted
        for _ in range(_CORRECTIONS):
            found = self.inverse(about)
            about = about + wanted - encode(_followed(self.steps, found), "srgb")
        found = self.inverse(about)
        axis, rising = np.linspace(0.0, 1.0, len(self.first)), np.maximum.accumulate(self.first)
        values = np.stack([np.interp(found[:, c], rising[:, c], axis) for c in range(3)], axis=-1)
        return values.reshape(light.shape)


def _followed(steps: Sequence[Curve], values: Array) -> Array:
    for step in steps:
        values = step(values)
    return values


def table_profile(data: bytes) -> TableProfile:
    """Return the map of a profile's tables, those for relative colours where it has some.

    Raises `ValueError` for tables of another kind.
    """
    tags = _tags(data)
    tag = tags.get(b"A2B1", tags.get(b"A2B0", b""))
    if tag[:4] not in (b"mft1", b"mft2", b"mAB ") or tag[8:10] != b"\3\3":
        raise ValueError("tables of a kind that is not known")
    first, steps = _packed(tag) if tag.startswith(b"mAB ") else _plain(tag)
    # Go on from the profile's XYZ or L*a*b* to light
    matrix, old = rec709_from_xyz(_D50).T, tag.startswith(b"mft2")
    if data[20:24] == b"XYZ ":
        steps.append(lambda codes: codes * _WHOLE_XYZ @ matrix)
    else:
        steps.append(lambda codes: _xyz_of_lab(codes, old=old) @ matrix)
    # Sample it, for the way back
    sampled = _followed(steps, unit_grid(_NODES)).reshape(_NODES, _NODES, _NODES, 3)
    light = np.asarray(encode(sampled, "srgb"), np.float64)
    if not np.all(np.isfinite(light)):
        raise ValueError("a broken profile")
    return TableProfile(hashlib.sha256(data).hexdigest(), first, tuple(steps), cube_function(light, inverse=True))


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


def _packed(tag: bytes) -> tuple[Array, list[Curve]]:
    """Return the first curves (n, 3) of a tag of kind lutAToB, and the steps behind them."""
    b, matrix, m, cube, a = struct.unpack_from(">5I", tag, 12)
    x = np.linspace(0.0, 1.0, _CURVE_NODES)
    groups = [_curves(tag, place) for place in (a, m, b) if place]
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


def _curves(tag: bytes, place: int) -> Curve:
    """Return the function of the three curves that lie one behind the other at a place, each on a multiple of 4."""
    found = []
    for _ in range(3):
        found.append(_curve(tag[place:]).to_light)
        size = (12 + 2 * struct.unpack_from(">I", tag, place + 8)[0]) if tag[place : place + 4] == b"curv" else (
            12 + 4 * (1, 3, 4, 5, 7)[struct.unpack_from(">H", tag, place + 8)[0]])  # fmt: skip
        place += -(-size // 4) * 4
    return lambda values: np.stack([one(values[:, k]) for k, one in enumerate(found)], axis=-1)


def _table(values: Array) -> Curve:
    """Return the function of a table (n, 3) or (n, n, n, 3) over [0, 1]."""
    if values.ndim == 4:
        return cube_function(values)
    axis = np.linspace(0.0, 1.0, len(values))
    return lambda x: np.stack([np.interp(x[:, c], axis, values[:, c]) for c in range(3)], axis=-1)


def _xyz_of_lab(values: Array, *, old: bool) -> Array:
    """Return XYZ of coded L*a*b* (m, 3), of which `old` is the code of lut16 tables (6.3.4.2 and 10.11)."""
    codes = values * (65535.0 / 65280.0 if old else 1.0)
    lightness, a, b = codes[:, 0] * 100.0, codes[:, 1] * 255.0 - 128.0, codes[:, 2] * 255.0 - 128.0
    y = (lightness + 16.0) / 116.0
    roots = np.stack([y + a / 500.0, y, y - b / 200.0], axis=-1)
    edge = 6.0 / 29.0
    return _D50 * np.where(roots > edge, roots**3, 3.0 * edge**2 * (roots - 4.0 / 29.0))
