# SPDX-License-Identifier: Apache-2.0
"""The state that all tabs of a tuning page share: document, time, view, newest picture, and the run beside the page;
and sliders in a notebook.
"""

from __future__ import annotations

import asyncio
import re
import sys
import time
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal

from mr360uw.base.progress import Progress
from mr360uw.errors import Mr360uwError, ParameterError, install_command
from mr360uw.preview.live import LivePreview
from mr360uw.preview.screen import screen_picture
from mr360uw.scene.model import Scene, load_scene
from mr360uw.scene.toml_model import dotted, scene_text, tables_of
from mr360uw.tune.document import Document, Observed, find, key_of
from mr360uw.tune.fields import Field, by_key, groups, without_numbers
from mr360uw.tune.pictures import MadePicture, PageRenderer, Pictures, T, Wanted
from mr360uw.video import VideoReader

State = Literal["running", "done", "failed", "cancelled"]
_MESSAGE_LINES = 40
"""Last lines of a run's output that are kept for its message."""


class CommandRun:
    """One run of a command; `state` is "running" until it ends. changed: called after every change.

    out: what it writes. phase: what it is at, as "rendering". done, total: frames of that. seconds_left: None before
    the first frame. message: what the command printed at its end.
    """

    def __init__(self, out: Path, changed: Callable[[], None]) -> None:
        self.out, self._changed = out, changed
        self.state: State = "running"
        self.phase, self.done, self.total = "", 0, 0
        self.seconds_left: float | None = None
        self.message = ""
        self._process: asyncio.subprocess.Process | None = None
        self._cancelled = False
        self._first: tuple[int, float] | None = None

    async def run(self, command: Sequence[str]) -> None:
        """Run a command of mr360uw, with --progress-lines among its words, to its end; one that was stopped goes on."""
        self._process = await asyncio.create_subprocess_exec(
            sys.executable, "-m", "mr360uw", *command, stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.STDOUT, start_new_session=True,
        )  # fmt: skip
        assert self._process.stdout is not None
        said: deque[str] = deque(maxlen=_MESSAGE_LINES)
        async for data in self._process.stdout:
            line = data.decode(errors="replace").rstrip()
            counted = re.fullmatch(r"frame (\d+) of (\d+|unknown)", line)
            if line.startswith("phase "):
                self.phase, self.done, self.seconds_left, self._first = line.removeprefix("phase "), 0, None, None
                self._changed()
            elif counted is None:
                said.append(line)
            else:
                self._count(int(counted[1]), 0 if counted[2] == "unknown" else int(counted[2]))
        code = await self._process.wait()
        self.message = "\n".join(said)
        self.state = "done" if code == 0 else "cancelled" if self._cancelled else "failed"
        self._changed()

    def cancel(self) -> None:
        """End the run: its finished parts stay, the next run to the same output goes on from them.

        Not as Ctrl+C does, which a page that was started in the background ignores, and its runs with it.
        """
        if self._process is not None and self._process.returncode is None:
            self._cancelled = True
            self._process.terminate()

    def _count(self, done: int, total: int) -> None:
        now = time.monotonic()
        if self._first is None or done < self._first[0] or total != self.total:  # a first pass counts its own frames
            self._first = (done, now)
        self.done, self.total = done, total
        start, began = self._first
        self.seconds_left = (now - began) / (done - start) * (total - done) if done > start and total else None
        self._changed()


Event = Literal["document", "picture", "time", "run", "thumbnails"]
"""Kind of a change that a session tells of."""
_THUMBNAILS = 12
"""Pictures on the time line: as many as are 100 pixels wide on a small screen."""


class Session(Observed):
    """A document, where in its clip the page is, and how the picture is shown. For the thread of the event loop.

    pictures: makes the pictures; what it publishes goes to `take`. clip: of the plate. frame_count: of the clip, 1 for
    a still. width: of full pictures [pixels]. backend: of the pictures and of runs. picture: the newest that could be
    made, of whatever state. problems: why the newest state has none. run: the last run of the whole clip. range: frames
    start:stop of it. thumbnails: numbers of small pictures, by frame. kept_pictures: numbers of pictures that snapshots
    and comparisons keep, by name.
    """

    def __init__(
        self, document: Document, pictures: Pictures, clip: VideoReader, width: int, backend: str = "auto"
    ) -> None:
        super().__init__()
        self.document, self.pictures, self.clip = document, pictures, clip
        self.width, self.backend = min(width, clip.width), backend
        self.run: CommandRun | None = None
        self.index, self.view, self.dark = 0, "composite", True
        self.frame_count = clip.frame_count or 1
        self.range = (0, self.frame_count)
        self.thumbnails: dict[int, int] = {}
        self._asked_thumbnails = False
        self.kept_pictures: dict[str, int] = {}
        self.picture: MadePicture | None = None
        self.problems: tuple[str, ...] = ()
        document.observe(self._document_changed)

    @property
    def time_s(self) -> float:
        """Time of the frame that is shown."""
        return self.index / float(self.clip.frame_rate)

    def is_present(self, picture: MadePicture) -> bool:
        """Whether a picture is of the present state, as a draft or at full size."""
        return picture.wanted == self._wanted(full=picture.wanted.full)

    @property
    def behind(self) -> bool:
        """Whether the picture is not of the present state at full size."""
        return self.picture is None or self.picture.draft or not self.is_present(self.picture)

    def show(self, *, full: bool = True, moving: bool = False) -> None:
        """Ask for a picture of the present state. full: at full size. moving: that can wait until nothing changes."""
        self.pictures.want(self._wanted(full=full), moving=moving)

    def seek(self, index: int, *, scrubbing: bool = False, playing: bool = False) -> None:
        """Show another frame of the clip, the nearest there is; at once where it was made before, and is as it was.

        scrubbing: more will follow, and a draft will do. playing: the next is asked for once this one is there.
        """
        index = min(max(index, 0), self.frame_count - 1)
        moved, self.index = index != self.index, index
        kept = not playing or index in self.pictures.played()  # the head goes on from frames that are
        if moved or not kept or (not scrubbing and self.behind):
            self.pictures.want(self._wanted(full=not scrubbing), seen=True, playing=playing)
        if moved:
            self._tell("time")

    def look(self, view: str | None = None, *, width: int | None = None, dark: bool | None = None) -> None:
        """Show another view, at another width of full pictures, or with charts that are dark or light."""
        self.view = self.view if view is None else view
        self.width = self.width if width is None else min(width, self.clip.width)
        self.dark = self.dark if dark is None else dark
        self.show()
        self._tell("time")

    def start_run(self, out: Path) -> CommandRun:
        """Return a new run to an output; raise `ParameterError` while another one is going on."""
        if self.run is not None and self.run.state == "running":
            raise ParameterError(f"render - a run is going on (got {self.run.out}) - wait for it, or cancel it")
        self.run = CommandRun(out, lambda: self._tell("run"))
        self._tell("run")
        return self.run

    def set_range(self, start: int, stop: int) -> None:
        """Set the frames start:stop that are played and rendered."""
        if (start, stop) != self.range:
            self.range = (start, stop)
            self._tell("time")

    def keep_picture(self, name: str) -> None:
        """Keep the newest picture under a name."""
        data = None if self.picture is None else self.pictures.get(self.picture.number)
        if data is not None:
            self.replaced(name, data)

    def replaced(self, name: str, data: bytes) -> int:
        """Keep a JPEG under a name, in place of one that had it; return its number."""
        if name in self.kept_pictures:
            self.pictures.drop(self.kept_pictures[name])
        self.kept_pictures[name] = self.pictures.store(data)
        return self.kept_pictures[name]

    async def measure_clip(self, progress: Progress) -> None:
        """Measure the clip's light as a composite does; pictures use it from then on. Raises what loading raises.

        progress: called by another thread; an exception of it ends the pass.
        """
        scene = self.document.scene
        analysis = await asyncio.to_thread(_measured, scene, progress)
        await self.ask(lambda renderer: renderer.take_analysis(scene, analysis), urgent=True)
        self.show()

    async def make_thumbnails(self) -> None:
        """Make the small pictures of the plate, unless they are there; tell when they are."""
        if self._asked_thumbnails:
            return
        self._asked_thumbnails, scene = True, self.document.scene
        try:
            made = await self.ask(lambda renderer: renderer.thumbnails(scene, _THUMBNAILS))
        except (Mr360uwError, OSError):  # the picture's own message says why; the next tab tries again
            self._asked_thumbnails = False
            return
        self.thumbnails = {frame: self.pictures.store(data) for frame, data in made}
        self._tell("thumbnails")

    async def ask(self, job: Callable[[PageRenderer], T], *, urgent: bool = False) -> T:
        """Return what a function of the renderer returns, run in the renderer's thread; see `Pictures.ask`."""
        return await asyncio.wrap_future(self.pictures.ask(job, urgent=urgent))

    def take(self, picture: MadePicture) -> None:
        """Take a picture that was made."""
        if picture.problems:
            self.problems = picture.problems
        else:
            self.picture, self.problems = picture, ()
        self._tell("picture")

    def _wanted(self, *, full: bool) -> Wanted:
        document = self.document
        return Wanted(document.scene, document.revision, self.index, self.view, self.width, full, self.dark)

    def _document_changed(self) -> None:
        if self.picture is None or self.picture.wanted.revision != self.document.revision:
            self.show(moving=self.document.dragging)
        self._tell("document")


def _measured(scene: Scene, progress: Progress) -> Any:
    with LivePreview("reference") as own:  # which draws nothing; the one that draws belongs to its thread
        return own.measure(scene, progress)


# --- A few sliders in a notebook ------------------------------------------------------------------------------------

# Sliders in a notebook: some parameters of a scene file, and the composite of one frame, drawn anew when one moves.


def sliders(scene: str | Path, *keys: str, frame: int = 0, width: int = 768, backend: str = "auto") -> Any:
    """Return a widget (`ipywidgets.VBox`): a slider for each key, below them one frame of the scene file's composite.

    keys: of numbers, with dots, as in "sea.wind_speed" and "object.0.scale". width: of the picture [pixels]. The file
    is not changed: `widget.overrides` are the values as `load_scene` and `--set` take them. A value that makes no scene
    is told below the sliders, and the last picture stays. Raises `ParameterError` for keys that are no numbers with a
    slider and where ipywidgets is missing, `SceneError`.
    """
    try:
        import ipywidgets as widgets
    except ImportError:
        raise ParameterError(f"sliders - need ipywidgets (got none) - {install_command('notebook')}") from None
    # Make a slider for each key, at the value of the file
    path, live = Path(scene), LivePreview(backend)
    load_scene(path)
    tables = tables_of(scene_text(path), str(path))
    rows = [_slider(widgets, key, _field(key), find(tables, key_of(".".join(dotted(key))))) for key in keys]
    picture, message = widgets.Image(format="jpeg", width=width), widgets.Label()
    box = widgets.VBox([*rows, message, picture])

    # Draw the frame anew when a slider moves; an error leaves the last picture
    def draw(_: Any = None) -> None:
        box.overrides = tuple(f"{key}={row.value}" for key, row in zip(keys, rows, strict=True))
        try:
            image = live.frame(load_scene(path, box.overrides), frame, width).picture.image_linear
        except Mr360uwError as error:
            message.value = str(error)
            return
        picture.value, message.value = screen_picture(image, ".jpg"), ""

    for row in rows:
        row.observe(draw, "value")
    draw()
    return box


def _field(key: str) -> Field:
    """Return the description of a number; raise `ParameterError` for other keys."""
    field = by_key(groups()).get(without_numbers(".".join(dotted(key))))
    if field is None or field.span is None or field.kind not in ("number", "integer"):
        raise ParameterError(f"{key} - is no number with a slider (got {key!r}) - take for example sea.wind_speed")
    return field


def _slider(widgets: Any, key: str, field: Field, value: Any) -> Any:
    assert field.span is not None
    low, high = field.span
    value = field.default if value is None else value
    value = (low + high) / 2.0 if value is None else value
    kind = widgets.IntSlider if field.kind == "integer" else widgets.FloatSlider
    step = 1 if field.kind == "integer" else field.step
    unit = f" [{field.unit}]" if field.unit else ""
    look = {"description": key, "tooltip": f"{field.help}{unit}", "continuous_update": False}
    return kind(value=value, min=min(low, value), max=max(high, value), step=step, **look)
