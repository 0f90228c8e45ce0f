# SPDX-License-Identifier: Apache-2.0
"""Coarse samples: the samples of a mesh at which it looks for other bodies and the ground, and exchanges light with
them.

Light that comes from other bodies changes slowly over a surface, so a few hundred samples, chosen one after the other
as the farthest from those before (Gonzalez 1985), stand for all; the others interpolate between them by moving least
squares (Levin 1998).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.ambient.lattice import Lattice
from mr360uw.types import Floats

_SPACING = 0.09
"""Every sample has a coarse sample nearer than this part of the longest side, a sixth of a ball's radius, unless that
makes more coarse samples than `_MOST`."""
_MOST = 600
_TURN = 4.0
"""A normal that turns by one radian counts as so many spacings of distance."""
_NEIGHBOURS = 8
_SHARP = 0.2
"""Part of the distance between neighbours within which a sample takes the value of a coarse sample itself."""
_STRAIGHT = 1e-4
"""Weight of the slope's penalty: coarse samples in a row do not fix the slope across it."""


@dataclass(frozen=True, slots=True, eq=False)
class CoarseSamples:
    """Coarse samples of a mesh with S samples.

    sample: (C,) their numbers among the samples. spread: (S, C) sparse float32, rows of sum 1: interpolation to all
    samples. of: (S,) the coarse sample nearest to each sample. spacing_m: largest distance of a sample to one, in the
    mesh's metres.
    """

    sample: NDArray[np.int64]
    spread: Any
    of: NDArray[np.int64]
    spacing_m: float

    def mean(self, values: Floats) -> Floats:
        """Return means (C, n) of values (S, n) over the samples that are nearest to each coarse sample."""
        count = np.bincount(self.of, minlength=len(self.sample))
        total = np.stack([np.bincount(self.of, column, len(self.sample)) for column in values.T], axis=-1)
        return np.asarray(total / count[:, None])


def choose_coarse(lattice: Lattice, size_m: float, seen: NDArray[np.bool_]) -> CoarseSamples:
    """Return the coarse samples of a lattice on a mesh of a longest side `size_m`, among the samples that are `seen`
    (S,)."""
    from scipy.sparse import csr_matrix
    from scipy.spatial import cKDTree

    spacing = _SPACING * size_m
    feature = np.append(lattice.position, _TURN * spacing * lattice.normal, axis=1)
    candidates = np.flatnonzero(seen)
    chosen, spacing = _farthest(feature[candidates].astype(np.float32), spacing)
    sample = np.sort(candidates[chosen])
    near = min(_NEIGHBOURS, len(sample))
    distance, at = (np.reshape(a, (-1, near)) for a in cKDTree(feature[sample]).query(feature, near))
    weight = _least_squares(lattice, sample[at], distance)
    rows = np.repeat(np.arange(len(feature)), near)
    spread = csr_matrix((weight.ravel().astype(np.float32), (rows, at.ravel())), shape=(len(feature), len(sample)))
    return CoarseSamples(sample, spread, at[:, 0].astype(np.int64), spacing)


def _farthest(feature: NDArray[np.float32], spacing: float) -> tuple[NDArray[np.int64], float]:
    """Return numbers of points (n, 6), each the farthest from those before, and how far all are from one at most."""
    chosen = [0]
    squared = np.sum((feature - feature[0]) ** 2, axis=-1)
    while len(chosen) < min(_MOST, len(feature)):
        farthest = int(np.argmax(squared))
        if squared[farthest] <= spacing * spacing:
            break
        chosen.append(farthest)
        np.minimum(squared, np.sum((feature - feature[farthest]) ** 2, axis=-1), out=squared)
    return np.array(chosen, np.int64), max(float(np.sqrt(squared.max())), spacing)


def _least_squares(lattice: Lattice, neighbours: NDArray[np.int64], distance: Floats) -> Floats:
    """Return weights (S, n) of neighbours at distances (S, n): those of a plane fitted along the surface."""
    normal = lattice.normal
    aside = np.eye(3)[np.argmin(np.abs(normal), axis=1)]
    u = np.cross(normal, aside)
    u /= np.linalg.norm(u, axis=-1, keepdims=True)
    v = np.cross(normal, u)
    reach = np.maximum(distance[:, -1:], 1e-12)
    off = (lattice.position[neighbours] - lattice.position[:, None]) / reach[..., None]
    terms = np.stack([np.ones_like(distance), np.sum(off * u[:, None], -1), np.sum(off * v[:, None], -1)], axis=-1)
    relative = distance / reach
    near = np.maximum(1.0 - relative, 1e-3) ** 2 / (relative**2 + _SHARP**2) ** 2
    moments = np.einsum("sn,sni,snj->sij", near, terms, terms)
    moments[:, [1, 2], [1, 2]] += _STRAIGHT * near.sum(axis=1)[:, None]
    first = np.linalg.solve(moments, np.broadcast_to(np.eye(3)[:, :1], (len(near), 3, 1)))[..., 0]
    return np.asarray(near * np.einsum("sni,si->sn", terms, first))
