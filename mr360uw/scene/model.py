# SPDX-License-Identifier: Apache-2.0
"""The scene: all settings of a composite, as one model and one TOML file.

The tables are the parameter models that live beside their physics; this module only composes them, reads and checks
files, and reports every problem of a file at once.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, ValidationError, model_validator

from mr360uw.base.color import DisplayTransfer, Levels, Primaries, Transfer
from mr360uw.base.constants import MAXIMUM_SUN_SAMPLES
from mr360uw.base.parameters import Parameters, advanced, checked, file_path, listed, parameter
from mr360uw.caustics.gerstner import GerstnerSea
from mr360uw.caustics.settings import CausticSettings, Sea
from mr360uw.composite.grading.settings import MatchSettings
from mr360uw.composite.settings import (
    DrawSettings,
    HoldoutSettings,
    LampSettings,
    ObjectSettings,
    ReceiverSettings,
    SnowSettings,
    SurfaceSettings,
)
from mr360uw.errors import SceneError
from mr360uw.ibl.settings import LightSettings
from mr360uw.medium.settings import ShaftSettings, WaterSettings
from mr360uw.scene.key_targets import KeyedParameter, check_keys
from mr360uw.scene.problems import Lines, problems
from mr360uw.scene.toml_model import (
    as_tables,
    load_model,
    model_from_dict,
    named_files,
    override,
    toml_document,
    with_absolute_paths,
)
from mr360uw.video.clip import FISHEYE_FOV_DEG, EncodeSettings, Projection
from mr360uw.yuv.ocio_transform import OcioSettings

QUALITIES: Mapping[str, Mapping[str, Mapping[str, object]]] = {
    "draft": {
        "water": {"bands": 21},
        "caustics": {"size": 256, "planes": 2},
        "shafts": {"resolution": 512, "slices": 16},
        "draw": {"samples": 13, "sun_samples": 8},
    },
    "final": {},
    "reference": {
        "water": {"bands": 121},
        "caustics": {"size": 1024, "grid": 512, "planes": 8},
        "shafts": {"resolution": 2048, "slices": 128},
        "draw": {"shading": "sample", "sun_samples": MAXIMUM_SUN_SAMPLES},
    },
}
"""Values of each `draw.quality`, by table and key. "final" is the defaults of the tables. `mr360uw bench` measures what
each value costs and how far it is from the reference."""


def with_quality(data: Any) -> Any:
    """Return the tables of a scene with the values of its `draw.quality` where they have none of their own.

    data: as `Scene` is made of, tables or models by name; a value that is set is kept, the default of its key included.
    What is no such table, or of no known quality, is returned as it is, for the models to report.
    """
    draw = data.get("draw") if isinstance(data, dict) else None
    quality = draw.get("quality") if isinstance(draw, dict) else getattr(draw, "quality", None)
    tables = QUALITIES.get(quality, {}) if isinstance(quality, str) else {}
    filled = {name: _filled(data.get(name, {}), values) for name, values in tables.items()}
    return {**data, **filled} if filled else data


def _filled(table: Any, values: Mapping[str, object]) -> Any:
    if isinstance(table, BaseModel):
        return table.model_copy(update={key: v for key, v in values.items() if key not in table.model_fields_set})
    return {**values, **table} if isinstance(table, dict) else table


class PlateSettings(Parameters):
    """The video, image sequence or still that objects are put into."""

    path: Path = parameter(..., "360 video (mp4, mov, mkv, webm), image sequence (plate_%04d.png) or still")
    transfer: Transfer | None = parameter(None, "curve from code values to linear light; none: as the file is tagged")
    primaries: Primaries | None = advanced(None, "primaries of the plate's light; none: as its matrix has them")
    lut: Path | None = parameter(
        None, "lookup table (.cube) from the plate's values to a picture or to light, instead of transfer; invertible"
    )
    lut_to: DisplayTransfer = advanced("srgb", "curve of the table's output, a picture of Rec.709; linear: light")
    levels: Levels = advanced(
        "video", "what 0 and 1 are for lut and ocio: black and white of the plate's range, or code 0 and full scale"
    )
    ocio: OcioSettings | None = parameter(None, "colour spaces of an OpenColorIO config, instead of transfer")
    eye: Literal["left", "right", "both"] | None = parameter(None, "the eyes of a stereo plate to work on")
    layout: Literal["mono", "top-bottom", "bottom-top", "left-right", "right-left"] | None = advanced(
        None, "arrangement of the eyes, in which the panorama may be squeezed; none: as tagged, or by the frame's shape"
    )
    depth: Path | None = parameter(
        None,
        "folder of distance maps, or a pattern, of `mr360uw depth` or others: it hides bodies, and shadows fall on it",
    )
    depth_kind: Literal["metric", "inverse"] = advanced(
        "metric", "of maps made elsewhere: distances, or their inverse as networks give it"
    )
    depth_scale: float = advanced(
        1.0, "of maps made elsewhere: metres for 1, and for the white of a PNG", unit="m", above=0.0, high=10000.0
    )
    frame_rate: float = parameter(30.0, "of pictures, which have none of their own", unit="1/s", above=0.0, high=1000.0)
    scale: float = parameter(
        1.0, "size of the frames that are worked on over the plate's, for drafts", above=0.0, high=1.0,
        internal="--scale",
    )  # fmt: skip
    decoder: Literal["software", "auto"] = advanced(
        "software", "of a video: FFmpeg, or a graphics card whose first picture is the same; a note says which"
    )
    damaged: Literal["stop", "hold"] = advanced(
        "stop", "at a frame of a video that cannot be decoded: end the run, or repeat the last good frame"
    )
    projection: Projection = parameter(
        "auto",
        "of the file's pictures, which are turned to equirectangular; auto: .insv and .osv dual_fisheye, .360 eac",
    )
    fisheye_fov_deg: float = advanced(
        FISHEYE_FOV_DEG, "angle across one half of a dual-fisheye frame; most cameras: 190 to 205", unit="deg",
        low=120.0, high=280.0,
    )  # fmt: skip

    @model_validator(mode="after")
    def _one_way_to_light(self) -> Self:
        named = [name for name in ("lut", "ocio") if getattr(self, name) is not None]
        curve = [name for name in ("transfer", "primaries") if getattr(self, name) is not None]
        if len(named) + bool(curve) > 1:
            raise ValueError(f"{' and '.join(named + curve)} all say what the plate's values mean; keep one of them")
        if self.lut is None and self.lut_to != "srgb":
            raise ValueError(
                f"lut_to - is of a lookup table, and there is none (got {self.lut_to!r}) - name one by lut or remove it"
            )
        if not named and self.levels != "video":
            raise ValueError(
                f"levels - is of lut or ocio, and there is neither (got {self.levels!r}) - name one, or remove levels"
            )
        return self

    @property
    def eyes(self) -> int:
        """Number of eyes that are worked on."""
        return 2 if self.eye == "both" else 1


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
    ipd_m: float = advanced(
        0.064, 'distance between the eyes of the plate\'s camera, for plate.eye = "both"',
        unit="m", low=0.01, high=0.2, fixed="the eyes keep their distance",
    )  # fmt: skip
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


@listed
class Scene(Parameters):
    """A composite: a plate and everything that is put into it.

    Only the plate is required; all else has defaults. Settings are checked when the scene is made, and it never changes
    afterwards: `with_` makes another.

    Raises
    ------
    SceneError
        With one line for each problem: *key - what is wrong (got ...) - what to do*.

    See Also
    --------
    uw.load_scene : Reads one from a file.
    uw.Scene.with_ : Returns a variant of one.
    uw.composite_video : Makes its video.

    Examples
    --------
    >>> made = uw.Scene(plate="dive.mp4", objects=[{"mesh": "whale.glb", "position_m": [0.0, -0.5, -3.0]}])
    >>> made.objects[0].scale
    1.0
    """

    model_config = ConfigDict(populate_by_name=True)

    plate: Annotated[PlateSettings, BeforeValidator(_plate_from_path)] = parameter(
        ..., "the video to work on", fixed="the plate is read in one way"
    )
    camera: CameraSettings = parameter(CameraSettings(), "the 360 camera")
    water: WaterSettings = parameter(WaterSettings(), "the water between camera and objects")
    objects: tuple[ObjectSettings, ...] = parameter((), "the meshes", alias="object")
    lamps: tuple[LampSettings, ...] = parameter((), "lights beside the plate's own", alias="lamp")
    receiver: ReceiverSettings | None = parameter(
        None, "the floor, sand or rock: the part of the plate that receives shadows and caustics"
    )
    holdouts: tuple[HoldoutSettings, ...] = parameter(
        (),
        "masks (mattes) of the plate in front of the objects",
        alias="holdout",
        fixed="a matte may itself be a video",
    )
    light: LightSettings = parameter(LightSettings(), "how light is taken from the plate")
    sea: Sea = parameter(GerstnerSea(), "the water surface")
    caustics: CausticSettings = parameter(CausticSettings(), "light focused by the surface")
    shafts: ShaftSettings = parameter(
        ShaftSettings(), "light in the water (shafts, god rays), and bodies' shadows in it"
    )
    snow: SnowSettings = parameter(SnowSettings(), "particles suspended in the water")
    surface: SurfaceSettings = parameter(SurfaceSettings(), "objects at the water's surface")
    match: MatchSettings = parameter(MatchSettings(), "look of the plate that bodies are given")
    draw: DrawSettings = parameter(DrawSettings(), "how finely objects are drawn")
    output: EncodeSettings = parameter(
        EncodeSettings(), "how the result is encoded", fixed="a clip is encoded in one way"
    )
    keys: tuple[KeyedParameter, ...] = parameter((), "parameters that change over time", fixed="keys stay as they are")

    _of_quality = model_validator(mode="before")(staticmethod(with_quality))

    @classmethod
    @checked
    def refusal(cls, error: ValidationError) -> SceneError:
        """Return what is wrong with the tables of a scene that is made in Python, in the words of a file's."""
        return SceneError("Scene", problems(error, cls, "Scene", {}))

    def with_(self, *overrides: str, **tables: Any) -> Scene:
        """Return the scene with some settings changed, checked as a file is.

        For variants of one scene, as over wind or depth. Relative paths among the new values start at the current
        folder.

        Parameters
        ----------
        *overrides : str
            Settings as the command line takes them, 'object.0.scale=2'.
        **tables : dict or list or scalar
            Tables by name; the keys of a table replace those of the scene's, as in water={"type": "II"}. Lists of
            tables and single values replace the scene's.

        Returns
        -------
        Scene
            Another scene; this one stays as it is.

        Raises
        ------
        SceneError
            With one line for each problem.

        See Also
        --------
        uw.load_scene : Takes the same overrides with a file.
        uw.Scene.to_toml : Writes the variant down.

        Examples
        --------
        >>> scene.with_("object.0.scale=2", water={"type": "II"}).water.type
        'II'
        """
        data = as_tables(self)
        for name, value in tables.items():
            key = fields[name].alias or name if name in (fields := type(self).model_fields) else name
            old, new = data.get(key), as_tables(value)
            data[key] = {**old, **new} if isinstance(old, dict) and isinstance(new, dict) else new
        for one in overrides:
            override(data, one)
        return model_from_dict(Scene, data, Path.cwd(), "Scene")

    def only(self, *names: str, **instead: Any) -> Scene:
        """Return a scene with the plate and the named tables of this one, and the defaults of all others.

        What is computed from it can depend on nothing else. instead: values that other tables have.
        """
        others = {name: value for name, value in _default_tables().items() if name != "plate" and name not in names}
        return self.model_copy(update=others | instead)

    def to_toml(self) -> str:
        """Return the text of a scene file with the settings that are not left at their defaults; paths are absolute.

        For keeping a scene that was made or changed in Python. Comments of a file that it came from are lost.

        Returns
        -------
        str
            TOML that `load_scene` reads.

        Raises
        ------
        SceneError
            If a setting cannot be written.

        See Also
        --------
        uw.load_scene : Reads the text from a file.
        uw.Scene.with_ : Changes settings.

        Examples
        --------
        >>> scene.with_("water.type=II").to_toml().count('type = "II"')
        1
        """
        return toml_document(as_tables(with_absolute_paths(self, Path.cwd())))

    @model_validator(mode="after")
    def _tables_fit(self) -> Scene:
        # Lamps are on objects that there are
        for number, lamp in enumerate(self.lamps):
            if isinstance(lamp.attach, int) and lamp.attach >= len(self.objects):
                raise ValueError(
                    f"lamp.{number}.attach - no such object (got {lamp.attach}) - the scene has {len(self.objects)}, "
                    "the first is 0"
                )
        # Objects stand on a floor whose shape is known before the first frame
        kind = "none" if self.receiver is None else self.receiver.kind
        standing = [n for n, one in enumerate(self.objects) if one.stand_on is not None]
        if standing and kind in ("none", "distance"):
            raise ValueError(
                f"object.{standing[0]}.stand_on - needs a floor of known shape (got receiver {kind}) - add a "
                "[receiver] of kind plane, mesh or height_map, as in height_m = -2"
            )
        check_keys(self, self.keys)
        return self


@checked
def load_scene(path: str | Path, overrides: Sequence[str] = ()) -> Scene:
    """Return the scene of a TOML file; relative paths in it start at its folder.

    It reads the text alone: plate, meshes and other files that the scene names are opened when frames are made.

    Parameters
    ----------
    path : str or Path
        The scene file.
    overrides : sequence of str
        Settings as 'table.key=value' with a TOML value (a bare word is text), 'object.0.scale=2' for the first object.

    Returns
    -------
    Scene
        The scene, checked.

    Raises
    ------
    SceneError
        With one line for each problem: *file:line key - what is wrong (got ...) - what to do*.

    See Also
    --------
    uw.Scene : A scene made in Python.
    uw.Scene.with_ : Changes settings of a scene that is loaded.
    uw.load_aerial : Reads the scene of a camera in the air.

    Examples
    --------
    >>> uw.load_scene("scene.toml", ["water.type=II"]).water.type
    'II'
    """
    return load_model(Scene, file_path("scene", path), overrides, made="mr360uw new VIDEO MESH")


@checked
def scene_from_dict(data: dict[str, Any], folder: Path, where: str = "scene", lines: Lines | None = None) -> Scene:
    """Return the scene of nested dictionaries as a TOML file gives them; raise `SceneError` with every problem."""
    return model_from_dict(Scene, data, folder, where, lines)


@functools.cache
def _default_tables() -> dict[str, Any]:
    """Return the default of every table of a scene, frozen as they are."""
    return {name: field.get_default(call_default_factory=True) for name, field in Scene.model_fields.items()}


def at_scale(scene: Scene, scale: float | None) -> Scene:
    """Return a scene that works on frames of `scale` times its plate's size; itself for None."""
    if scale is None:
        return scene
    return scene.model_copy(update={"plate": scene.plate.model_copy(update={"scale": scale})})


def files_of(scene: Parameters) -> list[Path]:
    """Return every file and pattern of files that a scene names."""
    return [file for _, file in named_files(scene)]
