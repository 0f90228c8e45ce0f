# SPDX-License-Identifier: Apache-2.0
"""Arguments and options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mr360uw.cli.arguments import EyeName
from mr360uw.cli.gated import Role

SceneArgument = Annotated[Path, typer.Argument(help="scene file (TOML)", show_default=False), Role.READ]
FramesOption = Annotated[str | None, typer.Option(help="frames a:b, b not included; either may be left out")]
BackendOption = Annotated[str, typer.Option(help="auto, gl or reference")]
OverwriteOption = Annotated[bool, typer.Option("--overwrite", help="replace an output that is there")]
SetOption = Annotated[
    list[str] | None, typer.Option("--set", help="override one key of the scene, as in --set camera.depth_m=8")
]
ScaleOption = Annotated[float | None, typer.Option(help="size over the plate's, for drafts, as in 0.25")]
FrameOption = Annotated[int | None, typer.Option(help="number of the frame; default: 0")]
TimeOption = Annotated[float | None, typer.Option("--time", help="seconds from the start, instead")]
ViewOption = Annotated[str | None, typer.Option(help="yaw,pitch,fov in degrees; default: the whole panorama")]
SizeOption = Annotated[str, typer.Option(help="of a view, in pixels")]
EyeOption = Annotated[EyeName | None, typer.Option(help="eye of a stereo plate to work on")]
