# SPDX-License-Identifier: Apache-2.0
"""The bar of the tool that draws mattes: around something or over it, in one frame or at keys of a clip."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np
from nicegui import background_tasks, ui
from numpy.typing import NDArray

from mr360uw.errors import Mr360uwError, ParameterError
from mr360uw.files import is_pattern, numbered, write_whole
from mr360uw.reading.disk_cache import stamp
from mr360uw.tune.controls import Button, Choice, Text
from mr360uw.tune.lasso import (
    Kind,
    Line,
    check_own,
    free_name,
    is_matte_name,
    is_whole,
    key_file,
    key_files,
    matte_of_lines,
    named_path,
    outlines_of_matte,
    pictures_at_stake,
    png,
    write_frames,
)
from mr360uw.tune.placing import Point
from mr360uw.tune.session import Session
from mr360uw.video.writer import picture_codes

_KINDS = {"outline": "around it", "inside": "over it", "outside": "not this"}
_NEW = "new matte"
_LISTED = 4
"""Most keys whose frames the bar lists; of more, their number."""
_TOLD_FRAMES = 5
"""Frames between two words on how far a matte is carried."""


class LassoTool:
    """The tool of a tab. failed: tells an error. changed: called when what is drawn or shown changes.

    lines: what is drawn, in this frame. kind: of the next line.
    """

    def __init__(self, session: Session, failed: Callable[[Exception], None], changed: Callable[[], None]) -> None:
        self._session, self._document = session, session.document
        self._failed, self._changed = failed, changed
        self._folder, self._clip = session.document.path.parent, session.frame_count > 1
        self.lines: list[Line] = []
        self.kind: Kind = "outline"
        self._name, self._index = "", session.index
        self._outlines: list[list[Point]] = []
        self._seen: object = None
        self._doing = ""
        self._shown = False
        with ui.element("span").classes("floor-tool") as self._root:
            self._choice = Choice("Which matte is drawn", {"": _NEW}, "", self._hold)
            Choice("What a line is drawn over", _KINDS, self.kind, self._draw)
            self._make = Button("Make matte", self._made, title="keep what is drawn before the objects")
            self._back = Button("Take back", self._take_back, title="forget the last line or point")
            self._drop = Button("Remove key", self._removed, title="of this frame")
            self._count = Text("", classes="status").props("role=status")
        self._root.set_visibility(False)

    def begin(self, *, shown: bool) -> None:
        """Forget what is drawn; show the tool or hide it."""
        self.lines, self._shown = [], shown
        self._root.set_visibility(shown)
        self.follow()
        self._changed()

    def follow(self) -> None:
        """Follow the document and the frame: what was drawn in another frame is forgotten."""
        if self._index != self._session.index:
            self._index, self.lines = self._session.index, []
        names = list(self._mattes())
        self._name = self._name if self._name in names else ""
        self._choice.offer({"": _NEW} | {name: name for name in names}, self._name)
        self._tell()
        if self._shown:
            background_tasks.create(self._look(), name="outline of a matte")

    def add(self, points: list[Point]) -> None:
        """Take a line that was drawn, or a point that was clicked."""
        self.lines.append((self.kind, tuple(points)))
        self._tell()
        self._changed()

    def drawn(self) -> list[tuple[str, list[Point]]]:
        """Return the lines to show: what is drawn, and the outline of the matte as it is in this frame."""
        around = [point for kind, points in self.lines if kind == "outline" for point in points]
        closed = [*around, *(around[:1] if len(around) > 2 else [])]
        strokes: list[tuple[str, list[Point]]] = [(kind, [*line]) for kind, line in self.lines if kind != "outline"]
        return [*(("matte", line) for line in self._outlines), *([("outline", closed)] if closed else []), *strokes]

    # --- what is chosen

    def _hold(self, name: str) -> None:
        self._name, self.lines = name, []
        self.follow()
        self._changed()

    def _draw(self, kind: str) -> None:
        self.kind = cast("Kind", kind)
        self._changed()

    def _take_back(self) -> None:
        self.lines = self.lines[:-1]
        self._tell()
        self._changed()

    def _mattes(self) -> dict[str, int]:
        """Return the numbers of the scene's holdouts that were drawn here, by the mattes' names."""
        found = {}
        for number, row in enumerate(self._document.get("holdout") or []):
            parts = Path(str(row.get("path", ""))).parts
            name = Path(parts[0]).stem if len(parts) == 1 else parts[0] if len(parts) == 2 else ""
            if is_matte_name(name):
                found[name] = number
        return found

    def _keys(self) -> list[int]:
        return list(key_files(self._folder / self._name)) if self._name and self._clip else []

    def _tell(self) -> None:
        if self._root.is_deleted:
            return
        keys, busy = self._keys(), bool(self._doing)
        here = self._index in keys or not self._clip
        self._make.text = "Make matte" if not self._name else "Make it again" if here else "Make key"
        self._make.enable(is_whole(self.lines) and not busy)
        self._back.enable(bool(self.lines) and not busy)
        self._drop.set_visibility(self._index in keys)
        self._drop.enable(not busy)
        words = [f"{len(self.lines)} drawn"] if self.lines else [] if keys else ["draw, or click points"]
        frames = ", ".join(map(str, keys))
        if keys:
            words.append(f"keys: {frames}" if len(keys) <= _LISTED else f"{len(keys)} keys")
        self._count.text = self._doing or " · ".join(words)
        self._count.props["title"] = f"keys at frames {frames}" if keys else "an outline, or strokes over and beside it"

    async def _look(self) -> None:
        """Find the outline of the matte in hand, in this frame, where it is another than the one that is shown."""
        number = self._mattes().get(self._name)
        file = None
        if number is not None:
            path = self._folder / str(self._document.get(f"holdout.{number}.path"))
            file = numbered(path, self._index) if is_pattern(path) else path
        seen = None if file is None else (file, stamp(file))
        if seen == self._seen:
            return
        self._seen = seen
        found = [] if file is None else await asyncio.to_thread(_outlines_in, file)
        if seen == self._seen and not self._root.is_deleted:
            self._outlines = found
            self._changed()

    # --- what is done

    async def _made(self) -> None:
        session, lines, index = self._session, list(self.lines), self._index
        scene, width = self._document.scene, session.clip.width

        async def make() -> None:
            if scene.plate.eye == "both":
                raise ParameterError('matte - is of one eye (got plate.eye = "both") - set one eye, or give a file')
            job = session.pictures.ask(
                lambda renderer: picture_codes(renderer.preview.plates.at(scene, index, width), deep=False)
            )
            codes: NDArray[Any] = await asyncio.wrap_future(job)
            data = png(await asyncio.to_thread(matte_of_lines, codes, lines))
            name = self._name or free_name(self._folder)
            await self._check_own(name, index)
            if self._clip:
                (self._folder / name).mkdir(exist_ok=True)
                write_whole(key_file(self._folder / name, index), data)
                await self._carry(name, index)
            else:
                write_whole(self._folder / f"{name}.png", data)
            self._name = self._put(name)

        await self._busy("finding its edges", make)

    async def _removed(self) -> None:
        name, index = self._name, self._index

        async def remove() -> None:
            if len(self._keys()) == 1:
                raise ParameterError(
                    f"{name} - has one key left (got frame {index}) - remove the matte from the scene instead"
                )
            await self._check_own(name, index)
            key_file(self._folder / name, index).unlink(missing_ok=True)
            await self._carry(name, index)
            self._put(name)

        await self._busy("removing the key", remove)

    async def _busy(self, doing: str, work: Callable[[], Any]) -> None:
        self._doing = doing
        self._tell()
        try:
            await work()
        except (Mr360uwError, OSError) as error:
            self._failed(error)
        finally:
            self._doing = ""
            self.follow()

    async def _check_own(self, name: str, index: int) -> None:
        """Raise `OutputError` where a key at a frame would replace or remove a picture that was not drawn here."""
        files = pictures_at_stake(self._folder / name, index) if self._clip else [self._folder / f"{name}.png"]
        await asyncio.to_thread(check_own, files)

    async def _carry(self, name: str, index: int) -> None:
        """Write the pictures of all frames that a key has changed, and say how far that is."""
        loop = asyncio.get_running_loop()

        def tell(done: int, total: int) -> None:
            self._doing = f"carrying it, frame {done} of {total}"
            self._tell()

        def progress(done: int, total: int) -> None:
            if done % _TOLD_FRAMES == 0:
                loop.call_soon_threadsafe(tell, done, total)

        await asyncio.to_thread(write_frames, self._folder / name, self._session.frame_count, index, progress)

    def _put(self, name: str) -> str:
        """Let the scene name the pictures of a matte, and show them; return its name."""
        path = Path(f"{name}.png") if not self._clip else named_path(self._folder / name).relative_to(self._folder)
        number = self._mattes().get(name)
        if number is None:
            self._document.append("holdout", {"path": path.as_posix()})
        elif self._document.get(f"holdout.{number}.path") != path.as_posix():
            self._document.set(f"holdout.{number}.path", path.as_posix())
        else:
            self._session.show()  # of the same scene: what its files hold is new
        return name


def _outlines_in(file: Path) -> list[list[Point]]:
    """Return the outlines of a matte's file; none where it is gone."""
    try:
        found = cv2.imdecode(np.frombuffer(file.read_bytes(), np.uint8), cv2.IMREAD_GRAYSCALE)
    except (OSError, cv2.error):
        return []
    return [] if found is None else outlines_of_matte(cast("NDArray[np.uint8]", found))
