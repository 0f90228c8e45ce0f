# SPDX-License-Identifier: Apache-2.0
"""The sample's whale: a humpback that swims, as a binary glTF file of any length.

It lies beside this module, 1 m long, as samples/humpback/make.py makes it.
"""

from __future__ import annotations

import json
from importlib import resources
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.files import write_whole


def write_whale(
    path: Path, length_m: float = 13.5, *, detail: Literal["high", "low"] = "high", swims: bool = True
) -> None:
    """Write a humpback whale as binary glTF: metres, front +z, up +y, its middle at the origin.

    One closed skin, a skeleton, and a stroke of swimming that repeats.

    Parameters
    ----------
    path : Path
        File to write, .glb.
    length_m : float
        Length from the snout to the notch of the flukes; adults are 11 to 16 m, newborn calves 4 m long.
    detail : str
        "high": 24 thousand triangles, maps of colour, roughness and normals of 2048 x 2048; "low": 2 thousand, matt, a
        map of colour of 256 x 256.
    swims : bool
        Whether it has a skeleton and swims; else it is rigid.
    """
    # A file is a header of 12 bytes and two chunks, of JSON and of arrays; each begins with its size and kind
    stored = resources.files("mr360uw.sample").joinpath(f"humpback_{detail}.glb").read_bytes()
    start = 28 + int.from_bytes(stored[12:16], "little")
    tree, arrays = json.loads(stored[20 : start - 8]), bytearray(stored[start:])
    places = [tree["meshes"][0]["primitives"][0]["attributes"]["POSITION"]]
    # Enlarge places in the skin, of joints, and of the joint that moves; each matrix back ends in a place
    clip = tree["animations"][0]
    moved = [way["sampler"] for way in clip["channels"] if way["target"]["path"] == "translation"]
    for number in places + [clip["samplers"][sampler]["output"] for sampler in moved]:
        values, entry = _array(tree, arrays, number, 3), tree["accessors"][number]
        values *= np.float32(length_m)
        entry["min"], entry["max"] = values.min(axis=0).tolist(), values.max(axis=0).tolist()
    _array(tree, arrays, tree["skins"][0]["inverseBindMatrices"], 16)[:, 12:15] *= np.float32(length_m)
    for node in tree["nodes"][1:]:
        node["translation"] = (length_m * np.array(node["translation"])).tolist()
    for named in (tree["asset"], tree["nodes"][0]):
        named["extras"]["length_m"] = length_m
    if not swims:
        del (
            tree["skins"],
            tree["animations"],
            tree["nodes"][1:],
            tree["nodes"][0]["skin"],
            tree["scenes"][0]["nodes"][1:],
        )
        for name in ("JOINTS_0", "WEIGHTS_0"):
            del tree["meshes"][0]["primitives"][0]["attributes"][name]
    # Pack it again (glTF 2.0 specification, section 4.4)
    text = json.dumps(tree, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    body = len(text).to_bytes(4, "little") + b"JSON" + text + stored[start - 8 : start] + arrays
    write_whole(path, stored[:8] + (12 + len(body)).to_bytes(4, "little") + body)


def _array(tree: dict[str, Any], arrays: bytearray, number: int, columns: int) -> NDArray[np.float32]:
    """Return an accessor's rows of 32-bit floats, to be changed in place."""
    entry = tree["accessors"][number]
    offset = tree["bufferViews"][entry["bufferView"]]["byteOffset"]
    return np.frombuffer(arrays, np.float32, columns * entry["count"], offset).reshape(-1, columns)
