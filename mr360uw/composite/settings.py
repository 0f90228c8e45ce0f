# SPDX-License-Identifier: Apache-2.0
"""Parameters of objects, lamps, receivers, holdouts, sampling, the surface and snow."""

from __future__ import annotations

import itertools
import math
from fractions import Fraction
from pathlib import Path
from typing import Annotated, Literal, Self, TypeVar

from pydantic import AfterValidator, Field, model_validator

from mr360uw.base.constants import MAXIMUM_SUN_SAMPLES
from mr360uw.base.parameters import LATEST_S, Parameters, advanced, parameter
from mr360uw.composite.mesh.up_axis import Up
from mr360uw.ibl.settings import EXPOSURE

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
PLACE = "position (right, up, back): of a lamp in its frame; of the receiver's mesh or the middle of its height map"
TURN = "(yaw, pitch, roll): nose or beam (-z) to the right, up, right side down; roll first"
SIZE, CASTS = "factor on its size", "whether there are shadows: of this object on all, or of all in this lamp's light"
"""What keys of several tables mean."""


_Key = TypeVar("_Key", "LampKeySettings", "KeySettings")


def check_times(keys: tuple[_Key, ...]) -> tuple[_Key, ...]:
    """Return the keys of a motion; raise `ValueError` where their times do not ascend."""
    for number, (one, after) in enumerate(itertools.pairwise(key.time_s for key in keys)):
        if after <= one:
            what = f"key {number + 1} must be later than key {number}"
            raise ValueError(f"{what} (got time_s {one:g}, then {after:g}) - sort the keys")
    return keys


def check_color(color: Vector) -> Vector:
    """Return a linear colour; raise `ValueError` where a channel is negative."""
    if min(color) < 0.0:
        raise ValueError(f"must be three numbers >= 0 (got {list(color)}) - light cannot be taken away")
    return color


Colour = Annotated[Vector, AfterValidator(check_color)]


class ReceiverSettings(Parameters):
    """The floor: the surface of the plate that shows shadows and, on request, caustics."""

    kind: Literal["plane", "mesh", "height_map", "distance"] = parameter("plane", "source of its shape")
    height_m: float = parameter(-2.0, "height of the plane above the camera's position at time 0", unit="m")
    path: Path | None = parameter(
        None, "the mesh, the height map, or the distance map (image, sequence or video; 0, inf, NaN: no surface)"
    )
    position_m: Vector = parameter((0.0, 0.0, 0.0), PLACE, unit="m")
    rotation_deg: Vector = parameter((0.0, 0.0, 0.0), TURN, unit="deg")
    scale: float = parameter(1.0, SIZE, unit="1", low=1e-6, high=1e6)
    size_m: tuple[Extent, Extent] = advanced((20.0, 20.0), "extent of the height map along x and z", unit="m")
    range_m: tuple[float, float] = advanced(
        (0.0, 1.0), "heights of black and white of the height map, or distances of a distance map in codes", unit="m"
    )
    outside_files: bool = advanced(False, "whether the mesh file may name files outside of its own folder")
    shadow: bool = parameter(True, "whether the sun's shadow falls on it")
    occlusion: bool = advanced(True, "whether objects block ambient light on it")
    caustics: bool = parameter(False, "whether caustics are added to those the plate already shows")
    extent_m: float = advanced(
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
    invert: bool = advanced(False, "whether black hides the objects instead")
    range_m: tuple[float, float] = advanced(
        (0.0, 100.0), "distances of black and white of a distance map in codes; EXR holds metres", unit="m"
    )


class LampKeySettings(Parameters):
    """One instant of a lamp's motion; values that are not set are the lamp's own."""

    time_s: float = parameter(..., "time of the key from the start of the clip", unit="s", low=-LATEST_S, high=LATEST_S)
    position_m: Vector | None = parameter(None, "position (right, up, back)", unit="m")
    rotation_deg: Vector | None = parameter(None, "(yaw, pitch, roll) of the beam", unit="deg")


LampKeys = Annotated[tuple[LampKeySettings, ...], AfterValidator(check_times)]


class LampSettings(Parameters):
    """A lamp that the plate does not show: a torch, a strobe, a light on an object."""

    position_m: Vector = parameter((0.0, 0.0, 0.0), PLACE, unit="m")
    rotation_deg: Vector = parameter((0.0, 0.0, 0.0), TURN, unit="deg")
    attach: Literal["world", "camera"] | Annotated[int, Field(ge=0, le=10000)] = parameter(
        "world", "frame of reference: the world, the camera, or an object by its number, the first is 0"
    )
    key: LampKeys = parameter((), "the motion, ascending in time", fixed=MOTION)
    interpolation: Interpolation = advanced("smooth", "between keys: straight, or a monotone cubic")
    lumen: float | None = parameter(None, "luminous flux; none: 2000", unit="lm", low=0.0, high=1e7)
    temperature_k: float = parameter(5600.0, "colour temperature of its spectrum", unit="K", low=1000.0, high=25000.0)
    color: Colour = advanced((1.0, 1.0, 1.0), "linear filter on its colour, before the water", unit="1")
    cone_deg: float = parameter(
        60.0, "full angle beyond which it is dark; 360: it shines to all sides", unit="deg", above=0.0, high=360.0
    )
    radius_m: float = advanced(0.02, "radius of the luminous ball, for soft shadows", unit="m", low=0.0, high=100.0)
    casts_shadow: bool = parameter(True, CASTS)


class DrawSettings(Parameters):
    """Sampling of objects and shadows, motion blur, grain."""

    quality: Quality = parameter(
        "final", "values of the settings that trade time for accuracy, where a scene does not set them",
        fixed="a clip has one quality",
    )  # fmt: skip
    samples: Samples = advanced(65, "samples of every pixel, on a rotated grid", unit="1")
    shading: Literal["pixel", "sample"] = parameter(
        "pixel", "shade each surface once a pixel, or once a sample", internal="draw.quality"
    )
    ambient_occlusion: bool = advanced(
        True, "bodies block ambient light from themselves and from each other, and reflect light onto each other"
    )
    sun_samples: int = parameter(
        24, "directions over a light's disc, averaged for soft shadows", low=1, high=MAXIMUM_SUN_SAMPLES,
        internal="draw.quality",
    )  # fmt: skip
    sun_spread_deg: float = advanced(
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

    def exposure_s(self, frame_rate: Fraction | float | None) -> float:
        """Return the exposure time [s] at a frame rate [1/s]; 0 of a still, which has none."""
        return float(self.shutter / frame_rate) if frame_rate else 0.0


Diameter = Annotated[float, Field(ge=0.05, le=50.0)]
SnowPhase = Literal["grain", "petzold", "isotropic"]

NEAREST_M = 0.15
"""Distance from the camera within which there are no particles: its housing."""
_CARRIED = "particles would jump: they are where it has carried them since time 0"
_SIZES = "particles would change places between classes of size"


class SnowSettings(Parameters):
    """Marine snow: particles suspended in the water. Off by default."""

    amount: float = parameter(
        0.0, "number of particles over what the water's scattering gives; 0: none", unit="1", low=0.0, high=1000.0
    )
    exponent: float = advanced(
        3.58, "of the size spectrum dN/dd = A d^-exponent; 4: equal volumes in every octave, 3: a bloom",
        unit="1", low=2.5, high=5.0, fixed=_SIZES,
    )  # fmt: skip
    sizes_mm: tuple[Diameter, Diameter] = advanced(
        (0.5, 4.0), "least and greatest diameter that is drawn", unit="mm", fixed=_SIZES
    )
    range_m: float = advanced(4.0, "distance beyond which there are none", unit="m", low=0.2, high=50.0)
    albedo: float = advanced(
        0.5, "fraction of the light on a particle that it scatters", unit="1", low=0.0, high=1.0, internal="snow.amount"
    )
    phase: SnowPhase = parameter(
        "grain", "where it scatters: back, as a white ball; forwards, as the water's particles; to all sides",
        internal="comparisons",
    )  # fmt: skip
    current_m_s: tuple[float, float, float] = parameter(
        (0.0, 0.0, 0.0), "velocity (right, up, back) of the water", unit="m/s", fixed=_CARRIED
    )

    @model_validator(mode="after")
    def _ascending(self) -> SnowSettings:
        if self.sizes_mm[1] <= self.sizes_mm[0]:
            raise ValueError(f"sizes_mm - must ascend (got {list(self.sizes_mm)}) - sort them")
        return self


# --- the surface ----------------------------------------------------------------------------------------------------


class SurfaceSettings(Parameters):
    """Objects at the water's surface: mirrored in it, seen through it, cut by it."""

    objects: Literal["auto", "all", "none"] = parameter(
        "auto", "objects that the surface mirrors and cuts; auto: those that come near it"
    )


# --- objects --------------------------------------------------------------------------------------------------------


Attachment = Literal["world", "camera", "surface"]
Loop = Literal["repeat", "once", "ping-pong"]
Front = Literal["+z", "-z", "+x", "-x"]
Facing = Literal["camera"] | Annotated[float, Field(ge=-360.0, le=360.0)]
POLAR = ("azimuth_deg", "elevation_deg", "distance_m")
"""Words of a place that stand instead of `position_m`."""
_KEYED = ("position_m", *POLAR, "rotation_deg", "face", "scale")
_AWAY_M = 3.0
"""Distance [m] of an object whose azimuth alone is given."""


class _Placed(Parameters):
    """What an object and the keys of its motion have in common: a place that is given once."""

    @model_validator(mode="after")
    def _one_place(self) -> Self:
        polar = [name for name in POLAR if getattr(self, name) is not None]
        if polar and "position_m" in self.model_fields_set and getattr(self, "position_m", None) is not None:
            raise ValueError(f"{polar[0]} - position_m is given too (got both) - remove one of them")
        return self

    @property
    def polar(self) -> bool:
        """Whether its place is given by azimuth, elevation or distance."""
        return any(getattr(self, name) is not None for name in POLAR)


class KeySettings(_Placed):
    """One instant of an object's motion; values that are not set are the object's own."""

    time_s: float = parameter(..., "time of the key from the start of the clip", unit="s", low=-LATEST_S, high=LATEST_S)
    position_m: Vector | None = parameter(None, "position (right, up, back)", unit="m")
    azimuth_deg: float | None = parameter(None, "instead of position_m, as the object's", unit="deg")
    elevation_deg: float | None = parameter(
        None, "instead of position_m, as the object's", unit="deg", low=-90.0, high=90.0
    )
    distance_m: float | None = parameter(None, "instead of position_m, as the object's", unit="m", above=0.0, high=1e5)
    rotation_deg: Vector | None = parameter(None, "(yaw, pitch, roll)", unit="deg")
    face: Facing | None = parameter(None, "side that its front is turned to, as the object's", unit="deg")
    scale: float | None = parameter(None, "factor on the object's size", unit="1", low=1e-6, high=1e6)


Keys = Annotated[tuple[KeySettings, ...], AfterValidator(check_times)]


class ObjectSettings(_Placed):
    """A mesh in the scene: position, size, material, motion."""

    mesh: Path = parameter(..., "glTF, GLB, USD, OBJ, PLY or STL; fish_%04d.glb for one mesh a frame")
    position_m: Vector = parameter((0.0, 0.0, -3.0), "position (right, up, back) from the camera at time 0", unit="m")
    azimuth_deg: float | None = parameter(
        None, "instead of position_m: side on which its middle is, 0 = ahead, + = to the right", unit="deg"
    )
    elevation_deg: float | None = parameter(
        None, "with azimuth_deg: height of its middle over the horizon; 0 if not set", unit="deg", low=-90.0, high=90.0
    )
    distance_m: float | None = parameter(
        None, "with azimuth_deg: distance of its middle from the camera at time 0; 3 if not set; level, of one that "
        "stands on the floor", unit="m", above=0.0, high=1e5,
    )  # fmt: skip
    stand_on: Literal["receiver"] | None = parameter(
        None, "receiver: its lowest point is on the sea floor (receiver), whatever the height of its position"
    )
    rotation_deg: Vector = parameter((0.0, 0.0, 0.0), TURN, unit="deg")
    face: Facing | None = parameter(
        None, "turns its front to the camera (where that is at time 0), or to an azimuth in degrees; rotation_deg is "
        "then from there", unit="deg",
    )  # fmt: skip
    up: Up = parameter(
        "auto", "axis of the mesh that points up; auto: as glTF, USD or the file's comments say, of other STL, OBJ and "
        "PLY as the shape shows, else y"
    )  # fmt: skip
    front: Front = advanced("+z", "side of the mesh, turned y up, that is its front, for face; glTF has +z")
    size_m: float | None = parameter(
        None, "length of its longest side, whatever the unit of the file, instead of scale", unit="m",
        above=0.0, high=1e6,
    )  # fmt: skip
    scale: float = parameter(1.0, SIZE, unit="1", low=1e-6, high=1e6)
    attach: Attachment = parameter(
        "world",
        "frame of reference: the world; the camera and its rotation; or the waves, on which it floats, with position_m "
        "over the mean surface",
    )
    key: Keys = parameter((), "the motion, ascending in time", fixed=MOTION)
    interpolation: Interpolation = advanced("smooth", "between keys: straight, or a monotone cubic")
    animation: int | str = parameter(
        "auto", "clip of a glTF file that is played, by name or number (the first is 0); auto: its first, '': none"
    )
    loop: Loop = advanced("repeat", "how the clip goes on after its end: again, not at all, or back and forth")
    speed: float = advanced(
        1.0, "clip seconds a second of the video; negative plays backwards", unit="1", low=-1e3, high=1e3,
        fixed="the clip would jump: key start_s, the time within it",
    )  # fmt: skip
    start_s: float = advanced(0.0, "time within the clip at the video's time 0", unit="s", low=-LATEST_S, high=LATEST_S)
    casts_shadow: bool = parameter(True, CASTS)
    visible: bool = parameter(True, "whether the camera sees the object; its shadow stays")
    texture: Path | None = parameter(None, "base colour image to use instead of the file's own")
    vertex_colors: bool = parameter(True, "whether the file's vertex colours multiply the base colour")
    base_color: Colour | None = parameter(
        None, "linear base colour, multiplies the texture; none: the file's", unit="1"
    )
    metallic: float | None = parameter(None, "0 dielectric, 1 metal; none: the file's", unit="1", low=0.0, high=1.0)
    roughness: float | None = parameter(None, "0 mirror, 1 matt; none: the file's", unit="1", low=0.0, high=1.0)
    refractive_index: float | None = parameter(
        None, "of the surface, against vacuum; none: the file's", unit="1", low=1.0, high=4.0, internal="the mesh file"
    )
    exposure: float = parameter(0.0, EXPOSURE, unit="stops", low=-10.0, high=10.0)
    tint: Colour = parameter(
        (1.0, 1.0, 1.0), "factors on the red, green and blue of the light that the camera gets from it", unit="1"
    )
    double_sided: bool | None = advanced(None, "whether back faces are drawn; none: as the file says")
    smooth_deg: float | None = advanced(
        None, "new normals, smooth across edges that bend by less than this (30 to 60 is usual), 0 = flat; none: the "
        "file's, and where it has none glTF and USD are flat, others smooth below 60", unit="deg", low=0.0, high=180.0,
    )  # fmt: skip
    outside_files: bool = advanced(False, "whether the mesh file may name files outside of its own folder")

    @model_validator(mode="after")
    def _placed_once(self) -> ObjectSettings:
        if self.size_m is not None:
            given = "scale" in self.model_fields_set
            if given or any(key.scale is not None for key in self.key):
                name = "scale" if given else "key.scale"
                raise ValueError(f"size_m - {name} is given too (got both) - remove one of them")
        if self.stand_on is not None and self.attach != "world":
            raise ValueError(
                f"stand_on - needs an object of the world (got attach {self.attach!r}) - remove one of them"
            )
        instants: tuple[ObjectSettings | KeySettings, ...] = (self, *self.key)
        if self.stand_on is not None and any(one.elevation_deg is not None for one in instants):
            raise ValueError("elevation_deg - the floor decides its height (got stand_on too) - remove one of them")
        if self.attach == "surface" and any(one.polar for one in instants):
            raise ValueError("azimuth_deg - is from the camera (got attach 'surface') - give position_m")
        return self

    @property
    def place_m(self) -> Vector:
        """Its place (right, up, back) [m]: of its middle if `polar`, else of the origin of its mesh."""
        if not self.polar:
            return self.position_m
        azimuth, elevation = math.radians(self.azimuth_deg or 0.0), math.radians(self.elevation_deg or 0.0)
        away = _AWAY_M if self.distance_m is None else self.distance_m
        level = away * math.cos(elevation)
        return level * math.sin(azimuth), away * math.sin(elevation), -level * math.cos(azimuth)

    def at_key(self, key: KeySettings) -> ObjectSettings:
        """Return the settings of an instant of the motion: those of the key, and its own where the key has none."""
        given = {name: value for name in _KEYED if (value := getattr(key, name)) is not None}
        if key.position_m is not None:
            given = dict.fromkeys(POLAR) | given
        return self.model_copy(update=given)
