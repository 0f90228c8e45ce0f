# SPDX-License-Identifier: Apache-2.0
"""Processes that render parts of a clip: on this machine, each with its share of the cores, or on a Dask cluster.

A worker that dies has its part given to another one; a part that kills two is an error, on a cluster one that kills
more than its scheduler allows. Workers of a cluster all see the scene's files and the output's folder.
"""

from __future__ import annotations

import functools
import importlib
import logging
import multiprocessing
import os
import threading
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, Literal

from mr360uw.errors import ParameterError, VideoError, install_command
from mr360uw.runs.job import Job, OpenJob, RunTimes
from mr360uw.runs.work_folder import Part

_SCHEMES = ("tcp", "tls", "ws", "wss")
"""Kinds of connections to a scheduler."""
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
        return _distributed().Client(address, timeout=10)
    except (OSError, ValueError) as error:
        raise ParameterError(
            f"--dask - no scheduler answers (got {address!r}: {error}) - start one: dask scheduler; dask worker ADDRESS"
        ) from error


def _distributed() -> Any:
    try:
        distributed = importlib.import_module("distributed")
    except ImportError as error:
        raise ParameterError(f"--dask - Dask is not installed - {install_command('farm')}") from error
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
                workers.append(_Worker.start(job, len(workers), count))
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


@dataclass(slots=True)
class _Worker:
    """A process, the way to it, and the part that it renders, if any."""

    process: BaseProcess
    connection: Connection
    part: Part | None = None

    @classmethod
    def start(cls, job: Job, number: int, count: int) -> _Worker:
        context = multiprocessing.get_context("spawn")
        here, there = context.Pipe()
        process = context.Process(target=_work, args=(there, job), name=f"worker {number}", daemon=True)
        with _share_of_cores(number, count):
            process.start()
        there.close()
        return cls(process, here)

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


@contextmanager
def _share_of_cores(number: int, count: int) -> Iterator[None]:
    """A context in which started processes get one of `count` shares of this process's cores.

    Every library then opens as many threads as it has cores. Only Linux can do it; elsewhere they share all.
    """
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    cores = sorted(os.sched_getaffinity(0))
    share = cores[number % len(cores) :: count] if count <= len(cores) else [cores[number % len(cores)]]
    os.sched_setaffinity(0, share)
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)
