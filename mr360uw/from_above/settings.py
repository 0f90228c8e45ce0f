# SPDX-License-Identifier: Apache-2.0
"""The scene of a picture from above: camera in the air, sky, sun, sea, water, floor.

World: +y up, its origin on the mean surface, forward = -z, right = +x.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, ConfigDict, Field, field_validator, model_validator

from mr360uw.base.color import Transfer
from mr360uw.base.constants import SUN_HALF_ANGLE_RAD
from mr360uw.base.parameters import Parameters, checked, parameter
from mr360uw.caustics import CausticSettings, SpectralSea
from mr360uw.caustics.settings import Sea
from mr360uw.composite.settings import ObjectSettings
from mr360uw.medium.settings import WaterKindSettings
from mr360uw.scene.handbook import parameters_markdown
from mr360uw.scene.toml_model import load_model
from mr360uw.video.clip import EncodeSettings

Vector = tuple[float, float, float]
Positive = Annotated[float, Field(ge=0.0, le=1e6)]
Light = tuple[Positive, Positive, Positive]
Fraction = Annotated[float, Field(ge=0.0, le=1.0)]

_SEA: dict[str, Any] = {
    "model": "spectral", "spectrum": "phillips", "tile_m": 20.0, "resolution": 256, "shortest_wavelength_m": 0.25
}  # fmt: skip


def _spectral_by_default(value: Any) -> Any:
    """Return the table of a sea with what it leaves out of a spectral one."""
    if isinstance(value, dict) and value.get("model", "spectral") == "spectral":
        return _SEA | value
    return value


class AerialPlateSettings(Parameters):
    """Pictures or a video from the air that the objects are put into, instead of a picture of the scene's sea."""

    path: Path = parameter(..., "video, numbered pictures (drone_%04d.png) or a still; gives size and frame rate")
    transfer: Transfer | None = parameter(None, "curve from code values to linear light; none: as the file is tagged")
    match: bool = parameter(True, "whether the scene's light is scaled so that its own sea has the plate's colour")
    grain: float = parameter(1.0, "amount of the plate's grain on the objects", unit="1", low=0.0, high=4.0)


class AerialCameraSettings(Parameters):
    """The camera: its place, direction, lens and picture."""

    position_m: Vector = parameter(
        (0.0, 12.0, 0.0), "(right, up, back) at time 0; up = height over the mean surface", unit="m"
    )
    yaw_deg: float = parameter(0.0, "azimuth at time 0, 0 = ahead, + = right", unit="deg", low=-360.0, high=360.0)
    pitch_deg: float = parameter(-55.0, "-90 = straight down", unit="deg", low=-90.0, high=90.0)
    roll_deg: float = parameter(0.0, "+ = right side down", unit="deg", low=-180.0, high=180.0)
    projection: Literal["perspective", "orthographic", "equirectangular"] = parameter(
        "perspective", "lens; orthographic: parallel rays; equirectangular: all round"
    )
    fov_deg: float = parameter(60.0, "for perspective: from edge to edge, across", unit="deg", low=0.1, high=160.0)
    width_m: float = parameter(20.0, "for orthographic: width in the world", unit="m", above=0.0, high=1e5)
    width: int = parameter(1280, "columns of the picture", unit="px", low=1, high=16384)
    height: int = parameter(720, "rows of the picture; half of width for equirectangular", unit="px", low=1, high=16384)
    velocity_m_s: Vector = parameter((0.0, 0.0, 0.0), "motion of the camera (right, up, back)", unit="m/s")
    turn_deg_s: float = parameter(0.0, "change of the azimuth", unit="deg/s", low=-3600.0, high=3600.0)
    exposure: float = parameter(
        2.0, "factor on the picture; at 1 a level white card on the shore is just not clipped", unit="1", above=0.0,
        high=1e6,
    )  # fmt: skip

    @field_validator("position_m")
    @classmethod
    def _in_the_air(cls, position: Vector) -> Vector:
        if position[1] <= 0.0:
            raise ValueError(f"must be over the water (got height {position[1]:g} m) - raise it")
        return position

    @model_validator(mode="after")
    def _check(self) -> AerialCameraSettings:
        if self.projection == "equirectangular" and self.width != 2 * self.height:
            raise ValueError(
                f"width, height - equirectangular is twice as wide as high (got {self.width}x{self.height}) - "
                f"take {2 * self.height}x{self.height}"
            )
        return self


class AerialSunSettings(Parameters):
    """The sun, as seen in the air."""

    elevation_deg: float = parameter(55.0, "over the horizon", unit="deg", low=0.0, high=90.0)
    azimuth_deg: float = parameter(150.0, "0 = ahead (-z), 90 = right (+x)", unit="deg", low=-360.0, high=360.0)
    irradiance: Light | None = parameter(
        None, "on a plane across its beam, linear RGB; none: 1 under a clear sky, else no sun", unit="1"
    )
    half_angle_rad: float = parameter(SUN_HALF_ANGLE_RAD, "angular radius of its disc", unit="rad", above=0.0, high=0.5)


class SkySettings(Parameters):
    """The dome of the sky."""

    kind: Literal["clear", "overcast", "map"] = parameter("clear", "CIE standard sky 12 or 1, or a map of radiance")
    map: Path | None = parameter(
        None, "for kind map: equirectangular picture (.hdr, .exr; others are read as sRGB), its middle ahead"
    )
    irradiance: float | None = parameter(
        None, "on level ground, mean of the colours; none: 0.2 clear, 0.5 overcast, a map's own", unit="1", low=0.0,
        high=1e6,
    )  # fmt: skip
    turn_deg: float = parameter(0.0, "for kind map: turn to the right", unit="deg", low=-360.0, high=360.0)

    @model_validator(mode="after")
    def _check(self) -> SkySettings:
        if self.kind == "map" and self.map is None:
            raise ValueError("map - kind map needs a picture (got none) - name it")
        return self


class AerialFloorSettings(Parameters):
    """The sea floor."""

    depth_m: float = parameter(
        4.0, "depth below the mean surface, for the waves' dispersion too unless sea.water_depth_m is set", unit="m",
        above=0.0, high=1000.0,
    )  # fmt: skip
    albedo: float | Vector = parameter(
        0.35, "mean reflectance of even ground and of sand; factor on a picture's", unit="1"
    )
    ground: Literal["sand", "even", "picture"] = parameter("sand", "rippled sand, one colour, or a picture")
    picture: Path | None = parameter(None, "for ground picture: its albedo, read as sRGB; repeats")
    tile_m: float = parameter(12.0, "side of the square after which the ground repeats", unit="m", above=0.0, high=1e4)
    relief: Path | None = parameter(None, "a square picture of heights over depth_m, which repeats; none: level")
    relief_m: float = parameter(1.0, "height of white over black of that picture", unit="m", low=0.0, high=1000.0)
    relief_tile_m: float = parameter(20.0, "side of that picture's square", unit="m", above=0.0, high=1e4)

    @field_validator("albedo")
    @classmethod
    def _fractions(cls, albedo: float | Vector) -> float | Vector:
        parts = albedo if isinstance(albedo, tuple) else (albedo,)
        if not all(0.0 <= part <= 1.0 for part in parts):
            raise ValueError(f"must lie in [0, 1] (got {albedo}) - ground sends back no more than it gets")
        return albedo

    @model_validator(mode="after")
    def _check(self) -> AerialFloorSettings:
        if self.relief is not None and self.relief_m >= self.depth_m:
            raise ValueError(f"relief_m - reaches the surface (got {self.relief_m:g} of {self.depth_m:g} m) - lower it")
        if self.ground == "picture" and self.picture is None:
            raise ValueError("picture - ground picture needs a file (got none) - name it")
        return self


class AerialWaterSettings(WaterKindSettings):
    """The water, and how it changes what is seen through it."""

    mode: Literal["table", "kd", "koschmieder", "blended"] = parameter(
        "table", "solved light field; closed form; one attenuation and one colour; floor's albedo mixed with a colour"
    )
    attenuation_per_m: Light | None = parameter(
        None, "for koschmieder: beta; none: the water's beam attenuation c at 650, 550, 450 nm", unit="1/m"
    )
    far_radiance: Light | None = parameter(
        None, "for koschmieder: colour of endless water per unit irradiance below the surface; none: of deep water "
        "seen from above", unit="1/sr",
    )  # fmt: skip
    blend_per_m: Light | None = parameter(
        None, "for blended: k of exp(-k depth), the part of the floor's own albedo; none: twice the water's Kd",
        unit="1/m",
    )  # fmt: skip
    blend_color: tuple[Fraction, Fraction, Fraction] | None = parameter(
        None, "for blended: albedo that deep floors take on; none: reflectance of deep water", unit="1"
    )


class ReflectionSettings(Parameters):
    """What the surface mirrors."""

    sun: Literal["slopes", "thresholded"] = parameter(
        "slopes", "glitter by the slopes of all waves (Cox & Munk); thresholded: a published look, not physical"
    )
    threshold_deg: float = parameter(
        4.0,
        "for thresholded: angle from the sun within which a mirrored ray shows it",
        unit="deg",
        above=0.0,
        high=90.0,
    )
    gain: float = parameter(
        2.0, "for thresholded: radiance of that reflection over the sun's irradiance", unit="1/sr", low=0.0, high=1e6
    )


class FilmSettings(Parameters):
    """Length and rate of a film, and rays of a pixel."""

    duration_s: float = parameter(4.0, "length of a film", unit="s", above=0.0, high=1e5)
    frame_rate: float = parameter(24.0, "frames a second", unit="1/s", above=0.0, high=1000.0)
    samples: int = parameter(2, "rays of a pixel along each axis", low=1, high=32)


class AerialScene(Parameters):
    """A picture from above."""

    model_config = ConfigDict(populate_by_name=True)

    plate: AerialPlateSettings | None = parameter(None, "a picture or video to work on; none: the scene's sea")
    camera: AerialCameraSettings = parameter(AerialCameraSettings(), "the camera in the air")
    sun: AerialSunSettings = parameter(AerialSunSettings(), "the sun")
    sky: SkySettings = parameter(SkySettings(), "the sky")
    sea: Annotated[Sea, BeforeValidator(_spectral_by_default)] = parameter(
        SpectralSea(**_SEA), "the water surface, spectral by default"
    )
    caustics: CausticSettings = parameter(CausticSettings(size=1024), "light focused on the floor")
    water: AerialWaterSettings = parameter(AerialWaterSettings(), "the water over the floor")
    floor: AerialFloorSettings = parameter(AerialFloorSettings(), "the sea floor")
    reflection: ReflectionSettings = parameter(ReflectionSettings(), "what the surface mirrors")
    objects: tuple[ObjectSettings, ...] = parameter(
        (), "bodies in the water and at its surface; positions from the world's origin", alias="object"
    )
    film: FilmSettings = parameter(FilmSettings(), "length of films and samples of pixels")
    output: EncodeSettings = parameter(EncodeSettings(), "how films are encoded")

    @model_validator(mode="after")
    def _check(self) -> AerialScene:
        if self.plate is not None and not self.objects:
            raise ValueError("plate - nothing is put into it (got no objects) - add [[object]], or remove the plate")
        if self.objects and self.camera.projection == "orthographic":
            raise ValueError(
                "camera.projection - parallel rays show no objects (got 'orthographic') - take perspective, from afar"
            )
        return self


@checked
def load_aerial(path: str | Path, overrides: Sequence[str] = ()) -> AerialScene:
    r"""Return the scene from above of a TOML file; relative paths in it start at its folder.

    Every key has a default, so an empty file is a scene. Positions start on the mean surface, not at the camera as in a
    composite.

    Parameters
    ----------
    path : str or Path
        The scene file.
    overrides : sequence of str
        Settings as 'table.key=value', as in 'sea.wind_speed=8'.

    Returns
    -------
    AerialScene
        The scene, checked.

    Raises
    ------
    SceneError
        With one line for each problem: *file:line key - what is wrong (got ...) - what to do*.

    See Also
    --------
    uw.aerial : Makes a picture of it.
    uw.AerialScene : A scene made in Python.
    uw.load_scene : Reads the scene of a composite.

    Examples
    --------
    >>> with open("above.toml", "w", encoding="utf-8") as file:
    ...     _ = file.write("[sea]\nwind_speed = 6.0\n")
    >>> uw.load_aerial("above.toml").sea.wind_speed
    6.0
    """
    return load_model(AerialScene, path, overrides)


def aerial_handbook() -> str:
    """Return the page docs/aerial-parameters.md."""
    title, command = "Parameters of a picture from above", "mr360uw schema --aerial --markdown"
    return parameters_markdown(AerialScene, title, command)
