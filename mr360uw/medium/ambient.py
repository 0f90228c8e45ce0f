# SPDX-License-Identifier: Apache-2.0
"""Ambient light on surfaces at any depth: what a plate shows at the camera, times the solved change from there.

    A(n, d) = q K(n, d) + p S(n, d) + x G(n, d)        ratio = A(n, d)/A(n, camera)

    symbol   light on a plane at the depth d whose normal has the y component n
    K        of a uniform sky
    S        of a sun's beam, as far as the water has scattered it out of the beam
    G        of a floor whose radiance is 1; none without a floor

p is the strength of the measured beam; q and x give level planes at the camera the ambient light that is measured from
above and from below. x is the floor's radiance in the plate's light. Every part is at least 0.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import shared
from mr360uw.constants import PI
from mr360uw.medium.medium import Medium
from mr360uw.medium.models import SpectralModel
from mr360uw.medium.ray_field import Sky, cosine_kernel
from mr360uw.medium.tabulate import NORMALS, depth_nodes, diffuse_table, normal_nodes
from mr360uw.types import Floats

Array = NDArray[np.float64]

_STEP = 0.01
"""Interval of the sine of the sun's elevation in the water at which fields are solved: 0.3 % of the light."""
_TINY = 1e-290


def ambient_parts(medium: Medium, down: Floats, up: Floats, sun: Floats, sun_up: float) -> tuple[Array, Array]:
    """Return the table `MediumTable.diffuse` (N, D, 3) of a medium, and the radiance (3,) of its floor, 0 without.

    down, up: (3,) measured irradiance at the camera of level planes that face up and down, without the sun's beam. sun:
    (3,) irradiance across the beam, 0 for none; sun_up: y of its direction.
    """
    depth, here = depth_nodes(medium.length_m, medium.light.deepest_m), np.array([medium.camera_depth_m])
    skies: list[tuple[Sky, float | None]] = [(medium.sky, None)]
    amounts: list[Array] = [np.ones(3)]
    of_sun, of_glow = np.zeros((NORMALS, 3)), np.zeros((NORMALS, 3))
    if np.any(sun > 0.0):
        sun_up = min(max(round(sun_up / _STEP), 1) * _STEP, 1.0)
        skies.append((("sun", sun_up, 1.0), sun_up))
        model = medium.under(skies[-1][0]).model
        left = model.level_beam / sun_up * np.exp(-model.extinction / sun_up * medium.camera_depth_m)
        amounts.append(sun / np.maximum(left @ medium.bands.lobes, _TINY))
        of_sun = amounts[-1] * _on_normals(medium, *skies[-1], here)[:, 0]
    if medium.floor_m is not None:
        skies.append(("floor", None))
        of_glow = _on_normals(medium, *skies[-1], here)[:, 0]
    from_above, from_below = (np.maximum(seen - of_sun[k], 0.0) for seen, k in ((down, -1), (up, 0)))
    of_sky = _on_normals(medium, *skies[0], here)[:, 0]
    amounts[0], floor = two_lights(of_sky[[-1, 0]], of_glow[[-1, 0]], from_above, from_below)
    if medium.floor_m is not None:
        amounts.append(floor)
    whole, at_camera = (
        sum((a * _on_normals(medium, *sky, at) for a, sky in zip(amounts, skies, strict=True)), np.zeros(3))
        for at in (depth if medium.floor_m is None else np.minimum(depth, medium.floor_m), here)
    )
    return diffuse_table(whole, at_camera[:, 0], depth, medium.camera_depth_m), floor


def two_lights(sky: Array, glow: Array, first: Array, second: Array) -> tuple[Array, Array]:
    """Return how much (3,) of a sky's and of a floor's light add up to two measured quantities (3,), neither below 0.

    sky, glow: (2, 3) of both quantities that each light gives. All of the sky where nothing is measured.
    """
    determinant = sky[0] * glow[1] - glow[0] * sky[1]
    solvable = determinant > 0.0
    x = np.divide(sky[0] * second - sky[1] * first, determinant, out=np.zeros(3), where=solvable)
    x = np.clip(x, 0.0, np.divide(second, glow[1], out=np.zeros(3), where=glow[1] > 0.0))
    q = np.maximum(first - x * glow[0], 0.0) / np.maximum(sky[0], _TINY)
    return np.where(q + x > 0.0, q, 1.0), x


def _on_normals(medium: Medium, sky: Sky, sun_up: float | None, depth_m: Array) -> Array:
    """Return the irradiance (N, D, 3) on `normal_nodes` at depths, without the beam of a sun."""
    light = _solved(medium.under(sky).model, sun_up, depth_m.tobytes())
    return np.asarray(light @ (medium.floor_lobes if sky == "floor" else medium.bands.lobes))


@shared(keep=32)
def _solved(model: SpectralModel, sun_up: float | None, depths: bytes) -> Array:
    """Return the same at the model's wavelengths, (N, D, n)."""
    depth, normal = np.frombuffer(depths), normal_nodes()[:, None]
    light = model.irradiance(depth, normal)
    if sun_up is not None:
        facing = cosine_kernel(np.array(sun_up), normal) / (2.0 * PI * sun_up)
        light = light - facing[..., None] * model.level_beam * np.exp(-model.extinction / sun_up * depth[:, None])
    return np.maximum(light, 0.0)
