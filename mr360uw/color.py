# SPDX-License-Identifier: Apache-2.0
"""Colour: transfer functions, luminance, primaries and the Y'CbCr matrices of video.

Inside the toolkit colour is linear Rec.709 scene radiance. A plate with the Y'CbCr matrix of BT.2020 has its primaries
too; `rec709_from_plate` converts its light. `decode` and `encode` are the only conversions between code
values in [0, 1] and linear light; names say `_encoded` or `_linear`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.constants import LUMINANCE_B, LUMINANCE_G, LUMINANCE_R
from mr360uw.errors import ParameterError
from mr360uw.shapes import numbers, real, vectors

Matrix = Literal["bt601", "bt709", "bt2020"]
Transfer = Literal["srgb", "bt709", "bt1886", "gamma22", "linear"]
TRANSFERS: tuple[Transfer, ...] = ("srgb", "bt709", "bt1886", "gamma22", "linear")

LUMINANCE = np.array([LUMINANCE_R, LUMINANCE_G, LUMINANCE_B])

# The curve of ITU-R BT.709-6 with the digits of BT.2020-2 table 4, with which its two pieces join smoothly.
_CURVE_ALPHA, _CURVE_BETA = 1.09929682680944, 0.018053968510807

# Luma weights (K_R, K_B): ITU-R BT.601-7, BT.709-6, BT.2020-2.
_LUMA_WEIGHTS: dict[Matrix, tuple[float, float]] = {
    "bt601": (0.299, 0.114),
    "bt709": (0.2126, 0.0722),
    "bt2020": (0.2627, 0.0593),
}

# Chromaticities (x, y) of red, green and blue, ITU-R BT.709-6 and BT.2020-2, and of their white, D65.
_REC709_PRIMARIES = np.array([(0.640, 0.330), (0.300, 0.600), (0.150, 0.060)])
_REC2020_PRIMARIES = np.array([(0.708, 0.292), (0.170, 0.797), (0.131, 0.046)])
_WHITE = np.array((0.3127, 0.3290))


@dataclass(frozen=True, slots=True)
class ColorSpec:
    """Interpretation of a plate's code values: matrix, range, transfer curve, depth.

    matrix: Y'CbCr weights; bt2020 implies the primaries of BT.2020. full_range: luma 0..2^bits - 1 (JPEG)
    or the limited 16..235 (scaled to the depth). transfer: curve between code values and linear light. bits: depth of
    the code values, 8 or 10 for video.
    """

    matrix: Matrix = "bt709"
    full_range: bool = False
    transfer: Transfer = "srgb"
    bits: int = 8


def luminance(linear: ArrayLike) -> NDArray[np.floating]:
    """Return the luminance (...,) of linear Rec.709 colours (..., 3)."""
    return vectors("linear", linear) @ LUMINANCE


def decode(encoded: ArrayLike, transfer: Transfer) -> NDArray[np.floating]:
    """Return linear light of code values in [0, 1]; odd about zero, so that excursions survive.

    srgb: IEC 61966-2-1. bt709: inverse of the camera curve of ITU-R BT.709-6. bt1886: display gamma 2.4.
    linear: as it is, also what is not finite, as in maps of distances.
    """
    v = (real if transfer == "linear" else numbers)("encoded", encoded)
    v = v if np.issubdtype(v.dtype, np.floating) else v.astype(np.float64)
    a = np.abs(v)
    if transfer == "srgb":
        linear = np.where(a <= 0.04045, a / 12.92, ((a + 0.055) / 1.055) ** 2.4)
    elif transfer == "bt709":
        linear = np.where(a < 4.5 * _CURVE_BETA, a / 4.5, ((a + (_CURVE_ALPHA - 1.0)) / _CURVE_ALPHA) ** (1.0 / 0.45))
    elif transfer == "bt1886":
        linear = a**2.4
    elif transfer == "gamma22":
        linear = a**2.2
    elif transfer == "linear":
        linear = a
    else:
        raise ParameterError(f"transfer - unknown curve (got {transfer!r}) - take one of {', '.join(TRANSFERS)}")
    return np.copysign(linear, v).astype(v.dtype, copy=False)


def encode(linear: ArrayLike, transfer: Transfer) -> NDArray[np.floating]:
    """Return code values of linear light, the inverse of `decode`; not clipped."""
    v = (real if transfer == "linear" else numbers)("linear", linear)
    v = v if np.issubdtype(v.dtype, np.floating) else v.astype(np.float64)
    a = np.abs(v)
    if transfer == "srgb":
        code = np.where(a <= 0.04045 / 12.92, a * 12.92, 1.055 * a ** (1.0 / 2.4) - 0.055)
    elif transfer == "bt709":
        code = np.where(a < _CURVE_BETA, a * 4.5, _CURVE_ALPHA * a**0.45 - (_CURVE_ALPHA - 1.0))
    elif transfer == "bt1886":
        code = a ** (1.0 / 2.4)
    elif transfer == "gamma22":
        code = a ** (1.0 / 2.2)
    elif transfer == "linear":
        code = a
    else:
        raise ParameterError(f"transfer - unknown curve (got {transfer!r}) - take one of {', '.join(TRANSFERS)}")
    return np.copysign(code, v).astype(v.dtype, copy=False)


def rgb_from_ycbcr(matrix: Matrix) -> NDArray[np.float64]:
    """Return the (3, 3) matrix from (Y', Cb, Cr), Y' in [0, 1] and C in [-.5, .5], to R'G'B' in [0, 1]."""
    kr, kb = _LUMA_WEIGHTS[matrix]
    kg = 1.0 - kr - kb
    return np.array(
        [
            [1.0, 0.0, 2.0 * (1.0 - kr)],
            [1.0, -2.0 * kb * (1.0 - kb) / kg, -2.0 * kr * (1.0 - kr) / kg],
            [1.0, 2.0 * (1.0 - kb), 0.0],
        ]
    )


def ycbcr_from_rgb(matrix: Matrix) -> NDArray[np.float64]:
    """Return the inverse of `rgb_from_ycbcr`."""
    return np.linalg.inv(rgb_from_ycbcr(matrix)).astype(np.float64)


def _xyz_from_rgb(primaries: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (3, 3) matrix from linear RGB of `primaries` (3, 2) to XYZ, white at Y = 1 (SMPTE RP 177-1993)."""
    columns = np.stack([primaries[:, 0], primaries[:, 1], 1.0 - primaries.sum(axis=1)]) / primaries[:, 1]
    white = np.array([_WHITE[0], _WHITE[1], 1.0 - _WHITE.sum()]) / _WHITE[1]
    return np.asarray(columns * np.linalg.solve(columns, white), np.float64)


def rec709_from_plate(matrix: Matrix) -> NDArray[np.float64]:
    """Return the (3, 3) matrix from the linear light of a plate, in its own primaries, to linear Rec.709.

    White stays white. Colours outside the gamut of Rec.709 get a negative channel. The primaries of standard definition
    (bt601) are taken as those of Rec.709, which they all but are.
    """
    if matrix != "bt2020":
        return np.eye(3)
    return np.linalg.solve(_xyz_from_rgb(_REC709_PRIMARIES), _xyz_from_rgb(_REC2020_PRIMARIES)).astype(np.float64)


def code_range(spec: ColorSpec) -> tuple[float, float, float, float]:
    """Return (luma offset, luma span, chroma offset, chroma span) in code values of `spec.bits`.

    Y' = (code - luma offset)/luma span, C = (code - chroma offset)/chroma span (ITU-R BT.709-6 section 4.6).
    """
    scale = float(1 << (spec.bits - 8))
    if spec.full_range:
        peak = float((1 << spec.bits) - 1)
        return 0.0, peak, 128.0 * scale, peak
    return 16.0 * scale, 219.0 * scale, 128.0 * scale, 224.0 * scale
