# SPDX-License-Identifier: Apache-2.0
"""Wavelength bands: n wavelengths and RGB weights that replace the full spectrum.

A spectrum X relative to the illuminant becomes RGB = sum_i weight_i X(wavelength_i); the weights of each channel sum to
1, so that white (X = 1) is (1, 1, 1).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from mr360uw.errors import ParameterError
from mr360uw.medium.spectral.sensor import DEFAULT_ILLUMINANT, VISIBLE_NM, Sensor, checked_sensor, illuminant
from mr360uw.shapes import checked, vectors, whole

Array = NDArray[np.float64]

Rule = Literal["rectangle", "integrated", "fitted"]


@dataclass(frozen=True, slots=True, eq=False)
class Bands:
    """wavelength_nm: (n,) ascending. weight: (n, 3), each column sums to 1. name: sensor, illuminant and rule."""

    wavelength_nm: Array
    weight: Array
    name: str

    def rgb(self, spectrum: Array) -> Array:
        """Return RGB (..., 3) of spectra (..., n) relative to the illuminant; may be negative out of gamut."""
        return vectors("spectrum", spectrum, len(self.weight)) @ self.weight

    @property
    def signed(self) -> bool:
        """True if some weight is negative, so that colours can leave the gamut."""
        return bool(np.any(self.weight < 0.0))

    @property
    def lobes(self) -> Array:
        """Non-negative weights (n, 3), columns of sum 1, for ratios of light such as transmittance.

        A camera's weights as they are. Of a response with negative parts, the lobe about its peak only: a sum with
        negative weights can pass through zero over distance, which no light does. The observer's red also has a second
        lobe in the violet, which would let red outlast green in clear water.
        """
        if not self.signed:
            return self.weight
        kept = np.zeros_like(self.weight)
        for channel, column in enumerate(self.weight.T):
            peak, other = int(column.argmax()), np.flatnonzero(column < 0.0)
            start = max((int(i) + 1 for i in other if i < peak), default=0)
            end = min((int(i) for i in other if i > peak), default=len(column))
            kept[start:end, channel] = column[start:end]
        return kept / kept.sum(axis=0)

    def log_light(self, log_spectrum: Array) -> Array:
        """Return the logarithm (..., 3) of sums with the weights `lobes`, from the logarithm (..., n) of a spectrum.

        Differences of it are the log attenuation of a grey colour. It does not underflow.
        """
        x = vectors("log_spectrum", log_spectrum, len(self.weight))
        result = np.empty((*np.shape(log_spectrum)[:-1], 3))
        for channel, weight in enumerate(self.lobes.T):
            part = x[..., weight > 0.0]
            top = part.max(axis=-1, keepdims=True)
            result[..., channel] = top[..., 0] + np.log(np.exp(part - top) @ weight[weight > 0.0])
        return result


@checked
def bands(
    n: int,
    sensor: Sensor | None = None,
    rule: Rule = "rectangle",
    illuminant_name: str = DEFAULT_ILLUMINANT,
    range_nm: tuple[float, float] = VISIBLE_NM,
) -> Bands:
    """Return wavelengths and RGB weights that replace the full spectrum.

    A pixel costs the same for any number, so `Medium` takes 61. Fitted ones serve code that pays for each: 8 of them
    are off by 0.3 % in colour, 8 even ones by 4 %. Common ones ship with the package; others are searched for once, in
    seconds.

    Parameters
    ----------
    n : int
        Number of wavelengths, 1 to 1000.
    sensor : Sensor, optional
        The sensor; without it the default camera.
    rule : {"rectangle", "integrated", "fitted"}
        Equal intervals with response and illuminant at their midpoints; the same midpoints, response times illuminant
        averaged over each interval; or the 2 to 24 wavelengths and weights that reproduce the colours of water best.
    illuminant_name : str
        Light that white is balanced for: "D65", "sun-sky", "equal-energy", "A", ...
    range_nm : tuple of float
        First and last wavelength [nm].

    Returns
    -------
    Bands
        `wavelength_nm` (n,) and `weight` (n, 3), each column of sum 1.

    Raises
    ------
    ParameterError
        If the rule is not known, the range beyond the sensor, or a channel is missed by all bands.

    See Also
    --------
    uw.medium.Medium : Takes number and rule.
    uw.medium.illuminant : Spectra of illuminants.

    Examples
    --------
    >>> three = uw.medium.bands(3)
    >>> three.wavelength_nm.tolist(), three.weight.sum(axis=0).round(6).tolist()
    ([450.0, 550.0, 650.0], [1.0, 1.0, 1.0])
    """
    sensor = checked_sensor(sensor)
    n = whole("bands", n, 1, 1000)
    if rule not in get_args(Rule):
        raise ParameterError(f"rule - unknown (got {rule!r}) - take one of {', '.join(get_args(Rule))}")
    low, high = range_nm
    known = sensor.curves.wavelength_nm
    if not known[0] <= low < high <= known[-1]:
        raise ParameterError(
            f"range_nm - beyond the sensor, known from {known[0]:g} to {known[-1]:g} nm "
            f"(got {low:g} to {high:g}) - narrow it"
        )
    name = f"{sensor.name}, {illuminant_name}, {n} {rule}"
    if rule == "fitted":
        from mr360uw.medium.spectral.fitted import fitted_bands

        wavelength, weight = fitted_bands(n, sensor, illuminant_name, range_nm)
        return Bands(wavelength, weight, name)
    edge = np.linspace(low, high, n + 1)
    middle = 0.5 * (edge[:-1] + edge[1:])
    light = illuminant(illuminant_name)
    if rule == "rectangle":
        weight = sensor.response(middle) * light(middle)[:, None]
    else:
        per_band = max(8, 600 // n)
        fine = low + (high - low) * (np.arange(n * per_band) + 0.5) / (n * per_band)
        weight = (sensor.response(fine) * light(fine)[:, None]).reshape(n, per_band, 3).mean(axis=1)
    return Bands(middle, _balanced(weight, n, sensor.name), name)


def _balanced(weight: Array, n: int, name: str) -> Array:
    total = weight.sum(axis=0)
    if np.any(np.abs(total) < 1e-6 * np.abs(weight).max()):
        raise ParameterError(f"bands - {n} bands miss a channel of {name} - choose more bands or rule='fitted'")
    return weight / total
