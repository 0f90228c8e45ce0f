# SPDX-License-Identifier: Apache-2.0
"""Bars of tools for clicks in the picture: the height of the sea floor, patches of known colour, the horizon,
outlines of mattes.

Rays alone leave the scale of a scene open, so that one length has to be known: the camera's height above the floor,
distances from the camera, or lengths between clicked points. All fits assume a level floor and a levelled camera:
with an error e [rad] of its level, a height found at a distance D along the ground is wrong by D tan e.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from math import degrees, inf, nan, radians
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np
from nicegui import background_tasks, ui

from mr360uw.base.files import is_pattern, numbered, write_whole
from mr360uw.base.input_files import stamp
from mr360uw.errors import ParameterError
from mr360uw.ibl.tilt import roll_pitch
from mr360uw.tune import lasso
from mr360uw.tune.controls import Button, Choice, Text, text_input
from mr360uw.tune.fields import SAME_S
from mr360uw.tune.lasso import Kind, Line
from mr360uw.tune.placing import Point, ray
from mr360uw.tune.session import Session
from mr360uw.tune.situation import Marker
from mr360uw.types import Floats, View
from mr360uw.video.writer import picture_codes

FloorFit = tuple[float, float, str]
"""A level floor: its height [m] in the world, as `receiver.height_m`, the root mean square deviation [m] from what was
given, 0 where nothing is left to compare, and what is assumed, in words."""


def floor_from_height(camera: View, clicks: Sequence[Point], camera_height_m: float) -> FloorFit:
    """Return the floor that lies `camera_height_m` below the camera, whatever was clicked; raise `ParameterError`."""
    _per_height(camera, clicks)
    height = _positive("height of the camera above the floor", camera_height_m)
    return float(camera.position[1]) - height, 0.0, f"the camera is {height:g} m above a level floor"


def floor_from_distances(camera: View, clicks: Sequence[Point], distance_m: Sequence[float]) -> FloorFit:
    """Return the level floor nearest to points that are clicked at known distances [m] along their rays.

    Least squares over the vertical deviations: the mean of the points' heights. Raises `ParameterError`.
    """
    _per_height(camera, clicks)
    reach = [_positive("distance of a clicked point", d) for d in distance_m]
    _same_count(clicks, reach, "distances")
    points = np.stack([camera.position + d * ray(camera, p) for d, p in zip(reach, clicks, strict=True)])
    heights = points[:, 1]
    words = "the floor is level, and the points are as far from the camera as given"
    return float(np.mean(heights)), float(np.std(heights)), words


def floor_from_lengths(camera: View, clicks: Sequence[Point], length_m: Sequence[float]) -> FloorFit:
    """Return the level floor on which clicked points are known lengths [m] apart, the first from the second and so on.

    For a camera h above the floor the lengths are h times those for h = 1; h is their least squares fit. Raises
    `ParameterError`.
    """
    slope = _per_height(camera, clicks)
    lengths = np.array([_positive("length on the floor", one) for one in length_m])
    _same_count(clicks[1:], lengths, "lengths")
    unit_lengths = np.linalg.norm(np.diff(slope, axis=0), axis=-1)
    if not np.any(unit_lengths > 0.0):
        raise ParameterError("floor - all clicked points are the same (got no length) - click points that are apart")
    height = float(unit_lengths @ lengths / (unit_lengths @ unit_lengths))
    error = float(np.sqrt(np.mean((height * unit_lengths - lengths) ** 2)))
    return float(camera.position[1]) - height, error, "the floor is level, and lengths on it are known"


def _per_height(camera: View, clicks: Sequence[Point]) -> Floats:
    """Return what rays meet on a floor 1 m below the camera, from the camera, (n, 3); raise `ParameterError`."""
    if not clicks:
        raise ParameterError("floor - no point is clicked (got 0) - click on the floor")
    rays = np.stack([ray(camera, point) for point in clicks])
    for number, one in enumerate(rays):
        if one[1] >= 0.0:
            elevation = np.degrees(np.arcsin(one[1]))
            raise ParameterError(
                f"floor - point {number + 1} is above the horizon (got {elevation:.1f} deg) - click lower, or correct "
                "the camera's roll and pitch"
            )
    return rays / -rays[:, 1:2]


def _positive(what: str, value: float) -> float:
    if not 0.0 < value < np.inf:
        raise ParameterError(f"floor - the {what} must be above 0 m (got {value:g}) - measure or estimate it")
    return float(value)


def _same_count(clicks: Sequence[Point], given: Sequence[float] | Floats, what: str) -> None:
    if len(clicks) != len(given):
        raise ParameterError(f"floor - clicked points need {len(clicks)} {what} (got {len(given)}) - give one for each")


_KNOWN = {
    "height": "camera above the floor [m]",
    "distances": "distance of each point [m]",
    "lengths": "between the points [m]",
}


class _PointTool:
    """A tool of a tab for points that are clicked, in a bar of its own.

    changed: called when the clicks change. asks: what the bar says while there are none.
    """

    asks = ""

    def __init__(self, session: Session, changed: Callable[[], None]) -> None:
        self._session, self._document, self._changed = session, session.document, changed
        self.clicks: list[Point] = []
        self._camera: View | None = None
        with ui.element("span").classes("floor-tool") as self._root:
            self._count = Text("", classes="status").props("role=status")
            self._fill()
            Button("Forget points", lambda: self.begin(shown=True))
        self._root.set_visibility(False)

    def begin(self, *, shown: bool) -> None:
        """Forget all points; show the tool or hide it."""
        self.clicks = []
        self._root.set_visibility(shown)
        self._tell()

    def add(self, camera: View, point: Point) -> None:
        """Take a point that was clicked in a camera's picture."""
        self._camera = camera
        self.clicks.append(point)
        self._tell()

    def _tell(self) -> None:
        self._count.text = f"{len(self.clicks)} points" if self.clicks else self.asks
        self._changed()

    def _fill(self) -> None:
        """Put the tool's own controls into its bar."""
        raise NotImplementedError


class FloorTool(_PointTool):
    """The tool that finds the height of the sea floor."""

    asks = "click points on the floor"
    _known, _lengths = "height", ""

    def _fill(self) -> None:
        Choice("What is known of the floor", _KNOWN, "height", lambda known: setattr(self, "_known", known))
        text_input("size=8 aria-label='Known lengths in metres'", lambda text: setattr(self, "_lengths", text))
        Button("Set floor", self._set)

    def _set(self) -> None:
        height_m, error_m, assumed = self._fit()
        self._document.apply("floor by clicks", {"receiver.height_m": round(height_m, 3)})
        spread = f", the clicks deviate by {error_m:.2g} m" if error_m else ""
        ui.notify(f"The sea floor is at {height_m:.2f} m{spread}: {assumed}.")
        self.begin(shown=True)

    def _fit(self) -> FloorFit:
        """Return the floor of the clicks; raise `ParameterError`."""
        if self._camera is None:
            raise ParameterError("floor - no point is clicked (got 0) - click on the floor")
        try:
            lengths = [float(part) for part in self._lengths.replace(",", " ").split()]
        except ValueError:
            raise ParameterError(f"floor - no lengths (got {self._lengths!r}) - write metres, as in 2.5, 3") from None
        if self._known == "height":
            return floor_from_height(self._camera, self.clicks, lengths[0] if lengths else 0.0)
        if self._known == "distances":
            return floor_from_distances(self._camera, self.clicks, lengths)
        return floor_from_lengths(self._camera, self.clicks, lengths)


PATCH_TOOLS = {"black": "Click: this is black", "grey": "Click: this is grey", "white": "Click: this is white"}
"""What a click may say that something is, in the words of `[[match.patch]]`."""


class PatchTool:
    """The tool of a tab, in a bar of its own."""

    def __init__(self, session: Session) -> None:
        self._session, self._document, self._distance = session, session.document, ""
        with ui.element("span").classes("floor-tool") as self._root:
            look = "size=12 aria-label='Distance of what is clicked, in metres' placeholder='distance [m]'"
            given = text_input(look, lambda text: setattr(self, "_distance", text.strip()))
            given.props["title"] = "its distance in the water; empty: nearer than about a metre"
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


_APART = 0.13
"""Least ratio of the two larger singular values of clicks on the horizon: two clicks are 15 degrees apart, or nearly
opposite by as much. There an error of a click is four times as large in the level."""


def up_of_horizon(clicks: Sequence[Point], up: Floats) -> Floats:
    """Return the direction (3,) of the world's up in the camera's axes for points that were clicked on the horizon.

    Least squares over the sines of their elevations. up: the present one, of which it is on the side. Raises
    `ParameterError` where the clicks leave it open.
    """
    _, size, axes = np.linalg.svd(np.stack([point.direction for point in clicks]).reshape(-1, 3))
    if len(clicks) < 2 or size[1] < _APART * size[0]:
        raise ParameterError(
            f"horizon - needs two points that are apart (got {len(clicks)}) - click on it ahead and to a side"
        )
    found: Floats = axes[2] * (1.0 if axes[2] @ up >= 0.0 else -1.0)
    return found


class LevelTool(_PointTool):
    """The tool that levels the camera by the horizon."""

    asks = "click two or more points of the horizon"

    def _fill(self) -> None:
        self._level = Button("Level camera", self._set, title="set the camera's roll and pitch")

    def _tell(self) -> None:
        self._level.enable(len(self.clicks) > 1)
        super()._tell()

    def _set(self) -> None:
        assert self._camera is not None
        roll, pitch = roll_pitch(up_of_horizon(self.clicks, self._camera.world_from_camera[1]))
        self._document.apply("level by the horizon", self._changes(float(degrees(roll)), float(degrees(pitch))))
        ui.notify(f"The camera's roll is {degrees(roll):z.1f}, its pitch {degrees(pitch):z.1f} degrees.")
        self.begin(shown=True)

    def _changes(self, roll_deg: float, pitch_deg: float) -> dict[str, Any]:
        """Return the keys that level the camera: of this frame where its tilt has keys."""
        camera = self._document.scene.camera
        for name in ("track", "gravity"):
            if getattr(camera, name) is not None:
                raise ParameterError(
                    f"camera.{name} - levels the camera already (got {getattr(camera, name)}) - remove it first"
                )
        roll, pitch, time_s = round(roll_deg, 2) + 0.0, round(pitch_deg, 2) + 0.0, round(self._session.time_s, 6)
        if not camera.tilt_keys:
            return {"camera.roll_deg": roll, "camera.pitch_deg": pitch}
        others = [list(key) for key in camera.tilt_keys if abs(key[0] - time_s) > SAME_S]
        return {"camera.tilt_keys": sorted([*others, [time_s, roll, pitch]])}


# --- Outlines -------------------------------------------------------------------------------------------------------

# The bar of the tool that draws mattes: around something or over it, in one frame or at keys of a clip.


_KINDS = {"outline": "around it", "inside": "over it", "outside": "not this"}
_NEW = "new matte"
_LISTED = 4
"""Most keys whose frames the bar lists; of more, their number."""
_TOLD_FRAMES = 5
"""Frames between two words on how far a matte is carried."""


class LassoTool:
    """The tool of a tab. changed: called when what is drawn or shown changes.

    lines: what is drawn, in this frame. kind: of the next line.
    """

    def __init__(self, session: Session, changed: Callable[[], None]) -> None:
        self._session, self._document, self._changed = session, session.document, changed
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
            if lasso.is_matte_name(name):
                found[name] = number
        return found

    def _keys(self) -> list[int]:
        return list(lasso.key_files(self._folder / self._name)) if self._name and self._clip else []

    def _tell(self) -> None:
        if self._root.is_deleted:
            return
        keys, busy = self._keys(), bool(self._doing)
        here = self._index in keys or not self._clip
        self._make.text = "Make matte" if not self._name else "Make it again" if here else "Make key"
        self._make.enable(lasso.is_whole(self.lines) and not busy)
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

        with self._busy("finding its edges"):
            if scene.plate.eye == "both":
                raise ParameterError('matte - is of one eye (got plate.eye = "both") - set one eye, or give a file')
            codes = await session.ask(
                lambda renderer: picture_codes(renderer.plates.at(scene, index, width), deep=False)
            )
            data = lasso.png(await asyncio.to_thread(lasso.matte_of_lines, codes, lines))
            name = self._name or lasso.free_name(self._folder)
            await self._check_own(name, index)
            if self._clip:
                (self._folder / name).mkdir(exist_ok=True)
                write_whole(lasso.key_file(self._folder / name, index), data)
                await self._carry(name, index)
            else:
                write_whole(self._folder / f"{name}.png", data)
            self._name = self._put(name)

    async def _removed(self) -> None:
        name, index = self._name, self._index

        with self._busy("removing the key"):
            if len(self._keys()) == 1:
                raise ParameterError(
                    f"{name} - has one key left (got frame {index}) - remove the matte from the scene instead"
                )
            await self._check_own(name, index)
            lasso.key_file(self._folder / name, index).unlink(missing_ok=True)
            await self._carry(name, index)
            self._put(name)

    @contextmanager
    def _busy(self, doing: str) -> Iterator[None]:
        self._doing = doing
        self._tell()
        try:
            yield
        finally:
            self._doing = ""
            self.follow()

    async def _check_own(self, name: str, index: int) -> None:
        """Raise `OutputError` where a key at a frame would replace or remove a picture that was not drawn here."""
        files = lasso.pictures_at_stake(self._folder / name, index) if self._clip else [self._folder / f"{name}.png"]
        await asyncio.to_thread(lasso.check_own, files)

    async def _carry(self, name: str, index: int) -> None:
        """Write the pictures of all frames that a key has changed, and say how far that is."""
        loop = asyncio.get_running_loop()

        def tell(done: int, total: int) -> None:
            self._doing = f"carrying it, frame {done} of {total}"
            self._tell()

        def progress(done: int, total: int) -> None:
            if done % _TOLD_FRAMES == 0:
                loop.call_soon_threadsafe(tell, done, total)

        await asyncio.to_thread(lasso.write_frames, self._folder / name, self._session.frame_count, index, progress)

    def _put(self, name: str) -> str:
        """Let the scene name the pictures of a matte, and show them; return its name."""
        path = lasso.named_path(self._folder / name).relative_to(self._folder) if self._clip else Path(f"{name}.png")
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
        return lasso.outlines_of_matte(lasso.read_matte(file))
    except (OSError, ParameterError, cv2.error):
        return []
