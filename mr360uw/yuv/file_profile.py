# SPDX-License-Identifier: Apache-2.0
"""The map between a picture's values and light that its file names: an ICC profile, or chromaticities and a curve.

Profiles of a matrix and curves are evaluated from their tags, in floats, so that pictures of 16 bits keep all of them.
Those of tables: `profile_tables`. Tags: ICC.1:2022, sections 9 and 10.
"""

from __future__ import annotations

import functools
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.color import PlateMapping, encode, rec709_from_chromaticities, rec709_from_xyz
from mr360uw.yuv.profile_tables import TableProfile, table_profile

Array = NDArray[np.float64]

REC709_XY = (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329)
"""x, y of red, green, blue and white (ITU-R BT.709-6): the primaries of all linear light here."""
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

    @property
    def on_file_codes(self) -> bool:
        """Whether values are codes over full scale: those of pictures, whose range is full, are the same."""
        return False

    @property
    def is_wide(self) -> bool:
        """Whether light may be above white; the brightest code of a picture is white."""
        return False

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


@functools.lru_cache(maxsize=4)
def icc_profile(data: bytes) -> PlateMapping | None:
    """Return the map of an ICC profile of RGB or grey pictures; None for that of sRGB, to a quarter of an 8-bit code.

    Raises `ValueError` with the reason where it cannot be read.
    """
    try:
        found = _matrix_and_curves(data) or table_profile(data, _tags(data), lambda tag: _curve(tag).to_light)
    except (struct.error, IndexError, np.linalg.LinAlgError, UnicodeDecodeError) as error:
        raise ValueError("a broken profile") from error
    if isinstance(found, TableProfile):
        return found
    steps = np.linspace(0.0, 1.0, 5)
    values = np.stack(np.meshgrid(steps, steps, steps), axis=-1)
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
            return ToneCurve(struct.unpack_from(">H", tag, 12)[0] / 256.0 if count else 1.0)
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
