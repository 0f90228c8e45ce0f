# SPDX-License-Identifier: Apache-2.0
"""Results of long computations, kept on the disk from one run to the next under the hash of all that they depend on.

That is what the caller names, the sources of this package and the version of NumPy: after an edit or an update all is
computed again. Files may be removed at any moment. At their end they have the hash of what they hold, by which damaged
ones are known.
"""

from __future__ import annotations

import functools
import hashlib
import io
import os
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.files import is_ours, write_whole

Arrays = Mapping[str, NDArray[Any]]

FOLDER = "MR360UW_CACHE"
"""Variable of the environment that names another folder; empty: nothing is kept."""
_ROOM = 1 << 30
"""Bytes that all files take at most; those that were used longest ago are removed first."""
_SOURCES = (".py", ".csv", ".json", ".glsl", ".vert", ".geom", ".frag")
_DIGEST = hashlib.sha256().digest_size
_PACKAGE = Path(__file__).parents[1]


def cache_folder() -> Path | None:
    """Return where results are kept: $MR360UW_CACHE, or mr360uw below $XDG_CACHE_HOME or ~/.cache.

    None for nowhere: the variable is empty, the user has no home, or the folder is another user's, who could have put
    results there that are not ours.
    """
    named = os.environ.get(FOLDER)
    if named == "":
        return None
    try:
        if named is not None:
            folder = Path(named).expanduser()
        else:
            folder = Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser() / "mr360uw"
        return folder if not folder.exists() or is_ours(folder) else None
    except (RuntimeError, OSError):  # there is no home, as in some containers, or it cannot be entered
        return None


def cache_file(kind: str, depends_on: Sequence[object]) -> Path | None:
    """Return the file of a result of a kind, whether it is there or not; None where nothing is kept.

    depends_on: arrays count by their content, all else by its `repr`.
    """
    folder = cache_folder()
    if folder is None:
        return None
    found = hashlib.sha256(sources_stamp().encode())
    for item in depends_on:
        if isinstance(item, np.ndarray):
            found.update(f"{item.dtype}{item.shape}".encode())
            found.update(np.ascontiguousarray(item).data)
        else:
            found.update(repr(item).encode())
        found.update(b"\0")
    return folder / f"{kind}-{found.hexdigest()[:40]}.npz"


def kept_arrays(kind: str, depends_on: Sequence[object], make: Callable[[], Arrays]) -> Arrays:
    """Return arrays by their names: from the disk, or made and put there.

    depends_on: all that decides the result, see `cache_file`. A file that is damaged is made anew; where nothing can be
    written, the result is made each time.
    """
    path = cache_file(kind, depends_on)
    found = None if path is None else read_arrays(path)
    if found is not None:
        return found
    made = {name: np.asarray(array, order="C") for name, array in make().items()}  # as they are read
    if path is not None:
        keep_arrays(path, made)
    return made


@contextmanager
def nothing_kept() -> Iterator[None]:
    """Within it nothing is taken from the disk or put there, by all threads: to measure what computing costs."""
    before = os.environ.get(FOLDER)
    os.environ[FOLDER] = ""
    try:
        yield
    finally:
        if before is None:
            del os.environ[FOLDER]
        else:
            os.environ[FOLDER] = before


def kernel_folder() -> Path | None:
    """Return where compiled kernels are kept: $NUMBA_CACHE_DIR, or a folder in that of results; None for nowhere."""
    named = os.environ.get("NUMBA_CACHE_DIR")
    if not named:
        folder = cache_folder()
        return None if folder is None else folder / "kernels"
    folder = Path(named).expanduser()
    return folder if not folder.exists() or is_ours(folder) else None


def read_bytes(path: Path) -> bytes | None:
    """Return what `write_bytes` wrote; None where there is no file, or it is damaged."""
    try:
        stored = path.read_bytes()
        data, mark = stored[:-_DIGEST], stored[-_DIGEST:]
        if hashlib.sha256(data).digest() != mark:
            return None
        with suppress(OSError):  # of another's or read-only, as an installed package: none is removed by its age
            os.utime(path)
    except OSError:
        return None
    return data


def write_bytes(path: Path, data: bytes) -> None:
    """Write bytes, and their SHA-256 after them, to a file that appears whole. Raises `OSError`."""
    write_whole(path, data + hashlib.sha256(data).digest())


def keep_bytes(path: Path, data: bytes) -> None:
    """Write bytes to a file of the cache; on a disk that is full or read-only, none is there."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_bytes(path, data)
        if path.stem.endswith("0"):  # names end in a hash: at every sixteenth file or so
            _make_room(path.parent, path.suffix)
    except OSError:
        return  # it only costs the time to make them again


def read_arrays(path: Path) -> Arrays | None:
    """Return the arrays of a file of `write_arrays`; None where there is none, or it is damaged."""
    data = read_bytes(path)
    if data is None:
        return None
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            return dict(arrays)
    except (ValueError, TypeError, EOFError, zipfile.BadZipFile):  # a file of another kind under a right hash
        return None


def write_arrays(path: Path, arrays: Arrays) -> None:
    """Write arrays to a file (NumPy .npz, see `write_bytes`), which appears whole. Raises `OSError`."""
    write_bytes(path, _packed(arrays))


def keep_arrays(path: Path, arrays: Arrays) -> None:
    """Write arrays to a file of the cache; on a disk that is full or read-only, none is there."""
    keep_bytes(path, _packed(arrays))


def _packed(arrays: Arrays) -> bytes:
    held = io.BytesIO()
    np.savez(held, **arrays)  # type: ignore[arg-type]
    return held.getvalue()


def _make_room(folder: Path, suffix: str) -> None:
    """Remove the files of a kind that were used longest ago, where all take more than `_ROOM`."""
    with os.scandir(folder) as entries:
        stats = [(entry.stat(), entry.path) for entry in entries if entry.name.endswith(suffix)]
    total = sum(stat.st_size for stat, _ in stats)
    for stat, path in sorted(stats, key=lambda pair: pair[0].st_mtime_ns):
        if total <= _ROOM:
            return
        Path(path).unlink(missing_ok=True)
        total -= stat.st_size


@functools.cache
def sources_stamp() -> str:
    """Return what changes with NumPy and with the modules, shaders and tables of this package."""
    return repr((np.__version__, sorted(_stamps(_PACKAGE))))


def _stamps(folder: str | Path) -> Iterator[tuple[str, int, int]]:
    """Yield the name, the length and the time of the last change of all sources below a folder."""
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.is_dir():
                yield from _stamps(entry.path)
            elif entry.name.endswith(_SOURCES):
                stat = entry.stat()
                yield entry.path, stat.st_size, stat.st_mtime_ns
