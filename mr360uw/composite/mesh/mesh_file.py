# SPDX-License-Identifier: Apache-2.0
"""Reads mesh files: each format by its own module."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.mesh.gltf_scene import read_gltf
from mr360uw.composite.mesh.material import MeshFile, Part
from mr360uw.composite.mesh.normals import crease_normals
from mr360uw.composite.mesh.obj_file import read_obj
from mr360uw.composite.mesh.ply_file import read_ply
from mr360uw.composite.mesh.skin import smoothed_body
from mr360uw.composite.mesh.stl_file import read_stl
from mr360uw.composite.mesh.usd.usd_scene import read_usd
from mr360uw.errors import MeshError
from mr360uw.reading.input_files import DATA, not_read, unreadable

_READERS = {
    **dict.fromkeys((".glb", ".gltf"), read_gltf), ".obj": read_obj, ".ply": read_ply, ".stl": read_stl,
    **dict.fromkeys((".usd", ".usda", ".usdc", ".usdz"), read_usd),
}  # fmt: skip
FORMATS = tuple(_READERS)


def read_mesh_file(path: Path, *, outside: bool = False, smooth_deg: float | None = None) -> MeshFile:
    """Return every placed part of a mesh file and its materials; raise `MeshError`.

    outside: the file may name others outside of its folder. smooth_deg: None for the normals of the file, else new ones
    that are smooth across edges of less than this angle [deg].
    """
    file = _read(path, outside=outside)
    return file if smooth_deg is None else smoothed(file, smooth_deg)


def _read(path: Path, *, outside: bool) -> MeshFile:
    suffix = path.suffix.lower()
    if suffix in not_read("mesh by Blender"):
        raise MeshError(f"{path} - is {suffix}, which is not read - convert it with Blender: {_conversion(path)}")
    if said := not_read("mesh").get(suffix):
        raise MeshError(f"{path} - {said}")
    if suffix not in FORMATS:
        raise MeshError(f"{path} - not a mesh format that is read (got {suffix!r}) - give {', '.join(FORMATS)}")
    if reason := unreadable(path):
        raise MeshError(f"{path} - {reason}")
    DATA.check(str(path), path.stat().st_size, MeshError)
    return _READERS[suffix](path, outside=outside)


def _conversion(path: Path) -> str:
    """Return the command with which Blender makes a .glb of a file beside it."""
    importer = not_read("mesh by Blender")[path.suffix.lower()]
    opened, steps = f" {path}", []
    if importer:
        opened = ""
        steps = ["bpy.ops.wm.read_homefile(use_empty=True)", f"bpy.ops.{importer}(filepath={str(path)!r})"]
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
