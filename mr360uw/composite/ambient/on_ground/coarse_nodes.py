# SPDX-License-Identifier: Apache-2.0
"""Light that bodies block at the coarse nodes of the ground, as linear operators on the light of the sky and of bodies.

    E_blocked = W Q - D B        D_(c, n) = pi s_c b_(c, n)

with Q the sky of sky_weights.py and W its weights, B the mean radiance that bodies send to their nodes n, s the
fraction of uniform light that a body blocks at a coarse node c, and b the bilinear weights of its nodes there.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.ambient.among.relative_pose import rounded
from mr360uw.composite.ambient.on_ground.ground_view import NODES
from mr360uw.composite.ambient.on_ground.height_field import HeightField
from mr360uw.composite.ambient.on_ground.light_table import glow_table
from mr360uw.composite.ambient.on_ground.node_kernel import from_nodes
from mr360uw.composite.ambient.on_ground.sky_weights import weights_of
from mr360uw.composite.ambient.on_ground.standing import Standing, Swept, nothing_swept, sweep_field
from mr360uw.types import Floats


@dataclass(frozen=True, slots=True, eq=False)
class Nodes:
    """Nodes of the ground below a body: its number among those that stand there, and the places of its nodes
    (NODES^2, 3) and coarse nodes (n, 3) from its origin [m].
    """

    body: int
    fine: Floats
    coarse: Floats


@dataclass(frozen=True, slots=True, eq=False)
class CoarseNodes:
    """What is blocked at the coarse nodes of b bodies, one body after the other. weights: (n, nodes of the sky), W
    above, sent: (n, NODES^2 b) sparse, D above; both float32.
    """

    weights: NDArray[np.float32]
    sent: Any


def make_coarse_nodes(
    standing: Standing, nodes: Sequence[Nodes], radii: Sequence[float], kept: Callable[..., Swept]
) -> CoarseNodes:
    """Return what bodies of some radii [m] block at the coarse nodes of some of them, at least one.

    kept: gets a sweep of one body from a cache.
    """
    places = np.concatenate([own.coarse + standing.origin[own.body] for own in nodes])
    share, weights, count = np.zeros((len(standing.fields), len(places))), [], len(places) // len(nodes)
    seen = standing.seen_from(places)
    for number in range(len(nodes)):
        part = slice(number * count, (number + 1) * count)
        bodies = np.flatnonzero(seen[:, part].any(axis=1))
        swept = nothing_swept(len(bodies), count)
        for row, m in enumerate(bodies.tolist()):
            field, points = standing.fields[m], rounded(places[part] - standing.origin[m], radii[m])
            key: Hashable = (field, points.tobytes())
            swept[0][row], swept[1][row] = kept(key, functools.partial(_swept, field, points))
        found = weights_of(swept, glow_table()[..., 0], up=True)
        weights.append(found.weights)
        share[bodies, part] = np.pi * found.share
    ends = np.stack([own.fine[[0, -1]] + standing.origin[own.body] for own in nodes])
    return CoarseNodes(np.concatenate(weights), _from_nodes(ends, places, share[[own.body for own in nodes]]))


def _swept(field: HeightField, places: Floats) -> Swept:
    begins, blocked = nothing_swept(1, len(places))
    sweep_field(field, places, np.zeros(3), begins[0], blocked[0])
    return begins[0], blocked[0]


def _from_nodes(ends: Floats, points: Floats, factor: Floats) -> Any:
    """Return the sparse matrix (n, NODES^2 b) that gives the sum over b bodies of the values of their nodes at places
    (n, 3), bilinear, times factors (b, n). ends: (b, 2, 3) places of the first and the last node of each.
    """
    from scipy.sparse import csr_matrix

    entries = 4 * np.count_nonzero(factor)
    begin, column = np.zeros(len(points) + 1, np.int32), np.zeros(entries, np.int32)
    weight = np.zeros(entries, np.float32)
    from_nodes(points, ends, factor, NODES, begin, column, weight)
    return csr_matrix((weight, column, begin), shape=(len(points), NODES**2 * len(ends)))


def among_nodes(nodes: Floats, points: Floats) -> Floats:
    """Return where points (n, 3) lie among nodes (NODES^2, 3), (n, 2), counted along both sides."""
    low, high = nodes[[0, -1]]
    return np.asarray((points - low)[:, [0, 2]] / (high - low)[[0, 2]] * (NODES - 1))
