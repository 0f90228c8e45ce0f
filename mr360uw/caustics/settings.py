# SPDX-License-Identifier: Apache-2.0
"""The `[sea]` and `[caustics]` tables of a scene, and the depth planes and sizes of maps that follow from them.

The cells of the surface that a sea's caustics need follow from its shortest waves and the blur of its light. Inside a
cell g wide a ray's slope is interpolated linearly. A ray is then off by f d g^2/8 times the second derivative of the
surface's slope, d the depth and f = 1 - 1/n. Sun's disc and short waves blur the light with the standard deviation b d.
As both grow with depth alike, the error of a map goes with the ratio

    r = f g^2/8 m/b        m^2 = sum k^6 A^2/2, the variance of the second derivative of the surface's slope

The light of a triangle is even. Near the surface, where b d is less than a cell, its edges show, an error that goes
with (g k)^2, k the wave number of the light: that of the surface's curvature, which focuses it, behind the blur

    k^2 = sum w k^6 A^2/sum w k^4 A^2        w = exp(-(k b d)^2)
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Discriminator, Tag, field_validator

from mr360uw.base.cache import shared
from mr360uw.base.constants import REFRACTIVE_INDEX_SEA, SUN_HALF_ANGLE_RAD
from mr360uw.base.parameters import Parameters, advanced, listed, number, parameter
from mr360uw.caustics.gerstner import GerstnerSea
from mr360uw.caustics.spectral import SpectralSea
from mr360uw.errors import ParameterError

_RATIO = 0.11
"""Greatest r. The error of maps with the sun overhead is 0.3 to 0.7 r of their standard deviation, as measured.

Twice as large, grids have 0.7 times the cells across and twice the error.
"""
_WIDEST = 0.67
"""Greatest g k. The error of maps 0.5 to 3 m deep is 0.05 to 0.1 (g k)^2 of their standard deviation, as measured."""
_STEP, _FEWEST, _MOST = 32, 64, 256
"""Grids are multiples of a step in a range. 256 cells take about twice the time of 128."""
_DEEP_M = 1e6
"""Depth [m] at which the shortest waves are blurred away."""
_SAMPLES = 256
"""Points across the tile that the waves' spectrum is taken of."""


def cells_across(sea: Sea, sun_half_angle_rad: float, depth_m: float = _DEEP_M) -> int:
    """Return the cells of the surface across the tile that keep the error of its caustics at about 0.05.

    depth_m: of the shallowest plane.
    """
    bend = 1.0 - 1.0 / REFRACTIVE_INDEX_SEA
    blur = math.hypot(bend * sea.blur_slope / math.sqrt(2.0), 0.5 * sun_half_angle_rad / REFRACTIVE_INDEX_SEA)
    k, curved, bent = _curvature(sea)
    with np.errstate(under="ignore"):  # of waves that are blurred away nothing is left
        shown = np.exp(-np.square(k * blur * depth_m))
    finest = math.sqrt(float(shown @ bent) / max(float(shown @ curved), 1e-300))
    for_rays = math.sqrt(bend * math.sqrt(bent.sum()) / (8.0 * _RATIO * max(blur, 1e-9)))
    cells = sea.tile_m * max(for_rays, finest / _WIDEST)
    return int(np.clip(_STEP * math.ceil(min(cells, _MOST) / _STEP), _FEWEST, _MOST))


def grid_of(settings: CausticSettings, sea: Sea, depth_m: float = _DEEP_M) -> int:
    """Return the cells across the tile that settings give, or that the sea needs from a depth on."""
    return cells_across(sea, settings.sun_half_angle_rad, depth_m) if settings.grid is None else settings.grid


@shared(keep=32)
def _curvature(sea: Sea) -> NDArray[np.float64]:
    """Return wave numbers [1/m], and variances there of the surface's curvature and its slope, (3, n), at time 0."""
    power = np.abs(np.fft.fft2(sea.grid_fields(_SAMPLES, 0.0).height) / _SAMPLES**2) ** 2
    waves = np.fft.fftfreq(_SAMPLES, 1.0 / _SAMPLES)
    square = waves[:, None] ** 2 + waves**2
    ring, per_m = np.rint(np.sqrt(square)).astype(np.int64), 2.0 * np.pi / sea.tile_m
    curved, bent = (np.bincount(ring.ravel(), (power * (square * per_m**2) ** n).ravel()) for n in (2, 3))
    return np.stack([per_m * np.arange(len(bent)), curved, bent])[:, 1:]


Method = Literal["exact", "ratio", "fan", "jacobian", "scrolling"]
"""exact: flux by exact coverage. The others are published methods, see `published`."""
DIVIDED_AREAS: tuple[Method, ...] = ("ratio", "fan", "jacobian")
"""The methods of `published.divided_areas`."""


def _sea_model(value: Any) -> str:
    return str(value.get("model", "gerstner") if isinstance(value, dict) else getattr(value, "model", "gerstner"))


Sea = Annotated[
    Annotated[GerstnerSea, Tag("gerstner")] | Annotated[SpectralSea, Tag("spectral")], Discriminator(_sea_model)
]
"""A sea of either kind, chosen by `model`; Gerstner by default."""


@listed
class CausticSettings(Parameters):
    """Method and resolution of the caustics.

    The `[caustics]` table of a scene, and the `settings` of library calls. Time goes with the pixels of the maps, the
    cells of the surface and the planes.

    Raises
    ------
    ParameterError
        If a value is out of its range; the message names it.

    See Also
    --------
    uw.caustics.caustic_stack : Takes them.
    uw.Scene : Has them as `caustics`.

    Examples
    --------
    >>> uw.caustics.CausticSettings(size=64).size
    64
    """

    enabled: bool = parameter(True, "whether the surface focuses light")
    method: Method = parameter(
        "exact", "exact conserves energy; ratio, fan, jacobian, scrolling: as published", internal="comparisons"
    )
    size: int = advanced(
        512, "pixels of the map across the sea's tile, a power of two; fewer where no picture shows them",
        low=16, high=4096,
    )  # fmt: skip
    grid: int | None = advanced(
        None, "cells of the surface across the tile; none: as many as the sea needs, 64 to 256", low=4, high=2048
    )
    planes: int = parameter(
        4, "most depths that a frame's caustics are computed at", low=1, high=64, internal="draw.quality"
    )
    chromatic: Literal[1, 3] = advanced(1, "1: one refractive index; 3: one for each of red, green and blue")
    sun_half_angle_rad: float = parameter(
        SUN_HALF_ANGLE_RAD, "angular radius of the sun's disc in air; larger for haze", unit="rad", low=0.0, high=0.5
    )

    @field_validator("size")
    @classmethod
    def _power_of_two(cls, size: int) -> int:
        if size & (size - 1):
            raise ValueError(f"must be a power of two (got {size}): 128, 256, 512")
        return size


# Depth planes of a scene's caustics and the size of their maps, fixed for a scene whatever moves in it.
#
# All planes stand on one ladder of depths from the surface down, and a frame gets those that enclose its objects. A
# plane enters or leaves only while nothing is at its depth, so the light on a body does not jump and does not depend on
# the pose of others. Between two planes light is interpolated linearly. The error grows with how far filaments move
# from plane to plane over their width. The sun's disc widens them with depth: the intervals grow with the root of the
# depth.

_RUNG = 0.125
"""Interval of the ladder in sqrt(depth + `_NEAR_M`) [sqrt(m)]: 0.25 m at the surface, 0.56 m at 4 m, 0.9 m at 12 m.

Twice as large, frames have half the planes and two to three times the interpolation error.
"""
_NEAR_M = 1.0
"""Depth [m] down to which light has not focused yet and contrast grows linearly; intervals are nearly even there."""
_SAME = 1e-6
"""Fraction of an interval that an object may reach beyond a plane without needing the next one: rounding."""
_SMALLEST_MAP = 16
"""Least pixels across a map, the least that the settings allow."""

Span = tuple[float, float]
"""Least and greatest depth [m] of an object."""


def _rung(depth_m: ArrayLike) -> NDArray[np.float64]:
    """Return how many intervals of the ladder a depth lies below the surface."""
    return np.asarray((np.sqrt(np.maximum(depth_m, 0.0) + _NEAR_M) - math.sqrt(_NEAR_M)) / _RUNG)


def _depth(rung: ArrayLike) -> NDArray[np.float64]:
    """Return the depth [m] of a place on the ladder."""
    return np.asarray((math.sqrt(_NEAR_M) + _RUNG * np.maximum(rung, 0.0)) ** 2 - _NEAR_M)


def stack_depths(near_m: float, far_m: float, count: int) -> NDArray[np.float64]:
    """Return ascending depths for a stack of caustics, closer to each other near the surface.

    Light is mixed linearly between planes. The sun's disc widens filaments with depth, so deeper planes may stand
    further apart.

    Parameters
    ----------
    near_m, far_m : float
        First and last depth [m], 0 < near_m <= far_m.
    count : int
        Number of depths, 1 or more; a single one lies halfway.

    Returns
    -------
    ndarray
        Depths (count,) [m].

    Raises
    ------
    ParameterError
        If the depths do not ascend from above 0, or there is no plane.

    See Also
    --------
    uw.caustics.caustic_stack : Takes the depths.

    Examples
    --------
    >>> uw.caustics.stack_depths(1.0, 9.0, 3).round(2).tolist()
    [1.0, 4.24, 9.0]
    """
    if not 0.0 < number("near_m", near_m) <= number("far_m", far_m) or number("count", count) < 1:
        raise ParameterError(
            f"stack - needs 0 < near <= far and a plane (got {near_m}, {far_m}, {count}) - correct the depths"
        )
    ends = _rung([near_m, far_m])
    if count == 1 or near_m == far_m:
        return _depth([ends.mean()])
    depths = _depth(np.linspace(ends[0], ends[1], count))
    depths[0], depths[-1] = near_m, far_m
    return depths


@dataclass(frozen=True, slots=True)
class PlaneLadder:
    """The depths of a scene's planes.

    first, step: rung of one plane, and rungs from plane to plane. fixed_m: depths of planes that every frame has.
    only_m: the depth of the only plane, or None where there may be more.
    """

    first: float = 0.0
    step: float = 1.0
    fixed_m: tuple[float, ...] = ()
    only_m: float | None = None

    @classmethod
    def of_scene(
        cls, reaches: Sequence[Span], heights_m: Sequence[float], fixed_m: Sequence[float], most: int
    ) -> PlaneLadder:
        """Return the ladder that gives a frame up to `most` planes, and two more than `fixed_m` in any case.

        reaches: the depths that each object passes in the course of the scene. heights_m: how much depth each takes
        up at a time. fixed_m: depths of flat receivers, which get planes of their own.
        """
        fixed = tuple(sorted(set(fixed_m)))
        if most == 1:
            depths = np.maximum(np.ravel(reaches), 0.0) if reaches else np.zeros(1)
            return cls(only_m=fixed[0] if fixed else 0.5 * float(depths.min() + depths.max()))
        if not reaches:
            return cls(fixed_m=fixed)
        free = max(most - len(fixed), 2)
        first, last = _rung([min(r[0] for r in reaches), max(r[1] for r in reaches)]).tolist()
        if last - first <= free - 1:
            return cls(first, max(last - first, 1e-3) / max(math.ceil(last - first), 1), fixed)
        least = np.maximum([reach[0] for reach in reaches], 0.0)
        tall = (_rung(least + heights_m) - _rung(least)).tolist()
        step = 1.0
        while min(sum(math.ceil(t / step) + 2 for t in tall), math.ceil((last - first) / step) + 1) > free:
            step *= 1.05
        return cls(first, step, fixed)

    def around(self, spans: Sequence[Span]) -> NDArray[np.float64]:
        """Return the ascending depths of the planes that enclose what spans the given depths now."""
        if self.only_m is not None:
            return np.array([self.only_m])
        numbers: set[int] = set()
        rungs = (_rung(np.reshape(spans, (-1, 2))) - self.first) / self.step
        for least, greatest in rungs.tolist():
            above = math.floor(least + _SAME)
            numbers.update(range(above, max(math.ceil(greatest - _SAME), above) + 1))
        return np.union1d(_depth(self.first + np.array(list(numbers), np.float64) * self.step), self.fixed_m)


def map_size(most: int, tile_m: float, nearest_footprint_m: float, sun_radius_m: float, blur_m: float = 0.0) -> int:
    """Return the pixels across a map: `most` halved while a picture would not show the difference.

    nearest_footprint_m: width w of a pixel at the nearest lit point. sun_radius_m: r of the sun's image at the
    shallowest one. A picture sees the pattern through both, of variances w^2/12 and r^2/4. A map of pixels t wide,
    read bilinearly, blurs with variance t^2/4: nothing is lost where that is w^2/12, and up to a tenth of the contrast
    where it makes the sun's image twice as wide, at t = sqrt(3) r. The size is halved up to there. blur_m: standard
    deviation b of the blur by short waves there, which leaves no detail narrower; t^2/4 may add a tenth to b^2.
    """
    widest = math.sqrt(nearest_footprint_m**2 / 3.0 + 3.0 * sun_radius_m**2 + 0.4 * blur_m**2)
    size = most
    while size >= 2 * _SMALLEST_MAP and tile_m / (size // 2) <= widest:
        size //= 2
    return size
