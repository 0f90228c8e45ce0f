# SPDX-License-Identifier: Apache-2.0
"""Held-out error of a solved path: points from half of the key frames, looked for in the other half.

This is how far an object that stands on such a point slips against the picture in frames that did not place it.
"""

from __future__ import annotations

import numpy as np

from mr360uw.track.structure import Solution
from mr360uw.types import Floats

WIDTH = 2048
"""Width of the panorama [px] whose pixels the error is counted in."""
_ROUNDS = 4
"""Fits of a point, each weighted by the distances that the one before found."""
_LEAST_OBSERVED = 5
"""Fewest held-out features of a key frame that has an error."""


def held_out_error_px(scene: Solution) -> Floats:
    """Return the median held-out error (k,) of each key frame, in pixels of a panorama 2048 wide; NaN where unknown.

    Points that at least two even key frames see are triangulated from these alone, and compared with where odd ones
    see them; then the other way round.
    """
    kept = np.flatnonzero(scene.solved)
    frame = np.concatenate([np.full(len(scene.point[k]), k) for k in kept])
    order = np.searchsorted(kept, frame)
    point = np.concatenate([scene.point[k] for k in kept])
    look = np.concatenate([scene.direction[k] @ scene.rotation[k].T for k in kept])
    eye = scene.position[frame]
    error = np.full(len(frame), np.nan)
    for parity in (0, 1):
        using = order % 2 == parity
        place = triangulate(point[using], eye[using], look[using], len(scene.points))
        towards = place[point[~using]] - eye[~using]
        chord = np.linalg.norm(look[~using] - towards / np.linalg.norm(towards, axis=1, keepdims=True), axis=1)
        error[~using] = chord * WIDTH / (2.0 * np.pi)
    medians = np.full(len(scene.solved), np.nan)
    for k in kept:
        of_frame = error[frame == k]
        of_frame = of_frame[np.isfinite(of_frame)]
        if len(of_frame) >= _LEAST_OBSERVED:
            medians[k] = np.median(of_frame)
    return medians


def triangulate(point: np.ndarray, eye: Floats, look: Floats, count: int) -> Floats:
    """Return the points (count, 3) nearest to their rays, by angle; NaN for points of fewer than two rays.

    point (n,): number of the point that each ray belongs to. eye, look (n, 3): origins and unit directions of rays.
    Solves sum w (1 - d d^T)(x - eye) = 0 for each point, with w = 1/distance^2.
    """
    across = np.eye(3) - look[:, :, None] * look[:, None, :]
    weight = np.ones(len(point))
    place = np.full((count, 3), np.nan)
    seen = np.bincount(point, minlength=count)
    known = seen >= 2
    for _ in range(_ROUNDS):
        normal, right = np.zeros((count, 3, 3)), np.zeros((count, 3))
        np.add.at(normal, point, weight[:, None, None] * across)
        np.add.at(right, point, weight[:, None] * np.einsum("nij,nj->ni", across, eye))
        trace = np.trace(normal, axis1=1, axis2=2)
        regular = known & (np.abs(np.linalg.det(normal)) > 1e-12 * np.maximum(trace, 1e-300) ** 3)
        place[:] = np.nan
        place[regular] = np.linalg.solve(normal[regular], right[regular][:, :, None])[:, :, 0]
        weight = np.nan_to_num(1.0 / np.maximum(np.sum(np.square(place[point] - eye), axis=1), 1e-18), nan=0.0)
    return place
