# SPDX-License-Identifier: Apache-2.0
"""Values kept from frame to frame, each under a name and the key of everything it depends on.

A value is a function of its key: the cache may be emptied at any moment without changing a result.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Any, TypeVar

T = TypeVar("T")


class Same:
    """A key that equals only itself for one and the same object, which it keeps alive: for arrays."""

    __slots__ = ("value",)

    def __init__(self, value: object) -> None:
        self.value = value

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Same) and other.value is self.value

    def __hash__(self) -> int:
        return object.__hash__(self.value)


class Cache:
    """Keeps the last values of every name."""

    def __init__(self) -> None:
        self._kept: dict[str, dict[Hashable, Any]] = {}

    def get(self, name: str, key: Hashable, make: Callable[[], T], keep: int = 1) -> T:
        """Return the value of a name for a key; `make` it where it is not among the last `keep` that were asked for."""
        values = self._kept.setdefault(name, {})
        value: T = values.pop(key) if key in values else make()
        values[key] = value
        while len(values) > keep:
            values.pop(next(iter(values)))
        return value

    def drop(self, name: str) -> None:
        """Forget the values of a name."""
        self._kept.pop(name, None)

    def clear(self) -> None:
        """Forget everything."""
        self._kept.clear()
