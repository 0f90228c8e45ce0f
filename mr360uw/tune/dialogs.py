# SPDX-License-Identifier: Apache-2.0
"""The page's "Render": asks for the output, runs `mr360uw composite` on the scene, shows how far it is."""

from __future__ import annotations

import asyncio
import itertools
import os
import secrets
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from nicegui import background_tasks, ui

from mr360uw import match
from mr360uw.base.constants import DEPTH_EYES_S, DEPTH_FRAME_S
from mr360uw.base.files import write_whole
from mr360uw.errors import Mr360uwError, ParameterError
from mr360uw.preview.screen import encoded
from mr360uw.scene.model import Scene
from mr360uw.tune.controls import Button, Choice, Text, text_input
from mr360uw.tune.placing import Point
from mr360uw.tune.session import CommandRun, Session

if TYPE_CHECKING:
    from mr360uw.match import CausticMatch, WaterMatch


_SCALES = {"1": "full size", "0.5": "half size", "0.25": "quarter size"}


class RenderDialog:
    """The dialog of a tab. The run itself belongs to the session."""

    def __init__(self, session: Session) -> None:
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
                self._out = text_input("spellcheck=false", self._named)
                self._out.props["^value"] = self._name  # at first: what is typed stays while others are updated
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
                self._save_first = Button("Save and render", lambda: self._start(save=True), classes="primary")
                self._copy = Button("Render without saving", lambda: self._start(save=False))
                self._cancel = Button("Cancel the run", self._stop)
                ui.element("span").classes("grow")
                Button("Close", self._dialog.close)

    def open(self) -> None:
        """Show the dialog."""
        self.refresh()
        self._dialog.open()

    def refresh(self) -> None:
        """Show how far the run is."""
        # Show what a run would do, and whether it can begin
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
        # Show how far the last run is, and the way to its result
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

    def _named(self, name: str) -> None:
        self._name = self._out.props["^value"] = name  # also where the dialog is opened again

    def frame(self) -> None:
        """Render the frame that is shown at full size, to a picture beside the scene with a name that is free."""
        scene, number = self._document.path.absolute(), self._session.index + self._session.clip.first_number
        endings = (f".frame-{number:04d}{f'-{k}' if k > 1 else ''}.png" for k in itertools.count(1))
        out = next(path for ending in endings if not os.path.lexists(path := scene.with_suffix(ending)))
        self._run("still", out, ["--frame", str(number)])
        self.open()

    def _start(self, *, save: bool) -> None:
        """Start a run over the range; save the scene before, or not."""
        (start, stop), first = self._session.range, self._session.clip.first_number
        if save:
            self._document.save()
        options = [*(["--scale", self._scale] if self._scale != "1" else []), *(["--overwrite"] * self._overwrite)]
        if (start, stop) != (0, self._session.frame_count):
            options += ["--frames", f"{start + first}:{stop + first}"]
        out = self._document.path.parent / Path(self._name).expanduser()
        self._run("composite", out, ["--progress-lines", *options])

    def _run(self, command: str, out: Path, options: list[str]) -> None:
        """Start a command on the scene, or, with changes that are not saved, on a copy that is removed afterwards."""
        run, scene, copy = self._session.start_run(out), self._document.path, None
        if self._document.dirty:
            scene = copy = scene.with_name(f".{scene.stem}.{secrets.token_hex(4)}.toml")
            write_whole(copy, self._document.text)
        words = [command, str(scene), str(out), *options, "--backend", self._session.backend]
        background_tasks.create(_finish(run, words, copy), name=command)

    def _stop(self) -> None:
        if self._session.run is not None:
            self._session.run.cancel()


async def _finish(run: CommandRun, words: list[str], copy: Path | None) -> None:
    try:
        await run.run(words)
    finally:
        if copy is not None:
            copy.unlink(missing_ok=True)


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    if minutes >= 60:
        return f"{minutes // 60} h {minutes % 60} min"
    return f"{minutes} min {rest} s" if minutes else f"{rest} s"


# The page's "Match": fits the sea or the water to the plate, shows numbers and pictures before and after, applies.

_PATCH_DEG = 12.0
"""Side of the square of open water around a click: hundreds of pixels of a small plate, of one hue."""


MATCH_CAUSTICS = (
    "Finds the waves that make the moving light on the plate's floor: reads two seconds of the clip, about a minute. "
    "It changes the wind, its direction and the longest wave, and those only when you press Apply."
)
_MATCH_WATER = (
    "Finds the water whose colour the plate has around your click: a few seconds. It changes the water, and that only "
    "when you press Apply."
)


class MatchDialog:
    """The dialog of a tab."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._changes: dict[str, Any] = {}
        self._name, self._running = "", False
        with ui.dialog() as self._dialog, ui.element("div").classes("card wide").props("aria-label='Match'"):
            self._title = Text("", "h2")
            self._text = Text("", "p", "match-text").props("role=status")
            self._bar = ui.element("progress").props("aria-label='matching'")
            self._shown = ui.element("div").classes("match-pictures")
            with ui.element("div").classes("row-field"):
                self._apply = Button("Apply", self._take, classes="primary")
                ui.element("span").classes("grow")
                Button("Close", self._dialog.close)

    def caustics(self) -> None:
        """Fit the sea to the caustics on the plate's floor."""
        scene = self._session.document.scene
        self._start("Match the floor's light", MATCH_CAUSTICS, "matched caustics", lambda: match.match_caustics(scene))

    def water(self, point: Point) -> None:
        """Fit the water to the plate around a point."""
        scene, index = self._session.document.scene, self._session.index
        self._start("Match the water", _MATCH_WATER, "matched water", partial(_water, scene, point, index))

    def _start(self, title: str, text: str, name: str, job: Callable[[], Any]) -> None:
        self._dialog.open()
        if not self._running:
            self._running, self._name = True, name
            self._title.text, self._text.text = title, text
            self._bar.set_visibility(True)
            self._apply.enable(False)
            self._shown.clear()
            background_tasks.create(self._run(job), name="match")

    async def _run(self, job: Callable[[], Any]) -> None:
        try:
            found = await asyncio.to_thread(job)
        except (Mr360uwError, OSError) as error:
            self._text.text, found = str(error), None
        finally:
            self._running = False
        if self._dialog.is_deleted:
            return
        self._bar.set_visibility(False)
        if found is None:
            return
        self._changes = {key: _plain(value) for key, value in found.changes.items()}
        values = ((key, self._session.document.get(key), value) for key, value in self._changes.items())
        lines = (f"{key}: {'the default' if old is None else old} → {new}" for key, old, new in values)
        self._text.text = "\n".join([found.sentence, *lines])
        self._apply.enable(bool(self._changes))
        with self._shown:
            if hasattr(found, "plate_code"):
                _show_colours(found)
            else:
                self._show_floors(found)

    def _take(self) -> None:
        self._session.document.apply(self._name, self._changes)
        self._apply.enable(False)

    def _show_floors(self, found: CausticMatch) -> None:
        for name, codes in zip(("floors", "spectra"), found.pictures().values(), strict=False):
            number = self._session.replaced(f"match {name}", encoded(codes, ".jpg"))
            ui.element("img").props(f'src="/picture/{number}" alt="{name} of plate and scene, before and after"')


def _show_colours(found: WaterMatch) -> None:
    for words, code in (
        ("plate", found.plate_code), ("before", found.before_code), ("after", found.after_code),
    ):  # fmt: skip
        red, green, blue = (round(float(one)) for one in code)
        with ui.element("figure"):
            ui.element("div").classes("swatch").style(f"background: rgb({red} {green} {blue})")
            Text(f"{words}: {red}, {green}, {blue}", "figcaption")
    if np.isfinite(found.rms_before) and np.isfinite(found.rms_after):
        Text(f"Deviation from the plate: {found.rms_before:.1f} codes before, {found.rms_after:.1f} after.", "p")


def _water(scene: Scene, point: Point, index: int) -> WaterMatch:
    yaw, pitch = np.degrees(point.longitude), np.degrees(point.latitude)
    limit = 88.0 - 0.5 * _PATCH_DEG
    patch = match.WaterPatch(float(yaw), float(np.clip(pitch, -limit, limit)), _PATCH_DEG)
    return match.match_water(scene, patch, index)


def _plain(value: Any) -> Any:
    """Return a value as TOML has it."""
    if isinstance(value, tuple | list):
        return [_plain(one) for one in value]
    return value if isinstance(value, str | bool) else float(f"{float(value):.5g}")


# The page's "Find depth": runs `mr360uw depth` on the plate, shows how far it is, and names the maps in the scene.

_DEPTH = (
    "Finds how far away everything in the plate is, from the motion of its camera or by its two eyes: objects then go "
    "behind what is nearer. A frame takes about {:.1f} s, all {} about {:.0f} min; you can go on meanwhile.\n"
    "It writes maps into the folder {}, and then names them in the scene as plate.depth, which Undo takes back. Press "
    "the button again to stop: what is found stays."
)


class DepthTool:
    """The button of a tab, and the dialog that says what it will do; pressed again, it ends the run."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._run: CommandRun | None = None
        frames, eyes = session.frame_count, session.document.scene.plate.eye == "both"
        frame_s = DEPTH_EYES_S if eyes else DEPTH_FRAME_S
        self._folder = session.document.path.with_name(f"{session.document.path.stem}.depth")
        words = _DEPTH.format(frame_s, frames, max(frames * frame_s / 60.0, 1.0), self._folder.name)
        self._button = Button("Find depth", self._pressed, title="how far away everything in the plate is")
        self._button.set_visibility(frames > 1 or eyes)
        with ui.dialog() as self._dialog, ui.element("div").classes("card").props("aria-label='Find depth'"):
            Text("Find depth", "h2")
            Text(words, "p")
            with ui.element("div").classes("row-field"):
                Button("Start", self._start, classes="primary")
                ui.element("span").classes("grow")
                Button("Close", self._dialog.close)

    def _pressed(self) -> None:
        if self._run is None:
            self._command()
            self._dialog.open()
        else:
            self._run.cancel()

    def _command(self) -> list[str]:
        """Return the words of the command; raise `ParameterError` where nothing gives the scale."""
        scene = self._session.document.scene
        command = ["depth", str(scene.plate.path), "-o", str(self._folder)]
        if scene.plate.eye == "both":
            command += ["--eye", "both", "--ipd", str(scene.camera.ipd_m)]
        elif scene.camera.track is None:
            raise ParameterError(
                "camera.track - is not set, so distances have no scale (got none) - run mr360uw track on the plate "
                "with --height, and name the table"
            )
        else:
            command += ["--track", str(scene.camera.track)]
            command += [] if scene.plate.eye is None else ["--eye", scene.plate.eye]
        return command

    async def _start(self) -> None:
        """Run it, and name its maps in the scene."""
        self._dialog.close()
        command, run = self._command(), CommandRun(self._folder, self._show)
        self._run = run
        self._show()
        try:
            await run.run([*command, "--progress-lines"])
        finally:
            self._run = None
            self._show()
        if run.state == "failed":
            raise ParameterError(run.message)
        if run.state == "done":
            self._session.document.set("plate.depth", Path(run.out).name)
            if not self._button.is_deleted:
                ui.notify(run.message, type="positive", timeout=8000, close_button="Close")

    def _show(self) -> None:
        run = self._run
        if not self._button.is_deleted:
            share = f" {100 * run.done // run.total} %" if run is not None and run.total else " …"
            self._button.text = "Find depth" if run is None else f"Finding depth{share}, stop"
            self._button.press(run is not None)
