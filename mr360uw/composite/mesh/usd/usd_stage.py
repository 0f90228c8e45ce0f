# SPDX-License-Identifier: Apache-2.0
"""Stages of USD (Universal Scene Description): opened with the files that they name, which are checked first.

A stage is composed of layers, each a file of its own or one in a .usdz package; textures are further files.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mr360uw.composite.mesh.usd.usd_arcs import clip_assets, composed_prims
from mr360uw.errors import MeshError
from mr360uw.reading.extras import command, installed
from mr360uw.reading.files_read import note_read
from mr360uw.reading.input_files import read_data
from mr360uw.reading.limits import DATA, PRIMS
from mr360uw.reading.neighbours import neighbour

USD_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")


def open_stage(path: Path, *, outside: bool = False) -> Any:
    """Return the composed stage of a file; outside: its layers may lie outside of the file's folder.

    Raises `MeshError` where usd-core is not installed, the file is damaged, or a layer is missing or lies outside.
    """
    if not installed("pxr"):
        raise MeshError(f"{path} - is USD, which needs the package usd-core - {command('usd')}, or export it as .glb")
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
            _check_file(neighbour(path, file, "layer", outside=outside, shown=asset))
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
    neighbour(path, Ar.SplitPackageRelativePathOuter(place)[0], "texture", outside=outside, shown=asset.path)
    opened = Ar.GetResolver().OpenAsset(Ar.ResolvedPath(place))
    if opened is None:
        raise MeshError(f"{path} - a texture is missing (got {asset.path!r}) - export it again")
    DATA.check(place, opened.GetSize(), MeshError)
    return bytes(opened.GetBuffer())
