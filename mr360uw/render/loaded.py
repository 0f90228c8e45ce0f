# SPDX-License-Identifier: Apache-2.0
"""A scene resolved for frames of one size: files loaded, water solved, plan made, once before all frames."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from mr360uw.composite import SceneObject, load_objects
from mr360uw.composite.scene_lamps import SceneLamp, load_lamps
from mr360uw.reading.files_read import files_read
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


def load(scene: Scene, width: int, height: int, *, clip: bool = True) -> Loaded:
    """Return a scene loaded for frames of width x height.

    clip: whether the plate has several frames, for a first pass. Raises `SceneError`, `MeshError`, `VideoError` or
    `ParameterError`.
    """
    with files_read() as object_files:
        objects = load_objects(scene.objects)
    with files_read() as other_files:
        receiver = ReceiverClip(scene.receiver, width, height) if scene.receiver is not None else None
        surroundings = load_surroundings(scene)
    medium = surroundings.medium
    still = receiver if scene.receiver is not None and scene.receiver.kind != "distance" else None
    ground = still.at(0) if still is not None else None
    facts = tuple(_facts(placed, surroundings.camera) for placed in objects)
    found = dict.fromkeys(note for placed in objects for note in placed.notes)
    return Loaded(
        scene=scene,
        width=width,
        height=height,
        surroundings=surroundings,
        objects=objects,
        lamps=load_lamps(scene.lamps, medium, scene.light.white_cd_m2),
        receiver=receiver,
        mattes=Mattes(scene, width, height),
        caustic_depths=CausticDepths.of(scene, objects, ground, surroundings.camera, height),
        plan=make_plan(
            scene, facts, None if surroundings.medium is None else surroundings.medium.unit_table, clip=clip
        ),
        notes=(*found, *placement_notes(scene, objects, surroundings.camera, height)),
        object_files=tuple(object_files),
        other_files=tuple(other_files),
    )


def _facts(placed: SceneObject, camera: CameraPath) -> ObjectFacts:
    depth_m = camera.depth_m - placed.highest_m(camera.highest_m)
    return ObjectFacts(depth_m, any(mesh.glossy for mesh in placed.meshes), placed.moves)
