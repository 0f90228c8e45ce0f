# SPDX-License-Identifier: Apache-2.0
"""The `[match]` table of a scene, its `[[match.patch]]` tables, and the grade of a plate that they ask for."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, replace
from math import radians
from typing import Annotated, Literal

import numpy as np
from pydantic import ConfigDict, Field, model_validator

from mr360uw.base.color import decode
from mr360uw.base.parameters import LATEST_S, Parameters, advanced, parameter
from mr360uw.base.sphere import direction_from_angles
from mr360uw.composite.grading.colour_grade import (
    LEAST_CONTRAST,
    MOST_CONTRAST,
    MOST_LIGHT,
    NO_GRADE,
    ColourGrade,
    Three,
)
from mr360uw.types import Floats


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


def gaussian(image: Floats, deviation_px: float) -> Floats:
    """Return a picture (h, w, 4) blurred by a Gaussian cut off at three standard deviations."""
    if deviation_px <= 0.0:
        return image
    import cv2

    size = 2 * ceil_px(deviation_px) + 1
    found: Floats = cv2.GaussianBlur(image, (size, size), deviation_px, borderType=cv2.BORDER_REPLICATE)
    return found


_ONE_LOOK = "a clip has one look"
LEAST_STEP = 0.2
"""Least white over black: below it most of the plate's light is lost in rounding to codes."""
_Black = Annotated[float, Field(ge=-0.3, le=0.5)]
_White = Annotated[float, Field(ge=0.4, le=1.6)]
Black = Literal["auto"] | _Black | tuple[_Black, _Black, _Black]
White = Literal["auto"] | _White | tuple[_White, _White, _White]
Reflectance = Annotated[float, Field(gt=0.0, le=1.0)]
_GREY, _WHITE = 0.18, 0.9
"""Fractions of light that a grey card reflects, and white paint or paper."""
COLOUR = ("black", "white", "gamma", "contrast", "saturation")
"""The keys of a grade's colour: numbers, or "auto", which is solved from patches or changes nothing."""


class PatchSettings(Parameters):
    """Something in the plate whose colour is known: near the camera, or at a known distance in the water."""

    model_config = ConfigDict(populate_by_name=True)

    azimuth_deg: float = parameter(..., "side of the panorama on which it is, 0: middle, +: right", unit="deg")
    elevation_deg: float = parameter(..., "height over the panorama's middle row", unit="deg", low=-90.0, high=90.0)
    size_deg: float = advanced(1.0, "diameter of the part that is read", unit="deg", low=0.05, high=20.0)
    shows: Literal["grey", "colour", "black", "white"] = parameter(
        "grey", "a grey, which reflects all colours alike; a colour; black; or white, a grey of 0.9", alias="is"
    )
    reflectance: Reflectance | tuple[Reflectance, Reflectance, Reflectance] = parameter(
        _GREY, "fraction of the light that a grey or white reflects; of a colour, of red, green and blue", unit="1"
    )
    distance_m: float | None = parameter(
        None, "distance, whose water is reckoned with; none: under about a metre, as if without water", unit="m",
        above=0.0, high=100.0,
    )  # fmt: skip
    time_s: float = parameter(0.0, "time of the frame that shows it", unit="s", low=0.0, high=LATEST_S)

    @model_validator(mode="after")
    def _as_many_numbers_as_colours(self) -> PatchSettings:
        several = isinstance(self.reflectance, tuple)
        if self.shows == "black" and "reflectance" in self.model_fields_set:
            raise ValueError("reflectance - black has none (got both) - remove it, or say that it is grey")
        if several != (self.shows == "colour"):
            wanted = "three numbers, red, green, blue" if self.shows == "colour" else "one number"
            raise ValueError(f"reflectance - of a {self.shows} is {wanted} (got {self.reflectance}) - give these")
        return self

    @property
    def direction(self) -> Floats:
        """Direction (3,) of its middle, in the panorama's own axes."""
        return direction_from_angles(radians(self.azimuth_deg), radians(self.elevation_deg))

    @property
    def reflected(self) -> Three:
        """Fraction of red, green and blue that it reflects."""
        if self.shows == "black":
            return _three(0.0)
        given = "reflectance" in self.model_fields_set
        return _three(_WHITE if self.shows == "white" and not given else self.reflectance)


class MatchSettings(Parameters):
    """Grade, softness and sharpening of the plate: its light is read without the grade, bodies are given all of it."""

    black: Black = parameter(
        "auto", "code of black, 0 to 1, of all channels or of red, green, blue; auto: by the patches, else 0", unit="1",
        fixed=_ONE_LOOK,
    )  # fmt: skip
    white: White = parameter(
        "auto", "code of white, 0 to 1, of all channels or of red, green, blue; auto: by the patches, else 1", unit="1",
        fixed=_ONE_LOOK,
    )  # fmt: skip
    gamma: Literal["auto"] | Annotated[float, Field(ge=0.3, le=3.0)] = parameter(
        "auto", "exponent of the codes, below 1 brighter; auto: by the patches, else 1", unit="1", fixed=_ONE_LOOK
    )
    contrast: Literal["auto"] | Annotated[float, Field(ge=LEAST_CONTRAST, le=MOST_CONTRAST)] = parameter(
        "auto", "slope at middle grey of an S curve that keeps black and white; auto: by the patches, else 1", unit="1",
        fixed=_ONE_LOOK,
    )  # fmt: skip
    saturation: Literal["auto"] | Annotated[float, Field(ge=0.1, le=4.0)] = parameter(
        "auto",
        "factor on the distance of codes from their luma; auto: by the patches, else 1",
        unit="1",
        fixed=_ONE_LOOK,
    )
    patch: tuple[PatchSettings, ...] = parameter((), "things of known colour in the plate", fixed=_ONE_LOOK)
    softness: Literal["auto"] | Annotated[float, Field(ge=0.0, le=10.0)] = parameter(
        "auto", "standard deviation of the blur of bodies; auto: as the plate shows it, where it does; 0: none",
        unit="px", fixed=_ONE_LOOK,
    )  # fmt: skip
    sharpening: float = parameter(
        0.0, "amount of an unsharp mask on bodies, where the plate was sharpened; 0: none", unit="1", low=0.0, high=5.0,
        fixed=_ONE_LOOK,
    )  # fmt: skip

    @model_validator(mode="after")
    def _light_can_be_read(self) -> MatchSettings:
        given = self.colour_over(NO_GRADE)
        for black, white in zip(given.black, given.white, strict=True):
            if white - black < LEAST_STEP:
                raise ValueError(
                    f"white - must be {LEAST_STEP:g} above black (got {white:g} over {black:g}) - change one of them"
                )
        brightest = float(decode(given.ungraded(np.ones((1, 3))), "srgb").max())
        if brightest > MOST_LIGHT:
            raise ValueError(
                f"white - the plate's greatest code would be {brightest:.3g} times as bright as white, by black, "
                f"white, gamma and contrast together (at most {MOST_LIGHT:g}) - bring white or gamma nearer to 1"
            )
        return self

    def colour_over(self, found: ColourGrade) -> ColourGrade:
        """Return the colour of the grade: the given numbers, and those found where a key is "auto"."""
        given = {name: getattr(self, name) for name in COLOUR if getattr(self, name) != "auto"}
        given |= {name: _three(given[name]) for name in ("black", "white") if name in given}
        return replace(found, **given)

    @property
    def open_keys(self) -> tuple[str, ...]:
        """The keys of the colour that the patches are to tell."""
        return tuple(name for name in COLOUR if self.patch and getattr(self, name) == "auto")

    @property
    def reading(self) -> Hashable:
        """Key of all that the plate's light is read by."""
        return *(getattr(self, name) for name in COLOUR), self.patch

    @property
    def measured(self) -> MatchSettings:
        """The same settings without those that do not count where the plate's look is measured."""
        softness = self.softness if self.softness == "auto" else 0.0
        return self.model_copy(update={"softness": softness, "sharpening": 0.0})

    @property
    def measures(self) -> bool:
        """Whether anything of the plate's look is measured."""
        return self.softness == "auto" or bool(self.open_keys)

    @property
    def colours(self) -> bool:
        """Whether the plate may have a grade that its light is read without."""
        return bool(self.open_keys) or self.colour_over(NO_GRADE).changes

    @property
    def changes(self) -> bool:
        """Whether bodies may be changed."""
        return self.softness != 0.0 or self.sharpening != 0.0 or self.colours

    @property
    def in_words(self) -> str:
        """The numbers that are set and change anything, and those that patches or the plate tell; "" for nothing."""
        set_ = self.colour_over(NO_GRADE)
        parts = [
            f"{name} {number_words(getattr(set_, name))}"
            for name in COLOUR
            if getattr(set_, name) != getattr(NO_GRADE, name)
        ]
        parts += [
            f"{name} {getattr(self, name):g}"
            for name in ("softness", "sharpening")
            if getattr(self, name) not in (0.0, "auto")
        ]
        patches = f"{len(self.patch)} patch{'es' * (len(self.patch) > 1)}"
        solved = f"solved from {patches}: {', '.join(self.open_keys)}" if self.open_keys else ""
        unread = f"{patches} not read, as every number is set" if self.patch and not self.open_keys else ""
        soft = "softness measured in the plate" if self.softness == "auto" else ""
        given = "the grade as set: " + ", ".join(parts) if parts else ""
        return "; ".join(filter(None, [given, solved, unread, soft]))


def number_words(value: float | Three) -> str:
    """Return a number of a grade, or one for each channel where they differ."""
    if not isinstance(value, tuple):
        return f"{value:.2f}"
    return f"{value[0]:.3f}" if len(set(value)) == 1 else " ".join(f"{part:.3f}" for part in value)


def _three(value: float | Three) -> Three:
    """Return a value for each channel."""
    return value if isinstance(value, tuple) else (value, value, value)
