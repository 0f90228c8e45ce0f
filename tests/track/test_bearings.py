# SPDX-License-Identifier: Apache-2.0
"""Rotations between matched directions, and still, turning and moving cameras."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mr360uw.base.sphere import unit
from mr360uw.track.colmap import average_rotations, classify, robust_rotation, wahba

PIXEL = 2.0 * np.pi / 1280
FRAMES = 5


def clip(
    rng: np.random.Generator, turn_deg: float, step_m: float, outliers: float = 0.05, noise_px: float = 0.15
) -> tuple[dict[tuple[int, int], tuple[np.ndarray, np.ndarray]], np.ndarray]:
    """Return matches between all pairs of frames of a camera that turns and moves evenly, and its rotations."""
    points = unit(rng.normal(size=(300, 3))) * rng.uniform(2.0, 8.0, (300, 1))
    rotation = Rotation.from_rotvec(np.radians(turn_deg) * np.outer(np.arange(FRAMES), [0.2, 0.9, 0.3])).as_matrix()
    seen = []
    for k in range(FRAMES):
        direction = unit((points - [0.0, 0.0, -step_m * k]) @ rotation[k])
        direction = unit(direction + rng.normal(0.0, noise_px * PIXEL, direction.shape))
        wrong = rng.random(len(direction)) < outliers
        direction[wrong] = unit(rng.normal(size=(np.count_nonzero(wrong), 3)))
        seen.append(direction)
    return {(i, j): (seen[i], seen[j]) for i in range(FRAMES) for j in range(i + 1, FRAMES)}, rotation


def test_wahba_finds_an_exact_rotation(rng: np.random.Generator) -> None:
    b, rotation = unit(rng.normal(size=(5, 3))), Rotation.from_rotvec([0.3, -1.2, 2.0]).as_matrix()
    np.testing.assert_allclose(wahba(b @ rotation.T, b), rotation, atol=1e-12)  # rounding of a few products


def test_half_of_the_matches_may_be_wrong(rng: np.random.Generator) -> None:
    b, rotation = unit(rng.normal(size=(200, 3))), Rotation.from_rotvec([0.1, 0.7, -0.2]).as_matrix()
    a = b @ rotation.T
    a[:100] = unit(rng.normal(size=(100, 3)))
    found, inside = robust_rotation(a, b, PIXEL)
    np.testing.assert_allclose(found, rotation, atol=1e-9)  # the right matches are exact
    assert inside[100:].all()
    assert np.count_nonzero(inside[:100]) <= 2  # a random direction is within a pixel once in 10^5


@pytest.mark.parametrize(
    ("turn_deg", "step_m", "kind"),
    [(0.0, 0.0, "still"), (0.02, 0.0, "still"), (0.5, 0.0, "turning"), (20.0, 0.0, "turning"),
     (0.0, 0.1, "moving"), (20.0, 0.1, "moving")],
)  # fmt: skip
def test_kinds_of_cameras(rng: np.random.Generator, turn_deg: float, step_m: float, kind: str) -> None:
    matches, _ = clip(rng, turn_deg, step_m)
    assert classify(matches, PIXEL) == kind


def test_rotations_are_averaged_over_all_pairs(rng: np.random.Generator) -> None:
    matches, rotation = clip(rng, 20.0, 0.0)
    found = average_rotations(FRAMES, matches, PIXEL)
    error = Rotation.from_matrix(np.swapaxes(found, 1, 2) @ rotation).magnitude()
    # 300 directions with a noise of 0.15 pixels fix a rotation to about 0.15/sqrt(300) = 0.01; five times that
    assert error.max() < 0.05 * PIXEL
