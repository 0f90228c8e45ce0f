# SPDX-License-Identifier: Apache-2.0
"""The `[shafts]` table of a scene."""

from __future__ import annotations

from typing import Literal

from mr360uw.parameters import Parameters, parameter

LEAST_NODES = 16
"""Least nodes around the sun."""
LEAST_CODES = 2.0
"""Change of 8-bit code values below which light in the water is left out. Twice as much: shafts that can be seen go."""
LONGEST_M = 500.0
"""Farthest [m] that shafts are followed: even the clearest water has dimmed them to nothing before."""


class ShaftSettings(Parameters):
    """Light in the water: shafts under waves, shadows of bodies in the water, beams of lamps."""

    mode: Literal["auto", "on", "off"] = parameter(
        "auto", "auto: where enough of the sun's beam is left, or lamps shine; on: however little is left; off: none"
    )
    strength: float = parameter(1.0, "factor on them; 1 is physical, 0 is off", unit="1", low=0.0, high=100.0)
    on_plate: bool = parameter(
        False, "shafts of the waves in all of the plate, which may show its own; those before objects are always drawn"
    )
    range_m: float = parameter(
        100.0, "distance from the camera up to which they are seen", unit="m", low=0.0, high=LONGEST_M,
        internal="the water, which dims them",
    )  # fmt: skip
    resolution: int = parameter(
        1024,
        "nodes around the sun, 3/8 as many from it to its antipode; fewer in small frames",
        low=LEAST_NODES,
        high=2048,
        internal="draw.quality",
    )
    slices: int = parameter(32, "slices of the grid over distance", low=4, high=512, internal="draw.quality")

    @property
    def least_codes(self) -> float:
        """Change of an 8-bit code value from which on they are drawn."""
        return LEAST_CODES if self.mode == "auto" else 0.0

    @property
    def why_off(self) -> str:
        """The reason why there is nothing to draw; "" where there may be."""
        if self.mode == "off":
            return "switched off"
        return "shafts.strength is 0" if self.strength == 0.0 else "shafts.range_m is 0" if self.range_m == 0.0 else ""
