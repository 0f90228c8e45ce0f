# SPDX-License-Identifier: Apache-2.0
"""`mr360uw` and `python -m mr360uw` are the command line."""

import atexit
import ctypes
import gc
import os
import sys

_INTERRUPTED = 130  # 128 + SIGINT, as shells count
_NEW_OBJECTS = 100_000
"""New objects between two searches for rubbish: while modules load, thousands are made that all stay."""
_M_TRIM_THRESHOLD, _M_TOP_PAD, _M_MMAP_THRESHOLD = -1, -2, -3  # numbers of glibc's malloc.h
_KEPT_BYTES, _HEAP_BYTES = 1 << 30, 1 << 25
"""Free memory that glibc keeps at most, and the largest blocks that it takes from there, which may not be larger."""


def main() -> None:
    """Run the command line; an interrupt ends it without a traceback, also while its modules are still loading."""
    _open_standard_streams()
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # its threads wait busily, and matrices here are small
    gc.set_threshold(_NEW_OBJECTS, 50, 50)
    atexit.register(gc.freeze)  # the process ends with all that is loaded: to search it for rubbish takes .3 s
    _keep_freed_memory()
    try:
        from mr360uw.cli import main as run

        run()
    except KeyboardInterrupt:
        sys.exit(_INTERRUPTED)


def _keep_freed_memory() -> None:
    """Have glibc keep the memory of one frame for the next.

    It would return it to the kernel, which clears each page that it hands out: up to a tenth of a run at 3840x1920.
    """
    set_option = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform == "linux" else None
    if set_option is not None:  # other C libraries have none
        set_option(_M_TRIM_THRESHOLD, _KEPT_BYTES)
        set_option(_M_TOP_PAD, 2 * _HEAP_BYTES)  # as large as a thread's heap: with less room, it gives that back
        set_option(_M_MMAP_THRESHOLD, _HEAP_BYTES)


def _open_standard_streams() -> None:
    """Open the null device where standard input, output or error is closed.

    The next file to be opened would else take its number, and messages of libraries would be written into that file.
    """
    for number in (0, 1, 2):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest number that is free


if __name__ == "__main__":
    main()
