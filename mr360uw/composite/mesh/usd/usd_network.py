# SPDX-License-Identifier: Apache-2.0
"""Shading networks of USD: constants and textures that the inputs of a shader are fed from.

Nodes: UsdUVTexture, UsdTransform2d and UsdPrimvarReader (UsdPreviewSurface specification, section "Core Nodes").
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from mr360uw.composite.mesh.material import MapCoordinates
from mr360uw.composite.mesh.texture import Wrap

_WRAPS: dict[str, Wrap] = {"repeat": "repeat", "mirror": "mirror", "clamp": "clamp", "black": "clamp"}
"""Edges of textures; black ones are not drawn. `useMetadata`, the default, is repeat: images hold no such metadata."""


@dataclass(frozen=True, slots=True)
class Sampled:
    """An input fed from a texture: its file, the channels read ("rgb", "r", ...), value = scale texture + bias."""

    file: Any = field(compare=False)
    name: str
    channels: str
    coordinates: MapCoordinates
    wrap: tuple[Wrap, Wrap]
    color_space: str
    scale: tuple[float, ...]
    bias: tuple[float, ...]


Fed = Sampled | str | tuple[float, ...]
"""What an input is fed from: a texture, a primvar of the mesh by its name, or constants."""
PLAIN = MapCoordinates("st")


def fed(shader: Any, name: str, default: tuple[float, ...], time: Any) -> tuple[Fed, str]:
    """Return what an input of a shader is fed from, constants as tuples, and what cannot be followed or "".

    time: a UsdTimeCode.
    """
    from pxr import UsdShade

    given = shader.GetInput(name)
    for source in given.GetValueProducingAttributes() if given else ():
        if UsdShade.Output.IsOutput(source):
            node = UsdShade.Shader(source.GetPrim())
            return _of_node(node, source.GetName().split(":", 1)[-1], default, time)
        value = source.Get(time)
        if value is not None:
            return tuple(float(v) for v in np.ravel(np.asarray(value, np.float64))), ""
    return default, ""


def _of_node(node: Any, output: str, default: tuple[float, ...], time: Any) -> tuple[Fed, str]:
    kind = str(node.GetIdAttr().Get())
    if kind.startswith("UsdPrimvarReader_float"):
        return _text(node, "varname", time, "displayColor"), ""
    if kind != "UsdUVTexture":
        return default, f"a node {kind}"
    file = _value(node, "file", time)
    if file is None or not file.path:
        return default, "a texture without a file"
    if "<UDIM>" in file.path:
        return default, f"tiled textures ({file.path})"
    coordinates, unread = _coordinates(node, time)
    wrap = tuple(_WRAPS.get(_text(node, side, time, "useMetadata"), "repeat") for side in ("wrapS", "wrapT"))
    scale, bias = (_four(node, side, time, first) for side, first in (("scale", 1.0), ("bias", 0.0)))
    space = _text(node, "sourceColorSpace", time, "auto")
    name = str(file.resolvedPath) or file.path
    return Sampled(file, name, output, coordinates, (wrap[0], wrap[1]), space, scale, bias), unread


def _coordinates(node: Any, time: Any) -> tuple[MapCoordinates, str]:
    """Return the texture coordinates of a UsdUVTexture, and what cannot be followed or "".

    UsdTransform2d turns anticlockwise where v points up.
    """
    reader, found = _before(node, "st"), PLAIN
    if reader is not None and _kind(reader) == "UsdTransform2d":
        x, y = (float(v) for v in _value(reader, "scale", time) or (1.0, 1.0))
        right, up = (float(v) for v in _value(reader, "translation", time) or (0.0, 0.0))
        turn = -float(np.radians(float(_value(reader, "rotation", time) or 0.0)))
        found = MapCoordinates("st", (right, up), turn, (x, y))
        reader = _before(reader, "in")
    if reader is None:
        return found, ""
    if _kind(reader) != "UsdPrimvarReader_float2":
        return found, f"texture coordinates of a node {_kind(reader)}"
    return replace(found, name=_text(reader, "varname", time, "st")), ""


def _before(node: Any, name: str) -> Any:
    """Return the shader that feeds an input, or None."""
    from pxr import UsdShade

    given = node.GetInput(name)
    for source in given.GetValueProducingAttributes(True) if given else ():
        return UsdShade.Shader(source.GetPrim())
    return None


def _kind(node: Any) -> str:
    return str(node.GetIdAttr().Get())


def _value(node: Any, name: str, time: Any) -> Any:
    given = node.GetInput(name)
    for source in given.GetValueProducingAttributes() if given else ():
        return source.Get(time)
    return None


def _text(node: Any, name: str, time: Any, default: str) -> str:
    value = _value(node, name, time)
    return default if value in (None, "") else str(value)


def _four(node: Any, name: str, time: Any, default: float) -> tuple[float, ...]:
    value = _value(node, name, time)
    return (default,) * 4 if value is None else tuple(float(v) for v in value)
