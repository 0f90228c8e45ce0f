# SPDX-License-Identifier: Apache-2.0
"""Ambient light of a shot with everything that bodies keep off and send back, solved on their samples for every frame.

    E_i = sum_k c_ik V_ik A_k + sum_j c_ij B_j + sum_g c_ig G_g        B_j = rho_j (E_j + S_j)/pi + e_j

with i, j samples, c the solid angle times cosine of a direction, V its visibility, A the environment as the body sees
it: the ground is at a distance and so not where the camera sees it. g are the nodes of the ground nearby, G what they
send, rho the reflectance, S the sun's irradiance and e the emission. Jacobi steps from E as if each sample lay in a
hollow of uniform light: that of a furnace stays what it is in every step, also in a closed white box.

All light is over the ambient light's fall with depth. The light of the ground changes at the nodes below bodies by

    r - 1 = -(F L + S v)/(E + S)

with L the ambient light that bodies block at coarse nodes less what they send there, F the interpolation from these, E
the ambient irradiance, S the sun's and v the fraction of it that bodies block. A node sends r G, and G is as bright
from all sides:

    G = w P + (1 - w) L        w = T^20

with P what the camera sees in its place, T the transmittance of the water before it, and L the environment in the
direction of who looks at it. Under water the camera sees more haze than ground there: no water is the limit of thin
water, and half of G is P at a loss of 3.5 %.

Glossy reflection loses what other bodies and shaded ground fill of the lobe of a sample towards the camera:

    kept = 1 - sum_m p w_k L_k/sum_k w_k L_k        instead = sum_m p w_k B_m/sum_k w_k
    w    = D(n.h) V(n.v, n.l) n.l

with k the directions (mesh_transfer.py), m those that meet a coarse sample, a node of the ground or ground farther
off, p the part of the direction that they fill, L the environment at the camera, B the radiance that coarse samples and
ground send, D and V those of `shading.py`. The prefiltered environment times kept plus instead is the reflected light:
white bodies in white light stay white, and nothing changes where nothing is met.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.cache import Cache, PartOf, Same
from mr360uw.base.rays import RayScene, barycentric
from mr360uw.composite.ambient.blocked_light import Occlusion, fraction_left, sky_table
from mr360uw.composite.ambient.form_factors import (
    COARSE_NODES,
    Body,
    Exchange,
    FormFactors,
    Layout,
    Met,
    from_coarse,
    make_exchange,
    make_layout,
)
from mr360uw.composite.ambient.mesh_transfer import (
    CHANNELS,
    FEW_CHANNELS,
    UNTOUCHED,
    Transfer,
    blurred,
    directions,
    points_at,
    seen_by_camera,
)
from mr360uw.composite.light_sources import sun_of, sun_up
from mr360uw.composite.raycast import Hits
from mr360uw.composite.receiver.shape import ReceiverShape
from mr360uw.composite.shot import BetweenSamples, PlacedObject, Shot
from mr360uw.ibl.lookup import environment_lookup
from mr360uw.jit import fast, fast_making
from mr360uw.medium.lookup import ambient_ratio, beam_ratio, transmittance_lookup
from mr360uw.types import Floats

BOUNCES = 8
"""Steps of the solution at most: what the first guess is off by shrinks by the reflectance times what is hidden in each
step, to less than half a percent inside a crate of reflectance .8."""
_SETTLED = 5e-4
"""A step that changes the light by less than this part of its largest value is the last: a tenth of a code value."""
_ROWS_AT_ONCE = 256
"""Rows of a product of matrices that is too small for BLAS to wake other threads, which cost more than they save."""
_BRIGHTEST = 16.0
"""Most that neighbours multiply the ambient light of a place by."""
_NO_TABLE = np.zeros((0, 3, 3))
"""Table of the environment of shots without a receiver, which is what it is for."""
_UP = np.array([[0.0, 1.0, 0.0]])
_THIN_POWER = 20.0
_STEPS = 64.0
"""The sun's direction in shadow rays of this module is rounded to such parts of one: kept while its track trembles."""
_KEPT = 4
"""Directions of the sun for which shadows are kept while bodies stand still."""
LEAST_ALPHA = 0.1
"""Least width of a lobe. Its core is then as wide as the directions lie apart, 9 degrees: reflections of bodies in
smoother surfaces are blurred as much. Twice as wide, a ball of roughness .35 on the ground is off by a third more.
"""
_LEAST_COSINE = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class AmbientLight:
    """Solved ambient light of a shot.

    values: for each object those of its points (mesh_transfer.py), float32, or None where nothing is in its way.
    table: of the environment (`sky_table`), empty without a receiver. sent: for each body that the ground sees the
    mean radiance (NODES, NODES, 3) of what it hides, at the nodes below it. ambient: (H, W, 3). samples: the solutions
    that it is interpolated between, with their weights; none where it is solved itself.
    """

    layout: Layout
    values: tuple[NDArray[np.float32] | None, ...]
    table: Floats
    sent: tuple[Floats, ...]
    ambient: Floats
    samples: tuple[tuple[AmbientLight, float], ...] = ()

    def free(self, blocked: Occlusion, points: Floats) -> Floats:
        """Return the fraction (n, 3) of the ambient light that is left on the ground at places (n, 3) of the world,
        with what bodies send there.
        """
        lost = blocked.irradiance(self.table) - self.layout.bounced(blocked, points, self.sent)
        return fraction_left(blocked.share.sum(axis=0), lost, environment_lookup(self.ambient, blocked.normal))


def interpolated(layout: Layout, before: AmbientLight, after: AmbientLight, share: float) -> AmbientLight:
    """Return the light of a layout between two solutions for the same bodies, interpolated linearly.

    share: 0 at `before`, 1 at `after`. What bodies that stand still send to the ground is linear in the environment and
    in the sun, so that this is exact; the ratios of their own points are, to the second order of what changes between
    both, which are also the turns and the ways of bodies that move.
    """

    # At one of the times nothing may be in a body's way: its light is untouched then
    values: list[NDArray[np.float32] | None] = []
    for a, b in zip(before.values, after.values, strict=True):
        known = a if b is None else b
        if known is not None:
            untouched = np.array(UNTOUCHED[: known.shape[1]], np.float32)
            known = _mixed(untouched if a is None else a, untouched if b is None else b, share)
        values.append(known)
    sent = tuple(map(_mixed, before.sent, after.sent, itertools.repeat(share)))
    table, ambient = _mixed(before.table, after.table, share), _mixed(before.ambient, after.ambient, share)
    return AmbientLight(layout, tuple(values), table, sent, ambient, ((before, 1.0 - share), (after, share)))


def _mixed(a: Any, b: Any, share: float) -> Any:
    return a + np.asarray(share, a.dtype) * (b - a)


class Solver:
    """Solves the ambient light of one shot; shadow rays and materials are kept in `cache`."""

    def __init__(self, shot: Shot, exchange: Exchange, cache: Cache) -> None:
        self._shot, self._exchange = shot, exchange
        self._bodies = bodies = exchange.layout.bodies
        self._sunlight = Sunlight(shot, exchange.layout, cache)
        map_ = blurred(shot.environment)
        towards = np.array([directions() @ body.rotation.T for body in bodies])
        self._radiance = np.asarray(environment_lookup(map_, towards), np.float32)
        around = [self._at_body(*of) for of in zip(bodies, towards, self._radiance, strict=True)]
        self._open = self._around = np.array(around, np.float32)
        # What the coarse samples send: a fraction of their light, and emission over the ambient light's fall with depth
        keep = max(64, 2 * len(bodies))
        sent = [cache.of(_at_coarse, body.transfer, shot.refractive_index, keep=keep) for body in bodies]
        falls = [self._sunlight.ambient(body.center[None]) for body in bodies]
        self._reflected: Floats = np.concatenate([reflected for reflected, _ in sent])
        self._emitted = np.concatenate([emitted / fall for (_, emitted), fall in zip(sent, falls, strict=True)])
        self._sun = self._sunlight.at_coarse()
        self._table = _NO_TABLE if shot.receiver is None else sky_table(shot.environment)

    def _at_body(self, body: Body, direction: Floats, radiance: Floats) -> Floats:
        """Return the radiance (COUNT, 3) of the environment as a body sees it, from its middle: where it looks at level
        ground, that of the place. Without ground that of the camera, `radiance`. direction: (COUNT, 3).
        """
        if body.height_m is None or not body.on_ground:
            return radiance
        above_m = body.height_m * body.placed.scale
        if above_m <= 0.0 or self._shot.view.position[1] <= body.center[1] - above_m:
            return radiance
        down = np.flatnonzero(direction[:, 1] < 0.0)
        place = body.center - above_m * direction[down] / direction[down, 1:2]
        around = radiance.copy()
        around[down] = ground_radiance(self._shot, self._shot.environment.residual, place, direction[down])
        return around

    def solve(self) -> AmbientLight:
        """Return the light after the last step; what the ground and far bodies send is found from the first two."""
        # Guess what the bodies send, of the sky and the sun alone, as if every sample lay in a hollow of its own
        # openness v and reflectance rho: v/(1 - rho (1 - v)) of the open irradiance, 1 in a white or an open one
        exchange, open_ = self._exchange, self._open
        bodies, views = self._bodies, exchange.views
        seen = np.concatenate([view.openness for view in views])
        hollow = (seen + 1e-6) / (1.0 - self._reflected * (1.0 - seen) + 1e-6)
        irradiance = np.concatenate(_products([body.plain for body in bodies], open_)) * hollow
        sent = self._sent(irradiance)
        ground = NodeRadiance(self._shot, exchange, self._table, self._sunlight)
        # Let light go back and forth between bodies and ground until it settles
        steps = BOUNCES if exchange.samples.nnz or any(b.on_ground for b in bodies) or len(exchange.far.lit) else 0
        for step in range(steps):
            if step < 2:
                self._around = exchange.with_far(open_, sent)
                nodes = ground.radiance(sent if step else None)
                direct = np.concatenate(_products([body.direct for body in bodies], self._around))
                for view, around, of, k in zip(views, self._around, nodes, exchange.first.tolist(), strict=False):
                    if not view.coarse.nothing:
                        direct[k : k + len(view.coarse.lost)] += view.coarse.ground @ of - view.coarse.lost @ around
            before, irradiance = irradiance, direct + exchange.samples @ sent
            sent = self._sent(irradiance)
            if step > 1 and np.max(np.abs(irradiance - before)) <= _SETTLED * np.max(irradiance):
                break
        # Find the light of the bodies' own points, and what they send to the ground
        values: tuple[NDArray[np.float32] | None, ...] = (None,) * len(self._shot.objects)
        if self._shot.draw.ambient_occlusion:
            self._around = exchange.with_far(open_, sent)
            nodes = ground.radiance(sent)
            everywhere = self._everywhere()
            values = tuple(self._values(k, everywhere[k], sent, nodes[k]) for k in range(len(bodies)))
        sent_down, ambient = exchange.sent_down(sent), self._shot.environment.ambient
        return AmbientLight(exchange.layout, values, self._table, sent_down, ambient)

    def _sent(self, irradiance: Floats) -> Floats:
        """Return the radiance (all, 3) that coarse samples send to all sides, over the ambient light's fall with
        depth."""
        return (self._reflected * (irradiance + self._sun) / np.pi + self._emitted).astype(np.float32)

    def _everywhere(self) -> list[tuple[Floats, ...]]:
        """Return for each body whose light is changed the irradiance (n, 3) were nothing of others in the way, by the
        environment at the camera and at the body, and what the body itself keeps off: at all samples of those that
        take light of their own, at the coarse samples of others, which keep off nothing.
        """
        needs = []
        for k, body in enumerate(self._bodies):
            if self._exchange.untouched(k):
                continue
            plain = body.plain if body.lost is None else body.transfer.cosine
            needs += [(k, plain, self._radiance), (k, plain, self._around)]
            needs += [(k, body.lost, self._around)] if body.lost is not None else []
        products = _products([matrix for _, matrix, _ in needs], [light[k] for k, _, light in needs])
        found: list[tuple[Floats, ...]] = [()] * len(self._bodies)
        for (k, _, _), of_matrix in zip(needs, products, strict=True):
            found[k] = (*found[k], of_matrix)
        return found

    def _values(
        self, number: int, own_light: tuple[Floats, ...], sent: Floats, nodes: Floats
    ) -> NDArray[np.float32] | None:
        """Return the values of a body's points (mesh_transfer.py), None where nothing is in its way. own_light: of
        `_everywhere`. sent, nodes: radiance of all coarse samples, and of the nodes.
        """
        # Add up what other bodies and the ground change, at coarse samples and where they are near
        body, view = self._bodies[number], self._exchange.views[number]
        light, around = self._radiance[number], self._around[number]
        if self._exchange.untouched(number):
            return None
        transfer = body.transfer
        others = [self._from_others(factors, around, sent, nodes) for factors in (view.coarse, view.near)]
        # Add what the body does to itself: a hull in the sky's place, or its own form factors
        if body.lost is None:
            both = np.append(light, around, axis=1)
            at_coarse = np.concatenate([*own_light, others[0]], axis=1)
            near = np.append(transfer.cosine[view.near_sample] @ both, others[1], axis=1)
            plain, at_body, of_others = np.split(view.spread(body, at_coarse, near), 3, axis=1)
            irradiance = at_body + of_others
        else:
            (plain, at_body, lost), first = own_light, self._exchange.first
            inside = body.inside @ sent[first[number] : first[number + 1]]
            irradiance = at_body - lost + inside + view.spread(body, *others)
        # Say both as a ratio to the light of a lone, convex body; mirrors have one of their own
        least = 1e-3 * plain.max() + 1e-9
        ratio = np.clip((irradiance + least) / (plain + least), 0.0, _BRIGHTEST)
        from_samples = transfer.lattice.from_samples
        met = view.met if len(self._shot.environment.glossy) else None
        values = np.zeros((from_samples.shape[0], FEW_CHANNELS if met is None else CHANNELS), np.float32)
        values[:, :3] = from_samples @ ratio
        if met is not None:
            camera = self._shot.view.position
            mirrored = from_samples @ reflected_among(body, met, camera, light, around, sent, nodes)
            values[:, 4:7], values[:, 8:11] = mirrored[:, :3], mirrored[:, 3:]
        return values

    @staticmethod
    def _from_others(factors: FormFactors, around: Floats, sent: Floats, nodes: Floats) -> Floats:
        """Return at r samples (r, 3) how other bodies and the ground change the irradiance. around: (COUNT, 3)
        radiance; the others are those of `_values`.
        """
        if factors.nothing:
            return np.zeros((len(factors.lost), 3), np.float32)
        return np.asarray(factors.samples @ sent + factors.ground @ nodes - factors.lost @ around)


def _products(
    matrices: Sequence[NDArray[np.float32]], light: Sequence[Floats] | NDArray[np.float32]
) -> list[NDArray[np.float32]]:
    """Return the products (n, 3) of matrices (n, k) and light (k, 3); a matrix that several share is read once."""
    sharing: dict[int, list[int]] = {}
    for number, matrix in enumerate(matrices):
        sharing.setdefault(id(matrix), []).append(number)
    found = [np.zeros((0, 3), np.float32)] * len(matrices)
    for numbers in sharing.values():
        columns, matrix = np.concatenate([light[k] for k in numbers], axis=1), matrices[numbers[0]]
        rows = [matrix[k : k + _ROWS_AT_ONCE] @ columns for k in range(0, len(matrix), _ROWS_AT_ONCE)]
        for number, part in zip(numbers, np.split(np.concatenate(rows), len(numbers), axis=1), strict=True):
            found[number] = part
    return found


def _at_coarse(transfer: Transfer, refractive_index: float) -> tuple[Floats, Floats]:
    """Return the reflectance (C, 3) and the emission (C, 3) of a mesh at its coarse samples."""
    of_samples = transfer.reflected(refractive_index), transfer.material.emission
    return transfer.coarse_means(of_samples[0]), transfer.coarse_means(of_samples[1])


class Sunlight:
    """Irradiance of one shot's sun; its shadow rays are kept in `cache`."""

    def __init__(self, shot: Shot, layout: Layout, cache: Cache) -> None:
        self._shot, self._layout, self._sun = shot, layout, sun_of(shot)
        self._lit: list[Floats] = []
        if self._sun is not None:
            towards = np.round(_STEPS * np.asarray(self._sun.direction))
            self._lit = cache.of(_lit, layout, towards / np.linalg.norm(towards), keep=_KEPT)

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
        cosine = [b.transfer.lattice.normal[b.transfer.coarse] @ (towards @ b.rotation) for b in bodies]
        lit = np.concatenate(self._lit[: len(bodies)])
        return self._beam(np.concatenate(place)) * (np.maximum(np.concatenate(cosine), 0.0) * lit)[:, None]

    def at_nodes(self) -> tuple[Floats, Floats]:
        """Return the irradiance on the nodes of all bodies without bodies (n, 3), and what part (n,) of it bodies
        block.
        """
        node = np.concatenate(self._layout.nodes)
        if self._sun is None:
            return np.zeros((len(node), 3)), np.zeros(len(node))
        beam = self._beam(node) * max(float(self._sun.direction[1]), 0.0)
        return beam, 1.0 - np.concatenate(self._lit[len(self._layout.bodies) :])

    def _beam(self, points: Floats) -> Floats:
        """Return the sun's irradiance (n, 3) across its beam."""
        shot, sun = self._shot, self._sun
        assert sun is not None
        beam = np.broadcast_to(sun.irradiance, (len(points), 3))
        if shot.medium is not None:
            beam = beam * beam_ratio(shot.medium, shot.view.surface_y_m - points[:, 1], sun_up(sun))
        return np.asarray(beam / np.maximum(self.ambient(points), 1e-9))


def _coarse(layout: Layout) -> list[Floats]:
    """Return the places (C, 3) of the coarse samples of each body in the world."""
    parts = [(body.placed, body.transfer.lattice.position[body.transfer.coarse]) for body in layout.bodies]
    return [placed.to_world(position) for placed, position in parts]


def _lit(layout: Layout, towards: Floats) -> list[Floats]:
    """Return what is left of the sun at the coarse samples of each body, then at the nodes of each."""
    return layout.lit([*_coarse(layout), *layout.nodes], towards)


class NodeRadiance:
    """Light of one shot at the nodes of bodies; what does not depend on what bodies send is found once.

    table: of the shot's environment (`sky_table`).
    """

    def __init__(self, shot: Shot, exchange: Exchange, table: Floats, sunlight: Sunlight) -> None:
        self._exchange, layout = exchange, exchange.layout
        self._numbers = [k for k, node in enumerate(layout.nodes) if len(node)]
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

    def radiance(self, sent: NDArray[np.float32] | None) -> list[NDArray[np.float32]]:
        """Return the radiance (NODES^2, 3) that the nodes of each body send, none of bodies that do not see the ground.

        sent: (all coarse samples, 3) radiance that they send; None: as the ground is without bodies.
        """
        exchange, left = self._exchange, np.ones(1)
        found = [np.zeros((0, 3), np.float32)] * len(exchange.layout.bodies)
        if not self._numbers:
            return found
        if sent is not None:
            # r: less of the ambient light at coarse nodes, and of the sun at all
            bounced = exchange.layout.bounced(exchange.blocked, exchange.coarse, exchange.sent_down(sent))
            lost = (self._lost - bounced).reshape(-1, COARSE_NODES**2, 3)
            at_nodes = (from_coarse() @ lost).reshape(-1, 3)
            left = 1.0 - np.minimum((at_nodes + self._shade) / self._whole, 1.0)
        of_nodes = np.split((self._plain * left).astype(np.float32), len(self._numbers))
        for k, values in zip(self._numbers, of_nodes, strict=True):
            found[k] = values
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


def reflected_among(
    body: Body, met: Met, camera: Floats, radiance: Floats, around: Floats, sent: Floats, ground: Floats
) -> Floats:
    """Return (S, 6) for the samples of a body: the ratio of the environment's glossy light that is kept, and the
    radiance that is seen instead.

    camera: (3,) place in the world. radiance, around: (COUNT, 3) of the environment in the body's directions, as the
    camera and as the body sees it. sent: (all coarse samples, 3) radiance of what is met; ground: (NODES^2, 3) of the
    nodes.
    """
    lattice = body.transfer.lattice
    towards = (camera - body.placed.to_world(lattice.position)) @ body.rotation
    towards /= np.maximum(np.linalg.norm(towards, axis=-1, keepdims=True), 1e-9)
    alpha = np.maximum(body.transfer.material.roughness**2, LEAST_ALPHA)
    out = np.zeros((len(towards), 6))
    out[:, :3] = 1.0
    normal, ways = np.ascontiguousarray(lattice.normal, np.float32), np.ascontiguousarray(directions().T, np.float32)
    towards, alpha = towards.astype(np.float32), alpha.astype(np.float32)
    light, at_body = (np.ascontiguousarray(a.T, np.float32) for a in (radiance, around))
    moved = np.flatnonzero(np.any(light != at_body, axis=0))
    _reflect((normal, towards, alpha), ways, (light, at_body, moved), met, sent, ground, out)
    return out


@fast
def _weigh(normal: Any, towards: Any, alpha: Any, d: Any, weight: Any) -> None:
    """Set the weights (COUNT,) of directions (3, COUNT) in a lobe."""
    nx, ny, nz = normal[0], normal[1], normal[2]
    vx, vy, vz = towards[0], towards[1], towards[2]
    cosine = nx * vx + ny * vy + nz * vz
    if cosine < np.float32(_LEAST_COSINE):  # behind its own horizon: as seen along the surface
        lift = np.float32(_LEAST_COSINE) - cosine
        vx, vy, vz = vx + lift * nx, vy + lift * ny, vz + lift * nz
        scale = np.float32(1.0) / max(np.sqrt(vx * vx + vy * vy + vz * vz), np.float32(1e-6))
        vx, vy, vz = vx * scale, vy * scale, vz * scale
        cosine = np.float32(_LEAST_COSINE)
    one, squared = np.float32(1.0), alpha * alpha
    masked = np.sqrt(cosine * cosine * (one - squared) + squared)
    for k in range(len(weight)):
        light = max(nx * d[0, k] + ny * d[1, k] + nz * d[2, k], np.float32(0.0))
        twice = max(np.float32(2.0) + np.float32(2.0) * (vx * d[0, k] + vy * d[1, k] + vz * d[2, k]), np.float32(1e-6))
        facets = (cosine + light) * (cosine + light) / twice * (squared - one) + one
        facets = max(facets, np.float32(0.5) * squared)  # below the horizon it may be 0, as the light
        smith = light * masked + cosine * np.sqrt(light * light * (one - squared) + squared)
        weight[k] = light / (facets * facets * smith)


@fast_making
def _reflect(samples: Any, d: Any, light: Any, met: Any, sent: Any, ground: Any, out: Any) -> None:
    """Set what `reflected_among` returns. samples: normals, directions to the camera, and widths of lobes. light: of
    the environment as the camera and as the body sees it, and the directions in which they differ.
    """
    (normal, towards, alpha), (radiance, around, moved) = samples, light
    first, direction, target, part = met
    # Mark the directions of far bodies, which fill them whole
    weight, far = np.empty(d.shape[1], np.float32), np.zeros(d.shape[1], np.bool_)
    far[moved] = True
    for s in range(len(normal)):
        if first[s] == first[s + 1] and len(moved) == 0:
            continue
        # Weigh the directions by the lobe of the sample
        _weigh(normal[s], towards[s], alpha[s], d, weight)
        whole = np.float32(1e-12)
        for k in range(len(weight)):
            whole += weight[k]
        # Sum what the lobe sees of the open sky, what it loses of it, and what is there instead
        for c in range(3):
            seen, lost, instead = np.float32(1e-12), np.float32(0.0), np.float32(0.0)
            for k in range(len(weight)):
                seen += weight[k] * radiance[c, k]
            for k in moved:
                lost += weight[k] * radiance[c, k]
                instead += weight[k] * around[c, k]
            for p in range(first[s], first[s + 1]):
                k, number = direction[p], target[p]
                filled = part[p] * weight[k]
                if far[k]:
                    instead -= filled * around[c, k]
                else:
                    lost += filled * radiance[c, k]
                instead += filled * (sent[number - 1, c] if number > 0 else ground[-number - 1, c])
            out[s, c] = max(np.float32(1.0) - lost / seen, np.float32(0.0))
            out[s, 3 + c] = max(instead, np.float32(0.0)) / whole


_PLACES_AT_ONCE, _KEPT_PLACES = 1 << 13, 8
"""Places of the ground that are looked at together, 3 kB each, and how many such sets are kept."""
_KEPT_SAMPLES = 3
"""Instants of which it is kept how bodies lie and what their light is: two samples in time, and one between them."""
_MOST_MOVED, _MOST_TURNED = 0.125, 0.125
"""Most that a body may move, over its radius, and turn [rad] between two samples in time for its light to be
interpolated. Of bodies that pass through each other so fast, four of a million values of 8 bits are then off by more
than one code, by 3 at most; twice as fast a hundred of them, by 15 at most."""


def ambient_layout(shot: Shot, cache: Cache) -> Layout:
    """Return where the bodies of a shot are over its ground: straight below their middles on a mesh, where the camera
    sees the middle of their undersides on a distance map.
    """
    objects, receiver = _bodies(shot), shot.receiver
    on_ground = receiver is not None and receiver.occlusion
    heights: list[float | None] = [None] * len(objects)
    if receiver is not None and on_ground:
        if receiver.plane_y is not None:
            heights = [receiver.plane_y] * len(objects)
        elif receiver.mesh is not None:
            scene = cache.of(RayScene, receiver.mesh)
            heights = [_below(scene, placed) for placed in objects]
        else:
            shape = cache.of(ReceiverShape, receiver, shot.view.position)
            heights = [_seen(shot, shape, placed) for placed in objects]
    return cache.of(make_layout, objects, heights, on_ground, cache, keep=_KEPT_SAMPLES)


def _bodies(shot: Shot) -> tuple[PlacedObject, ...]:
    """Return the objects that have a part in ambient light: all, or those alone that shade the ground."""
    if shot.draw.ambient_occlusion:
        return shot.objects
    return shot.casters if shot.receiver is not None and shot.receiver.occlusion else ()


def _below(scene: RayScene, placed: PlacedObject) -> float | None:
    start, down = placed.to_world(placed.mesh.center_m)[None], np.array([[0.0, -1.0, 0.0]])
    triangle = scene.first_hit(start, down)
    if triangle[0] < 0:
        return None
    _, distance = barycentric(scene.triangles[triangle] - start[:, None], down)
    return float(start[0, 1] - distance[0])


def _seen(shot: Shot, shape: ReceiverShape, placed: PlacedObject) -> float | None:
    points = placed.to_world(placed.mesh.hull.reshape(-1, 3))
    middle = placed.to_world(placed.mesh.center_m)
    middle[1] = points[:, 1].min()
    ray = middle - shot.view.position
    x, y = shot.view.places(ray[None])
    distance, _ = shape.meet(shot.view, x, y)
    if not np.isfinite(distance[0]):
        return None
    return float(shot.view.position[1] + shot.view.points(shot.view.directions(x, y), distance)[0, 1])


def ambient_light(shot: Shot, cache: Cache) -> AmbientLight | None:
    """Return the solved ambient light of a shot; None where bodies have no part in it."""
    if not _bodies(shot):
        return None
    between = shot.between
    if between is None or not _slow(between):
        return _solved(PartOf(shot), cache)
    before = _at_sample(shot, between.before, cache)
    after = before if between.share == 0.0 else _at_sample(shot, between.after, cache)
    if before is None or after is None:
        return _solved(PartOf(shot), cache)
    return interpolated(ambient_layout(shot, cache), before, after, between.share)


def _slow(between: BetweenSamples) -> bool:
    """Return whether bodies are the same at two samples in time, and each moves and turns little between them."""
    before, after = between.before.objects, between.after.objects
    if len(before) != len(after):
        return False
    for a, b in zip(before, after, strict=True):
        mesh, scale = a.mesh.still, a.scale
        if mesh is not b.mesh.still or a.visible != b.visible or a.casts_shadow != b.casts_shadow:
            return False
        moved = np.linalg.norm(b.to_world(mesh.center_m) - a.to_world(mesh.center_m)) / (mesh.radius_m * scale)
        turned = np.linalg.norm(b.world_from_object[:3, :3] - a.world_from_object[:3, :3], 2) / scale
        if not (moved <= _MOST_MOVED and turned <= _MOST_TURNED):
            return False
    return True


def _at_sample(shot: Shot, sample: Shot, cache: Cache) -> AmbientLight | None:
    """Return the light of a shot's bodies as it is at a sample in time; kept in `cache`."""
    view = replace(shot.view, position=sample.view.position, eye_m=0.0)
    then = replace(
        shot, view=view, objects=sample.objects, environment=sample.environment, lights=sample.lights,
        medium=sample.medium, between=None,
    )  # fmt: skip
    of_light = PartOf(then, Same(sample), shot.receiver, shot.draw.ambient_occlusion, view.surface_y_m)
    return cache.of(_solved, of_light, cache, keep=_KEPT_SAMPLES)


def _solved(shot: PartOf[Shot], cache: Cache) -> AmbientLight | None:
    """Return the light of a shot, solved for it alone; None where nothing is in the way of any."""
    exchange = cache.of(make_exchange, ambient_layout(shot.whole, cache), cache, keep=_KEPT_SAMPLES)
    return None if exchange.nothing else Solver(shot.whole, exchange, cache).solve()


def free_of_bodies(
    shot: Shot, light: AmbientLight | None, point: Floats, normal: Floats, cache: Cache | None = None
) -> Floats:
    """Return the fraction (..., 3) of the ambient light that bodies leave at places (..., 3) of the receiver, from the
    camera, with what they send there. cache: keeps what they block of the last few sets of places; nothing without.
    """
    free = np.ones((point.size // 3, 3))
    if light is None or shot.receiver is None or not shot.receiver.occlusion:
        return free.reshape(point.shape)
    places, normals = point.reshape(-1, 3) + shot.view.position, normal.reshape(-1, 3)
    for start in range(0, len(places), _PLACES_AT_ONCE):
        part, blocked_at = slice(start, start + _PLACES_AT_ONCE), light.layout.occluders.blocked
        some = places[part], normals[part]
        blocked = blocked_at(*some) if cache is None else cache.of(blocked_at, *some, keep=_KEPT_PLACES)
        free[part] = light.free(blocked, places[part])
    return free.reshape(point.shape)


def ambient_at(shot: Shot, light: AmbientLight | None, hits: Hits) -> Floats:
    """Return the values (n, CHANNELS) of ambient light at hits, whose objects are numbered among the visible ones."""
    values = np.tile(UNTOUCHED, (len(hits.triangle), 1))
    if light is None:
        return values
    visible = [k for k, placed in enumerate(shot.objects) if placed.visible]
    first = np.cumsum([0, *(len(shot.objects[k].mesh.positions) for k in visible)])
    for number, k in enumerate(visible):
        known, of = light.values[k], np.flatnonzero(hits.object == number)
        if known is None or len(of) == 0:
            continue
        lattice = light.layout.bodies[k].transfer.lattice
        points, shares = points_at(lattice.places[hits.triangle[of] - first[number]], hits.weights[of])
        if lattice.two_sided:
            points = points + lattice.points * hits.behind[of, None]
        whole = known if known.shape[1] == CHANNELS else np.concatenate([known, known, np.zeros_like(known)], axis=1)
        values[of] = np.einsum("nk,nkc->nc", shares, whole[points].astype(np.float64))
    return values
