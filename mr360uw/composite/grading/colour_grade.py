# SPDX-License-Identifier: Apache-2.0
"""Colour of a grade: levels, curve and saturation between the ordinary response of a camera and a plate's codes.

    light L  --response-->  code x  --curve-->  y  --levels-->  z  --saturation-->  v  --blur, unsharp mask-->  file

    x = E(L)                          E: the plate's transfer curve (`color.encode_signal`), of each channel
    y = 1/2 + 1/2 s(2 x^gamma - 1)    s(u) = k u - (k - 1) u^3, k: contrast, the slope at middle grey
    z = black + (white - black) y     each channel has its own black and white
    v = Y' + saturation (z - Y')      Y' = w . z, luma by the weights of the plate's matrix

s blends the identity with smoothstep (k = 1.5): it keeps black, middle grey and white. Beyond them it goes on straight,
and x^gamma as an odd function, so that v = g(x) has an inverse for all codes. Both directions use the same g:

    reading the light    L = D(g^-1(v))     D = E^-1: of the plate, for environment, sun, veil and receiver
    laying in            v = g(E(L'))       L': the composite in that light

So the composite over a graded plate is the grade of the composite over the ungraded one. Shadows, caustics and shafts
change L and reach the file through g: they are as strong as in the graded picture, scaled by the slope of g.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.cache import shared
from mr360uw.base.color import ColorSpec, decode_signal, encode_signal, in_plate_primaries, in_rec709, ycbcr_from_rgb
from mr360uw.jit import exact_making, inlined
from mr360uw.types import Floats

Three = tuple[float, float, float]
LEAST_CONTRAST, MOST_CONTRAST = 0.3, 1.45
"""Slopes at middle grey. At 1.5 black and white have the slope 0, from which no light can be read; 1.45 leaves 0.1."""
MOST_LIGHT = 100.0
"""Most light that a code of a graded plate is read as, over that of its white, unless the plate itself says more: white
of PQ is less. Codes that no grade makes, as a full red where saturation is low, would be read as far more."""
_ODD_CUBIC = 1.5 * np.sqrt(3.0)
"""Factor in the trigonometric and hyperbolic solutions of u^3 -+ p u = q."""


def graded_spec(spec: ColorSpec) -> ColorSpec:
    """Return how the codes are read that a plate is graded in: its own, but of linear numbers those of a display."""
    return ColorSpec("bt709", True, "srgb", primaries=spec.gamut) if spec.transfer == "linear" else spec


def code_of(linear: Floats, spec: ColorSpec) -> NDArray[np.floating]:
    """Return the R'G'B' (..., 3) that a plate is graded in, of linear Rec.709 light (..., 3)."""
    return encode_signal(in_plate_primaries(linear, graded_spec(spec)), graded_spec(spec))


def luma_weights_of(spec: ColorSpec) -> Floats:
    """Return the weights (3,) of the luma that a plate is saturated about."""
    weights: Floats = ycbcr_from_rgb(graded_spec(spec).matrix)[0]
    return weights


@dataclass(frozen=True, slots=True)
class ColourGrade:
    """Levels, curve and saturation of a grade; the defaults change nothing.

    black, white: R'G'B' that black and white have become. gamma: exponent of the curve, below 1 brighter. contrast:
    slope of its S at middle grey. saturation: factor on the distance from luma.
    """

    black: Three = (0.0, 0.0, 0.0)
    white: Three = (1.0, 1.0, 1.0)
    gamma: float = 1.0
    contrast: float = 1.0
    saturation: float = 1.0

    @property
    def numbers(self) -> Floats:
        """Its nine numbers (9,): black, white, gamma, contrast, saturation."""
        return np.array([*self.black, *self.white, *astuple(self)[2:]])

    @property
    def changes(self) -> bool:
        """Whether it changes a code."""
        return self != ColourGrade()

    def graded(self, code: Floats, weights: Floats | None = None) -> NDArray[np.floating]:
        """Return the graded R'G'B' (..., 3) of codes (..., 3), 0 black and 1 white, not clipped.

        weights: (3,) of luma; by default those of ITU-R BT.709.
        """
        low, span = self._levels(code)
        z = low + span * self._curve(code)
        return self._saturated(z, self.saturation, weights)

    def ungraded(self, code: Floats, weights: Floats | None = None) -> NDArray[np.floating]:
        """Return the codes (..., 3) of graded R'G'B' (..., 3): the inverse of `graded`."""
        z = self._saturated(code, 1.0 / self.saturation, weights)
        low, span = self._levels(code)
        return self._uncurve((z - low) / span)

    def lay_on(self, linear: Floats, spec: ColorSpec) -> NDArray[np.float32]:
        """Return the light (..., 3) that the graded codes show, of light (..., 3); both linear Rec.709, float32."""
        return self._through(linear, spec, laid_on=True)

    def take_off(self, linear: Floats, spec: ColorSpec) -> NDArray[np.float32]:
        """Return the light (..., 3) before the grade, of light (..., 3) as the plate shows it: inverse of `lay_on`.

        Codes that a grade cannot have made of any light show none, or `MOST_LIGHT`, in the plate's own primaries:
        colours outside Rec.709 stay what they are.
        """
        return self._through(linear, spec, laid_on=False)

    def _through(self, linear: Floats, spec: ColorSpec, *, laid_on: bool) -> NDArray[np.float32]:
        own = graded_spec(spec)
        light = in_plate_primaries(np.asarray(linear, np.float32), own)
        if own.is_wide or np.max(np.abs(light), initial=0.0) > BRIGHTEST:
            change = self.graded if laid_on else self.ungraded
            code = change(encode_signal(light, own), luma_weights_of(own))
            if not laid_on:
                most = encode_signal(np.maximum(light, MOST_LIGHT), own)
                code = np.clip(code, -most, most)  # log curves of more are not finite
            changed = decode_signal(code, own)
        else:
            flat = np.ascontiguousarray(light, np.float32).reshape(-1, 3)
            out = np.empty_like(flat)
            encode, before, curves, after, last = _tables(self, own, laid_on)
            _run(flat, encode, before, curves, after, last, out)
            changed = out.reshape(light.shape)
        if not laid_on:
            changed = np.clip(changed, 0.0, np.maximum(light, MOST_LIGHT))
        return np.asarray(in_rec709(changed, own), np.float32)

    def _levels(self, code: Floats) -> tuple[Floats, Floats]:
        low = np.array(self.black, code.dtype)
        return low, np.array(self.white, code.dtype) - low

    @staticmethod
    def _saturated(code: Floats, factor: float, weights: Floats | None) -> Floats:
        if factor == 1.0:
            return code
        by = ycbcr_from_rgb("bt709")[0] if weights is None else weights
        luma = (code @ by.astype(code.dtype))[..., None]
        return luma + code.dtype.type(factor) * (code - luma)

    def _curve(self, code: Floats) -> Floats:
        if self.gamma != 1.0:
            code = np.copysign(np.abs(code) ** code.dtype.type(self.gamma), code)
        if self.contrast == 1.0:
            return code
        k = code.dtype.type(self.contrast)
        u = 2.0 * code - 1.0
        inside = np.clip(u, -1.0, 1.0)
        return 0.5 + 0.5 * (k * inside - (k - 1.0) * inside**3 + (3.0 - 2.0 * k) * (u - inside))

    def _uncurve(self, code: Floats) -> Floats:
        if self.contrast != 1.0:
            s = 2.0 * code - 1.0
            inside = np.clip(s, -1.0, 1.0)
            beyond = (s - inside) / code.dtype.type(3.0 - 2.0 * self.contrast)
            code = 0.5 + 0.5 * (_inverse_s(inside, self.contrast) + beyond)
        if self.gamma == 1.0:
            return code
        return np.copysign(np.abs(code) ** code.dtype.type(1.0 / self.gamma), code)


NO_GRADE = ColourGrade()


@shared(keep=8)
def _tables(grade: ColourGrade, spec: ColorSpec, laid_on: bool) -> GradeTables:
    """Return the tables of a grade in one direction, of codes that are read by `spec`."""
    codes, s = np.linspace(LOW, HIGH, STEPS + 1), grade.saturation
    mixed = s * np.eye(3) + (1.0 - s) * np.outer(np.ones(3), luma_weights_of(spec))  # from R'G'B' before saturation
    plain, grey = replace(grade, saturation=1.0), codes[:, None] * np.ones(3)
    encode = encode_signal(np.linspace(0.0, np.sqrt(BRIGHTEST), STEPS + 1) ** 2, spec)
    steps: tuple[Floats, ...]
    if laid_on:
        steps = encode, np.eye(3), plain.graded(grey).T, mixed, decode_signal(codes, spec)
    else:
        steps = encode, np.linalg.inv(mixed), decode_signal(plain.ungraded(grey), spec).T, np.eye(3), np.empty(0)
    return tuple(np.ascontiguousarray(step, np.float32) for step in steps)


def _inverse_s(s: Floats, contrast: float) -> Floats:
    """Return u (...) in [-1, 1] with contrast u - (contrast - 1) u^3 = s, by the closed forms of a depressed cubic."""
    k = abs(contrast - 1.0)
    p = contrast / k
    scale = s.dtype.type(2.0 * np.sqrt(p / 3.0))
    inner = s * s.dtype.type(_ODD_CUBIC / k * p**-1.5)
    if contrast > 1.0:
        return scale * np.sin(np.arcsin(np.clip(inner, -1.0, 1.0)) / 3.0)
    return scale * np.sinh(np.arcsinh(inner) / 3.0)


# A grade of a whole picture by tables: ten times as fast as its formulas, within a hundredth of an 8-bit code;
# in the darkest hundred-thousandth of light, within a fifth.
#
#     code = encode(sqrt |light|)     code' = before . code     value = curve_c(code')     light' = last(after . value)
#
# Tables are interpolated linearly and go on straight beyond their ends. The square root spreads the steep foot of a
# power law; the error of each table falls with the square of its step.

STEPS = 16384
"""Cells of each table. With half as many the error is four times as large."""
BRIGHTEST = 2.5
"""Light up to which the tables hold; brighter pictures take the formulas."""
LOW, HIGH = -1.0, 2.5
"""Codes at the ends of the tables of codes: a saturation of 1.4 takes the brightest light to 1.9."""


GradeTables = tuple[NDArray[np.float32], ...]
"""The steps of a grade in one direction. encode: (STEPS + 1,) codes over the square root of light from 0 to that of
`BRIGHTEST`; before: (3, 3); curves: (3, STEPS + 1) over codes from LOW to HIGH; after: (3, 3); last: (STEPS + 1,) light
over codes from LOW to HIGH, or (0,) where the curves give light."""


@inlined
def _look(table: Any, place: Any) -> Any:
    """Return the value of a table at a place, in cells from its start."""
    cell = min(max(np.int32(place), np.int32(0)), np.int32(table.size - 2))
    low = table[cell]
    return low + (place - np.float32(cell)) * (table[cell + 1] - low)


@exact_making
def _run(light: Any, encode: Any, before: Any, curves: Any, after: Any, last: Any, out: Any) -> None:
    """Write the light (n, 3) behind all steps; see `GradeTables`."""
    of_root = np.float32(STEPS / np.sqrt(BRIGHTEST))
    of_code, low = np.float32(STEPS / (HIGH - LOW)), np.float32(LOW)
    code = np.empty(3, np.float32)
    value = np.empty(3, np.float32)
    for i in range(light.shape[0]):
        for c in range(3):
            found = _look(encode, np.sqrt(np.abs(light[i, c])) * of_root)
            code[c] = found if light[i, c] >= np.float32(0.0) else -found
        for c in range(3):
            mixed = before[c, 0] * code[0] + before[c, 1] * code[1] + before[c, 2] * code[2]
            value[c] = _look(curves[c], (mixed - low) * of_code)
        for c in range(3):
            mixed = after[c, 0] * value[0] + after[c, 1] * value[1] + after[c, 2] * value[2]
            out[i, c] = mixed if last.size == 0 else _look(last, (mixed - low) * of_code)
