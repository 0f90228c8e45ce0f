# SPDX-License-Identifier: Apache-2.0
"""What lights a scene: the sun, lamps, the environment."""

from __future__ import annotations

from dataclasses import dataclass

from mr360uw.cache import Parts
from mr360uw.types.frames import Floats


@dataclass(frozen=True, slots=True, eq=False)
class Sun(Parts):
    """A dominant light as the camera sees it (below the surface: after refraction).

    direction: (3,) unit, towards the sun. irradiance: (3,) linear RGB on a plane perpendicular to the beam, in plate
    radiance times sr. half_angle_rad: angular radius of the disc. confidence: 0 (a guess) to 1 (given or certain).
    shown: how far strength and colour are those that a plate shows, 1, and not what others tell of a clipped disc, 0.
    share: fraction of the light of its spot in the plate that it is; the rest stays in the sky.
    """

    direction: Floats
    irradiance: Floats
    half_angle_rad: float
    confidence: float
    shown: float = 1.0
    share: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Lamp(Parts):
    """A point or spot light at one instant, in the world.

    position: (3,) [m]. axis: (3,) unit, the direction of travel along the middle of a spot. intensity: (3,) linear RGB
    along the axis, in plate radiance times m2: the irradiance at 1 m without water. cos_core, cos_edge: cosines of the
    angles from the axis up to which a spot is fully bright and from which on it is dark; both -1 for a point light.
    radius_m: of the ball that shines, for soft shadows. attenuation: (D, 3) effective beam attenuation [1/m] of its
    light over a path S in water, at t = S/(S + length_m) of the medium's table; None without water. casts_shadow:
    whether bodies take its light away behind them.
    """

    position: Floats
    axis: Floats
    intensity: Floats
    cos_core: float = -1.0
    cos_edge: float = -1.0
    radius_m: float = 0.0
    attenuation: Floats | None = None
    casts_shadow: bool = True


Light = Sun | Lamp
"""A source with a direction of its own; what comes from all around is the `Environment`."""


@dataclass(frozen=True, slots=True, eq=False)
class Environment:
    """The light that reaches the camera, (32, 64, 3) equirectangular maps in plate radiance.

    radiance: of the expanded plate. irradiance: cosine integral of `radiance` over the hemisphere about each
    pixel's direction. sun: None where there is none. residual: `radiance` without the sun. ambient: cosine integral
    of `residual`, what surfaces receive besides the sun's beam. glossy: `residual` filtered by GGX lobes, (L, 32, 64,
    3), at the roughnesses `glossy_roughness` (L,), ascending; L = 0 where nothing needs them. detail: (128, 256, 3)
    what `residual` is the mean of, but for light of the sky that was restored later; None where it is not known.
    """

    radiance: Floats
    irradiance: Floats
    sun: Sun | None
    residual: Floats
    ambient: Floats
    glossy: Floats
    glossy_roughness: Floats
    detail: Floats | None = None
