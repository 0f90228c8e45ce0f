# SPDX-License-Identifier: Apache-2.0
"""Confidence of distances: the probability that one is within 6 % of the truth, by logistic regression.

Regressed on synthetic dives with particles, poles and fish, under caustics as they are and three times as strong;
`benchmarks/depth.py` measures it on others. No wrong distance makes the caustics of many instants agree, but all pairs
of pictures also agree on what is behind a fish that passes, which stands still and is hidden in this frame alone. So
what tells most is that the frame itself agrees with the mean of the others, as much as these agree with each other.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mr360uw.depth.warping import Map, Panorama, Warped, resized, window_mean
from mr360uw.types import Floats

_SIDES = 7, 11, 21
"""Sides of windows [px] in which correlations are taken."""
_LEAST = 1e-3
"""Least parallax [rad], and inverse distance in baselines, of which a logarithm is taken."""
_SPREAD_SIDES, _LEVEL_SIDE = (9, 27), 5
"""Windows [px] of the spread of the distances, and of the brightness."""
_LEAST_SPREAD, _LEAST_WEIGHT = 0.01, 0.03
"""Spread of logarithms of distance, and fraction of the neighbours, that are added before a logarithm is taken."""
_COEFFICIENTS = np.array([1.92, 2.11, -13.75, 2.84, 3.42, 10.74, -0.87, 0.55, -0.47, -0.72, 4.55, -2.46], np.float32)
"""Of the evidence, in its order."""
_FILLED, _ERODED = 5, 9
"""Windows [px] of the largest, and then of the least logit about a pixel. 1 and 1: at the same coverage, three times as
many pixels of fish are confident of a wrong distance."""
_FAR = 30.0
"""Baselines beyond which nothing is taken to be seen that stands still."""
_RIG_ALIKE, _RIG_MORE = 0.25, 0.1
"""Correlation of pictures as they are from which on a pixel is of the camera's rig, and how much more than warped ones
it must be, where these are not warped by infinity. .5: a quarter of a mottled disc is missed."""
_RIG_PX, _RIG_SIDE = 1.0, 9
"""Least movement [px] of what is far, where a rig can be told from it, and pixels about a rig that are left out too."""
_MANY, _FEW = 32, 2.0
"""Neighbours of the dives of the regression, and what one e-th of them takes off the logit: by chance the caustics of
few instants agree."""
_HALF = 0.6
"""Probability that is given the confidence of a half. Higher: less is used, and more of that is right."""


def evidence(
    reference: Panorama, neighbours: Sequence[Panorama], warped: Warped, inverse: Map, baseline_m: float
) -> Floats:
    """Return what tells whether inverse distances (H, W) [1/m] are right, (12, H, W) float32.

    warped: neighbours at the size of the frame. Correlations of all pairs in windows of three sizes; of the frame with
    the mean of the others, likewise; difference of the frame's brightness from their mean, in deviations of theirs;
    logarithms of the parallax, of the spread of distances near and about the pixel, and of the fraction of the
    neighbours that count; and one.
    """
    import cv2

    sums = warped.sums(inverse)
    size = inverse.shape[::-1]
    small = Warped(reference, neighbours, max(warped.width // 2, min(warped.width, 256)), _brightness)
    level = small.sums(resized(inverse, small.width))
    mean = level[0] / np.maximum(level[3], _LEAST)
    variance = np.maximum(level[2] / np.maximum(level[3], _LEAST) - mean * mean, 0.0)
    differs = cv2.resize(np.abs(small.own - mean) / np.sqrt(variance + 1.0), size, interpolation=cv2.INTER_LINEAR)
    depth = np.log(np.maximum(inverse * np.float32(baseline_m), _LEAST)).astype(np.float32)
    spreads = []
    for side in _SPREAD_SIDES:
        around = np.ones((side, side), np.uint8)
        spreads.append(np.log(cv2.dilate(depth, around) - cv2.erode(depth, around) + _LEAST_SPREAD))
    return np.stack(
        [
            *(1.0 - warped.cost_of(sums, side) for side in _SIDES),
            *(_agreement(warped.own, sums[0], side) for side in _SIDES),
            np.minimum(differs, 4.0),
            np.log(np.maximum(warped.parallax(inverse), _LEAST)),
            *spreads,
            np.log(sums[3] / warped.count + _LEAST_WEIGHT),
            np.ones_like(depth),
        ]
    ).astype(np.float32)


def _brightness(grey: Map) -> Map:
    """Return a grey picture (h, w) averaged over windows."""
    return window_mean(grey, _LEVEL_SIDE)


def _agreement(own: Map, others: Map, side: int) -> Map:
    """Return the correlation (h, w) of a picture with the sum of others within windows."""
    power = window_mean(own * own, side) * window_mean(others * others, side)
    return np.asarray(window_mean(own * others, side) / np.sqrt(np.maximum(power, 1e-6)), np.float32)


def of_rig(warped: Warped, inverse: Map, seen: Floats, baseline_m: float) -> NDArray[np.bool_]:
    """Return the pixels (H, W) that move with the camera: a tripod, a hand, a stick.

    Pictures there agree as they are, though what stands still would have moved, however far it is; and warped by the
    distances that were found, inverse (H, W) [1/m], they agree less, or these are infinite. seen: the evidence.
    """
    import cv2

    alike = warped.unwarped(_SIDES[1])
    found = (inverse * np.float32(baseline_m) > 1.0 / _FAR) & (alike < seen[1] + _RIG_MORE)
    if not np.any(alike[~found] > _RIG_ALIKE):
        return np.zeros(alike.shape, bool)
    moves = warped.shifted(1.0 / (_FAR * baseline_m)) > _RIG_PX * 2.0 * np.pi / warped.width
    rig = (alike > _RIG_ALIKE) & ~found & moves
    return np.asarray(cv2.dilate(rig.astype(np.uint8), np.ones((_RIG_SIDE, _RIG_SIDE), np.uint8)) > 0)


def confidence(seen: Floats, count: int) -> Map:
    """Return confidences (H, W), 0 to 1, from evidence (12, H, W) and the number of neighbours.

    Pixels that are surrounded by sure ones are so too; then those within some pixels of doubtful ones are doubtful: the
    rim of a fish, whose windows hold more of what is behind it than of the fish.
    """
    import cv2

    logit = np.tensordot(_COEFFICIENTS, seen, 1) + _FEW * np.log(min(count / _MANY, 1.0))
    reach = _ERODED // 2
    wide = cv2.copyMakeBorder(logit.astype(np.float32), 0, 0, reach, reach, cv2.BORDER_WRAP)
    filled = cv2.dilate(wide, np.ones((_FILLED, _FILLED), np.uint8))
    least = cv2.erode(filled, np.ones((_ERODED, _ERODED), np.uint8))[:, reach:-reach]
    shifted = np.clip(least - np.log(_HALF / (1.0 - _HALF)), -30.0, 30.0)
    return np.asarray(1.0 / (1.0 + np.exp(-shifted)), np.float32)
