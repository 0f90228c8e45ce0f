# SPDX-License-Identifier: Apache-2.0
"""Materials of Wavefront OBJ: the diffuse colour or its image; the rest of a library is reported."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from mr360uw.composite.mesh.material import Material
from mr360uw.composite.mesh.texture import check_image, decoded, make_texture
from mr360uw.errors import MeshError
from mr360uw.reading.input_files import neighbour, read_data
from mr360uw.reading.limits import TEXT

_NOT_DRAWN = ("map_d", "map_bump", "bump", "norm", "map_ks", "map_ke", "map_pr", "map_pm", "pr", "pm")


def obj_notes(path: Path, *, outside: bool = False) -> tuple[str, ...]:
    """Return notes on unsupported properties in the libraries of an OBJ.

    outside: its libraries and images may lie outside of its folder. Raises `MeshError` if an image cannot be used.
    """
    notes: dict[str, None] = {}
    for library in _libraries(path, outside=outside):
        for line in read_data(library, MeshError, TEXT).decode("utf-8", "replace").splitlines():
            word, _, value = line.strip().partition(" ")
            word, value = word.lower(), value.strip()
            if word == "map_kd" and not value.startswith("-"):
                image = neighbour(path, value.replace("\\", "/"), "texture", outside=outside)
                check_image(read_data(image, MeshError), str(image))
            if word in _NOT_DRAWN or (word == "d" and value != "1" and value.strip("0") != "1."):
                notes[f"{library} - {word} is not drawn - give the object textures in the scene, or export glTF"] = None
    return tuple(notes)


def _libraries(path: Path, *, outside: bool) -> Iterator[Path]:
    """Yield the material libraries of an OBJ that exist; without one it is drawn with a default material."""
    for line in read_data(path, MeshError).decode("utf-8", "replace").splitlines():
        word, _, name = line.strip().partition(" ")
        if word == "mtllib" and os.path.lexists(path.parent / name.strip()):
            yield neighbour(path, name.strip(), "material library", outside=outside)


class ObjNeighbours:
    """Reads the files that an OBJ names, for trimesh. outside: they may lie outside of its folder."""

    def __init__(self, path: Path, *, outside: bool) -> None:
        self.file_name = path.name
        self._path, self._outside = path, outside

    def get(self, name: str) -> bytes:
        """Return the bytes of a file; raise `MeshError`."""
        file = neighbour(self._path, name.strip().replace("\\", "/"), "file", outside=self._outside)
        return read_data(file, MeshError)

    __getitem__ = get


def simple_material(source: Any, path: Path) -> Material:
    """Return a trimesh material's diffuse colour (encoded) or its image; middle grey without either.

    path: of the mesh file. Raises `MeshError` where the image is damaged.
    """
    from mr360uw.color import decode

    image = getattr(source, "image", None)
    real = image is not None and max(image.size) > 2  # trimesh makes a 2 x 2 image if there is none
    if real:
        texture = make_texture(decoded(image, str(path)), srgb=True)
        return Material(base_color=(1.0, 1.0, 1.0, 1.0), base_map=texture, double_sided=True)
    diffuse = getattr(source, "diffuse", None)
    r, g, b = 0.5, 0.5, 0.5
    if diffuse is not None and getattr(source, "kwargs", {}).get("kd") is not None:
        r, g, b = decode(np.asarray(diffuse[:3], np.float64) / 255.0, "srgb")
    return Material(base_color=(float(r), float(g), float(b), 1.0), double_sided=True)
