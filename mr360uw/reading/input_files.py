# SPDX-License-Identifier: Apache-2.0
"""Files that are read whole: regular ones, within a limit."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from mr360uw.errors import Mr360uwError
from mr360uw.reading.files_read import note_read
from mr360uw.reading.limits import DATA, TEXT, Limit


def unreadable(path: Path) -> str:
    """Return why a path is no file that can be read, *what is wrong - what to do*; "" for a regular file.

    Devices, pipes and sockets are refused: reading them may wait for ever, or never end.
    """
    try:
        mode = path.stat().st_mode
    except (FileNotFoundError, NotADirectoryError):
        return "no such file - check the path"
    except (OSError, ValueError) as error:
        return f"cannot be read (got: {getattr(error, 'strerror', None) or error}) - check its name and rights"
    if stat.S_ISDIR(mode):
        return "is a folder - name a file"
    if not stat.S_ISREG(mode):
        return "is a device, a pipe or a socket, which cannot be read twice - save it as a file first"
    return ""


def read_data(path: Path, wrong: type[Mr360uwError], limit: Limit = DATA) -> bytes:
    """Return the bytes of a file; raise `wrong` where it cannot be read, is no regular file, or is over the limit."""
    if reason := unreadable(path):
        raise wrong(f"{path} - {reason}")
    try:
        note_read(path)
        with path.open("rb") as file:
            limit.check(str(path), os.fstat(file.fileno()).st_size, wrong)
            return file.read(limit.value())
    except OSError as error:
        raise wrong(f"{path} - cannot be read (got: {error.strerror or error}) - check its rights") from error


def read_text(path: Path, wrong: type[Mr360uwError]) -> str:
    """Return the text of a UTF-8 file, without a byte order mark; raise `wrong` as `read_data` does, or for others."""
    try:
        return read_data(path, wrong, TEXT).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise wrong(f"{path} - is no text in UTF-8 (got: {error!s:.80}) - save it as such") from None
