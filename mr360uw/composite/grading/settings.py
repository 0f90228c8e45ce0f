# SPDX-License-Identifier: Apache-2.0
"""The `[match]` table of a scene."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from mr360uw.parameters import Parameters, parameter

_ONE_LOOK = "a clip has one look"


class MatchSettings(Parameters):
    """Softness and sharpening of the plate, which bodies are given too."""

    enabled: bool = parameter(True, "whether bodies are given any of the plate's look", fixed=_ONE_LOOK)
    softness: Literal["auto"] | Annotated[float, Field(ge=0.0, le=10.0)] = parameter(
        "auto", "standard deviation of the blur of bodies; auto: as the plate shows it, where it does; 0: none",
        unit="px", fixed=_ONE_LOOK,
    )  # fmt: skip
    sharpening: float = parameter(
        0.0, "amount of an unsharp mask on bodies, where the plate was sharpened; 0: none", unit="1", low=0.0, high=5.0,
        fixed=_ONE_LOOK,
    )  # fmt: skip
    sharpening_px: float = parameter(
        1.0, "standard deviation of that mask", unit="px", above=0.0, high=10.0, fixed=_ONE_LOOK
    )

    @property
    def measures(self) -> bool:
        """Whether anything of the plate's look is measured."""
        return self.enabled and self.softness == "auto"

    @property
    def changes(self) -> bool:
        """Whether bodies may be changed."""
        return self.enabled and (self.softness != 0.0 or self.sharpening != 0.0)
