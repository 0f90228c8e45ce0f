# SPDX-License-Identifier: Apache-2.0
"""Relative change of the light on the ground at the nodes below bodies, and the radiance that they send for it.

    r - 1 = -(F (W Q - D B) + S v)/(E + S)

with W, Q, D and B those of coarse_nodes.py, F the interpolation from coarse nodes, E the ambient irradiance, S the
sun's and v the fraction of it that bodies block.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import Cache
from mr360uw.composite.ambient.body_layout import Layout
from mr360uw.composite.ambient.on_ground.ground_view import COARSE_NODES, NODES, from_coarse
from mr360uw.composite.ambient.on_ground.light_table import level_table
from mr360uw.composite.ambient.sunlight import Sunlight
from mr360uw.composite.shot import Shot
from mr360uw.ibl.lookup import environment_lookup, lookup_matrix
from mr360uw.types import Floats

_UP = np.array([[0.0, 1.0, 0.0]])


class GroundLight:
    """Light of one shot at the nodes of the bodies of a layout; what does not depend on what bodies send is found once.

    table: of `light_table` of the shot's environment. cache: keeps what bodies block while they stand as they do.
    """

    def __init__(self, shot: Shot, layout: Layout, table: Floats, sunlight: Sunlight, cache: Cache) -> None:
        self._layout = layout
        self._numbers = [k for k, node in enumerate(layout.nodes) if len(node)]
        self._empty = np.zeros((0, 3), np.float32)
        if not self._numbers:
            return
        self._coarse, residual = layout.coarse_nodes(cache), shot.environment.residual
        sky = level_table(table[..., :3], up=True).reshape(-1, 3).astype(np.float32)
        self._lost = self._coarse.weights @ sky
        beam, shaded = (np.concatenate(a) for a in zip(*(sunlight.at_nodes(k) for k in self._numbers), strict=True))
        whole = np.maximum(environment_lookup(shot.environment.ambient, _UP), 1e-9)
        self._whole, self._shade = whole + beam, beam * shaded[:, None]
        behind = cache.get("ambient behind", (layout, residual.shape), lambda: self._behind(residual.shape))
        self._sky = behind @ residual.reshape(-1, 3)

    def _behind(self, shape: tuple[int, ...]) -> Any:
        """Return the lookup in maps of a shape of the directions from bodies to their nodes."""
        layout = self._layout
        away = np.concatenate([layout.nodes[k] - layout.bodies[k].center for k in self._numbers])
        return lookup_matrix(shape, away)

    def change(self, sent: NDArray[np.float32]) -> list[NDArray[np.float32]]:
        """Return the relative change (NODES^2, 3) of the light at the nodes of each body, from -1 on; none of bodies
        that do not see the ground.

        sent: (all lookouts, 3) radiance that they send.
        """
        if not self._numbers:
            return [self._empty] * len(self._layout.bodies)
        down = np.concatenate([self._layout.sent_down(k, sent) for k in self._numbers])
        lost = (self._lost - self._coarse.sent @ down).reshape(-1, COARSE_NODES**2, 3)
        taken = ((from_coarse() @ lost).reshape(-1, 3) + self._shade) / self._whole
        return self._of_bodies(-np.minimum(taken, 1.0).astype(np.float32))

    def added(self, change: list[NDArray[np.float32]]) -> list[NDArray[np.float32]]:
        """Return the radiance (NODES^2, 3) that the nodes of each body send beyond what they would without bodies."""
        if not self._numbers:
            return change
        of_nodes = np.concatenate([change[k] for k in self._numbers])
        return self._of_bodies((self._sky * of_nodes).astype(np.float32))

    def _of_bodies(self, values: NDArray[np.float32]) -> list[NDArray[np.float32]]:
        found, step = [self._empty] * len(self._layout.bodies), NODES**2
        for number, k in enumerate(self._numbers):
            found[k] = values[number * step : (number + 1) * step]
        return found
