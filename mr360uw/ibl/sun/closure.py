# SPDX-License-Identifier: Apache-2.0
"""The closure: light of a clipped sun, which no pixel shows, from its ratio to the light of the sky.

    E_sun sin(elevation) = ratio x E_sky

The ratio is given or by the plate's own evidence (`evidence`). The colour is that of sunlight through the scattering
of Rayleigh (Hansen 1974, equation 2.30) and of haze (Angstrom 1964), along the air mass of Kasten 1989, against a white
balance for a sun half-way up. Losses in water are not part of it.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from mr360uw.color import luminance
from mr360uw.ibl.level.upward import elevation_sine
from mr360uw.ibl.plate import Plate
from mr360uw.ibl.sun.evidence import shown_ratio
from mr360uw.ibl.sun.split import Split, sky_irradiance
from mr360uw.types import Floats

_LOWEST_SINE = 0.05
"""Least sine of the elevation in the closure, 3 degrees: dividing by less would make the beam arbitrarily strong."""
_BANDS_UM = np.array([0.662, 0.554, 0.439])
"""Wavelengths [um] that are scattered as red, green and blue of linear Rec.709 are: fitted to the integral of the sun's
spectrum over the CIE 1931 observer for elevations of 5 to 90 degrees, to 0.03. The dominant wavelengths of the
primaries (0.61, 0.55, 0.465) redden a sun at 8 degrees by half as much."""
_HAZE, _HAZE_POWER = 0.05, 1.3
"""Optical depth of haze at 1 um, and the power of the wavelength by which it falls."""
_CLEAR_RATIO = 3.0
"""Direct over diffuse horizontal irradiance for a sun half-way up in clear air: a diffuse part of a quarter."""
BALANCED_SINE = math.sin(math.radians(45.0))
"""Sine of the elevation of the sun that a camera's white balance makes white."""


def close(split: Split, plate: Plate, ratio: float | None, *, disc: bool) -> Split:
    """Return the split of a clipped plate with the light of its sun solved.

    ratio: direct over diffuse horizontal irradiance at the camera; None: as the plate speaks for it. disc: whether
    hardly more than the sun's own disc is clipped.
    """
    sky = np.asarray(sky_irradiance(split.residual, plate.up), np.float64)
    grey = float(luminance(sky))
    sine = max(float(elevation_sine(split.sun.direction, plate.up)), _LOWEST_SINE)
    clear = clear_ratio(sine) if disc else None
    here = shown_ratio(plate, split.sun.direction, sky, clear) if ratio is None else ratio
    wanted = here * grey / sine
    irradiance = np.asarray(sunlight(sine) * wanted, np.float32)
    return Split(split.residual, replace(split.sun, irradiance=irradiance, shown=0.0))


def sunlight(sine: float) -> Floats:
    """Return the colour (3,) of the sun at a sine of its elevation, of luminance 1; white at 45 degrees."""
    colour = np.exp(-clear_air_depth() * (air_mass(sine) - air_mass(BALANCED_SINE)))
    return np.asarray(colour / luminance(colour))


def clear_ratio(sine: float) -> float:
    """Return the direct over diffuse horizontal irradiance under clear air at a sine of the sun's elevation: as what
    the air lets through over what it scatters.
    """

    def odds(s: float) -> float:
        passed = float(luminance(np.exp(-clear_air_depth() * air_mass(s))))
        return passed / (1.0 - passed)

    return _CLEAR_RATIO * odds(sine) / odds(BALANCED_SINE)


def clear_air_depth() -> Floats:
    """Return the optical depth (3,) of clear air to the zenith."""
    air = 0.008569 * _BANDS_UM**-4 * (1.0 + 0.0113 * _BANDS_UM**-2 + 0.00013 * _BANDS_UM**-4)
    return np.asarray(air + _HAZE * _BANDS_UM**-_HAZE_POWER)


def air_mass(sine: float) -> float:
    """Return the air along the way to the sun over that to the zenith (Kasten 1989, table II)."""
    degrees = math.degrees(math.asin(min(max(sine, 0.0), 1.0)))
    return float(1.0 / (math.sin(math.radians(degrees)) + 0.50572 * (degrees + 6.07995) ** -1.6364))
