# SPDX-License-Identifier: Apache-2.0
"""Ambient light of a shot with its bodies, as the renderers ask for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mr360uw.cache import Cache, PartOf
from mr360uw.composite.ambient.bodies import Layout, make_layout
from mr360uw.composite.ambient.form_factors import make_exchange
from mr360uw.composite.ambient.quadtree import Quadtree, camera_place, make_quadtree
from mr360uw.composite.ambient.sample_points import UNTOUCHED, points_at, whole_values
from mr360uw.composite.ambient.solver import AmbientLight, Solver, interpolated
from mr360uw.composite.raycast import Hits
from mr360uw.composite.receiver.shape import ReceiverShape, kept_shape
from mr360uw.composite.shot import BetweenSamples, LightSample, PlacedObject, Shot
from mr360uw.rays import RayScene, barycentric
from mr360uw.types import Floats

_PLACES_AT_ONCE, _KEPT_PLACES = 1 << 13, 8
"""Places of the ground that are looked at together, 3 kB each, and how many such sets are kept."""
_KEPT_SAMPLES = 3
"""Instants of which it is kept how bodies lie and what their light is: two samples in time, and one between them."""
_MOST_MOVED, _MOST_TURNED = 0.125, 0.125
"""Most that a body may move, over its radius, and turn [rad] between two samples in time for its light to be
interpolated. Of bodies that pass through each other so fast, four of a million values of 8 bits are then off by more
than one code, by 3 at most; twice as fast a hundred of them, by 15 at most."""

_PART_OF_HEIGHT = 0.25
"""Most that a body may move to the first one between two samples in time, over its height above level ground, for what
it blocks there to be interpolated."""


def ambient_layout(shot: Shot, cache: Cache) -> Layout:
    """Return where the bodies of a shot are over its ground."""
    on_ground, objects = _on_ground(shot), _bodies(shot)
    heights = _ground_heights(shot, objects, cache)
    return cache.of(make_layout, objects, heights, on_ground, cache, keep=_KEPT_SAMPLES)


def _on_ground(shot: Shot) -> bool:
    return shot.receiver is not None and shot.receiver.occlusion


def _bodies(shot: Shot) -> tuple[PlacedObject, ...]:
    """Return the objects that have a part in ambient light: all, or those alone that shade the ground."""
    return shot.objects if shot.draw.ambient_occlusion else tuple(o for o in shot.casters if _on_ground(shot))


def _ground_heights(shot: Shot, objects: Sequence[PlacedObject], cache: Cache) -> list[float | None]:
    """Return the height [m] of the ground below each object in the world, None where there is none.

    Of a mesh straight below the body's middle; of a distance map where the camera sees the middle of its underside.
    """
    receiver = shot.receiver
    if receiver is None or not receiver.occlusion:
        return [None] * len(objects)
    if receiver.plane_y is not None:
        return [receiver.plane_y] * len(objects)
    mesh = receiver.mesh
    if mesh is not None:
        scene = cache.of(RayScene, mesh)
        return [_below(scene, placed) for placed in objects]
    shape = kept_shape(receiver, shot.view.position, cache)
    return [_seen(shot, shape, placed) for placed in objects]


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
    distance, _ = shape.meet(shot, x, y)
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
    return len(before) == len(after) and all(
        a.mesh.still is b.mesh.still and a.visible == b.visible and a.casts_shadow == b.casts_shadow and _near(a, b)
        for a, b in zip(before, after, strict=True)
    )


def _near(one: PlacedObject, other: PlacedObject) -> bool:
    """Return whether two places of a body are near each other."""
    middle, scale = one.mesh.still.center_m, one.scale
    moved = np.linalg.norm(other.to_world(middle) - one.to_world(middle)) / (one.mesh.still.radius_m * scale)
    turned = np.linalg.norm(other.world_from_object[:3, :3] - one.world_from_object[:3, :3], 2) / scale
    return bool(moved <= _MOST_MOVED and turned <= _MOST_TURNED)


def _at_sample(shot: Shot, sample: LightSample, cache: Cache) -> AmbientLight | None:
    """Return the light of a shot's bodies as it is at a sample in time; kept in `cache`."""
    view = replace(shot.view, position=sample.position, eye_m=0.0)
    then = replace(
        shot, view=view, objects=sample.objects, environment=sample.environment, lights=sample.lights,
        medium=sample.medium, between=None,
    )  # fmt: skip
    of_light = PartOf(then, sample, shot.receiver, shot.draw.ambient_occlusion, view.surface_y_m)
    return cache.of(_solved, of_light, cache, keep=_KEPT_SAMPLES)


def _solved(shot: PartOf[Shot], cache: Cache) -> AmbientLight | None:
    """Return the light of a shot, solved for it alone; None where nothing is in the way of any."""
    exchange = cache.of(make_exchange, ambient_layout(shot.whole, cache), cache, keep=_KEPT_SAMPLES)
    return None if exchange.nothing else Solver(shot.whole, exchange, cache).solve()


def free_of_bodies(shot: Shot, light: AmbientLight | None, point: Floats, normal: Floats, cache: Cache) -> Floats:
    """Return the fraction (..., 3) of the ambient light that bodies leave at places (..., 3) of the receiver, from the
    camera, with what they send there. cache: keeps what they block of the last few sets of places.
    """
    free = np.ones((point.size // 3, 3))
    if light is None or shot.receiver is None or not shot.receiver.occlusion:
        return free.reshape(point.shape)
    places, normals = point.reshape(-1, 3) + shot.view.position, normal.reshape(-1, 3)
    for start in range(0, len(places), _PLACES_AT_ONCE):
        part = slice(start, start + _PLACES_AT_ONCE)
        blocked = cache.of(light.layout.occluders.blocked, places[part], normals[part], keep=_KEPT_PLACES)
        free[part] = light.free(blocked, places[part])
    return free.reshape(point.shape)


@dataclass(frozen=True, slots=True, eq=False)
class GroundField:
    """Ambient light that the bodies of a shot leave on its receiver.

    origin: (3,) in the world of level ground below the first body. patches: quadtrees of that ground, from there, each
    with the values of its samples and its weight; none where the receiver is not level or bodies block nothing, where
    light is that of each place. gap_m: height above it of the lowest body: light hardly changes over a part of that.
    cache: keeps what bodies block there.
    """

    shot: Shot
    light: AmbientLight | None
    cache: Cache
    origin: Floats
    patches: tuple[tuple[Quadtree, Floats, float], ...]
    gap_m: float

    def at(self, point: Floats, normal: Floats) -> Floats:
        """Return what `free_of_bodies` does; of patches within `quadtree.TOLERANCE`.

        Where the light jumps between samples, at the outline of a body that stands on the ground, it is that of each
        place.
        """
        if not self.patches:
            return free_of_bodies(self.shot, self.light, point, normal, self.cache)
        place = point.reshape(-1, 3)
        free, jump = np.zeros(place.shape), np.zeros(len(place), np.bool_)
        for tree, values, share in self.patches:
            found, jumps = tree.between(values, place + (self.shot.view.position - self.origin), 1.0)
            free, jump = free + share * found, jump | jumps
        if np.any(jump):
            each = place[jump], normal.reshape(-1, 3)[jump]
            free[jump] = free_of_bodies(self.shot, self.light, *each, self.cache)
        return np.asarray(np.maximum(free, 0.0)).reshape(point.shape)  # parabolas between steep samples dip below

    def jumps(self) -> Floats:
        """Return places (n, 3) of level ground, from the camera, a few pixels apart at most, all along the lines at
        which the light jumps.
        """
        places = [tree.jumps() for tree, _, _ in self.patches]
        return np.concatenate([np.zeros((0, 3)), *places]) + (self.origin - self.shot.view.position)


def ground_field(shot: Shot, light: AmbientLight | None, cache: Cache) -> GroundField:
    """Return the ambient light on a shot's receiver. cache: keeps quadtrees while bodies stand still to each other."""
    receiver = shot.receiver
    if light is None or receiver is None or receiver.plane_y is None or not light.layout.ground_bodies:
        return GroundField(shot, light, cache, np.zeros(3), (), 0.0)
    origin, patches = light.layout.below(receiver.plane_y), []
    camera, pixel_rad, gap_m = camera_place(shot.view.position - origin), 2.0 * np.pi / shot.view.width, np.inf
    for solved, share in _samples(light, receiver.plane_y):
        below = solved.layout.below(receiver.plane_y)
        occluders = solved.layout.occluders_from(below)
        tree = cache.of(make_quadtree, occluders, camera, pixel_rad, receiver.extent_m, keep=2)
        gap_m = min(gap_m, *(_height(solved, k, receiver.plane_y) for k in solved.layout.ground_bodies))
        patches.append((tree, cache.of(_at_samples, solved, tree, below, keep=2), share))
    return GroundField(shot, light, cache, origin, tuple(patches), gap_m)


def _samples(light: AmbientLight, ground_y: float) -> list[tuple[AmbientLight, float]]:
    """Return the solutions between which light on level ground is interpolated, as seen from below the first body, with
    their weights: the light itself where it is solved, or bodies move by much of their height above the ground.

    What bodies block varies along the ground as slowly as they are high above it. A straight line between two places a
    quarter of that apart then misses 1/8 (1/4)^2 of it, less than a hundredth.
    """
    if not light.samples:
        return [(light, 1.0)]
    (before, _), (after, _) = light.samples
    first, last = before.layout.below(ground_y), after.layout.below(ground_y)
    for k in before.layout.ground_bodies:
        a, b = before.layout.bodies[k], after.layout.bodies[k]
        turned_m = a.radius * np.linalg.norm(b.rotation - a.rotation, 2)
        moved_m = np.linalg.norm((b.origin - last) - (a.origin - first)) + turned_m
        if moved_m > _PART_OF_HEIGHT * _height(before, k, ground_y):
            return [(light, 1.0)]
    return [(solved, share) for solved, share in light.samples if share > 0.0]


def _height(light: AmbientLight, number: int, ground_y: float) -> float:
    """Return the height [m] of the lower end of a body above level ground, 0 at least."""
    body = light.layout.bodies[number]
    return max(float(body.field.heights[0] + body.origin[1]) - ground_y, 0.0)


def _at_samples(light: AmbientLight, tree: Quadtree, origin: Floats) -> Floats:
    """Return the light at the samples of a quadtree whose origin (3,) is given."""
    return tree.joined(light.free(tree.blocked, tree.place + origin))


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
        values[of] = np.einsum("nk,nkc->nc", shares, whole_values(known)[points].astype(np.float64))
    return values
