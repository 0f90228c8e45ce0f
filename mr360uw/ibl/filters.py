# SPDX-License-Identifier: Apache-2.0
"""Filters of radiance maps by zonal kernels: irradiance (a cosine) and glossy levels (GGX lobes), maps of 64 x 32; and
the reflectance of a GGX surface, with which these make its reflection.

    E(n) = int L(d) max(0, n.d) dd = sum_p L_p K(n, p),   K(n, p) = int_p max(0, n.d) dd over source pixel p

K is one constant matrix. Turning the world about the vertical only renames longitudes, so K depends on the difference
of the columns: it is stored as one column of normals (block-circulant) and applied as spectra along the longitude, 60
times less data and time than the full 2048 x 2048 matrix, with the same result. Source maps may be finer than the
result by a whole factor.

Radiance filtered by a GGX lobe is the first half of the split sum. With view, normal and reflection taken as one
(n = v = r: Karis 2013, section "Image-Based Lighting"), it is the mean of L(l) weighted by

    k(n.l) = D(n.h) max(0, n.l),   n.h = sqrt((1 + n.l)/2),   D = GGX of alpha = roughness^2 (Walter 2007 eq. 33)

normalised to 1. This kernel is zonal too, so a level is one more constant filter, integrated over source pixels.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.base.cache import shared
from mr360uw.base.constants import ENVIRONMENT_COLUMNS as COLUMNS
from mr360uw.base.constants import ENVIRONMENT_ROWS as ROWS
from mr360uw.base.disk_cache import kept_arrays
from mr360uw.base.parameters import checked, common_shape, exactly, number, numbers
from mr360uw.base.sphere import directions, row_solid_angle
from mr360uw.errors import ParameterError
from mr360uw.ibl.settings import MINIMUM_ROUGHNESS
from mr360uw.published import harmonic_irradiance
from mr360uw.types import Array, Floats

Kernel = Callable[[Array], Array]

_SAMPLES = 16
"""Midpoint samples of one 64 x 32 pixel along each axis: error 2e-5 of a cosine's peak, a quarter of it with 32."""


class ZonalFilter:
    """A zonal kernel k(n.d), integrated over source pixels, as a filter of maps.

    `scale`: source pixels along one side of a result pixel. The result has 64 x 32 pixels, n at their centres.
    `normalised`: weights of sum 1, a mean instead of an integral. `name`: all that decides the kernel; under it the
    filter is kept on the disk.
    """

    def __init__(self, kernel: Kernel, name: object, scale: int = 1, *, normalised: bool = False) -> None:
        self.scale = scale
        depends_on = name, scale, normalised, COLUMNS, ROWS, _SAMPLES
        kept = kept_arrays("filter", depends_on, lambda: {"spectrum": self._spectrum_of(kernel, normalised)})
        self._spectrum = kept["spectrum"]

    def _spectrum_of(self, kernel: Kernel, normalised: bool) -> NDArray[np.complex64]:
        """Return the spectrum (frequency, source row, result row) of the kernel along the longitude."""
        scale = self.scale
        samples = max(_SAMPLES // scale, 4)
        width, height = COLUMNS * scale, ROWS * scale
        # of directions (cos b sin a, sin b, -cos b cos a), the cosine with a normal is a sum of products over b and a
        columns, rows = width * samples, height * samples
        # the world is its own mirror image about the normals' meridian, the middle of the first `scale` pixels
        half = np.arange(scale // 2, scale // 2 + width // 2 + 1)
        sampled = (half[:, None] + (np.arange(samples) + 0.5) / samples).ravel()
        longitude = 2.0 * np.pi * (sampled / width - 0.5)
        latitude = np.pi * (0.5 - (np.arange(rows) + 0.5) / rows)
        solid_angle = row_solid_angle(columns, rows)
        normals = directions(COLUMNS, ROWS)[:, 0]
        matrix = np.empty((ROWS // 2, height, width), np.float64)
        for row, normal in enumerate(normals[: ROWS // 2]):
            along = normal[0] * np.sin(longitude) - normal[2] * np.cos(longitude)
            values = kernel(np.outer(np.cos(latitude), along) + (normal[1] * np.sin(latitude))[:, None])
            of_rows = values.reshape(rows, len(half), samples) @ np.ones(samples) * solid_angle[:, None]
            of_half = of_rows.reshape(height, samples, len(half)).sum(axis=1)
            matrix[row][:, half % width] = of_half
            matrix[row][:, (scale - 1 - half) % width] = of_half
        if normalised:
            matrix /= matrix.sum(axis=(1, 2), keepdims=True)
        upper = np.conj(self._transform(np.moveaxis(matrix, 0, -1))).astype(np.complex64)
        # below the equator, the mirror image of a normal sees that of the world
        lower = upper.reshape(-1, ROWS // 2, height, scale)[:, ::-1, ::-1].reshape(upper.shape)
        spectrum = np.concatenate([upper, lower], axis=1)
        return np.ascontiguousarray(np.moveaxis(spectrum, 1, 2))

    def _transform(self, maps: np.ndarray) -> np.ndarray:
        """Return the spectra (33, C, H * scale) along the longitude of maps (H, W, C), one for each column phase."""
        height, _, channels = maps.shape
        phases = np.moveaxis(maps.reshape(height, COLUMNS, self.scale, channels), (1, 3), (0, 1))
        real, imaginary = _transform_matrix().astype(maps.dtype) @ phases.reshape(COLUMNS, -1)
        return (real + 1j * imaginary).reshape(-1, channels, height * self.scale)

    def __call__(self, radiance: ArrayLike) -> Floats:
        """Return the filtered map (32, 64, 3) of a radiance map (32 scale, 64 scale, 3)."""
        spectrum = self._transform(np.asarray(radiance, np.float32))  # (frequency, channel, source)
        filtered = np.fft.irfft(spectrum @ self._spectrum, n=COLUMNS, axis=0)  # (column, channel, row)
        return np.ascontiguousarray(np.moveaxis(filtered, (0, 1, 2), (1, 2, 0)), np.float32)


@functools.cache
def _transform_matrix() -> Array:
    """Return the Fourier transform of 64 real numbers as a matrix, (2, 33, 64): real and imaginary part."""
    matrix = np.fft.rfft(np.eye(COLUMNS), axis=0)
    return np.stack([matrix.real, matrix.imag])


def filter_scale(radiance: ArrayLike) -> int:
    """Return k of a radiance map (32 k, 64 k, 3); raise `ParameterError` for other shapes."""
    shape = numbers("radiance", radiance).shape
    scale = shape[0] // ROWS if shape else 0
    if len(shape) != 3 or scale < 1 or shape != (ROWS * scale, COLUMNS * scale, 3):
        raise ParameterError(f"radiance - must be (32 k, 64 k, 3) (got shape {shape}) - use reduce_map first")
    return scale


@functools.cache
def cosine_filter(scale: int = 1) -> ZonalFilter:
    """Return the constant cosine integral for maps of (32 scale, 64 scale, 3)."""
    return ZonalFilter(lambda cosine: np.maximum(cosine, 0.0), "cosine", scale)


def cosine_beam(direction: ArrayLike, irradiance: ArrayLike) -> Floats:
    """Return the irradiance map (32, 64, 3) of a beam: irradiance (3,) on a plane facing `direction` (3,)."""
    cosine = np.maximum(_normals() @ exactly("direction", direction, (3,)).astype(np.float64), 0.0)
    return (cosine[..., None] * exactly("irradiance", irradiance, (3,)).astype(np.float64)).astype(np.float32)


@functools.cache
def _normals() -> Array:
    return directions(COLUMNS, ROWS)


@checked
def irradiance(radiance: ArrayLike, method: Literal["exact", "sh9"] = "exact") -> Floats:
    """Return the irradiance of surfaces of any orientation, from a radiance map.

    Times albedo/pi it is the radiance of a diffuse surface. A sun in a coarse map is as wide as its pixel:
    `environment` takes the sun out and adds its beam in closed form.

    Parameters
    ----------
    radiance : array_like
        Equirectangular map (32 k, 64 k, 3), k = 1, 2, ...
    method : {"exact", "sh9"}
        The cosine integral over every source pixel; or nine spherical harmonics, smooth, a few percent off under a sun,
        and negative there on the far side.

    Returns
    -------
    ndarray
        Irradiance (32, 64, 3) on a surface that faces each pixel's direction, in radiance times sr.

    Raises
    ------
    ParameterError
        If the map has another shape.

    See Also
    --------
    uw.ibl.environment : The light of a plate, its sun apart.
    uw.ibl.prefilter : The light that a glossy surface mirrors.

    Notes
    -----
    The nine harmonics are those of Ramamoorthi & Hanrahan 2001.

    Examples
    --------
    >>> uw.ibl.irradiance(np.ones((32, 64, 3)))[0, 0].round(4)
    array([3.1416, 3.1416, 3.1416], dtype=float32)
    """
    scale = filter_scale(radiance)
    return cosine_filter(scale)(radiance) if method == "exact" else harmonic_irradiance(radiance)


def ggx_distribution(cos_half: ArrayLike, roughness: float) -> Array:
    """Return the GGX normal distribution D [1/sr] at the cosine between normal and half vector."""
    alpha_squared = roughness**4
    c2 = np.square(np.asarray(cos_half, np.float64))
    return alpha_squared / (np.pi * np.square(c2 * (alpha_squared - 1.0) + 1.0))


def ggx_kernel(cosine: ArrayLike, roughness: float) -> Array:
    """Return the prefilter's weight, not normalised, of light at `cosine` = n.l."""
    cosine = np.asarray(cosine, np.float64)
    lit = np.maximum(cosine, 0.0)
    return ggx_distribution(np.sqrt(0.5 + 0.5 * np.maximum(cosine, -1.0)), roughness) * lit


@shared(keep=16)
def glossy_filter(roughness: float, scale: int = 1) -> ZonalFilter:
    """Return the constant prefilter of one roughness for maps of (32 scale, 64 scale, 3)."""
    return ZonalFilter(lambda cosine: ggx_kernel(cosine, roughness), ("ggx", roughness), scale, normalised=True)


def _check_roughness(roughness: float) -> None:
    if not MINIMUM_ROUGHNESS <= number("roughness", roughness) <= 1.0:
        raise ParameterError(
            f"roughness - outside [{MINIMUM_ROUGHNESS}, 1] (got {roughness!r}) - use the radiance itself for mirrors"
        )


def prefilter(radiance: ArrayLike, roughness: float) -> Floats:
    """Return a radiance map filtered by the GGX lobe of a roughness.

    The lobe has the integral 1, so even light stays as it is: this is the first half of the split sum, without masking
    and Fresnel's factor.

    Parameters
    ----------
    radiance : array_like
        Equirectangular map (32 k, 64 k, 3), k = 1, 2, ...
    roughness : float
        Of the surface, in [0.05, 1].

    Returns
    -------
    ndarray
        Filtered radiance (32, 64, 3) about the mirror direction.

    Raises
    ------
    ParameterError
        If the map has another shape or the roughness is out of range.

    See Also
    --------
    uw.ibl.split_sum : The second half, with these factors.
    uw.ibl.glossy_beam : The same of the sun's beam.
    uw.ibl.irradiance : The integral for diffuse surfaces.

    Examples
    --------
    >>> uw.ibl.prefilter(np.ones((32, 64, 3)), 0.5).shape
    (32, 64, 3)
    """
    _check_roughness(roughness)
    return glossy_filter(float(roughness), filter_scale(radiance))(radiance)


def glossy_beam(direction: ArrayLike, irradiance: ArrayLike, roughness: float) -> Floats:
    """Return the prefiltered radiance (32, 64, 3) of a beam: irradiance (3,) on a plane facing `direction` (3,)."""
    _check_roughness(roughness)
    cosine = np.linspace(0.0, 1.0, 1 << 16)  # the kernel's integral, with 1 - cosine spaced as a square
    tail = np.square(1.0 - cosine)
    total = 2.0 * np.pi * np.trapezoid(ggx_kernel(1.0 - tail, roughness), tail)
    towards = exactly("direction", direction, (3,)).astype(np.float64)
    lobe = ggx_kernel(_normals() @ towards, roughness) / abs(float(total))
    return (lobe[..., None] * exactly("irradiance", irradiance, (3,)).astype(np.float64)).astype(np.float32)


def glossy_levels(radiance: ArrayLike, roughness: ArrayLike) -> Floats:
    """Return the levels (L, 32, 64, 3) of a radiance map at ascending roughnesses (L,)."""
    levels = np.asarray(roughness, np.float64)
    if levels.ndim != 1 or np.any(np.diff(levels) <= 0.0):
        raise ParameterError(f"glossy_roughness - must ascend (got {levels.tolist()}) - sort it, without repeats")
    if not len(levels):
        return np.zeros((0, 32, 64, 3), np.float32)
    return np.stack([prefilter(radiance, float(level)) for level in levels])


# --- reflectance under a uniform sky --------------------------------------------------------------------------------

# Reflectance of a GGX surface under a uniform sky, F0 A + B: the second half of the split sum.
#
#     A = int f/F cos (1 - (1 - v.h)^5),   B = int f/F cos (1 - v.h)^5   over the hemisphere of l
#
# f = GGX with the height-correlated Smith masking (Heitz 2014 eq. 99) and the Fresnel factor of Schlick 1994.
# `split_sum` is a quotient of polynomials fitted to the integral (Karis 2013): rms error .014 of
# A + B and .003 of B, within .04 and .015 where n.v > .1; B vanishes at n.v = 1 as it must, or every dark dielectric
# would look hazy. (The widely used fit of Karis 2014 is off by up to .47 for rough metals.)
# Twin: splitsum.glsl.


def split_sum(roughness: ArrayLike, n_dot_v: ArrayLike) -> tuple[Array, Array]:
    """Return (A, B) for perceptual roughness (alpha = roughness^2) and n.v, each (...,) in [0, 1]."""
    common_shape(roughness=roughness, n_dot_v=n_dot_v)
    r = np.asarray(roughness, np.float64)
    v = np.asarray(n_dot_v, np.float64)
    white = (1.004 + v * (0.1061 - v * (0.1398 + 0.1248 * v))
             + r * (-2.549 + v * (0.1271 + 0.4051 * v) + r * (2.37 - 0.5209 * v - 0.5446 * r)))  # fmt: skip
    white = white / (1.0 + v * (0.05538 - 0.209 * v) + r * (-2.2 + 0.2572 * v + 1.505 * r))
    b = 0.9969 + v * (-1.096 + 1.0529 * v) + r * (-1.0901 + 0.0253 * v + 0.484 * r)
    b = b / (1.0 + v * (0.0215 + 7.8124 * v) + r * (-0.292 - 13.4496 * v + 8.9049 * r))
    x = 1.0 - v
    b = np.maximum(x * x * x * b, 0.0)
    return np.minimum(white, 1.0) - b, b
