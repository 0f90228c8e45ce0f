# SPDX-License-Identifier: Apache-2.0
"""A scene resolved for frames of one size: files loaded, water solved, plan made, objects' places checked, once before
all frames.

A scene that is changed and loaded again by the same `Loader` shares all that the change leaves as it was. So does a
scene with keys, from one instant to the next.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from mr360uw.base.cache import Cache
from mr360uw.base.constants import PI
from mr360uw.base.input_files import files_read
from mr360uw.composite import PlacedObject, SceneObject, load_objects
from mr360uw.composite.shot import Receiver, SceneLamp, load_lamps, on_the_floor, on_the_sea
from mr360uw.errors import ParameterError, SceneError
from mr360uw.render.mattes import Mattes, ReceiverClip
from mr360uw.render.plan import CausticDepths, ObjectFacts, Plan, joined_plan, make_plan
from mr360uw.render.surroundings import (
    CameraPath,
    Surroundings,
    camera_path,
    floor_depth_m,
    load_surroundings,
    pose_notes,
)
from mr360uw.scene.key_targets import KeyedParameter, key_times
from mr360uw.scene.model import Scene
from mr360uw.scene.resolved import WaterBetween, scene_at, water_between
from mr360uw.scene.toml_model import dotted
from mr360uw.types import Floats, Lamp, View

if TYPE_CHECKING:
    from mr360uw.depth.occlusion import PlateDepth

T = TypeVar("T")
Objects = tuple[SceneObject, ...]
Keys = tuple[KeyedParameter, ...]
_MOVING = ("object", "lamp", "receiver")
"""Tables whose keys are followed within a frame's exposure."""


@dataclass(frozen=True, slots=True, eq=False)
class Loaded:
    """A scene resolved for frames of width x height [pixels].

    notes: warnings about its files and the placement of its objects. object_files: that its objects were read from,
    with the textures and buffers that these name. other_files: that all else was read from, as far as loaders note it.
    Where the scene has keys, its values are those of time 0, and its plan and notes those of all keys; `at` has the
    values of other times.
    """

    scene: Scene
    width: int
    height: int
    surroundings: Surroundings
    objects: Objects
    lamps: tuple[SceneLamp, ...]
    receiver: ReceiverClip | None
    mattes: Mattes
    plate_depth: PlateDepth | None
    caustic_depths: CausticDepths
    plan: Plan
    notes: tuple[str, ...]
    object_files: tuple[Path, ...]
    other_files: tuple[Path, ...]
    _loader: Loader

    def at(self, time_s: float, frame: Loaded | None = None) -> Loaded:
        """Return the scene loaded for an instant [s], with the plan of all: itself where nothing is keyed.

        frame: that of the frame whose exposure the instant is part of; its light and its water are kept.
        """
        return self._loader.at(self, time_s, frame) if self.scene.keys else self

    def surroundings_at(self, time_s: float) -> Surroundings:
        """Return the surroundings at an instant [s]."""
        return self.at(time_s).surroundings

    def view(self, time_s: float) -> View:
        """Return the camera's view at a time."""
        position, rotation = self.surroundings.camera.at(time_s)
        return View(self.width, self.height, position, rotation, self.scene.camera.depth_m)

    def receiver_at(self, index: int, time_s: float, eye: int = 0, eye_m: float = 0.0) -> Receiver | None:
        """Return the receiver in a frame's picture, with the relief that `plate.depth` is sure of; None without one.

        eye: 1 for the right one of two, else 0. eye_m: how far [m] the eye is to the right of the middle.
        """
        if self.receiver is None:
            return None
        plain = self.receiver.at(index, eye)
        if self.plate_depth is None or plain.distance_m is not None:  # a distance map of its own
            return plain
        return self.plate_depth.receiver_at(index, plain, replace(self.view(time_s), eye_m=eye_m), eye)

    @property
    def moves(self) -> bool:
        """Whether anything changes within a frame's exposure."""
        return (
            any(dotted(key.parameter)[0] in _MOVING for key in self.scene.keys)
            or self.surroundings.camera.moves
            or any(o.moves for o in self.objects)
            or any(lamp.moves for lamp in self.lamps)
        )

    def check(self, stop: int) -> None:
        """Raise `VideoError` where a matte, a distance map or the plate's depth ends before frame `stop`."""
        self.mattes.check(stop)
        if self.plate_depth is not None:
            self.plate_depth.check(stop)
        if self.receiver is not None:
            self.receiver.check(stop)


def load_plate_depth(
    scene: Scene, size: tuple[int, int], reads: Cache, frames: tuple[int, int | None] | None = None
) -> PlateDepth | None:
    """Return the distances of a scene's plate of width x height; None where it names none.

    frames: (stop, count) for all that `DepthClip.check_all` finds in the files, before a run.

    Raises `SceneError` where the scene works on both eyes and the maps are of one, `VideoError` where they do not fit.
    """
    plate = scene.plate
    if plate.depth is None:
        return None
    from mr360uw.depth.occlusion import PlateDepth  # whose kernels most scenes have no use for

    depth = reads.of(PlateDepth, plate.depth, plate.depth_kind, plate.depth_scale, plate.eye == "right", size)
    if frames is None:
        depth.check(0)
    else:
        depth.check_all(*frames)
    if plate.eye == "both" and not depth.of_both_eyes:
        problem = (
            'plate.depth - is of one eye (got plate.eye = "both") - name one, or make maps of both with '
            "mr360uw depth --eye both"
        )
        raise SceneError("scene", [problem])
    return depth


class Loader:
    """Loads scenes for frames of width x height [pixels]; parts that a change leaves as they were are kept.

    clip: whether the plate has several frames, for a first pass. A part depends on its own settings and files alone, so
    that what was loaded before changes no result. reads: counts what was made; loaders of other sizes may share it, in
    one thread. A loader of its own may be used by any thread, one at a time.
    """

    def __init__(self, width: int, height: int, *, clip: bool = True, reads: Cache | None = None) -> None:
        self._size, self._clip = (width, height), clip
        self.reads = Cache() if reads is None else reads
        self._one_thread = threading.Lock()

    def load(self, scene: Scene) -> Loaded:
        """Return a scene loaded; raise `SceneError`, `MeshError`, `VideoError` or `ParameterError`."""
        with self._one_thread:
            check_above_floor(scene, self.reads)
            first = self._load(scene_at(scene, 0.0), water_between(scene, 0.0), scene.keys)
            if not scene.keys:
                return first
            times = key_times(scene.keys)
            all_keys = [first, *(self._load(scene_at(scene, time_s), None, scene.keys) for time_s in times)]
        return replace(
            first,
            scene=first.scene.model_copy(update={"keys": scene.keys}),
            plan=joined_plan([loaded.plan for loaded in all_keys]),
            notes=_each_once(loaded.notes for loaded in all_keys),
            object_files=_each_once(loaded.object_files for loaded in all_keys),
            other_files=_each_once(loaded.other_files for loaded in all_keys),
        )

    def at(self, whole: Loaded, time_s: float, frame: Loaded | None = None) -> Loaded:
        """Return a loaded scene with keys for an instant, see `Loaded.at`."""
        with self._one_thread:
            between = water_between(whole.scene, time_s) if frame is None else None
            return self._load(scene_at(whole.scene, time_s), between, (), whole, frame)

    def _load(
        self,
        scene: Scene,
        between: WaterBetween | None,
        keys: Keys,
        whole: Loaded | None = None,
        frame: Loaded | None = None,
    ) -> Loaded:
        """Return a scene without keys loaded.

        keys: that it has at other times, for the plan. whole: that it is an instant of, with its plan and notes.
        """
        # Read the files, noting which belong to objects and which to all else
        reads, (width, height) = self.reads, self._size
        with files_read() as object_files:
            stops = scene.light.exposure
            trimmed = [one.model_copy(update={"exposure": one.exposure + stops}) for one in scene.objects]
            placed = load_objects(trimmed if stops else scene.objects, reads)
        with files_read() as other_files:
            receiver = None
            if scene.receiver is not None:
                receiver = reads.of(ReceiverClip, scene.receiver, width, height, scene.plate.eye)
            surroundings = load_surroundings(scene, reads, between) if frame is None else frame.surroundings
        medium, camera = surroundings.medium, surroundings.camera
        plate_depth = load_plate_depth(scene, (width, height), reads)
        # Put what floats on the sea and what stands on the floor
        still = receiver if scene.receiver is not None and scene.receiver.kind != "distance" else None
        ground = still.at(0) if still is not None else None
        afloat = (on_the_sea(one, scene.sea, scene.camera.depth_m) for one in placed)
        objects = tuple(on_the_floor(one, ground) for one in afloat)
        # Plan the frames; refuse what both eyes cannot have
        plan = self._plan(scene, objects, surroundings, keys) if whole is None else whole.plan
        if scene.plate.eye == "both" and plan.surface.runs:
            problem = (
                "surface - bodies that the water's surface cuts or mirrors are drawn from one point, not for both eyes "
                '(got plate.eye = "both") - place the objects deeper, or set surface.objects = "none"'
            )
            raise SceneError("scene", [problem])
        # Hold it all together
        lamps = reads.of(load_lamps, scene.lamps, medium, scene.light.white_cd_m2)
        mattes = reads.of(Mattes, scene.holdouts, width, height, scene.plate.eye)
        loaded = Loaded(
            scene=scene,
            width=width,
            height=height,
            surroundings=surroundings,
            objects=objects,
            lamps=lamps,
            receiver=receiver,
            mattes=mattes,
            plate_depth=plate_depth,
            caustic_depths=CausticDepths.of(scene, objects, ground, camera, height, relief=plate_depth is not None),
            plan=plan,
            notes=() if whole is None else whole.notes,
            object_files=tuple(object_files),
            other_files=tuple(other_files),
            _loader=self,
        )
        return loaded if whole is not None else replace(loaded, notes=_notes(loaded))

    def _plan(self, scene: Scene, objects: Objects, surroundings: Surroundings, keys: Keys) -> Plan:
        medium, camera = surroundings.medium, surroundings.camera
        keyed = {tuple(dotted(key.parameter)[:2]) for key in keys}
        facts = tuple(
            ObjectFacts(
                camera.depth_m - placed.highest_m(camera.highest_m),
                any(mesh.glossy for mesh in placed.meshes),
                ("object", str(number)) in keyed or placed.moves,
            )
            for number, placed in enumerate(objects)
        )
        if medium is None:
            return make_plan(scene, facts, None, clip=self._clip)

        def share() -> float:
            from mr360uw.medium.shafts.shaft_scene import beam_share

            return beam_share(medium, camera.depth_m - camera.highest_m)

        return make_plan(scene, facts, medium.unit_table, share, clip=self._clip)


def check_above_floor(scene: Scene, reads: Cache) -> None:
    """Raise `ParameterError` where the camera is below a level floor at a key of either."""
    receiver = scene.receiver
    if receiver is None or receiver.kind != "plane":
        return
    camera = camera_path(scene, reads)
    times, depths = camera.instants, camera.depths
    floors = np.array([floor_depth_m(scene) or np.inf])
    if any(dotted(key.parameter)[0] == "receiver" for key in scene.keys):
        times = np.union1d(times, key_times(scene.keys))
        depths = np.array([camera.depth_at(float(time_s)) for time_s in times])
        floors = np.array([floor_depth_m(scene_at(scene, float(time_s))) or np.inf for time_s in times])
    below = np.flatnonzero(depths >= floors)
    if len(below):
        at, floor_m = below[0], np.broadcast_to(floors, depths.shape)[below[0]]
        raise ParameterError(
            f"camera.{'depth_keys' if scene.camera.track is None else 'track'} - goes below the floor at {times[at]:g} "
            f"s (got {depths[at]:.2f} m deep, and the floor at {floor_m:.2f} m by receiver.height_m) - set "
            f"receiver.height_m below {scene.camera.depth_m - depths.max():.2f}, or where the floor slopes take a "
            "receiver of kind mesh or distance, or correct the depths"
        )


def load(scene: Scene, width: int, height: int, *, clip: bool = True) -> Loaded:
    """Return one scene loaded by a `Loader`."""
    return Loader(width, height, clip=clip).load(scene)


def _notes(loaded: Loaded) -> tuple[str, ...]:
    """Return the warnings about a scene's files and what looks odd about where its objects, lamps and floor are."""
    found = dict.fromkeys(note for placed in loaded.objects for note in placed.notes)
    of_depth = () if loaded.plate_depth is None else (*loaded.plate_depth.notes, *_floor_notes(loaded))
    of_lamps, snow = _lamp_notes(loaded), _snow_notes(loaded.scene, loaded.height)
    placed = (*found, *pose_notes(loaded.scene), *_placement_notes(loaded))
    return (*placed, *of_lamps, *snow, *of_depth, *loaded.mattes.notes)


_FLOOR_OFF = 0.15
"""How far, as a fraction, a level floor may be from what the plate's depth shows below the camera without a word."""


def _floor_notes(loaded: Loaded) -> tuple[str, ...]:
    """Return a line where a level floor is far above or below the ground that the first frame's distances show."""
    receiver, depth = loaded.scene.receiver, loaded.plate_depth
    if depth is None or receiver is None or receiver.kind != "plane":
        return ()
    below_m, height_m = depth.ground_below(0, _camera_at_start(loaded)), loaded.view(0.0).position[1]
    if below_m is None or abs(height_m - receiver.height_m - below_m) < _FLOOR_OFF * below_m:
        return ()
    return (
        f"receiver - is not where plate.depth shows the ground (got {receiver.height_m:.3g} m, and the ground about "
        f"{height_m - below_m:.3g} m) - set receiver.height_m, or plate.depth_scale",
    )


def _camera_at_start(loaded: Loaded) -> View:
    """Return the camera's view at time 0, of frames of any size."""
    return replace(loaded.view(0.0), width=2, height=1)


_LEAST_LIT = 1e-3
"""Light of a white card over the plate's white below which a lamp shows nothing: a quarter of a code of 8 bits."""
_CLOSEST_M = 0.05
"""Least distance [m] at which a lamp's light is looked at."""


def _lamp_notes(loaded: Loaded) -> tuple[str, ...]:
    """Return a line for every lamp whose light reaches no object and no floor: too weak, too far, or turned away.

    By the brightest light that bounding spheres and a level floor may get at time 0, without shadows. Lamps and scenes
    that move, and floors of other shapes, are not judged.
    """
    scene, lamps, camera = loaded.scene, loaded.lamps, loaded.surroundings.camera
    receiver = scene.receiver
    moving = camera.moves or any(lamp.motion.moves for lamp in lamps) or any(one.moves for one in loaded.objects)
    if not lamps or scene.keys or moving or (receiver is not None and receiver.kind != "plane"):
        return ()
    view = _camera_at_start(loaded)
    placed = [one.at(0.0, 0, view.position, view.world_from_camera) for one in loaded.objects]
    spheres = [(one.to_world(one.mesh.center_m), one.mesh.radius_m * one.scale) for one in placed]
    notes = []
    for number, lamp in enumerate(one.at(0.0, view, placed) for one in lamps):
        lit = [_brightest(lamp, middle - lamp.position, radius) for middle, radius in spheres]
        if receiver is not None:
            under = np.array([0.0, receiver.height_m - lamp.position[1], 0.0])
            lit.append(_brightest(lamp, under, 0.0, level=True))
        if max(lit, default=0.0) < _LEAST_LIT:
            notes.append(
                f"lamp[{number}] - lights no object and no floor (got {max(lit, default=0.0):.1g} of the plate's white "
                "on a white card) - move or turn it, or raise its lumen"
            )
    return tuple(notes)


def _brightest(lamp: Lamp, towards: Floats, radius_m: float, *, level: bool = False) -> float:
    """Return the most light, over white, that a white card gets in a sphere about a place [m] from a lamp.

    level: on the level plane through the place, which lies straight over or under the lamp.
    """
    far = float(np.linalg.norm(towards))
    nearest = max(far - radius_m, _CLOSEST_M)
    angle = math.acos(np.clip(np.dot(towards, lamp.axis) / max(far, 1e-9), -1.0, 1.0))
    beside = angle - math.acos(lamp.cos_edge) if lamp.cos_edge > -1.0 else 0.0
    if level:
        nearest = nearest / math.cos(beside) if 0.0 < beside < 0.5 * PI else nearest
        missed = beside >= 0.5 * PI
    else:
        missed = far > radius_m and beside > math.asin(min(radius_m / far, 1.0))
    if missed:
        return 0.0
    fall = 0.0 if lamp.attenuation is None else np.min(lamp.attenuation, axis=0)
    return float(np.max(lamp.intensity * np.exp(-fall * nearest)) / nearest**2 / PI)


def _snow_notes(scene: Scene, height: int) -> tuple[str, ...]:
    water = scene.water.water(scene.camera.depth_m) if scene.snow.amount > 0.0 else None
    if water is None:
        return ()
    from mr360uw.composite.snow_particles import note_on

    return tuple(filter(None, [note_on(scene.snow, water, height)]))


def _each_once(rows: Iterable[tuple[T, ...]]) -> tuple[T, ...]:
    return tuple(dict.fromkeys(one for row in rows for one in row))


_INSTANTS = 64
"""Most times at which an object is checked."""


def _placement_notes(loaded: Loaded) -> tuple[str, ...]:
    """Return a line for every object that is above the water, around the camera, or smaller than a pixel.

    Checked at the keys of the object and of the camera.
    """
    scene, camera, reads = loaded.scene, loaded.surroundings.camera, loaded._loader.reads
    under_m = scene.camera.depth_m if scene.water.type != "none" else None
    return tuple(
        f"object[{number}] {placed.settings.mesh.name} - {note}"
        for number, placed in enumerate(loaded.objects)
        for note in reads.of(_notes_on, placed, camera, under_m, loaded.height, keep=2 * len(loaded.objects))
    )


def _notes_on(placed: SceneObject, camera: CameraPath, under_m: float | None, height: int) -> tuple[str, ...]:
    """Return what is odd about where an object is. under_m: height of the water's surface, None where there is none."""
    # Where it is; the hull of one that plays holds all of its poses
    times, notes = _times(placed, camera), list[str]()
    poses, resting = [camera.at(time) for time in times], replace(placed, playback=None)
    views = [resting.at(time, 0, *pose) for time, pose in zip(times, poses, strict=True)]
    hull = resting.meshes[0].hull.reshape(-1, 3)
    lowest = min(float(view.to_world(view.mesh.hull.reshape(-1, 3))[:, 1].min()) for view in views)
    if under_m is not None and lowest > under_m:
        notes.append(
            f"is wholly above the water's surface (got {lowest - under_m:.2f} m at the least) - lower its position_m, "
            "or set camera.depth_m to the camera's true depth"
        )
    # Only where the camera may be inside, it is posed
    inside = []
    for time, (eye, turned), view in zip(times, poses, views, strict=True):
        if placed.playback is None or _is_within(eye, view, hull.min(axis=0), hull.max(axis=0)):
            then = placed.at(time, 0, eye, turned)
            half = 0.5 * then.mesh.extent_m
            if _is_within(eye, then, then.mesh.center_m - half, then.mesh.center_m + half):
                inside.append(time)
    if inside and placed.settings.visible:
        notes.append(
            f"the camera is within its bounds (got time {inside[0]:.2f} s) - if that is not meant, move it by "
            "position_m, or set its size_m or scale"
        )
    pixels = [_pixels(eye, view, height) for (eye, _), view in zip(poses, views, strict=True)]
    if max(pixels) < 1.0 and placed.settings.visible:
        notes.append(f"is smaller than a pixel (got {max(pixels):.2g} at the most) - set its scale, or move it nearer")
    return tuple(notes)


def _times(placed: SceneObject, camera: CameraPath) -> Floats:
    """Return the times [s] at which the object or the camera has a key, thinned out where there are many, and some of
    the clip that the object plays.
    """
    times = np.unique(np.concatenate([np.zeros(1), placed.instants, camera.instants]))
    return times[np.unique(np.linspace(0, len(times) - 1, _INSTANTS).round().astype(int))]


def _is_within(eye: Floats, view: PlacedObject, low: Floats, high: Floats) -> bool:
    """Return whether a point of the world is in a box (low, high) in an object's axes."""
    local = np.linalg.solve(view.world_from_object, [*eye, 1.0])[:3]
    return bool(np.all((low <= local) & (local <= high)))


def _pixels(eye: Floats, view: PlacedObject, height: int) -> float:
    """Return the diameter of an object's bounding sphere in pixels."""
    distance = float(np.linalg.norm(view.to_world(view.mesh.center_m) - eye))
    return 2.0 * view.mesh.radius_m * view.scale / max(distance, 1e-9) * height / np.pi
