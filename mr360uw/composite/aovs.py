# SPDX-License-Identifier: Apache-2.0
"""Output variables of a layer (AOVs) for compositors: each kind of light apart, and the geometry of the surfaces.

All colours are linear, premultiplied by alpha, and attenuated by the water in front, so

    beauty    = diffuse + glossy + sun + lamps + emission + veil + shafts + snow    (caustics is a part of sun)
    composite = beauty + (1 - alpha) (plate + receiver_difference)
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.color import REC709_XY, rec709_from_chromaticities
from mr360uw.base.rays import barycentric
from mr360uw.composite.shot import PlacedObject, Shot
from mr360uw.types import Floats, Layer, View

SUMS = ("diffuse", "glossy", "sun", "lamps", "caustics", "emission", "veil", "transmittance", "normal", "position")
"""Variables summed over a pixel's surfaces, weighted by their fraction of it; (h, w, 3) each."""


@dataclass(frozen=True, slots=True, eq=False)
class Aovs:
    """Arbitrary output variables of a frame, (H, W, 3) unless noted; zero where there is no object.

    diffuse, glossy: reflected ambient light. sun, lamps: their reflected light; caustics: its change by the waves,
    of either sign. emission. veil: light scattered by the water in front of the objects; shafts: its change by
    waves, bodies and lamps, and what the blur by the water brings and takes, of either sign. All these are
    premultiplied, and attenuated by the water and by the snow before the objects. snow: light of marine snow;
    behind objects, what they let pass. transmittance: of the water, mean over the objects in a pixel, 1 where there
    is none. normal: unit in the world, position [m] in the world, means likewise. object_id: (H, W) uint32, 1 for
    the first visible object, 0 for none; the one with the largest share. triangle: (H, W) int32, the one of largest
    share, numbered through all visible objects, -1 for none. pieces: of surfaces, the number (n,) of their pixel,
    row by row, their triangle (n,), and their share (n,) of the pixel.
    """

    diffuse: Floats
    glossy: Floats
    sun: Floats
    lamps: Floats
    caustics: Floats
    emission: Floats
    veil: Floats
    shafts: Floats
    snow: Floats
    transmittance: Floats
    normal: Floats
    position: Floats
    object_id: NDArray[np.uint32]
    triangle: NDArray[np.int32]
    pieces: tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float32]]

    def cut(self, kept: Floats) -> Aovs:
        """Return the variables of which a fraction `kept` (H, W) of the objects' samples is left, 0 to 1."""
        pixel, triangle, share = self.pieces
        values = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "pieces"}
        gone = kept == 0.0
        for name, image in values.items():
            if name in ("transmittance", "normal", "position", "object_id", "triangle"):
                nothing = {"transmittance": 1.0, "triangle": -1}.get(name, 0)
                values[name] = np.where(gone if image.ndim == 2 else gone[..., None], nothing, image)
            else:
                values[name] = image * kept[..., None]
        images = {name: image.astype(getattr(self, name).dtype) for name, image in values.items()}
        return Aovs(**images, pieces=(pixel, triangle, share * kept.ravel()[pixel].astype(np.float32)))


class AovFrame:
    """Sums of a frame's output variables while its surfaces are drawn."""

    def __init__(self, shot: Shot) -> None:
        size = shot.view.height, shot.view.width
        self.sums: dict[str, Floats] = {name: np.zeros((*size, 3), np.float32) for name in SUMS}
        self.share = np.zeros(size, np.float32)
        self.object_id = np.zeros(size, np.uint32)
        self.triangle = np.full(size, -1, np.int32)
        self._pieces: list[tuple[NDArray[Any], ...]] = [(np.zeros(0, np.int64),) * 2 + (np.zeros(0, np.float32),)]
        self._ends = np.cumsum([len(placed.mesh.positions) for placed in shot.visible])

    def add(
        self, pixels: tuple[NDArray[np.int64], NDArray[np.int64]], share: Floats, values: Mapping[str, Floats],
        triangle: NDArray[np.int64],
    ) -> None:  # fmt: skip
        """Add the variables (n, 3) of surfaces, weighted by their share (n,) of pixels.

        pixels: rows and columns (n,); some may stand there several times. triangle: (n,) that the surfaces are on,
        numbered through all visible objects.
        """
        for name in SUMS:
            np.add.at(self.sums[name], pixels, (share[:, None] * values[name]).astype(np.float32))
        order = np.lexsort((-np.arange(len(share)), share))  # of several in a pixel, the largest is written last
        order = order[share[order] > self.share[pixels][order]]
        at = pixels[0][order], pixels[1][order]
        number = np.searchsorted(self._ends, triangle[order], side="right")
        self.share[at], self.object_id[at], self.triangle[at] = share[order], number + 1, triangle[order]
        place = np.asarray(pixels[0] * self.share.shape[1] + pixels[1], np.int64)
        self._pieces.append((place, triangle.astype(np.int64), share.astype(np.float32)))

    def finish(self, shot: Shot, layer: Layer) -> Aovs:
        """Return the variables, with the shot's mattes applied as to the layer. Shafts and snow come later."""
        alpha = layer.alpha
        covered = self.sums["transmittance"].max(axis=-1) > 0.0
        kept = np.ones_like(alpha)
        if shot.holdout is not None:
            kept -= np.clip(shot.holdout, 0.0, 1.0).astype(np.float32)
        if shot.holdout_distance_m is not None:
            kept *= alpha > 0.0
        coverage = np.where(covered & (kept > 0.0), alpha / np.maximum(kept, 1e-6), 1.0)[..., None]
        values = {name: total * kept[..., None] for name, total in self.sums.items()}
        shown = (covered & (alpha > 0.0))[..., None]
        values["transmittance"] = np.where(shown, self.sums["transmittance"] / np.maximum(coverage, 1e-6), 1.0)
        values["position"] = np.where(shown, self.sums["position"] / np.maximum(coverage, 1e-6), 0.0)
        length = np.linalg.norm(self.sums["normal"], axis=-1, keepdims=True)
        values["normal"] = np.where(shown, self.sums["normal"] / np.maximum(length, 1e-6), 0.0)
        ids = np.where(shown[..., 0], self.object_id, 0).astype(np.uint32)
        values["shafts"], values["snow"] = np.zeros_like(values["veil"]), np.zeros_like(values["veil"])
        pixel, triangle, share = (np.concatenate(one) for one in zip(*self._pieces, strict=True))
        return Aovs(
            **{name: v.astype(np.float32) for name, v in values.items()}, object_id=ids,
            triangle=np.where(shown[..., 0], self.triangle, -1).astype(np.int32),
            pieces=(pixel, triangle, share * kept.ravel()[pixel]),
        )  # fmt: skip


def receiver_difference(plate_linear: Floats, layer: Layer) -> Floats:
    """Return the change (H, W, 3) of the plate by shadows, caustics, lamps and shafts, without the objects."""
    from mr360uw.composite.tiles import over

    bare = (replace(t, radiance=np.zeros_like(t.radiance), alpha=np.zeros_like(t.alpha)) for t in layer.tiles)
    return over(plate_linear, replace(layer, tiles=tuple(bare))) - plate_linear


# --- Motion ---------------------------------------------------------------------------------------------------------


def motion(aovs: Aovs, shot: Shot, objects: Sequence[PlacedObject], view: View) -> Floats:
    """Return how far the surface in each pixel moves (H, W, 2) [px], right and up, from a shot to another instant.

    objects, view: then, the objects in the shot's order. The shorter way around the seam is taken. A point keeps its
    place in its triangle; 0 where there is none, and for meshes whose triangles are others then.
    """
    moved, first = np.zeros((*aovs.triangle.shape, 2), np.float32), 0
    for now, then in zip(shot.visible, (one for one in objects if one.visible), strict=True):
        count = len(now.mesh.positions)
        at = np.nonzero((aovs.triangle >= first) & (aovs.triangle < first + count))
        number, first = aovs.triangle[at] - first, first + count
        if not len(number) or len(then.mesh.positions) != count:
            continue
        # The place of each pixel's point in its triangle, where that is now, and then
        corners = now.to_world(now.mesh.positions[number])
        weights, _ = barycentric(corners - shot.view.position, aovs.position[at] - shot.view.position)
        here = np.einsum("nv,nvk->nk", weights, corners) - shot.view.position
        there = np.einsum("nv,nvk->nk", weights, then.to_world(then.mesh.positions[number])) - view.position
        x, y = (np.subtract(*one) for one in zip(view.places(there), shot.view.places(here), strict=True))
        moved[at] = np.stack([(x + 0.5 * view.width) % view.width - 0.5 * view.width, -y], axis=-1)
    return moved


# --- Cryptomatte ----------------------------------------------------------------------------------------------------

# Mattes of objects and materials by name (Friedman & Jones 2015, and the specification 1.2.0 of Psyop): pairs of a
# name's hash and its coverage of the pixel, by coverage, two pairs a part.

_RANKS = 6
"""Names that a pixel keeps."""


def murmur(text: str) -> int:
    """Return the hash MurmurHash3_x86_32 (Appleby) of a text in UTF-8, of seed 0."""
    data, mixed = text.encode(), 0
    for start in range(0, len(data), 4):
        block = data[start : start + 4]
        k = int.from_bytes(block, "little") * 0xCC9E2D51 & 0xFFFFFFFF
        mixed ^= ((k << 15 | k >> 17) & 0xFFFFFFFF) * 0x1B873593 & 0xFFFFFFFF
        if len(block) == 4:
            mixed = ((mixed << 13 | mixed >> 19) & 0xFFFFFFFF) * 5 + 0xE6546B64 & 0xFFFFFFFF
    mixed ^= len(data)
    for shift, factor in ((16, 0x85EBCA6B), (13, 0xC2B2AE35), (16, 1)):
        mixed = (mixed ^ mixed >> shift) * factor & 0xFFFFFFFF
    return mixed


def cryptomatte(aovs: Aovs, shot: Shot, names: Sequence[str]) -> tuple[dict[str, Part], dict[str, str]]:
    """Return the parts of two cryptomattes, CryptoObject and CryptoMaterial, and the header entries that name them.

    names: of the shot's objects. Materials have those of their files. Pieces that share a name are one.
    """
    # The names of objects and of materials, and which of them each triangle has
    seen = [(placed.mesh, name) for placed, name in zip(shot.objects, names, strict=True) if placed.visible]
    of_objects = [([name], np.zeros(len(mesh.positions), np.int64)) for mesh, name in seen]
    of_materials = [([one.name or "default" for one in mesh.materials], mesh.material) for mesh, _ in seen]
    parts: dict[str, Part] = {}
    header: dict[str, str] = {}
    for layer, of_meshes in (("CryptoObject", of_objects), ("CryptoMaterial", of_materials)):
        listed = sorted({name for some, _ in of_meshes for name in some})
        place = [np.searchsorted(listed, some)[own].astype(np.int64) for some, own in of_meshes]
        bits = np.array([murmur(name) for name in listed], np.uint32)
        special = np.isin(bits >> 23 & 255, (0, 255))  # no floats that programs change: zero, denormal, infinite, NaN
        bits ^= special.astype(np.uint32) << 23
        ranked = _ranked(aovs, np.concatenate([np.zeros(0, np.int64), *place]), bits.view(np.float32))
        for k in range(_RANKS // 2):
            four = np.moveaxis(ranked[..., 2 * k : 2 * k + 2, :].reshape(*ranked.shape[:2], 4), -1, 0)
            name = f"{layer}{k:02d}"
            parts[name] = {f"{name}.{one}": np.ascontiguousarray(four["RGBA".index(one)]) for one in "RGBA"}
        manifest = json.dumps({name: f"{number:08x}" for name, number in zip(listed, bits.tolist(), strict=True)})
        told = {"name": layer, "hash": "MurmurHash3_32", "conversion": "uint32_to_float32", "manifest": manifest}
        header |= {f"cryptomatte/{murmur(layer):08x}"[:19] + f"/{entry}": value for entry, value in told.items()}
    return parts, header


def _ranked(aovs: Aovs, of_triangle: NDArray[np.int64], hashes: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return hashes and coverages (H, W, ranks, 2) of the names that cover most. of_triangle: number of its name."""
    pixel, triangle, share = aovs.pieces
    found = np.zeros((aovs.triangle.size, _RANKS, 2), np.float32)
    if len(pixel):
        # Sum the shares of one name in one pixel, then number the names of a pixel by their sums
        key, inverse = np.unique(pixel * len(hashes) + of_triangle[triangle], return_inverse=True)
        covered = np.bincount(inverse, share)
        order = np.lexsort((-covered, key // len(hashes)))
        key, covered = key[order], covered[order]
        place = key // len(hashes)
        rank = np.arange(len(key)) - np.searchsorted(place, place)
        kept = (rank < _RANKS) & (covered > 0.0)
        found[place[kept], rank[kept]] = np.stack([hashes[key[kept] % len(hashes)], covered[kept]], axis=-1)
    return found.reshape(*aovs.triangle.shape, _RANKS, 2)


# --- Files ----------------------------------------------------------------------------------------------------------

RECIPE = (
    "linear light, premultiplied by A; composite = RGB + (1 - A) * (plate + receiver_difference), with the plate in "
    "the same primaries; Z is metres along the ray"
)
"""Comment in the header of a layered file."""
_FACTORS = ("transmittance", "shadow_ratio")
"""Parts that are no light: factors on light of Rec.709."""
Part = dict[str, NDArray[np.generic]]
"""Channels of a part of an EXR file by name."""
_FARTHEST_M = 1e10
_HALF = float(np.finfo(np.float16).max)


def exr_parts(
    layer: Layer, aovs: Aovs, plate_linear: Floats, moved: tuple[Floats, Floats] | None = None,
    primaries: tuple[float, ...] = REC709_XY,
) -> dict[str, dict[str, NDArray[np.generic]]]:  # fmt: skip
    """Return the parts of a layered EXR, {part: {channel: array}}, half floats but for depth, position and number.

    rgba: the beauty and alpha. depth: Z, the distance along the ray [m], 1e10 where there is none. N, P: X, Y, Z of the
    normal and the position [m]. id: Y, of the object. moved: `motion` to the frames after and before, which become
    forward and backward: u, v [px]. diffuse, glossy, sun, lamps, caustics, emission, veil,
    shafts (before objects), snow, transmittance, shadow_ratio, plate_shafts (before the plate, a part of the next),
    receiver_difference (of shadow, caustics, lamps and shafts): R, G, B. Every channel is named layer.channel, as the
    format asks for (OpenEXR, "Channel Naming"), except those of rgba and depth, which have standard names. primaries:
    chromaticities that light is given in; transmittance and shadow_ratio are factors on that of Rec.709.
    """
    of_light = *SUMS[:7], "shafts", "snow", "transmittance"
    colours = {name: getattr(aovs, name) for name in of_light} | {"shadow_ratio": layer.ratio}
    colours |= {"plate_shafts": layer.shafts, "receiver_difference": receiver_difference(plate_linear, layer)}
    beauty = layer.radiance
    if primaries != REC709_XY:
        turn = np.linalg.inv(rec709_from_chromaticities(np.reshape(primaries, (4, 2)))).T.astype(np.float32)
        colours = {name: image if name in _FACTORS else image @ turn for name, image in colours.items()}
        beauty = beauty @ turn
    parts: dict[str, dict[str, NDArray[np.generic]]] = {
        "rgba": {"RGBA": _half(np.concatenate([beauty, layer.alpha[..., None]], axis=-1))},
        "depth": {"Z": np.minimum(layer.distance_m, _FARTHEST_M).astype(np.float32)},
        "N": {f"N.{axis}": _half(aovs.normal[..., k]) for k, axis in enumerate("XYZ")},
        "P": {f"P.{axis}": aovs.position[..., k].astype(np.float32) for k, axis in enumerate("XYZ")},
        "id": {"id.Y": aovs.object_id},
    }
    for name, image in zip(("forward", "backward"), moved or (), strict=False):
        parts[name] = {f"{name}.u": image[..., 0], f"{name}.v": image[..., 1]}
    return parts | {name: {name: _half(image)} for name, image in colours.items()}


def stereo_parts(eyes: Mapping[str, dict[str, Part]]) -> tuple[dict[str, Part], dict[str, str]]:
    """Return the parts of a layered EXR of several eyes, "rgba.left" and so on, and the view of each.

    eyes: parts by "left" and "right". Each part names its view in its header (OpenEXR, "Storing Multi-View Images"):
    left and right in lower case, the left one first.
    """
    parts = {f"{name}.{view}": part for view, own in eyes.items() for name, part in own.items()}
    return parts, {f"{name}.{view}": view for view, own in eyes.items() for name in own}


def _half(image: Floats) -> NDArray[np.float16]:
    """Return half floats, clipped to their finite range."""
    return np.clip(image, -_HALF, _HALF).astype(np.float16)
