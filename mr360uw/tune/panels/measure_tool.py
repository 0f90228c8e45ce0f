# SPDX-License-Identifier: Apache-2.0
"""The button that measures the clip's sun, gain and background, as a composite does before its first frame."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from nicegui import background_tasks

from mr360uw.errors import Mr360uwError
from mr360uw.tune.panels.widgets import Button
from mr360uw.tune.session import Session

_TITLE = "measure sun and veil over the whole clip, as a composite does; the picture then shows that light"


class _StoppedError(Exception):
    """Ends a pass over the clip."""


class MeasureTool:
    """The button of a tab; pressed again, it ends the pass. failed: tells an error."""

    def __init__(self, session: Session, failed: Callable[[Exception], None]) -> None:
        self._session, self._failed = session, failed
        self._running, self._stop = False, False
        self._button = Button("Measure clip", self._pressed, title=_TITLE)

    def _pressed(self) -> None:
        self._stop = self._running
        if not self._running:
            background_tasks.create(self._run(), name="measure clip")

    async def _run(self) -> None:
        loop = asyncio.get_running_loop()

        def progress(done: int, total: int | None) -> None:
            if self._stop:
                raise _StoppedError
            loop.call_soon_threadsafe(self._show, done, total)

        self._running = True
        self._show(0, None)
        try:
            await self._session.measure_clip(progress)
        except (Mr360uwError, OSError) as error:
            self._failed(error)
        except _StoppedError:
            pass  # as asked for
        finally:
            self._running = self._stop = False
            self._show(0, None)

    def _show(self, done: int, total: int | None) -> None:
        if not self._button.is_deleted:
            share = f" {100 * done // total} %" if total else " …"
            self._button.text = f"Measuring{share}, stop" if self._running else "Measure clip"
            self._button.press(self._running)
