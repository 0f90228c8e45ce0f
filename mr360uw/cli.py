# SPDX-License-Identifier: Apache-2.0
"""The command line: text in, one library call, text out.

Exit codes: 0 done, 2 bad input (one line for each problem), 130 interrupted. A run that fails leaves no output.
"""

from __future__ import annotations

import signal
import sys
from functools import partial
from pathlib import Path
from typing import Annotated, NoReturn

import typer

from mr360uw.arguments import Eye, ImageFormat, check_report, frame_range, variants, view_of, worker_count
from mr360uw.errors import Mr360uwError, ParameterError

app = typer.Typer(
    name="mr360uw",
    help="Put virtual objects into 360 degree underwater video, physically right.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

_INTERRUPTED, _TERMINATED = 130, 143  # 128 + SIGINT, 128 + SIGTERM, as shells count

SceneArgument = Annotated[Path, typer.Argument(help="scene file (TOML)", show_default=False)]
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
EyeOption = Annotated[Eye | None, typer.Option(help="eye of a stereo plate to work on")]


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


@app.command()
def composite(
    scene: SceneArgument,
    out: Annotated[Path, typer.Argument(help="video, still or numbered images (out_%04d.exr) to write")],
    frames: FramesOption = None,
    backend: BackendOption = "auto",
    overrides: SetOption = None,
    scale: ScaleOption = None,
    overwrite: OverwriteOption = False,
    layers: Annotated[Path | None, typer.Option(help="also write multi-part EXR layers, as in layers_%04d.exr")] = None,
    fresh: Annotated[bool, typer.Option("--fresh", help="use nothing of a run that was stopped")] = False,
    workers: Annotated[str, typer.Option(help="processes that render, or auto")] = "1",
    dask: Annotated[str | None, typer.Option(help="address of a Dask scheduler, as in tcp://farm:8786")] = None,
    mixed: Annotated[bool, typer.Option("--mixed", help="let workers without OpenGL use the reference")] = False,
    report_file: Annotated[Path | None, typer.Option("--report", help="also write the report, as JSON")] = None,
    explain: Annotated[bool, typer.Option("--explain", help="print what will run and why, and stop")] = False,
) -> None:
    """Put the objects of SCENE into its plate and write OUT; goes on where a run that was stopped ended."""
    from mr360uw.pipeline import composite_video
    from mr360uw.progress import terminal_progress
    from mr360uw.render.check import explain_plan
    from mr360uw.scene.model import at_scale, load_scene

    loaded = at_scale(load_scene(scene, overrides or ()), scale)
    check_report(report_file, loaded)
    if explain:
        typer.echo(explain_plan(loaded, backend))
        return
    with terminal_progress() as progress:
        report = composite_video(
            loaded, out, frames=frame_range(frames), backend=backend, overwrite=overwrite, layers=layers,
            progress=progress, tell=partial(typer.echo, err=True), fresh=fresh, workers=worker_count(workers),
            cluster=dask, mixed=mixed,
        )  # fmt: skip
    if report_file is not None:
        report.save(report_file)
    typer.echo(str(report))


@app.command()
def still(
    scene: SceneArgument,
    out: Annotated[Path, typer.Argument(help="picture to write: .png, .jpg, .exr")],
    frame: FrameOption = None,
    time_s: TimeOption = None,
    view: ViewOption = None,
    size: SizeOption = "1280x720",
    scale: ScaleOption = None,
    backend: BackendOption = "auto",
    overrides: SetOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Write one frame of SCENE, whole or as a view into it; its light is measured in that frame alone."""
    from mr360uw.preview.still import save_still
    from mr360uw.scene.model import at_scale, load_scene

    loaded = at_scale(load_scene(scene, overrides or ()), scale)
    seen = view_of(view, size)
    save_still(out, loaded, frame=frame, time_s=time_s, view=seen, backend=backend, overwrite=overwrite)
    typer.echo(f"wrote {out}")


@app.command()
def sweep(
    scene: SceneArgument,
    out: Annotated[Path, typer.Argument(help="sheet to write: .png or .jpg; a page .html goes beside it")],
    overrides: Annotated[list[str], typer.Option("--set", help="key and its values, as in --set sea.wind_speed=2,4,8")],
    frame: FrameOption = None,
    time_s: TimeOption = None,
    view: ViewOption = None,
    size: SizeOption = "1280x720",
    scale: ScaleOption = None,
    backend: BackendOption = "auto",
    overwrite: OverwriteOption = False,
) -> None:
    """Render one frame of SCENE with every combination of values, side by side on a labelled sheet."""
    from mr360uw.preview.contact_sheet import sweep as write_sweep
    from mr360uw.progress import terminal_progress

    with terminal_progress() as progress:
        written = write_sweep(
            scene, out, variants(overrides), scale=scale, frame=frame, time_s=time_s,
            view=view_of(view, size), backend=backend, overwrite=overwrite, progress=progress,
        )  # fmt: skip
    typer.echo("wrote " + "\n      ".join(str(path) for path in written))


@app.command()
def new(
    video: Annotated[Path, typer.Argument(help="360 plate")],
    mesh: Annotated[Path, typer.Argument(help="glTF, OBJ, PLY or STL")],
    out: Annotated[Path | None, typer.Option("--out", "-o", help="scene file; default: VIDEO.toml")] = None,
    eye: EyeOption = None,
    overwrite: OverwriteOption = False,
    outside_files: Annotated[bool, typer.Option("--outside-files", help="MESH may name files elsewhere")] = False,
) -> None:
    """Write a commented scene file that puts MESH into VIDEO and runs as it is."""
    from mr360uw.scene.template import write_scene

    path = write_scene(
        video, mesh, out, eye=None if eye is None else eye.value, overwrite=overwrite, outside_files=outside_files
    )
    typer.echo(f"wrote {path}\nnext:  mr360uw composite {path} {path.with_suffix('.composite.mp4').name}")


@app.command()
def check(
    scene: SceneArgument,
    out: Annotated[Path | None, typer.Argument(help="the output, to be checked too", show_default=False)] = None,
    frames: FramesOption = None,
    backend: BackendOption = "auto",
    overrides: SetOption = None,
) -> None:
    """Check SCENE and every file it names, without rendering; print every problem, or the plan, and left-over parts."""
    from mr360uw.render.check import check_scene
    from mr360uw.runs.work_folder import stale_notes
    from mr360uw.scene.model import load_scene

    loaded = load_scene(scene, overrides or ())
    text = check_scene(loaded, out, frames=frame_range(frames), backend=backend, where=str(scene))
    typer.echo("\n".join([text, *stale_notes((out or scene).absolute().parent)]))


@app.command()
def clean(
    folder: Annotated[Path, typer.Argument(help="folder of outputs")] = Path(),
    dry_run: Annotated[bool, typer.Option("--dry-run", help="only list them")] = False,
) -> None:
    """Remove the finished parts of runs that were stopped, in FOLDER; runs in progress keep theirs."""
    from mr360uw.runs.work_folder import remove_stale

    if not folder.is_dir():
        raise ParameterError(f"{folder} - is no folder - name the one that the outputs are in")
    for line in remove_stale(folder, dry_run=dry_run):
        typer.echo(line)


@app.command()
def sample(
    folder: Annotated[Path, typer.Argument(help="folder to make")],
    width: Annotated[int, typer.Option(help="frame width in pixels; the height is half of it")] = 1024,
    frames: Annotated[int, typer.Option(help="number of frames")] = 48,
    seed: Annotated[int, typer.Option(help="seed of sea and sand")] = 1,
    water: Annotated[str, typer.Option(help="Jerlov type of the water")] = "IB",
    depth: Annotated[float, typer.Option(help="depth of the camera in metres")] = 4.0,
    floor: Annotated[float | None, typer.Option(help="depth of the sand in metres; default: 3.5 below")] = None,
    sun_elevation: Annotated[float, typer.Option(help="of the sun above the surface, in degrees")] = 57.3,
    sun_azimuth: Annotated[float, typer.Option(help="of the sun, 0 = ahead, + = right, in degrees")] = 34.4,
    wind: Annotated[float, typer.Option(help="speed of the wind in m/s")] = 3.0,
    speed: Annotated[float, typer.Option(help="speed in m/s at which the camera swims ahead")] = 0.0,
    overwrite: OverwriteOption = False,
) -> None:
    """Make a synthetic 360 dive: plate with sound, whale, and a scene file that puts one into the other."""
    from mr360uw.progress import terminal_progress
    from mr360uw.sample import DiveSettings, sample_dive

    dive_of = DiveSettings.in_degrees(water, depth, floor, sun_elevation, sun_azimuth, wind, speed, seed)
    with terminal_progress() as progress:
        dive = sample_dive(folder, dive_of, width=width, frames=frames, overwrite=overwrite, progress=progress)
    typer.echo(f"wrote {dive.plate}\n      {dive.mesh}\n      {dive.scene}")


@app.command()
def analyse(
    video: Annotated[Path, typer.Argument(help="360 plate, or a scene file that names one")],
    out: Annotated[Path | None, typer.Option("--out", "-o", help="page to write; default: VIDEO.html")] = None,
    eye: EyeOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Write a self-contained page about the light and the water of VIDEO, and the track of its sun."""
    from mr360uw.progress import terminal_progress
    from mr360uw.render.analysis import analyse_video

    with terminal_progress() as progress:
        written = analyse_video(
            video, out, eye=None if eye is None else eye.value, overwrite=overwrite, progress=progress
        )
    typer.echo("wrote " + "\n      ".join(str(path) for path in written))


@app.command()
def caustics(
    scene: SceneArgument,
    folder: Annotated[Path, typer.Argument(help="folder for the images")],
    frames: Annotated[int, typer.Option(help="number of frames of the loop")] = 48,
    loop_s: Annotated[float, typer.Option(help="length of the loop in seconds")] = 8.0,
    depth_m: Annotated[float | None, typer.Option(help="depth of the caustics; default: the receiver's")] = None,
    image_format: Annotated[ImageFormat, typer.Option("--format", help="16-bit PNG or float EXR")] = ImageFormat.png,
    backend: BackendOption = "auto",
    overrides: SetOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Export SCENE's sea as tileable, looping caustic, height and normal maps for other programs."""
    from mr360uw.progress import terminal_progress
    from mr360uw.render.caustic_tiles import export_caustics
    from mr360uw.scene.model import load_scene

    with terminal_progress() as progress:
        written = export_caustics(
            load_scene(scene, overrides or ()), folder, frames=frames, loop_s=loop_s, depth_m=depth_m,
            image_format=image_format.value, backend=backend, overwrite=overwrite, progress=progress,
        )  # fmt: skip
    typer.echo(f"wrote {len(written)} files into {folder}")


@app.command()
def schema(
    markdown: Annotated[bool, typer.Option("--markdown", help="print tables for people instead")] = False,
) -> None:
    """Print the JSON schema of a scene file."""
    import json

    from mr360uw.scene.handbook import parameters_markdown
    from mr360uw.scene.model import scene_schema

    if markdown:
        typer.echo(parameters_markdown(), nl=False)
        return
    typer.echo(json.dumps(scene_schema(), indent=2))


@app.command()
def info() -> None:
    """Print the renderer, the graphics device, the video codecs and the versions in use."""
    from mr360uw.info import describe

    typer.echo(describe())


@app.callback(invoke_without_command=True)
def _version(
    context: typer.Context, version: Annotated[bool, typer.Option("--version", help="print the version")] = False
) -> None:
    if version:
        from mr360uw import __version__

        typer.echo(__version__)
        raise typer.Exit
    del context
