# SPDX-License-Identifier: Apache-2.0
"""The command that makes a synthetic dive."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from mr360uw.cli.arguments import OverwriteOption
from mr360uw.cli.gated import Role


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
    from mr360uw.errors import ParameterError
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
