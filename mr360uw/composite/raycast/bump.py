# SPDX-License-Identifier: Apache-2.0
"""Normals turned by a tangent space normal map."""

from __future__ import annotations

import numpy as np

from mr360uw.types import Floats


def bumped(normal: Floats, e1: Floats, e2: Floats, uv: Floats, bump: Floats) -> Floats:
    """Return unit normals (n, 3) turned by a tangent space normal (n, 3) whose y points up the image.

    The tangents are those of the triangle's own texture coordinates (n, 3, 2), made perpendicular to the normal.
    """
    d1, d2 = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    determinant = (d1[:, 0] * d2[:, 1] - d2[:, 0] * d1[:, 1])[:, None]
    sign = np.sign(determinant)
    tangent = sign * (e1 * d2[:, 1:] - e2 * d1[:, 1:])
    up = -sign * (e2 * d1[:, :1] - e1 * d2[:, :1])
    tangent = tangent - normal * np.sum(normal * tangent, -1, keepdims=True)
    up = up - normal * np.sum(normal * up, -1, keepdims=True)
    tangent = tangent / np.maximum(np.linalg.norm(tangent, axis=-1, keepdims=True), 1e-20)
    up = up / np.maximum(np.linalg.norm(up, axis=-1, keepdims=True), 1e-20)
    turned = bump[:, :1] * tangent + bump[:, 1:2] * up + bump[:, 2:] * normal
    length = np.linalg.norm(turned, axis=-1, keepdims=True)
    return np.where(length > 1e-6, turned / np.maximum(length, 1e-6), normal)
