# SPDX-License-Identifier: Apache-2.0
"""A sea of Gerstner waves (trochoids) with exact normals and Jacobian.

    symbol   field              unit     meaning
    k        wave_vector        rad/m    over (x, z)
    A        amplitude_m        m
    Q        steepness          1        horizontal over vertical amplitude; 1 = circular orbits
    theta    k.(x, z) - omega t + phase

    height = sum A sin theta        shift = sum Q A k/|k| cos theta

The surface cannot fold over while sum Q |k| A <= 1 (Finch 2004; Thompson et al. 2019 eq. 1 without its slips). Wave
vectors lie on the tile's lattice and frequencies on the loop's, so both close exactly.

Random waves of a wind have lengths even in log k and directions about the wind. Every octave has the same slope
variance, as in the equilibrium range of a wind sea (Phillips 1958). The sum is the part of the mean square slope of Cox
& Munk 1954 that lies in the band.

Where the wind changes over a clip, waves must not: a wave whose length or direction followed the wind would jump, the
further from the origin the more. Lengths and directions are then drawn once for all winds of the clip. At each time
every wave has the variance of the present wind at its place in the spectrum: it grows and fades where it is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import field_validator, model_validator

from mr360uw.base.cache import shared
from mr360uw.base.parameters import Parameters, advanced, exactly, listed, numbers, parameter
from mr360uw.base.texels import smoothstep
from mr360uw.caustics.sea import (
    WAVES_STAY,
    SeaParameters,
    SurfaceFields,
    angular_frequency,
    band_slope_variance,
    lattice_vector,
    looping_frequency,
    peak_wavelength,
)
from mr360uw.errors import ParameterError
from mr360uw.types import Array

Complex = NDArray[np.complex128]

_MOST_TURN = 3.0
"""Most that the wind may turn, over the waves' spread: at the ends 37 % of the waves carry the sea then. Twice as far,
18 %."""
_LEAST_WAVES = 6
"""Waves that stay in the weakest wind: the surface would show the shape of two or three alone."""
_FADING_OCTAVES = 1.0
"""Octaves of wavelength over which waves fade that are longer than the wind makes. The peak's wavelength goes with the
square of the wind: a wave grows while the wind does by 40 %. With half as much it grows twice as fast."""
_LAPS = 3
"""Turns to either side that a wave's direction is counted at: enough for the widest spread, 180 degrees."""
_FOLDING = 1.0 + 1e-9
"""Greatest sum Q |k| A that counts as not folding over: 1, and rounding."""


class GerstnerWave(Parameters):
    """One explicit wave."""

    wave_vector: tuple[float, float] = parameter(..., "wave vector over (x, z)", unit="rad/m", fixed=WAVES_STAY)
    amplitude_m: float = parameter(..., "amplitude", unit="m", low=0.0, high=1000.0)
    steepness: float = parameter(1.0, "horizontal over vertical amplitude", low=0.0, high=1.0)
    phase_rad: float = parameter(0.0, "phase at the origin at time 0", unit="rad")

    @field_validator("wave_vector")
    @classmethod
    def _has_a_direction(cls, vector: tuple[float, float]) -> tuple[float, float]:
        if not any(vector):
            raise ValueError(f"must have a length (got {list(vector)}) - a wave goes somewhere; leave this one out")
        return vector


@dataclass(frozen=True, slots=True)
class Waves:
    """The waves of a sea: wave_vector (n, 2) [rad/m], angular_frequency (n,) [rad/s], the others (n,)."""

    wave_vector: Array
    amplitude_m: Array
    steepness: Array
    phase_rad: Array
    angular_frequency: Array

    @property
    def folding(self) -> float:
        """The sum of Q |k| A: the surface cannot fold over up to 1."""
        return float(np.sum(self.steepness * np.linalg.norm(self.wave_vector, axis=1) * self.amplitude_m))

    def coefficients(self, time_s: float) -> Complex:
        """Return (n, 8) complex amplitudes c of the fields of `SurfaceFields`: field = Re sum c exp(i k.(x, z))."""
        k = self.wave_vector
        length = np.linalg.norm(k, axis=1)
        dx, dz = (k / np.maximum(length, 1e-30)[:, None]).T
        amplitude = self.amplitude_m
        sideways = self.steepness * amplitude
        strain = 1j * sideways * length
        turn = np.exp(1j * np.remainder(self.phase_rad - self.angular_frequency * time_s, 2.0 * np.pi))
        columns = [-1j * amplitude, sideways * dx, sideways * dz, amplitude * k[:, 0], amplitude * k[:, 1],
                   strain * dx * dx, strain * dz * dz, strain * dx * dz]  # fmt: skip
        return np.stack(columns, axis=1) * turn[:, None]


def gerstner(waves: Waves, x_m: Array, z_m: Array, time_s: float) -> SurfaceFields:
    """Return the fields at points (n,) [m], summed wave by wave."""
    wave = np.exp(1j * (x_m[:, None] * waves.wave_vector[:, 0] + z_m[:, None] * waves.wave_vector[:, 1]))
    return SurfaceFields(*(wave @ waves.coefficients(time_s)).real.T)


@listed
class GerstnerSea(SeaParameters):
    """A sea of Gerstner waves, random ones that follow the wind or explicit ones.

    The default sea of scenes: a few dozen waves, which never fold over. A `SpectralSea` looks less regular.

    Raises
    ------
    ParameterError
        If a value is out of its range; the message names it.

    See Also
    --------
    uw.caustics.SpectralSea : Random waves of a whole spectrum.
    uw.caustics.GerstnerSea.from_waves : A sea of known waves.
    uw.caustics.caustic_map : The light below a sea.

    Notes
    -----
    A particle at rest at x moves on a circle: height = sum A sin theta, shift = sum Q A k/|k| cos theta, theta = k.x -
    omega t + phase (Tessendorf 2001, section 3.1). The waves' mean square slope is that of Cox & Munk 1954.

    Examples
    --------
    >>> sea = uw.caustics.GerstnerSea(wind_speed=4.0, seed=1)
    >>> sea.surface([0.0, 1.0], [0.0, 0.0], time_s=0.5).position.shape
    (2, 3)
    """

    model: Literal["gerstner"] = parameter("gerstner", "kind of sea")
    steepness: float = parameter(0.8, "sharpness of the crests: 0 = sines, 1 = trochoids", low=0.0, high=1.0)
    spread_deg: float = advanced(
        55.0, "standard deviation of the waves' directions about the wind", unit="deg", low=0.0, high=180.0,
        fixed=WAVES_STAY,
    )  # fmt: skip
    dominant_wavelength_m: float | None = parameter(
        None, "longest wave; none: that of a fully developed sea", unit="m", above=0.0, high=2000.0, fixed=WAVES_STAY
    )
    wave_count: int = parameter(24, "number of waves", low=1, high=512, internal="comparisons")
    explicit_waves: tuple[GerstnerWave, ...] = parameter(
        (), "waves to use instead of random ones", internal="GerstnerSea.from_waves"
    )

    @classmethod
    def from_waves(
        cls,
        wave_vector: ArrayLike,
        amplitude_m: ArrayLike,
        steepness: ArrayLike,
        phase_rad: ArrayLike,
        tile_m: float = 8.0,
        **knobs: object,
    ) -> Self:
        """Return a sea of explicit waves.

        For a sea that is known, as in a wave tank or a test. These waves are all of it: no shorter ones blur its
        caustics unless `detail_slope` is given.

        Parameters
        ----------
        wave_vector : array_like
            Wave vectors (n, 2) [rad/m] over (x, z), moved to the nearest vector that repeats after `tile_m`.
        amplitude_m : array_like
            Amplitudes [m], (n,) or one number.
        steepness : array_like
            Horizontal over vertical amplitude, 0 to 1, (n,) or one number.
        phase_rad : array_like
            Phases [rad] at the origin at time 0, (n,) or one number.
        tile_m : float
            Side [m] of the square after which the sea repeats.
        **knobs : object
            Other parameters of `GerstnerSea`.

        Returns
        -------
        GerstnerSea
            The sea.

        Raises
        ------
        ParameterError
            If a value is out of range, or where sum Q |k| A > 1 and the surface would fold over.

        See Also
        --------
        uw.caustics.GerstnerSea : Random waves that follow the wind.
        uw.caustics.GerstnerSea.surface : Heights and normals.

        Notes
        -----
        At t = 0, theta = k.(x, z) + phase, height = sum A sin theta, shift = sum Q A k/|k| cos theta.

        Examples
        --------
        >>> swell = uw.caustics.GerstnerSea.from_waves([[0.8, 0.0]], 0.1, 0.5, 0.0, tile_m=8.0)
        >>> swell.waves.wave_vector.round(4)
        array([[0.7854, 0.    ]])
        """
        k = np.atleast_2d(numbers("wave_vector", wave_vector).astype(np.float64))
        if k.ndim != 2 or k.shape[1] != 2:
            raise ParameterError(f"wave_vector - must be (n, 2) (got {k.shape}) - give k_x, k_z of each wave")
        given = {"amplitude_m": amplitude_m, "steepness": steepness, "phase_rad": phase_rad}
        rows = [np.broadcast_to(exactly(name, a, (), k.shape[:1]), k.shape[:1]) for name, a in given.items()]
        try:
            waves = tuple(
                GerstnerWave(wave_vector=(kx, kz), amplitude_m=a, steepness=q, phase_rad=p)
                for (kx, kz), a, q, p in zip(k.tolist(), *(r.tolist() for r in rows), strict=True)
            )
            return cls(explicit_waves=waves, tile_m=tile_m, **knobs)
        except ValueError as error:
            reason = "; ".join(str(error).splitlines()[:4])
            raise ParameterError(f"waves - cannot be used (got: {reason}) - see GerstnerWave for the ranges") from error

    @model_validator(mode="after")
    def _does_not_fold(self) -> Self:
        if self.explicit_waves and self.waves.folding > _FOLDING:
            raise ValueError(
                f"the waves fold over (got sum Q k A = {self.waves.folding:.4g}, at most 1) - "
                "lower the steepness or the amplitudes"
            )
        return self

    @model_validator(mode="after")
    def _spreads_as_it_turns(self) -> Self:
        arc = self.waves_of_wind_deg
        if arc is not None and not self.explicit_waves and arc[1] - arc[0] > _MOST_TURN * self.spread_deg:
            raise ValueError(
                f"the wind turns too far for the spread of its waves (got {arc[1] - arc[0]:g} degrees, at most "
                f"{_MOST_TURN:g} times spread_deg) - set sea.spread_deg to {(arc[1] - arc[0]) / _MOST_TURN:.0f}, or "
                'sea.model to "spectral"'
            )
        return self

    @property
    def waves(self) -> Waves:
        """The explicit waves, or those that the parameters make."""
        return _waves_of(self)

    @property
    def detail_rms_slope(self) -> float:
        """As of every sea; explicit waves are the whole sea unless `detail_slope` is given."""
        return 0.0 if self.explicit_waves and self.detail_slope is None else super().detail_rms_slope

    def _random_waves(self) -> tuple[Array, Array, Array]:
        """Return wave vectors (n, 2) [rad/m] that repeat after the tile, amplitudes (n,) [m] and phases (n,) [rad]."""
        # Bound the wavelengths: by the tile, and by the wind that waves were drawn for
        count, spread = self.wave_count, math.radians(self.spread_deg)
        shortest = min(self.shortest_wavelength_m or self.tile_m / 40.0, self.tile_m)

        def longest_at(wind_speed: float) -> float:
            return max(min(self.dominant_wavelength_m or peak_wavelength(wind_speed), self.tile_m), shortest)

        longest = longest_at(self.waves_of_wind_speed or self.wind_speed)
        present = min(longest_at(self.wind_speed), longest)
        # Draw one wave from each even part of the logarithm of length
        random = np.random.default_rng([self.seed, 0x5EA])
        place = (np.arange(count) + random.uniform(0.0, 1.0, count)) / count
        length = 2.0 * np.pi / longest * (longest / shortest) ** place
        angle = spread * random.standard_normal(count)
        phase = random.uniform(0.0, 2.0 * np.pi, count)
        # Weigh waves by the present wind, so that a wind that changes moves none
        weight, wind = share_of_lengths(2.0 * np.pi / length, present), math.radians(self.wind_direction_deg)
        azimuth = wind
        if self.waves_of_wind_deg is not None:
            azimuth, last = (math.radians(one) for one in self.waves_of_wind_deg)
            angle += (last - azimuth) * (random.permutation(count) + random.uniform(0.0, 1.0, count)) / count
            weight *= share_of_directions(angle, wind - azimuth, last - azimuth, spread)
        # Move wave vectors to the tile's lattice; share out the variance of slopes
        wx, wz = math.sin(azimuth), -math.cos(azimuth)
        c, s = np.cos(angle), np.sin(angle)
        k = lattice_vector(length[:, None] * np.stack([c * wx - s * wz, s * wx + c * wz], axis=1), self.tile_m)
        variance = band_slope_variance(self.wind_speed, 2.0 * np.pi / present, 2.0 * np.pi / shortest)
        return k, np.sqrt(2.0 * variance * weight / np.sum(weight)) / np.linalg.norm(k, axis=1), phase

    def fields_at(self, x_m: Array, z_m: Array, time_s: float) -> SurfaceFields:
        """Return the fields at points (n,) [m]."""
        return gerstner(self.waves, x_m, z_m, time_s)

    def grid_fields(self, size: int, time_s: float) -> SurfaceFields:
        """Return the fields (size, size) at x = column tile/size, z = row tile/size.

        On a grid, exp(i k.(x, z)) is a product of a function of x and one of z: two matrices instead of a sum at every
        point.
        """
        columns, along_z = _grid_phases_of(self, size)
        rows = _waves_of(self).coefficients(time_s).T[:, None] * along_z
        fields = np.concatenate([rows.real, rows.imag], axis=-1).reshape(-1, len(columns)) @ columns
        return SurfaceFields(*fields.reshape(-1, size, size))


def share_of_lengths(wavelength: Array, present: float) -> Array:
    """Return the weights (n,) of waves [m] at a wind whose longest waves have the length `present`, at least those of
    the shortest `_LEAST_WAVES`; longer ones fade over an octave.

    The amplitudes, the root of the weights, grow smoothly with the wind.
    """
    kept = max(present, float(np.sort(wavelength)[:_LEAST_WAVES][-1]))
    return np.square(smoothstep(np.log2(wavelength / kept), _FADING_OCTAVES, 0.0))


def share_of_directions(angle: Array, present: float, turn: float, spread: float) -> Array:
    """Return weights (n,) of waves for the present wind: the ratio of two densities of directions.

    angle: of the waves [rad], drawn from normal distributions of standard deviation `spread` about directions even over
    [0, turn]. With the weights they have that distribution about the direction `present` alone (importance sampling).
    All one if spread or turn are 0.
    """
    if spread == 0.0 or turn == 0.0:
        return np.ones(len(angle))
    from scipy.special import ndtr

    laps = angle[:, None] + 2.0 * np.pi * np.arange(-_LAPS, _LAPS + 1)
    now = np.exp(-0.5 * ((laps - present) / spread) ** 2).sum(axis=1)
    drawn = (ndtr(laps / spread) - ndtr((laps - turn) / spread)).sum(axis=1)
    return np.asarray(now / drawn)


@shared(keep=8)
def _grid_phases_of(sea: GerstnerSea, size: int) -> tuple[Array, Complex]:
    """Return exp(i k_x x) of the waves at the grid's columns, as (2 n, size) of real and imaginary parts for a product
    with real and imaginary parts, and exp(i k_z z) at its rows (size, n)."""
    at = np.arange(size)[:, None] * (sea.tile_m / size)
    along_x, along_z = (np.exp(1j * at * sea.waves.wave_vector[:, axis]) for axis in (0, 1))
    return np.ascontiguousarray(np.concatenate([along_x.real, -along_x.imag], axis=1).T), along_z


@shared(keep=32)
def _waves_of(sea: GerstnerSea) -> Waves:
    # kept outside of the frozen model, whose copies would carry it along
    if sea.explicit_waves:
        k = lattice_vector(np.array([w.wave_vector for w in sea.explicit_waves]), sea.tile_m)
        numbers = [(w.amplitude_m, w.steepness, w.phase_rad) for w in sea.explicit_waves]
        amplitude, steepness, phase = np.array(numbers).T
    else:
        k, amplitude, phase = sea._random_waves()
        length = np.linalg.norm(k, axis=1)
        steepness = np.full(len(k), sea.steepness / max(1.0, float(np.sum(length * amplitude))))
    frequency = looping_frequency(angular_frequency(np.linalg.norm(k, axis=1), sea.water_depth_m), sea.loop_s)
    return Waves(k, amplitude, steepness, phase, frequency)
