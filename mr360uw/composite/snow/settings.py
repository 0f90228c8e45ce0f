# SPDX-License-Identifier: Apache-2.0
"""The `[snow]` table of a scene."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from mr360uw.parameters import Parameters, advanced, parameter

Diameter = Annotated[float, Field(ge=0.05, le=50.0)]
SnowPhase = Literal["grain", "petzold", "isotropic"]

NEAREST_M = 0.15
"""Distance from the camera within which there are no particles: its housing."""
_CARRIED = "particles would jump: they are where it has carried them since time 0"
_SIZES = "particles would change places between classes of size"


class SnowSettings(Parameters):
    """Marine snow: particles suspended in the water. Off by default."""

    amount: float = parameter(
        0.0, "number of particles over what the water's scattering gives; 0: none", unit="1", low=0.0, high=1000.0
    )
    exponent: float = advanced(
        3.58, "of the size spectrum dN/dd = A d^-exponent; 4: equal volumes in every octave, 3: a bloom",
        unit="1", low=2.5, high=5.0, fixed=_SIZES,
    )  # fmt: skip
    sizes_mm: tuple[Diameter, Diameter] = advanced(
        (0.5, 4.0), "least and greatest diameter that is drawn", unit="mm", fixed=_SIZES
    )
    range_m: float = advanced(4.0, "distance beyond which there are none", unit="m", low=0.2, high=50.0)
    albedo: float = advanced(
        0.5, "fraction of the light on a particle that it scatters", unit="1", low=0.0, high=1.0, internal="snow.amount"
    )
    phase: SnowPhase = parameter(
        "grain", "where it scatters: back, as a white ball; forwards, as the water's particles; to all sides",
        internal="comparisons",
    )  # fmt: skip
    current_m_s: tuple[float, float, float] = parameter(
        (0.0, 0.0, 0.0), "velocity (right, up, back) of the water", unit="m/s", fixed=_CARRIED
    )

    @model_validator(mode="after")
    def _ascending(self) -> SnowSettings:
        if self.sizes_mm[1] <= self.sizes_mm[0]:
            raise ValueError(f"sizes_mm - must ascend (got {list(self.sizes_mm)}) - sort them")
        return self
