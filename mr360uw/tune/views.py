# SPDX-License-Identifier: Apache-2.0
"""Views of a frame: its picture and what it is made of, each as a picture of 8-bit sRGB codes.

`VIEWS` names them. Panoramas are equirectangular, in the camera's axes, as the plate; charts are flat: a tile of
the caustics, a tile of the sea, a plan of the scene from above.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.color import encode
from mr360uw.caustics import refract_to_air
from mr360uw.composite.receiver.shape import ReceiverShape
from mr360uw.composite.shading import veil_ahead
from mr360uw.composite.shot import PlacedObject, Receiver
from mr360uw.ibl.lighting import turned
from mr360uw.medium.scattered_light import spread_of
from mr360uw.preview.pages import marked
from mr360uw.preview.screen import narrowed
from mr360uw.render.frame import Backend, Frame
from mr360uw.render.loaded import Loaded
from mr360uw.tune.placing import Point, pixel_of_point
from mr360uw.tune.situation import markers
from mr360uw.types import Floats, Sun, View
from mr360uw.video import VideoFrame
from mr360uw.video.writer import picture_codes

# Frame that is shown: its intermediate results, the scene it is of, and the renderer that made it.


@dataclass(frozen=True, slots=True, eq=False)
class ShownFrame:
    """A frame to be looked at. renderer: to be used in its own thread alone. duration_s: of the clip, 0 for a still.

    dark: whether the page around the picture is dark.
    """

    frame: Frame
    loaded: Loaded
    renderer: Backend
    duration_s: float = 0.0
    dark: bool = True

    @property
    def palette(self) -> Palette:
        """Colours of charts."""
        return DARK if self.dark else LIGHT

    @property
    def time_s(self) -> float:
        """Time of the frame [s]."""
        return self.frame.plate.time_s

    def view_of(self, width: int) -> View:
        """Return the camera's view with frames of another width."""
        return replace(self.loaded.view(self.time_s), width=width, height=width // 2)

    @property
    def receiver(self) -> Receiver | None:
        """The receiver as it is in this frame, or None."""
        return self.loaded.receiver_at(self.frame.plate.index, self.time_s)

    @property
    def sun(self) -> Sun | None:
        """The frame's sun in the world's axes, or None."""
        if self.frame.light is None:
            return None
        return turned(self.frame.light.environment, self.loaded.view(self.time_s).world_from_camera).sun

    @property
    def placed(self) -> tuple[PlacedObject, ...]:
        """The objects as they are at this time."""
        view, index = self.loaded.view(self.time_s), self.frame.plate.index
        return tuple(o.at(self.time_s, index, view.position, view.world_from_camera) for o in self.loaded.objects)

    @property
    def ground_y(self) -> tuple[float, str]:
        """Height [m] at which caustics are shown, and of what it is: the receiver, the lowest object or the camera."""
        receiver = self.receiver
        if receiver is not None and receiver.plane_y is not None:
            return receiver.plane_y, "receiver"
        if receiver is not None and receiver.mesh is not None:
            return float(np.mean(receiver.mesh[..., 1])), "receiver's mean height"
        if self.placed:
            return min(float(one.to_world(one.mesh.hull)[..., 1].min()) for one in self.placed), "lowest object"
        return float(self.loaded.view(self.time_s).position[1]), "camera"


# Text, scales and legends in pictures of the tuning page, readable on dark and on light pages.

Codes = NDArray[np.uint8]
"""A picture (H, W, 3), RGB."""
Color = tuple[int, int, int]


@dataclass(frozen=True, slots=True)
class Palette:
    """Colours of a chart. strong: of the camera and the frame's own time. warm: of lights. series: of objects."""

    back: Color
    line: Color
    text: Color
    soft: Color
    strong: Color
    warm: Color
    series: tuple[Color, ...]


DARK = Palette(
    (20, 24, 29), (58, 68, 79), (230, 237, 243), (159, 176, 192), (56, 189, 248), (251, 191, 36),
    ((244, 114, 182), (74, 222, 128), (167, 139, 250), (251, 146, 60), (45, 212, 191)),
)  # fmt: skip
LIGHT = Palette(
    (255, 255, 255), (195, 204, 213), (22, 32, 42), (82, 96, 109), (11, 110, 153), (180, 83, 9),
    ((190, 24, 93), (21, 128, 61), (109, 40, 217), (194, 65, 12), (15, 118, 110)),
)  # fmt: skip
_BLACK, _WHITE = (0, 0, 0), (255, 255, 255)


def write(image: Codes, text: str, at: tuple[float, float], color: Color, size: float = 0.5) -> None:
    """Write text into a picture, its left end on the baseline at (x, y) [px]; size 0.5 is 11 pixels high."""
    import cv2

    words, place = text.encode("ascii", "replace").decode(), (round(at[0]), round(at[1]))
    cv2.putText(image, words, place, cv2.FONT_HERSHEY_SIMPLEX, size, color, 1, cv2.LINE_AA)


def text_width(text: str, size: float = 0.5) -> int:
    """Return how wide a text is [px]."""
    import cv2

    return int(cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, size, 1)[0][0])


def label(image: Codes, text: str, at: tuple[float, float]) -> None:
    """Write white text on a dark ground, readable over any picture."""
    import cv2

    x, y = round(at[0]), round(at[1])
    part = image[max(y - 14, 0) : y + 6, max(x - 5, 0) : x + text_width(text) + 5]
    part[:] = cv2.addWeighted(part, 0.3, np.zeros_like(part), 0.7, 0.0)
    write(image, text, (x, y), _WHITE)


def round_length(most: float) -> float:
    """Return the largest of 1, 2, 5 times a power of ten that is not above `most` (> 0)."""
    power = 10.0 ** np.floor(np.log10(most))
    return float(max(f * power for f in (1.0, 2.0, 5.0) if f * power <= most * (1.0 + 1e-9)))


def scale_bar(image: Codes, metre_px: float, at: tuple[float, float], most_px: float) -> None:
    """Draw a bar of a round length, at most `most_px` long, left end at (x, y) [px].

    metre_px: pixels to a metre.
    """
    import cv2

    length = round_length(most_px / metre_px)
    x, y = round(at[0]), round(at[1])
    end = x + round(length * metre_px)
    label(image, f"{length:g} m", (x, y - 10))
    cv2.rectangle(image, (x, y - 4), (end, y), _BLACK, -1)
    cv2.rectangle(image, (x + 1, y - 3), (end - 1, y - 1), _WHITE, -1)


def false_colour(values: Floats) -> Codes:
    """Return the colours (..., 3) of values in [0, 1], blue to red (OpenCV's Turbo)."""
    import cv2

    codes = np.round(255.0 * np.clip(values, 0.0, 1.0)).astype(np.uint8)
    colours = cv2.applyColorMap(codes.reshape(-1, 1), cv2.COLORMAP_TURBO)[:, 0, ::-1]
    return np.ascontiguousarray(colours.reshape(*codes.shape, 3))


def legend(image: Codes, words: list[tuple[float, str]], at: tuple[int, int], width: int) -> None:
    """Draw the false colours from 0 to 1 with words below at their values; top left corner at (x, y) [px]."""
    (x, y), height = at, 14
    room = image[y - 8 : y + height + 26, x - 12 : x + width + 30]
    room[:] = (0.3 * room).astype(np.uint8)
    image[y : y + height, x : x + width] = false_colour(np.linspace(0.0, 1.0, width))
    for value, text in words:
        place = x + value * (width - 1)
        image[y + height : y + height + 4, int(place)] = _WHITE
        write(image, text, (place - 0.5 * text_width(text, 0.42), y + height + 18), _WHITE, 0.42)


def message(text: str, palette: Palette, width: int = 1024, height: int = 512) -> Codes:
    """Return a picture that says why there is none; long texts are broken into lines."""
    image = np.full((height, width, 3), palette.back, np.uint8)
    lines: list[str] = [""]
    for word in text.split():
        longer = f"{lines[-1]} {word}".strip()
        if text_width(longer, 0.6) > 0.85 * width:
            lines.append(word)
        else:
            lines[-1] = longer
    for number, line in enumerate(lines):
        y = 0.5 * height + 28 * (number - 0.5 * (len(lines) - 1))
        write(image, line, (0.5 * (width - text_width(line, 0.6)), y), palette.soft, 0.6)
    return image


_SIDE = 720
"""Side [px] of a tile."""
_SURFACE_POINTS = 256
_LOWEST_SUN = 0.02
"""Sine of the sun's elevation in water below which it makes no caustics that could be shown."""


def _caustic_chart(shown: ShownFrame) -> Codes:
    """Return a tile of the caustics, (720, 720, 3): irradiance over that of a flat sea at the receiver's depth.

    Column = +x, row = +z, from the world's origin along the beam. Shown also where the scene does not use them.
    """
    import cv2

    # Say why there is nothing to show
    sun, scene = shown.sun, shown.loaded.scene
    height, of = shown.ground_y
    depth = scene.camera.depth_m - height
    if sun is None or sun.direction[1] < _LOWEST_SUN:
        return message("no caustics: this frame shows no sun above the horizon", shown.palette, _SIDE, _SIDE)
    if scene.water.type == "none" or depth <= 0.0:
        return message("no caustics: there is no water above the receiver", shown.palette, _SIDE, _SIDE)
    # Make the caustics at the receiver, as the frame does
    index, settings = scene.water.refractive_index, shown.loaded.caustic_depths.settings
    medium = shown.loaded.surroundings.medium
    spread = spread_of(medium) if medium is not None else None
    in_air = refract_to_air(sun.direction, index)
    stack = shown.renderer.caustics(scene.sea, in_air, np.array([depth]), shown.time_s, settings, index, spread, None)
    # Draw one tile, its brightest lines white, with figures
    ratio = stack.ratio[0]
    white = max(float(np.percentile(ratio, 99.8)), 2.0)
    codes = np.round(255.0 * np.clip(encode(ratio / white, "srgb"), 0.0, 1.0)).astype(np.uint8)
    image = np.ascontiguousarray(cv2.resize(codes, (_SIDE, _SIDE), interpolation=cv2.INTER_CUBIC))
    runs = "" if shown.loaded.plan.caustics.runs else " (not used by this scene)"
    label(image, f"{depth:.2f} m deep, {of}{runs}", (12, 26))
    contrast = float(np.std(ratio))
    label(image, f"black 0, white {white:.1f}; mean 1, standard deviation {contrast:.2f}", (12, 50))
    scale_bar(image, _SIDE / scene.sea.tile_m, (16, _SIDE - 16), 0.3 * _SIDE)
    return image


def _surface_chart(shown: ShownFrame) -> Codes:
    """Return a tile of the sea, (720, 1448, 3): heights in false colours, and slopes as a relief lit from the left.

    Column = +x, row = +z, from the world's origin.
    """
    import cv2

    # Heights in false colours, slopes as a relief
    sea = shown.loaded.scene.sea
    surface = sea.grid_surface(_SURFACE_POINTS, shown.time_s)
    height = surface.position[..., 1]
    reach = max(float(np.abs(height).max()), 1e-4)
    colours = false_colour(0.5 + 0.5 * height / reach)
    slope = -surface.normal[..., :1] / surface.normal[..., 1:2]
    steep = max(float(np.sqrt(np.mean(slope**2))), 1e-4)
    relief = np.repeat(np.round(255.0 * np.clip(0.5 + slope / (6.0 * steep), 0.0, 1.0)), 3, axis=-1).astype(np.uint8)
    size = (_SIDE, _SIDE)
    left, right = (
        np.ascontiguousarray(cv2.resize(part, size, interpolation=cv2.INTER_LINEAR)) for part in (colours, relief)
    )
    # Write figures on both, side by side
    label(left, f"height; significant {4.0 * float(np.std(height)):.3f} m", (12, 26))
    legend(left, [(0.0, f"-{reach:.2g}"), (0.5, "0"), (1.0, f"{reach:.2g} m")], (24, _SIDE - 92), 260)
    scale_bar(left, _SIDE / sea.tile_m, (16, _SIDE - 16), 0.3 * _SIDE)
    rms = float(
        np.sqrt(np.mean((surface.normal[..., 0] ** 2 + surface.normal[..., 2] ** 2) / surface.normal[..., 1] ** 2))
    )
    label(right, f"slope; root mean square {rms:.3f}, of shorter waves {sea.blur_slope:.3f}", (12, 26))
    gap = np.full((_SIDE, 8, 3), shown.palette.back, np.uint8)
    return np.ascontiguousarray(np.concatenate([left, gap, right], axis=1))


_WIDTH = 1024
"""Width [px] of panoramas that are coarse, or have edges of their own; those of the frame's detail have its size."""
_SMOOTH_WIDTH = 512
_LARGEST_WIDTH = 4096
_FAR_M = 1e5
"""Length [m] of a way through water that nothing is seen through."""
_DIFFERENCE_GAIN = 4.0
"""Amplification of the change of the plate: a quarter more or less light is white or black."""
_NEAREST_M, _FARTHEST_M = 0.5, 50.0
"""Distances of the ends of the false colours, which go with the logarithm."""


def _lights_picture(shown: ShownFrame) -> Codes:
    """Return the light that reaches the camera, expanded, with the sun and the lamps marked; (512, 1024, 3)."""
    import cv2

    light = shown.frame.light
    if light is None:
        return message("no light is measured: nothing in this scene needs it", shown.palette)
    radiance = light.environment.radiance
    white = max(float(np.percentile(radiance, 99.0)), 1e-6)
    factor = _WIDTH // radiance.shape[1]
    large = np.repeat(np.repeat(radiance, factor, axis=0), factor, axis=1)
    image = _quantized(marked(np.clip(encode(large / white, "srgb"), 0.0, 1.0), light.environment.sun))
    for mark in markers(shown.loaded, shown.frame.plate.time_s, shown.frame.plate.index, light):
        x, y = pixel_of_point(Point(mark.longitude, mark.latitude), _WIDTH, _WIDTH // 2)
        if mark.kind == "lamp":
            cv2.drawMarker(image, (int(x), int(y)), (255, 255, 255), cv2.MARKER_DIAMOND, 16, 3, cv2.LINE_AA)
            cv2.drawMarker(image, (int(x), int(y)), (234, 88, 12), cv2.MARKER_DIAMOND, 16, 1, cv2.LINE_AA)
        if mark.kind in ("lamp", "sun"):
            label(image, mark.label, (min(x + 22, _WIDTH - 60), y + 5))
    found = light.environment.sun
    words = "no sun" if found is None else f"sun: confidence {found.confidence:.2f}"
    label(image, f"white is {white:.3g} x the plate's white; {words}", (12, _WIDTH // 2 - 14))
    return image


def _difference_picture(shown: ShownFrame) -> Codes:
    """Return the factor on the plate by shadows, caustics and lamps, amplified; grey where it is 1; (H, W, 3)."""
    grey = np.clip(0.5 + 0.5 * _DIFFERENCE_GAIN * (shown.frame.layer.ratio - 1.0), 0.0, 1.0)
    return narrowed(_quantized(grey), _LARGEST_WIDTH)


def _water_picture(shown: ShownFrame) -> Codes:
    """Return the water alone: the veil over a long way in every direction; (256, 512, 3)."""
    if shown.frame.medium is None:
        return message("there is no water: water.type is none, or nothing in this frame needs it", shown.palette)
    view = shown.view_of(_SMOOTH_WIDTH)
    direction = view.pixel_directions()
    veil = veil_ahead(shown.frame.medium, np.full(direction.shape[:-1], _FAR_M), direction)
    return _quantized(np.clip(encode(np.maximum(veil, 0.0), "srgb"), 0.0, 1.0))


def _depth_picture(shown: ShownFrame) -> Codes:
    """Return distances along the rays of objects, receiver and plate, false colours with a legend; (512, 1024, 3).

    Where `plate.depth` is sure of a distance, it stands before that of the receiver. Black: nothing there, or farther
    than the receiver's extent.
    """
    # Read distances of the bodies, the plate's maps and the receiver
    view = shown.view_of(_WIDTH)
    drawn = shown.frame.layer.distance_m
    rows, columns = (np.arange(n) * of // n for n, of in zip((view.height, view.width), drawn.shape, strict=True))
    distance = drawn[rows[:, None], columns]
    receiver, plate_m, floor_m = shown.receiver, np.full(distance.shape, np.inf), np.full(distance.shape, np.inf)
    if shown.loaded.plate_depth is not None:
        plate = shown.frame.plate
        plate_m = shown.loaded.plate_depth.surfaces(plate.index, plate).distance_m[rows[:, None], columns]
    if receiver is not None:
        x, y = np.broadcast_arrays(np.arange(view.width) + 0.5, (np.arange(view.height) + 0.5)[:, None])
        floor_m, _ = ReceiverShape(receiver, view.position).meet(view, x, y)
    distance = np.minimum(distance, np.where(plate_m < np.inf, plate_m, floor_m))
    # Colour their logarithm; black is infinite
    there = np.isfinite(distance)
    log_range = np.log(_FARTHEST_M / _NEAREST_M)
    image = false_colour(np.log(np.where(there, np.maximum(distance, 1e-3), 1.0) / _NEAREST_M) / log_range)
    image[~there] = 0
    metres = (_NEAREST_M, 1.0, 2.0, 5.0, 10.0, 20.0, _FARTHEST_M)
    words = [(float(np.log(m / _NEAREST_M) / log_range), f"{m:g}") for m in metres]
    legend(image, [*words[:-1], (1.0, f"{_FARTHEST_M:g} m")], (24, view.height - 48), 360)
    return image


def _codes(frame: VideoFrame) -> Codes:
    return narrowed(np.asarray(picture_codes(frame, deep=False), np.uint8), _LARGEST_WIDTH)


def _quantized(encoded: Floats) -> Codes:
    return np.ascontiguousarray(np.round(255.0 * encoded).astype(np.uint8))


# Plan of a scene from above: camera, objects and their paths, lamps, receiver and sun.

_CHART_SIDE = 900
_ROOM = 90
"""Margin [px] around what is shown."""
_LEAST_REACH_M = 2.0
"""Half the side of the smallest plan."""
_TIME_PX = 120.0
"""Distance of times along a path; it comes out between two fifths and all of it."""
_STEPS = 96
"""Points of a path."""


class _Paper:
    """A picture and its scale, on which points (n, 3) of the world have room. color: of its ground.

    middle: (2,) [m] over (x, z), at its centre. metre_px: pixels to a metre.
    """

    def __init__(self, points: Floats, color: Color) -> None:
        low, high = points[:, ::2].min(axis=0), points[:, ::2].max(axis=0)
        reach = max(0.5 * float(np.max(high - low)), _LEAST_REACH_M)
        self.image: Codes = np.full((_CHART_SIDE, _CHART_SIDE, 3), color, np.uint8)
        self.middle, self.metre_px = 0.5 * (low + high), (0.5 * _CHART_SIDE - _ROOM) / reach

    def pixel(self, points: Floats) -> Floats:
        """Return the places (..., 2) [px] of points (..., 3) in the world: right = +x, down = +z."""
        return 0.5 * _CHART_SIDE + self.metre_px * (np.asarray(points)[..., ::2] - self.middle)

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


def _plan_chart(shown: ShownFrame) -> Codes:
    """Return the plan, (900, 900, 3): right = +x, up = ahead of the camera at time 0 (-z).

    Bodies are drawn as the outlines of their hulls at the frame's time; paths over the clip have dots with times, as
    many as have room.
    """
    # Gather the paths and outlines of all that the plan shows
    loaded, palette = shown.loaded, shown.palette
    times = np.linspace(0.0, max(shown.duration_s, _last_key_s(shown)), _STEPS)
    camera = np.stack([loaded.surroundings.camera.at(float(t))[0] for t in times])
    paths = [_path(shown, number, times) for number in range(len(loaded.objects))]
    outlines = [_outline(one.to_world(one.mesh.hull).reshape(-1, 3)) for one in shown.placed]
    view = loaded.view(shown.time_s)
    lamps = [lamp.at(shown.time_s, view, shown.placed) for lamp in loaded.lamps]
    # Scale the paper so that all of it fits
    everything = np.concatenate([camera, *paths, *outlines, *(lamp.position[None] for lamp in lamps)])
    paper = _Paper(everything, palette.back)
    image = paper.image
    _grid(paper, palette.line)
    _receiver(paper, shown)
    # Draw bodies, lamps, the camera and the sun over the grid and the receiver
    for number, (path, outline) in enumerate(zip(paths, outlines, strict=True)):
        color = palette.series[number % len(palette.series)]
        _timed_path(paper, path, times, color)
        paper.line(outline, color, 2, closed=True)
        name = loaded.objects[number].settings.mesh.stem
        x, y = paper.pixel(outline).max(axis=0)
        write(image, name, (min(x + 6, _CHART_SIDE - text_width(name) - 6), min(y + 4, _CHART_SIDE - 8)), color)
    for number, lamp in enumerate(lamps):
        x, y = paper.dot(lamp.position, palette.warm)
        if lamp.cos_edge > -1.0:
            paper.line(np.stack([lamp.position, lamp.position + 40.0 / paper.metre_px * lamp.axis]), palette.warm, 2)
        write(image, f"lamp {number + 1}", (x + 8, y + 16), palette.warm)
    _timed_path(paper, camera, times, palette.strong)
    _camera(paper, shown)
    _sun(paper, shown)
    scale_bar(image, paper.metre_px, (16, _CHART_SIDE - 16), 0.25 * _CHART_SIDE)
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
    step = round_length(0.25 * _CHART_SIDE / paper.metre_px)
    reach = 0.5 * _CHART_SIDE / paper.metre_px
    for axis in (0, 1):
        first = np.ceil((paper.middle[axis] - reach) / step)
        for k in range(int(2.0 * reach / step) + 2):
            at = round(0.5 * _CHART_SIDE + paper.metre_px * ((first + k) * step - paper.middle[axis]))
            if 0 <= at < _CHART_SIDE:
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
    if 0 < y < _CHART_SIDE:
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
    corner = np.array([_CHART_SIDE - 90.0, 90.0])
    if sun is None:
        write(paper.image, "no sun", (corner[0] - 20, corner[1] - 40), palette.soft)
        return
    flat = sun.direction[::2]
    elevation = np.degrees(np.arcsin(np.clip(sun.direction[1], -1.0, 1.0)))
    start, end = (np.round(corner + s * 45.0 * flat).astype(int) for s in (1.0, -1.0))
    cv2.arrowedLine(paper.image, start.tolist(), end.tolist(), palette.warm, 2, cv2.LINE_AA, tipLength=0.3)
    cv2.circle(paper.image, start.tolist(), 7, palette.warm, -1, cv2.LINE_AA)
    write(paper.image, f"sunlight, {elevation:.0f} deg up", (_CHART_SIDE - 176, 160), palette.warm, 0.45)


_VIEWS: dict[str, tuple[str, Callable[[ShownFrame], Codes]]] = {
    "composite": ("Composite", lambda shown: _codes(shown.frame.picture)),
    "plate": ("Plate", lambda shown: _codes(shown.frame.plate.graded_by(None))),
    "caustics": ("Caustics", _caustic_chart),
    "surface": ("Sea surface", _surface_chart),
    "lights": ("Lights", _lights_picture),
    "difference": ("Shadows and caustics", _difference_picture),
    "water": ("Water alone", _water_picture),
    "depth": ("Distances", _depth_picture),
    "plan": ("Plan", _plan_chart),
}
VIEW_NAMES = {view: name for view, (name, _) in _VIEWS.items()}
"""The views' names for people."""
VIEWS = {view: draw for view, (_, draw) in _VIEWS.items()}
"""Functions that draw the views, by their names in URLs and settings."""
CHARTS = frozenset({"caustics", "surface", "plan"})
"""Views that are no panoramas."""
