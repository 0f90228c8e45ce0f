# SPDX-License-Identifier: Apache-2.0
"""Finds the colour of a plate's grade: what its patches tell, where its codes end, and how its water is bent."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from mr360uw.color import ColorSpec
from mr360uw.composite.grading.code_ends import code_ends
from mr360uw.composite.grading.colour_grade import NO_GRADE, ColourGrade, code_of
from mr360uw.composite.grading.patch_solve import Patch, solve_patches, solved_in_words
from mr360uw.composite.grading.settings import MatchSettings, PatchSettings
from mr360uw.composite.grading.water_shape import WaterView, bent_by, with_number
from mr360uw.sphere import direction_from_angles, disc_directions, frame_from_direction
from mr360uw.types import Floats, Rectangle

PATCH_SAMPLES = 64
"""Pixels that are read of a patch, evenly over its disc."""
_ROWS, _COLUMNS = 192, 512
"""Pixels of a frame whose codes are counted: enough for a pile of a thousandth. Time grows with their product."""
_NADIR = 1.0 / 6.0
"""Fraction of the rows at the bottom that are left out: the diver, the mount, a patch over them."""


class Picture(Protocol):
    """A plate's frame, read as the file has it."""

    @property
    def spec(self) -> ColorSpec:
        """How its codes are read."""

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""

    def linear(self, rectangle: Rectangle) -> Floats:
        """Return a part of it as linear light (h, w, 3)."""


def found_colour(
    frames: Sequence[Picture], settings: MatchSettings, shown: Sequence[Picture], water: WaterView | None = None
) -> tuple[ColourGrade, tuple[str, ...]]:
    """Return the colour of a plate's grade, and one line on each source of it.

    frames: of the clip. settings: numbers that are given stay; the others are found, or change nothing. shown: for each
    patch of the settings, the frame that shows it. water: of the frames, where the scene has a solved medium.
    """
    keys, given, lines = list(settings.open_keys), settings.colour_over(NO_GRADE), []
    if settings.patch:
        patches = [read_patch(frame, patch) for frame, patch in zip(shown, settings.patch, strict=True)]
        solved = solve_patches(patches, given, keys, shown[0].spec)
        given, keys = solved.colour, [key for key in keys if key not in solved.told]
        lines.append(solved_in_words(solved, len(patches)))
    ends = code_ends([_some_codes(frame) for frame in frames]) if {"black", "white"} & set(keys) else (None, None)
    for name, end in zip(("black", "white"), ends, strict=True):
        if end is not None and name in keys:
            given = with_number(given, name, end)
            keys.remove(name)
            lines.append(f"{name} {end:.3f}: codes end there")
    bent = None if water is None else bent_by(water, given, keys)
    if bent is not None:
        name, value = bent
        given = with_number(given, name, value)
        keys.remove(name)
        lines.append(f"{name} {value:.3f}: with it open water is as the medium says at all elevations")
    if keys:
        lines.append(f"{', '.join(keys)}: not told by this plate, taken as unchanged")
    return given, tuple(lines)


def read_patch(frame: Picture, patch: PatchSettings) -> Patch:
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


def _some_codes(frame: Picture) -> Floats:
    """Return the R'G'B' (n, 3) of pixels that are spread evenly over a frame, but for its lowest rows."""
    height, width = frame.shape
    rows = np.unique(np.linspace(0, height * (1.0 - _NADIR) - 1, _ROWS).astype(int))
    columns = np.unique(np.linspace(0, width - 1, _COLUMNS).astype(int))
    light = [np.asarray(frame.linear(Rectangle(0, int(row), width, 1)))[0, columns] for row in rows]
    return np.asarray(code_of(np.concatenate(light), frame.spec))
