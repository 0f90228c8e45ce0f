# SPDX-License-Identifier: Apache-2.0
"""Arrays whose users compiled code does not count.

A compiled function counts the users of every array that it is passed, in memory that all threads share: for functions
of a few numbers that costs more than what they do. An array without an owner is not counted. It must not outlive the
call that was passed the array it stands for.
"""

from __future__ import annotations

from typing import Any

from numba.extending import intrinsic


@intrinsic  # type: ignore[untyped-decorator, unused-ignore]
def bare(_typing: Any, array: Any) -> Any:
    """Return the same array without an owner."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        view = context.make_array(signature.args[0])(context, builder, arguments[0])
        view.meminfo = view.meminfo.type(None)
        return view._getvalue()

    return array(array), generate
