# SPDX-License-Identifier: Apache-2.0
"""Solves the colour of a grade from patches of known reflectance in its plate.

    v = g(E(e r T + f W))    e: light on a white patch at the camera, one number a channel, unknown; r: reflectance
    W = D(g^-1(w))           w: code of level open water

Patches stand in one light. T and f are of the water before a patch (`Patch`), 1 and 0 close to the camera. n
patches give 3 n equations for the three of e and the numbers of g (`colour_grade`). The light of the water is not given
but read from the plate through the same g: a black patch in the water then tells black by being darker than the water.
The numbers are taken in one by one, the best told first (black, then gamma ...), as long as all of those taken in are
known to better than `TOLD`; the others keep their value. Black is one number of all channels where no patch is black,
or where the water hides it in one of them.

Greys tell no saturation: codes follow nearly a power of light, and in these a saturated grey is one in other light.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mr360uw.base.color import ColorSpec, decode_signal, encode_signal
from mr360uw.composite.grading.colour_grade import (
    LEAST_CONTRAST,
    MOST_CONTRAST,
    NO_GRADE,
    ColourGrade,
    Three,
    graded_spec,
    luma_weights_of,
)
from mr360uw.composite.grading.settings import MatchSettings, number_words
from mr360uw.errors import ParameterError
from mr360uw.types import Floats

CODE_ERROR = 1.0 / 255.0
"""Standard error of a patch's mean code, one 8-bit code: uneven light and the encoder, not noise. Twice as large, a
number must be twice as well determined."""
ORDER = ("black", "gamma", "contrast", "saturation", "white")
"""Order in which the numbers are tried: by how often plates have them, and by how well patches tell them."""
TOLD = {"black": 0.01, "gamma": 0.08, "contrast": 0.08, "saturation": 0.1, "white": 0.03}
"""Standard error below which a number counts as told: it moves a code of the middle by about three."""
DISAGREE_CODES = 4.0
"""Root mean square difference [8-bit codes] from which patches count as contradicting each other."""
_NOTHING = (0.0, 0.0, 0.0)
_DARKEST = 0.01
"""Least reflectance, and least light, that the light on patches is first guessed from."""
_RANGES = {
    "black": (-0.3, 0.5), "gamma": (0.3, 3.0), "contrast": (LEAST_CONTRAST, MOST_CONTRAST),
    "saturation": (0.1, 4.0), "white": (0.5, 1.6),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Patch:
    """A patch, and the water before it, in the plate's primaries; without any by default.

    code: (3,) its mean R'G'B' in the plate, 0 to 1. reflectance: (3,) what it reflects. passed: (3,) light of a white
    patch there, as it arrives, over that of one at the camera. grown: (3,) light that this water adds, over that of
    level open water. water: (3,) light of that. water_code: (3,) the same as the plate shows it; None where its light
    is known without the plate.
    """

    code: Three
    reflectance: Three
    passed: Three = (1.0, 1.0, 1.0)
    grown: Three = _NOTHING
    water: Three = _NOTHING
    water_code: Three | None = None


def solve_patches(
    patches: Sequence[Patch], start: ColourGrade, open_keys: Sequence[str], spec: ColorSpec | None = None
) -> tuple[ColourGrade, tuple[str, ...], str]:
    """Return the grade of a plate with patches, the names of those `open_keys` whose numbers these tell, and a line on
    it. All other numbers are those of `start`.

    spec: how the plate's codes are read; by default sRGB's curve with the luma of ITU-R BT.709. Raises
    `ParameterError` without a patch.
    """
    if not patches:
        raise ParameterError("patches - none to solve a grade from (got 0) - give one at least")
    own = ColorSpec() if spec is None else graded_spec(spec)
    blacks = (3, 1) if any(patch.reflectance == _NOTHING for patch in patches) else (1,)
    problems = [_Problem(patches, start, own, count) for count in blacks]
    names: tuple[str, ...] = ()
    best, _, rms = problems[0].solve(names)
    for name in (name for name in ORDER if name in open_keys):
        for problem in problems:
            found, errors, left = problem.solve((*names, name))
            if all(errors[one] <= TOLD[one] for one in (*names, name)):
                problems, names, best, rms = [problem], (*names, name), found, left
                break
    # Say in words what they tell
    numbers = ", ".join(f"{name} {number_words(getattr(best, name))}" for name in names)
    line = f"{len(patches)} patch{'es' * (len(patches) > 1)}: {numbers or 'tell nothing of the grade'}"
    missing = ", ".join(name for name in ORDER[:-1] if name not in names)
    line += f"; not told by them: {missing}" if missing else ""
    if rms > DISAGREE_CODES:
        line += f"; they contradict each other by {rms:.0f} codes"
    return best, names, line


class _Problem:
    """The equations of patches; unknown: the logarithms of the light (3,), where a patch reflects any, and numbers.

    blacks: how many numbers black is, 3 or 1.
    """

    def __init__(self, patches: Sequence[Patch], start: ColourGrade, spec: ColorSpec, blacks: int) -> None:
        self._code = np.array([patch.code for patch in patches], float)
        self._reflectance = np.array([patch.reflectance for patch in patches], float)
        self._start, self._spec, self._weights, self._blacks = start, spec, luma_weights_of(spec), blacks
        self._lit = bool(np.any(self._reflectance > 0.0))
        self._passed, self._grown, self._water = (
            np.array([getattr(patch, name) for patch in patches]) for name in ("passed", "grown", "water")
        )
        self._water_code = np.array([patch.water_code or _NOTHING for patch in patches])
        self._shown = np.array([patch.water_code is not None for patch in patches])

    def solve(self, names: tuple[str, ...]) -> tuple[ColourGrade, dict[str, float], float]:
        """Return the grade with some numbers free, their standard errors, and the difference left [8-bit codes]."""
        from scipy.optimize import least_squares

        first, low, high = self._first(names)
        if len(first) == 0:
            return self._start, {}, float(255.0 * np.sqrt(np.mean(self._residual(first, names) ** 2)))
        if len(first) > self._code.size:
            return self._start, dict.fromkeys(names, np.inf), np.inf
        found = least_squares(self._residual, first, bounds=(low, high), args=(names,), x_scale="jac", xtol=1e-12)
        singular, turn = np.linalg.svd(np.asarray(found.jac), full_matrices=False)[1:]
        inverse = np.where(singular > 1e-9 * singular[0], CODE_ERROR / np.maximum(singular, 1e-300), np.inf)
        with np.errstate(invalid="ignore"):
            error = np.sqrt(np.nansum((turn * inverse[:, None]) ** 2, axis=0))
        errors = {name: float(error[place].max()) for name, place in self._places(names).items()}
        return self._grade(found.x, names), errors, float(255.0 * np.sqrt(np.mean(found.fun**2)))

    def _places(self, names: tuple[str, ...]) -> dict[str, slice]:
        """Return where the numbers of each name stand among the unknown ones, after the light."""
        places, end = {}, 3 if self._lit else 0
        for name in names:
            start, end = end, end + (self._blacks if name == "black" else 1)
            places[name] = slice(start, end)
        return places

    def _first(self, names: tuple[str, ...]) -> tuple[Floats, Floats, Floats]:
        values, ranges = [], []
        if self._lit:
            plain = decode_signal(np.clip(self._start.ungraded(self._code, self._weights), 0.02, 1.0), self._spec)
            own = plain - self._grown * self._light_of_water(self._start)
            light = np.median(own / np.maximum(self._reflectance * self._passed, _DARKEST), axis=0)
            values += list(np.log(np.maximum(light, _DARKEST)))
            ranges += [(-12.0, 6.0)] * 3
        for name, place in self._places(names).items():
            count = place.stop - place.start
            values += [float(np.mean(getattr(self._start, name)))] * count
            ranges += [_RANGES[name]] * count
        low, high = np.array(ranges, float).reshape(-1, 2).T
        return np.clip(np.array(values), low + 1e-6, high - 1e-6), low, high

    def _grade(self, unknown: Floats, names: tuple[str, ...]) -> ColourGrade:
        found = {}
        for name, place in self._places(names).items():
            values = tuple(unknown[place].tolist())
            found[name] = values if len(values) == 3 else values * 3 if name in ("black", "white") else values[0]
        return replace(self._start, **found)  # type: ignore[arg-type]

    def _residual(self, unknown: Floats, names: tuple[str, ...]) -> Floats:
        grade = self._grade(unknown, names)
        own = self._reflectance * self._passed * (np.exp(unknown[:3]) if self._lit else 0.0)
        light = own + self._grown * self._light_of_water(grade)
        shown = grade.graded(encode_signal(light, self._spec), self._weights)
        return np.asarray(shown - self._code).ravel()

    def _light_of_water(self, grade: ColourGrade) -> Floats:
        """Return the light (patches, 3) of level open water in the patches' frames, as a grade has its codes read."""
        if not np.any(self._shown):
            return self._water
        read = decode_signal(grade.ungraded(self._water_code, self._weights), self._spec)
        return np.where(self._shown[:, None], read, self._water)


_ROUNDS = 6
"""Most solutions of patches in the water: the light of open water is averaged over pixels without the grade last found,
and two or three settle it."""
_NEARER = 0.9
"""Factor on the distances of patches for what an error of them does; longer ones may be beyond all sight."""


def patched_colour(
    settings: MatchSettings, patches: Sequence[Patch], spec: ColorSpec,
    in_water: Callable[[ColourGrade, float], Sequence[Patch]] | None,
) -> tuple[ColourGrade, str]:  # fmt: skip
    """Return the colour of a plate's grade by its patches, one or more, and a line on what they tell.

    settings: numbers that are given stay. spec: how the plate's codes are read. in_water: gives the patches with the
    water before each, in a plate whose light is read without a grade, their distances times a factor; None where no
    water is seen before any of them.
    """
    start = settings.colour_over(NO_GRADE)
    if in_water is None:
        colour, _, line = solve_patches(patches, start, settings.open_keys, spec)
        return colour, line

    def through(read_without: ColourGrade, stretch: float) -> tuple[ColourGrade, tuple[str, ...], str]:
        return solve_patches(in_water(read_without, stretch), start, settings.open_keys, spec)

    (colour, told, line), read_without = through(start, 1.0), start
    for _ in range(_ROUNDS):
        if float(np.abs(colour.numbers - read_without.numbers).max()) < 0.1 * CODE_ERROR:
            break
        read_without = colour
        colour, told, line = through(read_without, 1.0)
    if told:
        nearer = through(read_without, _NEARER)[0]
        line += f"; were all a tenth nearer, {told[0]} would be {number_words(getattr(nearer, told[0]))}"
    return colour, line
