# SPDX-License-Identifier: Apache-2.0
"""Solved ambient light of a shot: of its bodies' knots, and of places on the ground."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.ambient.body_layout import Layout
from mr360uw.composite.ambient.on_ground.ground_kernel import fraction_left, gather
from mr360uw.ibl.lookup import environment_lookup
from mr360uw.types import Floats


@dataclass(frozen=True, slots=True, eq=False)
class AmbientLight:
    """Solved ambient light of a shot. values: for each object those of its knots (knot_values.py), float32, or None
    where nothing is in its way. table: of the environment, as `ground_kernel.gather` takes it; empty without a
    receiver. sent: for each body that the ground sees the mean radiance (NODES, NODES, 3) of what it hides, at the
    nodes below it. ambient: (H, W, 3).
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
        return fraction_left(share, lost, environment_lookup(self.ambient, normal))


def interpolated(before: AmbientLight, after: AmbientLight, share: float) -> AmbientLight:
    """Return the light between two solutions of one layout, interpolated linearly.

    share: 0 at `before`, 1 at `after`. What bodies send to the ground is linear in the environment and in the sun, so
    that this is exact; the ratios of their own knots are, to the second order of what changes between both.
    """

    def mixed(a: Any, b: Any) -> Any:
        return a + np.asarray(share, a.dtype) * (b - a)

    values = tuple(
        None if a is None or b is None else mixed(a, b) for a, b in zip(before.values, after.values, strict=True)
    )
    sent = tuple(mixed(a, b) for a, b in zip(before.sent, after.sent, strict=True))
    table, ambient = mixed(before.table, after.table), mixed(before.ambient, after.ambient)
    return AmbientLight(before.layout, values, table, sent, ambient)


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
    blocked = blocked_light(table, normal, swept)
    lost = blocked[..., :3].sum(axis=0)
    for k, radiance, of in zip(layout.ground_bodies, sent, blocked, strict=True):
        if np.any(of[:, 3]):
            lost -= of[:, 3:] * layout.at_nodes(k, radiance, point)
    return lost, blocked[..., 3].sum(axis=0) / np.pi


def blocked_light(table: NDArray[np.float64], normal: Floats, swept: tuple[NDArray[Any], NDArray[Any]]) -> Floats:
    """Return what each body blocks (bodies, n, 4) of light and of a radiance of 1; the arguments are `light_lost`'s."""
    blocked = np.zeros((len(swept[0]), len(normal), 4))
    normal = np.ascontiguousarray(normal, np.float64)
    weights = normal
    if len(normal) and np.all(normal == normal[0]):
        table, weights = np.tensordot(table, normal[0], axes=(2, 0))[:, :, None], np.ones((len(normal), 1))
    gather(normal, weights, *swept, table, blocked)
    return blocked
