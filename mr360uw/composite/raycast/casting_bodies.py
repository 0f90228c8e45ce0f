# SPDX-License-Identifier: Apache-2.0
"""Bodies of a shot that take light away from points in the water."""

from __future__ import annotations

import numpy as np

from mr360uw.cache import Cache
from mr360uw.composite.raycast.geometry import occluding
from mr360uw.composite.shot import PlacedObject, Shot
from mr360uw.medium.shafts.occluders import Bodies, bodies_of


def casting_bodies(shot: Shot, kept: Cache) -> Bodies:
    """Return the opaque parts of a shot's objects that cast shadows, in the world. kept: holds them."""
    return kept.of(_in_world, shot.casters)


def _in_world(casters: tuple[PlacedObject, ...]) -> Bodies:
    return bodies_of([occluding([placed], np.zeros(3)) for placed in casters])
