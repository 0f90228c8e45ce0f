# SPDX-License-Identifier: Apache-2.0
"""Held-out error of a solved path: points from half of the key frames, looked for in the other half.

This is how far an object that stands on such a point slips against the picture in frames that did not place it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mr360uw.track.structure import Solution
from mr360uw.types import Floats

WIDTH = 2048
"""Width of the panorama [px] whose pixels the error is counted in."""
_ROUNDS = 4
"""Fits of a point, each weighted by the distances that the one before found."""
_LEAST_OBSERVED = 20
"""Least number of held-out features of a key frame that has a slip; half as many make its noise 1.4 times as large."""


@dataclass(frozen=True, slots=True, eq=False)
class HeldOut:
    """Held-out errors of key frames (k,), in pixels of a panorama 2048 wide; NaN where too few points are seen.

    slip_px: length of the median error, as a vector, of the features below the horizon: how far the ground as a whole,
    and a body on it, is off. feature_px: median length of the errors of single features, which contains their noise.
    """

    slip_px: Floats
    feature_px: Floats


def held_out_errors(scene: Solution) -> HeldOut:
    """Return the errors of points from half of the key frames in the other half.

    Points that at least two even key frames see are triangulated from these alone, and compared with where odd ones
    see them; then the other way round. Errors are in the tangent plane: along the parallel and along the meridian.
    """
    kept = np.flatnonzero(scene.solved)
    frame = np.concatenate([np.full(len(scene.point[k]), k) for k in kept])
    order = np.searchsorted(kept, frame)
    point = np.concatenate([scene.point[k] for k in kept])
    own = np.concatenate([scene.direction[k] for k in kept])
    look = np.concatenate([scene.direction[k] @ scene.rotation[k].T for k in kept])
    eye = scene.position[frame]
    error = np.full((len(frame), 2), np.nan)
    for parity in (0, 1):
        using = order % 2 == parity
        place = triangulate(point[using], eye[using], look[using], len(scene.points))
        towards = np.einsum("nji,nj->ni", scene.rotation[frame[~using]], place[point[~using]] - eye[~using])
        error[~using] = _tangent(own[~using], towards) * WIDTH / (2.0 * np.pi)
    slip, feature = np.full(len(scene.solved), np.nan), np.full(len(scene.solved), np.nan)
    for k in kept:
        known = (frame == k) & np.isfinite(error[:, 0])
        ground = known & (own[:, 1] < 0.0)
        if np.count_nonzero(known) >= _LEAST_OBSERVED:
            feature[k] = np.median(np.linalg.norm(error[known], axis=1))
        if np.count_nonzero(ground) >= _LEAST_OBSERVED:
            slip[k] = np.linalg.norm(np.median(error[ground], axis=0))
    return HeldOut(slip, feature)


def _tangent(seen: Floats, towards: Floats) -> Floats:
    """Return errors (n, 2) [rad] of unit directions (n, 3) in camera axes: along the parallel and the meridian."""
    expected = towards / np.linalg.norm(towards, axis=1, keepdims=True)
    level = np.maximum(np.hypot(expected[:, 0], expected[:, 2]), 1e-9)
    east = np.stack([-expected[:, 2], np.zeros(len(expected)), expected[:, 0]], axis=1) / level[:, None]
    off = seen - expected
    return np.stack([np.sum(off * east, axis=1), np.sum(off * np.cross(east, expected), axis=1)], axis=1)


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
