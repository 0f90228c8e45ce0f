# SPDX-License-Identifier: Apache-2.0
"""Holdout mattes: parts of the plate that stay in front of the objects."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mr360uw.composite.shot import Shot
from mr360uw.types import Tile


def hold_out(shot: Shot, tile: Tile) -> Tile:
    """Return a tile with the shot's mattes applied to the objects and to the receiver's ratio.

    A distance matte hides the objects behind it. It leaves the receiver, whose distances are of the same surfaces.
    """
    if shot.holdout is None and shot.holdout_distance_m is None:
        return tile
    kept = np.ones(tile.alpha.shape, np.float32)
    if shot.holdout is not None:
        kept -= np.clip(shot.holdout[tile.window], 0.0, 1.0).astype(np.float32)
    plate_kept = kept
    ratio = 1.0 + plate_kept[..., None] * (tile.ratio - 1.0)
    if shot.holdout_distance_m is not None:
        kept = kept * (tile.distance_m < shot.holdout_distance_m[tile.window])
    return replace(
        tile,
        radiance=tile.radiance * kept[..., None],
        alpha=tile.alpha * kept,
        distance_m=np.where(kept > 0.0, tile.distance_m, np.inf).astype(np.float32),
        ratio=ratio.astype(np.float32),
        shafts=None if tile.shafts is None else tile.shafts * plate_kept[..., None],
    )
