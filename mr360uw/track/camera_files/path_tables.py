# SPDX-License-Identifier: Apache-2.0
"""Tables of a camera's path: this toolkit's own, Blender's, COLMAP's, and Nuke's, which SynthEyes writes too.

Own: time_s, x, y, z, qx, qy, qz, qw; camera axes right, up, back; +y up.
Blender: blender_frame, x, y, z, qw, qx, qy, qz of the camera's matrix_world; camera axes right, up, back; +z up; or
JSON with "blender_frames": a list of {"frame", "matrix_world"} and "fps".
Nuke and SynthEyes: frame, x, y, z, and rotations [degrees] about x, y and z, with or without names and a field of view,
between blanks or commas (.chan); camera axes right, up, back; +y up; rotated about z first, then x, then y ("ZXY").

COLMAP's images.txt has for each picture a line with its pose and one with its features. The pose is the rotation
(quaternion w, x, y, z) and translation from the world to camera axes right, down, forward. The world has no known up.
Frames are numbered by the last digits in the pictures' names.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from mr360uw.composite import read_camera_track
from mr360uw.composite.motion import check_unit_quaternions
from mr360uw.errors import ParameterError
from mr360uw.medium.tables import parse_table
from mr360uw.track.camera_files.solved_path import FLIPPED, Y_UP_FROM_Z_UP, SolvedPath
from mr360uw.types import Floats

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


def rotations(quaternion: Floats, where: str) -> Floats:
    """Return rotations (n, 3, 3) of quaternions (n, 4), x, y, z, w; raise `ParameterError` unless of length 1."""
    from scipy.spatial.transform import Rotation

    check_unit_quaternions(quaternion, where)
    return np.asarray(Rotation.from_quat(quaternion).as_matrix()) if len(quaternion) else np.zeros((0, 3, 3))


_UP = np.array([0.0, 1.0, 0.0])
_BLENDER = ("blender_frame", "x", "y", "z", "qx", "qy", "qz", "qw")
_NAMES = (("frame",), ("tx", "x"), ("ty", "y"), ("tz", "z"), ("rx",), ("ry",), ("rz",))


def is_blender_json(text: str) -> bool:
    """Return whether a text is the JSON of Blender's cameras."""
    return text.lstrip().startswith("{") and '"blender_frames"' in text


def read_blender_json(text: str, where: str) -> SolvedPath:
    """Return the path of the JSON that docs/tracking.md's script writes from Blender; raise `ParameterError`."""
    try:
        read = json.loads(text)
        frames = np.array([float(row["frame"]) for row in read["blender_frames"]])
        matrices = np.array([row["matrix_world"] for row in read["blender_frames"]], np.float64).reshape(-1, 4, 4)
        rate = float(read["fps"])
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
        raise ParameterError(f"{where} - is no path from Blender (got: {error}) - export it by the script") from None
    return _of_blender(frames, matrices[:, :3, 3], matrices[:, :3, :3], rate)


def is_table(text: str) -> bool:
    """Return whether a text looks like one of the tables."""
    first = next((line for line in text.splitlines() if line.strip() and not line.startswith("#")), "")
    names = [cell.strip().lower() for cell in first.split(",")]
    named = "time_s" in names or "blender_frame" in names or "frame" in names
    return named or _is_plain(first)


def read_path_table(text: str, path: Path) -> SolvedPath:
    """Return the path of a table; raise `ParameterError`."""
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    where = str(path)
    if _is_plain(lines[0]):
        return _of_angles(_plain_rows(lines, where))
    table = {name.lower(): values for name, values in parse_table(lines, where).items()}
    if "time_s" in table:
        motion = read_camera_track(path)
        return SolvedPath("mr360uw track", motion.position, motion.rotation, time_s=motion.time_s, up=_UP)
    if "blender_frame" in table:
        values = _columns(table, [(name,) for name in _BLENDER], where)
        return _of_blender(values[:, 0], values[:, 1:4], rotations(values[:, 4:], where), None)
    return _of_angles(_columns(table, list(_NAMES), where))


def _columns(table: Mapping[str, Floats], names: list[tuple[str, ...]], where: str) -> Floats:
    """Return the columns (n, k) of a table, each by the first of its names that is there."""
    missing = [choices[0] for choices in names if not any(name in table for name in choices)]
    if missing:
        raise ParameterError(f"{where} - columns are missing (got no {', '.join(missing)}) - export it with them")
    return np.stack([next(table[name] for name in choices if name in table) for choices in names], axis=1)


def _of_blender(frame: Floats, position: Floats, rotation: Floats, rate: float | None) -> SolvedPath:
    turned = Y_UP_FROM_Z_UP
    return SolvedPath("Blender path", position @ turned.T, turned @ rotation, frame=frame, up=_UP, frame_rate=rate)


def _of_angles(values: Floats) -> SolvedPath:
    """Return the path of rows (n, 7 or more): frame, position, angles [deg] about x, y, z."""
    from scipy.spatial.transform import Rotation

    # extrinsic: about the fixed axes z, then x, then y
    rotation = np.asarray(Rotation.from_euler("zxy", values[:, [6, 4, 5]], degrees=True).as_matrix())
    return SolvedPath("Nuke or SynthEyes path", values[:, 1:4], rotation, frame=values[:, 0], up=_UP)


def _cells(line: str) -> list[str]:
    return line.replace(",", " ").split()


def _is_plain(line: str) -> bool:
    """Return whether a line is seven to nine numbers: frame, position, angles, and a zoom."""
    cells = _cells(line)
    try:
        numbers = [float(cell) for cell in cells]
    except ValueError:
        return False
    return 7 <= len(numbers) <= 9


def _plain_rows(lines: list[str], where: str) -> Floats:
    for number, line in enumerate(lines, 1):
        if not _is_plain(line) or len(_cells(line)) != len(_cells(lines[0])):
            raise ParameterError(f"{where}, row {number} - is no row of a path (got {line!r:.60}) - export it again")
    return np.array([[float(cell) for cell in _cells(line)] for line in lines])
