# SPDX-License-Identifier: Apache-2.0
"""Pictures of a scene that changes, made by one thread with a live preview: always of the newest state asked for.

First a draft, then the picture at full size: at once, or within a drag when nothing was asked for a moment.
"""

from __future__ import annotations

import threading
import time
import traceback
from collections import OrderedDict, deque
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from mr360uw.base.input_files import Stamp, files_read, stamp
from mr360uw.errors import Mr360uwError
from mr360uw.preview.live import COARSE_WIDTH, LivePreview, coarse
from mr360uw.preview.screen import encoded
from mr360uw.scene.model import Scene
from mr360uw.tune.views import CHARTS, VIEWS, ShownFrame
from mr360uw.video.writer import picture_codes


@dataclass(frozen=True, slots=True)
class Wanted:
    """A picture to be made.

    revision: of the document whose scene it is. index: of the frame. view: a key of `views.VIEWS`. dark: its charts.
    width: [pixels] of the full picture. full: whether to make that once nothing else is asked for.
    """

    scene: Scene
    revision: int
    index: int
    view: str
    width: int
    full: bool = True
    dark: bool = True

    @property
    def draft_width(self) -> int:
        """Width [pixels] of a draft."""
        return min(self.width // 2, COARSE_WIDTH)


@dataclass(frozen=True, slots=True)
class MadePicture:
    """A picture that was made, as JPEG, with its size [pixels]; or, where none could be made, the problems.

    panorama: whether it is equirectangular. measured: whether its light is that of a clip that was measured. number: by
    which browsers fetch it. seconds: it took. stand_in: whether it is a draft of the nearest keyframe.
    """

    wanted: Wanted
    width: int = 0
    height: int = 0
    data: bytes = b""
    panorama: bool = True
    measured: bool = False
    number: int = 0
    draft: bool = False
    stand_in: bool = False
    seconds: float = 0.0
    problems: tuple[str, ...] = ()


_SHORT = 300
"""Frames of clips that are decoded whole for thumbnails where they have few keyframes; longer ones have more."""
_THUMBNAIL_WIDTH = 160


class PageRenderer(LivePreview):
    """A live preview with the pictures of the page."""

    def picture(self, wanted: Wanted, width: int) -> MadePicture:
        """Return a picture of about a width, without its number and kind; raises what `LivePreview.frame` raises."""
        draft = width <= COARSE_WIDTH and width < wanted.width
        scene = coarse(wanted.scene) if draft else wanted.scene
        frame = self.frame(scene, wanted.index, width, holds_light=draft)
        loaded = self.loaded(scene, width).at(frame.plate.time_s)
        plate = self.plates.reader(wanted.scene)
        duration_s = float((plate.frame_count or 0) / plate.frame_rate)
        shown = ShownFrame(frame, loaded, self.backend, duration_s, wanted.dark)
        codes = VIEWS[wanted.view](shown)
        size, measured = (codes.shape[1], codes.shape[0]), self.has_measured(scene, width)
        return MadePicture(wanted, *size, encoded(codes, ".jpg"), wanted.view not in CHARTS, measured)

    def stand_in(self, wanted: Wanted) -> int:
        """Return the frame to show while the one that is wanted is decoded, or that one."""
        try:
            return self.plates.soonest(wanted.scene, wanted.index, wanted.draft_width)
        except (Mr360uwError, OSError):  # the picture says it
            return wanted.index

    def plate(self, scene: Scene, index: int, width: int) -> bytes:
        """Return a frame of a scene's plate as JPEG; raise `VideoError`."""
        return encoded(picture_codes(self.plates.at(scene, index, width), deep=False), ".jpg")

    def thumbnails(self, scene: Scene, count: int) -> list[tuple[int, bytes]]:
        """Return (frame, JPEG) of up to `count` small frames of a scene's plate; raise `VideoError`."""
        made = self.plates.overview(scene, count, _THUMBNAIL_WIDTH)
        length = self.plates.reader(scene).frame_count or 1
        if len(made) < count and length <= _SHORT:
            frames = np.unique(np.linspace(0, length - 1, count).astype(int)).tolist()
            made = [self.plates.at(scene, frame, _THUMBNAIL_WIDTH) for frame in frames]
        return [(frame.index, encoded(picture_codes(frame, deep=False), ".jpg")) for frame in made]


REST_S = 0.15
"""Rest [s] before the full picture within a drag. Twice as long, it comes visibly late; at half of it slow drags start
full pictures that hold up the next draft."""
_QUICK_S = 0.1
"""Full pictures that take less [s] need no draft before them; at the end of a drag those that take twice as long."""
_KEPT = 48
"""Pictures that browsers may still fetch, of up to 1 MB."""
_PLAYED_BYTES = 1 << 28
"""Bytes of frames that are kept for playing: a minute and more at 1024 x 512."""

T = TypeVar("T")


class Pictures:
    """The thread that makes pictures. make: called in it for the renderer. publish: called in it with each picture."""

    def __init__(self, make: Callable[[], PageRenderer], publish: Callable[[MadePicture], None]) -> None:
        self._make, self._publish = make, publish
        self._changed = threading.Condition()
        self._wanted: Wanted | None = None
        self._jobs: deque[tuple[Callable[[Any], Any], Future[Any]]] = deque()
        self._urgent: deque[tuple[Callable[[Any], Any], Future[Any]]] = deque()
        self._closed = False
        self._kept: OrderedDict[int, bytes] = OrderedDict()
        self._stored: dict[int, bytes] = {}
        self._count = 0
        self._full_s = 1.0
        self._settled, self._whole = True, False
        self._played: dict[int, MadePicture] = {}  # full pictures of the present state, by frame
        self._files: dict[Path, Stamp] = {}  # that these were made of
        # Of the picture that is being made: whether nothing but the frame has changed since, and whether one that was
        # kept is shown instead
        self._same, self._passed = True, False
        self._thread = threading.Thread(target=self._run, name="pictures", daemon=True)
        self._thread.start()

    def want(self, wanted: Wanted, *, moving: bool = False, seen: bool = False, playing: bool = False) -> None:
        """Ask for a picture, in place of one that was asked for and not begun. moving: others are likely to follow.

        seen: whether nothing but the frame has changed since the last one, so that frames made before may be shown
        again. playing: without a draft before it.
        """
        with self._changed:
            if not seen or any(stamp(path) != before for path, before in self._files.items()):
                self._forget()
            made = self._played.get(wanted.index)
            self._wanted, self._settled, self._whole = None if made else wanted, not moving, playing
            self._passed = self._passed or made is not None
            self._changed.notify()
        if made is not None:
            self._publish(replace(made, wanted=wanted))

    def _forget(self) -> None:
        """Let go of the frames that were kept for playing."""
        for index in tuple(self._played):
            self._let_go(index)
        self._files.clear()
        self._same = False

    def _let_go(self, index: int) -> None:
        del self._stored[self._played.pop(index).number]

    def played(self) -> list[int]:
        """Return the frames, ascending, that are shown at once."""
        with self._changed:
            return sorted(self._played)

    def settle(self) -> None:
        """Say that no other picture is likely to follow: the full one need not wait."""
        with self._changed:
            self._settled = True
            self._changed.notify()

    def ask(self, job: Callable[[Any], T], *, urgent: bool = False) -> Future[T]:
        """Run a function of the renderer in its thread when no picture is wanted; return its future result.

        urgent: before the next picture; for functions of a few milliseconds.
        """
        future: Future[T] = Future()
        with self._changed:
            (self._urgent if urgent else self._jobs).append((job, future))
            self._changed.notify()
        return future

    def get(self, number: int) -> bytes | None:
        """Return the JPEG of a picture by its number while it is kept."""
        with self._changed:
            return self._stored.get(number) or self._kept.get(number)

    def store(self, data: bytes) -> int:
        """Keep a JPEG of another kind, as a thumbnail, for good; return its number."""
        with self._changed:
            self._count += 1
            self._stored[self._count] = data
            return self._count

    def drop(self, number: int) -> None:
        """Let go of a picture that was stored."""
        with self._changed:
            self._stored.pop(number, None)

    def close(self) -> None:
        """End the thread after the picture that it is at."""
        with self._changed:
            self._closed = True
            self._changed.notify()
        self._thread.join(timeout=30.0)

    def _run(self) -> None:
        renderer: PageRenderer | None = None
        while True:
            with self._changed:
                while self._wanted is None and not self._urgent and not self._jobs and not self._closed:
                    self._changed.wait()
                if self._closed:
                    break
                wanted, job = None, None
                if self._urgent or self._wanted is None:
                    job = (self._urgent or self._jobs).popleft()
                else:
                    wanted, self._wanted, self._same, self._passed = self._wanted, None, True, False
            try:
                renderer = renderer or self._make()
                if job is not None:
                    _run_job(job, renderer)
                elif wanted is not None:
                    self._serve(renderer, wanted)
            # of whatever kind: the page lives on this thread, and the next change may well be drawn
            except Exception as error:  # noqa: BLE001
                if job is not None:
                    job[1].set_exception(error)
                elif wanted is not None:
                    self._publish(self._numbered(_failed(wanted, error)))
        for _, future in (*self._urgent, *self._jobs):
            future.cancel()
        if renderer is not None:
            renderer.close()

    def _serve(self, renderer: PageRenderer, wanted: Wanted) -> None:
        """Make the draft and, at rest, the full picture, unless another is asked for meanwhile."""
        quick = wanted.full and (self._whole or self._full_s <= (2.0 if self._settled else 1.0) * _QUICK_S)
        if quick or (self._draft(renderer, wanted) and wanted.full and not self._rest(renderer)):
            self._one(renderer, wanted, draft=False)

    def _draft(self, renderer: PageRenderer, wanted: Wanted) -> bool:
        """Make the draft, after one of the nearest keyframe where that comes sooner; return whether it was made."""
        index = renderer.stand_in(wanted)
        if index != wanted.index:
            self._one(renderer, wanted, draft=True, index=index)
            if self._wanted:
                return False
        self._one(renderer, wanted, draft=True)
        return True

    def _rest(self, renderer: PageRenderer) -> bool:
        """Wait until nothing moves, and do what is urgent; return whether another picture is asked for by then."""
        while True:
            with self._changed:
                self._changed.wait_for(
                    lambda: self._wanted or self._urgent or self._closed or self._settled, timeout=REST_S
                )
                other = self._wanted is not None or self._passed or self._closed
                if other or not self._urgent:
                    return other
                job = self._urgent.popleft()
            _run_job(job, renderer)

    def _one(self, renderer: PageRenderer, wanted: Wanted, *, draft: bool, index: int | None = None) -> None:
        """Make and publish one picture; raises what `PageRenderer.picture` raises. index: of one that stands in."""
        start, shown = time.perf_counter(), wanted if index is None else replace(wanted, index=index)
        with files_read() as read:
            drawn = renderer.picture(shown, wanted.draft_width if draft else wanted.width)
        seconds = time.perf_counter() - start
        self._full_s = self._full_s if draft else seconds
        made = replace(drawn, wanted=wanted, draft=draft, stand_in=index is not None, seconds=seconds)
        made = self._numbered(made)
        if not draft:
            self._keep(made, {path: stamp(path) for path in read})
        if not self._passed:
            self._publish(made)

    def _keep(self, made: MadePicture, files: dict[Path, Stamp]) -> None:
        """Keep a full picture for playing, made of files, in place of the oldest ones where there is no room."""
        with self._changed:
            if not self._same:
                return
            if any(self._files.get(path, now) != now for path, now in files.items()):
                self._forget()  # those before were made of other files
            if made.wanted.index in self._played:  # it was asked for again before it was there
                self._let_go(made.wanted.index)
            self._played[made.wanted.index], self._stored[made.number] = made, made.data
            self._files |= files
            while sum(len(one.data) for one in self._played.values()) > _PLAYED_BYTES:
                self._let_go(next(iter(self._played)))

    def _numbered(self, picture: MadePicture) -> MadePicture:
        with self._changed:
            self._count += 1
            numbered = replace(picture, number=self._count)
            if numbered.data:
                self._kept[numbered.number] = numbered.data
            while len(self._kept) > _KEPT:
                self._kept.popitem(last=False)
        return numbered


def _failed(wanted: Wanted, error: Exception) -> MadePicture:
    """Return the words on a picture that could not be made; an error that nobody expected goes to stderr besides."""
    lines = getattr(error, "problems", None) or (str(error) or type(error).__name__,)
    if not isinstance(error, (Mr360uwError, OSError, MemoryError)):
        traceback.print_exception(error)
        kind, what = type(error).__name__, f": {error}" if str(error) else ""
        lines = (
            f"picture - drawing it failed (got {kind}{what}) - undo the last change, or make another one; that is a "
            "fault of mr360uw, and the terminal has the details to report",
        )
    return MadePicture(wanted, problems=tuple(lines))


def _run_job(job: tuple[Callable[[Any], Any], Future[Any]], renderer: PageRenderer) -> None:
    work, future = job
    if not future.set_running_or_notify_cancel():
        return
    try:
        future.set_result(work(renderer))
    except Exception as error:  # noqa: BLE001 - raised again by the process that waits
        future.set_exception(error)
