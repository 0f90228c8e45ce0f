# SPDX-License-Identifier: Apache-2.0
"""Cuts of a clip, found where the picture changes at once and stays changed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mr360uw.types import Floats

_SIZE = (32, 16)
_LEAST_CHANGE = 0.3
"""Mean change of a thumbnail, in its standard deviations, of a cut. Two pictures that have nothing in common differ by
1.1; a car that drives out from under a bridge reaches 0.15."""
_OVER_USUAL = 4.0
"""Least change of a cut over the median change of the clip."""
_CERTAIN_CHANGE = 0.8
"""Change that is a cut in any clip: the fastest swimming over a chequered floor reaches 0.3."""
_NOISE_CODES = 4.0


def thumbnail(grey: NDArray[np.uint8]) -> Floats:
    """Return a picture's (16, 32) means over blocks, less their mean, over their standard deviation."""
    import cv2

    small = np.asarray(cv2.resize(grey, _SIZE, interpolation=cv2.INTER_AREA), np.float64)
    return np.asarray((small - small.mean()) / (small.std() + _NOISE_CODES))


def find_picture_cuts(thumbnails: Floats) -> tuple[int, ...]:
    """Return the first frames after cuts, of thumbnails (n, 16, 32).

    A flash in one frame is none. Where most frames differ by half as much as a cut, as noise does, there are none.
    """
    if len(thumbnails) < 3:
        return ()
    change = np.abs(np.diff(thumbnails, axis=0)).mean(axis=(1, 2))
    limit = min(max(_LEAST_CHANGE, _OVER_USUAL * float(np.median(change))), _CERTAIN_CHANGE)
    if float(np.median(change)) > 0.5 * limit:
        return ()
    cuts: list[int] = []
    for k in (np.flatnonzero(change > limit) + 1).tolist():
        stays = np.abs(thumbnails[min(k + 1, len(thumbnails) - 1)] - thumbnails[k - 1]).mean() > limit
        returned = k >= 2 and np.abs(thumbnails[k] - thumbnails[k - 2]).mean() < limit and change[k - 2] > limit
        if stays and not returned:
            cuts.append(k)
    return tuple(cuts)
