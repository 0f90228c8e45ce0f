# SPDX-License-Identifier: Apache-2.0
"""The meshes of a USD file where its prims put them, in metres, y up.

What varies with time is drawn as it is first; skeletons are not followed.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.input_files import DATA, PRIMS, TRIANGLES, neighbour, note_read, read_data
from mr360uw.composite.mesh.gltf import BROKEN
from mr360uw.composite.mesh.material import MeshFile, Part, decode_image
from mr360uw.composite.mesh.polygons import Polygons, placed, polygons_of
from mr360uw.composite.mesh.up_axis import UPRIGHT
from mr360uw.composite.mesh.usd_material import PLAIN, UNBOUND, Look, UsdMaterialReader
from mr360uw.errors import MeshError, install_command, installed
from mr360uw.types import Floats


def read_usd(path: Path, *, outside: bool = False) -> MeshFile:
    """Return the contents of a .usd, .usda, .usdc or .usdz; outside: as of `open_stage`. Raises `MeshError`."""
    stage = open_stage(path, outside=outside)
    from pxr import Tf

    try:
        return _StageReader(path, stage, outside=outside).read()
    except (*BROKEN, Tf.ErrorException) as error:
        what = f"{type(error).__name__}: {' '.join(str(error).split()):.120}"
        raise MeshError(f"{path} - is not valid USD (got {what}) - export it again") from error


class _StageReader:
    """Walks the prims of a stage."""

    def __init__(self, path: Path, stage: Any, *, outside: bool) -> None:
        from pxr import Usd, UsdGeom

        self.path = path
        self.stage = stage
        self.time = Usd.TimeCode.EarliestTime()
        self.cache = UsdGeom.XformCache(self.time)
        self.within: list[Any] = []  # paths of the instancers about a prim
        self.notes: dict[str, None] = {}  # in order, once each
        self._note = functools.partial(_note, path, self.notes)  # no reference to the reader: stages end with it
        self.looks: list[Look] = []
        self.numbers: dict[tuple[str, bool], int] = {}
        self.triangles = 0

        def pixels(asset: Any) -> Any:
            return decode_image(asset_bytes(path, asset, outside=outside), f"{path} {asset.path}")

        self.reader = UsdMaterialReader(pixels, self._note, self.time)

    def read(self) -> MeshFile:
        from pxr import Usd, UsdGeom

        upright = np.eye(4)
        upright[:3, :3] = UPRIGHT["z" if UsdGeom.GetStageUpAxis(self.stage) == UsdGeom.Tokens.z else "y"]
        root, every = self.stage.GetPseudoRoot(), Usd.TraverseInstanceProxies()
        parts = [part for prim, places in self._meshes(root, [upright], every) for part in self._parts(prim, places)]
        kinds = {str(prim.GetTypeName()) for prim in self.stage.Traverse()}
        if any(kind.endswith("Light") for kind in kinds):
            self._note("has lights - the scene's light is drawn; add [[lamp]] tables to it")
        if "Camera" in kinds:
            self._note("has a camera - it is not used - the camera of the scene is")
        metres = float(UsdGeom.GetStageMetersPerUnit(self.stage))
        if not 0.0 < metres < np.inf:
            raise ValueError(f"a unit of {metres:g} m")
        return MeshFile(tuple(parts), tuple(material for material, *_ in self.looks), tuple(self.notes), unit_m=metres)

    def _parts(self, prim: Any, places: list[Floats]) -> Iterator[Part]:
        """Yield the parts of a mesh, by material and place."""
        corners, own, polygons, flat = self._shape(prim)
        self.triangles += len(polygons.faces) * len(places)
        TRIANGLES.check(str(self.path), self.triangles, MeshError)
        name = str(prim.GetPath()).lstrip("/")
        for number, chosen in self._materials(prim, polygons):
            _, coordinates, primvar = self.looks[number]
            uv = self._primvar(prim, polygons, coordinates.name, 2)
            # from right and up from the bottom left to right and down from the top left
            uv = None if uv is None else coordinates.of(uv) * [1.0, -1.0] + [0.0, 1.0]
            colors = self._colors(prim, polygons, primvar) if primvar else None
            for place in places:
                positions, normals, turned = placed(place, corners, own, polygons.faces[chosen])
                yield Part(name, positions, turned, normals, uv, colors, number, flat)

    def _shape(self, prim: Any) -> tuple[Floats, Floats | None, Polygons, bool]:
        """Return a UsdGeomMesh: positions and normals by corner, polygons, and whether it is flat without normals."""
        from pxr import UsdGeom

        mesh = UsdGeom.Mesh(prim)
        if mesh.GetPointsAttr().ValueMightBeTimeVarying() or prim.HasAPI("SkelBindingAPI"):
            self._note("has a mesh that changes its shape - it is drawn as it is first; export it as glTF to play it")
        points = np.asarray(_or_empty(mesh.GetPointsAttr().Get(self.time)), np.float64).reshape(-1, 3)
        counts = _or_empty(mesh.GetFaceVertexCountsAttr().Get(self.time))
        corners = _or_empty(mesh.GetFaceVertexIndicesAttr().Get(self.time))
        holes = _or_empty(mesh.GetHoleIndicesAttr().Get(self.time))
        left = mesh.GetOrientationAttr().Get(self.time) == UsdGeom.Tokens.leftHanded
        polygons = polygons_of(points, counts, corners, left_handed=left, holes=holes)
        subdivided = mesh.GetSubdivisionSchemeAttr().Get(self.time) != UsdGeom.Tokens.none
        if subdivided:
            self._note("has a subdivision surface - its polygons are drawn, with smooth normals")
        normals = self._primvar(prim, polygons, "normals", 3)
        if normals is None and (given := mesh.GetNormalsAttr().Get(self.time)):
            normals = polygons.at_corners(given, str(mesh.GetNormalsInterpolation()), "normals")
        return points[polygons.corners], normals, polygons, not subdivided

    def _primvar(self, prim: Any, polygons: Polygons, name: str, width: int) -> Floats | None:
        """Return a primvar (C, width) by corner, or None."""
        from pxr import UsdGeom

        primvar = UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance(name)
        values = primvar.ComputeFlattened(self.time) if primvar and primvar.HasValue() else None
        if values is None:
            return None
        array = np.asarray(values, np.float64).reshape(-1, width)
        return polygons.at_corners(array, str(primvar.GetInterpolation()), name)

    def _colors(self, prim: Any, polygons: Polygons, name: str) -> Floats | None:
        rgb = self._primvar(prim, polygons, name, 3)
        if rgb is not None and np.any(rgb < 0.0):
            raise ValueError(f"a colour is negative: {rgb.min():g}")
        return None if rgb is None else np.concatenate([rgb, np.ones((len(rgb), 1))], axis=1)

    def _materials(self, prim: Any, polygons: Polygons) -> Iterator[tuple[int, NDArray[np.bool_]]]:
        """Yield the number of each material of a mesh and which triangles (T,) it has."""
        from pxr import UsdShade

        rest = np.ones(len(polygons.counts), bool)
        for subset in UsdShade.MaterialBindingAPI(prim).GetMaterialBindSubsets():
            chosen = np.zeros_like(rest)
            chosen[np.asarray(_or_empty(subset.GetIndicesAttr().Get(self.time)), np.int64)] = True
            if np.any((chosen & rest)[polygons.polygon]):
                yield self._number(subset.GetPrim(), prim), (chosen & rest)[polygons.polygon]
            rest &= ~chosen
        if np.any(rest[polygons.polygon]):
            yield self._number(prim, prim), rest[polygons.polygon]

    def _number(self, bound: Any, prim: Any) -> int:
        """Return the number of the material that is bound to a mesh or a part of one."""
        from pxr import UsdGeom, UsdShade

        material = UsdShade.MaterialBindingAPI(bound).ComputeBoundMaterial()[0]
        both_sides = bool(UsdGeom.Mesh(prim).GetDoubleSidedAttr().Get(self.time))
        key = (str(material.GetPath()) if material else self._color_name(prim), both_sides)
        if key not in self.numbers:
            look, coordinates, primvar = self.reader.read(material) if material else self._unbound(key[0])
            self.numbers[key] = len(self.looks)
            self.looks.append((replace(look, double_sided=both_sides), coordinates, primvar))
        return self.numbers[key]

    def _color_name(self, prim: Any) -> str:
        from pxr import UsdGeom

        primvar = UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance("displayColor")
        return "displayColor" if primvar and primvar.HasValue() else ""

    def _unbound(self, color: str) -> Look:
        if not color:
            self._note("has parts without material and colours - they are grey")
        return (replace(UNBOUND, base_color=(1.0, 1.0, 1.0, 1.0)) if color else UNBOUND), PLAIN, color

    def _meshes(self, root: Any, places: list[Floats], which: Any) -> Iterator[tuple[Any, list[Floats]]]:
        """Yield every mesh below a prim and where it is shown: transforms (4, 4) from its own axes.

        places: transforms from the axes of the stage's world, one for each repetition. which: predicate of the prims.
        """
        from pxr import Usd, UsdGeom

        walk = iter(Usd.PrimRange(root, which))
        for prim in walk:
            if not self._shown(prim):
                walk.PruneChildren()
            elif prim.IsA(UsdGeom.PointInstancer):
                walk.PruneChildren()
                yield from self._instances(UsdGeom.PointInstancer(prim), places)
            elif prim.IsA(UsdGeom.Mesh):
                own = self._world(prim)
                yield prim, [place @ own for place in places]
            elif prim.IsA(UsdGeom.Gprim):
                self._note(f"has a {prim.GetTypeName()}, which is not drawn - convert it to a mesh")

    def _shown(self, prim: Any) -> bool:
        """Return whether a prim is visible, as far as it tells by itself, and meant for the final picture."""
        from pxr import UsdGeom

        imageable = UsdGeom.Imageable(prim)
        if not imageable:
            return True
        hidden = imageable.GetVisibilityAttr().Get(self.time) == UsdGeom.Tokens.invisible
        return not hidden and imageable.GetPurposeAttr().Get() in (UsdGeom.Tokens.default_, UsdGeom.Tokens.render, None)

    def _world(self, prim: Any) -> Floats:
        """Return the transform (4, 4), for columns, from a prim's axes to the stage's."""
        from pxr import UsdGeom

        if UsdGeom.Xformable(prim).TransformMightBeTimeVarying():
            self._note("moves - it is drawn as it is first; glTF and the scene's own keys can move it")
        return np.asarray(self.cache.GetLocalToWorldTransform(prim), np.float64).T

    def _instances(self, instancer: Any, places: list[Floats]) -> Iterator[tuple[Any, list[Floats]]]:
        """Yield the meshes of a UsdGeomPointInstancer's prototypes, each with all its places."""
        from pxr import Usd, UsdGeom

        if instancer.GetPath() in self.within:
            raise ValueError(f"{instancer.GetPath()} repeats itself")
        ignored = UsdGeom.PointInstancer.IgnoreMask
        found = instancer.ComputeInstanceTransformsAtTime(
            self.time, self.time, UsdGeom.PointInstancer.IncludeProtoXform, ignored
        )
        transforms = np.asarray(found, np.float64).reshape(-1, 4, 4).swapaxes(1, 2)
        which = np.asarray(instancer.GetProtoIndicesAttr().Get(self.time), np.int64)
        mask = np.asarray(instancer.ComputeMaskAtTime(self.time) or [True] * len(which), bool)
        if len(transforms) != len(which):
            raise ValueError(f"{len(which)} instances with {len(transforms)} transforms")
        own = self._world(instancer.GetPrim())
        any_prim = Usd.TraverseInstanceProxies(Usd.PrimIsActive & Usd.PrimIsLoaded)
        for number, target in enumerate(instancer.GetPrototypesRel().GetForwardedTargets()):
            root = self.stage.GetPrimAtPath(target)
            if not root:
                raise ValueError(f"no prototype {target}")
            back = np.linalg.inv(self._world(root))
            shown = np.flatnonzero((which == number) & mask)
            moved = [place @ own @ transforms[k] @ back for k in shown for place in places]
            if moved:
                self.within.append(instancer.GetPath())
                yield from self._meshes(root, moved, any_prim)
                self.within.pop()


def _note(path: Path, notes: dict[str, None], text: str) -> None:
    notes[f"{path} - {text}"] = None


def _or_empty(values: Any) -> Any:
    """Return an attribute's values, or none where it has none."""
    return () if values is None else values


# Stages of USD (Universal Scene Description): opened with the files that they name, which are checked first.
#
# A stage is composed of layers, each a file of its own or one in a .usdz package; textures are further files.
#
# Before layers are composed, the prims that they make are counted. A prim that refers to one that refers to ten others
# has all of them. A few lines can so make any number of prims, and composing them takes the memory at once.

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
