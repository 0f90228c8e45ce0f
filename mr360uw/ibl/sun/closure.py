# SPDX-License-Identifier: Apache-2.0
"""The closure: light of a clipped sun, which no pixel shows, from its ratio to the light of the sky.

    E_sun sin(elevation) = ratio x E_sky

The ratio is given or by the plate's own evidence (`evidence`), and turned into that at the camera by the water above:

    s = 1 - c / (1 + R)                share of the sun at the surface, c the colour of a clear sky
    ratio = s b / (w - s b)            b, w: fractions of the beam and of all light that reach the camera

in each channel, so that thin water, b = w = 1, leaves it as it is. Colour: in air that of sunlight through the
scattering of Rayleigh (Hansen 1974, equation 2.30) and of haze (Angstrom 1964), along the air mass of Kasten 1989,
against a white balance for a sun half-way up. Under water that of the solved beam, s b, and that of the plate's own sky
times the ratio, the geometric mean of the two: the second has the camera's white balance, but misses what clipped.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from mr360uw.color import luminance
from mr360uw.ibl.level.upward import elevation_sine
from mr360uw.ibl.plate import Plate
from mr360uw.ibl.sun.evidence import UNKNOWN_RATIO, shown_ratio
from mr360uw.ibl.sun.split import Split, sky_irradiance
from mr360uw.types import Floats

_LOWEST_SINE = 0.05
"""Least sine of the elevation in the closure, 3 degrees: dividing by less would make the beam arbitrarily strong."""
_CLEAR_RATIO = 3.0
"""Direct over diffuse irradiance above water through which the sky cannot be judged: a clear sky with the sun high."""
_THIN_POWER = 20.0
"""Power of the fraction of light that reaches the camera, by which the plate's evidence counts under water: half at a
loss of 3.5 %; the glitter under more water is no glow of the sky. The water's colour counts for the rest."""
_LEAST, _MOST = 0.05, 4.0
"""Limits of the ratio at the camera under water."""
_LEAST_SHARE = 0.01
"""Least share of the sun in a channel, where hardly any of the light is its."""
_BANDS_UM = np.array([0.61, 0.55, 0.465])
"""Middle wavelengths [um] of red, green and blue."""
_HAZE, _HAZE_POWER = 0.05, 1.3
"""Optical depth of haze at 1 um, and the power of the wavelength by which it falls."""
_BALANCED_SINE = math.sin(math.radians(45.0))
"""Sine of the elevation of the sun that a camera's white balance makes white."""


__all__ = ["UNKNOWN_RATIO", "WaterLight", "clearness", "close", "sunlight"]


@dataclass(frozen=True, slots=True)
class WaterLight:
    """Fractions (3,) of the sun's beam and of all downward light at the surface that reach a camera under water."""

    beam: Floats
    whole: Floats


def clearness(water: WaterLight) -> float:
    """Return how much of the sky a camera under water judges by its own picture, 1 at the surface, 0 in the deep."""
    return float(np.clip(luminance(water.whole), 0.0, 1.0)) ** _THIN_POWER


def close(split: Split, plate: Plate, ratio: float | None, water: WaterLight | None = None) -> Split:
    """Return the split of a clipped plate with the light of its sun solved.

    ratio: direct over diffuse horizontal irradiance at the camera; None: as the plate speaks for it.
    """
    sky = np.asarray(sky_irradiance(split.residual, plate.up), np.float64)
    grey = float(luminance(sky))
    sine = max(float(elevation_sine(split.sun.direction, plate.up)), _LOWEST_SINE)
    here = shown_ratio(plate, split.sun.direction, sky) if ratio is None else ratio
    colour = sunlight(sine)
    if water is not None:
        clear = clearness(water)
        above = here if ratio is not None else here**clear * _CLEAR_RATIO ** (1.0 - clear)
        share = np.maximum(1.0 - skylight() / (1.0 + above), _LEAST_SHARE)
        each = share * water.beam / np.maximum(water.whole - share * water.beam, 1e-6)
        mixed = np.sqrt(_tinted(share * water.beam) * _tinted(each * sky))
        colour = clear * colour + (1.0 - clear) * _tinted(mixed)
        if ratio is None and grey > 0.0:
            deep = float(np.clip(luminance(each * sky) / grey, _LEAST, _MOST))
            here = above**clear * deep ** (1.0 - clear)
    wanted = here * grey / sine
    return Split(split.residual, replace(split.sun, irradiance=np.asarray(colour * wanted, np.float32)))


def _tinted(light: Floats) -> Floats:
    """Return light (3,) scaled to luminance 1, white where there is none."""
    value = float(luminance(light))
    return np.asarray(light / value) if value > 0.0 else np.ones(3)


def sunlight(sine: float) -> Floats:
    """Return the colour (3,) of the sun at a sine of its elevation, of luminance 1; white at 45 degrees."""
    colour = np.exp(-_optical_depth() * (_air_mass(sine) - _air_mass(_BALANCED_SINE)))
    return _tinted(colour)


def skylight() -> Floats:
    """Return the colour (3,) of a clear sky under a sun at 45 degrees, of luminance 1: what sunlight lost."""
    colour = 1.0 - np.exp(-_optical_depth() * _air_mass(_BALANCED_SINE))
    return _tinted(colour)


def _optical_depth() -> Floats:
    """Return the optical depth (3,) of clear air to the zenith."""
    air = 0.008569 * _BANDS_UM**-4 * (1.0 + 0.0113 * _BANDS_UM**-2 + 0.00013 * _BANDS_UM**-4)
    return np.asarray(air + _HAZE * _BANDS_UM**-_HAZE_POWER)


def _air_mass(sine: float) -> float:
    """Return the air along the way to the sun over that to the zenith (Kasten 1989, table II)."""
    degrees = math.degrees(math.asin(min(max(sine, 0.0), 1.0)))
    return float(1.0 / (math.sin(math.radians(degrees)) + 0.50572 * (degrees + 6.07995) ** -1.6364))
