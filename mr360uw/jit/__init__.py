# SPDX-License-Identifier: Apache-2.0
"""Loops compiled to machine code (kernels), and where compiled ones are kept.

`exact`     arithmetic as it is written
`fast`      sums may be reordered, products and sums joined, divisions multiplied; no number may be infinite or NaN
`inlined`   becomes part of the kernels that call it, with their arithmetic

`exact` and `fast` kernels read and write arrays that they are passed, make none and return numbers. `exact_making` and
`fast_making` are for kernels that make arrays: they count who uses every array that they touch, in memory that all
threads share, which in a loop over a few numbers costs more than what it does, and takes a tenth longer to compile. So
a loop that needs room is passed it, of `base.cache.room`. One that makes none calls none that returns an array.

Each kernel costs a tenth of a second or more in a first run. One that sets a row of an array to another array, or
multiplies one in place, costs two seconds, as NumPy's broadcasting and its error texts are compiled with it: numbers
are set one by one. `inlined` is for what is short or called once: its statements are compiled again in each caller.

All run outside of Python's lock; a division by zero gives infinity, as in NumPy. A kernel is compiled for a class of
processors, not for one, so that all workers of a farm compute the same: x86-64-v3, ARMv8, or, where the machine is
older than these, for itself.

A compiled kernel is looked for among those that came with the package, then in the user's cache (`disk_cache`), under
the hash of all that its machine code follows from: `add_to` reads what the compiler reads, the code of the function and
of every function and constant that it names. So kernels are never stale, copies of the same sources share them, and
an edit compiles anew what it touches and nothing else.
"""

from __future__ import annotations

import dis
import hashlib
import os
import pickle
import platform
import sys
from collections.abc import Callable
from functools import cache, cached_property
from pathlib import Path
from types import BuiltinFunctionType, CodeType, EllipsisType, FunctionType, ModuleType
from typing import Any, TypeVar

import llvmlite
import llvmlite.binding
import numba
import numpy as np
from llvmlite import ir
from numba.core import config, sigutils, types
from numba.core.caching import _Cache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompileResult
from numba.core.dispatcher import Dispatcher
from numba.core.runtime.nrt import rtsys
from numba.core.serialize import dumps
from numba.core.types.abstract import Type
from numba.core.types.containers import BaseNamedTuple, BaseTuple
from numba.core.types.functions import Dispatcher as DispatcherType
from numba.extending import _Intrinsic, intrinsic

from mr360uw.base.disk_cache import keep_bytes, kernel_folder, read_bytes, read_kept

F = TypeVar("F", bound=Callable[..., Any])

SHIPPED = Path(__file__).parents[1] / "compiled"
"""Kernels that came with the package; see `make wheel`."""
_V3 = ("avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe")
"""What processors of the class x86-64-v3 have beside those before."""


def exact(function: F) -> F:
    """Return a function of numbers and arrays as a kernel, compiled at its first call with arguments of a type."""
    return _kernel(function, _nrt=False)


def fast(function: F) -> F:
    """Return a function of numbers and arrays as a kernel that need not keep to the order of its arithmetic."""
    return _kernel(function, fastmath=True, _nrt=False)


def exact_making(function: F) -> F:
    """Return a function as a kernel, as `exact` does, that makes arrays."""
    return _kernel(function)


def fast_making(function: F) -> F:
    """Return a function as a kernel, as `fast` does, that makes arrays."""
    return _kernel(function, fastmath=True)


def inlined(function: F) -> F:
    """Return a function that becomes part of each kernel that calls it."""
    return _kernel(function, inline="always")


@intrinsic  # type: ignore[untyped-decorator, misc, unused-ignore]
def mix_texels(_: Any, texels: Any, places: Any, shares: Any, out: Any, at: Any) -> Any:
    """Write the four channels of a texel and the one beside it, in two rows, mixed in shares of each, to `out` from
    `at` on: four numbers in one instruction, of which the compiler on its own takes one by one.

    places: of the first channel in either row. shares: of the texels, row by row.
    """

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        def pointer(array: int, place: Any, beside: int) -> Any:
            data = context.make_array(signature.args[array])(context, builder, values[array]).data
            place = builder.add(place, place.type(4 * beside))
            return builder.bitcast(builder.gep(data, [place]), four.as_pointer())

        four, whole = ir.VectorType(ir.FloatType(), 4), ir.Constant(ir.VectorType(ir.IntType(32), 4), [0] * 4)
        total = ir.Constant(four, [0.0] * 4)
        for n in range(4):
            place, share = builder.extract_value(values[1], n // 2), builder.extract_value(values[2], n)
            first = builder.insert_element(ir.Constant(four, ir.Undefined), share, ir.IntType(32)(0))
            shares = builder.shuffle_vector(first, first, whole)
            texel = builder.load(pointer(0, place, n % 2), align=4)
            total = builder.fadd(total, builder.fmul(shares, texel, flags=("fast",)), flags=("fast",))
        builder.store(total, pointer(3, values[4], 0), align=4)
        return context.get_dummy_value()

    return types.void(texels, places, shares, out, at), generate


def _kernel(function: F, **options: Any) -> F:
    _compile_for_class()
    # Without the entry for callers in C, of whom there are none
    kernel: Any = numba.njit(nogil=True, error_model="numpy", no_cfunc_wrapper=True, **options)(function)
    if isinstance(kernel, Dispatcher):  # not where NUMBA_DISABLE_JIT leaves it a function
        vars(kernel)["_cache"] = _Kept(kernel)
    compiled: F = kernel
    return compiled


@cache
def _compile_for_class() -> None:
    """Tell the compiler the class of this machine's processor, unless NUMBA_CPU_NAME says another.

    In the environment: the compiler reads it again when any of its variables changes.
    """
    if config.CPU_NAME is not None:
        return
    if platform.machine() in ("aarch64", "arm64"):
        name = "generic"
    elif all(llvmlite.binding.get_host_cpu_features().get(name) for name in _V3):
        name = "x86-64-v3"
    else:
        return
    os.environ.update(NUMBA_CPU_NAME=name, NUMBA_CPU_FEATURES="")
    config.reload_config()


class _Library(JITCodeLibrary):  # type: ignore[misc, unused-ignore]
    """The code of a kernel, machine code and bitcode; that of a kept one is read where one that calls it is compiled.

    Reading the bitcode of all kernels of a run, and the names in it, takes as long as all else of loading them.
    """

    _bitcode = b""

    @classmethod
    def _unserialize(cls, codegen: Any, state: Any) -> Any:
        name, _, (code, bitcode) = state
        library = codegen.create_library(name)
        library.enable_object_caching()
        library._set_compiled_object(code)
        library._finalize_final_module()
        library._bitcode = bitcode
        return library

    def get_pointer_to_function(self, name: str) -> int:
        # Of a kept kernel its own function is asked for, which is there
        address = self._codegen._engine.get_function_address if self._bitcode else super().get_pointer_to_function
        return int(address(name))

    def _get_module_for_linking(self) -> Any:
        if self._bitcode:
            self._shared_module, self._bitcode = llvmlite.binding.parse_bitcode(self._bitcode), b""
            self._codegen._engine._load_defined_symbols(self._shared_module)
        return super()._get_module_for_linking()


class _Kept(_Cache):  # type: ignore[misc, unused-ignore]
    """Where a kernel is looked for before it is compiled, and kept afterwards, for each type of its arguments."""

    def __init__(self, kernel: Any) -> None:
        self._kernel, self._enabled = kernel, True

    @property
    def cache_path(self) -> str:
        return str(kernel_folder())

    def file(self, sig: Any) -> Path | None:
        """Return the file of the kernel for arguments of a type; None where there is none."""
        name = self._name(sig, self._kernel.targetctx.codegen())
        files = [folder / name for folder in (SHIPPED, kernel_folder()) if folder is not None]
        return next((file for file in files if file.is_file()), None)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the kernel for arguments of a type, None where it must be compiled."""
        # Memory for what kernels make; the tables of the compiler are read where one must be compiled
        rtsys.initialize(target_context)
        target_context.codegen()._library_class = _Library
        name = self._name(sig, target_context.codegen())
        for folder, read in ((SHIPPED, read_bytes), (kernel_folder(), read_kept)) if self._enabled else ():
            stored = None if folder is None else read(folder / name)
            if stored is not None:
                try:
                    return CompileResult._rebuild(target_context, *pickle.loads(stored))  # noqa: S301 - nobody else's
                except ModuleNotFoundError:  # a function that it names has moved, with the same code, to another module
                    return None
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep a compiled kernel for arguments of a type. Raises `TypeError` for one that returns an array that it was
        passed: its caller would free it.
        """
        if not self._kernel.targetoptions.get("_nrt", True) and "array(" in str(data.signature.return_type):
            raise TypeError(f"{self._kernel.__name__} returns an array of which it counted no users")
        folder = kernel_folder()
        if folder is not None and self._enabled and not data.lifted and not data.library.has_dynamic_globals:
            keep_bytes(folder / self._name(sig, data.codegen), dumps(data._reduce()))

    def enable(self) -> None:
        self._enabled = True

    def disable(self) -> None:
        self._enabled = False

    def flush(self) -> None:
        """Keep to what is there: a kernel that no longer holds is not found under its name."""

    def _name(self, sig: Any, codegen: Any) -> str:
        found = self._sources.copy()
        add_to(found, sigutils.normalize_signature(sig)[0])
        found.update(repr(codegen.magic_tuple()).encode())
        return f"{self._kernel.__module__}.{self._kernel.__name__}-{found.hexdigest()[:32]}.nbc"

    @cached_property
    def _sources(self) -> Any:
        found = hashlib.sha256(repr(versions()).encode())
        add_to(found, self._kernel)
        return found


_LOAD_GLOBAL = dis.opmap["LOAD_GLOBAL"]


@cache
def versions() -> tuple[object, ...]:
    """Return what compiles: the same sources give other machine code where one of these is another."""
    compiler = (numba.__version__, llvmlite.__version__, config.OPT, config.USING_SVML, config.BOUNDSCHECK)
    return (sys.implementation.cache_tag, np.__version__.split(".")[:2], *compiler)


def add_to(found: Any, value: Any, within: tuple[int, ...] = ()) -> None:
    """Add to a hash what a kernel takes from a value that it names: of functions their code and what that names.

    within: identities of the functions that led here, which may call themselves. Raises `TypeError` for values of a
    kind that no kernel has named so far.
    """
    found.update(f"({type(value).__name__} ".encode())

    def add(*parts: Any) -> None:
        for part in parts:
            add_to(found, part, within)

    match value:  # what is met most often stands first
        case np.generic() | int() | float() | complex() | str() | bytes() | EllipsisType() | None:
            found.update(repr(value).encode())
        case tuple() | list():
            add(*value)
        case CodeType():
            found.update(value.co_code)
            add(value.co_names, value.co_varnames, value.co_consts)
        case FunctionType() if id(value) not in within:
            named = [value.__globals__.get(name) for name in sorted(_globals(value.__code__))]
            cells = [cell.cell_contents for cell in value.__closure__ or ()]
            for part in (value.__code__, value.__defaults__, *named, *cells):
                add_to(found, part, (*within, id(value)))
        case FunctionType() | BuiltinFunctionType():
            found.update(value.__name__.encode())
        case ModuleType() if not value.__name__.startswith(__package__):
            found.update(value.__name__.encode())
        case type():
            found.update(f"{value.__module__}.{value.__qualname__}{getattr(value, '_fields', '')}".encode())
        case np.ndarray():
            found.update(f"{value.dtype.str}{value.shape}".encode() + value.tobytes())
        case np.ufunc():
            found.update(repr(value).encode())
        case Dispatcher():
            found.update(repr(sorted(value.targetoptions.items())).encode())
            add(value.py_func)
        case _Intrinsic():
            add(value._defn)
        case DispatcherType():
            add(value.dispatcher)
        case BaseNamedTuple():
            add(value.instance_class, tuple(value.types))
        case BaseTuple():
            add(tuple(value.types))
        case Type():
            found.update(repr(value).encode())
        case _ if callable(value) and str(getattr(value, "__module__", "")).startswith("numpy"):
            found.update(repr(value.__name__).encode())
        case _:
            raise TypeError(f"a kernel names a {type(value).__name__}, which its stamp does not know")
    found.update(b")")


def _globals(code: CodeType) -> set[str]:
    """Return the names that a function's code looks up in its module, also in the functions within it.

    Those that `dis` shows; it makes an object of every instruction, and all kernels are asked at every start.
    """
    names: set[str] = set().union(*(_globals(part) for part in code.co_consts if isinstance(part, CodeType)))
    extended = 0
    for operation, argument in zip(code.co_code[::2], code.co_code[1::2], strict=True):
        number = extended | argument
        extended = number << 8 if operation == dis.EXTENDED_ARG else 0
        if operation == _LOAD_GLOBAL:
            names.add(code.co_names[number >> 1])  # the lowest bit says what else is pushed
    return names
