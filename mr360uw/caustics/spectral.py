# SPDX-License-Identifier: Apache-2.0
"""A sea from a wave spectrum, summed by fast Fourier transform (Tessendorf 2001).

    h(k, t) = h0(k) exp(-i omega t) + conj h0(-k) exp(i omega t)

so that h(x, t) = sum h(k, t) exp(i k.x) is real and waves run along k. Slopes i k h; shift i k/|k| h, whose sign draws
particles towards the crests (the paper's -i sharpens the troughs). Wave vectors are the tile's lattice; the rows of
the highest frequency, which have no partner, stay empty.

    phillips   alpha/2 exp(-1/(k L)^2)/k^4, L = U^2/g, spread ~ cos^p         Phillips 1958; Tessendorf 2001 eq. 40
    jonswap    alpha g^2 w^-5 exp(-1.25 (wp/w)^4) gamma^r, cos^2s spread      Hasselmann et al. 1973, 1980
               up to a fully developed sea                                    Pierson & Moskowitz 1964
    tma        jonswap times the depth factor        Bouws et al. 1985; Thompson & Vincent 1983

Waves against the wind are left out: there are no standing waves then, and the variance is the same at all times.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from typing import Literal

import numpy as np

from mr360uw.base.cache import shared
from mr360uw.base.constants import GRAVITY_M_S2
from mr360uw.base.parameters import advanced, listed, parameter
from mr360uw.caustics.gerstner import Complex, Waves
from mr360uw.caustics.sea import (
    PHILLIPS_ALPHA,
    SeaParameters,
    SurfaceFields,
    angular_frequency,
    cosine_power_share,
    cosine_spread,
    group_speed,
    jonswap,
    looping_frequency,
    peak_frequency,
    tma_factor,
)
from mr360uw.types import Array

_FADING = 0.5
"""Cosine of the angle to a wind that turns below which waves fade, to nothing across it: over its last 30 degrees. With
half as much a wave fades in half the time."""


@listed
class SpectralSea(SeaParameters):
    """A sea of random waves with the spectrum of a wind sea.

    It has every wave of a lattice, so it looks less regular than a `GerstnerSea`, but it may fold over where it is
    steep.

    Raises
    ------
    ParameterError
        If a value is out of its range; the message names it.

    See Also
    --------
    uw.caustics.GerstnerSea : Fewer waves, which never fold over.
    uw.caustics.caustic_map : The light below a sea.

    Notes
    -----
    h(k, t) = h0(k) exp(-i omega t) + conj h0(-k) exp(i omega t), summed by a fast Fourier transform (Tessendorf 2001).
    The spectra are those of Phillips 1958, Hasselmann et al. 1973 (JONSWAP) and Bouws et al. 1985 (TMA). The latter two
    grow with the fetch up to a fully developed sea (Pierson & Moskowitz 1964). A tile holds no waves longer than
    itself: `held_variance` is the fraction of the spectrum's variance that it has. Longer waves have little slope.

    Examples
    --------
    >>> sea = uw.caustics.SpectralSea(spectrum="jonswap", resolution=32, significant_wave_height_m=0.2)
    >>> round(sea.significant_height_m, 3)
    0.2
    """

    model: Literal["spectral"] = parameter("spectral", "kind of sea")
    spectrum: Literal["phillips", "jonswap", "tma"] = parameter("jonswap", "spectrum; tma: jonswap on shallow water")
    resolution: int = advanced(128, "wave vectors across the lattice", low=4, high=2048)
    significant_wave_height_m: float | None = parameter(
        None, "four standard deviations of the tile's heights; none: of the spectrum's waves that fit into it",
        unit="m", low=0.0, high=40.0,
    )  # fmt: skip
    fetch_m: float = parameter(
        100e3, "distance the wind has blown over; waves grow with it until they are fully developed", unit="m",
        low=1.0, high=1e8,
    )  # fmt: skip
    alignment: float = advanced(
        2.0, "for spectrum phillips: exponent of the cosine to the wind; 0: none, 20: along the wind alone", unit="1",
        low=0.0, high=64.0,
    )  # fmt: skip
    choppiness: float = parameter(0.7, "horizontal shift: 0 = none, 1 = circular orbits", low=0.0, high=2.0)

    @property
    def lattice(self) -> tuple[Array, Array]:
        """The wave vectors (k_x, k_z) [rad/m], each (n, n) in the order of the transform."""
        m = np.fft.fftfreq(self.resolution, 1.0 / self.resolution) * (2.0 * np.pi / self.tile_m)
        return np.broadcast_to(m, (self.resolution,) * 2), np.broadcast_to(m[:, None], (self.resolution,) * 2)

    @property
    def significant_height_m(self) -> float:
        """Four standard deviations [m] of the height."""
        return 4.0 * float(np.sqrt(_variance_of(self).sum()))

    @property
    def peak_period_s(self) -> float:
        """Period [s] of the spectrum's peak, whether the tile holds such waves or not; infinite without wind."""
        frequency = _peak_of(self)
        return 2.0 * math.pi / frequency if frequency > 0.0 else math.inf

    @property
    def peak_wavelength_m(self) -> float:
        """Wavelength [m] of the spectrum's peak, on water of this depth."""
        k = np.geomspace(1e-6, 1e4, 1 << 13)
        frequency = _peak_of(self)
        return 2.0 * math.pi / float(np.interp(frequency, angular_frequency(k, self.water_depth_m), k))

    @property
    def spectrum_height_m(self) -> float:
        """Significant height [m] of the whole spectrum, of which the tile holds `held_variance`."""
        return 4.0 * math.sqrt(_whole_variance_of(self))

    @property
    def held_variance(self) -> float:
        """Fraction of the spectrum's variance in waves that fit into the tile and are not too short for it."""
        whole = _whole_variance_of(self)
        return min(float(_spectrum_variance_of(self).sum()) / whole, 1.0) if whole > 0.0 else 1.0

    def __repr_args__(self) -> Iterator[tuple[str | None, object]]:
        """Yield what the sea's representation lists: its parameters, and the heights and lengths that they make."""
        yield from super().__repr_args__()
        for name in (
            "significant_height_m",
            "spectrum_height_m",
            "held_variance",
            "peak_period_s",
            "peak_wavelength_m",
        ):
            yield name, float(f"{getattr(self, name):.3g}")

    def spectra(self, time_s: float) -> Complex:
        """Return the spectra (8, n, n) of the fields of `SurfaceFields`: field = Re sum c(k) exp(i k.(x, z))."""
        h0, frequency = _amplitudes_of(self)
        turn = np.exp(-1j * np.remainder(frequency * time_s, 2.0 * np.pi))
        opposite = np.roll(h0[::-1, ::-1], (1, 1), (0, 1))
        h = h0 * turn + np.conj(opposite * turn)
        kx, kz = self.lattice
        k = np.hypot(kx, kz)
        shift = 1j * self.choppiness * h / np.where(k > 0.0, k, 1.0)
        return np.stack([h, shift * kx, shift * kz, 1j * kx * h, 1j * kz * h,
                         1j * kx * kx * shift, 1j * kz * kz * shift, 1j * kx * kz * shift])  # fmt: skip

    def waves(self, count: int = 256) -> Waves:
        """Return the `count` waves of the largest amplitude, fewer where there are fewer, as `GerstnerSea` has them.

        h0 exp(i (k.x - omega t)) and its conjugate add up to a sine of amplitude 2 |h0|.
        """
        h0, frequency = _amplitudes_of(self)
        amplitude = 2.0 * np.abs(h0).ravel()
        largest = np.argsort(-amplitude, kind="stable")[:count]
        largest = largest[amplitude[largest] > 0.0]
        k = np.stack(self.lattice, axis=-1).reshape(-1, 2)[largest]
        phase = np.angle(h0).ravel()[largest] + 0.5 * np.pi
        choppy = np.full(len(largest), self.choppiness)
        return Waves(k, amplitude[largest], choppy, phase, frequency.ravel()[largest])

    def fields_at(self, x_m: Array, z_m: Array, time_s: float) -> SurfaceFields:
        """Return the fields at points (n,) [m], summed wave by wave: for few points; `grid_fields` for whole tiles."""
        spectra = self.spectra(time_s)
        used = np.flatnonzero(np.any(spectra != 0.0, axis=(0, 2)))
        m = np.fft.fftfreq(self.resolution, 1.0 / self.resolution)[used] * (2.0 * np.pi / self.tile_m)
        along_x, along_z = np.exp(1j * x_m[:, None] * m), np.exp(1j * z_m[:, None] * m)
        core = spectra[:, used[:, None], used]
        return SurfaceFields(*(np.sum((along_z @ c) * along_x, axis=1).real for c in core))

    def grid_fields(self, size: int, time_s: float) -> SurfaceFields:
        """Return the fields (size, size) at x = column tile/size, z = row tile/size.

        Frequencies above what the grid holds fall on lower ones, as they do when a surface is sampled.
        """
        from scipy.fft import ifft2

        spectra = self.spectra(time_s)
        place = np.fft.fftfreq(self.resolution, 1.0 / self.resolution).astype(np.int64) % size
        # two real fields in one transform
        pairs = spectra[0::2] + 1j * spectra[1::2]
        folded = np.zeros((len(pairs), size, size), np.complex128)
        times = self.resolution // size
        for field, spectrum in zip(folded, pairs, strict=True):
            if times * size == self.resolution:
                field[...] = spectrum.reshape(times, size, times, size).sum(axis=(0, 2))
            elif size > self.resolution:  # every frequency has a place of its own
                field[place[:, None], place] = spectrum
            else:
                np.add.at(field, (place[:, None], place), spectrum)
        pairs = ifft2(folded, norm="forward", overwrite_x=True, workers=os.cpu_count())
        values = np.stack([pairs.real, pairs.imag], axis=1).reshape(-1, size, size)
        return SurfaceFields(*values)


def _density_of(sea: SpectralSea) -> Array:
    """Return the variance density F [m^4] over the lattice's wave vectors: the integral of F dk_x dk_z is var(h).

    Where the wind changes its direction, waves across it fade out, so that none ends at once.
    """
    kx, kz = sea.lattice
    k, wind, wind_speed = np.hypot(kx, kz), sea.wind_travel, sea.wind_speed
    if wind_speed == 0.0:
        return np.zeros(k.shape)
    # Leave out the mean; waves run with the wind
    used = k > 0.0
    k = np.where(used, k, 1.0)
    cosine = (kx * wind[0] + kz * wind[1]) / k
    # Density over wave vectors, by formula or from that over frequency (Jacobian group speed/k)
    if sea.spectrum == "phillips":
        length = wind_speed**2 / GRAVITY_M_S2
        spread = np.maximum(cosine, 0.0) ** sea.alignment * cosine_power_share(sea.alignment)
        density = 0.5 * PHILLIPS_ALPHA * np.exp(-1.0 / (k * length) ** 2) / k**4 * spread
    else:
        frequency = angular_frequency(k, sea.water_depth_m)
        density = _frequency_density_of(sea, frequency)
        spread = cosine_spread(np.arccos(np.clip(cosine, -1.0, 1.0)), frequency, wind_speed, sea.fetch_m)
        density = density * spread * group_speed(k, sea.water_depth_m) / k
    # Fade the edges, where a turning wind would cut waves off
    if sea.waves_of_wind_deg is not None:
        edge = np.clip(cosine / _FADING, 0.0, 1.0)
        density = density * edge**2 * (3.0 - 2.0 * edge)
    return np.where(used & (cosine > 0.0), density, 0.0)


def _frequency_density_of(sea: SpectralSea, frequency: Array) -> Array:
    """Return S(omega) [m^2 s] of a sea with wind, of spectrum jonswap or tma."""
    density = jonswap(frequency, sea.wind_speed, sea.fetch_m)
    return density * tma_factor(frequency, sea.water_depth_m) if sea.spectrum == "tma" else density


def _peak_of(sea: SpectralSea) -> float:
    """Return the angular frequency [rad/s] of a spectrum's peak, 0 without wind.

    Phillips' is w^-5 exp(-(g/(U w))^4) in deep water, which is greatest where (g/(U w))^4 = 5/4.
    """
    if sea.wind_speed == 0.0:
        return 0.0
    if sea.spectrum == "phillips":
        return GRAVITY_M_S2 / sea.wind_speed * 0.8**0.25
    return peak_frequency(sea.wind_speed, sea.fetch_m)


def _whole_variance_of(sea: SpectralSea) -> float:
    """Return the variance [m^2] of a whole spectrum, waves of all lengths: in closed form, or over log w."""
    if sea.wind_speed == 0.0:
        return 0.0
    if sea.spectrum == "phillips":
        return 0.25 * PHILLIPS_ALPHA * (sea.wind_speed**2 / GRAVITY_M_S2) ** 2
    frequency = _peak_of(sea) * np.geomspace(0.2, 100.0, 4001)
    return float(np.trapezoid(frequency * _frequency_density_of(sea, frequency), np.log(frequency)))


@shared(keep=8)
def _variance_of(sea: SpectralSea) -> Array:
    """Variance [m^2] of the waves of each wave vector, from the spectrum or scaled to the height that is set."""
    variance = _spectrum_variance_of(sea)
    total = float(variance.sum())
    if sea.significant_wave_height_m is not None and total > 0.0:
        variance = variance * ((sea.significant_wave_height_m / 4.0) ** 2 / total)
    return variance


def _spectrum_variance_of(sea: SpectralSea) -> Array:
    """Return the variance [m^2] that the spectrum gives the waves of each wave vector."""
    kx, kz = sea.lattice
    variance = _density_of(sea) * (2.0 * np.pi / sea.tile_m) ** 2
    highest = np.arange(sea.resolution) == sea.resolution // 2
    shortest = sea.shortest_wavelength_m or sea.tile_m / 40.0
    longest_kept = max(2.0 * np.pi / shortest, 2.0 * np.pi / sea.tile_m)
    out = (np.hypot(kx, kz) > longest_kept * (1.0 + 1e-9)) | highest | highest[:, None]
    return np.where(out, 0.0, variance)


@shared(keep=8)
def _amplitudes_of(sea: SpectralSea) -> tuple[Complex, Array]:
    """Return h0 (n, n) and the angular frequencies (n, n).

    Gaussian amplitudes, scaled as a whole so that this sea has the stated height and not only the mean sea of many.
    """
    n = sea.resolution
    random = np.random.default_rng([sea.seed, 0xFF7])
    gauss = random.standard_normal((2, n, n))
    h0 = (gauss[0] + 1j * gauss[1]) * np.sqrt(_variance_of(sea) / 4.0)
    made = 2.0 * float(np.sum(np.abs(h0) ** 2))
    h0 *= np.sqrt(float(_variance_of(sea).sum()) / made) if made > 0.0 else 0.0
    kx, kz = sea.lattice
    k = np.hypot(kx, kz)
    frequency = angular_frequency(np.where(k > 0.0, k, 1.0), sea.water_depth_m)
    return h0, looping_frequency(frequency, sea.loop_s)
