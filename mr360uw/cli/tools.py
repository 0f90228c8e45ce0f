# SPDX-License-Identifier: Apache-2.0
"""Commands that measure plates and this machine, fit scenes, export maps and tell what is there."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from mr360uw.cli.arguments import (
    BackendOption,
    EyeOption,
    FramesOption,
    JsonOption,
    OverwriteOption,
    Role,
    Said,
    SceneArgument,
    SetOption,
    frame_range,
)
from mr360uw.errors import ParameterError

if TYPE_CHECKING:
    from mr360uw.base.progress import Progress
    from mr360uw.scene.model import Scene

_DIFFERS = 1
"""Exit code of a self-test in which a picture is wrong."""


def analyse(
    video: Annotated[Path, typer.Argument(help="360 plate, or a scene file that names one"), Role.READ],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="page to write; default: VIDEO.html"), Role.WRITTEN
    ] = None,
    eye: EyeOption = None,
    overwrite: OverwriteOption = False,
    as_json: JsonOption = False,
) -> None:
    """Write a self-contained page about the light and the water of VIDEO, and the track of its sun."""
    from mr360uw.base.progress import terminal_progress
    from mr360uw.first_look.observations import look_at_plate
    from mr360uw.first_look.proposal import where_line
    from mr360uw.preview.pages import analyse_video
    from mr360uw.scene.model import load_scene

    in_air, say, medium = False, Said(as_json), None
    if video.suffix.lower() != ".toml":
        medium = look_at_plate(video, eye).medium
        in_air = not medium.underwater
        say(where_line(medium))
    else:
        scene = load_scene(video)
        if "water" not in scene.model_fields_set and scene.plate.model_fields_set == {"path"}:
            in_air = not look_at_plate(scene.plate.path).medium.underwater
            if in_air:
                say('note      the plate is in air, and the scene does not say so: [water] type = "none"')
    with terminal_progress() as progress:
        written = analyse_video(video, out, eye=eye, in_air=in_air, overwrite=overwrite, progress=progress, tell=say)
    say("wrote " + "\n      ".join(str(path) for path in written))
    say.end(medium=medium, written=written)


def caustics(
    scene: SceneArgument,
    folder: Annotated[Path, typer.Argument(help="folder for the images"), Role.FOLDER],
    frames: Annotated[int, typer.Option(help="number of frames of the loop")] = 48,
    loop_s: Annotated[float, typer.Option(help="length of the loop in seconds")] = 8.0,
    depth_m: Annotated[float | None, typer.Option(help="depth of the caustics; default: the receiver's")] = None,
    image_format: Annotated[Literal["png", "exr"], typer.Option("--format", help="16-bit PNG or float EXR")] = "png",
    overrides: SetOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Export SCENE's sea as tileable, looping caustic, height and normal maps for other programs."""
    from mr360uw.base.progress import terminal_progress
    from mr360uw.runs.pipeline import export_caustics
    from mr360uw.scene.model import load_scene

    with terminal_progress() as progress:
        written = export_caustics(
            load_scene(scene, overrides or ()), folder, frames=frames, loop_s=loop_s, depth_m=depth_m,
            image_format=image_format, overwrite=overwrite, progress=progress,
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
    as_json: JsonOption = False,
) -> None:
    """Fit SCENE's sea or water to what its plate shows, and print the changes as --set takes them."""
    from mr360uw.base.files import check_outputs
    from mr360uw.base.progress import terminal_progress
    from mr360uw.scene.model import files_of, load_scene
    from mr360uw.scene.resolved import open_plate

    if caustics == (water is not None):
        raise ParameterError("match - fits one thing at a time (got both or none) - give --caustics or --water")
    loaded, span = load_scene(scene, overrides or ()), None
    if picture is not None and water is None:
        if picture.suffix.lower() != ".png":
            raise ParameterError(f"--picture - is no name of a PNG (got {picture}) - end it in .png")
        check_outputs([picture], inputs=files_of(loaded), overwrite=overwrite)
    if frames is not None:
        with open_plate(loaded) as video:
            span = video.numbered_range(*frame_range(frames))
    with terminal_progress() as progress:
        say = Said(as_json)
        found: object = (
            _matched_caustics(loaded, span, picture, progress, say)
            if water is None
            else _matched_water(loaded, water, span, say)
        )
    say.end(found=found)


def _matched_water(scene: Scene, patch: str, frames: tuple[int, int] | None, say: Said) -> object:
    """Return, and say, what a fit of the water to a patch 'yaw,pitch,size' found. frames: [a, b), else the first."""
    import numpy as np

    from mr360uw.match import WaterPatch, match_water

    try:
        yaw, pitch, size = (float(part) for part in patch.split(","))
    except ValueError:
        raise ParameterError(
            f"--water - is no patch (got {patch!r}) - write yaw,pitch,size in degrees, as in 120,5,15"
        ) from None
    found = match_water(scene, WaterPatch(yaw, pitch, size), frames or 0)
    codes = "; ".join(
        f"{name} {np.round(code).astype(int).tolist()}"
        for name, code in (("plate", found.plate_code), ("before", found.before_code), ("after", found.after_code))
    )
    say("\n".join([found.sentence, f"code values: {codes}", *(f"--set {change}" for change in found.overrides)]))
    return found


def _matched_caustics(
    scene: Scene, frames: tuple[int, int] | None, picture: Path | None, progress: Progress, say: Said
) -> object:
    """Return, and say, what a fit of the sea to the plate's caustics found; write both to a picture."""
    import numpy as np

    from mr360uw.base.files import write_whole
    from mr360uw.match import match_caustics
    from mr360uw.preview.screen import encoded

    found = match_caustics(scene, frames, progress=progress)
    lines = [found.sentence, f"confidence {found.confidence:.2f}", *(f"--set {change}" for change in found.overrides)]
    pictures = found.pictures()
    if picture is not None and pictures:
        write_whole(picture, encoded(np.concatenate([pictures["floor"], pictures["spectra"]]), ".png"))
        lines.append(f"wrote {picture}")
    elif picture is not None:
        lines.append(f"{picture} is not written, as no caustics were read on the floor")
    say("\n".join(lines))
    return found


def schema(
    markdown: Annotated[bool, typer.Option("--markdown", help="print tables for people instead")] = False,
    aerial: Annotated[bool, typer.Option("--aerial", help="of the scenes of `mr360uw aerial`")] = False,
) -> None:
    """Print the JSON schema of a scene file."""
    import json

    from mr360uw.from_above.settings import AerialScene, aerial_handbook
    from mr360uw.scene.handbook import parameters_markdown
    from mr360uw.scene.model import Scene

    if markdown:
        typer.echo(aerial_handbook() if aerial else parameters_markdown(), nl=False)
        return
    typer.echo(json.dumps((AerialScene if aerial else Scene).model_json_schema(by_alias=True), indent=2))


def info(
    gpu: Annotated[
        bool, typer.Option("--gpu", help="also draw eight small pictures with both renderers, and compare")
    ] = False,
    out: Annotated[
        Path | None, typer.Option("--report", help="also write what is printed to a text file"), Role.WRITTEN
    ] = None,
    overwrite: OverwriteOption = False,
    as_json: JsonOption = False,
) -> None:
    """Print the renderer, the graphics device, the video codecs and the versions in use."""
    from mr360uw import __version__
    from mr360uw.base.files import write_whole
    from mr360uw.errors import package_versions

    del overwrite  # the output has been looked at: see `gated`
    lines, wrong, say = describe(), False, Said(as_json)
    say(lines)
    if gpu:
        from mr360uw.composite.gl.self_test import report, run_trials

        trials = run_trials()
        found = report(trials)
        say(found)
        lines, wrong = f"{lines}\n{found}", any(trial.problem for trial in trials)
    say.end(version=__version__, packages=package_versions(), wrong=wrong)
    if out is not None:
        write_whole(out, lines + "\n")
    if wrong:
        raise typer.Exit(_DIFFERS)


_NO_CARD = 'none, so output.encoder = "auto" takes those of the processor'


def describe() -> str:
    """Return several lines: version, renderer and device, video library and encoders, packages, extras."""
    import platform

    import av

    from mr360uw import __version__
    from mr360uw.base.disk_cache import cache_folder, cache_notes, kernel_folder
    from mr360uw.errors import EXTRAS, GlError, extra_versions, package_versions
    from mr360uw.gl import gl_device
    from mr360uw.video.clip import CODECS
    from mr360uw.video.encoder import opening_encoders

    lines = [f"mr360uw {__version__}, Python {platform.python_version()}, {platform.platform()}"]
    # Renderer, codecs and encoders that work here
    try:
        device = gl_device()
        kind = "software" if device.software else "GPU"
        lines.append(f"renderer  gl: {device.renderer} ({kind}), OpenGL {device.version}, {device.vendor}")
    except GlError as error:
        lines.append(f"renderer  reference: {error}")
    ffmpeg = ".".join(str(part) for part in av.library_versions["libavcodec"])
    known = (*(form.software for form in CODECS.values()), "prores_ks")
    found = [name for name in known if name in av.codecs_available]
    lines.append(f"video     FFmpeg libavcodec {ffmpeg}; encoders {' '.join(found)}")
    lines.append(f"encoders  of graphics cards that open here: {' '.join(opening_encoders()) or _NO_CARD}")
    # Folders, packages and extras
    folder, kernels = cache_folder(), kernel_folder()
    lines.append(f"cache     {folder or 'none'}; compiled kernels in {kernels or 'none'}")
    lines += [f"note      {note}" for note in cache_notes()]
    lines += [
        f"package   {name} {version}" if version else f"package   {name} is not installed"
        for name, version in package_versions().items()
    ]
    lines += [f"extra     {extra}: {extra_versions(extra)}" for extra in EXTRAS]
    return "\n".join(lines)


_REGRESSED = 1
"""Exit code of a comparison that found something slower or less accurate."""


def bench(
    quick: Annotated[
        bool, typer.Option("--quick", help="fewer settings and smaller frames: about two minutes")
    ] = False,
    only: Annotated[list[str] | None, typer.Option(help="measure this stage alone; may be repeated")] = None,
    json_file: Annotated[
        Path | None, typer.Option("--json", help="also write every measurement, as JSON"), Role.WRITTEN
    ] = None,
    page: Annotated[
        Path | None, typer.Option(help="also write a page with the Pareto fronts, as HTML"), Role.WRITTEN
    ] = None,
    against: Annotated[
        Path | None,
        typer.Option(help="JSON of an earlier run: list what is slower or worse, exit code 1 if any"),
        Role.READ,
    ] = None,
    backend: BackendOption = "auto",
    overwrite: OverwriteOption = False,
) -> None:
    """Measure what settings cost (processor time) and bring (error), stage by stage, on a sample dive."""
    from mr360uw.base.files import write_whole
    from mr360uw.base.progress import terminal_progress
    from mr360uw.bench.bench_report import bench_page, check_kinds, chosen_stages, compare, read_report, run_bench

    del overwrite  # the outputs have been looked at: see `gated`
    stages, before = chosen_stages(only or ()), None if against is None else read_report(against)
    if before is not None:
        check_kinds(before, quick=quick)
    with terminal_progress() as progress:
        report = run_bench(stages, quick=quick, backend=backend, progress=progress)
    typer.echo(str(report))
    if json_file is not None:
        write_whole(json_file, report.model_dump_json(indent=2) + "\n")
    if page is not None:
        write_whole(page, bench_page(report))
    if before is not None:
        regressions, comparison = compare(before, report)
        typer.echo(f"\nagainst {against}: {comparison}")
        if regressions:
            raise typer.Exit(_REGRESSED)
