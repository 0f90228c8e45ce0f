# SPDX-License-Identifier: Apache-2.0
"""Names of numbered files: patterns such as out_%04d.png, out_####.png, out_@@@@.png or Houdini's out_$F4.png."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

_NUMBER = re.compile(r"%(?:0(\d+))?d|(#+|@@+)|\$F(\d*)")


def is_pattern(path: Path) -> bool:
    """Return whether a name is the pattern of a sequence, with %04d, ####, @@@@ or $F4 in it."""
    return _NUMBER.search(path.name) is not None


def without_number(path: Path) -> Path:
    """Return a name without the number of a pattern and what parts it from the rest: out.exr for out_%04d.exr."""
    found = _NUMBER.search(path.name)
    if found is None:
        return path
    return path.with_name((path.name[: found.start()].rstrip("_-. ") or "frames") + path.name[found.end() :])


def numbered(path: Path, number: int) -> Path:
    """Return the file of a pattern with this number."""
    found = _NUMBER.search(path.name)
    assert found is not None
    digits = len(found[2]) if found[2] else int(found[1] or found[3] or 0)
    return path.with_name(path.name[: found.start()] + f"{number:0{digits}d}" + path.name[found.end() :])


def matching_files(path: Path) -> list[tuple[int, Path]]:
    """Return the existing files of a pattern with their numbers, ascending."""
    name = matcher(path)
    folder = path.parent.iterdir() if path.parent.is_dir() else ()
    hits = ((name.fullmatch(file.name), file) for file in folder)
    return sorted((int(hit[1]), file) for hit, file in hits if hit)


def matcher(path: Path) -> re.Pattern[str]:
    """Return an expression for the names of a pattern's files; its first group is their number."""
    found = _NUMBER.search(path.name)
    assert found is not None
    before, after = re.escape(path.name[: found.start()]), re.escape(path.name[found.end() :])
    return re.compile(f"{before}(\\d+){after}")


def files_named(path: Path) -> Iterator[Path]:
    """Yield the files that a path, a folder, a numbered pattern or a wildcard stands for."""
    if is_pattern(path):
        yield from (file for _, file in matching_files(path))
    elif "*" in path.name:
        yield from path.parent.glob(path.name)
    elif path.is_dir():
        yield from sorted(file for file in path.iterdir() if file.is_file())
    else:
        yield path
