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
from collections import deque
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, closing
from types import TracebackType
from typing import Any, Generic, TypeVar

from mr360uw.steps import Pause, Steps, finished

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
    """Calls `work` on items in order on a separate thread; `put` and leaving the block raise its exceptions.

    last: is called on that thread before it ends.
    """

    def __init__(self, work: Callable[[T], None], depth: int = 4, last: Callable[[], None] = lambda: None) -> None:
        self._work, self._last = work, last
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
        try:
            self._run()
        finally:
            self._last()

    def _run(self) -> None:
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


class _Flying(Generic[T]):
    """Steps that are under way. pause: where they are; None at their end."""

    def __init__(self, steps: Steps[T]) -> None:
        self._steps = steps
        self._result: list[T] = []
        self._error: Exception | None = None
        self._working: Future[None] | None = None
        self.pause: Pause | None = Pause.REST

    def go_on(self) -> None:
        """Go on to the next pause, on any thread that this pause allows."""
        try:
            self.pause = next(self._steps)
        except StopIteration as done:
            self.pause = None
            self._result.append(done.value)
        except Exception as error:  # noqa: BLE001 - raised again by `result`, after all that is before it
            self.pause, self._error = None, error

    def go_on_in(self, pool: ThreadPoolExecutor) -> None:
        """Go on on another thread; `is_there` is false meanwhile."""
        self._working = pool.submit(self.go_on)

    @property
    def is_there(self) -> bool:
        """Whether no other thread is at work on it."""
        return self._working is None or self._working.done()

    def wait(self) -> None:
        """Wait until no other thread is at work on it."""
        if self._working is not None:
            self._working.result()

    def result(self) -> T:
        """Return the result of what is at its end; raise what it raised."""
        if self._error is not None:
            raise self._error
        return self._result[0]


def in_flight(frames: Iterable[Steps[T]], answer: Callable[[], object], depth: int) -> Generator[T]:
    """Yield the results of steps in order, of which up to `depth` are under way at a time.

    What needs the device runs on the caller's thread, one step of all before it waits for the answers, which `answer`
    takes from the device; the rest runs on other threads: the beginning of each ahead of all others, and what follows
    an answer side by side. The caller's thread goes round: it takes in one more, lets the device draw, and waits once.
    depth: 0 runs them one after the other, on the caller's thread alone.
    """
    if depth == 0:
        yield from map(finished, frames)
        return
    flying: deque[_Flying[T]] = deque()
    coming, error = True, None
    with closing(prefetch(map(_begun, frames), 1)) as begun, ThreadPoolExecutor(depth, "steps") as pool:
        while coming or flying:
            if coming and len(flying) < depth:
                try:
                    flying.append(next(begun))
                except StopIteration:
                    coming = False
                except Exception as caught:  # noqa: BLE001 - raised again, after all that is before it
                    coming, error = False, caught
            drawing = [one for one in flying if one.is_there]
            for one in drawing:
                while one.pause is Pause.DEVICE:
                    one.go_on()
            answer()
            soon = [one for one in drawing if one.pause is Pause.ANSWER]
            for one in drawing:
                if one.pause is not None:
                    one.go_on_in(pool)
            for one in soon:
                one.wait()
            if flying and (len(flying) == depth or not coming):
                flying[0].wait()
            while flying and flying[0].is_there and flying[0].pause is None:
                yield flying.popleft().result()
    if error is not None:
        raise error


def _begun(steps: Steps[T]) -> _Flying[T]:
    """Return steps at their first pause."""
    one = _Flying(steps)
    one.go_on()
    return one
