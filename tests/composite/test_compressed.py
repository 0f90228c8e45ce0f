# SPDX-License-Identifier: Apache-2.0
"""glTF compressed with Draco and with meshopt shows what the same file shows without."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mr360uw.composite import load_mesh
from mr360uw.composite.mesh.mesh import Mesh
from mr360uw.errors import MeshError
from tests.composite import tolerances as tol
from tests.composite.gltf_files import GltfFile

POINTS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 0.5, 1]], np.float32)
NORMALS = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0], [0, 0, 1]], np.float32)
FACES = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]], np.uint16)


def plain(folder: Path) -> Mesh:
    file = GltfFile()
    file.mesh(
        {
            "attributes": {"POSITION": file.accessor(POINTS), "NORMAL": file.accessor(NORMALS)},
            "indices": file.accessor(FACES.ravel(), "u2"),
        }
    )
    return load_mesh(file.write(folder / "plain.glb"))


def corners(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    """Return positions and normals (n, 3) of all corners, in an order that their positions decide."""
    points, normals = mesh.positions.reshape(-1, 3), mesh.normals.reshape(-1, 3)
    order = np.lexsort(points.round(4).T)
    return points[order], normals[order]


def packed_view(file: GltfFile, name: str, data: bytes, rows: np.ndarray, **more: Any) -> int:
    """Return the number of a view of meshopt's bytes, whose own place is in a buffer without bytes."""
    number = file.view(data)
    stored = file.tree["bufferViews"][number]
    packed = {**stored, "byteStride": rows.itemsize * (rows.shape[1] if rows.ndim == 2 else 1), "count": len(rows)}
    place = {"buffer": 1, "byteOffset": 0, "byteLength": rows.nbytes}
    file.tree["bufferViews"].append({**place, "extensions": {name: {**packed, **more}}})
    return len(file.tree["bufferViews"]) - 1


def with_meshopt(name: str = "EXT_meshopt_compression") -> GltfFile:
    meshopt = pytest.importorskip("meshopt", reason="needs mr360uw[gltf]")
    file = GltfFile(extensionsUsed=[name], extensionsRequired=[name])
    unit = NORMALS / np.linalg.norm(NORMALS, axis=1, keepdims=True)
    round_ones = meshopt.encode_filter_oct(np.pad(unit, ((0, 0), (0, 1))), 4, 8).view(np.int8)
    views = [
        packed_view(file, name, meshopt.encode_gltf_buffer(POINTS, "ATTRIBUTES"), POINTS, mode="ATTRIBUTES"),
        packed_view(
            file, name, meshopt.encode_gltf_buffer(round_ones, "ATTRIBUTES"), round_ones, mode="ATTRIBUTES",
            filter="OCTAHEDRAL",
        ),
        packed_view(file, name, meshopt.encode_gltf_buffer(FACES, "TRIANGLES"), FACES.ravel(), mode="TRIANGLES"),
    ]  # fmt: skip
    file.tree["bufferViews"][views[1]]["byteStride"] = 4
    count = len(POINTS)
    file.tree["accessors"] = [
        {"bufferView": views[0], "componentType": 5126, "count": count, "type": "VEC3"},
        {"bufferView": views[1], "componentType": 5120, "count": count, "type": "VEC3", "normalized": True},
        {"bufferView": views[2], "componentType": 5123, "count": FACES.size, "type": "SCALAR"},
    ]
    file.mesh({"attributes": {"POSITION": 0, "NORMAL": 1}, "indices": 2})
    file.more_buffers = [{"byteLength": 4096, "extensions": {name: {"fallback": True}}}]
    return file


def with_draco() -> GltfFile:
    draco = pytest.importorskip("DracoPy", reason="needs mr360uw[gltf]")
    name = "KHR_draco_mesh_compression"
    file = GltfFile(extensionsUsed=[name], extensionsRequired=[name])
    data = draco.encode(
        POINTS, FACES.astype(np.uint32), quantization_bits=0, normals=NORMALS.astype(float), preserve_order=True
    )
    ids = {a["attribute_type"]: a["unique_id"] for a in draco.decode(data).attributes}
    file.tree["accessors"] = [
        {"componentType": 5126, "count": len(POINTS), "type": "VEC3"},
        {"componentType": 5126, "count": len(POINTS), "type": "VEC3"},
        {"componentType": 5123, "count": FACES.size, "type": "SCALAR"},
    ]
    packed = {"bufferView": file.view(data), "attributes": {"POSITION": ids[0], "NORMAL": ids[1]}}
    file.mesh({"attributes": {"POSITION": 0, "NORMAL": 1}, "indices": 2, "extensions": {name: packed}})
    return file


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
@pytest.mark.parametrize(
    ("make", "apart"),
    [
        (with_draco, tol.FLOAT32),
        (with_meshopt, 0.02),  # eight bits of the normals: 1 / 127 a coordinate, twice for the octahedron
        (lambda: with_meshopt("KHR_meshopt_compression"), 0.02),
    ],
)
def test_a_compressed_mesh_is_the_mesh(tmp_path: Path, suffix: str, make: Any, apart: float) -> None:
    mesh, expected = load_mesh(make().write(tmp_path / f"packed{suffix}")), plain(tmp_path)
    for face, own in zip(mesh.positions, expected.positions, strict=True):  # a triangle may begin at another corner
        assert any(np.allclose(np.roll(face, k, axis=0), own, atol=tol.FLOAT32) for k in range(3))
    where, found = corners(mesh)
    there, wanted = corners(expected)
    np.testing.assert_allclose(where, there, atol=tol.FLOAT32)
    np.testing.assert_allclose(found, wanted, atol=apart)
    assert len(mesh.notes) == len(expected.notes)


@pytest.mark.parametrize("name", ["EXT_meshopt_compression", "KHR_draco_mesh_compression"])
def test_without_the_packages_the_message_is_the_word(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "meshopt", None)
    monkeypatch.setitem(sys.modules, "DracoPy", None)
    file = GltfFile(extensionsUsed=[name])
    with pytest.raises(MeshError, match=r"is compressed with .* - pip install 'mr360uw\[gltf\]', or export it without"):
        load_mesh(file.write(tmp_path / "packed.glb"))


def test_damaged_bytes_are_refused(tmp_path: Path) -> None:
    for make, says in ((with_meshopt, "meshopt, is damaged"), (with_draco, "Draco, is damaged")):
        file = make()
        file.data = bytes(255 - byte for byte in file.data)
        with pytest.raises(MeshError, match=says):
            load_mesh(file.write(tmp_path / "packed.glb"))
