# SPDX-License-Identifier: Apache-2.0
"""Reads mesh files: each format by its own module."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.mesh.material import MeshFile, Part
from mr360uw.composite.mesh.normals import crease_normals
from mr360uw.composite.mesh.obj_file import read_obj
from mr360uw.composite.mesh.ply_file import read_ply
from mr360uw.composite.mesh.skin import smoothed_body
from mr360uw.composite.mesh.stl_file import read_stl
from mr360uw.composite.mesh.usd.usd_stage import USD_SUFFIXES
from mr360uw.errors import MeshError
from mr360uw.reading.input_files import DATA, unreadable

FORMATS = (".glb", ".gltf", ".obj", ".ply", ".stl", *USD_SUFFIXES)
_IMPORTERS = {
    ".fbx": "import_scene.fbx", ".abc": "wm.alembic_import", ".dae": "wm.collada_import", ".blend": "",
}  # fmt: skip
"""Formats that Blender reads and this does not: Blender's operator, none for its own files."""
_GAUSSIANS = "is points or splats, which have no surface - make a mesh of them first"
_OF_CAD = "is of a CAD program - export glTF, OBJ or STL there, or in FreeCAD"
_OF_MODELLER = "is of a modelling program - export glTF or OBJ there"
_OTHERS = {
    **dict.fromkeys((".splat", ".spz", ".ksplat", ".las", ".laz", ".e57", ".pts", ".ptx", ".xyz", ".pcd"), _GAUSSIANS),
    **dict.fromkeys((".step", ".stp", ".iges", ".igs", ".ifc", ".sldprt", ".dwg", ".dxf", ".f3d", ".3dm"), _OF_CAD),
    **dict.fromkeys(
        (".max", ".ma", ".mb", ".c4d", ".lwo", ".skp", ".3ds", ".hip", ".ztl", ".x3d", ".wrl"), _OF_MODELLER
    ),
    **dict.fromkeys((".3mf", ".amf", ".off"), "is read by MeshLab - open it there and export glTF, OBJ or PLY"),
    **dict.fromkeys((".zip", ".7z", ".rar", ".gz"), "is an archive - unpack it, and name the mesh in it"),
    ".vrm": "is glTF under another name - call it .glb",
    ".mtl": "is the material library of an OBJ - name the .obj",
    ".bin": "is the buffer of a glTF - name the .gltf",
}
"""Formats that are not read, and what to do."""


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
    if suffix in _OTHERS:
        raise MeshError(f"{path} - {_OTHERS[suffix]}")
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
    return read_ply(path, outside=outside) if suffix == ".ply" else read_stl(path)


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
