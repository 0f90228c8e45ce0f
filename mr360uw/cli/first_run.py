# SPDX-License-Identifier: Apache-2.0
"""What a first run on a machine does once, and says so."""

from __future__ import annotations


def compile_first() -> None:
    """Compile the kernels of a plain composite that this machine does not have, on all cores, and count them."""
    from mr360uw.jit.ahead import compile_ahead
    from mr360uw.progress import terminal_count

    compile_ahead(terminal_count("compiling for this machine, once"))
