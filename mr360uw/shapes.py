# SPDX-License-Identifier: Apache-2.0
"""Arguments: checks whose messages name the argument, what it is, and what it should be.

Public functions call them once where an array enters. They refuse what is no number and what is not finite; the test
for that is one sum over the array.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.errors import ParameterError

_NUMBERS = "fiu"
T = TypeVar("T")


def real(name: str, values: ArrayLike) -> NDArray[Any]:
    """Return values as an array of their own type; raise `ParameterError` unless they are real numbers, or NaN."""
    try:
        array = np.asarray(values)
    except (TypeError, ValueError) as error:  # lists of unequal lengths
        raise ParameterError(f"{name} - must be an array of numbers (got: {error!s:.60}) - give one shape") from None
    if array.dtype.kind not in _NUMBERS:
        raise ParameterError(f"{name} - must be real numbers (got {array.dtype}: {values!r:.40}) - give numbers")
    return array


def is_finite(array: NDArray[Any]) -> bool:
    """Return whether all numbers of an array are finite."""
    if array.dtype.kind != "f":
        return True
    with np.errstate(all="ignore"):  # infinities cancel to NaN, and finite ones may overflow
        return bool(np.isfinite(array.sum(dtype=np.float64)) or np.all(np.isfinite(array)))


def numbers(name: str, values: ArrayLike, *, infinite: bool = False) -> NDArray[Any]:
    """Return values as an array of their own type; raise `ParameterError` unless they are real, finite numbers.

    infinite: they may be infinite, not NaN.
    """
    array = real(name, values)
    if not is_finite(array) and not (infinite and not np.any(np.isnan(array))):
        raise ParameterError(f"{name} - must be finite (got {array[~np.isfinite(array)].flat[0]}) - give numbers")
    return array


def number(name: str, value: Any) -> float:
    """Return one number; raise `ParameterError` for other shapes, and as `numbers` does."""
    return float(exactly(name, value, ()))


def whole(name: str, value: Any, least: int, most: int) -> int:
    """Return a whole number of a range; raise `ParameterError` for anything else."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or not least <= value <= most:
        raise ParameterError(f"{name} - must be a whole number (got {value!r:.40}) - choose {least} to {most}")
    return int(value)


def instance(name: str, value: Any, kind: type[T], advice: str) -> T:
    """Return a value of a type; raise `ParameterError` for one of another. advice: what makes one."""
    if not isinstance(value, kind):
        raise ParameterError(f"{name} - must be a {kind.__name__} (got {type(value).__name__}) - {advice}")
    return value


def file_path(name: str, value: Any) -> Path:
    """Return a path; raise `ParameterError` for what is no name of a file."""
    if not isinstance(value, str) and not hasattr(value, "__fspath__"):
        raise ParameterError(f"{name} - must be the name of a file (got {type(value).__name__}) - give text or a Path")
    return Path(value)


def vectors(name: str, values: ArrayLike, size: int = 3) -> NDArray[Any]:
    """Return values as an array (..., size) of their own type; raise `ParameterError` for another last axis."""
    array = numbers(name, values)
    if array.ndim == 0 or array.shape[-1] != size:
        raise ParameterError(f"{name} - must be (..., {size}) (got shape {array.shape}) - give {size} numbers each")
    return array


def exactly(name: str, values: ArrayLike, *shapes: tuple[int, ...]) -> NDArray[Any]:
    """Return values as an array of their own type; raise `ParameterError` unless they have one of the shapes."""
    array = numbers(name, values)
    if array.shape not in shapes:
        wanted = " or ".join(str(shape) for shape in shapes)
        raise ParameterError(f"{name} - must have the shape {wanted} (got {array.shape}) - reshape it")
    return array


def common_shape(may_be_infinite: str = "", **arguments: ArrayLike) -> tuple[int, ...]:
    """Return the shape to which arguments broadcast; raise `ParameterError` where they do not, or are no numbers.

    may_be_infinite: the name of one that may.
    """
    shapes = {n: numbers(n, values, infinite=n == may_be_infinite).shape for n, values in arguments.items()}
    try:
        return np.broadcast_shapes(*shapes.values())
    except ValueError:
        got = ", ".join(f"{name} {shape}" for name, shape in shapes.items())
        raise ParameterError(f"{', '.join(shapes)} - do not fit together (got {got}) - give one shape") from None
