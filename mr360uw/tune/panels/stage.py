# SPDX-License-Identifier: Apache-2.0
"""The picture of a tab, the bar above it, and what is said about it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from nicegui import background_tasks, ui

from mr360uw.tune.panels.widgets import Choice, Text
from mr360uw.tune.session import Session
from mr360uw.tune.situation import SNAPSHOT, Compare, Viewer

_WIDTHS = (512, 1024, 2048, 4096, 8192)
_COMPARISONS = {"": "compare with …", "plate": "compare with the plate"}


class ShownPicture:
    """The picture of a tab. failed: tells an error. tools, tool_bars: of the bars above it, to be filled."""

    def __init__(self, session: Session, failed: Callable[[Exception], None]) -> None:
        self._session, self._failed = session, failed
        self._shown_number = 0
        self._other: tuple[object, ...] = ()
        self._compared = ""
        with ui.element("main").classes("page-stage"):
            with ui.element("div").classes("stage-bar"):
                self._views = Choice("What is shown", session.views, session.view, session.look)
                widths = sorted({*(w for w in _WIDTHS if w < session.clip.width), session.clip.width})
                self._width = Choice(
                    "Width of the full picture", {str(w): f"{w} px" for w in widths}, str(session.width),
                    lambda width: session.look(width=int(width)),
                )  # fmt: skip
                self._comparison = Choice("Compare with", _COMPARISONS, "", self._compare)
                self.tools = ui.element("span").classes("stage-tools")
            with ui.element("div").classes("stage-bar"):
                self.tool_bars = ui.element("span").classes("stage-tools")
                ui.element("span").classes("grow")
                self._status = Text("", classes="status").props("role=status")
            self._problems = ui.element("div")
            with ui.element("div").classes("stage-picture"):
                self.viewer = Viewer()
        self.viewer.on_compare(self._follow_viewer)

    def expect(self) -> None:
        """Mark the picture as older than the document."""
        if self._session.behind:
            self.viewer.expect()
        self._offer()
        self.follow()

    def show(self) -> None:
        """Show the newest picture, or why there is none."""
        session, picture = self._session, self._session.picture
        if picture is not None and picture.number != self._shown_number:
            self._shown_number = picture.number
            if self._compared:  # what is no panorama is shown alone
                self.viewer.set_compare("wipe" if picture.panorama else "none")
            self.viewer.show(
                f"/picture/{picture.number}", stale=not session.is_present(picture), coarse=picture.draft,
                stand_in=picture.stand_in, panorama=picture.panorama, name=session.views[picture.wanted.view],
            )  # fmt: skip
        self._problems.clear()
        with self._problems:
            if session.problems:
                with ui.element("div").classes("problems").props("role=alert"):
                    for line in session.problems:
                        Text(line, "div")
        self.follow()
        if self._compared == "plate":
            self._compare("plate")

    def follow(self) -> None:
        """Show where in the clip the page is, and what the picture is of."""
        session, picture = self._session, self._session.picture
        words = []
        if picture is not None:
            words += ["light of the clip"] if picture.measured else []
            words.append(f"{picture.width} x {picture.height}, {1000.0 * picture.seconds:.0f} ms")
        if session.behind:
            words.append("rendering")
        self._status.text = " · ".join(words)
        self._width.choose(str(session.width))
        self._views.choose(session.view)

    def _offer(self) -> None:
        """Offer the pictures that there are to compare with; choose the one that is compared with."""
        session = self._session
        names = [name for name in session.document.snapshots if name in session.kept_pictures]
        names += [SNAPSHOT] if self._compared == SNAPSHOT else []
        if self._compared not in (*names, *_COMPARISONS):  # it was forgotten
            self._compared = ""
            self.viewer.set_compare("none")
        self._comparison.offer(_COMPARISONS | {name: f"compare with {name}" for name in names}, self._compared)

    def _follow_viewer(self, comparison: Compare, second: str) -> None:
        """Choose in the list what the viewer's own buttons compare with."""
        self._compared = "" if comparison == "none" else second
        self._offer()

    def _compare(self, name: str) -> None:
        """Set the second picture, and show it beside a divider if it is chosen for the first time."""
        begins, self._compared = name != self._compared, name
        if not name:
            self.viewer.set_compare("none")
            return
        if begins:
            self.viewer.set_compare("wipe")
        session = self._session
        if name in session.kept_pictures:
            self.viewer.show_other(f"/picture/{session.kept_pictures[name]}", name)
            return
        wanted = (session.document.scene.plate, session.index, session.width)
        if begins or wanted != self._other:
            self._other = wanted
            background_tasks.create(self._show_plate(), name="plate")

    async def _show_plate(self) -> None:
        session = self._session
        scene, index, width = session.document.scene, session.index, session.width
        try:
            data: bytes = await asyncio.wrap_future(
                session.pictures.ask(lambda renderer: renderer.plate(scene, index, width))
            )
        except Exception as error:  # noqa: BLE001 - told to the user
            self._failed(error)
            return
        if self._compared == "plate":
            self.viewer.show_other(f"/picture/{session.replaced('plate', data)}", "plate")
