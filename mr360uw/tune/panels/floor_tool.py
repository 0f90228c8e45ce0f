# SPDX-License-Identifier: Apache-2.0
"""Height of the sea floor from points that are clicked on it and one known length."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from nicegui import ui

from mr360uw.errors import ParameterError
from mr360uw.tune import floor
from mr360uw.tune.panels.widgets import Button, Choice, Text
from mr360uw.tune.placing import Point
from mr360uw.tune.session import Session
from mr360uw.types import View

_KNOWN = {
    "height": "camera above the floor [m]",
    "distances": "distance of each point [m]",
    "lengths": "between the points [m]",
}


class FloorTool:
    """The tool of a tab, in a bar of its own. failed: tells an error. changed: called when the clicks change."""

    def __init__(self, session: Session, failed: Callable[[Exception], None], changed: Callable[[], None]) -> None:
        self._document, self._failed, self._changed = session.document, failed, changed
        self.clicks: list[Point] = []
        self._camera: View | None = None
        self._known, self._lengths = "height", ""
        with ui.element("span").classes("floor-tool") as self._root:
            self._count = Text("", classes="status").props("role=status")
            Choice("What is known of the floor", _KNOWN, "height", lambda known: setattr(self, "_known", known))
            given = ui.element("input").props("type=text size=8 aria-label='Known lengths in metres'")
            given.on("change", self._given, js_handler="(e) => emit(e.target.value)")
            Button("Set floor", self._set)
            Button("Forget points", lambda: self.begin(shown=True))
        self._root.set_visibility(False)

    def begin(self, *, shown: bool) -> None:
        """Forget all points; show the tool or hide it."""
        self.clicks = []
        self._count.text = "click points on the floor"
        self._root.set_visibility(shown)
        self._changed()

    def add(self, camera: View, point: Point) -> None:
        """Take a point that was clicked in a camera's picture."""
        self._camera = camera
        self.clicks.append(point)
        self._count.text = f"{len(self.clicks)} points"
        self._changed()

    def _given(self, event: Any) -> None:
        self._lengths = str(event.args)

    def _set(self) -> None:
        try:
            fit = self._fit()
            self._document.apply("floor by clicks", {"receiver.height_m": round(fit.height_m, 3)})
        except (ParameterError, OSError) as error:
            self._failed(error)
            return
        spread = f", the clicks deviate by {fit.error_m:.2g} m" if fit.error_m else ""
        ui.notify(f"The sea floor is at {fit.height_m:.2f} m{spread}: {fit.assumed}.")
        self.begin(shown=True)

    def _fit(self) -> floor.FloorFit:
        """Return the floor of the clicks; raise `ParameterError`."""
        if self._camera is None:
            raise ParameterError("floor - no point is clicked (got 0) - click on the floor")
        try:
            lengths = [float(part) for part in self._lengths.replace(",", " ").split()]
        except ValueError:
            raise ParameterError(f"floor - no lengths (got {self._lengths!r}) - write metres, as in 2.5, 3") from None
        if self._known == "height":
            return floor.floor_from_height(self._camera, self.clicks, lengths[0] if lengths else 0.0)
        if self._known == "distances":
            return floor.floor_from_distances(self._camera, self.clicks, lengths)
        return floor.floor_from_lengths(self._camera, self.clicks, lengths)
