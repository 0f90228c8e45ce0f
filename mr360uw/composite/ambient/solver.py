# SPDX-License-Identifier: Apache-2.0
"""Ambient light of a shot with everything that bodies keep off and send back, solved on their sites for every frame.

    E_i = sum_k c_ik V_ik L_k + sum_j c_ij B_j + sum_g c_ig L_g (r_g - 1)        B_j = rho_j (E_j + S_j)/pi + e_j

with i, j sites, c the solid angle times cosine of a direction, V its visibility, L the environment, g the nodes of the
ground, r the ratio of light on them, rho the reflectance, S the sun's irradiance and e the emission. Jacobi steps from
E as if each site lay in a hollow of uniform light: that of a furnace stays what it is in every step, also in a closed
white box.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import Cache
from mr360uw.composite.ambient.body_layout import Layout
from mr360uw.composite.ambient.body_view import NODES
from mr360uw.composite.ambient.directions import blurred, radiance_towards
from mr360uw.composite.ambient.ground_kernel import gather, shown
from mr360uw.composite.ambient.knot_values import CHANNELS
from mr360uw.composite.ambient.light_table import light_table
from mr360uw.composite.ambient.lobe_occlusion import reflected_among
from mr360uw.composite.lighting.sun import sun_of, sun_up
from mr360uw.composite.shot import Shot
from mr360uw.ibl.lookup import environment_lookup
from mr360uw.medium.lookup import ambient_ratio, beam_ratio
from mr360uw.types import Floats

BOUNCES = 8
"""Steps of the solution: what the first guess is off by shrinks by the reflectance times what is hidden in each, to
less than half a percent inside a crate of reflectance .8."""
_BRIGHTEST = 16.0
"""Most that neighbours multiply the ambient light of a place by."""
_STEPS = 64.0
"""The sun's direction in shadow rays of this module is rounded to such parts of one: kept while its track trembles."""
_FEW = 0.002
"""Share of a node's light below which the mean of what it sees is drawn to that of its neighbours."""


@dataclass(frozen=True, slots=True, eq=False)
class AmbientLight:
    """Solved ambient light of a shot. values: for each object the values (K, CHANNELS) of its knots, float32, or None
    where nothing is in its way. table: of the environment, as `ground_kernel.gather` takes it. sent: for each body that
    the ground sees the mean radiance (NODES, NODES, 3) of what it hides, at the nodes below it. ambient: (H, W, 3).
    """

    layout: Layout
    values: tuple[NDArray[np.float32] | None, ...]
    table: NDArray[np.float64]
    sent: tuple[Floats, ...]
    ambient: Floats

    def free(self, point: Floats, normal: Floats, swept: tuple[NDArray[Any], NDArray[Any]]) -> Floats:
        """Return the fraction (n, 3) of the ambient light that is left on the ground at places (n, 3) of the world with
        normals (n, 3), with what bodies send there; `swept` is the layout's sweep of the places.
        """
        lost, share = light_lost(self.layout, self.table, self.sent, point, normal, swept)
        whole = np.maximum(environment_lookup(self.ambient, normal), 1e-9)
        return 1.0 - shown(share)[:, None] * lost / whole


def light_lost(
    layout: Layout,
    table: NDArray[np.float64],
    sent: tuple[Floats, ...],
    point: Floats,
    normal: Floats,
    swept: tuple[NDArray[Any], NDArray[Any]],
) -> tuple[Floats, Floats]:
    """Return the irradiance (n, 3) that bodies take from places of the ground less what they send there, and the
    fraction (n,) of uniform light that they block. The arguments are those of `AmbientLight` and `AmbientLight.free`.
    """
    blocked = np.zeros((len(sent), len(normal), 4))
    normal = np.ascontiguousarray(normal, np.float64)
    weights = normal
    if len(normal) and np.all(normal == normal[0]):
        table, weights = np.tensordot(table, normal[0], axes=(2, 0))[:, :, None], np.ones((len(normal), 1))
    gather(normal, weights, *swept, table, blocked)
    lost = blocked[..., :3].sum(axis=0)
    for k, radiance, of in zip(layout.ground_bodies, sent, blocked, strict=True):
        lost -= of[:, 3:] * layout.at_nodes(k, radiance, point)
    return lost, blocked[..., 3].sum(axis=0) / np.pi


class Solver:
    """Solves the ambient light of one shot; the layout's shadow rays and sweeps of its nodes are kept in `cache`."""

    def __init__(self, shot: Shot, layout: Layout, cache: Cache) -> None:
        self._shot, self._layout, self._cache = shot, layout, cache
        map_ = blurred(shot.environment)
        self._radiance = [radiance_towards(map_, body.rotation) for body in layout.bodies]
        self._plain = [
            b.transfer.cosine @ r.astype(np.float32) for b, r in zip(layout.bodies, self._radiance, strict=True)
        ]
        self._reflected = np.concatenate([b.transfer.reflected(shot.refractive_index) for b in layout.bodies])
        self._emitted = np.concatenate([b.transfer.emission / self._scale(b.center[None]) for b in layout.bodies])
        self._sun = np.concatenate([self._sunlight(k) for k in range(len(layout.bodies))])
        self._table = light_table(shot.environment)

    def solve(self) -> AmbientLight:
        """Return the light after `BOUNCES` steps; the ground's shade is found from the first."""
        layout = self._layout
        views = layout.views
        irradiance = np.concatenate(self._plain) * self._first_guess()
        direct = [
            plain - view.lost @ radiance
            for plain, view, radiance in zip(self._plain, views, self._radiance, strict=True)
        ]
        shade: list[Floats] = [np.zeros((len(plain), 3)) for plain in direct]
        sent = self._sent(irradiance)
        steps = BOUNCES if any(view.sites.nnz or view.ground.nnz for view in views) else 0
        for step in range(steps):
            if step == 1:
                down = self._down(sent)
                shade = [view.ground @ (self._floor(k) * self._ground_change(k, down)) for k, view in enumerate(views)]
            found = [d + view.sites @ sent + s for d, view, s in zip(direct, views, shade, strict=True)]
            irradiance = np.concatenate(found)
            sent = self._sent(irradiance)
        values = self._values(np.maximum(irradiance, 0.0), sent) if self._shot.draw.ambient_occlusion else None
        none: tuple[None, ...] = (None,) * len(self._shot.objects)
        down = self._down(sent)
        ambient = self._shot.environment.ambient
        return AmbientLight(layout, none if values is None else values, self._table, down, ambient)

    def _first_guess(self) -> Floats:
        """Return the ratio (sites, 3) of irradiance were every site in a hollow of its own openness v and reflectance:
        v/(1 - rho (1 - v)); 1 in a white or an open one.
        """
        seen = np.concatenate([view.visible[:, None] for view in self._layout.views])
        return (seen + 1e-6) / (1.0 - self._reflected * (1.0 - seen) + 1e-6)

    def _sent(self, irradiance: Floats) -> Floats:
        """Return the radiance (sites, 3) that sites send to all sides, over the ambient light's fall with depth."""
        return self._reflected * (irradiance + self._sun) / np.pi + self._emitted

    def _scale(self, points: Floats) -> Floats:
        """Return the ambient light (n, 3) at the depth of points (n, 3) of the world over that at the camera."""
        shot = self._shot
        if shot.medium is None:
            return np.ones((len(points), 3))
        return ambient_ratio(shot.medium, shot.view.surface_y_m - points[:, 1])

    def _beam(self, points: Floats) -> Floats:
        """Return the sun's irradiance (n, 3) across its beam over the ambient light's fall with depth."""
        shot, sun = self._shot, sun_of(self._shot)
        if sun is None:
            return np.zeros((len(points), 3))
        beam = np.broadcast_to(sun.irradiance, (len(points), 3))
        if shot.medium is not None:
            beam = beam * beam_ratio(shot.medium, shot.view.surface_y_m - points[:, 1], sun_up(sun))
        return beam / np.maximum(self._scale(points), 1e-9)

    def _sunlight(self, number: int) -> Floats:
        """Return the irradiance (S, 3) of the sun on the sites of a body."""
        body, sun = self._layout.bodies[number], sun_of(self._shot)
        if sun is None:
            return np.zeros((len(body.transfer.cosine), 3))
        place = body.placed.to_world(body.transfer.lattice.position)
        cosine = np.maximum(body.transfer.lattice.normal @ body.rotation.T @ sun.direction, 0.0)
        return self._beam(place) * (cosine * ~self._shaded(("sites", number), place))[:, None]

    def _shaded(self, what: object, place: Floats) -> NDArray[np.bool_]:
        sun = sun_of(self._shot)
        assert sun is not None
        towards = np.round(_STEPS * np.asarray(sun.direction))
        towards = towards / np.linalg.norm(towards)
        key = (self._layout, what, towards.tobytes())
        return self._cache.get("ambient sun", key, lambda: self._layout.shaded(place, towards), keep=256)

    def _down(self, sent: Floats) -> tuple[Floats, ...]:
        """Return `AmbientLight.sent`."""
        return tuple(self._sent_down(k, sent) for k in self._layout.ground_bodies)

    def _ground_change(self, number: int, down: tuple[Floats, ...]) -> Floats:
        """Return the relative change (NODES^2, 3) of the light on the ground at the nodes of a body, from -1 on."""
        node, layout = self._layout.views[number].node, self._layout
        if len(node) == 0:
            return np.zeros((0, 3))
        sun, up = sun_of(self._shot), np.array([0.0, 1.0, 0.0])
        swept = self._cache.get("ambient nodes", (layout, number), lambda: layout.sweep(node), keep=64)
        lost, _ = light_lost(layout, self._table, down, node, np.tile(up, (len(node), 1)), swept)
        before = np.maximum(environment_lookup(self._shot.environment.ambient, up[None]), 1e-9)
        change = -lost
        if sun is not None:
            beam = self._beam(node) * max(float(sun.direction[1]), 0.0)
            change = change - beam * self._shaded(("nodes", number), node)[:, None]
            before = before + beam
        return np.maximum(change / before, -1.0)

    def _floor(self, number: int) -> Floats:
        """Return the radiance (NODES^2, 3) of the ground without bodies at the nodes of a body."""
        away = self._layout.views[number].node - self._layout.bodies[number].center
        towards = away / np.maximum(np.linalg.norm(away, axis=-1, keepdims=True), 1e-9)
        return environment_lookup(self._shot.environment.residual, towards)

    def _values(self, irradiance: Floats, sent: Floats) -> tuple[NDArray[np.float32] | None, ...]:
        layout = self._layout
        values: list[NDArray[np.float32] | None] = []
        for k, (body, view) in enumerate(zip(layout.bodies, layout.views, strict=True)):
            if view.nothing:
                values.append(None)
                continue
            plain, part = self._plain[k], slice(layout.first[k], layout.first[k + 1])
            of_sites = np.zeros((len(plain), CHANNELS))
            least = 1e-3 * plain.max() + 1e-9
            of_sites[:, :3] = np.minimum((irradiance[part] + least) / (plain + least), _BRIGHTEST)
            of_sites[:, 4:7] = of_sites[:, :3]
            if len(self._shot.environment.glossy) and body.placed.mesh.glossy:
                camera = self._shot.view.position
                change = self._ground_change(k, self._down(sent))
                mirrored = reflected_among(body, view, camera, self._radiance[k], sent, change)
                of_sites[:, 4:7], of_sites[:, 8:11] = mirrored[:, :3], mirrored[:, 3:]
            values.append((body.transfer.lattice.from_sites @ of_sites).astype(np.float32))
        return tuple(values)

    def _sent_down(self, number: int, sent: Floats) -> Floats:
        """Return the mean radiance (NODES, NODES, 3) of what the nodes of a body see of it, spread to all of them."""
        view, layout = self._layout.views[number], self._layout
        if len(view.node) == 0:
            return np.zeros((NODES, NODES, 3))
        down = view.back @ sent[layout.first[number] : layout.first[number + 1]]
        seen = np.asarray(view.back.sum(axis=1)).reshape(NODES, NODES, 1)
        return spread_from(down.reshape(NODES, NODES, 3), seen)


def spread_from(total: Floats, weight: Floats) -> Floats:
    """Return means (n, n, c) of a grid of sums and weights; where there is no weight, those of coarser cells."""
    if len(total) == 1:
        return total / np.maximum(weight, 1e-12)
    rows = len(total) // 2
    coarse = spread_from(*(a.reshape(rows, 2, rows, 2, -1).sum(axis=(1, 3)) for a in (total, weight)))
    around = coarse.repeat(2, axis=0).repeat(2, axis=1)
    few = _FEW * np.pi
    return (total + few * around) / (weight + few)
