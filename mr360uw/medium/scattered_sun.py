# SPDX-License-Identifier: Apache-2.0
"""Scattered sunlight: the spread of the beam by small angles, and light of open water by its azimuth from the sun.

Small-angle scattering theory (Wells 1969, 1973): light turned by theta at a distance t before a plane arrives theta t
beside its ray. With tau the optical depth of small-angle scattering over the path p, p_s the phase function of small
angles (integral 1) and x a spatial frequency times p, the pattern of the beam is passed on with the factor

    M(x) = exp(-tau (1 - P(x)))        P(x) = int_0^1 du 2 pi int p_s J0(2 pi theta u x) theta dtheta

M(0) = 1: no light is lost, as all of it counts as the beam. M falls to exp(-tau), the part that has not turned at all
and stays sharp. The rest, (M - exp(-tau))/(1 - exp(-tau)), is a sum of Gaussians of non-negative weight.
"""

from __future__ import annotations

import functools

import numpy as np

from mr360uw.cache import shared
from mr360uw.constants import PI
from mr360uw.medium.medium import Medium
from mr360uw.medium.models import FieldModel
from mr360uw.medium.open_water import COLUMNS, MIDDLE, ROWS, row_up, typical
from mr360uw.medium.phase import Phase, forward_peak
from mr360uw.reading.disk_cache import kept_arrays
from mr360uw.sphere import directions, gauss_legendre
from mr360uw.threads import one_blas_thread
from mr360uw.types import Array, BeamSpread, Floats

SPREAD_NM = 550.0
"""Wavelength [nm] whose small-angle scattering shapes the pattern of light that has turned; others differ little."""
_ANGLES_RAD = 0.0015 * 2.0 ** np.arange(9)
"""Standard deviations of the Gaussians over the path: 0.09 to 22 degrees, a factor of two apart."""
_FREQUENCIES = np.geomspace(0.1, 600.0, 80)
"""Values of x that the weights are fitted at: cycles per radian."""
_DEPTHS = np.concatenate([[1e-3], np.geomspace(0.02, 40.0, 34)])
"""Values of tau that weights are tabulated at; deeper down nothing of a pattern is left."""
_STEPS = 24
"""Gauss-Legendre nodes along the path."""


def spread_factor(phase: Phase, tau: Array, x: Array) -> Array:
    """Return M (len(tau), len(x)) of a particle phase function. x: cycles per radian."""
    return np.exp(-np.asarray(tau, np.float64)[:, None] * (1.0 - _mean_transform(phase, x)))


def _mean_transform(phase: Phase, x: Array) -> Array:
    """Return P (n,) at x (n,)."""
    from scipy.special import j0

    theta, weight = forward_peak(phase)
    node, share = gauss_legendre(_STEPS)
    # light that turns near the plane is hardly moved: nodes are dense there
    u, share = (0.5 * (node + 1.0)) ** 2, 0.5 * share * (node + 1.0)
    along = np.asarray(x, np.float64)[:, None] * u
    places, values = np.geomspace(1e-6, max(float(along.max()), 1e-5), 400), np.empty(400)
    for i, place in enumerate(places):
        values[i] = weight @ j0(2.0 * PI * theta * place)
    return np.asarray(np.interp(along, np.append(0.0, places), np.append(1.0, values)) @ share)


@shared(keep=16)
def _weights(phase: Phase) -> Array:
    """Return the weights (len(_DEPTHS), len(_ANGLES_RAD)) of the turned light's Gaussians, each row of sum 1."""
    return np.asarray(kept_arrays("spread", (phase,), lambda: {"weights": _fitted_weights(phase)})["weights"])


def _fitted_weights(phase: Phase) -> Array:
    from scipy.optimize import nnls

    gaussians = np.exp(-2.0 * (PI * _ANGLES_RAD * _FREQUENCIES[:, None]) ** 2)
    unturned = np.exp(-_DEPTHS)[:, None]
    turned = (spread_factor(phase, _DEPTHS, _FREQUENCIES) - unturned) / -np.expm1(-_DEPTHS)[:, None]
    system = np.vstack([gaussians, np.full((1, len(_ANGLES_RAD)), 1e3)])
    rows = np.array([nnls(system, np.append(row, 1e3))[0] for row in turned])
    return np.asarray(rows / rows.sum(axis=1, keepdims=True))


@shared(keep=4)
def spread_of(medium: Medium) -> BeamSpread | None:
    """Return the spread of the sun's beam in a medium at `SPREAD_NM`.

    None for the closed forms and fitted formations: their beam has no light that has turned.
    """
    if medium.mode not in ("table", "plate"):
        return None
    at = int(np.argmin(np.abs(medium.bands.wavelength_nm - SPREAD_NM)))
    scattering = float(medium.model.attenuation[at] - medium.model.extinction[at])
    return beam_spread(medium.water.phase, scattering) if scattering > 0.0 else None


@shared(keep=16)
def beam_spread(phase: Phase, scattering: float) -> BeamSpread:
    """Return the spread of the beam, one object for equal arguments.

    scattering: by small angles [1/m], the difference of c and c'.
    """
    return BeamSpread(scattering, _ANGLES_RAD, _DEPTHS, _weights(phase))


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


def around_sun(medium: Medium) -> Array | None:
    """Return the ratio R (ROWS, len(AZIMUTHS), 3) at a medium's camera; None where its light has no sun."""
    if not isinstance(medium.model, FieldModel) or not isinstance(medium.sky, tuple):
        return None
    every = min(_EVERY, max(len(medium.bands.wavelength_nm) // _FEWEST, 1))
    model = medium.model_at(medium.bands.wavelength_nm[::every], "table")
    lobes = medium.bands.lobes[::every].tobytes()
    assert isinstance(model, FieldModel)
    if medium.rough:
        return _roughly(model, lobes, medium.camera_depth_m)
    step = int(np.floor(np.log(medium.camera_depth_m) / np.log(_DEPTH_RATIO)))
    above, below = _DEPTH_RATIO**step, _DEPTH_RATIO ** (step + 1)
    if medium.floor_m is not None:
        below = max(min(below, medium.floor_m), medium.camera_depth_m)
    share = np.log(medium.camera_depth_m / above) / np.log(below / above) if below > above else 0.0
    upper, lower = (_at_depth(model, lobes, depth_m) for depth_m in (above, below))
    return upper + share * (lower - upper)


@shared(keep=64)
def _at_depth(model: FieldModel, lobes: bytes, depth_m: float) -> Array:
    weights = np.frombuffer(lobes).reshape(-1, 3)

    def ratio() -> dict[str, Array]:
        with one_blas_thread():
            light = model.around_sun(depth_m, row_up(ROWS), AZIMUTHS) @ weights
        return {"ratio": _over_mean(light)}

    return np.asarray(kept_arrays("around", (depth_m, weights, *model.inputs), ratio)["ratio"])


@shared(keep=64)
def _roughly(model: FieldModel, lobes: bytes, depth_m: float) -> Array:
    from scipy.interpolate import PchipInterpolator

    with one_blas_thread():
        few = model.up_to_order(_ROUGH_ORDERS).around_sun(depth_m, row_up(ROWS), _ROUGH_AZIMUTHS)
    light = PchipInterpolator(_ROUGH_AZIMUTHS, few @ np.frombuffer(lobes).reshape(-1, 3), axis=1)(AZIMUTHS)
    return _over_mean(light)


def _over_mean(light: Array) -> Array:
    """Return light (r, a, 3) over its mean over the azimuths; 1 in a channel without light."""
    gap, (_, bent) = np.diff(AZIMUTHS), _spline()
    weight = 0.5 * (np.append(gap, 0.0) + np.append(0.0, gap))  # of each node in the mean of straight lines between
    cubes = np.append(gap**3, 0.0) + np.append(0.0, gap**3)
    share = (weight - cubes @ bent / 24.0) / PI
    mean = np.einsum("a,rak->rk", share, light)[:, None]
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
    """Return a ratio R (ROWS, a, 3) as an equirectangular map (ROWS, COLUMNS, 3).

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
    return np.maximum(np.einsum("ca,rak->rck", weight, ratio), 0.0)


def typical_level(around: Array) -> Array:
    """Return what is typical (3,) of a map R at the horizon, from where a gain is fitted to a plate (`fit_level`)."""
    level = around[ROWS // 2 - 1 : ROWS // 2 + 1].mean(axis=0)
    return typical(level, np.ones(COLUMNS), MIDDLE)
