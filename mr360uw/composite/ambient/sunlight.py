# SPDX-License-Identifier: Apache-2.0
"""The sun's light on bodies and on the ground below them, over the ambient light's fall with depth."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import Cache
from mr360uw.composite.ambient.body_layout import Layout
from mr360uw.composite.lighting.sun import sun_of, sun_up
from mr360uw.composite.shot import Shot
from mr360uw.medium.lookup import ambient_ratio, beam_ratio
from mr360uw.types import Floats

_STEPS = 64.0
"""The sun's direction in shadow rays of this module is rounded to such parts of one: kept while its track trembles."""
_KEPT = 4
"""Directions of the sun for which shadows are kept while bodies stand still."""


class Sunlight:
    """Irradiance of one shot's sun; its shadow rays are kept in `cache`."""

    def __init__(self, shot: Shot, layout: Layout, cache: Cache) -> None:
        self._shot, self._layout, self._cache = shot, layout, cache
        self._sun = sun_of(shot)

    def ambient(self, points: Floats) -> Floats:
        """Return the ambient light (n, 3) at the depth of points (n, 3) of the world over that at the camera."""
        shot = self._shot
        if shot.medium is None:
            return np.ones((len(points), 3))
        return ambient_ratio(shot.medium, shot.view.surface_y_m - points[:, 1])

    def at_coarse(self) -> Floats:
        """Return the irradiance (all, 3) on the coarse samples of all bodies."""
        bodies = self._layout.bodies
        place = _coarse(self._layout)
        if self._sun is None:
            return np.zeros((sum(map(len, place)), 3))
        towards = self._sun.direction
        cosine = [b.transfer.lattice.normal[b.transfer.coarse.sample] @ (towards @ b.rotation) for b in bodies]
        lit = 1.0 - np.concatenate(self._cache.of(_coarse_shaded, self._layout, self._towards, keep=_KEPT))
        return self._beam(np.concatenate(place)) * (np.maximum(np.concatenate(cosine), 0.0) * lit)[:, None]

    def at_nodes(self) -> tuple[Floats, Floats]:
        """Return the irradiance on the nodes of all bodies without bodies (n, 3), and what part (n,) of it bodies
        block.
        """
        node = np.concatenate(self._layout.nodes)
        if self._sun is None:
            return np.zeros((len(node), 3)), np.zeros(len(node))
        beam = self._beam(node) * max(float(self._sun.direction[1]), 0.0)
        shaded = self._cache.of(_nodes_shaded, self._layout, self._towards, keep=_KEPT)
        return beam, np.concatenate(shaded).astype(np.float64)

    def _beam(self, points: Floats) -> Floats:
        """Return the sun's irradiance (n, 3) across its beam."""
        shot, sun = self._shot, self._sun
        assert sun is not None
        beam = np.broadcast_to(sun.irradiance, (len(points), 3))
        if shot.medium is not None:
            beam = beam * beam_ratio(shot.medium, shot.view.surface_y_m - points[:, 1], sun_up(sun))
        return np.asarray(beam / np.maximum(self.ambient(points), 1e-9))

    @property
    def _towards(self) -> Floats:
        assert self._sun is not None
        towards = np.round(_STEPS * np.asarray(self._sun.direction))
        return np.asarray(towards / np.linalg.norm(towards))


def _coarse(layout: Layout) -> list[Floats]:
    """Return the places (C, 3) of the coarse samples of each body in the world."""
    parts = [(body.placed, body.transfer.lattice.position[body.transfer.coarse.sample]) for body in layout.bodies]
    return [placed.to_world(position) for placed, position in parts]


def _coarse_shaded(layout: Layout, towards: Floats) -> list[NDArray[np.bool_]]:
    return layout.shaded(_coarse(layout), towards)


def _nodes_shaded(layout: Layout, towards: Floats) -> list[NDArray[np.bool_]]:
    return layout.shaded(layout.nodes, towards)
