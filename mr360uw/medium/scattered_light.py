# SPDX-License-Identifier: Apache-2.0
"""Scattered light: ambient light on surfaces at any depth, light around the sun, and the spread of the sun's beam.

Ambient light is what the plate shows at the camera, times the solved change from there:

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

import numpy as np

from mr360uw.base.cache import shared
from mr360uw.base.constants import PI
from mr360uw.base.disk_cache import kept_arrays
from mr360uw.base.progress import one_blas_thread
from mr360uw.base.sphere import directions, gauss_legendre, row_solid_angle
from mr360uw.medium.lookup import depth_nodes, diffuse_table, normal_nodes
from mr360uw.medium.medium import SOLVED, Medium
from mr360uw.medium.models import FieldModel, SpectralModel, mean_rates
from mr360uw.medium.open_water import COLUMNS, MIDDLE, ROWS, row_up, typical
from mr360uw.medium.phase import Phase, forward_cone, forward_peak, wide_angle_moments
from mr360uw.medium.ray_field import Sky, SurfaceKind, cosine_kernel
from mr360uw.medium.spectra import Sensor
from mr360uw.medium.water import Water
from mr360uw.types import Array, BeamSpread, Floats

_STEP = 0.01
"""Interval of the sine of the sun's elevation in the water at which fields are solved: 0.3 % of the light."""
_TINY = 1e-290
"""Radiance below which there is no light."""


def ambient_parts(medium: Medium, down: Floats, up: Floats, sun: Floats, sun_up: float) -> tuple[Array, Array]:
    """Return the table `MediumTable.diffuse` (N, D, 3) of a medium, and the radiance (3,) of its floor, 0 without.

    down, up: (3,) measured irradiance at the camera of level planes that face up and down, without the sun's beam. sun:
    (3,) irradiance across the beam, 0 for none; sun_up: y of its direction.
    """
    depth = depth_nodes(medium.length_m, medium.light.deepest_m, rough=medium.rough)
    here = np.array([medium.camera_depth_m])
    # Light the water by a sky of strength 1, by the measured sun, and by a floor of radiance 1
    skies: list[tuple[Sky, float | None]] = [(medium.sky, None)]
    amounts: list[Array] = [np.ones(3)]
    of_sun = of_glow = np.zeros((len(normal_nodes(rough=medium.rough)), 3))
    if np.any(sun > 0.0):
        sun_up = min(max(round(sun_up / _STEP), 1) * _STEP, 1.0)
        skies.append((("sun", sun_up, 1.0), sun_up))
        model = medium.under(skies[-1][0]).model
        depth_m = medium.camera_depth_m
        left = model.level_beam / sun_up * np.exp(-mean_rates(model, 0.0, depth_m)[0] / sun_up * depth_m)
        amounts.append(sun / np.maximum(left @ medium.bands.lobes, _TINY))
        of_sun = amounts[-1] * _on_normals(medium, *skies[-1], here)[:, 0]
    if medium.floor_m is not None:
        skies.append(("floor", None))
        of_glow = _on_normals(medium, *skies[-1], here)[:, 0]
    # Find how strong sky and floor are, from what is left of the measured light
    from_above, from_below = (np.maximum(seen - of_sun[k], 0.0) for seen, k in ((down, -1), (up, 0)))
    of_sky = _on_normals(medium, *skies[0], here)[:, 0]
    amounts[0], floor = _two_lights(of_sky[[-1, 0]], of_glow[[-1, 0]], from_above, from_below)
    if medium.floor_m is not None:
        amounts.append(floor)
    # Sum the parts over depth and normal, relative to the camera
    whole, at_camera = (
        sum((a * _on_normals(medium, *sky, at) for a, sky in zip(amounts, skies, strict=True)), np.zeros(3))
        for at in (depth if medium.floor_m is None else np.minimum(depth, medium.floor_m), here)
    )
    return diffuse_table(whole, at_camera[:, 0], depth, medium.camera_depth_m), floor


def _two_lights(sky: Array, glow: Array, first: Array, second: Array) -> tuple[Array, Array]:
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
    lobes = medium.floor_lobes if sky == "floor" else medium.bands.lobes
    return _solved(medium.under(sky).model, sun_up, depth_m.tobytes(), lobes.tobytes(), medium.rough)


@shared(keep=32)
def _solved(model: SpectralModel, sun_up: float | None, depths: bytes, lobes: bytes, rough: bool) -> Array:
    """Return the same of a model in the channels of some lobes (n, 3)."""
    depth, normal = np.frombuffer(depths), normal_nodes(rough=rough)[:, None]
    light = model.irradiance(depth, normal)
    if sun_up is not None:
        facing = cosine_kernel(np.array(sun_up), normal) / (2.0 * PI * sun_up)
        lost = mean_rates(model, 0.0, depth)[0] / sun_up * depth[:, None]
        light = light - facing[..., None] * model.level_beam * np.exp(-lost)
    return np.maximum(light, 0.0) @ np.frombuffer(lobes).reshape(-1, 3)


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

_COARSE = 0.05
"""`_STEP` for what is typical of the azimuths: 0.5 % of E."""
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
    strength, floor = _two_lights(of_sky[:2], of_floor[:2], shown, np.asarray(below, np.float64))
    return np.asarray(strength * of_sky[2] + floor * of_floor[2])


def _lights_at(medium: Medium, sky: Sky) -> Array:
    """Return, of a sky and of a floor of radiance 1, the level light, that below the horizon, and the irradiance of a
    level plane that faces up, (2, 3, 3).

    Where a camera rises or sinks they are interpolated linearly between depths 6 % apart: within 0.06 % of what is
    solved at its own.
    """
    kind = medium.water, medium.sensor, medium.illuminant, medium.surface, medium.refractive_index
    at = medium.floor_m, medium.rough
    if not medium.between_m:
        return _lights(kind, sky, medium.camera_depth_m, *at)
    above, below = medium.between_m
    share = (medium.camera_depth_m - above) / (below - above)
    return (1.0 - share) * _lights(kind, sky, above, *at) + share * _lights(kind, sky, below, *at)


@shared(keep=64)
def _lights(
    kind: tuple[Water, Sensor, str, SurfaceKind, float], sky: Sky, depth_m: float, floor_m: float | None, rough: bool
) -> Array:
    """Return `_lights_at` a depth, which takes 30 ms to solve; that of a solved field is kept on the disk.

    kind: water, sensor, illuminant, surface and refractive index.
    """
    water, sensor, illuminant, surface, refractive_index = kind
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
            if (around := around_sun(medium.under(("sun", coarse, 1.0)), level=True)) is not None:
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


# Spread of the sun's beam by small angles.
#
# Small-angle scattering theory (Wells 1969, 1973): light turned by theta at a distance t before a plane arrives theta t
# beside its ray. With tau the optical depth of small-angle scattering over the path p, p_s the phase function of small
# angles (integral 1) and x a spatial frequency times p, the pattern of the beam is passed on with the factor
#
#     M(x) = exp(-tau (1 - P(x)))        P(x) = int_0^1 du 2 pi int p_s J0(2 pi theta u x) theta dtheta
#
# M(0) = 1: no light is lost, as all of it counts as the beam. M falls to exp(-tau), the part that has not turned at all
# and stays sharp. The rest, (M - exp(-tau))/(1 - exp(-tau)), is a sum of Gaussians of non-negative weight.

_SPREAD_NM = 550.0
"""Wavelength [nm] whose small-angle scattering shapes the pattern of light that has turned; others differ little."""
_ANGLES_RAD = 0.0015 * 2.0 ** np.arange(9)
"""Standard deviations of the Gaussians over the path: 0.09 to 22 degrees, a factor of two apart."""
_FREQUENCIES = np.geomspace(0.1, 600.0, 80)
"""Values of x that the weights are fitted at: cycles per radian."""
_DEPTHS = np.concatenate([[1e-3], np.geomspace(0.02, 40.0, 34)])
"""Values of tau that weights are tabulated at; deeper down nothing of a pattern is left."""
_STEPS = 24
"""Gauss-Legendre nodes along the path."""


def spread_factor(theta: Array, weight: Array, tau: Array, x: Array) -> Array:
    """Return M (len(tau), len(x)) of angles (n,) [rad] and the fractions (n,) of light that turns by them.

    x: cycles per radian.
    """
    return np.exp(-np.asarray(tau, np.float64)[:, None] * (1.0 - _mean_transform(theta, weight, x)))


def _mean_transform(theta: Array, weight: Array, x: Array) -> Array:
    """Return P (n,) at x (n,)."""
    from scipy.special import j0

    node, share = gauss_legendre(_STEPS)
    # light that turns near the plane is hardly moved: nodes are dense there
    u, share = (0.5 * (node + 1.0)) ** 2, 0.5 * share * (node + 1.0)
    along = np.asarray(x, np.float64)[:, None] * u
    places, values = np.geomspace(1e-6, max(float(along.max()), 1e-5), 400), np.empty(400)
    for i, place in enumerate(places):
        values[i] = weight @ j0(2.0 * PI * theta * place)
    return np.asarray(np.interp(along, np.append(0.0, places), np.append(1.0, values)) @ share)


@shared(keep=16)
def _weights(phase: Phase, *, cone: bool) -> Array:
    """Return the weights (len(_DEPTHS), len(_ANGLES_RAD)) of the turned light's Gaussians, each row of sum 1.

    cone: of light that turns within the cone instead of that of the forward peak.
    """
    turns = forward_cone(phase)[:2] if cone else forward_peak(phase)
    return np.asarray(kept_arrays("spread", turns, lambda: {"weights": _fitted_weights(*turns)})["weights"])


def _fitted_weights(theta: Array, weight: Array) -> Array:
    from scipy.optimize import nnls

    gaussians = np.exp(-2.0 * (PI * _ANGLES_RAD * _FREQUENCIES[:, None]) ** 2)
    unturned = np.exp(-_DEPTHS)[:, None]
    turned = (spread_factor(theta, weight, _DEPTHS, _FREQUENCIES) - unturned) / -np.expm1(-_DEPTHS)[:, None]
    system = np.vstack([gaussians, np.full((1, len(_ANGLES_RAD)), 1e3)])
    rows = np.array([nnls(system, np.append(row, 1e3))[0] for row in turned])
    return np.asarray(rows / rows.sum(axis=1, keepdims=True))


@shared(keep=4)
def spread_of(medium: Medium) -> BeamSpread | None:
    """Return the spread of the sun's beam in a medium at `_SPREAD_NM`; in layers, that of the camera's.

    None for the closed forms and fitted formations: their beam has no light that has turned.
    """
    if medium.mode not in SOLVED:
        return None
    at = int(np.argmin(np.abs(medium.bands.wavelength_nm - _SPREAD_NM)))
    scattering = float(medium.model.attenuation[at] - medium.model.extinction[at])
    return beam_spread(medium.water.phase, scattering) if scattering > 0.0 else None


@shared(keep=16)
def beam_spread(phase: Phase, scattering: float) -> BeamSpread:
    """Return the spread of the beam, one object for equal arguments.

    scattering: by small angles [1/m], the difference of c and c'.
    """
    return BeamSpread(scattering, _ANGLES_RAD, _DEPTHS, _weights(phase, cone=False))


def image_spread(medium: Medium) -> BeamSpread | None:
    """Return how a medium, or the camera's layer, blurs pictures, by the light that turns within a cone; None as
    `spread_of`.

    A body's light takes the way of the beam backwards: what turns by theta at a distance t from it arrives beside it by
    theta t over its distance. So M holds, of the phase function within the cone.
    """
    if spread_of(medium) is None:
        return None
    phase, light = medium.water.phase, np.maximum(medium.bands.weight, 0.0)
    peak = (medium.model.attenuation - medium.model.extinction) @ light / light.sum(axis=0)
    within = peak * forward_cone(phase)[2] / (1.0 - float(wide_angle_moments(phase, 1)[0]))
    return BeamSpread(within, _ANGLES_RAD, _DEPTHS, _weights(phase, cone=True), within - peak)


# Light of open water by its azimuth from the sun, over the mean that the tables of a medium hold.
#
#     veil(d, s) = veil(up, s) R(d)        R(d) = L(d)/mean of L over the azimuth
#
# L: light that an endless ray, or one up to the surface, gains. Light at a small angle to the sun is several times as
# bright as opposite. On shorter ways the ratio is hardly another: level rays have the same at any length; with R, light
# of rays of 1 to 5 m is off by 0.4 % rms of that of the endless ray in clear water, by 3 % in turbid water, 7 m deep,
# where rays towards the surface pass from diffuse into direct light.

_NO_LIGHT = 1e-300
"""Mean radiance up to which there is no light to take a ratio to."""
_HORIZON = slice(ROWS // 2 - 1, ROWS // 2 + 1)
"""The two rows at the horizon."""
AZIMUTHS = PI * np.linspace(0.0, 1.0, 25) ** 1.5
"""Azimuths from the sun's [rad] that the ratio is computed at: dense about the sun."""
_EVERY, _FEWEST = 4, 4
"""One wavelength in so many is taken, as the ratio changes slowly over them, but no fewer than these where there are as
many: a channel that none of them reaches would have no light."""
_DEPTH_RATIO = 2.0**0.5
"""Ratio of the depths that are computed. Between them R is interpolated, which even in turbid water is off by 1 %."""
_ROUGH_AZIMUTHS, _ROUGH_ORDERS = PI * np.linspace(0.0, 1.0, 13) ** 1.5, 4
"""Azimuths and highest order for drafts, a fifth of the time: R is off by 1 to 3 % rms, typical light at the horizon by
less than 1 %; in clear water within degrees of the sun by more."""


def around_sun(medium: Medium, *, level: bool = False) -> Array | None:
    """Return the ratio R (ROWS, len(AZIMUTHS), 3) at a medium's camera; None where its light has no sun.

    level: of the two rows at the horizon alone. Of water in layers it is that of the camera's alone.
    """
    medium = medium.in_one_water()
    if not isinstance(medium.model, FieldModel) or not isinstance(medium.sky, tuple):
        return None
    every = min(_EVERY, max(len(medium.bands.wavelength_nm) // _FEWEST, 1))
    model = medium.model_at(medium.bands.wavelength_nm[::every], "table")
    lobes, up = medium.bands.lobes[::every].tobytes(), row_up(ROWS)[_HORIZON if level else ...].tobytes()
    assert isinstance(model, FieldModel)
    if medium.rough:
        return _roughly(model, lobes, medium.camera_depth_m, up)
    step = int(np.floor(np.log(medium.camera_depth_m) / np.log(_DEPTH_RATIO)))
    above, below = _DEPTH_RATIO**step, _DEPTH_RATIO ** (step + 1)
    if medium.floor_m is not None:
        below = max(min(below, medium.floor_m), medium.camera_depth_m)
    share = np.log(medium.camera_depth_m / above) / np.log(below / above) if below > above else 0.0
    upper, lower = _at_depths(model, lobes, (above, below), up)
    return upper + share * (lower - upper)


@shared(keep=64)
def _at_depths(model: FieldModel, lobes: bytes, depths_m: tuple[float, ...], directions: bytes) -> Array:
    weights, up = np.frombuffer(lobes).reshape(-1, 3), np.frombuffer(directions)

    def ratio() -> dict[str, Array]:
        with one_blas_thread():
            light = model.around_sun(depths_m, up, AZIMUTHS) @ weights
        return {"ratio": _over_mean(light)}

    return np.asarray(kept_arrays("around", (*depths_m, up, weights, *model.inputs), ratio)["ratio"])


@shared(keep=64)
def _roughly(model: FieldModel, lobes: bytes, depth_m: float, directions: bytes) -> Array:
    from scipy.interpolate import PchipInterpolator

    up = np.frombuffer(directions)
    with one_blas_thread():
        few = model.up_to_order(_ROUGH_ORDERS).around_sun(depth_m, up, _ROUGH_AZIMUTHS)
    light = PchipInterpolator(_ROUGH_AZIMUTHS, few @ np.frombuffer(lobes).reshape(-1, 3), axis=1)(AZIMUTHS)
    return _over_mean(light)


def _over_mean(light: Array) -> Array:
    """Return light (..., a, 3) over its mean over the azimuths; 1 in a channel without light."""
    gap, (_, bent) = np.diff(AZIMUTHS), _spline()
    weight = 0.5 * (np.append(gap, 0.0) + np.append(0.0, gap))  # of each node in the mean of straight lines between
    cubes = np.append(gap**3, 0.0) + np.append(0.0, gap**3)
    share = (weight - cubes @ bent / 24.0) / PI
    mean = (share @ light)[..., None, :]
    return np.divide(light, mean, out=np.ones(light.shape), where=mean > _NO_LIGHT)


@functools.cache
def _spline() -> tuple[Array, Array]:
    """Return the gaps (a - 1,) between `AZIMUTHS` and the matrix (a, a) that gives a cubic spline's second derivatives.

    With y at the nodes, h the gaps, y" is continuous and linear between nodes, and y' is 0 at both ends, where the sun
    and its opposite are:

        h_(k-1) y"_(k-1) + 2 (h_(k-1) + h_k) y"_k + h_k y"_(k+1) = 6 ((y_(k+1) - y_k)/h_k - (y_k - y_(k-1))/h_(k-1))
    """
    gap = np.diff(AZIMUTHS)
    slope = np.diff(np.eye(len(AZIMUTHS)), axis=0) / gap[:, None]
    left, right = np.append(0.0, gap), np.append(gap, 0.0)
    bend = np.diag(2.0 * (left + right)) + np.diag(gap, 1) + np.diag(gap, -1)
    ends = np.zeros((1, len(AZIMUTHS)))
    return gap, np.linalg.solve(bend, 6.0 * np.diff(np.vstack([ends, slope, ends]), axis=0))


def placed(ratio: Array, sun: Floats) -> Array:
    """Return a ratio R (rows, a, 3) as an equirectangular map (rows, COLUMNS, 3).

    sun: (3,) direction towards it in the map's axes.
    """
    level = directions(COLUMNS, 2)[0][:, [0, 2]]
    across = np.array([sun[0], sun[2]]) / max(float(np.hypot(sun[0], sun[2])), 1e-12)
    cosine = level @ across / np.linalg.norm(level, axis=1)
    # Weights (COLUMNS, a) of the nodes in the cubic spline at each column's azimuth from the sun
    gap, bent = _spline()
    azimuth = np.arccos(np.clip(cosine, -1.0, 1.0))
    before = np.clip(np.searchsorted(AZIMUTHS, azimuth, side="right") - 1, 0, len(gap) - 1)
    h, b = gap[before], (azimuth - AZIMUTHS[before]) / gap[before]
    a, nodes = 1.0 - b, np.eye(len(AZIMUTHS))
    weight = a[:, None] * nodes[before] + b[:, None] * nodes[before + 1]
    for part, node in ((a, before), (b, before + 1)):
        weight += ((part**3 - part) * h * h / 6.0)[:, None] * bent[node]
    return np.maximum(weight @ ratio, 0.0)


def typical_level(around: Array) -> Array:
    """Return what is typical (3,) of a map R at the horizon, from where a gain is fitted to a plate (`fit_level`)."""
    middle = len(around) // 2
    level = around[middle - 1 : middle + 1].mean(axis=0)
    return typical(level, np.ones(COLUMNS), MIDDLE)
