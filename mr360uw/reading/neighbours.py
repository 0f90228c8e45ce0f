# SPDX-License-Identifier: Apache-2.0
"""Files that a mesh file names: buffers, textures, material libraries.

They lie in the folder of the mesh or below it. A mesh from a stranger could otherwise show any file of the machine.
"""

from __future__ import annotations

from pathlib import Path

from mr360uw.errors import MeshError
from mr360uw.reading.input_files import unreadable


def neighbour(path: Path, name: str, what: str, *, outside: bool, shown: str = "") -> Path:
    """Return the file that a mesh file calls `name`.

    path: of the mesh file; what: kind of the file, for messages; shown: the name as the mesh file has it. outside: it
    may lie outside of the mesh file's folder. Raises `MeshError` for other places, and for what is no regular file.
    """
    file, shown = path.parent / name, shown or name
    try:
        found = file.resolve()
        there = file.exists()
    except (OSError, ValueError, RuntimeError):  # a name too long, with a zero character, or a circle of links
        raise MeshError(f"{path} - names a {what} by a name that no file has (got {shown!r:.80}) - rename it") from None
    if (
        not outside
        and not found.is_relative_to(path.parent.resolve())
        and not found.is_relative_to(path.resolve().parent)
    ):
        raise MeshError(
            f"{path} - names a {what} outside of its folder (got {shown!r:.80}) - put it beside the mesh, or if you "
            "trust the mesh set outside_files = true for the object"
        )
    if not there:
        raise MeshError(f"{path} - a {what} is missing (got {shown!r:.80}) - put it beside the mesh")
    if reason := unreadable(file):
        raise MeshError(f"{path} - names a {what} that {reason} (got {shown!r:.80})")
    return file
