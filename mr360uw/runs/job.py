# SPDX-License-Identifier: Apache-2.0
"""Rendering of parts of a clip, and what a process needs for it, which can be sent to another process or machine."""

from __future__ import annotations

import platform
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

from mr360uw import __version__
from mr360uw.cache import Cache
from mr360uw.composite.aovs import RECIPE, exr_parts, stereo_parts
from mr360uw.composite.aovs import Part as LayerPart
from mr360uw.errors import GlError
from mr360uw.files import WrittenFiles, numbered
from mr360uw.render.backends import Backend, make_backend
from mr360uw.render.first_pass import ClipAnalysis
from mr360uw.render.frame import DrawnFrame, Frame, FrameShots, blend_frame, draw_frame, frame_shots, measure_plate
from mr360uw.render.loaded import Loaded, load
from mr360uw.render.plate_light import LightSamples
from mr360uw.runs.work_folder import Part, SegmentSink, WorkFolder
from mr360uw.scene.model import Scene
from mr360uw.scene.resolved import open_plate
from mr360uw.threads import Behind, one_blas_thread, prefetch
from mr360uw.video import VideoFrame, VideoReader, write_exr
from mr360uw.video.formats import PICTURE_SUFFIXES
from mr360uw.video.other_tracks import exr_attributes
from mr360uw.video.writer import ImageWriter, VideoWriter

_WAITING = 2
"""Frames between two stages at most, beside the one in each."""


@dataclass
class RunTimes:
    """Seconds by stage, and counts of frames.

    frames: "all", those that are "empty", without visible objects, or "sunless", and by the damage of their plates
    (`VideoFrame.damage`): "none", "held", "concealed". renderers: frames by renderer and device.
    """

    seconds: dict[str, float] = field(default_factory=dict)
    frames: Counter[str] = field(default_factory=Counter)
    renderers: Counter[str] = field(default_factory=Counter)

    def add(self, stage: str, since: float) -> float:
        """Add the time since `since` to a stage; return the present time."""
        now = time.perf_counter()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now - since
        return now

    def merge(self, other: RunTimes) -> None:
        """Add what another part of the run took."""
        for stage, seconds in other.seconds.items():
            self.seconds[stage] = self.seconds.get(stage, 0.0) + seconds
        self.frames.update(other.frames)
        self.renderers.update(other.renderers)


def _layers(frame: Frame) -> tuple[dict[str, LayerPart], dict[str, str]]:
    """Return the parts of a frame's layered EXR, and the view of each where there are two eyes."""
    eyes = {"left": frame} if frame.right is None else {"left": frame, "right": frame.right}
    parts = {
        name: exr_parts(eye.layer, eye.variables, eye.plate.image_linear)
        for name, eye in eyes.items()
        if eye.variables is not None
    }
    return (parts["left"], {}) if len(parts) == 1 else stereo_parts(parts)


@dataclass(frozen=True, slots=True)
class Job:
    """A run over a clip.

    backend: name of the renderer; all processes use the same, so that frames do not flicker, except with "auto".
    layers: pattern of layered EXR files, or None. parts: of the clip, each complete on its own. All paths absolute; the
    clip's analysis lie in the work folder.
    """

    scene: Scene
    out: Path
    work: WorkFolder
    backend: str
    layers: Path | None
    parts: tuple[Part, ...]

    def __hash__(self) -> int:
        return hash((self.work.path, self.parts))


class OpenJob:
    """A job with its plate, its loaded scene and its renderer, for the thread that opened it."""

    def __init__(
        self,
        job: Job,
        video: VideoReader | None = None,
        loaded: Loaded | None = None,
        backend: Backend | None = None,
        analysis: ClipAnalysis | None = None,
    ) -> None:
        self.job = job
        self.video = open_plate(job.scene) if video is None else video
        size = self.video.width, self.video.height
        self.loaded = load(job.scene, *size, clip=not self.video.is_still) if loaded is None else loaded
        self.backend = _backend_of_worker(job.backend, job.scene.plate.eyes) if backend is None else backend
        analysis = job.work.analysis() if analysis is None else analysis
        assert analysis is not None, "the analysis is stored before a job is opened"
        self._analysis, self._times = analysis, RunTimes()

    def render(self, start: int, stop: int, done: Callable[[], None] = lambda: None) -> RunTimes:
        """Render frames [start, stop), which are parts of the job; return what it took. done: is called after each.

        Decoder, renderer and encoder each run on threads, with short queues between them: memory does not grow with
        the clip. Each frame depends on what is loaded, the clip's analysis and the plate about it alone.
        """
        self._times = RunTimes()
        files = self.job.work.files(start)
        drawing, blending, sink = self._cache(), self._cache(), self._sink(files)
        behind: Behind[DrawnFrame] = Behind(lambda drawn: self._write(drawn, sink, files, blending), _WAITING)
        renderer = f"{self.backend.name} ({self.backend.device})"
        variables = self.job.layers is not None
        with one_blas_thread(), sink, behind, closing(prefetch(self._read(start, stop), _WAITING)) as frames:
            for shots in frames:
                since = time.perf_counter()
                drawn = draw_frame(self.backend, shots, drawing, variables=variables)
                self._times.add("render", since)
                behind.put(drawn)
                self._times.renderers[renderer] += 1
                done()
        return self._times

    def _cache(self) -> Cache:
        """Return a cache of one stage of all frames."""
        return Cache(self.loaded.scene.plate.eyes)

    def _read(self, start: int, stop: int) -> Iterator[FrameShots]:
        """Yield frames, decoded, with their light measured, and what is to be drawn for them."""
        times, measuring = self._times, self._cache()
        exposure_s = self.loaded.scene.draw.exposure_s(self.video.frame_rate)
        samples = LightSamples(self.loaded, self._analysis, self.video, self._decoded)
        since, decoding_s = time.perf_counter(), times.seconds.get("decode", 0.0)
        for plate, light in samples.frames(start, stop):
            measured = measure_plate(self.loaded, self._analysis, plate, measuring, light)
            shots = frame_shots(self.loaded, self.backend, measured, exposure_s, measuring)
            times.add("light", since + times.seconds["decode"] - decoding_s)
            yield shots
            since, decoding_s = time.perf_counter(), times.seconds["decode"]

    def _decoded(self, start: int, stop: int) -> Iterator[VideoFrame]:
        since = time.perf_counter()
        for plate in self.video.frames(start, stop):
            self._times.add("decode", since)
            yield plate
            since = time.perf_counter()

    def _write(self, drawn: DrawnFrame, sink: VideoWriter, files: WrittenFiles, cache: Cache) -> None:
        """Composite a frame and write it, and before it the file of its layers. cache: results of earlier frames."""
        times, since = self._times, time.perf_counter()
        frame = blend_frame(self.loaded, self._analysis, drawn, cache)
        since = times.add("blend", since)
        sunless = frame.light is not None and frame.light.environment.sun is None
        times.frames.update(all=1, empty=not frame.layer.tiles, sunless=sunless)
        times.frames[frame.plate.damage] += 1
        if self.job.layers is not None and frame.variables is not None:
            parts, views = _layers(frame)
            file = numbered(self.job.layers, frame.plate.index + self.video.first_number)
            told = {"comments": RECIPE, "software": f"mr360uw {__version__}"}
            told |= exr_attributes(self.video, frame.plate.index)
            write_exr(file, parts, attributes=told, views=views, file=files.file)
            since = times.add("layers", since)
        sink.write(frame.picture)
        times.add("encode", since)

    def _sink(self, files: WrittenFiles) -> VideoWriter:
        job = self.job
        if job.out.suffix.lower() in PICTURE_SUFFIXES:
            return ImageWriter(job.out, self.video, overwrite=True, file=files.file)
        return SegmentSink(job.work, list(job.parts), self.video, job.scene.output)


def _backend_of_worker(name: str, kinds: int) -> Backend:
    """Return a worker's renderer for so many kinds of frames that take turns.

    Raises `GlError` where it lacks the one that the others render with.
    """
    try:
        return make_backend(name, Cache(kinds))[0]
    except GlError as error:
        raise GlError(
            f"worker {platform.node()} - has no OpenGL, which the run renders with (got: {error}) - give --backend "
            "reference, or --mixed to let each worker take the renderer that it has"
        ) from error
