# SPDX-License-Identifier: Apache-2.0
"""Opens the plate of a scene, and protects the scene's input files from being overwritten."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from mr360uw.errors import VideoError
from mr360uw.parameters import Parameters
from mr360uw.scene.model import Scene, files_of
from mr360uw.video import VideoReader, open_video
from mr360uw.video.read.images import is_pattern, matching_files
from mr360uw.video.read.scaled import scaled


def open_plate(scene: Scene) -> VideoReader:
    """Return the scene's plate, opened as its table says; raise `VideoError`."""
    plate = scene.plate
    video = open_video(
        plate.path, transfer=plate.transfer, eye=plate.eye, frame_rate=plate.frame_rate, damaged=plate.damaged,
        layout=plate.layout,
    )  # fmt: skip
    return scaled(video, plate.scale)


def keep_inputs(scene: Parameters, *outputs: Path) -> None:
    """Raise `VideoError` where an output, a file or a numbered pattern, would replace a file that the scene reads."""
    inputs = {file.resolve(): file for path in files_of(scene) for file in input_files(path)}
    for output in outputs:
        hit = next((file for file in input_files(output) if file.resolve() in inputs), None)
        if hit is not None:
            raise VideoError(f"{output} - would replace {hit}, which the scene reads - choose another name")


def input_files(path: Path) -> Iterator[Path]:
    """Yield the files that a path, a numbered pattern or a wildcard stands for."""
    if is_pattern(path):
        yield from (file for _, file in matching_files(path))
    elif "*" in path.name:
        yield from path.parent.glob(path.name)
    else:
        yield path
