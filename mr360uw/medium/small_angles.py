# SPDX-License-Identifier: Apache-2.0
"""Spread of sunlight that the water has turned by small angles, at a plane across the beam.

Small-angle scattering theory (Wells 1969, 1973): light turned by theta at a distance t before the plane arrives
theta t beside its ray. With tau the optical depth of small-angle scattering over the path p, p_s the phase function of
small angles (integral 1) and x a spatial frequency times p, the pattern of the beam is passed on with the factor

    M(x) = exp(-tau (1 - P(x)))        P(x) = int_0^1 du 2 pi int p_s J0(2 pi theta u x) theta dtheta

M(0) = 1: no light is lost, as all of it counts as the beam. M falls to exp(-tau), the part that has not turned at all
and stays sharp. The rest, (M - exp(-tau))/(1 - exp(-tau)), is a sum of Gaussians of non-negative weight.
"""

from __future__ import annotations

import numpy as np

from mr360uw.cache import shared
from mr360uw.constants import PI
from mr360uw.medium.medium import Medium
from mr360uw.medium.phase import Phase, forward_peak
from mr360uw.reading.disk_cache import kept_arrays
from mr360uw.sphere import gauss_legendre
from mr360uw.types import Array, BeamSpread

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
