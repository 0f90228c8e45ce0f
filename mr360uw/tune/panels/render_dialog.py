# SPDX-License-Identifier: Apache-2.0
"""The page's "Render": asks for the output, runs `mr360uw composite` on the scene, shows how far it is."""

from __future__ import annotations

import secrets
from collections.abc import Callable
from pathlib import Path
from typing import Any

from nicegui import background_tasks, ui

from mr360uw.files import write_whole
from mr360uw.tune.panels.widgets import Button, Choice, Text
from mr360uw.tune.session import CommandRun, Session

_SCALES = {"1": "full size", "0.5": "half size", "0.25": "quarter size"}


class RenderDialog:
    """The dialog of a tab. guarded: runs an action and tells its error. The run itself belongs to the session."""

    def __init__(self, session: Session, guarded: Callable[[Callable[[], Any]], None]) -> None:
        self._session, self._document = session, session.document
        self._scale, self._overwrite = "1", False
        with (
            ui.dialog() as self._dialog,
            ui.element("form").classes("card").props("aria-label='Render' onsubmit='return false'"),
        ):
            self._title = Text("", "h2")
            self._unsaved = Text("", "p", "muted")
            with ui.element("label").classes("row-field"):
                Text("Output")
                still = session.frame_count == 1
                scene = self._document.path.absolute()  # names that are not absolute are beside it
                self._name = str(scene.with_suffix(".composite.png" if still else ".composite.mp4"))
                self._out = ui.element("input").props("type=text spellcheck=false")
                self._out.props["^value"] = self._name  # at first: what is typed stays while others are updated
                self._out.on("change", self._named, js_handler="(e) => emit(e.target.value)")
            with ui.element("div").classes("row-field"):
                Choice("Size", _SCALES, "1", lambda scale: setattr(self, "_scale", scale))
                with ui.element("label"):
                    box = ui.element("input").props("type=checkbox")
                    allow = "(e) => emit(e.target.checked)"
                    box.on("change", lambda event: setattr(self, "_overwrite", bool(event.args)), js_handler=allow)
                    Text(" replace an output that is there")
            self._bar = ui.element("progress").props("max=1 aria-label='frames rendered'")
            self._text = Text("", "p", "run-text").props("role=status")
            self._link = ui.element("div")
            with ui.element("div").classes("row-field"):
                self._save_first = Button(
                    "Save and render", lambda: guarded(lambda: self._start(save=True)), classes="primary"
                )
                self._copy = Button("Render without saving", lambda: guarded(lambda: self._start(save=False)))
                self._cancel = Button("Cancel the run", self._stop)
                ui.element("span").classes("grow")
                Button("Close", self._dialog.close)

    def open(self) -> None:
        """Show the dialog."""
        self.refresh()
        self._dialog.open()

    def refresh(self) -> None:
        """Show how far the run is."""
        run, dirty = self._session.run, self._document.dirty
        running = run is not None and run.state == "running"
        (start, stop), count = self._session.range, self._session.frame_count
        whole = "Render the picture" if count == 1 else "Render the whole clip"
        self._title.text = whole if stop - start == count else f"Render frames {start} to {stop - 1}"
        self._unsaved.text = "There are unsaved changes." if dirty else "The scene is saved."
        self._save_first.text = "Save and render" if dirty else "Render"
        self._save_first.enable(not running)
        self._copy.set_visibility(dirty and not running)
        self._cancel.set_visibility(running)
        self._bar.set_visibility(running)
        self._link.clear()
        if run is None:
            self._text.text = ""
            return
        self._bar.props["value"] = run.done / run.total if run.total else 0.0
        if running:
            left = "" if run.seconds_left is None else f", {_duration(run.seconds_left)} left"
            frames = f": frame {run.done} of {run.total}" if run.total else ""
            self._text.text = f"{run.phase or 'starting'}{frames}{left}"
        else:
            words = {"done": "Done.", "failed": "It failed.", "cancelled": "Cancelled; what is finished stays."}
            self._text.text = f"{words[run.state]}\n{run.message}"
            if run.state == "done":
                with self._link, ui.element("a").props(f'href="/result?{secrets.token_hex(4)}" target=_blank'):
                    Text(f"Open {run.out.name}")

    def _named(self, event: Any) -> None:
        self._name = self._out.props["^value"] = str(event.args)  # also where the dialog is opened again

    def _start(self, *, save: bool) -> None:
        """Start a run on the saved scene, or on a copy beside it that is removed afterwards."""
        document, session = self._document, self._session
        scene, copy = document.path, None
        if save or not document.dirty:
            document.save()
        else:
            scene = copy = document.path.with_name(f".{document.path.stem}.{secrets.token_hex(4)}.toml")
            write_whole(copy, document.text)
        options = [*(["--scale", self._scale] if self._scale != "1" else []), *(["--overwrite"] * self._overwrite)]
        if session.range != (0, session.frame_count):
            options += ["--frames", f"{session.range[0]}:{session.range[1]}"]
        run = session.start_run(document.path.parent / Path(self._name).expanduser())
        background_tasks.create(_finish(run, scene, copy, [*options, "--backend", session.backend]), name="composite")

    def _stop(self) -> None:
        if self._session.run is not None:
            self._session.run.cancel()


async def _finish(run: CommandRun, scene: Path, copy: Path | None, options: list[str]) -> None:
    try:
        await run.run(["composite", str(scene), str(run.out), "--progress-lines", *options])
    finally:
        if copy is not None:
            copy.unlink(missing_ok=True)


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    return (
        f"{minutes // 60} h {minutes % 60} min"
        if minutes >= 60
        else f"{minutes} min {rest} s"
        if minutes
        else f"{rest} s"
    )
