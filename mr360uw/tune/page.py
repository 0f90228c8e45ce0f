# SPDX-License-Identifier: Apache-2.0
"""The tuning page: header, controls, picture and time line of one tab, joined to the session."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from nicegui import background_tasks, ui

from mr360uw.base.parameters import bounds_of, stated
from mr360uw.errors import OutputExistsError
from mr360uw.scene.key_targets import target_of
from mr360uw.tune import fields
from mr360uw.tune.controls import Button, Choice, ControlPanel, Interpolation, Text, Timeline, alert, menu, tell_error
from mr360uw.tune.dialogs import MATCH_CAUSTICS, DepthTool, MatchDialog, RenderDialog
from mr360uw.tune.place_tools import PlaceTools, ShownPicture
from mr360uw.tune.session import Event, Session


class TunePage:
    """The page of one tab, which is in step with the session until the tab is closed."""

    def __init__(self, session: Session) -> None:
        ui.add_head_html('<link rel="stylesheet" href="/tune/page.css"><script src="/tune/page.js" defer></script>')
        self.session, self.document, self._begun = session, session.document, False
        self.client = ui.context.client
        with ui.element("div").classes("page") as self.root:
            self.header = Header(session, self.save)
            with ui.element("div").classes("page-controls"):
                self.controls = ControlPanel(
                    session,
                    mark=lambda key, default: self.time.mark(key, default),  # noqa: PLW0108 - it is made later
                    choose=lambda key, number: self.place.select(number) if key == "object" else None,
                    in_words=lambda *word: self.place.set_word(*word),  # noqa: PLW0108 - it is made later
                )  # fmt: skip
            self.stage = ShownPicture(session)
            self.render = RenderDialog(session)
            self.match = MatchDialog(session)
            with self.header.tools:
                Button("Match caustics", self.match.caustics, title=MATCH_CAUSTICS)
                MeasureTool(session)
                DepthTool(session)
                Button("Render frame", self.render.frame, title="at full size, to a new picture beside the scene")
                Button("Render …", self.render.open, title="the clip, or the range").props("data-words=resolution")
            self.place = PlaceTools(session, self.stage, self.match.water, self.controls.show_words)
            self.time = TimePanel(session)
        ui.on_exception(tell_error)
        ui.on("tune", lambda event: self._pressed(str(event.args)))
        # What follows the session: a scene that changed changes all; the first picture lets the rest begin
        self._followers: dict[Event, tuple[Callable[[], None], ...]] = {
            "document": (
                self.controls.refresh, self.header.refresh, self.stage.expect, self.render.refresh, self.time.refresh,
                self.place.refresh,
            ),
            "picture": (self.stage.show, self.time.show_played, self._begin),
            "time": (self.stage.expect, self.time.follow, self.place.refresh, self.controls.refresh),
            "run": (self.render.refresh,),
            "thumbnails": (self.time.show_thumbnails,),
        }  # fmt: skip
        self.client.on_delete(session.observe(self._follow))
        for event in self._followers:
            self._follow(event)

    def save(self) -> None:
        """Save the document; ask first where the file was changed meanwhile."""
        try:
            self.document.save()
        except OutputExistsError:
            self.header.ask_overwrite()

    def _follow(self, event: Event) -> None:
        for follower in self._followers[event]:
            follower()

    def _begin(self) -> None:
        if not self._begun and self.session.picture is not None:
            self._begun = True
            self.place.refresh()
            self.time.begin()

    def _pressed(self, name: str) -> None:
        session = self.session
        actions: dict[str, Callable[[], Any]] = {
            "save": self.save, "undo": self.document.undo, "redo": self.document.redo, "play": self.time.play,
            "back": lambda: session.seek(session.index - 1), "forward": lambda: session.seek(session.index + 1),
            "start": lambda: session.seek(session.range[0]), "end": lambda: session.seek(session.range[1] - 1),
            "darker": lambda: self.place.trim(-1), "brighter": lambda: self.place.trim(1),
            "marks": lambda: self.stage.viewer.run_method("hide"),
            "close": self.place.choose if self.place.tool else self.time.choose,
        }  # fmt: skip
        if name in actions:
            actions[name]()


# The page's header: file, unsaved mark, undo, redo, save, presets, snapshots, dark or light.

PRESETS: Mapping[str, Mapping[str, Any]] = {
    name: {"water.visibility_m": None, **values} for name, values in fields.CONTROLS["presets"].items()
}
"""Values of dotted keys, by the preset's name; None: as it is by default."""


_MODES: dict[str, bool | None] = {"auto": None, "dark": True, "light": False}


class Header:
    """The header of a tab. save: saves the document."""

    def __init__(self, session: Session, save: Callable[[], None]) -> None:
        self._session, self._document = session, session.document
        document = session.document
        with ui.element("header").classes("page-header") as self.root:
            Text(document.path.name, "h1").props["title"] = str(document.path.resolve())
            self._unsaved = Text("", classes="muted unsaved").props("role=status")
            self._undo = Button("↶", document.undo).props("aria-label=Undo")
            self._redo = Button("↷", document.redo).props("aria-label=Redo")
            Button("Save", save, title="save the scene file (Ctrl+S)", classes="primary")
            with menu("Presets", "values that suit one kind of dive"):
                for name, values in PRESETS.items():
                    ui.menu_item(name, partial(document.apply, f"preset {name}", values))
            self._snapshots = menu("Snapshots", "states kept while the page is open")
            self.tools = ui.element("span").classes("header-tools")
            ui.element("span").classes("grow")
            dark = ui.dark_mode(None)

            def show(mode: str) -> None:
                dark.set_value(_MODES[mode])
                if mode != "auto":
                    session.look(dark=mode == "dark")

            Choice("Dark or light", {"auto": "Auto", "dark": "Dark", "light": "Light"}, "auto", show)
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
            button.describe(f"{word}: {label}" if label else f"nothing to {word}")
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
                ui.separator()
                ui.menu_item(f"Back to {name}", partial(self._document.replace, f"back to {name}", text))
                ui.menu_item(f"Forget {name}", partial(self._document.forget, name))

    def _keep(self) -> None:
        taken = self._document.snapshots
        number = next(k for k in range(1, len(taken) + 2) if f"snapshot {k}" not in taken)
        self._session.keep_picture(f"snapshot {number}")
        self._document.keep(f"snapshot {number}")

    def _show_notices(self) -> None:
        document = self._document
        self._notices.clear()
        with self._notices:
            if document.outside is not None:
                with ui.element("div").classes("notice").props("role=alert"):
                    Text("The scene file was changed by another program.")
                    Button("Take its text", document.take_outside)
                    Button("Overwrite it with mine", lambda: document.save(overwrite=True))
            if document.problems:
                alert(document.problems)


# The time line of a tab: thumbnails, play head, range, and the curve of a keyed parameter.

_AXES = ("right", "up", "back")


class TimePanel:
    """The time line of a tab."""

    def __init__(self, session: Session) -> None:
        self._session, self._document = session, session.document
        self._chosen, self._drag = "", 0
        self._playing = False
        clip = session.clip
        self.root = ui.element("footer").classes("page-foot")
        with self.root:
            self._line = Timeline(session.frame_count, float(clip.frame_rate))
            with ui.element("div").classes("foot-bar") as self._bar:
                self._choice = Choice("Keyed parameter", {"": "no curve"}, "", self.choose)
                self._shut = Button("Close curve", self.choose, title="show no curve (Escape)")
        self._line.on_seek(lambda frame, how: session.seek(frame, scrubbing=how == "scrub", playing=how == "play"))
        self._line.on_play(lambda playing: setattr(self, "_playing", playing))
        self._line.on_range(session.set_range)
        self._line.on_keys(self._edited)

    def begin(self) -> None:
        """Ask for the thumbnails, which would hold up the first picture."""
        background_tasks.create(self._session.make_thumbnails(), name="thumbnails")

    def play(self) -> None:
        """Start or stop playing."""
        self._line.run_method("play", not self._playing)

    def choose(self, name: str = "") -> None:
        """Show the curve of a keyed parameter, "name" or "name component"; "": none."""
        self._chosen = name
        self.refresh()

    def mark(self, key: str, default: Any) -> None:
        """Set a key of a parameter at the present time, or remove the one that is there; show its curve."""
        session, time_s = self._session, self._session.time_s
        value = None
        if not fields.has_key(self._document, key, time_s):
            now = fields.values_at(self._document, time_s).get(key)
            value = fields.present_value(self._document, key, default) if now is None else now
        fields.set_key(self._document, key, time_s, value)
        held = fields.keyed_parameters(self._document).get(key)
        vector = held is not None and isinstance(held.value[0], tuple)
        self.choose("" if held is None else f"{key} 0" if vector else key)
        session.show()

    def refresh(self) -> None:
        """Show the document's keys."""
        names = {"": "no curve"}
        for name, key in fields.keyed_parameters(self._document).items():
            first = key.value[0]
            if isinstance(first, tuple):
                words = _AXES if name.endswith("position_m") else tuple(str(k + 1) for k in range(len(first)))
                names |= {f"{name} {k}": f"{name}, {words[k]}" for k in range(len(first))}
            else:
                names[name] = name
        if self._chosen not in names:
            self._chosen = ""
        self._choice.offer(names, self._chosen)
        self._bar.set_visibility(len(names) > 1)
        self._shut.set_visibility(bool(self._chosen))
        self._line.set_curve(self._curve(names[self._chosen]) if self._chosen else None)

    def follow(self) -> None:
        """Move the play head to the session's frame, and the range."""
        self._line.set_frame(self._session.index)
        self._line.set_range(*self._session.range)

    def _curve(self, label: str) -> dict[str, Any]:
        name, component = self._named()
        key = fields.keyed_parameters(self._document)[name]
        field = target_of(self._document.scene, name).field
        low, high = bounds_of(field)
        values = [fields.component_of(value, component) for value in key.value]
        end_s = self._session.frame_count / float(self._session.clip.frame_rate)
        return {
            "label": label, "unit": stated(field, "unit"), "keys": list(zip(key.time_s, values, strict=True)),
            "samples": fields.samples(self._document, key, end_s, component), "interpolation": key.interpolation,
            "low": low, "high": high,
        }  # fmt: skip

    def _named(self) -> tuple[str, int | None]:
        name, _, component = self._chosen.partition(" ")
        return name, int(component) if component else None

    def _edited(self, keys: list[tuple[float, float]], interpolation: Interpolation, done: bool) -> None:
        name, component = self._named()
        key = fields.keyed_parameters(self._document).get(name)
        if key is None:
            self.refresh()
            return
        pairs = keys if component is None else fields.with_component(self._document, key, component, keys)
        group = f"{self._line.client.id} keys {self._drag}"
        try:
            fields.set_keys(self._document, name, pairs, interpolation, group=group)
        finally:
            self._drag += done
            self.refresh()

    def show_played(self) -> None:
        """Show which frames play at once."""
        self._line.set_played(self._session.pictures.played())

    def show_thumbnails(self) -> None:
        """Show the small pictures of the plate that there are."""
        self._line.set_thumbnails({f: f"/picture/{n}" for f, n in self._session.thumbnails.items()})


_TITLE = "measure sun and veil over the whole clip, as a composite does; the picture then shows that light"


class _StoppedError(Exception):
    """Ends a pass over the clip."""


class MeasureTool:
    """The button of a tab; pressed again, it ends the pass."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._running, self._stop = False, False
        self._button = Button("Measure clip", self._pressed, title=_TITLE)

    async def _pressed(self) -> None:
        if self._running:
            self._stop = True
            return
        loop = asyncio.get_running_loop()

        def progress(done: int, total: int | None) -> None:
            if self._stop:
                raise _StoppedError
            loop.call_soon_threadsafe(self._show, done, total)

        self._running = True
        self._show(0, None)
        try:
            await self._session.measure_clip(progress)
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
