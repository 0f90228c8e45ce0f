# SPDX-License-Identifier: Apache-2.0
"""Detects the sun in a plate, clipped or not.

The sun is light that stands out of the map (Iorns 2016). Candidates come from the coarse map; each is measured closely
(`blob`) and judged by properties that clouds, sand, caustics and lamps lack:

    small      an unclipped sun is half a degree wide; a clipped one grows with the exposure, but not over the sky
    alone      most light of such brightness lies in the spot (a sky of clipped clouds is bright all over)
    an edge    the surroundings are much darker, or the spot ends sharply; a bright sky has a smooth maximum
    above      over the horizon, or inside Snell's window for a camera under water

Its irradiance is the light above the threshold near it; what stays below remains in the sky, so nothing counts twice.

The bright spot bounds the light that is taken out of the sky, not the size of the sun: exposure, haze and lens make a
clipped spot up to ten times as wide as the disc that casts the shadows. A clipped sun gets the sun's true radius.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from mr360uw.constants import REFRACTIVE_INDEX_SEA, SUN_HALF_ANGLE_RAD
from mr360uw.ibl.expansion import checked_plate, snell_elevation
from mr360uw.ibl.level.upward import upward
from mr360uw.ibl.plate import LinearPlate, Plate, coarse_directions, coarse_solid_angle, plate_sines
from mr360uw.ibl.sun.blob import CLIPPED, Blob, brightness, examine
from mr360uw.ibl.sun.split import Split, split_sun
from mr360uw.types import Floats, Sun

DISPLAY_WHITE = 1.5
"""A plate with values above this is scene radiance; display-referred white is 1, with some headroom."""
_MOST_SEEDS = 600
"""Bright coarse pixels that are compared with each other; time grows with the square."""
_CANDIDATES = 3
"""Spots that are measured closely, at most; the search ends at the first one of confidence above 0.5."""
_LONE_ANGLE_RAD = np.radians(4.0)
"""Radius [rad] within which bright pixels count as one spot."""
_WIDEST_GLARE_RAD = np.radians(15.0)
"""Radius [rad] above which a bright spot is a sky, not the glare of a sun; the detector's confidence is 0 there."""


@dataclass(frozen=True, slots=True)
class Disc:
    """A candidate for the sun, and the confidence in it, 0 to 1."""

    blob: Blob
    confidence: float


def lowest_sine(underwater: bool, refractive_index: float = REFRACTIVE_INDEX_SEA) -> float:
    """Return the sine of the lowest elevation of a sun: that of the horizon, or of the edge of Snell's window."""
    return float(np.sin(snell_elevation(refractive_index))) if underwater else 0.0


def find_disc(plate: Plate, *, underwater: bool = False) -> Disc | None:
    """Return the most sun-like spot of a plate, None where nothing stands out at all."""
    floor = lowest_sine(underwater, plate.refractive_index)
    allowed = plate_sines(plate) > floor
    bright = np.where(allowed, plate.brightest, 0.0)
    value = brightness(plate.coarse)
    peak = float(bright.max())
    if peak <= 1.05 * float(np.median(plate.brightest[allowed])):
        return None
    hdr = not is_display_referred(plate)
    weight = np.where(bright >= (0.3 if hdr else 0.9) * peak, value, 0.0) * coarse_solid_angle()
    best: Disc | None = None
    for seed in _seeds(weight):
        blob = examine(plate, seed, floor, white=not hdr)
        if blob is None:
            continue
        near = coarse_directions() @ blob.direction > np.cos(max(2.0 * blob.radius_rad, _LONE_ANGLE_RAD))
        lone = float(weight[near].sum() / weight.sum())
        contrast = blob.peak / max(float(np.median(value)), 1e-6)
        disc = Disc(blob, confidence(blob, lone, contrast, hdr=hdr, underwater=underwater))
        if best is None or disc.confidence > best.confidence:
            best = disc
        if best.confidence > 0.5:
            break
    return best


def _seeds(weight: Floats) -> Iterator[Floats]:
    """Yield directions (3,) about which most weight lies, within 4 degrees, each 15 degrees from those before."""
    chosen = weight > 0.0
    d, w = coarse_directions()[chosen], weight[chosen]
    step = len(d) // _MOST_SEEDS + 1  # of a sky that is bright all over any few pixels will do
    d, w = d[::step], w[::step]
    gathered = np.exp((d @ d.T - 1.0) / _LONE_ANGLE_RAD**2) @ w
    for _ in range(_CANDIDATES):
        k = int(gathered.argmax())
        if gathered[k] <= 0.0:
            return
        yield d[k]
        gathered = np.where(d @ d[k] > np.cos(np.radians(15.0)), 0.0, gathered)


def _falling(x: float, one: float, zero: float) -> float:
    """Return 1 for x on the side of `one`, 0 on that of `zero`, a smooth step between."""
    t = float(np.clip((x - zero) / (one - zero), 0.0, 1.0))
    return t * t * (3.0 - 2.0 * t)


def confidence(blob: Blob, lone: float, contrast: float, *, hdr: bool, underwater: bool) -> float:
    """Return the confidence, 0 to 1, that a spot is a sun; above 0.5 it is taken for one.

    lone: its share of all light as bright. contrast: peak over the median value of the map.
    """
    radius = float(np.degrees(blob.radius_rad)) / (1.5 if underwater else 1.0)
    if hdr:
        return _falling(radius, 0.5, 1.0) * _falling(np.log10(contrast), 3.6, 2.6) * _falling(lone, 0.7, 0.3)
    size = _falling(radius, 5.0, 15.0) if blob.clipped else _falling(radius, 1.0, 3.0)
    white = _falling(blob.peak, CLIPPED, CLIPPED - 0.1)
    edge = max(_falling(blob.halo, 0.55, 0.8), _falling(blob.radius_rad / blob.extent_rad, 0.7, 0.4))
    return size * white * _falling(lone, 0.5, 0.15) * edge


def half_angle(underwater: bool, refractive_index: float = REFRACTIVE_INDEX_SEA) -> float:
    """Return the angular radius [rad] of the sun's disc, in air or as seen from the water through the surface.

    Refraction divides the angles across its plane by the index of the water. Along it the disc is narrower still, but
    waves tilt by far more: the round disc is the sharpest that shadows get (`draw.sun_spread_deg` widens them).
    """
    return SUN_HALF_ANGLE_RAD / refractive_index if underwater else SUN_HALF_ANGLE_RAD


def is_display_referred(plate: Plate) -> bool:
    """Return whether a plate ends at display white, so that a sun in it is clipped."""
    return float(plate.brightest.max()) <= DISPLAY_WHITE


def glare_radius(plate: Plate, direction: Floats) -> float:
    """Return the radius [rad] of the bright spot that a sun towards `direction` (3,) makes; 0 where there is none."""
    blob = examine(plate, direction, -1.0, white=is_display_referred(plate))
    if blob is None or blob.radius_rad > _WIDEST_GLARE_RAD:
        return 0.0
    return blob.radius_rad if float(blob.direction @ direction) > np.cos(blob.radius_rad) else 0.0


def split_given(plate: Plate, direction: Floats, half_angle_rad: float, confidence: float) -> Split:
    """Return the plate's expanded map split into a sun given towards `direction` and the rest."""
    return split_sun(plate, direction, max(glare_radius(plate, direction), half_angle_rad), half_angle_rad, confidence)


def split_disc(plate: Plate, disc: Disc, *, underwater: bool = False) -> Split:
    """Return the plate's expanded map split into this sun and the rest; one that is not clipped is centred.

    Its half angle is the measured one, or where it is clipped that of the sun.
    """
    blob = disc.blob
    clipped = is_display_referred(plate) and (blob.clipped or blob.peak >= CLIPPED)
    size = half_angle(underwater, plate.refractive_index) if clipped else blob.radius_rad
    return split_sun(plate, blob.direction, blob.radius_rad, size, disc.confidence, centred=not blob.clipped)


def detect_sun(
    plate: ArrayLike,
    underwater: bool = False,
    *,
    up: ArrayLike | None = None,
    refractive_index: float = REFRACTIVE_INDEX_SEA,
) -> Sun | None:
    """Return the sun of a linear plate (H, W, 3), HDR or clipped to display white = 1; None where there is none.

    underwater: look inside Snell's window only; the direction is that in the water. up, refractive_index: as in
    `environment`. The irradiance is that of the plate as it is: of a clipped one far too low (see `environment`).
    Raises `ParameterError` for other arrays.
    """
    seen = LinearPlate.of(checked_plate(plate), up=upward(up), refractive_index=refractive_index)
    disc = find_disc(seen, underwater=underwater)
    return None if disc is None or disc.confidence <= 0.0 else split_disc(seen, disc, underwater=underwater).sun
