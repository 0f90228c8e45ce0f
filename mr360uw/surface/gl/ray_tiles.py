# SPDX-License-Identifier: Apache-2.0
"""Parts of a frame whose rays cannot meet the surface, which need a shader of a third of the cost."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mr360uw.surface.ray_stage import RayStage
from mr360uw.types import Rectangle, View

_TILE = 16
"""Side of a tile [pixels]: half as large, the boundary of the parts takes as long to find as to draw."""


def split_frame(stage: RayStage, view: View) -> tuple[list[Rectangle], list[Rectangle]]:
    """Return rectangles that cover the frame: those whose rays cannot meet the surface, and the others."""
    rows, columns = -(-view.height // _TILE), -(-view.width // _TILE)
    x = np.minimum(np.arange(columns + 1) * _TILE, view.width)
    y = np.minimum(np.arange(rows + 1) * _TILE, view.height)
    up = view.directions(*np.meshgrid(x, y))[..., 1]
    over = view.origins(*np.meshgrid(x, y))[..., 1] - view.surface_y_m
    # within a tile a direction is at most a diagonal of it away from the nearest corner
    margin = 1.5 * _TILE * view.pixel_rad
    if stage.camera_in_water:
        free = (up < -margin) & (over < stage.sea.lowest_m)
    else:
        free = (up > margin) & (over > stage.sea.highest_m)
    whole = free[:-1, :-1] & free[1:, :-1] & free[:-1, 1:] & free[1:, 1:]
    return _rectangles(whole, view), _rectangles(~whole, view)


def _rectangles(tiles: NDArray[np.bool_], view: View) -> list[Rectangle]:
    """Return the tiles (rows, columns) that are set as rectangles of pixels; runs that repeat below are joined."""
    found: list[Rectangle] = []
    started: dict[tuple[int, int], int] = {}
    for row, line in enumerate([*tiles, np.zeros(tiles.shape[1], bool)]):
        edges = np.flatnonzero(np.diff(np.concatenate([[False], line, [False]]).astype(np.int8)))
        runs = {(int(a), int(b)) for a, b in edges.reshape(-1, 2)}
        for run in started.keys() - runs:
            x, y = run[0] * _TILE, started.pop(run) * _TILE
            found.append(Rectangle(x, y, min(run[1] * _TILE, view.width) - x, min(row * _TILE, view.height) - y))
        started |= dict.fromkeys(runs - started.keys(), row)
    return sorted(found)
