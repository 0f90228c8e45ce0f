# SPDX-License-Identifier: Apache-2.0
"""The command that serves the tuning page."""

from __future__ import annotations

import gc
import importlib.util
import threading
import webbrowser
from pathlib import Path
from typing import Annotated

import typer

from mr360uw.cli.arguments import BackendOption
from mr360uw.cli.gated import Role
from mr360uw.errors import Mr360uwError

_NEEDED = ("nicegui", "tomlkit")


def tune(
    source: Annotated[
        Path, typer.Argument(metavar="SCENE_OR_VIDEO", help="scene file (TOML), or a 360 plate"), Role.READ
    ],
    mesh: Annotated[
        Path | None,
        typer.Argument(help="with a plate: glTF, OBJ, PLY or STL; a scene is written as `new` does"),
        Role.READ,
    ] = None,
    port: Annotated[int | None, typer.Option(help="default: 8360, or a free one", show_default=False)] = None,
    host: Annotated[
        str, typer.Option(help="address to listen on; others than this machine's let other machines in")
    ] = "127.0.0.1",
    token: Annotated[
        str | None,
        typer.Option(envvar="MR360UW_TOKEN", help="that visitors must show; default: a random one", show_default=False),
    ] = None,
    no_browser: Annotated[bool, typer.Option("--no-browser", help="only print the address")] = False,
    backend: BackendOption = "auto",
) -> None:
    """Tune a scene by eye in a browser: every parameter, frame by frame."""
    if any(importlib.util.find_spec(name) is None for name in _NEEDED):
        raise Mr360uwError("tune - needs packages that are not installed - pip install mr360uw[tune]")
    from mr360uw.tune.editing.document import Document

    scene = source
    if mesh is not None:
        from mr360uw.first_look.first_scene import make_first_scene

        made = make_first_scene(source, mesh, backend=backend)
        typer.echo("\n".join(made.lines))
        scene = made.scene
    document = Document(scene)

    gc.disable()  # modules are no garbage: looking for some takes a tenth of the time to load them
    from mr360uw.tune.server import serve

    gc.freeze()
    gc.enable()

    def show(door: Path) -> None:
        if not no_browser:
            threading.Thread(target=webbrowser.open, args=(door.as_uri(),), daemon=True).start()

    try:
        serve(document, host=host, port=port, token=token, backend=backend, tell=typer.echo, show=show)
    except KeyboardInterrupt:
        return
