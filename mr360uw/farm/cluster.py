# SPDX-License-Identifier: Apache-2.0
"""Parts of a clip on the workers of a Dask cluster, which all see the scene's files and the output's folder."""

from __future__ import annotations

import functools
import importlib
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from mr360uw.errors import ParameterError
from mr360uw.farm.job import Job, OpenJob
from mr360uw.runs.frame_range import RunTimes
from mr360uw.runs.sinks import Part

_SCHEMES = ("tcp", "tls", "ws", "wss")
"""Kinds of connections to a scheduler."""
_RETRIES = 1
"""Workers that may die over a part, beside the first."""


@dataclass(frozen=True, slots=True)
class ClusterCrew:
    """The `count` workers of a Dask scheduler at an address such as "tcp://farm:8786"."""

    address: str
    count: int

    @classmethod
    def at(cls, address: str) -> ClusterCrew:
        """Return the workers of a scheduler; `ParameterError` where Dask is not installed or no scheduler answers."""
        with _client(address) as client:
            return cls(address, max(1, len(client.scheduler_info(n_workers=-1)["workers"])))

    def render(self, job: Job, done: Callable[[], None]) -> RunTimes:
        """Render all parts of a job; done: is called for every frame of a part that is complete."""
        times = RunTimes()
        with _client(self.address) as client:
            futures = client.map(
                functools.partial(render_part, job), job.parts, pure=False, retries=_RETRIES, allow_other_workers=False
            )
            for _, found in _distributed().as_completed(futures, with_results=True):
                times.merge(found)
                for _ in range(found.frames):
                    done()
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
        return importlib.import_module("distributed")
    except ImportError as error:
        raise ParameterError("--dask - Dask is not installed - pip install 'mr360uw[farm]'") from error
