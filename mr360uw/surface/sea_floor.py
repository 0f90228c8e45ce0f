# SPDX-License-Identifier: Apache-2.0
"""The sea floor: its heights and albedo, and the light on it."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from mr360uw.caustic_lookup import mip_level, mip_levels, periodic_trilinear
from mr360uw.constants import PI
from mr360uw.errors import ParameterError
from mr360uw.shapes import number, numbers
from mr360uw.surface.tracing.floor_light import relief_height
from mr360uw.types import Array, Floats

_CELL = 16
"""Pixels along each side of the squares of a relief whose height is bounded. With 8 and 32 rays take as long."""


class Tiled:
    """A picture (size, size, C) that repeats every tile_m [m], column = +x, row = +z; pixel (0, 0) spans [0,
    tile_m/size) from `origin` (2,) over (x, z) [m]; with its halves for footprints."""

    def __init__(self, picture: Floats, tile_m: float, origin: tuple[float, float] = (0.0, 0.0)) -> None:
        self.levels, self.tile_m, self.origin = mip_levels(np.asarray(picture, np.float64)[None]), tile_m, origin

    def at(self, x_m: Array, z_m: Array, footprint_m: Array) -> Array:
        """Return values (n, 3) at places (n,), averaged over footprints (n,) [m]."""
        level = mip_level(footprint_m, self.tile_m / self.levels[0].shape[1], len(self.levels) - 1.0)
        u, v = (x_m - self.origin[0]) / self.tile_m, (z_m - self.origin[1]) / self.tile_m
        return np.asarray(periodic_trilinear(self.levels, np.zeros(len(x_m), np.int64), u, v, level))


class Floor:
    """A diffuse floor, level or uneven.

    It sends light up equally in all directions. A relief shades itself from the sun, with a hard edge, but not from the
    sky.

    Parameters
    ----------
    height_m : float
        Its y [m] in the world.
    albedo : array_like
        In [0, 1]: a number, (3,), or an image (size, size, 3) or (size, size), `size` a power of two, that repeats
        every albedo_tile_m from the world's origin, column = +x, row = +z.
    tile_m : float, optional
        Length [m] after which the relief repeats.
    relief : array_like
        Heights (size, size) [m] over height_m at the centres of pixels, read bilinearly.
    albedo_tile_m : float, optional
        Length [m] after which the albedo repeats; `tile_m` unless given.

    Raises
    ------
    ParameterError
        If a shape or a value is out of its domain.

    See Also
    --------
    uw.surface.SeaScene : Takes a floor.
    uw.floor_from_track : A mesh of a real floor.

    Examples
    --------
    >>> uw.surface.Floor(-4.0, albedo=[0.4, 0.35, 0.3]).mean_albedo
    array([0.4 , 0.35, 0.3 ])
    """

    def __init__(
        self,
        height_m: float,
        albedo: ArrayLike = 0.3,
        tile_m: float | None = None,
        *,
        relief: ArrayLike = 0.0,
        albedo_tile_m: float | None = None,
    ) -> None:
        self.height_m = number("floor.height_m", height_m)
        for name, length in (("tile_m", tile_m), ("albedo_tile_m", albedo_tile_m)):
            if length is not None:
                number(f"floor.{name}", length)
        image = numbers("floor.albedo", albedo).astype(np.float64)
        if image.size == 0 or image.min() < 0.0 or image.max() > 1.0:
            raise ParameterError(f"floor.albedo - must lie in [0, 1] (got {image.ravel()[:3]}) - give fractions")
        given = tile_m if albedo_tile_m is None else albedo_tile_m
        if image.shape in ((), (3,)):
            image, given = np.broadcast_to(image, (1, 1, 3)), 1.0
        elif image.ndim == 2:
            image = image[..., None]
        size = image.shape[0]
        if image.ndim != 3 or image.shape[1] != size or image.shape[2] not in (1, 3) or size & (size - 1):
            raise ParameterError(
                f"floor.albedo - must be a number, (3,) or a square image (got shape {image.shape}) - "
                "sides of a power of two tile"
            )
        self.mean_albedo: Array = np.broadcast_to(image.mean(axis=(0, 1)), (3,)).copy()
        self.image = Tiled(image, _metres("tile_m" if albedo_tile_m is None else "albedo_tile_m", given))
        heights = numbers("floor.relief", relief).astype(np.float64)
        level = heights.ndim == 0
        if not level and (heights.ndim != 2 or heights.shape[0] != heights.shape[1] or len(heights) < 2):
            raise ParameterError(f"floor.relief - must be (size, size) (got shape {heights.shape}) - give heights")
        self.height_m += float(heights) if level else 0.0
        self.relief: Array = np.zeros((1, 1)) if level else np.ascontiguousarray(heights)
        self.tile_m = 1.0 if level else _metres("tile_m", tile_m)
        self.lowest_m, self.highest_m = float(self.relief.min()), float(self.relief.max())
        self.cells = _cells(self.relief, self.tile_m)
        """(k, k, 2) greatest height and bound of the slope in squares of the tile."""
        self.steepest = float(self.cells[..., 1].max())

    def height_at(self, x_m: float, z_m: float) -> float:
        """Return the y [m] in the world of the floor at a place in the world."""
        return self.height_m + relief_height(self.relief, self.tile_m, x_m, z_m)

    def albedo(self, x_m: Array, z_m: Array, footprint_m: Array) -> Array:
        """Return the albedo (n, 3) at places (n,) in the world, averaged over footprints (n,) [m]."""
        return self.image.at(x_m, z_m, footprint_m)


def _cells(relief: Array, tile_m: float) -> Array:
    """Return `Floor.cells`. A bilinear surface is highest in its nodes, and steepest along the edges between them."""
    size = len(relief)
    edges = np.linspace(0.0, size, max(size // _CELL, 1) + 1)
    # The nodes about each interval of pixels, whose centres are at i + .5
    spans = [np.arange(int(a - 0.5) - 1, int(b + 0.5) + 1) % size for a, b in pairwise(edges)]

    def most(values: Array) -> Array:
        rows = np.stack([values[span].max(axis=0) for span in spans])
        return np.stack([rows[:, span].max(axis=1) for span in spans], axis=1)

    by_z, by_x = (most(np.abs(np.roll(relief, -1, axis) - relief)) for axis in (0, 1))
    return np.stack([most(relief), np.hypot(by_x, by_z) * size / tile_m], axis=-1)


def _metres(name: str, length: float | None) -> float:
    if length is None or not number(f"floor.{name}", length) > 0.0:
        raise ParameterError(f"floor.{name} - an image needs its size (got {length}) - give metres above 0")
    return float(length)


@dataclass(frozen=True, slots=True, eq=False)
class FloorLight:
    """Irradiance of the floor: an even part (3,) and patterns that repeat with the sea, each times a factor (3,).

    dry: (3,) irradiance of what stands out of the water; dry_sun: the sun's part of it. skies: how many of the
    patterns, the first, are of the sky; the others are of the sun.
    """

    even: Array
    patterns: tuple[tuple[Tiled, Array], ...]
    dry: Array
    dry_sun: Array
    skies: int = 0

    def irradiance(self, x_m: Array, z_m: Array, footprint_m: Array) -> Array:
        """Return the irradiance (n, 3) at places (n,) in the world, averaged over footprints (n,) [m]."""
        light = np.broadcast_to(self.even, (len(x_m), 3)).copy()
        for pattern, factor in self.patterns:
            light += factor * pattern.at(x_m, z_m, footprint_m)
        return light

    def radiance(self, floor: Floor, x_m: Array, z_m: Array, footprint_m: Array, dry: bool) -> Array:
        """Return the radiance (n, 3) of the floor there; dry: above the water."""
        light = self.dry if dry else self.irradiance(x_m, z_m, footprint_m)
        return floor.albedo(x_m, z_m, footprint_m) * light / PI
