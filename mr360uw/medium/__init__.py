# SPDX-License-Identifier: Apache-2.0
"""The water between things: waters, sensors, bands, scattering."""

from __future__ import annotations

import importlib
from typing import Any

_HOME = {
    "Bands": "spectral_bands",
    "bands": "spectral_bands",
    "LightField": "transfer",
    "Medium": "medium",
    "MODES": "medium",
    "PlateProfile": "plate",
    "Sensor": "sensor",
    "Water": "water",
    "JERLOV_TYPES": "water",
    "cameras": "sensor",
    "WaterSettings": "settings",
    "compress_gamut": "gamut",
    "exposure_change": "exposure",
    "fit_gain": "plate",
    "WaterFit": "waterfit",
    "fit_water": "waterfit",
    "illuminant": "sensor",
    "spectral_model": "models",
    "picture_change": "exposure",
    "reflectance": "upsampling",
    "steady_gain": "exposure",
    "multiple_scattering": "closed_form",
}

__all__ = sorted(_HOME)  # noqa: PLE0605 - resolved by __getattr__ at first use


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)
    globals()[name] = value
    return value
