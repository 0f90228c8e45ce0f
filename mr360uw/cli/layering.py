# SPDX-License-Identifier: Apache-2.0
"""The command `layer`: EXR layers of a composite as a video with alpha."""

from __future__ import annotations

from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from mr360uw.cli.arguments import OverwriteOption
from mr360uw.cli.gated import Role


class _Alpha(Enum):
    straight = "straight"
    premultiplied = "premultiplied"


class _Eye(Enum):
    left = "left"
    right = "right"


def layer(
    layers: Annotated[
        Path, typer.Argument(help="pattern of the EXR files of `composite --layers`: layers_%04d.exr"), Role.READ
    ],
    out: Annotated[Path, typer.Argument(help="video to write, .mov (ProRes 4444 with alpha)"), Role.WRITTEN],
    alpha: Annotated[_Alpha, typer.Option(help="colour as it is, or times alpha")] = _Alpha.straight,
    frame_rate: Annotated[float, typer.Option(help="frames a second, of the plate")] = 30.0,
    eye: Annotated[_Eye | None, typer.Option(help="of layers of two eyes")] = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Write what a composite laid over its plate as a video with alpha, from its EXR layers."""
    from mr360uw.runs.run_report import counted
    from mr360uw.video.write.layer_video import layer_video

    count, empty = layer_video(
        layers, out, alpha=alpha.value, frame_rate=frame_rate, eye=None if eye is None else eye.value,
        overwrite=overwrite,
    )  # fmt: skip
    note = f", {empty} of them transparent for want of a file" if empty else ""
    typer.echo(f"wrote {out}: {counted(count)}{note}, {alpha.value} alpha")
