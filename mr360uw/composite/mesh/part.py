# SPDX-License-Identifier: Apache-2.0
"""Contents of a mesh file of any format: placed, indexed parts and their materials."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.mesh.material import Material
from mr360uw.types import Floats


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """Triangles `faces` (T, 3) over vertices (V, 3), in the world of the file.

    normals: (V, 3) of any length. flat: shading of a part without normals: flat (as glTF requires) or smooth between
    creases. uv: (V, 2) right and down from the image's top left. colors: (V, 4) linear. material: an index.
    """

    name: str
    positions: Floats
    faces: NDArray[np.int64]
    normals: Floats | None = None
    uv: Floats | None = None
    colors: Floats | None = None
    material: int = 0
    flat: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class MeshFile:
    """The contents of a file. notes: for the user, on features that are not drawn or drawn in another way."""

    parts: tuple[Part, ...]
    materials: tuple[Material, ...]
    notes: tuple[str, ...] = ()


def placed(
    transform: Floats, positions: Floats, normals: Floats | None, faces: NDArray[np.int64]
) -> tuple[Floats, Floats | None, NDArray[np.int64]]:
    """Return positions, normals and faces under a (4, 4) transform; a mirror reverses the faces' winding."""
    linear = transform[:3, :3]
    mirrored = bool(np.linalg.det(linear) < 0.0)
    if normals is not None:
        normals = normals @ cofactors(linear).T * (-1.0 if mirrored else 1.0)
    return positions @ linear.T + transform[:3, 3], normals, faces[:, ::-1] if mirrored else faces


def cofactors(linear: Floats) -> Floats:
    """Return the transform of normals (..., 3, 3): cofactors (determinant times inverse transpose), scaled to norm 1.

    Cofactors exist for singular transforms, too.
    """
    a, b, c = (linear[..., k, :] for k in range(3))
    matrix = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=-2)
    return matrix / np.maximum(np.linalg.norm(matrix, axis=(-2, -1), keepdims=True), 1e-300)
