# SPDX-License-Identifier: Apache-2.0
"""The picture of a tab, the bar above it, and what is said about it."""

from __future__ import annotations

from nicegui import ui

from mr360uw.tune.session import Session
from mr360uw.tune.widgets import Choice, Text

_WIDTHS = (512, 1024, 2048, 4096, 8192)


class Stage:
    """The picture of a tab."""

    def __init__(self, session: Session) -> None:
        self._session = session
        with ui.element("main").classes("page-stage"):
            with ui.element("div").classes("stage-bar"):
                widths = sorted({*(w for w in _WIDTHS if w < session.clip.width), session.clip.width})
                self._width = Choice(
                    "Width of the full picture", {str(w): f"{w} px" for w in widths}, str(session.width),
                    lambda width: session.look(width=int(width)),
                )  # fmt: skip
                ui.element("span").classes("grow")
                self._status = Text("", classes="status").props("role=status")
            self._problems = ui.element("div")
            with ui.element("div").classes("stage-picture"):
                self._image = ui.element("img").props("alt=picture")

    def expect(self) -> None:
        """Mark the picture as older than the document."""
        self.follow()

    def show(self) -> None:
        """Show the newest picture, or why there is none."""
        picture = self._session.picture
        if picture is not None:
            self._image.props["src"] = f"/picture/{picture.number}"
        self._problems.clear()
        with self._problems:
            if self._session.problems:
                with ui.element("div").classes("problems").props("role=alert"):
                    for line in self._session.problems:
                        Text(line, "div")
        self.follow()

    def follow(self) -> None:
        """Show where in the clip the page is, and what the picture is of."""
        session, picture = self._session, self._session.picture
        words = [f"frame {session.index + 1} of {session.frame_count}", f"{session.time_s:.2f} s"]
        if picture is not None:
            words.append(f"{picture.width} x {picture.height}")
            words.append(f"{1000.0 * picture.seconds:.0f} ms")
        if session.behind:
            words.append("rendering")
        self._status.text = " · ".join(words)
        self._width.choose(str(session.width))
