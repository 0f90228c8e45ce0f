# SPDX-License-Identifier: Apache-2.0
"""Quaternions of files as rotations."""

from __future__ import annotations

import numpy as np

from mr360uw.composite.motion import check_unit_quaternions
from mr360uw.types import Floats


def rotations(quaternion: Floats, where: str) -> Floats:
    """Return rotations (n, 3, 3) of quaternions (n, 4), x, y, z, w; raise `ParameterError` unless of length 1."""
    from scipy.spatial.transform import Rotation

    check_unit_quaternions(quaternion, where)
    return np.asarray(Rotation.from_quat(quaternion).as_matrix()) if len(quaternion) else np.zeros((0, 3, 3))
