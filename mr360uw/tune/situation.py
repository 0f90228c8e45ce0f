# SPDX-License-Identifier: Apache-2.0
"""Camera, receiver and objects of one frame, for placing things by clicks, and the marks that show them.

Marks stand where objects, lamps and the sun show, and along the edge of the receiver.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from nicegui.element import Element
from nicegui.events import GenericEventArguments

from mr360uw.base.sphere import direction_from_frame, unit
from mr360uw.errors import ParameterError
from mr360uw.preview.live import COARSE_WIDTH, coarse
from mr360uw.scene.model import Scene
from mr360uw.tune import placing
from mr360uw.tune.placing import Point, shown_at
from mr360uw.types import Floats, View

if TYPE_CHECKING:
    from mr360uw.composite.shot import Receiver, SceneObject
    from mr360uw.preview.live import LivePreview
    from mr360uw.render.loaded import Loaded
    from mr360uw.render.plate_light import FrameLight


Kind = Literal["object", "sun", "lamp", "spot"]
Handle = Literal["move", "turn", "scale", "reach"]
_AZIMUTHS, _ELEVATIONS = 180, 90
"""Directions in which the edge of a receiver is looked for: 2 degrees apart."""
_REACH = 4.0
"""Most times farther that a drag moves what stands: towards the horizon its distance has no bound."""


@dataclass(frozen=True, slots=True)
class Marker:
    """A mark over the picture. name: unique. label: its text. radius: angular radius [rad] of an object, for handles.

    kind: an object, the sun, a lamp, or a spot (a clicked point). handles: those it has while it is selected.
    """

    name: str
    longitude: float
    latitude: float
    kind: Kind = "object"
    label: str = ""
    radius: float = 0.0
    handles: tuple[Handle, ...] = ("move", "turn", "scale")


def markers(loaded: Loaded, time_s: float, index: int, light: FrameLight | None) -> list[Marker]:
    """Return the marks of a frame: objects (object.0, ...), lamps (lamp.0, ...) and the sun, each where it shows.

    An object is marked at the centre of its bounding box. A lamp at the camera itself has no direction and no mark.
    """
    view = loaded.view(time_s)
    placed = [o.at(time_s, index, view.position, view.world_from_camera) for o in loaded.objects]
    found = []
    for number, (one, scene_object) in enumerate(zip(placed, loaded.objects, strict=True)):
        point, distance = _seen(view, one.to_world(one.mesh.center_m))
        if point is not None:
            radius = float(np.arctan2(one.mesh.radius_m * one.scale, distance))
            name, label = f"object.{number}", scene_object.settings.mesh.stem
            found.append(Marker(name, point.longitude, point.latitude, "object", label, radius))
    for number, lamp in enumerate(loaded.lamps):
        point, _ = _seen(view, lamp.at(time_s, view, placed).position)
        if point is not None:
            name = f"lamp.{number}"
            found.append(Marker(name, point.longitude, point.latitude, "lamp", f"lamp {number + 1}", 0.0, ("move",)))
    sun = None if light is None else light.environment.sun
    if sun is not None:
        point, _ = _seen(View(view.width, view.height), sun.direction)  # in the camera's axes
        assert point is not None
        found.append(Marker("sun", point.longitude, point.latitude, "sun", "sun", 0.0, ()))
    return found


def receiver_edge(camera: View, receiver: Receiver) -> list[list[Point]]:
    """Return lines of points along the far edge of a receiver: of a plane, where its extent ends; of another shape, the
    highest direction that meets it, where one does.
    """
    from mr360uw.composite.receiver.shape import ReceiverShape

    # A plane ends in a circle about the camera
    longitude = np.linspace(-np.pi, np.pi, _AZIMUTHS + 1)
    if receiver.plane_y is not None:
        height = receiver.plane_y - camera.position[1]
        if not 0.0 < abs(height) < receiver.extent_m:
            return []
        up = np.full(len(longitude), height / receiver.extent_m)
        level = np.sqrt(1.0 - up**2)
        world = np.stack([level * np.sin(longitude), up, -level * np.cos(longitude)], axis=-1)
        return [_points(world @ camera.world_from_camera)]
    # Of other shapes take the farthest row that is met, cut where it jumps
    x = (longitude / (2.0 * np.pi) + 0.5) * camera.width
    y = (np.arange(_ELEVATIONS) + 0.5)[:, None] * (camera.height / _ELEVATIONS)
    x, y = np.broadcast_arrays(x, y)
    seen = direction_from_frame(x, y, camera.width, camera.height)
    distance, _ = ReceiverShape(receiver, camera.position).meet(camera, x, y, seen @ camera.world_from_camera.T)
    hit = np.isfinite(distance)
    top, any_hit = np.argmax(hit, axis=0), np.any(hit, axis=0)
    rows = seen[top, np.arange(len(longitude))]
    breaks = np.flatnonzero(~any_hit | np.append(False, np.abs(np.diff(top)) > _ELEVATIONS // 8))
    parts = np.split(np.arange(len(longitude)), breaks)
    return [_points(rows[part[any_hit[part]]]) for part in parts if np.sum(any_hit[part]) > 1]


def _seen(view: View, position: Floats) -> tuple[Point | None, float]:
    try:
        return shown_at(view, position)
    except ParameterError:
        return None, 0.0


def _points(directions: Floats) -> list[Point]:
    longitude = np.arctan2(directions[:, 0], -directions[:, 2])
    latitude = np.arcsin(np.clip(directions[:, 1], -1.0, 1.0))
    return [Point(float(a), float(b)) for a, b in zip(longitude, latitude, strict=True)]


class SituatedObject:
    """An object as it is in a frame, and as the scene sets it. lifted: (3,) what the surface adds to its position."""

    def __init__(self, of_scene: SceneObject, view: View, index: int, time_s: float) -> None:
        self.placed = of_scene.at(time_s, index, view.position, view.world_from_camera)
        self.settings = of_scene.settings
        self.lifted = of_scene.lifted(self.position.copy(), time_s)

    @property
    def position(self) -> Floats:
        """Place (3,) of its origin in the world."""
        return self.placed.world_from_object[:3, 3]

    @property
    def center(self) -> Floats:
        """Place (3,) of the middle of its bounding box in the world."""
        return self.placed.to_world(self.placed.mesh.center_m)

    @property
    def shape(self) -> tuple[Floats, Floats, float]:
        """Hull (h, 3, 3) of its mesh, its rotation (3, 3) and its scale."""
        return self.placed.mesh.hull, self.placed.world_from_object[:3, :3] / self.placed.scale, self.placed.scale

    @property
    def sizes(self) -> dict[str, float]:
        """All numbers that its size is proportional to, by their keys below its table."""
        if self.settings.size_m is not None:
            return {"size_m": self.settings.size_m}
        keys = self.settings.key
        keyed = {f"key.{k}.scale": key.scale for k, key in enumerate(keys) if key.scale is not None}
        at_rest = {} if keyed and len(keyed) == len(keys) else {"scale": self.settings.scale}
        return at_rest | keyed


class Situation:
    """A frame's camera, receiver (or None), objects and marks. edge: lines around the receiver.

    lamps: their positions (3,) in the world; None of those that go with the camera or an object. Raises what loading
    the scene raises.
    """

    def __init__(self, preview: LivePreview, scene: Scene, index: int, time_s: float) -> None:
        loaded = preview.loaded(coarse(scene), COARSE_WIDTH).at(time_s)  # as the draft is: loaded already
        view = self.camera = loaded.view(time_s)
        self.bodies = [SituatedObject(one, view, index, time_s) for one in loaded.objects]
        self.receiver = None if loaded.receiver is None else loaded.receiver.at(index)
        self.edge = [] if self.receiver is None else receiver_edge(view, self.receiver)
        self.lamps = [
            lamp.at(time_s, view, ()).position if lamp.settings.attach == "world" else None for lamp in loaded.lamps
        ]
        self.marks = markers(loaded, time_s, index, None)
        self._plate_depth, self._index = loaded.plate_depth, index

    def standing(self, number: int, point: Point) -> Floats:
        """Return the position (3,) in the world of an object that stands where a point shows the plate, if
        `plate.depth` is sure of the distance there, else the receiver.
        """
        depth = self._plate_depth
        shown_m = np.inf if depth is None else float(depth.toward(self._index, point.direction))
        if np.isfinite(shown_m):
            return placing.at_distance(self.camera, point, shown_m) - placing.foot(*self.bodies[number].shape)
        if self.receiver is None:
            raise ParameterError("receiver - is not in the scene (got none) - add the sea floor first")
        return placing.stand_at(self.camera, point, self.receiver, *self.bodies[number].shape)

    def swimming(self, number: int, point: Point, farther: float = 1.0, *, level: bool = False) -> Floats:
        """Return the position (3,) in the world of an object whose middle is moved to a point, `farther` times as far
        away as it is. level: at the height that it has, as one that stands.
        """
        body, start, toward = self.bodies[number], self.camera.position, placing.ray(self.camera, point)
        away = body.center - start
        beside, slope = float(np.hypot(*away[::2])), toward[1] / max(float(np.hypot(*toward[::2])), 1e-9)
        moved = placing.swim_to(self.camera, point, start + farther * away)
        if level:
            reach = min(away[1] / slope, _REACH * beside) if away[1] * slope > 0.0 else beside
            moved = start + farther * reach * unit(toward * (1.0, 0.0, 1.0)) + (0.0, away[1], 0.0)
        return moved - body.center + body.position

    def at(self, point: Point) -> int | None:
        """Return the number of the nearest object whose hull a point shows; None beside all."""
        from mr360uw.base.rays import RayScene

        hulls = [body.placed.to_world(body.placed.mesh.hull) for body in self.bodies]
        owner = np.repeat(np.arange(len(hulls)), [len(hull) for hull in hulls])
        scene = RayScene(np.concatenate([*hulls, np.zeros((0, 3, 3))]))
        (found,) = scene.first_hit(self.camera.position[None], placing.ray(self.camera, point)[None])
        return int(owner[found]) if found >= 0 else None

    def setting_of(self, number: int, position: Floats) -> Floats:
        """Return the position setting of an object for a position (3,) in the world."""
        body = self.bodies[number]
        of_camera = body.settings.attach == "camera"
        return placing.in_camera(self.camera, position) if of_camera else position - body.lifted

    def words(self, number: int, position: Floats | None = None, *, level: bool = False) -> dict[str, Any]:
        """Return the place and the size of an object in all words that a scene file has for them.

        position: (3,) in the world; None: where it is. level: whether `distance_m` is along the ground, as of one that
        stands on it.
        """
        body = self.bodies[number]
        at = body.position if position is None else position
        place, middle = (self.setting_of(number, one) for one in (at, at + body.center - body.position))
        if body.settings.polar and (level or body.settings.stand_on is None):  # its middle at rest, whatever it moves
            middle = body.settings.place_m + place - self.setting_of(number, body.position)
        hull, _, scale = body.shape
        beside, away = float(np.hypot(middle[0], middle[2])), float(np.linalg.norm(middle))
        return {
            "position_m": [round(float(part), 4) + 0.0 for part in place],
            "azimuth_deg": round(float(np.degrees(np.arctan2(middle[0], -middle[2]))), 2) + 0.0,
            "elevation_deg": round(float(np.degrees(np.arctan2(middle[1], beside))), 2) + 0.0,
            "distance_m": round(beside if level else away, 4),
            "size_m": float(f"{float(np.ptp(hull.reshape(-1, 3), axis=0).max()) * scale:.4g}"),
        }

    def shown(self, number: int) -> Point | None:
        """Return the point that shows an object's middle; None at the camera."""
        found = [mark for mark in self.marks if mark.name == f"object.{number}"]
        return Point(found[0].longitude, found[0].latitude) if found else None

    def lamp_at(self, number: int, point: Point) -> Floats:
        """Return the position setting of a lamp in the world that is moved to a point, as far away as it is."""
        lamp = self.lamps[number]
        if lamp is None:
            raise ParameterError(f"lamp.{number} - goes with the camera or an object (got a drag) - set its position")
        return placing.swim_to(self.camera, point, lamp)

    def sun_angles_deg(self, point: Point) -> tuple[float, float]:
        """Return azimuth and elevation [deg] of a point in the levelled frame, as `light.sun_azimuth_deg` has them.

        Raises `ParameterError` for a point below the horizon.
        """
        x, y, z = placing.ray(self.camera, point)
        if y < 0.0:
            below = np.degrees(np.arcsin(-y))
            raise ParameterError(
                f"sun - is below the horizon there (got {below:.1f} deg) - click higher, or level the camera first"
            )
        return float(np.degrees(np.arctan2(x, -z))), float(np.degrees(np.arcsin(np.clip(y, -1.0, 1.0))))


# The viewer: an element of the tuning page that shows a picture, flat or around the viewer, and takes clicks on it.
#
# Angles are longitude and latitude [rad] in the camera's axes (`base.sphere`), but for the look-around view, which
# is given as `preview.screen.perspective` has it, in degrees. The browser's side is viewer.js.

Phase = Literal["start", "move", "end", "cancel"]
Compare = Literal["none", "wipe", "side"]
SNAPSHOT = "snapshot"
"""Name of a second picture that the viewer's own button keeps."""


@dataclass(frozen=True, slots=True)
class Drag:
    """A drag of a handle, or an arrow key on it: from `start` to `point`. name: of the marker.

    phase: "start", then any number of "move" (at most 25 a second), then "end", or "cancel" where nothing is to change.
    shift: whether that key is held. farther: factor on the distance, of handle "reach", the wheel over an object.
    """

    phase: Phase
    handle: Handle
    name: str
    start: Point
    point: Point
    shift: bool
    farther: float = 1.0


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
        self._give(expected=self._serial + 1)

    def show(
        self, url: str, *, stale: bool = False, coarse: bool = False, stand_in: bool = False, panorama: bool = True,
        name: str = "composite",
    ) -> None:  # fmt: skip
        """Show the picture at a URL of this server.

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

    def show_other(self, url: str, name: str = "plate") -> None:
        """Set the second picture, for `set_compare`; its size may differ, its projection not."""
        self._others += 1
        self._give(other={"url": url, "serial": self._others, "name": name})

    def set_compare(self, compare: Compare) -> None:
        """Show the picture alone, with a draggable divider to the second one, or both beside each other."""
        self._give(compare=compare)

    # --- views and marks

    def set_look(self, *, look: bool) -> None:
        """Look around in a panorama, or show it flat."""
        self._give(look=look)

    def turn_to(self, point: Point) -> None:
        """Look at a point of the picture."""
        self.run_method("turnTo", {"longitude": point.longitude, "latitude": point.latitude})

    def set_marks(self, markers: Sequence[Marker], horizon: Sequence[Sequence[Point]] = ()) -> None:
        """Replace the marks, and the lines that show the edge of the receiver."""
        edge = [[[p.longitude, p.latitude] for p in line] for line in horizon]
        self._give(markers=[asdict(marker) for marker in markers], horizon=edge)

    def set_lines(self, lines: Sequence[tuple[str, Sequence[Point]]]) -> None:
        """Replace the lines that are drawn in the picture: (kind, points) of each; a single point is a dot.

        kind: its colour: "outline", "inside" or "outside" of something, or "matte", the outline of one that was made.
        """
        self._give(drawn=[[kind, [[p.longitude, p.latitude] for p in line]] for kind, line in lines])

    def set_drawing(self, kind: str) -> None:
        """Let drags draw lines of a kind, as `set_lines` has them, instead of turning the view; "": they turn it."""
        self._give(drawing=kind)

    def select(self, name: str | None) -> None:
        """Give the marker of a name its handles; None: no marker."""
        self._give(selected=name or "")

    def _give(self, **values: Any) -> None:
        """Give the browser's side values."""
        self._props.update(values)
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
            return handler(Drag(a["phase"], a["handle"], a["name"], began, here, a["shift"], a.get("farther", 1.0)))

        self.on("drag", told)

    def on_select(self, handler: Callable[[str], Any]) -> None:
        """Call a handler with the name of a marker that is clicked on."""
        self.on("select", lambda event: handler(event.args["name"]))

    def on_compare(self, handler: Callable[[Compare, str], Any]) -> None:
        """Call a handler with how pictures are compared, and the second one's name, when its own buttons change that.

        The name is `SNAPSHOT` where the second picture is one that was kept in the viewer alone.
        """
        self.on("compare", lambda event: handler(event.args["compare"], event.args["second"]))
