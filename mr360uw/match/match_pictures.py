# SPDX-License-Identifier: Apache-2.0
"""Pictures of a match: the plate's caustics on the floor beside ours, and their spectra. North (-z) is at the top."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mr360uw.match.pattern_measures import FloorPattern
from mr360uw.types import Floats

Codes = NDArray[np.uint8]

_SIDE = 320
"""Pixels of one square."""
_LABEL_ROWS, _GAP = 26, 6
_BRIGHTEST = 3.0
"""Standard deviations of the plate's light above its mean that are white; as many below are black."""
_FINEST_M = 0.25
"""Wavelength [m] at the edge of the spectra."""
_DECADES = 3.0
"""Powers of ten of a spectrum between black and white."""
_NAMES = ("plate", "ours before", "ours after")


def floor_pictures(shown: Sequence[FloorPattern]) -> Codes:
    """Return the light of floors (plate, before, after) side by side, (H, W, 3), on one scale."""
    reach = _BRIGHTEST * max(float(np.std(shown[0].relative)), 1e-6)
    grey = [np.clip(0.5 + 0.5 * one.relative / reach, 0.0, 1.0) for one in shown]
    labels = [f"{name}, contrast {100 * one.measures.contrast:.0f} %" for name, one in zip(_NAMES, shown, strict=False)]
    return _side_by_side(grey, labels)


def spectrum_pictures(shown: Sequence[FloorPattern], pixel_m: float) -> Codes:
    """Return the power over wave vectors of travel, long waves in the middle, as logarithms on one scale."""
    parts = []
    top = max(float(shown[0].measures.spectrum.max()), 1e-30)
    for one in shown:
        power = one.measures.spectrum
        n = len(power)
        half = int(np.clip(round(n * pixel_m / _FINEST_M), 2, n // 2 - 1))
        middle = slice(n // 2 - half, n // 2 + half + 1)
        level = np.log10(np.maximum(power[middle, middle], 1e-30) / top)
        parts.append(np.clip(1.0 + level / _DECADES, 0.0, 1.0))
    labels = [
        f"{name}, {one.measures.scale_m:.2f} m to {one.measures.azimuth_deg:.0f} deg"
        for name, one in zip(_NAMES, shown, strict=False)
    ]
    return _side_by_side(parts, labels)


def _side_by_side(parts: Sequence[Floats], labels: Sequence[str]) -> Codes:
    """Return pictures (n, n) of 0 to 1 as squares in a row, (H, W, 3), each with its label below."""
    import cv2

    sheet = np.full((_SIDE + _LABEL_ROWS, len(parts) * (_SIDE + _GAP) - _GAP, 3), 24, np.uint8)
    for number, (part, label) in enumerate(zip(parts, labels, strict=True)):
        left = number * (_SIDE + _GAP)
        codes = np.asarray(255.0 * part + 0.5, np.float32).astype(np.uint8)
        square = cv2.resize(codes, (_SIDE, _SIDE), interpolation=cv2.INTER_LINEAR)
        sheet[:_SIDE, left : left + _SIDE] = square[..., None]
        at = left + 4, _SIDE + _LABEL_ROWS - 8
        cv2.putText(sheet, label, at, cv2.FONT_HERSHEY_SIMPLEX, 0.5, (235, 235, 235), 1, cv2.LINE_AA)
    return sheet
