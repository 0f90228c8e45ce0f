# SPDX-License-Identifier: Apache-2.0
"""The time line: an element of the tuning page with thumbnails, a play head, a range, and the keys of one parameter.

Frames are counted from 0; a frame's time [s] is its number over the frame rate. The browser's side is timeline.js. How
a value goes between keys is Python's to say: the curve that is drawn is made of samples that are given.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

from nicegui.element import Element
from nicegui.events import GenericEventArguments

Interpolation = Literal["linear", "smooth", "hold"]


@dataclass(frozen=True, slots=True)
class Thumbnail:
    """A small picture of a frame, at a URL of this server."""

    frame: int
    url: str


@dataclass(frozen=True, slots=True)
class ParameterKeys:
    """The keys of one parameter. keys: (time [s], value), ascending. low, high: of its range, None where it has none.

    samples: (time [s], value) of the curve, ascending and dense enough to be joined by straight lines.
    """

    label: str
    unit: str
    keys: tuple[tuple[float, float], ...]
    samples: tuple[tuple[float, float], ...]
    interpolation: Interpolation = "linear"
    low: float | None = None
    high: float | None = None


@dataclass(frozen=True, slots=True)
class Seek:
    """The play head is at a frame. scrubbing: it is on its way, dragged or playing, and a draft will do."""

    frame: int
    time_s: float
    scrubbing: bool


@dataclass(frozen=True, slots=True)
class KeyEdit:
    """Keys as they are after an edit: (time [s], value), ascending, each at a frame of its own. done: not mid-drag."""

    keys: tuple[tuple[float, float], ...]
    interpolation: Interpolation
    done: bool


class Timeline(Element, component="timeline.js", esm={"mr360uw-tune": "js"}):
    """The time of a clip of `count` frames at `rate` frames a second."""

    def __init__(self, count: int, rate: float) -> None:
        super().__init__()
        self._serial, self._heard = 0, 0
        self._props.update({"count": count, "rate": rate, "thumbnails": [], "curve": None})
        self.set_frame(0)
        self.set_range(0, count)
        self.classes("w-full")
        for name in ("seek", "range", "keys"):
            self.on(name, self._hear)

    def set_frame(self, frame: int) -> None:
        """Move the play head, without an event."""
        self._set("at", {"frame": frame})

    def set_range(self, start: int, stop: int) -> None:
        """Set the in and the out point, frames start:stop, without an event."""
        self._set("range", {"start": start, "stop": stop})

    def set_thumbnails(self, thumbnails: Sequence[Thumbnail]) -> None:
        """Set the pictures of the strip, any number of them; each fills the strip up to half way to its neighbours."""
        self._props["thumbnails"] = [asdict(one) for one in thumbnails]
        self.update()

    def set_curve(self, curve: ParameterKeys | None) -> None:
        """Show the keys of a parameter below the strip; None: none."""
        self._set("curve", None if curve is None else asdict(curve))

    # --- events

    def on_seek(self, handler: Callable[[Seek], Any]) -> None:
        """Call a handler when the play head moves, at most 17 times a second and where it comes to rest."""

        def told(event: GenericEventArguments) -> Any:
            a = event.args
            return handler(Seek(a["frame"], a["time_s"], a["scrubbing"]))

        self.on("seek", told)

    def on_play(self, handler: Callable[[bool], Any]) -> None:
        """Call a handler when playing begins (True) and ends; the element itself moves the head in real time."""
        self.on("play", lambda event: handler(event.args["playing"]))

    def on_range(self, handler: Callable[[int, int], Any]) -> None:
        """Call a handler with the new range, frames start:stop."""
        self.on("range", lambda event: handler(event.args["start"], event.args["stop"]))

    def on_keys(self, handler: Callable[[KeyEdit], Any]) -> None:
        """Call a handler when keys are changed; it answers by `set_curve`, until then the curve is shown as old."""

        def told(event: GenericEventArguments) -> Any:
            keys = tuple((float(t), float(v)) for t, v in event.args["keys"])
            return handler(KeyEdit(keys, event.args["interpolation"], event.args["done"]))

        self.on("keys", told)

    def _set(self, name: str, value: dict[str, Any] | None) -> None:
        """Send a value, numbered: an update sends all values again, and only new ones count.

        It also says what was heard of last: the browser leaves out what does not know of its newest event yet.
        """
        self._serial += 1
        self._props[name] = None if value is None else {**value, "serial": self._serial, "after": self._heard}
        self.update()

    def _hear(self, event: GenericEventArguments) -> None:
        self._heard = max(self._heard, event.args["number"])
