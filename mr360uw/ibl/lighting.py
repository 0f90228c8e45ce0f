# SPDX-License-Identifier: Apache-2.0
"""Environment maps of a plate: radiance, irradiance, glossy levels, and the same without the sun."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.constants import ENVIRONMENT_COLUMNS, ENVIRONMENT_ROWS, REFRACTIVE_INDEX_SEA
from mr360uw.errors import ParameterError
from mr360uw.ibl.filters import cosine_beam, cosine_filter, glossy_levels
from mr360uw.ibl.lookup import environment_lookup, reduce_map
from mr360uw.ibl.plate import COARSE_COLUMNS, COARSE_ROWS, COARSE_SCALE, LinearPlate, Plate, checked_plate
from mr360uw.ibl.settings import GLOSSY_ROUGHNESS, LightSettings, Operator
from mr360uw.ibl.sun.detect import (
    find_disc,
    is_disc,
    lost_light,
    shows_disc,
    split_disc,
    split_given,
    split_known,
    spot_towards,
)
from mr360uw.ibl.sun.judge import taken_share
from mr360uw.ibl.sun.split import UNKNOWN_RATIO, Split, close, with_sun, without_glare
from mr360uw.ibl.tilt import level_matrix, roll_pitch, upward
from mr360uw.shapes import checked, exactly
from mr360uw.sphere import directions, unit
from mr360uw.types import Environment, Floats, Sun

SunChoice = Sun | Literal["detect"] | NDArray[np.floating[Any]] | None


@checked
def environment(
    plate: ArrayLike,
    settings: LightSettings | None = None,
    *,
    expansion: Operator | None = None,
    sun: SunChoice = "detect",
    underwater: bool = False,
    glossy: bool = False,
    up: ArrayLike | None = None,
    refractive_index: float = REFRACTIVE_INDEX_SEA,
    clearness: float | None = None,
) -> Environment:
    """Return the light of a linear plate as small maps, its sun apart.

    A clipped sun gets the strength and colour of sunlight in air, without the losses of the water above.

    Parameters
    ----------
    plate : array_like
        Equirectangular picture (H, W, 3) of linear light, of any size; white is 1.
    settings : LightSettings, optional
        How the plate is expanded to scene radiance, and where its sun is.
    expansion : str, optional
        Operator instead of that of the settings; "none" says that the plate is scene radiance already.
    sun : Sun or "detect" or array_like or None
        By default "detect" follows `settings.sun`: the sun is detected, inside Snell's window if `underwater`, and left
        in the sky as far as the confidence is low. A direction (3,) as seen by the camera measures the light there; a
        `Sun` replaces the light there; None leaves all light in the sky.
    underwater : bool
        Whether the camera is under water.
    glossy : bool
        Also filter the residual at the roughnesses of the settings.
    up : array_like, optional
        Direction (3,) of the world's up in the frame's axes; by default the frame is level. The result is in the
        frame's axes for any `up`.
    refractive_index : float
        Index of the water, 1 to 4, which sets the width of Snell's window and of the sun's disc.
    clearness : float, optional
        Of the water above the camera, from 0 to 1, which is none: how far sun and sky are told apart as in air. Without
        it, under water, they are taken to be equally strong.

    Returns
    -------
    Environment
        Radiance, irradiance and the sun; `residual` and `ambient` lack the sun.

    Raises
    ------
    ParameterError
        If an array is no plate, or no direction.

    See Also
    --------
    uw.ibl.detect_sun : The sun alone, as bright as the plate shows it.
    uw.ibl.environment_from_yuv : The same from the decoded planes of a video frame.
    uw.medium.fit_water : Finds the type of water that fits the light.

    Examples
    --------
    >>> light = uw.ibl.environment(plate, underwater=True)
    >>> light.irradiance.shape
    (32, 64, 3)
    >>> uw.ibl.environment(plate, sun=None).sun is None
    True
    """
    settings = settings or LightSettings()
    if expansion is not None:
        settings = LightSettings(**{**settings.model_dump(), "operator": expansion})
    linear = LinearPlate(checked_plate(plate), settings, upward(up), refractive_index)
    return light_of(linear, settings, sun, underwater, glossy, clearness)


def light_of(
    plate: Plate,
    settings: LightSettings,
    sun: SunChoice = "detect",
    underwater: bool = False,
    glossy: bool = False,
    clearness: float | None = None,
) -> Environment:
    """Return the light of a plate of any storage; see `environment`."""
    split = _split(plate, settings, sun, underwater, clearness)
    roughness = GLOSSY_ROUGHNESS if glossy else ()
    return assemble(plate.coarse, None, roughness) if split is None else assemble(split.residual, split.sun, roughness)


def _split(
    plate: Plate, settings: LightSettings, sun: SunChoice, underwater: bool, clearness: float | None
) -> Split | None:
    ratio = settings.direct_to_diffuse
    if ratio is None and underwater and clearness is None:
        ratio = UNKNOWN_RATIO
    glare = 1.0 - (clearness or 0.0) if underwater else 0.0
    if isinstance(sun, str):
        if sun != "detect":
            raise ParameterError(f"sun - unknown (got {sun!r:.40}) - take 'detect', a direction, a Sun or None")
        if settings.sun == "none":
            return None
        if settings.sun == "date" and underwater:
            raise ParameterError(
                'sun - "date" is a place in the air (got a plate under water) - refract it, pass it as sun'
            )
        direction = settings.given_direction
        if direction is None:
            return _detected(plate, settings, underwater, ratio, glare)
        sun = direction @ level_matrix(*map(float, roll_pitch(plate.up)))  # given in level axes of the same heading
    if sun is None:
        return None
    if isinstance(sun, Sun):
        lost = settings.operator == "closure" and lost_light(plate, sun.direction)
        known = replace(sun, shown=0.0) if lost else sun
        split = without_glare(split_known(plate, sun), plate, glare).shared(sun.share, plate.coarse)
        return replace(split, sun=known)
    split = split_given(plate, unit(exactly("sun", sun, (3,))), underwater=underwater)
    split = without_glare(split, plate, glare)
    lost = settings.operator == "closure" and lost_light(plate, split.sun.direction)
    return close(split, plate, ratio, disc=shows_disc(spot_towards(plate, split.sun.direction))) if lost else split


def _detected(
    plate: Plate, settings: LightSettings, underwater: bool, ratio: float | None, glare: float
) -> Split | None:
    disc = find_disc(plate, underwater=underwater)
    share = 0.0 if disc is None else taken_share(disc.confidence)
    if disc is None or share == 0.0:
        return None
    split = without_glare(split_disc(plate, disc, underwater=underwater), plate, glare)
    if settings.operator == "closure":
        if lost_light(plate, disc.blob.direction, disc.blob):
            split = close(split, plate, ratio, disc=shows_disc(disc.blob))
        else:  # what is no sharp disc has light of the sky in it, and of the glitter only a part
            split = replace(split, sun=replace(split.sun, shown=float(is_disc(disc.blob))))
    return split.shared(share, plate.coarse)


def assemble(coarse: Floats, sun: Sun | None, roughness: tuple[float, ...] = ()) -> Environment:
    """Return the environment of a coarse map (128, 256, 3) without the sun, and of the sun."""
    ambient = cosine_filter(COARSE_SCALE)(coarse)
    residual = reduce_map(coarse, ENVIRONMENT_COLUMNS, ENVIRONMENT_ROWS)
    return sunlit(
        residual, ambient, glossy_levels(coarse, roughness), np.asarray(roughness, np.float32), sun, detail=coarse
    )


def sunlit(
    residual: Floats, ambient: Floats, glossy: Floats, roughness: Floats, sun: Sun | None,
    *, detail: Floats | None = None,
) -> Environment:  # fmt: skip
    """Return the environment of maps that lack the sun, and of the sun; symbols as of `Environment`."""
    radiance, irradiance = residual, ambient
    if sun is not None:
        radiance, irradiance = with_sun(residual, sun), ambient + cosine_beam(sun.direction, sun.irradiance)
    return Environment(radiance, irradiance, sun, residual, ambient, glossy, roughness, detail)


def light_between(before: Environment, after: Environment, share: float, sun: Sun | None) -> Environment:
    """Return the light of an instant between two, whose maps are interpolated linearly.

    share: 0 at `before`, 1 at `after`. sun: of the instant, in the axes of the maps.
    """

    def mixed(a: Floats, b: Floats) -> Floats:
        return ((1.0 - share) * a + share * b).astype(np.float32)

    residual, ambient, glossy = (
        mixed(getattr(before, name), getattr(after, name)) for name in ("residual", "ambient", "glossy")
    )
    detail = None if before.detail is None or after.detail is None else mixed(before.detail, after.detail)
    return sunlit(residual, ambient, glossy, before.glossy_roughness, sun, detail=detail)


def sun_between(before: Sun, after: Sun, share: float) -> Sun:
    """Return the sun of an instant between two, every value of which is interpolated linearly. share: 0 at `before`."""
    direction, irradiance, half_angle_rad, confidence = (
        (1.0 - share) * np.asarray(getattr(before, name), np.float64)
        + share * np.asarray(getattr(after, name), np.float64)
        for name in ("direction", "irradiance", "half_angle_rad", "confidence")
    )
    return Sun(unit(direction), irradiance.astype(np.float32), float(half_angle_rad), float(confidence))


def turned(light: Environment, world_from_camera: Floats) -> Environment:
    """Return the light that a camera saw, in the axes of the world."""
    if np.array_equal(world_from_camera, np.eye(3)):
        return light
    seen = directions(ENVIRONMENT_COLUMNS, ENVIRONMENT_ROWS) @ world_from_camera
    maps: dict[str, Any] = {
        name: environment_lookup(getattr(light, name), seen).astype(np.float32)
        for name in ("radiance", "residual", "ambient")
    }
    if len(light.glossy):
        maps["glossy"] = np.array([environment_lookup(level, seen) for level in light.glossy], np.float32)
    if light.detail is not None:
        finer = directions(COARSE_COLUMNS, COARSE_ROWS) @ world_from_camera
        maps["detail"] = environment_lookup(light.detail, finer).astype(np.float32)
    sun = None if light.sun is None else replace(light.sun, direction=world_from_camera @ light.sun.direction)
    lit = maps["ambient"] if sun is None else maps["ambient"] + cosine_beam(sun.direction, sun.irradiance)
    return replace(light, irradiance=lit, sun=sun, **maps)
