# SPDX-License-Identifier: Apache-2.0
"""What waves and bodies leave of the sun's beam at points in the water, over an open, flat sea.

Light that has not turned:                    sharp = C V         C caustic ratio, V visible fraction of the sun's disc
Light that has turned by small angles:        soft = B V_halo     B blurred caustic ratio (1 without), V_halo visible
                                                                  fraction of the wider disc that this light comes from
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import Parts
from mr360uw.caustic_lookup import caustic_lookup, mip_levels
from mr360uw.errors import ParameterError
from mr360uw.medium.shafts.occluders import Bodies
from mr360uw.sphere import disc_directions, effective_half_angle, unit
from mr360uw.types import CausticStack, Floats, Sun

Array = NDArray[np.float64]

MOST_POINTS = 1 << 18
"""Points looked up together, which bounds memory at some tens of megabytes."""


@dataclass(frozen=True, eq=False)
class BeamPattern(Parts):
    """Bodies and waves between the sun and points in the world.

    surface_y_m: height of the mean water surface. samples: directions over the sun's disc. spread_rad: standard
    deviation of the directions of light that has turned by small angles; eight times as many directions sample it.
    """

    sun: Sun
    bodies: Bodies
    caustics: CausticStack | None
    surface_y_m: float
    samples: int
    spread_rad: float = 0.0

    def __post_init__(self) -> None:
        if self.caustics is not None and not isinstance(self.caustics, CausticStack):
            raise ParameterError(
                f"caustics - not a stack (got {type(self.caustics).__name__}) - give what uw.caustics.caustic_stack "
                "returns, or None"
            )

    @property
    def even(self) -> bool:
        """Whether nothing takes light away or moves it."""
        return not self.bodies.occluders and self.caustics is None

    def sharp(self, point: Array, along: Array, footprint_m: Floats | float = 0.0) -> Array:
        """Return C V (n, 3) at points (n, 3) in the world.

        V is a mean over the segments `along` (n, 3) [m] about the points, C over footprints (n,) [m].
        """
        return self._ratio(self._levels, point, footprint_m) * self._seen(point, self.disc, along)[:, None]

    def soft(self, point: Array, along: Array, footprint_m: Floats | float = 0.0) -> Array:
        """Return B V_halo (n, 3) at points (n, 3) in the world; arguments as for `sharp`."""
        return self._ratio(self._soft_levels, point, footprint_m) * self._seen(point, self.halo, along)[:, None]

    def _ratio(self, levels: list[Floats], point: Array, footprint_m: Floats | float) -> Array:
        if self.caustics is None or not levels:
            return np.ones((len(point), 3))
        depth = np.maximum(self.surface_y_m - point[:, 1], 0.0)
        ratio = caustic_lookup(self.caustics, levels, point[:, 0], depth, point[:, 2], footprint_m)
        # waves have not focused anything at the surface: contrast grows from there to the first plane
        focused = np.minimum(depth / self.caustics.depth_m[0], 1.0)[:, None]
        return 1.0 + (ratio - 1.0) * focused

    def _seen(self, point: Array, directions: Array, along: Array) -> Array:
        return self.bodies.visible(point, directions, along) if self.bodies.occluders else np.ones(len(point))

    @functools.cached_property
    def _levels(self) -> list[Floats]:
        return [] if self.caustics is None else mip_levels(self.caustics.ratio)

    @functools.cached_property
    def _soft_levels(self) -> list[Floats]:
        return [] if self.caustics is None or self.caustics.soft is None else mip_levels(self.caustics.soft)

    @functools.cached_property
    def disc(self) -> Array:
        """Directions (samples, 3) over the sun's disc."""
        return disc_directions(unit(self.sun.direction), self.sun.half_angle_rad, self.samples)

    @functools.cached_property
    def halo(self) -> Array:
        """Directions (8 samples, 3) that light which has turned by small angles comes from."""
        wide = float(effective_half_angle(self.sun.half_angle_rad, self.spread_rad))
        return disc_directions(unit(self.sun.direction), wide, 8 * self.samples)
