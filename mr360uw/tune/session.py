# SPDX-License-Identifier: Apache-2.0
"""The state that all tabs of a tuning page share: document, time, view, newest picture."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, Protocol

from mr360uw.errors import ParameterError
from mr360uw.tune.composite_run import CompositeRun
from mr360uw.tune.document import Document
from mr360uw.tune.pictures import Picture, Pictures, Wanted

Event = Literal["document", "picture", "time", "run"]


class Clip(Protocol):
    """Length of a plate; a still has no frame count."""

    @property
    def frame_count(self) -> int | None:
        """Number of frames."""

    @property
    def frame_rate(self) -> Any:
        """Frames a second."""

    @property
    def width(self) -> int:
        """Of a frame [pixels]."""


class Session:
    """A document, where in its clip the page is, and how the picture is shown. For the thread of the event loop.

    pictures: makes the pictures; what it publishes goes to `take`. clip: of the plate. width: of full pictures
    [pixels]. backend: of the pictures and of runs. picture: the newest that could be made, of whatever state. problems:
    why the newest state has none. run: the last run of the whole clip.
    """

    def __init__(self, document: Document, pictures: Pictures, clip: Clip, width: int, backend: str = "auto") -> None:
        self.document, self.pictures, self.clip = document, pictures, clip
        self.width, self.backend = min(width, clip.width), backend
        self.run: CompositeRun | None = None
        self.index, self.view, self.playing = 0, "composite", False
        self.options: tuple[tuple[str, Any], ...] = ()
        self.picture: Picture | None = None
        self.problems: tuple[str, ...] = ()
        self._played_from = (0, 0.0)
        self._observers: list[Callable[[Event], None]] = []
        document.observe(self._document_changed)

    @property
    def frame_count(self) -> int:
        """Number of frames of the clip; 1 for a still."""
        return self.clip.frame_count or 1

    @property
    def time_s(self) -> float:
        """Time of the frame that is shown."""
        return self.index / float(self.clip.frame_rate)

    @property
    def behind(self) -> bool:
        """Whether the picture is not of the present state at full size."""
        newest = self.picture
        if newest is None or newest.draft:
            return True
        return newest.wanted != self._wanted(full=newest.wanted.full)

    def observe(self, callback: Callable[[Event], None]) -> Callable[[], None]:
        """Call a function after every change with its kind; return the function that ends it."""
        self._observers.append(callback)

        def end() -> None:
            if callback in self._observers:
                self._observers.remove(callback)

        return end

    def show(self) -> None:
        """Ask for a picture of the present state."""
        self.pictures.want(self._wanted(full=not self.playing))

    def seek(self, index: int) -> None:
        """Show another frame of the clip; the nearest there is."""
        index = min(max(index, 0), self.frame_count - 1)
        if index != self.index:
            self.index = index
            self._played_from = (index, time.monotonic())
            self.show()
            self._tell("time")

    def look(self, view: str | None = None, *, width: int | None = None, **options: Any) -> None:
        """Show another view, at another width of full pictures, or with other options of the view."""
        self.view = self.view if view is None else view
        self.width = self.width if width is None else min(width, self.clip.width)
        self.options = tuple(sorted({**dict(self.options), **options}.items()))
        self.show()
        self._tell("time")

    def play(self, playing: bool) -> None:
        """Start or stop playing: frames at the clip's times, as many of them as can be made."""
        if playing != self.playing:
            self.playing = playing and self.frame_count > 1
            self._played_from = (self.index, time.monotonic())
            self.show()
            self._tell("time")

    def start_run(self, out: Path) -> CompositeRun:
        """Return a new run to an output; raise `ParameterError` while another one is going on."""
        if self.run is not None and self.run.state == "running":
            raise ParameterError(f"render - a run is going on (got {self.run.out}) - wait for it, or cancel it")
        self.run = CompositeRun(out, lambda: self._tell("run"))
        self._tell("run")
        return self.run

    def take(self, picture: Picture) -> None:
        """Take a picture that was made."""
        if picture.problems:
            self.problems = picture.problems
            self.playing = False
        else:
            self.picture, self.problems = picture, ()
        self._tell("picture")
        if self.playing:
            start, began = self._played_from
            passed = int((time.monotonic() - began) * float(self.clip.frame_rate))
            following = (start + max(passed, 1)) % self.frame_count
            self.index = following if following != self.index else (self.index + 1) % self.frame_count
            self.show()
            self._tell("time")

    def _wanted(self, *, full: bool) -> Wanted:
        document = self.document
        return Wanted(document.scene, document.revision, self.index, self.view, self.width, full, self.options)

    def _document_changed(self) -> None:
        if self.picture is None or self.picture.wanted.revision != self.document.revision:
            self.show()
        self._tell("document")

    def _tell(self, event: Event) -> None:
        for callback in tuple(self._observers):
            callback(event)
