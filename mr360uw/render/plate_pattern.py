# SPDX-License-Identifier: Apache-2.0
"""The plate's own caustics in a frame, as shadows on the receiver take them away.

Where the camera stands, the clip's mean is the plate in calm light. Where it moves, or of a single picture, detail of
the size of caustics is smoothed, by the fraction of its variance that the scene's own sea explains.
"""

from __future__ import annotations

import numpy as np

from mr360uw.caustics import caustic_map, refract_to_air
from mr360uw.color import luminance
from mr360uw.composite.receiver.pattern import PlatePattern
from mr360uw.composite.shot import Receiver
from mr360uw.medium.lookup import unscattered_share
from mr360uw.render.loaded import Loaded
from mr360uw.types import Floats, Rectangle, Sun
from mr360uw.video import VideoFrame

_TYPICAL_HEIGHT_M = 2.0
_DETAIL_ROWS = (0.6, 0.9)
"""Part of the frame's height over which the detail of the ground is measured: 18 to 72 degrees below the horizon."""


def plate_pattern(loaded: Loaded, calm: Floats | None, plate: VideoFrame, sun: Sun | None) -> PlatePattern | None:
    """Return the pattern of a plate's frame on the receiver; None where the plan has none. sun: in the world."""
    if not loaded.plan.pattern.runs or loaded.receiver is None or sun is None:
        return None
    view = loaded.view(plate.time_s)
    height_m = _height_above(loaded.receiver.at(plate.index), float(view.position[1]))
    if calm is not None:
        return PlatePattern(plate, calm, height_m, 1.0)
    whole = PlatePattern(plate, None, height_m, 1.0)
    expected = _expected_contrast(loaded, sun, view.surface_y_m - float(view.position[1]) + height_m)
    return PlatePattern(plate, None, height_m, _explained(whole, plate.shape, expected))


def _height_above(receiver: Receiver, camera_y: float) -> float:
    """Return about how high [m] the camera is above a receiver."""
    if receiver.plane_y is not None:
        below = camera_y - receiver.plane_y
    elif receiver.mesh is not None:
        below = camera_y - float(receiver.mesh[..., 1].mean())
    else:
        below = _TYPICAL_HEIGHT_M
    return max(abs(below), 0.2)


def _expected_contrast(loaded: Loaded, sun: Sun, depth_m: float) -> float:
    """Return the standard deviation of light on the ground over its mean that the scene's sea makes."""
    scene, medium = loaded.scene, loaded.surroundings.medium
    assert medium is not None
    in_air = refract_to_air(sun.direction, scene.water.refractive_index)
    if in_air[1] < 0.05:
        return 0.0
    pattern = caustic_map(scene.sea, in_air, max(depth_m, 0.0), 0.0, size=128, grid=64)
    table = medium.unit_table
    kept = unscattered_share(table, np.array([depth_m]), float(sun.direction[1]))
    return float(pattern.std() * kept.max())


def _explained(pattern: PlatePattern, shape: tuple[int, int], expected: float) -> float:
    """Return the fraction of the variance of the ground's detail that caustics of a contrast make."""
    height, width = shape
    first, last = (int(part * height) for part in _DETAIL_ROWS)
    shown, calm = pattern.light(Rectangle(0, first, width, last - first))
    detail = luminance(shown) / np.maximum(luminance(calm), 1e-3) - 1.0
    return float(min(1.0, expected**2 / max(float(np.var(detail)), 1e-9)))
