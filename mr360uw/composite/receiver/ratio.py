# SPDX-License-Identifier: Apache-2.0
"""The factor by which objects, waves and lamps change the light on the receiver: E_with/E_without.

    ratio = 1 + w (share free + (1 - share) seen waves + added - 1)

with share the ambient fraction of what lights the plate, free the fraction of it that bodies leave, with what they send
there themselves, seen and waves the visible fraction of the plate's own direct light and the waves' factor on it, added
the irradiance of lamps that the plate does not know over all that lights it, and w the fading towards the receiver's
end.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mr360uw.composite.lighting.arrival import LightSource
from mr360uw.composite.lighting.surfaces import ambient_irradiance
from mr360uw.composite.shot import Shot
from mr360uw.types import Floats

FADE_FROM = 0.8
"""Fraction of its extent from which the receiver fades out: no line across the ground where shadow or waves end."""
BRIGHTEST = 64.0
"""Most that lamps multiply the plate by: past six stops its noise is what would be seen."""
DARK = 1e-9
"""Irradiance below which a place counts as dark: its direct light is all of it."""


def ambient_share(shot: Shot, sources: Sequence[LightSource], point: Floats, normal: Floats) -> Floats:
    """Return the ambient fraction (n, 3) of what falls on the plate's own receiver; 0 in the dark."""
    ambient, beam = _plate_light(shot, sources, point, normal)
    return ambient / np.maximum(ambient + beam, DARK)


def _plate_light(shot: Shot, sources: Sequence[LightSource], point: Floats, normal: Floats) -> tuple[Floats, Floats]:
    """Return the ambient and the direct irradiance (n, 3) that the plate was filmed in."""
    ambient, beam = ambient_irradiance(shot, point, normal), np.zeros((len(point), 3))
    for source in sources:
        if source.in_plate:
            arrival = source.arrival(point)
            beam = beam + arrival.irradiance * np.maximum(np.sum(normal * arrival.direction, -1), 0.0)[:, None]
    return ambient, beam


def added_light(
    shot: Shot, sources: Sequence[LightSource], point: Floats, normal: Floats, *, shadows: bool = True
) -> Floats:
    """Return the light (n, 3) of sources that the plate does not know, over all that lights the plate."""
    added = np.zeros((len(point), 3))
    for source in sources:
        if source.in_plate:
            continue
        arrival = source.arrival(point)
        cosine = np.maximum(np.sum(normal * arrival.direction, -1), 0.0)
        seen = source.visibility(point) if shadows else np.ones(len(point))
        added = added + arrival.irradiance * (cosine * seen)[:, None]
    if np.any(added):
        ambient, beam = _plate_light(shot, sources, point, normal)
        added = np.minimum(added / np.maximum(ambient + beam, DARK), BRIGHTEST)
    return added


def receiver_ratio(
    shot: Shot, sources: Sequence[LightSource], free: Floats, point: Floats, normal: Floats, distance_m: Floats
) -> Floats:
    """Return E_with/E_without (n, 3) at points of the receiver, 1 where it ends.

    free: (n, 3) fraction of the ambient light that bodies leave there, with what they send.
    """
    receiver = shot.receiver
    assert receiver is not None
    seen: Floats = np.ones(len(point))
    waves: Floats = np.ones((len(point), 3))
    for source in sources:
        if source.in_plate:
            seen = source.visibility(point) if receiver.shadow else seen
            waves = source.pattern(point, distance_m * np.pi / shot.view.height) if receiver.caustics else waves
    share = ambient_share(shot, sources, point, normal)
    ratio = share * free + (1.0 - share) * seen[:, None] * waves
    ratio = ratio + added_light(shot, sources, point, normal)
    return 1.0 + receiver_weight(distance_m, receiver.extent_m)[:, None] * (ratio - 1.0)


def receiver_weight(distance_m: Floats, extent_m: float) -> Floats:
    """Return how much (...,) of its change the receiver shows: 1, and from `FADE_FROM` of its extent on less, to 0."""
    t = np.clip((np.asarray(distance_m) / extent_m - FADE_FROM) / (1.0 - FADE_FROM), 0.0, 1.0)
    return 1.0 - t * t * (3.0 - 2.0 * t)
