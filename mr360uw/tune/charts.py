# SPDX-License-Identifier: Apache-2.0
"""Charts of a frame: a tile of its caustics and of its sea, and a plan of the scene from above."""

from __future__ import annotations

import numpy as np

from mr360uw.caustics import refract_to_air
from mr360uw.color import encode
from mr360uw.medium.small_angles import spread_of
from mr360uw.tune.drawing import Codes, false_colour, label, legend, message, scale_bar
from mr360uw.tune.plan_chart import plan_chart
from mr360uw.tune.shown_frame import ShownFrame

__all__ = ["caustic_chart", "plan_chart", "surface_chart"]

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
