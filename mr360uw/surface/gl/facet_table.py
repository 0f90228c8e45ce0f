# SPDX-License-Identifier: Apache-2.0
"""Table of the random facets that rays see, read by facets.glsl.

The deviation up to which a share of the seen facets lies has no closed form. It depends on two numbers: the normal
quantile z of the share, and c = -mean/spread of f (see `slopes`). The table holds it less z, which is smooth and
bounded, over z in [-QUANTILES, QUANTILES] and over w = c/(1 + |c|), from -1, where no facet is turned away, to the w of
c = FARTHEST.
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from mr360uw.surface.slopes import FARTHEST
from mr360uw.surface.tracing.facet_draws import seen_below, seen_deviation

QUANTILES = 5.6
"""Largest normal quantile in the table: beyond that of the largest number of 24 bits."""
_COLUMNS, _ROWS = 129, 256
"""Nodes over z and w: a slope is then within 4e-4 of its standard deviation. Half as many: 1.6e-3."""
_ALL = 1e9
"""-c of the first row, where all facets are seen alike."""


@functools.cache
def seen_slopes() -> NDArray[np.float32]:
    """Return (rows, columns, 2): the deviation less z, and the logarithm of mean(max(f, 0))/hypot(mean f, spread)."""
    z = np.linspace(-QUANTILES, QUANTILES, _COLUMNS)
    w = np.linspace(-1.0, FARTHEST / (1.0 + FARTHEST), _ROWS)
    c = w / np.maximum(1.0 - np.abs(w), 1.0 / _ALL)
    light = np.array([seen_below(FARTHEST, mean, 1.0) for mean in -c])
    rows = zip(-c, light, strict=True)
    seen = np.array([[seen_deviation(share, mean, 1.0, all_) for share in ndtr(z)] for mean, all_ in rows])
    area = light / np.hypot(c, 1.0)
    table = np.stack([seen - z, np.broadcast_to(np.log(area)[:, None], seen.shape)], axis=-1)
    return table.astype(np.float32)
