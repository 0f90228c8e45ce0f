# SPDX-License-Identifier: Apache-2.0
"""Reads a camera's path from any known file, and writes one for Nuke and Blender.

In Metashape's exported cameras (XML), a camera's transform takes camera axes right, down, forward to the chunk's; the
chunk's transform, if it has one, takes these to its world by scale, rotation and translation. A local world has +z up;
in the geocentric one (metres from the earth's centre) up leads away from the centre. Without a chunk's transform up is
unknown."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
from scipy.spatial.transform import Rotation

from mr360uw.base.files import check_outputs, write_whole
from mr360uw.base.input_files import json_of, read_text
from mr360uw.base.sphere import unit
from mr360uw.composite import read_camera_track
from mr360uw.composite.motion import check_unit_quaternions
from mr360uw.errors import ParameterError
from mr360uw.medium.spectra import parse_table
from mr360uw.track.camera_track import CameraTrack, rotation_to_world, smooth_quaternions
from mr360uw.types import Floats

_GEOCENTRIC_M = 1e6
"""Distance from the origin [m] beyond which a world is the geocentric one."""


def _read_metashape(text: str, where: str) -> SolvedPath:
    """Return the path of the first chunk's aligned cameras; raise `ParameterError`."""
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise ParameterError(f"{where} - declares entities, which cameras need none of - export it again")
    try:
        root = ET.fromstring(text)  # noqa: S314 - entities are refused above
    except ET.ParseError as error:
        raise ParameterError(f"{where} - is broken XML (got: {error}) - export it again") from None
    chunk = root if root.tag == "chunk" else root.find(".//chunk")
    if chunk is None:
        raise ParameterError(f"{where} - has no chunk of cameras - export cameras as Agisoft XML")
    frames, matrices = [], []
    for camera in chunk.iter("camera"):
        transform = camera.find("transform")
        if transform is not None:
            frames.append(_frame_number(camera.get("label", ""), where))
            matrices.append(_numbers_of(transform.text, 16, where).reshape(4, 4))
    poses = np.array(matrices).reshape(-1, 4, 4)
    rotation, position = poses[:, :3, :3] @ _FLIPPED, poses[:, :3, 3]
    world = chunk.find("transform")
    up: Floats | None = None
    if world is not None and world.find("rotation") is not None:
        turn = _numbers_of(world.findtext("rotation"), 9, where).reshape(3, 3)
        shift = _numbers_of(world.findtext("translation"), 3, where)
        scale = _numbers_of(world.findtext("scale"), 1, where)[0]
        position, rotation = scale * position @ turn.T + shift, turn @ rotation
        if np.linalg.norm(shift) > _GEOCENTRIC_M:
            up = unit(shift)
        else:
            position, rotation, up = position @ _Y_UP_FROM_Z_UP.T, _Y_UP_FROM_Z_UP @ rotation, np.array([0.0, 1.0, 0.0])
    return SolvedPath("Metashape cameras", position, rotation, frame=np.array(frames), up=up)


EXPORTS = (".chan", ".py")


def read_solved_path(path: Path) -> SolvedPath:
    """Return the path in a file, whose format is recognised by its content; raise `ParameterError`.

    A folder stands for the images.txt in it.
    """
    path = path / "images.txt" if path.is_dir() else path
    text = read_text(path, ParameterError)
    if text.lstrip().startswith("{") and '"blender_frames"' in text:
        return _read_blender_json(text, str(path))
    if text.lstrip().startswith("<") and "<camera" in text:
        return _read_metashape(text, str(path))
    if _is_colmap(text):
        return _read_colmap(text, str(path))
    if _is_table(text):
        return _read_path_table(text, path)
    raise ParameterError(
        f"{path} - is no path of a camera that is known - give COLMAP's images.txt, Metashape's XML, a .chan of Nuke "
        "or SynthEyes, Blender's JSON, or a track.csv"
    )


def nuke_chan(track: CameraTrack, frame_rate: float) -> str:
    """Return a track as Nuke's .chan: frame (from 1), x, y, z, degrees about x, y, z; z turns first, then x, then y."""
    z, x, y = Rotation.from_matrix(track.rotation).as_euler("zxy", degrees=True).T
    frame = 1.0 + np.round(track.time_s * frame_rate)
    rows = np.column_stack([frame, track.position, x, y, z])
    return "".join(" ".join(f"{value:.9g}" for value in row) + "\n" for row in rows)


def blender_script(track: CameraTrack, frame_rate: float) -> str:
    """Return a Python script that makes the track's camera in Blender: panoramic, with a key for each row."""
    turned = _Y_UP_FROM_Z_UP.T
    position = track.position @ turned.T
    quaternion = smooth_quaternions(turned @ track.rotation)[:, [3, 0, 1, 2]]
    frame = 1 + np.round(track.time_s * frame_rate).astype(int)
    rows = [
        [int(f), *(round(float(v), 9) for v in (*p, *q))] for f, p, q in zip(frame, position, quaternion, strict=True)
    ]
    script = (resources.files("mr360uw.track") / "blender_camera.py.txt").read_text(encoding="utf-8")
    return script.replace("ROWS", ",\n    ".join(json.dumps(row) for row in rows)).replace("RATE", f"{frame_rate:.9g}")


def export(track: CameraTrack, out: Path, frame_rate: float | None, *, overwrite: bool) -> Path:
    """Write a track as .chan for Nuke or .py for Blender; raise `ParameterError` or `OutputExistsError`."""
    if frame_rate is None:
        raise ParameterError(f"{out} - counts frames (got a track in seconds) - give the clip too, or --fps")
    check_outputs([out], overwrite=overwrite)
    text = nuke_chan(track, frame_rate) if out.suffix.lower() == ".chan" else blender_script(track, frame_rate)
    write_whole(out, text)
    return out


# Tables of a camera's path: this toolkit's own, Blender's, COLMAP's, and Nuke's, which SynthEyes writes too.
#
# Own: time_s, x, y, z, qx, qy, qz, qw; camera axes right, up, back; +y up.
# Blender: blender_frame, x, y, z, qw, qx, qy, qz of the camera's matrix_world; camera axes right, up, back; +z up; or
# JSON with "blender_frames": a list of {"frame", "matrix_world"} and "fps".
# Nuke and SynthEyes: frame, x, y, z, and rotations [degrees] about x, y and z, with or without names and a field of
# view,
# between blanks or
# commas (.chan); camera axes right, up, back; +y up; rotated about z first, then x, then y ("ZXY").
#
# COLMAP's images.txt has for each picture a line with its pose and one with its features. The pose is the rotation
# (quaternion w, x, y, z) and translation from the world to camera axes right, down, forward. The world has no known up.
# Frames are numbered by the last digits in the pictures' names.

_Y_UP_FROM_Z_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""From a world with +z up and +y ahead, as Blender's, to one with +y up and -z ahead."""
_FLIPPED = np.diag([1.0, -1.0, -1.0])
"""From camera axes right, down, forward to right, up, back."""
_FARTHEST_M = 1e9
"""Largest distance of a camera from the origin [m]."""
_LEAST_RATE = 1e-4
"""Least frames a second of a clip, and the inverse of the most."""
_LARGEST_SKEW = 1e-3
"""Largest deviation of a rotation matrix from an orthonormal one."""


@dataclass(frozen=True, slots=True, eq=False)
class SolvedPath:
    """Positions (n, 3) and rotations (n, 3, 3) from camera axes to the world, of frames (n,) or times (n,) [s].

    format: in words. up: (3,) in that world if known, else the cameras' own up on average is. frame_rate: if known.
    """

    format: str
    position: Floats
    rotation: Floats
    frame: Floats | None = None
    time_s: Floats | None = None
    up: Floats | None = None
    frame_rate: float | None = None


def _checked_rotations(matrices: Floats, where: str) -> Floats:
    """Return matrices (n, 3, 3) without their common scale; raise `ParameterError` where they are no rotations."""
    finite = bool(np.all(np.isfinite(matrices)))
    determinant = np.linalg.det(matrices if finite else np.zeros_like(matrices))
    if not finite or np.any(determinant <= 0.0):
        raise ParameterError(f"{where} - has a matrix that is no rotation (mirrored, or of zeros) - export it again")
    turned: Floats = matrices / np.cbrt(determinant)[:, None, None]
    skew = np.abs(turned @ np.swapaxes(turned, 1, 2) - np.eye(3)).max()
    if skew > _LARGEST_SKEW:
        raise ParameterError(f"{where} - has a matrix that is no rotation (skewed by {skew:.2g}) - export it again")
    return turned


def track_of(path: SolvedPath, where: str, frame_rate: float | None, scale: float = 1.0) -> CameraTrack:
    """Return a path as a track: its first camera at the origin, heading towards -z, +y up, in metres.

    frame_rate: of the clip, for files that count frames, whose first is time 0. scale: metres per unit of the file.
    Raises `ParameterError` for too few cameras and for frames without a rate.
    """
    if not len(path.position):
        raise ParameterError(f"{where} - holds no solved camera (got {path.format}) - export the cameras of all frames")
    if not 0.0 < scale <= _FARTHEST_M:
        raise ParameterError(f"--scale - must be more than 0 (got {scale:g}) - give the metres of the file's unit")
    if not np.all(np.abs(path.position) * scale <= _FARTHEST_M):
        raise ParameterError(f"{where} - has positions that are no numbers, or too far away - correct it")
    times, order = _times(path, where, frame_rate)
    position, rotation = path.position[order], _checked_rotations(path.rotation[order], where)
    up = unit(rotation[:, :, 1].mean(axis=0)) if path.up is None else path.up
    turned = rotation_to_world(up, rotation[0])
    count = len(times)
    said = "the cameras' own up on average" if path.up is None else f"the world of the file ({path.format})"
    moves = bool(np.ptp(position, axis=0).any())
    return CameraTrack(
        "moving" if moves else "turning" if np.ptp(rotation, axis=0).any() else "still", times,
        scale * (position - position[0]) @ turned.T, turned @ rotation, np.full(count, np.nan), np.full(count, np.nan),
        np.arange(count), np.zeros((0, 3)), np.zeros(0), 0.0, 0, None, said,
        f"{scale:g} m per unit of the file" + (", a guess: give --scale" if scale == 1.0 and path.up is None else ""),
    )  # fmt: skip


def _times(path: SolvedPath, where: str, frame_rate: float | None) -> tuple[Floats, np.ndarray]:
    """Return ascending times [s] of cameras, and their order in the file."""
    if path.time_s is not None:
        times = path.time_s
    else:
        rate = path.frame_rate if frame_rate is None else frame_rate
        if rate is None or path.frame is None:
            raise ParameterError(
                f"{where} - counts frames (got {path.format}) - give the clip too, or --fps with its frames a second"
            )
        if not _LEAST_RATE <= rate <= 1.0 / _LEAST_RATE:
            raise ParameterError(f"--fps - must be more than 0 (got {rate}) - give frames a second")
        times = (path.frame - path.frame.min()) / rate if np.all(np.isfinite(path.frame)) else path.frame
    if not np.all(np.isfinite(times)):
        raise ParameterError(f"{where} - has frames or times that are no numbers - correct it")
    order = np.argsort(times, kind="stable")
    twice = np.flatnonzero(np.diff(times[order]) <= 0.0)
    if len(twice):
        raise ParameterError(f"{where} - has a frame twice (at {times[order][twice[0]]:g} s) - leave one out")
    return times[order], order


_POSE = re.compile(r"^\s*\d+(\s+[-+.\deE]+){7}\s+\d+\s+\S")


def _is_colmap(text: str) -> bool:
    """Return whether a text is an images.txt."""
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    return bool(lines) and bool(_POSE.match(lines[0]))


def _read_colmap(text: str, where: str) -> SolvedPath:
    """Return the path of an images.txt; raise `ParameterError`."""
    rows, frames = [], []
    for line in text.splitlines():
        if line.startswith("#") or not _POSE.match(line):
            continue
        cells = line.split(maxsplit=9)
        rows.append(_numbers_of(" ".join(cells[1:8]), 7, where))
        frames.append(_frame_number(cells[9], where))
    values = np.array(rows).reshape(-1, 7)
    from_world = rotations(values[:, [1, 2, 3, 0]], where)
    to_world = np.swapaxes(from_world, 1, 2)
    position = -np.einsum("nij,nj->ni", to_world, values[:, 4:])
    return SolvedPath("COLMAP images.txt", position, to_world @ _FLIPPED, frame=np.array(frames))


def _numbers_of(text: str | None, count: int, where: str) -> Floats:
    """Return the finite numbers (count,) between the blanks of a text; raise `ParameterError` for anything else."""
    try:
        values = np.array([float(cell) for cell in (text or "").split()])
    except ValueError:
        values = np.zeros(0)
    if len(values) != count or not np.all(np.isfinite(values)):
        raise ParameterError(f"{where} - a pose needs {count} numbers (got {text!r:.60}) - export it again")
    return values


def _frame_number(name: str, where: str) -> float:
    """Return the last number in the name of a picture; raise `ParameterError` if it has none."""
    digits = re.findall(r"\d+", name.rsplit("/", 1)[-1].rsplit(".", 1)[0])
    if not digits:
        raise ParameterError(f"{where} - has a picture without a frame number (got {name!r:.60}) - number the pictures")
    return float(digits[-1])


def rotations(quaternion: Floats, where: str) -> Floats:
    """Return rotations (n, 3, 3) of quaternions (n, 4), x, y, z, w; raise `ParameterError` unless of length 1."""
    check_unit_quaternions(quaternion, where)
    return np.asarray(Rotation.from_quat(quaternion).as_matrix()) if len(quaternion) else np.zeros((0, 3, 3))


_UP = np.array([0.0, 1.0, 0.0])
_BLENDER = ("blender_frame", "x", "y", "z", "qx", "qy", "qz", "qw")
_NAMES = (("frame",), ("tx", "x"), ("ty", "y"), ("tz", "z"), ("rx",), ("ry",), ("rz",))


def _read_blender_json(text: str, where: str) -> SolvedPath:
    """Return the path of the JSON that docs/tracking.md's script writes from Blender; raise `ParameterError`."""
    try:
        read = json_of(text)
        frames = np.array([float(row["frame"]) for row in read["blender_frames"]])
        matrices = np.array([row["matrix_world"] for row in read["blender_frames"]], np.float64).reshape(-1, 4, 4)
        rate = float(read["fps"])
    except (ValueError, KeyError, TypeError, OverflowError) as error:
        raise ParameterError(f"{where} - is no path from Blender (got: {error}) - export it by the script") from None
    return _of_blender(frames, matrices[:, :3, 3], matrices[:, :3, :3], rate)


def _is_table(text: str) -> bool:
    """Return whether a text looks like one of the tables."""
    first = next((line for line in text.splitlines() if line.strip() and not line.startswith("#")), "")
    names = [cell.strip().lower() for cell in first.split(",")]
    named = "time_s" in names or "blender_frame" in names or "frame" in names
    return named or _is_plain(first)


def _read_path_table(text: str, path: Path) -> SolvedPath:
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
    turned = _Y_UP_FROM_Z_UP
    return SolvedPath("Blender path", position @ turned.T, turned @ rotation, frame=frame, up=_UP, frame_rate=rate)


def _of_angles(values: Floats) -> SolvedPath:
    """Return the path of rows (n, 7 or more): frame, position, angles [deg] about x, y, z."""
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
