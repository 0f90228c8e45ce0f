# SPDX-License-Identifier: Apache-2.0
"""Affine transforms (4, 4) of vertices, normals and triangles."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mr360uw.types import Floats


def placed(
    transform: Floats, positions: Floats, normals: Floats | None, faces: NDArray[np.int64]
) -> tuple[Floats, Floats | None, NDArray[np.int64]]:
    """Return positions, normals and faces under a (4, 4) transform; a mirror turns the faces' winding round."""
    linear = transform[:3, :3]
    mirrored = bool(np.linalg.det(linear) < 0.0)
    if normals is not None:
        normals = normals @ cofactors(linear).T * (-1.0 if mirrored else 1.0)
    return positions @ linear.T + transform[:3, 3], normals, faces[:, ::-1] if mirrored else faces


def cofactors(linear: Floats) -> Floats:
    """Return what normals transform by (..., 3, 3), scaled to norm 1: cofactors, determinant times inverse transpose.

    They exist for transforms that flatten, too.
    """
    a, b, c = (linear[..., k, :] for k in range(3))
    matrix = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=-2)
    return matrix / np.maximum(np.linalg.norm(matrix, axis=(-2, -1), keepdims=True), 1e-300)


def scale_of(linear: Floats) -> float:
    """Return the size of a linear map (3, 3): the cube root of its determinant, which is found without arrays."""
    (a, b, c), (d, e, f), (g, h, i) = linear.tolist()
    size: float = abs(a * (e * i - f * h) + b * (f * g - d * i) + c * (d * h - e * g)) ** (1.0 / 3.0)
    return size


def composed(translation: Floats, rotation: Floats, scale: Floats) -> Floats:
    """Return the transforms (n, 4, 4) that scale (n, 3), turn by quaternions x, y, z, w (n, 4) and move (n, 3).

    glTF 2.0 specification, section 3.5.3: T R S.
    """
    x, y, z, w = rotation.T
    matrix = np.zeros((len(rotation), 4, 4))
    matrix[:, 3, 3] = 1.0
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    matrix[:, :3, :3] = np.moveaxis(np.array(rows), -1, 0) * scale[:, None]
    matrix[:, :3, 3] = translation
    return matrix
