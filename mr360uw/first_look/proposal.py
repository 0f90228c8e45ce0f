# SPDX-License-Identifier: Apache-2.0
"""Proposes a scene from what a plate and a mesh show: the water, and the place of the object."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mr360uw.errors import ParameterError
from mr360uw.first_look.mesh_look import MeshLook
from mr360uw.first_look.place_in_plate import FreeView, Place, ShownDistance, Wish, free_view, guessed_drop_m, place_of
from mr360uw.first_look.plate_look import LITTLE_RED, PlateLook
from mr360uw.match import WaterPatch, match_water
from mr360uw.medium import Medium, Water
from mr360uw.medium.visibility import CONTRAST_LENGTHS, LEAST_M, MOST_M, visibility_m, water_seen_as_far
from mr360uw.medium.water import JerlovType
from mr360uw.scene.model import CameraSettings, PlateSettings, Scene
from mr360uw.types import Array, Floats
from mr360uw.video.layout import EYES_APART_M

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


# How far one sees in the water of a panorama, by its level floor: how contrast falls off, how dark dark places are.
#
#     |L(x + l) - L(x)|  ~  exp(-c s)        veil(s, e; V) <= L(x)        s = h/sin(e)        V = 4.8/c
#
# Differences of light between places of the floor that lie a fixed length apart do not have the veil in them; the water
# between floor and camera leaves exp(-c s) of them (`medium.visibility`). A place of the floor has the whole veil
# before it in its light, in every channel, so the darkest ones say how far one sees at least; shade and crevices tell
# it well. Where they are darker than the clearest water allows, the water before them is in the shade
# (`Medium.in_shade`). h: height of the camera over the floor, e: angle below the horizon.


_STEEPEST_DEG, _FLATTEST_DEG, _ROWS = 55.0, 5.0, 16
"""Angles below the horizon between which the floor is looked at: flatter, a pixel averages over too much of it."""
_APART, _DEEP = 0.25, 0.5
"""Distance across of the places that are compared, and extent away from the camera of each, over the height."""
_NOISE = 1.5
"""Differences over those of open water from which they are the floor's."""
_SURE_HEIGHT, _GUESSED_HEIGHT = 1.1, 1.7
"""Factors that a known and a guessed height over the floor may be off by; the visibility is proportional to it."""
_USUAL_M, _USUAL_RANGE = 20.0, 2.0
"""Visibility of clear coasts where people dive, at most that of the type; half and double of it are as common."""
_LEAST_TEXTURE, _LEAST_OVER_NOISE = 0.015, 15.0
"""Differences of the nearest floor, over its light and over those of open water, without which there is none to see."""
_LEAST_ROWS = 5
_TINY = 1e-9
_UNSURE = 0.35
"""Standard error of c, relative to it, up to which it counts as told."""
_UNEVEN = 0.15
"""Standard error of the logarithm of c that a floor adds which is not the same everywhere."""
_DARK_DEG = (20.0, 25.0, 30.0, 37.0, 45.0)
"""Angles below the horizon at which dark places are looked for: flatter, what rises from the floor is much nearer."""
_DARK_SHARE, _BLUR_DEG, _HIGH_DEG = 0.05, 0.5, 2.0
"""Share of directions that are dark places, the blur that takes their noise, and the height of the bands of them."""
_SEEN = 0.01
"""Light of open water that a channel needs for its dark places to tell: some times the noise and the steps of codes."""
_STEPS, _CLEAR_SIGHT_M = 7, 60.0
"""How many visibilities are tried, up to that of clear ocean; darker places are in the shade."""


@dataclass(frozen=True, slots=True)
class Sight:
    """A visibility [m] and the range it is in. by: what told it, or "". shade: of the water near the camera."""

    visibility_m: float
    low_m: float
    high_m: float
    by: str = ""
    shade: float = 0.0


def guess_sight(
    image: Floats, height_m: float | None, water: Water, open_water: FreeView, depth_m: float, *, known: bool
) -> Sight:
    """Return the visibility in a levelled panorama (h, w, 3) of linear light: by its floor, or what is usual.

    height_m: of the camera over the floor, None where there is none; known: whether it is, or is guessed. water: the
    nearest type; open_water: of the panorama; depth_m: of the camera.
    """
    unsure = _SURE_HEIGHT if known else _GUESSED_HEIGHT
    found = None if height_m is None else _by_contrast(image, height_m, unsure)
    if found is None:
        usual = min(visibility_m(water), _USUAL_M)
        found = Sight(usual, usual / _USUAL_RANGE, min(usual * _USUAL_RANGE, MOST_M))
    if height_m is None:
        return found
    least, shade = _by_dark_places(image, height_m, water, open_water, depth_m, found.visibility_m)
    if least <= found.visibility_m and not shade:
        return found
    high = max(found.high_m, min(least * unsure, MOST_M))
    return Sight(least, least / unsure, high, "dark places of the floor", shade)


def _by_dark_places(
    image: Floats, height_m: float, water: Water, open_water: FreeView, depth_m: float, least_m: float
) -> tuple[float, float]:
    """Return the visibility [m] from which the veil before the floor is below its dark places, from `least_m` upwards,
    and the shade of the water that they ask for besides.

    Of the bands of directions the one that asks for most is left out.
    """
    import cv2

    scale = len(image) / 180.0
    smooth = cv2.GaussianBlur(np.asarray(image, np.float32), (0, 0), _BLUR_DEG * scale)
    half = 0.5 * _HIGH_DEG
    bands = [smooth[round((90.0 + e - half) * scale) : round((90.0 + e + half) * scale)] for e in _DARK_DEG]
    dark = np.array([np.quantile(band.reshape(-1, 3), _DARK_SHARE, axis=0) for band in bands])
    _, elevation_deg, light = open_water
    color, up = np.array(light), -np.sin(np.radians(_DARK_DEG))
    level, seen = np.sin(np.radians([elevation_deg])), color > _SEEN
    if not np.any(seen):
        return least_m, 0.0
    visibility = np.unique(np.geomspace(least_m, max(least_m, _CLEAR_SIGHT_M), _STEPS))
    over = []
    for v in visibility:
        medium = Medium(water_seen_as_far(water, float(v)), camera_depth_m=depth_m)
        veil = color * medium.unit_veil(-height_m / up, up) / np.maximum(medium.level_radiance(level), _TINY)
        asked = np.log(np.maximum(veil, _TINY) / np.maximum(dark, _TINY))[:, seen].max(axis=1)
        over.append(np.sort(asked)[-2])
    if over[0] <= 0.0:
        return least_m, 0.0
    if over[-1] > 0.0:
        needed = -np.expm1(-asked) * np.exp(-CONTRAST_LENGTHS / visibility[-1] * height_m / up)
        return float(visibility[-1]), float(np.clip(np.sort(needed)[-2], 0.0, 1.0))
    falling = np.minimum.accumulate(over)[::-1]
    return float(np.exp(np.interp(0.0, falling, np.log(visibility[::-1])))), 0.0


def _by_contrast(image: Floats, height_m: float, unsure: float) -> Sight | None:
    """Return the visibility by the floor of a levelled panorama (h, w, 3) of linear light; None where it is not told.

    height_m: of the camera over the floor; unsure: factor that it may be off by, 1 or more.
    """
    angle = np.radians(np.geomspace(_STEEPEST_DEG, _FLATTEST_DEG, _ROWS))
    green = np.asarray(image[..., 1], np.float64)
    rows, columns = green.shape
    apart = np.maximum(np.round(columns * _APART * np.tan(angle) / (2.0 * np.pi)).astype(int), 1)
    high = np.maximum(_DEEP * np.sin(angle) ** 2 * rows / np.pi, 1.0)
    contrast = np.array([_difference(green, -a, s, h) for a, s, h in zip(angle, apart, high, strict=True)])
    noise = np.array([_difference(green, np.radians(_FLATTEST_DEG), s, h) for s, h in zip(apart, high, strict=True)])
    below = float(np.median(green[round(rows * (0.5 + angle[0] / np.pi))]))
    if contrast[0] < max(_LEAST_TEXTURE * below, _LEAST_OVER_NOISE * noise[0]):
        return None
    seen = contrast > _NOISE * noise
    seen = np.logical_and.accumulate(seen)  # beyond the first row that does not show, all is noise
    if np.count_nonzero(seen) < _LEAST_ROWS:
        return None
    way = height_m / np.sin(angle[seen])
    log = 0.5 * np.log(contrast[seen] ** 2 - noise[seen] ** 2)
    (slope, _), covariance = np.polyfit(way, log, 1, cov=True)
    error = float(np.sqrt(covariance[0, 0]))
    if slope > -CONTRAST_LENGTHS / MOST_M or error > -_UNSURE * slope:
        return None
    visibility, wide = -CONTRAST_LENGTHS / slope, unsure * np.exp(2.0 * np.hypot(error / slope, _UNEVEN))
    low, high = (float(np.clip(v, LEAST_M, MOST_M)) for v in (visibility / wide, visibility * wide))
    return Sight(float(max(visibility, LEAST_M)), low, high, "contrast of the floor with distance")


def _difference(light: Array, elevation: float, apart: int, high: float) -> float:
    """Return the median difference of light (h, w) about an elevation, between means over `high` rows `apart` columns
    from each other."""
    rows = len(light)
    middle = rows * (0.5 - elevation / np.pi)
    first = int(np.clip(round(middle - 0.5 * high), 0, rows - 1))
    across = light[first : first + max(round(high), 1)].mean(axis=0)
    box = np.convolve(np.pad(across, apart, mode="wrap"), np.ones(max(apart // 2, 1)) / max(apart // 2, 1), "same")
    return float(np.median(np.abs(box[2 * apart :] - box[: -2 * apart])))
