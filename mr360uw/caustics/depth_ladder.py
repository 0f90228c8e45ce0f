# SPDX-License-Identifier: Apache-2.0
"""Depth planes of a scene's caustics and the size of their maps, fixed for the scene whatever moves in it.

All planes stand on one ladder of depths from the surface down, and a frame gets those that enclose its objects. A plane
enters or leaves only while nothing is at its depth, so the light on a body does not jump and does not depend on the
pose of others. Between two planes light is interpolated linearly. The error grows with how far filaments move from
plane to plane over their width. The sun's disc widens them with depth: the intervals grow with the root of the depth.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.errors import ParameterError
from mr360uw.shapes import number

_STEP = 0.125
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
    return np.asarray((np.sqrt(np.maximum(depth_m, 0.0) + _NEAR_M) - math.sqrt(_NEAR_M)) / _STEP)


def _depth(rung: ArrayLike) -> NDArray[np.float64]:
    return np.asarray((math.sqrt(_NEAR_M) + _STEP * np.maximum(rung, 0.0)) ** 2 - _NEAR_M)


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
