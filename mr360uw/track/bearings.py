# SPDX-License-Identifier: Apache-2.0
"""Rotations between sets of matched directions, and whether a camera stands still, turns on the spot or moves.

A camera that turns without moving sees every point at a = R b, whatever its distance. R is the solution of Wahba's
problem (Wahba 1965) by singular values (Kabsch 1976), found robustly from random pairs of matches (Fischler & Bolles
1981). The rotations of all pairs of frames are then averaged on the group of rotations (Govindu 2004).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from mr360uw.track.camera_track import Kind
from mr360uw.types import Floats

_TRIALS = 200
"""Random pairs of matches. With half of the matches wrong, all are bad once in 10^24."""
_REFINEMENTS = 5
_STILL_SHARE = 0.9
"""Least number of matches within half a pixel of no motion, over that within half a pixel of the best rotation."""
_TURNING_SHARE = 0.85
"""Least share of matches that a rotation explains. Open water has no features, so a camera that moves through a scene
whose points are 20 times its path away counts as turning."""
_AVERAGINGS = 20
MINIMUM_MATCHES = 20
"""Fewest matches of a pair of frames that say anything."""

Matches = Mapping[tuple[int, int], tuple[Floats, Floats]]
"""Directions (n, 3) in the axes of frame i and of frame j, of the same points, for pairs (i, j)."""


def wahba(a: Floats, b: Floats) -> Floats:
    """Return the rotation R (3, 3) that minimises sum |a - R b|^2 of unit vectors a, b (n, 3)."""
    u, _, vt = np.linalg.svd(a.T @ b)
    fitted: Floats = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return fitted


def robust_rotation(a: Floats, b: Floats, limit_rad: float) -> tuple[Floats, np.ndarray]:
    """Return the rotation with a = R b that most matches (n, 3) agree on within `limit_rad`, and which do (n,)."""
    rng = np.random.default_rng(0)
    best: Floats = np.eye(3)
    most = -1
    for pair in rng.integers(0, len(a), (_TRIALS, 2)):
        trial = wahba(a[pair], b[pair])
        count = int(np.count_nonzero(_agree(a, b, trial, limit_rad)))
        if count > most:
            best, most = trial, count
    inside = _agree(a, b, best, limit_rad)
    for _ in range(_REFINEMENTS):
        if np.count_nonzero(inside) < 3:
            break
        best = wahba(a[inside], b[inside])
        inside = _agree(a, b, best, limit_rad)
    return best, inside


def _agree(a: Floats, b: Floats, rotation: Floats, limit_rad: float) -> np.ndarray:
    """Return which chords |a - R b| are within the limit; for small angles a chord is the angle."""
    return np.asarray(np.sum(np.square(a - b @ rotation.T), axis=1) <= limit_rad * limit_rad)


def classify(matches: Matches, pixel_rad: float) -> Kind:
    """Return whether the camera stands still, turns on the spot or moves.

    matches: of pairs of frames, near and far apart; the widest pair of every frame counts. pixel_rad: angle of a pixel.
    Turning: a rotation explains most matches within a pixel. Still: no rotation explains many more within half a pixel
    than none does.
    """
    widest: dict[int, tuple[int, int]] = {}
    for i, j in matches:
        if len(matches[i, j][0]) >= MINIMUM_MATCHES and (i not in widest or j > widest[i][1]):
            widest[i] = (i, j)
    pairs = [matches[pair] for pair in widest.values()]
    turns = [robust_rotation(a, b, pixel_rad)[0] for a, b in pairs]
    explained = [np.mean(_agree(a, b, turn, pixel_rad)) for (a, b), turn in zip(pairs, turns, strict=True)]
    if not pairs or np.median(explained) < _TURNING_SHARE:
        return "moving"
    turned = [np.mean(_agree(a, b, turn, 0.5 * pixel_rad)) for (a, b), turn in zip(pairs, turns, strict=True)]
    at_rest = [np.mean(_agree(a, b, np.eye(3), 0.5 * pixel_rad)) for a, b in pairs]
    return "still" if np.median(at_rest) >= _STILL_SHARE * np.median(turned) else "turning"


def average_rotations(count: int, matches: Matches, pixel_rad: float) -> Floats:
    """Return the rotations (count, 3, 3) from each frame's axes to those of frame 0 that fit all pairs best.

    They are chained from pair to pair, then refined together: the residual rotation vectors of the pairs are shared
    out by least squares, weighted by their numbers of agreeing matches, until they no longer change.
    """
    from scipy.spatial.transform import Rotation

    pairs, relative, weight = [], [], []
    for (i, j), (a, b) in sorted(matches.items()):
        if len(a) >= MINIMUM_MATCHES:
            rotation, inside = robust_rotation(a, b, 2.0 * pixel_rad)
            pairs.append((i, j))
            relative.append(rotation)
            weight.append(float(np.count_nonzero(inside)) ** 0.5)
    absolute = np.repeat(np.eye(3)[None], count, axis=0)
    known = {0}
    for (i, j), rotation in zip(pairs, relative, strict=True):
        if i in known and j not in known:
            absolute[j] = absolute[i] @ rotation
            known.add(j)
    design = np.zeros((len(pairs) + 1, count))
    design[-1, 0] = 1e3  # frame 0 stays
    for row, ((i, j), w) in enumerate(zip(pairs, weight, strict=True)):
        design[row, i], design[row, j] = -w, w
    for _ in range(_AVERAGINGS):
        residual = np.zeros((len(pairs) + 1, 3))
        for row, ((i, j), rotation, w) in enumerate(zip(pairs, relative, weight, strict=True)):
            residual[row] = w * Rotation.from_matrix(absolute[i] @ rotation @ absolute[j].T).as_rotvec()
        change = np.linalg.lstsq(design, residual, rcond=None)[0]
        absolute = Rotation.from_rotvec(change).as_matrix() @ absolute
        if np.abs(change).max() < 1e-9:
            break
    return np.asarray(absolute)
