# SPDX-License-Identifier: Apache-2.0
"""What a process needs to render parts of a clip: it can be sent to another process or machine."""

from __future__ import annotations

import platform
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from mr360uw.cache import Cache
from mr360uw.errors import GlError
from mr360uw.render.backends import Backend, make_backend
from mr360uw.render.loaded import Loaded, load
from mr360uw.runs.frame_range import RangeRenderer, RunTimes
from mr360uw.runs.work_folder import Part, PictureSink, SegmentSink, WorkFolder
from mr360uw.scene.inputs import open_plate
from mr360uw.scene.model import Scene
from mr360uw.video import VideoReader
from mr360uw.video.read.projection import PICTURE_SUFFIXES
from mr360uw.video.write.writer import VideoWriter


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
        self, job: Job, video: VideoReader | None = None, loaded: Loaded | None = None, backend: Backend | None = None
    ) -> None:
        self.job = job
        self.video = open_plate(job.scene) if video is None else video
        size = self.video.width, self.video.height
        self.loaded = load(job.scene, *size, clip=not self.video.is_still) if loaded is None else loaded
        self.backend = _backend_of_worker(job.backend, job.scene.plate.eyes) if backend is None else backend
        self._analysis = job.work.analysis()

    def render(self, start: int, stop: int, done: Callable[[], None] = lambda: None) -> RunTimes:
        """Render frames [start, stop), which are parts of the job; return what it took."""
        job, times = self.job, RunTimes()
        assert self._analysis is not None, "the analysis is stored before a job is opened"
        # a folder beside the output is on the disk of layers that are beside it too
        scratch = job.work.path if job.layers is not None and job.layers.parent == job.out.parent else None
        renderer = RangeRenderer(self.loaded, self._analysis, self.backend, self.video, job.layers, scratch, times)
        renderer.render(start, stop, self._sink(start), done)
        return times

    def _sink(self, start: int) -> VideoWriter:
        job = self.job
        if job.out.suffix.lower() in PICTURE_SUFFIXES:
            return PictureSink(job.work, start, job.out, self.video)
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
