# SPDX-License-Identifier: Apache-2.0
"""What a plate shows by itself: eye and projection to read it with, water or air, day or dark, level, a floor below."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from mr360uw.color import luminance
from mr360uw.errors import VideoError
from mr360uw.first_look.water_or_air import WaterOrAir, ground_texture, light_at, water_or_air
from mr360uw.ibl import environment
from mr360uw.ibl.level.horizon import clip_horizon, estimate_horizon
from mr360uw.ibl.level.tilt import level_matrix
from mr360uw.ibl.plate import remap
from mr360uw.render.surroundings import is_tilted
from mr360uw.scene.inputs import eyes_of_plate, pose_of_plate, projection_notes, shape_of_frame
from mr360uw.scene.model import PlateSettings, Scene
from mr360uw.sphere import directions, frame_from_direction
from mr360uw.types import Floats
from mr360uw.video import VideoReader, open_video
from mr360uw.video.eyes_seen import EyesSeen
from mr360uw.video.read.picture_shape import ONE_PICTURE, SHOWN_PROJECTIONS, shown_projection, way_out
from mr360uw.video.read.projection import PICTURE_SUFFIXES, Projection, projection_of

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


@dataclass(frozen=True, slots=True)
class Tilt:
    """Roll and pitch [deg] of a camera, and what told them."""

    roll_deg: float
    pitch_deg: float
    by: str


@dataclass(frozen=True, slots=True, eq=False)
class PlateLook:
    """What was found in a plate. image: (512, 1024, 3) linear light, levelled, the median of a few frames; sharp: the
    same of the first.

    still: one picture. size: (width, height) [pixels]. eye: that was looked at, None of mono. projection: "auto" unless
    the plate shows another one. tilt: of the camera, None where it cannot be told or is level. floor: whether something
    is seen below. eyes: what the two of a stereo plate show, None of mono; notes: doubts about their arrangement and
    about the plate's projection, one line each.
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
    tilt: Tilt | None
    floor: bool
    eyes: EyesSeen | None = None
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
    eyes, doubt = eyes_of_plate(scene)
    notes += (doubt,) if doubt else ()
    floor = _has_floor(image, medium.underwater)
    return PlateLook(path, image, frames[0], still, size, eye, projection, medium, dark, tilt, floor, eyes, notes)


def _small(video: VideoReader, index: int) -> Floats:
    import cv2

    light = np.asarray(next(iter(video.frames(index, index + 1))).image_linear, np.float32)
    light = np.nan_to_num(np.clip(light, 0.0, None), nan=0.0, posinf=1.0)
    way = cv2.INTER_AREA if light.shape[1] > COLUMNS else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(light, (COLUMNS, ROWS), interpolation=way))


def _posed(plate: PlateSettings) -> Tilt | None:
    """Return the tilt that a plate's file states, None where it is level."""
    _, pitch, roll = pose_of_plate(plate)
    return Tilt(roll, pitch, "the pose that its file states") if is_tilted(pitch, roll) else None


def _tilt(frames: list[Floats]) -> Tilt | None:
    """Return the tilt of a camera under water that most frames agree on; None where it is small or cannot be told."""
    found = [estimate_horizon(environment(image, underwater=True).residual) for image in frames]
    clip = clip_horizon(found)
    if clip is None or np.hypot(clip.roll_rad, clip.pitch_rad) < _LEAST_TILT_RAD:
        return None
    roll, pitch = np.degrees([clip.roll_rad, clip.pitch_rad]).tolist()
    return Tilt(roll, pitch, "its window to the sky (Snell's)")


def _levelled(image: Floats, tilt: Tilt) -> Floats:
    seen = directions(COLUMNS, ROWS) @ level_matrix(*np.radians([tilt.roll_deg, tilt.pitch_deg]).tolist())
    return remap(np.asarray(image, np.float32), *frame_from_direction(seen, COLUMNS, ROWS))


def _has_floor(image: Floats, underwater: bool) -> bool:
    """Return whether something is seen between 20 and 60 degrees below the horizon; in air there always is."""
    if not underwater:
        return True
    brighter = light_at(image, -60.0, -20.0) - light_at(image, -5.0, 5.0)
    return ground_texture(image, -60.0, -20.0) > _FLOOR_TEXTURE or brighter > np.log(_FLOOR_LIGHT)
