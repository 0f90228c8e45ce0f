# SPDX-License-Identifier: Apache-2.0
"""Leaves out matches of features that move along with the camera: a rig, a housing, a diver, the inside of a car.

Such features stay at the same pixels while the others move. Where most features of a picture are on the rig, the
geometry of two views would be fitted to the rig, as if the camera stood still.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from mr360uw.types import Floats

Indices = NDArray[np.uint32]
_STATIC_PX = 1.0
"""Largest motion [px] of a feature that stays where it is. Half: noisy features of a rig remain; double: distant ones
ahead of the camera are lost."""
_WRONG = np.radians(10.0)
"""Motion [rad] between neighbouring key frames above which a match is taken for wrong: four times what makes a key."""
_LEAST_MOVING, _MOVING_SHARE = 20, 0.1
"""Fewest features, and least share of them, that move between two key frames of a camera that moves."""
_LEAST_MOTION_PX = 3.0
"""Least median motion [px] of the features that move. Leaves and algae in the current sway by one or two."""


def without_riding(
    directions: tuple[Floats, ...], matches: Mapping[tuple[int, int], Indices], pixel_rad: float
) -> dict[tuple[int, int], Indices]:
    """Return the matches without those of features that move along with the camera.

    directions: (n, 3) of the features of each key frame, in its camera's axes. matches: pairs of features (m, 2) of
    pairs of key frames. pixel_rad: angle of a pixel. Pairs of key frames between which the camera pauses keep all; so
    does a clip that pauses in more than half of its neighbouring key frames.
    """
    motion = {
        (i, j): np.linalg.norm(directions[i][pair[:, 0]] - directions[j][pair[:, 1]], axis=1) / pixel_rad
        for (i, j), pair in matches.items()
    }
    moves = np.zeros(len(directions), bool)  # between a key frame and the next
    seen = 0
    for (i, j), pixels in motion.items():
        if j == i + 1:
            seen += 1
            moves[i] = _moves(pixels[pixels < _WRONG / pixel_rad])
    if 2 * np.count_nonzero(moves) < max(seen, 1):
        return dict(matches)
    return {(i, j): pair[motion[i, j] >= _STATIC_PX] if moves[i:j].any() else pair for (i, j), pair in matches.items()}


def _moves(motion_px: Floats) -> bool:
    """Return whether enough features move far enough between two key frames for a camera that moves."""
    moving = motion_px[motion_px >= _STATIC_PX]
    if len(moving) < max(_LEAST_MOVING, _MOVING_SHARE * len(motion_px)):
        return False
    return float(np.median(moving)) >= _LEAST_MOTION_PX
