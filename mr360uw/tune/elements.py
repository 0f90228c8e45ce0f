# SPDX-License-Identifier: Apache-2.0
"""Elements of the tuning page: the browser's own buttons and lists, and the time line."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Literal

from nicegui import ui
from nicegui.element import Element
from nicegui.elements.mixins.text_element import TextElement
from nicegui.events import GenericEventArguments


class Text(TextElement):
    """Text in a tag of its own."""

    def __init__(self, text: str = "", tag: str = "span", classes: str = "") -> None:
        super().__init__(tag=tag, text=text)
        self.classes(classes)


class Button(TextElement):
    """A button. label: for readers of the screen, where the text is a sign. pressed: of one that stays in."""

    def __init__(
        self, text: str, action: Callable[[], Any] | None = None, *, label: str = "", title: str = "", classes: str = ""
    ) -> None:
        super().__init__(tag="button", text=text)
        self.classes(classes)
        self._props["type"] = "button"
        self.describe(label, title)
        if action is not None:
            self.on("click", lambda _: action())

    def describe(self, label: str = "", title: str = "") -> None:
        """Set the label and the hint."""
        self._props.update({name: text for name, text in (("aria-label", label), ("title", title)) if text})
        self.update()

    def enable(self, on: bool) -> None:
        """Enable or disable it."""
        self._props["disabled"] = not on
        self.update()

    def press(self, on: bool) -> None:
        """Show it as pressed or not."""
        self._props["aria-pressed"] = "true" if on else "false"
        self.update()


class Choice(Element):
    """A list of which one is chosen. options: text of each value."""

    def __init__(self, label: str, options: Mapping[str, str], value: str, action: Callable[[str], Any]) -> None:
        super().__init__("select")
        self._props["aria-label"] = label
        self._props["title"] = label
        self.on("change", self._changed, js_handler="(e) => emit(e.target.value)")
        self._action = action
        self._options: dict[str, str] = {}
        self.offer(options, value)

    def offer(self, options: Mapping[str, str], value: str) -> None:
        """Offer other options."""
        if dict(options) != self._options:
            self._options = dict(options)
            self.clear()
            with self:
                for name, text in options.items():
                    Text(text, "option").props["value"] = name
        self.choose(value)

    def _changed(self, event: GenericEventArguments) -> None:
        self.choose(str(event.args))  # what the browser shows already
        self._action(str(event.args))

    def choose(self, value: str) -> None:
        """Show another value as chosen."""
        self._props["value"] = value
        self.update()


def menu(text: str, title: str) -> ui.menu:
    """Return a menu below a new button, to be filled."""
    with Button(f"{text} ▾", title=title).props("aria-haspopup=menu"):
        return ui.menu().props("auto-close")


# Frames are counted from 0; a frame's time [s] is its number over the frame rate. The browser's side is timeline.js.
# How a value goes between keys is Python's to say: the curve that is drawn is made of samples that are given.

Interpolation = Literal["linear", "smooth", "hold"]


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

    def set_thumbnails(self, urls: Mapping[int, str]) -> None:
        """Set the pictures of the strip, URLs of this server by frame; each fills it half way to its neighbours."""
        self._props["thumbnails"] = [{"frame": frame, "url": url} for frame, url in urls.items()]
        self.update()

    def set_curve(self, curve: dict[str, Any] | None) -> None:
        """Show the keys of a parameter below the strip; None: none.

        curve: label, unit, keys: (time [s], value), ascending; interpolation; low, high: of the parameter's range, None
        where it has none; samples: (time [s], value), ascending and dense enough to be joined by straight lines.
        """
        self._set("curve", curve)

    # --- events

    def on_seek(self, handler: Callable[[int, bool], Any]) -> None:
        """Call a handler when the play head moves, at most 17 times a second and where it comes to rest.

        It gets the frame, and whether the head is on its way, dragged or playing, so that a draft will do.
        """
        self.on("seek", lambda event: handler(event.args["frame"], event.args["scrubbing"]))

    def on_play(self, handler: Callable[[bool], Any]) -> None:
        """Call a handler when playing begins (True) and ends; the element itself moves the head in real time."""
        self.on("play", lambda event: handler(event.args["playing"]))

    def on_range(self, handler: Callable[[int, int], Any]) -> None:
        """Call a handler with the new range, frames start:stop."""
        self.on("range", lambda event: handler(event.args["start"], event.args["stop"]))

    def on_keys(self, handler: Callable[[list[tuple[float, float]], Interpolation, bool], Any]) -> None:
        """Call a handler when keys are changed; it answers by `set_curve`, until then the curve is shown as old.

        It gets the keys as they are then, (time [s], value), ascending, each at a frame of its own, their
        interpolation, and whether the edit is done: not mid-drag.
        """

        def told(event: GenericEventArguments) -> Any:
            keys = [(float(t), float(v)) for t, v in event.args["keys"]]
            return handler(keys, event.args["interpolation"], event.args["done"])

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
