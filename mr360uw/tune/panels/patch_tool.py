# SPDX-License-Identifier: Apache-2.0
"""Patches of known colour from clicks in the picture, and how far away they are."""

from __future__ import annotations

from math import degrees, inf, nan, radians
from typing import Any

from nicegui import ui

from mr360uw.errors import ParameterError
from mr360uw.tune.marks import Marker
from mr360uw.tune.panels.widgets import Button
from mr360uw.tune.placing import Point
from mr360uw.tune.session import Session

PATCH_TOOLS = {
    "black": "Click: this is black",
    "grey": "Click: this is grey",
    "white": "Click: this is white",
}
"""What a click may say that something is, in the words of `[[match.patch]]`."""


class PatchTool:
    """The tool of a tab, in a bar of its own."""

    def __init__(self, session: Session) -> None:
        self._session, self._document, self._distance = session, session.document, ""
        with ui.element("span").classes("floor-tool") as self._root:
            given = ui.element("input").props(
                "type=text size=12 aria-label='Distance of what is clicked, in metres' placeholder='distance [m]'"
            )
            given.props["title"] = "its distance in the water; empty: nearer than about a metre"
            given.on("change", self._given, js_handler="(e) => emit(e.target.value)")
            Button("Forget patches", self._forget, title="remove all patches of known colour from the scene")
        self._root.set_visibility(False)

    def begin(self, *, shown: bool) -> None:
        """Show the tool or hide it."""
        self._root.set_visibility(shown)

    def add(self, point: Point, kind: str) -> None:
        """Add to the scene what was clicked in the present frame; raise `ParameterError` for no distance."""
        patch: dict[str, Any] = {
            "azimuth_deg": round(degrees(point.longitude), 2),
            "elevation_deg": round(degrees(point.latitude), 2),
            "is": kind,
            "time_s": round(self._session.time_s, 6),
        }
        if self._distance:
            patch["distance_m"] = _metres(self._distance)
        self._document.append("match.patch", patch)

    def marks(self) -> list[Marker]:
        """Return a mark on each patch of the scene."""
        marks = []
        for k, patch in enumerate(self._document.scene.match.patch):
            point = Point(radians(patch.azimuth_deg), radians(patch.elevation_deg))
            label = patch.shows if patch.distance_m is None else f"{patch.shows}, {patch.distance_m:g} m"
            marks.append(Marker(f"patch.{k}", point.longitude, point.latitude, "spot", label, handles=()))
        return marks

    def _given(self, event: Any) -> None:
        self._distance = str(event.args).strip()

    def _forget(self) -> None:
        if self._document.get("match.patch") is not None:
            self._document.unset("match.patch")


def _metres(text: str) -> float:
    """Return a length [m] as it is written; raise `ParameterError` where it is none above 0."""
    try:
        length_m = float(text.replace(",", ".").removesuffix("m"))
    except ValueError:
        length_m = nan
    if not 0.0 < length_m < inf:
        raise ParameterError(f"distance - is no length (got {text!r}) - write metres, as in 2.5, or nothing")
    return length_m
