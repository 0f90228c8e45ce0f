# SPDX-License-Identifier: Apache-2.0
"""Shot: everything that the layer of one frame depends on, with its objects and the plate's receiver."""

from __future__ import annotations

import operator
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.cache import Cache, Parts
from mr360uw.base.color import LEAST_CHANGE, luminance
from mr360uw.base.input_files import OBJECTS
from mr360uw.base.parameters import checked
from mr360uw.caustics.settings import Sea
from mr360uw.composite.mesh.material import Material, Texture, read_texture
from mr360uw.composite.mesh.mesh import DARKENING, Mesh, Unit, opaque_where_sure
from mr360uw.composite.motion import (
    Motion,
    Playback,
    Rig,
    floating,
    lamp_motion,
    load_rig,
    object_motion,
    playback,
    rigid,
)
from mr360uw.composite.receiver.pattern import PlatePattern
from mr360uw.composite.settings import DrawSettings, LampSettings, ObjectSettings, SurfaceSettings
from mr360uw.errors import MeshError, ParameterError
from mr360uw.medium.lookup import DEPTH_SIZE, lengths
from mr360uw.medium.medium import DEFAULT_BANDS, Medium
from mr360uw.medium.spectra import DEFAULT_ILLUMINANT, illuminant
from mr360uw.medium.wavelengths import Bands, bands
from mr360uw.types import CausticStack, Environment, Floats, Lamp, Light, MediumTable, View

SHADOW_BIAS = 0.006
"""Offset of shadow rays as a fraction of the body's longest side: 1.5 texels of a shadow map 256 texels wide. Half as
large, bodies shade themselves in stripes; twice as large, contact shadows are visibly detached."""


@dataclass(frozen=True, slots=True, eq=False)
class PlacedObject(Parts):
    """A mesh in the world. world_from_object: (4, 4), rotation, uniform scale and translation."""

    mesh: Mesh
    world_from_object: Floats
    casts_shadow: bool = True
    visible: bool = True

    @property
    def scale(self) -> float:
        """Metres in the world for a metre of the mesh."""
        return scale_of(self.world_from_object[:3, :3])

    @property
    def bias_m(self) -> float:
        """Offset [m] of the body's shadow rays from its own surface."""
        return SHADOW_BIAS * float(np.max(self.mesh.extent_m)) * self.scale

    @property
    def triangles(self) -> Floats:
        """Its triangles (T, 3, 3) [m] in the world."""
        return self.to_world(self.mesh.positions)

    def to_world(self, points: Floats) -> Floats:
        """Return points (..., 3) of the object in the world."""
        placed = points.reshape(-1, 3) @ self.world_from_object[:3, :3].T + self.world_from_object[:3, 3]
        return placed.reshape(points.shape)


@dataclass(frozen=True, slots=True, eq=False)
class Receiver:
    """The surface of the plate that catches shadows: exactly one of the three shapes.

    plane_y: height [m] of a horizontal plane in the world. mesh: triangles (T, 3, 3) in the world. distance_m: (h, w)
    distances along the camera's rays, a frame of any size, 0, infinite or NaN where there is none. shadow, occlusion,
    caustics: whether it shows them. extent_m: distance from the camera beyond which it does not change.
    """

    plane_y: float | None = None
    mesh: Floats | None = None
    distance_m: Floats | None = None
    shadow: bool = True
    occlusion: bool = True
    caustics: bool = False
    extent_m: float = 30.0


@dataclass(frozen=True, slots=True, eq=False)
class BetweenSamples:
    """Place of an instant between two samples in time, for which the ambient light of bodies is solved.

    before, after: bodies, light in world axes with its sun if any, and water there. share: 0 at the sample before, 1 at
    that after.
    """

    before: Shot
    after: Shot
    share: float


@dataclass(frozen=True, slots=True, eq=False)
class Shot(Parts):
    """One instant of a frame: view, objects, light, water and sampling settings.

    environment: ambient light, in world axes. lights: sun (at most one) and lamps, in world axes. medium: None without
    water. caustics: of the sun. holdout: (H, W) in [0, 1], the fraction of the plate in front of the objects.
    holdout_distance_m: (H, W) [m]; objects beyond it are hidden. holdout_soft: whether the edges of what it hides are
    soft, over about a pixel. holdout_beside: another such distance (H, W) [m], and the fraction (H, W), 0 to 0.5, of
    pixels along edges that it holds for. pattern: the plate's own caustics on the receiver, which shadows remove; None
    leaves them.
    unseen: relative change of light that does not show in the plate's codes (`color.unseen_changes`), of all of them or
    of each block of the ground (R, C).
    between: two samples in time about this instant, between which the solved ambient light of bodies is interpolated
    where they move little; None solves it for this instant.
    """

    view: View
    objects: tuple[PlacedObject, ...]
    environment: Environment
    lights: tuple[Light, ...] = ()
    medium: MediumTable | None = None
    caustics: CausticStack | None = None
    receiver: Receiver | None = None
    holdout: Floats | None = None
    holdout_distance_m: Floats | None = None
    holdout_soft: bool = False
    holdout_beside: tuple[Floats, Floats] | None = None
    pattern: PlatePattern | None = None
    draw: DrawSettings = field(default_factory=DrawSettings)
    unseen: Floats | float = LEAST_CHANGE
    between: BetweenSamples | None = None

    @property
    def visible(self) -> tuple[PlacedObject, ...]:
        """The objects that the camera sees."""
        return tuple(filter(operator.attrgetter("visible"), self.objects))

    @property
    def casters(self) -> tuple[PlacedObject, ...]:
        """The objects that cast shadows."""
        return tuple(filter(operator.attrgetter("casts_shadow"), self.objects))

    @property
    def has_mattes(self) -> bool:
        """Whether parts of the plate may stand in front of the objects."""
        return self.holdout is not None or self.holdout_distance_m is not None

    @property
    def refractive_index(self) -> float:
        """Refractive index around the objects, relative to air: the water's, or 1 without water."""
        return 1.0 if self.medium is None else self.medium.refractive_index


WITHIN_M = 3.0
"""Greatest depth of an object's top at which "auto" shows it in the surface; images fade in over its last quarter."""
FAINTEST = 1e-3
"""Transmittance of the whole way, in its clearest channel, below which a body is not seen in the surface."""


def scale_of(linear: Floats) -> float:
    """Return the size of a linear map (3, 3): the cube root of its determinant, which is found without arrays."""
    (a, b, c), (d, e, f), (g, h, i) = linear.tolist()
    size: float = abs(a * (e * i - f * h) + b * (f * g - d * i) + c * (d * h - e * g)) ** (1.0 / 3.0)
    return size


def object_presence(shot: Shot, settings: SurfaceSettings) -> Floats:
    """Return for each visible object of a shot the fraction (n,) in which the surface shows it, by its top's depth."""
    depth = shot.view.surface_y_m - tops(shot)
    if settings.objects == "all":
        return np.ones(len(depth))
    return np.clip(4.0 * (1.0 - depth / WITHIN_M), 0.0, 1.0)


def tops(shot: Shot) -> Floats:
    """Return the height (n,) [m] in the world of the highest point of each visible object."""
    return np.array([o.to_world(o.mesh.hull.reshape(-1, 3))[:, 1].max() for o in shot.visible])


# --- Objects as they stand in a shot --------------------------------------------------------------------------------

# Objects of a scene: meshes of its `[[object]]` tables, set down on the receiver, and placed at a time for a shot; its
# lamps, from the `[[lamp]]` tables.


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
        hull = np.concatenate([mesh.hull.reshape(-1, 3) for mesh in self.meshes])
        reach = float(np.linalg.norm(hull, axis=-1).max()) * self.motion.scale
        if self.settings.attach == "camera":
            return camera_m + float(np.max(np.linalg.norm(self.motion.position, axis=-1) + reach))
        # Of a body that does not turn the top is known; one that does is taken as a ball about its origin
        if self.afloat is None and not np.ptp(self.motion.rotation, axis=0).any():
            reach = float(np.max(hull @ self.motion.rotation[0][1])) * self.motion.scale
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
def load_objects(all_settings: Sequence[ObjectSettings], reads: Cache | None = None) -> tuple[SceneObject, ...]:
    """Return objects with their meshes, textures and overrides; raise `MeshError`.

    Every file is read once, and objects that differ only in where they are share their meshes. reads: what was read
    before, for an object that changes.
    """
    OBJECTS.check("scene - its number of objects", len(all_settings), ParameterError)
    reads = Cache() if reads is None else reads
    several = 4 * len(all_settings)

    return tuple(reads.of(_scene_object, one, several, reads, keep=several) for one in all_settings)


def on_the_sea(placed: SceneObject, sea: Sea, surface_y_m: float) -> SceneObject:
    """Return an object afloat on a sea if it is attached to the surface, whose mean height in the world is given."""
    if placed.settings.attach != "surface":
        return placed
    motion = replace(placed.motion, position=placed.motion.position + np.array([0.0, surface_y_m, 0.0]))
    return replace(placed, motion=motion, afloat=(sea, surface_y_m))


def _scene_object(settings: ObjectSettings, several: int, reads: Cache) -> SceneObject:
    """Return an object. several: textures and looks that are kept."""
    sized = {} if settings.size_m is None else {"size_m": 1.0}
    rigs = reads.of(_rigs, settings.model_copy(update=_AT_REST | sized), several, reads, keep=several)
    played, notes = playback(settings, rigs[0], sequence=len(rigs) > 1)
    meshes = tuple(rig.resting for rig in rigs)
    if played is not None:
        rest = rigs[0].mesh
        meshes = (replace(rest, hull=played.bounds, notes=rest.notes + notes),)
    return SceneObject(settings, meshes, object_motion(settings, rigs[0].mesh), played)


def _rigs(look: ObjectSettings, several: int, reads: Cache) -> tuple[Rig, ...]:
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
    notes = [note for note in mesh.notes if settings.vertex_colors or DARKENING not in note]
    if base is not None and not np.any(mesh.uv):
        notes.append(f"{settings.mesh} - has no texture coordinates - all of it takes the corner of its texture")
    materials = []
    for material in mesh.materials:
        changed = material
        if base is not None:
            changed = replace(changed, base_map=base, base_color=(1.0, 1.0, 1.0, material.base_color[3]))
        materials.append(_factors(changed, settings))
    colors = mesh.colors
    if base is not None and settings.vertex_colors and np.any(colors[..., :3] != 1.0):
        notes.append(f"{settings.mesh} - vertex colours are left out beside the texture - remove that to see them")
    if base is not None or not settings.vertex_colors:
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


# --- lamps ----------------------------------------------------------------------------------------------------------

# Lamps of a scene: intensity from the `[[lamp]]` tables, and placement at a time for a shot.
#
#     I = flux/solid angle        intensity = I color/white
#
# with the flux in lumen, the solid angle that of the cone with its soft edge, and white the luminance [cd/m2] of the
# plate's white. A white card under a lamp then has its true brightness relative to the plate.
#
# Its colour, its flux, and how fast water takes it away:
#
#     S(T)   spectrum of a black body of temperature T (Planck 1901)        K = 683 lm/W  V S/S over 400 to 700 nm
#
# A lamp's own spectrum, not the daylight of its depth, decides what water leaves of it. V is the luminosity function of
# the CIE 1931 observer.


_EDGE = 0.3
"""Fraction of a cone's half angle over which its light fades. Twice as much: the beam has hardly a core."""
_DEFAULT_LUMEN = 2000.0
"""Flux of a typical diver's video light [lm], if a scene gives none."""


@dataclass(frozen=True, slots=True, eq=False)
class SceneLamp:
    """A lamp of a scene. intensity: (3,) along its axis, attenuation: (D, 3) or None, as in `types.Lamp`."""

    settings: LampSettings
    motion: Motion
    intensity: Floats
    attenuation: Floats | None

    @property
    def moves(self) -> bool:
        """Whether it moves in the world."""
        return self.motion.moves or self.settings.attach != "world"

    def at(self, time_s: float, view: View, objects: Sequence[PlacedObject]) -> Lamp:
        """Return the lamp at a time. view: of the camera. objects: of the scene, at the same time."""
        place = self.motion.at(time_s)
        if self.settings.attach == "camera":
            place = rigid(view.position, view.world_from_camera) @ place
        elif self.settings.attach != "world":
            place = objects[self.settings.attach].world_from_object @ place
        axis, of_lamp = -place[:3, 2] / np.linalg.norm(place[:3, 2]), self.settings
        return Lamp(
            place[:3, 3], axis, self.intensity, *cone_cosines(of_lamp), of_lamp.radius_m, self.attenuation,
            of_lamp.casts_shadow,
        )  # fmt: skip


def load_lamps(
    all_settings: Sequence[LampSettings], medium: Medium | None, white_cd_m2: float
) -> tuple[SceneLamp, ...]:
    """Return the lamps of a scene. medium: the water they shine in, or None. white_cd_m2: of the plate's white."""
    lamps = []
    for settings in all_settings:
        color = lamp_color(medium, settings.temperature_k) * np.asarray(settings.color)
        cos_core, cos_edge = cone_cosines(settings)
        # the mean of the smooth step over the cosine, and so over solid angle, is 1/2
        angle = 4.0 * np.pi if cos_edge <= -1.0 else 2.0 * np.pi * (1.0 - 0.5 * (cos_core + cos_edge))
        candela = (_DEFAULT_LUMEN if settings.lumen is None else settings.lumen) / float(angle)
        attenuation = None if medium is None else lamp_attenuation(medium, settings.temperature_k)
        lamps.append(SceneLamp(settings, lamp_motion(settings), color * candela / white_cd_m2, attenuation))
    return tuple(lamps)


def cone_cosines(settings: LampSettings) -> tuple[float, float]:
    """Return the cosines of the half angles of a lamp's core and edge; both -1 for a point light."""
    half = np.radians(0.5 * settings.cone_deg)
    if half >= np.pi:
        return -1.0, -1.0
    return float(np.cos(half * (1.0 - _EDGE))), float(np.cos(half))


Array = NDArray[np.float64]

_SECOND_RADIATION_NM_K = 1.438776877e7
"""hc/k (SI 2019)."""


def black_body(wavelength_nm: Array, temperature_k: float) -> Array:
    """Return the spectral radiance (...,) of a black body relative to that at 560 nm."""
    w = np.asarray(wavelength_nm, np.float64)

    def radiance(nm: Array) -> Array:
        return nm**-5.0 / np.expm1(_SECOND_RADIATION_NM_K / (nm * temperature_k))

    return radiance(w) / radiance(np.array(560.0))


def lamp_color(medium: Medium | None, temperature_k: float) -> Array:
    """Return the linear RGB (3,) of a lamp's light before the water, of luminance 1, as the medium's sensor sees it."""
    used, relative = _relative(medium, temperature_k)
    rgb = np.maximum(used.rgb(relative), 0.0)
    return rgb / luminance(rgb)


def lamp_attenuation(medium: Medium, temperature_k: float) -> Array:
    """Return the effective attenuation (T, 3) [1/m] of a lamp's light over paths, as `types.Lamp` says.

    In layers it is that of the camera's.
    """
    _, relative = _relative(medium, temperature_k)
    path = np.maximum(lengths(DEPTH_SIZE, medium.length_m), 1e-4 * medium.length_m)[:, None]
    log = np.log(relative)
    start = medium.bands.log_light(log)
    return np.asarray((start - medium.bands.log_light(log - medium.model.extinction * path)) / path)


def _relative(medium: Medium | None, temperature_k: float) -> tuple[Bands, Array]:
    """Return bands, and a lamp's spectrum at them relative to what their white is balanced for."""
    used = bands(DEFAULT_BANDS) if medium is None else medium.bands
    name = DEFAULT_ILLUMINANT if medium is None else medium.illuminant
    return used, black_body(used.wavelength_nm, temperature_k) / illuminant(name)(used.wavelength_nm)
