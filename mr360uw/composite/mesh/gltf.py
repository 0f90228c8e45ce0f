# SPDX-License-Identifier: Apache-2.0
"""The container of glTF 2.0: its JSON, buffers, accessors and images (glTF 2.0 specification, sections 3.6 and 4.4).

The JSON is not validated first: a missing key or an index out of range raises a Python exception, which
`gltf_scene.read_gltf` turns into a `MeshError`.
"""

from __future__ import annotations

import base64
import functools
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from mr360uw.errors import MeshError, install_command, installed, optional
from mr360uw.reading.input_files import DATA, json_of, neighbour, own_table, read_data

_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
BROKEN = (
    KeyError, IndexError, TypeError, ValueError, AttributeError, OverflowError, RecursionError, MemoryError,
    struct.error,
)  # fmt: skip
"""What Python raises where a file contradicts itself."""
_VALUE_BYTES = 200
"""Memory [bytes] that a value of JSON may take once it is read: an empty list in a list takes 70, a table more."""
_JSON_CHUNK, _BINARY_CHUNK = 0x4E4F534A, 0x004E4942

_MESHOPT = ("EXT_meshopt_compression", "KHR_meshopt_compression")
_DRACO = "KHR_draco_mesh_compression"
_PACKED = {_DRACO: ("Draco", "DracoPy"), **dict.fromkeys(_MESHOPT, ("meshopt", "meshopt"))}
"""Compressions by extension: what they are called, and the module that undoes them."""


@dataclass(frozen=True, slots=True, eq=False)
class Gltf:
    """An opened file: its JSON as `tree`, and its buffers. outside: images may lie outside of the file's folder."""

    path: Path
    tree: dict[str, Any]
    buffers: tuple[bytes, ...]
    outside: bool = False

    def listed(self, name: str) -> list[Any]:
        """Return one of the top level lists, empty where there is none."""
        return list(self.tree.get(name, []))

    def entry(self, name: str, number: int) -> dict[str, Any]:
        """Return one entry of a top level list."""
        if number < 0:
            raise IndexError(f"{name} {number}")
        return dict(self.tree[name][number])

    def view(self, number: int) -> bytes:
        """Return the bytes of a buffer view."""
        entry = self.entry("bufferViews", number)
        packed = next((entry["extensions"][name] for name in _MESHOPT if name in entry.get("extensions", {})), None)
        if packed is not None:
            return self._unpacked(number, packed)
        return self._stored(number, entry)

    def _stored(self, number: int, entry: dict[str, Any]) -> bytes:
        start, length = entry.get("byteOffset", 0), entry["byteLength"]
        if start < 0 or length < 1:
            raise ValueError(f"buffer view {number} has {length} bytes from {start}")
        data = self.buffers[entry["buffer"]][start : start + length]
        if len(data) < length:
            raise ValueError(f"buffer view {number} ends beyond its buffer")
        return data

    def _unpacked(self, number: int, packed: dict[str, Any]) -> bytes:
        """Return the bytes of a buffer view that meshopt compressed (EXT_meshopt_compression, its properties)."""
        count, stride = int(packed["count"]), int(packed["byteStride"])
        DATA.check(f"{self.path} buffer view {number}", count * stride, MeshError)
        data, kind = self._stored(number, packed), packed.get("filter", "NONE")
        try:
            values = optional("meshopt").decode_gltf_buffer(data, count, stride, packed["mode"], kind)
            return bytes(np.ascontiguousarray(values).data.cast("B"))
        except Exception as error:  # whatever the decoder raises
            what = f"{type(error).__name__}: {error!s:.80}"
            raise MeshError(
                f"{self.path} - view {number}, compressed with meshopt, is damaged (got {what}) - export it again"
            ) from error

    def draco(self, number: int) -> Any:
        """Return the mesh that a buffer view has by Draco."""
        try:
            return optional("DracoPy").decode(self.view(number))
        except Exception as error:  # whatever the decoder raises
            what = f"{type(error).__name__}: {error!s:.80}"
            raise MeshError(
                f"{self.path} - view {number}, compressed with Draco, is damaged (got {what}) - export it again"
            ) from error

    def accessor(self, number: int) -> NDArray[Any]:
        """Return an accessor (count, width): normalised integers as float64, others as they are stored."""
        entry = self.entry("accessors", number)
        width, count = _WIDTHS[entry["type"]], int(entry["count"])
        kind = np.dtype(_COMPONENTS[entry["componentType"]])
        DATA.check(f"{self.path} accessor {number}", count * width * np.dtype(np.float64).itemsize, MeshError)
        if "bufferView" in entry:
            stride = self.entry("bufferViews", entry["bufferView"]).get("byteStride", 0)
            values = self._elements(entry["bufferView"], entry.get("byteOffset", 0), kind, (count, width), stride)
        else:
            values = np.zeros((count, width), kind)
        if "sparse" in entry:
            values = self._sparse(entry["sparse"], values)
        return dequantised(values) if entry.get("normalized", False) else values

    def _elements(self, view: int, offset: int, kind: np.dtype[Any], shape: tuple[int, int], stride: int) -> Any:
        strides, data = (stride or shape[1] * kind.itemsize, kind.itemsize), self.view(view)
        if not data:  # NumPy takes an empty buffer for one of any length, and reads what lies behind it
            raise ValueError(f"buffer view {view} is empty")
        return np.ndarray(shape, kind, data, offset, strides)

    def _sparse(self, entry: dict[str, Any], values: NDArray[Any]) -> NDArray[Any]:
        """Return values with some of them replaced."""
        indices, places, count = entry["indices"], np.array(values), int(entry["count"])
        kind = np.dtype(_COMPONENTS[indices["componentType"]])
        at = self._elements(indices["bufferView"], indices.get("byteOffset", 0), kind, (count, 1), 0)[:, 0]
        shape = (count, values.shape[1])
        new = entry["values"]
        places[at] = self._elements(new["bufferView"], new.get("byteOffset", 0), values.dtype, shape, 0)
        return places

    def image(self, number: int) -> bytes:
        """Return the bytes of an image file."""
        entry = self.entry("images", number)
        if "bufferView" in entry:
            return self.view(entry["bufferView"])
        return _resource(self.path, entry["uri"], "texture", outside=self.outside)


def dequantised(values: NDArray[Any]) -> NDArray[Any]:
    """Return normalised integers as float64, in [0, 1] or [-1, 1] (section 3.6.2.2); floats as they are."""
    if values.dtype.kind == "f":
        return values
    return np.maximum(values.astype(np.float64) / np.iinfo(values.dtype).max, -1.0)


def open_gltf(path: Path, *, outside: bool = False) -> Gltf:
    """Return an opened .gltf or .glb; outside: its buffers and images may lie outside of its folder.

    Raises `MeshError` if it is no glTF, requires an unsupported extension, or names a file that cannot be read.
    """
    try:
        text, binary = _chunks(path)
        DATA.check(f"{path} JSON", _VALUE_BYTES * text.count(b","), MeshError)
        tree = dict(json_of(text))
    except (TypeError, ValueError, struct.error) as error:
        raise MeshError(f"{path} - is not glTF (got: {error!s:.120}) - export it again") from error
    _check_extensions(path, tree)
    for image in tree.get("images", []):
        uri = image.get("uri", "data:")
        if not uri.startswith("data:"):
            neighbour(path, unquote(uri), "texture", outside=outside, shown=uri)
    buffers = [_buffer(path, entry, binary, outside=outside) for entry in tree.get("buffers", [])]
    return Gltf(path, tree, tuple(buffers), outside)


def _chunks(path: Path) -> tuple[bytes, bytes]:
    """Return the JSON and the binary of a file (section 4.4)."""
    data = read_data(path, MeshError)
    if data.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"{"):  # whatever the file's ending says
        return data, b""
    magic, version, _ = struct.unpack_from("<4sII", data)
    length, kind = struct.unpack_from("<II", data, 12)
    if magic != b"glTF" or version != 2 or kind != _JSON_CHUNK:
        raise MeshError(f"{path} - is not glTF 2.0 (got header {data[:8]!r}) - export it again")
    text, start = data[20 : 20 + length], 20 + length
    if len(data) < start + 8:
        return text, b""
    size, kind = struct.unpack_from("<II", data, start)
    return text, data[start + 8 : start + 8 + size] if kind == _BINARY_CHUNK else b""


def _resource(path: Path, uri: str, what: str, *, outside: bool) -> bytes:
    if uri.startswith("data:"):
        return base64.b64decode(uri.split(",", 1)[1])
    return read_data(neighbour(path, unquote(uri), what, outside=outside, shown=uri), MeshError)


def _buffer(path: Path, entry: dict[str, Any], binary: bytes, *, outside: bool) -> bytes:
    """Return the bytes of a buffer; none of one for programs that cannot decompress."""
    if any(entry.get("extensions", {}).get(name, {}).get("fallback", False) for name in _MESHOPT):
        return b""
    return _resource(path, entry["uri"], "buffer", outside=outside) if "uri" in entry else binary


@functools.cache
def _extensions() -> dict[str, dict[str, str]]:
    """Return what is known of extensions, by their names."""
    return {row["extension"]: row for row in own_table("composite/mesh/data/gltf_extensions.csv")}


def _check_extensions(path: Path, tree: dict[str, Any]) -> None:
    used = set(tree.get("extensionsUsed", []))
    for name in sorted(used & _PACKED.keys()):
        called, module = _PACKED[name]
        if not installed(module):
            raise MeshError(
                f"{path} - is compressed with {called}, which needs the package {module} - "
                f"{install_command('gltf')}, or export it without compression"
            )
    for name in sorted(set(tree.get("extensionsRequired", []))):
        known = _extensions().get(name, {})
        if known.get("standing", "shape") == "shape":
            raise MeshError(f"{path} - {known.get('refused') or f'requires the extension {name}'} - export it without")


def extension_notes(gltf: Gltf) -> list[str]:
    """Return a note for every extension that is used and not read."""
    notes = []
    for name in sorted(set(gltf.tree.get("extensionsUsed", []))):
        known = _extensions().get(name, {})
        if known.get("standing") not in ("read", "no effect"):
            what, instead = known.get("what", ""), known.get("instead", "it looks as without")
            notes.append(f"{gltf.path} - the extension {name}{what and f' ({what})'} is not drawn - {instead}")
    return notes
