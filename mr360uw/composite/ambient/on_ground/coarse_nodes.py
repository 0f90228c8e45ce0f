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

from mr360uw.composite.ambient.on_ground.ground_view import NODES
from mr360uw.composite.ambient.on_ground.height_field import HeightField
from mr360uw.composite.ambient.on_ground.light_table import glow_table
from mr360uw.composite.ambient.on_ground.sky_weights import weights_of
from mr360uw.composite.ambient.on_ground.standing import Standing, Swept, nothing_swept, sweep_field
from mr360uw.composite.ambient.relative_pose import rounded
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
    from scipy.sparse import csr_matrix, hstack, vstack

    weights, rows = [], []
    for own in nodes:
        points = own.coarse + standing.origin[own.body]
        swept = nothing_swept(len(standing.fields), len(points))
        for m, (field, origin) in enumerate(zip(standing.fields, standing.origin, strict=True)):
            places = rounded(points - origin, radii[m])
            key: Hashable = (field, places.tobytes())
            swept[0][m], swept[1][m] = kept(key, functools.partial(_swept, field, places))
        found = weights_of(swept, glow_table()[..., 0], up=True)
        weights.append(found.weights)
        share = np.pi * found.share
        rows.append(hstack([_from_nodes(n.fine + standing.origin[n.body], points, share[n.body]) for n in nodes]))
    return CoarseNodes(np.concatenate(weights), csr_matrix(vstack(rows), dtype=np.float32))


def _swept(field: HeightField, places: Floats) -> Swept:
    begins, blocked = nothing_swept(1, len(places))
    sweep_field(field, places, np.zeros(3), begins[0], blocked[0])
    return begins[0], blocked[0]


def _from_nodes(nodes: Floats, points: Floats, factor: Floats) -> Any:
    """Return the sparse matrix (n, NODES^2) that gives values of nodes at places (n, 3), bilinear, times `factor`."""
    from scipy.sparse import csr_matrix

    place = np.clip(among_nodes(nodes, points), 0.0, NODES - 1.001)
    (i, j), (u, v) = place.astype(np.int64).T, (place - np.floor(place)).T
    first = i * NODES + j
    column = np.stack([first, first + 1, first + NODES, first + NODES + 1], axis=-1)
    weight = np.stack([(1.0 - u) * (1.0 - v), (1.0 - u) * v, u * (1.0 - v), u * v], axis=-1) * factor[:, None]
    row = np.repeat(np.arange(len(points)), 4)
    return csr_matrix((weight.ravel().astype(np.float32), (row, column.ravel())), shape=(len(points), NODES**2))


def among_nodes(nodes: Floats, points: Floats) -> Floats:
    """Return where points (n, 3) lie among nodes (NODES^2, 3), (n, 2), counted along both sides."""
    low, high = nodes[[0, -1]]
    return np.asarray((points - low)[:, [0, 2]] / (high - low)[[0, 2]] * (NODES - 1))
