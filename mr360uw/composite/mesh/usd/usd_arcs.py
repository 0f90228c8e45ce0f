# SPDX-License-Identifier: Apache-2.0
"""What the layers of a USD file name, before they are composed: how many prims they make, files of value clips.

A prim that refers to one that refers to ten others has all of them. A few lines can so make any number of prims, and
composing them takes the memory at once.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

_DEEPEST = 200
"""Prims within prims, by nesting and reference, that are followed; more count as without end."""
ENDLESS = 10**18


def composed_prims(layers: Sequence[Any]) -> int:
    """Return the number of prims that layers compose to, at most `ENDLESS`; the first one is the file's own.

    Every reference, payload, inherited and specialised prim and every variant counts, as if all were shown.
    """
    arcs = _Arcs({layer.identifier: layer for layer in layers}, {})
    return min(sum(arcs.count(layer, prim, 0) for layer in layers for prim in layer.rootPrims), ENDLESS)


@dataclass(frozen=True, slots=True)
class _Arcs:
    """Counts what prims compose to. layers: by their identifier; known: numbers by layer and path."""

    layers: dict[str, Any]
    known: dict[tuple[str, Any], int]

    def count(self, layer: Any, prim: Any, depth: int) -> int:
        """Return the number of prims that one composes to, itself included."""
        key = layer.identifier, prim.path
        if key not in self.known:
            self.known[key] = 0  # of a circle, which USD leaves out
            parts = self._parts(layer, prim) if depth <= _DEEPEST else ()
            below = sum(self.count(*one, depth + 1) for one in parts)
            self.known[key] = min(1 + below, ENDLESS) if depth <= _DEEPEST else ENDLESS
        return self.known[key]

    def _parts(self, layer: Any, prim: Any) -> Iterator[tuple[Any, Any]]:
        """Yield the prims, each with its layer, that one consists of or refers to."""
        yield from ((layer, child) for child in prim.nameChildren)
        for choices in prim.variantSets.values():
            yield from ((layer, variant.primSpec) for variant in choices.variants.values())
        for arc in (*prim.referenceList.GetAddedOrExplicitItems(), *prim.payloadList.GetAddedOrExplicitItems()):
            place = layer.ComputeAbsolutePath(arc.assetPath) if arc.assetPath else layer.identifier
            yield from self._target(self.layers.get(place), arc.primPath)
        for path in (*prim.inheritPathList.GetAddedOrExplicitItems(), *prim.specializesList.GetAddedOrExplicitItems()):
            yield from self._target(layer, path)

    def _target(self, layer: Any, path: Any) -> Iterator[tuple[Any, Any]]:
        if layer is not None:
            found = layer.GetPrimAtPath(path) if not path.isEmpty else layer.rootPrims.get(layer.defaultPrim)
            if found is not None:
                yield layer, found


def clip_assets(layer: Any) -> list[str]:
    """Return the files that value clips of a layer's prims name (UsdClipsAPI), as they are written."""
    found: list[str] = []

    def look(path: Any) -> None:
        spec = layer.GetPrimAtPath(path)
        clips = spec.GetInfo("clips") if spec is not None and path.IsPrimPath() else None
        for clip in (clips or {}).values():
            assets = [*(clip.get("assetPaths") or ()), clip.get("manifestAssetPath"), clip.get("templateAssetPath")]
            found.extend(str(getattr(asset, "path", asset)) for asset in assets if asset)

    layer.Traverse("/", look)
    return found
