# SPDX-License-Identifier: Apache-2.0
"""The command line: text in, one library call, text out.

Exit codes: 0 done, 2 bad input (one line for each problem), 130 interrupted. A run that fails leaves no output.
"""

from __future__ import annotations

import signal
import sys
from typing import Annotated, NoReturn

import typer

from mr360uw.cli import making, rendering, tools
from mr360uw.cli.arguments import gated
from mr360uw.errors import Mr360uwError

app = typer.Typer(
    name="mr360uw",
    help="Put virtual objects into 360 degree underwater video, physically right.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

for _command in (
    rendering.composite,
    rendering.still,
    rendering.sweep,
    rendering.aerial,
    making.new,
    making.tune,
    rendering.check,
    rendering.clean,
    rendering.layer,
    making.sample,
    tools.analyse,
    tools.caustics,
    tools.match,
    making.track,
    making.depth,
    making.floor,
    tools.schema,
    tools.info,
    tools.bench,
):
    app.command()(gated(_command))

_INTERRUPTED, _TERMINATED = 130, 143  # 128 + SIGINT, 128 + SIGTERM, as shells count


@app.callback(invoke_without_command=True)
def _version(
    context: typer.Context, version: Annotated[bool, typer.Option("--version", help="print the version")] = False
) -> None:
    if version:
        from mr360uw import __version__

        typer.echo(__version__)
        raise typer.Exit
    del context


def main() -> None:
    """Run the command line; turn every expected error into exit code 2 and plain lines."""
    for number in (signal.SIGTERM, *([signal.SIGHUP] if hasattr(signal, "SIGHUP") else [])):
        signal.signal(number, lambda *_: sys.exit(_TERMINATED))
    try:
        app()
    except Mr360uwError as error:
        _fail(str(error), error)
    except MemoryError as error:
        _fail("memory - is too little for this input (got no more) - take a smaller plate, mesh or texture", error)
    except OSError as error:
        _fail(f"{error.filename or 'a file'} - {error.strerror or error} - check the name, rights and space", error)
    except SystemExit as done:
        if done.code == _INTERRUPTED:
            typer.echo("interrupted: finished parts are kept beside the output; the same command goes on", err=True)
        raise


def _fail(text: str, error: Exception) -> NoReturn:
    """Print an error and its notes, without the control characters that names may hold; leave with exit code 2."""
    for line in (f"error: {text}", *getattr(error, "__notes__", ())):
        typer.echo("".join(c if c.isprintable() or c == "\n" else f"\\x{ord(c):02x}" for c in line), err=True)
    sys.exit(2)
