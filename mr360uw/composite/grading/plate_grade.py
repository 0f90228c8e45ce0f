# SPDX-License-Identifier: Apache-2.0
"""Look of a plate: what lens, camera and editor did to its pictures, as numbers that bodies can be given too."""

from __future__ import annotations

from dataclasses import dataclass

from mr360uw.composite.grading.colour_grade import NO_GRADE, ColourGrade
from mr360uw.composite.grading.settings import MatchSettings


@dataclass(frozen=True, slots=True)
class PlateGrade:
    """The look of a plate beside a picture drawn by this package; the defaults change nothing.

    softness_px: standard deviation [px] of the Gaussian blur. sharpening: amount of an unsharp mask of standard
    deviation sharpening_px, 0 none. columns: of the frames that these pixels are of; None: of any. colour: of the
    grade. found: one line on each part of the look that the plate shows, or does not tell.
    """

    softness_px: float = 0.0
    sharpening: float = 0.0
    sharpening_px: float = 1.0
    columns: int | None = None
    colour: ColourGrade = NO_GRADE
    found: tuple[str, ...] = ()

    @property
    def changes(self) -> bool:
        """Whether bodies with this look differ from bodies as drawn."""
        return self.reach_px > 0 or self.colour.changes

    @property
    def reach_px(self) -> int:
        """Distance [px] within which a pixel changes others."""
        return ceil_px(self.softness_px) + (ceil_px(self.sharpening_px) if self.sharpening > 0.0 else 0)

    def of_scene(self, settings: MatchSettings, columns: int, scale: float = 1.0) -> PlateGrade:
        """Return the look that a scene asks for in frames of `columns`, `scale` times as large as its plate.

        A softness in the settings stands in place of the plate's own; their pixels are those of the plate.
        """
        factor = 1.0 if self.columns is None else columns / self.columns
        softness_px = self.softness_px * factor if settings.softness == "auto" else settings.softness * scale
        colour = settings.colour_over(self.colour)
        return PlateGrade(softness_px, settings.sharpening, scale, columns, colour)


def ceil_px(deviation_px: float) -> int:
    """Return the radius [px] of a Gaussian kernel, cut off at three standard deviations; 0 for none."""
    return int(3.0 * deviation_px + 1.0) if deviation_px > 0.0 else 0
