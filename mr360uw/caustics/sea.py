# SPDX-License-Identifier: Apache-2.0
"""Base of the sea models: parameters, ripples, surfaces at points and on a tile's grid; statistics of wind waves.

A particle at rest at (x, 0, z) moves to P = (x + shift_x, height, z + shift_z). With the strains s_ab = d shift_a/d b
and slopes h_a = d height/d a, all at the *undisplaced* (x, z), the tangents are

    T_x = (1 + s_xx, h_x, s_xz)      T_z = (s_xz, h_z, 1 + s_zz)

N = T_z x T_x normalised and J = (1 + s_xx)(1 + s_zz) - s_xz^2, both exact (Finch 2004 drops terms of the normal;
its form holds for one wave only).

Fine ripples are two scrolling slope maps that are added to the slopes of the sea. One procedural, tileable slope map is
read twice, the second time with its axes swapped, and scrolled in two directions beside the wind. Slopes are added
rather than normals, so that the sum is the slope of a surface. The number of repeats in a tile and the scroll in a loop
are whole numbers, so tile and loop close exactly.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import model_validator

from mr360uw.base.cache import shared
from mr360uw.base.constants import GRAVITY_M_S2, SURFACE_TENSION_OVER_DENSITY
from mr360uw.base.parameters import FULL_TURN_DEG, Parameters, advanced, common_shape, number, parameter
from mr360uw.base.texels import between_four, texels_around
from mr360uw.types import Array, Floats, Surface

_POINTS_AT_ONCE = 1 << 13
"""Points evaluated together: with a hundred waves their phases take 13 MB."""
_RIPPLE_M, _RIPPLE_M_S = 0.12, 0.25
"""Dominant length [m] of ripples and the speed [m/s] that they scroll at."""
_SLOPE_GRID = 128
"""Points across the tile that the mean square slope is taken of."""


WAVES_STAY = "waves would jump: the wind is what changes a sea, key sea.wind_speed"
"""Advice on parameters that decide on the waves' lengths, directions or periods."""


class SurfaceFields(NamedTuple):
    """The eight fields of a displaced surface, each (...,): metres, or metres per metre."""

    height: Floats
    shift_x: Floats
    shift_z: Floats
    slope_x: Floats
    slope_z: Floats
    strain_xx: Floats
    strain_zz: Floats
    strain_xz: Floats


def _surface_normal(f: SurfaceFields, detail: ArrayLike = 0.0) -> Floats:
    """Return unit normals (..., 3). detail: (..., 2) slopes of a detail map, added to those of the surface."""
    d = np.asarray(detail, np.float64)
    detail_x, detail_z = (d, d) if d.ndim == 0 else (d[..., 0], d[..., 1])
    across_x, across_z = 1.0 + f.strain_xx, 1.0 + f.strain_zz
    y = surface_jacobian(f)
    x = f.slope_z * f.strain_xz - across_z * f.slope_x - detail_x * y
    z = f.slope_x * f.strain_xz - across_x * f.slope_z - detail_z * y
    return _vectors(x, y, z) / np.maximum(np.sqrt(x * x + y * y + z * z), 1e-30)[..., None]


def _vectors(x: Floats, y: Floats, z: Floats) -> Floats:
    """Return vectors (..., 3) of their components."""
    out = np.empty((*np.broadcast_shapes(np.shape(x), np.shape(y), np.shape(z)), 3))
    out[..., 0], out[..., 1], out[..., 2] = x, y, z
    return out


def surface_jacobian(f: SurfaceFields) -> Floats:
    """Return the determinant of the horizontal displacement; positive where the surface does not fold over."""
    return (1.0 + f.strain_xx) * (1.0 + f.strain_zz) - f.strain_xz * f.strain_xz


class SeaParameters(Parameters):
    """Parameters of every sea. Directions are azimuths as seen from above: 0 = forward (-z), 90 = right (+x)."""

    model: Literal["gerstner", "spectral"] = parameter("gerstner", "kind of sea")
    wind_speed: float = parameter(4.0, "wind speed 10 m above the sea", unit="m/s", low=0.0, high=40.0)
    wind_direction_deg: float = parameter(30.0, "azimuth the wind blows towards", unit="deg", low=-360.0, high=360.0)
    waves_of_wind_speed: float | None = parameter(
        None, "wind whose longest waves the sea keeps room for, as keys of wind_speed set it; none: wind_speed",
        unit="m/s", low=0.0, high=40.0, fixed=WAVES_STAY, internal="keys of sea.wind_speed",
    )  # fmt: skip
    waves_of_wind_deg: tuple[float, float] | None = parameter(
        None, "azimuths between which the wind turns, as keys of wind_direction_deg set them; none: it does not",
        unit="deg", fixed=WAVES_STAY, internal="keys of sea.wind_direction_deg",
    )  # fmt: skip
    tile_m: float = parameter(
        8.0, "side of the square after which the sea repeats", unit="m", low=0.05, high=2000.0, fixed=WAVES_STAY
    )
    water_depth_m: float = parameter(
        1000.0, "depth of the bottom, for dispersion", unit="m", above=0.0, high=11000.0, fixed=WAVES_STAY
    )
    loop_s: float | None = advanced(
        None, "time after which the sea repeats exactly; none: never", unit="s", above=0.0, high=3600.0,
        fixed=WAVES_STAY,
    )  # fmt: skip
    shortest_wavelength_m: float | None = advanced(
        None, "shortest wave; none: a fortieth of the tile", unit="m", above=0.0, high=2000.0, fixed=WAVES_STAY
    )
    detail_slope: float | None = advanced(
        None, "root mean square slope of all other waves; none: what the sea's own leave of Cox & Munk's for the wind",
        low=0.0, high=0.5,
    )  # fmt: skip
    detail_kind: Literal["blur", "ripples"] = advanced(
        "blur", "blur: those waves blur caustics; ripples: two scrolling maps on the surface, for fine grids"
    )
    seed: int = parameter(1, "seed of the waves' directions and phases", low=0)

    @model_validator(mode="after")
    def _arc_ascends(self) -> Self:
        arc = self.waves_of_wind_deg
        if arc is not None and not 0.0 <= arc[1] - arc[0] <= FULL_TURN_DEG:
            raise ValueError(f"waves_of_wind_deg - must ascend, by a turn at the most (got {list(arc)}) - sort them")
        return self

    @property
    def wind_travel(self) -> Array:
        """Horizontal direction (2,) over (x, z) the wind blows towards."""
        return _travel(self.wind_direction_deg)

    @property
    def ripples_travel(self) -> Array:
        """Horizontal direction (2,) that ripples scroll in: the wind's, or the middle of those that it turns through.

        Ripples are where their speed has carried them since time 0: turned with the wind, they would jump.
        """
        arc = self.waves_of_wind_deg
        return self.wind_travel if arc is None else _travel(0.5 * (arc[0] + arc[1]))

    @property
    def own_mean_square_slope(self) -> float:
        """Mean square slope, both axes, of the surface that the sea's own waves make at time 0."""
        return _mean_square_slope_of(self)

    @property
    def detail_rms_slope(self) -> float:
        """Root mean square slope, both axes, of all other waves: `detail_slope`, or what the wind gives.

        With the sea's own waves they have the mean square slope of Cox & Munk 1954; 0 where those exceed it.
        """
        if self.detail_slope is not None:
            return self.detail_slope
        return math.sqrt(max(mean_square_slope(self.wind_speed) - self.own_mean_square_slope, 0.0))

    @property
    def blur_slope(self) -> float:
        """Root mean square slope, both axes, of the waves whose only effect is to blur caustics."""
        return self.detail_rms_slope if self.detail_kind == "blur" else 0.0

    def detail(self, time_s: float) -> Detail | None:
        """Return the two scrolling slope maps at one time, or None where the sea has none."""
        if self.detail_kind == "blur" or self.detail_rms_slope == 0.0:
            return None
        return make_detail(
            self.tile_m, self.detail_rms_slope, _RIPPLE_M, _RIPPLE_M_S * self.ripples_travel,
            self.loop_s, self.seed, time_s,
        )  # fmt: skip

    def fields_at(self, x_m: Array, z_m: Array, time_s: float) -> SurfaceFields:
        """Return the fields at points (n,) [m]."""
        raise NotImplementedError

    def grid_fields(self, size: int, time_s: float) -> SurfaceFields:
        """Return the fields (size, size) at x = column tile/size, z = row tile/size."""
        raise NotImplementedError

    def surface(self, x_m: ArrayLike, z_m: ArrayLike, time_s: float) -> Surface:
        """Return the displaced surface of particles that rest at places in the world.

        Waves also shift particles sideways, so a returned position is not straight above the place that was asked for.
        The result depends on place and time alone.

        Parameters
        ----------
        x_m, z_m : array_like
            World x and z [m] of the particles at rest, of any one shape.
        time_s : float
            Time [s].

        Returns
        -------
        Surface
            Positions (..., 3), unit normals (..., 3) and the determinant (...,) of the horizontal displacement.

        Raises
        ------
        ParameterError
            If times or places are not finite.

        See Also
        --------
        uw.caustics.caustic_map : The light that the surface focuses.
        uw.surface.picture : The surface as a camera sees it.
        uw.plot.show : Draws the heights.

        Examples
        --------
        >>> sea = uw.caustics.GerstnerSea(wind_speed=0.0)
        >>> sea.surface(1.0, 2.0, time_s=0.0).normal
        array([0., 1., 0.])
        """
        number("time_s", time_s)
        common_shape(x_m=x_m, z_m=z_m)
        x, z = np.broadcast_arrays(np.asarray(x_m, np.float64), np.asarray(z_m, np.float64))
        flat_x, flat_z = x.ravel(), z.ravel()
        parts = [
            self.fields_at(flat_x[i : i + _POINTS_AT_ONCE], flat_z[i : i + _POINTS_AT_ONCE], time_s)
            for i in range(0, max(x.size, 1), _POINTS_AT_ONCE)
        ]
        fields = SurfaceFields(*(np.concatenate(field).reshape(x.shape) for field in zip(*parts, strict=True)))
        return self._displaced(x, z, fields, time_s)

    def grid_surface(self, size: int, time_s: float) -> Surface:
        """Return `surface` at x = column tile/size, z = row tile/size, (size, size), by the quickest exact way."""
        number("time_s", time_s)
        at = np.arange(size) * (self.tile_m / size)
        x, z = np.broadcast_arrays(at, at[:, None])
        return self._displaced(x, z, self.grid_fields(size, time_s), time_s)

    def _displaced(self, x_m: Array, z_m: Array, fields: SurfaceFields, time_s: float) -> Surface:
        """Return the surface with its ripples over undisplaced points (x, z) [m]."""
        position = _vectors(x_m + fields.shift_x, fields.height, z_m + fields.shift_z)
        detail = self.detail(time_s)
        ripples = 0.0 if detail is None else detail_slope(detail, x_m, z_m)
        return Surface(position, _surface_normal(fields, ripples), surface_jacobian(fields))


def _travel(azimuth_deg: float) -> Array:
    azimuth = math.radians(azimuth_deg)
    return np.array([math.sin(azimuth), -math.cos(azimuth)])


@shared(keep=32)
def _mean_square_slope_of(sea: SeaParameters) -> float:
    f = sea.grid_fields(_SLOPE_GRID, 0.0)
    slope = _surface_normal(f)
    area = np.maximum(surface_jacobian(f), 0.0)
    return float(np.average((1.0 - slope[..., 1] ** 2) / slope[..., 1] ** 2, weights=area))


_DETAIL_SIZE = 64
"""Texels across the map: ten for each dominant wavelength."""
_WAVES_ACROSS = 6
"""Dominant wavelengths in one repeat of the map."""
_SECOND_REPEAT = 1.3
"""Repeats of the second map over those of the first: not a simple ratio, so that no common period shows in the tile."""
_SCROLL_TURN_RAD = 0.6
"""Angle [rad] between the wind and each map's scroll, one to either side."""


@dataclass(frozen=True, slots=True)
class Detail:
    """The two maps at one time.

    slopes: (DETAIL_SIZE, DETAIL_SIZE, 2) periodic slopes over (x, z). repeats: (2,) in a tile. offset: (2, 2) scroll of
    each map over (x, z), in repeats.
    """

    slopes: Array
    repeats: Array
    offset: Array
    tile_m: float


@shared(keep=8)
def _slope_map(rms: float, seed: int) -> Array:
    """Return slopes of random waves about `_WAVES_ACROSS` in a repeat, each map carrying half of the variance."""
    n = _DETAIL_SIZE
    m = np.fft.fftfreq(n, 1.0 / n)
    mx, mz = np.meshgrid(m, m)
    k = np.hypot(mx, mz)
    spectrum = np.where(k > 0.0, np.exp(-0.5 * ((k - _WAVES_ACROSS) / (0.35 * _WAVES_ACROSS)) ** 2), 0.0)
    phase = np.random.default_rng([seed, 0xDE7A]).uniform(0.0, 2.0 * np.pi, (n, n))
    height = spectrum * np.exp(1j * phase) / np.maximum(k, 1.0)
    slopes = np.stack([np.fft.ifft2(1j * mx * height).real, np.fft.ifft2(1j * mz * height).real], axis=-1)
    return slopes * (rms / np.sqrt(2.0 * np.mean(np.sum(slopes**2, axis=-1))))


def make_detail(
    tile_m: float,
    rms_slope: float,
    wavelength_m: float,
    velocity: Array,
    loop_s: float | None,
    seed: int,
    time_s: float,
) -> Detail:
    """Return the detail maps at one time. velocity: (2,) m/s over (x, z) of their mean scroll."""
    first = max(round(tile_m / (_WAVES_ACROSS * wavelength_m)), 1)
    repeats = np.array([first, max(round(first * _SECOND_REPEAT), first + 1)], np.float64)
    offset = np.zeros((2, 2))
    for i, turn in enumerate((_SCROLL_TURN_RAD, -_SCROLL_TURN_RAD)):
        c, s = np.cos(turn), np.sin(turn)
        rate = np.array([c * velocity[0] - s * velocity[1], s * velocity[0] + c * velocity[1]]) * repeats[i] / tile_m
        if loop_s is not None:
            rate = np.round(rate * loop_s) / loop_s
        offset[i] = -rate * time_s
    return Detail(_slope_map(rms_slope, seed), repeats, offset - np.floor(offset), tile_m)


def periodic_slope(slopes: Array, u: Array, v: Array) -> Array:
    """Return the periodic bilinear sample (..., 2) at (u, v) in repeats, texel i centred at i/DETAIL_SIZE."""
    n = slopes.shape[0]
    i, j, fx, fy = texels_around(u * n, v * n)
    i0, j0, i1, j1 = i % n, j % n, (i + 1) % n, (j + 1) % n
    value: Array = between_four(slopes[j0, i0], slopes[j0, i1], slopes[j1, i0], slopes[j1, i1], fx, fy)
    return value


def detail_slope(detail: Detail, x_m: Array, z_m: Array) -> Array:
    """Return the sum of both maps' slopes (..., 2) at world (x, z) [m]."""
    u, v = x_m / detail.tile_m, z_m / detail.tile_m
    (a, b), o = detail.repeats, detail.offset
    first = periodic_slope(detail.slopes, a * u + o[0, 0], a * v + o[0, 1])
    second = periodic_slope(detail.slopes, b * v + o[1, 1], b * u + o[1, 0])
    return first + second[..., ::-1]


# Water waves: their dispersion, statistics of a wind sea, and the parts of its spectra.
#
# Dispersion of capillary-gravity waves over a flat bottom: Lamb 1932 section 267. Waves on the lattice 2 pi (m, n)/tile
# repeat at the tile's edges; frequencies that are multiples of 2 pi/loop repeat after the loop. No blending is needed.

_PEAK_FREQUENCY = 0.855
"""Peak angular frequency of a fully developed sea times wind speed over gravity (Pierson & Moskowitz 1964)."""
_SLOPE_CALM, _SLOPE_PER_WIND = 0.003, 0.00512
"""Mean square slope of a clean sea, and its growth per m/s of wind (Cox & Munk 1954)."""
_SHORTEST_RIPPLE = 370.0
"""Wavenumber [rad/m] of the slowest waves (17 mm long), about where the slope spectrum falls off.

Twice as large, a band of longer waves gets about a tenth less of the slope variance.
"""


def peak_wavelength(wind_speed: float) -> float:
    """Return the dominant wavelength [m] of a fully developed deep sea at a wind speed [m/s]."""
    frequency = _PEAK_FREQUENCY * GRAVITY_M_S2 / max(wind_speed, 0.1)
    return 2.0 * math.pi * GRAVITY_M_S2 / frequency**2


def mean_square_slope(wind_speed: float) -> float:
    """Return the mean square slope of the sea, both axes (Cox & Munk 1954 from 1 m/s up, falling to flat at 0)."""
    return (_SLOPE_CALM + _SLOPE_PER_WIND * wind_speed) * min(wind_speed, 1.0)


def band_slope_variance(wind_speed: float, from_wavenumber: float, to_wavenumber: float) -> float:
    """Return the slope variance in a band of wavenumbers [rad/m].

    `mean_square_slope` is spread evenly over log k from the peak of the spectrum up.
    """
    peak = 2.0 * math.pi / peak_wavelength(wind_speed)
    whole = math.log(max(_SHORTEST_RIPPLE / min(peak, from_wavenumber), math.e))
    return mean_square_slope(wind_speed) * min(math.log(max(to_wavenumber / from_wavenumber, math.e)) / whole, 1.0)


def angular_frequency(wavenumber: ArrayLike, water_depth_m: float) -> Array:
    """Return the angular frequency [rad/s] of waves of a wavenumber [rad/m] on water of a depth (infinity: deep)."""
    k = np.asarray(wavenumber, np.float64)
    shallow = np.tanh(np.minimum(k * water_depth_m, 50.0)) if np.isfinite(water_depth_m) else 1.0
    return np.sqrt((GRAVITY_M_S2 * k + SURFACE_TENSION_OVER_DENSITY * k**3) * shallow)


def group_speed(wavenumber: ArrayLike, water_depth_m: float) -> Array:
    """Return d omega/d k [m/s], the derivative of `angular_frequency`."""
    k = np.asarray(wavenumber, np.float64)
    restoring = GRAVITY_M_S2 * k + SURFACE_TENSION_OVER_DENSITY * k**3
    slope = GRAVITY_M_S2 + 3.0 * SURFACE_TENSION_OVER_DENSITY * k**2
    if not np.isfinite(water_depth_m):
        return slope / (2.0 * np.sqrt(restoring))
    kh = np.minimum(k * water_depth_m, 50.0)
    tanh = np.tanh(kh)
    return (slope * tanh + restoring * water_depth_m / np.cosh(kh) ** 2) / (2.0 * np.sqrt(restoring * tanh))


def looping_frequency(frequency: ArrayLike, loop_s: float | None) -> Array:
    """Return angular frequencies moved to the nearest multiple of 2 pi/loop_s, at least one; None leaves them."""
    w = np.asarray(frequency, np.float64)
    if loop_s is None:
        return w
    base = 2.0 * np.pi / loop_s
    return base * np.maximum(np.round(w / base), 1.0)


def lattice_vector(wave_vector: ArrayLike, tile_m: float) -> Array:
    """Return wave vectors (n, 2) [rad/m] moved to the nearest non-zero point of the lattice 2 pi (m, n)/tile_m."""
    unit = 2.0 * np.pi / tile_m
    k = np.asarray(wave_vector, np.float64) / unit
    nearest = np.round(k)
    along_x = np.abs(k[..., 0]) >= np.abs(k[..., 1])
    smallest = np.where(along_x[..., None], [1.0, 0.0], [0.0, 1.0]) * np.where(k < 0.0, -1.0, 1.0)
    return unit * np.where(np.any(nearest != 0.0, axis=-1, keepdims=True), nearest, smallest)


_PEAK_ENHANCEMENT = 3.3
"""Mean sharpness gamma of the peaks of the JONSWAP measurements; 1: a fully developed sea, as Pierson & Moskowitz's."""
_GROWING_PEAK, _GROWING_ALPHA = 22.0, 0.076
"""Peak frequency and constant alpha of a growing sea (Hasselmann et al. 1973): u w_p/g = 22 x^(-1/3), alpha = 0.076
x^(-0.22) at a fetch x = g F/u^2."""
PHILLIPS_ALPHA = 8.1e-3
"""Phillips' constant alpha of the equilibrium range of a fully developed sea."""
_SHARPNESS_ENERGY = 0.287
"""A peak of sharpness gamma has 1/(1 - 0.287 ln gamma) of the energy of one of gamma 1 (DNV-RP-C205, 3.5.5)."""
_FULL_FETCH = (_GROWING_PEAK / _PEAK_FREQUENCY) ** 3
"""Fetch g F/u^2 at which the peak has come to that of a fully developed sea: 28 km at 4 m/s."""
_FULL_ENERGY_FETCH = (
    PHILLIPS_ALPHA * (1.0 - _SHARPNESS_ENERGY * math.log(_PEAK_ENHANCEMENT)) / _GROWING_ALPHA
    * (_GROWING_PEAK / _PEAK_FREQUENCY) ** 4
) ** (1.0 / (4.0 / 3.0 - 0.22))  # fmt: skip
"""Fetch at which a growing sea has the energy of a fully developed one: 18 km at 4 m/s."""


def peak_frequency(wind_speed: float, fetch_m: float) -> float:
    """Return the angular frequency [rad/s] of the peak of a wind sea (Hasselmann et al. 1973).

    It falls with the fetch, down to that of a fully developed sea (Pierson & Moskowitz 1964).
    """
    fetch = min(GRAVITY_M_S2 * fetch_m / wind_speed**2, _FULL_FETCH)
    return _GROWING_PEAK * GRAVITY_M_S2 / wind_speed * fetch ** (-1.0 / 3.0)


def jonswap(frequency: Array, wind_speed: float, fetch_m: float) -> Array:
    """Return S(omega) [m^2 s] of a wind sea that grows with the fetch until it is fully developed.

    Up to the fetch where a growing sea (Hasselmann et al. 1973) has the energy of a fully developed one, it is that
    sea. From there on the energy stays; the peak moves on to Pierson & Moskowitz's and loses its sharpness, and then
    the spectrum is theirs. It changes continuously with wind and fetch.
    """
    fetch = min(GRAVITY_M_S2 * fetch_m / wind_speed**2, _FULL_FETCH)
    growing = math.log(_FULL_FETCH / max(fetch, _FULL_ENERGY_FETCH)) / math.log(_FULL_FETCH / _FULL_ENERGY_FETCH)
    sharpness = _PEAK_ENHANCEMENT**growing
    peak, developed = peak_frequency(wind_speed, fetch_m), _PEAK_FREQUENCY * GRAVITY_M_S2 / wind_speed
    of_full_energy = PHILLIPS_ALPHA * (peak / developed) ** 4 * (1.0 - _SHARPNESS_ENERGY * math.log(sharpness))
    alpha = min(_GROWING_ALPHA * fetch**-0.22, of_full_energy)
    width = np.where(frequency <= peak, 0.07, 0.09)
    r = np.exp(-((frequency - peak) ** 2) / (2.0 * width**2 * peak**2))
    tail = np.exp(-1.25 * np.minimum((peak / frequency) ** 4, 500.0))
    return alpha * GRAVITY_M_S2**2 * frequency**-5.0 * tail * sharpness**r


def tma_factor(frequency: Array, water_depth_m: float) -> Array:
    """Return the factor of shallow water, 1 where it is deep (Thompson & Vincent 1983)."""
    w = frequency * np.sqrt(water_depth_m / GRAVITY_M_S2)
    return np.where(w <= 1.0, 0.5 * w * w, np.where(w < 2.0, 1.0 - 0.5 * (2.0 - np.minimum(w, 2.0)) ** 2, 1.0))


def cosine_power_share(exponent: float) -> float:
    """Return the factor on cos^p of the angle to the wind whose integral over the half turn about it is 1."""
    return math.exp(math.lgamma(0.5 * exponent + 1.0) - math.lgamma(0.5 * exponent + 0.5)) / math.sqrt(math.pi)


def cosine_spread(angle: Array, frequency: Array, wind_speed: float, fetch_m: float) -> Array:
    """Return the directional distribution [1/rad], integral 1: cos^2s(angle/2) (Hasselmann et al. 1980)."""
    from scipy.special import gammaln

    ratio = frequency / peak_frequency(wind_speed, fetch_m)
    # the branches meet at 1.046 peak frequencies: parted at the peak itself, a wave would jump as the wind grows
    s = np.minimum(9.77 * ratio**-2.5, 6.97 * ratio**5.0)
    log_normal = gammaln(s + 1.0) - gammaln(s + 0.5) - np.log(2.0 * np.sqrt(np.pi))
    half = np.maximum(np.abs(np.cos(0.5 * angle)), 1e-30)
    return np.exp(log_normal + 2.0 * s * np.log(half))
