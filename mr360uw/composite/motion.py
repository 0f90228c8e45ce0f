# SPDX-License-Identifier: Apache-2.0
"""Motion: keys of position, rotation and scale over time, tracks of the camera, and meshes that move.

Rotations are (yaw, pitch, roll): roll first (right side down), then pitch (nose up), then yaw (nose to the right),
for a body that looks along -z with +y up. Between keys rotations take the shortest arc (slerp, Shoemake 1985);
positions and the logarithm of the scale are interpolated linearly or by a monotone cubic (Fritsch & Carlson 1980).
Before the first and after the last key everything is at rest.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.base.parameters import LATEST_S, checked
from mr360uw.base.sphere import yaw_matrix
from mr360uw.caustics.settings import Sea
from mr360uw.composite.mesh.material import MeshFile, Rigging
from mr360uw.composite.mesh.mesh import Mesh, Unit, mesh_of_file, object_from_file, proper_triangles, read_mesh_file
from mr360uw.composite.mesh.polygons import corner_normals, placed
from mr360uw.composite.mesh.skin import Animation
from mr360uw.composite.mesh.up_axis import Up
from mr360uw.composite.settings import Front, Interpolation, LampSettings, Loop, ObjectSettings
from mr360uw.errors import MeshError, ParameterError
from mr360uw.ibl.tilt import level_matrix
from mr360uw.medium.spectra import read_table
from mr360uw.types import Floats

_TO_NOSE: dict[Front, float] = {"-z": 0.0, "+z": 180.0, "+x": -90.0, "-x": 90.0}
"""Yaw [deg] that turns the front of a mesh to where noses are, -z."""
_QUATERNION_LENGTH = 0.01
"""Largest deviation of a quaternion's length from 1: files with three digits pass, exchanged columns do not."""


def rotation_matrix(yaw_pitch_roll_deg: Sequence[float]) -> Floats:
    """Return the (3, 3) rotation of angles [deg] as the module defines them."""
    yaw, pitch, roll = np.radians(yaw_pitch_roll_deg)
    return yaw_matrix(yaw) @ level_matrix(roll, pitch)


def rigid(position: ArrayLike, rotation: Floats, scale: float = 1.0) -> Floats:
    """Return the (4, 4) transform that scales, then rotates, then translates."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = scale * rotation, position
    return matrix


class ValuesOverTime:
    """Values (n, ...) at ascending times (n,) [s], one or more; before the first and after the last they stay.

    between: "linear"; "smooth", a monotone cubic (Fritsch & Carlson 1980); or "hold", the value before.
    """

    def __init__(
        self, time_s: ArrayLike, value: ArrayLike, between: Literal["linear", "smooth", "hold"] = "smooth"
    ) -> None:
        self.time_s, self.value = np.asarray(time_s, np.float64), np.asarray(value, np.float64)
        self._between = between

    def at(self, time_s: float) -> NDArray[np.float64]:
        """Return the value (...) at a time [s]."""
        t = min(max(time_s, self.time_s[0]), self.time_s[-1])
        if len(self.time_s) == 1 or self._between == "hold":
            return np.asarray(self.value[np.searchsorted(self.time_s, t, side="right") - 1])
        return self._curve(t)

    @cached_property
    def _curve(self) -> Callable[[float], NDArray[np.float64]]:
        from scipy.interpolate import PchipInterpolator, make_interp_spline

        if self._between == "smooth":
            return PchipInterpolator(self.time_s, self.value, axis=0)
        return make_interp_spline(self.time_s, self.value, k=1)


@dataclass(frozen=True, eq=False)
class Motion:
    """Keys over time (n,), ascending: position (n, 3) [m], rotation (n, 3, 3), scale (n,)."""

    time_s: Floats
    position: Floats
    rotation: Floats
    scale: Floats
    interpolation: Interpolation = "smooth"

    @property
    def moves(self) -> bool:
        """Whether position, rotation or scale differ between keys."""
        return any(np.ptp(a, axis=0).any() for a in (self.position, self.rotation, self.scale))

    def at(self, time_s: float) -> Floats:
        """Return the (4, 4) transform at a time; between equal keys turn and scale are theirs to the last bit."""
        if len(self.time_s) == 1:
            return rigid(self.position[0], self.rotation[0], float(self.scale[0]))
        t = float(np.clip(time_s, self.time_s[0], self.time_s[-1]))
        position, log_scale, turn = self._over_time
        k = max(int(np.searchsorted(self.time_s, t)), 1)
        turns, grows = np.any(self.rotation[k] != self.rotation[k - 1]), self.scale[k] != self.scale[k - 1]
        rotation = turn(t).as_matrix() if turns else self.rotation[k]
        return rigid(position.at(t), rotation, float(np.exp(log_scale.at(t)) if grows else self.scale[k]))

    @cached_property
    def _over_time(self) -> tuple[ValuesOverTime, ValuesOverTime, Any]:
        """Position, logarithm of the scale, and the function of a time that gives the rotation."""
        from scipy.spatial.transform import Rotation, Slerp

        position, scale = (
            ValuesOverTime(self.time_s, a, self.interpolation) for a in (self.position, np.log(self.scale))
        )
        return position, scale, Slerp(self.time_s, Rotation.from_matrix(self.rotation))


def lamp_motion(settings: LampSettings) -> Motion:
    """Return the motion of a lamp."""
    rows = [(key.time_s, key.position_m, key.rotation_deg) for key in settings.key] or [(0.0, None, None)]
    return Motion(
        np.array([time_s for time_s, _, _ in rows]),
        np.array([position or settings.position_m for _, position, _ in rows]),
        np.stack([rotation_matrix(rotation or settings.rotation_deg) for _, _, rotation in rows]),
        np.ones(len(rows)),
        settings.interpolation,
    )


def object_motion(settings: ObjectSettings, mesh: Mesh) -> Motion:
    """Return the motion of an object; mesh: its own, at rest. One that stands is at the height of its setting yet."""
    keys = settings.key
    poses = [_pose(settings.at_key(key), mesh) for key in keys] or [_pose(settings, mesh)]
    times = np.array([key.time_s for key in keys] or [0.0])
    position, rotation, scale = (np.array(values) for values in zip(*poses, strict=True))
    return Motion(times, position, rotation, scale, settings.interpolation)


def _pose(settings: ObjectSettings, mesh: Mesh) -> tuple[Floats, Floats, float]:
    """Return the position (3,), rotation (3, 3) and scale of an object of these settings."""
    place, scale = np.array(settings.place_m), settings.scale
    if settings.size_m is not None:
        scale = settings.size_m / float(np.max(mesh.extent_m))
    rotation = rotation_matrix(settings.rotation_deg)
    if settings.face is not None:
        azimuth = math.degrees(math.atan2(-place[0], place[2])) if settings.face == "camera" else settings.face
        rotation = (
            rotation_matrix((azimuth, 0.0, 0.0)) @ rotation @ rotation_matrix((_TO_NOSE[settings.front], 0.0, 0.0))
        )
    return place - scale * rotation @ mesh.center_m if settings.polar else place, rotation, scale


@checked
def read_camera_track(path: str | Path) -> Motion:
    """Return the camera's motion of a CSV file: time [s], x, y, z [m], and the quaternion qx, qy, qz, qw.

    The quaternion rotates the camera's axes (right, up, back) to the world's. The header names the columns
    time_s, x, y, z, qx, qy, qz, qw, in any order. Raises `ParameterError`.
    """
    from scipy.spatial.transform import Rotation

    path = Path(path)
    names = ("time_s", "x", "y", "z", "qx", "qy", "qz", "qw")
    table = read_table(path)
    missing = [name for name in names if name not in table]
    if missing:
        raise ParameterError(f"{path} - columns are missing (got no {', '.join(missing)}) - give {', '.join(names)}")
    columns = np.stack([table[name] for name in names], axis=-1)
    if not np.all(np.isfinite(columns)):
        raise ParameterError(f"{path} - has entries that are no numbers - correct the rows")
    if np.any(late := np.abs(columns[:, 0]) > LATEST_S):
        got = f"got {columns[late, 0][0]:g} s, at most {LATEST_S:g}"
        raise ParameterError(f"{path} time_s - is no time of a clip ({got}) - count from the clip's start")
    check_unit_quaternions(columns[:, 4:], str(path))
    times = columns[:, 0]
    if np.any(np.diff(times) <= 0.0):
        at = int(np.argmax(np.diff(times) <= 0.0))
        got = f"got {times[at]:g} then {times[at + 1]:g}"
        raise ParameterError(f"{path} time_s - must ascend ({got}) - sort the keys")
    rotation = Rotation.from_quat(columns[:, 4:]).as_matrix()
    return Motion(columns[:, 0], columns[:, 1:4], rotation, np.ones(len(columns)), "linear")


def check_unit_quaternions(quaternion: Floats, where: str) -> None:
    """Raise `ParameterError` unless quaternions (n, 4) have the length 1."""
    length = np.linalg.norm(quaternion, axis=-1)
    wrong = np.flatnonzero(~(np.abs(length - 1.0) < _QUATERNION_LENGTH))
    if len(wrong):
        raise ParameterError(
            f"{where} - quaternions must have the length 1 (got {length[wrong[0]]:.4g} in row {wrong[0] + 1}) - check "
            "that the columns are in their places, or export it again"
        )


_POINTS = 13
"""Points along each side of the footprint: waves of a sixth of its length are still averaged, not aliased."""
_LEAST_M = 0.05
"""Least length [m] of a footprint's side."""


def floating(sea: Sea, surface_y_m: float, calm: Floats, mesh: Mesh, time_s: float) -> Floats:
    """Return the transform (4, 4) at a time [s] of an object that has the transform `calm` on a level sea.

    The plane h + s.(x, z) that fits the surface best over the object's own length and width gives its heave h and tilt:
    waves that are shorter than the object do not move it. There is no inertia and no drift. surface_y_m: height of the
    mean surface in the world.
    """
    middle = calm[:3, :3] @ mesh.center_m + calm[:3, 3]
    sides = [_level(mesh.extent_m[axis] * calm[:3, axis], axis) for axis in (0, 2)]
    heave, slope = plane_of_waves(sea, middle[[0, 2]], np.array(sides), time_s)
    foot = np.array([middle[0], surface_y_m, middle[2]])
    turn = _upright_to(np.array([-slope[0], 1.0, -slope[1]]) / np.sqrt(1.0 + slope @ slope))
    pose = np.array(calm)
    pose[:3, :3] = turn @ calm[:3, :3]
    pose[:3, 3] = foot + [0.0, heave, 0.0] + turn @ (calm[:3, 3] - foot)
    return pose


def plane_of_waves(sea: Sea, middle: Floats, sides: Floats, time_s: float) -> tuple[float, Floats]:
    """Return the height [m] over the mean surface and the slopes (2,) over (x, z) of the plane that fits the waves.

    middle: (2,) of a parallelogram on the mean surface, where the height is taken; sides: (2, 2), [m] over (x, z).
    """
    place = (np.arange(_POINTS) + 0.5) / _POINTS - 0.5
    u, v = (k.ravel() for k in np.meshgrid(place, place))
    rest = middle + u[:, None] * sides[0] + v[:, None] * sides[1]
    point = sea.surface(rest[:, 0], rest[:, 1], time_s).position
    columns = np.stack([np.ones(len(u)), point[:, 0] - middle[0], point[:, 2] - middle[1]], axis=-1)
    height, *slope = np.linalg.lstsq(columns, point[:, 1], rcond=None)[0]
    return float(height), np.array(slope)


def _level(side: Floats, axis: int) -> Floats:
    """Return the horizontal part (2,) of a side of a body, lengthened to the least one."""
    flat = side[[0, 2]]
    length = float(np.linalg.norm(flat))
    if length >= _LEAST_M:
        return np.asarray(flat)
    return _LEAST_M * (flat / length if length > 0.0 else np.array([1.0, 0.0] if axis == 0 else [0.0, 1.0]))


def _upright_to(normal: Floats) -> Floats:
    """Return the least rotation (3, 3) that turns up, (0, 1, 0), to a unit normal with y > 0."""
    x, y, z = normal
    k = 1.0 / (1.0 + y)
    return np.array([[1.0 - k * x * x, x, -k * x * z], [-x, y, -z], [-k * x * z, z, 1.0 - k * z * z]])


# --- Meshes that move -----------------------------------------------------------------------------------------------

# Meshes that move: a mesh at rest, what moves it, and which clip of its file an object plays.
#
# A pose has the triangles, texture coordinates and materials of the mesh at rest. Its positions and normals are
# evaluated in float64; its hull is a 26-DOP of its vertices.


@dataclass(frozen=True, eq=False)
class Rig:
    """A mesh at rest and what moves it; the last few poses are kept, so that objects in step share their meshes.

    Its caches hold a copy of it, not itself: a reference circle would keep all poses until the garbage collector runs.

    mesh: at rest, but with scales of 0 as 1, because what is hidden at rest may show later.

    rigging: None where nothing moves; else its bodies are those of the mesh. faces: for each body (t, 3), the vertices
    of its triangles in the mesh's order. place: transform (4, 4) from the file's coordinates to the mesh's [m].
    """

    mesh: Mesh
    place: Floats
    rigging: Rigging | None = None
    faces: tuple[NDArray[np.int64], ...] = ()

    @property
    def resting(self) -> Mesh:
        """The mesh as it rests in the file, with what scales of 0 hide."""
        folded = self.rigging is not None and self.rigging.skeleton.folded
        return self.at(Animation("", ()), 0.0) if folded else self.mesh

    @functools.cached_property
    def at(self) -> Callable[[Animation, float], Mesh]:
        """Function that returns the mesh at a time of a clip [s], counted from the clip's own zero."""
        return functools.lru_cache(_KEPT_POSES)(functools.partial(pose, replace(self)))

    @functools.cached_property
    def clip(self) -> Callable[[int], Animation]:
        """Function that returns the animation of a number, see `Rigging.read_clip`."""
        assert self.rigging is not None
        return functools.cache(self.rigging.read_clip)

    @functools.cached_property
    def bounds(self) -> Callable[[Animation], Floats]:
        """Function that returns `clip_bounds`."""
        return functools.cache(functools.partial(clip_bounds, replace(self)))


def load_rig(
    path: Path,
    unit: Unit = "auto",
    outside: bool = False,
    smooth_deg: float | None = None,
    up: Up = "auto",
    place: Floats | None = None,
    part: str = "",
) -> Rig:
    """Return the mesh of a file and what moves it; arguments and errors are those of `load_mesh`.

    place: where the file's coordinates are in the object's, of a sequence whose first file told it.
    """
    file = _unfolded(read_mesh_file(path, outside=outside, smooth_deg=smooth_deg))
    place, notes = object_from_file(path, file, unit, up) if place is None else (place, ())
    mesh = mesh_of_file(path, file, place, unit, part)
    return _rig(file, replace(mesh, notes=mesh.notes + notes), place, part)


def _unfolded(file: MeshFile) -> MeshFile:
    """Return a file with its parts as if no node had a scale of 0 at rest."""
    if file.rigging is None or not file.rigging.skeleton.folded:
        return file
    pose_, parts = file.rigging.skeleton.unfolded(), []
    for part, body in zip(file.parts, file.rigging.bodies, strict=True):
        positions, normals, faces = body.at(pose_)
        parts.append(replace(part, positions=positions, normals=normals, faces=faces))
    return replace(file, parts=tuple(parts))


def _rig(file: MeshFile, mesh: Mesh, place: Floats, part: str) -> Rig:
    if file.rigging is None:
        return Rig(mesh, place)
    pairs = zip(file.parts, file.rigging.bodies, strict=True)
    kept = [(p, body) for p, body in pairs if part in p.name and len(p.faces)]
    corners = np.concatenate([placed(place, p.positions, None, p.faces)[0][p.faces] for p, _ in kept])
    proper = np.split(proper_triangles(corners), np.cumsum([len(p.faces) for p, _ in kept])[:-1])
    faces = tuple(p.faces[keep] for (p, _), keep in zip(kept, proper, strict=True))
    rigging = replace(file.rigging, bodies=tuple(body for _, body in kept))
    return Rig(mesh, place, rigging, faces)


def surfaces(rig: Rig, clip: Animation, time_s: float) -> list[tuple[Floats, Floats | None]]:
    """Return positions (V, 3) [m] and normals (V, 3), or None, of the vertices of each body at a time of a clip [s].

    A mirror turns normals round; the winding of the triangles stays that at rest.
    """
    assert rig.rigging is not None
    state = rig.rigging.skeleton.at(clip, time_s)
    return [placed(rig.place, *body.at(state))[:2] for body in rig.rigging.bodies]


def pose(rig: Rig, clip: Animation, time_s: float) -> Mesh:
    """Return the mesh at a time of a clip [s], counted from the clip's own zero."""
    found = surfaces(rig, clip, time_s)
    corners = [points.take(faces, axis=0) for (points, _), faces in zip(found, rig.faces, strict=True)]
    normals = [
        corner_normals(corner, normal, faces)
        for (_, normal), corner, faces in zip(found, corners, rig.faces, strict=True)
    ]
    points = np.concatenate([points for points, _ in found])
    return replace(
        rig.mesh,
        positions=np.concatenate(corners),
        normals=np.concatenate(normals),
        hull=slab_hull(slabs(points), points.mean(axis=0)),
        rest=rig.mesh,
    )


_KEPT_POSES = 8
_BOUND_INSTANTS = 49
"""Times of a clip at which its bounds are found, the first and the last among them. Twice as many halve the margin that
is left for what happens between them, and take twice the time to load."""
_NOTED_INSTANTS = 17


@dataclass(frozen=True, slots=True, eq=False)
class Playback:
    """A clip as an object plays it: at the video's time t it shows the clip's time start_s + speed t."""

    rig: Rig
    clip: Animation
    loop: Loop
    speed: float
    start_s: float

    @property
    def moves(self) -> bool:
        """Whether the pose changes with time."""
        return self.clip.duration_s > 0.0 and self.speed != 0.0

    @property
    def bounds(self) -> Floats:
        """Triangles (h, 3, 3) of a convex body that holds every pose of the clip."""
        return self.rig.bounds(self.clip)

    @property
    def instants(self) -> Floats:
        """Times (n,) of the video [s], from 0, that show all of the clip."""
        if not self.moves:
            return np.zeros(1)
        return np.linspace(0.0, (self.clip.duration_s + abs(self.start_s)) / abs(self.speed), _NOTED_INSTANTS)

    def at(self, time_s: float) -> Mesh:
        """Return the mesh at a time of the video [s]."""
        elapsed = looped(self.start_s + self.speed * time_s, self.clip.duration_s, self.loop)
        return self.rig.at(self.clip, self.clip.first_s + elapsed)


def looped(time_s: float, duration_s: float, loop: Loop) -> float:
    """Return the time in [0, duration_s] that a clip shows at any time, before 0 and after its end, too."""
    if duration_s <= 0.0:
        return 0.0
    if loop == "once":
        return min(max(time_s, 0.0), duration_s)
    if loop == "repeat":
        return time_s % duration_s
    return duration_s - abs(time_s % (2.0 * duration_s) - duration_s)


_SLAB_MARGIN = 1e-5
"""What a hull of slabs is larger by on every side, in terms of the extent: it keeps flat bodies from having no inside.
A hundredth of a pixel for a body that fills a frame of 1000 rows."""
SLAB_AXES = np.array([
    (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (1, -1, 0), (1, 0, 1), (1, 0, -1), (0, 1, 1), (0, 1, -1),
    (1, 1, 1), (1, 1, -1), (1, -1, 1), (1, -1, -1),
], np.float64)  # fmt: skip
"""Normals, not unit, of the pairs of planes about a pose: of faces, edges and corners of a cube."""


def slabs(points: Floats) -> Floats:
    """Return the least and the greatest coordinate (13, 2) of points (n, 3) along `SLAB_AXES`."""
    along = np.einsum("ak,vk->av", SLAB_AXES, points)
    return np.stack([along.min(axis=1), along.max(axis=1)], axis=-1)


def slab_hull(bounds: Floats, inside: Floats, more: float = 0.0) -> Floats:
    """Return the triangles (h, 3, 3) of the convex body between planes at `bounds` (13, 2), as `slabs` returns them.

    It holds all the points, and its bounding box is theirs but for `_SLAB_MARGIN`: a hull for poses, found in a
    millisecond (Klosowski et al. 1998, 26-DOP). inside: a point (3,) of their convex hull, such as their mean.
    more: what it is larger by on every side.
    """
    from scipy.spatial import ConvexHull, HalfspaceIntersection

    extent = float(np.max(bounds[:3, 1] - bounds[:3, 0]))
    margin = _SLAB_MARGIN * (extent if extent > 0.0 else 1.0)  # an animation may hide a body by the scale 0
    wider = (margin + more) * np.linalg.norm(SLAB_AXES, axis=-1, keepdims=True)
    planes = np.concatenate([
        np.append(SLAB_AXES, -bounds[:, 1:] - wider, axis=1), np.append(-SLAB_AXES, bounds[:, :1] - wider, axis=1)
    ])  # fmt: skip
    points = HalfspaceIntersection(planes, inside).intersections
    return np.asarray(points[ConvexHull(points).simplices])


def clip_bounds(rig: Rig, clip: Animation) -> Floats:
    """Return the triangles (h, 3, 3) of a convex body that holds the poses of a clip.

    It holds them at even instants. In between a vertex is taken to be within half the longest way that one goes from
    one instant to the next, of where it is at the nearer of them: true where it goes straight, or nearly so.
    """
    bounds, inside, way = [], np.zeros(3), 0.0
    before: Floats | None = None
    for time_s in clip.first_s + np.linspace(0.0, clip.duration_s, _BOUND_INSTANTS if clip.duration_s > 0.0 else 1):
        points = np.concatenate([points for points, _ in surfaces(rig, clip, float(time_s))])
        bounds.append(slabs(points))
        inside = points.mean(axis=0)
        way = way if before is None else max(way, float(np.max(np.linalg.norm(points - before, axis=-1))))
        before = points
    every = np.stack([np.min([b[:, 0] for b in bounds], axis=0), np.max([b[:, 1] for b in bounds], axis=0)], axis=-1)
    return slab_hull(every, inside, 0.5 * way)


def playback(settings: ObjectSettings, rig: Rig, *, sequence: bool) -> tuple[Playback | None, tuple[str, ...]]:
    """Return what an object plays, or None, and notes for the user.

    sequence: it has a mesh for every frame, which leaves nothing to play. Raises `MeshError` where the animation that
    the scene names is not there, or broken.
    """
    rigging = None if sequence else rig.rigging
    names = () if rigging is None else rigging.clips
    wanted = settings.animation
    number = _number(wanted, names)
    if number is None:
        if wanted in ("", "auto"):
            return None, ()
        there = ", ".join(repr(name) for name in names) if names else "none"
        why = "a sequence plays its meshes" if sequence else f"there are: {there}"
        raise MeshError(f"{settings.mesh} - no animation of that name or number (got {wanted!r}) - {why}")
    clip = rig.clip(number)
    notes: list[str] = []
    if wanted == "auto" and len(names) > 1:
        others = ", ".join(repr(name) for name in names)
        notes.append(f"{settings.mesh} - plays the first of its animations - set animation to choose of: {others}")
    if not clip.channels:
        notes.append(f"{settings.mesh} - its animation {clip.name!r} moves nothing that is drawn - it rests")
    return Playback(rig, clip, settings.loop, settings.speed, settings.start_s), tuple(notes)


def _number(wanted: Any, names: tuple[str, ...]) -> int | None:
    """Return the number of the animation that a scene asks for by name or number, None where there is none."""
    if wanted == "":
        return None
    if wanted in names:
        return names.index(wanted)
    number = 0 if wanted == "auto" else int(wanted) if str(wanted).isdecimal() else len(names)
    return number if number < len(names) else None
