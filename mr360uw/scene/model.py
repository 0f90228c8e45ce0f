# SPDX-License-Identifier: Apache-2.0
"""The scene: all settings of a composite, as one model and one TOML file.

The tables are the parameter models that live beside their physics; this module only composes them, reads and checks
files, and reports every problem of a file at once.
"""

from __future__ import annotations

import itertools
import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, ValidationError, model_validator

from mr360uw.caustics.sea.gerstner import GerstnerSea
from mr360uw.caustics.settings import CausticSettings, Sea
from mr360uw.color import Transfer
from mr360uw.composite.settings import DrawSettings, HoldoutSettings, LampSettings, ObjectSettings, ReceiverSettings
from mr360uw.composite.snow.settings import SnowSettings
from mr360uw.errors import SceneError, VideoError
from mr360uw.ibl.settings import LightSettings
from mr360uw.medium.settings import WaterSettings
from mr360uw.medium.shafts.settings import ShaftSettings
from mr360uw.parameters import Parameters, parameter
from mr360uw.reading.input_files import read_text, unreadable
from mr360uw.scene.key_problems import check_keys
from mr360uw.scene.key_settings import KeyedParameter
from mr360uw.scene.overrides import override
from mr360uw.scene.problems import Lines, Location, key_lines, place, problems
from mr360uw.scene.quality import with_quality
from mr360uw.video.settings import EncodeSettings


class PlateSettings(Parameters):
    """The video, image sequence or still that objects are put into."""

    path: Path = parameter(..., "360 video (mp4, mov, mkv, webm), image sequence (plate_%04d.png) or still")
    transfer: Transfer | None = parameter(None, "curve from code values to linear light; none: as the file is tagged")
    eye: Literal["left", "right"] | None = parameter(None, "the eye of a stereo plate to work on")
    frame_rate: float = parameter(30.0, "of pictures, which have none of their own", unit="1/s", above=0.0, high=1000.0)
    scale: float = parameter(
        1.0, "size of the frames that are worked on over the plate's, for drafts", above=0.0, high=1.0
    )
    damaged: Literal["stop", "hold"] = parameter(
        "stop", "at a frame of a video that cannot be decoded: end the run, or repeat the last good frame"
    )


class CameraSettings(Parameters):
    """Where the camera is."""

    depth_m: float = parameter(
        5.0, "depth of the camera below the mean water surface", unit="m", above=0.0, high=200.0,
        fixed="camera.depth_keys move the camera, and the objects stay where they are",
    )  # fmt: skip
    depth_keys: tuple[tuple[float, float], ...] = parameter(
        (), "(time_s, depth_m), ascending, of a camera that rises and sinks; positions start at depth_m"
    )
    track: Path | None = parameter(
        None, "CSV of its motion: time_s, x, y, z, qx, qy, qz, qw; positions start at depth_m"
    )
    roll_deg: float = parameter(
        0.0, "roll of a plate that is not level, + = right side down", unit="deg", low=-180.0, high=180.0,
        fixed="take camera.tilt_keys",
    )  # fmt: skip
    pitch_deg: float = parameter(
        0.0, "pitch of such a plate, + = its centre looks up", unit="deg", low=-90.0, high=90.0,
        fixed="take camera.tilt_keys",
    )  # fmt: skip
    tilt_keys: tuple[tuple[float, float, float], ...] = parameter(
        (), "(time_s, roll_deg, pitch_deg), ascending, instead"
    )
    gravity: Path | None = parameter(None, "GoPro clip whose gravity track levels the plate, or its GPMF payloads")

    @model_validator(mode="after")
    def _check(self) -> CameraSettings:
        if self.depth_keys and self.track is not None:
            raise ValueError("depth_keys - the track has the camera's height already (got both) - remove one of them")
        times = [time for time, _ in self.depth_keys]
        if any(b <= a for a, b in itertools.pairwise(times)):
            raise ValueError(f"depth_keys - must ascend in time (got {times}) - sort them")
        return self


def _plate_from_path(value: Any) -> Any:
    return {"path": value} if isinstance(value, str | Path) else value


class Scene(Parameters):
    """A composite: a plate and everything that is put into it."""

    model_config = ConfigDict(populate_by_name=True)

    plate: Annotated[PlateSettings, BeforeValidator(_plate_from_path)] = parameter(
        ..., "the video to work on", fixed="the plate is read in one way"
    )
    camera: CameraSettings = parameter(CameraSettings(), "the 360 camera")
    water: WaterSettings = parameter(WaterSettings(), "the water between camera and objects")
    objects: tuple[ObjectSettings, ...] = parameter((), "the meshes", alias="object")
    lamps: tuple[LampSettings, ...] = parameter((), "lights beside the plate's own", alias="lamp")
    receiver: ReceiverSettings | None = parameter(None, "the part of the plate that receives shadows and caustics")
    holdouts: tuple[HoldoutSettings, ...] = parameter(
        (), "mattes of the plate in front of the objects", alias="holdout", fixed="a matte may itself be a video"
    )
    light: LightSettings = parameter(LightSettings(), "how light is taken from the plate")
    sea: Sea = parameter(GerstnerSea(), "the water surface")
    caustics: CausticSettings = parameter(CausticSettings(), "light focused by the surface")
    shafts: ShaftSettings = parameter(ShaftSettings(), "light in the water, and bodies' shadows in it")
    snow: SnowSettings = parameter(SnowSettings(), "particles suspended in the water")
    draw: DrawSettings = parameter(DrawSettings(), "how finely objects are drawn")
    output: EncodeSettings = parameter(
        EncodeSettings(), "how the result is encoded", fixed="a clip is encoded in one way"
    )
    keys: tuple[KeyedParameter, ...] = parameter((), "parameters that change over time", fixed="keys stay as they are")

    _of_quality = model_validator(mode="before")(staticmethod(with_quality))

    @model_validator(mode="after")
    def _lamps_on_objects(self) -> Scene:
        for number, lamp in enumerate(self.lamps):
            if lamp.attach == "object" and lamp.object >= len(self.objects):
                raise ValueError(
                    f"lamp.{number}.object - no such object (got {lamp.object}) - the scene has {len(self.objects)}, "
                    "the first is 0"
                )
        return self

    @model_validator(mode="after")
    def _tables_fit(self) -> Scene:
        self.shafts.check(self.water.mode)
        check_keys(self, self.keys)
        return self


def load_scene(path: str | Path, overrides: Sequence[str] = ()) -> Scene:
    """Return the scene of a TOML file; relative paths in it start at its folder.

    overrides: 'table.key=value' with a TOML value (a bare word is text), 'object.0.scale=2' for the first object.
    Raises `SceneError` with one line for each problem: *file:line key - what is wrong (got ...) - what to do*.
    """
    path = Path(path)
    text = scene_text(path)
    data = tables_of(text, str(path))
    for text_override in overrides:
        override(data, text_override)
    return scene_from_dict(data, path.resolve().parent, where=str(path), lines=key_lines(text))


def scene_text(path: Path) -> str:
    """Return the text of a scene file; raise `SceneError` where there is none."""
    if reason := unreadable(path):
        made = ", or make one: mr360uw new VIDEO MESH" if reason.startswith("no such") else ""
        raise SceneError(str(path), [reason + made])
    try:
        return read_text(path, VideoError)
    except VideoError as error:
        raise SceneError(str(path), [str(error).removeprefix(f"{path} - ")]) from None


def tables_of(text: str, where: str) -> dict[str, Any]:
    """Return the nested tables of a scene's text; raise `SceneError` where it is not TOML. where: name of its file."""
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # TOMLDecodeError, or a number of more digits than Python reads
        raise SceneError(where, [f"is not TOML (got: {error!s:.120}) - correct the line"]) from None


def scene_from_dict(data: dict[str, Any], folder: Path, where: str = "scene", lines: Lines | None = None) -> Scene:
    """Return the scene of nested dictionaries as a TOML file gives them; raise `SceneError` with every problem."""
    try:
        scene = Scene.model_validate(data)
    except RecursionError:
        raise SceneError(
            where, ["has tables within tables too deep to read - write them as the handbook has them"]
        ) from None
    except ValidationError as error:
        raise SceneError(where, problems(error, Scene, where, lines or {})) from None
    scene = _with_absolute_paths(scene, folder)
    unusable = [
        f"{place(where, lines or {}, location)} - {problem}"
        for location, file in _files(scene)
        if (problem := _problem(file, folder))
    ]
    if unusable:
        raise SceneError(where, unusable)
    return scene


def at_scale(scene: Scene, scale: float | None) -> Scene:
    """Return a scene that works on frames of `scale` times its plate's size; itself for None."""
    if scale is None:
        return scene
    return scene.model_copy(update={"plate": scene.plate.model_copy(update={"scale": scale})})


def files_of(scene: Scene) -> list[Path]:
    """Return every file and pattern of files that a scene names."""
    return [file for _, file in _files(scene)]


def scene_schema() -> dict[str, Any]:
    """Return the JSON schema of a scene file, with units, ranges and help."""
    return Scene.model_json_schema(by_alias=True)


# --- files ---------------------------------------------------------------------------------------------------------


def _with_absolute_paths(value: Any, folder: Path) -> Any:
    if isinstance(value, Path):
        return value if value.is_absolute() else folder / value
    if isinstance(value, tuple):
        return tuple(_with_absolute_paths(item, folder) for item in value)
    if isinstance(value, BaseModel):
        changed = {}
        for name in type(value).model_fields:
            old = getattr(value, name)
            new = _with_absolute_paths(old, folder)
            if new is not old:
                changed[name] = new
        return value.model_copy(update=changed) if changed else value
    return value


def _files(value: Any, location: Location = ()) -> Iterator[tuple[Location, Path]]:
    if isinstance(value, Path):
        yield location, value
    elif isinstance(value, tuple):
        for index, item in enumerate(value):
            yield from _files(item, (*location, index))
    elif isinstance(value, BaseModel):
        for name, field in type(value).model_fields.items():
            yield from _files(getattr(value, name), (*location, field.alias or name))


def _problem(path: Path, folder: Path) -> str:
    """Return why a file, or a pattern of numbered files, cannot be read, "" if it can; folder: of the scene."""
    reason = unreadable(path)
    if not reason or (reason.startswith("no such") and any(c in path.name for c in "%#*") and path.parent.is_dir()):
        return ""
    what, todo = reason.split(" - ", 1)
    return f"{what} (got {path!s:.200}) - {todo}" + (f"; it starts at {folder}" if what == "no such file" else "")
