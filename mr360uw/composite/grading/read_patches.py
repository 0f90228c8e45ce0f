# SPDX-License-Identifier: Apache-2.0
"""Reads patches of known colour from the frames of a plate, and the colour of its grade from these."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from mr360uw.color import ColorSpec
from mr360uw.composite.grading.colour_grade import NO_GRADE, ColourGrade, code_of
from mr360uw.composite.grading.patch_solve import (
    CODE_ERROR,
    Patch,
    PatchWater,
    Solved,
    solve_patches,
    solved_in_words,
)
from mr360uw.composite.grading.settings import MatchSettings, PatchSettings, number_words
from mr360uw.sphere import disc_directions, frame_from_direction
from mr360uw.types import Floats, Rectangle

PATCH_SAMPLES = 64
"""Pixels that are read of a patch, evenly over its disc."""
_ROUNDS = 6
"""Most solutions of patches in the water: the light of open water is averaged over pixels without the grade last found,
and two or three settle it."""
_NEARER = 0.9
"""Factor on the distances of patches for what an error of them does; longer ones may be beyond all sight."""
Waters = Callable[[ColourGrade, float], Sequence[PatchWater | None]]
"""The water before each patch, in a plate whose light is read without a grade, their distances times a factor."""


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


def patched_colour(
    settings: MatchSettings, shown: Sequence[FilePicture], waters: Waters | None = None
) -> tuple[ColourGrade, str]:
    """Return the colour of a plate's grade by its patches, and a line on what they tell.

    settings: with one patch or more; numbers that are given stay. shown: for each patch the frame that shows it.
    waters: None where no water is seen before any of them.
    """
    patches = [read_patch(frame, patch) for frame, patch in zip(shown, settings.patch, strict=True)]
    start, spec = settings.colour_over(NO_GRADE), shown[0].spec
    if waters is None:
        solved = solve_patches(patches, start, settings.open_keys, spec)
        return solved.colour, solved_in_words(solved, len(patches))

    def through(read_without: ColourGrade, stretch: float) -> Solved:
        seen = zip(patches, waters(read_without, stretch), strict=True)
        in_water = [replace(patch, water=water) for patch, water in seen]
        return solve_patches(in_water, start, settings.open_keys, spec)

    solved, read_without = through(start, 1.0), start
    for _ in range(_ROUNDS):
        if float(np.abs(solved.colour.numbers - read_without.numbers).max()) < 0.1 * CODE_ERROR:
            break
        read_without = solved.colour
        solved = through(read_without, 1.0)
    line = solved_in_words(solved, len(patches))
    if solved.told:
        first, nearer = solved.told[0], through(read_without, _NEARER).colour
        line += f"; were all a tenth nearer, {first} would be {number_words(getattr(nearer, first))}"
    return solved.colour, line


def read_patch(frame: FilePicture, patch: PatchSettings) -> Patch:
    """Return a patch as a frame shows it: the median code of its disc in each channel."""
    directions = disc_directions(patch.direction, math.radians(0.5 * patch.size_deg), PATCH_SAMPLES)
    height, width = frame.shape
    x, y = frame_from_direction(directions, width, height)
    column, row = x.astype(int) % width, np.clip(y.astype(int), 0, height - 1)
    first, last = int(row.min()), int(row.max())
    light = np.asarray(frame.linear(Rectangle(0, first, width, last - first + 1)))[row - first, column]
    red, green, blue = np.median(code_of(light, frame.spec), axis=0)
    return Patch((float(red), float(green), float(blue)), patch.reflected)
