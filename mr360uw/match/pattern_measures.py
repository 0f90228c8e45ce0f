# SPDX-License-Identifier: Apache-2.0
"""Measures of a moving pattern of light on a level floor: contrast, scale, speed and direction of travel.

    C(x, t) = E(x, t)/<E(x)>_t - 1        P(k, w) = |F{h C}|^2 / (n sum h^2)

E: light of the floor at world (x, z), <>_t its mean over time, which takes the texture of the floor with it. h: Hann
window over x, z and t. P sums to the variance of C. A wave cos(k.x - w t) has its power at -k where w > 0 in the sign
of the transform: it travels along +k. Waves and what they focus travel alike, so directions have their sign.

Pictures show the plate's caustics on the floor beside ours, and their spectra. North (-z) is at the top.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mr360uw.constants import GRAVITY_M_S2
from mr360uw.errors import ParameterError
from mr360uw.types import Array, Floats

Codes = NDArray[np.uint8]

_SIDE = 320
"""Pixels of one square."""
_LABEL_ROWS, _GAP = 26, 6
_BRIGHTEST = 3.0
"""Standard deviations of the plate's light above its mean that are white; as many below are black."""
_FINEST_M = 0.25
"""Wavelength [m] at the edge of the spectra."""
_DECADES = 3.0
"""Powers of ten of a spectrum between black and white."""
_NAMES = ("plate", "ours before", "ours after")


def floor_pictures(shown: Sequence[PatternMeasures]) -> Codes:
    """Return the light of floors (plate, before, after) side by side, (H, W, 3), on one scale."""
    reach = _BRIGHTEST * max(float(np.std(shown[0].relative)), 1e-6)
    grey = [np.clip(0.5 + 0.5 * one.relative / reach, 0.0, 1.0) for one in shown]
    labels = [f"{name}, contrast {100 * one.contrast:.0f} %" for name, one in zip(_NAMES, shown, strict=False)]
    return _side_by_side(grey, labels)


def spectrum_pictures(shown: Sequence[PatternMeasures], pixel_m: float) -> Codes:
    """Return the power over wave vectors of travel, long waves in the middle, as logarithms on one scale."""
    parts = []
    top = max(float(shown[0].spectrum.max()), 1e-30)
    for one in shown:
        power = one.spectrum
        n = len(power)
        half = int(np.clip(round(n * pixel_m / _FINEST_M), 2, n // 2 - 1))
        middle = slice(n // 2 - half, n // 2 + half + 1)
        level = np.log10(np.maximum(power[middle, middle], 1e-30) / top)
        parts.append(np.clip(1.0 + level / _DECADES, 0.0, 1.0))
    labels = [
        f"{name}, {one.scale_m:.2f} m to {one.azimuth_deg:.0f} deg" for name, one in zip(_NAMES, shown, strict=False)
    ]
    return _side_by_side(parts, labels)


def _side_by_side(parts: Sequence[Floats], labels: Sequence[str]) -> Codes:
    """Return pictures (n, n) of 0 to 1 as squares in a row, (H, W, 3), each with its label below."""
    import cv2

    sheet = np.full((_SIDE + _LABEL_ROWS, len(parts) * (_SIDE + _GAP) - _GAP, 3), 24, np.uint8)
    for number, (part, label) in enumerate(zip(parts, labels, strict=True)):
        left = number * (_SIDE + _GAP)
        codes = np.asarray(255.0 * part + 0.5, np.float32).astype(np.uint8)
        square = cv2.resize(codes, (_SIDE, _SIDE), interpolation=cv2.INTER_LINEAR)
        sheet[:_SIDE, left : left + _SIDE] = square[..., None]
        at = left + 4, _SIDE + _LABEL_ROWS - 8
        cv2.putText(sheet, label, at, cv2.FONT_HERSHEY_SIMPLEX, 0.5, (235, 235, 235), 1, cv2.LINE_AA)
    return sheet


BANDS_PER_OCTAVE = 2
"""Bands of wavelength in an octave. Twice as many, each holds half the waves and varies more by chance."""
_FEWEST_PERIODS = 3.0
"""Least number of wavelengths across the region in its longest band; the window halves them."""
_BROADEST = 0.15
"""Standard deviation, over the region's side, of the blur that is taken out: a wave as long as the longest band keeps
0.99 of its amplitude. Twice as large, that of the exposure stays in."""
_TINY = 1e-30


@dataclass(frozen=True, slots=True, eq=False)
class PatternMeasures:
    """Measures of a pattern over a square region.

    contrast: standard deviation over mean. wavelength_m: (b,) middle of each band, ascending. power: (b,) variance of
    the relative light in each band. frequency_rad_s: (b,) mean angular frequency of each band, weighted by power.
    direction: (2,) over (x, z), mean unit vector of travel weighted by power; its length is 0 for a pattern without
    direction and 1 for a plane wave. spectrum: (n, n) power over wave vectors of travel, zero in the middle. relative:
    (n, n) C at the time in the middle.
    """

    contrast: float
    wavelength_m: Array
    power: Array
    frequency_rad_s: Array
    direction: Array
    spectrum: Array
    relative: Floats

    @property
    def scale_m(self) -> float:
        """Mean wavelength [m] of the bands, of the logarithm and weighted by power."""
        return float(np.exp(np.average(np.log(self.wavelength_m), weights=np.maximum(self.power, _TINY))))

    @property
    def dispersion(self) -> float:
        """Median over the bands of the frequency over that of deep-water waves of the same length, sqrt(g k).

        About 1 for caustics at the right scale; it grows with the square root of a floor's height that is too large.
        """
        waves = np.sqrt(GRAVITY_M_S2 * 2.0 * np.pi / self.wavelength_m)
        return float(np.median(self.frequency_rad_s / waves))

    @property
    def azimuth_deg(self) -> float:
        """Azimuth [deg] of the direction of travel, 0 = forward (-z), 90 = right (+x), in [0, 360)."""
        return float(np.degrees(np.arctan2(self.direction[0], -self.direction[1]))) % 360.0


def relative_light(light: Floats) -> NDArray[np.float32]:
    """Return C (T, n, n) of a series of the light (T, n, n) of a floor; 0 where the mean is not positive.

    What changes over more than `_BROADEST` of the region is taken out of every frame: exposure, shade, shafts.
    """
    import cv2

    mean = light.mean(axis=0, dtype=np.float64)
    lit = mean > 0.0
    relative = np.where(lit, light / np.where(lit, mean, 1.0) - 1.0, 0.0).astype(np.float32)
    sigma = _BROADEST * light.shape[1]
    return np.array([one - cv2.GaussianBlur(one, (0, 0), sigma, borderType=cv2.BORDER_REFLECT) for one in relative])


def bands(size_m: float, finest_m: float) -> Array:
    """Return the edges (b + 1,) [m], ascending, of the bands of wavelength that a region shows.

    size_m: side of the region. finest_m: shortest wavelength that is seen. Raises `ParameterError` where not one band
    lies between.
    """
    longest = size_m / _FEWEST_PERIODS
    count = int(np.floor(BANDS_PER_OCTAVE * np.log2(longest / finest_m))) if longest > finest_m else 0
    if count < 1:
        raise ParameterError(
            f"region - is too small for its pixels (got {size_m:.2g} m for waves from {finest_m:.2g} m up) - take a "
            "larger one, or a plate with more pixels"
        )
    return longest * 2.0 ** (np.arange(-count, 1) / BANDS_PER_OCTAVE)


def pattern_measures(relative: Floats, pixel_m: float, step_s: float, edges_m: Array) -> PatternMeasures:
    """Return the measures of C (T, n, n). pixel_m: of the region. step_s: between frames. edges_m: see `bands`."""
    frames, n = relative.shape[:2]
    space, time = np.hanning(n + 2)[1:-1], np.hanning(frames + 2)[1:-1]
    window = time[:, None, None] * space[:, None] * space
    seen = (relative.astype(np.float64) - relative.mean()) * window
    transform = np.fft.fft2(np.fft.rfft(seen, axis=0))
    power = np.abs(transform) ** 2 / (relative.size * np.sum(window**2))
    power[1 : (frames + 1) // 2] *= 2.0
    frequency = 2.0 * np.pi / (frames * step_s) * np.arange(len(power))
    k = 2.0 * np.pi * np.fft.fftfreq(n, pixel_m)
    length = np.hypot(k, k[:, None])
    of_band = np.digitize(2.0 * np.pi / np.maximum(length, _TINY), edges_m) - 1
    count = len(edges_m) - 1
    inside = (of_band >= 0) & (of_band < count)
    still, moving = power.sum(axis=0), np.tensordot(frequency, power, 1)
    banded = np.bincount(of_band[inside], still[inside], count).astype(np.float64)
    rate = np.bincount(of_band[inside], moving[inside], count).astype(np.float64) / np.maximum(banded, _TINY)
    # the frequency 0 has no sense of travel
    gone = power[1:].sum(axis=0)
    travel = -np.stack([np.broadcast_to(k, length.shape), np.broadcast_to(k[:, None], length.shape)])
    unit = travel / np.maximum(length, _TINY)
    direction = np.array([np.sum((u * gone)[inside]) for u in unit]) / max(float(gone[inside].sum()), _TINY)
    middle = np.sqrt(edges_m[:-1] * edges_m[1:])
    shown = np.fft.fftshift(np.roll(gone[::-1, ::-1], (1, 1), (0, 1)))
    return PatternMeasures(float(relative.std()), middle, banded, rate, direction, shown, relative[frames // 2].copy())
