# SPDX-License-Identifier: Apache-2.0
"""Cache of results between frames: the result of a function is found again by the function and its inputs.

Nobody writes a key: it is made of the inputs' versions. A function that is cached is a plain one, so that its inputs
are all that it can depend on, and the cache may be emptied at any moment without changing a result.

The version of an input is what it is equal to: settings and numbers count by value, arrays of up to a megabyte by their
content, what is assembled anew in every frame (`Parts`) by the versions of its fields, and all else, which is loaded or
computed once, by identity, as long as it is kept itself. Caches change no result, so they count for nothing. Files that
a function read (`input_files.files_read`) are watched: where one has changed, the function is called again.

Functions far below, which have no cache at hand, are `shared`: all scenes of the process find their results, until one
of the scenes is closed (`drop_shared`). What does not depend on a scene or a plate has `functools.cache`, and what an
object works out of itself `cached_property`.
"""

from __future__ import annotations

import functools
import math
import operator
import threading
import weakref
from collections import Counter
from collections.abc import Callable, Hashable, Iterable
from dataclasses import fields, is_dataclass
from pathlib import Path
from types import MethodType
from typing import Any, Generic, TypeVar, TypeVarTuple

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.input_files import Stamp, files_read, note_read, stamp

T = TypeVar("T")
Inputs = TypeVarTuple("Inputs")

_MISSING: tuple[Any, dict[Path, Stamp]] = object(), {}
"""Stands for a result that is not there, and the files that it was read from."""
_BY_CONTENT = 1 << 20
"""Bytes of an array up to which it counts by its content: to read a megabyte takes a third of a millisecond."""


class Neutral:
    """Base of inputs that change no result, as caches do."""


class Parts:
    """Base of dataclasses that are assembled anew in every frame: as an input of a cached function, equal parts are an
    equal whole.
    """

    __slots__ = ()


class PartOf(Generic[T]):
    """An input of which a function uses some parts alone, and which stands for nothing else: equal where these are.

    whole: what they are taken from; a cache does not keep it. version: of the parts.
    """

    __slots__ = ("version", "whole")

    def __init__(self, whole: T, *parts: object) -> None:
        self.whole, self.version = whole, version(parts)


class Same:
    """An object by identity: equal only for one and the same, which it keeps alive."""

    __slots__ = ("value",)

    def __init__(self, value: object) -> None:
        self.value = value

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Same) and other.value is self.value

    def __hash__(self) -> int:
        return object.__hash__(self.value)


def by_content(array: NDArray[Any]) -> PartOf[NDArray[Any]]:
    """Return a large array that counts by its content, as one that is made anew in every frame has to."""
    return PartOf(array, array.dtype.str, array.shape, array.tobytes())


def version(item: Any) -> Hashable:
    """Return what stands for an input: equal where a function of it has the same result."""
    if isinstance(item, np.ndarray):
        return (item.dtype.str, item.shape, item.tobytes()) if item.nbytes <= _BY_CONTENT else Same(item)
    if isinstance(item, tuple | list):
        return tuple(map(version, item))
    if isinstance(item, Neutral):
        return Neutral
    if isinstance(item, PartOf):
        return PartOf, item.version
    if isinstance(item, Parts):
        kind: Any = type(item)
        return kind, *map(version, _fields_of(kind)(item))
    try:
        hash(item)
    except TypeError:  # a dataclass that would compare arrays
        return Same(item)
    hashable: Hashable = item
    return hashable


@functools.cache
def _fields_of(kind: Any) -> Callable[[Any], Iterable[Any]]:
    """Return the function that gives the values of an object's fields."""
    names = [field.name for field in fields(kind)]
    return operator.attrgetter(*names) if len(names) > 1 else lambda item: [getattr(item, name) for name in names]


class Cache(Neutral):
    """The most recently used results of every function, for any number of threads.

    A result is made anew where a file that it was read from has changed; the files of one that is found are noted as if
    they had been read again. Threads that ask for the same at the same time may each call the function. room: factor on
    how many are kept, for frames of that many kinds which take turns.
    """

    def __init__(self, room: int = 1) -> None:
        self._room = room
        self._lock = threading.RLock()
        self._kept: dict[Any, dict[Hashable, tuple[Any, dict[Path, Stamp]]]] = {}
        self.made: Counter[str] = Counter()
        """How often each function was called, by its name (`name_of`)."""

    def of(self, function: Callable[[*Inputs], T], *inputs: *Inputs, keep: int = 1) -> T:
        """Return the result of a function; call it if that is not among the last `keep` used of its results.

        keep: is multiplied by the cache's room. Raises `TypeError` for a function made within another one: it may
        depend on more than its inputs.
        """
        plain, key = _with_own(function, inputs)
        with self._lock:
            result, files = kept = self._kept.get(plain, {}).get(key, _MISSING)
        if kept is _MISSING or any(stamp(path) != before for path, before in files.items()):
            name = name_of(plain)
            with files_read() as read:
                result = function(*inputs)
            files = {path: stamp(path) for path in read}
            with self._lock:
                self.made[name] += 1
        for path in files:
            note_read(path)
        with self._lock:
            results = self._kept.setdefault(plain, {})  # only now: the call may have dropped it
            results.pop(key, None)
            results[key] = result, files
            while len(results) > keep * self._room:
                results.pop(next(iter(results)))
        found: T = result
        return found

    def holds(self, function: Callable[..., Any], *inputs: object) -> bool:
        """Return whether the result of a function is there."""
        plain, key = _with_own(function, inputs)
        with self._lock:
            return key in self._kept.get(plain, {})

    def drop(self, function: Callable[..., Any], *inputs: object) -> None:
        """Remove a function's result for some inputs; all its results where none are given."""
        plain, key = _with_own(function, inputs)
        with self._lock:
            if inputs:
                self._kept.get(plain, {}).pop(key, None)
            else:
                self._kept.pop(plain, None)

    def clear(self) -> None:
        """Remove all results."""
        with self._lock:
            self._kept.clear()


def _with_own(function: Callable[..., Any], inputs: tuple[Any, ...]) -> tuple[Callable[..., Any], Hashable]:
    """Return a function, or a method's plain one, and the version of its inputs, of which a method's object is one.

    An object that is no dataclass is not kept alive: it often owns the cache, and both would wait for the garbage
    collector, which counts objects and not their size.
    """
    if isinstance(function, MethodType):
        own = function.__self__
        counted = version(own) if is_dataclass(own) else weakref.ref(own)
        return function.__func__, (counted, version(inputs))
    return function, version(inputs)


def name_of(function: Callable[..., Any]) -> str:
    """Return the name of a function that sees nothing but its inputs; raise `TypeError` for one within another."""
    name = function.__qualname__
    if "<" in name:
        raise TypeError(f"{name} - may depend on more than its inputs - write it at the top of a module")
    return name.lstrip("_")


_SHARED: list[functools._lru_cache_wrapper[Any]] = []
"""All functions that are `shared`, listed as their modules are loaded."""


def shared(keep: int) -> Callable[[Callable[..., T]], functools._lru_cache_wrapper[T]]:
    """Return a decorator for a plain function of a scene's settings or a plate's kind, whose last `keep` results all
    scenes share. Its inputs are hashable.
    """

    def decorated(function: Callable[..., T]) -> functools._lru_cache_wrapper[T]:
        kept = functools.lru_cache(maxsize=keep)(function)
        _SHARED.append(kept)
        return kept

    return decorated


def drop_shared() -> None:
    """Let go of the results of all `shared` functions, on any thread; scenes still open call them anew."""
    for kept in _SHARED:
        kept.cache_clear()


def room(*shapes: int | tuple[int, ...], dtype: type[np.generic] = np.float32) -> tuple[NDArray[Any], ...]:
    """Return arrays of zeros for a kernel to work in: of their own, for rows of one would be taken for overlapping."""
    return tuple(np.zeros(shape, dtype) for shape in shapes)


class Scratch:
    """Memory for arrays that are made anew in every frame: to take it from the system costs as much as to fill it."""

    def __init__(self) -> None:
        self._of_thread = threading.local()

    def floats(self, name: str, *shape: int) -> NDArray[np.float32]:
        """Return an array of any contents; it is the caller's until its thread asks for the same name."""
        flat: dict[str, NDArray[np.float32]] = vars(self._of_thread)
        size = math.prod(shape)
        if name not in flat or flat[name].size < size:
            flat[name] = np.empty(size, np.float32)
        return flat[name][:size].reshape(shape)
