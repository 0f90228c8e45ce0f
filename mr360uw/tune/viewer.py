# SPDX-License-Identifier: Apache-2.0
"""The viewer: an element of the tuning page that shows a picture, flat or around the viewer, and takes clicks on it.

Angles are longitude and latitude [rad] in the camera's axes (`mr360uw.sphere`), but for the look-around view, which is
given as `preview.perspective.Perspective` has it, in degrees. The browser's side is viewer.js.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

from nicegui.element import Element
from nicegui.events import GenericEventArguments

from mr360uw.tune.placing import Point
from mr360uw.tune.situation import Handle, Marker

Phase = Literal["start", "move", "end", "cancel"]
Compare = Literal["none", "wipe", "side"]
SNAPSHOT = "snapshot"
"""Name of a second picture that the viewer's own button keeps."""


@dataclass(frozen=True, slots=True)
class Drag:
    """A drag of a handle, or an arrow key on it: from `start` to `point`. name: of the marker.

    phase: "start", then any number of "move" (at most 25 a second), then "end", or "cancel" where nothing is to change.
    shift: whether that key is held.
    """

    phase: Phase
    handle: Handle
    name: str
    start: Point
    point: Point
    shift: bool


class Viewer(Element, component="viewer.js", esm={"mr360uw-tune": "js"}):
    """A picture that is looked at and clicked on, and has buttons. It fills its parent, which needs a height."""

    def __init__(self) -> None:
        super().__init__()
        self._serial, self._others = 0, 0
        self._props.update(
            {"picture": None, "other": None, "expected": 0, "markers": [], "horizon": [], "drawn": [], "selected": "",
             "look": False, "compare": "none", "drawing": ""}
        )  # fmt: skip
        self.classes("w-full h-full")
        # what its own buttons change is what Python has set
        self.on("mode", lambda event: self.set_look(look=event.args["look"]))
        self.on("compare", lambda event: self.set_compare(event.args["compare"]))

    # --- pictures

    def expect(self) -> None:
        """Say that the settings have changed: the picture is marked as older until one is shown that is not stale."""
        self._props["expected"] = self._serial + 1
        self.update()

    def show(
        self, url: str, *, stale: bool = False, coarse: bool = False, stand_in: bool = False, panorama: bool = True,
        name: str = "composite",
    ) -> int:  # fmt: skip
        """Show the picture at a URL of this server; return its serial number.

        It is shown once it is loaded, unless a newer one is there by then; the view stays. stale: the settings have
        changed since it was rendered. coarse: a draft of the picture that will follow. stand_in: a draft of the nearest
        keyframe. Each is marked. panorama: whether it is equirectangular and can be looked around in. name: for the
        chip beside a second picture. The URL must be another for another picture.
        """
        self._serial += 1
        self._props["picture"] = {
            "url": url, "serial": self._serial, "stale": stale, "coarse": coarse, "stand_in": stand_in,
            "panorama": panorama, "name": name,
        }  # fmt: skip
        if stale:
            self._props["expected"] = self._serial + 1
        self.update()
        return self._serial

    def show_other(self, url: str, name: str = "plate") -> None:
        """Set the second picture, for `set_compare`; its size may differ, its projection not."""
        self._others += 1
        self._props["other"] = {"url": url, "serial": self._others, "name": name}
        self.update()

    def set_compare(self, compare: Compare) -> None:
        """Show the picture alone, with a draggable divider to the second one, or both beside each other."""
        self._props["compare"] = compare
        self.update()

    # --- views and marks

    def set_look(self, *, look: bool) -> None:
        """Look around in a panorama, or show it flat."""
        self._props["look"] = look
        self.update()

    def turn_to(self, point: Point) -> None:
        """Look at a point of the picture."""
        self.run_method("turnTo", {"longitude": point.longitude, "latitude": point.latitude})

    def set_marks(self, markers: Sequence[Marker], horizon: Sequence[Sequence[Point]] = ()) -> None:
        """Replace the marks, and the lines that show the edge of the receiver."""
        self._props["markers"] = [asdict(marker) for marker in markers]
        self._props["horizon"] = [[[p.longitude, p.latitude] for p in line] for line in horizon]
        self.update()

    def set_lines(self, lines: Sequence[tuple[str, Sequence[Point]]]) -> None:
        """Replace the lines that are drawn in the picture: (kind, points) of each; a single point is a dot.

        kind: its colour: "outline", "inside" or "outside" of something, or "matte", the outline of one that was made.
        """
        self._props["drawn"] = [[kind, [[p.longitude, p.latitude] for p in line]] for kind, line in lines]
        self.update()

    def set_drawing(self, kind: str) -> None:
        """Let drags draw lines of a kind, as `set_lines` has them, instead of turning the view; "": they turn it."""
        self._props["drawing"] = kind
        self.update()

    def select(self, name: str | None) -> None:
        """Give the marker of a name its handles; None: no marker."""
        self._props["selected"] = name or ""
        self.update()

    # --- events

    def on_pick(self, handler: Callable[[Point], Any]) -> None:
        """Call a handler for each click on a panorama that is no drag, and for Enter (the middle of the view)."""

        def told(event: GenericEventArguments) -> Any:
            a = event.args
            return None if a.get("longitude") is None else handler(Point(a["longitude"], a["latitude"]))

        self.on("pick", told)

    def on_stroke(self, handler: Callable[[list[Point]], Any]) -> None:
        """Call a handler with the points of each line that a drag has drawn, see `set_drawing`."""
        self.on("stroke", lambda event: handler([Point(a, b) for a, b in event.args["points"]]))

    def on_drag(self, handler: Callable[[Drag], Any]) -> None:
        """Call a handler for each step of a drag of a handle."""

        def told(event: GenericEventArguments) -> Any:
            a, start = event.args, event.args["start"]
            began = Point(start["longitude"], start["latitude"])
            here = Point(a["longitude"], a["latitude"])
            return handler(Drag(a["phase"], a["handle"], a["name"], began, here, a["shift"]))

        self.on("drag", told)

    def on_select(self, handler: Callable[[str], Any]) -> None:
        """Call a handler with the name of a marker that is clicked on."""
        self.on("select", lambda event: handler(event.args["name"]))

    def on_compare(self, handler: Callable[[Compare, str], Any]) -> None:
        """Call a handler with how pictures are compared, and the second one's name, when its own buttons change that.

        The name is `SNAPSHOT` where the second picture is one that was kept in the viewer alone.
        """
        self.on("compare", lambda event: handler(event.args["compare"], event.args["second"]))
