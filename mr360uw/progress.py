# SPDX-License-Identifier: Apache-2.0
"""Progress of a run, on a terminal: frames, rate and time left; and the signals that end one."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

Progress = Callable[[int, int | None], None]
"""Called with (frames done, frames in all or None) after every frame."""


@contextmanager
def terminal_progress() -> Iterator[Progress]:
    """Yield a `Progress` that draws a bar on standard error, or nothing where that is not a terminal.

    A signal that was to end the run ends it at the next frame at the latest. For the main thread.
    """
    with _kept_signals() as stop_if_told, _bar() as draw:

        def progress(done: int, total: int | None) -> None:
            stop_if_told()
            draw(done, total)

        yield progress


@contextmanager
def _kept_signals() -> Iterator[Callable[[], None]]:
    """Yield a call that raises again what the handler of SIGINT or SIGTERM raised within the block.

    Python runs a handler wherever the main thread is. Where that is a callback out of C code, what the handler raises
    is printed and dropped, and the run would go on.
    """
    raised: list[BaseException] = []

    def keeping(handler: Callable[[int, FrameType | None], object]) -> Callable[[int, FrameType | None], None]:
        def handle(number: int, frame: FrameType | None) -> None:
            try:
                handler(number, frame)
            except BaseException as error:
                raised.append(error)
                raise

        return handle

    def stop_if_told() -> None:
        if raised:
            raise raised[0]

    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        for number, handler in handlers.items():
            if callable(handler):  # not where the signal is ignored, as of a program in the background
                signal.signal(number, keeping(handler))
        yield stop_if_told
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)


@contextmanager
def _bar() -> Iterator[Progress]:
    if not sys.stderr.isatty():
        yield lambda done, total: None  # noqa: ARG005 - the signature of Progress
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, ProgressColumn, Task, TimeRemainingColumn
    from rich.progress import Progress as Bar
    from rich.text import Text

    class Rate(ProgressColumn):
        def render(self, task: Task) -> Text:
            return Text(f"{task.speed:.1f} frames/s" if task.speed else "- frames/s")

    columns = (BarColumn(), MofNCompleteColumn(), Rate(), TimeRemainingColumn())
    with Bar(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("frames", total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)
