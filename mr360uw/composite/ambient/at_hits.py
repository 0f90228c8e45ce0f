# SPDX-License-Identifier: Apache-2.0
"""Solved ambient light where rays meet bodies (reference renderer)."""

from __future__ import annotations

import numpy as np

from mr360uw.composite.ambient.knot_values import UNTOUCHED, whole_values
from mr360uw.composite.ambient.lattice import knots_at
from mr360uw.composite.ambient.solved_light import AmbientLight
from mr360uw.composite.raycast.geometry import Hits
from mr360uw.composite.shot import Shot
from mr360uw.types import Floats


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
        knots, shares = knots_at(lattice.places[hits.triangle[of] - first[number]], hits.weights[of])
        if lattice.two_sided:
            knots = knots + lattice.knots * hits.behind[of, None]
        values[of] = np.einsum("nk,nkc->nc", shares, whole_values(known)[knots].astype(np.float64))
    return values
