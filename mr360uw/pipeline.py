# SPDX-License-Identifier: Apache-2.0
"""Compositing of whole videos and of single frames.

A video is made in parts that are kept until all are there: see `mr360uw.runs`; by one process or by several: see
`mr360uw.farm`.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from mr360uw.errors import ParameterError
from mr360uw.farm.crew import make_crew
from mr360uw.farm.job import Job, OpenJob
from mr360uw.progress import Progress
from mr360uw.render.backends import Backend, make_backend
from mr360uw.render.first_pass import ClipFacts, measured_range
from mr360uw.render.frame import finished, frame_stages
from mr360uw.render.loaded import Loaded, load
from mr360uw.render.sun_lines import scene_sun_lines
from mr360uw.runs.clip_measured import measured_facts
from mr360uw.runs.fingerprint import input_fingerprints, work_keys
from mr360uw.runs.forecast import Forecast
from mr360uw.runs.frame_range import RunTimes
from mr360uw.runs.outputs import Output
from mr360uw.runs.run_report import Report
from mr360uw.runs.sinks import Part, joined_bounds
from mr360uw.runs.work_folder import WorkFolder, work_folder
from mr360uw.scene.inputs import open_plate, projection_notes
from mr360uw.scene.model import Scene
from mr360uw.shapes import real
from mr360uw.types import CausticStack, Environment, Floats, Layer, MediumTable, Sun
from mr360uw.video import VideoFrame, VideoReader


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

    def _repr_png_(self) -> bytes:
        """Return the frame as a notebook shows it: 8-bit sRGB, at most 1024 pixels wide."""
        from mr360uw.preview.thumbnail import thumbnail

        return thumbnail(self.image_linear)


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
        caustics=frame.caustics,
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
    tell: Callable[[str], None] | None = None,
    fresh: bool = False,
    workers: int | Literal["auto"] = 1,
    cluster: str | None = None,
    mixed: bool = False,
    report: str | Path | None = None,
) -> Report:
    """Composite frames [a, b) of the scene's plate into `out`; return a report of stages and times.

    out: a video, or a pattern of images (out_%04d.png, .exr), or a still; it appears when it is complete. Until then
    finished parts lie in a folder beside it: the same call goes on after a stop. fresh: use nothing of earlier runs.
    layers: a pattern (layers_%04d.exr) of multi-part EXR files with the layer's variables, without motion blur.
    workers: processes; "auto" takes one for every two cores. cluster: address of a Dask scheduler instead. mixed: let
    each take the renderer that it has, `backend` or the reference. progress: is called over the frames an extra time if
    there is a first pass. report: file that the report is written to as JSON. tell: gets lines
    on the plate's sun, and one on the time and the disk space that a long run will take.

    Raises `VideoError`, `OutputExistsError`, `SceneError`, `MeshError`, `ParameterError`; then no output is there, of
    sequences the pictures that were complete. Where frames were finished, a note of the exception says where they are.
    """
    began = time.perf_counter()
    with open_plate(scene) as video:
        span = video.check_range(*frames)
        output = Output.of(scene, video, out, layers, span, overwrite=overwrite, report=report)
        parts, total = output.parts(), span[1] - span[0]
        loaded = load(scene, video.width, video.height, clip=not video.is_still)
        output.check([*loaded.object_files, *loaded.other_files])  # textures and the like, which only meshes name
        _check_lengths(loaded, video, span)
        renderer, fallback = make_backend(backend, scene.plate.eyes)
        crew, inputs = make_crew(workers, cluster, len(parts)), input_fingerprints(loaded)
        keys = work_keys(loaded, inputs, "mixed" if mixed else renderer.name, measured_range(video, *span))
        with work_folder(output.path, keys, fresh=fresh) as work:
            output.check_pictures(work)
            left, times, doubts = output.left(work, parts), RunTimes(), tuple[str, ...]()
            kept = total - sum(stop - start for start, stop in left)
            if left:
                facts = _find_facts(loaded, video, span, work, times, progress, fresh=fresh)
                doubts = facts.notes
                if tell is not None:
                    for line in scene_sun_lines(loaded, video, facts, span[0]):
                        tell(line)
                done = _counted(progress, tell and Forecast(tell, output, work, total - kept), kept, total)
                job = Job(scene, output.path, work, "auto" if mixed else renderer.name, output.layers, left)
                opened = OpenJob(job, video, loaded, renderer)
                with _noting_what_is_finished(output, work):
                    times.merge(_alone(opened, done) if crew is None else crew.render(job, done))
            notes = output.complete(work, parts)
        doubts = (*video.doubts, *projection_notes(scene, video, span[0]), *loaded.notes, *doubts, *work.notes)
    made = replace(
        _report(Path(out), total, loaded, renderer, times), seconds=time.perf_counter() - began, kept_frames=kept,
        notes=(*doubts, *filter(None, [fallback]), *notes), workers=1 if crew is None else crew.count, inputs=inputs,
    )  # fmt: skip
    if output.report is not None:
        made.save(output.report, overwrite=overwrite)
    return made


def _check_lengths(loaded: Loaded, video: VideoReader, span: Part) -> None:
    """Raise `VideoError` or `ParameterError` where a matte, a distance map or the camera's track lacks frames."""
    loaded.check(span[1])
    if not video.is_still:
        rate = float(video.frame_rate)
        loaded.surroundings.camera.check_times(span[0] / rate, (span[1] - 1) / rate, rate)


def _report(out: Path, frames: int, loaded: Loaded, renderer: Backend, times: RunTimes) -> Report:
    """Return the report of a run, without what only the run as a whole has."""
    plan = loaded.plan
    return Report(
        out=out,
        frames=frames,
        backend=renderer.name,
        device=renderer.device,
        plan=plan,
        seconds=0.0,
        stage_s=times.seconds,
        empty_frames=times.empty if plan.layer.runs else 0,
        sunless_frames=times.sunless if plan.sun.runs else 0,
        held_frames=times.held,
        concealed_frames=times.concealed,
        renderers=times.renderers,
    )


@contextmanager
def _noting_what_is_finished(output: Output, work: WorkFolder) -> Iterator[None]:
    """A context whose exceptions get a note on what is finished, which is made playable."""
    try:
        yield
    except Exception as error:
        note = output.finished_part(work)
        if note:
            error.add_note(note)
        raise


def _find_facts(
    loaded: Loaded,
    video: VideoReader,
    span: Part,
    work: WorkFolder,
    times: RunTimes,
    progress: Progress | None,
    *,
    fresh: bool,
) -> ClipFacts:
    """Return the facts of the clip's frames `span`, measured into the work folder unless they are there."""
    stored = work.facts()
    if stored is not None:
        return stored
    since = time.perf_counter()
    facts = measured_facts(loaded, video, span, work.keys, progress, fresh=fresh)
    work.keep_facts(facts)
    times.add("first pass", since)
    return facts


def _alone(opened: OpenJob, done: Callable[[], None]) -> RunTimes:
    """Render all parts of a job in this process; return what it took."""
    times = RunTimes()
    for start, stop in joined_bounds(list(opened.job.parts)):
        times.merge(opened.render(start, stop, done))
    return times


def _counted(progress: Progress | None, forecast: Forecast | None, kept: int, total: int) -> Callable[[], None]:
    """Return a function that reports one more frame as done."""
    count: Iterator[int] = itertools.count(kept + 1)

    def done() -> None:
        if progress is not None:
            progress(next(count), total)
        if forecast is not None:
            forecast.frame_done()

    return done
