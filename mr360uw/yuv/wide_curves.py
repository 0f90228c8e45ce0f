# SPDX-License-Identifier: Apache-2.0
"""Transfer curves that hold light far above white: HDR television, and the log recordings of cameras.

    pq       SMPTE ST 2084, ITU-R BT.2100-2: display light up to 10 000 cd/m^2; white is 203 cd/m^2 (ITU-R BT.2408)
    hlg      ITU-R BT.2100-2: scene light; white is the light at 75 % of the signal (ITU-R BT.2408)
    slog3    Sony S-Log3        vlog   Panasonic V-Log        dlog   DJI D-Log      white reflects 100 %
    protune, gplog, gplog2      GoPro's Protune Flat, GP-Log and GP-Log2: log(1 + (b - 1) light)/log b, with base b of
                                113, 400 and 600; white is the brightest light that they hold

The curves are those of colour-science; GoPro's are the formula above. White is linear light of 1. PQ ends at its
10 000 cd/m^2, 49 times white; the others go on as their formulas do.
"""

from __future__ import annotations

import functools
import math
import warnings
from collections.abc import Callable
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

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


def wide_decode(code: Array, transfer: WideTransfer) -> Array:
    """Return the linear light of signals, white = 1; below black the curves go on, down to negative light."""
    if transfer in _LOG_BASES:
        base = _LOG_BASES[transfer]
        return _odd(lambda v: np.expm1(v * math.log(base)) / (base - 1.0), code)
    models = colour_science().models
    with np.errstate(all="ignore"):  # both pieces of a curve are computed everywhere, and one is taken
        if transfer == "pq":
            return _odd(lambda v: models.eotf_ST2084(np.minimum(v, 1.0)) / _WHITE_CD_M2, code)
        if transfer == "hlg":
            return _odd(lambda v: models.oetf_inverse_BT2100_HLG(v) / _hlg_white(), code)
        return np.asarray(models.log_decoding(code, _LOG_NAMES[transfer]), np.float64)


def wide_encode(linear: Array, transfer: WideTransfer) -> Array:
    """Return the signals of linear light, white = 1: the inverse of `wide_decode`, not clipped."""
    if transfer in _LOG_BASES:
        base = _LOG_BASES[transfer]
        return _odd(lambda x: np.log1p(x * (base - 1.0)) / math.log(base), linear)
    models = colour_science().models
    with np.errstate(all="ignore"):
        if transfer == "pq":
            return _odd(lambda x: models.eotf_inverse_ST2084(x * _WHITE_CD_M2), linear)
        if transfer == "hlg":
            return _odd(lambda x: models.oetf_BT2100_HLG(x * _hlg_white()), linear)
        return np.asarray(models.log_encoding(linear, _LOG_NAMES[transfer]), np.float64)


@functools.cache
def wide_primaries(name: str) -> Array:
    """Return the chromaticities (3, 2) of a camera's red, green and blue, by colour-science's name of its gamut."""
    return np.asarray(colour_science().RGB_COLOURSPACES[name].primaries, np.float64)


def _odd(curve: Callable[[Array], Any], values: Array) -> Array:
    """Return a curve of values >= 0, continued through black as an odd function."""
    return np.copysign(np.asarray(curve(np.abs(values)), np.float64), values)


@functools.cache
def _hlg_white() -> float:
    return float(colour_science().models.oetf_inverse_BT2100_HLG(_HLG_WHITE))


@functools.cache
def colour_science() -> Any:
    """Return the package colour-science, imported at the first call: it takes about a second."""
    with warnings.catch_warnings(), np.printoptions():  # it changes how NumPy prints arrays, for the whole process
        warnings.simplefilter("ignore")  # it warns about optional packages
        import colour
    return colour
