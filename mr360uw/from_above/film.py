# SPDX-License-Identifier: Apache-2.0
"""Files of pictures from above: a still, numbered pictures, EXR files with parts, a video.

Bodies are laid into pictures or a video that a real camera took from the air where the scene names a plate. It says
where the camera was, what its lens is, and what sea, water, sky and sun were there. The waves of the scene move the
bodies' images; they are as steep as the real ones, not the same. The plate gives its own size.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from mr360uw.color import ColorSpec
from mr360uw.errors import OutputExistsError, ParameterError
from mr360uw.files import is_pattern, matching_files, numbered
from mr360uw.from_above.aerial_bodies import brightened
from mr360uw.from_above.aerial_picture import AerialPicture, LoadedAerial
from mr360uw.from_above.settings import AerialScene
from mr360uw.output_gate import check_outputs
from mr360uw.progress import Progress
from mr360uw.reading.input_files import FRAMES, files_read
from mr360uw.scene.model import files_of
from mr360uw.shapes import checked
from mr360uw.types import Array, Floats
from mr360uw.video import VideoFrame, create_video, open_video
from mr360uw.video.clip import Clip
from mr360uw.video.exr import Part, write_exr
from mr360uw.video.formats import PICTURE_SUFFIXES

_MATCH_COLUMNS = 96
"""Columns of the picture of the scene's sea that is compared with the plate: medians are the same with twice as many
within 1 %."""


def plate_gain(loaded: LoadedAerial, plate_linear: Floats) -> Array:
    """Return the factor (3,) on the scene's light that gives its own picture of the sea the plate's median colour."""
    height, width = plate_linear.shape[:2]
    columns = min(_MATCH_COLUMNS, width)
    bare = replace(loaded, bodies=None)
    sea = bare.picture(0.0, (columns, max(round(columns * height / width), 1))).image_linear
    ours, plate = (np.median(image.reshape(-1, 3), axis=0) for image in (sea, plate_linear))
    return np.asarray(plate / np.maximum(ours, 1e-9), np.float64)


def _write_onto_plate(
    scene: AerialScene, path: Path, frames: tuple[int, int | None], *, overwrite: bool, progress: Progress | None
) -> int:
    """Write a plate with bodies and return the number of frames; see `aerial_film`.

    What the bodies do not touch keeps its codes.
    """
    assert scene.plate is not None
    around = scene.camera.projection == "equirectangular"
    with open_video(scene.plate.path, scene.plate.transfer, equirectangular=around) as plate:
        start, stop = plate.numbered_range(*frames)
        with create_video(path, plate, scene.output, overwrite=overwrite) as writer:
            # Scale the scene's light to the plate's, then lay the bodies over each frame
            loaded, gain = LoadedAerial.of(scene), np.ones(3)
            if scene.plate.match:
                gain = plate_gain(loaded, next(iter(plate.frames(0, 1))).image_linear)
            for frame in plate.frames(start, stop):
                layer = brightened(loaded.layer(frame.time_s, (plate.width, plate.height)), gain)
                writer.write(frame.over(layer, scene.plate.grain))
                if progress is not None:
                    progress(frame.index - start + 1, stop - start)
    return stop - start


Write = Callable[[int, AerialPicture], None]
"""Takes the number of a frame and its picture."""


@dataclass(frozen=True, slots=True)
class AerialReport:
    """Files that were written. seconds: wall time."""

    out: Path
    frames: int
    seconds: float

    def __str__(self) -> str:
        count = f"{self.frames} frame" + "s" * (self.frames != 1)
        return f"wrote {self.out}: {count} in {self.seconds:.1f} s ({self.seconds / self.frames:.2f} s each)"


@checked
def aerial_film(
    scene: AerialScene,
    out: str | Path,
    *,
    frames: tuple[int, int | None] = (0, None),
    overwrite: bool = False,
    progress: Progress | None = None,
) -> AerialReport:
    """Write pictures of a scene and return a report.

    out: a picture (.png, .jpg, .exr ...: the first frame), a pattern of pictures (sea_%04d.exr) or a video (.mp4, .mov,
    .mkv, .webm). EXR files have the parts of `picture_parts`. frames: [start, stop); None: to the film's end. A scene
    with a plate puts its bodies into that, without parts.

    Each file appears when it is complete. Raises `ParameterError`, `VideoError` and `OutputExistsError`.
    """
    began = time.perf_counter()
    path, rate = Path(out), Fraction(scene.film.frame_rate).limit_denominator(1001)
    check_outputs([path], inputs=files_of(scene), overwrite=overwrite)
    if scene.plate is not None:
        done = _write_onto_plate(scene, path, frames, overwrite=overwrite, progress=progress)
        return AerialReport(path, done, time.perf_counter() - began)
    start, stop = _range(scene, path, frames, rate)
    with _output(scene, path, rate, overwrite) as write:
        with files_read() as read:
            loaded = LoadedAerial.of(scene)
        check_outputs([path], inputs=read, overwrite=True)  # textures and the like, which only meshes name
        for index in range(start, stop):
            write(index, loaded.picture(float(index / rate)))
            if progress is not None:
                progress(index - start + 1, stop - start)
    return AerialReport(path, stop - start, time.perf_counter() - began)


@checked
def picture_parts(picture: AerialPicture) -> dict[str, Part]:
    """Return the parts of an EXR file, float32: beauty, normal (N.X, N.Y, N.Z), floor, reflection, distance (Z), water
    (Z: length in the water), bodies (A: what they cover). See `AerialPicture`.
    """
    light = {"beauty": picture.image_linear, "floor": picture.floor_radiance, "reflection": picture.reflection}
    lengths = {"distance": picture.distance_m, "water": picture.in_water_m}
    parts: dict[str, Part] = {name: {"RGB": np.asarray(image, np.float32)} for name, image in light.items()}
    parts["normal"] = {f"N.{axis}": np.asarray(picture.normal[..., k], np.float32) for k, axis in enumerate("XYZ")}
    parts["bodies"] = {"A": np.asarray(picture.body_alpha, np.float32)}
    return parts | {name: {"Z": np.asarray(length, np.float32)} for name, length in lengths.items()}


def _range(scene: AerialScene, path: Path, frames: tuple[int, int | None], rate: Fraction) -> tuple[int, int]:
    """Return the frames [start, stop) that an output takes."""
    start, stop = frames
    if path.suffix.lower() in PICTURE_SUFFIXES and not is_pattern(path):
        if stop is not None and stop != start + 1:
            raise ParameterError(
                f"{path} - one picture cannot hold several frames (got {start}:{stop}) - name a pattern such as "
                f"{path.stem}_%04d{path.suffix}"
            )
        return start, start + 1
    count = max(round(scene.film.duration_s * rate), 1)
    stop = count if stop is None else stop
    if not 0 <= start < stop <= count:
        raise ParameterError(
            f"frames - outside of the film (got {start}:{stop}) - it has {count}; film.duration_s makes it longer"
        )
    FRAMES.check("frames", stop - start, ParameterError)
    return start, stop


@contextmanager
def _output(scene: AerialScene, path: Path, rate: Fraction, overwrite: bool) -> Iterator[Write]:
    """Yield a function that writes frames of a scene; the output is complete afterwards, or absent."""
    # EXR: a file of parts for each picture
    around = scene.camera.projection == "equirectangular"
    if path.suffix.lower() == ".exr":
        there = matching_files(path)[:1] if is_pattern(path) else []
        if there and not overwrite:
            raise OutputExistsError(f"{there[0][1]} - is already there - choose another name or allow overwriting")

        def write_parts(index: int, picture: AerialPicture) -> None:
            name = numbered(path, index) if is_pattern(path) else path
            write_exr(name, picture_parts(picture), latlong=around)

        yield write_parts
        return
    # All else is a video or pictures, as composites are written
    camera = scene.camera
    if path.suffix.lower() not in PICTURE_SUFFIXES and (camera.width % 2 or camera.height % 2):
        raise ParameterError(
            f"camera.width, camera.height - must be even for a video (got {camera.width}x{camera.height}) - add a pixel"
        )
    like = Clip(
        path=Path(), width=camera.width, height=camera.height, frame_rate=rate, time_base=1 / rate, panorama=around
    )
    with create_video(path, like, scene.output, overwrite=overwrite) as writer:
        spec = ColorSpec("bt709", True, "linear", 32)

        def write(index: int, picture: AerialPicture) -> None:
            time_s = float(index / rate)
            writer.write(VideoFrame(index, index, 1 / rate, time_s, 1, spec, rgb=picture.image_linear, wrap=around))

        yield write
