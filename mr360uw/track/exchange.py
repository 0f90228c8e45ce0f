# SPDX-License-Identifier: Apache-2.0
"""Reads a camera's path from any known file, and writes one for Nuke and Blender.

In Metashape's exported cameras (XML), a camera's transform takes camera axes right, down, forward to the chunk's; the
chunk's transform, if it has one, takes these to its world by scale, rotation and translation. A local world has +z up;
in the geocentric one (metres from the earth's centre) up leads away from the centre. Without a chunk's transform up is
unknown.
"""

from __future__ import annotations

import json
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from mr360uw.errors import ParameterError
from mr360uw.files import write_whole
from mr360uw.output_gate import check_outputs
from mr360uw.reading.input_files import read_text
from mr360uw.sphere import unit
from mr360uw.track.camera_track import CameraTrack
from mr360uw.track.path_tables import (
    FLIPPED,
    Y_UP_FROM_Z_UP,
    SolvedPath,
    frame_number,
    is_blender_json,
    is_colmap,
    is_table,
    numbers_of,
    read_blender_json,
    read_colmap,
    read_path_table,
)
from mr360uw.types import Floats

_GEOCENTRIC_M = 1e6
"""Distance from the origin [m] beyond which a world is the geocentric one."""


def read_metashape(text: str, where: str) -> SolvedPath:
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
            frames.append(frame_number(camera.get("label", ""), where))
            matrices.append(numbers_of(transform.text, 16, where).reshape(4, 4))
    poses = np.array(matrices).reshape(-1, 4, 4)
    rotation, position = poses[:, :3, :3] @ FLIPPED, poses[:, :3, 3]
    world = chunk.find("transform")
    up: Floats | None = None
    if world is not None and world.find("rotation") is not None:
        turn = numbers_of(world.findtext("rotation"), 9, where).reshape(3, 3)
        shift = numbers_of(world.findtext("translation"), 3, where)
        scale = numbers_of(world.findtext("scale"), 1, where)[0]
        position, rotation = scale * position @ turn.T + shift, turn @ rotation
        if np.linalg.norm(shift) > _GEOCENTRIC_M:
            up = unit(shift)
        else:
            position, rotation, up = position @ Y_UP_FROM_Z_UP.T, Y_UP_FROM_Z_UP @ rotation, np.array([0.0, 1.0, 0.0])
    return SolvedPath("Metashape cameras", position, rotation, frame=np.array(frames), up=up)


EXPORTS = (".chan", ".py")


def read_solved_path(path: Path) -> SolvedPath:
    """Return the path in a file, whose format is recognised by its content; raise `ParameterError`.

    A folder stands for the images.txt in it.
    """
    path = path / "images.txt" if path.is_dir() else path
    text = read_text(path, ParameterError)
    if is_blender_json(text):
        return read_blender_json(text, str(path))
    if text.lstrip().startswith("<") and "<camera" in text:
        return read_metashape(text, str(path))
    if is_colmap(text):
        return read_colmap(text, str(path))
    if is_table(text):
        return read_path_table(text, path)
    raise ParameterError(
        f"{path} - is no path of a camera that is known - give COLMAP's images.txt, Metashape's XML, a .chan of Nuke "
        "or SynthEyes, Blender's JSON, or a track.csv"
    )


def nuke_chan(track: CameraTrack, frame_rate: float) -> str:
    """Return a track as Nuke's .chan: frame (from 1), x, y, z, degrees about x, y, z; z turns first, then x, then y."""
    from scipy.spatial.transform import Rotation

    z, x, y = Rotation.from_matrix(track.rotation).as_euler("zxy", degrees=True).T
    frame = 1.0 + np.round(track.time_s * frame_rate)
    rows = np.column_stack([frame, track.position, x, y, z])
    return "".join(" ".join(f"{value:.9g}" for value in row) + "\n" for row in rows)


def blender_script(track: CameraTrack, frame_rate: float) -> str:
    """Return a Python script that makes the track's camera in Blender: panoramic, with a key for each row."""
    from scipy.spatial.transform import Rotation

    turned = Y_UP_FROM_Z_UP.T
    position = track.position @ turned.T
    quaternion = Rotation.from_matrix(turned @ track.rotation).as_quat()[:, [3, 0, 1, 2]]
    signs = np.where(np.sum(quaternion[1:] * quaternion[:-1], axis=1) < 0.0, -1.0, 1.0)
    quaternion = quaternion * np.concatenate([[1.0], np.cumprod(signs)])[:, None]
    frame = 1 + np.round(track.time_s * frame_rate).astype(int)
    rows = [
        [int(f), *(round(float(v), 9) for v in (*p, *q))] for f, p, q in zip(frame, position, quaternion, strict=True)
    ]
    return _SCRIPT.replace("ROWS", ",\n    ".join(json.dumps(row) for row in rows)).replace("RATE", f"{frame_rate:.9g}")


def export(track: CameraTrack, out: Path, frame_rate: float | None, *, overwrite: bool) -> Path:
    """Write a track as .chan for Nuke or .py for Blender; raise `ParameterError` or `OutputExistsError`."""
    if frame_rate is None:
        raise ParameterError(f"{out} - counts frames (got a track in seconds) - give the clip too, or --fps")
    check_outputs([out], overwrite=overwrite)
    text = nuke_chan(track, frame_rate) if out.suffix.lower() == ".chan" else blender_script(track, frame_rate)
    write_whole(out, text)
    return out


_SCRIPT = """# Run in Blender's text editor: makes a panoramic camera with the path of a 360 clip.
import bpy

# frame, x, y, z, qw, qx, qy, qz; +z is up
KEYS = [
    ROWS,
]

data = bpy.data.cameras.new("mr360uw")
data.type = "PANO"
for owner in (data, getattr(data, "cycles", None)):
    if hasattr(owner, "panorama_type"):
        owner.panorama_type = "EQUIRECTANGULAR"
camera = bpy.data.objects.new("mr360uw", data)
bpy.context.scene.collection.objects.link(camera)
bpy.context.scene.camera = camera
bpy.context.scene.render.fps = round(RATE)
bpy.context.scene.render.fps_base = round(RATE) / RATE
camera.rotation_mode = "QUATERNION"
for frame, x, y, z, qw, qx, qy, qz in KEYS:
    camera.location, camera.rotation_quaternion = (x, y, z), (qw, qx, qy, qz)
    camera.keyframe_insert("location", frame=frame)
    camera.keyframe_insert("rotation_quaternion", frame=frame)
"""
