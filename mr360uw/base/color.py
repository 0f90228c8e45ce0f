# SPDX-License-Identifier: Apache-2.0
"""Colour: transfer functions, luminance, primaries and the Y'CbCr matrices of video.

Inside the toolkit colour is linear Rec.709 scene radiance. A plate with the Y'CbCr matrix of BT.2020 has its primaries
too, unless others are named; `rec709_from_plate` converts its light. `decode` and `encode` are the only conversions
between code values in [0, 1] and linear light; names say `_encoded` or `_linear`. White is linear light of 1.
"""

from __future__ import annotations

import functools
import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal, Protocol, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.base.cache import shared
from mr360uw.base.constants import LUMINANCE_B, LUMINANCE_G, LUMINANCE_R
from mr360uw.base.parameters import numbers, real, vectors
from mr360uw.errors import ParameterError

# Transfer curves that hold light far above white: HDR television, and the log recordings of cameras.
#
#     pq       SMPTE ST 2084, ITU-R BT.2100-2: display light up to 10 000 cd/m^2; white is 203 cd/m^2 (ITU-R BT.2408)
#     hlg      ITU-R BT.2100-2: scene light; white is the light at 75 % of the signal (ITU-R BT.2408)
#     slog3    Sony S-Log3        vlog   Panasonic V-Log        dlog   DJI D-Log      white reflects 100 %
#     protune, gplog, gplog2      GoPro's Protune Flat, GP-Log and GP-Log2: log(1 + (b - 1) light)/log b, with base b of
#                                 113, 400 and 600; white is the brightest light that they hold
#
# The curves are those of colour-science; GoPro's are the formula above. White is linear light of 1. PQ ends at its
# 10 000 cd/m^2, 49 times white; the others go on as their formulas do.

WideTransfer = Literal["pq", "hlg", "slog3", "vlog", "dlog", "protune", "gplog", "gplog2"]
WIDE_TRANSFERS: tuple[WideTransfer, ...] = get_args(WideTransfer)

ON_FILE_CODES = frozenset({"slog3", "vlog", "dlog"})
"""Curves whose makers define them on the file's code values over full scale, whatever range the file is tagged with:
black of S-Log3 is the 10-bit code 95 in every recording. The others are defined on the signal, black to white."""

_WHITE_CD_M2 = 203.0  # luminance of HDR reference white, ITU-R BT.2408-7 table 1
_HLG_WHITE = 0.75  # signal of the same white in HLG
_LOG_NAMES = {"slog3": "S-Log3", "vlog": "V-Log", "dlog": "D-Log"}  # of colour-science
_LOG_BASES = {"protune": 113.0, "gplog": 400.0, "gplog2": 600.0}

Array = NDArray[np.float64]


@functools.cache
def colour_science() -> Any:
    """Return the package colour-science, imported at the first call: it takes about a second."""
    with warnings.catch_warnings(), np.printoptions():  # it changes how NumPy prints arrays, for the whole process
        warnings.simplefilter("ignore")  # it warns about optional packages
        import colour
    return colour


Levels = Literal["video", "data"]
"""Levels of 0 and 1 in a map's input. video: black and white of the plate's range. data: code 0 and full scale."""


class PlateMapping(Protocol):
    """A map between a plate's R'G'B' values and light that a curve and primaries cannot say: a lookup table, or OCIO.

    Implementations compare and hash by what the map does. on_file_codes: values are codes over full scale; otherwise
    0 is black and 1 is white of the plate's range. is_wide: light may be above white, as of a log recording. A map that
    is not wide is one that a picture file itself names, by a profile or its primaries: outputs that cannot name it hold
    Rec.709. Both methods take and return (..., 3) floats, of any shape before.
    """

    @property
    def on_file_codes(self) -> bool:
        """Whether values are codes over full scale, rather than signals from black to white."""
        ...

    @property
    def is_wide(self) -> bool:
        """Whether light may be above white."""
        ...

    def to_light(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return the linear Rec.709 light of values."""
        ...

    def to_values(self, light: NDArray[Any]) -> NDArray[Any]:
        """Return the values of linear Rec.709 light, the inverse of `to_light`."""
        ...


Matrix = Literal["bt601", "bt709", "bt2020"]
Primaries = Literal["bt709", "bt2020", "sgamut3", "sgamut3cine", "vgamut", "dgamut"]
DisplayTransfer = Literal["srgb", "bt709", "bt1886", "gamma22", "linear"]
"""Curves of which white is the brightest code."""
DISPLAY_CURVE: DisplayTransfer = "srgb"
"""Curve from code values to linear light that published inverse tone mapping operators assume."""
Transfer = DisplayTransfer | WideTransfer
TRANSFERS: tuple[Transfer, ...] = (*get_args(DisplayTransfer), *WIDE_TRANSFERS)

LUMINANCE = np.array([LUMINANCE_R, LUMINANCE_G, LUMINANCE_B])

# The curve of ITU-R BT.709-6 with the digits of BT.2020-2 table 4, with which its two pieces join smoothly.
_CURVE_ALPHA, _CURVE_BETA = 1.09929682680944, 0.018053968510807
_Curve = Callable[[Any], Any]
_DISPLAY_CURVES: dict[str, tuple[_Curve, _Curve]] = {
    "srgb": (
        lambda a: np.where(a <= 0.04045, a / 12.92, ((a + 0.055) / 1.055) ** 2.4),
        lambda a: np.where(a <= 0.04045 / 12.92, a * 12.92, 1.055 * a ** (1.0 / 2.4) - 0.055),
    ),
    "bt709": (
        lambda a: np.where(a < 4.5 * _CURVE_BETA, a / 4.5, ((a + (_CURVE_ALPHA - 1.0)) / _CURVE_ALPHA) ** (1.0 / 0.45)),
        lambda a: np.where(a < _CURVE_BETA, a * 4.5, _CURVE_ALPHA * a**0.45 - (_CURVE_ALPHA - 1.0)),
    ),
    "bt1886": (lambda a: a**2.4, lambda a: a ** (1.0 / 2.4)),
    "gamma22": (lambda a: a**2.2, lambda a: a ** (1.0 / 2.2)),
    "linear": (lambda a: a, lambda a: a),
}
"""Curves from values >= 0 to linear light, and back."""

# Luma weights (K_R, K_B): ITU-R BT.601-7, BT.709-6, BT.2020-2.
_LUMA_WEIGHTS: dict[Matrix, tuple[float, float]] = {
    "bt601": (0.299, 0.114),
    "bt709": (0.2126, 0.0722),
    "bt2020": (0.2627, 0.0593),
}

XY_BY_NAME: dict[str, tuple[float, ...]] = {
    "ap0": (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, 0.32168, 0.33767),
    "ap1": (0.713, 0.293, 0.165, 0.83, 0.128, 0.044, 0.32168, 0.33767),
    "rec2020": (0.708, 0.292, 0.17, 0.797, 0.131, 0.046, 0.3127, 0.329),
    "p3d65": (0.68, 0.32, 0.265, 0.69, 0.15, 0.06, 0.3127, 0.329),
    "rec709": (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329),
}
"""Chromaticities x, y of red, green, blue and white, by names of spaces of linear light (Color Interop Forum): those of
ACES, ITU-R BT.2020-2, Display P3 and ITU-R BT.709-6."""
REC709_XY = XY_BY_NAME["rec709"]
"""The primaries of all linear light here."""
HDR_CURVES: dict[int, Transfer] = {16: "pq", 18: "hlg"}
"""Curves of high dynamic range by their numbers in ITU-T H.273."""
_CAMERA_GAMUTS: dict[Primaries, str] = {
    "sgamut3": "S-Gamut3", "sgamut3cine": "S-Gamut3.Cine", "vgamut": "V-Gamut", "dgamut": "DJI D-Gamut"
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class ColorSpec:
    """Interpretation of a plate's code values: matrix, range, transfer curve, depth.

    matrix: Y'CbCr weights. full_range: luma 0..2^bits - 1 (JPEG) or the limited 16..235 (scaled to the depth).
    transfer: curve between code values and linear light. bits: depth of the code values, 8 or 10 for video. primaries:
    of the light; by default those of BT.2020 with its matrix, and of Rec.709 with the others. mapping: takes the place
    of both: with it the transfer is "linear", the primaries are "bt709", and what these give are the plate's R'G'B'
    signals, which `in_rec709` and `in_plate_primaries` map to light and back.
    """

    matrix: Matrix = "bt709"
    full_range: bool = False
    transfer: Transfer = "srgb"
    bits: int = 8
    primaries: Primaries | None = None
    mapping: PlateMapping | None = None

    def mapped(self, mapping: PlateMapping) -> ColorSpec:
        """Return the same codes read through a mapping."""
        return replace(self, transfer="linear", primaries="bt709", mapping=mapping)

    @property
    def picture_transfer(self) -> Transfer:
        """The curve of pictures of the plate with integer codes: its own, sRGB for linear plates."""
        return "srgb" if self.transfer == "linear" and not self.is_wide else self.transfer

    @property
    def gamut(self) -> Primaries:
        """The primaries of the light."""
        return self.primaries or ("bt2020" if self.matrix == "bt2020" else "bt709")

    @property
    def is_rec709(self) -> bool:
        """Whether the curve alone gives linear Rec.709 light of R'G'B'."""
        return self.mapping is None and self.gamut == "bt709"

    @property
    def is_wide(self) -> bool:
        """Whether light may be above white."""
        return self.transfer in WIDE_TRANSFERS or (self.mapping is not None and self.mapping.is_wide)


def luminance(linear: ArrayLike) -> NDArray[np.floating]:
    """Return the luminance (...,) of linear Rec.709 colours (..., 3)."""
    return vectors("linear", linear) @ LUMINANCE


def decode(encoded: ArrayLike, transfer: Transfer) -> NDArray[np.floating]:
    """Return linear light of code values in [0, 1]; odd about zero, so that excursions survive.

    srgb: IEC 61966-2-1. bt709: inverse of the camera curve of ITU-R BT.709-6. bt1886: display gamma 2.4.
    linear: as it is, also what is not finite, as in maps of distances. The others, of HDR television and of cameras'
    log recordings, stand above; below black, log curves go on as they are defined.
    """
    return _converted("encoded", encoded, transfer, 0)


def encode(linear: ArrayLike, transfer: Transfer) -> NDArray[np.floating]:
    """Return code values of linear light, the inverse of `decode`; not clipped."""
    return _converted("linear", linear, transfer, 1)


def _converted(name: str, values: ArrayLike, transfer: Transfer, way: Literal[0, 1]) -> NDArray[np.floating]:
    """Return values that a curve decodes (way 0) or encodes (1)."""
    v = (real if transfer == "linear" else numbers)(name, values)
    v = v if np.issubdtype(v.dtype, np.floating) else v.astype(np.float64)
    if transfer in _DISPLAY_CURVES:
        found = np.copysign(_DISPLAY_CURVES[transfer][way](np.abs(v)), v)
    elif transfer in WIDE_TRANSFERS:
        found = _wide(v.astype(np.float64), transfer, way)
    else:
        raise ParameterError(f"transfer - unknown curve (got {transfer!r}) - take one of {', '.join(TRANSFERS)}")
    return found.astype(v.dtype, copy=False)


def _wide(values: Array, transfer: WideTransfer, way: Literal[0, 1]) -> Array:
    """Return float64 values that a curve above white decodes (way 0) or encodes (1), not clipped."""
    size = np.abs(values)
    if transfer in _LOG_BASES:
        base, end = _LOG_BASES[transfer], math.log(_LOG_BASES[transfer])
        return np.copysign(np.log1p(size * (base - 1.0)) / end if way else np.expm1(size * end) / (base - 1.0), values)
    models = colour_science().models
    with np.errstate(all="ignore"):  # both pieces of a curve are computed everywhere, and one is taken
        if transfer in _LOG_NAMES:
            of_log = (models.log_decoding, models.log_encoding)[way]
            return np.asarray(of_log(values, _LOG_NAMES[transfer]), np.float64)
        if transfer == "pq":
            to_light, to_code, white = models.eotf_ST2084, models.eotf_inverse_ST2084, _WHITE_CD_M2
            size = size if way else np.minimum(size, 1.0)
        else:
            to_light, to_code = models.oetf_inverse_BT2100_HLG, models.oetf_BT2100_HLG
            white = float(to_light(_HLG_WHITE))
        found = to_code(size * white) if way else to_light(size) / white
        return np.copysign(np.asarray(found, np.float64), values)


def decode_signal(signal: ArrayLike, spec: ColorSpec) -> NDArray[np.floating]:
    """Return the linear light, in the plate's primaries, of R'G'B' signals: 0 at black and 1 at white of its range.

    It is `decode`, but that curves which are defined on the file's codes are given these.
    """
    if spec.transfer not in ON_FILE_CODES:
        return decode(signal, spec.transfer)
    low, span = _file_codes(spec)
    return decode(low + span * numbers("signal", signal), spec.transfer)


def encode_signal(linear: ArrayLike, spec: ColorSpec) -> NDArray[np.floating]:
    """Return the R'G'B' signals of linear light, the inverse of `decode_signal`; not clipped."""
    code = encode(linear, spec.transfer)
    if spec.transfer not in ON_FILE_CODES:
        return code
    low, span = _file_codes(spec)
    return np.asarray((code - low) / span, code.dtype)


def _file_codes(spec: ColorSpec, wanted: bool = True) -> tuple[float, float]:
    """Return offset and span of the plate's signals among the file's codes over full scale; (0, 1) unless `wanted`."""
    if not wanted:
        return 0.0, 1.0
    offset, span, _, _ = code_range(spec)
    peak = float((1 << spec.bits) - 1)
    return offset / peak, span / peak


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


# Cone responses of XYZ (Bradford; ICC.1:2022, annex E), in which white is adapted.
_CONES = np.array([(0.8951, 0.2664, -0.1614), (-0.7502, 1.7135, 0.0367), (0.0389, -0.0685, 1.0296)])


def _xyz_from_rgb(xy: ArrayLike) -> NDArray[np.float64]:
    """Return the (3, 3) matrix from linear RGB to XYZ, white at Y = 1 (SMPTE RP 177-1993).

    xy: chromaticities of red, green, blue and white, (8,) or (4, 2).
    """
    known = np.asarray(xy, np.float64).reshape(4, 2)
    primaries, white = known[:3], known[3]
    columns = np.stack([primaries[:, 0], primaries[:, 1], 1.0 - primaries.sum(axis=1)]) / primaries[:, 1]
    whitest = np.array([white[0], white[1], 1.0 - white.sum()]) / white[1]
    return np.asarray(columns * np.linalg.solve(columns, whitest), np.float64)


def rec709_from_xyz(white: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (3, 3) matrix from XYZ whose white is `white` (3,) to linear Rec.709; that white becomes (1, 1, 1)."""
    own = _xyz_from_rgb(REC709_XY)
    cones = (_CONES @ own.sum(axis=1)) / (_CONES @ white)
    return np.linalg.solve(own, np.linalg.solve(_CONES, cones[:, None] * _CONES)).astype(np.float64)


def rec709_from_chromaticities(xy: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (3, 3) matrix to linear Rec.709 from light whose red, green, blue and white have (x, y), (4, 2).

    White becomes (1, 1, 1). Raises `LinAlgError` where the primaries lie on a line.
    """
    own = _xyz_from_rgb(xy)
    return np.asarray(rec709_from_xyz(own.sum(axis=1)) @ own, np.float64)


def rec709_from_plate(primaries: Primaries) -> NDArray[np.float64]:
    """Return the (3, 3) matrix from the linear light of a plate, in its own primaries, to linear Rec.709.

    White stays white. Colours outside the gamut of Rec.709 get a negative channel. The primaries of standard definition
    are taken as those of Rec.709, which they all but are.
    """
    if primaries == "bt709":
        return np.eye(3)
    own = XY_BY_NAME["rec2020"]
    if primaries != "bt2020":
        camera = colour_science().RGB_COLOURSPACES[_CAMERA_GAMUTS[primaries]].primaries
        own = (*np.asarray(camera, np.float64).ravel(), *own[6:])
    return np.linalg.solve(_xyz_from_rgb(REC709_XY), _xyz_from_rgb(own)).astype(np.float64)


def in_rec709(linear: NDArray[np.floating], spec: ColorSpec) -> NDArray[np.floating]:
    """Return the linear Rec.709 light (..., 3) of a plate's linear light (..., 3), or of its mapped signals."""
    if spec.mapping is not None:
        low, span = _file_codes(spec, spec.mapping.on_file_codes)
        return np.asarray(spec.mapping.to_light(low + span * linear), linear.dtype)
    if spec.gamut == "bt709":
        return linear
    return np.asarray(linear @ rec709_from_plate(spec.gamut).T, linear.dtype)


def in_plate_primaries(linear: NDArray[np.floating], spec: ColorSpec) -> NDArray[np.floating]:
    """Return linear Rec.709 light (..., 3) in the plate's primaries, the inverse of `in_rec709`."""
    if spec.mapping is not None:
        low, span = _file_codes(spec, spec.mapping.on_file_codes)
        return np.asarray((spec.mapping.to_values(linear) - low) / span, linear.dtype)
    if spec.gamut == "bt709":
        return linear
    return np.asarray(linear @ np.linalg.inv(rec709_from_plate(spec.gamut)).T, linear.dtype)


@shared(keep=16)
def brightest_light(spec: ColorSpec) -> float:
    """Return the linear light of the brightest code that is written."""
    if spec.mapping is not None:
        return float(in_rec709(np.ones(3), spec).max())
    return float(decode_signal(np.ones(()), spec))


LEAST_CHANGE = 0.001
"""Relative change of light that no picture shows, whatever its codes: half a code of 10 bits at white."""
_SIGNALS = np.linspace(0.05, 1.0, 96)
"""Signals at which curves are compared: below them a code is a larger part of the light than at white."""


@functools.cache
def unseen_changes(spec: ColorSpec) -> NDArray[np.float32]:
    """Return, for each code of a plate of 8 to 16 bits, the relative change of light that moves no code up to it by
    more than half a step, `LEAST_CHANGE` at least. The darker a code, the more of its light a step is.
    """
    growth = np.gradient(np.log(np.maximum(decode_signal(_SIGNALS, spec), 1e-9)), _SIGNALS)
    low, span, _, _ = code_range(spec)
    signal = (np.arange(1 << spec.bits) - low) / span
    up_to = np.interp(signal, _SIGNALS, np.minimum.accumulate(growth))
    return np.maximum(0.5 / span * up_to, LEAST_CHANGE).astype(np.float32)


def code_range(spec: ColorSpec) -> tuple[float, float, float, float]:
    """Return (luma offset, luma span, chroma offset, chroma span) in code values of `spec.bits`.

    Y' = (code - luma offset)/luma span, C = (code - chroma offset)/chroma span (ITU-R BT.709-6 section 4.6).
    """
    scale = float(1 << (spec.bits - 8))
    if spec.full_range:
        peak = float((1 << spec.bits) - 1)
        return 0.0, peak, 128.0 * scale, peak
    return 16.0 * scale, 219.0 * scale, 128.0 * scale, 224.0 * scale
