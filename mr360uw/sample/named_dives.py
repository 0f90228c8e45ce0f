# SPDX-License-Identifier: Apache-2.0
"""Named dives: parameters of `DiveSettings` that differ from their defaults."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from typing import Any

from mr360uw.errors import ParameterError

PRESETS: Mapping[str, Mapping[str, Any]] = {
    "reef": {
        "depth_m": 6.0, "floor_m": 9.0, "water": "IB", "sun_elevation_deg": 62.0, "wind_m_s": 4.0, "rocks": 0.34,
        "grass": 0.05, "speed_m_s": 0.4, "yaw_deg_s": 2.0, "bob_m": 0.05, "stops": 0.5, "noise": 0.5,
    },
    "lagoon": {
        "depth_m": 1.5, "floor_m": 3.2, "water": "1C", "sun_elevation_deg": 70.0, "sun_azimuth_deg": -60.0,
        "wind_m_s": 2.0, "rocks": 0.02, "grass": 0.0, "sand_contrast": 0.7, "speed_m_s": 0.2, "bob_m": 0.03,
        "stops": 1.0, "noise": 0.3,
    },
    "blue": {
        "depth_m": 12.0, "floor_m": 60.0, "water": "IA", "sun_elevation_deg": 48.0, "sun_azimuth_deg": 20.0,
        "wind_m_s": 6.0, "rocks": 0.0, "grass": 0.0, "yaw_deg_s": -3.0, "bob_m": 0.2, "stops": 1.0, "noise": 0.5,
    },
    "coast": {
        "depth_m": 3.0, "floor_m": 5.0, "water": "3C", "sky": "overcast", "wind_m_s": 5.0, "rocks": 0.2, "grass": 0.3,
        "speed_m_s": 0.3, "bob_m": 0.1, "stops": 1.5, "noise": 1.0,
    },
    "green": {
        "depth_m": 5.0, "floor_m": 7.5, "water": "5C", "sun_elevation_deg": 45.0, "sun_azimuth_deg": 120.0,
        "wind_m_s": 3.0, "rocks": 0.1, "grass": 0.6, "speed_m_s": -0.3, "stops": 1.5, "noise": 1.0,
    },
    "dusk": {
        "depth_m": 2.5, "floor_m": 5.5, "water": "II", "sun_elevation_deg": 9.0, "sun_azimuth_deg": 15.0,
        "wind_m_s": 2.5, "rocks": 0.12, "grass": 0.15, "yaw_deg_s": 1.5, "stops": 0.5, "noise": 3.0,
    },
    "storm": {
        "depth_m": 8.0, "floor_m": 14.0, "water": "III", "sky": "overcast", "wind_m_s": 13.0, "rocks": 0.25,
        "grass": 0.0, "speed_m_s": 0.2, "bob_m": 0.4, "stops": 2.0, "noise": 2.0,
    },
}  # fmt: skip
"""Dives that look different: bright coral sand, a shallow lagoon, open ocean, coasts with more and more in the water, a
low sun, and a gale under clouds."""


def preset_of(name: str) -> dict[str, Any]:
    """Return the parameters of a named dive; raise `ParameterError` for other names."""
    if name not in PRESETS:
        near = difflib.get_close_matches(name, PRESETS, 1)
        advice = f"did you mean '{near[0]}'?" if near else f"take one of {', '.join(PRESETS)}"
        raise ParameterError(f"preset - no such dive (got {name!r:.40}) - {advice}")
    return dict(PRESETS[name])
