# SPDX-License-Identifier: Apache-2.0
"""The command that solves, reads and writes paths of cameras."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from mr360uw.cli.options import EyeOption, OverwriteOption
from mr360uw.errors import ParameterError

if TYPE_CHECKING:
    from mr360uw.track.scale import Measure


def track(
    video: Annotated[Path | None, typer.Argument(help="360 clip", show_default=False)] = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="track.csv or .json; both are written")] = Path("track.csv"),
    height: Annotated[float | None, typer.Option(help="of the camera over the floor at time 0, in metres")] = None,
    length: Annotated[
        str | None, typer.Option(help="X,Y:X,Y=METRES: metres between what two pixels of the first frame show")
    ] = None,
    depth_log: Annotated[
        Path | None, typer.Option("--depth-log", help="CSV of a dive computer with time_s and depth_m")
    ] = None,
    depth_offset: Annotated[
        float | None, typer.Option("--depth-offset", help="the log's time at the clip's start [s]; default: found")
    ] = None,
    mask: Annotated[Path | None, typer.Option(help="picture, black where nothing is tracked")] = None,
    eye: EyeOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Solve the camera's path of VIDEO from its pictures, for camera.track of a scene; say how good it is."""
    from mr360uw.track.camera_track import check_outputs
    from mr360uw.track.scale import DepthLog, Length, Measure

    if video is None:
        raise ParameterError("VIDEO - is missing - name a 360 clip")
    if depth_offset is not None and depth_log is None:
        raise ParameterError("--depth-offset - is of no use without --depth-log - give both")
    measure = Measure(
        height_m=height,
        length=None if length is None else Length.parse(length),
        depth_log=None if depth_log is None else DepthLog(depth_log, depth_offset),
    )
    check_outputs(out, overwrite=overwrite)
    _solve(video, out, measure, mask, None if eye is None else eye.value, overwrite=overwrite)


def _solve(
    video: Path,
    out: Path,
    measure: Measure,
    mask: Path | None,
    eye: Literal["left", "right"] | None,
    *,
    overwrite: bool,
) -> None:
    """Track the shots of a clip and write a track for each; keep the work beside the output until all is done."""
    from mr360uw.progress import terminal_progress
    from mr360uw.track.camera_track import check_outputs, shot_path
    from mr360uw.track.path_words import report_lines
    from mr360uw.track.tracking import track_shots

    keep = out.with_name(f"{out.stem}.track-work")
    with terminal_progress() as progress:
        shots = track_shots(video, measure=measure, mask=mask, eye=eye, keep=keep, progress=progress)
    outs = [out if len(shots) == 1 else shot_path(out, number) for number in range(1, len(shots) + 1)]
    for path in outs:
        check_outputs(path, overwrite=overwrite)
    for number, (path, shot) in enumerate(zip(outs, shots, strict=True), 1):
        if len(shots) > 1:
            typer.echo(f"shot {number}: frames {shot.start}:{shot.stop}, in a world of its own")
        if shot.track is None:
            typer.echo(f"not tracked: {shot.problem}")
            continue
        written = shot.track.save(path, overwrite=overwrite)
        typer.echo("\n".join([*report_lines(shot.track), "wrote " + "\n      ".join(str(name) for name in written)]))
    shutil.rmtree(keep, ignore_errors=True)
    if all(shot.track is None for shot in shots):
        raise ParameterError(f"{video} - none of its {len(shots)} shots can be tracked - see above")
