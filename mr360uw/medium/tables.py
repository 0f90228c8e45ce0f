# SPDX-License-Identifier: Apache-2.0
"""Published tables of coefficients in data/, and spectra made of their columns."""

from __future__ import annotations

import csv
import functools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from mr360uw.errors import ParameterError
from mr360uw.reading.input_files import read_text
from mr360uw.shapes import file_path, numbers
from mr360uw.types import Array


@dataclass(frozen=True, slots=True, eq=False)
class Spectrum:
    """A quantity tabulated over wavelength, linear in between.

    wavelength_nm: (w,) ascending. value: (w,) or (w, k). name: used in messages.
    """

    name: str
    wavelength_nm: Array
    value: Array

    def __post_init__(self) -> None:
        _check_wavelengths(self.name, self.wavelength_nm)
        if len(self.value) != len(self.wavelength_nm) or not np.all(np.isfinite(self.value)):
            raise ParameterError(
                f"{self.name} - needs one finite value for each wavelength "
                f"(got {len(self.value)} values for {len(self.wavelength_nm)} wavelengths) - complete the table"
            )

    def __call__(self, wavelength_nm: ArrayLike) -> Array:
        """Return the value at wavelengths [nm]; raise `ParameterError` beyond the table."""
        w = numbers("wavelength_nm", wavelength_nm).astype(np.float64, copy=False)
        low, high = self.wavelength_nm[0], self.wavelength_nm[-1]
        if w.size and (np.min(w) < low - 1e-9 or np.max(w) > high + 1e-9):
            raise ParameterError(
                f"{self.name} - is known from {low:g} to {high:g} nm only "
                f"(got {np.min(w):g} to {np.max(w):g}) - choose wavelengths inside"
            )
        if self.value.ndim == 1:
            return np.interp(w, self.wavelength_nm, self.value)
        return np.stack([np.interp(w, self.wavelength_nm, column) for column in self.value.T], axis=-1)


def _check_wavelengths(name: str, wavelength_nm: Array) -> None:
    """Raise `ParameterError` unless the wavelengths ascend and lie in a range that nanometres have."""
    w = np.asarray(wavelength_nm, np.float64)
    if w.ndim != 1 or len(w) < 1 or not np.all(np.isfinite(w)) or np.any(np.diff(w) <= 0.0):
        raise ParameterError(f"{name} - wavelengths must be a list that ascends (got {w.tolist()!r:.60}) - sort it")
    guess = next((unit for unit, low, high in _UNITS if low <= w[0] and w[-1] <= high), None)
    if guess:
        raise ParameterError(
            f"{name} - wavelengths must be in nm (got {w[0]:g} to {w[-1]:g}, which look like {guess}) - convert them"
        )
    if w[0] < 100.0 or w[-1] > 3000.0:
        raise ParameterError(f"{name} - wavelengths must be in nm (got {w[0]:g} to {w[-1]:g}) - convert them")


_UNITS = (("metres", 1e-8, 1e-5), ("micrometres", 0.1, 5.0), ("angstroms", 3001.0, 30000.0))
"""Units that a table in other units is likely to be in, each with the range that light has in it."""


def _rows(lines: Iterable[str]) -> Iterator[list[str]]:
    return csv.reader(line for line in lines if line.strip() and not line.startswith("#"))


def _number(cell: str, where: str) -> float:
    if not cell.strip():
        return np.nan
    try:
        return float(cell)
    except ValueError:
        raise ParameterError(f"{where} - not a number (got {cell.strip()!r:.40}) - correct the cell") from None


def parse_table(lines: Iterable[str], where: str) -> dict[str, Array]:
    """Return the columns of a CSV text by lower-case name; '#' starts a comment line, blank cells are NaN."""
    try:
        rows = list(_rows(lines))
    except csv.Error as error:
        raise ParameterError(f"{where} - not a table (got: {error}) - give a CSV file") from None
    if len(rows) < 2 or any(len(row) != len(rows[0]) for row in rows):
        raise ParameterError(
            f"{where} - not a table (got {len(rows)} rows of unequal length or none) - give a CSV file"
        )
    names = [name.strip() for name in rows[0]]
    values = np.array([[_number(cell, f"{where}, row {i}") for cell in row] for i, row in enumerate(rows[1:], 2)])
    return dict(zip(names, values.T, strict=True))


def read_table(path: str | Path) -> dict[str, Array]:
    """Return the columns of a user's CSV file; raise `ParameterError` where it cannot be read."""
    return parse_table(read_text(file_path("table", path), ParameterError).splitlines(), str(path))


@functools.cache
def builtin_table(name: str) -> dict[str, Array]:
    """Return the columns of one of the package's own tables."""
    return parse_table(_builtin_text(name).splitlines(), name)


def builtin_spectrum(table: str, column: str, label: str) -> Spectrum:
    """Return one column of a built-in table over its wavelengths, without its blank cells."""
    columns = builtin_table(table)
    known = np.isfinite(columns[column])
    return Spectrum(label, columns["wavelength_nm"][known], columns[column][known])


@functools.cache
def builtin_cameras() -> dict[str, Array]:
    """Return the (81, 3) responses of every built-in camera by name, 380 to 780 nm by 5 nm."""
    responses: dict[str, list[list[float]]] = {}
    for name, _channel, *cells in _rows(_builtin_text("cameras.csv").splitlines()):
        responses.setdefault(name, []).append([float(cell) for cell in cells])
    return {name: np.array(channels).T for name, channels in responses.items()}


def _builtin_text(name: str) -> str:
    return (resources.files("mr360uw.medium") / "data" / name).read_text(encoding="utf-8")
