# SPDX-License-Identifier: Apache-2.0
"""Cache of values between frames, each under a name and a key of everything it depends on.

A value is a function of its key, so the cache may be emptied at any moment without changing a result. In keys,
settings count by value; what was loaded or computed before counts by identity, as long as it is kept itself.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Hashable, Sequence
from dataclasses import fields
from functools import partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

T = TypeVar("T")


class Same:
    """A key by identity, for arrays: equal only for one and the same object, which it keeps alive."""

    __slots__ = ("value",)

    def __init__(self, value: object) -> None:
        self.value = value

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Same) and other.value is self.value

    def __hash__(self) -> int:
        return object.__hash__(self.value)


def by_value(item: Any) -> Hashable:
    """Return a key of a dataclass that is equal for equal values; arrays count by their content."""
    values = (getattr(item, field.name) for field in fields(item))
    return type(item), *(value.tobytes() if isinstance(value, np.ndarray) else value for value in values)


class Cache:
    """The most recently used values of every name.

    room: factor on how many are kept, for frames of that many kinds which take turns.
    """

    def __init__(self, room: int = 1) -> None:
        self._room = room
        self._kept: dict[str, dict[Hashable, Any]] = {}
        self.made: Counter[str] = Counter()
        """How often a value of each name was made."""

    def get(self, name: str, key: Hashable, make: Callable[[], T], keep: int = 1) -> T:
        """Return the value of a name for a key; call `make` if it is not among the last `keep` used of that name.

        keep: is multiplied by the cache's room.
        """
        if key in self._kept.get(name, {}):
            value: T = self._kept[name].pop(key)
        else:
            value = make()
            self.made[name] += 1
        values = self._kept.setdefault(name, {})  # only now: `make` may have dropped the name
        values[key] = value
        while len(values) > keep * self._room:
            values.pop(next(iter(values)))
        return value

    def get_all(
        self, name: str, keys: Sequence[Hashable], make: Callable[[list[Any]], Sequence[T]], keep: int = 1
    ) -> list[T]:
        """Return the values of a name for several keys; `make` is called once, with the keys of those that it returns.

        Otherwise as `get`.
        """
        missing = [key for key in dict.fromkeys(keys) if not self.holds(name, key)]
        held = {key: self._kept[name][key] for key in keys if self.holds(name, key)}
        held |= zip(missing, make(missing), strict=True) if missing else ()
        return [self.get(name, key, partial(held.__getitem__, key), keep) for key in keys]

    def holds(self, name: str, key: Hashable) -> bool:
        """Return whether a value of a name is there for a key."""
        return key in self._kept.get(name, {})

    def drop(self, name: str, *keys: Hashable) -> None:
        """Remove the values of a name, or of some of its keys."""
        for key in keys:
            self._kept.get(name, {}).pop(key, None)
        if not keys:
            self._kept.pop(name, None)

    def clear(self) -> None:
        """Remove all values."""
        self._kept.clear()


class Room:
    """Memory for arrays that are made anew in every frame: to take it from the system costs as much as to fill it."""

    def __init__(self) -> None:
        self._flat: dict[str, NDArray[np.float32]] = {}

    def floats(self, name: str, *shape: int) -> NDArray[np.float32]:
        """Return an array of any contents; it is the caller's until the same name is asked for."""
        size = math.prod(shape)
        if name not in self._flat or self._flat[name].size < size:
            self._flat[name] = np.empty(size, np.float32)
        return self._flat[name][:size].reshape(shape)
