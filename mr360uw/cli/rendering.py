# SPDX-License-Identifier: Apache-2.0
"""Commands that check and render a scene, and `layer`, which makes a video of what they rendered."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from mr360uw.cli.arguments import (
    BackendOption,
    FrameOption,
    FramesOption,
    JsonOption,
    OverwriteOption,
    ProgressOption,
    Role,
    Said,
    ScaleOption,
    SceneArgument,
    SetOption,
    SizeOption,
    TimeOption,
    ViewOption,
    frame_range,
    variants,
    view_of,
    worker_count,
)
from mr360uw.errors import ParameterError, SceneError

if TYPE_CHECKING:
    from mr360uw.preview.pages import Still


@dataclass(frozen=True, slots=True)
class RunOptions:
    """Which frames a composite makes, how, and what it writes beside its output."""

    frames: FramesOption = None
    backend: BackendOption = "auto"
    overwrite: OverwriteOption = False
    layers: Annotated[
        Path | None, typer.Option(help="also write multi-part EXR layers, as in layers_%04d.exr"), Role.WRITTEN
    ] = None
    fresh: Annotated[bool, typer.Option("--fresh", help="use nothing of earlier runs")] = False
    workers: Annotated[str, typer.Option(help="processes that render, or auto")] = "1"
    dask: Annotated[str | None, typer.Option(help="address of a Dask scheduler, as in tcp://farm:8786")] = None
    mixed: Annotated[bool, typer.Option("--mixed", help="let workers without OpenGL use the reference")] = False
    report_file: Annotated[
        Path | None,
        typer.Option("--report", help="JSON file of settings, versions and times; default: OUT.json"),
        Role.WRITTEN,
    ] = None
    no_report: Annotated[bool, typer.Option("--no-report", help="write no report")] = False
    progress_lines: ProgressOption = False


def composite(
    scene: SceneArgument,
    out: Annotated[Path, typer.Argument(help="video, still or numbered images (out_%04d.exr) to write"), Role.WRITTEN],
    run: RunOptions,
    overrides: SetOption = None,
    scale: ScaleOption = None,
    explain: Annotated[bool, typer.Option("--explain", help="print what will run and why, and stop")] = False,
    measure: Annotated[bool, typer.Option("--measure", help="with --explain: also time the stages of a frame")] = False,
) -> None:
    """Put the objects of SCENE into its plate and write OUT; goes on where a run that was stopped ended."""
    from mr360uw.base.progress import terminal_progress
    from mr360uw.render.check import explain_costs, explain_plan
    from mr360uw.runs.outputs import report_beside
    from mr360uw.runs.pipeline import composite_video
    from mr360uw.scene.model import at_scale, load_scene

    if run.report_file is not None and run.no_report:
        raise ParameterError("--no-report - contradicts --report (got both) - give one of them")
    if measure and not explain:
        raise ParameterError("--measure - times the stages that --explain lists (got it alone) - give both")
    loaded = at_scale(load_scene(scene, overrides or ()), scale)
    if explain:
        typer.echo(explain_plan(loaded, run.backend))
        if measure:
            typer.echo(explain_costs(loaded, run.backend))
        typer.echo(f"nothing was written to {out}: --explain says what would run")
        return
    compile_first()
    with terminal_progress(lines=run.progress_lines) as progress:
        report = composite_video(
            loaded, out, frames=frame_range(run.frames), backend=run.backend, overwrite=run.overwrite,
            layers=run.layers, progress=progress, tell=typer.echo, fresh=run.fresh, workers=worker_count(run.workers),
            cluster=run.dask, mixed=run.mixed,
            report=None if run.no_report else run.report_file or report_beside(out),
        )  # fmt: skip
    typer.echo(str(report))


@dataclass(frozen=True, slots=True)
class PictureOptions:
    """Which frame is shown, how much of it, how large, and by which renderer."""

    frame: FrameOption = None
    time_s: TimeOption = None
    view: ViewOption = None
    size: SizeOption = "1280x720"
    scale: ScaleOption = None
    backend: BackendOption = "auto"
    overwrite: OverwriteOption = False

    def still(self) -> Still:
        """Return the function that makes the picture."""
        from mr360uw.preview.pages import still_of

        return partial(still_of, frame=self.frame, time_s=self.time_s, view=view_of(self.view, self.size))


def still(
    scene: SceneArgument,
    out: Annotated[Path, typer.Argument(help="picture to write: .png, .jpg, .exr"), Role.WRITTEN],
    picture: PictureOptions,
    overrides: SetOption = None,
) -> None:
    """Write one frame of SCENE, whole or as a view into it; its light is measured in that frame alone."""
    from mr360uw.preview.pages import save_still
    from mr360uw.scene.model import at_scale, load_scene

    loaded, shown = at_scale(load_scene(scene, overrides or ()), picture.scale), picture.still()
    compile_first()
    save_still(out, loaded, shown, backend=picture.backend, overwrite=picture.overwrite)
    typer.echo(f"wrote {out}")


def sweep(
    scene: SceneArgument,
    out: Annotated[
        Path, typer.Argument(help="sheet to write: .png or .jpg; a page .html goes beside it"), Role.WRITTEN
    ],
    overrides: Annotated[list[str], typer.Option("--set", help="key and its values, as in --set sea.wind_speed=2,4,8")],
    picture: PictureOptions,
) -> None:
    """Render one frame of SCENE with every combination of values, side by side on a labelled sheet."""
    from mr360uw.base.progress import terminal_progress
    from mr360uw.preview.pages import sweep as write_sweep

    changes, shown = variants(overrides), picture.still()
    with terminal_progress() as progress:
        written = write_sweep(
            scene, out, changes, shown, scale=picture.scale, backend=picture.backend, overwrite=picture.overwrite,
            progress=progress,
        )  # fmt: skip
    typer.echo("wrote " + "\n      ".join(str(path) for path in written))


def aerial(
    scene: SceneArgument,
    out: Annotated[
        Path, typer.Argument(help="picture, numbered pictures (sea_%04d.exr) or video to write"), Role.WRITTEN
    ],
    frames: FramesOption = None,
    overrides: SetOption = None,
    overwrite: OverwriteOption = False,
    progress_lines: ProgressOption = False,
) -> None:
    """Write what a camera in the air sees of a shallow sea: SCENE has tables of its own, see docs/aerial.md."""
    from mr360uw.base.progress import terminal_progress
    from mr360uw.from_above import aerial_film, load_aerial

    loaded = load_aerial(scene, overrides or ())
    with terminal_progress(lines=progress_lines) as progress:
        report = aerial_film(loaded, out, frames=frame_range(frames), overwrite=overwrite, progress=progress)
    typer.echo(str(report))


def check(
    scene: SceneArgument,
    out: Annotated[
        Path | None, typer.Argument(help="the output, to be checked too", show_default=False), Role.READ
    ] = None,
    frames: FramesOption = None,
    backend: BackendOption = "auto",
    overrides: SetOption = None,
    as_json: JsonOption = False,
) -> None:
    """Check SCENE and every file it names, without rendering; print every problem, or the plan, and left-over parts."""
    from mr360uw.render.check import check_scene
    from mr360uw.runs.work_folder import stale_notes
    from mr360uw.scene.model import load_scene

    say = Said(as_json)
    try:
        loaded = load_scene(scene, overrides or ())
        text = check_scene(loaded, out, frames=frame_range(frames), backend=backend, where=str(scene))
    except SceneError as error:
        say.end(problems=error.problems)
        raise
    say("\n".join([text, *stale_notes((out or scene).absolute().parent)]))
    say.end(problems=[])


def clean(
    folder: Annotated[Path, typer.Argument(help="folder of outputs"), Role.READ] = Path(),
    dry_run: Annotated[bool, typer.Option("--dry-run", help="only list them")] = False,
) -> None:
    """Remove the finished parts of runs that were stopped, in FOLDER; runs in progress keep theirs."""
    from mr360uw.runs.work_folder import remove_stale

    if not folder.is_dir():
        raise ParameterError(f"{folder} - is no folder - name the one that the outputs are in")
    for line in remove_stale(folder, dry_run=dry_run):
        typer.echo(line)


def compile_first() -> None:
    """Compile the kernels of a plain composite that this machine does not have, on all cores, and count them.

    Says first why nothing is kept, where that is not what the user asked for.
    """
    from mr360uw.base.disk_cache import cache_notes
    from mr360uw.base.progress import terminal_count
    from mr360uw.jit.ahead import compile_ahead

    for note in cache_notes():
        typer.echo(f"note      {note}", err=True)
    compile_ahead(terminal_count("compiling for this machine, once"))


def layer(
    layers: Annotated[
        Path, typer.Argument(help="pattern of the EXR files of `composite --layers`: layers_%04d.exr"), Role.READ
    ],
    out: Annotated[Path, typer.Argument(help="video to write, .mov (ProRes 4444 with alpha)"), Role.WRITTEN],
    alpha: Annotated[
        Literal["straight", "premultiplied"], typer.Option(help="colour as it is, or times alpha")
    ] = "straight",
    frame_rate: Annotated[float, typer.Option(help="frames a second, of the plate")] = 30.0,
    eye: Annotated[Literal["left", "right"] | None, typer.Option(help="of layers of two eyes")] = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Write what a composite laid over its plate as a video with alpha, from its EXR layers."""
    from mr360uw.runs.outputs import counted
    from mr360uw.video.container_writer import layer_video

    count, empty = layer_video(
        layers, out, alpha=alpha, frame_rate=frame_rate, eye=eye, overwrite=overwrite,
    )  # fmt: skip
    note = f", {empty} of them transparent for want of a file" if empty else ""
    typer.echo(f"wrote {out}: {counted(count)}{note}, {alpha} alpha")
