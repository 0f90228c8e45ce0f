# SPDX-License-Identifier: Apache-2.0
"""Every file that the command line names is declared as read or written, and what is written passes the gate first."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from enum import Enum
from pathlib import Path
from typing import Any, get_args, get_type_hints

from mr360uw.output_gate import check_folder, check_outputs


class Role(Enum):
    """What a command does with a file that an argument or an option names; stands in its annotation."""

    READ = "read"
    WRITTEN = "written"
    FOLDER = "filled"


def gated(command: Callable[..., None]) -> Callable[..., None]:
    """Return a command that raises `OutputError` before it does anything where an output may not be written.

    Commands whose outputs have other names than the given ones, or whose scene names more inputs, check these too.
    """

    @functools.wraps(command)
    def checked(**values: Any) -> None:
        named = dict(roles_of(command))
        paths = {role: [Path(values[name]) for name in named if named[name] is role and values[name]] for role in Role}
        writes = not values.get("explain", False)
        for folder in paths[Role.FOLDER]:
            check_folder(folder)
        check_outputs(
            paths[Role.WRITTEN], inputs=paths[Role.READ], overwrite=values.get("overwrite", False) or not writes
        )
        command(**values)

    return checked


def roles_of(command: Callable[..., None]) -> Iterator[tuple[str, Role]]:
    """Yield the parameters of a command that name files, with what is done with these."""
    for name, hint in get_type_hints(command, include_extras=True).items():
        yield from ((name, role) for role in get_args(hint)[1:] if isinstance(role, Role))
