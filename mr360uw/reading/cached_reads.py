# SPDX-License-Identifier: Apache-2.0
"""Values made from files, kept while the files stay as they were."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar, TypeVarTuple

from mr360uw.cache import Cache, Neutral
from mr360uw.reading.input_files import files_read, note_read

T = TypeVar("T")
Inputs = TypeVarTuple("Inputs")
Stamp = tuple[int, int] | None
"""Time of the last change [ns] and length [bytes] of a file; None where it cannot be read."""


class CachedReads(Neutral):
    """Results of functions by their inputs and by the files that they read, which are watched themselves.

    A result is made anew where a file that it was read from has changed. As if it had been read again, its files are
    noted (`files_read`). cache: counts what was made. room: of that cache.
    """

    def __init__(self, room: int = 1) -> None:
        self.cache = Cache(room)

    def of(self, function: Callable[[*Inputs], T], *inputs: *Inputs, keep: int = 1) -> T:
        """Return the result of a function, as `Cache.of` does; call it too where its result is outdated."""
        reading: Any = _Reading(function)
        result, files = self.cache.of(reading, *inputs, keep=keep)
        if any(stamp(path) != before for path, before in files.items()):
            self.cache.drop(reading, *inputs)
            result, files = self.cache.of(reading, *inputs, keep=keep)
        for path in files:
            note_read(path)
        return result


@dataclass(frozen=True, slots=True)
class _Reading:
    """A function that tells beside its result which files it read, and what they were."""

    function: Callable[..., Any]

    def __call__(self, *inputs: Any) -> tuple[Any, dict[Path, Stamp]]:
        with files_read() as files:
            result = self.function(*inputs)
        return result, {path: stamp(path) for path in files}


def stamp(path: Path) -> Stamp:
    """Return what changes when a file does."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_mtime_ns, found.st_size
