# SPDX-License-Identifier: Apache-2.0
"""Shading networks of USD: constants and textures that the inputs of a shader are fed from.

Nodes: UsdUVTexture, UsdTransform2d and UsdPrimvarReader (UsdPreviewSurface specification, section "Core Nodes").
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mr360uw.composite.mesh.texture import Wrap
from mr360uw.types import Floats

_WRAPS: dict[str, Wrap] = {"repeat": "repeat", "mirror": "mirror", "clamp": "clamp", "black": "clamp"}
"""Edges of textures; black ones are not drawn. `useMetadata`, the default, is repeat: images hold no such metadata."""


@dataclass(frozen=True, slots=True)
class UsdCoordinates:
    """Texture coordinates of a map: the name of their primvar, and UsdTransform2d."""

    primvar: str = "st"
    rotation_deg: float = 0.0
    scale: tuple[float, float] = (1.0, 1.0)
    translation: tuple[float, float] = (0.0, 0.0)

    def of(self, st: Floats) -> Floats:
        """Return coordinates (n, 2), right and down from the top left, of st (n, 2), right and up from the bottom left.

        They are scaled, then turned anticlockwise, then moved.
        """
        c, s = np.cos(np.radians(self.rotation_deg)), np.sin(np.radians(self.rotation_deg))
        moved = st * self.scale @ np.array([[c, s], [-s, c]]) + self.translation
        return np.asarray(moved * [1.0, -1.0] + [0.0, 1.0])


@dataclass(frozen=True, slots=True)
class Sampled:
    """An input fed from a texture: its file, the channels read ("rgb", "r", ...), value = scale texture + bias."""

    file: Any = field(compare=False)
    name: str
    channels: str
    coordinates: UsdCoordinates
    wrap: tuple[Wrap, Wrap]
    color_space: str
    scale: tuple[float, ...]
    bias: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class PrimvarColor:
    """An input fed from a colour of the mesh: the name of its primvar."""

    primvar: str


Fed = Sampled | PrimvarColor | tuple[float, ...]


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
        return PrimvarColor(_text(node, "varname", time, "displayColor")), ""
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


def _coordinates(node: Any, time: Any) -> tuple[UsdCoordinates, str]:
    """Return the texture coordinates of a UsdUVTexture, and what cannot be followed or ""."""
    reader, found = _before(node, "st"), UsdCoordinates()
    if reader is not None and _kind(reader) == "UsdTransform2d":
        x, y = (float(v) for v in _value(reader, "scale", time) or (1.0, 1.0))
        right, up = (float(v) for v in _value(reader, "translation", time) or (0.0, 0.0))
        found = UsdCoordinates("st", float(_value(reader, "rotation", time) or 0.0), (x, y), (right, up))
        reader = _before(reader, "in")
    if reader is None:
        return found, ""
    if _kind(reader) != "UsdPrimvarReader_float2":
        return found, f"texture coordinates of a node {_kind(reader)}"
    primvar = _text(reader, "varname", time, "st")
    return UsdCoordinates(primvar, found.rotation_deg, found.scale, found.translation), ""


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
