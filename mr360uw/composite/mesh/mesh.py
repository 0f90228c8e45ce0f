# SPDX-License-Identifier: Apache-2.0
"""Meshes in the form that renderers take: separate triangles with all attributes of their corners, in metres.

Corners are not shared between triangles, so flat, creased and smooth surfaces, seams of the texture and several
materials need no special cases. A mesh also has its convex hull, for its bounds in the frame.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.color import luminance
from mr360uw.base.disk_cache import kept_arrays
from mr360uw.base.input_files import DATA, not_read, unreadable
from mr360uw.base.parameters import checked
from mr360uw.composite.mesh.gltf_scene import read_gltf
from mr360uw.composite.mesh.material import Material, MeshFile, Part
from mr360uw.composite.mesh.obj_file import read_obj
from mr360uw.composite.mesh.ply_stl import read_ply, read_stl
from mr360uw.composite.mesh.polygons import corner_normals, crease_normals, placed, smooth_patches, welded
from mr360uw.composite.mesh.skin import smoothed_body
from mr360uw.composite.mesh.up_axis import UPRIGHT, Up, up_axis
from mr360uw.composite.mesh.usd_scene import read_usd
from mr360uw.errors import MeshError
from mr360uw.types import Floats

Unit = Literal["auto", "m", "cm", "mm"]
METRES: dict[Unit, float] = {"auto": 1.0, "m": 1.0, "cm": 0.01, "mm": 0.001}
"""Length of one unit of a file [m]; "auto" for files that do not say."""
_KEPT = 1000
"""Triangles from which on the patches and the hull of a mesh are kept on the disk: computing less takes as long as
reading a file."""
_MANY = 50_000
"""Distinct points above which the hull is simplified."""
_SHALLOW = 1e-4
_LARGE_M = 20.0
_SMALL_M = 0.02
"""Sizes above and below which a note suggests another unit or a scale."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles in the object's own axes [m]; arrays are (T, ...) by triangle and (T, 3, ...) by corner.

    positions, normals: (T, 3, 3), normals unit, outwards. uv: (T, 3, 2), right and down from the image's top left;
    more_uv: (T, 3, m, 2) those of further `Material.sets`.
    colors: (T, 3, 4) linear factor on the base colour. material: (T,) index into `materials`. patch: (T,) number of
    the smooth piece of a triangle. hull: (h, 3, 3) triangles of the convex hull. notes: what looked odd, for the user.
    rest: of a pose of a mesh that moves, the mesh at rest; both have the same triangles in the same order, and the same
    uv, colors, material, patch and materials.
    """

    positions: Floats
    normals: Floats
    uv: Floats
    more_uv: Floats
    colors: Floats
    material: NDArray[np.int32]
    patch: NDArray[np.int32]
    materials: tuple[Material, ...]
    hull: Floats
    notes: tuple[str, ...] = ()
    rest: Mesh | None = None

    @property
    def still(self) -> Mesh:
        """The mesh at rest, which all poses share: a key for what does not change with the pose."""
        return self if self.rest is None else self.rest

    @cached_property
    def darkened_to(self) -> float:
        """Mean luminance of the vertex colours where they multiply a base map; 1 where there is none."""
        mapped = np.isin(self.material, [k for k, m in enumerate(self.materials) if m.base_map is not None])
        return float(luminance(self.colors[mapped][..., :3]).mean()) if np.any(mapped) else 1.0

    @cached_property
    def extent_m(self) -> Floats:
        """Size of the bounding box (3,)."""
        return np.ptp(self.hull.reshape(-1, 3), axis=0)

    @cached_property
    def center_m(self) -> Floats:
        """Centre of the bounding box (3,)."""
        points = self.hull.reshape(-1, 3)
        return 0.5 * (points.min(axis=0) + points.max(axis=0))

    @cached_property
    def radius_m(self) -> float:
        """Radius of the ball about `center_m` that contains every vertex."""
        return float(np.max(np.linalg.norm(self.hull.reshape(-1, 3) - self.center_m, axis=-1)))

    @property
    def glossy(self) -> bool:
        """Whether a material is smoother than diffuse."""
        return any(m.roughness < 0.95 or m.metallic_roughness_map is not None for m in self.materials)


@checked
def load_mesh(
    path: str | Path,
    unit: Unit = "auto",
    part: str = "",
    *,
    up: Up = "auto",
    outside: bool = False,
    smooth_deg: float | None = None,
) -> Mesh:
    """Return the mesh of a file, all its parts in the world of the file.

    Vertices stay where the file has them, but that they are turned y up, and moved to the origin from map coordinates.
    An animated file is taken as it rests: place and motion belong to the objects of a scene.

    Parameters
    ----------
    path : str or Path
        A file of one of the formats `FORMATS`: glTF, GLB, USD, OBJ, PLY, STL.
    unit : str
        Unit of the file; "auto" takes what the file says, or metres, and notes sizes that look wrong.
    part : str
        Keep the parts whose name contains it.
    up : str
        Axis of the file that points up: y, z, x, -y, -z or -x; "auto": as its format, its comments or its shape tells.
    outside : bool
        Buffers and textures may lie outside of the file's folder.
    smooth_deg : float, optional
        Make new normals, smooth across edges that bend by less than this [deg]; 0: flat.

    Returns
    -------
    Mesh
        Triangles (T, 3, 3) [m], normals and materials.

    Raises
    ------
    MeshError
        If the file cannot be read, has no triangles, vertices that are not finite or no extent, or names a missing
        texture.

    See Also
    --------
    uw.composite.load_object : A mesh with place and motion.
    uw.composite.Mesh : What is returned.
    uw.Scene : Names meshes as objects.

    Examples
    --------
    >>> uw.composite.load_mesh("whale.glb").positions.shape[1:]
    (3, 3)
    """
    file = read_mesh_file(Path(path), outside=outside, smooth_deg=smooth_deg)
    moves = "is animated - here it is drawn as it rests in the file"
    notes = (f"{path} - {moves}",) if file.rigging is not None else ()
    place, said = object_from_file(Path(path), file, unit, up)
    mesh = mesh_of_file(Path(path), file, place, unit, part)
    return opaque_where_sure(replace(mesh, notes=mesh.notes + said + notes))


def opaque_where_sure(mesh: Mesh) -> Mesh:
    """Return a mesh whose BLEND materials are OPAQUE where their alpha is 1 everywhere: exporters name BLEND also where
    nothing is clear, and opaque surfaces are cheaper.
    """

    def sure(number: int, material: Material) -> bool:
        of_map = 1.0 if material.base_map is None else float(material.base_map.levels[0][..., 3].min())
        of_vertices = mesh.colors[mesh.material == number, :, 3].min(initial=np.inf)
        return material.base_color[3] * of_map * of_vertices >= 1.0

    materials = tuple(
        replace(m, alpha_mode="OPAQUE") if m.alpha_mode == "BLEND" and sure(k, m) else m
        for k, m in enumerate(mesh.materials)
    )
    return replace(mesh, materials=materials)


def mesh_of_file(path: Path, file: MeshFile, place: Floats, unit: Unit = "auto", part: str = "") -> Mesh:
    """Return the mesh at rest of what a file holds, as `load_mesh` does. place: that of `object_from_file`."""
    named = [p for p in file.parts if part in p.name]
    if part and not named:
        names = ", ".join(sorted({p.name for p in file.parts}))
        raise MeshError(f"{path} - no part of that name (got {part!r}) - there are: {names}")
    parts = []
    for one in named:
        with np.errstate(invalid="ignore", over="ignore"):  # such vertices are refused next
            positions, normals, faces = placed(place, one.positions, one.normals, one.faces)
        parts.append(replace(one, positions=positions, normals=normals, faces=faces))
    mesh = make_mesh(parts, list(file.materials), where=str(path))
    odd = _size_notes(str(path), mesh.extent_m, cad=file.cad) if unit == "auto" else ()
    return replace(mesh, notes=file.notes + mesh.notes + odd)


def object_from_file(path: Path, file: MeshFile, unit: Unit, up: Up) -> tuple[Floats, tuple[str, ...]]:
    """Return the transform (4, 4) from a file's coordinates to the object's [m], and notes.

    A unit is as long as the file says, unless the user says another; the up axis is turned to y. A file in coordinates
    of a map is moved so that its middle is the origin: single precision would have no digits left for its shape.
    """
    # Find the up axis, and say so where the file did not
    axis, why = (up, "") if up != "auto" else up_axis(path, file)
    notes = []
    if up == "auto" and axis != "y":
        notes.append(f'{path} - has {axis} up ({why}) - it is turned so that it stands; up = "y" keeps it as it is')
    elif up == "auto" and not why and file.cad:
        notes.append(f'{path} - its format does not say which axis is up - y is taken; up = "z" stands it up')
    # Turn and scale; then move the middle of a far file to the origin, in double precision
    place = np.eye(4)
    place[:3, :3] = (file.unit_m if unit == "auto" else METRES[unit]) * UPRIGHT[axis]
    points = [part.positions[part.faces].reshape(-1, 3) for part in file.parts if len(part.faces)]
    low, high = (np.stack([edge(p, axis=0) for p in points] or [np.zeros(3)]) for edge in (np.min, np.max))
    low, high = low.min(axis=0), high.max(axis=0)
    middle, size = 0.5 * (low + high), float(np.max(high - low))
    if np.all(np.abs(middle) <= _FARTHEST) and np.max(np.abs(middle)) > _FAR * size > 0.0:
        place[:3, 3] = -place[:3, :3] @ middle
        where = ", ".join(f"{value:.9g}" for value in middle)
        notes.append(f"{path} - lies far from its origin, at {where} - it is moved: position_m places its middle")
    return place, tuple(notes)


_FAR = 300.0
"""Distance from the origin, over the size, from which coordinates are those of a map. Single precision changes the
picture of a ball that is 350 times its size away by 1 code."""
_FARTHEST = 1e9
"""Largest coordinate of a vertex: squares of areas stay finite in single precision."""


def make_mesh(parts: list[Part], materials: list[Material], *, where: str = "mesh") -> Mesh:
    """Return the mesh of indexed parts [m]. Raises `MeshError` as `load_mesh` does."""
    # Refuse what has no triangles, or vertices out of all bounds
    parts = [p for p in parts if len(p.faces)]
    if not parts:
        raise MeshError(f"{where} - has no triangles (got 0) - export the surface as triangles")
    parts, materials, notes = _without_useless_maps(where, parts, materials)
    wild = sum(int(np.sum(~(np.abs(p.positions[p.faces]) <= _FARTHEST).all(axis=(1, 2)))) for p in parts)
    if wild:
        raise MeshError(
            f"{where} - vertices are not finite, or more than {_FARTHEST:g} m away (got {wild} such triangles) - "
            "export the mesh again"
        )
    # Give each triangle its own corners, and leave out those without area
    further = max(len(p.more_uv) for p in parts)
    corners = [_corners(p, further) for p in parts]
    positions, normals, uv, more_uv, colors = (np.concatenate(arrays) for arrays in zip(*corners, strict=True))
    extent = np.ptp(positions.reshape(-1, 3), axis=0)
    if np.max(extent) <= 0.0:
        raise MeshError(f"{where} - has no extent (got all vertices in one place) - export it without compression")
    keep = proper_triangles(positions)
    if not np.any(keep):
        raise MeshError(f"{where} - all triangles are degenerate (got {len(keep)}) - export the surface again")
    material = np.concatenate([np.full(len(p.faces), p.material, np.int32) for p in parts])
    piece = np.concatenate([np.full(len(p.faces), k, np.int32) for k, p in enumerate(parts)])
    if not np.all(keep):
        positions, normals, uv, more_uv = positions[keep], normals[keep], uv[keep], more_uv[keep]
        colors, material, piece = colors[keep], material[keep], piece[keep]
    # Find the smooth pieces and the hull, and say what darkens the mesh
    patch, hull = _patches_and_hull(positions, normals, piece)
    made = Mesh(positions, normals, uv, more_uv, colors, material, patch, tuple(materials), hull, notes)
    if made.darkened_to > MUCH_DARKER:
        return made
    darkened = f"{where} - {DARKENING} to {made.darkened_to:.2g} of it - if that is wrong, set vertex_colors = false"
    return replace(made, notes=(*notes, darkened))


def _patches_and_hull(positions: Floats, normals: Floats, piece: NDArray[np.int32]) -> tuple[NDArray[np.int32], Floats]:
    """Return the smooth piece (T,) of each triangle and the triangles of the hull; of large meshes kept on the disk."""

    def made() -> dict[str, NDArray[Any]]:
        place = welded(positions)
        return {"patch": smooth_patches(place, normals, piece), "hull": hull_triangles(positions, place)}

    found = kept_arrays("mesh", (positions, normals, piece), made) if len(positions) >= _KEPT else made()
    return found["patch"], found["hull"]


def hull_triangles(positions: Floats, place: NDArray[np.int64]) -> Floats:
    """Return the triangles of the convex hull, or of the bounding box where the mesh is flat.

    place: (3 T,) index of every corner's position. Above `_MANY` positions, points may lie outside the hull by up to
    `_SHALLOW` of the extent: less than the pixel added around an object, with far fewer triangles.
    """
    from scipy.spatial import ConvexHull, QhullError

    points = positions.reshape(-1, 3)
    one = np.empty(place.max() + 1, np.int64)
    one[place] = np.arange(len(place))  # of the corners at a place, any
    points = points[one]
    try:
        shallow = _SHALLOW * float(np.max(np.ptp(points, axis=0)))
        hull = ConvexHull(points, qhull_options=f"Qt W{shallow:.3g}" if len(points) > _MANY else "Qt")
        return points[hull.simplices]
    except QhullError:
        low, high = points.min(axis=0), points.max(axis=0)
        box = np.stack(np.meshgrid(*zip(low, high, strict=True), indexing="ij"), axis=-1).reshape(8, 3)
        sides = [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]
        return box[[t for a, b, c, d in sides for t in ((a, b, c), (a, c, d))]]


def proper_triangles(positions: Floats) -> NDArray[np.bool_]:
    """Return which triangles (T, 3, 3) of a mesh have an area; the others are not drawn."""
    extent = np.ptp(positions.reshape(-1, 3), axis=0)
    area = 0.5 * np.linalg.norm(np.cross(positions[:, 1] - positions[:, 0], positions[:, 2] - positions[:, 0]), axis=-1)
    return np.asarray(area > 1e-14 * np.max(extent) ** 2)


MUCH_DARKER = 0.5
"""`Mesh.darkened_to` up to which that is said. Occlusion that is baked into vertex colours leaves 0.6 to 0.9."""
DARKENING = "has vertex colours that darken its texture"
"""How a note of that begins."""


def _size_notes(where: str, extent: Floats, *, cad: bool) -> tuple[str, ...]:
    longest = float(np.max(extent))
    if longest > _LARGE_M:
        guess: Unit = "mm" if cad or longest >= 100.0 * _LARGE_M else "cm"
    elif longest < _SMALL_M:
        return (f"{where} - is only {1000 * longest:.3g} mm large - a scale for the object may be missing",)
    else:
        return ()
    return (f"{where} - is {longest:.3g} m long - in {guess}? then set size_m, or scale = {METRES[guess]:g}",)


def _corners(part: Part, further: int) -> tuple[Floats, ...]:
    """Return positions, normals, uv, `further` more uv and colours of the corners of one part."""
    faces = part.faces
    positions: Floats = np.asarray(part.positions, np.float64)[faces]
    normals: Floats
    if not np.all(np.isfinite(positions)):
        normals = np.zeros_like(positions)
    elif part.normals is None or not np.all(np.isfinite(part.normals)):
        normals = corner_normals(positions, None, faces) if part.flat else crease_normals(positions)
    else:
        normals = corner_normals(positions, np.asarray(part.normals, np.float64), faces)
    uv = np.zeros((*faces.shape, 1 + further, 2))
    for number, of_set in enumerate((part.uv, *part.more_uv)):
        if of_set is not None:
            uv[..., number, :] = np.asarray(of_set, np.float64)[faces]
    uv = np.where(np.isfinite(uv), uv, 0.0)
    colors = np.ones((*faces.shape, 4)) if part.colors is None else np.asarray(part.colors, np.float64)[faces]
    return positions, normals, uv[..., 0, :], uv[..., 1:, :], np.where(np.isfinite(colors), colors, 1.0)


def _without_useless_maps(
    where: str, parts: list[Part], materials: list[Material]
) -> tuple[list[Part], list[Material], tuple[str, ...]]:
    """Return parts, materials and notes, with maps removed from parts without texture coordinates."""
    materials, notes = list(materials), []
    bare: dict[tuple[int, frozenset[int]], int] = {}
    changed = []
    for part in parts:
        if materials and (missing := part.missing_sets(materials[part.material])):
            notes.append(f"{where} - part {part.name!r} has maps but no texture coordinates - it is drawn without them")
            if (part.material, missing) not in bare:
                bare[part.material, missing] = len(materials)
                materials.append(materials[part.material].without_maps(missing))
            part = replace(part, material=bare[part.material, missing])  # noqa: PLW2901
        if not all(np.all(np.isfinite(uv)) for uv in (part.uv, *part.more_uv) if uv is not None):
            notes.append(f"{where} - part {part.name!r} has texture coordinates that are no numbers - unwrap it")
        changed.append(part)
    return changed, materials, tuple(dict.fromkeys(notes))


# Reads mesh files: each format by its own module.

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
    # Refuse what is no mesh, or one of a format that is not read, with the way out
    suffix, others = path.suffix.lower(), not_read("mesh by Blender")
    if suffix in others:
        converted = _conversion(path, others[suffix])
        raise MeshError(f"{path} - is {suffix}, which is not read - convert it with Blender: {converted}")
    if said := not_read("mesh").get(suffix):
        raise MeshError(f"{path} - {said}")
    if suffix not in FORMATS:
        raise MeshError(f"{path} - not a mesh format that is read (got {suffix!r}) - give {', '.join(FORMATS)}")
    if reason := unreadable(path):
        raise MeshError(f"{path} - {reason}")
    DATA.check(str(path), path.stat().st_size, MeshError)
    # Read it, and make its normals anew where that is asked for
    file = _READERS[suffix](path, outside=outside)
    return file if smooth_deg is None else smoothed(file, smooth_deg)


def _conversion(path: Path, importer: str) -> str:
    """Return the command with which Blender makes a .glb of a file beside it. importer: its operator, "" for none."""
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
