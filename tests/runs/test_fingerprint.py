# SPDX-License-Identifier: Apache-2.0
"""Kept work is used again only while every file that the scene reads, by whatever way, is what it was."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from mr360uw.base.input_files import input_file
from mr360uw.render.loaded import load
from mr360uw.runs.work_folder import WorkKeys, input_fingerprints, work_keys
from tests.composite.gltf_files import one_square
from tests.scenes import scene_with

OBJ = "mtllib one.mtl\nusemtl a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n"


@pytest.fixture
def files(tmp_path: Path) -> Path:
    """A folder with meshes in several files: glTF with a buffer and an image, OBJ with a library and its image."""
    for name in ("skin.png", "paint.png"):
        cv2.imwrite(str(tmp_path / name), np.full((4, 4, 3), 90, np.uint8))
    square = one_square({"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}})
    tree = {
        **square.tree,
        "images": [{"uri": "skin.png"}],
        "textures": [{"source": 0}],
        "buffers": [{"byteLength": len(square.data), "uri": "a%20buffer.bin"}],
    }
    (tmp_path / "a buffer.bin").write_bytes(square.data)
    (tmp_path / "square.gltf").write_text(json.dumps(tree))
    (tmp_path / "one.obj").write_text(OBJ)
    (tmp_path / "one.mtl").write_text("newmtl a\nKd 1 1 1\nmap_Kd paint.png\n")
    return tmp_path


def keys(folder: Path, measured: tuple[int, int] = (0, 8), **tables: Any) -> WorkKeys:
    objects = [{"mesh": str(folder / name), "position_m": [0.0, 0.0, -3.0]} for name in ("square.gltf", "one.obj")]
    receiver = {"kind": "mesh", "path": str(folder / "one.obj")}
    scene = scene_with(folder, None, object=objects, receiver=receiver, water={"type": "none"}, **tables)
    loaded = load(scene, 64, 32)
    return work_keys(loaded, input_fingerprints(loaded), "reference", measured)


def test_every_file_that_a_mesh_names_counts(files: Path) -> None:
    first = keys(files)
    assert keys(files) == first
    changes = {
        "a buffer.bin": (files / "a buffer.bin").read_bytes() + b"\0",
        "skin.png": cv2.imencode(".png", np.full((4, 4, 3), 91, np.uint8))[1].tobytes(),
    }
    for name, data in changes.items():
        (files / name).write_bytes(data)
        changed = keys(files)
        assert changed.pictures != first.pictures, name
        assert changed.first_pass == first.first_pass, name
        first = changed
    # the ground is read from this one, and the first pass depends on the ground
    for name, more in (("one.mtl", b"# new\n"), ("paint.png", b"\0")):
        (files / name).write_bytes((files / name).read_bytes() + more)
        changed = keys(files)
        assert changed.pictures != first.pictures, name
        assert changed.first_pass != first.first_pass, name
        first = changed


def test_work_of_another_range_is_measured_anew(files: Path) -> None:
    assert keys(files, (0, 8)).first_pass != keys(files, (0, 9)).first_pass


def test_keys_count_and_for_the_first_pass_those_of_what_it_measures(files: Path) -> None:
    def keyed(name: str, value: float) -> WorkKeys:
        return keys(files, keys=[{"parameter": name, "time_s": [0, 1], "value": [1.0, value]}])

    assert keyed("object.0.scale", 2.0) == keyed("object.0.scale", 2.0)
    assert keyed("object.0.scale", 2.0).pictures != keyed("object.0.scale", 3.0).pictures
    assert keyed("object.0.scale", 2.0).first_pass == keys(files).first_pass
    assert keyed("light.peak", 2.0).first_pass != keyed("light.peak", 3.0).first_pass


def test_a_large_file_that_is_replaced_with_its_time_set_back_is_another(tmp_path: Path) -> None:
    """Between the blocks that are hashed, and with the same length."""
    plate = tmp_path / "plate.mp4"
    plate.write_bytes(bytes(20 << 20))
    before, stat = input_file(plate), plate.stat()
    with plate.open("r+b") as file:
        file.seek((1 << 20) + 100_000)
        file.write(b"another")
    os.utime(plate, ns=(stat.st_atime_ns, stat.st_mtime_ns))
    assert plate.stat().st_mtime_ns == stat.st_mtime_ns
    assert input_file(plate) != before
    small = tmp_path / "small.mp4"
    small.write_bytes(bytes(1 << 20))
    one = input_file(small)
    small.chmod(0o600)
    assert input_file(small) == one  # all of it is hashed: only its content counts
