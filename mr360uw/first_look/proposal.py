# SPDX-License-Identifier: Apache-2.0
"""Proposes a scene from what a plate and a mesh show: water, floor, size and place of the object."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mr360uw.errors import ParameterError
from mr360uw.first_look.free_view import FreeView, free_view
from mr360uw.first_look.mesh_look import MeshLook
from mr360uw.first_look.plate_look import PlateLook
from mr360uw.first_look.sight import Sight, guess_sight
from mr360uw.first_look.water_or_air import LITTLE_RED
from mr360uw.match import WaterPatch, match_water
from mr360uw.medium import Water
from mr360uw.medium.jerlov import JerlovType
from mr360uw.medium.visibility import visibility_m
from mr360uw.scene.model import CameraSettings, PlateSettings, Scene

_DEPTH_M = 6.0
"""Depth of a camera that is not known: common in dives by daylight."""
_FLOOR_M: dict[bool, float] = {True: 2.0, False: 1.6}
"""Height of a camera over the floor that is not known: above sand under water, and of a tripod or a head in air."""
_WATER: JerlovType = "IB"
_MURKY: JerlovType = "9C"
"""Where no type is told: of clear seas, and the one in which red goes as far as green."""
_UNLIKE = 0.4
"""Rms of the logarithm of plate over model above which no type of water is proposed."""
_PATCH_DEG = 14.0
_ANGLE_DEG = 20.0
"""Angle that an object's longest side is seen under as a rule."""
_WIDEST_DEG = 30.0
_NEAR = (0.2, 0.35)
"""Greatest distance over that at which a black target is lost: contrasts of 38 and 19 %. The second is for things that
would be made smaller than half their size by the first."""
_HALF = 0.5
_STEEPEST_DEG = 40.0
"""Angle below the horizon at which things on the floor are seen, at most: seen from above they are hard to tell."""
_LEVEL_DEG = (-8.0, 18.0)
"""Elevations at which objects off the floor are put."""
_CLEAR_M = 0.3
"""Least distance [m] of objects off the floor from floor and surface."""
_TURN_DEG = 20.0
"""Angle from straight across by which the front is turned towards the camera."""


@dataclass(frozen=True, slots=True)
class WaterGuess:
    """A type of water. known: whether the plate shows one. sight: its visibility."""

    type: JerlovType
    confidence: float
    others: tuple[str, ...]
    known: bool
    sight: Sight


@dataclass(frozen=True, slots=True)
class Proposal:
    """A scene as it is proposed. water: None in air. floor_m: height of the floor, negative, or None.

    stands: whether the object is on the floor. lifted: whether it would be, but is too small to be seen there. smaller:
    whether it was made smaller than it is, to be seen. face: azimuth [deg] of its front, or "camera".
    lamp: whether a lamp goes with the camera.
    """

    view: FreeView
    water: WaterGuess | None
    depth_m: float
    floor_m: float | None
    floor_known: bool
    stands: bool
    lifted: bool
    size_m: float
    smaller: bool
    distance_m: float
    azimuth_deg: float
    elevation_deg: float
    face: float | str
    lamp: bool
    track: Path | None = None


def propose(plate: PlateLook, mesh: MeshLook, floor_m: float | None = None) -> Proposal:
    """Return a scene for a plate and a mesh. floor_m: height of the floor where it is known, negative."""
    wet = plate.medium.underwater
    water, view, sight = None, free_view(plate.image, _LEVEL_DEG, underwater=wet), math.inf
    if wet:
        height = -floor_m if floor_m is not None else _FLOOR_M[True] if plate.floor else None
        water = guess_water(plate, view, height, known=floor_m is not None)
        sight = water.sight.visibility_m
    floor = floor_m if floor_m is not None else (-_FLOOR_M[wet] if plate.floor else None)
    size, distance = _seen_through(mesh.size_m, sight)
    drop = None if floor is None else -floor
    of_floor = mesh.habit == "stands" or not (wet or mesh.kind)  # in air only what is known to swim hangs there
    stands = of_floor and drop is not None and _seen_on_floor(distance, drop)
    height = size * mesh.extent[1]
    if stands and drop is not None:
        middle = math.degrees(math.asin(max(min((0.5 * height - drop) / distance, 1.0), -1.0)))
        view = free_view(plate.image, (middle - 2.0, middle + 2.0), underwater=wet)
        distance = math.sqrt(max(distance**2 - (0.5 * height - drop) ** 2, (0.5 * distance) ** 2))
    else:
        view = free_view(plate.image, _elevations(distance, height, drop, wet), underwater=wet)
    top = height - (drop or 0.0) if stands else distance * math.sin(math.radians(view.elevation_deg)) + 0.5 * height
    depth = max(_DEPTH_M, math.ceil(top + _CLEAR_M)) if wet else CameraSettings().depth_m
    across = round((view.azimuth_deg + 90.0 + _TURN_DEG + 180.0) % 360.0 - 180.0, 1) + 0.0
    return Proposal(
        view=view,
        water=water,
        depth_m=float(depth),
        floor_m=None if floor is None else round(floor, 2),
        floor_known=floor_m is not None,
        stands=stands,
        lifted=of_floor and drop is not None and not stands,
        size_m=float(f"{size:.3g}"),
        smaller=size < mesh.size_m,
        distance_m=float(f"{distance:.3g}"),
        azimuth_deg=view.azimuth_deg,
        elevation_deg=round(view.elevation_deg, 1),
        face=across if mesh.long else "camera",
        lamp=plate.dark,
    )


def _seen_through(size_m: float, sight_m: float) -> tuple[float, float]:
    """Return the size and the distance [m] of a thing that a water does not hide; its own size if that can be."""
    size, reach = size_m, math.inf
    for share in _NEAR:
        reach = share * sight_m
        size = min(size_m, reach / _sizes_away(_WIDEST_DEG))
        if size >= _HALF * size_m:
            break
    return size, min(_sizes_away(_ANGLE_DEG) * size, reach)


def _sizes_away(angle_deg: float) -> float:
    """Return the distance, over its size, at which a thing is seen under an angle."""
    return 0.5 / math.tan(math.radians(0.5 * angle_deg))


def _seen_on_floor(distance_m: float, drop_m: float) -> bool:
    return drop_m < distance_m * math.sin(math.radians(_STEEPEST_DEG))


def _elevations(distance_m: float, height_m: float, drop_m: float | None, wet: bool) -> tuple[float, float]:
    """Return the elevations [deg] at which a thing is clear of the floor and of the water's surface."""

    def elevation(rise_m: float) -> float:
        return math.degrees(math.asin(max(-1.0, min(1.0, rise_m / distance_m))))

    low, high = _LEVEL_DEG
    if wet:
        high = min(high, elevation(_DEPTH_M - _CLEAR_M - 0.5 * height_m))
    if drop_m is not None:
        low = max(low, min(elevation(_CLEAR_M + 0.5 * height_m - drop_m), 30.0))
    return low, max(low, high)


def guess_water(plate: PlateLook, view: FreeView, height_m: float | None, *, known: bool) -> WaterGuess:
    """Return the type of water that is nearest to a plate's open water, at a typical depth, and its visibility.

    height_m: of the camera over the floor, None without one; known: whether it is, or is guessed.
    """
    kind, confidence, others = _nearest_type(plate, view)
    usual = visibility_m(Water.jerlov(kind))
    sight = guess_sight(plate.sharp, height_m, known=known, usual_m=usual)
    return WaterGuess(kind, confidence, others, confidence > 0.0, sight)


def _nearest_type(plate: PlateLook, view: FreeView) -> tuple[JerlovType, float, tuple[str, ...]]:
    """Return the nearest type, its confidence, 0 where none has the plate's colour, and the others that are likely."""
    camera = CameraSettings(depth_m=_DEPTH_M)
    if plate.tilt is not None:
        roll, pitch = (float(np.degrees(angle)) for angle in (plate.tilt.roll_rad, plate.tilt.pitch_rad))
        camera = camera.model_copy(update={"roll_deg": roll, "pitch_deg": pitch})
    reading = plate.reading
    scene = Scene(plate=PlateSettings(path=plate.path, eye=reading.eye, projection=reading.projection), camera=camera)
    unknown: JerlovType = _MURKY if plate.medium.red_far > LITTLE_RED else _WATER
    try:
        found = match_water(scene, WaterPatch(view.azimuth_deg, view.elevation_deg, _PATCH_DEG))
    except ParameterError:  # the open water is black, or redder than water
        return unknown, 0.0, ()
    nearest, _, misfit = found.candidates[0]
    if misfit > _UNLIKE:
        return unknown, 0.0, ()
    kind: JerlovType = nearest  # type: ignore[assignment]
    return kind, found.confidence, tuple(name for name, likelihood, _ in found.candidates[1:] if likelihood > 0.1)
