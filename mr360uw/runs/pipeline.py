# SPDX-License-Identifier: Apache-2.0
"""Compositing of whole videos, and export of a scene's sea.

A video is made in parts that are kept until all are there, by one process or by several: see `mr360uw.runs`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Literal

from mr360uw.base.cache import Cache
from mr360uw.base.disk_cache import keep_arrays
from mr360uw.base.parameters import checked
from mr360uw.base.progress import Progress, Steps, begin_phase
from mr360uw.caustics import export_tiles, refract_to_air
from mr360uw.errors import SceneError, package_versions
from mr360uw.render.check import scene_sun_lines
from mr360uw.render.first_pass import ClipAnalysis, clip_analysis, first_pass, measured_range
from mr360uw.render.frame import close_backend, make_backend
from mr360uw.render.loaded import Loaded, Loader, load_plate_depth
from mr360uw.render.surroundings import load_surroundings
from mr360uw.runs.job import Job, OpenJob, RunTimes, make_crew
from mr360uw.runs.outputs import Output, Report, forecaster, with_encoder
from mr360uw.runs.work_folder import (
    Part,
    WorkFolder,
    analysis_file,
    arrays_of_analysis,
    input_fingerprints,
    joined_bounds,
    load_analysis,
    work_folder,
    work_keys,
)
from mr360uw.scene.model import Scene
from mr360uw.scene.resolved import open_plate, projection_notes, scene_at
from mr360uw.scene.toml_model import dotted
from mr360uw.video import VideoReader
from mr360uw.video.reader import DecodedOnce


@checked
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
    """Composite frames of the scene's plate into a file; return a report of stages and times.

    The output appears when it is complete. Until then finished parts lie in a folder beside it, and the same call goes
    on after a stop.

    Parameters
    ----------
    scene : Scene
        The scene, whose plate is the clip.
    out : str or Path
        A video, or a pattern of pictures (out_%04d.png, .exr), or a still.
    frames : tuple of int
        Frames [a, b) by the numbers of a sequence's files, or from 0 of other clips; (0, None) takes all.
    backend : {"auto", "gl", "reference"}
        The renderer.
    overwrite : bool
        Replace an output that is there.
    layers : str or Path, optional
        A pattern (layers_%04d.exr) of multi-part EXR files with the layer's variables, without motion blur.
    progress : callable, optional
        Is called with (done, total) frames, over the frames an extra time if there is a first pass.
    tell : callable, optional
        Gets lines on the plate's sun, and one on the time and the disk space that a long run will take.
    fresh : bool
        Use nothing of earlier runs.
    workers : int or "auto"
        Processes; "auto" takes one for every two cores.
    cluster : str, optional
        Address of a Dask scheduler instead of own processes.
    mixed : bool
        Let each worker take the renderer that it has, `backend` or the reference.
    report : str or Path, optional
        File that the report is written to as JSON; out.mp4.json of an earlier run beside the output is replaced.

    Returns
    -------
    Report
        Frames, device, stages and their times.

    Raises
    ------
    VideoError, SceneError, MeshError, ParameterError
        If something cannot be used; then no output is there, of sequences the pictures that were complete. Where frames
        were finished, a note of the exception says where they are.
    OutputExistsError
        If the output is there and `overwrite` is not set.

    See Also
    --------
    uw.Compositor.frames : The same frames in memory, without a file.
    uw.render_frame : One frame, whose light is measured in it alone.
    uw.load_scene : Reads the scene.

    Examples
    --------
    >>> report = uw.composite_video(scene, "out.mp4", frames=(0, 1), backend="reference")
    >>> report.frames
    1
    """
    began = time.perf_counter()
    with open_plate(scene) as video, ExitStack() as last:
        span = video.numbered_range(*frames)
        scene, taken = with_encoder(scene, video, Path(out))
        output = Output(scene, video, out, layers, span, overwrite=overwrite, report=report)
        parts, total = output.parts(), span[1] - span[0]
        reads, size = Cache(), (video.width, video.height)
        load_plate_depth(scene, size, reads, (span[1], video.frame_count))
        loaded = Loader(*size, clip=not video.is_still, reads=reads).load(scene)
        output.check([*loaded.object_files, *loaded.other_files])  # textures and the like, which only meshes name
        _check_lengths(loaded, video, span)
        undrawn = ""
        if output.layers is not None and not loaded.plan.layer.runs:
            undrawn, output.layers = f"{output.layers} - is not written, as nothing is drawn over the plate", None
        renderer, fallback = make_backend(backend, Cache(scene.plate.eyes))
        last.callback(close_backend, renderer)
        (count, crew), inputs = make_crew(workers, cluster, len(parts)), input_fingerprints(loaded)
        keys = work_keys(loaded, inputs, "mixed" if mixed else renderer.name, measured_range(video, *span))
        seen = DecodedOnce(video, measured_range(video, *span) if crew is None else (0, 0))
        with work_folder(output.path, keys, fresh=fresh, overwrite=overwrite) as work:
            left, times, doubts = output.left(work, parts), RunTimes(), tuple[str, ...]()
            kept = total - sum(stop - start for start, stop in left)
            if left:
                analysis = _find_analysis(loaded, seen, span, work, times, progress, tell, fresh=fresh)
                doubts = analysis.notes
                begin_phase(progress, "rendering")
                done = _counted(Steps(progress, total, kept), tell and forecaster(tell, output, work, total - kept))
                job = Job(scene, output.path, work, "auto" if mixed else renderer.name, output.layers, left)
                opened = OpenJob(job, seen if seen.are_all else video, loaded, renderer, analysis)
                with _noting_what_is_finished(output, work):
                    times.merge(_alone(opened, done) if crew is None else crew(job, done))
            notes = output.complete(work, parts)
        doubts = (*video.doubts, *projection_notes(scene, seen, span[0]), *loaded.notes, *doubts, *work.notes)
    plan = loaded.plan
    made = Report(
        Path(out), total, renderer.name, renderer.device, plan, time.perf_counter() - began, times.seconds,
        notes=(*doubts, *filter(None, [fallback, taken, undrawn]), *notes), kept_frames=kept, workers=count,
        empty_frames=times.frames["empty"] if plan.layer.runs else 0,
        sunless_frames=times.frames["sunless"] if plan.sun.runs else 0,
        held_frames=times.frames["held"], concealed_frames=times.frames["concealed"],
        renderers=dict(times.renderers), inputs=inputs, packages=package_versions(),
        scene=loaded.scene.model_dump(mode="json", by_alias=True),
    )  # fmt: skip
    if output.report is not None:
        made.save(output.report, overwrite=True)  # what is there was looked at before the run
    return made


def _check_lengths(loaded: Loaded, video: VideoReader, span: Part) -> None:
    """Raise `VideoError` or `ParameterError` where a matte, a distance map or the camera's track lacks frames."""
    loaded.check(span[1])
    if not video.is_still:
        rate = float(video.frame_rate)
        loaded.surroundings.camera.check_times(span[0] / rate, (span[1] - 1) / rate, rate)


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


def _find_analysis(
    loaded: Loaded,
    video: VideoReader,
    span: Part,
    work: WorkFolder,
    times: RunTimes,
    progress: Progress | None,
    tell: Callable[[str], None] | None,
    *,
    fresh: bool,
) -> ClipAnalysis:
    """Return the analysis of the clip's frames `span`, measured into the work folder unless they are there; tell of the
    sun that they show.
    """
    analysis = work.analysis()
    if analysis is None:
        since = time.perf_counter()
        begin_phase(progress, "reading the light")
        # Take that of an earlier run over the same plate with the same settings, or measure it
        file = analysis_file(loaded, video, work.keys)
        analysis = None if file is None or fresh else load_analysis(file, kept=True)
        if analysis is None:
            analysis = clip_analysis(loaded, video, progress, frames=span)
            if file is not None:
                keep_arrays(file, arrays_of_analysis(analysis))
        work.keep_analysis(analysis)
        times.add("first pass", since)
    if tell is not None:
        for line in scene_sun_lines(loaded, video, analysis, span[0]):
            tell(line)
    return analysis


def _alone(opened: OpenJob, done: Callable[[], None]) -> RunTimes:
    """Render all parts of a job in this process; return what it took."""
    times = RunTimes()
    for start, stop in joined_bounds(list(opened.job.parts)):
        times.merge(opened.render(start, stop, done))
    return times


def _counted(steps: Steps, forecast: Callable[[], None] | None) -> Callable[[], None]:
    """Return a function that reports one more frame as done."""

    def done() -> None:
        steps.done()
        if forecast is not None:
            forecast()

    return done


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
    # Refuse a sea that changes: its tiles would not repeat
    keyed = [key.parameter for key in scene.keys if dotted(key.parameter)[0] in ("sea", "caustics")]
    if keyed:
        problem = f"keys - a sea that changes does not repeat, as tiles do (got {', '.join(keyed)}) - remove these keys"
        raise SceneError(str(scene.plate.path), [problem])
    # Find the sun in the plate, as a composite does
    scene = scene_at(scene, 0.0)
    with open_plate(scene) as video:
        surroundings, light = load_surroundings(scene), scene.light
        tracked = light.sun == "detect" and not video.is_still and (light.smooth or light.track is not None)
        sun = first_pass(surroundings, video, measures=["sun"] if tracked else []).sun_at(0)
        if isinstance(sun, str):
            sun = surroundings.light.sun(next(iter(video.frames(0, 1))).pixels, 0.0)
    if sun is None or sun.direction[1] <= 0.0:
        problem = 'no sun is found in the plate - set light.sun = "given" and its azimuth and elevation'
        raise SceneError(str(scene.plate.path), [problem])
    # Take the depth of the receiver, or of the first object
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
