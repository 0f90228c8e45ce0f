# SPDX-License-Identifier: Apache-2.0
"""Commands that make scenes, measure plates, export maps and tell what is there."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from mr360uw.cli.arguments import (
    BackendOption,
    EyeOption,
    FramesOption,
    ImageFormat,
    OverwriteOption,
    SceneArgument,
    SetOption,
)
from mr360uw.cli.gated import Role
from mr360uw.errors import ParameterError

if TYPE_CHECKING:
    from mr360uw.first_look.place_in_plate import Wish

_DIFFERS = 1
"""Exit code of a self-test in which a picture is wrong."""


def wish_of(at: str | None, stand: bool, swim: bool, size_m: float | None) -> Wish:
    """Return the wish that --at, --stand, --swim and --size state; raise `ParameterError` where they state none."""
    from mr360uw.first_look.place_in_plate import Wish

    if stand and swim:
        raise ParameterError("--stand, --swim - exclude each other (got both) - give one of them")
    direction = None
    if at is not None:
        try:
            azimuth, elevation = (float(part) for part in at.split(","))
        except ValueError:
            raise ParameterError(
                f"--at - is no direction (got {at!r}) - write azimuth,elevation in degrees, as in 30,-25"
            ) from None
        direction = azimuth, elevation
    return Wish(direction, "stands" if stand else "swims" if swim else None, size_m)


def new(
    video: Annotated[Path, typer.Argument(help="360 plate: a video or a still"), Role.READ],
    mesh: Annotated[Path, typer.Argument(help="glTF, USD, OBJ, PLY or STL"), Role.READ],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="scene file; default: VIDEO.toml"), Role.WRITTEN
    ] = None,
    at: Annotated[
        str | None, typer.Option(help="direction of its foot, or of its middle where it swims: azimuth,elevation")
    ] = None,
    stand: Annotated[bool, typer.Option("--stand", help="on the ground, whatever its name says")] = False,
    swim: Annotated[bool, typer.Option("--swim", help="off the ground, whatever its name says")] = False,
    size: Annotated[float | None, typer.Option(help="of its longest side, in metres")] = None,
    track: Annotated[
        Path | None, typer.Option(help="the camera's path, as `mr360uw track` writes it"), Role.READ
    ] = None,
    eye: EyeOption = None,
    backend: BackendOption = "auto",
    overwrite: OverwriteOption = False,
    outside_files: Annotated[bool, typer.Option("--outside-files", help="MESH may name files elsewhere")] = False,
) -> None:
    """Look at VIDEO and MESH, and write a scene that puts one into the other, with a preview; say what was guessed."""
    from mr360uw.first_look.first_scene import make_first_scene

    made = make_first_scene(
        video, mesh, out, wish=wish_of(at, stand, swim, size), track=track, eye=None if eye is None else eye.value,
        overwrite=overwrite,
        outside_files=outside_files, backend=backend,
    )  # fmt: skip
    typer.echo("\n".join([*made.lines, *made.next_lines]))


def analyse(
    video: Annotated[Path, typer.Argument(help="360 plate, or a scene file that names one"), Role.READ],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="page to write; default: VIDEO.html"), Role.WRITTEN
    ] = None,
    eye: EyeOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Write a self-contained page about the light and the water of VIDEO, and the track of its sun."""
    from mr360uw.first_look.plate_look import look_at_plate
    from mr360uw.first_look.proposal_words import where_line
    from mr360uw.preview.plate_report import analyse_video
    from mr360uw.progress import terminal_progress
    from mr360uw.scene.model import load_scene

    of_eye: Literal["left", "right"] | None = None if eye is None else eye.value
    in_air = False
    if video.suffix.lower() != ".toml":
        medium = look_at_plate(video, of_eye).medium
        in_air = not medium.underwater
        typer.echo(where_line(medium))
    else:
        scene = load_scene(video)
        if "water" not in scene.model_fields_set and scene.plate.model_fields_set == {"path"}:
            in_air = not look_at_plate(scene.plate.path).medium.underwater
            if in_air:
                typer.echo('note      the plate is in air, and the scene does not say so: [water] type = "none"')
    with terminal_progress() as progress:
        written = analyse_video(
            video, out, eye=of_eye, in_air=in_air, overwrite=overwrite, progress=progress, tell=typer.echo
        )
    typer.echo("wrote " + "\n      ".join(str(path) for path in written))


def caustics(
    scene: SceneArgument,
    folder: Annotated[Path, typer.Argument(help="folder for the images"), Role.FOLDER],
    frames: Annotated[int, typer.Option(help="number of frames of the loop")] = 48,
    loop_s: Annotated[float, typer.Option(help="length of the loop in seconds")] = 8.0,
    depth_m: Annotated[float | None, typer.Option(help="depth of the caustics; default: the receiver's")] = None,
    image_format: Annotated[ImageFormat, typer.Option("--format", help="16-bit PNG or float EXR")] = ImageFormat.png,
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
            image_format=image_format.value, overwrite=overwrite, progress=progress,
        )  # fmt: skip
    typer.echo(f"wrote {len(written)} files into {folder}")


def match(
    scene: SceneArgument,
    caustics: Annotated[bool, typer.Option("--caustics", help="fit the sea to the caustics on the floor")] = False,
    water: Annotated[str | None, typer.Option(help="fit the water to open water at yaw,pitch,size in degrees")] = None,
    frames: FramesOption = None,
    picture: Annotated[
        Path | None, typer.Option(help="PNG of the plate's caustics beside ours, with spectra"), Role.WRITTEN
    ] = None,
    overrides: SetOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Fit SCENE's sea or water to what its plate shows, and print the changes as --set takes them."""
    from mr360uw.cli.matching import match_lines
    from mr360uw.progress import terminal_progress

    with terminal_progress() as progress:
        lines = match_lines(
            scene, caustics=caustics, water=water, frames=frames, picture=picture, overrides=overrides or (),
            overwrite=overwrite, progress=progress,
        )  # fmt: skip
    typer.echo("\n".join(lines))


def schema(
    markdown: Annotated[bool, typer.Option("--markdown", help="print tables for people instead")] = False,
    aerial: Annotated[bool, typer.Option("--aerial", help="of the scenes of `mr360uw aerial`")] = False,
) -> None:
    """Print the JSON schema of a scene file."""
    import json

    from mr360uw.from_above.settings import AerialScene, aerial_handbook
    from mr360uw.scene.handbook import parameters_markdown
    from mr360uw.scene.model import scene_schema

    if markdown:
        typer.echo(aerial_handbook() if aerial else parameters_markdown(), nl=False)
        return
    typer.echo(json.dumps(AerialScene.model_json_schema(by_alias=True) if aerial else scene_schema(), indent=2))


def info(
    gpu: Annotated[
        bool, typer.Option("--gpu", help="also draw eight small pictures with both renderers, and compare")
    ] = False,
    out: Annotated[
        Path | None, typer.Option("--report", help="also write what is printed to a text file"), Role.WRITTEN
    ] = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Print the renderer, the graphics device, the video codecs and the versions in use."""
    from mr360uw.files import write_whole
    from mr360uw.info import describe

    del overwrite  # the output has been looked at: see `gated`
    lines, wrong = describe(), False
    typer.echo(lines)
    if gpu:
        from mr360uw.composite.gl.self_test import report, run_trials

        trials = run_trials()
        found = report(trials)
        typer.echo(found)
        lines, wrong = f"{lines}\n{found}", any(trial.problem for trial in trials)
    if out is not None:
        write_whole(out, lines + "\n")
    if wrong:
        raise typer.Exit(_DIFFERS)
