# SPDX-License-Identifier: Apache-2.0
"""Files that appear whole or not at all."""

from __future__ import annotations

import os
import secrets
import stat
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path

from mr360uw.errors import OutputError, OutputExistsError

NewFile = Callable[[Path], AbstractContextManager[Path]]
"""Opens a context with the name of an empty new file, which is renamed to the given path at its end: `whole_file`."""
_ANYONE = 0o666
"""Rights of a new file before the user's mask takes some away."""
_OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH


def is_ours(folder: Path) -> bool:
    """Return whether a folder belongs to the user who runs this process; on Windows, whose rights differ, always."""
    return not hasattr(os, "geteuid") or folder.stat().st_uid == os.geteuid()


def unsafe(path: Path) -> str:
    """Return why another user could have put or changed what is at a path, as "/x belongs to user 1001"; "" if none.

    As ssh and sudo judge it: the file or folder, every folder above it, and links on the way belong to the user who
    runs this process or to root, and nobody else may write to them. A folder above may be open to all where its sticky
    bit keeps others from renaming what is not theirs, as in /tmp. What does not exist yet is judged by what is above
    it. On Windows, whose rights differ, nothing is judged, and "" is returned.
    """
    if not hasattr(os, "geteuid"):
        return ""
    trusted, named, real = (0, os.geteuid()), path.absolute(), Path(os.path.realpath(path))
    for one in dict.fromkeys(part for end in (named, real) for part in (*reversed(end.parents), end)):
        try:
            found = one.lstat()
        except (FileNotFoundError, NotADirectoryError):
            continue
        except OSError as error:
            return f"{one} cannot be looked at ({error.strerror})"
        if found.st_uid not in trusted:
            return f"{one} belongs to user {found.st_uid}"
        above = one not in (named, real) and found.st_mode & stat.S_ISVTX
        if found.st_mode & _OTHERS_WRITE and not stat.S_ISLNK(found.st_mode) and not above:
            return f"{one} may be written to by others (mode {stat.S_IMODE(found.st_mode):o})"
    return ""


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


def rewrite(path: Path, text: str) -> None:
    """Write the text of a user's own file anew, whole or not at all; a link to it stays one.

    A file that is there keeps its rights, and its owner where that may be set. Raises `OutputError` where it is
    read-only, and `OSError`.
    """
    path = Path(os.path.realpath(path))
    try:
        before = path.stat()
    except FileNotFoundError:
        write_whole(path, text)
        return
    rights = stat.S_IMODE(before.st_mode)
    if not (rights & (stat.S_IWUSR | _OTHERS_WRITE) and os.access(path, os.W_OK)):
        raise OutputError(f"{path} - is read-only (got mode {rights:o}) - make it writable, then save again")
    with whole_file(path) as part:
        part.chmod(stat.S_IRUSR | stat.S_IWUSR)  # nobody reads what only the file's own readers may
        part.write_text(text, "utf-8", newline="")
        for owner in ((-1, before.st_gid), (before.st_uid, -1)):
            with suppress(AttributeError, PermissionError):  # on Windows; where only root may give a file away
                os.chown(part, *owner)
        part.chmod(rights)
