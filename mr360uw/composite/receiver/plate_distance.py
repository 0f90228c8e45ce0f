# SPDX-License-Identifier: Apache-2.0
"""How far away the plate's surfaces are, as far as the scene says: by its receiver, and by a matte with distances."""

from __future__ import annotations

import numpy as np

from mr360uw.cache import Cache
from mr360uw.composite.receiver.shape import ReceiverShape
from mr360uw.composite.shot import Receiver, Shot
from mr360uw.types import Floats


def kept_shape(receiver: Receiver, camera_position: Floats, kept: Cache) -> ReceiverShape:
    """Return a receiver's shape as seen from a position (3,) [m] in the world. kept: holds it for other frames."""
    return kept.of(ReceiverShape, receiver, camera_position)


def plate_distance(shot: Shot, x: Floats, y: Floats, direction: Floats, kept: Cache) -> Floats:
    """Return the distance (n,) [m] of the plate's surfaces along rays, infinity where the scene does not tell it.

    x, y: (n,) frame coordinates. direction: (n, 3) of the view there, world axes. kept: holds the receiver's shape.
    """
    view, matte = shot.view, shot.holdout_distance_m
    nearest = np.full(len(direction), np.inf)
    if shot.receiver is not None:
        nearest, _ = kept_shape(shot.receiver, view.position, kept).meet_along(view, x, y, direction)
    if matte is not None:
        found = matte[np.minimum(y.astype(np.int64), view.height - 1), x.astype(np.int64) % view.width]
        nearest = np.minimum(nearest, found)
    return np.asarray(nearest, np.float64)
