# SPDX-License-Identifier: Apache-2.0
"""Reads mesh files: glTF by `gltf_scene`, USD by `usd_scene`, other formats through trimesh."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import Same
from mr360uw.composite.affine import placed
from mr360uw.composite.mesh.material import Material, MeshFile, ObjNeighbours, Part, obj_notes, simple_material
from mr360uw.composite.mesh.normals import crease_normals
from mr360uw.composite.mesh.skin import smoothed_body
from mr360uw.composite.mesh.usd.usd_stage import USD_SUFFIXES
from mr360uw.errors import MeshError
from mr360uw.reading.input_files import unreadable
from mr360uw.reading.limits import DATA, TRIANGLES
from mr360uw.types import Floats

FORMATS = (".glb", ".gltf", ".obj", ".ply", ".stl", *USD_SUFFIXES)
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
    notes = obj_notes(path, outside=outside) if suffix == ".obj" else ()
    scene = _load_scene(path, ObjNeighbours(path, outside=outside) if suffix == ".obj" else None)
    parts: list[Part] = []
    materials: list[Material] = []
    indices: dict[Same, int] = {}
    triangles = 0
    for node in scene.graph.nodes_geometry:
        transform, name = scene.graph[node]
        geometry = scene.geometry[name]
        if not hasattr(geometry, "faces"):
            notes += (f"{path} - has points or lines - they are not drawn",)
            continue
        triangles += len(geometry.faces)
        TRIANGLES.check(str(path), triangles, MeshError)
        source = getattr(geometry.visual, "material", None)
        index = indices.setdefault(Same(source), len(materials))
        if index == len(materials):
            materials.append(Material(double_sided=True) if source is None else simple_material(source, path))
        parts.append(_part(path, str(name), geometry, np.asarray(transform), index))
    return MeshFile(tuple(parts), tuple(materials), notes)


def _conversion(path: Path) -> str:
    """Return the command with which Blender makes a .glb of a file beside it."""
    importer = _IMPORTERS[path.suffix.lower()]
    opened = f" {path}" if not importer else ""
    steps = [f"bpy.ops.{importer}(filepath={str(path)!r})"] if importer else []
    if importer:
        steps.insert(0, "bpy.ops.wm.read_homefile(use_empty=True)")
    steps.append(f"bpy.ops.export_scene.gltf(filepath={str(path.with_suffix('.glb'))!r})")
    return f'blender -b{opened} --python-expr "import bpy; {"; ".join(steps)}"'


def _load_scene(path: Path, neighbours: ObjNeighbours | None) -> Any:
    """Return a scene of trimesh, whose log is silent: its errors are raised as `MeshError`."""
    import trimesh

    log = logging.getLogger("trimesh")
    level = log.level
    log.setLevel(logging.CRITICAL)
    try:
        return trimesh.load_scene(path, process=False, resolver=neighbours)
    except Exception as error:  # trimesh does not catch the exceptions of its parsers
        raise MeshError(f"{path} - cannot be read as a mesh (got: {error!s:.200}) - export it again") from error
    finally:
        log.setLevel(level)


def _part(path: Path, name: str, geometry: Any, transform: Floats, material: int) -> Part:
    positions: Floats = np.asarray(geometry.vertices, np.float64)
    normals: Floats | None = None
    if "vertex_normals" in geometry._cache.cache:  # normals of the file; the attribute would compute missing ones
        own = np.asarray(geometry.vertex_normals, np.float64)
        normals = own if own.shape == positions.shape and np.any(own) else None
    faces = np.asarray(geometry.faces, np.int64)
    if faces.size and not 0 <= int(faces.min()) <= int(faces.max()) < len(positions):
        wrong = int(faces.min()) if faces.min() < 0 else int(faces.max())
        raise MeshError(
            f"{path} - has a face of a vertex that is not there (got {wrong} of {len(positions)}, the first is 0)"
            " - export it again"
        )
    positions, normals, faces = placed(transform, positions, normals, faces)
    uv = getattr(geometry.visual, "uv", None)
    if uv is not None:
        uv = np.asarray(uv, np.float64) * [1.0, -1.0] + [0.0, 1.0]
    return Part(name, positions, faces, normals, uv, _colors(geometry), material)


def _colors(geometry: Any) -> Floats | None:
    """Return linear vertex colours (V, 4): those of PLY and OBJ are 8-bit codes."""
    from mr360uw.color import decode

    if getattr(geometry.visual, "kind", None) != "vertex":
        return None
    colors = np.ones((len(geometry.vertices), 4))
    codes = np.asarray(geometry.visual.vertex_colors)
    colors[:, : codes.shape[1]] = codes / 255.0
    colors[:, :3] = decode(colors[:, :3], "srgb")
    return colors


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
