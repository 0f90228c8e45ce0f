# SPDX-License-Identifier: Apache-2.0
"""Output variables of a layer (AOVs) for compositors: each kind of light apart, and the geometry of the surfaces.

All colours are linear Rec.709, premultiplied by alpha, and attenuated by the water in front, so

    beauty    = diffuse + glossy + sun + lamps + emission + veil + shafts + snow    (caustics is a part of sun)
    composite = beauty + (1 - alpha) (plate + receiver_difference)
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.shot import Shot
from mr360uw.types import Floats, Layer

SUMS = ("diffuse", "glossy", "sun", "lamps", "caustics", "emission", "veil", "transmittance", "normal", "position")
"""Variables summed over a pixel's surfaces, weighted by their fraction of it; (h, w, 3) each."""


@dataclass(frozen=True, slots=True, eq=False)
class Aovs:
    """Arbitrary output variables of a frame, (H, W, 3) unless noted; zero where there is no object.

    diffuse, glossy: reflected ambient light. sun, lamps: their reflected light; caustics: its change by the waves, of
    either sign. emission. veil: light scattered by the water in front of the objects; shafts: its change by waves,
    bodies and lamps, of either sign. All these are premultiplied, and attenuated by the water and by the snow before
    the objects. snow: light of marine snow; behind objects, what they let pass. transmittance: of the water, mean over
    the objects in a pixel, 1 where there is none. normal: unit in the world, position [m] in the world, means likewise.
    object_id: (H, W) uint32, 1 for the first visible object, 0 for none; the one with the largest share.
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

    def cut(self, kept: Floats) -> Aovs:
        """Return the variables of which a fraction `kept` (H, W) of the objects' samples is left, 0 to 1."""
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        gone = kept == 0.0
        for name, image in values.items():
            if name in ("transmittance", "normal", "position", "object_id"):
                nothing = 1.0 if name == "transmittance" else 0
                values[name] = np.where(gone if image.ndim == 2 else gone[..., None], nothing, image)
            else:
                values[name] = image * kept[..., None]
        return Aovs(**{name: image.astype(getattr(self, name).dtype) for name, image in values.items()})


class AovFrame:
    """Sums of a frame's output variables while its surfaces are drawn."""

    def __init__(self, shot: Shot) -> None:
        size = shot.view.height, shot.view.width
        self.sums: dict[str, Floats] = {name: np.zeros((*size, 3), np.float32) for name in SUMS}
        self.share = np.zeros(size, np.float32)
        self.object_id = np.zeros(size, np.uint32)
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
        self.share[at], self.object_id[at] = share[order], number + 1

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
        return Aovs(**{name: v.astype(np.float32) for name, v in values.items()}, object_id=ids)


def receiver_difference(plate_linear: Floats, layer: Layer) -> Floats:
    """Return the change (H, W, 3) of the plate by shadows, caustics, lamps and shafts, without the objects."""
    from mr360uw.composite.tiles import over

    bare = (replace(t, radiance=np.zeros_like(t.radiance), alpha=np.zeros_like(t.alpha)) for t in layer.tiles)
    return over(plate_linear, replace(layer, tiles=tuple(bare))) - plate_linear


RECIPE = "linear Rec.709, premultiplied by A; composite = RGB + (1 - A) * (plate + receiver_difference)"
"""Comment in the header of a layered file."""
Part = dict[str, NDArray[np.generic]]
"""Channels of a part of an EXR file by name."""
_FARTHEST_M = 1e10
_HALF = float(np.finfo(np.float16).max)


def exr_parts(layer: Layer, aovs: Aovs, plate_linear: Floats) -> dict[str, dict[str, NDArray[np.generic]]]:
    """Return the parts of a layered EXR, {part: {channel: array}}, half floats but for depth, position and number.

    rgba: the beauty and alpha. depth: Z, the distance along the ray [m], 1e10 where there is none. N, P: X, Y, Z of the
    normal and the position [m]. id: Y, of the object. diffuse, glossy, sun, lamps, caustics, emission, veil,
    shafts (before objects), snow, transmittance, shadow_ratio, plate_shafts (before the plate, a part of the next),
    receiver_difference (of shadow, caustics, lamps and shafts): R, G, B. Every channel is named layer.channel, as the
    format asks for (OpenEXR, "Channel Naming"), except those of rgba and depth, which have standard names.
    """
    of_light = *SUMS[:7], "shafts", "snow", "transmittance"
    colours = {name: getattr(aovs, name) for name in of_light} | {"shadow_ratio": layer.ratio}
    colours |= {"plate_shafts": layer.shafts, "receiver_difference": receiver_difference(plate_linear, layer)}
    parts: dict[str, dict[str, NDArray[np.generic]]] = {
        "rgba": {"RGBA": _half(np.concatenate([layer.radiance, layer.alpha[..., None]], axis=-1))},
        "depth": {"Z": np.minimum(layer.distance_m, _FARTHEST_M).astype(np.float32)},
        "N": {f"N.{axis}": _half(aovs.normal[..., k]) for k, axis in enumerate("XYZ")},
        "P": {f"P.{axis}": aovs.position[..., k].astype(np.float32) for k, axis in enumerate("XYZ")},
        "id": {"id.Y": aovs.object_id},
    }
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
