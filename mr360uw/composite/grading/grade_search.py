# SPDX-License-Identifier: Apache-2.0
"""Finds the colour of a plate's grade: what its patches tell, where its codes end, and how its water is bent."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from mr360uw.color import ColorSpec
from mr360uw.composite.grading.code_ends import code_ends, ends_kept
from mr360uw.composite.grading.colour_grade import NO_GRADE, ColourGrade, code_of
from mr360uw.composite.grading.patch_solve import Patch, solve_patches, solved_in_words
from mr360uw.composite.grading.settings import MatchSettings, PatchSettings
from mr360uw.composite.grading.water_shape import WaterView, bent_by, black_by_colour, with_number
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
    codes = [_some_codes(frame) for frame in frames] if {"black", "white"} & set(keys) else None
    for name, value, why in _told_by_plate(codes, water, given, keys):
        if value is not None:
            given = with_number(given, name, value)
            keys.remove(name)
        lines.append(why)
    if keys:
        lines.append(f"{', '.join(keys)}: not told by this plate, taken as unchanged")
    return given, tuple(lines)


def _told_by_plate(
    codes: Sequence[Floats] | None, water: WaterView | None, start: ColourGrade, keys: Sequence[str]
) -> list[tuple[str, float | None, str]]:
    """Return name, value and a line on each number that a plate tells; the value is None where it is not taken.

    codes: R'G'B' (n, 3) of each frame; None where black and white are known. start: the grade that is known.

    White is taken only with black, and black by the colours of water only with white: a plate with both ends moved
    has about the contrast of one with none, and taking one of them alone would change that by a third.
    """
    low, high = (None, None) if codes is None else code_ends(codes)
    black_kept, white_kept = (True, True) if codes is None else ends_kept(codes)
    told: list[tuple[str, float | None, str]] = []
    if low is not None and "black" in keys:
        told.append(("black", low, f"black {low:.3f}: codes end there"))
        start, keys = with_number(start, "black", low), [key for key in keys if key != "black"]
    if high is not None and "white" in keys:
        left = [key for key in keys if key != "white"]
        bent = _bent(water, with_number(start, "white", high), left, by_colour="black" in left and not black_kept)
        if "black" not in keys or black_kept or (bent is not None and bent[0] == "black"):
            told.append(("white", high, f"white {high:.3f}: codes end there"))
            return told + _bent_line(bent)
        why = f"codes end at {high:.3f}: white, but only with black, which this plate does not tell"
        return [*told, ("white", None, why), *_bent_line(_bent(water, start, left, by_colour=False))]
    lifted = "black" in keys and not black_kept and ("white" not in keys or white_kept)
    return told + _bent_line(_bent(water, start, keys, by_colour=lifted))


def _bent(
    water: WaterView | None, start: ColourGrade, keys: Sequence[str], *, by_colour: bool
) -> tuple[str, float] | None:
    """Return the number that open water tells, or None. by_colour: whether its colours alone may tell black."""
    if water is None:
        return None
    bent = bent_by(water, start, keys)
    lifted = black_by_colour(water, start) if bent is None and by_colour else None
    return bent if lifted is None else ("black", lifted)


def _bent_line(bent: tuple[str, float] | None) -> list[tuple[str, float | None, str]]:
    """Return the number that open water tells with a line on it; nothing for None."""
    if bent is None:
        return []
    name, value = bent
    return [(name, value, f"{name} {value:.3f}: with it open water is as the medium says at all elevations")]


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
