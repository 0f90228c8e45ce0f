# SPDX-License-Identifier: Apache-2.0
"""Reads mesh files: each format by its own module, STL through trimesh."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mr360uw.color import decode
from mr360uw.composite.mesh.material import Material, MeshFile, Part
from mr360uw.composite.mesh.normals import crease_normals
from mr360uw.composite.mesh.obj_file import read_obj
from mr360uw.composite.mesh.ply_file import read_ply
from mr360uw.composite.mesh.skin import smoothed_body
from mr360uw.composite.mesh.usd.usd_stage import USD_SUFFIXES
from mr360uw.errors import MeshError
from mr360uw.reading.input_files import read_data, text_of, unreadable
from mr360uw.reading.limits import DATA, TRIANGLES
from mr360uw.types import Floats

FORMATS = (".glb", ".gltf", ".obj", ".ply", ".stl", *USD_SUFFIXES)
_STL_HEAD = 80
"""Bytes of the header of a binary STL; text names itself in the first of them."""
_IMPORTERS = {".fbx": "import_scene.fbx", ".abc": "wm.alembic_import", ".blend": ""}
"""Formats that Blender reads and this does not: Blender's operator, none for its own files."""


def read_mesh_file(path: Path, *, outside: bool = False, smooth_deg: float | None = None) -> MeshFile:
    """Return every placed part of a mesh file and its materials; raise `MeshError`.

    outside: the file may name others outside of its folder. smooth_deg: None for the normals of the file, else new ones
    that are smooth across edges of less than this angle [deg].
    """
    file = _read(path, outside=outside)
    return file if smooth_deg is None else smoothed(file, smooth_deg)


def _read(path: Path, *, outside: bool) -> MeshFile:
    suffix = path.suffix.lower()
    if suffix in _IMPORTERS:
        raise MeshError(f"{path} - is {suffix}, which is not read - convert it with Blender: {_conversion(path)}")
    if suffix not in FORMATS:
        raise MeshError(f"{path} - not a mesh format that is read (got {suffix!r}) - give {', '.join(FORMATS)}")
    if reason := unreadable(path):
        raise MeshError(f"{path} - {reason}")
    DATA.check(str(path), path.stat().st_size, MeshError)
    if suffix in (".glb", ".gltf"):
        from mr360uw.composite.mesh.gltf_scene import read_gltf

        return read_gltf(path, outside=outside)
    if suffix in USD_SUFFIXES:
        from mr360uw.composite.mesh.usd.usd_scene import read_usd

        return read_usd(path, outside=outside)
    if suffix == ".obj":
        return read_obj(path, outside=outside)
    return read_ply(path, outside=outside) if suffix == ".ply" else _read_stl(path)


def _read_stl(path: Path) -> MeshFile:
    """Return the triangles of an STL, with the colours that some programs keep in those of binary files."""
    import trimesh

    # Let trimesh read it; its log is silent, its errors are raised
    head = read_data(path, MeshError)[:_STL_HEAD]
    parts: list[Part] = []
    materials = [Material(double_sided=True), Material(base_color=(1.0, 1.0, 1.0, 1.0), double_sided=True)]
    triangles = 0
    log = logging.getLogger("trimesh")
    level = log.level
    log.setLevel(logging.CRITICAL)
    try:
        scene = trimesh.load_scene(path, process=False)
    except Exception as error:  # trimesh does not catch the exceptions of its parsers
        raise MeshError(f"{path} - cannot be read as a mesh (got: {error!s:.200}) - export it again") from error
    finally:
        log.setLevel(level)
    # Give every triangle corners of its own, with its colour
    for name, geometry in scene.geometry.items():
        triangles += len(geometry.faces)
        TRIANGLES.check(str(path), triangles, MeshError)
        positions, faces = np.asarray(geometry.vertices, np.float64), np.asarray(geometry.faces, np.int64)
        colors = _stl_colors(geometry.face_attributes.get("stl"), head)
        separate = np.arange(faces.size).reshape(-1, 3)
        white = int(colors is not None)
        parts.append(Part(str(name), positions[faces].reshape(-1, 3), separate, colors=colors, material=white))
    return MeshFile(tuple(parts), tuple(materials), head=text_of(head), cad=True)


def _stl_colors(words: NDArray[np.uint16] | None, head: bytes) -> Floats | None:
    """Return the linear colours (V, 4) of the corners of triangles by their 16 bits, or None where they have none.

    Five bits each of blue, green and red, from the lowest, where the highest bit is set (VisCAM, SolidView); with
    `COLOR=` in the header the order is red, green, blue and the highest bit is set where the header's colour is meant
    (Materialise Magics).
    """
    if words is None or not np.any(words):
        return None
    magics = head.find(b"COLOR=")
    shifts = (0, 5, 10) if magics >= 0 else (10, 5, 0)
    own = (words >> 15 == 0) if magics >= 0 else (words >> 15 == 1)
    codes = np.stack([(words >> shift & 31) / 31.0 for shift in shifts], axis=-1)
    common = np.frombuffer(head[magics + 6 : magics + 9], np.uint8) / 255.0 if magics >= 0 else np.full(3, 0.735)
    if not np.any(own) and magics < 0:
        return None
    rgb = decode(np.where(own[:, None], codes, common), "srgb")
    return np.repeat(np.append(rgb, np.ones((len(rgb), 1)), axis=1), 3, axis=0)


def _conversion(path: Path) -> str:
    """Return the command with which Blender makes a .glb of a file beside it."""
    importer = _IMPORTERS[path.suffix.lower()]
    opened = f" {path}" if not importer else ""
    steps = [f"bpy.ops.{importer}(filepath={str(path)!r})"] if importer else []
    if importer:
        steps.insert(0, "bpy.ops.wm.read_homefile(use_empty=True)")
    steps.append(f"bpy.ops.export_scene.gltf(filepath={str(path.with_suffix('.glb'))!r})")
    return f'blender -b{opened} --python-expr "import bpy; {"; ".join(steps)}"'


def smoothed(file: MeshFile, angle_deg: float) -> MeshFile:
    """Return the contents of a file with new normals: a face shares those of its neighbours across edges that bend by
    less than an angle [deg]; 0 is flat. Every corner of a triangle becomes a vertex.

    The new normals follow nodes and joints; morph targets do not bend them.
    """
    cosine = float(np.cos(np.radians(angle_deg)))
    if file.rigging is None:
        return replace(file, parts=tuple(_smoothed_part(part, cosine) for part in file.parts))
    rest = file.rigging.skeleton.at_rest()
    parts, bodies = [], []
    for part, body in zip(file.parts, file.rigging.bodies, strict=True):
        smooth = smoothed_body(body, cosine)
        bodies.append(smooth)
        if smooth is body:  # without triangles, or broken
            parts.append(part)
            continue
        positions, normals, faces = smooth.at(rest)
        parts.append(replace(_of_corners(part, body.faces), positions=positions, normals=normals, faces=faces))
    return replace(file, parts=tuple(parts), rigging=replace(file.rigging, bodies=tuple(bodies)))


def _smoothed_part(part: Part, cosine: float) -> Part:
    corners = part.positions[part.faces]
    if not len(corners) or not np.all(np.isfinite(corners)):
        return part
    return replace(_of_corners(part, part.faces), normals=crease_normals(corners, cosine).reshape(-1, 3))


def _of_corners(part: Part, faces: NDArray[np.int64]) -> Part:
    """Return a part with a vertex for every corner of its faces (T, 3), as these are ordered."""
    order = faces.ravel()
    uv, *more_uv = [None if uv is None else uv[order] for uv in (part.uv, *part.more_uv)]
    colors = None if part.colors is None else part.colors[order]
    separate = np.arange(len(order)).reshape(-1, 3)
    return replace(part, positions=part.positions[order], faces=separate, uv=uv, more_uv=tuple(more_uv), colors=colors)
