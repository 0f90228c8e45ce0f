# SPDX-License-Identifier: Apache-2.0
"""Contents of a mesh file of any format: placed, indexed parts and their materials (glTF 2.0's metallic-roughness)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.mesh.skin import Animation, Skeleton, UnplacedSurface
from mr360uw.composite.mesh.texture import Texture
from mr360uw.types import Floats


@dataclass(frozen=True, slots=True)
class MapCoordinates:
    """Texture coordinates of a material's maps: the name of the mesh's values, and how these are moved."""

    name: str
    offset: tuple[float, float] = (0.0, 0.0)
    rotation_rad: float = 0.0
    scale: tuple[float, float] = (1.0, 1.0)

    def of(self, uv: Floats) -> Floats:
        """Return coordinates (V, 2) scaled, then turned (anticlockwise where v points down), then moved."""
        c, s = np.cos(self.rotation_rad), np.sin(self.rotation_rad)
        return uv * self.scale @ np.array([[c, -s], [s, c]]) + self.offset


@dataclass(frozen=True, slots=True, eq=False)
class MappedMaterial:
    """A material of a file, the coordinates of each of its `sets`, and the name of its vertex colours or ""."""

    material: Material
    coordinates: tuple[MapCoordinates, ...]
    colors: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """Triangles `faces` (T, 3) over vertices (V, 3), in the world of the file.

    normals: (V, 3) of any length. flat: shading of a part without normals: flat (as glTF requires) or smooth between
    creases. uv: (V, 2) right and down from the image's top left, or None. more_uv: those of the material's further
    `sets`. colors: (V, 4) linear. material: an index.
    """

    name: str
    positions: Floats
    faces: NDArray[np.int64]
    normals: Floats | None = None
    uv: Floats | None = None
    colors: Floats | None = None
    material: int = 0
    flat: bool = False
    more_uv: tuple[Floats | None, ...] = ()

    def missing_sets(self, material: Material) -> frozenset[int]:
        """Return the numbers of texture coordinates that maps of a material need and the part has not."""
        there = self.uv, *self.more_uv
        return frozenset(n for _, n in material.mapped if n >= len(there) or there[n] is None)


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
    head: comments of a file in a format that has no up axis, in which exporters may name theirs; None: the axes are
    y up. cad: whether the format is one of machines, in which units are millimetres.
    """

    parts: tuple[Part, ...]
    materials: tuple[Material, ...]
    notes: tuple[str, ...] = ()
    rigging: Rigging | None = None
    unit_m: float = 1.0
    head: str | None = None
    cad: bool = False


AlphaMode = Literal["OPAQUE", "MASK", "BLEND"]
MAPS = ("base_map", "metallic_roughness_map", "normal_map", "occlusion_map", "emission_map")


@dataclass(frozen=True, slots=True, eq=False)
class Material:
    """Factors and maps of glTF 2.0 section 3.9; colours are linear Rec.709.

    base_color: (r, g, b, a). Every map multiplies its factor: `metallic_roughness_map` the roughness in its
    green and the metallic in its blue channel, `occlusion_map` in its red; `normal_map` is in tangent space,
    (x, y, z) = 2 rgb - 1.
    refractive_index: relative to vacuum; below water its ratio to that of water applies. trim: factors on light that
    reaches the camera; other surfaces receive it untrimmed. sets: number of the texture coordinates of each map, in the
    order of the maps below; the base map has the first.
    """

    name: str = ""
    base_color: tuple[float, float, float, float] = (0.5, 0.5, 0.5, 1.0)
    metallic: float = 0.0
    roughness: float = 0.7
    emission: tuple[float, float, float] = (0.0, 0.0, 0.0)
    normal_scale: float = 1.0
    occlusion_strength: float = 1.0
    alpha_mode: AlphaMode = "OPAQUE"
    alpha_cutoff: float = 0.5
    double_sided: bool = False
    refractive_index: float = 1.5
    trim: tuple[float, float, float] = (1.0, 1.0, 1.0)
    base_map: Texture | None = None
    metallic_roughness_map: Texture | None = None
    normal_map: Texture | None = None
    occlusion_map: Texture | None = None
    emission_map: Texture | None = None
    sets: tuple[int, int, int, int, int] = (0, 0, 0, 0, 0)

    @property
    def mapped(self) -> tuple[tuple[str, int], ...]:
        """Names of the maps that are set, and the number of the texture coordinates of each."""
        return tuple((name, n) for name, n in zip(MAPS, self.sets, strict=True) if getattr(self, name) is not None)

    @property
    def maps(self) -> tuple[Texture, ...]:
        """The maps that are set."""
        return tuple(getattr(self, name) for name, _ in self.mapped)

    @property
    def wrong_factors(self) -> list[float]:
        """Factors that are not finite, then those of light and reflection that are negative."""
        lit = (*self.base_color, *self.emission, self.metallic, self.roughness)
        others = (self.normal_scale, self.occlusion_strength, self.alpha_cutoff, self.refractive_index)
        bad = [factor for factor in (*lit, *others) if not math.isfinite(factor)]
        return bad + [factor for factor in lit if factor < 0.0]

    def without_maps(self, sets: frozenset[int]) -> Material:
        """Return the material without the maps that have these texture coordinates."""
        none: dict[str, Any] = {name: None for name, n in self.mapped if n in sets}
        return replace(self, **none)
