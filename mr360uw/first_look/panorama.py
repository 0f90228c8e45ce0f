# SPDX-License-Identifier: Apache-2.0
"""Tells how a plate's file is read as a panorama: which eye of a stereo one, and from which projection."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from mr360uw.errors import VideoError
from mr360uw.scene.inputs import shape_of_frame
from mr360uw.video import open_video
from mr360uw.video.read.picture_shape import SHOWN_PROJECTIONS, way_out
from mr360uw.video.read.projection import Projection, projection_of
from mr360uw.video.read.suffixes import PICTURE_SUFFIXES

Eye = Literal["left", "right"]


@dataclass(frozen=True, slots=True)
class PlateReading:
    """How a plate is read.

    eye: of a stereo plate, None of mono. projection: "auto" unless its pictures show another one.
    """

    eye: Eye | None = None
    projection: Projection = "auto"


def reading_of(path: Path, eye: Eye | None) -> PlateReading:
    """Return how a plate is read: with the eye asked for or the left one of a stereo plate; from what it shows.

    Raises `VideoError` where the plate is no panorama, and cannot be turned into one.
    """
    projection = _projection_shown(path) if eye is None else "auto"
    try:
        with open_video(path, eye=eye, projection=projection):
            return PlateReading(eye, projection)
    except VideoError:
        if eye is not None or projection != "auto" or not _is_stereo(path):
            raise
    with open_video(path, eye="left"):
        return PlateReading("left")


def _projection_shown(path: Path) -> Projection:
    """Return the projection that a plate's first picture shows; "auto" for a panorama, tagged as one or not."""
    if projection_of(path, "auto") != "equirectangular":
        return "auto"
    try:
        with open_video(path, equirectangular=False) as video:
            shape = "panorama" if video.spherical is not None else shape_of_frame(video)
    except VideoError:
        return "auto"  # the plate is opened again, and says why it cannot be read
    if shape in SHOWN_PROJECTIONS and path.suffix.lower() in PICTURE_SUFFIXES:
        raise VideoError(f"{path} - {way_out(shape, path)}")
    return SHOWN_PROJECTIONS.get(shape, "auto")


def _is_stereo(path: Path) -> bool:
    try:
        with open_video(path, eye="left", equirectangular=False):
            return True
    except VideoError:
        return False
