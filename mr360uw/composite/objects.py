# SPDX-License-Identifier: Apache-2.0
"""From the tables of a scene to what a shot holds: placed objects, receivers, mattes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mr360uw.composite.material import Material
from mr360uw.composite.mesh import Mesh, load_mesh
from mr360uw.composite.mesh_file import read_texture
from mr360uw.composite.motion import Motion, object_motion, rigid, rotation_matrix
from mr360uw.composite.settings import ObjectSettings, ReceiverSettings
from mr360uw.composite.shot import PlacedObject, Receiver
from mr360uw.errors import MeshError
from mr360uw.types import Floats


@dataclass(frozen=True, slots=True, eq=False)
class SceneObject:
    """An object of a scene, loaded. meshes: one, or one for every frame of a mesh sequence."""

    settings: ObjectSettings
    meshes: tuple[Mesh, ...]
    motion: Motion

    @property
    def moves(self) -> bool:
        """Whether it changes from frame to frame in the world."""
        return len(self.meshes) > 1 or self.motion.moves or self.settings.attach == "camera"

    @property
    def notes(self) -> tuple[str, ...]:
        """What looked odd about its files."""
        return self.meshes[0].notes

    def at(self, time_s: float, frame: int, camera_position: Floats, world_from_camera: Floats) -> PlacedObject:
        """Return the object as it is at a time; a mesh sequence starts again after its last mesh."""
        transform = self.motion.at(time_s)
        if self.settings.attach == "camera":
            transform = rigid(camera_position, world_from_camera) @ transform
        return PlacedObject(
            self.meshes[frame % len(self.meshes)], transform, self.settings.casts_shadow, self.settings.visible
        )


def load_object(settings: ObjectSettings) -> SceneObject:
    """Return an object with its meshes, textures and overrides; raise `MeshError`."""
    meshes = tuple(
        _overridden(load_mesh(path, settings.unit, settings.part), settings) for path in _paths(settings.mesh)
    )
    return SceneObject(settings, meshes, object_motion(settings))


def _paths(path: Path) -> list[Path]:
    """Return the file, or every file of a numbered pattern such as fish_%04d.glb, from the first number there is."""
    if "%" not in path.name:
        return [path]
    found: list[Path] = []
    number = 0
    try:
        while number < 2 or (found and found[-1] == path.with_name(path.name % (number - 1))):
            file = path.with_name(path.name % number)
            if file.is_file():
                found.append(file)
            number += 1
    except (TypeError, ValueError):
        raise MeshError(f"{path} - is no pattern of numbered files - write for example fish_%04d.glb") from None
    if not found:
        raise MeshError(f"{path} - no such files (got none with number 0 or 1) - check the pattern")
    return found


def _overridden(mesh: Mesh, settings: ObjectSettings) -> Mesh:
    """Return a mesh with the materials that a scene asks for."""
    base = read_texture(settings.texture, srgb=True) if settings.texture else None
    bump = read_texture(settings.normal_texture, srgb=False) if settings.normal_texture else None
    orm = read_texture(settings.orm_texture, srgb=False) if settings.orm_texture else None
    materials = []
    for material in mesh.materials:
        changed = material
        if base is not None:
            changed = replace(changed, base_map=base, base_color=(1.0, 1.0, 1.0, material.base_color[3]))
        if bump is not None:
            changed = replace(changed, normal_map=bump)
        if orm is not None:
            changed = replace(changed, metallic_roughness_map=orm, occlusion_map=orm, roughness=1.0, metallic=1.0)
        materials.append(_factors(changed, settings))
    tinted = settings.vertex_colors == "multiply" or (
        settings.vertex_colors == "auto" and all(m.base_map is None for m in materials)
    )
    colors = mesh.colors if tinted else np.ones_like(mesh.colors)
    return replace(mesh, materials=tuple(materials), colors=colors)


def _factors(material: Material, settings: ObjectSettings) -> Material:
    changed = material
    if settings.base_color is not None:
        r, g, b = settings.base_color
        changed = replace(changed, base_color=(r, g, b, material.base_color[3]))
    if settings.metallic is not None:
        changed = replace(changed, metallic=settings.metallic)
    if settings.roughness is not None:
        changed = replace(changed, roughness=settings.roughness)
    if settings.double_sided is not None:
        changed = replace(changed, double_sided=settings.double_sided)
    r, g, b = (settings.emission_scale * c for c in material.emission)
    index = material.refractive_index if settings.refractive_index is None else settings.refractive_index
    return replace(changed, emission=(r, g, b), refractive_index=index)


def load_receiver(settings: ReceiverSettings) -> Receiver:
    """Return the receiver of a scene's table, except a distance map, which is an image of every frame.

    For `kind = "distance"` the caller puts the frame's map into `Receiver.distance_m` with `map_range`.
    Raises `MeshError`.
    """
    plain = Receiver(
        shadow=settings.shadow,
        occlusion=settings.occlusion,
        caustics=settings.caustics,
        extent_m=settings.extent_m,
    )
    if settings.kind == "plane":
        return replace(plain, plane_y=settings.height_m)
    if settings.path is None:
        raise MeshError(f"receiver - kind {settings.kind!r} needs a file (got no path) - set receiver.path")
    if settings.kind == "mesh":
        transform = rigid(settings.position_m, rotation_matrix(settings.rotation_deg), settings.scale)
        placed = PlacedObject(load_mesh(settings.path), transform)
        return replace(plain, mesh=placed.to_world(placed.mesh.positions))
    if settings.kind == "height_map":
        return replace(plain, mesh=height_map_triangles(_grey(settings.path), settings))
    return replace(plain, distance_m=map_range(_grey(settings.path), settings.range_m))


def map_range(grey: Floats, range_m: tuple[float, float]) -> Floats:
    """Return the metres of grey values in [0, 1]."""
    return range_m[0] + (range_m[1] - range_m[0]) * np.asarray(grey, np.float64)


def height_map_triangles(grey: Floats, settings: ReceiverSettings, most: int = 256) -> Floats:
    """Return the triangles (T, 3, 3) of a height map (h, w) in [0, 1]: right = +x, down = +z, about `position_m`."""
    import cv2

    rows, columns = (min(n, most) for n in grey.shape)
    height = map_range(cv2.resize(np.float32(grey), (columns, rows), interpolation=cv2.INTER_AREA), settings.range_m)
    x = (np.linspace(0.0, 1.0, columns) - 0.5) * settings.size_m[0] + settings.position_m[0]
    z = (np.linspace(0.0, 1.0, rows) - 0.5) * settings.size_m[1] + settings.position_m[2]
    x, z = np.meshgrid(x, z)
    points = np.stack([x, height + settings.position_m[1], z], axis=-1)
    a, b, c, d = points[:-1, :-1], points[:-1, 1:], points[1:, 1:], points[1:, :-1]
    return np.concatenate([np.stack([a, d, c], axis=2), np.stack([a, c, b], axis=2)]).reshape(-1, 3, 3)


def _grey(path: Path) -> Floats:
    """Return an image as one channel in [0, 1]; float images (EXR, TIFF) keep their values."""
    import cv2

    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise MeshError(f"{path} - cannot be read as an image - give a PNG or TIFF of one channel")
    image = image if image.ndim == 2 else image[..., 0]
    whole = float(np.iinfo(image.dtype).max) if np.issubdtype(image.dtype, np.integer) else 1.0
    return np.asarray(image, np.float64) / whole
