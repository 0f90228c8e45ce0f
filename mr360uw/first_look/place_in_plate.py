# SPDX-License-Identifier: Apache-2.0
"""Places a thing in a plate: on ground near by if it stands, in open water if it swims, in the sky if it flies.

What stands is put 1.5 to 5 m away, 20 to 40 degrees below the horizon, farther only where it is too large for that. In
water nothing is farther than a third of the visibility: what would fill the view there is made smaller.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from mr360uw.composite.mesh.up_axis import Habit
from mr360uw.errors import ParameterError
from mr360uw.first_look.good_places import Sides, free_view, ground_place, shows_ground
from mr360uw.first_look.mesh_look import MeshLook
from mr360uw.first_look.plate_look import PlateLook
from mr360uw.sphere import direction_from_angles
from mr360uw.types import Floats

_GUESSED_M: dict[bool, float] = {True: 1.3, False: 1.6}
"""Height of a camera over the ground that is not known: of a diver over a floor, and of a tripod or a head in air."""
_USUAL_DEG, _WIDEST_DEG = 20.0, 40.0
"""Angle that a thing is seen under as a rule, and at most where there is room behind."""
_FILLS_DEG: dict[bool, float] = {True: 45.0, False: 60.0}
"""That angle at most where water hides the distance: of long things, whose nearer end looks larger, and of others."""
_NEAR = 1.0 / 3.0
"""Greatest distance over the visibility: a contrast of 20 %."""
_BELOW_DEG = (20.0, 40.0)
_NEAREST_M, _NEAR_BY_M = 1.5, 5.0
_ROOM = 1.6
"""Range of distances, over the least, of things too large for the usual ones."""
_SWIMS_DEG, _SINKS_DEG = (-8.0, 12.0), (-30.0, -12.0)
"""Elevations at which things off the ground are put, and things that would stand where no ground is seen."""
_CLEAR_M = 0.3
"""Least distance [m] of things off the ground from ground and surface."""
_TURN_DEG = 20.0
"""Angle from straight across by which the front is turned towards the camera."""
_STEP_DEG, _STEPS = 5.0, 7
_LOWEST_DEG = 2.0
"""Angle below the horizon from which a direction meets the ground within reach."""


@dataclass(frozen=True, slots=True)
class Wish:
    """What is asked for a thing's place. at_deg: azimuth and elevation, of its foot if it stands, else of its middle.

    habit: whether it stands or swims, whatever its name says. size_m: its longest side.
    """

    at_deg: tuple[float, float] | None = None
    habit: Habit | None = None
    size_m: float | None = None

    def __post_init__(self) -> None:
        if self.at_deg is not None and not (abs(self.at_deg[0]) <= 360.0 and abs(self.at_deg[1]) <= 90.0):
            raise ParameterError(
                f"--at - is no direction (got {self.at_deg}) - give azimuth,elevation in degrees, as in 30,-25"
            )
        if self.size_m is not None and not 0.0 < self.size_m <= 1e4:
            raise ParameterError(f"--size - must be above 0 m (got {self.size_m:g}) - give its longest side in metres")


@dataclass(frozen=True, slots=True)
class Place:
    """Where a thing is put. drop_m: height of the camera over the ground; None where no ground is seen.

    distance_m: level, where it stands. elevation_deg: of its middle. smaller: whether it was made smaller than it is,
    to be seen. hangs: whether it would stand, but there is no ground. uneven: cost of its ground, 0 where none is
    looked for. top_m: height of its top over the camera. face: azimuth [deg] of its front, or "camera". on_shown:
    whether its foot is on what the plate shows at a known distance, and not on the level floor.
    """

    stands: bool
    hangs: bool
    size_m: float
    smaller: bool
    azimuth_deg: float
    elevation_deg: float
    distance_m: float
    drop_m: float | None
    uneven: float
    top_m: float
    face: float | str
    on_shown: bool = False


def guessed_drop_m(plate: PlateLook, wish: Wish) -> float | None:
    """Return the height of the camera over the ground that is guessed; None where no ground is seen or asked for."""
    wet = plate.medium.underwater
    seen = not wet or (plate.floor and shows_ground(plate.image))
    return _GUESSED_M[wet] if seen or wish.habit == "stands" else None


ShownDistance = Callable[[Floats], float]
"""Distance [m] of what the plate shows in a direction (3,) of the levelled camera, infinite where it is not known."""


def place_of(
    plate: PlateLook,
    mesh: MeshLook,
    wish: Wish,
    sight_m: float,
    drop_m: float | None,
    shown_m: ShownDistance | None = None,
) -> Place:
    """Return the place of a mesh in a plate.

    sight_m: the water's visibility, infinite in air. drop_m: height of the camera over the ground, None without one.
    shown_m: tells distances; what stands is put on what the plate shows in the direction that is asked for. Raises
    `ParameterError` where nothing can stand in the direction that is asked for.
    """
    habit = wish.habit or (mesh.habit if plate.medium.underwater or mesh.habit == "flies" else "stands")
    whole = wish.size_m or mesh.size_m
    reach = _NEAR * sight_m
    size = wish.size_m or min(whole, reach / _sizes_away(_FILLS_DEG[mesh.long]))
    start = Place(
        stands=False, hangs=False, size_m=float(f"{size:.3g}"), smaller=size < whole, azimuth_deg=0.0,
        elevation_deg=0.0, distance_m=0.0, drop_m=drop_m, uneven=0.0, top_m=0.0, face="camera",
    )  # fmt: skip
    shown = math.inf if shown_m is None or wish.at_deg is None else shown_m(_direction(*wish.at_deg))
    if habit == "stands" and wish.at_deg is not None and math.isfinite(shown):
        found = _on_shown(mesh, wish.at_deg, start, shown)
    elif habit == "stands" and drop_m is not None:
        found = _standing(plate, mesh, wish, start, reach, drop_m)
    else:
        found = _off_the_ground(plate, mesh, wish, replace(start, hangs=habit == "stands"), reach)
    across = round((found.azimuth_deg + 90.0 + _TURN_DEG + 180.0) % 360.0 - 180.0, 1) + 0.0
    return replace(found, face=across if mesh.long else "camera", distance_m=float(f"{found.distance_m:.3g}"))


def _standing(plate: PlateLook, mesh: MeshLook, wish: Wish, start: Place, reach_m: float, drop_m: float) -> Place:
    """Return a place on the ground."""
    size = start.size_m
    level_reach = math.sqrt(max(reach_m**2 - drop_m**2, drop_m**2))
    least = drop_m / math.tan(math.radians(_BELOW_DEG[1]))
    near = min(max(least, _NEAREST_M, _sizes_away(_WIDEST_DEG) * size), max(level_reach, least))
    far = max(drop_m / math.tan(math.radians(_BELOW_DEG[0])), _ROOM * near)
    distances = np.geomspace(near, max(min(far, level_reach), near), _STEPS)
    azimuths = np.arange(-180.0, 180.0, _STEP_DEG)
    if wish.at_deg is not None:
        if wish.at_deg[1] > -_LOWEST_DEG:
            raise ParameterError(
                f"--at - meets no ground for what stands (got elevation {wish.at_deg[1]:g}) - give the direction of "
                f"its foot, {-_LOWEST_DEG:g} degrees or lower, or --swim"
            )
        azimuths, distances = (
            np.array([v]) for v in (wish.at_deg[0], drop_m / math.tan(math.radians(-wish.at_deg[1])))
        )
    height = size * mesh.extent[1]
    usual = float(
        np.clip(_sizes_away(_USUAL_DEG) * size, distances[0], max(distances[0], min(distances[-1], _NEAR_BY_M)))
    )
    azimuth, distance, cost = ground_place(plate.image, drop_m, _footprint(mesh, size), distances, azimuths, usual)
    middle = math.degrees(math.atan2(0.5 * height - drop_m, distance))
    return replace(
        start, stands=True, azimuth_deg=azimuth, elevation_deg=round(middle, 1),
        distance_m=distance, uneven=cost, top_m=height - drop_m,
    )  # fmt: skip


def _direction(azimuth_deg: float, elevation_deg: float) -> Floats:
    return direction_from_angles(math.radians(azimuth_deg), math.radians(elevation_deg))


def _on_shown(mesh: MeshLook, at_deg: tuple[float, float], start: Place, shown_m: float) -> Place:
    """Return a place whose foot is where the plate shows something at a known distance, as on a rock."""
    height = start.size_m * mesh.extent[1]
    middle = shown_m * _direction(*at_deg) + np.array([0.0, 0.5 * height, 0.0])
    distance = float(np.linalg.norm(middle))
    elevation = round(math.degrees(math.asin(middle[1] / distance)), 2)
    return replace(
        start, on_shown=True, azimuth_deg=at_deg[0], elevation_deg=elevation, distance_m=distance,
        top_m=float(middle[1]) + 0.5 * height,
    )  # fmt: skip


def _footprint(mesh: MeshLook, size_m: float) -> Sides:
    """Return the sides of a mesh as it is turned: long ones lie across the line of sight."""
    x, y, z = (size_m * side for side in mesh.extent)
    ahead, aside = (z, x) if mesh.front in ("+z", "-z") else (x, z)
    if not mesh.long:
        return aside, ahead, y
    c, s = math.cos(math.radians(_TURN_DEG)), math.sin(math.radians(_TURN_DEG))
    return c * ahead + s * aside, s * ahead + c * aside, y


def _off_the_ground(plate: PlateLook, mesh: MeshLook, wish: Wish, start: Place, reach_m: float) -> Place:
    """Return a place in open water, or in the sky."""
    size, wet = start.size_m, plate.medium.underwater
    height, distance = size * mesh.extent[1], min(_sizes_away(_USUAL_DEG) * size, reach_m)
    azimuth, elevation = wish.at_deg or (0.0, 0.0)
    if wish.at_deg is None:
        level = _SINKS_DEG if start.hangs or plate.medium.half else _clear_of_ground(distance, height, start.drop_m)
        azimuth, elevation, _ = free_view(plate.image, level, underwater=wet)
    return replace(
        start, azimuth_deg=azimuth, elevation_deg=round(elevation, 1), distance_m=distance,
        top_m=distance * math.sin(math.radians(elevation)) + 0.5 * height,
    )  # fmt: skip


def _sizes_away(angle_deg: float) -> float:
    """Return the distance, over its size, at which a thing is seen under an angle."""
    return 0.5 / math.tan(math.radians(0.5 * angle_deg))


def _clear_of_ground(distance_m: float, height_m: float, drop_m: float | None) -> tuple[float, float]:
    """Return the elevations [deg] at which a thing that swims is clear of the ground."""
    low, high = _SWIMS_DEG
    if drop_m is not None:
        rise = max(-1.0, min(1.0, (_CLEAR_M + 0.5 * height_m - drop_m) / distance_m))
        low = max(low, min(math.degrees(math.asin(rise)), 30.0))
    return low, max(low, high)
