# SPDX-License-Identifier: Apache-2.0
"""Small USD files, made by the package usd-core; without it the tests that import this are skipped."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

pytest.importorskip("pxr", reason="needs mr360uw[usd]")
from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade, UsdUtils, Vt

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)
"""The square of `GltfFile.square`."""


def new_stage(path: Path, *, up: str = "Y", metres: float = 1.0) -> Any:
    """Return a new stage that is saved to a file."""
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, up)
    UsdGeom.SetStageMetersPerUnit(stage, metres)
    return stage


def add_mesh(
    stage: Any, place: str, points: Any, faces: Any, *, normals: Any = None, st: Any = None, **more: Any
) -> Any:
    """Return a new mesh of polygons `faces`, by point; st is by corner. more: attributes by name."""
    mesh = UsdGeom.Mesh.Define(stage, place)
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(points, np.float32)))
    mesh.CreateFaceVertexCountsAttr([len(face) for face in faces])
    mesh.CreateFaceVertexIndicesAttr([int(corner) for face in faces for corner in face])
    mesh.CreateSubdivisionSchemeAttr(more.pop("scheme", "none"))
    if normals is not None:
        mesh.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(normals, np.float32)))
        mesh.SetNormalsInterpolation(more.pop("normals_by", "vertex"))
    if st is not None:
        primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, "faceVarying")
        primvar.Set(Vt.Vec2fArray.FromNumpy(np.ascontiguousarray(st, np.float32)))
    for name, value in more.items():
        mesh.GetPrim().GetAttribute(name).Set(value)
    return mesh


def add_square(stage: Any, place: str, **more: Any) -> Any:
    """Return a new square."""
    return add_mesh(
        stage, place, CORNERS, [[0, 1, 2, 3]], normals=np.tile([0, 0, 1.0], (4, 1)), st=CORNERS[:, :2], **more
    )


def add_material(stage: Any, place: str, **inputs: Any) -> Any:
    """Return a new material with a UsdPreviewSurface of these inputs: numbers, colours, or `add_texture`s."""
    material = UsdShade.Material.Define(stage, place)
    surface = UsdShade.Shader.Define(stage, f"{place}/surface")
    surface.CreateIdAttr("UsdPreviewSurface")
    for name, value in inputs.items():
        color = isinstance(value, tuple) and len(value) == 3
        kind = {int: "Int", float: "Float"}.get(type(value), "Color3f" if color or name.endswith("Color") else "Float")
        given = surface.CreateInput(name, getattr(Sdf.ValueTypeNames, kind))
        if isinstance(value, UsdShade.Output):
            given.ConnectToSource(value)
        else:
            given.Set(Gf.Vec3f(*value) if color else value)
    material.CreateSurfaceOutput().ConnectToSource(surface.ConnectableAPI(), "surface")
    return material


def add_texture(stage: Any, place: str, file: str, output: str = "rgb", transform: Any = None, **inputs: Any) -> Any:
    """Return an output of a new texture. inputs: wrapS, scale ...; transform: (degrees, scale, move)."""
    kinds = Sdf.ValueTypeNames
    reader = UsdShade.Shader.Define(stage, f"{place}_st")
    reader.CreateIdAttr("UsdPrimvarReader_float2")
    reader.CreateInput("varname", kinds.String).Set("st")
    source = reader.CreateOutput("result", kinds.Float2)
    if transform is not None:
        moved = UsdShade.Shader.Define(stage, f"{place}_moved")
        moved.CreateIdAttr("UsdTransform2d")
        moved.CreateInput("in", kinds.Float2).ConnectToSource(source)
        for name, kind, value in zip(
            ("rotation", "scale", "translation"), (kinds.Float, kinds.Float2, kinds.Float2), transform, strict=True
        ):
            moved.CreateInput(name, kind).Set(value)
        source = moved.CreateOutput("result", kinds.Float2)
    node = UsdShade.Shader.Define(stage, place)
    node.CreateIdAttr("UsdUVTexture")
    node.CreateInput("file", kinds.Asset).Set(file)
    node.CreateInput("st", kinds.Float2).ConnectToSource(source)
    for name, value in {"wrapS": "repeat", "wrapT": "repeat", **inputs}.items():
        node.CreateInput(name, kinds.Token if isinstance(value, str) else kinds.Float4).Set(value)
    return node.CreateOutput(output, kinds.Float3 if output == "rgb" else kinds.Float)


def bind(mesh: Any, material: Any) -> None:
    """Give a mesh, or a part of one, a material."""
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)


def write_png(path: Path, image: np.ndarray) -> str:
    """Write code values, RGB(A), and return the name of the file as its neighbours call it."""
    order = [2, 1, 0, 3][: image.shape[2]]
    cv2.imwrite(str(path), np.ascontiguousarray(image[..., order]))
    return f"./{path.name}"


def packed(path: Path) -> Path:
    """Return a .usdz of a stage that was saved, with all its textures."""
    out = path.with_suffix(".usdz")
    assert UsdUtils.CreateNewUsdzPackage(Sdf.AssetPath(str(path)), str(out))
    return out
