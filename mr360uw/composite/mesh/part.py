# SPDX-License-Identifier: Apache-2.0
"""Contents of a mesh file of any format: placed, indexed parts and their materials."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.mesh.curve import Animation
from mr360uw.composite.mesh.material import Material
from mr360uw.composite.mesh.skin import Skeleton, UnplacedSurface
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
class Rigging:
    """What moves the parts of a file. bodies: one for each part, in the same order. clips: names of the animations.

    read_clip: returns the animation of a number; raises `MeshError` where it is broken.
    """

    skeleton: Skeleton
    bodies: tuple[UnplacedSurface, ...]
    clips: tuple[str, ...]
    read_clip: Callable[[int], Animation]


@dataclass(frozen=True, slots=True, eq=False)
class MeshFile:
    """The contents of a file, its parts at rest; notes: what it holds that is not drawn, or drawn in another way, for
    the user. rigging: None where nothing in the file moves. unit_m: metres of a unit, as the file says, or 1.
    """

    parts: tuple[Part, ...]
    materials: tuple[Material, ...]
    notes: tuple[str, ...] = ()
    rigging: Rigging | None = None
    unit_m: float = 1.0
