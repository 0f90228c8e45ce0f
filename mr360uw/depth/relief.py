# SPDX-License-Identifier: Apache-2.0
"""The plate's own relief as a receiver: a map of distances that is sure in places, and another surface elsewhere.

Measured distances are off by some tenths of a per cent from pixel to pixel, which would tilt normals by 15 degrees, so
they are smoothed, by no more than `OFF` of their values. Where a map is not sure, its distance is used if it is between
the sure ones about it, as beside edges. The inverse distance, which is linear in the picture on a plane, is what is
averaged.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.receiver.shape import ReceiverShape, inverse_distance, running_mean, smoothed, width_px
from mr360uw.composite.shot import Receiver
from mr360uw.depth.sphere_stereo import SURE, DepthMap
from mr360uw.depth.warping import Map, resized
from mr360uw.sphere import directions
from mr360uw.types import Floats, View

MOST_COLUMNS = 1024
"""Columns to which larger maps are reduced: what is between is smoothed away."""
OFF, OFF_IN_HOLES = 0.02, 0.1
"""Fractions by which smoothing may change a distance, and one of which the map is not sure."""
_WIDTHS_DEG = (3.9, 1.8, 1.8, 0.7, 0.7)
"""Widths of the running means. Of synthetic dives with distances off by .25 % the normals of floors and rocks
are off by 3 to 6 degrees in the median; wider means bend those of rocks, narrower ones leave more noise."""
_ABOUT_DEG = 7.4
"""Width of the window about a pixel whose sure distances tell whether an unsure one can be right. 5: the middle of a
passing fish is not covered; 11: twice as much open water beside a wall is taken for wall."""
_SUPPORT = 0.1
"""Fraction of the pixels of such a window that must be sure: specks are often wrong."""
_LEAST_GROUND = 0.05
"""Fraction of the pixels far below the horizon that tell how far the ground is."""
_MOSTLY = 0.75
"""Fraction of a pixel of a reduced map that is sure, above which it is."""
_ALIKE = 0.1
"""How far, as a fraction, an unsure inverse distance may be beyond the sure ones about it."""


def on_relief(receiver: Receiver, found: DepthMap, view: View) -> Receiver:
    """Return a receiver with the shape that a frame's map shows where it is sure; its own shape elsewhere.

    view: that of the frame.
    """
    inverse, sure = inverse_distance(found.distance_m), (found.confidence >= SURE).astype(np.float32)
    if inverse.shape[1] > MOST_COLUMNS:
        seen = resized((inverse > 0.0).astype(np.float32), MOST_COLUMNS)
        inverse = (resized(inverse, MOST_COLUMNS) / np.maximum(seen, _MOSTLY)).astype(np.float32)
        sure = resized(sure, MOST_COLUMNS)
    of_map = (sure > _MOSTLY) & (inverse > 0.0)
    used = of_map | _between_sure(inverse, of_map)
    sees = replace(view, width=inverse.shape[1], height=inverse.shape[0])
    j, i = np.nonzero(~used)
    x, y = i + 0.5, j + 0.5
    elsewhere, _ = ReceiverShape(receiver, view.position).meet_along(sees, x, y, sees.directions(x, y))
    inverse[j, i] = inverse_distance(elsewhere)
    off = np.where(used & ~of_map, np.float32(OFF_IN_HOLES), np.float32(OFF))
    with np.errstate(divide="ignore"):
        shape = np.float32(1.0) / smoothed(inverse, inverse * (1.0 - off), inverse * (1.0 + off), _WIDTHS_DEG)
    return replace(receiver, plane_y=None, mesh=None, distance_m=shape)


def _between_sure(inverse: Map, sure: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the pixels (h, w) whose inverse distance [1/m] is between the sure ones in a window about them."""
    import cv2

    side = width_px(_ABOUT_DEG, sure.shape[1])
    half, window = side // 2, np.ones((side, side), np.uint8)

    def of_windows(extreme: Callable[..., Any], nothing: float) -> Map:
        wide = cv2.copyMakeBorder(np.where(sure, inverse, np.float32(nothing)), 0, 0, half, half, cv2.BORDER_WRAP)
        return np.asarray(extreme(wide, window)[:, half : half + sure.shape[1]])

    least, most = of_windows(cv2.erode, np.inf), of_windows(cv2.dilate, 0.0)
    enough = running_mean(sure.astype(np.float32), side) > _SUPPORT
    return enough & (inverse > (1.0 - _ALIKE) * least) & (inverse < (1.0 + _ALIKE) * most)


def ground_below(found: DepthMap, up: Floats) -> float | None:
    """Return how far [m] the ground is below the camera, as the median of what a map is sure of 30 degrees below it.

    up: (3,) in the camera's axes. None where less than a twentieth of that is sure.
    """
    rows, columns = found.distance_m.shape
    down = -directions(columns, rows) @ up
    under, sure = down > 0.5, found.confidence >= SURE
    seen = under & sure & np.isfinite(found.distance_m)
    if np.count_nonzero(seen) < _LEAST_GROUND * np.count_nonzero(under):
        return None
    return float(np.median(found.distance_m[seen] * down[seen]))
