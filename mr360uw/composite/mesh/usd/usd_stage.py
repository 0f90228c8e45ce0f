# SPDX-License-Identifier: Apache-2.0
"""Stages of USD (Universal Scene Description): opened with the files that they name, which are checked first.

A stage is composed of layers, each a file of its own or one in a .usdz package; textures are further files.

Before layers are composed, the prims that they make are counted. A prim that refers to one that refers to ten others
has all of them. A few lines can so make any number of prims, and composing them takes the memory at once.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from mr360uw.errors import MeshError, install_command, installed
from mr360uw.reading.input_files import DATA, PRIMS, neighbour, note_read, read_data

_DEEPEST = 200
"""Prims within prims, by nesting and reference, that are followed; more count as without end."""
ENDLESS = 10**18


def composed_prims(layers: Sequence[Any]) -> int:
    """Return the number of prims that layers compose to, at most `ENDLESS`; the first one is the file's own.

    Every reference, payload, inherited and specialised prim and every variant counts, as if all were shown.
    """
    by_identifier = {layer.identifier: layer for layer in layers}
    known: dict[tuple[str, Any], int] = {}
    found = (_count(by_identifier, known, layer, prim, 0) for layer in layers for prim in layer.rootPrims)
    return min(sum(found), ENDLESS)


def _count(layers: dict[str, Any], known: dict[tuple[str, Any], int], layer: Any, prim: Any, depth: int) -> int:
    """Return the number of prims that one composes to, itself included.

    layers: by their identifier; known: numbers by layer and path.
    """
    key = layer.identifier, prim.path
    if key not in known:
        known[key] = 0  # of a circle, which USD leaves out
        parts = _parts(layers, layer, prim) if depth <= _DEEPEST else ()
        below = sum(_count(layers, known, *one, depth + 1) for one in parts)
        known[key] = min(1 + below, ENDLESS) if depth <= _DEEPEST else ENDLESS
    return known[key]


def _parts(layers: dict[str, Any], layer: Any, prim: Any) -> Iterator[tuple[Any, Any]]:
    """Yield the prims, each with its layer, that one consists of or refers to. layers: by their identifier."""
    yield from ((layer, child) for child in prim.nameChildren)
    for choices in prim.variantSets.values():
        yield from ((layer, variant.primSpec) for variant in choices.variants.values())
    targets = []
    for arc in (*prim.referenceList.GetAddedOrExplicitItems(), *prim.payloadList.GetAddedOrExplicitItems()):
        place = layer.ComputeAbsolutePath(arc.assetPath) if arc.assetPath else layer.identifier
        targets.append((layers.get(place), arc.primPath))
    own = (*prim.inheritPathList.GetAddedOrExplicitItems(), *prim.specializesList.GetAddedOrExplicitItems())
    targets += [(layer, path) for path in own]
    for other, path in targets:
        if other is not None:
            found = other.GetPrimAtPath(path) if not path.isEmpty else other.rootPrims.get(other.defaultPrim)
            if found is not None:
                yield other, found


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


def open_stage(path: Path, *, outside: bool = False) -> Any:
    """Return the composed stage of a file; outside: its layers may lie outside of the file's folder.

    Raises `MeshError` where usd-core is not installed, the file is damaged, or a layer is missing or lies outside.
    """
    if not installed("pxr"):
        raise MeshError(
            f"{path} - is USD, which needs the package usd-core - {install_command('usd')}, or export it as .glb"
        )
    from pxr import Tf, Usd

    try:
        layers = _layers(path, outside=outside)
        PRIMS.check(str(path), composed_prims(layers), MeshError)
        stage = Usd.Stage.Open(layers[0])
    except Tf.ErrorException as error:
        raise MeshError(f"{path} - is not valid USD (got: {_said(error)}) - export it again") from error
    return stage


def _said(error: Any) -> str:
    """Return what an error of USD says, without where in USD's own sources it was raised."""
    text = " ".join(str(error).split())
    return text.rsplit(" : ", 1)[-1].strip("' ")[:160] or type(error).__name__


def _layers(path: Path, *, outside: bool) -> list[Any]:
    """Return the opened layer of a file and all that it refers to, directly or not."""
    from pxr import Ar, Sdf

    found: dict[str, Any] = {}
    pending = [str(path)]
    while pending:
        name = pending.pop()
        if name in found:
            continue
        layer = Sdf.Layer.Find(name)
        if layer is not None:  # of a stage that is read beside this one
            layer.Reload()
        else:
            layer = Sdf.Layer.FindOrOpen(name)
        if layer is None:
            raise MeshError(f"{path} - is not valid USD (got a layer without contents: {name}) - export it again")
        found[name] = layer
        for asset in filter(None, [*layer.GetCompositionAssetDependencies(), *clip_assets(layer)]):
            place = Sdf.Layer.SplitIdentifier(layer.ComputeAbsolutePath(asset))[0]
            packaged = Ar.IsPackageRelativePath(place)
            file = Ar.SplitPackageRelativePathOuter(place)[0] if packaged else place
            _check_file(neighbour(path, file, "layer", outside=outside, shown=asset, exact=True))
            pending.append(place)
    note_read(path)
    return list(found.values())


def _check_file(file: Path) -> None:
    """Raise `MeshError` where a layer is too large, and note that it is read."""
    DATA.check(str(file), file.stat().st_size, MeshError)
    note_read(file)


def asset_bytes(path: Path, asset: Any, *, outside: bool = False) -> bytes:
    """Return the bytes of a texture's file, which may be in a package; raise `MeshError`.

    path: of the mesh file. asset: an Sdf.AssetPath. outside: the file may lie outside of the mesh file's folder.
    """
    from pxr import Ar

    place = str(asset.resolvedPath)
    if not Ar.IsPackageRelativePath(place):
        return read_data(neighbour(path, place or asset.path, "texture", outside=outside, shown=asset.path), MeshError)
    package = Ar.SplitPackageRelativePathOuter(place)[0]
    neighbour(path, package, "texture", outside=outside, shown=asset.path, exact=True)
    opened = Ar.GetResolver().OpenAsset(Ar.ResolvedPath(place))
    if opened is None:
        raise MeshError(f"{path} - a texture is missing (got {asset.path!r}) - export it again")
    DATA.check(place, opened.GetSize(), MeshError)
    return bytes(opened.GetBuffer())
