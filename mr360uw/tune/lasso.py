# SPDX-License-Identifier: Apache-2.0
"""A matte from a rough outline of something in the plate: GrabCut inside of the outline, edges as the picture has them.

What is outside of the outline is taken as background, what is inside as one or the other by its colours (Rother et al.
2004, "GrabCut"); the edge follows the picture by a guided filter (He et al. 2013).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from mr360uw.errors import ParameterError
from mr360uw.tune.placing import Point, pixel_of_point

_MARGIN = 0.35
"""Picture beside the outline whose colours are those of the background, over the outline's longer side."""
_CUT_PX = 480
"""Longer side of the picture that is cut: a second on one core."""
_ROUNDS = 4
_EDGE_PX, _EDGE_SPREAD = 2, 1e-2
"""Radius of the filter of edges, in pixels of the picture that is cut, and the variance of values that is no edge: with
a tenth of it the matte follows noise, with a radius of 6 edges are twice as far off."""


def matte_of_outline(picture: NDArray[np.uint8], outline: Sequence[Point]) -> NDArray[np.uint8]:
    """Return the matte (h, w), 0 to 255, of what an outline is drawn around in a panorama (h, w, 3).

    outline: at least three points, in turn; it may cross the seam, and no pole. Raises `ParameterError` where nothing
    stands out inside.
    """
    height, width = picture.shape[:2]
    if len(outline) < 3:
        raise ParameterError(f"matte - an outline needs three points (got {len(outline)}) - click around the thing")
    places = np.array([pixel_of_point(point, width, height) for point in outline])
    turn = int(width // 2 - places[0, 0])
    places[:, 0] = (places[:, 0] + turn) % width  # the first point is in the middle: the seam is far
    low, high = places.min(axis=0), places.max(axis=0)
    margin = _MARGIN * float((high - low).max()) + 4.0
    x0, y0 = (max(int(v), 0) for v in low - margin)
    x1, y1 = (min(int(v) + 1, most) for v, most in zip(high + margin, (width, height), strict=True))
    part = np.ascontiguousarray(np.roll(picture, turn, axis=1)[y0:y1, x0:x1])
    alpha = _cut_out(part, places - (x0, y0))
    whole = np.zeros((height, width), np.uint8)
    whole[y0:y1, x0:x1] = alpha
    return np.roll(whole, -turn, axis=1)


def _cut_out(part: NDArray[np.uint8], outline: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Return the matte (h, w) of a part of a picture (h, w, 3). outline: (n, 2) x and y in it."""
    height, width = part.shape[:2]
    scale = min(_CUT_PX / max(height, width), 1.0)
    size = max(round(width * scale), 8), max(round(height * scale), 8)
    small = cv2.resize(part, size, interpolation=cv2.INTER_AREA)
    inside = np.zeros(small.shape[:2], np.uint8)
    cv2.fillPoly(inside, [np.rint(outline * np.divide(size, (width, height))).astype(np.int32)], 1)
    labels = np.where(inside > 0, cv2.GC_PR_FGD, cv2.GC_BGD).astype(np.uint8)
    if not np.any(inside):
        raise ParameterError("matte - the outline holds no pixel (got a line) - click around the thing")
    cv2.setRNGSeed(0)  # its first clusters are drawn at random
    try:
        cv2.grabCut(small, labels, None, np.zeros((1, 65)), np.zeros((1, 65)), _ROUNDS, cv2.GC_INIT_WITH_MASK)
    except cv2.error:
        labels[:] = cv2.GC_BGD
    found = ((labels == cv2.GC_FGD) | (labels == cv2.GC_PR_FGD)).astype(np.float32)
    if not np.any(found):
        raise ParameterError("matte - nothing stands out there (got one colour) - draw the outline wider")
    found = cv2.resize(found, (width, height), interpolation=cv2.INTER_LINEAR)
    guide = part.astype(np.float32) / 255.0
    soft = cv2.ximgproc.guidedFilter(guide, found, max(round(_EDGE_PX / scale), 1), _EDGE_SPREAD)
    return np.rint(255.0 * np.clip(soft, 0.0, 1.0)).astype(np.uint8)


def free_name(folder: Path) -> str:
    """Return the first name of a matte that no file in a folder has."""
    return next(name for k in range(1, 1 << 20) if not (folder / (name := f"matte-{k}.png")).exists())
