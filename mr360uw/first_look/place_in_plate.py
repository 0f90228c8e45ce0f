# SPDX-License-Identifier: Apache-2.0
"""Places a thing in a plate: on ground near by if it stands, in open water if it swims, in the sky if it flies.

What stands is put 1.5 to 5 m away, 20 to 40 degrees below the horizon, farther only where it is too large for that.
Where the plate's distances are known, it is put on ground that is there, with nothing in the way. In water nothing is
farther than a third of the visibility: what would fill the view there is made smaller.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.color import luminance
from mr360uw.base.constants import CLIPPED_LIGHT
from mr360uw.base.sphere import direction_from_angles, frame_from_direction
from mr360uw.composite.mesh.up_axis import Habit, Up
from mr360uw.errors import ParameterError
from mr360uw.first_look.observations import Eye, MeshLook, PlateLook, red_ratio
from mr360uw.types import Array, Floats

_GUESSED_M: dict[bool, float] = {True: 1.3, False: 1.6}
"""Height of a camera over the ground that is not known: of a diver over a floor, and of a tripod or a head in air."""
_USUAL_DEG, _LARGE_DEG = 20.0, 32.0
"""Angle that a thing is seen under as a rule, and that of large kinds."""
_WIDEST_DEG: dict[bool, float] = {True: 55.0, False: 40.0}
"""That angle at most where there is room behind: in water, which hides what is far away, and in air."""
_FILLS_DEG: dict[bool, float] = {True: 45.0, False: 60.0}
"""That angle at most where water hides the distance: of long things, whose nearer end looks larger, and of others."""
_NEAR = 1.0 / 3.0
"""Greatest distance over the visibility: a contrast of 20 %."""
_BELOW_DEG = (20.0, 40.0)
_NEAREST_M, _NEAR_BY_M = 1.5, 5.0
_ROOM = 2.2
"""Range of distances, over the least, of things too large for the usual ones."""
_SWIMS_DEG, _SINKS_DEG = (-8.0, 12.0), (-30.0, -12.0)
"""Elevations at which things off the ground are put, and things that would stand where no ground is seen."""
_CLEAR_M = 0.3
"""Least distance [m] of things off the ground from ground and surface."""
_TURN_DEG = 20.0
"""Angle from straight across by which the front is turned towards the camera."""
_TRIED_DEG, _TRIED = 5.0, 9
_LOWEST_DEG = 2.0
"""Angle below the horizon from which a direction meets the ground within reach."""


AUTO_TRACK = Path("auto")
"""A camera's path that is to be solved from the clip."""


@dataclass(frozen=True, slots=True)
class Wish:
    """Wishes for a thing's place. at_deg: azimuth and elevation, of its foot if it stands, else of its middle.

    habit: whether it stands or swims, whatever its name says. size_m: its longest side. Besides, what is known of the
    files: up, the mesh's axis that is up; eye, of a stereo plate, by default both; underwater, whether the
    plate is, None to tell it by the picture; track, the camera's path, whose floor is taken from the .json beside it,
    or `AUTO_TRACK`, to solve it; depth, folder of the plate's distances, which tell the floor and what things stand on.
    """

    at_deg: tuple[float, float] | None = None
    habit: Habit | None = None
    size_m: float | None = None
    up: Up = "auto"
    eye: Eye | None = None
    underwater: bool | None = None
    track: Path | None = None
    depth: Path | None = None

    def __post_init__(self) -> None:
        if self.at_deg is not None and not (abs(self.at_deg[0]) <= 360.0 and abs(self.at_deg[1]) <= 90.0):
            raise ParameterError(
                f"--at - is no direction (got {self.at_deg}) - give azimuth,elevation in degrees, as in 30,-25"
            )
        if self.size_m is not None and not 0.0 < self.size_m <= 1e4:
            raise ParameterError(f"--size - must be above 0 m (got {self.size_m:g}) - give its longest side in metres")


@dataclass(frozen=True, slots=True)
class Place:
    """Place of a thing. drop_m: height of the camera over the ground; None where no ground is seen.

    distance_m: level, where it stands. elevation_deg: of its middle. smaller: whether it was made smaller than it is,
    to be seen. hangs: whether it would stand, but there is no ground. uneven: cost of its ground, 0 where none is
    looked for. top_m: height of its top over the camera. face: azimuth [deg] of its front, or "camera". on_shown:
    whether its foot is on what the plate shows at a known distance, and not on the level floor.
    """

    size_m: float
    smaller: bool
    drop_m: float | None
    stands: bool = False
    hangs: bool = False
    azimuth_deg: float = 0.0
    elevation_deg: float = 0.0
    distance_m: float = 0.0
    uneven: float = 0.0
    top_m: float = 0.0
    face: float | str = "camera"
    on_shown: bool = False


def guessed_drop_m(plate: PlateLook, wish: Wish) -> float | None:
    """Return the height of the camera over the ground that is guessed; None where no ground is seen or asked for."""
    wet = plate.medium.underwater
    seen = not wet or (plate.floor and shows_ground(plate.image))
    return _GUESSED_M[wet] if seen or wish.habit == "stands" else None


ShownDistance = Callable[[Floats], Floats]
"""Distances (...) [m] of what the plate shows in directions (..., 3) of the levelled camera, infinite if not known."""


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
    shown_m: tells distances; what stands is put on what the plate shows in the direction that is asked for, and where
    they leave no room for it, in open water. Raises `ParameterError` where nothing can stand in the direction that is
    asked for, or anywhere in air.
    """
    habit = wish.habit or (mesh.habit if plate.medium.underwater or mesh.habit == "flies" else "stands")
    whole = wish.size_m or mesh.size_m
    reach = _NEAR * sight_m
    size = wish.size_m or min(whole, reach / nearest_m(mesh, 1.0))
    start = Place(float(f"{size:.3g}"), size < whole, drop_m)
    shown = math.inf if shown_m is None or wish.at_deg is None else float(shown_m(_direction(*wish.at_deg)))
    if habit == "stands" and wish.at_deg is not None and math.isfinite(shown):
        found = _on_shown(mesh, wish.at_deg, start, shown)
    elif habit == "stands" and drop_m is not None:
        found = _standing(plate, mesh, wish, start, reach, drop_m, shown_m)
        if found.uneven >= _NO_PLACE and shown_m is not None and wish.at_deg is None and wish.habit is None:
            if not plate.medium.underwater:
                raise ParameterError(
                    f"{mesh.path} - finds no room on the ground that the plate shows (got {size:.3g} m) - give --size, "
                    "or the direction of its foot: --at AZIMUTH,ELEVATION"
                )
            found = _off_the_ground(plate, mesh, wish, replace(start, hangs=True), reach)
    else:
        found = _off_the_ground(plate, mesh, wish, replace(start, hangs=habit == "stands"), reach)
    across = round((found.azimuth_deg + 90.0 + _TURN_DEG + 180.0) % 360.0 - 180.0, 1) + 0.0
    return replace(found, face=across if mesh.long else "camera", distance_m=float(f"{found.distance_m:.3g}"))


def _standing(
    plate: PlateLook, mesh: MeshLook, wish: Wish, start: Place, reach_m: float, drop_m: float,
    shown_m: ShownDistance | None,
) -> Place:  # fmt: skip
    """Return a place on the ground."""
    size = start.size_m
    level_reach = math.sqrt(max(reach_m**2 - drop_m**2, drop_m**2))
    least = drop_m / math.tan(math.radians(_BELOW_DEG[1]))
    near = min(
        max(least, _NEAREST_M, _sizes_away(_WIDEST_DEG[plate.medium.underwater]) * size), max(level_reach, least)
    )
    far = max(drop_m / math.tan(math.radians(_BELOW_DEG[0])), _ROOM * near)
    distances = np.geomspace(near, max(min(far, level_reach), near), _TRIED)
    azimuths = np.arange(-180.0, 180.0, _TRIED_DEG)
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
    usual = float(np.clip(_usual_distance(mesh, size), distances[0], max(distances[0], min(distances[-1], _NEAR_BY_M))))
    body = _footprint(mesh, size)
    azimuth, distance, cost = ground_place(plate.image, drop_m, body, distances, azimuths, usual, shown_m)
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
    height, distance = size * mesh.extent[1], min(_usual_distance(mesh, size), reach_m)
    azimuth, elevation = wish.at_deg or (0.0, 0.0)
    if wish.at_deg is None:
        level = _SINKS_DEG if start.hangs or plate.medium.half else _clear_of_ground(distance, height, start.drop_m)
        azimuth, elevation, _ = free_view(plate.image, level, underwater=wet)
    return _in_direction(start, azimuth, elevation, distance, height)


def _in_direction(place: Place, azimuth_deg: float, elevation_deg: float, distance_m: float, height_m: float) -> Place:
    """Return the place with the middle of what is `height_m` high in a direction, at a distance."""
    top = distance_m * math.sin(math.radians(elevation_deg)) + 0.5 * height_m
    elevation = round(elevation_deg, 1)
    return replace(place, azimuth_deg=azimuth_deg, elevation_deg=elevation, distance_m=distance_m, top_m=top)


def nearest_m(mesh: MeshLook, size_m: float) -> float:
    """Return the distance [m] at which a mesh of a size fills as much of the view as it may."""
    return _sizes_away(_FILLS_DEG[mesh.long]) * size_m


def nearer(place: Place, distance_m: float, mesh: MeshLook, wish: Wish) -> Place:
    """Return the place of a mesh off the ground at another distance: clear of the ground, or where it is asked for."""
    height, distance = place.size_m * mesh.extent[1], float(f"{distance_m:.3g}")
    low, _ = _clear_of_ground(distance, height, place.drop_m)
    elevation = place.elevation_deg
    if wish.at_deg is None and not place.hangs:
        elevation = round(max(elevation, low), 1)
    return _in_direction(place, place.azimuth_deg, elevation, distance, height)


def _usual_distance(mesh: MeshLook, size_m: float) -> float:
    """Return the distance [m] at which a mesh is seen under the angle that is usual for its kind."""
    return _sizes_away(_LARGE_DEG if mesh.large else _USUAL_DEG) * size_m


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


# Finds where a thing is seen best in a panorama: before open water or sky, or standing on the ground.
#
# The ground is taken as a level plane one camera height below, and laid out as seen from above, in camera heights:
# there ground looks alike everywhere, while what rises from it ends in edges. Of every place of a foot the cost is what
# is seen under it (edges, other colours than those of the ground near by, shade, nothing), the edges across the way to
# it, what is hidden behind the body, and how far it is from where one looks first.

_WIDE_DEG, _HIGH_DEG = 26.0, 18.0
"""Size [deg] of the part that is looked for: somewhat more than an object."""
_COARSE_DEG = 4.0
"""Standard deviation [deg] of the blur whose difference from the picture counts as texture."""
_STEP_DEG = 5.0
_DIM = 0.002
"""Light that is added before logarithms are taken: noise of dark plates is no texture."""
_RED, _BLACK, _WHITE, _CLIPS = 1.5, 0.25, 1.5, 0.15
"""Costs of red, of darkness (a factor of e), of white, and of a clipped channel, over those of texture (rms of the
logarithm of light)."""
_GLITTER = 0.9
"""Luminance from which water is white: the sun's glitter, or the sky above."""
_OFF_LEVEL, _OFF_MIDDLE = 0.008, 0.002
"""Costs for a degree from the wanted elevation, and from the middle of the frame: ties go to where one looks first."""


FreeView = tuple[float, float, tuple[float, float, float]]
"""A part of a panorama: azimuth and elevation [deg] of its middle, and its mean linear light."""


def free_view(image: Floats, elevation_deg: tuple[float, float], *, underwater: bool) -> FreeView:
    """Return the freest part of a levelled panorama (h, w, 3) of linear light, its middle within these elevations.

    underwater: parts with the veil's colour, without red, are preferred, and parts that are not white or clipped. The
    cost is texture and what the constants say.
    """
    import cv2

    # Measure texture and brightness about each direction, over the seam of the panorama
    height, width = image.shape[:2]
    scale = height / 180.0
    pad = width // 8
    wrapped = np.concatenate([image[:, -pad:], image, image[:, :pad]], axis=1).astype(np.float32)
    light = np.log(np.maximum(luminance(wrapped), 0.0) + _DIM)
    fine = light - cv2.GaussianBlur(light, (0, 0), _COARSE_DEG * scale)
    box = (round(_WIDE_DEG * scale), round(_HIGH_DEG * scale))

    def mean(values: Floats) -> Floats:
        return np.asarray(cv2.blur(np.asarray(values, np.float32), box)[:, pad : pad + width])

    texture = np.sqrt(np.maximum(mean(fine * fine), 0.0))
    bright = mean(light)
    # Prefer smooth, lit water: no glitter, nothing red, and if there is any with all of its colour, that
    cost = texture + _BLACK * np.maximum(np.quantile(bright, 0.8) - bright, 0.0)
    if underwater:
        cost += _WHITE * mean((luminance(wrapped) > _GLITTER).astype(np.float32))
        cost += _CLIPS * mean((wrapped.max(axis=-1) > CLIPPED_LIGHT).astype(np.float32))
        cost += _RED * mean(np.nan_to_num(np.minimum(red_ratio(wrapped), 1.0), nan=0.0))
    # Prefer directions near the middle, within the elevations; take the least cost
    elevation = 90.0 - (np.arange(height) + 0.5) / scale
    azimuth = ((np.arange(width) + 0.5) / width - 0.5) * 360.0
    low, high = elevation_deg
    cost += _OFF_LEVEL * np.abs(elevation - 0.5 * (low + high))[:, None] + _OFF_MIDDLE * np.abs(azimuth)
    cost[(elevation < low) | (elevation > high)] = np.inf
    row, column = np.unravel_index(int(np.argmin(cost)), cost.shape)
    color = tuple(float(mean(wrapped[..., k])[row, column]) for k in range(3))
    near_azimuth, near_elevation = (round(v / _STEP_DEG) * _STEP_DEG + 0.0 for v in (azimuth[column], elevation[row]))
    near_elevation = float(np.clip(near_elevation, low, high))
    return near_azimuth, near_elevation, (color[0], color[1], color[2])


_REACH, _CELL = 7.5, 0.05
"""Half the side of the layout and its cell, in camera heights."""
_DARK = 0.004
"""Linear light added before logarithms: noise of dark plates is no structure."""
_BLUR = 0.12
"""Standard deviation of the blur before edges are taken, in camera heights: grass and grain are finer."""
_NEAR_GROUND = (0.4, 1.2)
"""Distances, in camera heights, of the ground that other ground is compared with: what lies before one's feet."""
_COLOR = 0.7
"""Weight of a difference of colour (logarithm of red or blue over green) against one of light."""
_LEAST_SPREAD = 0.15
"""Spread of the ground's light and colour, as logarithms, that no ground falls below."""
_BARE = 0.018
"""Fine structure (mean change of the logarithm of light) of ground, at least: sand has 0.02, hazy open water 0.015."""
_EDGES, _UNLIKE, _SHADE, _PLAIN, _CROSSED = 2.0, 0.15, 0.5, 0.2, 1.0
"""Costs of edges under the foot, of each spread of difference, of a factor of e of darkness, of a factor of e of
missing structure, and of the strongest edge across the way."""
_HIDES, _ASIDE, _ODD = 0.2, 0.002, 0.6
"""Costs of edges behind the body over the plate's mean, of a degree from the middle, of a factor of e of distance. With
less for the last two, large things go behind the crest of a slope, where the plate shows a valley."""
_RISES, _PATCH_DEG, _UNLIKE_FROM = 1.0, 3.0, 2.0
"""Cost of ground that goes on above the horizon, the size of patches that are compared, and by how many spreads of the
ground near by they differ at least where it does not."""
_NO_ROOM = 4.0
"""Cost of a place where all that is known of the plate's distances is in a body's way, or not below its foot."""
_INTO, _OFF_GROUND = 0.9, 0.15
"""Distance of what the plate shows over that of the body below which it is in the way, and difference of the
logarithms of ground and foot that counts as none."""
_SHADE_FROM, _PLAIN_FROM = 0.4, 0.5
"""Logarithms of darkness and of missing structure that cost nothing."""
_WAY_FROM, _LANE = 0.8, 0.6
"""Beginning of the path to a foot, and width of its lane, in camera heights."""
_ACROSS = 9
"""Points along a side of a foot, and of what a body hides."""
UNEVEN, _NO_PLACE = 0.9, 3.5
"""Costs above which a place is doubtful, and above which it is none where distances are known: what looks like rubble
costs 2.2 at most, before they are counted."""


Sides = tuple[float, float, float]
"""Of what has to find a place: across the line of sight, along it, and its height, all [m]."""


def ground_place(
    image: Floats, drop_m: float, body: Sides, distances_m: Array, azimuths_deg: Array, usual_m: float,
    shown_m: ShownDistance | None = None,
) -> tuple[float, float, float]:  # fmt: skip
    """Return the best of some places on the ground of a levelled panorama (h, w, 3) of linear light.

    That is the azimuth of its middle [deg], its level distance [m], and its cost, 0.3 on even ground.

    drop_m: height of the camera over the ground. distances_m: (n,), level. azimuths_deg: (m,). usual_m: the distance
    that is preferred where all else is equal. shown_m: tells the distances of what the plate shows, where it is known.
    """
    layout = _Layout(image)
    azimuth, distance = np.meshgrid(np.radians(azimuths_deg), distances_m / drop_m, indexing="ij")
    across, along = body[0] / drop_m, body[1] / drop_m
    side = np.linspace(-0.5, 0.5, _ACROSS)
    right, ahead = (points.ravel() for points in np.meshgrid(side * across, side * along))
    foot = layout.cells(azimuth[..., None], distance[..., None] + ahead, right)
    edges, fine = layout.edges[foot], layout.fine[foot].mean(axis=-1)
    shades = layout.shades[foot].mean(axis=-2)
    unlike = np.sqrt(np.mean(((shades - layout.usual) / layout.spread) ** 2, axis=-1))
    missing = np.log(max(layout.texture, _BARE) / np.maximum(fine, 1e-4))
    cost = _EDGES * (np.sqrt(np.mean(edges**2, axis=-1)) + 0.25 * edges.max(axis=-1)) + _UNLIKE * unlike
    cost += _SHADE * np.maximum(layout.usual[0] - shades[..., 0] - _SHADE_FROM, 0.0)
    cost += _PLAIN * np.maximum(missing - _PLAIN_FROM, 0.0) + np.maximum(np.log(_BARE / np.maximum(fine, 1e-4)), 0.0)
    cost += _CROSSED * _crossed(layout, azimuth[:, 0], distance[0] + 0.5 * along, across)
    cost += _HIDES * _hidden(image, azimuth, distance * drop_m, body, drop_m)
    cost += _RISES * _rising(image, azimuth, distance * drop_m, body[0], drop_m, layout.spread)
    if shown_m is not None:
        cost += _NO_ROOM * _crowded(shown_m, azimuth, distance * drop_m, body, drop_m)
    # Of places that are alike, one in the middle and as far away as usual
    unusual = _ASIDE * np.abs(np.degrees(azimuth)) + _ODD * np.abs(np.log(distance * drop_m / usual_m))
    row, column = np.unravel_index(int(np.argmin(cost + unusual)), cost.shape)
    return float(azimuths_deg[row]), float(distances_m[column]), float(cost[row, column])


def shows_ground(image: Floats) -> bool:
    """Return whether a levelled panorama (h, w, 3) of linear light shows ground near by: it has structure there."""
    return _Layout(image).texture > _BARE


class _Layout:
    """The light of a panorama (h, w, 3) on the level ground, seen from above.

    +x is to the right and +z down, the camera in the middle.

    shades: (n, n, 3) logarithms of light, of red and of blue over green, blurred. edges: (n, n) change of them across
    the blur. fine: (n, n) fine structure. usual, spread: (3,) of the ground near by; texture: its fine structure.
    """

    def __init__(self, image: Floats) -> None:
        import cv2

        # Read the plate where it shows a plane one height below the camera
        place = np.arange(-_REACH, _REACH, _CELL) + 0.5 * _CELL
        x, z = np.meshgrid(place, place)
        height, width = image.shape[:2]
        column, row = frame_from_direction(np.stack([x, np.full_like(x, -1.0), z], axis=-1), width, height)
        around = np.concatenate([image, image[:, :1]], axis=1).astype(np.float32)
        where = ((column - 0.5).astype(np.float32), (row - 0.5).astype(np.float32))
        seen = cv2.remap(around, *where, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        # Take light and colour, the edges between them, and what is finer
        shades = _shades(seen)
        self.shades = cv2.GaussianBlur(shades, (0, 0), _BLUR / _CELL).astype(np.float64)
        change = np.stack(np.gradient(self.shades, axis=(0, 1))) * (_BLUR / _CELL)
        self.edges = np.sqrt(np.sum(change**2, axis=(0, -1)))
        fine = np.abs(shades[..., 0] - self.shades[..., 0])
        self.fine: Array = cv2.blur(fine, (9, 9))
        # Measure the ground near by, that other ground is compared with
        far = np.hypot(x, z)
        near = (far > _NEAR_GROUND[0]) & (far < _NEAR_GROUND[1])
        self.usual = np.median(self.shades[near], axis=0)
        self.spread = np.maximum(1.48 * np.median(np.abs(self.shades[near] - self.usual), axis=0), _LEAST_SPREAD)
        self.texture = float(np.median(fine[near]))

    def cells(self, azimuth: Array, ahead: Array, right: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the (row, column) of points ahead and to the right in some azimuths [rad], in camera heights.

        Those outside are taken to the rim.
        """
        x = ahead * np.sin(azimuth) + right * np.cos(azimuth)
        z = right * np.sin(azimuth) - ahead * np.cos(azimuth)
        row, column = (np.clip(((v + _REACH) / _CELL).astype(int), 0, len(self.edges) - 1) for v in (z, x))
        return row, column


def _shades(image: Floats) -> Floats:
    """Return logarithms of light, and of red and blue over green with their weight, of an image (h, w, 3)."""
    channels = np.log(np.maximum(image, 0.0) + _DARK)
    light = np.log(np.maximum(luminance(image), 0.0) + _DARK)
    return np.stack([light, *(_COLOR * (channels[..., k] - channels[..., 1]) for k in (0, 2))], axis=-1)


def _crossed(layout: _Layout, azimuth: Array, ends: Array, width: float) -> Array:
    """Return the strongest edge (azimuths, ends) across the way from the camera to somewhat past some ends.

    The way is as wide as the foot; an edge counts where it crosses one of its lanes.
    """
    lanes = max(1, round(width / _LANE))
    ahead = np.arange(_WAY_FROM, _REACH, _BLUR)
    right = np.linspace(-0.5, 0.5, lanes * _ACROSS)[:, None] * max(width, _LANE)
    shades = layout.shades[layout.cells(azimuth[:, None, None], ahead, right)]
    shades = shades.reshape(len(azimuth), lanes, _ACROSS, len(ahead), 3).mean(axis=2)
    step = np.linalg.norm(shades[:, :, 2:] - shades[:, :, :-2], axis=-1).max(axis=1)
    last = np.searchsorted(ahead[1:-1], ends + 2.0 * _BLUR)
    return np.asarray(np.maximum.accumulate(step, axis=1)[:, np.minimum(last, step.shape[1] - 1)])


def _crowded(shown_m: ShownDistance, azimuth: Array, distance_m: Array, body: Sides, drop_m: float) -> Array:
    """Return the fraction of what is known of the plate about some places that leaves a body no room there.

    That is what is nearer than its sides and its top, and ground that is not where its foot is; 0 where nothing is
    known.
    """
    # Points of the body from its foot to its top, over its width and length
    across, along, up = (axis.ravel() for axis in np.meshgrid([-0.5, 0.0, 0.5], [-0.5, 0.0, 0.5], [0.0, 0.4, 0.9]))
    right, ahead, above = across * body[0], along * body[1], up * body[2] - drop_m
    level = distance_m[..., None] + ahead
    x = level * np.sin(azimuth[..., None]) + right * np.cos(azimuth[..., None])
    z = right * np.sin(azimuth[..., None]) - level * np.cos(azimuth[..., None])
    points = np.stack([x, np.broadcast_to(above, x.shape), z], axis=-1)
    away = np.linalg.norm(points, axis=-1)
    # Compare them with what the plate shows in their directions
    seen = shown_m(points / away[..., None]) / away
    ground = np.broadcast_to(up == 0.0, seen.shape)
    wrong = np.where(ground, np.abs(np.log(np.maximum(seen, 1e-6))) > _OFF_GROUND, seen < _INTO)
    known = np.isfinite(seen)
    return np.asarray(np.sum(wrong & known, axis=-1) / np.maximum(np.sum(known, axis=-1), 1))


def _hidden(image: Floats, azimuth: Array, distance_m: Array, body: Sides, drop_m: float) -> Array:
    """Return how much is to be seen behind a body at some places: edges there over those of the whole plate, less 1."""
    import cv2

    scale = image.shape[0] / 180.0
    light = cv2.GaussianBlur(np.log(np.maximum(luminance(image), 0.0) + _DARK).astype(np.float32), (0, 0), scale)
    edges = np.hypot(*np.gradient(light)) * scale
    across, up = np.meshgrid(np.linspace(-0.5, 0.5, _ACROSS), np.linspace(0.1, 1.0, _ACROSS))
    longitude = azimuth[..., None] + np.arctan(across.ravel() * body[0] / distance_m[..., None])
    latitude = np.arctan2(up.ravel() * body[2] - drop_m, distance_m[..., None])
    behind = np.mean(_at(edges, longitude, latitude), axis=-1) / max(float(np.mean(edges)), 1e-3)
    return np.asarray(np.maximum(behind - 1.0, -0.5))


def _rising(image: Floats, azimuth: Array, distance_m: Array, width_m: float, drop_m: float, spread: Array) -> Array:
    """Return how much of what is seen above the horizon over some places is like their ground, 0 to 1: level ground
    ends below it, a wall or a slope goes on.
    """
    import cv2

    size = max(round(_PATCH_DEG * image.shape[0] / 180.0), 1)
    shades = cv2.blur(_shades(image).astype(np.float32), (size, size))
    longitude = azimuth[..., None] + np.arctan(np.linspace(-0.5, 0.5, _ACROSS) * width_m / distance_m[..., None])
    foot = _at(shades, longitude, np.arctan2(-drop_m, distance_m[..., None]))
    above = _at(shades, longitude, np.full_like(longitude, np.radians(_PATCH_DEG)))
    unlike = np.linalg.norm((foot - above) / spread, axis=-1)
    return np.asarray(np.mean(np.maximum(1.0 - unlike / _UNLIKE_FROM, 0.0), axis=-1))


def _at(image: Floats, longitude: Array, latitude: Array) -> Floats:
    """Return the pixels of a panorama in directions [rad]."""
    height, width = image.shape[:2]
    column = np.floor((longitude / (2.0 * np.pi) + 0.5) * width).astype(int) % width
    row = np.clip(((0.5 - latitude / np.pi) * height).astype(int), 0, height - 1)
    return np.asarray(image[row, column])
