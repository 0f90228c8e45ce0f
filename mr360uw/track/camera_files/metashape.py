# SPDX-License-Identifier: Apache-2.0
"""Metashape's exported cameras (XML).

A camera's transform takes camera axes right, down, forward to the chunk's; the chunk's transform, if it has one, takes
these to its world by scale, rotation and translation. A local world has +z up; in the geocentric one (metres from the
earth's centre) up leads away from the centre. Without a chunk's transform up is unknown.
"""

from __future__ import annotations

from xml.etree import ElementTree as ET

import numpy as np

from mr360uw.errors import ParameterError
from mr360uw.sphere import unit
from mr360uw.track.camera_files.colmap_text import frame_number
from mr360uw.track.camera_files.solved_path import FLIPPED, Y_UP_FROM_Z_UP, SolvedPath
from mr360uw.types import Floats

_GEOCENTRIC_M = 1e6
"""Distance from the origin [m] beyond which a world is the geocentric one."""


def is_metashape(text: str) -> bool:
    """Return whether a text is an XML document of cameras."""
    return text.lstrip().startswith("<") and "<camera" in text


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
            matrices.append(_numbers(transform.text, 16, where).reshape(4, 4))
    poses = np.array(matrices).reshape(-1, 4, 4)
    rotation, position = poses[:, :3, :3] @ FLIPPED, poses[:, :3, 3]
    world = chunk.find("transform")
    up: Floats | None = None
    if world is not None and world.find("rotation") is not None:
        turn = _numbers(world.findtext("rotation"), 9, where).reshape(3, 3)
        shift = _numbers(world.findtext("translation"), 3, where)
        scale = _numbers(world.findtext("scale"), 1, where)[0]
        position, rotation = scale * position @ turn.T + shift, turn @ rotation
        if np.linalg.norm(shift) > _GEOCENTRIC_M:
            up = unit(shift)
        else:
            position, rotation, up = position @ Y_UP_FROM_Z_UP.T, Y_UP_FROM_Z_UP @ rotation, np.array([0.0, 1.0, 0.0])
    return SolvedPath("Metashape cameras", position, rotation, frame=np.array(frames), up=up)


def _numbers(text: str | None, count: int, where: str) -> Floats:
    try:
        values = np.array([float(cell) for cell in (text or "").split()])
    except ValueError:
        values = np.zeros(0)
    if len(values) != count or not np.all(np.isfinite(values)):
        raise ParameterError(f"{where} - a transform needs {count} numbers (got {text!r:.60}) - export it again")
    return values
