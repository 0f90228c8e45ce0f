# SPDX-License-Identifier: Apache-2.0
"""Proposes a scene from what a plate and a mesh show, says in words what was found, and writes the scene's file."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mr360uw.base.color import encode
from mr360uw.base.constants import DEPTH_EYES_S, DEPTH_FRAME_S
from mr360uw.composite.mesh.mesh import MUCH_DARKER
from mr360uw.errors import ParameterError
from mr360uw.first_look.observations import LITTLE_RED, SURE, MeshLook, PlateLook, WaterOrAir
from mr360uw.first_look.place_in_plate import (
    UNEVEN,
    FreeView,
    Place,
    ShownDistance,
    Wish,
    free_view,
    guessed_drop_m,
    place_of,
)
from mr360uw.match import WaterPatch, match_water
from mr360uw.medium import Medium, Water
from mr360uw.medium.closed_form import CONTRAST_LENGTHS, LEAST_M, MOST_M, visibility_m, water_seen_as_far
from mr360uw.medium.water import JerlovType
from mr360uw.medium.waterfit import CONFIDENT
from mr360uw.scene.model import CameraSettings, PlateSettings, Scene
from mr360uw.scene.toml_model import toml_value
from mr360uw.types import Array, Floats
from mr360uw.video.clip import FISHEYE_FOV_DEG
from mr360uw.video.layout import EYES_APART_M

_DEPTH_M = 6.0
"""Depth of a camera that is not known: common in dives by daylight."""
_WATER: JerlovType = "IB"
_MURKY: JerlovType = "9C"
"""Types taken where none is told: of clear seas, and the one in which red goes as far as green."""
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


@dataclass(frozen=True, slots=True, eq=False)
class Proposal:
    """A scene as it is proposed for a plate and a mesh. water: None in air. floor_by: what told the floor's height, or
    "". exposure: stops by which the object is to be brighter, as the ground tells.
    """

    plate: PlateLook
    mesh: MeshLook
    wish: Wish
    place: Place
    water: WaterGuess | None
    depth_m: float
    floor_by: str
    exposure: float = 0.0

    @property
    def both(self) -> bool:
        """Whether both eyes of a stereo plate are worked on."""
        return self.plate.eye is not None and self.wish.eye is None


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
    return Proposal(plate, mesh, wish, place, water, float(depth), floor_by)


def _ground_below(plate: PlateLook, wish: Wish) -> tuple[float | None, str]:
    """Return the height of the camera over the ground, None where there is none, and what told it, "" if guessed."""
    if plate.floor_m is not None:
        return plate.floor_m, f"by the disparity of its eyes, if they are {EYES_APART_M:g} m apart"
    return guessed_drop_m(plate, wish), ""


def _nearest_type(plate: PlateLook, view: FreeView) -> tuple[JerlovType, float, tuple[str, ...]]:
    """Return the nearest type, its confidence, 0 where none has the plate's colour, and the others that are likely."""
    camera = CameraSettings(depth_m=_DEPTH_M, roll_deg=plate.roll_deg, pitch_deg=plate.pitch_deg)
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
_LEAST_TEXTURE, _LEAST_OVER_NOISE = 0.015, 8.0
"""Differences of the nearest floor over its light, and of half of it over those of open water, without which there is
none to see."""
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
"""Number of visibilities that are tried, up to that of clear ocean; darker places are in the shade."""


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

    # Find the dark places of the floor in bands of elevation
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
    # Ask at each visibility by how much the veil would be brighter than these
    visibility = np.unique(np.geomspace(least_m, max(least_m, _CLEAR_SIGHT_M), _STEPS))
    over = []
    for v in visibility:
        medium = Medium(water_seen_as_far(water, float(v)), camera_depth_m=depth_m)
        veil = color * medium.unit_veil(-height_m / up, up) / np.maximum(medium.level_radiance(level), _TINY)
        asked = np.log(np.maximum(veil, _TINY) / np.maximum(dark, _TINY))[:, seen].max(axis=1)
        over.append(np.sort(asked)[-2])
    # Take the least visibility at which it is not, or the clearest water with shade
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
    noise = np.minimum(noise, noise[-1])  # means over more pixels have less of it, and more of a glow
    below = float(np.median(green[round(rows * (0.5 + angle[0] / np.pi))]))
    if contrast[0] < _LEAST_TEXTURE * below or np.median(contrast / np.maximum(noise, _TINY)) < _LEAST_OVER_NOISE:
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
    """Return the median difference of light (h, w) about an elevation, between means over `high` rows and the middle of
    two that are `apart` columns to either side; so a glow that grows along the row makes none.
    """
    rows = len(light)
    middle = rows * (0.5 - elevation / np.pi)
    first = int(np.clip(round(middle - 0.5 * high), 0, rows - 1))
    across = light[first : first + max(round(high), 1)].mean(axis=0)
    box = np.convolve(np.pad(across, 2 * apart, mode="wrap"), np.ones(max(apart // 2, 1)) / max(apart // 2, 1), "same")
    return float(np.median(np.abs(box[2 * apart : -2 * apart] - 0.5 * (box[4 * apart :] + box[: -4 * apart]))))


# What was found and guessed, in words, and as a scene of some thirty lines.

_WIDTH = 34
"""Column at which comments of a scene start."""


def summary_line(chosen: Proposal, sun: str, *, in_doubt: bool) -> str:
    """Return what was made of a plate and a mesh in one sentence: what is where, in which light.

    sun: that of the plate, in words. in_doubt: whether it may be none, and the scene ends in lines that make it one.
    """
    place, mesh = chosen.place, chosen.mesh
    what = mesh.kind.word if mesh.kind else mesh.path.stem
    off = "in the water" if chosen.water else "in the air"
    how = "standing on the ground" if place.stands or place.on_shown else off
    if in_doubt:
        sun = "soft light, no sure sun, so weak shadows or none: if you see the sun, uncomment the scene's last lines"
    return f"{what}, {place.size_m:g} m long, {how} {_side(place.azimuth_deg)}, {place.distance_m:g} m away; {sun}"


def found_lines(chosen: Proposal, sun: str) -> list[str]:
    """Return a line for each thing found in the files or guessed. sun: that of the plate, in words."""
    # Say what the plate is, and how it is read
    plate, mesh = chosen.plate, chosen.mesh
    width, height = plate.size
    kind = "a still" if plate.still else "a clip"
    lines = [f"plate     {plate.path.name}: {kind}, {width}x{height}"]
    if plate.eye is not None:
        lines[0] += ", both eyes" if chosen.both else f", its {plate.eye} eye"
    if plate.projection != "auto":
        lines[0] += f", from {plate.projection}: it shows that"
    if plate.projection == "dual_fisheye":
        lines.append(f"lenses    {FISHEYE_FOV_DEG:g} degrees each, guessed: plate.fisheye_fov_deg sets it")
    # Say where it was taken, and what is not sure about that
    lines.append(where_line(plate.medium))
    if not plate.medium.said and plate.medium.confidence < SURE:
        lines.append(
            "unsure    white balance, dusk and lamps hide which: say it by --water or --air, or set water.type"
        )
    if plate.medium.half:
        lines.append(
            "half      half under and half over water: taken as under water, the camera at its surface; no body is "
            "drawn above"
        )
    # Say what lights it, how the camera stands, and what water, floor and depths were guessed
    lines.append(f"light     {'dark' if plate.dark else 'day'}; {sun}")
    if plate.tilt_by:
        lines.append(
            f"level     tilted, by {plate.tilt_by}: roll {plate.roll_deg:.0f}, pitch {plate.pitch_deg:.0f} degrees"
        )
    if chosen.wish.track is not None:
        lines.append(f"camera    stands or moves as {chosen.wish.track} says")
    elif not plate.still:
        lines.append("camera    taken as at rest: one look does not tell; if it swims, --track auto solves its path")
    if chosen.water is not None:
        lines += _water_lines(chosen)
    lines += [_floor_line(chosen), *_depth_lines(chosen)]
    # Say what the mesh is, and where it goes
    named = f"a {mesh.kind.word} by its name" if mesh.kind else "unknown by its name"
    lines.append(
        f"mesh      {mesh.path.name}: {named}; {mesh.why_size}: {mesh.size_m:g} m; front {mesh.front}, {mesh.why_front}"
    )
    if mesh.up != "auto":
        other = "y" if mesh.up == "z" else "z"
        lines.append(f"up        {mesh.up}, {mesh.why_up}; --up {other} if it lies on its side")
    return lines + _place_lines(chosen.place)


def where_line(medium: WaterOrAir) -> str:
    """Return whether a plate is under water or in air, and how that is told."""
    where, so = ("under water", "") if medium.underwater else ("in air", "; nothing is done about water")
    red = f"red is {medium.red_far:.2f} of green or blue in the distance"
    if medium.said:
        other = f", though it looks {'in air' if medium.underwater else 'under water'}"
        but = f"{other} (confidence {medium.confidence:.2f})" if medium.contradicted else ""
        return f"where     {where}, as you say{but}: {red}{so}"
    guess = "" if medium.confidence >= SURE else "a guess: "
    return f"where     {guess}{where}: {red}{so} (confidence {medium.confidence:.2f})"


def _floor_line(chosen: Proposal) -> str:
    """Return what is known of the ground."""
    place = chosen.place
    if place.drop_m is None or place.hangs:
        return "floor     none seen below, so no shadow on it (receiver)"
    how = chosen.floor_by or "guessed: nothing shows it"
    return f"floor     (receiver) {place.drop_m:.3g} m below the camera, {how}"


def _depth_lines(chosen: Proposal) -> list[str]:
    """Return what could tell how far away everything is, where that is not given."""
    plate, wish = chosen.plate, chosen.wish
    if wish.depth is not None or (wish.track is None and plate.eye is None):
        return []
    how = f"--track {wish.track}" if plate.eye is None else "--eye both"
    frame_s = DEPTH_FRAME_S if plate.eye is None else DEPTH_EYES_S
    return [
        f"behind    no body goes behind what is nearer: mr360uw depth {plate.path.name} -o depth {how} finds how far "
        f"away everything is, in about {frame_s:g} s a frame; then --depth depth"
    ]


def _place_lines(place: Place) -> list[str]:
    """Return where the object is, and what is doubtful there."""
    lines = []
    # Say what was made smaller, and where it stands or hangs
    if place.smaller:
        lines.append(
            f"size      made {place.size_m:g} m long, because this water hides what is farther away; size_m sets it"
        )
    off = f"off the floor, {place.elevation_deg:g} degrees over the horizon"
    how = "its foot on what the plate shows there" if place.on_shown else off
    how = "stands on the floor" if place.stands else how
    ahead = "seen from the side" if place.face != "camera" else "facing the camera"
    lines.append(f"place     {_side(place.azimuth_deg)}, {place.distance_m:g} m away, {how}, {ahead}")
    # Say what is doubtful about the ground
    if place.hangs:
        lines.append(
            "ground    none is seen with room to stand on, so it hangs in the water; --stand puts it on a floor"
        )
    elif place.uneven > UNEVEN:
        lines.append("ground    nowhere even: look at its foot; --at AZIMUTH,ELEVATION puts that elsewhere")
    return lines


def _water_lines(chosen: Proposal) -> list[str]:
    water = chosen.water
    assert water is not None
    code = np.round(255.0 * encode(np.clip(np.array(water.color), 0.0, 1.0), "srgb")).astype(int)
    hex_code = "".join(f"{c:02x}" for c in code.tolist())
    veil = f"open water has the colour #{hex_code} (veil)"
    if water.confidence <= 0.0:
        told = f"type {water.type} assumed: no Jerlov type has that colour"
    elif water.confidence >= CONFIDENT:
        told = f"type {water.type}, confidence {water.confidence:.2f}"
    else:
        others = f"; {', '.join(water.others)} are nearly as likely" if water.others else ""
        told = f"type {water.type} is nearest, confidence only {water.confidence:.2f}{others}"
    shade = f"; dark things near by have less haze (water.shade = {water.sight.shade:.2g})" if water.sight.shade else ""
    return [
        f"water     {told}; {veil}",
        f"sight     (visibility) {water.sight.visibility_m:.2g} m, {_sight_words(water.sight)}{shade}",
        f"depth     {chosen.depth_m:g} m guessed: one picture does not show it",
    ]


_WRONG_STOPS, _DOUBTFUL_STOPS, _MOST_STOPS = 1.5, 0.75, 3.0
"""Stops from which the light found is corrected under water, and from which that is proposed: of sand and rock of any
brightness most are within; and the most that it is corrected by: what asks for more is no ground."""


def corrected(chosen: Proposal, card_stops: float | None) -> Proposal:
    """Return a proposal with the exposure that the ground tells.

    card_stops: by which a grey card is brighter; None where no ground is seen. A lamp of the scene does not light the
    plate, whose ground then tells nothing.
    """
    if card_stops is None or chosen.plate.dark or abs(card_stops) < _DOUBTFUL_STOPS:
        return chosen
    return replace(chosen, exposure=round(min(max(-card_stops, -_MOST_STOPS), _MOST_STOPS), 1))


def brightness_lines(chosen: Proposal) -> list[str]:
    """Return a line where a grey card on the ground is brighter or darker than the ground."""
    stops = chosen.exposure
    if not stops:
        return []
    way = "darker" if stops > 0.0 else "brighter"
    by = f"{abs(stops):.1f} stops{' or more' * (abs(stops) >= _MOST_STOPS)}"
    done = "made up for by exposure" if _is_corrected(chosen) else f"exposure = {stops:.1f} would make up for that"
    return [f"grey      a grey card would be {by} {way} than the ground around it: {done}"]


def _is_corrected(chosen: Proposal) -> bool:
    return chosen.water is not None and abs(chosen.exposure) >= _WRONG_STOPS


def _sight_words(sight: Sight) -> str:
    """Return how well a visibility is known."""
    told = f"by the {sight.by}" if sight.by else "a guess, nothing shows it"
    return f"{told}; {sight.low_m:.2g} to {sight.high_m:.2g} m are as likely"


def _side(azimuth_deg: float) -> str:
    if abs(azimuth_deg) < 1.0:
        return "straight ahead"
    return f"{abs(azimuth_deg):g} degrees to the {'right' if azimuth_deg > 0.0 else 'left'}"


def scene_lines(chosen: Proposal, folder: Path, *, outside_files: bool) -> str:
    """Return the text of the scene, for a file in a folder."""
    plate, depth = chosen.plate, chosen.wish.depth
    rows: list[tuple[str, str]] = [("[plate]", ""), (f"path = {toml_value(relative_to(plate.path, folder))}", "")]
    if plate.eye is not None:
        rows.append(('eye = "both"', "of the stereo plate") if chosen.both else (f'eye = "{plate.eye}"', "of the two"))
    if plate.projection != "auto":
        rows.append((f'projection = "{plate.projection}"', "by what its first picture shows"))
    if depth is not None:
        note = "distances: bodies go behind what is nearer, shadows fall on it"
        rows.append((f"depth = {toml_value(relative_to(depth, folder))}", note))
    rows += [("", ""), *_camera_rows(chosen, folder), ("", ""), *_water_rows(chosen), ("", "")]
    rows += _object_rows(chosen, folder, outside_files=outside_files)
    if chosen.place.drop_m is not None and not chosen.place.hangs:
        known = chosen.floor_by or "a guess: height of the floor over the camera"
        rows += [
            ("", ""),
            ("[receiver]", "the floor, on which shadows fall"),
            (f"height_m = {-chosen.place.drop_m:.3g}", known),
        ]
    if plate.dark:
        rows += [("", ""), ("[[lamp]]", "the plate is dark"), ('attach = "camera"', ""), ("lumen = 3000.0", "")]
    head = [
        "# A scene of mr360uw, from a first look at its plate and mesh. What was guessed says so.",
        "# All keys: mr360uw schema --markdown",
        "",
    ]
    body = [f"{text:<{_WIDTH}} # {note}" if note else text for text, note in rows]
    return "\n".join([*head, *body, ""])


def _camera_rows(chosen: Proposal, folder: Path) -> list[tuple[str, str]]:
    plate, track = chosen.plate, chosen.wish.track
    guess = "a guess: how deep the camera was; sets light and colour"
    rows = [("[camera]", ""), (f"depth_m = {chosen.depth_m:g}", guess if chosen.water else "without water: no matter")]
    if track is not None:
        rows.append((f"track = {toml_value(relative_to(track, folder))}", ""))
    elif plate.tilt_by:
        rows.append((f"roll_deg = {plate.roll_deg:.1f}", f"by {plate.tilt_by}"))
        rows.append((f"pitch_deg = {plate.pitch_deg:.1f}", ""))
    return rows


def _water_rows(chosen: Proposal) -> list[tuple[str, str]]:
    if chosen.water is None:
        return [("[water]", ""), ('type = "none"', "the plate is in air")]
    water = chosen.water
    sure = f"confidence {water.confidence:.2f}" if water.confidence > 0.0 else "a guess"
    rows = [
        ("[water]", ""),
        (f'type = "{water.type}"', f"Jerlov: I IA IB II III, 1C 3C 5C 7C 9C; {sure}"),
        (f"visibility_m = {water.sight.visibility_m:.2g}", f"how far one sees; {_sight_words(water.sight)}"),
    ]
    if water.sight.shade > 0.0:
        rows.append(
            (f"shade = {water.sight.shade:.2g}", "fraction of the haze (veil) that is missing before what is near")
        )
    return rows


def _object_rows(chosen: Proposal, folder: Path, *, outside_files: bool) -> list[tuple[str, str]]:
    # Name the mesh, its size and its direction
    place, mesh = chosen.place, chosen.mesh
    why_size = mesh.why_size if place.size_m == mesh.size_m else "as it is put"
    rows = [
        ("[[object]]", ""),
        (f"mesh = {toml_value(relative_to(mesh.path, folder))}", ""),
        (f"size_m = {place.size_m:g}", f"longest side; {why_size}"),
        (f"azimuth_deg = {place.azimuth_deg:g}", "to the right of straight ahead"),
    ]
    # Stand it on the receiver, or set its height
    if place.stands:
        rows.append(('stand_on = "receiver"', "on the floor"))
    else:
        foot = "of its middle, whose foot is on what the plate shows" if place.on_shown else "over the horizon"
        rows.append((f"elevation_deg = {place.elevation_deg:g}", foot))
    # Turn it, and begin its first animation
    face = '"camera"' if isinstance(place.face, str) else f"{place.face:g}"
    rows += [
        (f"distance_m = {place.distance_m:g}", "from the camera"),
        *([(f'up = "{mesh.up}"', f"axis of the mesh that is up: {mesh.why_up}")] if mesh.up != "auto" else []),
        (f'front = "{mesh.front}"', f"of the mesh: {mesh.why_front}"),
        (f"face = {face}", 'azimuth its front points to, or "camera"'),
    ]
    if chosen.exposure:
        row = f"exposure = {chosen.exposure:.1f}"
        rows.append((row if _is_corrected(chosen) else f"# {row}", "stops, by the plate's ground beside a grey card"))
    if mesh.darkened_to <= MUCH_DARKER:
        left = f"they would darken the texture to {mesh.darkened_to:.2g} of it; true: as the file has them"
        rows.append(("vertex_colors = false", left))
    if len(mesh.clips) > 1:
        rows.append((f"animation = {toml_value(mesh.clips[0])}", f"the first of {len(mesh.clips)}"))
    return [*rows, ("outside_files = true", "")] if outside_files else rows


def relative_to(file: Path, folder: Path) -> str:
    """Return `file` as seen from `folder`, with forward slashes; absolute where they share no root."""
    try:
        return Path(os.path.relpath(file.resolve(), folder.resolve())).as_posix()
    except ValueError:
        return file.resolve().as_posix()
