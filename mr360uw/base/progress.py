# SPDX-License-Identifier: Apache-2.0
"""Progress of a run: on a terminal (frames, rate, time left), with the signals that end it; counts of uneven steps."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from types import FrameType
from typing import TYPE_CHECKING

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
    """Counts the steps of a run and passes them on; more may be expected as the run goes on."""

    def __init__(self, progress: Progress | None, expected: int) -> None:
        self._progress, self._done, self._expected = progress, 0, expected

    def expect(self, count: int) -> None:
        """Expect that many more steps."""
        self._expected += count

    def done(self, count: int = 1) -> None:
        """Count steps as done."""
        self._done += count
        if self._progress is not None:
            self._progress(self._done, max(self._expected, self._done))
