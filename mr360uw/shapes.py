# SPDX-License-Identifier: Apache-2.0
"""Shapes of array arguments: checks whose messages name the argument, its shape and the one it should have."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.errors import ParameterError


def vectors(name: str, values: ArrayLike, size: int = 3) -> NDArray[Any]:
    """Return values as an array (..., size) of their own type; raise `ParameterError` for another last axis."""
    array = np.asarray(values)
    if array.ndim == 0 or array.shape[-1] != size:
        raise ParameterError(f"{name} - must be (..., {size}) (got shape {array.shape}) - give {size} numbers each")
    return array


def exactly(name: str, values: ArrayLike, *shapes: tuple[int, ...]) -> NDArray[Any]:
    """Return values as an array of their own type; raise `ParameterError` unless they have one of the shapes."""
    array = np.asarray(values)
    if array.shape not in shapes:
        wanted = " or ".join(str(shape) for shape in shapes)
        raise ParameterError(f"{name} - must have the shape {wanted} (got {array.shape}) - reshape it")
    return array


def common_shape(**arguments: ArrayLike) -> tuple[int, ...]:
    """Return the shape to which arguments broadcast; raise `ParameterError` where they do not fit together."""
    shapes = {name: np.shape(values) for name, values in arguments.items()}
    try:
        return np.broadcast_shapes(*shapes.values())
    except ValueError:
        got = ", ".join(f"{name} {shape}" for name, shape in shapes.items())
        raise ParameterError(f"{', '.join(shapes)} - do not fit together (got {got}) - give one shape") from None
