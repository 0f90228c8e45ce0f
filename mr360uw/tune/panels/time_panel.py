# SPDX-License-Identifier: Apache-2.0
"""The time line of a tab: thumbnails, play head, range, and the curve of a keyed parameter."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from nicegui import background_tasks, ui

from mr360uw.parameters import bounds_of, stated
from mr360uw.scene.key_targets import target_of
from mr360uw.tune.editing import tracks
from mr360uw.tune.panels.widgets import Choice
from mr360uw.tune.session import Session
from mr360uw.tune.timeline import Interpolation, Timeline

_AXES = ("right", "up", "back")


class TimePanel:
    """The time line of a tab. guarded: runs an action and tells its error."""

    def __init__(self, session: Session, guarded: Callable[[Callable[[], Any]], None]) -> None:
        self._session, self._document, self._guarded = session, session.document, guarded
        self._chosen, self._drag = "", 0
        self._playing = False
        clip = session.clip
        self.root = ui.element("footer").classes("page-foot")
        with self.root:
            self._line = Timeline(session.frame_count, float(clip.frame_rate))
            with ui.element("div").classes("foot-bar") as self._bar:
                self._choice = Choice("Keyed parameter", {"": "no curve"}, "", self.choose)
        self._line.on_seek(lambda frame, scrubbing: session.seek(frame, scrubbing=scrubbing))
        self._line.on_play(lambda playing: setattr(self, "_playing", playing))
        self._line.on_range(session.set_range)
        self._line.on_keys(self._edited)

    def begin(self) -> None:
        """Ask for the thumbnails, which would hold up the first picture."""
        background_tasks.create(self._session.make_thumbnails(), name="thumbnails")

    def play(self) -> None:
        """Start or stop playing."""
        self._line.run_method("play", not self._playing)

    def choose(self, name: str) -> None:
        """Show the curve of a keyed parameter, "name" or "name component"; "": none."""
        self._chosen = name
        self.refresh()

    def mark(self, key: str, default: Any) -> None:
        """Set a key of a parameter at the present time, or remove the one that is there; show its curve."""
        session, time_s = self._session, self._session.time_s
        if tracks.has_key(self._document, key, time_s):
            tracks.remove_key(self._document, key, time_s)
        else:
            now = tracks.values_at(self._document, time_s).get(key)
            value = tracks.present_value(self._document, key, default) if now is None else now
            tracks.set_key(self._document, key, time_s, value)
        held = tracks.tracks(self._document).get(key)
        vector = held is not None and isinstance(held.value[0], tuple)
        self.choose("" if held is None else f"{key} 0" if vector else key)
        session.show()

    def refresh(self) -> None:
        """Show the document's keys."""
        names = {"": "no curve"}
        for name, key in tracks.tracks(self._document).items():
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
        self._line.set_curve(self._curve(names[self._chosen]) if self._chosen else None)

    def follow(self) -> None:
        """Move the play head to the session's frame, and the range."""
        self._line.set_frame(self._session.index)
        self._line.set_range(*self._session.range)

    def _curve(self, label: str) -> dict[str, Any]:
        name, component = self._named()
        key = tracks.tracks(self._document)[name]
        field = target_of(self._document.scene, name).field
        low, high = bounds_of(field)
        values = [tracks.component_of(value, component) for value in key.value]
        end_s = self._session.frame_count / float(self._session.clip.frame_rate)
        return {
            "label": label, "unit": stated(field, "unit"), "keys": list(zip(key.time_s, values, strict=True)),
            "samples": tracks.samples(self._document, key, end_s, component), "interpolation": key.interpolation,
            "low": low, "high": high,
        }  # fmt: skip

    def _named(self) -> tuple[str, int | None]:
        name, _, component = self._chosen.partition(" ")
        return name, int(component) if component else None

    def _edited(self, keys: list[tuple[float, float]], interpolation: Interpolation, done: bool) -> None:
        name, component = self._named()
        key = tracks.tracks(self._document).get(name)
        if key is None:
            self.refresh()
            return
        pairs = keys if component is None else tracks.with_component(self._document, key, component, keys)
        group = f"{self._line.client.id} keys {self._drag}"
        self._guarded(partial(tracks.set_keys, self._document, name, pairs, interpolation, group=group))
        self._drag += done
        self.refresh()

    def show_thumbnails(self) -> None:
        """Show the small pictures of the plate that there are."""
        self._line.set_thumbnails({f: f"/picture/{n}" for f, n in self._session.thumbnails.items()})
