# SPDX-License-Identifier: Apache-2.0
"""Lookup tables that map a plate's R'G'B' values to a display picture or to light, and their inverse.

A table has one stage or two: curves of one channel each (n, 3), and a cube (n, n, n, 3), whose axes are red, green,
blue. Values outside a stage's domain are held at its edge. Curves are interpolated linearly, cubes by tetrahedra
(`cube_kernels`). What comes out is in the space `to`: an encoded display picture, or linear light, of Rec.709.

The inverse is that of the interpolated table. A value that the table lacks gets the code of the closest that it has.
Where the table clips, many codes have one value, and the inverse gives the one that is closest to the middle.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise, permutations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.color import DisplayTransfer, Levels, decode, encode
from mr360uw.base.input_files import read_text
from mr360uw.errors import VideoError

Array = NDArray[np.float64]

_EXACT = 1e-9
"""Distance of values at which the inverse is found, of the table's range: far below any code."""

_GREYS = 1001  # values at which clipping is looked for, for a note of three digits


@dataclass(frozen=True, eq=False)
class LutTable:
    """One table: (n, 3) of curves, or (n, n, n, 3). low, high: (3,) ends of its domain."""

    table: Array
    low: Array
    high: Array

    @property
    def is_cube(self) -> bool:
        """Whether the table mixes channels."""
        return self.table.ndim == 4

    @cached_property
    def diagonal(self) -> Array:
        """The values (n, 3) for equal positions in all channels, made to rise."""
        n = np.arange(len(self.table))
        return np.maximum.accumulate(self.table[n, n, n] if self.is_cube else self.table, axis=0)

    @property
    def span(self) -> float:
        """The range of the values."""
        return float(np.ptp(self.table)) or 1.0

    def forward(self, values: Array) -> Array:
        """Return the stage's output (m, 3) of input (m, 3)."""
        last = len(self.table) - 1
        x = np.clip((values - self.low) / (self.high - self.low), 0.0, 1.0) * last
        if not self.is_cube:
            places = np.arange(last + 1)
            return np.stack([np.interp(x[:, c], places, self.table[:, c]) for c in range(3)], axis=-1)
        from mr360uw.yuv.cube_kernels import interpolate

        out = np.empty_like(x)
        interpolate(self.table, x, out)
        return out

    def inverse(self, wanted: Array) -> Array:
        """Return the input (m, 3) of output (m, 3)."""
        last = len(self.table) - 1
        x = np.stack([_risen(wanted[:, c], self.diagonal[:, c]) for c in range(3)], axis=-1)
        if self.is_cube:
            from mr360uw.yuv.cube_kernels import invert

            reached = np.clip(wanted, self.table.min(axis=(0, 1, 2)), self.table.max(axis=(0, 1, 2)))
            invert(self.table, reached, _EXACT * self.span, x)
        return self.low + x / last * (self.high - self.low)


@dataclass(frozen=True)
class CubeLut:
    """The mapping of a table to light; see `color.ColorSpec`.

    stages: applied one after the other. to: space of the last one's output. digest: of the file's bytes.
    on_file_codes: whether the input is codes over full scale. is_wide: see `color.PlateMapping`.
    """

    stages: tuple[LutTable, ...] = field(compare=False)
    digest: str
    to: DisplayTransfer
    on_file_codes: bool
    is_wide: bool = True

    def to_light(self, values: NDArray[Any]) -> Array:
        """Return the linear Rec.709 light (..., 3) of values (..., 3)."""
        found = np.asarray(values, np.float64).reshape(-1, 3)
        for stage in self.stages:
            found = stage.forward(found)
        return np.asarray(decode(found, self.to), np.float64).reshape(values.shape)

    def to_values(self, light: NDArray[Any]) -> Array:
        """Return the values (..., 3) of linear Rec.709 light (..., 3), within the table's domain."""
        found = np.asarray(encode(np.asarray(light, np.float64), self.to)).reshape(-1, 3)
        for stage in reversed(self.stages):
            found = stage.inverse(found)
        return found.reshape(light.shape)


def clipped_greys(lut: CubeLut) -> str:
    """Return the ranges of grey input that a table clips to black or white, in words; "" where it clips none."""
    first = lut.stages[0]
    part = np.linspace(0.0, 1.0, _GREYS)[:, None]
    light = lut.to_light(first.low + part * (first.high - first.low))
    grey = (first.low + part * (first.high - first.low)).max(axis=1)
    black = np.flatnonzero(np.all(light <= light[0], axis=1))[-1]
    white = np.flatnonzero(np.all(light >= light[-1], axis=1))[0]
    ends = [f"below {grey[black]:.3g}"] * int(black > 0) + [f"above {grey[white]:.3g}"] * int(white < _GREYS - 1)
    return " and ".join(ends)


def _risen(wanted: Array, curve: Array) -> Array:
    """Return the positions (m,) at which a curve (n,) that does not fall has the values wanted (m,).

    Where it is flat, at its foot the last position, at its head the first.
    """
    last = np.flatnonzero(curve <= curve[0])[-1]
    first = np.flatnonzero(curve >= curve[-1])[0]
    if first <= last:
        return np.full(wanted.shape, 0.5 * (len(curve) - 1))
    kept = np.arange(last, first + 1)
    steady = np.concatenate([[True], np.diff(curve[kept]) > 0.0])
    return np.interp(wanted, curve[kept][steady], kept[steady])


# Reads .cube lookup tables and checks that they can be inverted.
#
# Formats: Adobe's Cube LUT Specification 1.0, and Resolve's with input ranges and a 1D table before the cube. A table
# is refused where it is not monotonic, or where colours that are not clipped become equal: the output's light could
# then not be written as the plate's codes.

_MOST = {"LUT_1D_SIZE": 65536, "LUT_3D_SIZE": 256}  # of the specification
_COUNTS = {"DOMAIN_MIN": 3, "DOMAIN_MAX": 3, "LUT_1D_INPUT_RANGE": 2, "LUT_3D_INPUT_RANGE": 2}
"""Numbers after each keyword of a domain."""
_LARGEST = 65504.0
"""Largest value of a table or a domain: that of a half float, which no picture's light exceeds."""
_FLAT = 1e-7
"""Step of a value, of the table's range, below which it does not change: files have 6 digits. Ten times as large, steep
log tables would seem flat near black."""


def read_cube(path: Path, to: DisplayTransfer, levels: Levels) -> CubeLut:
    """Return the lookup table of a .cube file; VideoError where the file is damaged or cannot be inverted.

    to: encoding of its output. levels: "video": its input is 0 at black and 1 at white; "data": 1 is full scale.
    """
    text = read_text(path, VideoError)
    stages = tuple(_stages(path, *_parsed(path, text)))
    for stage in stages:
        _check_values(path, stage)
        _check_invertible(path, stage)
    return CubeLut(stages, hashlib.sha256(text.encode()).hexdigest(), to, levels == "data")


def _parsed(path: Path, text: str) -> tuple[dict[str, list[float]], Array]:
    """Return the numbers after each keyword of a file, and its rows (n, 3)."""
    found: dict[str, list[float]] = {}
    rows: list[float] = []
    for number, line in enumerate(text.splitlines(), 1):
        word, *rest = line.split() or ["#"]
        where = f"{path} line {number}"
        if word in _MOST:
            found[word] = [_size(f"{where} - {word}", rest, _MOST[word])]
        elif word in _COUNTS:
            found[word] = _numbers(f"{where} - {word}", rest, _COUNTS[word])
        elif word[0] in "+-.0123456789":
            rows.extend(_numbers(f"{where} - a row", [word, *rest], 3))
        elif word != "TITLE" and word[0] != "#":
            raise VideoError(
                f"{where} - is neither a keyword nor a row of numbers (got {line.strip()!r:.60}) - export the table "
                "again, or remove the line (plate.levels says what LUT_IN_VIDEO_RANGE does)"
            )
    return found, np.array(rows, np.float64).reshape(-1, 3)


def _size(where: str, words: list[str], most: int) -> int:
    size = int(words[0]) if len(words) == 1 and words[0].isdecimal() and len(words[0]) < 8 else 0
    if not 2 <= size <= most:
        raise VideoError(
            f"{where} must be a whole number from 2 to {most} (got {' '.join(words)!r:.40}) - export the table again"
        )
    return size


def _numbers(where: str, words: list[str], count: int) -> list[float]:
    try:
        found = [float(word) for word in words]
    except ValueError:
        found = []
    if len(found) != count:
        raise VideoError(f"{where} must hold {count} numbers (got {' '.join(words)!r:.60}) - export the table again")
    return found


def _stages(path: Path, found: dict[str, list[float]], rows: Array) -> Iterator[LutTable]:
    """Yield the tables, the one-dimensional first; VideoError where the number of rows is another."""
    sizes = {name: int(found[name][0]) for name in _MOST if name in found}
    if not sizes:
        raise VideoError(f"{path} - is no .cube table (it has no LUT_1D_SIZE or LUT_3D_SIZE) - export it as .cube")
    curves, cube = sizes.get("LUT_1D_SIZE", 0), sizes.get("LUT_3D_SIZE", 0)
    if len(rows) != curves + cube**3:
        raise VideoError(
            f"{path} - should hold {curves + cube**3} rows of numbers (got {len(rows)}) - export or copy it again"
        )
    low, high = found.get("DOMAIN_MIN", [0.0] * 3), found.get("DOMAIN_MAX", [1.0] * 3)
    if curves:
        ends = found.get("LUT_1D_INPUT_RANGE")
        yield LutTable(rows[:curves], *_domain(ends, low, high))
        low, high = [0.0] * 3, [1.0] * 3  # DOMAIN is the input of the whole
    if cube:  # red changes fastest in the file
        table = np.ascontiguousarray(rows[curves:].reshape(cube, cube, cube, 3).transpose(2, 1, 0, 3))
        yield LutTable(table, *_domain(found.get("LUT_3D_INPUT_RANGE"), low, high))


def _domain(ends: list[float] | None, low: list[float], high: list[float]) -> tuple[Array, Array]:
    """Return the ends (3,) of a domain: a range of all channels, or those of each."""
    if ends is not None:
        low, high = [ends[0]] * 3, [ends[1]] * 3
    return np.array(low), np.array(high)


def _check_values(path: Path, stage: LutTable) -> None:
    if not (np.isfinite(stage.table).all() and np.isfinite([stage.low, stage.high]).all()):
        raise VideoError(f"{path} - holds values that are no numbers (got NaN or infinity) - export it again")
    largest = max(float(np.abs(part).max()) for part in (stage.table, stage.low, stage.high))
    if largest > _LARGEST:
        raise VideoError(f"{path} - its values must be at most {_LARGEST:g} (got {largest:g}) - export it again")
    if not np.all(stage.low < stage.high):
        raise VideoError(
            f"{path} - its domain must rise (got {stage.low.tolist()} to {stage.high.tolist()}) - export it again"
        )


def _check_invertible(path: Path, stage: LutTable) -> None:
    """Raise `VideoError` where two codes of a stage have one value that is no clipped one."""
    where = _bad_cells(stage.table, stage.span) if stage.is_cube else _bad_steps(stage.table, stage.span)
    if where is None:
        return
    what, first, last = where
    ends = (stage.low + np.asarray(end) / (len(stage.table) - 1) * (stage.high - stage.low) for end in (first, last))
    low, high = ends
    region = ", ".join(f"{name} {a:.3g} to {b:.3g}" for name, a, b in zip("RGB", low, high, strict=True))
    raise VideoError(
        f"{path} - cannot be turned around: {what} (got it at input {region}) - light could not be written as the "
        "plate's codes; take a table that is technical rather than a creative look, or name plate.transfer"
    )


def _bad_steps(table: Array, span: float) -> tuple[str, Array, Array] | None:
    """Return what is wrong with curves (n, 3) and the positions between which it is; None where they rise."""
    step = np.diff(table, axis=0) / span
    low, high = table.min(axis=0), table.max(axis=0)
    clipped = np.any([np.abs(table[1:] - end) <= _FLAT * span for end in (low, high)], axis=0)
    clipped &= np.any([np.abs(table[:-1] - end) <= _FLAT * span for end in (low, high)], axis=0)
    for what, bad in (("a curve falls", step < -_FLAT), ("a curve is flat", (np.abs(step) <= _FLAT) & ~clipped)):
        if bad.any():
            rows = np.flatnonzero(bad.any(axis=1))
            return what, np.full(3, rows[0]), np.full(3, rows[-1] + 1)
    return None if np.all(high > low) else ("a curve is flat", np.zeros(3), np.full(3, len(table) - 1))


def _bad_cells(table: Array, span: float) -> tuple[str, Array, Array] | None:
    """Return what is wrong with a cube (n, n, n, 3) and the positions between which it is; None where it is not.

    Tetrahedra that touch the ends of the values are clipped ones: they may be flat, or turned.
    """
    # Mark the vertices that are clipped
    low, high = table.min(axis=(0, 1, 2)), table.max(axis=(0, 1, 2))
    whole = np.zeros(3), np.full(3, len(table) - 1)
    if not np.all(high > low):
        return ("different colours become one", *whole)
    edge = np.any((table - low <= _FLAT * span) | (high - table <= _FLAT * span), axis=-1)
    # Measure the volume of each of the six tetrahedra of all cells
    turned, flat = (np.zeros(tuple(n - 1 for n in table.shape[:3]), np.bool_) for _ in range(2))
    for order in permutations(range(3)):
        at = np.zeros(3, np.int64)
        corners = [_corner(table, at)]
        touches = _corner(edge, at).copy()
        for axis in order:
            at[axis] = 1
            corners.append(_corner(table, at))
            touches |= _corner(edge, at)
        sides = np.stack([(b - a) / span for a, b in pairwise(corners)], axis=-1)
        sign = 1.0 if order in ((0, 1, 2), (1, 2, 0), (2, 0, 1)) else -1.0
        volume = sign * np.linalg.det(sides)
        size = np.prod(np.linalg.norm(sides, axis=-2), axis=-1)
        turned |= (volume < -_FLAT * size) & ~touches
        flat |= (volume <= _FLAT * size) & ~touches
    # Bound the cells of the worst fault
    for what, bad in (("it folds back", turned), ("different colours become one", flat)):
        if bad.any():
            cells = np.argwhere(bad)
            return what, cells.min(axis=0), cells.max(axis=0) + 1
    return ("different colours become one", *whole) if edge[1:-1, 1:-1, 1:-1].all() and edge.size > 8 else None


def _corner(values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Return one corner of every cell, by its offsets (3,) of 0 or 1."""
    n = values.shape[0] - 1
    i, j, k = at.tolist()
    return values[i : i + n, j : j + n, k : k + n]
