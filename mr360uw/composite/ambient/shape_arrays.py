# SPDX-License-Identifier: Apache-2.0
"""Samples of a mesh and what they see of it as arrays by name, the form in which they are kept on the disk."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.ambient.coarse_samples import CoarseSamples
from mr360uw.composite.ambient.lattice import Lattice
from mr360uw.reading.disk_cache import Arrays

_SPARSE = ("data", "indices", "indptr")


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """m directions that something blocks: numbers of the sample, the direction, and the sample that is seen instead."""

    sample: NDArray[np.int64]
    direction: NDArray[np.int64]
    hit: NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Sides:
    """A mesh from +x, -x, +y, -y, +z and -z. area_m2: (3,) of its silhouettes along the axes. seen: (6, C) float32,
    rows of sum 1: part of each coarse sample in the mean of what is seen from each side.
    """

    area_m2: NDArray[np.float64]
    seen: NDArray[np.float32]


_PARTS: Sequence[tuple[str, type[Any], str]] = (
    ("lattice", Lattice, "from_samples"), ("coarse", CoarseSamples, "spread"), ("own", Pairs, ""),
    ("sides", Sides, ""),
)  # fmt: skip
"""Names of the parts, their types, and the field of each that is sparse."""


def arrays_of(lattice: Lattice, coarse: CoarseSamples, own: Pairs, sides: Sides) -> dict[str, NDArray[Any]]:
    """Return the arrays of a mesh's samples, of its coarse samples, of the pairs that it blocks itself, and of its
    sides."""
    arrays: dict[str, NDArray[Any]] = {}
    for (part, kind, sparse), value in zip(_PARTS, (lattice, coarse, own, sides), strict=True):
        for field in fields(kind):
            entry, name = getattr(value, field.name), f"{part}.{field.name}"
            if field.name == sparse:
                arrays |= {f"{name}.{of}": getattr(entry, of) for of in _SPARSE}
                arrays[f"{name}.shape"] = np.array(entry.shape)
            else:
                arrays[name] = _small(np.asarray(entry))
    return arrays


def _small(array: NDArray[Any]) -> NDArray[Any]:
    """Return numbers of samples, points and triangles in the smallest type that holds them."""
    return array.astype(np.min_scalar_type(int(array.max(initial=0)))) if array.dtype == np.int64 else array


def parts_of(arrays: Arrays) -> tuple[Lattice, CoarseSamples, Pairs, Sides]:
    """Return what `arrays_of` was given."""
    from scipy.sparse import csr_matrix

    made = []
    for part, kind, sparse in _PARTS:
        values: dict[str, Any] = {}
        for field in fields(kind):
            name = f"{part}.{field.name}"
            if field.name == sparse:
                entries = tuple(arrays[f"{name}.{of}"] for of in _SPARSE)
                values[field.name] = csr_matrix(entries, shape=tuple(arrays[f"{name}.shape"].tolist()))
            else:
                array = arrays[name]
                whole = array.dtype.kind == "u"
                values[field.name] = array.item() if not array.ndim else array.astype(np.int64) if whole else array
        made.append(kind(**values))
    lattice, coarse, own, sides = made
    return lattice, coarse, own, sides
