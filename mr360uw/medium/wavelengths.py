# SPDX-License-Identifier: Apache-2.0
"""Wavelength bands: n wavelengths and RGB weights that replace the full spectrum.

A spectrum X relative to the illuminant becomes RGB = sum_i weight_i X(wavelength_i); the weights of each channel sum to
1, so that white (X = 1) is (1, 1, 1).

Fitted ones reproduce the colours of light in water with a few bands. Training spectra: veils and grey objects in the
ten Jerlov types and in chlorophyll waters, over depths, distances and directions, each weighted by the inverse of its
colour so that relative errors count. For given wavelengths the best non-negative weights of the sensor's curves are a
least-squares problem with one solution. The wavelengths are found by moving one at a time, from several starts. Results
for the built-in sensors are stored in data/fitted_bands.json, others on the disk (`reading.disk_cache`).
"""

from __future__ import annotations

import functools
import hashlib
import itertools
import json
from dataclasses import dataclass
from importlib import resources
from typing import Any, Literal

import numpy as np

from mr360uw.base.disk_cache import kept_arrays
from mr360uw.base.parameters import checked, vectors, whole
from mr360uw.errors import ParameterError
from mr360uw.medium.closed_form import closed_form
from mr360uw.medium.spectra import DEFAULT_ILLUMINANT, DEFAULT_SENSOR, VISIBLE_NM, Sensor, illuminant
from mr360uw.medium.water import JERLOV_TYPES, Water
from mr360uw.types import Array

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
    # Check the arguments
    sensor = sensor or Sensor.camera(DEFAULT_SENSOR)
    n = whole("bands", n, 1, 1000)
    low, high = range_nm
    known = sensor.curves.wavelength_nm
    if not known[0] <= low < high <= known[-1]:
        raise ParameterError(
            f"range_nm - beyond the sensor, known from {known[0]:g} to {known[-1]:g} nm "
            f"(got {low:g} to {high:g}) - narrow it"
        )
    # Weigh fitted wavelengths, or the middles of even bands
    name = f"{sensor.name}, {illuminant_name}, {n} {rule}"
    if rule == "fitted":
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


FEWEST, MOST = 2, 24
"""Numbers of bands that are searched for, in seconds."""
_STEP_NM = 1.0
"""Spacing [nm] of the candidate wavelengths."""
_MOVES = (-12, -5, -2, -1, 1, 2, 5, 12)
"""Moves of one wavelength that a sweep tries, in steps: wide ones leave local minima."""
_STARTS = 24
_SWEEPS = 40
"""Starts, and most sweeps over all wavelengths from each; the time grows with both."""
_FINE = 600
"""Wavelengths of the exact sums, 0.5 nm apart over 400 to 700 nm."""


def fitted_bands(n: int, sensor: Sensor, illuminant_name: str, range_nm: tuple[float, float]) -> tuple[Array, Array]:
    """Return wavelengths (n,) and weights (n, 3), stored, cached on disk, or searched for (1 to 5 s)."""
    if not FEWEST <= n <= MOST:
        raise ParameterError(
            f"bands - the fitted rule has {FEWEST} to {MOST} bands (got {n}) - or take rule='rectangle'"
        )
    key = storage_key(n, sensor, illuminant_name, range_nm)
    found = _stored().get(key)
    if found is None:

        def searched() -> dict[str, Array]:
            wavelength, weight = search(n, sensor, illuminant_name, range_nm)
            return {"wavelength_nm": wavelength, "weight": np.round(weight, 7)}

        found = kept_arrays("bands", [key], searched)
    # weights as exact as the sensor's curves allow: white stays white
    weight = np.asarray(found["weight"], np.float64)
    white = _white(sensor, illuminant_name, range_nm)
    rgb = weight @ sensor.matrix.T / (sensor.matrix @ white)
    return np.asarray(found["wavelength_nm"], np.float64), rgb / rgb.sum(axis=0)


def search(n: int, sensor: Sensor, illuminant_name: str, range_nm: tuple[float, float]) -> tuple[Array, Array]:
    """Return the best wavelengths (n,) and non-negative weights (n, 3) of the sensor's curves."""
    from scipy.optimize import nnls

    candidate = np.arange(range_nm[0], range_nm[1] + 0.5 * _STEP_NM, _STEP_NM)
    design, target, scale = _training(sensor, illuminant_name, range_nm, candidate)
    # the three curves share the rows but not their scale: each channel is fitted for itself
    gram = np.einsum("ri,rc,rj->cij", design, scale**2, design)
    right = np.einsum("ri,rc,rc->ci", design, scale**2, target)
    total = np.einsum("rc,rc->c", scale**2, target**2)

    def weights(nodes: tuple[int, ...]) -> tuple[float, Array]:
        index = np.array(nodes)
        columns, cost = [], 0.0
        for channel in range(3):
            g = gram[channel][np.ix_(index, index)]
            lower = np.linalg.cholesky(g + 1e-10 * np.trace(g) * np.eye(n))
            projected = np.linalg.solve(lower, right[channel][index])
            w, residual = nnls(lower.T, projected)
            inside = float(np.sum(projected**2))
            cost += total[channel] - inside + residual**2
            columns.append(w)
        return cost, np.column_stack(columns)

    cost_of = functools.cache(lambda nodes: weights(nodes)[0])
    best: tuple[float, tuple[int, ...]] | None = None
    rng = np.random.default_rng(n)
    for start in range(_STARTS):
        place = (np.arange(n) + 0.5) / n + (rng.uniform(-0.4, 0.4, n) / n if start else 0.0)
        nodes = tuple(
            np.unique(np.clip(np.round(place * (len(candidate) - 1)), 0, len(candidate) - 1).astype(int)).tolist()
        )
        if len(nodes) < n:
            continue
        found = _descend(nodes, cost_of, len(candidate))
        if best is None or found[0] < best[0]:
            best = found
    if best is None:
        raise ParameterError(f"bands - {n} are too many for {range_nm} nm - choose fewer")
    return candidate[list(best[1])], weights(best[1])[1]


def _descend(nodes: tuple[int, ...], cost_of: Any, count: int) -> tuple[float, tuple[int, ...]]:
    cost = cost_of(nodes)
    for _ in range(_SWEEPS):
        before = cost
        for place, move in itertools.product(range(len(nodes)), _MOVES):
            moved = tuple(sorted({*nodes[:place], nodes[place] + move, *nodes[place + 1 :]}))
            if len(moved) == len(nodes) and moved[0] >= 0 and moved[-1] < count and cost_of(moved) < cost:
                nodes, cost = moved, cost_of(moved)
        if cost > before * (1.0 - 1e-4):
            break
    return cost, nodes


def _white(sensor: Sensor, illuminant_name: str, range_nm: tuple[float, float]) -> Array:
    fine = _midpoints(range_nm)
    return np.mean(sensor.curves(fine) * illuminant(illuminant_name)(fine)[:, None], axis=0)


def _midpoints(range_nm: tuple[float, float]) -> Array:
    return range_nm[0] + (range_nm[1] - range_nm[0]) * (np.arange(_FINE) + 0.5) / _FINE


def _training(
    sensor: Sensor, illuminant_name: str, range_nm: tuple[float, float], candidate: Array
) -> tuple[Array, Array, Array]:
    """Return spectra (r, candidates), their exact signals (r, 3) in the sensor's curves, and weights (r, 3)."""
    fine = _midpoints(range_nm)
    curves = sensor.curves(fine) * illuminant(illuminant_name)(fine)[:, None] / _FINE
    design = _training_spectra(candidate)
    target = _training_spectra(fine) @ curves
    # an error in a curve matters as much as it moves the colour, relative to the colour's size
    balanced = sensor.matrix / (sensor.matrix @ _white(sensor, illuminant_name, range_nm))[:, None]
    reach = np.linalg.norm(balanced, axis=0)
    scale = reach / np.linalg.norm(target @ balanced.T, axis=1)[:, None]
    # white itself, held tight
    design = np.vstack([design, np.ones(len(candidate))])
    target = np.vstack([target, curves.sum(axis=0)])
    return design, target, np.vstack([scale, 30.0 * reach / np.sqrt(3.0)])


def _training_spectra(wavelength_nm: Array) -> Array:
    """Return veils and object radiances (r, w) in many waters, relative to the light above, of any size."""
    waters = [Water.jerlov(name) for name in JERLOV_TYPES]
    waters += [Water.jerlov(name, "williamson2022") for name in ("IB", "II", "III", "1C", "3C", "5C")]
    waters += [Water.chlorophyll(c) for c in (0.03, 0.1, 0.3, 1.0, 3.0)]
    rows = []
    for water in waters:
        b, c, kd = (f(wavelength_nm) for f in (water.scattering, water.attenuation, water.diffuse_attenuation))
        reach = 1.0 / np.min(Water.attenuation(water, np.arange(400.0, 701.0, 10.0)))
        for depth, distance, up in itertools.product((1.0, 3.0, 8.0, 20.0), (0.2, 1.0, 4.0), (-0.9, 0.0, 0.6)):
            s = distance * reach
            rows.append(closed_form(b, c, kd, s, depth, up))
            rows.append(np.exp(-kd * np.maximum(depth - s * up, 0.0) - c * s))
    return np.array(rows)


def storage_key(n: int, sensor: Sensor, illuminant_name: str, range_nm: tuple[float, float]) -> str:
    """Return the name under which the bands of a sensor are stored: it holds all that the search depends on."""
    digest = hashlib.sha256()
    for part in (sensor.curves.wavelength_nm, sensor.curves.value, sensor.matrix, illuminant(illuminant_name).value):
        digest.update(np.round(part, 9).tobytes())
    return f"{n}-{range_nm[0]:g}-{range_nm[1]:g}-{digest.hexdigest()[:16]}"


@functools.cache
def _stored() -> dict[str, Any]:
    return json.loads((resources.files("mr360uw.medium") / "data" / "fitted_bands.json").read_text())
