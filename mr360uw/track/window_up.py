# SPDX-License-Identifier: Apache-2.0
"""Up of a solved scene from Snell's window: the bright circle of sky overhead that every frame shows."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mr360uw.ibl.level.horizon import estimate_horizon
from mr360uw.ibl.level.tilt import level_matrix
from mr360uw.sphere import unit
from mr360uw.types import Floats

_FRAMES = 6
"""Key frames that are looked at, evenly spaced."""
_LARGEST_SPREAD = np.radians(4.0)
"""Largest angle of a frame's window from the mean of all in the scene's axes; waves shift it by a degree or two."""
_MAP = (64, 32)


def window_up(paths: tuple[Path, ...], rotation: Floats) -> Floats | None:
    """Return up (3,) in the scene's axes; None where fewer than half of the frames show a window, or they disagree.

    paths, rotation (k, 3, 3): key frames, and their rotations from camera axes to the scene.
    """
    import cv2

    chosen = np.unique(np.linspace(0, len(paths) - 1, _FRAMES).astype(int))
    ups = []
    for k in chosen.tolist():
        grey = np.asarray(cv2.imread(str(paths[k]), cv2.IMREAD_GRAYSCALE), np.float64)
        light = cv2.resize((grey / 255.0) ** 2.2, _MAP, interpolation=cv2.INTER_AREA)
        found = estimate_horizon(np.repeat(light[..., None], 3, axis=-1))
        if found.reliable:
            ups.append(rotation[k] @ level_matrix(found.roll_rad, found.pitch_rad)[1])
    if 2 * len(ups) < len(chosen) or not ups:
        return None
    mean = unit(np.mean(ups, axis=0))
    apart = np.arccos(np.clip(np.array(ups) @ mean, -1.0, 1.0))
    return mean if apart.max() <= _LARGEST_SPREAD else None
