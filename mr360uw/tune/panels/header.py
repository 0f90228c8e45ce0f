# SPDX-License-Identifier: Apache-2.0
"""The page's header: file, unsaved mark, undo, redo, save, presets, snapshots, dark or light."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from types import MappingProxyType
from typing import Any

from nicegui import ui

from mr360uw.tune.panels.widgets import Button, Choice, Text, menu
from mr360uw.tune.session import Session

PRESETS: MappingProxyType[str, MappingProxyType[str, Any]] = MappingProxyType(
    {
        "tropical noon": MappingProxyType(
            {"water.type": "IB", "water.visibility_m": None, "sea.wind_speed": 4.0, "caustics.enabled": True,
             "caustics.sun_half_angle_rad": 0.00465}
        ),
        "tropical, evening": MappingProxyType(
            {"water.type": "IB", "water.visibility_m": None, "sea.wind_speed": 2.0, "caustics.enabled": True,
             "caustics.sun_half_angle_rad": 0.02}
        ),
        "temperate overcast": MappingProxyType(
            {"water.type": "1C", "water.visibility_m": None, "sea.wind_speed": 7.0, "caustics.enabled": False}
        ),
        "harbour": MappingProxyType(
            {"water.type": "harbour", "water.visibility_m": None, "sea.wind_speed": 2.0, "caustics.enabled": False}
        ),
    }
)  # fmt: skip
"""Values of dotted keys, by the preset's name; None: as it is by default."""


_MODES: dict[str, bool | None] = {"auto": None, "dark": True, "light": False}


class Header:
    """The header of a tab. guarded: runs an action and tells its error. save: saves the document."""

    def __init__(
        self, session: Session, guarded: Callable[[Callable[[], Any]], None], save: Callable[[], None]
    ) -> None:
        self._session, self._document, self._guarded = session, session.document, guarded
        document = session.document
        with ui.element("header").classes("page-header") as self.root:
            Text(document.path.name, "h1").props["title"] = str(document.path.resolve())
            self._unsaved = Text("", classes="muted unsaved").props("role=status")
            self._undo = Button("↶ Undo", lambda: guarded(document.undo))
            self._redo = Button("↷ Redo", lambda: guarded(document.redo))
            Button("Save", save, title="save the scene file (Ctrl+S)", classes="primary")
            with menu("Presets", "values that suit one kind of dive"):
                for name, values in PRESETS.items():
                    ui.menu_item(name, partial(guarded, partial(document.apply, f"preset {name}", values)))
            self._snapshots = menu("Snapshots", "states kept while the page is open")
            self.tools = ui.element("span").classes("header-tools")
            ui.element("span").classes("grow")
            dark = ui.dark_mode(None)

            def show(mode: str) -> None:
                dark.set_value(_MODES[mode])
                if mode != "auto":
                    session.look(dark=mode == "dark")

            Choice(
                "Dark or light", {"auto": "Auto", "dark": "Dark", "light": "Light"}, "auto",
                show,
            )  # fmt: skip
        self._notices = ui.element("div").classes("page-notices")
        self._shown: tuple[object, ...] = ()

    def refresh(self) -> None:
        """Show the document's state."""
        document = self._document
        self._unsaved.text = "● unsaved" if document.dirty else "saved"
        for button, word, label in (
            (self._undo, "undo", document.undo_label),
            (self._redo, "redo", document.redo_label),
        ):
            button.enable(label is not None)
            button.describe(title=f"{word}: {label}" if label else f"nothing to {word}")
        state = (document.snapshots, document.problems, document.outside)
        if state != self._shown:
            self._shown = state
            self._show_snapshots()
            self._show_notices()

    def ask_overwrite(self) -> None:
        """Point to the notice that asks what is to be done about a file that was changed meanwhile."""
        with self.root:
            ui.notify("The file was changed by another program: choose above which text counts.", type="warning")

    def _show_snapshots(self) -> None:
        self._snapshots.clear()
        with self._snapshots:
            ui.menu_item("Keep the present state", self._keep)
            for name, text in self._document.snapshots.items():
                back = partial(self._document.replace, f"back to {name}", text)
                ui.separator()
                ui.menu_item(f"Back to {name}", partial(self._guarded, back))
                ui.menu_item(f"Forget {name}", partial(self._document.forget, name))

    def _keep(self) -> None:
        taken = self._document.snapshots
        number = next(k for k in range(1, len(taken) + 2) if f"snapshot {k}" not in taken)
        self._session.keep_picture(f"snapshot {number}")
        self._document.keep(f"snapshot {number}")

    def _show_notices(self) -> None:
        document, self_guarded = self._document, self._guarded
        self._notices.clear()
        with self._notices:
            if document.outside is not None:
                with ui.element("div").classes("notice").props("role=alert"):
                    Text("The scene file was changed by another program.")
                    Button("Take its text", lambda: self_guarded(document.take_outside))
                    Button("Overwrite it with mine", lambda: self_guarded(lambda: document.save(overwrite=True)))
            if document.problems:
                with ui.element("div").classes("problems").props("role=alert"):
                    for line in document.problems:
                        Text(line, "div")
