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
from mr360uw.medium.around_sun import around_sun, placed, typical_level
from mr360uw.medium.medium import Medium
from mr360uw.medium.models import FieldModel, SpectralModel
from mr360uw.medium.ray_field import Sky, SurfaceKind, cosine_kernel
from mr360uw.medium.spectral.sensor import Sensor
from mr360uw.medium.tabulate import NORMALS, depth_nodes, diffuse_table, normal_nodes
from mr360uw.medium.water import Water
from mr360uw.reading.disk_cache import kept_arrays
from mr360uw.sphere import directions, row_solid_angle
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


# Irradiance at the camera from the light of open water at the horizon, for the sun's height and the floor's light.
#
#     l = s l_s + f l_f        b = s b_s + f b_f        E = s e_s + f e_f
#
# l, b: light that the plate shows along the horizon, and as a mean about 17 degrees below it. l_s, b_s, e_s: the same
# and the irradiance of a level plane that faces up, in the same water under a sun of that height over a black floor;
# l_f, b_f, e_f: of a floor of radiance 1. Level light is what is typical of the azimuths, as the gain is. It comes from
# a wide part of the floor: what lies straight below, with its own colour and lines of light, is no measure of that, and
# up to a fifth of E off. Without a floor E = l e_s/l_s. A high sun sends less of its light along the horizon than a
# uniform sky: under a uniform sky alone E would be a fifth too low. How strong the sun is beside the sky matters less:
# a beam of 0.6 instead of 0.75 makes 5 %.

"""Interval of the sine of the sun's elevation in the water at which fields are solved: 0.3 % of E."""
_COARSE = 0.05
"""The same for what is typical of the azimuths: 0.5 % of E."""
_LEVEL = np.zeros(1)
_BELOW, _ABOUT = -0.3, 0.12
"""Sine of the elevation about which the floor is looked at, and over which directions count less."""
_NODES = np.linspace(_BELOW - 3.0 * _ABOUT, -1e-3, 48)
"""Sines of elevation at which the solved light below the horizon is taken."""


def light_below_horizon(light: Floats, up: Floats) -> Array:
    """Return the mean light (3,) a little below the horizon in an equirectangular map (H, W, 3) of radiance.

    up: (3,) of the world in the map's axes.
    """
    weight = _weight(directions(*light.shape[1::-1]) @ up) * row_solid_angle(*light.shape[1::-1])[:, None]
    return np.asarray(np.tensordot(weight, light, 2) / weight.sum())


def _weight(up: Floats) -> Array:
    return np.exp(-(((up - _BELOW) / _ABOUT) ** 2)) * (up < 0.0)


def irradiance_from_level(medium: Medium, sun_up: float | None, direct: Floats | float, below: Floats) -> Array:
    """Return the irradiance (3,) of a level plane at the camera, sun included, in the medium's light times its gain.

    sun_up: y of the sun's direction in the water, in (0, 1], or None where it is not known. direct: fraction, (3,) or
    of all channels, of the light just below the surface that is its beam. below: (3,) the plate's
    `light_below_horizon`, which tells the floor's. A medium that was solved for a sun keeps its height. medium: of mode
    "table".
    """
    sky: Sky = medium.sky
    if isinstance(sky, tuple):
        sun_up, sky = sky[1], "uniform"
    of_sky, of_floor = _lights_at(medium, sky)
    if sun_up is not None and medium.surface != "none":
        of_sun, _ = _lights_at(medium, ("sun", min(max(round(sun_up / _STEP), 1) * _STEP, 1.0), 1.0))
        of_sky = (1.0 - direct) * of_sky + direct * of_sun
    shown = medium.gain * medium.level_radiance(_LEVEL)[0]
    strength, floor = two_lights(of_sky[:2], of_floor[:2], shown, np.asarray(below, np.float64))
    return np.asarray(strength * of_sky[2] + floor * of_floor[2])


def _lights_at(medium: Medium, sky: Sky) -> Array:
    """Return, of a sky and of a floor of radiance 1, the level light, that below the horizon, and the irradiance of a
    level plane that faces up, (2, 3, 3).

    Where a camera rises or sinks they are interpolated linearly between depths 6 % apart: within 0.06 % of what is
    solved at its own.
    """
    of_water = medium.water, medium.sensor, medium.illuminant, medium.surface, medium.refractive_index, sky
    at = medium.floor_m, medium.rough
    if not medium.between_m:
        return _lights(*of_water, medium.camera_depth_m, *at)
    above, below = medium.between_m
    share = (medium.camera_depth_m - above) / (below - above)
    return (1.0 - share) * _lights(*of_water, above, *at) + share * _lights(*of_water, below, *at)


@shared(keep=64)
def _lights(
    water: Water, sensor: Sensor, illuminant: str, surface: SurfaceKind, refractive_index: float, sky: Sky,
    depth_m: float, floor_m: float | None, rough: bool,
) -> Array:  # fmt: skip
    """Return `_lights_at` a depth, which takes 30 ms to solve; that of a solved field is kept on the disk."""
    uniform = Medium(
        water, sensor, camera_depth_m=depth_m, illuminant=illuminant, surface=surface,
        refractive_index=refractive_index, floor_m=floor_m,
    )  # fmt: skip
    uniform = uniform.for_drafts() if rough else uniform

    def solved() -> dict[str, Array]:
        medium, of_floor = uniform.under(sky), np.zeros((3, 3))
        of_sky = medium.light.display(_three(medium.model, depth_m))
        if isinstance(sky, tuple):  # what is typical of the azimuths, as the gain is
            coarse = min(max(round(sky[1] / _COARSE), 1) * _COARSE, 1.0)
            if (around := around_sun(medium.under(("sun", coarse, 1.0)))) is not None:
                of_sky[0] *= typical_level(placed(around, np.array([1.0, 0.0, 0.0])))
        if floor_m is not None:
            of_floor = _three(medium.under("floor").model, depth_m) @ medium.floor_lobes
        return {"light": np.stack([of_sky, of_floor])}

    # Under a uniform sky the water has been solved before: what it was solved for need not be, for another sky
    of_bands = uniform.bands.wavelength_nm, uniform.bands.weight
    assert isinstance(uniform.model, FieldModel)
    return kept_arrays("light", (sky, depth_m, rough, *of_bands, *uniform.model.inputs), solved)["light"]


def _three(model: SpectralModel, depth_m: float) -> Array:
    """Return the three quantities (3, n) of a model's bands."""
    weight = _weight(_NODES) / _weight(_NODES).sum()
    below = weight @ model.radiance(depth_m, _NODES)
    return np.stack([model.radiance(depth_m, _LEVEL)[0], below, model.irradiance(depth_m, np.ones(1))[0]])
