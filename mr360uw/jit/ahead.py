# SPDX-License-Identifier: Apache-2.0
"""The kernels of a plain composite (kernels.txt), compiled before the first frame by several processes at once.

Each line names a module, a kernel in it and the types of its arguments, `float32:2C` an array of two axes in C order,
`float32:2Cr` one that is not written, `(int64,float32:1C)` a tuple, `module.Name(int64)` a named one. One process
compiles all kernels of a module, which share functions; modules that take longest stand first.
`python -m mr360uw.jit.ahead` compiles the lines that it reads and answers each with a line.
"""

from __future__ import annotations

import gc
import hashlib
import importlib
import os
import sys
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from itertools import groupby
from pathlib import Path
from queue import SimpleQueue
from subprocess import DEVNULL, PIPE, Popen
from threading import Thread
from typing import IO, Any, cast

import numba
from numba.core.types.containers import BaseNamedTuple, BaseTuple
from numba.core.types.npytypes import Array

from mr360uw.base.disk_cache import is_writable, keep_bytes, kernel_folder, sources_stamp
from mr360uw.jit import versions

LIST = Path(__file__).with_name("kernels.txt")
_WORKERS = 4
"""Most processes that compile at once: with more, each would load what it needs for a few kernels."""


def compile_ahead(tell: Callable[[int, int | None], None]) -> None:
    """Compile the kernels of the list that are not there, on all cores; nothing where none could be kept.

    tell: called with how many are done, and how many there were.
    """
    folder, listed = kernel_folder(), LIST.read_text("utf-8")
    if folder is None or not is_writable(folder):
        return
    stamp = hashlib.sha256(repr((sources_stamp(), versions(), listed)).encode()).hexdigest()[:32]
    complete = folder / f"complete-{stamp}.nbc"
    if complete.is_file():
        return
    missing = [line for line in listed.splitlines() if not size(*_read(line))]
    for done in _compiled(missing):
        tell(done, len(missing))
    keep_bytes(complete, b"")


def _compiled(lines: list[str]) -> Iterator[int]:
    """Compile kernels by as many processes as there are cores; yield how many are done.

    A process that fails leaves its kernels to the run, which then says why.
    """
    # Start the processes, and for each a thread that hands it one module after the other
    modules = deque(list(group) for _, group in groupby(lines, key=lambda line: line.split()[0]))
    answers: SimpleQueue[bool] = SimpleQueue()
    command = [sys.executable, "-m", "mr360uw.jit.ahead"]
    workers = [
        Popen(command, stdin=PIPE, stdout=PIPE, stderr=DEVNULL, text=True)  # noqa: S603 - our own
        for _ in range(min(os.cpu_count() or 1, _WORKERS, len(modules)))
    ]
    for worker in workers:
        Thread(target=_feed, args=(worker, modules, answers), daemon=True).start()
    # Count the answers until all threads have ended
    done, working = 0, len(workers)
    try:
        while working:
            if answers.get():
                done += 1
                yield done
            else:
                working -= 1
    finally:
        for worker in workers:
            worker.terminate()
            worker.wait()


def _feed(worker: Popen[str], modules: deque[list[str]], answers: SimpleQueue[bool]) -> None:
    """Have a process compile modules until none is left; put True for each kernel, at last False."""
    with suppress(IndexError, OSError), worker:  # until no module is left, or the process has ended
        while True:
            for line in modules.popleft():
                print(line, file=worker.stdin, flush=True)
                if not cast("IO[str]", worker.stdout).readline():
                    raise BrokenPipeError
                answers.put(True)
    answers.put(False)


def size(kernel: Any, arguments: tuple[Any, ...]) -> int:
    """Return the bytes that a kernel takes for arguments of a type; 0 where it is not kept."""
    file = kernel._cache.file(arguments)
    return 0 if file is None else int(file.stat().st_size)


def entry(kernel: Any, arguments: tuple[Any, ...]) -> str:
    """Return the line of the list for a kernel and the types of its arguments."""
    return " ".join([kernel.__module__, kernel.__name__, *map(_written, arguments)])


def _written(kind: Any) -> str:
    if isinstance(kind, BaseTuple):
        made = kind.instance_class if isinstance(kind, BaseNamedTuple) else None
        name = "" if made is None else f"{made.__module__}.{made.__qualname__}"
        return f"{name}({','.join(map(_written, kind.types))})"
    if isinstance(kind, Array):
        return f"{kind.dtype}:{kind.ndim}{kind.layout}{'' if kind.mutable else 'r'}"
    return str(kind)


def _read(line: str) -> tuple[Any, tuple[Any, ...]]:
    """Return the kernel and the types of its arguments that a line names."""
    module, name, *written = line.split()
    return getattr(importlib.import_module(module), name), tuple(_kind(text) for text in written)


def _kind(text: str) -> Any:
    module_and_name, opened, parts = text.partition("(")
    if opened:
        module, _, name = module_and_name.rpartition(".")
        made = getattr(importlib.import_module(module), name) if module else None
        return BaseTuple.from_types(tuple(map(_kind, _outer_parts(parts[:-1]))), made)
    dtype, colon, rest = text.partition(":")
    scalar = getattr(numba.types, dtype)
    if not colon:
        return scalar
    layout: Any = rest[1]
    return Array(scalar, int(rest[0]), layout, readonly=rest.endswith("r"))


def _outer_parts(text: str) -> list[str]:
    """Return the parts of a text between the commas that stand in no parentheses."""
    depth, parts = 0, [""]
    for character in text:
        depth += (character == "(") - (character == ")")
        if character == "," and not depth:
            parts.append("")
        else:
            parts[-1] += character
    return parts


def _serve() -> None:
    """Compile the lines of standard input.

    Unused memory is not searched for: the compiler leaves little in circles, and the search takes a fifth of its time.
    """
    gc.disable()
    for line in sys.stdin:
        kernel, arguments = _read(line)
        kernel.compile(arguments)
        sys.stdout.write("\n")
        sys.stdout.flush()


if __name__ == "__main__":
    _serve()
