# SPDX-License-Identifier: Apache-2.0
"""Ambient light of a shot with its bodies, as the renderers ask for it."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np

from mr360uw.cache import Cache
from mr360uw.composite.ambient.body_layout import Layout, make_layout
from mr360uw.composite.ambient.on_ground.ground_height import ground_heights
from mr360uw.composite.ambient.on_ground.ground_kernel import fraction_left
from mr360uw.composite.ambient.on_ground.light_table import level_table
from mr360uw.composite.ambient.on_ground.patches import Patches, camera_place, make_patches
from mr360uw.composite.ambient.solved_light import AmbientLight, interpolated
from mr360uw.composite.ambient.solver import Solver
from mr360uw.composite.shot import KnotLight, PlacedObject, Shot
from mr360uw.ibl.lookup import environment_lookup
from mr360uw.types import Floats

_PLACES_AT_ONCE = 1 << 14
_KEPT_KNOTS = 2
_KEPT_PLACES, _KEPT_SWEEPS = 1 << 17, 8
"""Sets of places, 650 bytes a place and body, whose sweeps are kept."""


def ambient_layout(shot: Shot, cache: Cache) -> Layout:
    """Return how the bodies and the ground of a shot see each other."""
    on_ground, objects = _on_ground(shot), _bodies(shot)
    heights = ground_heights(shot, objects, cache)
    key = (tuple((o.key, o.casts_shadow) for o in objects), tuple(heights), on_ground)
    return cache.get("ambient layout", key, lambda: make_layout(objects, heights, on_ground, cache))


def _on_ground(shot: Shot) -> bool:
    return shot.receiver is not None and shot.receiver.occlusion


def _bodies(shot: Shot) -> tuple[PlacedObject, ...]:
    """Return the objects that have a part in ambient light: all, or those alone that shade the ground."""
    return shot.objects if shot.draw.ambient_occlusion else tuple(o for o in shot.casters if _on_ground(shot))


def ambient_light(shot: Shot, cache: Cache) -> AmbientLight | None:
    """Return the solved ambient light of a shot; None where bodies have no part in it."""
    if not _bodies(shot):
        return None
    layout = ambient_layout(shot, cache)
    if (
        all(view.nothing(body) for body, view in zip(layout.bodies, layout.views, strict=True))
        and not layout.ground_bodies
    ):
        return None
    knots = shot.knots
    if knots is None:
        return Solver(shot, layout, cache).solve()
    before, after = (_at_knot(shot, layout, knot, cache) for knot in (knots.before, knots.after))
    return interpolated(before, after, knots.share) if knots.share > 0.0 else before


def _at_knot(shot: Shot, layout: Layout, knot: KnotLight, cache: Cache) -> AmbientLight:
    """Return the light of a shot's bodies, which stand still, as it is in a knot of time; kept in `cache`."""
    view = replace(shot.view, position=knot.position)
    then = replace(shot, view=view, environment=knot.environment, lights=knot.lights, medium=knot.medium, knots=None)
    key = knot, layout, shot.draw.ambient_occlusion, view.surface_y_m
    return cache.get("ambient at knot", key, lambda: Solver(then, layout, cache).solve(), _KEPT_KNOTS)


def free_of_bodies(shot: Shot, light: AmbientLight | None, point: Floats, normal: Floats, cache: Cache) -> Floats:
    """Return the fraction (..., 3) of the ambient light that bodies leave at places (..., 3) of the receiver, from the
    camera, with what they send there. cache: keeps what they block of the last few sets of places.
    """
    free = np.ones((point.size // 3, 3))
    if light is None or shot.receiver is None or not shot.receiver.occlusion:
        return free.reshape(point.shape)
    places, normals = point.reshape(-1, 3) + shot.view.position, normal.reshape(-1, 3)
    layout, some = light.layout, len(places) * len(light.sent) <= _KEPT_PLACES
    for start in range(0, len(places), _PLACES_AT_ONCE):
        part = slice(start, start + _PLACES_AT_ONCE)
        key, keep = (layout, places[part].tobytes()), _KEPT_SWEEPS if some else 1
        swept = cache.get("ambient sweep", key, functools.partial(layout.sweep, places[part]), keep)
        free[part] = light.free(places[part], normals[part], swept)
    return free.reshape(point.shape)


def free_between(shot: Shot, light: AmbientLight | None, point: Floats, normal: Floats, cache: Cache) -> Floats:
    """Return what `free_of_bodies` does; on level ground interpolated between samples, within `patches.TOLERANCE`.

    Where the light jumps between samples, at the outline of a body that stands on the ground, it is that of each place.
    cache: keeps the samples and what bodies block there.
    """
    around = _patches(shot, light, cache)
    if light is None or around is None:
        return free_of_bodies(shot, light, point, normal, cache)
    patches, middle = around
    values = cache.get("ambient at patches", (light, patches), lambda: patches.joined(_free_at(light, patches, middle)))
    place = point.reshape(-1, 3)
    free, jump = patches.between(values, place + (shot.view.position - middle), 1.0)
    if np.any(jump):
        free[jump] = free_of_bodies(shot, light, place[jump], normal.reshape(-1, 3)[jump], cache)
    return np.asarray(np.maximum(free, 0.0)).reshape(point.shape)  # parabolas between steep samples dip below


def jumps_of_light(shot: Shot, light: AmbientLight | None, cache: Cache) -> Floats:
    """Return places (n, 3) of level ground, from the camera, a pixel apart at most, all along the lines at which the
    ambient light that bodies leave jumps.
    """
    around = _patches(shot, light, cache)
    if around is None:
        return np.zeros((0, 3))
    patches, middle = around
    return patches.jumps() + (middle - shot.view.position)


def _patches(shot: Shot, light: AmbientLight | None, cache: Cache) -> tuple[Patches, Floats] | None:
    """Return the patches of a shot's level ground, and the place (3,) of their origin in the world; None where bodies
    block nothing, or the ground is not level.
    """
    receiver = shot.receiver
    if light is None or receiver is None or not receiver.occlusion or receiver.plane_y is None:
        return None
    height, width, extent_m = receiver.plane_y, shot.view.width, receiver.extent_m
    standing, middle = cache.get("ambient standing", (light.layout, height), lambda: light.layout.standing(height))
    camera = camera_place(shot.view.position - middle)
    key = (standing.key, camera.tobytes(), width, extent_m)
    make = functools.partial(make_patches, standing, camera, 2.0 * np.pi / width, extent_m)
    return cache.get("ambient patches", key, make), middle


def _free_at(light: AmbientLight, patches: Patches, middle: Floats) -> Floats:
    """Return the fraction (samples, 3) of the ambient light that bodies leave at the samples of patches.

    middle: (3,) place of the patches' origin in the world.
    """
    blocked, layout, up = patches.blocked, light.layout, patches.up
    table = level_table(light.table[..., :3], up=up).reshape(-1, 3)
    lost = (blocked.weights @ table.astype(np.float32)).astype(np.float64)
    for k, radiance, share in zip(layout.ground_bodies, light.sent, blocked.share, strict=True):
        some = np.flatnonzero(share)
        lost[some] -= np.pi * share[some, None] * layout.at_nodes(k, radiance, patches.place[some] + middle)
    normal = np.array([[0.0, 1.0 if up else -1.0, 0.0]])
    return fraction_left(blocked.share.sum(axis=0), lost, environment_lookup(light.ambient, normal))
