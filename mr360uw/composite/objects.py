# SPDX-License-Identifier: Apache-2.0
"""Objects of a scene: meshes of its `[[object]]` tables, set down on the receiver, and placed at a time for a shot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mr360uw.caustics.settings import Sea
from mr360uw.composite.mesh.material import Material
from mr360uw.composite.mesh.mesh import Mesh, Unit, opaque_where_sure
from mr360uw.composite.mesh.texture import Texture, read_texture
from mr360uw.composite.motion import Motion, floating, object_motion, rigid
from mr360uw.composite.object_settings import ObjectSettings
from mr360uw.composite.playback import Playback, Rig, load_rig, playback
from mr360uw.composite.shot import PlacedObject, Receiver
from mr360uw.errors import MeshError, ParameterError
from mr360uw.reading.disk_cache import CachedReads
from mr360uw.reading.input_files import OBJECTS
from mr360uw.shapes import checked
from mr360uw.types import Floats

_MOVING = (
    "position_m", "azimuth_deg", "elevation_deg", "distance_m", "stand_on", "rotation_deg", "face", "front", "size_m",
    "scale", "attach", "key", "interpolation", "animation", "loop", "speed", "start_s", "casts_shadow", "visible",
)  # fmt: skip
_AT_REST = {name: ObjectSettings.model_fields[name].default for name in _MOVING}
"""The settings that do not change an object's meshes."""
_RIGS = 4096
"""Files of meshes that are reads: all of a long sequence."""


@dataclass(frozen=True, slots=True, eq=False)
class SceneObject:
    """An object of a scene, loaded. meshes: one, or one for every frame of a mesh sequence.

    playback: the clip that it plays, or None. The one mesh of an object that plays is that at rest, but for its hull,
    which holds every pose of the clip. afloat: the sea that it floats on and the height [m] of its mean surface in
    the world, or None; its motion then is that on a level sea.
    """

    settings: ObjectSettings
    meshes: tuple[Mesh, ...]
    motion: Motion
    playback: Playback | None = None
    afloat: tuple[Sea, float] | None = None

    @property
    def moves(self) -> bool:
        """Whether it changes from frame to frame in the world."""
        plays = self.playback is not None and self.playback.moves
        return len(self.meshes) > 1 or self.motion.moves or plays or self.settings.attach != "world"

    @property
    def instants(self) -> Floats:
        """Times (n,) of the video [s] at which it has a key, or that show all of the clip that it plays."""
        if self.playback is None:
            return self.motion.time_s
        return np.concatenate([self.motion.time_s, self.playback.instants])

    def highest_m(self, camera_m: float) -> float:
        """Return an upper bound [m] of its height in the world, for a camera that stays below `camera_m`."""
        reach = max(float(np.linalg.norm(mesh.hull, axis=-1).max()) for mesh in self.meshes) * self.motion.scale
        if self.settings.attach == "camera":
            return camera_m + float(np.max(np.linalg.norm(self.motion.position, axis=-1) + reach))
        return float(np.max(self.motion.position[:, 1] + reach))

    @property
    def notes(self) -> tuple[str, ...]:
        """Warnings about its files."""
        return self.meshes[0].notes

    def at(self, time_s: float, frame: int, camera_position: Floats, world_from_camera: Floats) -> PlacedObject:
        """Return the object as it is at a time; a mesh sequence starts again after its last mesh."""
        transform = self.motion.at(time_s)
        if self.settings.attach == "camera":
            transform = rigid(camera_position, world_from_camera) @ transform
        elif self.afloat is not None:
            transform = floating(*self.afloat, transform, self.meshes[0], time_s)
        mesh = self.meshes[frame % len(self.meshes)] if self.playback is None else self.playback.at(time_s)
        return PlacedObject(mesh, transform, self.settings.casts_shadow, self.settings.visible)

    def lifted(self, origin: Floats, time_s: float) -> Floats:
        """Return what the surface adds (3,) [m] to the position setting of an object that is at `origin` at a time."""
        if self.afloat is None:
            return np.zeros(3)
        return origin - self.motion.at(time_s)[:3, 3] + np.array([0.0, self.afloat[1], 0.0])


@checked
def load_object(settings: ObjectSettings) -> SceneObject:
    """Return an object with its meshes, textures and overrides; raise `MeshError`."""
    return load_objects([settings])[0]


@checked
def load_objects(all_settings: Sequence[ObjectSettings], reads: CachedReads | None = None) -> tuple[SceneObject, ...]:
    """Return objects with their meshes, textures and overrides; raise `MeshError`.

    Every file is read once, and objects that differ only in where they are share their meshes. reads: what was read
    before, for an object that changes.
    """
    OBJECTS.check("scene - its number of objects", len(all_settings), ParameterError)
    reads = CachedReads() if reads is None else reads
    several = 4 * len(all_settings)

    return tuple(reads.of(_scene_object, one, several, reads, keep=several) for one in all_settings)


def on_the_sea(placed: SceneObject, sea: Sea, surface_y_m: float) -> SceneObject:
    """Return an object afloat on a sea if it is attached to the surface, whose mean height in the world is given."""
    if placed.settings.attach != "surface":
        return placed
    motion = replace(placed.motion, position=placed.motion.position + np.array([0.0, surface_y_m, 0.0]))
    return replace(placed, motion=motion, afloat=(sea, surface_y_m))


def _scene_object(settings: ObjectSettings, several: int, reads: CachedReads) -> SceneObject:
    """Return an object. several: textures and looks that are kept."""
    sized = {} if settings.size_m is None else {"size_m": 1.0}
    rigs = reads.of(_rigs, settings.model_copy(update=_AT_REST | sized), several, reads, keep=several)
    played, notes = playback(settings, rigs[0], sequence=len(rigs) > 1)
    meshes = tuple(rig.resting for rig in rigs)
    if played is not None:
        rest = rigs[0].mesh
        meshes = (replace(rest, hull=played.bounds, notes=rest.notes + notes),)
    return SceneObject(settings, meshes, object_motion(settings, rigs[0].mesh), played)


def _rigs(look: ObjectSettings, several: int, reads: CachedReads) -> tuple[Rig, ...]:
    """Return the meshes of an object, one a file, with the materials that its settings ask for."""
    unit: Unit = "auto" if look.size_m is None else "m"  # of any unit: no note on an odd size
    first, *others = _paths(look.mesh)
    asked = unit, look.outside_files, look.smooth_deg, look.up
    rigs = [reads.of(load_rig, first, *asked, keep=_RIGS)]
    rigs += [reads.of(load_rig, path, *asked, rigs[0].place, keep=_RIGS) for path in others]
    base = reads.of(read_texture, look.texture, keep=several) if look.texture else None
    return tuple(replace(rig, mesh=_overridden(rig.mesh, look, base)) for rig in rigs)


def _paths(path: Path) -> list[Path]:
    """Return the file, or every file of a numbered pattern such as fish_%04d.glb, from the first number there is."""
    if "%" not in path.name or path.exists():
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


def _overridden(mesh: Mesh, settings: ObjectSettings, base: Texture | None) -> Mesh:
    """Return a mesh with the materials that a scene asks for. base: its texture, if it asks for one."""
    notes = list(mesh.notes)
    if base is not None and not np.any(mesh.uv):
        notes.append(f"{settings.mesh} - has no texture coordinates - all of it takes the corner of its texture")
    materials = []
    for material in mesh.materials:
        changed = material
        if base is not None:
            changed = replace(changed, base_map=base, base_color=(1.0, 1.0, 1.0, material.base_color[3]))
        materials.append(_factors(changed, settings))
    colors = mesh.colors
    if base is not None and np.any(colors[..., :3] != 1.0):
        notes.append(f"{settings.mesh} - vertex colours are left out beside the texture - remove that to see them")
        colors = np.concatenate([np.ones_like(colors[..., :3]), colors[..., 3:]], axis=-1)
    return opaque_where_sure(replace(mesh, materials=tuple(materials), colors=colors, notes=tuple(notes)))


def _factors(material: Material, settings: ObjectSettings) -> Material:
    names = ("metallic", "roughness", "double_sided", "refractive_index")
    given: dict[str, Any] = {name: value for name in names if (value := getattr(settings, name)) is not None}
    if settings.base_color is not None:
        given["base_color"] = (*settings.base_color, material.base_color[3])
    gain = 2.0**settings.exposure
    red, green, blue = (gain * part for part in settings.tint)
    return replace(material, **given, trim=(red, green, blue))


def on_the_floor(placed: SceneObject, receiver: Receiver | None) -> SceneObject:
    """Return an object that stands on a receiver if its settings say so, else itself.

    At every key its lowest point is as high as the receiver is under the middle of its foot; of an object that plays a
    clip, the lowest point at rest. Raises `MeshError` where no receiver of known shape is under it.
    """
    if placed.settings.stand_on is None:
        return placed
    mesh, motion = placed.meshes[0], placed.motion
    points = (mesh.hull if placed.playback is None else mesh.positions).reshape(-1, 3)
    position = motion.position.copy()
    for number, (rotation, scale) in enumerate(zip(motion.rotation, motion.scale, strict=True)):
        corners = scale * points @ rotation.T + position[number]
        low, high = corners.min(axis=0), corners.max(axis=0)
        x, z = 0.5 * (low + high)[[0, 2]]
        height = None if receiver is None else receiver_height(receiver, float(x), float(z))
        if height is None:
            raise MeshError(
                f"{placed.settings.mesh} - stands on nothing (got no receiver under x {x:.2f}, z {z:.2f} m) - move it, "
                "or give a receiver of kind plane, mesh or height_map that reaches there"
            )
        position[number, 1] += height - low[1]
    return replace(placed, motion=replace(motion, position=position))


def receiver_height(receiver: Receiver, x_m: float, z_m: float) -> float | None:
    """Return the height [m] in the world of the highest point of a receiver at (x, z); None where there is none.

    The shape of a distance map is known along the rays of a frame only: None.
    """
    if receiver.plane_y is not None:
        return receiver.plane_y
    if receiver.mesh is None:
        return None
    a, b, c = (receiver.mesh[:, k] for k in range(3))
    u, v = b - a, c - a
    area = u[:, 0] * v[:, 2] - u[:, 2] * v[:, 0]
    there = np.abs(area) > 0.0
    a, u, v, area = a[there], u[there], v[there], area[there]
    dx, dz = x_m - a[:, 0], z_m - a[:, 2]
    along_u, along_v = (dx * v[:, 2] - dz * v[:, 0]) / area, (dz * u[:, 0] - dx * u[:, 2]) / area
    inside = (along_u >= 0.0) & (along_v >= 0.0) & (along_u + along_v <= 1.0)
    heights = (a[:, 1] + along_u * u[:, 1] + along_v * v[:, 1])[inside]
    return float(heights.max()) if len(heights) else None
