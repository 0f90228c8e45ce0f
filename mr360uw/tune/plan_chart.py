# SPDX-License-Identifier: Apache-2.0
"""Plan of a scene from above: camera, objects and their paths, lamps, receiver and sun."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mr360uw.tune.drawing import Codes, Color, label, round_length, scale_bar, text_width, write
from mr360uw.tune.shown_frame import ShownFrame
from mr360uw.types import Floats

_SIDE = 900
_ROOM = 90
"""Margin [px] around what is shown."""
_LEAST_REACH_M = 2.0
"""Half the side of the smallest plan."""
_TIME_PX = 120.0
"""Distance of times along a path; it comes out between two fifths and all of it."""
_STEPS = 96
"""Points of a path."""


@dataclass(frozen=True, slots=True)
class _Paper:
    """A picture and its scale. middle: (2,) [m] over (x, z), at its centre. metre_px: pixels to a metre."""

    image: Codes
    middle: Floats
    metre_px: float

    def pixel(self, points: Floats) -> Floats:
        """Return the places (..., 2) [px] of points (..., 3) in the world: right = +x, down = +z."""
        return 0.5 * _SIDE + self.metre_px * (np.asarray(points)[..., ::2] - self.middle)

    def line(self, points: Floats, color: Color, width: int = 1, *, closed: bool = False) -> None:
        """Draw a line through points (n, 3)."""
        import cv2

        fine = np.round(16.0 * np.clip(self.pixel(points), -1e5, 1e5)).astype(np.int32)
        cv2.polylines(self.image, [fine.reshape(-1, 1, 2)], closed, color, width, cv2.LINE_AA, 4)

    def dot(self, point: Floats, color: Color, radius: int = 4) -> tuple[float, float]:
        """Draw a dot; return its place [px]."""
        import cv2

        x, y = self.pixel(point)
        cv2.circle(self.image, (round(x), round(y)), radius, color, -1, cv2.LINE_AA)
        return float(x), float(y)


def plan_chart(shown: ShownFrame) -> Codes:
    """Return the plan, (900, 900, 3): right = +x, up = ahead of the camera at time 0 (-z).

    Bodies are drawn as the outlines of their hulls at the frame's time; paths over the clip have dots with times, as
    many as have room.
    """
    loaded, palette = shown.loaded, shown.palette
    times = np.linspace(0.0, max(shown.duration_s, _last_key_s(shown)), _STEPS)
    camera = np.stack([loaded.surroundings.camera.at(float(t))[0] for t in times])
    paths = [_path(shown, number, times) for number in range(len(loaded.objects))]
    outlines = [_outline(one.to_world(one.mesh.hull).reshape(-1, 3)) for one in shown.placed]
    view = loaded.view(shown.time_s)
    lamps = [lamp.at(shown.time_s, view, shown.placed) for lamp in loaded.lamps]
    everything = np.concatenate([camera, *paths, *outlines, *(lamp.position[None] for lamp in lamps)])[:, ::2]
    low, high = everything.min(axis=0), everything.max(axis=0)
    reach = max(0.5 * float(np.max(high - low)), _LEAST_REACH_M)
    image = np.full((_SIDE, _SIDE, 3), palette.back, np.uint8)
    paper = _Paper(image, 0.5 * (low + high), (0.5 * _SIDE - _ROOM) / reach)
    _grid(paper, palette.line)
    _receiver(paper, shown)
    for number, (path, outline) in enumerate(zip(paths, outlines, strict=True)):
        color = palette.series[number % len(palette.series)]
        _timed_path(paper, path, times, color)
        paper.line(outline, color, 2, closed=True)
        name = loaded.objects[number].settings.mesh.stem
        x, y = paper.pixel(outline).max(axis=0)
        write(image, name, (min(x + 6, _SIDE - text_width(name) - 6), min(y + 4, _SIDE - 8)), color)
    for number, lamp in enumerate(lamps):
        x, y = paper.dot(lamp.position, palette.warm)
        if lamp.cos_edge > -1.0:
            paper.line(np.stack([lamp.position, lamp.position + 40.0 / paper.metre_px * lamp.axis]), palette.warm, 2)
        write(image, f"lamp {number + 1}", (x + 8, y + 16), palette.warm)
    _timed_path(paper, camera, times, palette.strong)
    _camera(paper, shown)
    _sun(paper, shown)
    scale_bar(image, paper.metre_px, (16, _SIDE - 16), 0.25 * _SIDE)
    label(image, f"from above at {shown.time_s:.2f} s; up = ahead (-z), right = +x", (12, 26))
    return image


def _last_key_s(shown: ShownFrame) -> float:
    """Return the time [s] of the last key of an object or of the camera's track, at least 0."""
    ends = [float(one.motion.time_s[-1]) for one in shown.loaded.objects]
    track = shown.loaded.surroundings.camera.track
    return max([0.0, *ends, *([] if track is None else [float(track.time_s[-1])])])


def _path(shown: ShownFrame, number: int, times: Floats) -> Floats:
    """Return the positions (n, 3) of an object at times (n,)."""
    one = shown.loaded.objects[number]
    found = np.stack([one.motion.at(float(t))[:3, 3] for t in times])
    if one.settings.attach != "camera":
        return found
    poses = [shown.loaded.surroundings.camera.at(float(t)) for t in times]
    return np.stack([position + turn @ p for p, (position, turn) in zip(found, poses, strict=True)])


def _outline(points: Floats) -> Floats:
    """Return the convex outline (n, 3) of points as seen from above."""
    import cv2

    order = cv2.convexHull(np.ascontiguousarray(points[:, ::2], np.float32), returnPoints=False)
    return points[order[:, 0]]


def _grid(paper: _Paper, color: Color) -> None:
    step = round_length(0.25 * _SIDE / paper.metre_px)
    reach = 0.5 * _SIDE / paper.metre_px
    for axis in (0, 1):
        first = np.ceil((paper.middle[axis] - reach) / step)
        for k in range(int(2.0 * reach / step) + 2):
            at = round(0.5 * _SIDE + paper.metre_px * ((first + k) * step - paper.middle[axis]))
            if 0 <= at < _SIDE:
                (paper.image[:, at] if axis == 0 else paper.image[at])[:] = color


def _receiver(paper: _Paper, shown: ShownFrame) -> None:
    receiver, palette = shown.receiver, shown.palette
    if receiver is None:
        return
    if receiver.mesh is not None:
        paper.line(_outline(receiver.mesh.reshape(-1, 3)), palette.soft, 1, closed=True)
    camera = shown.loaded.view(shown.time_s).position
    height = 0.0 if receiver.plane_y is None else receiver.plane_y - camera[1]
    radius = float(np.sqrt(max(receiver.extent_m**2 - height**2, 0.0)))
    angle = np.linspace(0.0, 2.0 * np.pi, 180)
    circle = camera + radius * np.stack([np.sin(angle), 0.0 * angle, np.cos(angle)], axis=-1)
    paper.line(circle, palette.soft)
    x, y = paper.pixel(camera + np.array([0.0, 0.0, -radius]))
    if 0 < y < _SIDE:
        write(paper.image, "receiver's extent", (x + 6, y - 5), palette.soft, 0.42)


def _timed_path(paper: _Paper, path: Floats, times: Floats, color: Color) -> None:
    """Draw a path with dots at round times, some `_TIME_PX` apart; nothing where it stands."""
    length = float(np.sum(np.linalg.norm(np.diff(paper.pixel(path), axis=0), axis=-1)))
    if length < 3.0:
        return
    paper.line(path, color)
    step = round_length(times[-1] * min(_TIME_PX / length, 1.0))
    last = np.full(2, 1e9)
    for time_s in np.arange(0.0, times[-1] + 1e-9, step):
        point = np.array([np.interp(time_s, times, path[:, k]) for k in range(3)])
        if np.linalg.norm(paper.pixel(point) - last) < 0.2 * _TIME_PX:  # at rest, or where it was
            continue
        last = paper.pixel(point)
        x, y = paper.dot(point, color, 3)
        write(paper.image, f"{time_s:g} s", (x + 6, y + 14), color, 0.4)


def _camera(paper: _Paper, shown: ShownFrame) -> None:
    """Draw the camera and, as a wedge of 90 degrees, what is ahead of it."""
    view, palette = shown.loaded.view(shown.time_s), shown.palette
    reach = 34.0 / paper.metre_px
    for side in (-1.0, 1.0):
        ray = view.world_from_camera @ np.array([side, 0.0, -1.0]) * (reach / np.sqrt(2.0))
        paper.line(np.stack([view.position, view.position + ray]), palette.strong, 2)
    x, y = paper.dot(view.position, palette.strong, 5)
    depth = view.surface_y_m - view.position[1]
    below = f", {depth:.1f} m deep" if shown.loaded.scene.water.type != "none" else ""
    write(paper.image, f"camera{below}", (x + 10, y + 18), palette.strong)


def _sun(paper: _Paper, shown: ShownFrame) -> None:
    """Draw an arrow in a corner that points as sunlight goes, longest for a sun on the horizon."""
    import cv2

    sun, palette = shown.sun, shown.palette
    corner = np.array([_SIDE - 90.0, 90.0])
    if sun is None:
        write(paper.image, "no sun", (corner[0] - 20, corner[1] - 40), palette.soft)
        return
    flat = sun.direction[::2]
    elevation = np.degrees(np.arcsin(np.clip(sun.direction[1], -1.0, 1.0)))
    start, end = (np.round(corner + s * 45.0 * flat).astype(int) for s in (1.0, -1.0))
    cv2.arrowedLine(paper.image, start.tolist(), end.tolist(), palette.warm, 2, cv2.LINE_AA, tipLength=0.3)
    cv2.circle(paper.image, start.tolist(), 7, palette.warm, -1, cv2.LINE_AA)
    write(paper.image, f"sunlight, {elevation:.0f} deg up", (_SIDE - 176, 160), palette.warm, 0.45)
