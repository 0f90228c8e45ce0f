# SPDX-License-Identifier: Apache-2.0
"""Contents of a mesh file of any format: placed, indexed parts, their materials (glTF 2.0's metallic-roughness) and
textures.
"""

from __future__ import annotations

import io
import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.base.color import decode
from mr360uw.base.input_files import PNG_START, TEXTURE, picture_size, read_data
from mr360uw.base.texels import between_four, texels_around
from mr360uw.composite.mesh.skin import Animation, Skeleton, UnplacedSurface
from mr360uw.errors import MeshError
from mr360uw.jit import exact
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


# --- Textures -------------------------------------------------------------------------------------------------------

# Textures: linear light, box-filtered levels, anisotropic lookup with a footprint.
#
# The footprint is computed from the rays of the neighbouring pixels (Igehy 1999), so it includes the stretch of the
# equirectangular frame. On the device: texture.glsl, with all levels of all maps in one store. Colour profiles and
# gamma tags of files are ignored, as glTF requires.


Pixels = NDArray[np.uint8] | NDArray[np.uint16]
_PNG_DEPTH = 24
"""Byte offset of the bit depth in a PNG file."""
_BROKEN = (OSError, ValueError, IndexError, KeyError, TypeError, SyntaxError, OverflowError, EOFError, MemoryError)
"""What PIL raises where a file is damaged; UnidentifiedImageError is an OSError."""


def read_texture(path: Path) -> Texture:
    """Return the texture of the colours in an image file; raise `MeshError`."""
    return make_texture(decode_image(read_data(path, MeshError), str(path)), srgb=True)


def decode_image(data: bytes, where: str) -> Pixels:
    """Return the code values (h, w, 3 or 4) of a PNG, JPEG, WebP ... file, uint8, or uint16 where it has 16 bits.

    Raises `MeshError` where it has too many pixels, and for what PIL and OpenCV raise.
    """
    import cv2
    from PIL import Image

    width, height = picture_size(data) or (0, 0)  # before PIL, which has a limit of its own
    TEXTURE.check(where, width * height, MeshError)
    try:
        with warnings.catch_warnings(action="ignore"), Image.open(io.BytesIO(data)) as image:  # damage is an error here
            TEXTURE.check(where, image.width * image.height, MeshError)
            deep = data.startswith(PNG_START) and data[_PNG_DEPTH] == 16
            return _sixteen_bits(data) if deep else _pixels(image)
    except MeshError:
        raise
    except (*_BROKEN, Image.DecompressionBombError, cv2.error) as error:
        what = "no kind of picture that is known" if "identify" in str(error) else str(error) or type(error).__name__
        raise MeshError(f"{where} - a texture cannot be read (got: {what:.120}) - give a PNG or JPEG") from error


def _pixels(image: Any) -> NDArray[np.uint8]:
    """Return a PIL image as (h, w, 3 or 4) uint8."""
    if image.mode.startswith("I"):  # PIL would clip 16-bit greys to 255 instead of scaling them
        grey = (np.asarray(image, np.float64) / 257.0 + 0.5).astype(np.uint8)
        return np.repeat(grey[..., None], 3, axis=-1)
    clear = image.mode in ("RGBA", "LA", "PA") or "transparency" in image.info
    return np.asarray(image.convert("RGBA" if clear else "RGB"))


def _sixteen_bits(data: bytes) -> NDArray[np.uint16]:
    """Return a PNG of 16 bits, of which PIL keeps 8."""
    import cv2

    image: Any = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise ValueError("a PNG of 16 bits that does not decode")
    if image.ndim == 2:
        image = np.repeat(image[..., None], 3, axis=-1)
    return np.ascontiguousarray(image[..., [2, 1, 0, 3][: image.shape[2]]])


Wrap = Literal["repeat", "clamp", "mirror"]
WRAPS: tuple[Wrap, ...] = ("repeat", "clamp", "mirror")
LARGEST_COUNT = 8
"""Lookups along a pixel's longer axis, at most. Twin: texture.glsl."""


@dataclass(frozen=True, slots=True, eq=False)
class Texture:
    """An image to be looked up: `levels[0]` is (h, w, 4) float16, linear, colour not premultiplied; then its halves.

    Texture coordinates (u, v) run right and down from the top left corner of the image.
    """

    levels: tuple[NDArray[np.float16], ...]
    wrap: tuple[Wrap, Wrap] = ("repeat", "repeat")

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the finest level."""
        height, width = self.levels[0].shape[:2]
        return width, height


def make_texture(
    image: NDArray[np.uint8] | NDArray[np.uint16], *, srgb: bool, wrap: tuple[Wrap, Wrap] = ("repeat", "repeat")
) -> Texture:
    """Return a texture of an image (h, w, 3 or 4) of 8 or 16 bit code values; srgb: whether its colours are encoded.

    Levels below the first average the colour weighted by alpha, so that the colour of clear texels does not leak.
    """
    import cv2

    # Level 0, in halves by the table of all codes: as many conversions as there are codes
    whole = np.iinfo(image.dtype).max
    codes = np.arange(whole + 1) / whole
    table = (decode(codes, "srgb") if srgb else codes).astype(np.float32)
    rgba, halves = np.ones((*image.shape[:2], 4), np.float32), np.ones((*image.shape[:2], 4), np.float16)
    colours = np.ascontiguousarray(image[..., :3])
    if whole == np.iinfo(np.uint8).max:
        rgba[..., :3] = cv2.LUT(colours, table)
        halves[..., :3] = cv2.LUT(colours, table.astype(np.float16).view(np.int16)).view(np.float16)
    else:
        rgba[..., :3] = table[colours]
        halves[..., :3] = rgba[..., :3]
    if image.shape[2] == 4:
        rgba[..., 3] = image[..., 3] / np.float32(whole)
        halves[..., 3] = rgba[..., 3]
    levels = [rgba]
    alpha_varies = bool(image.shape[2] == 4 and rgba[..., 3].min() < 1.0)
    while max(levels[-1].shape[:2]) > 1:
        height, width = (max(n // 2, 1) for n in levels[-1].shape[:2])
        if not alpha_varies:
            levels.append(cv2.resize(levels[-1], (width, height), interpolation=cv2.INTER_AREA))
            continue
        weighted = levels[-1].copy()
        weighted[..., :3] *= np.maximum(weighted[..., 3:], 1e-4)
        small = cv2.resize(weighted, (width, height), interpolation=cv2.INTER_AREA)
        small[..., :3] /= np.maximum(small[..., 3:], 1e-4)
        levels.append(small)
    return Texture((halves, *(level.astype(np.float16) for level in levels[1:])), wrap)


def wrapped(index: NDArray[np.int64], size: int, wrap: Wrap) -> NDArray[np.int64]:
    """Return texel indices wrapped into [0, size)."""
    if wrap == "clamp":
        return np.clip(index, 0, size - 1)
    if wrap == "mirror":
        folded = index % (2 * size)
        return np.minimum(folded, 2 * size - 1 - folded)
    return index % size


def bilinear_level(texture: Texture, level: int, uv: Floats) -> Floats:
    """Return one level (..., 4) at texture coordinates (..., 2), bilinear between texel centres."""
    image = texture.levels[level]
    height, width = image.shape[:2]
    i, j, fx, fy = texels_around(uv[..., 0] * width - 0.5, uv[..., 1] * height - 0.5)
    i0, i1 = wrapped(i, width, texture.wrap[0]), wrapped(i + 1, width, texture.wrap[0])
    j0, j1 = wrapped(j, height, texture.wrap[1]), wrapped(j + 1, height, texture.wrap[1])
    return np.asarray(between_four(image[j0, i0], image[j0, i1], image[j1, i0], image[j1, i1], fx, fy))


def texture_taps(texture: Texture, du: ArrayLike, dv: ArrayLike) -> tuple[Floats, NDArray[np.int64], Floats]:
    """Return (levels (...,), counts (...,), offsets (..., 2) in u and v) of the lookups along a pixel's longer axis.

    du, dv: changes of (u, v), each (..., 2), over half a pixel along its columns and rows. They span an ellipse on the
    map (Heckbert 1989, section 3): its shorter half axis sets the level, its longer one how many lookups are spread
    from -offset to +offset, so that a surface at a grazing angle is neither blurred nor undersampled. A pixel that is
    as long as wide has one lookup; none has more than `LARGEST_COUNT`.
    """
    size = np.asarray(texture.size, np.float64)
    a, b = np.asarray(du, np.float64) * size, np.asarray(dv, np.float64) * size
    p, q, r = np.sum(a * a, -1), np.sum(a * b, -1), np.sum(b * b, -1)
    half_sum, spread = 0.5 * (p + r), np.hypot(0.5 * (p - r), q)
    longer = np.sqrt(half_sum + spread)
    shorter = np.abs(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]) / np.maximum(longer, 1e-30)
    # axes of the ellipse in the plane of (du, dv): the angle of a turn that makes the two perpendicular
    angle = 0.5 * np.arctan2(2.0 * q, p - r)
    axis = np.cos(angle)[..., None] * np.asarray(du) + np.sin(angle)[..., None] * np.asarray(dv)
    extent = np.maximum(np.maximum(shorter, 2.0 * longer / (LARGEST_COUNT + 1.0)), 1.0)
    beyond = np.maximum(longer - extent, 0.0)
    count = 1 + np.ceil(2.0 * beyond / extent - 1e-4).astype(np.int64)
    level = np.minimum(np.log2(extent), len(texture.levels) - 1.0)
    return level, np.minimum(count, LARGEST_COUNT), (beyond / np.maximum(longer, 1e-30))[..., None] * axis


def texture_lookup(texture: Texture, uv: ArrayLike, du: ArrayLike, dv: ArrayLike) -> Floats:
    """Return the texture (..., 4) at coordinates (..., 2), trilinear, averaged along the pixel's longer axis."""
    uv = np.asarray(uv, np.float64)
    level, count, offset = texture_taps(texture, du, dv)
    result = np.zeros((*level.shape, 4))
    for k in range(int(count.max(initial=1))):
        used = k < count
        place = (2.0 * k - (count[used] - 1.0)) / np.maximum(count[used] - 1.0, 1.0)
        result[used] += trilinear(texture, uv[used] + place[:, None] * offset[used], level[used])
    return result / count[..., None]


def trilinear(texture: Texture, uv: ArrayLike, level: ArrayLike) -> Floats:
    """Return the texture (..., 4) at coordinates (..., 2) and fractional levels (...,)."""
    uv, level = np.asarray(uv, np.float64), np.asarray(level, np.float64)
    result = np.zeros((*level.shape, 4))
    for k in range(len(texture.levels)):
        weight = np.maximum(1.0 - np.abs(level - k), 0.0)
        used = weight > 0.0
        if np.any(used):
            result[used] += weight[used][:, None] * bilinear_level(texture, k, uv[used])
    return result


@exact
def alpha_at(alphas: Any, place: Any, u: Any, v: Any, change: Any) -> Any:
    """Return the alpha at texture coordinates of a map as `texture_lookup` does, compiled for a place at a time.

    alphas: of all levels of all maps, one after the other. place: (5,) where the map begins, its width and height, and
    numbers in `WRAPS` along both. change: (2, 2) of (u, v) over half a pixel along its columns and rows.
    """
    first, width, height = place[0], place[1], place[2]
    ax, ay, bx, by = change[0, 0] * width, change[0, 1] * height, change[1, 0] * width, change[1, 1] * height
    p, q, r = ax * ax + ay * ay, ax * bx + ay * by, bx * bx + by * by
    # Half axes of the ellipse that a pixel is on the map: the shorter one sets the level
    longer = np.sqrt(0.5 * (p + r) + np.hypot(0.5 * (p - r), q))
    shorter = abs(ax * by - ay * bx) / max(longer, 1e-30)
    extent = max(shorter, 2.0 * longer / (LARGEST_COUNT + 1.0), 1.0)
    level = min(np.log2(extent), np.floor(np.log2(max(width, height)) + 1e-4))
    beyond = max(longer - extent, 0.0)
    count = min(1 + int(np.ceil(2.0 * beyond / extent - 1e-4)), LARGEST_COUNT)
    angle, over = 0.5 * np.arctan2(2.0 * q, p - r), beyond / max(longer, 1e-30)
    offset_u = over * (np.cos(angle) * change[0, 0] + np.sin(angle) * change[1, 0])
    offset_v = over * (np.cos(angle) * change[0, 1] + np.sin(angle) * change[1, 1])
    for _ in range(int(level)):
        first, width, height = first + width * height, max(width // 2, 1), max(height // 2, 1)
    # Along the longer one, on both levels
    total, fraction = 0.0, level - np.floor(level)
    for finer in range(2 if fraction > 0.0 else 1):
        for k in range(count):
            along = (2.0 * k - (count - 1.0)) / max(count - 1.0, 1.0)
            x, y = (u + along * offset_u) * width - 0.5, (v + along * offset_v) * height - 0.5
            i, j = int(np.floor(x)), int(np.floor(y))
            fx, fy, value = x - i, y - j, 0.0
            for corner in range(4):
                column, row = _wrapped(i + corner % 2, width, place[3]), _wrapped(j + corner // 2, height, place[4])
                share = (fx if corner % 2 else 1.0 - fx) * (fy if corner // 2 else 1.0 - fy)
                value += share * alphas[first + width * row + column]
            total += (1.0 - fraction if finer == 0 else fraction) * value
        first, width, height = first + width * height, max(width // 2, 1), max(height // 2, 1)
    return total / count


@exact
def _wrapped(index: Any, size: Any, wrap: Any) -> Any:
    """Return a texel's index within [0, size), by the number of a way in `WRAPS`."""
    if wrap == 1:
        return min(max(index, 0), size - 1)
    within = index % (2 * size if wrap == 2 else size)
    return min(within, 2 * size - 1 - within)
