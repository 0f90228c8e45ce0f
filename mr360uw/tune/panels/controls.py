# SPDX-License-Identifier: Apache-2.0
"""The panel of controls: descriptions to the browser, changes from it into the document."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

from nicegui.element import Element
from nicegui.events import GenericEventArguments

from mr360uw.scene.toml_model import toml_value
from mr360uw.tune.editing.document import Document
from mr360uw.tune.editing.fields import FIRST, Field, Group, groups


def control_spec(tables: tuple[Group, ...]) -> list[dict[str, Any]]:
    """Return tables and their fields as values of JSON, for controls.js."""
    return [
        {"key": group.key, "title": group.title, "help": group.help, "repeated": group.repeated,
         "optional": group.optional, "tag": group.tag,
         "kinds": {tag: [_plain(field) for field in group.fields(tag)] for tag in group.tags}}
        for group in tables
    ]  # fmt: skip


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
    """Controls of a document's parameters.

    mark: called with the dotted key of a parameter that is to be keyed. choose: called with a list's key and the number
    of its entry that is chosen. keyed: returns the present values of the parameters that have keys, by key; a change of
    one of those goes to `key_value` instead of the document.
    """

    def __init__(
        self,
        document: Document,
        *,
        mark: Callable[[str], None],
        choose: Callable[[str, int], None],
        keyed: Callable[[], dict[str, Any]],
        key_value: Callable[[str, Any, str | None], None],
        failed: Callable[[Exception], None],
        settle: Callable[[], None],
    ) -> None:
        super().__init__()
        self._document, self._keyed, self._key_value, self._failed = document, keyed, key_value, failed
        tables = groups()
        self._fields = {
            f"{group.key}.{field.key}": field for group in tables for tag in group.tags for field in group.fields(tag)
        }
        self._props["spec"] = control_spec(tables)
        self._props["first"] = list(FIRST)
        self.on("change", self._changed)
        self.on("reset", self._reset)
        self.on("add", self._added)
        self.on("remove", lambda event: self._try(lambda: document.unset(event.args["key"])))
        self.on("mark", lambda event: self._try(lambda: mark(event.args["key"])))
        self.on("choose", lambda event: choose(event.args["key"], event.args["number"]))
        self.on("settle", lambda _: settle())
        self._props["begin"] = self._state()

    def refresh(self) -> None:
        """Show the document's values."""
        self.run_method("take", self._state())

    def _state(self) -> dict[str, Any]:
        tree, texts = self._document.tree, {}
        for key, value in _leaves(tree):
            field = self._field(key)
            if field is not None and field.kind == "toml":
                texts[key] = toml_value(value)
        errors = {key: self._document.problem_of(key) for key in self._document.problem_keys()}
        return {"tree": _jsonable(tree), "texts": texts, "errors": errors, "keyed": self._keyed()}

    def default_of(self, key: str) -> Any:
        """Return the default of a parameter; None where it has none."""
        field = self._field(key)
        return None if field is None else field.default

    def _field(self, key: str) -> Field | None:
        return self._fields.get(".".join(part for part in key.split(".") if not part.isdecimal()))

    def _changed(self, event: GenericEventArguments) -> None:
        key, value, group = event.args["key"], event.args["value"], event.args["group"]
        field = self._field(key)
        if field is not None:
            value = typed(field, value)
        drag = None if group is None else f"{self.client.id} {key} {group}"
        if key in self._keyed():
            self._try(lambda: self._key_value(key, value, drag))
        else:
            self._try(lambda: self._set(key, value, drag))

    def _set(self, key: str, value: Any, group: str | None) -> None:
        with self._document.together(f"set {key}", group=group):
            self._document.set(key, value)

    def _reset(self, event: GenericEventArguments) -> None:
        field = self._field(event.args["key"])
        default = None if field is None else field.default_text or "..."
        self._try(lambda: self._document.unset(event.args["key"], default))

    def _added(self, event: GenericEventArguments) -> None:
        self._try(lambda: self._document.append(event.args["key"], event.args["table"]))

    def _try(self, action: Callable[[], object]) -> None:
        try:
            action()
        except (ValueError, OSError) as error:
            self._failed(error)
        self.refresh()  # also where nothing changed, so that the control shows the value that counts


def _plain(field: Field) -> dict[str, Any]:
    described = asdict(field)
    described["step"], described["default_text"] = field.step, field.default_text
    return {name: _jsonable(value) for name, value in described.items()}


def _jsonable(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _jsonable(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_jsonable(one) for one in value]
    return value if isinstance(value, bool | int | float | str) or value is None else str(value)


def _leaves(tree: Any, prefix: str = "", depth: int = 0) -> list[tuple[str, Any]]:
    """Return the keys of tables and of the entries of their top lists, with their values."""
    if isinstance(tree, dict) and depth < 2:
        return [leaf for key, value in tree.items() for leaf in _leaves(value, f"{prefix}{key}.", depth + 1)]
    if isinstance(tree, list) and depth == 1 and all(isinstance(entry, dict) for entry in tree):
        return [leaf for k, entry in enumerate(tree) for leaf in _leaves(entry, f"{prefix}{k}.", depth)]
    return [(prefix.removesuffix("."), tree)]
