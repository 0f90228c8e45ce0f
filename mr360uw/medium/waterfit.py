# SPDX-License-Identifier: Apache-2.0
"""Estimates the Jerlov type of a plate from the colour of its water over elevation.

A plate shows how the water's radiance changes with direction, not with depth, so attenuation cannot be measured
directly. Instead the solved light field of every Jerlov type at the camera's depth is compared with the plate's profile
about the horizon. The exposure is free; a white balance is allowed at a cost in likelihood. Kd is that of the type that
is found.

How far a fit changes with the frames that it is made of is told by the bootstrap (Efron 1979).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Generic, TypeVar

import numpy as np

from mr360uw.base.color import encode
from mr360uw.base.constants import REFRACTIVE_INDEX_SEA
from mr360uw.base.parameters import checked, whole
from mr360uw.errors import ParameterError
from mr360uw.medium.medium import Medium
from mr360uw.medium.open_water import PlateProfile
from mr360uw.medium.spectra import Sensor
from mr360uw.medium.water import JERLOV_TYPES, JerlovType, Water
from mr360uw.types import Array, Floats

Name = TypeVar("Name", bound=str)

_REACH_RAD = np.radians(30.0)
"""Greatest elevation [rad] of the rows that are compared: above lies the surface.

Rows as far below the horizon count too where they show water; the ground shows through 60 m of clear water."""
CONFIDENT = 0.6
"""Confidence from which a type is named: in dives over sand in all types, all that are named are right."""
_LIKELY = 0.1
"""Least likelihood of the types that are listed where none is named."""
_ROW_SIGMA = 0.30
"""Expected relative deviation of a row from the model: marine snow, shafts of light, ground."""
_BALANCE_SIGMA = 0.30
"""Expected relative deviation of a channel due to the camera's white balance."""
_INDEPENDENT_ROWS = 3.0
"""Number of independent measurements in all rows together, because neighbouring rows deviate alike."""
_MISFIT_SCALE = 0.2
"""Rms residual at which the confidence has fallen by a factor of exp(-1/2).

The four figures are calibrated together: the confidence is then the rate at which the type is found again in waters of
both sources of coefficients under a sun, with a white balance that is off by 20 %.
"""
_BAND_COUNT = 31
"""Wavelengths of the light field: 10 nm apart, far finer than the types differ."""


@dataclass(frozen=True, slots=True)
class WaterFit:
    """The Jerlov type whose light field is nearest to a plate.

    water_type: nearest of all. confidence: 0 to 1, its likelihood among the types times how well it fits.
    residual: {type: rms of the logarithm of plate over model}, 0.1 = 10 %. kd: (3,) attenuation [1/m] of the
    downwelling light at the camera's depth, of that type. gain: (3,) plate over model.
    up: (r,) y of the rows' directions; measured, fitted: (r, 3) radiance in the plate's exposure.
    """

    water_type: JerlovType
    confidence: float
    residual: dict[JerlovType, float]
    likelihood: dict[JerlovType, float]
    kd: Array
    gain: Array
    camera_depth_m: float
    up: Array
    measured: Array
    fitted: Array

    @property
    def named(self) -> JerlovType | None:
        """The type of the water if it can be told from the others, else None."""
        return self.water_type if self.confidence >= CONFIDENT else None

    def html(self) -> str:
        """Return a fragment of HTML that shows the fit: verdict, profile and the other types."""
        # Name the type, or the likely ones; then the table of all
        likely = sorted((n for n in self.likelihood if self.likelihood[n] >= _LIKELY), key=JERLOV_TYPES.index)
        verdict = (
            f"Jerlov type: <b>{escape(self.water_type)}</b> (confidence {self.confidence:.2f})"
            if self.named
            else f"No single Jerlov type can be told; likely ones: {escape(', '.join(likely))}; "
            f"nearest <b>{escape(self.water_type)}</b> (confidence {self.confidence:.2f})"
        )
        kd = ", ".join(f"{channel} {value:.3f}" for channel, value in zip("RGB", self.kd, strict=True))
        rows = "".join(
            f"<tr><td>{escape(name)}</td><td>{100 * self.residual[name]:.0f} %</td>"
            f"<td><meter max='1' value='{share:.3f}'></meter> {100 * share:.0f} %</td></tr>"
            for name, share in sorted(self.likelihood.items(), key=lambda item: -item[1])
        )
        return (
            "<section class='water'><h2>Water</h2>"
            f"<p>{verdict}; rms deviation {100 * self.residual[self.water_type]:.0f} %. "
            f"Attenuation of daylight at {self.camera_depth_m:g} m: {kd} per metre, as the nearest type has it. "
            "One camera position shows how the water's colour changes with direction, not with depth: the type rests "
            "on colour and profile about the horizon, and a white balance in the camera moves it.</p>"
            f"{self._plot()}"
            f"<table><tr><th>type</th><th>deviation</th><th>likelihood</th></tr>{rows}</table></section>"
        )

    def _plot(self) -> str:
        """Return the profile over elevation as inline SVG: dots measured, lines fitted."""
        # Scale to the brightest value
        width, height = 360, 160
        top = 1.05 * float(max(self.measured.max(), self.fitted.max()))
        elevation = np.degrees(np.arcsin(self.up))
        x = (elevation - elevation.min()) / np.ptp(elevation) * (width - 20) + 10
        parts = [f"<svg viewBox='0 0 {width} {height + 20}' width='{width}' role='img'><title>profile</title>"]
        # Draw fitted lines and measured dots, then the colours along the profile
        for channel, colour in enumerate(("#c33", "#3a3", "#36c")):
            line = " ".join(
                f"{a:.1f},{height * (1 - v / top):.1f}" for a, v in zip(x, self.fitted[:, channel], strict=True)
            )
            parts.append(f"<polyline points='{line}' fill='none' stroke='{colour}'/>")
            parts += [
                f"<circle cx='{a:.1f}' cy='{height * (1 - v / top):.1f}' r='2.5' fill='{colour}'/>"
                for a, v in zip(x, self.measured[:, channel], strict=True)
            ]
        for a, row in zip(x, self.measured, strict=True):
            code = np.clip(255 * encode(row / top, "srgb"), 0, 255).astype(int)
            parts.append(
                f"<rect x='{a - 8:.1f}' y='{height + 4}' width='16' height='12' fill='rgb{tuple(code.tolist())}'/>"
            )
        return "".join(parts) + "</svg>"


@checked
def fit_water(
    radiance_map: Floats,
    camera_depth_m: float,
    sensor: Sensor | None = None,
    refractive_index: float = REFRACTIVE_INDEX_SEA,
) -> WaterFit:
    """Return the nearest Jerlov type of a plate.

    Elevations near the horizon are compared with the solved light of all ten types. A white balance moves colours more
    than types I to 3C differ: look at `confidence`, and at `named`, which is None below 0.6.

    Parameters
    ----------
    radiance_map : array_like
        Linear radiance (32, 64, 3) of the plate, as `Environment.residual`.
    camera_depth_m : float
        Depth [m] of the camera.
    sensor : Sensor, optional
        Of the camera, the default one unless given.
    refractive_index : float
        Index of the water relative to air.

    Returns
    -------
    WaterFit
        The type, how certain it is, and the fit of all types.

    Raises
    ------
    ParameterError
        If the plate is black about the horizon.

    See Also
    --------
    uw.ibl.environment : Makes the map.
    uw.medium.Water.jerlov : The water of a type.
    uw.medium.fit_gain : The exposure of a known water.

    Examples
    --------
    >>> light = uw.ibl.environment(plate, underwater=True)
    >>> uw.medium.fit_water(light.residual, camera_depth_m=4.0).water_type in uw.medium.JERLOV_TYPES
    True
    """
    profile = PlateProfile.from_map(radiance_map)
    up = profile.up[np.abs(np.arcsin(profile.up)) <= _REACH_RAD]
    both = (_fit(profile, rows, camera_depth_m, sensor, refractive_index) for rows in (up, up[up > 0.0]))
    return max(both, key=lambda fit: fit.confidence)


def _fit(
    profile: PlateProfile, up: Array, camera_depth_m: float, sensor: Sensor | None, refractive_index: float
) -> WaterFit:
    # Compare the profile with the level light of every type
    measured = profile(up)
    if np.any(measured.max(axis=0) <= 0.0):
        raise ParameterError(
            f"water - the plate is black about the horizon (got {measured.max(axis=0).tolist()}) - brighten it"
        )
    models = {name: _level_light(name, up, camera_depth_m, sensor, refractive_index) for name in JERLOV_TYPES}
    found = compare_waters(measured, {name: light for name, (light, _) in models.items()})
    light, kd = models[found.nearest]
    return WaterFit(
        water_type=found.nearest,
        confidence=found.confidence,
        residual=found.residual,
        likelihood=found.likelihood,
        kd=kd,
        gain=found.gain,
        camera_depth_m=float(camera_depth_m),
        up=up,
        measured=measured,
        fitted=found.gain * light,
    )


@dataclass(frozen=True, slots=True)
class WaterComparison(Generic[Name]):
    """Waters against a profile; see `WaterFit` for the fields."""

    nearest: Name
    confidence: float
    residual: dict[Name, float]
    likelihood: dict[Name, float]
    gain: Array


def compare_waters(measured: Array, lights: Mapping[Name, Array]) -> WaterComparison[Name]:
    """Return how waters of radiances (r, 3) compare with a measured profile (r, 3), each up to exposure and balance."""
    log_measured = np.log(np.maximum(measured, 1e-4 * measured.max()))
    results = {name: _compare(log_measured - np.log(light)) for name, light in lights.items()}
    misfit = {name: result[0] for name, result in results.items()}
    lowest = min(misfit.values())
    weight = {name: float(np.exp(-0.5 * (value - lowest))) for name, value in misfit.items()}
    likelihood = {name: value / sum(weight.values()) for name, value in weight.items()}
    best = max(lights, key=lambda name: likelihood[name])
    residual = {name: result[2] for name, result in results.items()}
    confidence = float(likelihood[best] * np.exp(-0.5 * (residual[best] / _MISFIT_SCALE) ** 2))
    return WaterComparison(best, confidence, residual, likelihood, np.exp(results[best][1]))


def _level_light(
    name: JerlovType, up: Array, depth_m: float, sensor: Sensor | None, refractive_index: float
) -> tuple[Array, Array]:
    """Return a type's radiance (r, 3) and the attenuation (3,) [1/m] of its downwelling irradiance at a depth."""
    medium = Medium(
        Water.jerlov(name), sensor, "table", depth_m, band_count=_BAND_COUNT, refractive_index=refractive_index
    )
    light = medium.light.display(medium.model.radiance(depth_m, up))
    log = medium.light.ambient_log(np.array([0.95, 1.05]) * depth_m)
    return light, (log[0] - log[1]) / (0.1 * depth_m)


def _compare(difference: Array) -> tuple[float, Array, float]:
    """Return misfit (twice the negative log likelihood), log gain (3,) and rms of a logarithmic difference (r, 3).

    The mean over channels is the exposure, which is free. The deviation of a channel from it is the white balance,
    which adds to the misfit.
    """
    rows = len(difference)
    share = _INDEPENDENT_ROWS / rows / _ROW_SIGMA**2
    mean = difference.mean(axis=0)
    exposure = mean.mean()
    balance = (mean - exposure) * (rows * share) / (rows * share + 1.0 / _BALANCE_SIGMA**2)
    left = difference - exposure - balance
    misfit = share * np.sum(left**2) + np.sum(balance**2) / _BALANCE_SIGMA**2
    return float(misfit), exposure + balance, float(np.sqrt(np.mean(left**2)))


Frame = TypeVar("Frame")
Fitted = TypeVar("Fitted")


def resampled(fit: Callable[[list[Frame]], Fitted], frames: Sequence[Frame], draws: int, seed: int) -> list[Fitted]:
    """Return what a fit gives of so many draws of as many frames, with replacement: the bootstrap (Efron 1979).

    Raises `ParameterError` without frames.
    """
    whole("draws", draws, 2, 1_000_000)
    if not len(frames):
        raise ParameterError("frames - must hold one or more (got none) - give the frames of a clip")
    drawn = np.random.default_rng([seed, 0xB007]).integers(0, len(frames), (draws, len(frames)))
    return [fit([frames[k] for k in row]) for row in drawn]
