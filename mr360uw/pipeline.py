# SPDX-License-Identifier: Apache-2.0
"""Compositing of whole videos and of single frames.

A video is made in parts that are kept until all are there: see `mr360uw.runs`; by one process or by several: see
`mr360uw.farm`.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from mr360uw.errors import OutputExistsError, ParameterError, VideoError
from mr360uw.farm.crew import make_crew
from mr360uw.farm.job import Job, OpenJob, Part
from mr360uw.progress import Progress
from mr360uw.render.backends import make_backend
from mr360uw.render.first_pass import ClipFacts, first_pass
from mr360uw.render.frame import finished, frame_stages
from mr360uw.render.loaded import Loaded, load
from mr360uw.render.plate_pattern import calm_series
from mr360uw.runs.fingerprint import input_fingerprints, work_keys
from mr360uw.runs.frame_range import RunTimes
from mr360uw.runs.run_report import Report
from mr360uw.runs.sinks import joined_bounds, segment_bounds
from mr360uw.runs.work_folder import WorkFolder, work_folder
from mr360uw.scene.inputs import keep_inputs, open_plate
from mr360uw.scene.model import Scene
from mr360uw.shapes import real
from mr360uw.types import CausticStack, Environment, Floats, Layer, MediumTable, Sun
from mr360uw.video import VideoFrame, VideoReader, create_video
from mr360uw.video.read.images import PICTURE_SUFFIXES, is_pattern, matching_files, numbered


@dataclass(frozen=True, slots=True)
class FrameResult:
    """One composited frame and its intermediate results; stages that the scene does not need are None.

    image_linear: (H, W, 3) float32. layer: objects, shadows and caustics over the plate. environment: the plate's
    light. caustics: on planes around the objects' depths. medium: the water, its veil matched to the plate.
    """

    image_linear: Floats
    layer: Layer
    environment: Environment | None
    caustics: CausticStack | None
    medium: MediumTable | None


def render_frame(
    plate: Floats,
    scene: Scene,
    time_s: float = 0.0,
    backend: str = "auto",
    *,
    index: int = 0,
    sun: Sun | Literal["scene"] | None = "scene",
    gain: Floats | None = None,
    facts: ClipFacts | None = None,
    shutter_s: float = 0.0,
) -> FrameResult:
    """Return the composite of one plate (H, W, 3), float32, linear, values up to 1 where it clips.

    time_s: of the sea and of moving objects. index: of the frame, for sequences and grain. backend: "auto", "gl" or
    "reference". sun: "scene" follows the scene's settings in this plate alone; for a frame of a video give
    `facts.sun_at(index)`. gain: (3,) of the veil if the scene's is "auto"; None fits it to this plate alone, for a
    frame of a video give `facts.gain_at(index)`. facts: of a first pass over the plate's clip, in place of both.
    shutter_s: exposure time, for motion blur. The scene is loaded on each call; for many frames use
    `render.loaded.load` and `render.frame.frame_stages`.
    """
    plate = real("plate", plate)
    if plate.ndim != 3 or plate.shape[2] != 3 or plate.shape[1] != 2 * plate.shape[0] or plate.shape[0] % 2:
        raise ParameterError(
            f"plate - must be an equirectangular image (H, 2 H, 3) of even height (got {plate.shape}) - resize it"
        )
    if not np.issubdtype(plate.dtype, np.floating) or not np.all(np.isfinite(plate)):
        raise ParameterError("plate - must be finite floating point light - decode code values with uw.open_video")
    loaded = load(scene, plate.shape[1], plate.shape[0], clip=False)
    renderer, _ = make_backend(backend)
    facts = ClipFacts.of_frame(sun, gain) if facts is None else facts
    frame = finished(frame_stages(loaded, facts, renderer, VideoFrame.of_linear(plate, index, time_s), shutter_s))
    return FrameResult(
        image_linear=frame.picture.image_linear,
        layer=frame.layer,
        environment=frame.light.environment if frame.light is not None else None,
        caustics=renderer.download(frame.caustics) if frame.caustics is not None else None,
        medium=frame.medium,
    )


def composite_video(
    scene: Scene,
    out: str | Path,
    *,
    frames: tuple[int, int | None] = (0, None),
    backend: str = "auto",
    overwrite: bool = False,
    layers: str | Path | None = None,
    progress: Progress | None = None,
    fresh: bool = False,
    workers: int | Literal["auto"] = 1,
    cluster: str | None = None,
) -> Report:
    """Composite frames [a, b) of the scene's plate into `out`; return a report of stages and times.

    out: a video, or a pattern of images (out_%04d.png, .exr), or a still; it appears when it is complete. Until then
    finished parts lie in a folder beside it: the same call goes on after a run that was stopped, unless `fresh`.
    layers: a pattern (layers_%04d.exr) of multi-part EXR files with the layer's variables, without motion blur.
    workers: processes; "auto" takes one for every two cores. cluster: address of a Dask scheduler instead.
    progress: is called over the clip an extra time if there is a first pass. Raises `VideoError`, `OutputExistsError`,
    `SceneError`, `MeshError`, `ParameterError`; then no output is there, of sequences the pictures that were complete.
    """
    began, target = time.perf_counter(), Path(out).absolute()
    pattern = None if layers is None else _layers_pattern(Path(layers).absolute(), target)
    keep_inputs(scene, target, *([] if pattern is None else [pattern]))
    with open_plate(scene) as video:
        span = video.check_range(*frames)
        parts, total = _parts(target, video, scene, span, overwrite=overwrite), span[1] - span[0]
        loaded = load(scene, video.width, video.height, clip=not video.is_still)
        loaded.check(span[1])
        renderer, fallback = make_backend(backend)
        crew = make_crew(workers, cluster, len(parts))
        inputs = input_fingerprints(scene)
        with work_folder(target, work_keys(scene, inputs, renderer.name), fresh=fresh) as work:
            if not (work.resumed or overwrite):
                _check_pictures(target, pattern)
            left, times, doubts = _left(work, target, parts), RunTimes(), tuple[str, ...]()
            kept = total - sum(stop - start for start, stop in left)
            if left:
                doubts = _find_facts(loaded, video, work, times, progress).notes
                done = _counted(progress, kept, total)
                opened = OpenJob(Job(scene, target, work, renderer.name, pattern, left), video, loaded, renderer)
                times.merge(_alone(opened, done) if crew is None else crew.render(opened.job, done))
            notes = _completed(work, target, video, scene, parts, overwrite=overwrite)
    plan = loaded.plan
    return Report(
        out=Path(out),
        frames=total,
        backend=renderer.name,
        device=renderer.device,
        plan=plan,
        seconds=time.perf_counter() - began,
        stage_s=times.seconds,
        notes=(*loaded.notes, *doubts, *filter(None, [fallback]), *work.notes, *notes),
        empty_frames=times.empty if plan.layer.runs else 0,
        sunless_frames=times.sunless if plan.sun.runs else 0,
        kept_frames=kept,
        workers=1 if crew is None else crew.count,
        inputs=inputs,
    )


def _layers_pattern(pattern: Path, out: Path) -> Path:
    """Return the pattern of layered files; raise if it is the output's, or no pattern of EXR files."""
    if pattern == out or (is_pattern(pattern) and pattern.resolve() == out.resolve()):
        raise ParameterError(f"{pattern} - is the name of the output too - give the layers one of their own")
    if not is_pattern(pattern) or pattern.suffix.lower() != ".exr":
        raise ParameterError(f"{pattern} - is no pattern of numbered EXR files - write for example layers_%04d.exr")
    return pattern


def _parts(out: Path, video: VideoReader, scene: Scene, span: Part, *, overwrite: bool) -> list[Part]:
    """Return the parts of an output that are complete on their own; raise `VideoError` if it cannot be made."""
    pictures = out.suffix.lower() in PICTURE_SUFFIXES
    create_video(out, video, scene.output, overwrite=overwrite or is_pattern(out)).abort()
    if not pictures:
        rate = float(video.frame_rate)
        return segment_bounds(*span, max(1, round(scene.output.segment_s * rate)))
    if not is_pattern(out) and span[1] - span[0] > 1:
        raise VideoError(
            f"{out} - one picture cannot hold several frames (got {span[0]}:{span[1]}) - name a pattern such as "
            f"{out.stem}_%04d{out.suffix}, or one frame"
        )
    return segment_bounds(*span, 1)


def _check_pictures(*patterns: Path | None) -> None:
    """Raise `OutputExistsError` where files of a pattern are there."""
    for pattern in patterns:
        there = matching_files(pattern) if pattern is not None and is_pattern(pattern) else []
        if there:
            raise OutputExistsError(f"{there[0][1]} - is there already - name another pattern, or give --overwrite")


def _left(work: WorkFolder, out: Path, parts: list[Part]) -> tuple[Part, ...]:
    """Return the parts that are not complete yet."""
    if out.suffix.lower() in PICTURE_SUFFIXES:
        name = numbered if is_pattern(out) else lambda path, _: path
        done = {(k, k + 1) for k in work.pictures() if name(out, k).exists()}
    else:
        done = {(segment.start, segment.stop) for segment in work.segments()}
    return tuple(part for part in parts if part not in done)


def _find_facts(
    loaded: Loaded, video: VideoReader, work: WorkFolder, times: RunTimes, progress: Progress | None
) -> ClipFacts:
    """Return the clip's facts, measured into the work folder unless they are there."""
    stored = work.facts()
    if stored is not None:
        return stored
    since, plan = time.perf_counter(), loaded.plan
    wanted = {"sun": plan.track_sun.runs, "gain": plan.track_gain.runs}
    calm = calm_series(loaded) if not video.is_still else None
    facts = first_pass(loaded.surroundings, video, progress, calm=calm, **wanted)
    work.keep_facts(facts)
    times.add("first pass", since)
    return facts


def _alone(opened: OpenJob, done: Callable[[], None]) -> RunTimes:
    """Render all parts of a job in this process; return what it took."""
    times = RunTimes()
    for start, stop in joined_bounds(list(opened.job.parts)):
        times.merge(opened.render(start, stop, done))
    return times


def _counted(progress: Progress | None, kept: int, total: int) -> Callable[[], None]:
    """Return a function that reports one more frame as done."""
    count: Iterator[int] = itertools.count(kept + 1)

    def done() -> None:
        if progress is not None:
            progress(next(count), total)

    return done


def _completed(
    work: WorkFolder, out: Path, video: VideoReader, scene: Scene, parts: list[Part], *, overwrite: bool
) -> tuple[str, ...]:
    """Join the segments of a video under its name; return what the output lacks of the plate, one line each."""
    if out.suffix.lower() in PICTURE_SUFFIXES:
        return create_video(out, video, overwrite=True).notes
    wanted = set(parts)
    segments = [segment for segment in work.segments() if (segment.start, segment.stop) in wanted]
    from mr360uw.video.write.container_writer import ContainerWriter

    with ContainerWriter(out, video, scene.output, overwrite=overwrite, folder=work.path) as writer:
        writer.write_segments(segments)
    return writer.notes
