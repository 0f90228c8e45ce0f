# SPDX-License-Identifier: Apache-2.0
"""Ambient light of a shot with its bodies, as the renderers ask for it."""

from __future__ import annotations

import functools

import numpy as np

from mr360uw.cache import Cache
from mr360uw.composite.ambient.body_layout import Layout, make_layout
from mr360uw.composite.ambient.ground_height import ground_heights
from mr360uw.composite.ambient.solver import AmbientLight, Solver
from mr360uw.composite.shot import Shot
from mr360uw.types import Floats

_PLACES_AT_ONCE = 1 << 14
_KEPT_PLACES, _KEPT_SWEEPS = 1 << 17, 8
"""Sets of places, 400 bytes a place and body, whose sweeps are kept."""


def ambient_layout(shot: Shot, cache: Cache) -> Layout:
    """Return how the bodies and the ground of a shot see each other."""
    receiver = shot.receiver
    on_ground = receiver is not None and receiver.occlusion
    objects = shot.objects if shot.draw.ambient_occlusion else tuple(o for o in shot.casters if on_ground)
    heights = ground_heights(shot, objects, cache)
    key = (tuple((o.key, o.casts_shadow) for o in objects), tuple(heights), on_ground)
    return cache.get("ambient layout", key, lambda: make_layout(objects, heights, on_ground, cache))


def ambient_light(shot: Shot, cache: Cache) -> AmbientLight | None:
    """Return the solved ambient light of a shot; None where bodies have no part in it."""
    receiver = shot.receiver
    if not shot.objects or not (shot.draw.ambient_occlusion or (receiver is not None and receiver.occlusion)):
        return None
    layout = ambient_layout(shot, cache)
    if (
        all(view.nothing(body) for body, view in zip(layout.bodies, layout.views, strict=True))
        and not layout.ground_bodies
    ):
        return None
    return Solver(shot, layout, cache).solve()


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
