# SPDX-License-Identifier: Apache-2.0
"""Proposes a scene from what a plate and a mesh show: the water, and the place of the object."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from mr360uw.errors import ParameterError
from mr360uw.first_look.good_places import FreeView, free_view
from mr360uw.first_look.mesh_look import MeshLook
from mr360uw.first_look.place_in_plate import Place, ShownDistance, Wish, guessed_drop_m, place_of
from mr360uw.first_look.plate_look import PlateLook
from mr360uw.first_look.sight import Sight, guess_sight
from mr360uw.first_look.water_or_air import LITTLE_RED
from mr360uw.match import WaterPatch, match_water
from mr360uw.medium import Water
from mr360uw.medium.water import JerlovType
from mr360uw.scene.model import CameraSettings, PlateSettings, Scene
from mr360uw.video.eyes_seen import EYES_APART_M

_DEPTH_M = 6.0
"""Depth of a camera that is not known: common in dives by daylight."""
_WATER: JerlovType = "IB"
_MURKY: JerlovType = "9C"
"""Where no type is told: of clear seas, and the one in which red goes as far as green."""
_UNLIKE = 0.4
"""Rms of the logarithm of plate over model above which no type of water is proposed."""
_PATCH_DEG = 14.0
_OPEN_DEG = (-8.0, 18.0)
"""Elevations at which open water is looked for."""
_CLEAR_M = 0.3
"""Least distance [m] of things from the surface, and of cameras that are half in air."""


@dataclass(frozen=True, slots=True)
class WaterGuess:
    """A type of water. confidence: 0 where the plate shows none. others: nearly as likely. sight: its visibility.

    color: (3,) linear light of the open water.
    """

    type: JerlovType
    confidence: float
    others: tuple[str, ...]
    sight: Sight
    color: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Proposal:
    """A scene as it is proposed. water: None in air. floor_by: what told the floor's height, or "".

    lamp: whether a lamp goes with the camera. track, depth: files that were given for it.
    """

    place: Place
    water: WaterGuess | None
    depth_m: float
    floor_by: str
    lamp: bool
    track: Path | None = None
    depth: Path | None = None


def propose(
    plate: PlateLook,
    mesh: MeshLook,
    wish: Wish,
    floor: tuple[float, str] | None = None,
    shown_m: ShownDistance | None = None,
) -> Proposal:
    """Return a scene for a plate and a mesh.

    floor: height of the camera over the floor, and what told it, where it is known. shown_m: see `place_of`. Raises
    `ParameterError` where what is wished for cannot be.
    """
    wet = plate.medium.underwater
    drop, floor_by = _ground_below(plate, wish) if floor is None else floor
    water = None
    if wet:
        view = free_view(plate.image, _OPEN_DEG, underwater=True)
        kind, confidence, others = _nearest_type(plate, view)
        seen = guess_sight(plate.sharp, drop, Water.jerlov(kind), view, _DEPTH_M, known=bool(floor_by))
        water = WaterGuess(kind, confidence, others, seen, view[2])
    sight = math.inf if water is None else water.sight.visibility_m
    place = place_of(plate, mesh, wish, sight, drop, shown_m)
    least = _CLEAR_M if plate.medium.half else _DEPTH_M
    depth = max(least, math.ceil(10.0 * (place.top_m + _CLEAR_M)) / 10.0) if wet else CameraSettings().depth_m
    return Proposal(place, water, float(depth), floor_by, plate.dark)


def _ground_below(plate: PlateLook, wish: Wish) -> tuple[float | None, str]:
    """Return the height of the camera over the ground, None where there is none, and what told it, "" if guessed."""
    if plate.eyes is not None and plate.eyes.floor_m is not None:
        return plate.eyes.floor_m, f"by the disparity of its eyes, if they are {EYES_APART_M:g} m apart"
    return guessed_drop_m(plate, wish), ""


def _nearest_type(plate: PlateLook, view: FreeView) -> tuple[JerlovType, float, tuple[str, ...]]:
    """Return the nearest type, its confidence, 0 where none has the plate's colour, and the others that are likely."""
    camera = CameraSettings(depth_m=_DEPTH_M)
    if plate.tilt is not None:
        camera = camera.model_copy(update={"roll_deg": plate.tilt.roll_deg, "pitch_deg": plate.tilt.pitch_deg})
    settings = PlateSettings(path=plate.path, eye=plate.eye, projection=plate.projection)
    scene = Scene(plate=settings, camera=camera)
    unknown: JerlovType = _MURKY if plate.medium.red_far > LITTLE_RED else _WATER
    try:
        found = match_water(scene, WaterPatch(view[0], view[1], _PATCH_DEG))
    except ParameterError:  # the open water is black, or redder than water
        return unknown, 0.0, ()
    nearest, _, misfit = found.candidates[0]
    if misfit > _UNLIKE:
        return unknown, 0.0, ()
    kind: JerlovType = nearest  # type: ignore[assignment]
    return kind, found.confidence, tuple(name for name, likelihood, _ in found.candidates[1:] if likelihood > 0.1)
