# SPDX-License-Identifier: Apache-2.0
"""The closure: light of a clipped sun, which no pixel shows, from its ratio to the light of the sky.

    E_sun sin(elevation) = ratio x E_sky

The ratio is given or by what did not clip in the plate: the sky's glow about the sun, and the ground that it lights.

    ratio = sqrt(R_glow R_ground)     direct over diffuse horizontal irradiance
    R_glow = 0.1 (G - 4)              G: radiance of the sky 4 degrees from the sun, over that far from it
    R_ground = B / 0.3 - 1            B: radiance of the bright part of the ground, over white's under the sky alone

The clearer the air, the more of its light a sun sends straight and the steeper the glow that is left; G is 4 or less
under a cloud or at dusk, without any beam. Where more is clipped than 4 degrees, the glow further out is followed
inwards as the inverse of the angle. The brightest tenth of the ground is sunlit and of albedo 0.3, or lit by the sky
alone. Neither is exact; only where both speak for a sun there is much of one. Where hardly more than the sun's
disc is clipped, it shines through clear air, whose ratio then stands for that of the glow.

The colour is that of sunlight through the scattering of Rayleigh (Hansen 1974, equation 2.30) and of haze (Angstrom
1964), along the air mass of Kasten 1989, against a white balance for a sun half-way up. Losses in water are not part of
it. `beam_below` and `direct_share` are of sun and sky of a clear day just below the surface.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np

from mr360uw.color import luminance
from mr360uw.constants import CLEAR_SKY_B, CLEAR_SKY_G, CLEAR_SKY_R, REFRACTIVE_INDEX_SEA
from mr360uw.ibl.plate import Plate, coarse_directions, coarse_solid_angle, plate_sines
from mr360uw.ibl.sun.split import Split, sky_irradiance
from mr360uw.ibl.tilt import elevation_sine
from mr360uw.optics import fresnel_transmittance
from mr360uw.types import Floats

_GLOW_PER_RATIO, _GLOW_OF_CLOUD = 0.1, 4.0
_ALBEDO = 0.3
_NEAR_RAD, _FAR_RAD = np.radians(4.0), np.radians(50.0)
"""Angles from the sun [rad] whose radiance is compared."""
_RINGS = 12
"""Rings of the sky between them that are looked at, evenly spaced in the logarithm of the angle."""
_FEWEST = 4
"""Fewest pixels of a ring; of the ground, and of the sky far from the sun, a hundred times as many."""
_CLIPPED = 0.9
"""Radiance up to which a coarse pixel, a mean of many of the plate's, holds none that clipped."""
_LOWEST_SINE = 0.05
"""Sine of the elevation, 3 degrees, above which is sky, and below whose negative is ground. Also the least of a sun in
the closure: dividing by less would make the beam arbitrarily strong."""
_GROUND_QUANTILE = 0.9
_LEAST, _MOST = 0.05, 5.0
"""Limits of both ratios: from a sun behind clouds to the clearest sky."""
UNKNOWN_RATIO = 1.0
"""The ratio where a plate shows neither: between haze (0.2) and a clear sky (5)."""


def shown_ratio(plate: Plate, direction: Floats, sky: Floats, clear: float | None) -> float:
    """Return the direct over diffuse horizontal irradiance that a clipped plate speaks for.

    direction: (3,) of the sun. sky: (3,) horizontal irradiance without it. clear: the ratio in clear air where the
    plate shows the sun's disc, None where it does not.
    """
    value = luminance(plate.coarse)
    sine = plate_sines(plate)
    known = [
        float(np.clip(ratio, _LEAST, _MOST))
        for ratio in (_by_glow(plate, value, sine, direction) if clear is None else clear, ground_ratio(plate, sky))
        if ratio is not None
    ]
    return float(np.exp(np.mean(np.log(known)))) if known else UNKNOWN_RATIO


def _by_glow(plate: Plate, value: Floats, sine: Floats, direction: Floats) -> float | None:
    angle = np.arccos(np.clip(coarse_directions() @ direction, -1.0, 1.0))
    above = sine > _LOWEST_SINE
    far = value[above & (angle > _FAR_RAD)]
    open_sky = above & (plate.brightest < _CLIPPED)
    edges = np.geomspace(_NEAR_RAD / 1.25, _FAR_RAD, _RINGS + 1)
    if far.size < 100 * _FEWEST or float(np.median(far)) <= 0.0:
        return None
    for inner, outer in itertools.pairwise(edges):
        ring = (angle > inner) & (angle <= outer)
        seen = ring & open_sky
        if np.count_nonzero(seen) < max(_FEWEST, 0.5 * np.count_nonzero(ring & above)):
            continue
        near = float(np.median(value[seen])) * float(np.sqrt(inner * outer)) / _NEAR_RAD
        return _GLOW_PER_RATIO * (near / float(np.median(far)) - _GLOW_OF_CLOUD)
    return None


def ground_ratio(plate: Plate, sky: Floats) -> float | None:
    """Return the ratio that the ground alone speaks for; below 0 where it is darker than the sky lights it.

    sky: (3,) horizontal irradiance. None where there is neither ground nor light.
    """
    value = luminance(plate.coarse)
    ground = plate_sines(plate) < -_LOWEST_SINE
    white = float(luminance(sky)) / np.pi
    if np.count_nonzero(ground) < 100 * _FEWEST or white <= 0.0:
        return None
    weight = np.broadcast_to(coarse_solid_angle(), value.shape)[ground]
    order = np.argsort(value[ground])
    share = np.cumsum(weight[order])
    bright = float(np.interp(_GROUND_QUANTILE * share[-1], share, value[ground][order]))
    return bright / white / _ALBEDO - 1.0


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


CLEAR_SKY_DIRECT = 0.75
"""Direct fraction of the irradiance just below the surface, for a high sun in a clear sky."""
_LEAST_WHITE = 0.65
"""Least share of a beam whose colour makes the sum with the sky white. Beams of less, of low suns and in haze, keep its
colour: with a share of 0.2 a white sum would leave no blue in them."""
CLEAR_SKY = np.array([CLEAR_SKY_R, CLEAR_SKY_G, CLEAR_SKY_B])


def beam_below(share: float, air_sine: float) -> Floats:
    """Return the irradiance (3,) of the sun's beam just below the surface over that of sun and sky together.

    share: of the beam in the luminance. air_sine: sine of the sun's elevation above the surface. A beam of a high sun
    and a sky of the colour `CLEAR_SKY` are white together; a sun below 45 degrees is redder by its longer way through
    the air.
    """
    high = max(share, _LEAST_WHITE)
    white = share * (1.0 - (1.0 - high) * CLEAR_SKY) / high
    return np.asarray(white * sunlight(min(air_sine, BALANCED_SINE)))


def direct_share(sine: float) -> float:
    """Return the fraction of the irradiance just below the surface that is the beam of a sun at a sine of elevation.

    Direct over diffuse goes with what clear air lets through over what it scatters, times what the surface lets through
    of the beam; at 45 degrees the fraction is `CLEAR_SKY_DIRECT`.
    """

    enters = fresnel_transmittance(np.array([sine, BALANCED_SINE]), REFRACTIVE_INDEX_SEA)
    whole = CLEAR_SKY_DIRECT / (1.0 - CLEAR_SKY_DIRECT) * float(enters[0] / enters[1])
    ratio = whole * clear_ratio(sine) / clear_ratio(BALANCED_SINE)
    return ratio / (1.0 + ratio)
