# SPDX-License-Identifier: Apache-2.0
"""What the machine code of a kernel follows from, as a hash."""

from __future__ import annotations

import dis
from types import BuiltinFunctionType, CodeType, EllipsisType, FunctionType, ModuleType
from typing import Any

import numpy as np
from numba.core.dispatcher import Dispatcher
from numba.core.types.abstract import Type
from numba.core.types.containers import BaseNamedTuple, BaseTuple
from numba.core.types.functions import Dispatcher as DispatcherType
from numba.extending import _Intrinsic


def add_to(found: Any, value: Any, within: tuple[int, ...] = ()) -> None:
    """Add to a hash what a kernel takes from a value that it names: of functions their code and what that names.

    within: identities of the functions that led here, which may call themselves. Raises `TypeError` for values of a
    kind that no kernel has named so far.
    """
    found.update(f"({type(value).__name__} ".encode())

    def add(*parts: Any) -> None:
        for part in parts:
            add_to(found, part, within)

    match value:
        case Dispatcher():
            found.update(repr(sorted(value.targetoptions.items())).encode())
            add(value.py_func)
        case _Intrinsic():
            add(value._defn)
        case FunctionType() if id(value) not in within:
            named = [value.__globals__.get(name) for name in sorted(_globals(value.__code__))]
            cells = [cell.cell_contents for cell in value.__closure__ or ()]
            for part in (value.__code__, value.__defaults__, *named, *cells):
                add_to(found, part, (*within, id(value)))
        case CodeType():
            found.update(value.co_code)
            add(value.co_names, value.co_varnames, value.co_consts)
        case DispatcherType():
            add(value.dispatcher)
        case BaseNamedTuple():
            add(value.instance_class, tuple(value.types))
        case BaseTuple():
            add(tuple(value.types))
        case Type():
            found.update(repr(value).encode())
        case tuple() | list():
            add(*value)
        case np.ndarray():
            found.update(f"{value.dtype.str}{value.shape}".encode() + value.tobytes())
        case type():
            found.update(f"{value.__module__}.{value.__qualname__}{getattr(value, '_fields', '')}".encode())
        case FunctionType() | BuiltinFunctionType():
            found.update(value.__name__.encode())
        case ModuleType() if not value.__name__.startswith(__package__):
            found.update(value.__name__.encode())
        case np.ufunc() | np.generic() | int() | float() | complex() | str() | bytes() | EllipsisType() | None:
            found.update(repr(value).encode())
        case _ if callable(value) and str(getattr(value, "__module__", "")).startswith("numpy"):
            found.update(repr(value.__name__).encode())
        case _:
            raise TypeError(f"a kernel names a {type(value).__name__}, which its stamp does not know")
    found.update(b")")


def _globals(code: CodeType) -> set[str]:
    """Return the names that a function's code looks up in its module, also in the functions within it."""
    within = [_globals(part) for part in code.co_consts if isinstance(part, CodeType)]
    return {i.argval for i in dis.get_instructions(code) if i.opname == "LOAD_GLOBAL"}.union(*within)
