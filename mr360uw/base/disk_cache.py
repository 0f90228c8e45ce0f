# SPDX-License-Identifier: Apache-2.0
"""Results of long computations, kept on the disk from one run to the next.

A file on the disk has in its name the hash of all that the result depends on: what the caller names, the sources of
this package and the version of NumPy. After an edit or an update all is computed again. Files may be removed at any
moment. At their end they have the hash of what they hold, by which damaged ones are known.

Only files that no other user could have put there are read (`files.unsafe`): compiled kernels are pickles, which run
code as they are loaded, and a planted table would change a picture. On Windows, where that is not judged, the folder
below the user's profile is trusted. Kernels that came with the package are as trusted as its sources.
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

from mr360uw.base.files import unsafe, whole_file, write_whole

Arrays = Mapping[str, NDArray[Any]]

FOLDER = "MR360UW_CACHE"
"""Variable of the environment that names another folder; empty: nothing is kept."""
_ROOM = 1 << 30
"""Bytes that all files take at most; those that were used longest ago are removed first."""
_SOURCES = (".py", ".csv", ".json", ".glsl", ".vert", ".geom", ".frag")
_OWN_FOLDER, _NOT_OTHERS = 0o700, 0o755
"""Rights of a folder that is made, and those that the user's mask may leave to a file."""
_DIGEST = hashlib.sha256().digest_size
_PACKAGE = Path(__file__).parents[1]


def cache_folder() -> Path | None:
    """Return where results are kept: $MR360UW_CACHE, or mr360uw below $XDG_CACHE_HOME or ~/.cache.

    None for nowhere: the variable is empty, the user has no home, or another user could have put results there.
    """
    return _safe(_results_named())


def kernel_folder() -> Path | None:
    """Return where compiled kernels are kept: $NUMBA_CACHE_DIR, or a folder in that of results; None for nowhere."""
    return _safe(_kernels_named())


def is_writable(folder: Path) -> bool:
    """Return whether files can be kept in a folder, which may be made for them."""
    there = next(one for one in (folder, *folder.parents) if one.exists())
    return there.is_dir() and os.access(there, os.W_OK | os.X_OK)


def cache_notes() -> list[str]:
    """Return a line for each reason why folders that are named for results or kernels are not used."""
    named = [folder for folder in (_results_named(), _kernels_named()) if folder is not None]
    unwritable = [folder for folder in named if not unsafe(folder) and not is_writable(folder)]
    lines = [
        f"cache - {reason}, so nothing is read from there or kept there - take that away (chown, chmod go-w), or name "
        f"a folder of your own in {FOLDER}"
        for reason in filter(None, map(unsafe, named))
    ]
    lines += [
        f"cache - nothing new can be kept in {folder} - make it writable, or name another folder in {FOLDER}"
        for folder in unwritable
    ]
    return list(dict.fromkeys(lines))


def _results_named() -> Path | None:
    """Return the folder for results, absolute, whoever it belongs to; None where none is wanted or there is no home.

    A relative $XDG_CACHE_HOME is ignored, as its standard demands.
    """
    named = os.environ.get(FOLDER)
    if named is not None:
        return _absolute(named)
    base = os.environ.get("XDG_CACHE_HOME", "")
    folder = _absolute(base if Path(base).is_absolute() else "~/.cache")
    return None if folder is None else folder / "mr360uw"


def _kernels_named() -> Path | None:
    named = os.environ.get("NUMBA_CACHE_DIR")
    if named:
        return _absolute(named)
    folder = _results_named()
    return None if folder is None else folder / "kernels"


def _absolute(named: str) -> Path | None:
    """Return a folder that the environment names, from the current one on; None for "" or where there is no home."""
    try:
        return Path(named).expanduser().absolute() if named else None
    except RuntimeError:  # there is no home, as in some containers
        return None


def _safe(folder: Path | None) -> Path | None:
    return None if folder is None or unsafe(folder) else folder


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
    found = None if path is None else read_arrays(path, kept=True)
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


def read_kept(path: Path) -> bytes | None:
    """Return what `keep_bytes` wrote; None where there is no file, it is damaged, or another user could have put it."""
    return None if unsafe(path) else read_bytes(path)


def read_bytes(path: Path) -> bytes | None:
    """Return the bytes of a file that ends in their SHA-256; None where there is no file, or it is damaged."""
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


def keep_bytes(path: Path, data: bytes) -> None:
    """Write bytes, and their SHA-256 after them, to a file of the cache; on a full or read-only disk, none is there.

    Whatever the user's mask is, nobody else may write to it: it would not be read (`read_kept`).
    """
    try:
        for folder in reversed([one for one in (path.parent, *path.parent.parents) if not one.exists()]):
            folder.mkdir(_OWN_FOLDER, exist_ok=True)
        with whole_file(path) as part:
            part.chmod(part.stat().st_mode & _NOT_OTHERS)
            part.write_bytes(_sealed(data))
        if path.stem.endswith("0"):  # names end in a hash: at every sixteenth file or so
            _make_room(path.parent, path.suffix)
    except OSError:
        return  # it only costs the time to make them again


def read_arrays(path: Path, *, kept: bool = False) -> Arrays | None:
    """Return the arrays of a file of `write_arrays` or `keep_arrays`; None where there is none, or it is damaged.

    kept: it is one of the cache; None as for `read_kept`.
    """
    data = read_kept(path) if kept else read_bytes(path)
    if data is None:
        return None
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            return dict(arrays)
    except (ValueError, TypeError, EOFError, zipfile.BadZipFile):  # a file of another kind under a right hash
        return None


def write_arrays(path: Path, arrays: Arrays) -> None:
    """Write arrays to a file (NumPy .npz, and its SHA-256), which appears whole. Raises `OSError`."""
    write_whole(path, _sealed(_packed(arrays)))


def keep_arrays(path: Path, arrays: Arrays) -> None:
    """Write arrays to a file of the cache; on a disk that is full or read-only, none is there."""
    keep_bytes(path, _packed(arrays))


def _sealed(data: bytes) -> bytes:
    return data + hashlib.sha256(data).digest()


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
