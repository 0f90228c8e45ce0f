# SPDX-License-Identifier: Apache-2.0
"""Bodies under the waves laid into pictures or a video that a real camera took from the air.

The scene says where the camera was, what its lens is, and what sea, water, sky and sun were there. The waves of the
scene move the bodies' images; they are as steep as the real ones, not the same. The plate gives its own size.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.over import over_tile
from mr360uw.from_above.aerial_bodies import brightened
from mr360uw.from_above.aerial_picture import LoadedAerial
from mr360uw.from_above.settings import AerialScene
from mr360uw.progress import Progress
from mr360uw.types import Floats
from mr360uw.video import VideoFrame, VideoReader, create_video, open_video

Array = NDArray[np.float64]

_MATCH_COLUMNS = 96
"""Columns of the picture of the scene's sea that is compared with the plate: medians are the same with twice as many
within 1 %."""


def open_aerial_plate(scene: AerialScene) -> VideoReader:
    """Return the plate of a scene that has one; raise `VideoError` where it cannot be read."""
    assert scene.plate is not None
    around = scene.camera.projection == "equirectangular"
    return open_video(scene.plate.path, scene.plate.transfer, equirectangular=around)


def plate_gain(loaded: LoadedAerial, plate_linear: Floats) -> Array:
    """Return the factor (3,) on the scene's light that gives its own picture of the sea the plate's median colour."""
    height, width = plate_linear.shape[:2]
    columns = min(_MATCH_COLUMNS, width)
    bare = replace(loaded, bodies=None)
    sea = bare.picture(0.0, (columns, max(round(columns * height / width), 1))).image_linear
    ours, plate = (np.median(image.reshape(-1, 3), axis=0) for image in (sea, plate_linear))
    return np.asarray(plate / np.maximum(ours, 1e-9), np.float64)


def frames_with_bodies(scene: AerialScene, plate: VideoReader, start: int, stop: int) -> Iterator[VideoFrame]:
    """Yield frames [start, stop) of a plate with the scene's bodies; what they do not touch keeps its codes."""
    assert scene.plate is not None
    loaded, size = LoadedAerial.of(scene), (plate.width, plate.height)
    gain = np.ones(3)
    if scene.plate.match:
        gain = plate_gain(loaded, next(iter(plate.frames(0, 1))).image_linear)
    for frame in plate.frames(start, stop):
        layer = brightened(loaded.layer(frame.time_s, size), gain)
        yield frame.over(layer, over_tile, scene.plate.grain)


def write_onto_plate(
    scene: AerialScene, path: Path, frames: tuple[int, int | None], *, overwrite: bool, progress: Progress | None
) -> int:
    """Write a plate with bodies and return the number of frames; see `aerial_film`."""
    with open_aerial_plate(scene) as plate:
        start, stop = plate.check_range(*frames)
        with create_video(path, plate, scene.output, overwrite=overwrite) as writer:
            for frame in frames_with_bodies(scene, plate, start, stop):
                writer.write(frame)
                if progress is not None:
                    progress(frame.index - start + 1, stop - start)
    return stop - start
