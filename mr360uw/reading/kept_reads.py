# SPDX-License-Identifier: Apache-2.0
"""Values made from files, kept while the files stay as they were."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from pathlib import Path
from typing import TypeVar

from mr360uw.cache import Cache
from mr360uw.reading.files_read import files_read, note_read

T = TypeVar("T")
Stamp = tuple[int, int] | None
"""Time of the last change [ns] and length [bytes] of a file; None where it cannot be read."""


class KeptReads:
    """Values under a name and a key of all that they depend on but files, which are watched themselves.

    A value is made anew where a file that it was read from has changed. As if it had been read again, its files are
    noted (`files_read`). cache: counts what was made. room: of that cache.
    """

    def __init__(self, room: int = 1) -> None:
        self.cache = Cache(room)

    def get(self, name: str, key: Hashable, make: Callable[[], T], keep: int = 1) -> T:
        """Return the value of a name for a key; call `make` if it is not among the last `keep` used, or is outdated."""

        def read() -> tuple[T, dict[Path, Stamp]]:
            with files_read() as files:
                value = make()
            return value, {path: stamp(path) for path in files}

        value, files = self.cache.get(name, key, read, keep)
        if any(stamp(path) != before for path, before in files.items()):
            self.cache.drop(name, key)
            value, files = self.cache.get(name, key, read, keep)
        for path in files:
            note_read(path)
        return value


def stamp(path: Path) -> Stamp:
    """Return what changes when a file does."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_mtime_ns, found.st_size
