# SPDX-License-Identifier: Apache-2.0
"""Export of a scene's sea as tileable, looping maps for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from mr360uw.caustics import export_tiles, refract_to_air
from mr360uw.errors import SceneError
from mr360uw.progress import Progress
from mr360uw.render.first_pass import first_pass
from mr360uw.render.surroundings import load_surroundings
from mr360uw.scene.inputs import open_plate
from mr360uw.scene.keyed_water import scene_at
from mr360uw.scene.model import Scene
from mr360uw.scene.toml_model import dotted


def export_caustics(
    scene: Scene,
    folder: str | Path,
    *,
    frames: int = 48,
    loop_s: float = 8.0,
    depth_m: float | None = None,
    image_format: Literal["png", "exr"] = "png",
    overwrite: bool = False,
    progress: Progress | None = None,
) -> tuple[Path, ...]:
    """Write the scene's sea as tileable, looping caustic, height and normal maps; return their paths.

    The sun is the scene's: given, or found in the plate. depth_m: of the plane the caustics fall on, below the mean
    surface; by default that of a receiver plane, else of the first object, else of the camera. Keyed parameters have
    their values of time 0. Raises `SceneError` where the plate shows no sun, or where the sea is keyed.
    """
    keyed = [key.parameter for key in scene.keys if dotted(key.parameter)[0] in ("sea", "caustics")]
    if keyed:
        problem = f"keys - a sea that changes does not repeat, as tiles do (got {', '.join(keyed)}) - remove these keys"
        raise SceneError(str(scene.plate.path), [problem])
    scene = scene_at(scene, 0.0)
    with open_plate(scene) as video:
        surroundings, light = load_surroundings(scene), scene.light
        tracked = light.sun == "detect" and not video.is_still and (light.smooth or light.track is not None)
        track = first_pass(surroundings, video, measures=["sun"] if tracked else []).sun
        sun = track.at(0) if track is not None else surroundings.light.sun(next(iter(video.frames(0, 1))).pixels, 0.0)
    if sun is None or sun.direction[1] <= 0.0:
        problem = 'no sun is found in the plate - set light.sun = "given" and its azimuth and elevation'
        raise SceneError(str(scene.plate.path), [problem])
    if depth_m is None:
        heights = [0.0, *(o.place_m[1] for o in scene.objects[:1])]
        if scene.receiver is not None and scene.receiver.kind == "plane":
            heights.append(scene.receiver.height_m)
        depth_m = max(scene.camera.depth_m - heights[-1], 0.0)
    return export_tiles(
        scene.sea,
        refract_to_air(sun.direction, scene.water.refractive_index),
        depth_m,
        folder,
        frames,
        loop_s,
        scene.caustics,
        image_format,
        refractive_index=scene.water.refractive_index,
        overwrite=overwrite,
        progress=progress,
    )
