# SPDX-License-Identifier: Apache-2.0
"""The floor of a synthetic dive: heights and albedo of sand ripples, rocks and patches of sea grass, in a tile that
repeats.
"""

from __future__ import annotations

import numpy as np

from mr360uw.sample.dive_settings import DiveSettings
from mr360uw.types import Floats

BED_TILE_M = 12.0
"""Side [m] of the square after which the floor repeats."""
_SIZE = 1024
"""Pixels across that square, 12 mm each: finer than a frame 1024 pixels wide shows on the floor."""
_RIPPLES, _RIPPLE_M = 44, 0.018
"""Crests across the tile, 0.27 m apart, and their amplitude [m]: steepness 0.13, as of ripples of waves on sand."""
_DUNE_M = 0.05
"""Standard deviation [m] of the sand's slow undulations."""
_SAND_COLOR, _ROCK, _GRASS = np.array([1.06, 1.0, 0.86]), np.array([0.15, 0.125, 0.10]), np.array([0.035, 0.05, 0.025])
"""Albedo of sand over that in green; mean albedo of rock under algae, and of sea grass."""
_ROCK_HEIGHT_M, _GRASS_HEIGHT_M = 0.55, 0.22
"""Height [m] of the largest rocks, and of grass."""


def sea_bed(settings: DiveSettings) -> tuple[Floats, Floats]:
    """Return the tile of a dive's floor, a function of its seed and its parameters of the floor.

    Heights (size, size) [m] over the floor's mean, and albedo (size, size, 3); column = +x, row = +z.
    """
    sand, dunes = _sand(_Noise(settings.seed, 0), settings.sand_albedo, settings.sand_contrast)
    rocks, boulders, crust = _rocks(_Noise(settings.seed, 1), settings.rocks)
    grass, tufts, blades = _grass(_Noise(settings.seed, 2), settings.grass)
    grass = grass * (1.0 - rocks)
    bare = (1.0 - rocks) * (1.0 - grass)
    height = settings.relief * (dunes * (1.0 - rocks) + boulders + grass * tufts)
    albedo = bare[..., None] * sand + rocks[..., None] * crust + grass[..., None] * blades
    return height - height.mean(), np.clip(albedo, 0.0, 0.9)


class _Noise:
    """Periodic random fields of mean 0 and deviation 1, in the order in which they are asked for."""

    def __init__(self, seed: int, kind: int) -> None:
        self._rng = np.random.default_rng((seed, kind, 0x5A4D))
        along = np.fft.rfftfreq(_SIZE, 1.0 / _SIZE)
        self._radius = np.hypot(np.fft.fftfreq(_SIZE, 1.0 / _SIZE)[:, None], along)

    def smooth(self, exponent: float, cutoff: float) -> Floats:
        """Return a field (size, size) whose amplitudes fall with a power of the frequency, and fast beyond `cutoff`
        periods to the tile.
        """
        spectrum = np.fft.rfft2(self._rng.standard_normal((_SIZE, _SIZE)))
        shape = np.exp(-((self._radius / cutoff) ** 2)) / np.maximum(self._radius, 1.0) ** exponent
        field = np.fft.irfft2(spectrum * shape, (_SIZE, _SIZE))
        return np.asarray((field - field.mean()) / field.std())


def _sand(noise: _Noise, albedo: float, contrast: float) -> tuple[Floats, Floats]:
    """Return albedo (size, size, 3) and height (size, size) [m] of rippled sand."""
    across = 2.0 * np.pi * _RIPPLES * np.arange(_SIZE) / _SIZE
    phase = across[:, None] + 1.8 * noise.smooth(2.0, 40.0)
    crests = np.sin(phase + 0.35 * np.sin(phase))  # steeper on the lee side
    strength = np.clip(0.75 + 0.35 * noise.smooth(1.5, 6.0), 0.0, 1.5)
    height = _DUNE_M * noise.smooth(2.0, 6.0) + _RIPPLE_M * strength * crests
    # troughs collect darker grains and debris
    grey = 0.07 * strength * crests + 0.08 * noise.smooth(1.0, 120.0) + 0.09 * noise.smooth(1.6, 12.0)
    return albedo * _SAND_COLOR * np.maximum(1.0 + contrast * grey[..., None], 0.05), height


def _rocks(noise: _Noise, fraction: float) -> tuple[Floats, Floats, Floats]:
    """Return cover (size, size), height (size, size) [m] and albedo (..., 3) of rocks under growth of some colours."""
    if fraction <= 0.0:
        return np.zeros((1, 1)), np.zeros((1, 1)), np.zeros((1, 1, 3))
    cover = _cover(noise.smooth(1.2, 9.0) + 0.35 * noise.smooth(1.0, 40.0), fraction, 0.25)
    lumps = 0.55 + 0.25 * noise.smooth(0.6, 30.0) + 0.1 * noise.smooth(0.8, 120.0)
    red, blue = noise.smooth(0.8, 40.0), noise.smooth(0.8, 40.0)
    tint = 1.0 + 0.12 * np.stack([red, -0.5 * (red + blue), blue], axis=-1)
    crust = np.exp(0.35 * noise.smooth(0.8, 60.0))[..., None] * tint
    return cover, _ROCK_HEIGHT_M * np.maximum(cover**0.6 * lumps, 0.0), _ROCK * crust


def _grass(noise: _Noise, fraction: float) -> tuple[Floats, Floats, Floats]:
    """Return cover (size, size), height (size, size) [m] and albedo (..., 3) of sea grass."""
    if fraction <= 0.0:
        return np.zeros((1, 1)), np.zeros((1, 1)), np.zeros((1, 1, 3))
    blades = noise.smooth(0.0, 250.0)
    cover = _cover(noise.smooth(1.4, 7.0) + 0.2 * noise.smooth(0.5, 90.0), fraction, 0.4)
    return cover, _GRASS_HEIGHT_M * (0.7 + 0.3 * blades), _GRASS * np.exp(0.45 * blades)[..., None]


def _cover(field: Floats, fraction: float, soft: float) -> Floats:
    """Return 0 to 1 over a field's highest places, so that they cover a fraction of it. soft: width of their edges."""
    threshold = np.quantile(field, 1.0 - fraction)
    edge = np.clip((field - threshold) / soft + 0.5, 0.0, 1.0)
    return np.asarray(edge * edge * (3.0 - 2.0 * edge))
