# SPDX-License-Identifier: Apache-2.0
"""The `[shafts]` table of a scene."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from mr360uw.medium.models import CLOSED_FORMS
from mr360uw.parameters import Parameters, parameter

MeanCosine = Annotated[float, Field(ge=-0.95, le=0.99)]

LEAST_NODES = 16
"""Least nodes around the sun."""
LONGEST_M = 500.0
"""Farthest [m] that shafts are followed: even the clearest water has dimmed them to nothing before."""


class ShaftSettings(Parameters):
    """Light in the water: shafts under waves, shadows of bodies in the water, beams of lamps."""

    mode: Literal["auto", "on", "off"] = parameter(
        "auto", "auto: where enough of the sun's beam is left, or lamps shine; on: however little is left; off: none"
    )
    strength: float = parameter(1.0, "factor on them; 1 is physical, 0 is off", unit="1", low=0.0, high=100.0)
    phase: Literal["water"] | MeanCosine = parameter(
        "water", "how they are turned towards the camera: as by the water, or by Henyey-Greenstein of this mean cosine",
        unit="1", fixed="water has one phase function",
    )  # fmt: skip
    on_plate: bool = parameter(
        False, "shafts of the waves in all of the plate, which may show its own; those before objects are always drawn"
    )
    whole: bool = parameter(
        False, "for water.mode kd, kd+ and rgb: before objects all of the beam's light scattered once, not its change"
    )
    range_m: float = parameter(100.0, "distance from the camera up to which they are seen", unit="m", low=0.0,
                               high=LONGEST_M)  # fmt: skip
    threshold: float = parameter(
        2.0, "change of 8-bit code values below which auto leaves them out", unit="1", low=0.0, high=255.0
    )
    resolution: int = parameter(
        1024,
        "nodes around the sun, 3/8 as many from it to its antipode; fewer in small frames",
        low=LEAST_NODES,
        high=2048,
    )
    slices: int = parameter(32, "slices of the grid over distance", low=4, high=512)

    def check(self, water_mode: str) -> None:
        """Raise `ValueError` where the water's mode has all of the beam's light in its veil already."""
        if self.whole and water_mode not in CLOSED_FORMS:
            raise ValueError(
                f"shafts.whole - the veil has the beam's light already (got water.mode {water_mode!r}) - take one of "
                f"{', '.join(CLOSED_FORMS)}, or remove it"
            )

    @property
    def least_codes(self) -> float:
        """Change of an 8-bit code value from which on they are drawn."""
        return self.threshold if self.mode == "auto" else 0.0

    @property
    def why_off(self) -> str:
        """The reason why there is nothing to draw; "" where there may be."""
        if self.mode == "off":
            return "switched off"
        return "shafts.strength is 0" if self.strength == 0.0 else "shafts.range_m is 0" if self.range_m == 0.0 else ""
