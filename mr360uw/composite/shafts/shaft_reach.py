# SPDX-License-Identifier: Apache-2.0
"""Parts of the frame in which light in the water before the plate changes enough to be drawn.

The frame is divided into cells, and the light in their middles is read from a coarse grid. A cell is drawn where that
light, or that of a cell near it, changes a code by a third of the threshold. A shaft too thin for the coarse grid is
too thin to be seen: what it adds falls with the length of the ray within it, as its width does.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.cache import Cache
from mr360uw.composite.lighting.surfaces import water_ahead
from mr360uw.composite.shafts.code_change import code_change
from mr360uw.composite.shot import Shot
from mr360uw.medium.shafts.froxels import FroxelGrid, shaft_field
from mr360uw.medium.shafts.shaft_scene import ShaftScene

Array = NDArray[np.float64]

_ROWS = 128
"""Cells from pole to pole, 1.4 degrees each."""
_AROUND = 2
"""Cells on every side of one with light that are drawn too."""
_MARGIN = 0.35
"""Fraction of the threshold at which a cell is drawn: between the coarse nodes there may be more."""
_STEP = 1.25
"""Ratio of the steps that the light is rounded to before cells are marked."""
_GRID = FroxelGrid(64, 192, 16)
"""The coarse grid: a sixth of the default one in both directions, half as many slices."""


def shaft_pixels(shot: Shot, scene: ShaftScene, range_m: float, least_codes: float, kept: Cache) -> NDArray[np.bool_]:
    """Return the mask (H, W) of pixels over whose veil the scene's light may change a code by `least_codes`.

    kept: holds what does not change from frame to frame.
    """
    view = shot.view
    side = max(2 * -(-view.height // (2 * _ROWS)), 2)
    rows, columns = -(-view.height // side), -(-view.width // side)
    x, y = np.meshgrid((np.arange(columns) + 0.5) * side, (np.arange(rows) + 0.5) * side)
    directions = np.asarray(view.directions(x, np.minimum(y, view.height - 0.5)), np.float64).reshape(-1, 3)
    ends = np.full(len(directions), range_m)
    changes = [_change(part, directions, ends, kept) for part in scene.parts]
    _, veil = water_ahead(shot, ends, directions)
    veil = veil * _stepped(np.mean(veil)) / max(float(np.mean(veil)), 1e-30)
    codes = sum((code_change(veil, change) for change in changes), np.zeros(len(veil)))
    marked = ((codes >= _MARGIN * least_codes) & (codes > 0.0)).reshape(rows, columns)
    around = np.pad(np.pad(marked, ((0, 0), (_AROUND,) * 2), "wrap"), ((_AROUND,) * 2, (0, 0))).astype(np.uint8)
    reach = np.ones((2 * _AROUND + 1,) * 2, np.uint8)
    marked = cv2.dilate(around, reach)[_AROUND:-_AROUND, _AROUND:-_AROUND] > 0
    return np.repeat(np.repeat(marked, side, axis=0), side, axis=1)[: view.height, : view.width]


def _change(scene: ShaftScene, directions: Array, ends: Array, kept: Cache) -> Array:
    """Return what one kind of light changes (n, 3) in the middles of a view's cells."""
    of_unit = kept.of(_radiance, scene.per_unit, directions, ends, kept, keep=2)
    return of_unit if scene.pattern is None else of_unit * _stepped(scene.pattern.sun.irradiance)


def _radiance(scene: ShaftScene, directions: Array, ends: Array, kept: Cache) -> Array:
    return shaft_field(scene, _GRID, directions, kept).radiance(directions, ends)


def _stepped(light: ArrayLike) -> Array:
    """Return light (...,) rounded up to a step, so that small changes of it mark the same cells."""
    return np.asarray(_STEP ** np.ceil(np.log(np.maximum(light, 1e-30)) / np.log(_STEP)))
