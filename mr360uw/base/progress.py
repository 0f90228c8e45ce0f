# SPDX-License-Identifier: Apache-2.0
"""Progress of a run: on a terminal (frames, rate, time left), with the signals that end it; counts of uneven steps; and
the threads and cores that it uses."""

from __future__ import annotations

import functools
import os
import signal
import sys
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager, nullcontext
from types import FrameType
from typing import TYPE_CHECKING, Any, Generic, TypeVar

if TYPE_CHECKING:
    from rich.progress import Progress as Bar

_ENDING = (signal.SIGINT, signal.SIGTERM, *([signal.SIGHUP] if hasattr(signal, "SIGHUP") else []))
Progress = Callable[[int, int | None], None]
"""Called with (frames done, frames in all or None) after every frame."""


@contextmanager
def terminal_progress(*, lines: bool = False) -> Iterator[Progress]:
    """Yield a `Progress` that draws a bar on standard error, or does nothing if that is not a terminal.

    lines: prints a line "frame 3 of 48" for each frame instead, and "phase rendering" where one begins, for programs
    that read them. SIGINT, SIGTERM and SIGHUP end the run at the next frame at the latest. For the main thread.
    """
    with _pending_signals() as raise_pending, _bar(hidden=lines) as bar:
        yield _Terminal(raise_pending, bar, lines=lines)


class _Terminal:
    """A `Progress` that a run may tell the name of its phase. bar: of rich; None for lines, or nothing at all."""

    def __init__(self, raise_pending: Callable[[], None], bar: Bar | None, *, lines: bool) -> None:
        self._raise_pending, self._bar, self._lines = raise_pending, bar, lines
        self._task = None if bar is None else bar.add_task("frames", total=None)

    def __call__(self, done: int, total: int | None) -> None:
        self._raise_pending()
        self._print(f"frame {done} of {total or 'unknown'}")
        if self._bar is not None and self._task is not None:
            self._bar.update(self._task, completed=done, total=total)

    def phase(self, name: str) -> None:
        """Begin a phase of the run, with a bar of its own; those of earlier phases are gone."""
        self._print(f"phase {name}")
        if self._bar is not None and self._task is not None:
            self._bar.remove_task(self._task)
            self._task = self._bar.add_task(name, total=None)

    def _print(self, line: str) -> None:
        if self._lines:
            sys.stderr.write(f"{line}\n")
            sys.stderr.flush()


def begin_phase(progress: Progress | None, name: str) -> None:
    """Tell a `Progress` that a phase of the run begins, as "rendering", if it wants to know: if it has `phase`."""
    phase = getattr(progress, "phase", None)
    if phase is not None:
        phase(name)


def terminal_count(doing: str) -> Progress:
    """Return a `Progress` that keeps "doing: 3 of 48" on standard error where that is a terminal."""

    def tell(done: int, total: int | None) -> None:
        if sys.stderr.isatty():
            sys.stderr.write(f"\r{doing}: {done} of {total}" + "\n" * (done == total))
            sys.stderr.flush()

    return tell


@contextmanager
def _pending_signals() -> Iterator[Callable[[], None]]:
    """Yield a function that raises the exception of the handler of a signal that ends the run again.

    Python runs a handler wherever the main thread is. If that is a callback out of C code, the handler's exception is
    printed and dropped, and the run would continue.
    """
    raised: list[BaseException] = []

    def recording(handler: Callable[[int, FrameType | None], object]) -> Callable[[int, FrameType | None], None]:
        def handle(number: int, frame: FrameType | None) -> None:
            try:
                handler(number, frame)
            except BaseException as error:
                raised.append(error)
                raise

        return handle

    def raise_pending() -> None:
        if raised:
            raise raised[0]

    handlers = {number: signal.getsignal(number) for number in _ENDING}
    try:
        for number, handler in handlers.items():
            if callable(handler):  # not if the signal is ignored, as in a background job
                signal.signal(number, recording(handler))
        yield raise_pending
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)


def _bar(*, hidden: bool) -> AbstractContextManager[Bar | None]:
    """Return a bar on standard error: phase, frames, rate and time left; None where it is no terminal, or hidden."""
    if hidden or sys.stderr is None or not sys.stderr.isatty():
        return nullcontext()
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, ProgressColumn, Task, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar
    from rich.text import Text

    class Rate(ProgressColumn):
        def render(self, task: Task) -> Text:
            return Text(f"{task.speed:.1f} frames/s" if task.speed else "- frames/s")

    named = TextColumn("{task.description}")
    columns = (named, BarColumn(), MofNCompleteColumn(), Rate(), TimeRemainingColumn())
    return Bar(*columns, console=Console(stderr=True), transient=True)


class Steps:
    """Counts the steps of a run and passes them on; more may be expected as the run goes on. done: steps before it."""

    def __init__(self, progress: Progress | None, expected: int, done: int = 0) -> None:
        self._progress, self._done, self._expected = progress, done, expected

    def expect(self, count: int) -> None:
        """Expect that many more steps."""
        self._expected += count

    def done(self, count: int = 1) -> None:
        """Count steps as done."""
        self._done += count
        if self._progress is not None:
            self._progress(self._done, max(self._expected, self._done))


# --- Threads that work side by side ---------------------------------------------------------------------------------

# Threads and cores: bounded queues that let decoding, rendering and encoding run side by side in one process, and the
# cores that matrix products and other processes get.
#
# FFmpeg, numba and OpenCV release the interpreter lock, so threads are enough. What the renderer draws stays on the
# thread of the caller, to which its OpenGL context belongs. Memory is bounded by the depth of the queues.


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
