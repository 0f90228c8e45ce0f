# SPDX-License-Identifier: Apache-2.0
"""Small elements of the tuning page: the browser's own buttons and lists."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

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
