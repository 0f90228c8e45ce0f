# SPDX-License-Identifier: Apache-2.0
"""Materials of USD: UsdPreviewSurface as the metallic-roughness model of glTF, which it is but for its names.

Separate maps of roughness, metalness, occlusion and opacity are joined into the channels that `Material` has for them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.mesh.material import (
    MapCoordinates,
    Material,
    Pixels,
    Texture,
    Wrap,
    make_texture,
)

Look = tuple[Material, MapCoordinates, str]
"""A material, the texture coordinates of all its maps, and the primvar that its colours are taken from or ""."""
UNBOUND = Material("", (0.18, 0.18, 0.18, 1.0), roughness=0.5)
"""The defaults of UsdPreviewSurface: what a mesh without a material looks like."""
_CHANNELS = "rgba"
_WHITE = np.full((1, 1), 255, np.uint8)


class UsdMaterialReader:
    """Reads materials; every image is decoded once. pixels: returns a texture's code values. time: a UsdTimeCode."""

    def __init__(self, pixels: Callable[[Any], Pixels], note: Callable[[str], None], time: Any) -> None:
        self.note = note
        self.time = time
        self._decode = pixels
        self._pixels: dict[str, Pixels] = {}
        self._textures: dict[Any, Texture] = {}

    def read(self, bound: Any) -> Look:
        """Return a UsdShadeMaterial as a material."""
        name = str(bound.GetPrim().GetName())
        shader = bound.ComputeSurfaceSource()[0]
        if not shader or str(shader.GetIdAttr().Get()) != "UsdPreviewSurface":
            self.note(f"material {name!r} has no UsdPreviewSurface - it is grey - export one beside it")
            return replace(UNBOUND, name=name), PLAIN, ""
        return _Surface(self, shader, name).read()

    def pixels(self, source: Sampled) -> Pixels:
        """Return the code values (h, w, 3 or 4) of a texture."""
        if source.name not in self._pixels:
            self._pixels[source.name] = self._decode(source.file)
        return self._pixels[source.name]

    def texture(self, key: Any, make: Callable[[], Pixels], source: Sampled, *, srgb: bool) -> Texture:
        """Return a texture of code values, one for each key; source: gives its edges."""
        key = (key, source.wrap, srgb)
        if key not in self._textures:
            self._textures[key] = make_texture(make(), srgb=srgb, wrap=source.wrap)
        return self._textures[key]


class _Surface:
    """One UsdPreviewSurface that is read."""

    def __init__(self, reader: UsdMaterialReader, shader: Any, name: str) -> None:
        self.reader = reader
        self.shader = shader
        self.name = name
        self.coordinates: MapCoordinates | None = None

    def read(self) -> Look:
        # Follow each input to its number, map or primvar
        color, emission = self._fed("diffuseColor", 0.18, 0.18, 0.18), self._fed("emissiveColor", 0.0, 0.0, 0.0)
        opacity, normal = self._fed("opacity", 1.0), self._fed("normal", 0.0, 0.0, 1.0)
        cutoff = self._number("opacityThreshold", 0.0)
        base, base_map = self._base(color, opacity)
        glow, emission_map = self._color(emission)
        metallic, roughness, orm = self._metallic_roughness()
        occlusion = self._fed("occlusion", 1.0)
        # Say what is not drawn
        clear = isinstance(opacity, Sampled) or base[3] < 1.0
        if self._number("clearcoat", 0.0) > 0.0:
            self._note("has a clear coat, which is not drawn")
        if isinstance(self._fed("displacement", 0.0), Sampled) or self._number("displacement", 0.0) != 0.0:
            self._note("has a displacement, which is not drawn")
        # Make the material of them
        normal_map, normal_scale = self._normal(normal)
        index = self._number("ior", 1.5)
        material = Material(
            name=self.name,
            base_color=base,
            metallic=metallic,
            roughness=roughness,
            emission=glow,
            normal_scale=normal_scale,
            alpha_mode="MASK" if cutoff > 0.0 else "BLEND" if clear else "OPAQUE",
            alpha_cutoff=cutoff if cutoff > 0.0 else 0.5,
            refractive_index=index if index > 0.0 else 1.5,
            base_map=base_map,
            metallic_roughness_map=orm,
            normal_map=normal_map,
            occlusion_map=self._joined([occlusion, None, None]) if isinstance(occlusion, Sampled) else None,
            emission_map=emission_map,
        )
        if bad := material.wrong_factors:
            raise ValueError(f"a factor of material {self.name!r} that is negative or not finite: {bad[0]:g}")
        return material, self.coordinates or PLAIN, color if isinstance(color, str) else ""

    def _fed(self, name: str, *default: float) -> Fed:
        """Return what an input is fed from; a texture with coordinates of its own is left out, with a note."""
        found, unread = fed(self.shader, name, default, self.reader.time)
        if unread:
            self._note(f"takes {name} from {unread}, which is not drawn")
        if not isinstance(found, Sampled):
            if isinstance(found, str) and name != "diffuseColor":
                self._note(f"takes {name} from a primvar, which is not drawn")
                return default
            return found
        if self.coordinates not in (None, found.coordinates):
            self._note(f"has a map of {name} with texture coordinates of its own, which is not drawn")
            return default
        self.coordinates = found.coordinates
        return found

    def _number(self, name: str, default: float) -> float:
        found = fed(self.shader, name, (default,), self.reader.time)[0]
        return float(found[0]) if isinstance(found, tuple) and found else default

    def _note(self, text: str) -> None:
        self.reader.note(f"material {self.name!r} {text}")

    def _color(self, color: Fed) -> tuple[tuple[float, float, float], Texture | None]:
        """Return a colour's factor and map."""
        if isinstance(color, str):
            return (1.0, 1.0, 1.0), None
        if not isinstance(color, Sampled):
            return (color[0], color[1], color[2]), None
        r, g, b = self._scale(color)[:3]
        pixels = self.reader.texture(
            (color.name, "rgb"), lambda: self.reader.pixels(color)[..., :3], color, srgb=color.color_space != "raw"
        )
        return (r, g, b), pixels

    def _scale(self, color: Sampled) -> tuple[float, ...]:
        if any(color.bias) or min(color.scale) < 0.0:
            self._note("has a bias or a negative scale of a colour, which is not drawn")
        return tuple(max(part, 0.0) for part in color.scale)

    def _base(self, color: Fed, opacity: Fed) -> tuple[tuple[float, float, float, float], Texture | None]:
        """Return the base colour with its opacity as a factor and a map."""
        (r, g, b), base_map = self._color(color)
        if not isinstance(opacity, Sampled):
            assert isinstance(opacity, tuple)
            return (r, g, b, opacity[0]), base_map
        alpha, factor = self._channel(opacity)
        own = self.reader.pixels(color)[..., :3] if isinstance(color, Sampled) else np.full((1, 1, 3), 255, np.uint8)
        source = color if isinstance(color, Sampled) else opacity
        key = (source.name, "rgb", opacity.name, opacity.channels, opacity.scale, opacity.bias)
        srgb = source.color_space != "raw"
        made = self.reader.texture(key, lambda: joined([*np.moveaxis(own, -1, 0), alpha]), source, srgb=srgb)
        return (r, g, b, factor), made

    def _metallic_roughness(self) -> tuple[float, float, Texture | None]:
        """Return the factors of metalness and roughness, and their map."""
        metallic, roughness = self._fed("metallic", 0.0), self._fed("roughness", 0.5)
        if self._number("useSpecularWorkflow", 0.0) > 0.5:
            self._note("is given by specular colours, which are not drawn")
            metallic = (0.0,)
        m, r = (self._channel(v)[1] if isinstance(v, Sampled) else _first(v) for v in (metallic, roughness))
        maps = [v if isinstance(v, Sampled) else None for v in (roughness, metallic)]
        return m, r, self._joined([None, *maps]) if any(maps) else None

    def _joined(self, sources: list[Sampled | None]) -> Texture:
        """Return the map whose red, green and blue are a channel of textures each, or white."""
        first = next(source for source in sources if source is not None)
        key = tuple(s and (s.name, s.channels, s.scale, s.bias, s.color_space) for s in sources)
        return self.reader.texture(
            key, lambda: joined([_WHITE if s is None else self._channel(s)[0] for s in sources]), first, srgb=False
        )

    def _channel(self, source: Sampled) -> tuple[Pixels, float]:
        """Return the code values (h, w) of a texture's channel and their factor; a bias is put into the values."""
        pixels = self.reader.pixels(source)
        number = max(_CHANNELS.find(source.channels), 0)
        whole = np.iinfo(pixels.dtype).max
        values = pixels[..., number] if number < pixels.shape[-1] else np.full(pixels.shape[:2], whole, pixels.dtype)
        scale, bias = source.scale[number], source.bias[number]
        if bias == 0.0 and scale >= 0.0:
            return values, scale
        moved = np.clip(values / whole * scale + bias, 0.0, 1.0)
        return np.asarray(np.round(moved * 65535.0), np.uint16), 1.0

    def _normal(self, normal: Fed) -> tuple[Texture | None, float]:
        """Return the normal map, y up, and its scale; value = 2 texture - 1 but for that scale."""
        if not isinstance(normal, Sampled):
            return None, 1.0
        usual = any(normal.bias)
        down = usual and normal.scale[1] < 0.0

        def upright() -> Pixels:
            pixels = self.reader.pixels(normal)[..., :3]
            if not down:
                return pixels
            turned = pixels.copy()
            turned[..., 1] = np.iinfo(pixels.dtype).max - pixels[..., 1]
            return turned

        made = self.reader.texture((normal.name, "normal", down), upright, normal, srgb=False)
        return made, 0.5 * abs(normal.scale[0]) if usual else 1.0


def _first(value: Fed) -> float:
    return float(value[0]) if isinstance(value, tuple) else 0.0


def joined(channels: list[NDArray[Any]]) -> Pixels:
    """Return code values (h, w, n) of channels (h, w) of 8 or 16 bits, enlarged to the size of the largest."""
    import cv2

    height, width = (max(c.shape[k] for c in channels) for k in (0, 1))
    deep = any(c.dtype == np.uint16 for c in channels)
    ready = []
    for channel in channels:
        values = channel.astype(np.uint16) * 257 if deep and channel.dtype == np.uint8 else channel
        if values.shape != (height, width):
            values = cv2.resize(values, (width, height), interpolation=cv2.INTER_LINEAR)
        ready.append(values)
    return np.stack(ready, axis=-1)


# Shading networks of USD: constants and textures that the inputs of a shader are fed from.
#
# Nodes: UsdUVTexture, UsdTransform2d and UsdPrimvarReader (UsdPreviewSurface specification, section "Core Nodes").

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

    for source in _sources(shader, name):
        if UsdShade.Output.IsOutput(source):
            node = UsdShade.Shader(source.GetPrim())
            return _of_node(node, source.GetName().split(":", 1)[-1], default, time)
        value = source.Get(time)
        if value is not None:
            return tuple(float(v) for v in np.ravel(np.asarray(value, np.float64))), ""
    return default, ""


def _sources(node: Any, name: str, *, outputs: bool = False) -> Any:
    """Return the attributes that give an input its value. outputs: of other nodes alone."""
    given = node.GetInput(name)
    return given.GetValueProducingAttributes(outputs) if given else ()


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

    return next((UsdShade.Shader(source.GetPrim()) for source in _sources(node, name, outputs=True)), None)


def _kind(node: Any) -> str:
    return str(node.GetIdAttr().Get())


def _value(node: Any, name: str, time: Any) -> Any:
    return next((source.Get(time) for source in _sources(node, name)), None)


def _text(node: Any, name: str, time: Any, default: str) -> str:
    value = _value(node, name, time)
    return default if value in (None, "") else str(value)


def _four(node: Any, name: str, time: Any, default: float) -> tuple[float, ...]:
    value = _value(node, name, time)
    return (default,) * 4 if value is None else tuple(float(v) for v in value)
