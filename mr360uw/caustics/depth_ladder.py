# SPDX-License-Identifier: Apache-2.0
"""Which depths a scene's caustics are computed at, and how finely: fixed for the scene, whatever moves in it.

Planes stand on one ladder of depths from the surface down. A frame gets those that enclose its objects: a plane comes
and goes while nothing is at its depth, so nothing jumps, and the light at a place does not depend on where an object
reaches to. What lies between two planes is a mix of them, wrong by more where filaments move by more of their width,
which grows with depth by the sun's disc: the ladder's intervals grow with the root of the depth.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mr360uw.errors import ParameterError

_STEP = 0.125
"""Interval of the ladder in sqrt(depth + `_NEAR_M`): 0.25 m at the surface, 0.56 m at 4 m, 0.9 m at 12 m."""
_NEAR_M = 1.0
"""Down to about here light has not focused, and contrast grows evenly with depth: intervals are even too."""
_SAME = 1e-6
"""Part of an interval by which something may reach beyond a plane."""
_SMALLEST_MAP = 16

Span = tuple[float, float]
"""Least and greatest depth [m] of something."""


def _rung(depth_m: float) -> float:
    return (math.sqrt(max(depth_m, 0.0) + _NEAR_M) - math.sqrt(_NEAR_M)) / _STEP


def _depth(rung: float) -> float:
    return (math.sqrt(_NEAR_M) + _STEP * max(rung, 0.0)) ** 2 - _NEAR_M


def stack_depths(near_m: float, far_m: float, count: int) -> NDArray[np.float64]:
    """Return `count` ascending depths from near_m to far_m, evenly on the ladder; one lies halfway."""
    if not (0.0 < near_m <= far_m < math.inf) or count < 1:
        raise ParameterError(
            f"stack - needs 0 < near <= far and a plane (got {near_m}, {far_m}, {count}) - correct the depths"
        )
    first, last = _rung(near_m), _rung(far_m)
    if count == 1 or near_m == far_m:
        return np.array([_depth(0.5 * (first + last))])
    depths = np.array([_depth(rung) for rung in np.linspace(first, last, count)])
    depths[0], depths[-1] = near_m, far_m
    return depths


@dataclass(frozen=True, slots=True)
class PlaneLadder:
    """The depths of a scene's planes.

    first, step: rung of one plane, and rungs from plane to plane. fixed_m: depths of planes that are always there.
    only_m: the depth where there is to be one plane alone.
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
        first, last = _rung(min(r[0] for r in reaches)), _rung(max(r[1] for r in reaches))
        if last - first <= free - 1:
            return cls(first, max(last - first, 1e-3) / max(math.ceil(last - first), 1), fixed)
        tall = [
            _rung(max(least, 0.0) + height) - _rung(least)
            for (least, _), height in zip(reaches, heights_m, strict=True)
        ]
        step = 1.0
        while min(sum(math.ceil(t / step) + 2 for t in tall), math.ceil((last - first) / step) + 1) > free:
            step *= 1.05
        return cls(first, step, fixed)

    def around(self, spans: Iterable[Span]) -> NDArray[np.float64]:
        """Return the ascending depths of the planes that enclose what spans the given depths now."""
        if self.only_m is not None:
            return np.array([self.only_m])
        numbers: set[int] = set()
        for span in spans:
            least, greatest = ((_rung(depth) - self.first) / self.step for depth in span)
            above = math.floor(least + _SAME)
            numbers.update(range(above, max(math.ceil(greatest - _SAME), above) + 1))
        return np.array(sorted({_depth(self.first + n * self.step) for n in numbers} | set(self.fixed_m)))


def map_size(most: int, tile_m: float, nearest_footprint_m: float, sun_radius_m: float) -> int:
    """Return the pixels across a map, `most` or a half, a quarter of it, that show what a picture can show.

    nearest_footprint_m: width w of a pixel at the nearest lit point. sun_radius_m: r of the sun's image at the
    shallowest one. A picture sees the pattern through both, of variances w^2/12 and r^2/4. A map of pixels t wide,
    read bilinearly, is seen through t^2/4: nothing is lost where that is w^2/12, and up to a tenth of the contrast
    where the sun's image is seen twice as wide, at t = sqrt(3) r. That is as far as it goes.
    """
    widest = math.sqrt(nearest_footprint_m**2 / 3.0 + 3.0 * sun_radius_m**2)
    size = most
    while size >= 2 * _SMALLEST_MAP and tile_m / (size // 2) <= widest:
        size //= 2
    return size
