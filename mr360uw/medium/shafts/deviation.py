# SPDX-License-Identifier: Apache-2.0
"""Deviation of the light in the water from the smooth veil: shafts under waves and behind bodies, light of lamps.

The veil holds the light that an open, flat sea would scatter towards the camera, the first scattering of the sun's beam
included. Bodies and waves change that part. Only the change is added, so nothing counts twice:

    D = int_0^Z b p'(v . l) E' exp(-c' s) [u C V + (1 - u) B V_halo - 1] ds

    E'      E_camera exp(c' s v_y/l_y), the beam; light that turns by small angles is a part of it
    u       exp(-(c - c') p), the fraction of the beam that has not turned at all after its path p
    C, B    caustic ratio, and that of the light that has turned; V, V_halo: visible fractions of the sun's disc and
            of the wider disc that turned light comes from (`beam_pattern`)
    b p'    scattering by wide angles: the phase function with its forward peak cut off level
    c'      a plus the integral of b p' over the sphere; c = a + b

p' and c' are those of the medium's transmittance and veil and of the beam on objects (share g^4, below 22 degrees in
the ocean, `phase.wide_angle_moments`), and they go together. Where V is 0 everywhere D is exactly minus what the beam's
first wide-angle scattering gave to the veil. Light that turns by a small angle first and by a wide one later is part of
the shaft, blurred, as it is part of the beam on objects. Exact single scattering (p and c, `single_scattering`) lacks
that light and has instead the glow within 22 degrees of the sun, which the veil leaves out inside Snell's window.
docs/medium.md has what the choice amounts to. Shafts are not blurred on their way to the camera, as objects are not.

Lamps do not light the plate: all of their scattered light is added, with the same p' and c'. For the modes that are
closed forms the phase function is isotropic and c' = c, as in their veil.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.errors import ParameterError
from mr360uw.medium.medium import Medium
from mr360uw.medium.shafts.beam_pattern import MOST_POINTS
from mr360uw.medium.shafts.froxels import DEFAULT_GRID, FroxelGrid, shaft_field
from mr360uw.medium.shafts.ray_segments import radius_at, ray_ends_m, view_directions
from mr360uw.medium.shafts.shaft_scene import SPREAD_RAD, SUN_SAMPLES, ShaftScene
from mr360uw.shapes import checked
from mr360uw.types import CausticStack, Floats, Lamp, Sun, View

Array = NDArray[np.float64]

STEPS = 512
"""Segments of a ray of the exact march."""


@checked
def shaft_deviation(
    view: View,
    medium: Medium,
    sun: Sun | None,
    bodies: Sequence[Any] = (),
    caustics: CausticStack | None = None,
    lamps: Sequence[Lamp] = (),
    *,
    end_m: ArrayLike | None = None,
    grid: FroxelGrid | None = DEFAULT_GRID,
    steps: int = STEPS,
    spread_rad: float = SPREAD_RAD,
    sun_samples: int = SUN_SAMPLES,
) -> Floats:
    """Return the radiance (H, W, 3) by which light in the water deviates from the smooth veil, of either sign.

    sun: direction in the water, irradiance (3,) at the camera. bodies: as in `single_scattering`. caustics: of the same
    sun; its planes should reach from near the surface to where light fades. lamps: in the world. end_m: (H, W) or
    a number, distance [m] at which rays end besides the surface and the bodies. grid: of froxels; None marches every
    pixel in `steps` segments. spread_rad: standard
    deviation of the directions of light that has turned by small angles. sun_samples: directions over the sun's disc.
    Exactly zero without lamps where neither bodies nor caustics are given. Raises `ParameterError`.
    """
    if steps < 1:
        raise ParameterError(f"steps - must be 1 or more (got {steps}) - take more")
    scene = ShaftScene.of(view, medium, sun, bodies, caustics, lamps, spread_rad, sun_samples)
    directions = view_directions(view)
    ends = ray_ends_m(view, directions, view.surface_y_m, scene.bodies, end_m)
    if scene.dark:
        radiance = np.zeros((len(directions), 3))
    elif grid is None:
        radiance = march(scene, directions, ends, steps)
    else:
        radiance = shaft_field(scene, grid, directions).radiance(directions, ends)
    return radiance.reshape(view.height, view.width, 3)


def march(scene: ShaftScene, directions: Array, end_m: Array, steps: int) -> Array:
    """Return the deviation (m, 3) along rays (m, 3) of lengths (m,), from segments of equal light."""
    result = np.zeros((len(directions), 3))
    t = np.arange(steps + 1) / steps
    for part in np.array_split(np.arange(len(directions)), -(-len(directions) * steps // MOST_POINTS)):
        rate, reach = (x[:, None] for x in scene.layout(directions[part, 1]))
        reach = np.minimum(reach, end_m[part, None])
        result[part] = scene.segments(directions[part], radius_at(t, rate, reach)).sum(axis=1)
    return result
