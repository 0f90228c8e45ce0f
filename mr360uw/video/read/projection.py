# SPDX-License-Identifier: Apache-2.0
"""How plates are stored: ends of their names, projections, and rows of cube faces of GoPro's 360 cameras.

A track of such a camera is a row of three faces. The middle face is seen by one lens. The seam between the lenses runs
through the middle of each outer face, which stores the strip about it twice, side by side; they are blended into one.
Widths of the strip: Bourke 2020.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

INTEGER_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp")
FLOAT_SUFFIXES = (".exr", ".hdr")
WRITTEN_SUFFIXES = INTEGER_SUFFIXES + FLOAT_SUFFIXES
RAW_SUFFIXES = (".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".rw2", ".orf", ".gpr", ".nrw", ".pef", ".srw",
                ".rwl", ".x3f", ".3fr", ".iiq", ".fff", ".erf", ".kdc", ".dcr", ".mrw", ".sr2")  # fmt: skip
_READ_SUFFIXES = (".insp", ".dpx", ".tga", ".jp2", ".j2k", ".avif", ".jpe", ".jfif", ".dib", ".heic", ".heif",
                  ".pic", ".rgbe", ".xyze")  # fmt: skip
UNREAD_SUFFIXES = (
    ".psd", ".psb", ".xcf", ".kra", ".jxl", ".gif", ".ppm", ".pgm", ".pnm", ".pfm", ".qoi", ".jxr", ".hdp", ".wdp",
    ".dds", ".ktx", ".ktx2", ".sgi", ".pcx", ".ico", ".svg", ".pdf", ".eps", ".ai", ".thm", ".afphoto",
)  # fmt: skip
PICTURE_SUFFIXES = WRITTEN_SUFFIXES + _READ_SUFFIXES + RAW_SUFFIXES + UNREAD_SUFFIXES
"""Endings of pictures: those that are read and written, that are read alone, and two groups that are not read."""


Projection = Literal["auto", "equirectangular", "dual_fisheye", "eac"]
"""How a plate's pixels are rays; auto: by the end of its name, else equirectangular."""

FISHEYE_FOV_DEG = 200.0
"""Angle [deg] across one half of a dual-fisheye frame where none is given. Cameras for 360 video have 189 to 205.
Given too small, what is near the seam is seen twice; too large, it is missing."""
FFMPEG_NAMES = {"dual_fisheye": "dfisheye", "eac": "eac"}
"""Names of projections in FFmpeg's filter v360."""
_BY_SUFFIX: dict[str, Projection] = {
    ".insv": "dual_fisheye", ".insp": "dual_fisheye", ".osv": "dual_fisheye", ".360": "eac"
}  # fmt: skip


def projection_of(path: Path, projection: Projection) -> Projection:
    """Return the projection of a plate, with "auto" replaced by that of the file's ending."""
    return _BY_SUFFIX.get(path.suffix.lower(), "equirectangular") if projection == "auto" else projection


def second_lens(path: Path) -> Path | None:
    """Return the file of the other lens of a camera that writes one for each, if it is there."""
    other = path.with_name(path.name.replace("_00_", "_10_", 1))
    return other if other != path and other.exists() else None


def turned_by_ffmpeg(path: Path, projection: Projection) -> str:
    """Return the command that turns a still of a projection other than equirectangular, for messages."""
    angle = f":ih_fov={FISHEYE_FOV_DEG:g}:iv_fov={FISHEYE_FOV_DEG:g}" if projection == "dual_fisheye" else ""
    return f"ffmpeg -i {path.name} -vf v360={FFMPEG_NAMES[projection]}:e{angle} out.png"


DOUBLED_STRIP = {(4096, 1344): 64, (2272, 736): 32}
"""Columns of the strip that an outer face stores twice, for the (columns, rows) of a track. Others: what is left of
three square faces."""


def joined_row(plane: NDArray[Any], size: tuple[int, int]) -> NDArray[Any]:
    """Return three square faces (h, 3 h) of a plane (h, w) of a track whose luma has `size`, (columns, rows).

    Faces of exactly 3:1 have no doubled strip, and are returned as they are.
    """
    import cv2

    height, columns = plane.shape
    across = columns / size[0]
    overlap = round(across * DOUBLED_STRIP.get(size, (size[0] - 3 * size[1]) // 2))
    middle = round(across * size[1])
    outer = (columns - middle) // 2
    if overlap <= 0:
        return plane
    weight = ((np.arange(overlap) + 0.5) / overlap).astype(np.float32)
    faces = [plane[:, outer : outer + middle]]
    for side in (plane[:, :outer], plane[:, outer + middle :]):
        seam = outer // 2
        left, right = side[:, seam - overlap : seam], side[:, seam : seam + overlap]
        blend = np.rint(left * (1.0 - weight) + right * weight).astype(plane.dtype)
        face = np.concatenate([side[:, : seam - overlap], blend, side[:, seam + overlap :]], axis=1)
        faces.append(np.asarray(cv2.resize(face, (middle, height), interpolation=cv2.INTER_LINEAR)))
    return np.concatenate([faces[1], faces[0], faces[2]], axis=1)
