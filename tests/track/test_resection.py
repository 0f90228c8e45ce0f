# SPDX-License-Identifier: Apache-2.0
"""Poses from followed features."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mr360uw.base.sphere import unit
from mr360uw.track.key_poses import Landmarks, resect

PIXEL = 2.0 * np.pi / 1280


@pytest.mark.parametrize("far", [False, True])
def test_a_pose_is_found_beside_wrong_features(rng: np.random.Generator, far: bool) -> None:
    points = unit(rng.normal(size=(200, 3))) * (1.0 if far else rng.uniform(2.0, 6.0, (200, 1)))
    position = np.zeros(3) if far else np.array([0.05, -0.02, -0.1])
    rotation = Rotation.from_rotvec([0.02, -0.03, 0.01]).as_matrix()
    observed = unit((points - position) @ rotation)
    observed[:20] = unit(rng.normal(size=(20, 3)))
    found = resect(Landmarks(np.zeros((200, 2)), points, far), observed, np.zeros(3), np.eye(3), PIXEL)
    assert found is not None
    place, turned, residual_rad = found
    # a wrong feature pulls with a weight of (pixel/error)^2: 20 of them by 0.02 pixels at most
    np.testing.assert_allclose(turned, rotation, atol=0.02 * PIXEL)
    np.testing.assert_allclose(place, position, atol=0.02 * PIXEL * 6.0)
    assert residual_rad < 0.02 * PIXEL


def test_too_few_features_make_no_pose(rng: np.random.Generator) -> None:
    points = unit(rng.normal(size=(5, 3)))
    assert resect(Landmarks(np.zeros((5, 2)), points, True), points, np.zeros(3), np.eye(3), PIXEL) is None
