# SPDX-License-Identifier: Apache-2.0
"""Placing by clicks and drags in the picture: objects, the sun, the height of the sea floor."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from nicegui import background_tasks, ui

from mr360uw.errors import ParameterError
from mr360uw.tune import floor, placing, tracks
from mr360uw.tune.panels.stage import Stage
from mr360uw.tune.panels.widgets import Button, Choice, Text
from mr360uw.tune.placing import Point
from mr360uw.tune.session import Session
from mr360uw.tune.situation import Situation
from mr360uw.tune.viewer import Drag, Marker, Pick

_TOOLS = {
    "": "Click: nothing",
    "stand": "Click: stand here",
    "swim": "Click: swim there",
    "sun": "Click: the sun is here",
    "floor": "Click: points on the floor",
}
_KNOWN = {
    "height": "camera above the floor [m]",
    "distances": "distance of each point [m]",
    "lengths": "between the points [m]",
}
_TURN_STEP_DEG = 15.0
"""Step of a turn while Shift is held."""


class PlaceTools:
    """The placing tools of a tab. failed: tells an error."""

    def __init__(self, session: Session, stage: Stage, failed: Callable[[Exception], None]) -> None:
        self._session, self._document, self._failed = session, session.document, failed
        self._viewer = stage.viewer
        self._tool, self._number, self._known = "", 0, "height"
        self._situation: Situation | None = None
        self._clicks: list[Point] = []
        self._drag: tuple[Situation, Any] | None = None
        self._asked = 0
        with stage.tools:
            self._choice = Choice("What a click in the picture does", _TOOLS, "", self._choose)
            self._face = Button("Face camera", self._face_camera, title="turn the chosen object's nose to the camera")
            with ui.element("span").classes("floor-tool") as self._floor:
                self._count = Text("", classes="status").props("role=status")
                Choice("What is known of the floor", _KNOWN, "height", lambda known: setattr(self, "_known", known))
                given = ui.element("input").props("type=text size=8 aria-label='Known lengths in metres'")
                given.on("change", self._given, js_handler="(e) => emit(e.target.value)")
                Button("Set floor", lambda: self._try(self._set_floor))
                Button("Forget", self._forget)
        self._lengths = ""
        self._viewer.on_pick(self._picked)
        self._viewer.on_drag(self._dragged)
        self._viewer.on_select(lambda name: self.select(int(name.removeprefix("object "))))
        self._choose("")

    def select(self, number: int) -> None:
        """Choose an object by its number."""
        self._number = number
        self._mark()

    def refresh(self) -> None:
        """Show where the objects are now."""
        self._asked += 1
        background_tasks.create(self._refresh(self._asked), name="situation")

    async def _refresh(self, asked: int) -> None:
        await asyncio.sleep(0.05)
        if asked != self._asked or self._document.problems:
            return
        try:
            self._situation = await self._ask()
        except Exception:  # noqa: BLE001 - the picture's own message says it
            self._situation = None
        if not self._viewer.is_deleted:
            self._mark()

    async def _ask(self) -> Situation:
        session = self._session
        job = partial(_situation, session.document.scene, session.index, session.time_s)
        return await asyncio.wrap_future(session.pictures.ask(job, urgent=True))

    def _mark(self) -> None:
        here, marks = self._situation, []
        for number, body in enumerate(here.bodies if here is not None else ()):
            assert here is not None
            shown = here.shown(number)
            if shown is not None:
                point, radius = shown
                marks.append(Marker(f"object {number}", point.longitude, point.latitude, "object", body.name, radius))
        marks += [
            Marker(f"floor {k}", p.longitude, p.latitude, "spot", str(k + 1), handles=())
            for k, p in enumerate(self._clicks)
        ]
        self._viewer.set_marks(marks, here.rim() if here is not None and self._tool in ("stand", "floor") else ())
        self._viewer.select(f"object {self._number}")
        self._face.enable(bool(here is not None and here.bodies))

    def _choose(self, tool: str) -> None:
        self._tool = tool
        self._choice.choose(tool)
        self._floor.set_visibility(tool == "floor")
        self._forget()

    def _forget(self) -> None:
        self._clicks = []
        self._count.text = "0 points"
        self._mark()

    def _given(self, event: Any) -> None:
        self._lengths = str(event.args)

    async def _picked(self, pick: Pick) -> None:
        point = pick.point
        if point is None or not self._tool:
            return
        try:
            here = await self._ask()
            if self._tool == "floor":
                self._clicks.append(point)
                self._count.text = f"{len(self._clicks)} points"
                self._mark()
            elif self._tool == "sun":
                azimuth, elevation = here.sun_angles_deg(point)
                given = {
                    "sun": "given",
                    "sun_azimuth_deg": _short(azimuth, 2),
                    "sun_elevation_deg": _short(elevation, 2),
                }
                self._document.apply("sun by click", {f"light.{name}": value for name, value in given.items()})
            else:
                self._check_number(here)
                place = here.standing if self._tool == "stand" else here.swimming
                self._put(f"object.{self._number}.position_m", _vector(place(self._number, point)))
        except (ParameterError, OSError, ValueError) as error:
            self._failed(error)

    async def _dragged(self, drag: Drag) -> None:
        try:
            if drag.phase == "start":
                self._number = int(drag.name.removeprefix("object "))
                here = await self._ask()
                self._check_number(here)
                setting = self._document.scene.objects[self._number]
                self._drag = here, setting
                self._asked += 1
            if self._drag is None or drag.phase == "start":
                return
            here, setting = self._drag
            group = f"{self._viewer.client.id} drag {id(here)}"
            self._follow_drag(drag, here, setting, group)
            if drag.phase in ("end", "cancel"):
                self._drag = None
        except (ParameterError, OSError, ValueError) as error:
            self._failed(error)

    def _follow_drag(self, drag: Drag, here: Situation, setting: Any, group: str) -> None:
        key = f"object.{self._number}"
        point = drag.start if drag.phase == "cancel" else drag.point
        shown = here.shown(self._number)
        if drag.handle == "move":
            self._put(f"{key}.position_m", _vector(here.swimming(self._number, point)), group)
        elif shown is not None and drag.handle == "turn":
            step = _TURN_STEP_DEG if drag.keys.shift else 0.0
            yaw = placing.yaw_by_drag(setting.rotation_deg[0], shown[0], drag.start, point, step)
            self._put(f"{key}.rotation_deg", [_short(yaw, 2), *map(float, setting.rotation_deg[1:])], group)
        elif shown is not None:
            scale = placing.scale_by_drag(setting.scale, shown[0], drag.start, point)
            self._put(f"{key}.scale", float(f"{scale:.4g}"), group)

    def _face_camera(self) -> None:
        def turn() -> None:
            assert self._situation is not None
            self._check_number(self._situation)
            yaw = _short(self._situation.facing_yaw_deg(self._number), 2)
            rest = self._document.scene.objects[self._number].rotation_deg[1:]
            self._put(f"object.{self._number}.rotation_deg", [yaw, *map(float, rest)])

        self._try(turn)

    def _set_floor(self) -> None:
        if self._situation is None:
            raise ParameterError("floor - the scene cannot be drawn (got no camera) - correct it first")
        camera, clicks = self._situation.camera, self._clicks
        try:
            lengths = [float(part) for part in self._lengths.replace(",", " ").split()]
        except ValueError:
            raise ParameterError(f"floor - no lengths (got {self._lengths!r}) - write metres, as in 2.5, 3") from None
        if self._known == "height":
            fit = floor.floor_from_height(camera, clicks, lengths[0] if lengths else 0.0)
        elif self._known == "distances":
            fit = floor.floor_from_distances(camera, clicks, lengths)
        else:
            fit = floor.floor_from_lengths(camera, clicks, lengths)
        self._document.apply("floor by clicks", {"receiver.height_m": _short(fit.height_m, 3)})
        spread = f", the clicks deviate by {fit.error_m:.2g} m" if fit.error_m else ""
        ui.notify(f"The sea floor is at {fit.height_m:.2f} m{spread}: {fit.assumed}.")
        self._forget()

    def _check_number(self, here: Situation) -> None:
        if not here.bodies:
            raise ParameterError("object - there is none to place (got 0) - add one first")
        self._number = min(self._number, len(here.bodies) - 1)

    def _put(self, key: str, value: Any, group: str | None = None) -> None:
        """Set a parameter, or its key of this time where it has keys."""
        if key in tracks.tracks(self._document):
            tracks.set_key(self._document, key, self._session.time_s, value, group=group)
        else:
            self._document.set(key, value, group=group)

    def _try(self, action: Callable[[], Any]) -> None:
        try:
            action()
        except (ParameterError, OSError, ValueError) as error:
            self._failed(error)


def _situation(scene: Any, index: int, time_s: float, renderer: Any) -> Situation:
    here: Situation = renderer.situation(scene, index, time_s)
    return here


def _vector(position: Any) -> list[float]:
    return [_short(part, 4) for part in np.asarray(position).tolist()]


def _short(value: float, digits: int) -> float:
    return round(float(value), digits) + 0.0
