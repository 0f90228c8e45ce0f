# SPDX-License-Identifier: Apache-2.0
"""Confidence of distances: the probability that one is within 6 % of the truth, by logistic regression.

Regressed on synthetic dives with particles under caustics as they are and three times as strong
(`benchmarks/depth.py` measures it on others). What tells most is the correlation of all pairs of pictures at the size
of the frame: no wrong distance makes the caustics of many instants agree. Where distances vary within a few pixels, and
where the picture is even, they count for less.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mr360uw.depth.warping import Map, window_mean

_BESIDE = 4
"""Trials on either side of the best one that belong to the same minimum."""
_LOW_PARALLAX = np.exp(-3.5)
"""Parallax [rad] below which distances become uncertain: 1.7 degrees."""
_LEAST = 1e-3
"""Least margin, and least parallax [rad], of which a logarithm is taken."""
_CONTRAST_SIDE, _SPREAD_SIDE = 5, 9
"""Windows [px] of the contrast of the picture, and of the spread of the distances."""
_FINE, _COARSE, _MARGIN, _PARALLAX, _LOW, _CONTRAST, _SPREAD, _CONSTANT = (
    7.11,
    -6.60,
    1.12,
    -1.22,
    3.10,
    1.15,
    -1.01,
    -3.21,
)
"""Coefficients of the correlations in fine and in coarse pictures, and of the logarithms of the margin, of the
parallax, of how far that is below the low one, of the contrast [codes], and of the spread."""
_MANY, _FEW = 32, 2.0
"""Neighbours of the dives of the regression, and what one e-th of them takes off the logit: by
chance the caustics of few instants agree. Without it, half the neighbours leave four of five confident pixels right
under caustics three times as strong."""
_HALF = 0.85
"""Probability that is given the confidence of a half. Higher: less is used, and more of that is right."""


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """What a sweep tells of its distances, each (h, w) at the size of the sweep.

    cost: of the chosen trial. margin: by which the best trial elsewhere costs more, after smoothing.
    """

    cost: Map
    margin: Map

    @classmethod
    def of(cls, cost: Map, total: Map, best: NDArray[np.int64]) -> Evidence:
        """Return the evidence of costs (h, w, n), of smoothed ones, and of the trials (h, w) that were chosen."""
        at = best[..., None]
        elsewhere = np.where(np.abs(np.arange(cost.shape[-1]) - at) > _BESIDE, total, np.float32(np.inf)).min(axis=-1)
        margin = elsewhere - np.take_along_axis(total, at, -1)[..., 0]
        return cls(np.take_along_axis(cost, at, -1)[..., 0], margin)


def confidence(evidence: Evidence, cost: Map, parallax: Map, inverse: Map, grey: Map, count: int) -> Map:
    """Return confidences (H, W), 0 to 1, of a frame's distances.

    Parameters
    ----------
    evidence : of the sweep.
    cost : (H, W), of the refined distances.
    parallax : (H, W) [rad], of the neighbours on average.
    inverse : (H, W), inverse distances in largest baselines.
    grey : (H, W), the frame's codes in [0, 255].
    count : of neighbours.
    """
    import cv2

    size = cost.shape[::-1]
    coarse, margin = (cv2.resize(one, size, interpolation=cv2.INTER_LINEAR) for one in (evidence.cost, evidence.margin))
    wide = np.log(np.maximum(parallax, _LEAST))
    mean = window_mean(grey, _CONTRAST_SIDE)
    contrast = np.sqrt(np.maximum(window_mean(grey * grey, _CONTRAST_SIDE) - mean * mean, 0.0))
    depth, around = np.log(np.maximum(inverse, _LEAST)), np.ones((_SPREAD_SIDE, _SPREAD_SIDE), np.uint8)
    spread = cv2.dilate(depth, around) - cv2.erode(depth, around)
    logit = (
        _CONSTANT
        + _FINE * (1.0 - cost)
        + _COARSE * (1.0 - coarse)
        + _MARGIN * np.log(np.maximum(margin, _LEAST))
        + _PARALLAX * wide
        + _LOW * np.minimum(wide - np.log(_LOW_PARALLAX), 0.0)
        + _CONTRAST * np.log(contrast + 0.5)
        + _SPREAD * np.log(spread + 0.01)
        + _FEW * np.log(min(count / _MANY, 1.0))
    )
    shifted = np.clip(logit - np.log(_HALF / (1.0 - _HALF)), -30.0, 30.0)
    return np.asarray(1.0 / (1.0 + np.exp(-shifted)), np.float32)
