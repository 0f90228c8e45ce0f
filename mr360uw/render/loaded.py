# SPDX-License-Identifier: Apache-2.0
"""A scene resolved for frames of one size: files loaded, water solved, plan made, once before all frames.

A scene that is changed and loaded again by the same `Loader` shares all that the change leaves as it was.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from mr360uw.cache import Same
from mr360uw.composite import SceneObject, load_objects
from mr360uw.composite.scene_lamps import SceneLamp, load_lamps
from mr360uw.reading.files_read import files_read
from mr360uw.reading.kept_reads import KeptReads
from mr360uw.render.camera import CameraPath
from mr360uw.render.caustic_depths import CausticDepths
from mr360uw.render.mattes import Mattes, ReceiverClip
from mr360uw.render.placement import placement_notes
from mr360uw.render.plan import ObjectFacts, Plan, make_plan
from mr360uw.render.surroundings import Surroundings, load_surroundings
from mr360uw.scene.model import Scene
from mr360uw.types import View


@dataclass(frozen=True, slots=True, eq=False)
class Loaded:
    """A scene resolved for frames of width x height [pixels].

    notes: warnings about its files and the placement of its objects. object_files: that its objects were read from,
    with the textures and buffers that these name. other_files: that all else was read from, as far as loaders note it.
    """

    scene: Scene
    width: int
    height: int
    surroundings: Surroundings
    objects: tuple[SceneObject, ...]
    lamps: tuple[SceneLamp, ...]
    receiver: ReceiverClip | None
    mattes: Mattes
    caustic_depths: CausticDepths
    plan: Plan
    notes: tuple[str, ...]
    object_files: tuple[Path, ...]
    other_files: tuple[Path, ...]

    def view(self, time_s: float) -> View:
        """Return the camera's view at a time."""
        position, rotation = self.surroundings.camera.at(time_s)
        return View(self.width, self.height, position, rotation, self.scene.camera.depth_m)

    @property
    def moves(self) -> bool:
        """Whether anything changes within a frame's exposure."""
        return (
            self.surroundings.camera.moves
            or any(o.moves for o in self.objects)
            or any(lamp.moves for lamp in self.lamps)
        )

    def check(self, stop: int) -> None:
        """Raise `VideoError` where a matte or a distance map ends before the plate's frame `stop`."""
        self.mattes.check(stop)
        if self.receiver is not None:
            self.receiver.check(stop)


class Loader:
    """Loads scenes for frames of width x height [pixels]; parts that a change leaves as they were are kept.

    clip: whether the plate has several frames, for a first pass. A part depends on its own settings and files alone, so
    that what was loaded before changes no result. kept: counts what was made; loaders of other sizes may share it.
    """

    def __init__(self, width: int, height: int, *, clip: bool = True, kept: KeptReads | None = None) -> None:
        self._size, self._clip = (width, height), clip
        self.kept = KeptReads() if kept is None else kept

    def load(self, scene: Scene) -> Loaded:
        """Return a scene loaded; raise `SceneError`, `MeshError`, `VideoError` or `ParameterError`."""
        kept, (width, height) = self.kept, self._size
        with files_read() as object_files:
            objects = load_objects(scene.objects, kept)
        with files_read() as other_files:
            receiver = kept.get("receiver", (scene.receiver, self._size), lambda: self._receiver(scene))
            surroundings = load_surroundings(scene, kept)
        medium, camera = surroundings.medium, surroundings.camera
        still = receiver if scene.receiver is not None and scene.receiver.kind != "distance" else None
        ground = still.at(0) if still is not None else None
        facts = tuple(_facts(placed, camera) for placed in objects)
        found = dict.fromkeys(note for placed in objects for note in placed.notes)
        of_lamps = scene.lamps, Same(medium), scene.light.white_cd_m2
        return Loaded(
            scene=scene,
            width=width,
            height=height,
            surroundings=surroundings,
            objects=objects,
            lamps=kept.get("lamps", of_lamps, lambda: load_lamps(scene.lamps, medium, scene.light.white_cd_m2)),
            receiver=receiver,
            mattes=kept.get("mattes", (scene.holdouts, self._size), lambda: Mattes(scene, width, height)),
            caustic_depths=CausticDepths.of(scene, objects, ground, camera, height),
            plan=make_plan(scene, facts, None if medium is None else medium.unit_table, clip=self._clip),
            notes=(*found, *placement_notes(scene, objects, camera, height)),
            object_files=tuple(object_files),
            other_files=tuple(other_files),
        )

    def _receiver(self, scene: Scene) -> ReceiverClip | None:
        return None if scene.receiver is None else ReceiverClip(scene.receiver, *self._size)


def load(scene: Scene, width: int, height: int, *, clip: bool = True) -> Loaded:
    """Return one scene loaded by a `Loader`."""
    return Loader(width, height, clip=clip).load(scene)


def _facts(placed: SceneObject, camera: CameraPath) -> ObjectFacts:
    depth_m = camera.depth_m - placed.highest_m(camera.highest_m)
    return ObjectFacts(depth_m, any(mesh.glossy for mesh in placed.meshes), placed.moves)
