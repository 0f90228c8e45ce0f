# SPDX-License-Identifier: Apache-2.0
"""Rendering of parts of a clip, what a process needs for it, which can be sent to another process or machine, and the
processes that do it."""

from __future__ import annotations

import functools
import logging
import multiprocessing
import os
import platform
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError
from contextlib import closing
from dataclasses import dataclass, field, replace
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any, Literal

from mr360uw import __version__
from mr360uw.base.cache import Cache
from mr360uw.base.color import XY_BY_NAME
from mr360uw.base.files import WrittenFiles, numbered
from mr360uw.base.progress import Behind, one_blas_thread, prefetch, share_of_cores
from mr360uw.composite.aovs import RECIPE, cryptomatte, exr_parts, motion, stereo_parts
from mr360uw.composite.aovs import Part as LayerPart
from mr360uw.errors import GlError, ParameterError, VideoError, needed
from mr360uw.render.first_pass import ClipAnalysis
from mr360uw.render.frame import Backend, Drawn, Frame, FrameShots, blend_frame, draw_frame, make_backend
from mr360uw.render.loaded import Loaded, load
from mr360uw.runs.compositor import shots_of_clip
from mr360uw.runs.work_folder import Part, WorkFolder
from mr360uw.scene.model import Scene
from mr360uw.scene.resolved import open_plate
from mr360uw.video import VideoFrame, VideoReader, write_exr
from mr360uw.video.clip import PICTURE_SUFFIXES
from mr360uw.video.other_tracks import exr_attributes
from mr360uw.video.writer import ImageWriter, SegmentWriter, VideoWriter

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


def _layers(
    loaded: Loaded, shots: FrameShots, frame: Frame, step_s: float
) -> tuple[dict[str, LayerPart], dict[str, str], dict[str, Any]]:
    """Return the parts of a frame's layered EXR, the view of each where there are two eyes, and what its header says.

    step_s: time [s] to the frames after and before, to which the surfaces move.
    """
    names, primaries = list[str](), XY_BY_NAME[loaded.scene.output.layers]
    for settings in loaded.scene.objects:  # a mesh that stands twice has a number
        stem = settings.mesh.stem
        names.append(stem if stem not in names else f"{stem}_{len(names) + 1}")
    eyes = {"left": frame} if frame.right is None else {"left": frame, "right": frame.right}
    parts: dict[str, dict[str, LayerPart]] = {}
    told: dict[str, str] = {}
    for (name, eye), (_, instants) in zip(eyes.items(), shots.eyes, strict=True):
        if eye.variables is None:
            continue
        at, moved = instants[-1], []
        for k in (1, -1):
            then_s = at.time_s + k * step_s
            then = loaded.at(then_s, at.now)
            view = replace(then.view(then_s), eye_m=at.shot.view.eye_m)
            place = then_s, frame.plate.index + k, view.position, view.world_from_camera
            moved.append(motion(eye.variables, at.shot, [one.at(*place) for one in then.objects], view))
        mattes, told = cryptomatte(eye.variables, at.shot, names)
        light = eye.layer, eye.variables, eye.plate.image_linear
        parts[name] = exr_parts(*light, (moved[0], moved[1]), primaries) | mattes
    header: dict[str, Any] = told | {"chromaticities": primaries}
    return (parts["left"], {}, header) if len(parts) == 1 else (*stereo_parts(parts), header)


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
        behind = Behind[tuple[FrameShots, Drawn]](lambda one: self._write(*one, sink, files, blending), _WAITING)
        renderer = f"{self.backend.name} ({self.backend.device})"
        variables = self.job.layers is not None
        with one_blas_thread(), sink, behind, closing(prefetch(self._read(start, stop), _WAITING)) as frames:
            for shots in frames:
                since = time.perf_counter()
                drawn = draw_frame(self.backend, shots, drawing, variables=variables)
                self._times.add("render", since)
                behind.put((shots, drawn))
                self._times.renderers[renderer] += 1
                done()
        return self._times

    def _cache(self) -> Cache:
        """Return a cache of one stage of all frames."""
        return Cache(self.loaded.scene.plate.eyes)

    def _read(self, start: int, stop: int) -> Iterator[FrameShots]:
        """Yield frames, decoded, with their light measured, and what is to be drawn for them."""
        times = self._times
        found = shots_of_clip(self.loaded, self._analysis, self.backend, self.video, self._decoded, start, stop)
        since, decoding_s = time.perf_counter(), times.seconds.get("decode", 0.0)
        for shots in found:
            times.add("light", since + times.seconds["decode"] - decoding_s)
            yield shots
            since, decoding_s = time.perf_counter(), times.seconds["decode"]

    def _decoded(self, start: int, stop: int) -> Iterator[VideoFrame]:
        since = time.perf_counter()
        for plate in self.video.frames(start, stop):
            self._times.add("decode", since)
            yield plate
            since = time.perf_counter()

    def _write(self, shots: FrameShots, drawn: Drawn, sink: VideoWriter, files: WrittenFiles, cache: Cache) -> None:
        """Composite a frame and write it, and before it the file of its layers. cache: results of earlier frames."""
        times, since = self._times, time.perf_counter()
        frame = blend_frame(self.loaded, self._analysis, shots, drawn, cache)
        since = times.add("blend", since)
        sunless = frame.light is not None and frame.light.environment.sun is None
        times.frames.update(all=1, empty=int(not frame.layer.tiles), sunless=int(sunless))
        times.frames[frame.plate.damage] += 1
        if self.job.layers is not None and frame.variables is not None:
            parts, views, header = _layers(self.loaded, shots, frame, 1.0 / float(self.video.frame_rate or 1.0))
            file = numbered(self.job.layers, frame.plate.index + self.video.first_number)
            told = {"comments": RECIPE, "software": f"mr360uw {__version__}"} | header
            told |= exr_attributes(self.video, frame.plate.index)
            write_exr(file, parts, attributes=told, views=views, file=files.file)
            since = times.add("layers", since)
        sink.write(frame.picture)
        times.add("encode", since)

    def _sink(self, files: WrittenFiles) -> VideoWriter:
        job = self.job
        if job.out.suffix.lower() in PICTURE_SUFFIXES:
            return ImageWriter(job.out, self.video, overwrite=True, file=files.file)
        return SegmentWriter(job.work.path, job.parts, self.video, job.scene.output)


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


# --- worker processes -----------------------------------------------------------------------------------------------

# Processes that render parts of a clip: on this machine, each with its share of the cores, or on a Dask cluster.
#
# A worker that dies has its part given to another one; a part that kills two is an error, on a cluster one that kills
# more than its scheduler allows. Workers of a cluster all see the scene's files and the output's folder.


_SCHEMES = ("tcp", "tls", "ws", "wss")
"""Kinds of connections to a scheduler."""
_ANSWER_S = 10.0
"""Seconds that a scheduler has to answer who connects to it."""
_LOOK_S = 10.0
"""Seconds without a result after which a scheduler is asked for its workers."""
_NO_WORKER_S = 60.0
"""Seconds that a scheduler without any worker is waited for: a worker that died is replaced in a few."""


def _render_in_cluster(address: str, job: Job, done: Callable[[], None]) -> RunTimes:
    """Render all parts of a job by the workers of a Dask scheduler at an address such as "tcp://farm:8786".

    done: is called for every frame of a part that is complete. `VideoError` where the scheduler or its workers die.
    """
    times, distributed = RunTimes(), _distributed()
    try:
        with _client(address) as client:
            waiting = client.map(functools.partial(render_part, job), job.parts, pure=False)
            while waiting:
                try:
                    finished, waiting = distributed.wait(waiting, _LOOK_S, return_when="FIRST_COMPLETED")
                except TimeoutError:
                    if not client.scheduler_info(n_workers=-1)["workers"]:
                        client.wait_for_workers(1, timeout=_NO_WORKER_S)
                    continue
                for future in finished:
                    found = future.result()
                    times.merge(found)
                    for _ in range(found.frames["all"]):
                        done()
    except (distributed.comm.CommClosedError, distributed.KilledWorker, CancelledError, TimeoutError) as error:
        raise VideoError(
            f"--dask - the scheduler or its workers died (got {address!r}: {error!s:.120}) - start them again; the "
            "same command goes on where it stopped"
        ) from error
    return times


def render_part(job: Job, part: Part) -> RunTimes:
    """Render a part of a job on a worker of a cluster; the job stays open for the next part."""
    return _opened(job, threading.get_ident()).render(*part)


@functools.lru_cache(maxsize=1)
def _opened(job: Job, thread: int) -> OpenJob:  # noqa: ARG001 - a renderer belongs to the thread that made it
    return OpenJob(job)


def _client(address: str) -> Any:
    """Return a connection to a scheduler, to be used in a `with` block."""
    scheme = address.partition("://")[0] if "://" in address else _SCHEMES[0]
    if scheme not in _SCHEMES:
        raise ParameterError(
            f"--dask - is no address of a scheduler (got {address!r}) - begin it with {', '.join(_SCHEMES)}://"
        )
    try:
        return _distributed().Client(address, timeout=_ANSWER_S)
    except (OSError, ValueError) as error:
        raise ParameterError(
            f"--dask - no scheduler answers (got {address!r}: {error}) - start one: dask scheduler; dask worker ADDRESS"
        ) from error


def _distributed() -> Any:
    distributed = needed("distributed", "farm", "--dask")
    for name in ("distributed", "distributed.client"):  # what they log is raised too, and told as an error
        logging.getLogger(name).setLevel(logging.CRITICAL)
    return distributed


Crew = Callable[[Job, Callable[[], None]], RunTimes]
"""Renders all parts of a job; calls the second argument after every frame. Raises what a process raised."""


def make_crew(workers: int | Literal["auto"], cluster: str | None, parts: int) -> tuple[int, Crew | None]:
    """Return the number of processes that render `parts` parts, and what renders by them; None for this one alone.

    workers: their number; "auto" takes one for every two cores. cluster: address of a Dask scheduler instead. Raises
    `ParameterError`, also where Dask is not installed or no scheduler answers.
    """
    if cluster is not None:
        with _client(cluster) as client:
            count = max(1, len(client.scheduler_info(n_workers=-1)["workers"]))
        return count, functools.partial(_render_in_cluster, cluster)
    if workers != "auto" and (isinstance(workers, bool) or not isinstance(workers, int) or workers < 1):
        raise ParameterError(f"workers - must be a number of processes or auto (got {workers!r}) - give 1 or more")
    count = min(max(1, (os.cpu_count() or 2) // 2) if workers == "auto" else workers, parts)
    return count, functools.partial(render_in_workers, count) if count > 1 else None


_TRIES = 2
"""Workers that may die over a part."""


def render_in_workers(count: int, job: Job, done: Callable[[], None]) -> RunTimes:
    """Render all parts of a job by `count` spawned processes on this machine; done: is called after every frame.

    `VideoError` where workers died over a part.
    """
    waiting, tries, times = deque(job.parts), dict.fromkeys(job.parts, 0), RunTimes()
    workers: list[_Worker] = []
    try:
        while waiting or any(worker.part for worker in workers):
            # Start workers while there is work for them, and hand out parts
            while waiting and len(workers) < count:
                workers.append(_Worker(job, len(workers), count))
            for worker in workers:
                if worker.part is None and waiting:
                    worker.take(waiting.popleft())
            # Hear of frames and parts that are done; parts of a worker that died are tried again
            busy = wait([worker.connection for worker in workers if worker.part is not None])
            for worker in [worker for worker in workers if worker.connection in busy]:
                try:
                    message = worker.connection.recv()
                except (EOFError, OSError):
                    workers.remove(worker)
                    waiting.extendleft(_given_back(worker, tries))
                    continue
                if isinstance(message, BaseException):
                    raise message
                if isinstance(message, RunTimes):
                    times.merge(message)
                    worker.part = None
                else:
                    done()
    finally:
        for worker in workers:
            worker.end()
    return times


class _Worker:
    """A process that is started, the way to it, and the part that it renders, if any."""

    def __init__(self, job: Job, number: int, count: int) -> None:
        context = multiprocessing.get_context("spawn")
        self.part: Part | None = None
        self.connection, there = context.Pipe()
        self.process = context.Process(target=_work, args=(there, job), name=f"worker {number}", daemon=True)
        with share_of_cores(number, count):
            self.process.start()
        there.close()

    def take(self, part: Part) -> None:
        self.part = part
        self.connection.send(part)

    def end(self) -> None:
        self.connection.close()
        if self.part is not None:  # an idle worker ends by itself
            self.process.terminate()
        self.process.join()


def _given_back(worker: _Worker, tries: dict[Part, int]) -> list[Part]:
    """Return the part of a dead worker, to be rendered again; raise `VideoError` after the last try."""
    worker.process.join()
    part = worker.part
    if part is None:
        return []
    tries[part] += 1
    if tries[part] >= _TRIES:
        raise VideoError(
            f"frames {part[0]}:{part[1]} - {_TRIES} workers died over them (got exit code {worker.process.exitcode}) - "
            "render them alone to see why; too little memory is the usual cause: take fewer workers"
        )
    return [part]


def _work(connection: Any, job: Job) -> None:
    """Body of a worker: render the parts that arrive, until the other side closes."""
    try:
        opened = OpenJob(job)
        while True:
            start, stop = connection.recv()
            connection.send(opened.render(start, stop, lambda: connection.send(None)))
    except (EOFError, BrokenPipeError, ConnectionResetError):
        return
    except Exception as error:  # noqa: BLE001 - raised again by the process that waits
        connection.send(error)
