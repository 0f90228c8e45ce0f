# SPDX-License-Identifier: Apache-2.0
"""Controls of the tuning page: buttons and lists, the time line, and the panel of all parameters."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Literal

from nicegui import ui
from nicegui.element import Element
from nicegui.elements.mixins.text_element import TextElement
from nicegui.events import GenericEventArguments
from pydantic_core import to_jsonable_python

from mr360uw.errors import Mr360uwError
from mr360uw.scene.toml_model import toml_value
from mr360uw.tune import fields
from mr360uw.tune.fields import Field
from mr360uw.tune.session import Session

TOLD = (Mr360uwError, ValueError, OSError)
"""Errors that a tab tells whoever asked for something; of others the terminal has the details."""


def tell_error(error: Exception) -> None:
    """Show an error in the present tab."""
    if isinstance(error, TOLD):
        ui.notify(str(error), type="negative", multi_line=True, timeout=8000, close_button="Close")


class Text(TextElement):
    """Text in a tag of its own."""

    def __init__(self, text: str = "", tag: str = "span", classes: str = "") -> None:
        super().__init__(tag=tag, text=text)
        self.classes(classes)


def alert(lines: Sequence[str]) -> None:
    """Show problems, a line each."""
    with ui.element("div").classes("problems").props("role=alert"):
        for line in lines:
            Text(line, "div")


class Button(TextElement):
    """A button. title: its hint."""

    def __init__(
        self, text: str, action: Callable[[], Any] | None = None, *, title: str = "", classes: str = ""
    ) -> None:
        super().__init__(tag="button", text=text)
        self.classes(classes)
        self._props["type"] = "button"
        if title:
            self.describe(title)
        if action is not None:
            self.on("click", lambda _: action())

    def describe(self, title: str) -> None:
        """Set the hint."""
        self._props["title"] = title
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


def text_input(props: str, action: Callable[[str], Any]) -> Element:
    """Return a field for a line of text. action: called with the text when it was changed."""
    field = ui.element("input").props(f"type=text {props}")
    return field.on("change", lambda event: action(str(event.args)), js_handler="(e) => emit(e.target.value)")


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
        self._props.update({"count": count, "rate": rate, "thumbnails": [], "played": [], "curve": None})
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

    def set_played(self, frames: Sequence[int]) -> None:
        """Set the frames, ascending, that are shown at once; while playing, the head waits for others."""
        ends = [k for k in range(len(frames)) if k + 1 == len(frames) or frames[k + 1] != frames[k] + 1]
        starts = [0, *(k + 1 for k in ends[:-1])]
        parts = [[frames[a], frames[b] + 1] for a, b in zip(starts, ends, strict=False)]
        if parts != self._props["played"]:
            self._props["played"] = parts
            self.update()

    def set_curve(self, curve: dict[str, Any] | None) -> None:
        """Show the keys of a parameter below the strip; None: none.

        curve: label, unit, keys: (time [s], value), ascending; interpolation; low, high: of the parameter's range, None
        where it has none; samples: (time [s], value), ascending and dense enough to be joined by straight lines.
        """
        self._set("curve", curve)

    # --- events

    def on_seek(self, handler: Callable[[int, str], Any]) -> None:
        """Call a handler when the play head moves; dragged, at most 17 times a second and where it comes to rest.

        It gets the frame, and how the head moves: "scrub", dragged, so that a draft will do; "play"; or "", set.
        """
        self.on("seek", lambda event: handler(event.args["frame"], event.args["how"]))

    def on_play(self, handler: Callable[[bool], Any]) -> None:
        """Call a handler when playing begins (True) and ends; the element itself moves the head, see `set_played`."""
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


def typed(field: Field, value: Any) -> Any:
    """Return what a control sent as a value of the scene file; numbers that JSON made whole are floats again."""
    if field.kind == "toml":
        try:
            return tomllib.loads(f"value = {value}")["value"]
        except (ValueError, RecursionError):
            return str(value)
    if field.kind == "number" and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if field.kind in ("vector", "colour") and isinstance(value, list):
        return [float(part) if isinstance(part, int) else part for part in value]
    return value


class ControlPanel(Element, component="controls.js"):
    """Controls of the parameters of a session's document; of those that have keys, of their present values.

    mark: called with the dotted key of a parameter that is to be keyed, and its default. choose: called with a list's
    key and the number of its entry that is chosen. in_words: called with an object's number, the word, its value and
    the group of a drag; sets it and returns whether it did, where others had to change with it.
    """

    def __init__(
        self,
        session: Session,
        *,
        mark: Callable[[str, Any], None],
        choose: Callable[[str, int], None],
        in_words: Callable[[int, str, Any, str | None], bool],
    ) -> None:
        super().__init__()
        self._in_words, self._words, self._chosen = in_words, dict[str, Any](), 0
        self._session, self._document = session, session.document
        document, tables = session.document, fields.groups()
        self._fields = fields.by_key(tables)
        self._props["spec"] = to_jsonable_python(tables, fallback=str)
        self._props["first"] = list(fields.FIRST)
        self.on("change", self._changed)
        self.on("reset", self._reset)
        self.on("add", lambda event: self._try(lambda: document.append(event.args["key"], event.args["table"])))
        self.on("remove", lambda event: self._try(lambda: document.unset(event.args["key"])))
        self.on("mark", lambda event: self._try(lambda: mark(event.args["key"], self._default_of(event.args["key"]))))
        self.on("choose", lambda event: choose(event.args["key"], event.args["number"]))
        self.on("settle", lambda _: session.pictures.settle())
        self._props["begin"] = self._state()

    def refresh(self) -> None:
        """Show the document's values."""
        self.run_method("take", self._state())

    def show_words(self, words: dict[str, Any], chosen: int) -> None:
        """Show the present places and sizes of objects, by dotted key, in whichever words the file has them, and the
        chosen object.
        """
        if (words, chosen) != (self._words, self._chosen):
            self._words, self._chosen = words, chosen
            self.refresh()

    def _state(self) -> dict[str, Any]:
        tree, texts = self._document.tree, {}
        for key, value in _leaves(tree):
            field = self._field(key)
            if field is not None and field.kind == "toml":
                texts[key] = toml_value(value)
        objects = tree.get("object", [])
        hidden = [f"object.{k}.{word}" for k, table in enumerate(objects) for word in fields.unsaid(table)]
        plain, keyed = to_jsonable_python(tree, fallback=str), fields.values_at(self._document, self._session.time_s)
        return {"tree": plain, "texts": texts, "errors": self._document.problems_by_key, "keyed": keyed,
                "words": self._words, "chosen": self._chosen, "hidden": hidden,
                "idle": self._idle(len(objects))}  # fmt: skip

    def _idle(self, objects: int) -> dict[str, str]:
        """Return why parameters have no effect, by dotted key."""
        found = {}
        for key in self._fields:
            table, _, name = key.partition(".")
            for at in [f"{table}.{k}.{name}" for k in range(objects)] if table == "object" else [key]:
                other = fields.without_effect(key, partial(self._now, beside=at))
                if other:
                    now, label = self._now(other, at)[0], self._fields[other].label
                    found[at] = f"No effect while {label[0].lower() + label[1:]} is {_word(now)}"
        return found

    def _now(self, key: str, beside: str) -> tuple[Any, Any]:
        """Return the present value and the default of a parameter without numbers, of the entry of one beside it."""
        table, _, name = key.partition(".")
        place = f"{beside.rpartition('.')[0]}.{name}" if beside.startswith(f"{table}.") else key
        default, value = self._fields[key].default, self._document.get(place)
        return default if value is None else value, default

    def _default_of(self, key: str) -> Any:
        """Return the default of a parameter; None where it has none."""
        field = self._field(key)
        return None if field is None else field.default

    def _field(self, key: str) -> Field | None:
        return self._fields.get(fields.without_numbers(key))

    def _changed(self, event: GenericEventArguments) -> None:
        key, value, group = event.args["key"], event.args["value"], event.args["group"]
        field = self._field(key)
        if field is not None:
            value = typed(field, value)
        drag = None if group is None else f"{self.client.id} {key} {group}"
        self._try(lambda: self._set(key, value, drag))

    def _set(self, key: str, value: Any, group: str | None) -> None:
        if key in fields.keyed_parameters(self._document):
            fields.set_key(self._document, key, self._session.time_s, value, group=group)
            return
        table, _, rest = key.partition(".")
        number, _, name = rest.partition(".")
        if table == "object" and number.isdecimal() and self._in_words(int(number), name, value, group):
            return
        along = fields.set_along(key, partial(self._now, beside=key)) if key in self._fields else {}
        self._document.apply(f"set {key}", along | {key: value}, group=group)

    def _reset(self, event: GenericEventArguments) -> None:
        field = self._field(event.args["key"])
        default = None if field is None else field.default_text or "..."
        self._try(lambda: self._document.unset(event.args["key"], default))

    def _try(self, action: Callable[[], object]) -> None:
        try:
            action()
        finally:
            self.refresh()  # also where nothing changed, so that the control shows the value that counts


def _word(value: Any) -> str:
    if isinstance(value, bool) or value is None:
        return {None: "not set", True: "on", False: "off"}[value]
    return f"{value:g}" if isinstance(value, float) else str(value)


def _leaves(tree: Any, prefix: str = "", depth: int = 0) -> list[tuple[str, Any]]:
    """Return the keys of tables and of the entries of their top lists, with their values."""
    if isinstance(tree, dict) and depth < 2:
        return [leaf for key, value in tree.items() for leaf in _leaves(value, f"{prefix}{key}.", depth + 1)]
    if isinstance(tree, list) and depth == 1 and all(isinstance(entry, dict) for entry in tree):
        return [leaf for k, entry in enumerate(tree) for leaf in _leaves(entry, f"{prefix}{k}.", depth)]
    return [(prefix.removesuffix("."), tree)]
