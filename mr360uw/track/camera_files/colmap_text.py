# SPDX-License-Identifier: Apache-2.0
"""COLMAP's images.txt: for each picture a line with its pose and one with its features.

The pose is the rotation (quaternion w, x, y, z) and translation from the world to camera axes right, down, forward.
The world has no known up. Frames are numbered by the last digits in the pictures' names.
"""

from __future__ import annotations

import re

import numpy as np

from mr360uw.errors import ParameterError
from mr360uw.track.camera_files.path_tables import rotations
from mr360uw.track.camera_files.solved_path import FLIPPED, SolvedPath

_POSE = re.compile(r"^\s*\d+(\s+[-+.\deE]+){7}\s+\d+\s+\S")


def is_colmap(text: str) -> bool:
    """Return whether a text is an images.txt."""
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    return bool(lines) and bool(_POSE.match(lines[0]))


def read_colmap(text: str, where: str) -> SolvedPath:
    """Return the path of an images.txt; raise `ParameterError`."""
    rows, frames = [], []
    for line in text.splitlines():
        if line.startswith("#") or not _POSE.match(line):
            continue
        cells = line.split(maxsplit=9)
        rows.append([float(cell) for cell in cells[1:8]])
        frames.append(frame_number(cells[9], where))
    values = np.array(rows).reshape(-1, 7)
    from_world = rotations(values[:, [1, 2, 3, 0]], where)
    to_world = np.swapaxes(from_world, 1, 2)
    position = -np.einsum("nij,nj->ni", to_world, values[:, 4:])
    return SolvedPath("COLMAP images.txt", position, to_world @ FLIPPED, frame=np.array(frames))


def frame_number(name: str, where: str) -> float:
    """Return the last number in the name of a picture; raise `ParameterError` if it has none."""
    digits = re.findall(r"\d+", name.rsplit("/", 1)[-1].rsplit(".", 1)[0])
    if not digits:
        raise ParameterError(f"{where} - has a picture without a frame number (got {name!r:.60}) - number the pictures")
    return float(digits[-1])
