# SPDX-License-Identifier: Apache-2.0
"""The floor of a synthetic dive: heights and albedo of sand ripples, rocks and patches of sea grass, in a tile that
repeats.
"""

from __future__ import annotations

import numpy as np

from mr360uw.sample.dive_settings import DiveSettings
from mr360uw.texels import smoothstep
from mr360uw.types import Floats

BED_TILE_M = 12.0
"""Side [m] of the square after which the floor repeats."""
_SIZE = 1024
"""Pixels across that square, 12 mm each: finer than a frame 1024 pixels wide shows on the floor."""
_RIPPLES, _RIPPLE_M = 36, 0.026
"""Crests across the tile, 0.33 m apart, and their amplitude [m]: steepness 0.16, as of ripples of waves on sand."""
_DUNE_M = 0.05
"""Standard deviation [m] of the sand's slow undulations."""
_SAND_COLOR, _ROCK, _GRASS = np.array([1.06, 1.0, 0.86]), np.array([0.15, 0.125, 0.10]), np.array([0.035, 0.05, 0.025])
"""Albedo of sand over that in green; mean albedo of rock under algae, and of sea grass."""
_BOULDER_M, _GROUPS, _TO_A_GROUP = 0.9, 70, 7
"""Radius [m] of large boulders, groups of them in a tile that they cover, and boulders in each."""
_REACH_M = 2.0
"""Distance [m] within which a boulder counts."""
_FLATNESS, _FOOT_M, _ROCK_EDGE = 0.75, 0.12, 0.06
"""Height of boulders over that of spheres; rounding [m] of their feet, which bounds their slope; width of their edge in
R^2 - r^2 [m2]: 3 cm of a boulder of 1 m."""
_GRASS_HEIGHT_M = 0.16
"""Mean height [m] of grass."""


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
        self.rng = np.random.default_rng((seed, kind, 0x5A4D))
        along = np.fft.rfftfreq(_SIZE, 1.0 / _SIZE)
        self._radius = np.hypot(np.fft.fftfreq(_SIZE, 1.0 / _SIZE)[:, None], along)

    def smooth(self, exponent: float, cutoff: float) -> Floats:
        """Return a field (size, size) whose amplitudes fall with a power of the frequency, and fast beyond `cutoff`
        periods to the tile.
        """
        spectrum = np.fft.rfft2(self.rng.standard_normal((_SIZE, _SIZE)))
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
    """Return cover (size, size), height (size, size) [m] and albedo (..., 3) of boulders under growth, in colours."""
    if fraction <= 0.0:
        return np.zeros((1, 1)), np.zeros((1, 1)), np.zeros((1, 1, 3))
    over = _boulders(noise, fraction)
    cover = smoothstep(over / _ROCK_EDGE + 0.5, 0.0, 1.0)
    rough = 1.0 + 0.10 * noise.smooth(0.8, 60.0) + 0.05 * noise.smooth(0.4, 200.0)
    height = _FLATNESS * (np.sqrt(np.maximum(over, 0.0) + _FOOT_M**2) - _FOOT_M) * rough
    # Growth by patches of colours, darker in the clefts
    red, blue = noise.smooth(0.8, 40.0), noise.smooth(0.8, 40.0)
    tint = 1.0 + 0.12 * np.stack([red, -0.5 * (red + blue), blue], axis=-1)
    crust = np.exp(0.35 * noise.smooth(0.8, 60.0) + 0.3 * noise.smooth(0.3, 250.0))[..., None] * tint
    return cover, np.maximum(height, 0.0), _ROCK * crust


def _boulders(noise: _Noise, fraction: float) -> Floats:
    """Return the largest R^2 - r^2 (size, size) [m2] of boulders of radius R that cover a fraction of the tile, r:
    distance to the centre of one, along axes that are warped.
    """
    step, rng = BED_TILE_M / _SIZE, noise.rng
    warp_x, warp_z = (0.22 * noise.smooth(1.8, 30.0) + 0.035 * noise.smooth(0.8, 60.0) for _ in range(2))
    nearest, boulders = np.full((_SIZE, _SIZE), np.inf), []
    for center in rng.uniform(0.0, BED_TILE_M, (1 + round(_GROUPS * fraction), 2)):
        largest = _BOULDER_M * rng.uniform(0.6, 1.0)
        for k in range(_TO_A_GROUP):
            radius = largest * rng.uniform(0.15, 0.6) if k else largest
            x, z = center + (rng.normal(0.0, 1.1 * largest, 2) if k else 0.0)
            # Squared distances of the pixels about it, which may lie over the edge of the tile
            columns, rows = (np.arange(int((c - _REACH_M) / step), int((c + _REACH_M) / step)) for c in (x, z))
            here = np.ix_(rows % _SIZE, columns % _SIZE)
            aside, along = columns * step - x + warp_x[here], rows[:, None] * step - z + warp_z[here]
            stretch = rng.uniform(0.6, 1.6)
            squared = stretch * aside**2 + along**2 / stretch
            nearest[here] = np.minimum(nearest[here], squared / radius**2)
            boulders.append((here, radius, squared))
    # Let all of them grow until they cover the fraction
    growth, over = np.quantile(nearest, fraction), np.full((_SIZE, _SIZE), -np.inf)
    for here, radius, squared in boulders:
        over[here] = np.maximum(over[here], growth * radius**2 - squared)
    return over


def _grass(noise: _Noise, fraction: float) -> tuple[Floats, Floats, Floats]:
    """Return cover (size, size), height (size, size) [m] and albedo (..., 3) of sea grass."""
    if fraction <= 0.0:
        return np.zeros((1, 1)), np.zeros((1, 1)), np.zeros((1, 1, 3))
    blades = noise.smooth(0.0, 250.0)
    field = noise.smooth(1.4, 7.0) + 0.2 * noise.smooth(0.5, 90.0)
    over = field - np.quantile(field, 1.0 - fraction)
    cover = smoothstep(over / 0.4 + 0.5, 0.0, 1.0)
    tufts = _GRASS_HEIGHT_M * (0.85 + 0.25 * noise.smooth(0.6, 60.0) + 0.08 * blades)
    return cover, np.maximum(tufts, 0.0) * smoothstep(over, 0.0, 1.0), _GRASS * np.exp(0.45 * blades)[..., None]
