# SPDX-License-Identifier: Apache-2.0
"""Parameters of objects: mesh, place, size, material, motion."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from mr360uw.composite.mesh.up_axis import Up
from mr360uw.composite.settings import CASTS, MOTION, SIZE, TURN, Interpolation, Vector, check_color, check_times
from mr360uw.ibl.settings import EXPOSURE
from mr360uw.parameters import LATEST_S, Parameters, advanced, parameter

Attachment = Literal["world", "camera", "surface"]
Loop = Literal["repeat", "once", "ping-pong"]
Front = Literal["+z", "-z", "+x", "-x"]
Facing = Literal["camera"] | Annotated[float, Field(ge=-360.0, le=360.0)]
POLAR = ("azimuth_deg", "elevation_deg", "distance_m")
"""Words of a place that stand instead of `position_m`."""
_KEYED = ("position_m", *POLAR, "rotation_deg", "face", "scale")
_AWAY_M = 3.0
"""Distance [m] of an object whose azimuth alone is given."""


class KeySettings(Parameters):
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

    @model_validator(mode="after")
    def _one_place(self) -> KeySettings:
        _check_place(self)
        return self

    @property
    def polar(self) -> bool:
        """Whether its place is given by azimuth, elevation or distance."""
        return any(getattr(self, name) is not None for name in POLAR)


class ObjectSettings(Parameters):
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
    key: tuple[KeySettings, ...] = parameter((), "the motion, ascending in time", fixed=MOTION)
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
    base_color: Vector | None = parameter(
        None, "linear base colour, multiplies the texture; none: the file's", unit="1"
    )
    metallic: float | None = parameter(None, "0 dielectric, 1 metal; none: the file's", unit="1", low=0.0, high=1.0)
    roughness: float | None = parameter(None, "0 mirror, 1 matt; none: the file's", unit="1", low=0.0, high=1.0)
    refractive_index: float | None = parameter(
        None, "of the surface, against vacuum; none: the file's", unit="1", low=1.0, high=4.0, internal="the mesh file"
    )
    exposure: float = parameter(0.0, EXPOSURE, unit="stops", low=-10.0, high=10.0)
    tint: Vector = parameter(
        (1.0, 1.0, 1.0), "factors on the red, green and blue of the light that the camera gets from it", unit="1"
    )
    double_sided: bool | None = advanced(None, "whether back faces are drawn; none: as the file says")
    smooth_deg: float | None = advanced(
        None, "new normals, smooth across edges that bend by less than this (30 to 60 is usual), 0 = flat; none: the "
        "file's, and where it has none glTF and USD are flat, others smooth below 60", unit="deg", low=0.0, high=180.0,
    )  # fmt: skip
    outside_files: bool = advanced(False, "whether the mesh file may name files outside of its own folder")

    @field_validator("base_color")
    @classmethod
    def _not_negative(cls, color: Vector | None) -> Vector | None:
        return None if color is None else check_color(color)

    @field_validator("tint")
    @classmethod
    def _no_negative_light(cls, tint: Vector) -> Vector:
        return check_color(tint)

    @field_validator("key")
    @classmethod
    def _ascending(cls, keys: tuple[KeySettings, ...]) -> tuple[KeySettings, ...]:
        check_times([key.time_s for key in keys])
        return keys

    @model_validator(mode="after")
    def _placed_once(self) -> ObjectSettings:
        _check_place(self)
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
    def polar(self) -> bool:
        """Whether its place is given by azimuth, elevation and distance."""
        return any(getattr(self, name) is not None for name in POLAR)

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


def _check_place(given: KeySettings | ObjectSettings) -> None:
    """Raise `ValueError` where a place is given twice."""
    polar = [name for name in POLAR if getattr(given, name) is not None]
    if polar and "position_m" in given.model_fields_set and given.position_m is not None:
        raise ValueError(f"{polar[0]} - position_m is given too (got both) - remove one of them")
