# SPDX-License-Identifier: Apache-2.0
"""Solved ambient light of a shot: of its bodies' points, of places on the ground, and where rays meet bodies."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.ambient.body_layout import Layout
from mr360uw.composite.ambient.lattice import points_at
from mr360uw.composite.ambient.lattice_kernel import UNTOUCHED, whole_values
from mr360uw.composite.ambient.on_ground.blocked_light import BlockedLight, fraction_left
from mr360uw.composite.raycast.geometry import Hits
from mr360uw.composite.shot import Shot
from mr360uw.ibl.lookup import environment_lookup
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
        points, shares = points_at(lattice.places[hits.triangle[of] - first[number]], hits.weights[of])
        if lattice.two_sided:
            points = points + lattice.points * hits.behind[of, None]
        values[of] = np.einsum("nk,nkc->nc", shares, whole_values(known)[points].astype(np.float64))
    return values


@dataclass(frozen=True, slots=True, eq=False)
class AmbientLight:
    """Solved ambient light of a shot.

    values: for each object those of its points (lattice_kernel.py), float32, or None where nothing is in its way.
    table: of the environment (sky_table.py), empty without a receiver. sent: for each body that the ground sees the
    mean radiance (NODES, NODES, 3) of what it hides, at the nodes below it. ambient: (H, W, 3).
    """

    layout: Layout
    values: tuple[NDArray[np.float32] | None, ...]
    table: Floats
    sent: tuple[Floats, ...]
    ambient: Floats

    def free(self, blocked: BlockedLight, points: Floats) -> Floats:
        """Return the fraction (n, 3) of the ambient light that is left on the ground at places (n, 3) of the world,
        with what bodies send there.
        """
        lost = blocked.irradiance(self.table) - self.layout.bounced(blocked, points, self.sent)
        return fraction_left(blocked.share.sum(axis=0), lost, environment_lookup(self.ambient, blocked.normal))


def interpolated(before: AmbientLight, after: AmbientLight, share: float) -> AmbientLight:
    """Return the light between two solutions of one layout, interpolated linearly.

    share: 0 at `before`, 1 at `after`. What bodies send to the ground is linear in the environment and in the sun, so
    that this is exact; the ratios of their own points are, to the second order of what changes between both.
    """

    def mixed(a: Any, b: Any) -> Any:
        return a + np.asarray(share, a.dtype) * (b - a)

    values = tuple(
        None if a is None or b is None else mixed(a, b) for a, b in zip(before.values, after.values, strict=True)
    )
    sent = tuple(mixed(a, b) for a, b in zip(before.sent, after.sent, strict=True))
    table, ambient = mixed(before.table, after.table), mixed(before.ambient, after.ambient)
    return AmbientLight(before.layout, values, table, sent, ambient)
