# SPDX-License-Identifier: Apache-2.0
"""Threads and cores: bounded queues that let decoding, rendering and encoding run side by side in one process, and the
cores that matrix products and other processes get.

FFmpeg, numba and OpenCV release the interpreter lock, so threads are enough. What the renderer draws stays on the
thread of the caller, to which its OpenGL context belongs. Memory is bounded by the depth of the queues.
"""

from __future__ import annotations

import functools
import os
import sys
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from typing import Any, Generic, TypeVar

T = TypeVar("T")


def one_blas_thread() -> AbstractContextManager[Any]:
    """Return a context in which NumPy's matrix products run on the calling thread only.

    They are small here, and the threads of BLAS would spin on the cores that decode and encode.
    """
    limits: AbstractContextManager[Any] = _thread_pools("scipy.linalg" in sys.modules).limit(limits=1, user_api="blas")
    return limits


@functools.cache
def _thread_pools(of_scipy: bool) -> Any:  # noqa: ARG001 - found anew once the BLAS of SciPy is loaded too
    """Return the thread pools of the libraries that are loaded, which take milliseconds to find."""
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


_END: Any = object()
"""What a source of items gives after its last one."""


def prefetch(items: Iterable[T], depth: int = 4) -> Generator[T]:
    """Yield items that a separate thread takes at most `depth` ahead; its exceptions are raised here."""
    source = iter(items)
    with ThreadPoolExecutor(1, "prefetch") as thread:
        ahead = deque(thread.submit(next, source, _END) for _ in range(depth + 1))
        try:
            while (item := ahead.popleft().result()) is not _END:
                ahead.append(thread.submit(next, source, _END))
                yield item
        finally:
            thread.shutdown(cancel_futures=True)


class Behind(Generic[T]):
    """Calls `work` on items in order on a separate thread; `put` and leaving the block raise its exceptions."""

    def __init__(self, work: Callable[[T], None], depth: int = 4) -> None:
        self._work, self._depth, self._failed = work, depth, False
        self._thread, self._waiting = ThreadPoolExecutor(1, "behind"), deque[Future[None]]()

    def __enter__(self) -> Behind[T]:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._thread.shutdown()
        if kind is None:
            for done in self._waiting:
                done.result()

    def put(self, item: T) -> None:
        """Queue an item; wait while more than `depth` are queued."""
        self._waiting.append(self._thread.submit(self._one, item))
        while self._waiting and (len(self._waiting) > self._depth + 1 or self._waiting[0].done()):
            self._waiting.popleft().result()

    def _one(self, item: T) -> None:
        if self._failed:  # what follows an item that failed is not done
            return
        try:
            self._work(item)
        except BaseException:
            self._failed = True
            raise


@contextmanager
def share_of_cores(number: int, count: int) -> Iterator[None]:
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
