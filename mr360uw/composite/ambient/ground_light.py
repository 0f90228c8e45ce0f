# SPDX-License-Identifier: Apache-2.0
"""The sun's light on bodies and the ground, over the ambient light's fall with depth, and the light of the ground: its
relative change at the nodes below bodies, and the radiance that these send.

    r - 1 = -(F L + S v)/(E + S)

with L the ambient light that bodies block at coarse nodes less what they send there, F the interpolation from these, E
the ambient irradiance, S the sun's and v the fraction of it that bodies block. A node sends r G, and G is as bright
from all sides:

    G = w P + (1 - w) L        w = T^20

with P what the camera sees in its place, T the transmittance of the water before it, and L the environment in the
direction of who looks at it. Under water the camera sees more haze than ground there: no water is the limit of thin
water, and half of G is P at a loss of 3.5 %.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import Cache
from mr360uw.composite.ambient.body import COARSE_NODES, NODES, from_coarse
from mr360uw.composite.ambient.body_layout import Exchange, Layout
from mr360uw.composite.ambient.directions import seen_by_camera
from mr360uw.composite.lighting.sun import sun_of, sun_up
from mr360uw.composite.shot import Shot
from mr360uw.ibl.lookup import environment_lookup
from mr360uw.medium.lookup import ambient_ratio, beam_ratio, transmittance_lookup
from mr360uw.types import Floats

_UP = np.array([[0.0, 1.0, 0.0]])
_THIN_POWER = 20.0
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
        lit = np.concatenate(self._cache.of(_coarse_lit, self._layout, self._towards, keep=_KEPT))
        return self._beam(np.concatenate(place)) * (np.maximum(np.concatenate(cosine), 0.0) * lit)[:, None]

    def at_nodes(self) -> tuple[Floats, Floats]:
        """Return the irradiance on the nodes of all bodies without bodies (n, 3), and what part (n,) of it bodies
        block.
        """
        node = np.concatenate(self._layout.nodes)
        if self._sun is None:
            return np.zeros((len(node), 3)), np.zeros(len(node))
        beam = self._beam(node) * max(float(self._sun.direction[1]), 0.0)
        return beam, 1.0 - np.concatenate(self._cache.of(_nodes_lit, self._layout, self._towards, keep=_KEPT))

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


def _coarse_lit(layout: Layout, towards: Floats) -> list[Floats]:
    return layout.lit(_coarse(layout), towards)


def _nodes_lit(layout: Layout, towards: Floats) -> list[Floats]:
    return layout.lit(layout.nodes, towards)


class GroundLight:
    """Light of one shot at the nodes of bodies; what does not depend on what bodies send is found once.

    table: of the shot's environment (sky_table.py).
    """

    def __init__(self, shot: Shot, exchange: Exchange, table: Floats, sunlight: Sunlight) -> None:
        self._exchange, layout = exchange, exchange.layout
        self._numbers = [k for k, node in enumerate(layout.nodes) if len(node)]
        self._empty = np.zeros((0, 3), np.float32)
        if not self._numbers:
            return
        self._lost, light = exchange.blocked.irradiance(table), shot.environment
        map_ = light.residual if light.detail is None else light.detail
        beam, shaded = sunlight.at_nodes()
        whole = np.maximum(environment_lookup(shot.environment.ambient, _UP), 1e-9)
        self._whole, self._shade = whole + beam, beam * shaded[:, None]
        nodes = np.concatenate([layout.nodes[k] for k in self._numbers])
        behind = np.concatenate([layout.nodes[k] - layout.bodies[k].center for k in self._numbers])
        self._plain = ground_radiance(shot, map_, nodes, behind)

    def _taken(self, sent: NDArray[np.float32]) -> Floats:
        """Return 1 - r (all nodes, 3), at most 1. sent: (all coarse samples, 3) radiance that they send."""
        exchange = self._exchange
        bounced = exchange.layout.bounced(exchange.blocked, exchange.coarse, exchange.sent_down(sent))
        lost = self._lost - bounced
        at_nodes = (from_coarse() @ lost.reshape(-1, COARSE_NODES**2, 3)).reshape(-1, 3)
        return np.minimum((at_nodes + self._shade) / self._whole, 1.0)

    def radiance(self, sent: NDArray[np.float32] | None) -> list[NDArray[np.float32]]:
        """Return the radiance (NODES^2, 3) that the nodes of each body send, none of bodies that do not see the ground.

        sent: (all coarse samples, 3) radiance that they send; None: as the ground is without bodies.
        """
        if not self._numbers:
            return [self._empty] * len(self._exchange.layout.bodies)
        left = 1.0 if sent is None else 1.0 - self._taken(sent)
        return self._of_bodies((self._plain * left).astype(np.float32))

    def _of_bodies(self, values: NDArray[np.float32]) -> list[NDArray[np.float32]]:
        found, step = [self._empty] * len(self._exchange.layout.bodies), NODES**2
        for number, k in enumerate(self._numbers):
            found[k] = values[number * step : (number + 1) * step]
        return found


def ground_radiance(shot: Shot, map_: Floats, place: Floats, towards: Floats) -> Floats:
    """Return the radiance G (n, 3) of places (n, 3) of level ground without bodies, see the module's text.

    map_: (H, W, 3) of the environment. towards: (n, 3) directions in which the places are looked at, down.
    """
    away = place - shot.view.position
    way = seen_by_camera(away, towards)
    shown = environment_lookup(map_, way)
    if shot.medium is None:
        return shown
    through = transmittance_lookup(shot.medium, np.linalg.norm(away, axis=-1), way[:, 1])
    behind = environment_lookup(map_, towards)
    return np.asarray(behind + through**_THIN_POWER * (shown - behind))
