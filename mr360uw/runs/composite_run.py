# SPDX-License-Identifier: Apache-2.0
"""A run of `mr360uw composite` beside the page: progress, time left, cancelling."""

from __future__ import annotations

import asyncio
import re
import signal
import sys
import time
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal

State = Literal["running", "done", "failed", "cancelled"]
_MESSAGE_LINES = 40
"""Last lines of a run's output that are kept for its message."""


class CompositeRun:
    """One run; `state` is "running" until it ends. changed: called after every change.

    done, total: frames. seconds_left: None before the first frame. message: what the command printed at its end.
    """

    def __init__(self, out: Path, changed: Callable[[], None]) -> None:
        self.out, self._changed = out, changed
        self.state: State = "running"
        self.done, self.total = 0, 0
        self.seconds_left: float | None = None
        self.message = ""
        self._process: asyncio.subprocess.Process | None = None
        self._cancelled = False
        self._first: tuple[int, float] | None = None

    async def run(self, scene: Path, options: Sequence[str] = ()) -> None:
        """Run the command on a scene file to its end; a run that was stopped goes on, as the command does."""
        command = ["composite", str(scene), str(self.out), "--progress-lines", *options]
        self._process = await asyncio.create_subprocess_exec(
            sys.executable, "-m", "mr360uw", *command, stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.STDOUT, start_new_session=True,
        )  # fmt: skip
        assert self._process.stdout is not None
        said: deque[str] = deque(maxlen=_MESSAGE_LINES)
        async for data in self._process.stdout:
            line = data.decode(errors="replace").rstrip()
            counted = re.fullmatch(r"frame (\d+) of (\d+|unknown)", line)
            if counted is None:
                said.append(line)
            else:
                self._count(int(counted[1]), 0 if counted[2] == "unknown" else int(counted[2]))
        code = await self._process.wait()
        self.message = "\n".join(said)
        self.state = "done" if code == 0 else "cancelled" if self._cancelled else "failed"
        self._changed()

    def cancel(self) -> None:
        """End the run as Ctrl+C does: its finished parts stay, the next run to the same output goes on from them."""
        if self._process is not None and self._process.returncode is None:
            self._cancelled = True
            if sys.platform == "win32":
                self._process.terminate()
            else:
                self._process.send_signal(signal.SIGINT)

    def _count(self, done: int, total: int) -> None:
        now = time.monotonic()
        if self._first is None or done < self._first[0] or total != self.total:  # a first pass counts its own frames
            self._first = (done, now)
        self.done, self.total = done, total
        start, began = self._first
        self.seconds_left = (now - began) / (done - start) * (total - done) if done > start and total else None
        self._changed()
