# SPDX-License-Identifier: Apache-2.0
"""The page's "Match": fits the sea or the water to the plate, shows numbers and pictures before and after, applies."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from nicegui import background_tasks, ui

from mr360uw.errors import Mr360uwError
from mr360uw.preview.thumbnail import encoded
from mr360uw.scene.model import Scene
from mr360uw.tune.panels.widgets import Button, Text
from mr360uw.tune.placing import Point
from mr360uw.tune.session import Session

if TYPE_CHECKING:
    from mr360uw.match import CausticMatch, WaterMatch

PATCH_DEG = 12.0
"""Side of the square of open water around a click: hundreds of pixels of a small plate, of one hue."""


class MatchDialog:
    """The dialog of a tab. guarded: runs an action and tells its error."""

    def __init__(self, session: Session, guarded: Callable[[Callable[[], Any]], None]) -> None:
        self._session, self._guarded = session, guarded
        self._changes: dict[str, Any] = {}
        self._name, self._running = "", False
        with ui.dialog() as self._dialog, ui.element("div").classes("card wide").props("aria-label='Match'"):
            self._title = Text("", "h2")
            self._text = Text("", "p", "match-text").props("role=status")
            self._bar = ui.element("progress").props("aria-label='matching'")
            self._shown = ui.element("div").classes("match-pictures")
            with ui.element("div").classes("row-field"):
                self._apply = Button("Apply", lambda: guarded(self._take), classes="primary")
                ui.element("span").classes("grow")
                Button("Close", self._dialog.close)

    def caustics(self) -> None:
        """Fit the sea to the caustics on the plate's floor."""
        scene = self._session.document.scene
        self._start("Match the caustics on the floor", "matched caustics", partial(_caustics, scene))

    def water(self, point: Point) -> None:
        """Fit the water to the plate around a point."""
        scene, index = self._session.document.scene, self._session.index
        self._start("Match the water", "matched water", partial(_water, scene, point, index))

    def _start(self, title: str, name: str, job: Callable[[], Any]) -> None:
        self._dialog.open()
        if not self._running:
            self._running, self._name = True, name
            self._title.text, self._text.text = title, "Measuring the plate …"
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
        self._text.text = "\n".join([found.sentence, *self._lines()])
        self._apply.enable(bool(self._changes))
        with self._shown:
            if hasattr(found, "plate_code"):
                _show_colours(found)
            else:
                self._show_floors(found)

    def _lines(self) -> list[str]:
        """Return a line for each parameter that would change: its value before and after."""
        document, lines = self._session.document, []
        for key, value in self._changes.items():
            before = document.get(key)
            lines.append(f"{key}: {'the default' if before is None else before} → {value}")
        return lines

    def _take(self) -> None:
        self._session.document.apply(self._name, self._changes)
        self._apply.enable(False)

    def _show_floors(self, found: CausticMatch) -> None:
        from mr360uw.match.pattern_measures import floor_pictures, spectrum_pictures

        shown = [one for one in (found.plate, found.before, found.after) if one is not None]
        if not shown:
            return
        for name, codes in (("floors", floor_pictures(shown)), ("spectra", spectrum_pictures(shown, found.pixel_m))):
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


def _caustics(scene: Scene) -> CausticMatch:
    from mr360uw.match import match_caustics

    return match_caustics(scene)


def _water(scene: Scene, point: Point, index: int) -> WaterMatch:
    from mr360uw.match import WaterPatch, match_water

    yaw, pitch = np.degrees(point.longitude), np.degrees(point.latitude)
    limit = 88.0 - 0.5 * PATCH_DEG
    return match_water(scene, WaterPatch(float(yaw), float(np.clip(pitch, -limit, limit)), PATCH_DEG), index)


def _plain(value: Any) -> Any:
    """Return a value as TOML has it."""
    if isinstance(value, tuple | list):
        return [_plain(one) for one in value]
    return value if isinstance(value, str | bool) else float(f"{float(value):.5g}")
