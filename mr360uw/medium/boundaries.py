# SPDX-License-Identifier: Apache-2.0
"""What bounds the water and lights it: its surface, the sky above, the floor below."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mr360uw.errors import ParameterError

SurfaceKind = Literal["snell", "none"]
"""A flat surface with Fresnel's reflection, or none: no change of refractive index."""


@dataclass(frozen=True, slots=True)
class SkyShape:
    """A sky without a sun, the same on all sides. radiance: relative, at sines of elevation above the surface that are
    evenly spaced from 0 to 1; one number is a uniform sky.
    """

    radiance: tuple[float, ...] = (1.0,)

    def __post_init__(self) -> None:
        if not self.radiance or min(self.radiance) < 0.0 or not 0.0 < max(self.radiance) < np.inf:
            raise ParameterError(f"sky - needs light, none of it negative (got {self.radiance!r:.60}) - correct it")

    def seen_through(self, up: NDArray[np.float64], refractive_index: float) -> NDArray[np.float64]:
        """Return the relative radiance (...,) that is seen from below a flat surface in directions of a y."""
        sine = np.sqrt(np.maximum(1.0 - refractive_index**2 * (1.0 - up * up), 0.0))
        return np.interp(sine, np.linspace(0.0, 1.0, len(self.radiance)), self.radiance)


Sky = Literal["uniform", "floor"] | tuple[Literal["sun"], float, float] | SkyShape
"""Light that comes in: a uniform sky, or ("sun", y of the direction to the sun in the water, fraction of the
downwelling irradiance below the surface that is its beam), the rest being uniform sky; or "floor", no light from above
and a floor that shines with a radiance of 1 in all directions, which the results are then per unit of; or a sky of a
shape."""


@dataclass(frozen=True, slots=True)
class LambertFloor:
    """A level Lambert floor. depth_m: below the surface. albedo: in [0, 1], of n wavelengths, or one for all."""

    depth_m: float
    albedo: tuple[float, ...]

    def __post_init__(self) -> None:
        if not (np.isfinite(self.depth_m) and self.depth_m > 0.0):
            raise ParameterError(f"floor - must lie below the surface (got {self.depth_m!r} m) - give a depth above 0")
        if not self.albedo or not all(0.0 <= a <= 1.0 for a in self.albedo):
            raise ParameterError(f"floor - albedo must lie in [0, 1] (got {self.albedo!r:.60}) - correct it")


def sky_parts(sky: Sky) -> tuple[float, float]:
    """Return the y of the direction to the sun in the water, and the fraction of the light that is its beam."""
    if sky in ("uniform", "floor") or isinstance(sky, SkyShape):
        return 1.0, 0.0
    if isinstance(sky, tuple) and len(sky) == 3 and sky[0] == "sun" and 0.0 < sky[1] <= 1.0 and 0.0 <= sky[2] <= 1.0:
        return float(sky[1]), float(sky[2])
    raise ParameterError(
        f"sky - unknown (got {sky!r}) - take 'uniform', 'floor', a SkyShape or ('sun', up in the water in (0, 1], "
        "share in [0, 1])"
    )
