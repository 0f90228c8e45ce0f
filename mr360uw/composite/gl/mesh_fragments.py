# SPDX-License-Identifier: Apache-2.0
"""Fragments of one mesh, which are shaded together, as layer.frag reads them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.gl.fragments import Fragments
from mr360uw.composite.gl.upload import list_texture
from mr360uw.composite.mesh.mesh import Mesh
from mr360uw.composite.shot import PlacedObject
from mr360uw.types import Floats

if TYPE_CHECKING:
    import moderngl

_AT_ONCE = 1 << 19


@dataclass(frozen=True, slots=True, eq=False)
class MeshFragments:
    """Fragments of one mesh that are shaded together. chosen: (n,) numbers among all.

    listed: (n, 9) of each, triangle on the device, place (2), body and area (5) of `Fragments`. pixel: (n,) numbers,
    those of a pixel in sequence; weight: (n,) of `Fragments`. entries: texture of `listed`. name: of this part of the
    shot's fragments.
    """

    mesh: Mesh
    chosen: NDArray[np.int64]
    listed: Floats
    pixel: NDArray[np.int64]
    weight: Floats
    entries: moderngl.Texture
    name: str


def mesh_fragments(
    objects: Sequence[PlacedObject],
    fragments: Fragments,
    first: NDArray[np.int64],
    body: NDArray[np.int64],
    number: int,
) -> list[MeshFragments]:
    """Return the fragments of layer `number` by mesh. first: number of each object's first triangle. body: (n,)."""
    triangle, pixel = fragments.triangle - first[body], fragments.pixel()
    listed = np.concatenate([triangle[:, None], fragments.place, body[:, None], fragments.area], axis=1)
    meshes = list(dict.fromkeys(placed.mesh for placed in objects))
    of_mesh = np.array([meshes.index(placed.mesh) for placed in objects])[body]
    parts = []
    for k, mesh in enumerate(meshes):
        chosen = np.flatnonzero(of_mesh == k)
        for start in range(0, len(chosen), _AT_ONCE):
            part = chosen[start : start + _AT_ONCE]
            of_part, name = listed[part], f"{number} {k} {start}"
            parts.append(
                MeshFragments(mesh, part, of_part, pixel[part], fragments.weight[part], list_texture(of_part, 3), name)
            )
    return parts
