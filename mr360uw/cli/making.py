# SPDX-License-Identifier: Apache-2.0
"""Commands that make scenes: `new` and `tune` of a plate and a mesh, `sample` of nothing."""

from __future__ import annotations

import gc
import importlib.util
import threading
import webbrowser
from pathlib import Path
from typing import Annotated, Any, cast, get_args

import typer

from mr360uw.cli.arguments import BackendOption, EyeOption, OverwriteOption, Role
from mr360uw.errors import Mr360uwError, ParameterError
from mr360uw.reading.extras import command

_NEEDED = ("nicegui", "tomlkit")


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
    water: Annotated[bool, typer.Option("--water", help="VIDEO is under water, whatever it looks like")] = False,
    air: Annotated[bool, typer.Option("--air", help="VIDEO is in air, whatever it looks like")] = False,
    up: Annotated[str, typer.Option(help="axis of MESH that is up: auto, y, z, x, -y, -z or -x")] = "auto",
    track: Annotated[
        Path | None, typer.Option(help="the camera's path, as `mr360uw track` writes it"), Role.READ
    ] = None,
    depth: Annotated[
        Path | None, typer.Option(help="folder of the plate's distances, as `mr360uw depth` writes them"), Role.READ
    ] = None,
    eye: EyeOption = None,
    backend: BackendOption = "auto",
    overwrite: OverwriteOption = False,
    outside_files: Annotated[bool, typer.Option("--outside-files", help="MESH may name files elsewhere")] = False,
) -> None:
    """Look at VIDEO and MESH, and write a scene that puts one into the other, with a preview; say what was guessed."""
    from mr360uw.composite.mesh.up_axis import Up
    from mr360uw.first_look.first_scene import make_first_scene
    from mr360uw.first_look.place_in_plate import Wish

    if stand and swim:
        raise ParameterError("--stand, --swim - exclude each other (got both) - give one of them")
    if water and air:
        raise ParameterError("--water, --air - exclude each other (got both) - give one of them")
    if up not in get_args(Up):
        raise ParameterError(f"--up - is no axis (got {up!r}) - give one of {', '.join(get_args(Up))}")
    direction = None
    if at is not None:
        try:
            azimuth, elevation = (float(part) for part in at.split(","))
        except ValueError:
            raise ParameterError(
                f"--at - is no direction (got {at!r}) - write azimuth,elevation in degrees, as in 30,-25"
            ) from None
        direction = azimuth, elevation
    wish = Wish(direction, "stands" if stand else "swims" if swim else None, size)
    _, lines, commands = make_first_scene(
        video, mesh, out, wish=wish, track=track, depth=depth, eye=eye, up=cast("Up", up),
        underwater=water if water or air else None, overwrite=overwrite, outside_files=outside_files, backend=backend,
    )  # fmt: skip
    typer.echo("\n".join([*lines, *commands]))


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
        raise Mr360uwError(f"tune - needs packages that are not installed - {command('tune')}")
    gc.disable()  # modules are no garbage: looking for some takes a tenth of the time to load them
    from mr360uw.tune.editing.document import Document
    from mr360uw.tune.server import check_options, serve

    gc.freeze()
    gc.enable()
    check_options(host, token, backend)
    scene = source
    if mesh is not None:
        from mr360uw.first_look.first_scene import make_first_scene

        scene, lines, _ = make_first_scene(source, mesh, backend=backend)
        typer.echo("\n".join(lines))
    document = Document(scene)

    def show(door: Path) -> None:
        if not no_browser:
            threading.Thread(target=webbrowser.open, args=(door.as_uri(),), daemon=True).start()

    try:
        serve(document, host=host, port=port, token=token, backend=backend, tell=typer.echo, show=show)
    except KeyboardInterrupt:
        return


def sample(
    folder: Annotated[Path, typer.Argument(help="folder to make"), Role.FOLDER],
    preset: Annotated[
        str | None, typer.Option(help="reef, lagoon, blue, coast, green, dusk or storm; options override it")
    ] = None,
    width: Annotated[int, typer.Option(help="frame width in pixels; the height is half of it")] = 1024,
    frames: Annotated[int, typer.Option(help="number of frames")] = 48,
    samples: Annotated[int, typer.Option(help="rays of a pixel along each axis, 1 to 8")] = 1,
    truth: Annotated[bool, typer.Option("--truth", help="distances and masks of every frame")] = False,
    seed: Annotated[int | None, typer.Option(help="seed of waves, floor and noise")] = None,
    water: Annotated[str | None, typer.Option(help="Jerlov type of the water")] = None,
    depth: Annotated[float | None, typer.Option(help="depth of the camera in metres")] = None,
    floor: Annotated[float | None, typer.Option(help="depth of the floor in metres; default: 3.5 below")] = None,
    sky: Annotated[str | None, typer.Option(help="clear, even or overcast")] = None,
    sky_map: Annotated[str | None, typer.Option(help="HDR picture of the sky, with its sun"), Role.READ] = None,
    sun_elevation: Annotated[float | None, typer.Option(help="of the sun above the surface, in degrees")] = None,
    sun_azimuth: Annotated[float | None, typer.Option(help="of the sun, 0 = ahead, + = right, in degrees")] = None,
    wind: Annotated[float | None, typer.Option(help="speed of the wind in m/s")] = None,
    speed: Annotated[float | None, typer.Option(help="speed in m/s at which the camera swims ahead")] = None,
    overrides: Annotated[
        list[str] | None,
        typer.Option("--set", help="any parameter of the dive, as in --set rocks=0.3 (docs/sample.md)"),
    ] = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Make a synthetic 360 dive: plate with sound, whale, truth, and a scene file that puts one into the other."""
    from mr360uw.progress import terminal_progress
    from mr360uw.sample import DiveSettings, check_recording, sample_dive
    from mr360uw.scene.toml_model import override

    named = {
        "seed": seed, "water": water, "depth_m": depth, "floor_m": floor, "sky": sky, "sky_map": sky_map,
        "sun_elevation_deg": sun_elevation, "sun_azimuth_deg": sun_azimuth, "wind_m_s": wind, "speed_m_s": speed,
    }  # fmt: skip
    options: dict[str, Any] = {name: value for name, value in named.items() if value is not None}
    for text in overrides or ():
        override(options, text)
    wrong, settings = [], None
    try:
        settings = DiveSettings.of(preset, **options)
    except ParameterError as error:
        wrong.append(str(error))
    try:
        check_recording(width, frames, samples)
    except ParameterError as error:
        wrong.append(str(error))
    if wrong:
        raise ParameterError("\n".join(wrong))
    with terminal_progress() as progress:
        dive = sample_dive(
            folder, settings, width=width, frames=frames, samples=samples, truth=truth, overwrite=overwrite,
            progress=progress,
        )  # fmt: skip
    typer.echo(f"wrote {dive.plate}\n      {dive.mesh}\n      {dive.scene}\n      {dive.truth}")
