# SPDX-License-Identifier: Apache-2.0
"""The `[snow]` table of a scene."""

from __future__ import annotations

from typing import Literal

from pydantic import model_validator

from mr360uw.parameters import Parameters, parameter

SnowPhase = Literal["grain", "petzold", "isotropic"]

_CARRIED = "particles would jump: they are where it has carried them since time 0"
_SIZES = "particles would change places between classes of size"


class SnowSettings(Parameters):
    """Marine snow: particles suspended in the water. Off by default."""

    enabled: bool = parameter(False, "whether particles are drawn")
    amount: float = parameter(
        1.0, "factor on the number of particles that the water's scattering gives", unit="1", low=0.0, high=1000.0
    )
    exponent: float = parameter(
        3.58, "of the size spectrum dN/dd = A d^-exponent; 4: equal volumes in every octave, 3: a bloom",
        unit="1", low=2.5, high=5.0, fixed=_SIZES,
    )  # fmt: skip
    smallest_mm: float = parameter(0.5, "least diameter that is drawn", unit="mm", low=0.05, high=20.0, fixed=_SIZES)
    largest_mm: float = parameter(4.0, "greatest diameter", unit="mm", low=0.1, high=50.0, fixed=_SIZES)
    nearest_m: float = parameter(
        0.15, "distance from the camera within which there are none: its housing", unit="m", low=0.01, high=10.0
    )
    range_m: float = parameter(4.0, "distance beyond which there are none", unit="m", low=0.1, high=50.0)
    albedo: float = parameter(0.5, "fraction of the light on a particle that it scatters", unit="1", low=0.0, high=1.0)
    phase: SnowPhase = parameter(
        "grain", "where it scatters: back, as a white ball; forwards, as the water's particles; to all sides"
    )
    current_m_s: tuple[float, float, float] = parameter(
        (0.0, 0.0, 0.0), "velocity (right, up, back) of the water", unit="m/s", fixed=_CARRIED
    )
    settling: float = parameter(
        1.0, "factor on the speed at which aggregates sink", unit="1", low=0.0, high=1000.0, fixed=_CARRIED
    )
    orbits: bool = parameter(True, "whether the waves of the sea move the particles")
    aperture_mm: float = parameter(
        0.6, "diameter of the lens's entrance pupil, for defocus; 0: all is sharp", unit="mm", low=0.0, high=50.0
    )
    focus_m: float = parameter(1.0, "distance that is in focus", unit="m", low=0.05, high=1000.0)
    seed: int = parameter(1, "seed of the particles' places and sizes", low=0)

    @model_validator(mode="after")
    def _ascending(self) -> SnowSettings:
        if self.largest_mm <= self.smallest_mm:
            raise ValueError(
                f"largest_mm - must be above smallest_mm (got {self.largest_mm:g} and {self.smallest_mm:g}) - raise it"
            )
        if self.range_m <= self.nearest_m:
            raise ValueError(
                f"range_m - must be above nearest_m (got {self.range_m:g} and {self.nearest_m:g}) - raise it"
            )
        return self
