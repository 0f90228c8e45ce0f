# SPDX-License-Identifier: Apache-2.0
"""Dives over level sand, for tests that know its light: relief shades it, and rocks and grass cover it."""

from __future__ import annotations

from typing import Any

from mr360uw.sample import DiveSettings

LEVEL_SAND = {"relief": 0.0, "rocks": 0.0, "grass": 0.0}


def over_sand(**options: Any) -> DiveSettings:
    """Return the settings of a dive over level sand."""
    return DiveSettings(**(LEVEL_SAND | options))
