# SPDX-License-Identifier: Apache-2.0
"""The tuning page: header, controls, picture and time line of one tab, joined to the session."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

from nicegui import background_tasks, ui

from mr360uw.errors import Mr360uwError, OutputExistsError
from mr360uw.tune.editing import tracks
from mr360uw.tune.panels.controls import ControlPanel
from mr360uw.tune.panels.depth_tool import DepthTool
from mr360uw.tune.panels.header import Header
from mr360uw.tune.panels.match_dialog import MatchDialog
from mr360uw.tune.panels.place_tools import PlaceTools
from mr360uw.tune.panels.render_dialog import RenderDialog
from mr360uw.tune.panels.stage import ShownPicture
from mr360uw.tune.panels.time_panel import TimePanel
from mr360uw.tune.panels.widgets import Button
from mr360uw.tune.session import Event, Session

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


def build_page(session: Session) -> None:
    """Build the page of one tab and keep it in step with the session until the tab is closed."""
    ui.add_head_html('<link rel="stylesheet" href="/tune/page.css"><script src="/tune/page.js" defer></script>')
    TunePage(session)


class TunePage:
    """One tab."""

    def __init__(self, session: Session) -> None:
        self.session, self.document, self._begun = session, session.document, False
        self.client = ui.context.client
        with ui.element("div").classes("page") as self.root:
            self.header = Header(session, self.guarded, self.save)
            with ui.element("div").classes("page-controls"):
                self.controls = ControlPanel(
                    session.document, mark=self._mark, choose=self._choose, keyed=self._keyed,
                    key_value=self._key_value, in_words=self._in_words, failed=self.failed, settle=session.settle,
                )  # fmt: skip
            self.stage = ShownPicture(session, self.failed)
            self.render = RenderDialog(session, self.guarded)
            self.match = MatchDialog(session, self.guarded)
            with self.header.tools:
                Button("Match caustics", self.match.caustics, title="fit the sea to the caustics on the plate's floor")
                MeasureTool(session, self.failed)
                DepthTool(session, self.failed)
                Button("Render …", self.render.open, title="composite the whole clip")
            self.place = PlaceTools(session, self.stage, self.failed, self.match.water, self.controls.show_words)
            self.time = TimePanel(session, self.guarded)
        ui.on("tune", lambda event: self._pressed(str(event.args)))
        self.client.on_delete(session.observe(self._follow))
        self._follow("document")
        self._follow("picture")
        self._follow("time")
        self._follow("thumbnails")

    def guarded(self, action: Callable[[], Any]) -> None:
        """Run an action of the user; tell its error."""
        try:
            action()
        except (Mr360uwError, OSError) as error:
            self.failed(error)

    def failed(self, error: Exception) -> None:
        """Tell an error."""
        with self.root:
            ui.notify(str(error), type="negative", multi_line=True, timeout=8000, close_button="Close")

    def save(self) -> None:
        """Save the document; ask first where the file was changed meanwhile."""
        try:
            self.document.save()
        except OutputExistsError:
            self.header.ask_overwrite()
        except (Mr360uwError, OSError) as error:
            self.failed(error)

    def _follow(self, event: Event) -> None:
        if event == "document":
            self.controls.refresh()
            self.header.refresh()
            self.stage.expect()
            self.render.refresh()
            self.time.refresh()
            self.place.refresh()
        elif event == "picture":
            self.stage.show()
            if not self._begun and self.session.picture is not None:
                self._begun = True
                self.place.refresh()
                self.time.begin()
        elif event == "time":
            self.stage.expect()
            self.time.follow()
            self.place.refresh()
            self.controls.refresh()
        elif event == "thumbnails":
            self.time.show_thumbnails()
        else:
            self.render.refresh()

    def _pressed(self, name: str) -> None:
        session = self.session
        actions: dict[str, Callable[[], Any]] = {
            "save": self.save, "undo": self.document.undo, "redo": self.document.redo, "play": self.time.play,
            "back": lambda: session.seek(session.index - 1), "forward": lambda: session.seek(session.index + 1),
            "start": lambda: session.seek(session.range[0]), "end": lambda: session.seek(session.range[1] - 1),
            "darker": lambda: self.place.trim(-1), "brighter": lambda: self.place.trim(1),
        }  # fmt: skip
        if name in actions:
            self.guarded(actions[name])

    def _keyed(self) -> dict[str, Any]:
        return tracks.values_at(self.document, self.session.time_s)

    def _mark(self, key: str) -> None:
        self.guarded(lambda: self.time.mark(key, self.controls.default_of(key)))

    def _key_value(self, key: str, value: Any, group: str | None) -> None:
        tracks.set_key(self.document, key, self.session.time_s, value, group=group)

    def _in_words(self, number: int, name: str, value: Any, group: str | None) -> bool:
        return self.place.set_word(number, name, value, group)

    def _choose(self, key: str, number: int) -> None:
        if key == "object":
            self.place.select(number)
