# SPDX-License-Identifier: Apache-2.0
"""The plate's own relief as a receiver: a map of distances that is sure in places, and another surface elsewhere.

Measured distances are off by some tenths of a per cent from pixel to pixel, which would tilt normals by 15 degrees, so
they are smoothed, by no more than `OFF` of their values. Where a map is not sure, its distance is used if it is between
the sure ones about it, as beside edges. The inverse distance, which is linear in the picture on a plane, is what is
averaged.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.receiver.distance_map import inverse_distance, running_mean, smoothed, width_px
from mr360uw.composite.receiver.shape import ReceiverShape
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
    own, sure = inverse_distance(found.distance_m), (found.confidence >= SURE).astype(np.float32)
    if own.shape[1] > MOST_COLUMNS:
        seen = resized((own > 0.0).astype(np.float32), MOST_COLUMNS)
        own = (resized(own, MOST_COLUMNS) / np.maximum(seen, _MOSTLY)).astype(np.float32)
        sure = resized(sure, MOST_COLUMNS)
    rows, columns = own.shape
    sees = replace(view, width=columns, height=rows)
    x, y = np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5)
    elsewhere, _ = ReceiverShape(receiver, view.position).meet_along(sees, x, y, sees.directions(x, y))
    with np.errstate(divide="ignore"):
        shape = np.float32(1.0) / relief(own, sure > _MOSTLY, inverse_distance(elsewhere))
    return replace(receiver, plane_y=None, mesh=None, distance_m=shape)


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


def relief(own: Map, sure: NDArray[np.bool_], elsewhere: Map) -> Map:
    """Return the inverse distances (h, w) [1/m] of a receiver, 0 where there is no surface.

    own: (h, w) [1/m] those of the plate. sure: (h, w) where they are right. elsewhere: (h, w) [1/m] those of the
    surface that stands where the plate's are not used. Both are 0 where there is nothing.
    """
    sure = sure & (own > 0.0)
    least, most = (_of_windows(np.where(sure, own, np.float32(nothing)), nothing > 0.0) for nothing in (np.inf, 0.0))
    about = running_mean(sure.astype(np.float32), width_px(_ABOUT_DEG, own.shape[1]))
    alike = (about > _SUPPORT) & (own > (1.0 - _ALIKE) * least) & (own < (1.0 + _ALIKE) * most)
    used = sure | alike
    inverse = np.where(used, own, elsewhere)
    off = np.where(used & ~sure, np.float32(OFF_IN_HOLES), np.float32(OFF))
    return smoothed(inverse, inverse * (1.0 - off), inverse * (1.0 + off), _WIDTHS_DEG)


def _of_windows(values: Map, least: bool) -> Map:
    """Return the least or the largest value (h, w) of the windows about the pixels; the seam is closed."""
    import cv2

    side = width_px(_ABOUT_DEG, values.shape[1])
    half, of_window = side // 2, cv2.erode if least else cv2.dilate
    wide = cv2.copyMakeBorder(values, 0, 0, half, half, cv2.BORDER_WRAP)
    return np.asarray(of_window(wide, np.ones((side, side), np.uint8))[:, half : half + values.shape[1]])
