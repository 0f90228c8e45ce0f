# SPDX-License-Identifier: Apache-2.0
"""Spectra: published tables of coefficients in data/, sensors, illuminants, and reflectances of RGB albedos."""

from __future__ import annotations

import csv
import functools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from mr360uw.base.color import colour_science
from mr360uw.base.input_files import read_text
from mr360uw.base.parameters import checked, file_path, instance, numbers, real, vectors
from mr360uw.errors import ParameterError
from mr360uw.plot import Figure, Shown
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


def read_columns(
    path: str | Path, names: Sequence[str], advice: str = "", renamed: Mapping[str, str] = MappingProxyType({})
) -> dict[str, Array]:
    """Return the columns of a user's CSV file by lower-case name; raise `ParameterError` where one of `names` is
    missing. advice: what to do then. renamed: other names of columns, lower case.
    """
    columns = {renamed.get(name.lower(), name.lower()): values for name, values in read_table(path).items()}
    missing = [name.lower() for name in names if name.lower() not in columns]
    if missing:
        advice = advice or f"name them {', '.join(names)}"
        raise ParameterError(f"{path} - column {missing[0]} is missing (got {', '.join(columns)}) - {advice}")
    return columns


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


# White is balanced for an illuminant. The reflectance of an albedo is a sum of three smooth basis spectra, which add up
# to 1, weighted by red, green and blue (Mallett & Yuksel 2019): linear in the colour, exact under D65, within [0, 1].
#
# Sources: CIE 018:2019 (1931 observer); IEC 61966-2-1 (XYZ to linear Rec.709); rawtoaces-data (52 cameras); CIE 15
# (D65); ASTM G173-03 (sun and sky).

_REC709_FROM_XYZ = np.array(
    [
        [3.2404542, -1.5371385, -0.4985314],
        [-0.9692660, 1.8760108, 0.0415560],
        [0.0556434, -0.2040259, 1.0572252],
    ]
)

VISIBLE_NM = (400.0, 700.0)
"""Range [nm] of the bands by default: all tables of waters cover it, and sensors respond little beyond."""

DEFAULT_SENSOR = "Insta360 X5"
"""Sensor by default: plates are filmed by cameras, whose responses have no negative parts."""
DEFAULT_ILLUMINANT = "D65"
"""Illuminant by default: the white of Rec.709, the colour space of plates."""

_CAMERA_STEP = (380.0, 780.0, 81)
"""First and last wavelength [nm] and number of samples of the built-in cameras."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Sensor(Shown):
    """Relative responses of red, green and blue over wavelength.

    Only ratios within a channel matter: bands are balanced so that the illuminant's white is (1, 1, 1).

    Parameters
    ----------
    name : str
        Used in messages.
    curves : Spectrum
        Responses (w, 3), non-negative.
    matrix : ndarray
        Matrix (3, 3) from them to linear RGB.

    See Also
    --------
    uw.medium.Sensor.camera : Responses of a built-in camera.
    uw.medium.bands : Wavelengths and weights for a sensor.
    uw.medium.Medium : The water as a sensor sees it.

    Examples
    --------
    >>> uw.medium.Sensor.camera("Insta360 X5")
    <Sensor Arashi Vision Insta360 X5: 380 to 780 nm>
    """

    name: str
    curves: Spectrum
    matrix: Array

    def __repr__(self) -> str:
        known = self.curves.wavelength_nm
        return f"<Sensor {self.name}: {known[0]:g} to {known[-1]:g} nm>"

    def _figure(self) -> Figure:
        w = self.curves.wavelength_nm
        curves = dict(zip(("red", "green", "blue"), self.response(w).T, strict=True))
        return Figure(self.name, w, curves, "wavelength [nm]", "response")

    def response(self, wavelength_nm: ArrayLike) -> Array:
        """Return the responses of red, green and blue.

        Only its course over the wavelength means something; `bands` multiplies it by the illuminant and balances it to
        white.

        Parameters
        ----------
        wavelength_nm : array_like
            Wavelengths (...,) [nm].

        Returns
        -------
        ndarray
            Responses (..., 3), the observer's with negative parts.

        Raises
        ------
        ParameterError
            If a wavelength is beyond the table.

        See Also
        --------
        uw.medium.bands : Weights that are balanced.
        uw.plot.show : Draws the responses.

        Examples
        --------
        >>> uw.medium.Sensor.cie1931().response([450.0, 550.0, 650.0]).round(2)
        array([[ 0.15, -0.18,  1.88],
               [-0.13,  1.45, -0.17],
               [ 0.75, -0.07, -0.01]])
        """
        return self.curves(wavelength_nm) @ self.matrix.T

    @classmethod
    def cie1931(cls) -> Sensor:
        """Return the CIE 1931 2 degree observer in linear Rec.709; its responses have negative parts.

        For colours as a person sees them. The red of clear water is then outside the gamut, and transmittances are less
        exact than a camera's.

        Returns
        -------
        Sensor
            The observer of CIE 018:2019.

        See Also
        --------
        uw.medium.Sensor.camera : Responses of a camera, the default.
        uw.medium.compress_gamut : Brings negative colours into the gamut.

        Examples
        --------
        >>> uw.medium.Sensor.cie1931().name
        'CIE 1931'
        """
        return _cie1931()

    @classmethod
    def camera(cls, name: str) -> Sensor:
        """Return the raw channels of a built-in camera.

        Plates are filmed by cameras, so the Insta360 X5 is the default of all calls. The channels are red, green and
        blue as they are, without the maker's colour matrix.

        Parameters
        ----------
        name : str
            One of `cameras()`, or a part that only it has, like "Insta360 X5".

        Returns
        -------
        Sensor
            Its responses, 380 to 780 nm.

        Raises
        ------
        ParameterError
            If no camera, or more than one, has the name.

        See Also
        --------
        uw.medium.cameras : Names of the built-in cameras.
        uw.medium.Sensor.from_csv : Responses of another camera.
        uw.medium.Sensor.cie1931 : The standard observer.

        Examples
        --------
        >>> uw.medium.Sensor.camera("Insta360 X5").response(550.0).round(2)
        array([0.05, 0.95, 0.09])
        """
        found = _matching(instance("camera", name, str, "give a name of `cameras()`"), cameras())
        if len(found) != 1:
            what = "no such camera" if not found else f"fits {len(found)} cameras"
            choices = ", ".join(found or cameras())
            raise ParameterError(f"camera - {what} (got {name!r}) - take one of {choices}")
        wavelength = np.linspace(*_CAMERA_STEP)
        return cls(found[0], Spectrum(found[0], wavelength, builtin_cameras()[found[0]]), np.eye(3))

    @classmethod
    def from_arrays(cls, wavelength_nm: ArrayLike, response: ArrayLike, name: str = "sensor") -> Sensor:
        """Return a sensor of responses at wavelengths.

        For a camera that is not built in. Channels need no common scale: each is balanced to white by itself.

        Parameters
        ----------
        wavelength_nm : array_like
            Wavelengths (w,) [nm], ascending.
        response : array_like
            Responses (w, 3) of red, green and blue, at least 0.
        name : str
            Used in messages.

        Returns
        -------
        Sensor
            Linear between the wavelengths.

        Raises
        ------
        ParameterError
            If the shapes do not fit, or values are negative or all zero.

        See Also
        --------
        uw.medium.Sensor.from_csv : Reads the responses from a file.
        uw.medium.Sensor.camera : Built-in cameras.

        Examples
        --------
        >>> uw.medium.Sensor.from_arrays([450.0, 550.0, 650.0], np.eye(3)[::-1]).response(600.0)
        array([0.5, 0.5, 0. ])
        """
        values = real(f"{name} responses", response).astype(np.float64)
        if values.ndim != 2 or values.shape[1] != 3 or not np.all(np.isfinite(values)):
            raise ParameterError(
                f"{name} - responses must be (w, 3) finite numbers (got {values.shape}) - give red, green, blue"
            )
        if np.any(values < 0.0) or np.any(np.sum(values, axis=0) <= 0.0):
            raise ParameterError(
                f"{name} - responses must be >= 0 and not all zero (got sums {values.sum(0).tolist()}) - "
                "check the columns"
            )
        return cls(name, Spectrum(name, numbers("wavelength_nm", wavelength_nm).astype(np.float64), values), np.eye(3))

    @classmethod
    def from_csv(cls, path: str | Path) -> Sensor:
        r"""Return a sensor of a CSV file with the columns wavelength_nm, R, G, B.

        For a camera that is not built in. Channels need no common scale: each is balanced to white by itself.

        Parameters
        ----------
        path : str or Path
            The file; lines that start with # are comments.

        Returns
        -------
        Sensor
            Linear between the wavelengths of the file.

        Raises
        ------
        ParameterError
            If the file cannot be read or a column is missing.

        See Also
        --------
        uw.medium.Sensor.from_arrays : Takes arrays.
        uw.medium.Sensor.camera : Built-in cameras.

        Examples
        --------
        >>> with open("sensor.csv", "w", encoding="utf-8") as file:
        ...     _ = file.write("wavelength_nm,R,G,B\n450,0,0.1,1\n550,0.1,1,0.1\n650,1,0.1,0\n")
        >>> uw.medium.Sensor.from_csv("sensor.csv").response(650.0)
        array([1. , 0.1, 0. ])
        """
        columns = read_columns(path, ("wavelength_nm", "R", "G", "B"))
        response = np.column_stack([columns[channel] for channel in "rgb"])
        return cls.from_arrays(columns["wavelength_nm"], response, Path(path).name)


@functools.cache
def _cie1931() -> Sensor:
    table = builtin_table("cie1931.csv")
    xyz = np.column_stack([table["x"], table["y"], table["z"]])
    name = "CIE 1931"
    return Sensor(name, Spectrum(name, table["wavelength_nm"], xyz), _REC709_FROM_XYZ)


def named_sensor(name: str) -> Sensor:
    """Return the sensor of a name: "CIE 1931", a CSV file, or a built-in camera."""
    if name.casefold().replace(" ", "") == "cie1931":
        return Sensor.cie1931()
    return Sensor.from_csv(name) if name.lower().endswith(".csv") else Sensor.camera(name)


def cameras() -> tuple[str, ...]:
    """Return the names of the built-in cameras."""
    return tuple(builtin_cameras())


def _matching(name: str, names: tuple[str, ...]) -> list[str]:
    """Return the names that equal `name`, else those that end in it, else those that contain it; case is ignored."""
    wanted = name.casefold()
    for fits in (str.__eq__, str.endswith, str.__contains__):
        found = [full for full in names if wanted and fits(full.casefold(), wanted)]
        if found:
            return found
    return []


_ILLUMINANTS = {"D65": "d65", "sun-sky": "sun_sky"}


@functools.cache
def illuminant(name: str) -> Spectrum:
    """Return the relative spectrum of an illuminant.

    "equal-energy", "D65", "sun-sky" (ASTM G173 global), or any name that colour-science knows ("D50", "A", "FL2", ...).
    """
    if name == "equal-energy":
        return Spectrum(name, np.array([300.0, 830.0]), np.ones(2))
    if name in _ILLUMINANTS:
        return builtin_spectrum("cie1931.csv", _ILLUMINANTS[name], name)
    colour = colour_science()
    if name not in colour.SDS_ILLUMINANTS:
        known = ", ".join(("equal-energy", *_ILLUMINANTS, *sorted(colour.SDS_ILLUMINANTS)))
        raise ParameterError(f"illuminant - unknown (got {name!r}) - take one of {known}")
    distribution = colour.SDS_ILLUMINANTS[name]
    return Spectrum(name, np.asarray(distribution.wavelengths), np.asarray(distribution.values))


@checked
def reflectance(albedo_rgb: ArrayLike, wavelength_nm: ArrayLike) -> Array:
    """Return reflectances (..., n) in [0, 1] of linear Rec.709 albedos (..., 3) in [0, 1] at wavelengths (n,) [nm]."""
    w = np.atleast_1d(numbers("wavelength_nm", wavelength_nm))
    return vectors("albedo_rgb", albedo_rgb).astype(np.float64, copy=False) @ _basis()(w).T


@functools.cache
def _basis() -> Spectrum:
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it warns about optional packages
        from colour.recovery import MSDS_BASIS_FUNCTIONS_sRGB_MALLETT2019 as BASIS
    return Spectrum("reflectance basis", np.asarray(BASIS.wavelengths), np.asarray(BASIS.values))
