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

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mr360uw.medium.medium import Medium
from mr360uw.medium.models import SpectralModel
from mr360uw.medium.ray_field import cosine_kernel
from mr360uw.medium.spectral.bands import Bands
from mr360uw.medium.tabulate import depth_nodes, diffuse_table, normal_nodes
from mr360uw.types import Floats

Array = NDArray[np.float64]

_STEP = 0.01
"""Interval of the sine of the sun's elevation in the water at which fields are solved: 0.3 % of the light."""
_TINY = 1e-290


@dataclass(frozen=True, slots=True, eq=False)
class LightAtCamera:
    """Measured light of the place of a camera. down, up: (3,) irradiance of level planes that face up and down, without
    the sun's beam. sun: (3,) irradiance across the beam, 0 for none; sun_up: y of its direction.
    """

    down: Floats
    up: Floats
    sun: Floats
    sun_up: float


def ambient_parts(medium: Medium, light: LightAtCamera) -> tuple[Array, Array]:
    """Return the table `MediumTable.diffuse` (N, D, 3) of a medium at its camera's depth, and the floor's radiance (3,).

    The radiance is 0 for a medium without a floor.
    """
    depth, here = depth_nodes(medium.length_m, medium.light.deepest_m), np.array([medium.camera_depth_m])
    parts = [_of(medium, None)]
    beam = np.zeros(3)
    if np.any(light.sun > 0.0):
        sun_up = min(max(round(light.sun_up / _STEP), 1) * _STEP, 1.0)
        parts.append(_of(medium.under(("sun", sun_up, 1.0)), sun_up))
        left = _beam(parts[1][0], sun_up, here, np.ones(1))[0] / sun_up
        beam = light.sun / np.maximum(left @ medium.bands.lobes, _TINY)
    glow = None if medium.floor_m is None else _of(medium.under("floor"), None)
    at_camera = [_on_normals(*part, here.tobytes())[:, 0] for part in parts]
    of_sun = beam * at_camera[1] if len(parts) > 1 else np.zeros_like(at_camera[0])
    down, up = (np.maximum(m - of_sun[k], 0.0) for m, k in ((light.down, -1), (light.up, 0)))
    of_glow = np.zeros_like(of_sun) if glow is None else _on_normals(*glow, here.tobytes())[:, 0]
    sky, floor = _two(at_camera[0], of_glow, down, up)
    amounts = [sky, beam, floor]
    whole, camera = 0.0, 0.0
    for part, amount in zip((parts[0], parts[1] if len(parts) > 1 else None, glow), amounts, strict=True):
        if part is not None:
            whole = whole + amount * _on_normals(*part, depth.tobytes())
            camera = camera + amount * _on_normals(*part, here.tobytes())
    return diffuse_table(whole, camera[:, 0], depth, medium.camera_depth_m), floor


def _two(sky: Array, glow: Array, down: Array, up: Array) -> tuple[Array, Array]:
    """Return how much (3,) of a sky's and of a floor's light give level planes the irradiances `down` and `up` (3,).

    sky, glow: (N, 3) of normals from below to above. All of the sky where nothing is measured.
    """
    determinant = sky[-1] * glow[0] - glow[-1] * sky[0]
    solvable = determinant > 0.0
    x = np.divide(sky[-1] * up - sky[0] * down, determinant, out=np.zeros(3), where=solvable)
    x = np.clip(x, 0.0, np.divide(up, glow[0], out=np.zeros(3), where=glow[0] > 0.0))
    q = np.maximum(down - x * glow[-1], 0.0) / np.maximum(sky[-1], _TINY)
    return np.where(q + x > 0.0, q, 1.0), x


def _of(medium: Medium, sun_up: float | None) -> tuple[SpectralModel, Bands, float | None]:
    return medium.model, medium.bands, sun_up


@functools.lru_cache(maxsize=64)
def _on_normals(model: SpectralModel, bands: Bands, sun_up: float | None, depths: bytes) -> Array:
    """Return the irradiance (N, D, 3) on `normal_nodes` at depths, without the beam of a sun."""
    depth, normal = np.frombuffer(depths), normal_nodes()
    light = model.irradiance(depth, normal[:, None])
    if sun_up is not None:
        light = light - _beam(model, sun_up, depth, normal[:, None])
    return np.asarray(np.maximum(light, 0.0) @ bands.lobes)


def _beam(model: SpectralModel, sun_up: float, depth: Array, normal: Array) -> Array:
    """Return the irradiance (..., n) of a sun's beam, with what turns by small angles, on normals at depths."""
    facing = cosine_kernel(np.array(sun_up), normal)[..., None] / (2.0 * np.pi * sun_up)
    return np.asarray(model.level_beam * facing * np.exp(-model.extinction / sun_up * depth[..., None]))
