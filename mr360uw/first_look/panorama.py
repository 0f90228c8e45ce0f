# SPDX-License-Identifier: Apache-2.0
"""Tells whether a plate is a panorama that can be worked on, and which eye of a stereo one to take."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from mr360uw.errors import VideoError
from mr360uw.video import open_video

Eye = Literal["left", "right"]


def eye_of(path: Path, eye: Eye | None) -> Eye | None:
    """Return the eye of a plate that is worked on: the one asked for, the left one of a stereo plate, None of mono.

    Raises `VideoError` where the plate is no equirectangular panorama.
    """
    try:
        with open_video(path, eye=eye):
            return eye
    except VideoError:
        if eye is not None or not _is_stereo(path):
            raise
    with open_video(path, eye="left"):
        return "left"


def _is_stereo(path: Path) -> bool:
    try:
        with open_video(path, eye="left", equirectangular=False):
            return True
    except VideoError:
        return False
