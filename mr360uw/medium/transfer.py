# SPDX-License-Identifier: Apache-2.0
"""The light field of deep, homogeneous water under a flat surface, by discrete ordinates.

Plane-parallel radiative transfer, azimuthal mean, per unit downwelling irradiance just below the surface. For the
radiance at the nodes mu_i of a quadrature on (0, 1), downwelling I+ and upwelling I-, the sum and the difference obey

    (I+ + I-)' = -P (I+ - I-)        (I+ - I-)' = -Q (I+ + I-)

with symmetric, positive P and Q after scaling by sqrt(mu w); their eigenvectors are the modes exp(-k y) of the field
(Stamnes et al. 1988, Applied Optics 27, 2502; symmetric form after Nakajima & Tanaka 1986, J. Quant. Spectrosc. Radiat.
Transfer 35, 13). Deep water holds the decaying half; the surface fixes their amounts. The forward peak of the phase
function is taken as unscattered (delta-M, Wiscombe 1977, J. Atmos. Sci. 34, 1408). Between the nodes the radiance is
the integral of the modes' own source function, so every quantity is a sum of exponentials and every path integral the
stable closed form of `closed_form.path_integral`. A beam of the sun is one more mode, of rate c'/mu_sun.
"""

from __future__ import annotations

import functools
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.constants import LONGEST_RAY_M, PI, REFRACTIVE_INDEX_SEA
from mr360uw.errors import ParameterError
from mr360uw.medium.closed_form import check_ray, path_integral, ray_in_water
from mr360uw.medium.phase import Phase, phase_moments

Array = NDArray[np.float64]

SurfaceKind = Literal["snell", "none"]

STREAMS_PER_HEMISPHERE = 24


def fresnel_reflectance(mu: ArrayLike, index: float) -> Array:
    """Return the reflectance (0 to 1) of a flat surface for unpolarised light from below, mu = cosine in the water."""
    c1 = np.asarray(mu, np.float64)
    sine2 = index * index * (1.0 - c1 * c1)
    c2 = np.sqrt(np.maximum(1.0 - sine2, 0.0))
    rs = (index * c1 - c2) / np.maximum(index * c1 + c2, 1e-300)
    rp = (c1 - index * c2) / np.maximum(c1 + index * c2, 1e-300)
    return np.where(sine2 < 1.0, 0.5 * (rs * rs + rp * rp), 1.0)


@functools.cache
def _nodes(streams: int, split: float) -> tuple[Array, Array]:
    """Gauss-Legendre nodes and weights on (0, 1), in two panels that meet at `split` where that lies inside."""
    edges = [0.0, split, 1.0] if 0.0 < split < 1.0 else [0.0, 1.0]
    x, w = np.polynomial.legendre.leggauss(streams // (len(edges) - 1))
    half = 0.5 * np.diff(edges)[:, None]
    middle = 0.5 * (np.array(edges[1:]) + np.array(edges[:-1]))[:, None]
    return (middle + half * x).ravel(), (half * w).ravel()


Sky = Literal["uniform"] | tuple[Literal["sun"], float, float]
"""What shines on the surface: a uniform sky, or ("sun", y of the direction to the sun in the water, share of its beam in
the downwelling irradiance that passes the surface), the rest being uniform sky."""

MOMENTS = 2 * STREAMS_PER_HEMISPHERE + 1


class LightField:
    """The light in deep water of n sets of coefficients, solved once; see the module's docstring.

    absorption (> 0), scattering: (n,) or scalar [1/m]. phase: one for all, see `phase.Phase`, or Legendre moments (m,)
    or (n, m). surface: "snell", flat with Fresnel's reflection, or "none", no change of refractive index. sky: see
    `Sky`. All results are per unit downwelling irradiance just below the surface. Raises `ParameterError`.
    """

    def __init__(
        self,
        absorption: ArrayLike,
        scattering: ArrayLike,
        phase: Phase | Array = "petzold",
        surface: SurfaceKind = "snell",
        sky: Sky = "uniform",
        refractive_index: float = REFRACTIVE_INDEX_SEA,
        streams: int = STREAMS_PER_HEMISPHERE,
    ) -> None:
        self.absorption, self.scattering = (
            np.array(x, np.float64)
            for x in np.broadcast_arrays(np.atleast_1d(np.asarray(absorption)), np.atleast_1d(np.asarray(scattering)))
        )
        if not np.all(self.absorption > 0.0) or not np.all(self.scattering >= 0.0):
            raise ParameterError(
                f"light field - absorption must be above and scattering at least zero "
                f"(got {np.min(self.absorption):g} and {np.min(self.scattering):g} 1/m) - correct the coefficients"
            )
        if surface not in ("snell", "none"):
            raise ParameterError(f"surface - unknown (got {surface!r}) - take 'snell' or 'none'")
        self.refractive_index = refractive_index if surface == "snell" else 1.0
        moments = _moments(phase, len(self.absorption), 2 * streams + 1)
        peak = moments[:, -1]
        self._chi = (moments[:, :-1] - peak[:, None]) / (1.0 - peak[:, None])
        self._b = self.scattering * (1.0 - peak)
        self.extinction: Array = self.absorption + self._b
        """(n,) [1/m] extinction without the forward peak."""
        self._mu, self._weight = _nodes(streams, _critical_cosine(self.refractive_index))
        self._solve(*_sky_parts(sky))

    def _solve(self, sun_mu: float, sun_share: float) -> None:
        mu, w, c, b = self._mu, self._weight, self.extinction, self._b
        order = np.arange(self._chi.shape[1])
        legendre = np.polynomial.legendre.legvander(mu, len(order) - 1)
        parity = (-1.0) ** order
        weighted = (2 * order + 1) * self._chi * b[:, None]
        scale = np.sqrt(w / mu)

        def coupling(kept: Array) -> Array:
            scattered = np.einsum("il,nl,jl->nij", legendre, weighted * kept, legendre)
            return np.eye(len(mu)) * c[:, None, None] / mu - scale[:, None] * scattered * scale

        p, q = coupling(parity < 0), coupling(parity > 0)
        lower = np.linalg.cholesky(q)
        squared, z = np.linalg.eigh(np.swapaxes(lower, 1, 2) @ p @ lower)
        rate = np.sqrt(np.maximum(squared, 0.0))
        total = np.linalg.solve(np.swapaxes(lower, 1, 2), z)
        net = lower @ z / rate[:, None, :]
        spread = 0.5 / np.sqrt(mu * w)[:, None]
        down, up = spread * (total + net), spread * (total - net)

        reflectance = fresnel_reflectance(mu, self.refractive_index)[:, None]
        transmitted = (1.0 - reflectance[:, 0]) / (2.0 * PI * np.sum(w * mu * (1.0 - reflectance[:, 0])))
        boundary = np.broadcast_to((1.0 - sun_share) * transmitted, (len(c), len(mu)))
        beam = sun_share / sun_mu
        if beam > 0.0:
            at_sun = np.polynomial.legendre.legvander(np.array(sun_mu), len(order) - 1)
            source = beam / (4.0 * PI) * np.einsum("nl,l,il->nil", weighted, at_sun, legendre)
            even, odd = source[..., parity > 0].sum(-1), source[..., parity < 0].sum(-1)
            sun_rate = c / sun_mu * (1.0 + 1e-9)
            particular = _particular(p, q, sun_rate, 2.0 * scale * odd, 2.0 * scale * even)
            sun_down = spread[:, 0] * (particular[0] + particular[1])
            sun_up = spread[:, 0] * (particular[0] - particular[1])
            boundary = boundary - sun_down + reflectance[:, 0] * sun_up
        amount = np.linalg.solve(down - reflectance * up, boundary[..., None])
        down, up = down * np.swapaxes(amount, 1, 2), up * np.swapaxes(amount, 1, 2)
        if beam > 0.0:
            rate = np.concatenate([rate, sun_rate[:, None]], axis=1)
            down = np.concatenate([down, sun_down[..., None]], axis=2)
            up = np.concatenate([up, sun_up[..., None]], axis=2)

        incident = 2.0 * PI * np.einsum("i,nij->n", w * mu, down) + sun_share
        norm = 1.0 / incident[:, None, None]
        self._rate = rate
        self._down, self._up = down * norm, up * norm
        self._beam, self._sun_mu = beam / incident, sun_mu
        self._sky = (1.0 - sun_share) / (2.0 * PI * np.sum(w * mu * (1.0 - reflectance[:, 0]))) / incident
        moments = np.einsum("i,il,nij->nlj", w, legendre, self._down)
        moments += parity[:, None] * np.einsum("i,il,nij->nlj", w, legendre, self._up)
        if beam > 0.0:
            moments[..., -1] += self._beam[:, None] * at_sun / (2.0 * PI)
        self._source = 0.5 * weighted[..., None] * moments

    # --- results -----------------------------------------------------------------------------------------------

    @property
    def decay(self) -> Array:
        """The attenuation (n,) [1/m] that every quantity approaches with depth (K infinity)."""
        return self._rate.min(axis=1)

    def inscatter(
        self, distance_m: ArrayLike, depth_m: ArrayLike, up: ArrayLike, extinction: ArrayLike | None = None
    ) -> Array:
        """Return the radiance (..., n) scattered into camera rays, cut at the surface.

        extinction: (n,) [1/m] of the ray, c unless given. With a smaller one, light that was scattered by small angles
        belongs to what lies behind, not to the in-scatter: radiance(camera) = inscatter + exp(-extinction S)
        radiance(end) for any value.
        """
        check_ray(distance_m, depth_m, up)
        s, y, mu = np.broadcast_arrays(
            ray_in_water(distance_m, depth_m, up), np.asarray(depth_m, np.float64), np.asarray(up, np.float64)
        )
        outer = self.absorption + self.scattering if extinction is None else np.asarray(extinction, np.float64)
        own = self._along(s, y, mu)
        s = s[..., None]
        gap = outer - self.extinction
        # exp(-c' S) - exp(-c S), either being the smaller
        peak = np.sign(gap) * np.exp(-np.minimum(self.extinction, outer) * s) * -np.expm1(-np.abs(gap) * s)
        return own + peak * self.radiance(np.maximum(y - s[..., 0] * mu, 0.0), mu)

    def radiance(self, depth_m: ArrayLike, up: ArrayLike) -> Array:
        """Return the radiance (..., n) that arrives at a depth from directions with the y component `up`.

        The sun's own beam is not in it.
        """
        check_ray(0.0, depth_m, up)
        y, mu = np.broadcast_arrays(np.asarray(depth_m, np.float64), np.asarray(up, np.float64))
        s = ray_in_water(np.inf, y, mu)
        from_surface = np.exp(-self.extinction * s[..., None]) * self._boundary(np.maximum(mu, 0.0))
        return self._along(s, y, mu) + np.where((mu > 0.0)[..., None], from_surface, 0.0)

    def irradiance(self, depth_m: ArrayLike, normal_up: ArrayLike) -> Array:
        """Return the irradiance (..., n) of a surface whose normal has the y component `normal_up`, sun included.

        1: downwelling E_d, -1: upwelling E_u, 0: a vertical plane, averaged over its azimuth.
        """
        check_ray(0.0, depth_m, normal_up)
        y, normal = np.broadcast_arrays(np.asarray(depth_m, np.float64), np.asarray(normal_up, np.float64))
        down = cosine_kernel(self._mu, normal[..., None]) * self._weight
        up = cosine_kernel(-self._mu, normal[..., None]) * self._weight
        modes = np.einsum("...i,nij->...nj", down, self._down) + np.einsum("...i,nij->...nj", up, self._up)
        diffuse = np.sum(modes * np.exp(-self._rate * y[..., None, None]), axis=-1)
        direct = cosine_kernel(np.array(self._sun_mu), normal)[..., None] / (2.0 * PI)
        return diffuse + self._beam * direct * np.exp(-self.extinction / self._sun_mu * y[..., None])

    def scalar_irradiance(self, depth_m: ArrayLike) -> Array:
        """Return the irradiance (..., n) of a small sphere, E_0, sun included."""
        y = np.asarray(depth_m, np.float64)[..., None]
        modes = 2.0 * PI * np.einsum("i,nij->nj", self._weight, self._down + self._up)
        direct = self._beam * np.exp(-self.extinction / self._sun_mu * y)
        return np.sum(modes * np.exp(-self._rate * y[..., None]), axis=-1) + direct

    # --- pieces ------------------------------------------------------------------------------------------------

    def _source_modes(self, mu: Array) -> Array:
        """The source (..., n, j) [1/(m sr)] of every mode in directions mu, at the surface."""
        legendre = np.polynomial.legendre.legvander(mu, self._source.shape[1] - 1)
        return np.tensordot(legendre, self._source, axes=(-1, 1))

    def _along(self, s: Array, y: Array, mu: Array) -> Array:
        """The source integrated over rays (...,) with the solver's extinction, (..., n)."""
        if mu.ndim == 2 and np.all(mu == mu[:, :1]):
            source = self._source_modes(mu[:, :1])
        else:
            source = self._source_modes(mu)
        length = path_integral(
            self.extinction[:, None], self._rate, s[..., None, None], y[..., None, None], mu[..., None, None]
        )
        return np.sum(source * length, axis=-1)

    def _boundary(self, mu: Array) -> Array:
        """The radiance (..., n) just below the surface travelling down, mu >= 0."""
        reflectance = fresnel_reflectance(mu, self.refractive_index)[..., None]
        upwelling = np.sum(
            self._source_modes(-mu) / (self.extinction[:, None] + self._rate * mu[..., None, None]), axis=-1
        )
        return self._sky * (1.0 - reflectance) + reflectance * upwelling


def cosine_kernel(mu: ArrayLike, normal_up: ArrayLike) -> Array:
    """Return the integral over azimuth of max(0, cos) between directions at height mu and a normal at `normal_up`."""
    mu, n = np.asarray(mu, np.float64), np.clip(np.asarray(normal_up, np.float64), -1.0, 1.0)
    along = np.asarray(mu * n)
    across = np.sqrt(np.maximum(1.0 - mu * mu, 0.0)) * np.sqrt(1.0 - n * n)
    ratio = np.divide(-along, across, out=np.array(-np.sign(along)), where=across > np.abs(along))
    half = np.arccos(np.clip(ratio, -1.0, 1.0))
    return 2.0 * (along * half + across * np.sin(half))


def _critical_cosine(index: float) -> float:
    return float(np.sqrt(1.0 - 1.0 / index**2)) if index > 1.0 else 0.0


def _sky_parts(sky: Sky) -> tuple[float, float]:
    if sky == "uniform":
        return 1.0, 0.0
    if isinstance(sky, tuple) and len(sky) == 3 and sky[0] == "sun" and 0.0 < sky[1] <= 1.0 and 0.0 <= sky[2] <= 1.0:
        return float(sky[1]), float(sky[2])
    raise ParameterError(
        f"sky - unknown (got {sky!r}) - take 'uniform' or ('sun', up in the water in (0, 1], share in [0, 1])"
    )


def _moments(phase: Phase | Array, count: int, orders: int) -> Array:
    if isinstance(phase, np.ndarray):
        moments = np.broadcast_to(phase, (count, phase.shape[-1]))
        if moments.shape[1] < orders or not np.allclose(moments[:, 0], 1.0):
            raise ParameterError(f"phase - needs {orders} Legendre moments from 1 on (got {phase.shape}) - give more")
        return np.array(moments[:, :orders], np.float64)
    return np.broadcast_to(phase_moments(phase, orders), (count, orders))


def _particular(p: Array, q: Array, rate: Array, odd: Array, even: Array) -> tuple[Array, Array]:
    """Sum and difference (n, i) of the scaled radiance that a source exp(-rate y) holds up."""
    size = p.shape[1]
    eye = np.eye(size) * rate[:, None, None]
    system = np.concatenate([np.concatenate([-eye, p], axis=2), np.concatenate([q, -eye], axis=2)], axis=1)
    solution = np.linalg.solve(system, np.concatenate([odd, even], axis=1)[..., None])[..., 0]
    return solution[:, :size], solution[:, size:]
