# SPDX-License-Identifier: Apache-2.0
"""Meshes that move: a mesh at rest, what moves it, and its pose at a time.

A pose has the triangles, texture coordinates and materials of the mesh at rest. Its positions and normals are evaluated
in float64; its hull is a 26-DOP of its vertices.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.mesh.curve import Animation
from mr360uw.composite.mesh.hull import slab_hull, slabs
from mr360uw.composite.mesh.material import MeshFile, Rigging
from mr360uw.composite.mesh.mesh import Mesh, Unit, mesh_of_file, metres_of, proper_triangles
from mr360uw.composite.mesh.mesh_file import read_mesh_file
from mr360uw.composite.mesh.normals import corner_normals
from mr360uw.types import Floats


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """A mesh at rest and what moves it.

    rigging: None where nothing moves; else its bodies are those of the mesh. faces: for each body (t, 3), the vertices
    of its triangles in the mesh's order. scale: metres for a unit of the file.
    """

    mesh: Mesh
    rigging: Rigging | None = None
    faces: tuple[NDArray[np.int64], ...] = ()
    scale: float = 1.0


def load_rig(
    path: str | Path, unit: Unit = "auto", part: str = "", *, outside: bool = False, smooth_deg: float | None = None
) -> Rig:
    """Return the mesh of a file and what moves it; arguments and errors are those of `load_mesh`."""
    path = Path(path)
    file = read_mesh_file(path, outside=outside, smooth_deg=smooth_deg)
    return _rig(file, mesh_of_file(path, file, unit, part), metres_of(file, unit), part)


def _rig(file: MeshFile, mesh: Mesh, scale: float, part: str) -> Rig:
    if file.rigging is None:
        return Rig(mesh)
    pairs = zip(file.parts, file.rigging.bodies, strict=True)
    kept = [(p, body) for p, body in pairs if part in p.name and len(p.faces)]
    corners = np.concatenate([p.positions[p.faces] for p, _ in kept]) * scale
    proper = np.split(proper_triangles(corners), np.cumsum([len(p.faces) for p, _ in kept])[:-1])
    faces = tuple(p.faces[keep] for (p, _), keep in zip(kept, proper, strict=True))
    rigging = replace(file.rigging, bodies=tuple(body for _, body in kept))
    return Rig(mesh, rigging, faces, scale)


def surfaces(rig: Rig, clip: Animation, time_s: float) -> list[tuple[Floats, Floats | None]]:
    """Return positions (V, 3) [m] and normals (V, 3), or None, of the vertices of each body at a time of a clip [s].

    A mirror turns normals round; the winding of the triangles stays that at rest.
    """
    assert rig.rigging is not None
    state = rig.rigging.skeleton.at(clip, time_s)
    found = [body.at(state) for body in rig.rigging.bodies]
    return [(positions * rig.scale, normals) for positions, normals, _ in found]


def pose(rig: Rig, clip: Animation, time_s: float) -> Mesh:
    """Return the mesh at a time of a clip [s], counted from the clip's own zero."""
    found = surfaces(rig, clip, time_s)
    corners = [points.take(faces, axis=0) for (points, _), faces in zip(found, rig.faces, strict=True)]
    normals = [
        corner_normals(corner, normal, faces)
        for (_, normal), corner, faces in zip(found, corners, rig.faces, strict=True)
    ]
    positions, points = _joined(corners), _joined([points for points, _ in found])
    return replace(
        rig.mesh,
        positions=positions,
        normals=_joined(normals),
        hull=slab_hull(slabs(points), points.mean(axis=0)),
        rest=rig.mesh,
    )


def _joined(arrays: list[Floats]) -> Floats:
    """Return arrays one after the other; one array without a copy."""
    return arrays[0] if len(arrays) == 1 else np.concatenate(arrays)
