# SPDX-License-Identifier: Apache-2.0
"""Black, gamma or contrast of a grade from the light of open water over elevation, against the solved medium.

    r = ln D(g^-1(v)) - ln M, less its mean in each channel        v: codes of open water, M: the medium's radiance

The medium says how its light falls from the zenith to the nadir in every channel, but for one gain each. Black, gamma
and contrast bend the codes in ways of their own, and the number whose removal leaves the medium's shape is that of the
grade. It is taken only where the medium describes the water closely with it, does not without it, and no other number
does nearly as well: another type of water bends the profile too, but rarely in all channels as a grade does.

Black is told by the colours of the profile alone too, r less its mean over the channels at each elevation: a constant
changes red most, which has the least light, and gamma and contrast leave the ratios nearly as they are. What changes
all channels alike then does not matter: the sun's side of the water, a glow, a slope of the ground below.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mr360uw.color import ColorSpec, decode_signal, in_rec709
from mr360uw.composite.grading.colour_grade import ColourGrade, graded_spec, luma_weights_of
from mr360uw.types import Floats

SPAN_RAD = np.radians(14.0)
"""Elevation to either side of the horizon that is looked at: above it comes the surface, below it the ground."""
ELEVATIONS = 13
"""Number of elevations: two for each row of the map that they are read from."""
CLOSE = 0.006
"""Largest root mean square of r with the number. Sample dives in the water that their scene names leave 0.003 to 0.008;
with another type of water, and a number that suits that best, 0.007 and more."""
FAR = 0.025
"""Least root mean square of r without the number: a code or two of 8 bits over the profile."""
APART = 1.6
"""Least ratio of what the second best number leaves to what the best one leaves."""
CLOSE_COLOUR = 0.0095
"""The same as `CLOSE`, of the colours alone. Where dives with lifted black leave more, black is 0.03 off."""
APART_COLOUR = 2.2
"""The same as `APART`, of the colours alone, and of no change at all. Ungraded dives reach 1.6, a gamma of 0.8 1.75."""
LEAST_BY_COLOUR = 0.045
"""Least black that colours alone tell, 0 to 1. Ungraded dives at low resolution show up to 0.035."""
_LEAST = 1e-5
"""Least light of which the logarithm is taken."""
_CANDIDATES = {
    "black": np.arange(-0.1, 0.2001, 0.01), "gamma": np.arange(0.5, 1.6001, 0.02),
    "contrast": np.arange(0.5, 1.4501, 0.02),
}  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class WaterView:
    """Open water of frames over elevation: R'G'B' codes and the solved radiance of the medium, both (f, n, 3)."""

    codes: Floats
    model: Floats
    spec: ColorSpec


def bent_by(view: WaterView, start: ColourGrade, keys: Sequence[str]) -> tuple[str, float] | None:
    """Return the name and the value of the one unknown number that makes the water fit the medium, or None.

    start: the known numbers of the grade. keys: names of the unknown ones.
    """
    if _left(view, start) < FAR:
        return None
    best = sorted(_best(view, start, name) for name in _CANDIDATES if name in keys)
    if not best or best[0][0] > CLOSE or (len(best) > 1 and best[1][0] < APART * best[0][0]):
        return None
    return best[0][1], best[0][2]


def black_by_colour(view: WaterView, start: ColourGrade) -> float | None:
    """Return the lifted black that the colours of the water tell, between 0 and 1, or None.

    start: the grade that is known.
    """
    best = sorted(_best(view, start, name, by_colour=True) for name in _CANDIDATES)
    left, name, value = best[0]
    others = min(best[1][0], _left(view, start, by_colour=True))
    told = name == "black" and value >= LEAST_BY_COLOUR and left <= CLOSE_COLOUR and others >= APART_COLOUR * left
    return value if told else None


def with_number(colour: ColourGrade, name: str, value: float) -> ColourGrade:
    """Return a grade with one of its numbers changed, black and white in all channels."""
    changed = (value, value, value) if name in ("black", "white") else value
    return replace(colour, **{name: changed})  # type: ignore[arg-type]


def _best(view: WaterView, start: ColourGrade, name: str, *, by_colour: bool = False) -> tuple[float, str, float]:
    """Return what the best value of a number leaves, the number's name, and the value between the candidates."""
    values = _CANDIDATES[name]
    left = np.array([_left(view, with_number(start, name, float(value)), by_colour=by_colour) for value in values])
    k = int(np.clip(np.argmin(left), 1, len(values) - 2))
    low, middle, high = left[k - 1 : k + 2] ** 2
    bend = low - 2.0 * middle + high
    shift = float(np.clip(0.5 * (low - high) / bend, -1.0, 1.0)) if bend > 0.0 else 0.0
    value = float(values[k] + shift * (values[1] - values[0]))
    return _left(view, with_number(start, name, value), by_colour=by_colour), name, value


def _left(view: WaterView, colour: ColourGrade, *, by_colour: bool = False) -> float:
    """Return the root mean square of r (see above) once a grade is removed; by_colour: less its mean over channels."""
    plain = colour.ungraded(view.codes, luma_weights_of(view.spec))
    light = in_rec709(decode_signal(plain, graded_spec(view.spec)), view.spec)
    ratio = np.log(np.maximum(light, _LEAST)) - np.log(np.maximum(view.model, _LEAST))
    rest = ratio - ratio.mean(axis=1, keepdims=True)
    if by_colour:
        rest = rest - rest.mean(axis=2, keepdims=True)
    return float(np.sqrt(np.mean(rest**2)))
