# SPDX-License-Identifier: Apache-2.0
"""Presets: named sets of values that suit one kind of dive, as a start to tune from."""

from __future__ import annotations

from types import MappingProxyType
from typing import Any

PRESETS: MappingProxyType[str, MappingProxyType[str, Any]] = MappingProxyType(
    {
        "tropical noon": MappingProxyType(
            {"water.type": "IB", "water.visibility_m": None, "sea.wind_speed": 4.0, "caustics.enabled": True,
             "caustics.sun_half_angle_rad": 0.00465}
        ),
        "tropical, evening": MappingProxyType(
            {"water.type": "IB", "water.visibility_m": None, "sea.wind_speed": 2.0, "caustics.enabled": True,
             "caustics.sun_half_angle_rad": 0.02}
        ),
        "temperate overcast": MappingProxyType(
            {"water.type": "1C", "water.visibility_m": None, "sea.wind_speed": 7.0, "caustics.enabled": False}
        ),
        "harbour": MappingProxyType(
            {"water.type": "harbour", "water.visibility_m": None, "sea.wind_speed": 2.0, "caustics.enabled": False}
        ),
    }
)  # fmt: skip
"""Values of dotted keys, by the preset's name; None: as it is by default."""
