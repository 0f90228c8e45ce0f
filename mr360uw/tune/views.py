# SPDX-License-Identifier: Apache-2.0
"""Views of a frame: its picture and what it is made of, each as a picture of 8-bit sRGB codes.

`VIEWS` names them. Panoramas are equirectangular, in the camera's axes, as the plate; charts are flat: a tile of
the caustics, a tile of the sea, a plan of the scene from above.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mr360uw.caustics import refract_to_air
from mr360uw.color import encode
from mr360uw.composite.lighting.shading import veil_ahead
from mr360uw.composite.receiver.shape import ReceiverShape
from mr360uw.ibl.report import marked
from mr360uw.medium.small_angles import spread_of
from mr360uw.tune.drawing import Codes, false_colour, label, legend, message, scale_bar
from mr360uw.tune.placing import Point, pixel_of_point
from mr360uw.tune.plan_chart import plan_chart
from mr360uw.tune.shown_frame import ShownFrame
from mr360uw.tune.situation import markers
from mr360uw.types import Floats
from mr360uw.video import VideoFrame
from mr360uw.video.write.image_writer import picture_codes

_SIDE = 720
"""Side [px] of a tile."""
_SURFACE_POINTS = 256
_LOWEST_SUN = 0.02
"""Sine of the sun's elevation in water below which it makes no caustics that could be shown."""


def caustic_chart(shown: ShownFrame) -> Codes:
    """Return a tile of the caustics, (720, 720, 3): irradiance over that of a flat sea at the receiver's depth.

    Column = +x, row = +z, from the world's origin along the beam. Shown also where the scene does not use them.
    """
    import cv2

    sun, scene = shown.sun, shown.loaded.scene
    height, of = shown.ground_y
    depth = scene.camera.depth_m - height
    if sun is None or sun.direction[1] < _LOWEST_SUN:
        return message("no caustics: this frame shows no sun above the horizon", shown.palette, _SIDE, _SIDE)
    if scene.water.type == "none" or depth <= 0.0:
        return message("no caustics: there is no water above the receiver", shown.palette, _SIDE, _SIDE)
    index, settings = scene.water.refractive_index, shown.loaded.caustic_depths.settings
    medium = shown.loaded.surroundings.medium
    spread = spread_of(medium) if medium is not None else None
    in_air = refract_to_air(sun.direction, index)
    stack = shown.renderer.caustics(scene.sea, in_air, np.array([depth]), shown.time_s, settings, index, spread)
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


def surface_chart(shown: ShownFrame) -> Codes:
    """Return a tile of the sea, (720, 1448, 3): heights in false colours, and slopes as a relief lit from the left.

    Column = +x, row = +z, from the world's origin.
    """
    import cv2

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


def lights_picture(shown: ShownFrame) -> Codes:
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


def difference_picture(shown: ShownFrame) -> Codes:
    """Return the factor on the plate by shadows, caustics and lamps, amplified; grey where it is 1; (H, W, 3)."""
    grey = np.clip(0.5 + 0.5 * _DIFFERENCE_GAIN * (shown.frame.layer.ratio - 1.0), 0.0, 1.0)
    return _reduced(_quantized(grey))


def water_picture(shown: ShownFrame) -> Codes:
    """Return the water alone: the veil over a long way in every direction; (256, 512, 3)."""
    if shown.frame.medium is None:
        return message("there is no water: water.type is none, or nothing in this frame needs it", shown.palette)
    view = shown.view_of(_SMOOTH_WIDTH)
    direction = view.directions(np.arange(view.width) + 0.5, (np.arange(view.height) + 0.5)[:, None])
    veil = veil_ahead(shown.frame.medium, np.full(direction.shape[:-1], _FAR_M), direction)
    return _quantized(np.clip(encode(np.maximum(veil, 0.0), "srgb"), 0.0, 1.0))


def depth_picture(shown: ShownFrame) -> Codes:
    """Return distances along the rays of objects, receiver and plate, false colours with a legend; (512, 1024, 3).

    Where `plate.depth` is sure of a distance, it stands before that of the receiver. Black: nothing there, or farther
    than the receiver's extent.
    """
    view = shown.view_of(_WIDTH)
    drawn = shown.frame.layer.distance_m
    rows, columns = (np.arange(n) * of // n for n, of in zip((view.height, view.width), drawn.shape, strict=True))
    distance = drawn[rows[:, None], columns]
    receiver, plate_m = shown.receiver, np.full(distance.shape, np.inf)
    if shown.loaded.plate_depth is not None:
        plate_m = shown.loaded.plate_depth.at(shown.frame.plate.index, shown.frame.plate)[rows[:, None], columns]
    if receiver is not None:
        x, y = np.broadcast_arrays(np.arange(view.width) + 0.5, (np.arange(view.height) + 0.5)[:, None])
        floor, _ = ReceiverShape(receiver, view.position).meet_along(view, x, y, view.directions(x, y))
        floor = np.where(plate_m < np.inf, plate_m, floor)
        distance = np.minimum(distance, floor)
    else:
        distance = np.minimum(distance, plate_m)
    there = np.isfinite(distance)
    log_range = np.log(_FARTHEST_M / _NEAREST_M)
    image = false_colour(np.log(np.where(there, np.maximum(distance, 1e-3), 1.0) / _NEAREST_M) / log_range)
    image[~there] = 0
    metres = (_NEAREST_M, 1.0, 2.0, 5.0, 10.0, 20.0, _FARTHEST_M)
    words = [(float(np.log(m / _NEAREST_M) / log_range), f"{m:g}") for m in metres]
    legend(image, [*words[:-1], (1.0, f"{_FARTHEST_M:g} m")], (24, view.height - 48), 360)
    return image


VIEWS: dict[str, Callable[[ShownFrame], Codes]] = {
    "composite": lambda shown: _codes(shown.frame.picture),
    "plate": lambda shown: _codes(shown.frame.plate.graded_by(None)),
    "caustics": caustic_chart,
    "surface": surface_chart,
    "lights": lights_picture,
    "difference": difference_picture,
    "water": water_picture,
    "depth": depth_picture,
    "plan": plan_chart,
}
"""Functions that draw the views, by their names in URLs and settings."""
CHARTS = frozenset({"caustics", "surface", "plan"})
"""Views that are no panoramas."""
VIEW_NAMES = {
    "composite": "Composite",
    "plate": "Plate",
    "caustics": "Caustics",
    "surface": "Sea surface",
    "lights": "Lights",
    "difference": "Shadows and caustics",
    "water": "Water alone",
    "depth": "Distances",
    "plan": "Plan",
}
"""The views' names for people."""


def _codes(frame: VideoFrame) -> Codes:
    return _reduced(np.asarray(picture_codes(frame, deep=False), np.uint8))


def _reduced(codes: Codes) -> Codes:
    """Return a picture no wider than a texture is taken."""
    import cv2

    height, width = codes.shape[:2]
    if width <= _LARGEST_WIDTH:
        return codes
    size = (_LARGEST_WIDTH, max(1, round(height * _LARGEST_WIDTH / width)))
    return np.asarray(cv2.resize(codes, size, interpolation=cv2.INTER_AREA), np.uint8)


def _quantized(encoded: Floats) -> Codes:
    return np.ascontiguousarray(np.round(255.0 * encoded).astype(np.uint8))
