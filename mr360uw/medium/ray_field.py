# SPDX-License-Identifier: Apache-2.0
"""Radiance along rays through water whose light is a sum of exponentials of depth, down to a floor if there is one.

The exponentials are the modes of plane-parallel light at the nodes of a quadrature (discrete ordinates). In each mode
the light that scatters into a direction mu falls off as exp(-k y), so the path integral of every mode is the closed
form of `closed_form.path_integral`. mu: y of the view direction, +1 straight up. What bounds the water and lights it
stands here too: its surface, the sky above, the floor below. See `transfer` for the equations; P and Q are those of its
text.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.base.cache import shared
from mr360uw.base.constants import PI
from mr360uw.base.optics import fresnel_from_below
from mr360uw.base.parameters import checked
from mr360uw.base.sphere import gauss_legendre
from mr360uw.errors import ParameterError
from mr360uw.jit import exact, fast_making
from mr360uw.medium.closed_form import check_ray, ray_in_water, together
from mr360uw.medium.phase import Scatterers, legendre_polynomials
from mr360uw.types import Array

SurfaceKind = Literal["snell", "none"]
"""A flat surface with Fresnel's reflection, or none: no change of refractive index."""


@dataclass(frozen=True, slots=True)
class SkyShape:
    """A sky without a sun, the same on all sides. radiance: relative, at sines of elevation above the surface that are
    evenly spaced from 0 to 1; one number is a uniform sky.
    """

    radiance: tuple[float, ...] = (1.0,)

    def __post_init__(self) -> None:
        if not self.radiance or min(self.radiance) < 0.0 or not 0.0 < max(self.radiance) < np.inf:
            raise ParameterError(f"sky - needs light, none of it negative (got {self.radiance!r:.60}) - correct it")

    def seen_through(self, up: NDArray[np.float64], refractive_index: float) -> NDArray[np.float64]:
        """Return the relative radiance (...,) that is seen from below a flat surface in directions of a y."""
        sine = np.sqrt(np.maximum(1.0 - refractive_index**2 * (1.0 - up * up), 0.0))
        return np.interp(sine, np.linspace(0.0, 1.0, len(self.radiance)), self.radiance)


Sky = Literal["uniform", "floor"] | tuple[Literal["sun"], float, float] | SkyShape
"""Light that comes in: a uniform sky, or ("sun", y of the direction to the sun in the water, fraction of the
downwelling irradiance below the surface that is its beam), the rest being uniform sky; or "floor", no light from above
and a floor that shines with a radiance of 1 in all directions, which the results are then per unit of; or a sky of a
shape."""


@checked
@dataclass(frozen=True, slots=True)
class LambertFloor:
    """A level Lambert floor. depth_m: below the surface. albedo: in [0, 1], of n wavelengths, or one for all."""

    depth_m: float
    albedo: tuple[float, ...]

    def __post_init__(self) -> None:
        if self.depth_m <= 0.0:
            raise ParameterError(f"floor - must lie below the surface (got {self.depth_m!r} m) - give a depth above 0")
        if not self.albedo or not all(0.0 <= a <= 1.0 for a in self.albedo):
            raise ParameterError(f"floor - albedo must lie in [0, 1] (got {self.albedo!r:.60}) - correct it")


def index_below(surface: SurfaceKind, refractive_index: float) -> float:
    """Return the refractive index that a surface bounds, 1 for "none"; raise `ParameterError`."""
    if not 1.0 <= refractive_index <= 4.0:
        raise ParameterError(f"refractive_index - must lie in [1, 4] (got {refractive_index}) - sea water has 1.34")
    return refractive_index if surface == "snell" else 1.0


def floor_at(floor: LambertFloor | None, count: int) -> tuple[float, Array]:
    """Return the depth [m] of a floor, infinite without one, and its albedo (n,) at so many wavelengths."""
    if floor is None:
        return np.inf, np.zeros(count)
    if len(floor.albedo) not in (1, count):
        raise ParameterError(
            f"floor - needs one albedo, or one for each of {count} wavelengths (got {len(floor.albedo)}) - give as many"
        )
    return floor.depth_m, np.broadcast_to(np.array(floor.albedo), (count,))


def sky_parts(sky: Sky) -> tuple[float, float]:
    """Return the y of the direction to the sun in the water, and the fraction of the light that is its beam."""
    if sky in ("uniform", "floor") or isinstance(sky, SkyShape):
        return 1.0, 0.0
    if isinstance(sky, tuple) and len(sky) == 3 and sky[0] == "sun" and 0.0 < sky[1] <= 1.0 and 0.0 <= sky[2] <= 1.0:
        return float(sky[1]), float(sky[2])
    raise ParameterError(
        f"sky - unknown (got {sky!r}) - take 'uniform', 'floor', a SkyShape or ('sun', up in the water in (0, 1], "
        "share in [0, 1])"
    )


def scattered_beam(scatterers: Scatterers, sun_mu: float, mu: Array, azimuth_rad: float | Array | None) -> Array:
    """Return the light [1/(m sr)] (..., n) that a beam of the sun scatters directly into rays, with its exact angle.

    scatterers: with what each kind scatters of the beam [1/m]. sun_mu, mu: y of the directions to the sun and of the
    rays, at an azimuth from the sun's, or several (a,): (..., a, n); None: the mean over it. By less than
    `_LEAST_TURN_RAD` nothing turns.
    """
    kinds, amount = scatterers
    across = np.sqrt(np.maximum(1.0 - mu * mu, 0.0) * max(1.0 - sun_mu**2, 0.0))

    def turned(azimuth: ArrayLike) -> Array:
        cosine = np.multiply.outer(across, np.cos(azimuth)) + (mu * sun_mu).reshape(*mu.shape, *[1] * np.ndim(azimuth))
        return kinds(np.clip(cosine, -1.0, np.cos(_LEAST_TURN_RAD)))

    if azimuth_rad is not None:
        return np.asarray(turned(azimuth_rad) @ amount)
    x, weight = gauss_legendre(_AZIMUTHS)
    x, weight = 0.5 * (x + 1.0), 0.5 * weight
    # nodes are dense about the sun
    return np.asarray(np.einsum("a,...ak->...k", 2.0 * x * weight, turned(PI * x**2)) @ amount)


_LEAST_TURN_RAD = 0.01
"""Least angle that light of the sun's beam turns by: what turns by less counts as turning by so much."""
_AZIMUTHS = 128
"""Directions about the sun that a mean is taken over."""


@dataclass(frozen=True, slots=True, eq=False)
class RayField:
    """Light of n wavelengths in j modes, and its scattering into rays.

    extinction: (n,) [1/m] of the rays. rate: (n, j) [1/m]. origin_m: (j,) depth at which modes have their amounts.
    source: [1/(m sr)] the light scattered into a ray, there: of orders m of cos(m azimuth), whose modes follow one
    another, the coefficients (n, l, j of it) of the associated Legendre functions of mu. sky: (n,) radiance of the sky
    as it would be just below the surface without reflection, over its shape. index: refractive index of the water.
    floor_m, floor: depth and radiance (n,) of a Lambert floor; infinity: none.
    of_beam: function of mu and azimuth_rad, the light that the sun's beam, the last mode of all, scatters directly into
    rays (`scattered_beam`); None: no beam.
    azimuth_rad: of the rays, from the sun's; None: the mean over it. Of several (a,) there is no source but the beam,
    and n stands for the wavelengths of one after those of the other.
    """

    extinction: Array
    rate: Array
    origin_m: Array
    source: Mapping[int, Array]
    sky: Array
    shape: SkyShape
    index: float
    floor_m: float
    floor: Array
    of_beam: Callable[[Array, float | Array | None], Array] | None = None
    azimuth_rad: float | Array | None = None

    def inscatter(self, distance_m: ArrayLike, depth_m: ArrayLike, up: ArrayLike) -> Array:
        """Return the radiance (..., n) scattered into camera rays (...,), cut at the surface.

        radiance(camera) = inscatter + exp(-extinction S) radiance(end) holds exactly as far as the floor. Beyond it the
        water goes on and scatters what it does at the floor, which keeps tables smooth.
        """
        check_ray(distance_m, depth_m, up)
        s, y, mu = together(ray_in_water(distance_m, depth_m, up), depth_m, up)
        result = self._within(s, y, mu)
        deeper = np.maximum(s - self.to_floor(y, mu), 0.0)
        below = deeper > 0.0
        if np.any(below):
            lost = self.extinction * deeper[below][:, None]
            left = np.exp(-self.extinction * (s - deeper)[below][:, None])
            result[below] += left * -np.expm1(-lost) / self.extinction * self.scattered(self.floor_m, mu[below])
        return result

    def _within(self, s: Array, y: Array, mu: Array) -> Array:
        """Return the radiance (..., n) scattered into rays between surface and floor."""

        s = np.minimum(s, self.to_floor(y, mu))
        # tables ask for few directions and many distances, of which those beyond surface and floor are one
        asked = np.stack([mu.ravel(), np.minimum(y, self.floor_m).ravel(), s.ravel()])
        rays, place = np.unique(asked, axis=1, return_inverse=True)
        mu, y, distance = np.ascontiguousarray(rays)
        directions, which = np.unique(mu, return_inverse=True)
        source = _source_of(self, directions.tobytes())
        result = sum_modes(source, self.rate, self.origin_m, self.extinction, directions, which, y, distance)
        return result[place.ravel()].reshape(*s.shape, len(self.extinction))

    def radiance(self, depth_m: ArrayLike, up: ArrayLike) -> Array:
        """Return the radiance (..., n) that arrives at a depth from the directions `up`, without the sun's beam."""
        check_ray(0.0, depth_m, up)
        y, mu = together(depth_m, up)
        s = np.minimum(ray_in_water(np.inf, y, mu), self.to_floor(y, mu))
        result = self._within(s, y, mu) + np.exp(-self.extinction * s[..., None]) * self.floor
        rising = mu > 0.0
        if np.any(rising):
            left = np.exp(-self.extinction * s[rising][:, None])
            result[rising] += left * (self.below_surface(mu[rising]) - self.floor)
        return result

    def scattered(self, depth_m: ArrayLike, up: ArrayLike) -> Array:
        """Return the radiance [1/m] (..., n) that the water at a depth scatters into rays."""
        y, mu = together(depth_m, up)
        rays, place = np.unique(np.stack([mu.ravel(), y.ravel()]), axis=1, return_inverse=True)
        modes = np.exp(-self.rate * (np.minimum(rays[1], self.floor_m)[:, None, None] - self.origin_m))
        result = np.sum(_source_of(self, rays[0].tobytes()) * modes, axis=-1)
        return np.asarray(result[place.ravel()].reshape(*mu.shape, -1))

    def below_surface(self, up: ArrayLike) -> Array:
        """Return the radiance (..., n) just below the surface that travels down, up >= 0: sky, and reflected light."""
        mu = np.asarray(up, np.float64)
        directions, place = np.unique(mu, return_inverse=True)
        light = at_surface(directions, self.sky, self.shape, self.index, self.radiance(0.0, -directions))
        return light[place].reshape(*mu.shape, len(self.sky))

    def to_floor(self, y: Array, mu: Array) -> Array:
        """Return the length (...,) [m] of rays down to the floor, infinite for others."""
        return length_to(self.floor_m, y, mu)


@shared(keep=2)
def _source_of(rays: RayField, directions: bytes) -> Array:
    """Return the source (r, n, j) of every mode in directions mu (r,), where it has its amount."""
    mu, azimuth = np.frombuffer(directions), 0.0 if rays.azimuth_rad is None else rays.azimuth_rad
    modes, end = np.zeros((len(mu), *rays.rate.shape)), 0
    for order, source in rays.source.items():
        legendre = legendre_polynomials(mu, source.shape[1], order)
        start, end = end, end + source.shape[2]
        modes[..., start:end] = np.cos(order * azimuth) * np.tensordot(legendre, source, axes=(-1, 1))
    if rays.of_beam is not None:
        modes[..., -1] += rays.of_beam(mu, rays.azimuth_rad).reshape(len(mu), -1)
    return modes


def at_surface(mu: Array, sky: Array, shape: SkyShape, index: float, rising: Array) -> Array:
    """Return the radiance (r, n) just below the surface that travels down from directions mu (r,): sky, and light that
    rises there (r, n), reflected. sky: (n,) as `RayField` has it.
    """
    reflectance = fresnel_from_below(mu, index)[:, None]
    return np.asarray(sky * shape.seen_through(mu, index)[:, None] * (1.0 - reflectance) + reflectance * rising)


def length_to(depth_m: float, y: Array, mu: Array) -> Array:
    """Return the length (...,) [m] of rays from depths y down to a depth, infinite for rays that do not go down."""
    above = np.maximum(depth_m - y, 0.0)
    return np.divide(above, -mu, out=np.full(np.broadcast_shapes(y.shape, mu.shape), np.inf), where=mu < 0.0)


def cosine_kernel(mu: ArrayLike, normal_up: ArrayLike) -> Array:
    """Return the integral over azimuth of max(0, cos) between directions at height mu and a normal at `normal_up`."""
    mu, n = np.asarray(mu, np.float64), np.clip(np.asarray(normal_up, np.float64), -1.0, 1.0)
    along = np.asarray(mu * n)
    across = np.sqrt(np.maximum(1.0 - mu * mu, 0.0)) * np.sqrt(1.0 - n * n)
    ratio = np.divide(-along, across, out=np.array(-np.sign(along)), where=across > np.abs(along))
    half = np.arccos(np.clip(ratio, -1.0, 1.0))
    return 2.0 * (along * half + across * np.sin(half))


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

    rate: (n, j) [1/m]. origin_m: (j,). down, up: (n, i, j) radiance at the nodes, at that depth. moments: (n, l, j)
    associated Legendre moments of every mode, where they are known.
    """

    rate: Array
    origin_m: Array
    down: Array
    up: Array
    moments: Array = field(default_factory=lambda: np.zeros((0, 0, 0)))

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


def bounded(
    free: Sequence[Modes], driven: Sequence[Modes], bottom_m: Sequence[float], reflectance: Array, entering: Array,
    sent: Array, lit: Array,
) -> list[Modes]:  # fmt: skip
    """Return the modes of each layer in the amounts that its bounds give them, that of the sun last.

    free, driven: modes of each layer without sources, and the one that the sun drives. bottom_m: of each layer [m], of
    the last one the floor, infinite without. reflectance: (i,) of the surface from below. entering: radiance (i,) or
    (n, i) that passes it. sent: (n, i) what the floor sends up of the light at each node. lit: (n,) radiance of the
    floor by what is no mode.
    """

    def at_surface(modes: Modes) -> Array:
        down, up = modes.at(0.0)
        return np.asarray(down - reflectance[:, None] * up)

    def at_floor(modes: Modes) -> Array:
        down, up = modes.at(bottom_m[-1])
        return np.asarray(up - np.einsum("ni,nij->nj", sent, down)[:, None])

    # Layer by layer, downwards, as amount - change @ (amounts of the next layer): light that comes down into a layer is
    # that of the one above it, light that comes up into it that of the one below
    found: list[tuple[Array, Array]] = []
    for number, (modes, sun, end) in enumerate(zip(free, driven, bottom_m, strict=True)):
        after = np.zeros((len(lit), 0, 0))
        if number == 0:
            rows, known = [at_surface(modes)], [entering - at_surface(sun)[..., 0]]
        else:
            top, (change, amount) = bottom_m[number - 1], found[-1]
            above, steady = free[number - 1].at(top)[0], driven[number - 1].at(top)[0] - sun.at(top)[0]
            rows = [modes.at(top)[0] + above @ change]
            known = [(above @ amount[..., None] + steady)[..., 0]]
        if number < len(free) - 1:
            after = -free[number + 1].at(end)[1]
            rows.append(modes.at(end)[1])
            known.append((driven[number + 1].at(end)[1] - sun.at(end)[1])[..., 0])
            after = np.concatenate([np.zeros_like(after), after], axis=1)
        elif np.isfinite(end):
            rows.append(at_floor(modes))
            known.append(lit[:, None] - at_floor(sun)[..., 0])
        right = np.concatenate(known, axis=1)[..., None]
        right = right if after.size == 0 else np.concatenate([after, right], axis=2)
        both = np.linalg.solve(np.concatenate(rows, axis=1), right)
        found.append((np.asarray(both[..., :-1]), np.asarray(both[..., -1])))
    # From the last layer up, the amounts
    amounts = [found[-1][1]]
    for change, amount in reversed(found[:-1]):
        amounts.insert(0, amount - (change @ amounts[0][..., None])[..., 0])
    return [m.times(part).beside(sun) for m, part, sun in zip(free, amounts, driven, strict=True)]


class Ordinates:
    """Coupling of n wavelengths' light at nodes mu (i,) with weights (i,).

    extinction: (n,) [1/m]. moments: (n, l) Legendre moments of the scattering times 2 l + 1 [1/m]. order: m of light
    that varies as cos(m azimuth).
    """

    def __init__(self, mu: Array, weight: Array, extinction: Array, moments: Array, order: int = 0) -> None:
        self._mu, self._weight, self._extinction, self._moments = mu, weight, extinction, moments
        self._scale = np.sqrt(weight / mu)
        self._spread = 0.5 / np.sqrt(mu * weight)
        self.order = order
        self.legendre = legendre_polynomials(mu, moments.shape[1], order)
        self.parity = (-1.0) ** (np.arange(moments.shape[1]) + order)
        self._p, self._q = self._coupling(self.parity < 0), self._coupling(self.parity > 0)

    def _coupling(self, kept: NDArray[np.bool_]) -> Array:
        """Return what streams lose less what they get from each other, (n, i, i); symmetric, positive definite."""
        legendre = self.legendre[:, kept]
        scattered = (legendre * self._moments[:, None, kept]) @ legendre.T
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
        of_degree = (self._weight[:, None] * self.legendre).T
        return np.asarray(of_degree @ modes.down + self.parity[:, None] * (of_degree @ modes.up))

    @functools.cached_property
    def free(self) -> Modes:
        """The modes of water without sources, as many as nodes, that fade downwards."""
        lower = np.linalg.cholesky(self._q)
        squared, z = np.linalg.eigh(np.swapaxes(lower, 1, 2) @ self._p @ lower)
        rate = np.sqrt(np.maximum(squared, 0.0))
        total = np.linalg.solve(np.swapaxes(lower, 1, 2), z)
        net = lower @ z / rate[:, None, :]
        spread = self._spread[:, None]
        return Modes(rate, np.zeros(len(self._mu)), spread * (total + net), spread * (total - net))

    def driven(self, sun_mu: float, beam: Array) -> Modes:
        """Return the one mode that a beam drives. beam: (n,) its irradiance, across it, just below the surface."""
        at_sun = legendre_polynomials(np.array(sun_mu), self._moments.shape[1], self.order)
        across = (beam / (PI if self.order else 2.0 * PI))[:, None, None]  # cosines have half the square of 1
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


# Sums of modes along rays: most of the time that the tables of a new water take.

_LEAST = 0.02
"""Exponent from which on 1 - exp(-x) keeps 14 digits; below, seven terms of its series have 16."""


_LOG2_E = 1.4426950408889634


_LN2_HIGH = 0.693147180369123816490
"""ln(2) but for `_LN2_LOW`, with so few digits that its products with whole numbers are exact."""


_LN2_LOW = 1.90821492927058770002e-10


_ROUNDS = 1.5 * 2.0**52
"""A number so large that a whole number added to it stands in its last bits."""


@exact
def _mean(x: float) -> float:
    """Return the mean of exp(-x t) for t from 0 to 1: (1 - exp(-x))/x for a small x."""
    return 1.0 - x / 2.0 * (1.0 - x / 3.0 * (1.0 - x / 4.0 * (1.0 - x / 5.0 * (1.0 - x / 6.0 * (1.0 - x / 7.0)))))


@exact
def _exp(x: float) -> float:
    """Return exp(x) to the last digit or two, for x below 700; 1e-304 from -700 down.

    2^k exp(r) with r below ln(2)/2, without a branch or a call, so that it runs for several modes at a time.
    """
    x = max(x, -700.0)
    k = np.floor(x * _LOG2_E + 0.5)
    r = (x - k * _LN2_HIGH) - k * _LN2_LOW
    high = 1.0 / 40320.0 + r * (1.0 / 362880.0 + r * (1.0 / 3628800.0 + r * (1.0 / 39916800.0 + r / 479001600.0)))
    low = 1.0 / 24.0 + r * (1.0 / 120.0 + r * (1.0 / 720.0 + r * (1.0 / 5040.0 + r * high)))
    power: Any = np.int64((np.float64(k + _ROUNDS).view(np.int64) + np.int64(1023)) << np.int64(52))
    return (1.0 + r * (1.0 + r * (1.0 / 2.0 + r * (1.0 / 6.0 + r * low)))) * power.view(np.float64)


@fast_making
def sum_modes(
    source: Any, rate: Any, origin_m: Any, extinction: Any, mu: Any, which: Any, depth_m: Any, distance_m: Any
) -> Any:
    """Return the sum (r, n) over the modes of `source` (d, n, j) times `closed_form.path_integral`.

    rate: (n, j), origin_m: (j,), extinction: (n,), mu: (d,). which: (r,) direction of each ray. depth_m, distance_m:
    (r,) of its start, and from there to its end. Depth and distance are in one exponential: by themselves, one may
    underflow where the other overflows. Rays of one depth that follow one another are the fastest.
    """
    begun, power = np.empty(rate.shape), np.empty(rate.shape)
    result = np.empty((len(distance_m), len(extinction)))
    for r in range(len(distance_m)):
        s, d = distance_m[r], which[r]
        if r == 0 or depth_m[r] != depth_m[r - 1]:
            for n in range(rate.shape[0]):
                for j in range(rate.shape[1]):
                    power[n, j] = -rate[n, j] * (depth_m[r] - origin_m[j])
                    begun[n, j] = _exp(power[n, j])
        for n in range(len(extinction)):
            total = 0.0
            for j in range(len(origin_m)):
                lost = (extinction[n] - rate[n, j] * mu[d]) * s
                small = abs(lost) < _LEAST
                change = (begun[n, j] - _exp(power[n, j] - lost)) / (1.0 if small else lost)
                total += source[d, n, j] * (begun[n, j] * _mean(lost) if small else change)
            result[r, n] = total * s
    return result
