# SPDX-License-Identifier: Apache-2.0
"""Notes of the files that are read."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

_NOTES: ContextVar[tuple[dict[Path, None], ...]] = ContextVar("files read", default=())
"""The notes that are being taken in this thread, one inside the other."""


@contextmanager
def files_read() -> Iterator[dict[Path, None]]:
    """Yield a dictionary whose keys become the files that `note_read` names on this thread within the context.

    `read_data` names every file that it opens, so that a mesh's textures and buffers are found without knowing its
    format.
    """
    found: dict[Path, None] = {}
    before = _NOTES.set((*_NOTES.get(), found))
    try:
        yield found
    finally:
        _NOTES.reset(before)


def note_read(path: Path) -> None:
    """Note that a file is read."""
    for found in _NOTES.get():
        found[path] = None
