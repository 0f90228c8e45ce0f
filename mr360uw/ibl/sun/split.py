# SPDX-License-Identifier: Apache-2.0
"""Splits the environment map into sun and sky, so that the two add up to it.

    removed light of a pixel: H - H min(1, Yt/Y),   Yt = mean + 2 sigma of the map's luminance, at most half the peak

(Iorns 2016, with mean and deviation weighted by solid angle.) A wide sun would raise that threshold by itself, so the
light of an unclipped disc is told by the sky right about it instead. Where the sun is clipped its light cannot be
measured: the closure solves for it.

Under water waves and small-angle scattering spread the sun over many degrees. That glare is the beam's; what stays of
it in the sky would count twice, and most of all in red, of which deep water leaves the sky little. The sky itself
hardly depends on the azimuth, so near the sun it is that of the same elevation far from the sun:

    residual' = residual + w (sky(elevation) - residual)       w: `amount` near the sun, 0 from `_REACH_RAD` on

Bodies before the sky, far darker than it, stay.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.cache import shared
from mr360uw.base.color import luminance
from mr360uw.base.constants import CLEAR_SKY_B, CLEAR_SKY_G, CLEAR_SKY_R, REFRACTIVE_INDEX_SEA
from mr360uw.base.optics import fresnel_transmittance
from mr360uw.base.sphere import Array, frame_from_direction, row_solid_angle, unit
from mr360uw.ibl.plate import (
    COARSE_COLUMNS,
    COARSE_ROWS,
    Plate,
    coarse_directions,
    coarse_solid_angle,
    patch_directions,
    patch_step,
    plate_sines,
)
from mr360uw.ibl.tilt import LEVEL, elevation_sine
from mr360uw.types import Floats, Sun

_PATCH = 81
"""Samples across the patch about the sun."""
_SAMPLES_ACROSS = 4.0
"""Least number of samples across a coarse pixel that is split; with fewer, slivers about a pole are missed."""
_REACH = 2.0
"""Radius within which the sun's light is gathered, in radii of the spot: disc and glare, but no cloud far from it."""
_MARGIN_RAD = np.pi / COARSE_ROWS
"""Width [rad] of the rim that is sampled beyond the reach, so that coarse pixels on it are sampled as a whole."""
_NARROWEST_RAD, _WIDEST_RAD = np.radians(1.5), 1.0
"""Limits of the reach [rad]."""
_RING_QUANTILE = 0.9
"""Quantile of the sky right outside the reach that is still the sky's within it."""


def taken_in_part(residual: Floats, sun: Sun, share: float, coarse: Floats) -> tuple[Floats, Sun]:
    """Return the parts of a coarse map that leave all but a share of the sun's light in the first of them."""
    if share == 1.0:
        return residual, sun
    sun = replace(sun, irradiance=np.float32(share) * sun.irradiance, share=share)
    return coarse + np.float32(share) * (residual - coarse), sun


def threshold(coarse: Floats) -> float:
    """Return the mean of a coarse map's luminance plus two deviations, over solid angle."""
    value = luminance(coarse)
    weight = coarse_solid_angle() / (4.0 * np.pi)
    mean = float((value * weight).sum())
    return mean + 2.0 * float(np.sqrt((np.square(value - mean) * weight).sum()))


def split_sun(
    plate: Plate,
    direction: Floats,
    radius_rad: float,
    half_angle_rad: float,
    confidence: float,
    *,
    centred: bool = False,
    local: bool = False,
) -> tuple[Floats, Sun]:
    """Return the coarse map (128, 256, 3) of a plate without the light near `direction` that stands out, and this sun.

    radius_rad: of the bright spot in the plate, about which light is gathered. half_angle_rad: of the sun itself, which
    is far smaller where the plate is clipped. centred: its direction becomes the centroid of that light. local: the
    light above the sky right about it is the sun's, as that of an unclipped disc is, whatever the whole map holds.
    """
    reach = min(max(_REACH * radius_rad, _NARROWEST_RAD), _WIDEST_RAD)
    look = patch_directions(direction, reach + _MARGIN_RAD, _PATCH)
    colour = plate.look_expanded(look)
    value = np.maximum(luminance(colour), 1e-9)
    bound = min(threshold(plate.coarse), 0.5 * float(value.max()))
    along = look @ direction
    inside = along > np.cos(reach)
    floor = None
    if local:
        ring = (along > np.cos(reach + _MARGIN_RAD)) & ~inside
        floor = np.quantile(colour[ring], _RING_QUANTILE, axis=0)
        bound = min(bound, float(luminance(floor)))
    share = np.maximum(1.0 - bound / value, 0.0) * inside
    span = _spans(patch_step(reach + _MARGIN_RAD, _PATCH))
    cell, (taken, seen) = _gather(COARSE_COLUMNS, COARSE_ROWS, look, colour * share[..., None], colour, span=span)
    # as a fraction of each coarse pixel, which samples of the patch cannot overdraw
    residual, energy = _take_out(plate.coarse, cell, taken / np.maximum(seen, 1e-12), span, floor)
    if centred:
        direction = unit((value * share).ravel() @ look.reshape(-1, 3))
    sun = Sun(np.asarray(direction, np.float64), energy.astype(np.float32), half_angle_rad, confidence)
    return residual, sun


def _spans(step: float) -> NDArray[np.int64]:
    """Return the number of pixels of each row of a coarse map (rows,) that are merged, a power of two.

    About a pole the pixels are slivers, narrower than samples `step` [rad] apart, which would miss some of them.
    """
    colatitude = np.pi * (np.arange(COARSE_ROWS) + 0.5) / COARSE_ROWS
    wanted = _SAMPLES_ACROSS * step / (2.0 * np.pi / COARSE_COLUMNS * np.sin(colatitude))
    power = np.ceil(np.log2(np.clip(wanted, 1.0, COARSE_COLUMNS)))
    return np.asarray(2**power, np.int64)


def _take_out(
    coarse: Floats,
    cell: tuple[NDArray[np.int64], ...],
    fraction: NDArray[np.float64],
    span: NDArray[np.int64],
    floor: Floats | None,
) -> tuple[Floats, Floats]:
    """Return a coarse map without a fraction (n, 3) of some pixels, evened out over each span, and the energy taken.

    floor: (3,) of the sky, or None; with it all that is above it goes, whatever the fraction, if that is not 0.
    """
    row, column = cell
    number = span[row]
    first = np.cumsum(number) - number
    rows = np.repeat(row, number)
    columns = np.repeat(column - first, number) + np.arange(len(rows))
    light = np.add.reduceat(coarse[rows, columns], first, axis=0) / number[:, None]
    removed = fraction * light if floor is None else np.maximum(light - floor, 0.0) * (fraction > 0.0)
    residual = coarse.copy()
    changed = np.repeat(fraction.any(axis=1), number)
    residual[rows[changed], columns[changed]] = np.repeat(light - removed, number, axis=0)[changed]
    return residual, (removed * number[:, None] * coarse_solid_angle()[row]).sum(axis=0)


def _gather(
    width: int, height: int, look: Floats, *lights: Floats, span: NDArray[np.int64] | None = None
) -> tuple[tuple[NDArray[np.int64], ...], list[NDArray[np.float64]]]:
    """Return the pixels (rows, columns) of a map that directions fall into, and the sums (n, 3) of each light there.

    span: of each row, the number of neighbours that are merged into the first of them.
    """
    x, y = frame_from_direction(look, width, height)
    row = np.clip(y.astype(np.int64), 0, height - 1)
    column = x.astype(np.int64) % width
    if span is not None:
        column -= column % span[row]
    index = (row * width + column).ravel()
    number = np.zeros(width * height, np.int64)
    number[index] = 1
    cell = np.flatnonzero(number)
    number[cell] = np.arange(len(cell))
    place = (3 * number[index][:, None] + np.arange(3)).ravel()
    sums = [np.bincount(place, light.ravel()).astype(np.float64).reshape(-1, 3) for light in lights]
    return np.divmod(cell, width), sums


def with_sun(residual: Floats, sun: Sun) -> Floats:
    """Return a map (H, W, 3) with the sun's light spread evenly over its disc."""
    radius = max(sun.half_angle_rad, np.radians(0.2))
    look = patch_directions(sun.direction, radius, 33)
    weight = 1.0 * (look @ sun.direction >= np.cos(min(radius, np.pi)))
    height, width = residual.shape[:2]
    light = (weight / weight.sum())[..., None] * np.asarray(sun.irradiance, np.float64)
    cell, (light,) = _gather(width, height, look, light)
    out = residual.copy()
    out[cell] += light / row_solid_angle(width, height)[cell[0], None]
    return out


def sky_irradiance(residual: Floats, up: Array = LEVEL) -> Floats:
    """Return the irradiance (3,) of a horizontal plane by the half of a coarse map that is above it."""
    weight = np.maximum(elevation_sine(coarse_directions(), up), 0.0) * coarse_solid_angle()
    return np.tensordot(weight, residual, ([0, 1], [0, 1]))


_REACH_RAD = np.radians(20.0)
"""Angle from the sun [rad] from which the sky is its own. At 16 and at 25 degrees its irradiance differs by 1 %; far
beyond, the sky near a high sun would be read from the window's edge."""
_FADE = 0.25
"""Fraction of that angle over which the weight falls to 0."""
_RINGS = 64
"""Steps of elevation, 1.4 degrees, a pixel of the coarse map each."""
_FEWEST = 6
"""Fewest pixels far from the sun that tell the sky of an elevation; others take that of the nearest."""
_BODY, _SKY = 0.4, 0.7
"""Luminance over that of the sky up to which a pixel is a body, and from which it is sky."""


def without_glare(residual: Floats, sun: Sun, plate: Plate, amount: float = 1.0) -> tuple[Floats, Sun]:
    """Return a residual that is the sky's near the sun; what is taken out of it is added to the sun.

    amount: of the glare that is taken out, 0 to 1.
    """
    # Sort what is above the horizon into near the sun, where there is glare, and far from it
    if amount <= 0.0:
        return residual, sun
    above, elevation, rings = _rings(tuple(plate.up.tolist()))
    angle = np.arccos(np.clip(coarse_directions() @ sun.direction.astype(np.float32), -1.0, 1.0))
    near = above & (angle < _REACH_RAD)
    far = above & ~near
    # Take the sky of each elevation from far away
    ring = rings[far]
    count = np.bincount(ring, minlength=_RINGS)
    told = count >= _FEWEST
    if not np.any(near) or not np.any(told):
        return residual, sun
    place = np.bincount(ring, elevation[far], _RINGS)[told] / count[told]
    shown = residual[far]
    sky = np.stack(
        [
            np.interp(elevation[near], place, np.bincount(ring, shown[:, k], _RINGS)[told] / count[told])
            for k in range(3)
        ],
        axis=-1,
    )
    # Bend what is near to that sky, but not where something dark stands before it
    seen = residual[near]
    clear = np.clip((luminance(seen) / np.maximum(luminance(sky), 1e-12) - _BODY) / (_SKY - _BODY), 0.0, 1.0)
    weight = amount * clear * np.clip((_REACH_RAD - angle[near]) / (_FADE * _REACH_RAD), 0.0, 1.0)
    change = weight[:, None] * (sky - seen)
    # Give to the sun what that took
    residual = residual.copy()
    residual[near] = seen + change
    area = np.broadcast_to(coarse_solid_angle(), near.shape)[near]
    taken: Floats = np.maximum(sun.irradiance - area @ change, 0.0).astype(np.float32)
    return residual, replace(sun, irradiance=taken)


@shared(keep=4)
def _rings(up: tuple[float, ...]) -> tuple[NDArray[np.bool_], Floats, NDArray[Any]]:
    """Return of the coarse map's pixels (128, 256): whether they are above the horizon, elevation [rad], and ring."""
    sine = elevation_sine(coarse_directions(), np.array(up))
    elevation = np.arcsin(np.clip(sine, -1.0, 1.0))
    ring = np.clip((elevation * (2.0 * _RINGS / np.pi)).astype(np.int64), 0, _RINGS - 1)
    return sine > 0.0, elevation, ring


# --- a clipped sun --------------------------------------------------------------------------------------------------

# The closure: light of a clipped sun, which no pixel shows, from its ratio to the light of the sky.
#
#     E_sun sin(elevation) = ratio x E_sky
#
# The ratio is given or by what did not clip in the plate: the sky's glow about the sun, and the ground that it lights.
#
#     ratio = sqrt(R_glow R_ground)     direct over diffuse horizontal irradiance
#     R_glow = 0.1 (G - 4)              G: radiance of the sky 4 degrees from the sun, over that far from it
#     R_ground = B / 0.3 - 1            B: radiance of the bright part of the ground, over white's under the sky alone
#
# The clearer the air, the more of its light a sun sends straight and the steeper the glow that is left; G is 4 or less
# under a cloud or at dusk, without any beam. Where more is clipped than 4 degrees, the glow further out is followed
# inwards as the inverse of the angle. The brightest tenth of the ground is sunlit and of albedo 0.3, or lit by the sky
# alone. Neither is exact; only where both speak for a sun there is much of one. Where hardly more than the sun's
# disc is clipped, it shines through clear air, whose ratio then stands for that of the glow.
#
# The colour is that of sunlight through the scattering of Rayleigh (Hansen 1974, equation 2.30) and of haze (Angstrom
# 1964), along the air mass of Kasten 1989, against a white balance for a sun half-way up. Losses in water are not part
# of it. `beam_below` and `direct_share` are of sun and sky of a clear day just below the surface.


_GLOW_PER_RATIO, _GLOW_OF_CLOUD = 0.1, 4.0
_ALBEDO = 0.3
_NEAR_RAD, _FAR_RAD = np.radians(4.0), np.radians(50.0)
"""Angles from the sun [rad] whose radiance is compared."""
_LIT_RINGS = 12
"""Rings of the sky between them that are looked at, evenly spaced in the logarithm of the angle."""
_FEWEST_LIT = 4
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
    edges = np.geomspace(_NEAR_RAD / 1.25, _FAR_RAD, _LIT_RINGS + 1)
    if far.size < 100 * _FEWEST_LIT or float(np.median(far)) <= 0.0:
        return None
    for inner, outer in itertools.pairwise(edges):
        ring = (angle > inner) & (angle <= outer)
        seen = ring & open_sky
        if np.count_nonzero(seen) < max(_FEWEST_LIT, 0.5 * np.count_nonzero(ring & above)):
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
    if np.count_nonzero(ground) < 100 * _FEWEST_LIT or white <= 0.0:
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


def close(residual: Floats, sun: Sun, plate: Plate, ratio: float | None, *, disc: bool) -> Sun:
    """Return the sun of a clipped plate with its light solved. residual: the coarse map without it.

    ratio: direct over diffuse horizontal irradiance at the camera; None: as the plate speaks for it. disc: whether
    hardly more than the sun's own disc is clipped.
    """
    sky = np.asarray(sky_irradiance(residual, plate.up), np.float64)
    grey = float(luminance(sky))
    sine = max(float(elevation_sine(sun.direction, plate.up)), _LOWEST_SINE)
    clear = clear_ratio(sine) if disc else None
    here = shown_ratio(plate, sun.direction, sky, clear) if ratio is None else ratio
    wanted = here * grey / sine
    irradiance = np.asarray(sunlight(sine) * wanted, np.float32)
    return replace(sun, irradiance=irradiance, shown=0.0)


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
