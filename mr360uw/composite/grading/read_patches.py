# SPDX-License-Identifier: Apache-2.0
"""Reads patches of known colour from the frames of a plate, and the colour of its grade from these."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from mr360uw.color import ColorSpec
from mr360uw.composite.grading.colour_grade import NO_GRADE, ColourGrade, code_of
from mr360uw.composite.grading.patch_solve import Patch, solve_patches, solved_in_words
from mr360uw.composite.grading.settings import MatchSettings, PatchSettings
from mr360uw.sphere import direction_from_angles, disc_directions, frame_from_direction
from mr360uw.types import Floats, Rectangle

PATCH_SAMPLES = 64
"""Pixels that are read of a patch, evenly over its disc."""


class FilePicture(Protocol):
    """A plate's frame, read as the file has it."""

    @property
    def spec(self) -> ColorSpec:
        """How its codes are read."""

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""

    def linear(self, rectangle: Rectangle) -> Floats:
        """Return a part of it as linear light (h, w, 3)."""


def patched_colour(settings: MatchSettings, shown: Sequence[FilePicture]) -> tuple[ColourGrade, str]:
    """Return the colour of a plate's grade by its patches, and a line on what they tell.

    settings: with one patch or more; numbers that are given stay. shown: for each patch the frame that shows it.
    """
    patches = [read_patch(frame, patch) for frame, patch in zip(shown, settings.patch, strict=True)]
    solved = solve_patches(patches, settings.colour_over(NO_GRADE), settings.open_keys, shown[0].spec)
    return solved.colour, solved_in_words(solved, len(patches))


def read_patch(frame: FilePicture, patch: PatchSettings) -> Patch:
    """Return a patch as a frame shows it: the median code of its disc in each channel."""
    middle = direction_from_angles(math.radians(patch.azimuth_deg), math.radians(patch.elevation_deg))
    directions = disc_directions(middle, math.radians(0.5 * patch.size_deg), PATCH_SAMPLES)
    height, width = frame.shape
    x, y = frame_from_direction(directions, width, height)
    column, row = x.astype(int) % width, np.clip(y.astype(int), 0, height - 1)
    first, last = int(row.min()), int(row.max())
    light = np.asarray(frame.linear(Rectangle(0, first, width, last - first + 1)))[row - first, column]
    red, green, blue = np.median(code_of(light, frame.spec), axis=0)
    return Patch((float(red), float(green), float(blue)), patch.reflected)
