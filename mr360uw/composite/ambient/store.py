# SPDX-License-Identifier: Apache-2.0
"""Results of long computations kept on the disk under the hash of what they depend on."""

from __future__ import annotations

import hashlib
import io
import os
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mr360uw.files import write_whole

_FOLDER = "ambient"


def cache_folder() -> Path:
    """Return where results are kept: mr360uw/ambient below $XDG_CACHE_HOME, or ~/.cache."""
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "mr360uw" / _FOLDER


def kept_on_disk(
    depends_on: Sequence[NDArray[np.generic]],
    names: Sequence[str],
    limits: Sequence[int],
    make: Callable[[], Sequence[NDArray[np.int64]]],
) -> tuple[NDArray[np.int64], ...]:
    """Return whole numbers (m,), one array a name, each below its limit: from the disk, or made and put there.

    depends_on: arrays that decide the result. A file that is damaged is made anew; where nothing can be written, the
    result is made each time.
    """
    digest = hashlib.sha256()
    for array in depends_on:
        digest.update(f"{array.dtype}{array.shape}".encode() + np.ascontiguousarray(array).tobytes())
    path = cache_folder() / f"{digest.hexdigest()}.npz"
    found = _read(path, names, limits)
    if found is not None:
        return found
    made = tuple(make())
    data = io.BytesIO()
    small = {
        name: array.astype(np.min_scalar_type(max(limit, 1)))
        for name, array, limit in zip(names, made, limits, strict=True)
    }
    np.savez(data, **small)  # type: ignore[arg-type]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, data.getvalue())
    except OSError:
        return made  # a disk that is full or read-only only costs the time to make it again
    return made


def _read(path: Path, names: Sequence[str], limits: Sequence[int]) -> tuple[NDArray[np.int64], ...] | None:
    """Return what a file holds; None where there is none, or not what was written."""
    try:
        with path.open("rb") as data, np.load(data) as file:
            arrays = tuple(file[name].astype(np.int64) for name in names)
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None
    whole = all(a.ndim == 1 and len(a) == len(arrays[0]) for a in arrays)
    return arrays if whole and all(np.all((a >= 0) & (a < n)) for a, n in zip(arrays, limits, strict=True)) else None
