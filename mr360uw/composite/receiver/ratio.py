# SPDX-License-Identifier: Apache-2.0
"""Irradiance ratio E_with/E_without of the receiver: its change by objects, waves and lamps.

    ratio = 1 + w (share free + (1 - share) seen waves + added - 1)

with share the ambient fraction of the plate's irradiance, free the fraction of it that bodies leave, with what they
send there themselves, seen the visible fraction of the plate's direct light, waves the caustic factor on it, added the
irradiance of lamps over that of the plate, and w the weight that fades out towards the receiver's end.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mr360uw.composite.lighting.light_sources import LightSource
from mr360uw.composite.lighting.shading import ambient_irradiance
from mr360uw.composite.receiver.pattern import direct_pattern
from mr360uw.composite.shot import Shot
from mr360uw.constants import BRIGHTEST, DARK
from mr360uw.texels import smoothstep
from mr360uw.types import Floats

FADE_FROM = 0.8
"""Fraction of its extent from which the receiver fades out, so that shadow and waves end without a line."""


def ambient_share(shot: Shot, sources: Sequence[LightSource], point: Floats, normal: Floats) -> Floats:
    """Return the ambient fraction (n, 3) of the plate's irradiance on the receiver; 0 in the dark."""
    ambient, beam = _plate_light(shot, sources, point, normal)
    return ambient / np.maximum(ambient + beam, DARK)


def _plate_light(shot: Shot, sources: Sequence[LightSource], point: Floats, normal: Floats) -> tuple[Floats, Floats]:
    """Return the ambient and the direct irradiance (n, 3) of the plate on the receiver."""
    ambient, beam = ambient_irradiance(shot, point, normal), np.zeros((len(point), 3))
    for source in sources:
        if source.in_plate:
            direction, irradiance, _ = source.arrival(point)
            beam = beam + irradiance * np.maximum(np.sum(normal * direction, -1), 0.0)[:, None]
    return ambient, beam


def added_light(
    shot: Shot,
    sources: Sequence[LightSource],
    point: Floats,
    normal: Floats,
    sides: Floats | None = None,
    *,
    shadows: bool = True,
) -> Floats:
    """Return the irradiance (n, 3) of sources that are not in the plate, over that of the plate.

    sides: (n, 2, 3) [m] of footprints, over which shadows are averaged; None for points.
    """
    added = np.zeros((len(point), 3))
    for source in sources:
        if source.in_plate:
            continue
        direction, irradiance, _ = source.arrival(point)
        cosine = np.maximum(np.sum(normal * direction, -1), 0.0)
        seen = source.visibility(point, sides) if shadows else np.ones(len(point))
        added = added + irradiance * (cosine * seen)[:, None]
    if np.any(added):
        ambient, beam = _plate_light(shot, sources, point, normal)
        added = np.minimum(added / np.maximum(ambient + beam, DARK), BRIGHTEST)
    return added


def receiver_ratio(
    shot: Shot,
    sources: Sequence[LightSource],
    free: Floats,
    point: Floats,
    normal: Floats,
    distance_m: Floats,
    plate: tuple[Floats, Floats, Floats] | None = None,
    sides: Floats | None = None,
) -> Floats:
    """Return E_with/E_without (n, 3) at points of the receiver, 1 where it ends.

    free: (n, 3) fraction of the ambient light that bodies leave there, with what they send. plate: its light, its calm
    light and its veil there, each (n, 3), where it has a pattern (see pattern.py). sides: (n, 2, 3) [m] of the pixels
    on the receiver, over which shadows are averaged; None for points.
    """
    receiver = shot.receiver
    assert receiver is not None
    seen: Floats = np.ones(len(point))
    waves: Floats = np.ones((len(point), 3))
    for source in sources:
        if source.in_plate:
            seen = source.visibility(point, sides) if receiver.shadow else seen
            waves = source.pattern(point, distance_m * np.pi / shot.view.height) if receiver.caustics else waves
    share = ambient_share(shot, sources, point, normal)
    r = np.ones_like(share) if plate is None else direct_pattern(*plate, share)
    ratio = share * free + (r - share) * seen[:, None] * waves
    ratio = (ratio + added_light(shot, sources, point, normal, sides)) / r
    weight = 1.0 - smoothstep(distance_m / receiver.extent_m, FADE_FROM, 1.0)
    return 1.0 + weight[:, None] * (ratio - 1.0)
