# SPDX-License-Identifier: Apache-2.0
"""Commands that make a scene and what it reads: `new`, `tune`, `sample`; `track`, `floor` and `depth` of a clip."""

from __future__ import annotations

import gc
import threading
import webbrowser
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, cast, get_args

import typer

from mr360uw.cli.arguments import BackendOption, EyeOption, JsonOption, OverwriteOption, ProgressOption, Role, Said
from mr360uw.errors import Mr360uwError, ParameterError, install_command, installed

if TYPE_CHECKING:
    from mr360uw.composite.mesh.up_axis import Habit
    from mr360uw.first_look.place_in_plate import Wish
    from mr360uw.sample import DiveSettings
    from mr360uw.track.camera_track import Measure


_NEEDED = ("nicegui", "tomlkit")


@dataclass(frozen=True, slots=True)
class WishOptions:
    """What is wished for an object, and known of the files, in place of guesses."""

    at: Annotated[
        str | None, typer.Option(help="direction of its foot, or of its middle where it swims: azimuth,elevation")
    ] = None
    stand: Annotated[bool, typer.Option("--stand", help="on the ground, whatever its name says")] = False
    swim: Annotated[bool, typer.Option("--swim", help="off the ground, whatever its name says")] = False
    size: Annotated[float | None, typer.Option(help="of its longest side, in metres")] = None
    water: Annotated[bool, typer.Option("--water", help="VIDEO is under water, whatever it looks like")] = False
    air: Annotated[bool, typer.Option("--air", help="VIDEO is in air, whatever it looks like")] = False
    up: Annotated[str, typer.Option(help="axis of MESH that is up: auto, y, z, x, -y, -z or -x")] = "auto"
    track: Annotated[
        Path | None, typer.Option(help="the camera's path, as `mr360uw track` writes it; auto: solve it"), Role.READ
    ] = None
    depth: Annotated[
        Path | None, typer.Option(help="folder of the plate's distances, as `mr360uw depth` writes them"), Role.READ
    ] = None
    eye: EyeOption = None

    def wish(self) -> Wish:
        """Return them as values; raise `ParameterError` where they contradict each other or are none."""
        from mr360uw.composite.mesh.up_axis import Up
        from mr360uw.first_look.place_in_plate import Wish

        if self.stand and self.swim:
            raise ParameterError("--stand, --swim - exclude each other (got both) - give one of them")
        if self.water and self.air:
            raise ParameterError("--water, --air - exclude each other (got both) - give one of them")
        if self.up not in get_args(Up):
            raise ParameterError(f"--up - is no axis (got {self.up!r}) - give one of {', '.join(get_args(Up))}")
        direction = None
        if self.at is not None:
            try:
                azimuth, elevation = (float(part) for part in self.at.split(","))
            except ValueError:
                raise ParameterError(
                    f"--at - is no direction (got {self.at!r}) - write azimuth,elevation in degrees, as in 30,-25"
                ) from None
            direction = azimuth, elevation
        habit: Habit | None = "stands" if self.stand else "swims" if self.swim else None
        underwater = self.water if self.water or self.air else None
        return Wish(direction, habit, self.size, cast("Up", self.up), self.eye, underwater, self.track, self.depth)


def new(
    video: Annotated[Path, typer.Argument(help="360 plate: a video or a still"), Role.READ],
    mesh: Annotated[Path, typer.Argument(help="glTF, USD, OBJ, PLY or STL"), Role.READ],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="scene file; default: VIDEO.toml"), Role.WRITTEN
    ] = None,
    *,
    wish: WishOptions,
    backend: BackendOption = "auto",
    overwrite: OverwriteOption = False,
    outside_files: Annotated[bool, typer.Option("--outside-files", help="MESH may name files elsewhere")] = False,
) -> None:
    """Look at VIDEO and MESH, and write a scene that puts one into the other, with a preview; say what was guessed."""
    from mr360uw.base.progress import terminal_progress
    from mr360uw.first_look.first_scene import make_first_scene

    wished = wish.wish()
    with terminal_progress() as progress:
        _, lines, commands = make_first_scene(
            video, mesh, out, wished, overwrite=overwrite, outside_files=outside_files, backend=backend,
            progress=progress,
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
    if not all(map(installed, _NEEDED)):
        raise Mr360uwError(f"tune - needs packages that are not installed - {install_command('tune')}")
    gc.disable()  # modules are no garbage: looking for some takes a tenth of the time to load them
    from mr360uw.tune.document import Document
    from mr360uw.tune.server import check_options, serve

    gc.freeze()
    gc.enable()
    check_options(host, token, backend)
    scene = source
    if mesh is not None:
        from mr360uw.base.progress import terminal_progress
        from mr360uw.first_look.first_scene import make_first_scene

        with terminal_progress() as progress:
            scene, lines, _ = make_first_scene(source, mesh, backend=backend, progress=progress)
        typer.echo("\n".join(lines))
    document = Document(scene)

    def show(door: Path) -> None:
        if not no_browser:
            threading.Thread(target=webbrowser.open, args=(door.as_uri(),), daemon=True).start()

    try:
        serve(document, host=host, port=port, token=token, backend=backend, tell=typer.echo, show=show)
    except KeyboardInterrupt:
        return


@dataclass(frozen=True, slots=True)
class DiveOptions:
    """Parameters of a synthetic dive; None is that of the preset."""

    preset: Annotated[
        str | None, typer.Option(help="reef, lagoon, blue, coast, green, dusk or storm; options override it")
    ] = None
    seed: Annotated[int | None, typer.Option(help="seed of waves, floor and noise")] = None
    water: Annotated[str | None, typer.Option(help="Jerlov type of the water")] = None
    depth: Annotated[float | None, typer.Option(help="depth of the camera in metres")] = None
    floor: Annotated[float | None, typer.Option(help="depth of the floor in metres; default: 3.5 below")] = None
    sky: Annotated[str | None, typer.Option(help="clear, even or overcast")] = None
    sky_map: Annotated[str | None, typer.Option(help="HDR picture of the sky, with its sun"), Role.READ] = None
    sun_elevation: Annotated[float | None, typer.Option(help="of the sun above the surface, in degrees")] = None
    sun_azimuth: Annotated[float | None, typer.Option(help="of the sun, 0 = ahead, + = right, in degrees")] = None
    wind: Annotated[float | None, typer.Option(help="speed of the wind in m/s")] = None
    speed: Annotated[float | None, typer.Option(help="speed in m/s at which the camera swims ahead")] = None
    overrides: Annotated[
        list[str] | None,
        typer.Option("--set", help="any parameter of the dive, as in --set rocks=0.3 (docs/sample.md)"),
    ] = None

    def settings(self) -> DiveSettings:
        """Return the dive's settings; raise `ParameterError` with a line for each problem."""
        from mr360uw.sample import DiveSettings
        from mr360uw.scene.toml_model import override

        named = {
            "seed": self.seed, "water": self.water, "depth_m": self.depth, "floor_m": self.floor, "sky": self.sky,
            "sky_map": self.sky_map, "sun_elevation_deg": self.sun_elevation, "sun_azimuth_deg": self.sun_azimuth,
            "wind_m_s": self.wind, "speed_m_s": self.speed,
        }  # fmt: skip
        options: dict[str, Any] = {name: value for name, value in named.items() if value is not None}
        for text in self.overrides or ():
            override(options, text)
        return DiveSettings.of(self.preset, **options)


def sample(
    folder: Annotated[Path, typer.Argument(help="folder to make"), Role.FOLDER],
    width: Annotated[int, typer.Option(help="frame width in pixels; the height is half of it")] = 1024,
    frames: Annotated[int, typer.Option(help="number of frames")] = 48,
    samples: Annotated[int, typer.Option(help="rays of a pixel along each axis, 1 to 8")] = 1,
    truth: Annotated[bool, typer.Option("--truth", help="distances and masks of every frame")] = False,
    *,
    dive: DiveOptions,
    overwrite: OverwriteOption = False,
) -> None:
    """Make a synthetic 360 dive: plate with sound, whale, truth, and a scene file that puts one into the other."""
    from mr360uw.base.progress import terminal_progress
    from mr360uw.sample import check_recording, sample_dive

    wrong, settings = [], None
    try:
        settings = dive.settings()
    except ParameterError as error:
        wrong.append(str(error))
    try:
        check_recording(width, frames, samples)
    except ParameterError as error:
        wrong.append(str(error))
    if wrong:
        raise ParameterError("\n".join(wrong))
    with terminal_progress() as progress:
        made = sample_dive(
            folder, settings, width=width, frames=frames, samples=samples, truth=truth, overwrite=overwrite,
            progress=progress,
        )  # fmt: skip
    typer.echo(f"wrote {made.plate}\n      {made.mesh}\n      {made.scene}\n      {made.truth}")


def track(
    video: Annotated[Path | None, typer.Argument(help="360 clip", show_default=False), Role.READ] = None,
    out: Annotated[
        Path,
        typer.Option("--out", "-o", help="track.csv or .json; both are written. .chan for Nuke, .py for Blender"),
        Role.WRITTEN,
    ] = Path("track.csv"),
    height: Annotated[float | None, typer.Option(help="of the camera over the floor at time 0, in metres")] = None,
    length: Annotated[
        str | None, typer.Option(help="X,Y:X,Y=METRES: metres between what two pixels of the first frame show")
    ] = None,
    depth_log: Annotated[
        Path | None, typer.Option("--depth-log", help="CSV of a dive computer with time_s and depth_m"), Role.READ
    ] = None,
    depth_offset: Annotated[
        float | None, typer.Option("--depth-offset", help="the log's time at the clip's start [s]; default: found")
    ] = None,
    mask: Annotated[Path | None, typer.Option(help="picture, black where nothing is tracked"), Role.READ] = None,
    mask_only: Annotated[
        bool, typer.Option("--mask-only", help="leave out nothing else: also track what moves along with the camera")
    ] = False,
    solved: Annotated[
        Path | None,
        typer.Option("--from", help="path of another program, or track.csv, in place of solving"),
        Role.READ,
    ] = None,
    fps: Annotated[float | None, typer.Option(help="frames a second of a file that counts frames")] = None,
    scale: Annotated[float, typer.Option(help="metres per unit of the file")] = 1.0,
    eye: EyeOption = None,
    overwrite: OverwriteOption = False,
    as_json: JsonOption = False,
) -> None:
    """Solve the camera's path of VIDEO from its pictures, for camera.track of a scene; say how good it is.

    With --from, convert the path that another program has solved.
    """
    from mr360uw.base.files import check_work_folder
    from mr360uw.track.camera_track import Measure, parse_length, track_files

    if solved is not None:
        if any(given is not None for given in (height, length, depth_log, mask)):
            raise ParameterError(
                "--from - takes its scale from --scale (got a measure or a mask for solving) - leave them out"
            )
        _convert(solved, video, out, fps, scale, Said(as_json), overwrite=overwrite)
        return
    if video is None:
        raise ParameterError("VIDEO - is missing - name a 360 clip, or give --from")
    if fps is not None or scale != 1.0:
        raise ParameterError("--fps, --scale - are for --from alone - leave them out")
    if depth_offset is not None and depth_log is None:
        raise ParameterError("--depth-offset - is of no use without --depth-log - give both")
    apart = None if length is None else parse_length(length)
    measure = Measure(height, apart, depth_log, depth_offset)
    track_files(out, [video, *(file for file in (mask, depth_log) if file is not None)], overwrite=overwrite)
    check_work_folder(_work_of(out))
    _solve(video, out, measure, mask, eye, Said(as_json), mask_only=mask_only, overwrite=overwrite)


def floor(
    track: Annotated[Path, typer.Argument(help="track.json of `mr360uw track`"), Role.READ],
    out: Annotated[Path, typer.Option("--out", "-o", help="floor.glb or floor.ply"), Role.WRITTEN],
    overwrite: OverwriteOption = False,
) -> None:
    """Make a mesh of the floor from the points of TRACK, for receiver.path of a scene; say how good it is."""
    from mr360uw.track.floor_mesh import check_mesh_output, floor_from_track
    from mr360uw.track.tracking import floor_lines

    check_mesh_output(out, overwrite=overwrite)
    found = floor_from_track(track)
    written = found.save(out, overwrite=overwrite)
    typer.echo("\n".join([*floor_lines(found, track, written), f"wrote {written}"]))


def depth(
    video: Annotated[
        Path, typer.Argument(help="360 clip of a camera that moves, or a stereo plate", show_default=False), Role.READ
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="folder for the maps"), Role.FOLDER],
    track: Annotated[
        Path | None, typer.Option(help="track.csv of `mr360uw track`; default: solved here"), Role.READ
    ] = None,
    width: Annotated[int | None, typer.Option(help="of the maps, in pixels; default: 1024, of both eyes 2048")] = None,
    water: Annotated[
        bool, typer.Option("--water", help="then tell the water by what is seen from near and far; needs --track")
    ] = False,
    eye: Annotated[
        Literal["left", "right", "both"] | None,
        typer.Option(help="eye of a stereo plate; both: the distances of both by their disparity, without a track"),
    ] = None,
    ipd: Annotated[
        float | None, typer.Option(help="metres between the eyes, for --eye both; default: 0.064, as camera.ipd_m")
    ] = None,
    overwrite: OverwriteOption = False,
    progress_lines: ProgressOption = False,
    as_json: JsonOption = False,
) -> None:
    """Write distances and confidences of all frames of VIDEO, as numbered EXR files; a stopped run goes on."""
    from mr360uw.base.progress import begin_phase, terminal_progress
    from mr360uw.depth.clip_depth import depth_of_clip
    from mr360uw.depth.clip_eyes import depth_of_eyes
    from mr360uw.depth.clip_water import water_of_clip
    from mr360uw.video.layout import EYES_APART_M

    # Check options that exclude each other
    if water and track is None:
        raise ParameterError("--water - needs the camera's path (got none) - give --track, made with --height")
    if eye == "both" and track is not None:
        raise ParameterError("--track - is of no use for both eyes (got one) - leave it out, or name one eye")
    if eye != "both" and ipd is not None:
        raise ParameterError("--ipd - is for --eye both alone (got it without) - leave it out")
    # Two eyes need no track; a moving camera may tell the water too
    say, found = Said(as_json), None
    with terminal_progress(lines=progress_lines) as progress:
        if eye == "both":
            apart = EYES_APART_M if ipd is None else ipd
            report = depth_of_eyes(
                video, out, width=width or 2048, eyes_apart_m=apart, overwrite=overwrite, progress=progress
            )
            say(str(report))
            say.end(maps=report)
            return
        report = depth_of_clip(
            video, out, track=track, width=width or 1024, eye=eye, overwrite=overwrite, progress=progress
        )
        say(str(report))
        if water and track is not None:
            begin_phase(progress, "reading the water")
            found = water_of_clip(video, out, track, eye=eye, progress=progress)
            say("\n".join([str(found), *(f"--set {change}" for change in found.overrides)]))
    say.end(maps=report, water=found)


def _work_of(out: Path) -> Path:
    """Return the folder in which the work of a track is kept until it is complete."""
    return out.with_name(f"{out.stem}.track-work")


def _convert(
    solved: Path, video: Path | None, out: Path, fps: float | None, scale: float, say: Said, *, overwrite: bool
) -> None:
    """Write the path in another program's file as a track, or for another program."""
    from mr360uw.track.camera_track import track_files
    from mr360uw.track.path_files import EXPORTS, export, read_solved_path, track_of
    from mr360uw.track.tracking import report_lines
    from mr360uw.video import open_video

    if video is not None:
        with open_video(video) as clip:
            fps = float(clip.frame_rate)
    path = read_solved_path(solved)
    track = track_of(path, str(solved), fps, scale)
    if out.suffix.lower() in EXPORTS:
        written: tuple[Path, ...] = (export(track, out, fps or path.frame_rate, overwrite=overwrite),)
    else:
        track_files(out, [solved], overwrite=overwrite)
        written = track.save(out, overwrite=overwrite)
    say(f"{path.format}: {len(track.time_s)} cameras")
    say("\n".join([*report_lines(track), "wrote " + "\n      ".join(str(name) for name in written)]))
    say.end(tracks=[track], written=written)


def _solve(
    video: Path,
    out: Path,
    measure: Measure,
    mask: Path | None,
    eye: Literal["left", "right"] | None,
    say: Said,
    *,
    mask_only: bool,
    overwrite: bool,
) -> None:
    """Track the shots of a clip and write a track for each; keep the work beside the output until all is done."""
    from mr360uw.base.files import remove_work_folder
    from mr360uw.base.progress import terminal_progress
    from mr360uw.track.camera_track import shot_path, track_files
    from mr360uw.track.tracking import report_lines, track_shots

    keep = _work_of(out)
    try:
        with terminal_progress() as progress:
            shots = track_shots(
                video, measure=measure, mask=mask, eye=eye, mask_only=mask_only, keep=keep, progress=progress
            )
    except ParameterError:  # the clip cannot be tracked; a run that was interrupted leaves the folder, and goes on
        remove_work_folder(keep)
        raise
    outs = [out if len(shots) == 1 else shot_path(out, number) for number in range(1, len(shots) + 1)]
    for path in outs:
        track_files(path, overwrite=overwrite)
    every: list[Path] = []
    for number, (path, shot) in enumerate(zip(outs, shots, strict=True), 1):
        if len(shots) > 1:
            say(f"shot {number}: frames {shot.start}:{shot.stop}, in a world of its own")
        if shot.track is None:
            say(f"not tracked: {shot.problem}")
            continue
        written = shot.track.save(path, overwrite=overwrite)
        say("\n".join([*report_lines(shot.track), "wrote " + "\n      ".join(str(name) for name in written)]))
        every += written
    say.end(tracks=[shot.track for shot in shots], written=every)
    remove_work_folder(keep)
    if all(shot.track is None for shot in shots):
        raise ParameterError(f"{video} - none of its {len(shots)} shots can be tracked - see above")
