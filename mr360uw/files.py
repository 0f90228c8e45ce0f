# SPDX-License-Identifier: Apache-2.0
"""Files that appear whole or not at all."""

from __future__ import annotations

import os
import secrets
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

from mr360uw.errors import OutputExistsError

NewFile = Callable[[Path], AbstractContextManager[Path]]
"""Opens a context with the name of an empty new file, which is renamed to the given path at its end: `whole_file`."""
_ANYONE = 0o666
"""Rights of a new file before the user's mask takes some away."""


def is_ours(folder: Path) -> bool:
    """Return whether a folder belongs to the user who runs this process; on Windows, whose rights differ, always."""
    return not hasattr(os, "geteuid") or folder.stat().st_uid == os.geteuid()


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield the name of an empty new file; afterwards it is renamed to `path`, or removed if there was an exception.

    Raises `OSError`.
    """
    part = new_file(path)
    try:
        yield part
        publish(part, path, overwrite=True)
    finally:
        part.unlink(missing_ok=True)


def new_file(path: Path, folder: Path | None = None) -> Path:
    """Return the name of an empty file that did not exist before, beside `path` or in a folder, with its suffix."""
    while True:
        part = (folder or path.parent) / f".{path.stem}.{secrets.token_hex(4)}.part{path.suffix}"
        try:
            # neither an existing file nor a link is opened
            os.close(os.open(part, os.O_CREAT | os.O_EXCL | os.O_WRONLY, _ANYONE))
        except FileExistsError:
            continue
        return part


def publish(part: Path, path: Path, *, overwrite: bool) -> None:
    """Rename a complete file to `path`; without `overwrite`, `OutputExistsError` where that is there already."""
    if overwrite:
        part.replace(path)
        return
    exists = OutputExistsError(f"{path} - came into being meanwhile - choose another name or allow overwriting")
    try:
        os.link(part, path)
    except FileExistsError:
        raise exists from None
    except OSError:  # a disk without hard links
        if path.exists():
            raise exists from None
        part.replace(path)
        return
    part.unlink()


def write_whole(path: Path, data: str | bytes) -> None:
    """Write a small file; on failure nothing is left, and `OSError` names the file."""
    with whole_file(path) as part:
        try:
            part.write_bytes(data.encode() if isinstance(data, str) else data)
        except OSError as error:  # of a full disk, which names no file
            raise OSError(error.errno, error.strerror, str(path)) from error
