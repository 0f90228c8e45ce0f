# SPDX-License-Identifier: Apache-2.0
"""Shapes of arrays at public calls: what comes out for given shapes, and that others are refused by name.

A folder's test_shapes.py holds two tables. `RETURNS` maps a public name (and what of it is called) to a call on inputs
of a batch shape, and to the shapes that it returns for that batch. `REFUSED` maps names to calls with wrong shapes.
"""

from __future__ import annotations

import dataclasses
import inspect
import re
from collections.abc import Callable, Iterable
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from mr360uw.errors import ParameterError

Batch = tuple[int, ...]
Returns = dict[str, tuple[Callable[[Batch], Any], Callable[[Batch], Any]]]
Refused = dict[str, Callable[[], Any]]

BATCHES: tuple[Batch, ...] = ((), (5,), (2, 3))


def filled(*shape: int, value: float = 0.3) -> np.ndarray:
    """Return an array of one value."""
    return np.full(shape, value)


def towards(batch: Batch) -> np.ndarray:
    """Return unit directions (*batch, 3) that point up and to the side."""
    return np.broadcast_to([0.6, 0.8, 0.0], (*batch, 3))


def shapes(value: Any) -> Any:
    """Return the shape of an array, the shapes of a sequence, or those of an object's arrays by field."""
    if isinstance(value, tuple | list):
        return tuple(shapes(item) for item in value)
    if dataclasses.is_dataclass(value):
        fields = ((f.name, getattr(value, f.name)) for f in dataclasses.fields(value))
        return {name: item.shape for name, item in fields if isinstance(item, np.ndarray | np.generic)}
    return np.shape(value)


def functions_of(package: ModuleType) -> set[str]:
    """Return the public functions of a package."""
    return {name for name in package.__all__ if inspect.isfunction(getattr(package, name))}


def called(names: Iterable[str]) -> set[str]:
    """Return what is called: "Water" of "Water.absorption", "caustic_map" of "caustic_map, a plane"."""
    return {re.split(r"\W", name, maxsplit=1)[0] for name in names}


def check_returned(table: Returns, subtests: pytest.Subtests) -> None:
    """Check the shapes that come out of every call of a table, for every batch shape that the call takes."""
    for name, (call, expected) in table.items():
        takes_batches = "_" not in inspect.signature(call).parameters
        for batch in BATCHES if takes_batches else BATCHES[:1]:
            with subtests.test(name, batch=batch):
                assert shapes(call(batch)) == expected(batch)


def check_refused(table: Refused, subtests: pytest.Subtests) -> None:
    """Check that every call of a table is refused with *where - what is wrong (got ...) - what to do*."""
    for name, call in table.items():
        with subtests.test(name), pytest.raises(ParameterError, match=r" - .*\(got .* - "):
            call()
