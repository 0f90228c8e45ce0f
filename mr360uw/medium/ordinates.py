# SPDX-License-Identifier: Apache-2.0
"""Discrete ordinates of plane-parallel light: its modes at the nodes of a quadrature, without boundaries.

See `transfer` for the equations; P and Q are those of its text.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mr360uw.constants import PI
from mr360uw.medium.phase import legendre_polynomials
from mr360uw.sphere import gauss_legendre
from mr360uw.types import Array

_PANELS = 0.5, 0.75
"""Least and greatest split of two panels, indices of 1.15 to 1.51: half of all nodes in a narrow panel leave too few
for the other, and light in water of an index of 1.01 was off by as much as there is."""


@functools.cache
def nodes(streams: int, split: float) -> tuple[Array, Array]:
    """Gauss-Legendre nodes and weights on (0, 1), in two panels that meet at `split`, or in one (`_PANELS`)."""
    edges = [0.0, split, 1.0] if _PANELS[0] < split < _PANELS[1] else [0.0, 1.0]
    x, w = gauss_legendre(streams // (len(edges) - 1))
    half = 0.5 * np.diff(edges)[:, None]
    middle = 0.5 * (np.array(edges[1:]) + np.array(edges[:-1]))[:, None]
    return (middle + half * x).ravel(), (half * w).ravel()


def _diagonal(values: Array) -> Array:
    """Return diagonal matrices (n, i, i) of values (n, i)."""
    return np.asarray(np.eye(values.shape[1]) * values[:, None])


def _positive(matrices: Array) -> bool:
    """Return whether symmetric matrices (n, i, i) are all positive definite."""
    try:
        np.linalg.cholesky(matrices)
    except np.linalg.LinAlgError:
        return False
    return True


@dataclass(frozen=True, slots=True, eq=False)
class Modes:
    """Light that changes as exp(-rate (y - origin_m)) with the depth y.

    rate: (n, j) [1/m]. origin_m: (j,). down, up: (n, i, j) radiance at the nodes, at that depth.
    """

    rate: Array
    origin_m: Array
    down: Array
    up: Array

    def mirrored(self, depth_m: float) -> Modes:
        """Return the same light turned upside down, which fades upwards from a depth."""
        return Modes(-self.rate, np.full(self.origin_m.shape, depth_m), self.up, self.down)

    def times(self, amount: Array) -> Modes:
        """Return the modes in amounts (n, j)."""
        return Modes(self.rate, self.origin_m, self.down * amount[:, None], self.up * amount[:, None])

    def beside(self, other: Modes) -> Modes:
        """Return these modes and others."""
        pairs = ((self.rate, other.rate, 1), (self.down, other.down, 2), (self.up, other.up, 2))
        rate, down, up = (np.concatenate([a, b], axis=axis) for a, b, axis in pairs)
        return Modes(rate, np.append(self.origin_m, other.origin_m), down, up)

    def at(self, depth_m: float) -> tuple[Array, Array]:
        """Return the radiance at the nodes, down and up, each (n, i, j), at a depth."""
        left = np.exp(-self.rate * (depth_m - self.origin_m))[:, None]
        return self.down * left, self.up * left


class Ordinates:
    """Coupling of n wavelengths' light at nodes mu (i,) with weights (i,).

    extinction: (n,) [1/m]. moments: (n, l) Legendre moments of the scattering times 2 l + 1 [1/m]. order: m of light
    that varies as cos(m azimuth).
    """

    def __init__(self, mu: Array, weight: Array, extinction: Array, moments: Array, order: int = 0) -> None:
        self._mu, self._weight, self._extinction, self._moments = mu, weight, extinction, moments
        self._scale = np.sqrt(weight / mu)
        self._spread = 0.5 / np.sqrt(mu * weight)
        self._order = order
        self.legendre = legendre_polynomials(mu, moments.shape[1], order)
        self.parity = (-1.0) ** (np.arange(moments.shape[1]) + order)
        self._p, self._q = self._coupling(self.parity < 0), self._coupling(self.parity > 0)

    def _coupling(self, kept: NDArray[np.bool_]) -> Array:
        """Return what streams lose less what they get from each other, (n, i, i); symmetric, positive definite."""
        scattered = np.einsum("il,nl,jl->nij", self.legendre, self._moments * kept, self.legendre)
        scattered = self._scale[:, None] * scattered * self._scale
        lost = self._extinction[:, None] / self._mu
        albedo = self._moments[:, :1] / self._extinction[:, None]
        # Where the nodes integrate high degrees badly, a pattern of light gains more than the albedo allows
        if not _positive(_diagonal(lost * (0.5 + 0.5 * albedo)) - scattered):
            size = np.sqrt(lost[:, :, None] * lost[:, None, :])
            gain, pattern = np.linalg.eigh(scattered / size)
            kept_gain = np.clip(gain, -albedo, albedo)[:, None]
            scattered = size * ((pattern * kept_gain) @ np.swapaxes(pattern, 1, 2))
        return _diagonal(lost) - scattered

    def moments(self, modes: Modes) -> Array:
        """Return the moments (n, l, j) of modes: their light over all directions, by degrees of Legendre functions."""
        of_degree = self._weight[:, None] * self.legendre
        down, up = (np.einsum("il,nij->nlj", of_degree, light) for light in (modes.down, modes.up))
        return np.asarray(down + self.parity[:, None] * up)

    def free(self) -> Modes:
        """Return the modes of water without sources, as many as nodes, that fade downwards."""
        lower = np.linalg.cholesky(self._q)
        squared, z = np.linalg.eigh(np.swapaxes(lower, 1, 2) @ self._p @ lower)
        rate = np.sqrt(np.maximum(squared, 0.0))
        total = np.linalg.solve(np.swapaxes(lower, 1, 2), z)
        net = lower @ z / rate[:, None, :]
        spread = self._spread[:, None]
        return Modes(rate, np.zeros(len(self._mu)), spread * (total + net), spread * (total - net))

    def driven(self, sun_mu: float, beam: Array) -> Modes:
        """Return the one mode that a beam drives. beam: (n,) its irradiance, across it, just below the surface."""
        at_sun = legendre_polynomials(np.array(sun_mu), self._moments.shape[1], self._order)
        across = (beam / (PI if self._order else 2.0 * PI))[:, None, None]  # cosines have half the square of 1
        source = across * self._scale[:, None] * self.legendre * (self._moments * at_sun)[:, None]
        even, odd = (source[..., kept].sum(-1) for kept in (self.parity > 0, self.parity < 0))
        rate = self._extinction / sun_mu * (1.0 + 1e-9)  # beside a rate of the water's own
        size = len(self._mu)
        eye = np.eye(size) * rate[:, None, None]
        system = np.block([[-eye, self._p], [self._q, -eye]])
        both = np.linalg.solve(system, np.concatenate([odd, even], axis=1)[..., None])
        total, net = both[:, :size], both[:, size:]
        spread = self._spread[:, None]
        return Modes(rate[:, None], np.zeros(1), spread * (total + net), spread * (total - net))
