# SPDX-License-Identifier: Apache-2.0
"""Dives whose light is what a composite takes it for: level grey sand under an even, hazy sky.

Relief, rocks and grass shade and cover sand; white sand lights the water from below, by way of the surface; a clear
sky's glow about the sun clips.
"""

from __future__ import annotations

from typing import Any

from mr360uw.sample import DiveSettings

LEVEL_SAND: dict[str, Any] = {
    "relief": 0.0, "rocks": 0.0, "grass": 0.0, "sand_albedo": 0.09, "sky": "even", "sun_share": 0.7,
}  # fmt: skip


def over_sand(**options: Any) -> DiveSettings:
    """Return the settings of such a dive."""
    return DiveSettings(**(LEVEL_SAND | options))
