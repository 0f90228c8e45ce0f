# SPDX-License-Identifier: Apache-2.0
"""Bounded queues that let decoding, rendering and encoding run side by side in one process.

FFmpeg, numba and OpenCV release the interpreter lock, so threads are enough. What the renderer draws stays on the
thread of the caller, to which its OpenGL context belongs. Memory is bounded by the depth of the queues.
"""

from __future__ import annotations

import functools
import queue
import sys
import threading
from collections.abc import Callable, Generator, Iterable
from contextlib import AbstractContextManager
from types import TracebackType
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


class _End:
    """Marks the end of a queue, with the exception that ended it, if any."""

    def __init__(self, error: BaseException | None = None) -> None:
        self.error = error


def prefetch(items: Iterable[T], depth: int = 4) -> Generator[T]:
    """Yield items that a separate thread takes at most `depth` ahead; its exceptions are raised here."""
    ready: queue.Queue[T | _End] = queue.Queue(depth)
    stopped = threading.Event()

    def take() -> None:
        end = _End()
        try:
            for item in items:
                while not stopped.is_set():
                    try:
                        ready.put(item, timeout=0.1)
                        break
                    except queue.Full:
                        continue
                if stopped.is_set():
                    return
        except BaseException as error:  # noqa: BLE001 - raised again on the caller's thread
            end = _End(error)
        while not stopped.is_set():
            try:
                ready.put(end, timeout=0.1)
                break
            except queue.Full:
                continue

    thread = threading.Thread(target=take, name="prefetch", daemon=True)
    thread.start()
    try:
        while True:
            item = ready.get()
            if isinstance(item, _End):
                if item.error is not None:
                    raise item.error
                return
            yield item
    finally:
        stopped.set()
        thread.join()


class Behind(Generic[T]):
    """Calls `work` on items in order on a separate thread; `put` and leaving the block raise its exceptions."""

    def __init__(self, work: Callable[[T], None], depth: int = 4) -> None:
        self._work = work
        self._waiting: queue.Queue[T | _End] = queue.Queue(depth)
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._all, name="behind", daemon=True)

    def __enter__(self) -> Behind[T]:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._waiting.put(_End(error))
        self._thread.join()
        if error is None and self._error is not None:
            raise self._error

    def put(self, item: T) -> None:
        """Queue an item; wait while the queue is full."""
        if self._error is not None:
            raise self._error
        self._waiting.put(item)

    def _all(self) -> None:
        abandoned = False
        while True:
            item = self._waiting.get()
            if isinstance(item, _End):
                return
            if abandoned:
                continue  # keep emptying the queue, so that `put` never blocks for ever
            try:
                self._work(item)
            except BaseException as error:  # noqa: BLE001 - raised again on the caller's thread
                self._error, abandoned = error, True
