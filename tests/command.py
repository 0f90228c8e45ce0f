# SPDX-License-Identifier: Apache-2.0
"""The command line as tests call it in their own process."""

from __future__ import annotations

import functools
from typing import Any

import typer

from mr360uw import cli


@functools.cache
def command_line() -> Any:
    """Return the command line, built once: it takes most of the time of a refusal."""
    return typer.main.get_command(cli.app)
