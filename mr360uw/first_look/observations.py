# SPDX-License-Identifier: Apache-2.0
"""Observations on a plate and on a mesh, before anything is asked.

Plate: eye and projection to read it with, water or air, day or dark, level, a floor below. Mesh: kind, size, front.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, cast

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.color import luminance
from mr360uw.base.sphere import directions, frame_from_direction, row_solid_angle
from mr360uw.composite import Mesh
from mr360uw.composite.mesh.mesh import METRES, Unit, mesh_of_file, object_from_file, read_mesh_file
from mr360uw.composite.mesh.up_axis import Habit, Kind, Up, asymmetry, kind_of, surface_points, up_axis
from mr360uw.composite.settings import Front
from mr360uw.errors import VideoError
from mr360uw.ibl import environment
from mr360uw.ibl.plate import remap
from mr360uw.ibl.tilt import clip_horizon, estimate_horizon, level_matrix
from mr360uw.medium.open_water import weighted_quantile
from mr360uw.render.surroundings import is_tilted
from mr360uw.scene.model import PlateSettings, Scene
from mr360uw.scene.resolved import eyes_of_plate, pose_of_plate, projection_notes, shape_of_frame
from mr360uw.types import Floats
from mr360uw.video import VideoReader, open_video
from mr360uw.video.clip import PICTURE_SUFFIXES, Projection, projection_of
from mr360uw.video.layout import ONE_PICTURE, SHOWN_PROJECTIONS, shown_projection, way_out

Eye = Literal["left", "right"]


def _reading_of(path: Path, eye: Eye | None) -> tuple[Eye | None, Projection]:
    """Return the eye that a plate is read with, None of mono, and the projection: "auto" unless it shows another one.

    It is the eye asked for, or the left one of a stereo plate. Raises `VideoError` where the plate is no panorama, and
    cannot be turned into one.
    """
    projection = _projection_shown(path) if eye is None else "auto"
    try:
        with open_video(path, eye=eye, projection=projection):
            return eye, projection
    except VideoError:
        if eye is not None or projection != "auto" or not _is_stereo(path):
            raise
    with open_video(path, eye="left"):
        return "left", "auto"


def _projection_shown(path: Path) -> Projection:
    """Return the projection that a plate's first picture shows; "auto" for a panorama, tagged as one or not."""
    if projection_of(path, "auto") != "equirectangular":
        return "auto"
    try:
        with open_video(path, equirectangular=False) as video:
            shape = "panorama" if video.spherical is not None else shape_of_frame(video)
    except VideoError:
        return "auto"  # the plate is opened again, and says why it cannot be read
    shown = shown_projection(shape, path)
    if (shown is None and shape in ONE_PICTURE) or (
        shape in SHOWN_PROJECTIONS and path.suffix.lower() in PICTURE_SUFFIXES
    ):
        raise VideoError(f"{path} - {way_out(shape, path)}")
    return shown or "auto"


def _is_stereo(path: Path) -> bool:
    try:
        with open_video(path, eye="left", equirectangular=False):
            return True
    except VideoError:
        return False


COLUMNS, ROWS = 1024, 512
"""Pixels of the picture that is looked at."""
_FRAMES = 3
"""Frames of a clip that are looked at, evenly spread: what swims through is in one of them only."""
_LEAST_TILT_RAD = np.radians(5.0)
"""Tilt below which a plate is taken as level: low sun and waves move the window by up to 4.4 degrees."""
_DARK = 0.02
"""Linear light that a tenth of the upper hemisphere of a plate by day exceeds."""
_FLOOR_TEXTURE = 0.01
"""Structure from which what is below is a floor. Open water has 0.003 to 0.006, the faintest floors 0.014."""
_FLOOR_LIGHT = 0.9
"""Light from below over that at the horizon from which a smooth floor is likely; open water gets darker downwards."""


_Tilt = tuple[float, float, str]
"""Roll and pitch [deg] of a camera, and what told them."""


@dataclass(frozen=True, slots=True, eq=False)
class PlateLook:
    """Observations on a plate. image: (512, 1024, 3) linear light, levelled, the median of a few frames; sharp: the
    same of the first.

    still: one picture. size: (width, height) [pixels]. eye: that was looked at, None of mono. projection: "auto" unless
    the plate shows another one. roll_deg, pitch_deg: of the camera; tilt_by: what told them, "" where they cannot be
    told or it is level. floor: whether something is seen below. eyes_agree: whether the plate has two eyes, arranged as
    it is read. floor_m: height of the camera over the ground by these, None where they do not tell it; notes: doubts
    about their arrangement and about the plate's projection, one line each.
    """

    path: Path
    image: Floats
    sharp: Floats
    still: bool
    size: tuple[int, int]
    eye: Eye | None
    projection: Projection
    medium: WaterOrAir
    dark: bool
    roll_deg: float
    pitch_deg: float
    tilt_by: str
    floor: bool
    eyes_agree: bool = False
    floor_m: float | None = None
    notes: tuple[str, ...] = ()


def look_at_plate(path: Path, eye: Eye | None = None, *, underwater: bool | None = None) -> PlateLook:
    """Return what a plate shows; raise `VideoError` where it is no panorama, or cannot be read.

    underwater: whether it is, as the user says; None tells it by the picture.
    """
    eye, projection = _reading_of(path, eye)
    with open_video(path, eye=eye, projection=projection) as video:
        count = 1 if video.is_still else video.frame_count or 1
        chosen = sorted(set(np.linspace(0, count - 1, _FRAMES).astype(int).tolist()))
        frames = [_small(video, index) for index in chosen]
        still, size = video.is_still, (video.width, video.height)
        scene = Scene(plate=PlateSettings(path=path, eye=eye, projection=projection))
        notes = projection_notes(scene, video)
    # The file's pose says how the camera was held; without one, the window to the sky may
    image, tilt = np.median(frames, axis=0), _posed(scene.plate)
    if tilt is not None:
        image, frames = _levelled(image, tilt), [_levelled(frame, tilt) for frame in frames]
    medium = water_or_air(image)
    medium = medium if underwater is None else medium.decided(underwater=underwater)
    if tilt is None and medium.underwater and (tilt := _tilt(frames)) is not None:
        image, frames[0] = _levelled(image, tilt), _levelled(frames[0], tilt)
    upper = luminance(image[: ROWS // 2])
    dark = float(np.quantile(upper, 0.9)) < _DARK
    doubt, floor_m = eyes_of_plate(scene)
    notes += (doubt,) if doubt else ()
    floor, agree = _has_floor(image, medium.underwater), eye is not None and not doubt
    return PlateLook(
        path, image, frames[0], still, size, eye, projection, medium, dark, *(tilt or (0.0, 0.0, "")), floor, agree,
        floor_m, notes,
    )  # fmt: skip


def _small(video: VideoReader, index: int) -> Floats:
    import cv2

    light = np.asarray(next(iter(video.frames(index, index + 1))).image_linear, np.float32)
    light = np.nan_to_num(np.clip(light, 0.0, None), nan=0.0, posinf=1.0)
    way = cv2.INTER_AREA if light.shape[1] > COLUMNS else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(light, (COLUMNS, ROWS), interpolation=way))


def _posed(plate: PlateSettings) -> _Tilt | None:
    """Return the tilt that a plate's file states, None where it is level."""
    _, pitch, roll = pose_of_plate(plate)
    return (roll, pitch, "the pose that its file states") if is_tilted(pitch, roll) else None


def _tilt(frames: list[Floats]) -> _Tilt | None:
    """Return the tilt of a camera under water that most frames agree on; None where it is small or cannot be told."""
    found = [estimate_horizon(environment(image, underwater=True).residual) for image in frames]
    clip = clip_horizon(found)
    if clip is None or np.hypot(*clip[:2]) < _LEAST_TILT_RAD:
        return None
    roll, pitch = np.degrees(clip[:2]).tolist()
    return roll, pitch, "its window to the sky (Snell's)"


def _levelled(image: Floats, tilt: _Tilt) -> Floats:
    seen = directions(COLUMNS, ROWS) @ level_matrix(*np.radians(tilt[:2]).tolist())
    return remap(np.asarray(image, np.float32), *frame_from_direction(seen, COLUMNS, ROWS))


def _has_floor(image: Floats, underwater: bool) -> bool:
    """Return whether something is seen between 20 and 60 degrees below the horizon; in air there always is."""
    if not underwater:
        return True
    brighter = _light_at(image, -60.0, -20.0) - _light_at(image, -5.0, 5.0)
    return _ground_texture(image, -60.0, -20.0) > _FLOOR_TEXTURE or brighter > np.log(_FLOOR_LIGHT)


# Tells plates under water from plates in air by the red that is missing in the distance, and by ground that is.
#
# Water absorbs red within a few metres, so the far distance, which a panorama shows about its horizon, has little of
# it:
#
#     q = 10 % quantile over |elevation| < 8 degrees of R / max(G, B)        s = 90 % quantile below the horizon
#
# In air the distance may be blue, but the ground nearby has red. A strobe gives the ground nearby its red back; then
# only a very low q tells. Murky coastal water keeps some red, but hides the ground: nothing is seen below, and light
# falls off from high above the horizon to far below. In air there is always a ground.
#
# How sure that is, a second measure says that no white balance changes: how much the ratio rises from the horizon to
# the zenith. Light from above comes a shorter way through the water and has more red, while a sky is bluer overhead:
#
#     rise = log(median above 50 degrees / median over |elevation| < 8 degrees)
#
# Dives whose white balance put the red back, and dusk, whose light has little, get a low confidence by it. Below 0.5
# the rise decides instead of the red: under water where it rises and light falls from above, in air where it falls, but
# for plates with next to no red and those half under water. One picture is never sure.
#
# Measured on 28 plates, each as it is and with a grey-world white balance, and those in air also in the colours of dusk
# and of night: 96 pictures. The limits of the rise were chosen on every second plate, where 47 of 48 pictures are
# right, all 10 of a confidence below 0.5. Of the others 46 of 48 are right, and 11 of 12 (4 by the red alone). What is
# wrong is a chart and a studio in the colours of dusk, and a dive lit by strobes whose white balance put the red back.
#
# Structure of the ground is taken between 3 and 12 degrees and along rows: grain is finer, and what open water does, it
# does in all directions alike.

_FINE_DEG, _COARSE_DEG = 3.0, 12.0
_TOE = 0.01
"""Linear light that is added before the logarithm: what is darker has grain alone."""
_MARGIN_DEG = 36.0
"""Columns taken from the other side of the seam, three deviations of the coarse Gaussian."""


def _ground_texture(image: Floats, lowest_deg: float, highest_deg: float) -> float:
    """Return the structure of a levelled panorama (h, w, 3) of linear light between two elevations.

    It is the root mean square along rows of the logarithm of light: 0.01 in open water, 0.06 and more over dry ground.
    """
    import cv2

    scale = image.shape[0] / 180.0
    margin = round(_MARGIN_DEG * scale)
    light = np.pad(luminance(np.maximum(image, 0.0)), ((0, 0), (margin, margin)), mode="wrap").astype(np.float32)
    fine = np.log(cv2.GaussianBlur(light, (0, 0), _FINE_DEG * scale) + _TOE)
    band = (fine - cv2.GaussianBlur(fine, (0, 0), _COARSE_DEG * scale))[_rows(scale, lowest_deg, highest_deg)]
    inner = band[:, margin:-margin]
    return float(np.std(inner - inner.mean(axis=1, keepdims=True)))


def _light_at(image: Floats, lowest_deg: float, highest_deg: float) -> float:
    """Return the logarithm of a levelled panorama's light (h, w, 3) between two elevations: its median."""
    light = luminance(image[_rows(image.shape[0] / 180.0, lowest_deg, highest_deg)])
    return float(np.log(max(float(np.median(light)), 0.0) + _TOE))


def _rows(scale: float, lowest_deg: float, highest_deg: float) -> slice:
    return slice(round((90.0 - highest_deg) * scale), round((90.0 - lowest_deg) * scale))


_BAND_SINE = float(np.sin(np.radians(8.0)))
_BELOW_SINE = float(np.sin(np.radians(-5.0)))
_NO_RED = 0.16
"""q below which a plate is under water whatever its ground shows. Real plates in air: 0.24 and more."""
LITTLE_RED, _GROUND_RED = 0.45, 0.62
"""q and s below which, together, a plate is under water. Coastal water has 0.35 and 0.5; dry ground 0.7 and more."""
_NO_GROUND = 0.035
"""Structure below the horizon under which no ground is seen. Dry ground: 0.059 and more; murky water: 0.02 and less."""
_FALL = 0.4
"""Logarithm of light 40 degrees higher over that at the horizon, and of that over light 45 degrees lower, at least."""
_REDDEST = 1.1
"""R / max(G, B), median below the horizon, above which no murk is water: soil and sunsets are redder."""
_LOW_SKY, _MORE_RED = 0.42, 2.0
"""Red ratio of the lowest sky, and that over the ratio just below the horizon, from which the plate is half in air.
Real skies have 0.4 to 1.5 there, and water at most 0.39; murky water below, 0.35, is not told from a sky."""
_SKY_DEG, _SEA_DEG = (3.0, 12.0), (-12.0, -3.0)
_SURE = 0.35
"""Distance of the logarithm of a measure from its limit at which the answer is sure."""
_TOP_SINE = float(np.sin(np.radians(50.0)))
_RISE = 0.25
"""Rise at which it speaks for water, and fall for air, as clearly as it can. Dives have 0.25 to 1.3, skies less than 0,
rooms up to 0.11; one dive of 8 has a fall."""
_ALONE, _AGREED = 0.55, 0.9
"""Confidence of an answer about which the rise says nothing, and of one that it supports; one that it contradicts has
as much less as this has more."""
SURE = 0.5
"""Confidence below which the answer is a guess, and the rise decides."""
_RISES, _HARDLY_RED = 0.1, 0.03
"""Rise, or fall, that decides: 0.05 to 0.2 give the same answers. q below which no fall does: skies at dusk have 0.07
and more."""
_COLOURLESS = 0.004
"""Linear light below which a pixel has no colour: one code of 8 bits."""


@dataclass(frozen=True, slots=True)
class WaterOrAir:
    """Whether a plate is under water. confidence: of that, 0 to 0.9. red_far: q of the module's text.

    half: whether it is so below the horizon only, and in air above. said: whether it is not by the picture, but as the
    user says; confidence is then that of the picture, which shows the contrary where `contradicted`.
    """

    underwater: bool
    confidence: float
    red_far: float
    half: bool = False
    said: bool = False
    contradicted: bool = False

    def decided(self, *, underwater: bool) -> WaterOrAir:
        """Return what a user says of a plate that shows this."""
        half = self.half and underwater
        return replace(self, underwater=underwater, half=half, said=True, contradicted=underwater != self.underwater)


def red_ratio(image: Floats) -> Floats:
    """Return R / max(G, B) (h, w) of linear light (h, w, 3); NaN where it is too dark to have a colour."""
    most = image[..., 1:].max(axis=-1)
    bright = np.maximum(most, image[..., 0]) > _COLOURLESS
    return np.where(bright, np.maximum(image[..., 0], 0.0) / np.maximum(most, _COLOURLESS), np.nan)


def water_or_air(image: Floats) -> WaterOrAir:
    """Return whether a levelled panorama (h, w, 3) of linear light is under water; without any light it is in air."""
    height, width = image.shape[:2]
    up = directions(width, height)[..., 1]
    weight = np.broadcast_to(row_solid_angle(width, height)[:, None], up.shape)
    ratio = red_ratio(image)
    lit = np.isfinite(ratio)
    far, near = (
        _quantile(ratio, weight, lit & there, q)
        for there, q in ((np.abs(up) < _BAND_SINE, 0.1), (up < _BELOW_SINE, 0.9))
    )
    if np.isnan(far):
        return WaterOrAir(False, 0.0, 1.0)
    if np.isnan(near):  # the ground is black, as over deep water
        near = far
    margins = [
        np.log(_NO_RED / max(far, 1e-6)),
        min(np.log(LITTLE_RED / max(far, 1e-6)), np.log(_GROUND_RED / max(near, 1e-6))),
        _murk(image, _quantile(ratio, weight, lit & (up < _BELOW_SINE), 0.5)),
    ]
    margin = float(max(margins))
    top, level = (_quantile(ratio, weight, lit & there, 0.5) for there in (up > _TOP_SINE, np.abs(up) < _BAND_SINE))
    rise = np.nan_to_num(np.log(max(top, 1e-6) / max(level, 1e-6)))
    support = float(np.clip(rise / _RISE, -1.0, 1.0)) * (1.0 if margin > 0.0 else -1.0)
    confidence = min(abs(margin) / _SURE, 1.0) * (_ALONE + (_AGREED - _ALONE) * support)
    # Where both contradict each other, light from above and its red tell more than the red in the distance
    wet = margin > 0.0
    half = wet and _half_in_air(ratio, weight, up)
    if confidence < SURE and wet:
        wet = rise > -_RISES or far < _HARDLY_RED or half  # there is a sky above half water
    elif confidence < SURE:
        wet = rise > _RISES and _light_at(image, 35.0, 45.0) > _light_at(image, -5.0, 5.0)
    return WaterOrAir(wet, confidence, far, half)


def _half_in_air(ratio: Floats, weight: Floats, up: Floats) -> bool:
    """Return whether there is red just above the horizon, as in a sky, and little just below it, as in water."""
    sky, sea = (
        _quantile(ratio, weight, np.isfinite(ratio) & (up > np.sin(low)) & (up < np.sin(high)), 0.5)
        for low, high in (np.radians(_SKY_DEG), np.radians(_SEA_DEG))
    )
    return sky > max(_LOW_SKY, _MORE_RED * sea)


def _murk(image: Floats, red: float) -> float:
    """Return by how much a panorama is murky water: the least margin, in logarithms. red: median of the ratio below."""
    level = _light_at(image, -5.0, 5.0)
    return min(
        np.log(_NO_GROUND / max(_ground_texture(image, -50.0, -5.0), 1e-6)),
        _light_at(image, 35.0, 45.0) - level - _FALL,
        level - _light_at(image, -50.0, -40.0) - _FALL,
        -np.inf if np.isnan(red) else np.log(_REDDEST / max(red, 1e-6)),
    )


def _quantile(values: Floats, weight: Floats, there: NDArray[np.bool_], quantile: float) -> float:
    """Return the weighted quantile of some values, NaN of none."""
    return weighted_quantile(values[there], weight[there], quantile) if np.any(there) else float("nan")


# What a mesh shows by itself: the kind of thing, its size in metres, its front, and whether it stands on a floor.
#
# The kind is told by words in the names of its file and parts. Of the axes x and z, that one is its left-right axis
# about which it is clearly more mirror-symmetric. The other one points to its front; of a body that is longest along
# it, the thicker end is the front (heads are thicker than tails). Where that does not tell, +z is the front, as glTF
# has it.

_UNITS: dict[Unit, str] = {"m": "metres", "cm": "centimetres", "mm": "millimetres"}
_LOW_M, _HIGH_M, _TYPICAL_M = 0.1, 20.0, 1.0
"""Sizes of things of an unknown kind."""
_LARGE_M = 3.0
"""Typical length from which a kind is large."""
_CLEARLY = 0.6
"""Ratio of the asymmetries about two axes below which the lesser one is the left-right axis."""
_LONG = 0.8
"""Length over width from which a body counts as long, so that its thicker end may be a head."""
_THICKER = 0.4
"""Logarithm of the ratio of cross-sections near both ends from which one is the thicker."""


@dataclass(frozen=True, slots=True)
class MeshLook:
    """Observations on a mesh. size_m: its longest side. why_size: the reason, in words.

    extent: (3,) sides over the longest. front: the side that is its front. long: whether it is longer than wide. kind:
    of thing, or None. clips: names of its animations. up: the axis of its file that is up, or "auto" where the file
    says it; why_up: what tells it. darkened_to: of `Mesh`.
    """

    path: Path
    kind: Kind | None
    size_m: float
    why_size: str
    extent: tuple[float, float, float]
    front: Front
    why_front: str
    long: bool
    habit: Habit
    clips: tuple[str, ...]
    up: Up = "auto"
    why_up: str = ""
    darkened_to: float = 1.0

    @property
    def large(self) -> bool:
        """Whether its kind is large, as whales and wrecks are: they should look it."""
        return self.kind is not None and self.kind.typical_m >= _LARGE_M


def look_at_mesh(path: Path, *, up: Up = "auto", outside_files: bool = False) -> MeshLook:
    """Return what a mesh shows; raise `MeshError` where it cannot be read. up: its upward axis, if known."""
    file = read_mesh_file(path, outside=outside_files)
    axis, why_up = (up, "asked for") if up != "auto" else up_axis(path, file)
    mesh = mesh_of_file(path, file, object_from_file(path, file, "auto", axis)[0])
    clips = () if file.rigging is None else file.rigging.clips
    kind = kind_of(path.stem, (part.name for part in file.parts))
    longest = float(np.max(mesh.extent_m))
    size, why = _size(kind, longest, cad=file.cad or (file.head is not None and axis == "z"))
    front, why_front, long = _front(mesh, kind)
    x, y, z = (mesh.extent_m / longest).tolist()
    habit: Habit = kind.habit if kind else "stands"
    known = up == "auto" and file.head is None
    return MeshLook(
        path, kind, size, why, (x, y, z), front, why_front, long, habit, clips, "auto" if known else axis,
        why_up or "nothing shows another", mesh.darkened_to,
    )  # fmt: skip


def _size(kind: Kind | None, units: float, *, cad: bool) -> tuple[float, str]:
    """Return the length [m] of the longest side, which the file has in `units`, and the reason.

    Metres where they fit. Of other units that fit, machines are in millimetres (cad), and other things are in that of
    which their size is nearer to the usual one.
    """
    low, high, typical = (kind.low_m, kind.high_m, kind.typical_m) if kind else (_LOW_M, _HIGH_M, _TYPICAL_M)
    what = f"a {kind.word}" if kind else "a thing"
    sizes = {name: units * METRES[unit] for unit, name in _UNITS.items()}
    fitting = [name for name, size in sizes.items() if low <= size <= high]
    if not fitting:
        return typical, f"its {units:.3g} units fit no unit for {what}, so a typical size"
    usual = min(fitting, key=lambda name: abs(math.log(sizes[name] / typical)))
    name = fitting[0] if "metres" in fitting else fitting[-1] if cad else usual
    return float(f"{sizes[name]:.3g}"), f"its {units:.3g} units are {name}"


def _front(mesh: Mesh, kind: Kind | None) -> tuple[Front, str, bool]:
    """Return the front, the reason, and whether the body is longer than wide."""
    points = surface_points(mesh.positions) - mesh.center_m
    unlike = {axis: asymmetry(points, axis) for axis in (0, 2)}
    length = {axis: float(mesh.extent_m[axis]) for axis in (0, 2)}
    lateral = min(unlike, key=lambda axis: unlike[axis])
    if unlike[lateral] < _CLEARLY * unlike[2 - lateral]:
        axis, why = 2 - lateral, "by its symmetry"
    else:
        axis, why = (0 if length[0] > 1.05 * length[2] else 2), "by its length"
    long = length[axis] > _LONG * length[2 - axis]
    thicker = _thicker_end(points, axis, mesh.extent_m)
    if long and (kind is None or kind.blunt) and abs(thicker) > _THICKER:
        sign, why = "+" if thicker > 0.0 else "-", f"{why}, its thicker end"
    else:
        sign = "+"
    return cast("Front", f"{sign}{'xyz'[axis]}"), why, long


def _thicker_end(points: Floats, axis: int, extent: Floats) -> float:
    """Return the logarithm of the cross-section near the positive end of an axis over that near the negative end."""
    along = points[:, axis] / extent[axis]
    ends = []
    for low, high in ((0.2, 0.4), (-0.4, -0.2)):
        there = points[(along > low) & (along < high)]
        ends.append(np.ptp(there[:, 1]) * np.ptp(there[:, 2 - axis]) if len(there) > 1 else 0.0)
    least = 1e-9 * float(np.max(extent)) ** 2
    return float(np.log((ends[0] + least) / (ends[1] + least)))
