# SPDX-License-Identifier: Apache-2.0
"""Our caustics of a sea on the region of floor that a plate shows, read through the pixels of its camera.

    E/<E> = 1 + f (s (C - 1) + (1 - s) (B - 1))        f = (1 - (1 - q) sky) b(d)/r(d)

f: fraction of the daylight on the floor, at the depth d, that is the sun's beam; q: the same just below the surface;
sky: colour of the rest; b, r: fractions of the beam and of all light that reach d; s: fraction of the beam that has not
turned; C: caustic ratio of that part, B: of the rest. The
fractions are means over R, G and B, weighted by the luminance of each in the floor that is seen. C and B are averaged
over the footprint of each of the plate's pixels; the region is then read from the pixels as it is from the plate's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mr360uw.caustic_lookup import mip_level, mip_levels
from mr360uw.caustics import CausticSettings, caustic_stack
from mr360uw.caustics.settings import Sea
from mr360uw.color import luminance
from mr360uw.constants import REFRACTIVE_INDEX_SEA
from mr360uw.ibl.sun.closure import CLEAR_SKY, CLEAR_SKY_DIRECT
from mr360uw.match.floor_series import FloorSeries, FloorView
from mr360uw.medium.lookup import ambient_ratio, beam_fraction, unscattered_share
from mr360uw.medium.small_angles import spread_of
from mr360uw.optics import refract_to_water
from mr360uw.types import BeamSpread, Floats

Array = NDArray[np.float64]

_SIZES = (64, 512)
"""Least and most pixels of a map across the sea's tile."""
_GRID_PER_WAVE = 5
"""Cells of the surface in its shortest wave. Three make a pattern that is less sharp: the wind that fits a finer one is
then 5 to 20 % too strong. Twice as many move it by 2 to 8 %, the most in the weakest winds."""
_GRIDS = (64, 256)
_MOST_LOST, _MOST_BLUR, _WIDEST_BLUR = 0.07, 0.6, 0.5
"""Most of the pattern's amplitude that a codec takes, and most of its blur [pixels of the plate], times the pattern's
standard deviation in code values; the last is the most of any. Codecs drop what is below a step: of 2 code values H.264
took 0 to 4 % of the amplitude, of 14 or more below 1 %."""


@dataclass(frozen=True, slots=True, eq=False)
class ModelledFloor:
    """Makes the light of a floor under seas.

    views: (T,) where the frame at each time shows the region. pixel_m: of the region. beam, unturned: fractions f and s
    above. codes: of `FloorSeries`. blur: standard deviation [pixels of the plate] of what blurs its frames: a codec.
    """

    views: tuple[FloorView, ...]
    pixel_m: float
    time_s: Array
    depth_m: float
    sun_in_air: Array
    beam: float
    unturned: float
    spread: BeamSpread | None = None
    refractive_index: float = REFRACTIVE_INDEX_SEA
    codes: float = math.inf
    blur: float = 0.0

    @classmethod
    def of(cls, series: FloorSeries, sun_share: float = 0.0) -> ModelledFloor:
        """Return the model for the floor of a plate.

        sun_share: q, 0 for that of a clear sky.
        """
        sun_share = sun_share or CLEAR_SKY_DIRECT
        medium, at = series.medium, np.array([series.floor_depth_m])
        up = float(refract_to_water(series.sun_in_air, medium.refractive_index)[1])
        whole = ambient_ratio(medium.unit_table, at) / ambient_ratio(medium.unit_table, 0.0)
        direct = (1.0 - (1.0 - sun_share) * CLEAR_SKY) * beam_fraction(medium.unit_table, at, up)
        seen = luminance(np.diag(series.color)) / max(float(luminance(series.color)), 1e-12)
        fraction = (direct / whole)[0] * seen
        beam = float(np.sum(fraction))
        unturned = float(np.sum(unscattered_share(medium.unit_table, at, up)[0] * fraction)) / max(beam, 1e-12)
        spread = spread_of(medium)
        return cls(
            series.views, series.grid.pixel_m, series.time_s, series.floor_depth_m, series.sun_in_air,
            beam, unturned, spread, medium.refractive_index, series.codes,
        )  # fmt: skip

    def as_coded(self, beam: float, codec: float) -> ModelledFloor:
        """Return the floor with `beam` times the beam's fraction, through a codec that takes the part `codec` (0 to 1)
        of the most that codecs take of a pattern of so few code values."""
        lost = codec * min(_MOST_LOST / self.codes, 0.5)
        blur = codec * min(_MOST_BLUR / self.codes, _WIDEST_BLUR)
        return replace(self, beam=min(self.beam * beam, 1.0) * (1.0 - lost), blur=blur)

    def light(self, sea: Sea) -> NDArray[np.float32]:
        """Return the light (T, n, n) of the floor under a sea, relative to that under a flat one."""
        settings = self._settings(sea)
        times = zip(self.views, self.time_s, strict=True)
        return np.array([self._at(sea, float(time_s), view, settings) for view, time_s in times])

    def _settings(self, sea: Sea) -> CausticSettings:
        size = 2.0 ** np.ceil(np.log2(sea.tile_m / self.pixel_m))
        shortest = getattr(sea, "shortest_wavelength_m", None) or sea.tile_m / 40.0
        grid = _GRID_PER_WAVE * sea.tile_m / shortest
        return CausticSettings(size=int(np.clip(size, *_SIZES)), grid=int(np.clip(grid, *_GRIDS)))

    def _at(self, sea: Sea, time_s: float, view: FloorView, settings: CausticSettings) -> NDArray[np.float32]:
        at = np.array([self.depth_m])
        stack = caustic_stack(sea, self.sun_in_air, at, time_s, settings, self.refractive_index, self.spread)
        pattern = self.unturned * (stack.ratio[..., 1:2] - 1.0)
        if stack.soft is not None:
            pattern = pattern + (1.0 - self.unturned) * (stack.soft - 1.0)
        along = self.depth_m / stack.sun_direction[1] * stack.sun_direction
        u, v = (view.x_m + along[0]) / stack.tile_m, (view.z_m + along[2]) / stack.tile_m
        seen = _read(mip_levels(pattern), u, v, view.footprint_m / stack.tile_m)
        return 1.0 + np.float32(self.beam) * view.read(seen, self.blur)


def _read(levels: list[Floats], u: Array, v: Array, footprint: Array) -> NDArray[np.float32]:
    """Return mip levels (1, size, size, 1) at places of a tile, averaged over footprints; all (h, w), in tiles."""
    import cv2

    level = mip_level(footprint, 1.0 / levels[0].shape[1], len(levels) - 1.0)
    image = np.zeros(u.shape, np.float32)
    for k, texels in enumerate(levels):
        weight = np.maximum(1.0 - np.abs(level - k), 0.0).astype(np.float32)
        if weight.any():
            size = texels.shape[1]
            x, y = (np.remainder(a * size - 0.5, size).astype(np.float32) for a in (u, v))
            picture = texels[0, ..., 0].astype(np.float32)
            image += weight * cv2.remap(picture, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
    return image
