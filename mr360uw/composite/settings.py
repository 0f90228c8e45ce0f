# SPDX-License-Identifier: Apache-2.0
"""Parameters of lamps, receivers, holdouts and sampling; those of objects are in `object_settings`."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from mr360uw.constants import MAXIMUM_SUN_SAMPLES
from mr360uw.parameters import Parameters, parameter

FARTHEST = 1e9
"""Largest number of a position [m] or a rotation [deg]: beyond it the sums of single-precision numbers overflow."""
_Part = Annotated[float, Field(ge=-FARTHEST, le=FARTHEST)]
Vector = tuple[_Part, _Part, _Part]
Extent = Annotated[float, Field(gt=0.0, le=1e6)]
Interpolation = Literal["linear", "smooth"]
Quality = Literal["draft", "final", "reference"]
Samples = Literal[1, 5, 13, 17, 29, 41, 65]
MOTION = "it is a motion over time itself"
"""Why keys of motions are not keyed themselves."""


def check_times(times: Sequence[float]) -> None:
    """Raise `ValueError` where times of keys do not ascend."""
    for number, (one, after) in enumerate(itertools.pairwise(times)):
        if after <= one:
            what = f"key {number + 1} must be later than key {number}"
            raise ValueError(f"{what} (got time_s {one:g}, then {after:g}) - sort the keys")


def check_color(color: Vector) -> Vector:
    """Return a linear colour; raise `ValueError` where a channel is negative."""
    if min(color) < 0.0:
        raise ValueError(f"must be three numbers >= 0 (got {list(color)}) - light cannot be taken away")
    return color


class ReceiverSettings(Parameters):
    """The floor: the surface of the plate that shows shadows and, on request, caustics."""

    kind: Literal["plane", "mesh", "height_map", "distance"] = parameter("plane", "source of its shape")
    height_m: float = parameter(-2.0, "height of the plane above the camera's position at time 0", unit="m")
    path: Path | None = parameter(
        None, "the mesh, the height map, or the distance map (image, sequence or video; 0, inf, NaN: no surface)"
    )
    position_m: Vector = parameter((0.0, 0.0, 0.0), "position of the mesh or centre of the height map", unit="m")
    rotation_deg: Vector = parameter((0.0, 0.0, 0.0), "(yaw, pitch, roll) of the mesh", unit="deg")
    scale: float = parameter(1.0, "factor on the mesh's size", unit="1", above=0.0, high=1e6)
    size_m: tuple[Extent, Extent] = parameter((20.0, 20.0), "extent of the height map along x and z", unit="m")
    range_m: tuple[float, float] = parameter(
        (0.0, 1.0), "heights of black and white of the height map, or distances of a distance map in codes", unit="m"
    )
    outside_files: bool = parameter(False, "whether the mesh file may name files outside of its own folder")
    shadow: bool = parameter(True, "whether the sun's shadow falls on it")
    occlusion: bool = parameter(True, "whether objects block ambient light on it")
    caustics: bool = parameter(False, "whether caustics are added to those the plate already shows")
    plate_caustics: Literal["auto", "keep"] = parameter(
        "auto", "the plate's own caustics in a shadow; auto: they go with the sun's light"
    )
    extent_m: float = parameter(
        30.0, "distance from the camera beyond which it is not changed", unit="m", above=0.0, high=1e4
    )

    @model_validator(mode="after")
    def _file_of_shape(self) -> ReceiverSettings:
        if self.kind != "plane" and self.path is None:
            raise ValueError(f"kind {self.kind!r} needs a file (got no path) - set receiver.path")
        return self


class HoldoutSettings(Parameters):
    """A mask (matte) of the plate that stays in front of the objects."""

    path: Path = parameter(..., "image, sequence (matte_%04d.png) or video of the plate's shape")
    kind: Literal["mask", "distance"] = parameter("mask", "white hides the objects, or a distance along the ray")
    range_m: tuple[float, float] = parameter(
        (0.0, 100.0), "distances of black and white of a distance map in codes; EXR holds metres", unit="m"
    )
    invert: bool = parameter(False, "whether black hides the objects instead")
    feather_px: float = parameter(0.0, "width of a soft edge added to the matte", unit="px", low=0.0, high=200.0)


class LampKeySettings(Parameters):
    """One instant of a lamp's motion; values that are not set are the lamp's own."""

    time_s: float = parameter(..., "time of the key from the start of the clip", unit="s")
    position_m: Vector | None = parameter(None, "position (right, up, back)", unit="m")
    rotation_deg: Vector | None = parameter(None, "(yaw, pitch, roll) of the beam", unit="deg")


class LampSettings(Parameters):
    """A lamp that the plate does not show: a torch, a strobe, a light on an object."""

    kind: Literal["spot", "point"] = parameter("spot", "a cone of light, or light to all sides")
    position_m: Vector = parameter((0.0, 0.0, 0.0), "position (right, up, back) in its frame of reference", unit="m")
    rotation_deg: Vector = parameter(
        (0.0, 0.0, 0.0), "(yaw, pitch, roll) of a spot's beam; (0, 0, 0) is straight ahead (-z)", unit="deg"
    )
    attach: Literal["world", "camera", "object"] = parameter("world", "frame of reference")
    object: int = parameter(0, "for attach object: its number, the first is 0", low=0, high=10000)
    key: tuple[LampKeySettings, ...] = parameter((), "the motion, ascending in time", fixed=MOTION)
    interpolation: Interpolation = parameter("smooth", "between keys: straight, or a monotone cubic")
    lumen: float | None = parameter(None, "luminous flux; none: from watts, or 2000", unit="lm", low=0.0, high=1e7)
    watts: float | None = parameter(
        None, "radiant flux between 400 and 700 nm, instead of lumen (LEDs give a third of what they draw)",
        unit="W", low=0.0, high=1e5,
    )  # fmt: skip
    temperature_k: float = parameter(5600.0, "colour temperature of its spectrum", unit="K", low=1000.0, high=25000.0)
    color: Vector = parameter((1.0, 1.0, 1.0), "linear filter on its colour, before the water", unit="1")
    cone_deg: float = parameter(
        60.0, "of a spot: full angle beyond which it is dark", unit="deg", above=0.0, high=360.0
    )
    edge: float = parameter(
        0.3, "of a spot: fraction of the half angle over which it fades", unit="1", low=0.0, high=1.0
    )
    radius_m: float = parameter(0.02, "radius of the luminous ball, for soft shadows", unit="m", low=0.0, high=100.0)
    casts_shadow: bool = parameter(True, "whether objects cast shadows in its light")

    @field_validator("color")
    @classmethod
    def _not_negative(cls, color: Vector) -> Vector:
        return check_color(color)

    @field_validator("key")
    @classmethod
    def _ascending(cls, keys: tuple[LampKeySettings, ...]) -> tuple[LampKeySettings, ...]:
        check_times([key.time_s for key in keys])
        return keys

    @model_validator(mode="after")
    def _one_flux(self) -> LampSettings:
        if self.lumen is not None and self.watts is not None:
            raise ValueError("watts - lumen is given too (got both) - remove one of them")
        return self


class DrawSettings(Parameters):
    """Sampling of objects and shadows, motion blur, grain."""

    quality: Quality = parameter(
        "final", "values of the settings that trade time for accuracy, where a scene does not set them",
        fixed="a clip has one quality",
    )  # fmt: skip
    samples: Samples = parameter(65, "samples of every pixel, on a rotated grid", unit="1")
    shading: Literal["pixel", "sample"] = parameter("pixel", "shade each surface once a pixel, or once a sample")
    ambient_occlusion: bool = parameter(
        True, "bodies block ambient light from themselves and from each other, and reflect light onto each other"
    )
    sun_samples: int = parameter(
        24, "directions over a light's disc, averaged for soft shadows", low=1, high=MAXIMUM_SUN_SAMPLES
    )
    sun_spread_deg: float = parameter(
        5.0,
        "standard deviation of the directions of sunlight scattered forwards by the water, for shadows",
        unit="deg",
        low=0.0,
        high=30.0,
    )
    motion_samples: int = parameter(1, "sub-frames averaged for motion blur; 1: none", low=1, high=64)
    grain: float = parameter(
        0.0, "grain on objects: 0 none, 1 as strong as the plate's, as each frame shows it", unit="1", low=0.0, high=4.0
    )
    shutter: float = parameter(
        0.5, "exposure time as a fraction of the frame's time", unit="1", low=0.0, high=1.0,
        fixed="the plate was shot with one shutter",
    )  # fmt: skip
