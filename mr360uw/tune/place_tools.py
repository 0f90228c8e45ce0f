# SPDX-License-Identifier: Apache-2.0
"""The picture of a tab: what it shows, and clicks and drags in it that place objects, sun, floor, water and patches."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from functools import partial
from typing import Any

from nicegui import background_tasks, ui

from mr360uw.base.parameters import bounds_of
from mr360uw.composite.settings import POLAR, ObjectSettings
from mr360uw.errors import ParameterError
from mr360uw.tune import fields, placing
from mr360uw.tune.click_tools import PATCH_TOOLS, FloorTool, LassoTool, LevelTool, PatchTool
from mr360uw.tune.controls import Button, Choice, Text, alert
from mr360uw.tune.fields import in_words
from mr360uw.tune.placing import Point
from mr360uw.tune.session import Session
from mr360uw.tune.situation import SNAPSHOT, Compare, Drag, Marker, Situation, Viewer
from mr360uw.tune.views import VIEW_NAMES
from mr360uw.types import Floats

_TOOLS = {
    "": "Click: choose an object",
    "stand": "Click: stand here",
    "swim": "Click: swim there",
    "sun": "Click: the sun is here",
    "level": "Click: points on the horizon",
    "floor": "Click: points on the floor",
    "water": "Click: match open water",
    **PATCH_TOOLS,
    "lasso": "Draw: a matte",
}
_SAME_M = 1e-3
"""Change of height [m] below which an object still stands."""
_TURN_STEP_DEG = 15.0
"""Step of a turn while Shift is held."""
_LEAST_STOPS, _MOST_STOPS = bounds_of(ObjectSettings.model_fields["exposure"])
"""Range of an object's exposure."""


class PlaceTools:
    """The placing tools of a tab. tool: what a click does, by its name of the list; "": it chooses an object.

    match_water: called with the point of open water clicked.
    show_words: called with the present places and sizes of objects, by dotted key, and the chosen object's number.
    """

    def __init__(
        self,
        session: Session,
        stage: ShownPicture,
        match_water: Callable[[Point], None],
        show_words: Callable[[dict[str, Any], int], None],
    ) -> None:
        self._session, self._document = session, session.document
        self._viewer, self._match_water, self._show_words = stage.viewer, match_water, show_words
        self.tool, self._number = "", 0
        self._situation: Situation | None = None
        self._drag: tuple[Situation, str, int] | None = None
        self._in_turn = asyncio.Lock()
        self._asked = 0
        # Controls above the picture
        with stage.tools:
            self._choice = Choice("What a click in the picture does", _TOOLS, "", self.choose)
            self._go = Button("Go to", self._go_to, title="look at the chosen object")
            self._face = Button("Face camera", self._face_camera, title="turn the chosen object's nose to the camera")
            with ui.element("span").classes("segments").props("role=group aria-label='Exposure of the chosen object'"):
                self._trims = [
                    Button(text, partial(self.trim, step), title=f"the chosen object, by a third of a stop ({key})")
                    for text, step, key in (("Darker", -1, "comma"), ("Brighter", 1, "full stop"))
                ]
        # Bars of single tools, shown while their tool is chosen
        with stage.tool_bars:
            self._floor = FloorTool(session, self._mark)
            self._level = LevelTool(session, self._mark)
            self._patch = PatchTool(session)
            self._lasso = LassoTool(session, self._mark)
            self._shut = Button("Close", self.choose, title="no tool: a click chooses an object (Escape)")
        # What happens in the picture
        self._viewer.on_pick(self._picked)
        self._viewer.on_stroke(self._lasso.add)
        self._viewer.on_drag(self._dragged)
        self._viewer.on_select(self._selected)
        self.choose()

    def select(self, number: int) -> None:
        """Choose an object by its number."""
        self._number = number
        self._mark()

    def _selected(self, name: str) -> None:
        kind, _, number = name.partition(".")
        if kind == "object":
            self.select(int(number))

    def refresh(self) -> None:
        """Show where the objects are now; before the first picture this would hold it up."""
        self._lasso.follow()
        if self._session.picture is None:
            return
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
        scene, index, time_s = self._document.scene, self._session.index, self._session.time_s
        return await self._session.ask(lambda renderer: Situation(renderer, scene, index, time_s), urgent=True)

    def _mark(self) -> None:
        here = self._situation
        draws = self.tool == "lasso"  # then marks and handles would be in the way
        marks = [] if here is None or draws else list(here.marks)
        marks += [
            Marker(f"click.{k}", p.longitude, p.latitude, "spot", str(k + 1), handles=())
            for k, p in enumerate(self._floor.clicks + self._level.clicks)
        ]
        marks += self._patch.marks() if self.tool in PATCH_TOOLS else []
        self._viewer.set_lines(self._lasso.drawn() if draws else [])
        self._viewer.set_drawing(self._lasso.kind if draws else "")
        self._viewer.set_marks(marks, here.edge if here is not None and self.tool in ("stand", "floor") else ())
        self._viewer.select(f"object.{self._number}")
        for button in (self._face, self._go, *self._trims):
            button.enable(bool(here is not None and here.bodies))
        if here is not None:
            keys = [f"object.{number}" for number in range(len(here.bodies))]
            stands = [self._document.get(f"{key}.stand_on") is not None for key in keys]
            words = {key: here.words(k, level=stands[k]) for k, key in enumerate(keys)}
            every = {f"{at}.{word}": value for at, of in words.items() for word, value in of.items()}
            self._show_words(every, self._number)

    def set_word(self, number: int, name: str, value: Any, group: str | None) -> bool:
        """Set a word of an object's place or size, in place of those that say the same; return False where nothing but
        it changes, which is left to the caller.
        """
        here, key = self._situation, f"object.{number}"
        if here is None or number >= len(here.bodies):
            return False
        words = self._document.get(key) or {}
        changes = in_words(words, name, value, lambda level: here.words(number, level=level))
        if changes is None:
            return False
        ordered = sorted(changes.items(), key=lambda change: change[1] is not None)  # what is removed goes first
        self._document.apply(f"set {key}.{name}", {f"{key}.{word}": now for word, now in ordered}, group=group)
        return True

    def trim(self, thirds: int) -> None:
        """Change the exposure of the chosen object by thirds of a stop, to whole thirds."""
        objects = self._document.scene.objects
        if not objects:
            return
        key = f"object.{min(self._number, len(objects) - 1)}.exposure"
        now = fields.values_at(self._document, self._session.time_s).get(key, self._document.get(key) or 0.0)
        stops = round(round(3.0 * now + thirds) / 3.0, 3)
        if (_LEAST_STOPS or 0.0) <= stops <= (_MOST_STOPS or 0.0):
            self._put(key, stops + 0.0)

    def _go_to(self) -> None:
        point = None if self._situation is None else self._situation.shown(self._number)
        if point is not None:
            self._viewer.turn_to(point)

    def choose(self, tool: str = "") -> None:
        """Take a tool of the list; "": none."""
        self.tool = tool
        self._choice.choose(tool)
        self._shut.set_visibility(bool(tool))
        self._patch.begin(shown=tool in PATCH_TOOLS)
        self._floor.begin(shown=tool == "floor")
        self._level.begin(shown=tool == "level")
        self._lasso.begin(shown=tool == "lasso")

    async def _picked(self, point: Point) -> None:
        if self.tool == "water":
            self._match_water(point)
        elif self.tool in PATCH_TOOLS:
            self._patch.add(point, self.tool)
        elif self.tool == "lasso":
            self._lasso.add([point])
        elif self.tool:
            await self._place(point)
        elif self._situation is not None and (found := self._situation.at(point)) is not None:
            self.select(found)

    async def _place(self, point: Point) -> None:
        """Ask for the frame's geometry, and place floor, sun or object by it."""
        here = await self._ask()
        if self.tool in ("floor", "level"):
            (self._floor if self.tool == "floor" else self._level).add(here.camera, point)
        elif self.tool == "sun":
            azimuth, elevation = (_short(angle, 2) for angle in here.sun_angles_deg(point))
            angles = {"light.sun_azimuth_deg": azimuth, "light.sun_elevation_deg": elevation}
            self._document.apply("sun by click", {"light.sun": "given", **angles})
        else:
            self._check_number(here)
            place = here.standing if self.tool == "stand" else here.swimming
            self._move(here, self._number, place(self._number, point))

    async def _dragged(self, drag: Drag) -> None:
        async with self._in_turn:  # the end of a short drag waits for what its start asks
            if drag.phase == "start":
                self._drag = None
                kind, _, digits = drag.name.partition(".")
                here, number = await self._ask(), int(digits)
                if kind == "object":
                    self._number = number
                    self._check_number(here)
                self._drag = here, kind, number
                self._asked += 1
            if self._drag is None or drag.phase == "start":
                return
            here, kind, number = self._drag
            group = f"{self._viewer.client.id} drag {id(here)}"
            if kind == "object":
                self._drag_object(drag, here, number, group)
            elif kind == "lamp":
                point = drag.start if drag.phase == "cancel" else drag.point
                self._put(f"lamp.{number}.position_m", [_short(part, 4) for part in here.lamp_at(number, point)], group)
            if drag.phase in ("end", "cancel"):
                self._drag = None
                self._session.pictures.settle()

    def _drag_object(self, drag: Drag, here: Situation, number: int, group: str) -> None:
        body = here.bodies[number]
        point = drag.start if drag.phase == "cancel" else drag.point
        shown = here.shown(number)
        stands = self._document.get(f"object.{number}.stand_on") is not None
        if drag.handle == "reach" and body.settings.polar:  # the direction stays as it is written
            away = here.words(number, level=stands)["distance_m"]
            self._put(f"object.{number}.distance_m", _short(drag.farther * away, 4), group)
        elif drag.handle in ("move", "reach"):
            to = shown if drag.handle == "reach" and shown is not None else point  # a mark may be of before
            self._move(here, number, here.swimming(number, to, drag.farther, level=stands), group)
        elif shown is not None and drag.handle == "turn":
            # An azimuth that it faces turns; a rotation does, which is from there where it faces the camera
            face, (yaw, *rest) = body.settings.face, body.settings.rotation_deg
            before, step = face if isinstance(face, float) else yaw, _TURN_STEP_DEG if drag.shift else 0.0
            now = _short(placing.yaw_by_drag(before, shown, drag.start, point, step), 2)
            word, value = ("face", now) if isinstance(face, float) else ("rotation_deg", [now, *rest])
            self._put(f"object.{number}.{word}", value, group)
        elif shown is not None:
            with self._document.together(f"scale object.{number}", group=group):
                for word, before in body.sizes.items():
                    size = placing.scale_by_drag(before, shown, drag.start, point)
                    self._put(f"object.{number}.{word}", before if point == drag.start else float(f"{size:.4g}"), group)

    def _face_camera(self) -> None:
        assert self._situation is not None
        self._check_number(self._situation)
        key, (_, *rest) = f"object.{self._number}", self._situation.bodies[self._number].settings.rotation_deg
        rotation = [0.0, *rest] if any(rest) else None
        self._document.apply(f"set {key}.face", {f"{key}.face": "camera", f"{key}.rotation_deg": rotation})

    def _check_number(self, here: Situation) -> None:
        if not here.bodies:
            raise ParameterError("object - there is none to place (got 0) - add one first")
        self._number = min(self._number, len(here.bodies) - 1)

    def _move(self, here: Situation, number: int, position: Floats, group: str | None = None) -> None:
        """Set the place of an object, a position (3,) in the world, in the words that the file has for it."""
        key, raised = f"object.{number}", abs(position[1] - here.bodies[number].position[1]) > _SAME_M
        table = self._document.get(key)
        stands = table.get("stand_on") is not None and not raised
        now, before = (here.words(number, at, level=stands) for at in (position, None))
        # Of directions and distances, those that the file has and those that change
        words = [w for w in POLAR if w in table or (now[w] != before[w] and not (stands and w == "elevation_deg"))]
        words = words if any(w in table for w in POLAR) else ["position_m"]
        with self._document.together(f"move {key}", group=group):
            if raised:
                self._document.apply(f"move {key}", {f"{key}.stand_on": None})
            for word in words:
                self._put(f"{key}.{word}", now[word], group)

    def _put(self, key: str, value: Any, group: str | None = None) -> None:
        """Set a parameter, or its key of this time where it has keys."""
        if key in fields.keyed_parameters(self._document):
            fields.set_key(self._document, key, self._session.time_s, value, group=group)
        else:
            self._document.set(key, value, group=group)


def _short(value: float, digits: int) -> float:
    return round(float(value), digits) + 0.0


_WIDTHS = (512, 1024, 2048, 4096, 8192)
_COMPARISONS = {"": "compare with …", "plate": "compare with the plate"}


class ShownPicture:
    """The picture of a tab. tools, tool_bars: of the bars above it, to be filled."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._shown_number = 0
        self._other: tuple[object, ...] = ()
        self._compared = ""
        with ui.element("main").classes("page-stage"):
            with ui.element("div").classes("stage-bar"):
                self._views = Choice("What is shown", VIEW_NAMES, session.view, session.look)
                widths = sorted({*(w for w in _WIDTHS if w < session.clip.width), session.clip.width})
                self._width = Choice(
                    "Width of the full picture", {str(w): f"{w} px" for w in widths}, str(session.width),
                    lambda width: session.look(width=int(width)),
                )  # fmt: skip
                self._comparison = Choice("Compare with", _COMPARISONS, "", self._compare)
                self.tools = ui.element("span").classes("stage-tools")
            with ui.element("div").classes("stage-bar"):
                self.tool_bars = ui.element("span").classes("stage-tools")
                ui.element("span").classes("grow")
                self._status = Text("", classes="status").props("role=status")
            self._problems = ui.element("div")
            with ui.element("div").classes("stage-picture"):
                self.viewer = Viewer()
        self.viewer.on_compare(self._follow_viewer)

    def expect(self) -> None:
        """Mark the picture as older than the document."""
        if self._session.behind:
            self.viewer.expect()
        self._offer()
        self.follow()

    def show(self) -> None:
        """Show the newest picture, or why there is none."""
        session, picture = self._session, self._session.picture
        if picture is not None and picture.number != self._shown_number:
            self._shown_number = picture.number
            if self._compared:  # what is no panorama is shown alone
                self.viewer.set_compare("wipe" if picture.panorama else "none")
            self.viewer.show(
                f"/picture/{picture.number}", stale=not session.is_present(picture), coarse=picture.draft,
                stand_in=picture.stand_in, panorama=picture.panorama, name=VIEW_NAMES[picture.wanted.view],
            )  # fmt: skip
        self._problems.clear()
        with self._problems:
            if session.problems:
                alert(session.problems)
        self.follow()
        if self._compared == "plate":
            self._compare("plate")

    def follow(self) -> None:
        """Show where in the clip the page is, and what the picture is of."""
        session, picture = self._session, self._session.picture
        words = []
        if picture is not None:
            words += ["light of the clip"] if picture.measured else []
            words.append(f"{picture.width} x {picture.height}, {1000.0 * picture.seconds:.0f} ms")
        if session.behind:
            words.append("rendering")
        self._status.text = " · ".join(words)
        self._width.choose(str(session.width))
        self._views.choose(session.view)

    def _offer(self) -> None:
        """Offer the pictures that there are to compare with; choose the one that is compared with."""
        session = self._session
        names = [name for name in session.document.snapshots if name in session.kept_pictures]
        names += [SNAPSHOT] if self._compared == SNAPSHOT else []
        if self._compared not in (*names, *_COMPARISONS):  # it was forgotten
            self._compared = ""
            self.viewer.set_compare("none")
        self._comparison.offer(_COMPARISONS | {name: f"compare with {name}" for name in names}, self._compared)

    def _follow_viewer(self, comparison: Compare, second: str) -> None:
        """Choose in the list what the viewer's own buttons compare with."""
        self._compared = "" if comparison == "none" else second
        self._offer()

    def _compare(self, name: str) -> None:
        """Set the second picture, and show it beside a divider if it is chosen for the first time."""
        begins, self._compared = name != self._compared, name
        if not name:
            self.viewer.set_compare("none")
            return
        if begins:
            self.viewer.set_compare("wipe")
        session = self._session
        if name in session.kept_pictures:
            self.viewer.show_other(f"/picture/{session.kept_pictures[name]}", name)
            return
        wanted = (session.document.scene.plate, session.index, session.width)
        if begins or wanted != self._other:
            self._other = wanted
            background_tasks.create(self._show_plate(), name="plate", context=self.viewer)

    async def _show_plate(self) -> None:
        session = self._session
        scene, index, width = session.document.scene, session.index, session.width
        data = await session.ask(lambda renderer: renderer.plate(scene, index, width))
        if self._compared == "plate":
            self.viewer.show_other(f"/picture/{session.replaced('plate', data)}", "plate")
