# SPDX-License-Identifier: Apache-2.0
"""Projections in which plates are stored."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

Projection = Literal["auto", "equirectangular", "dual_fisheye", "eac"]
"""How a plate's pixels are rays; auto: by the end of its name, else equirectangular."""

FISHEYE_FOV_DEG = 200.0
"""Angle [deg] across one half of a dual-fisheye frame where none is given. Cameras for 360 video have 189 to 205.
Given too small, what is near the seam is seen twice; too large, it is missing."""
FFMPEG_NAMES = {"dual_fisheye": "dfisheye", "eac": "eac"}
"""Names of projections in FFmpeg's filter v360."""
_BY_SUFFIX: dict[str, Projection] = {".insv": "dual_fisheye", ".360": "eac"}


def projection_of(path: Path, projection: Projection) -> Projection:
    """Return the projection of a plate, with "auto" replaced by that of the file's ending."""
    return _BY_SUFFIX.get(path.suffix.lower(), "equirectangular") if projection == "auto" else projection


def turned_by_ffmpeg(path: Path, projection: Projection) -> str:
    """Return the command that turns a still of a projection other than equirectangular, for messages."""
    angle = f":ih_fov={FISHEYE_FOV_DEG:g}:iv_fov={FISHEYE_FOV_DEG:g}" if projection == "dual_fisheye" else ""
    return f"ffmpeg -i {path.name} -vf v360={FFMPEG_NAMES[projection]}:e{angle} out.png"
