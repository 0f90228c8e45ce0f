# SPDX-License-Identifier: Apache-2.0
"""Depth planes and map size of a scene's caustics, chosen from the depths that its objects reach over the clip."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mr360uw.caustics.settings import CausticSettings, PlaneLadder, Span, map_size
from mr360uw.caustics.sun_disc import detail_footprint
from mr360uw.composite import Receiver, SceneObject, Shot
from mr360uw.composite.settings import NEAREST_M
from mr360uw.render.surroundings import CameraPath
from mr360uw.scene.model import Scene
from mr360uw.types import Floats

_WATER_LADDER = PlaneLadder(first=0.5, step=2.0)
"""Planes of the water itself, every second one of those around objects: rays cross several and average over them. The
first is 0.13 m deep."""
_WATER_SIZE = 256
"""Most pixels across the maps of these planes. Twice as many: no visible difference, in twice the time."""
_SHALLOWEST_M = 0.15
"""Depth [m] above which waves have not focused light yet: contrast grows linearly from the surface."""
_OVERHEAD = np.array([0.0, 1.0, 0.0])
"""Direction of the sun under which short waves blur least."""


@dataclass(frozen=True, slots=True)
class CausticDepths:
    """Depth planes of a scene's caustics, and its settings with the map size reduced to what the frame resolves.

    ground: depth range of a receiver that is no plane and shows caustics, or None. snow_m: distance from the camera up
    to which particles need planes; 0 beside objects, whose planes particles take.
    """

    ladder: PlaneLadder
    ground: Span | None
    settings: CausticSettings
    snow_m: float = 0.0

    @classmethod
    def of(
        cls,
        scene: Scene,
        objects: tuple[SceneObject, ...],
        receiver: Receiver | None,
        camera: CameraPath,
        frame_height: int,
        *,
        relief: bool = False,
    ) -> CausticDepths:
        """Return the planes and settings of a scene. receiver: None if its shape is a map, known in each frame alone.

        relief: whether it has the plate's relief, which is taken to rise from it to the height of the camera.
        """
        settings, surface = scene.caustics, scene.camera.depth_m
        cameras = _positions(camera)
        nearest = [_nearest(placed, cameras) for placed in objects]
        reaches, heights = [], []
        for placed in objects:
            levels = surface - _levels(placed, cameras)
            reaches.append((float(levels.min()), float(levels.max())))
            heights.append(float(np.ptp(levels, axis=1).max()))
        flat: list[float] = []
        levels_y: list[float] = []
        ground: Span | None = None
        if scene.receiver is not None and scene.receiver.caustics:
            nearest.append(0.0)
            if receiver is not None and receiver.plane_y is not None:
                flat.append(surface - receiver.plane_y)
                levels_y = [receiver.plane_y]
                nearest[-1] = 0.0 if relief else float(np.min(np.abs(cameras[:, 1] - receiver.plane_y)))
            elif receiver is not None and receiver.mesh is not None:
                levels_y = [float(receiver.mesh[..., 1].min()), float(receiver.mesh[..., 1].max())]
            levels_y += [float(cameras[:, 1].max())] if relief else []
            if len(levels_y) > 1:
                ground = surface - max(levels_y), surface - min(levels_y)
                reaches.append(ground)
                heights.append(ground[1] - ground[0])
        snow_m = scene.snow.range_m if scene.snow.amount > 0.0 and not objects else 0.0
        if snow_m > 0.0:
            depths = surface - cameras[:, 1]
            nearest.append(NEAREST_M)
            reaches.append((float(depths.min()) - snow_m, float(depths.max()) + snow_m))
            heights.append(2.0 * snow_m)
        shallowest = max(min([*(reach[0] for reach in reaches), *flat], default=0.0), 0.0)
        blurred = detail_footprint(_OVERHEAD, scene.water.refractive_index, scene.sea.blur_slope, shallowest)
        size = map_size(
            settings.size, scene.sea.tile_m, max(min(nearest, default=0.0), 0.0) * np.pi / frame_height,
            shallowest * settings.sun_half_angle_rad / scene.water.refractive_index,
            float(np.linalg.norm(blurred, -2)),
        )  # fmt: skip
        ladder = PlaneLadder.of_scene(reaches, heights, flat, settings.planes)
        return cls(ladder, ground, settings.model_copy(update={"size": size}), snow_m)

    def water_planes(self, shot: Shot, deepest_m: float) -> Floats:
        """Return the depths (n,) [m] of the planes of the water between the camera and a shot's objects, ascending.

        deepest_m: depth that they reach at least, then from the surface; 0: none.
        """
        camera = shot.view.surface_y_m - float(shot.view.position[1])
        depths = [camera, *((_SHALLOWEST_M, deepest_m) if deepest_m > 0.0 else ())]
        for placed in shot.objects:
            levels = shot.view.surface_y_m - placed.to_world(placed.mesh.hull)[..., 1]
            depths += [float(levels.min()), float(levels.max())]
        span = tuple(max(depth, _SHALLOWEST_M) for depth in (min(depths), max(depths)))
        return _WATER_LADDER.around([(span[0], span[1])])

    @property
    def of_water(self) -> CausticSettings:
        """The settings of the caustics in the water itself: rays average over more than a pixel of their maps."""
        return self.settings.model_copy(update={"size": min(self.settings.size, _WATER_SIZE)})

    def planes(self, shot: Shot) -> Floats:
        """Return the depths (n,) [m] of the planes that a shot needs, ascending."""
        spans = [] if self.ground is None else [self.ground]
        for placed in shot.objects:
            depth = shot.view.surface_y_m - placed.to_world(placed.mesh.hull)[..., 1]
            spans.append((float(depth.min()), float(depth.max())))
        if self.snow_m > 0.0:
            depth_m = shot.view.surface_y_m - float(shot.view.position[1])
            spans.append((max(depth_m - self.snow_m, 0.0), depth_m + self.snow_m))
        return self.ladder.around(spans)


def _positions(camera: CameraPath) -> Floats:
    """Return positions (n, 3) whose bounding box contains the camera at all times."""
    if camera.track is not None:
        return camera.track.position
    depths = np.array([camera.depth_m]) if camera.depth_keys is None else camera.depth_keys[:, 1]
    return np.stack([0.0 * depths, camera.depth_m - depths, 0.0 * depths], axis=-1)


def _levels(placed: SceneObject, cameras: Floats) -> Floats:
    """Return the heights (n, 2) [m] of the lowest and highest point of an object at each of its keys.

    Between keys it may reach beyond them. Then a frame has more planes; the result is still right.
    """
    hull = np.concatenate([mesh.hull.reshape(-1, 3) for mesh in placed.meshes])
    poses = [placed.motion.at(time_s) for time_s in placed.motion.time_s.tolist()]
    rows = [hull @ pose[1, :3] + pose[1, 3] for pose in poses]
    levels = np.array([(row.min(), row.max()) for row in rows])
    if placed.settings.attach == "camera":
        return np.concatenate([levels + cameras[:, 1].min(), levels + cameras[:, 1].max()])
    return levels


def _nearest(placed: SceneObject, cameras: Floats) -> float:
    """Return a lower bound [m] of an object's distance from the camera; it may be negative.

    Between keys, positions and scales stay between those of the keys.
    """
    motion = placed.motion
    reach = float(motion.scale.max()) * max(float(np.linalg.norm(m.center_m)) + m.radius_m for m in placed.meshes)
    if placed.settings.attach == "camera":
        cameras = np.zeros((1, 3))
    low, high = motion.position.min(axis=0), motion.position.max(axis=0)
    apart = np.maximum(low - cameras.max(axis=0), cameras.min(axis=0) - high)
    return float(np.linalg.norm(np.maximum(apart, 0.0))) - reach
