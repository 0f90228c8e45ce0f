# SPDX-License-Identifier: Apache-2.0
"""Light of a plate's frame: small levelled maps of it, and environment and sun by the `[light]` settings of its scene.

Under water, what clipped pixels of the sky or a clipped sun lost is restored from the solved field (`restored`), in
each channel:

    A' + S' = E        A'/A = S'/S = E/(A + S), but A' >= A

A, S: horizontal irradiance at the camera of ambient light and of the sun; E: that which open water at the horizon and
the light from below tell, neither of which clips (`fit.level_light`). What A lacks is put into clipped pixels, as far
as there are any, or else into the whole sky; what did not clip stays.

Ground sends back no more light than falls on it (`lit_as_its_ground`): where clipping, tone mapping or a white balance
took more of the sky than that, it is given back, in each channel:

    A' + S' >= B/r

B: horizontal irradiance from below; r: the greatest albedo of ground.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.base.cache import shared
from mr360uw.base.color import luminance
from mr360uw.base.constants import ENVIRONMENT_COLUMNS, ENVIRONMENT_ROWS, MINIMUM_SUN_UP
from mr360uw.base.sphere import direction_from_frame, directions, frame_from_direction
from mr360uw.caustics import refract_to_water
from mr360uw.ibl import LightSettings
from mr360uw.ibl.filters import cosine_filter, glossy_levels
from mr360uw.ibl.lighting import light_of, plate_of_yuv, sunlit
from mr360uw.ibl.lookup import environment_lookup, reduce_map
from mr360uw.ibl.plate import (
    COARSE_COLUMNS,
    COARSE_ROWS,
    DISPLAY_WHITE,
    FILL_FROM,
    LinearPlate,
    Plate,
    checked_plate,
    coarse_directions,
    remap,
    unclipped,
)
from mr360uw.ibl.sun.detect import sun_found
from mr360uw.ibl.sun.split import CLEAR_SKY, CLEAR_SKY_DIRECT, beam_below, direct_share
from mr360uw.ibl.tilt import is_level, level_matrix, roll_pitch, upward
from mr360uw.medium import Medium
from mr360uw.medium.lookup import ambient_ratio, beam_fraction, beam_ratio
from mr360uw.medium.scattered_light import irradiance_from_level, light_below_horizon
from mr360uw.medium.veil_gain import BAND_RAD, SECTORS, LevelView
from mr360uw.scene.model import Scene
from mr360uw.types import Environment, Floats, MediumTable, Sun, YuvImage

# A plate without expansion, small and levelled, to which the colour of its water is fitted: a map, and its horizon.

_SAMPLES = (6, 12)
"""Rows above and below the horizon, and columns of each azimuth, at which a plate's horizon is read."""
_FINER = 8
"""Planes are averaged as code values to cells this many times finer than the map, before they are decoded to light."""


def plate_map(plate: Floats | YuvImage, up: ArrayLike | None = None) -> Floats:
    """Return the (32, 64, 3) means of a linear plate (H, W, 3) or of decoded planes over exact solid angles.

    Codes outside the gamut (deep blue water in red) give negative light; means are clipped at 0. up: direction (3,) of
    the world's up in the plate's axes; the map is levelled and its heading kept.
    """
    fine, up = small_picture(plate), upward(up)
    if not is_level(up):
        fine = reduce_map(fine, COARSE_COLUMNS, COARSE_ROWS)
        seen = coarse_directions() @ level_matrix(*map(float, roll_pitch(up)))
        fine = remap(fine, *frame_from_direction(seen, COARSE_COLUMNS, COARSE_ROWS))
    return np.maximum(reduce_map(fine, ENVIRONMENT_COLUMNS, ENVIRONMENT_ROWS), 0.0)


def world_view(plate: Floats | YuvImage, world_from_camera: Floats) -> Floats:
    """Return the light (h, w, 3) of a linear plate or of decoded planes, at most 512 x 256, in the world's axes, with
    its clipped channels filled.
    """
    import cv2

    fine = np.ascontiguousarray(small_picture(plate))
    growth = _growth(plate, fine)
    if np.any(growth > 1.0):
        fine = fine * cv2.resize(growth, fine.shape[1::-1], interpolation=cv2.INTER_LINEAR)
    if not np.allclose(world_from_camera, np.eye(3), atol=1e-9):
        height, width = fine.shape[:2]
        fine = remap(fine, *frame_from_direction(directions(width, height) @ world_from_camera, width, height))
    return fine


def level_view(plate: Floats | YuvImage, up: ArrayLike | None = None) -> LevelView:
    """Return the light of a linear plate (H, W, 3) or of decoded planes just above and below the horizon.

    Pixels are read at full resolution, up to `_SAMPLES` an azimuth, and clipped channels are filled. up: as for
    `plate_map`.
    """
    height, width = (plate.y if isinstance(plate, YuvImage) else plate).shape[:2]
    column, row = _places(width, height, upward(up).tobytes())
    rows, columns = _SAMPLES
    light = _pixels(plate, row, column)
    if np.any(light > FILL_FROM):
        light = (
            light * _growth(plate, small_picture(plate))[row * COARSE_ROWS // height, column * COARSE_COLUMNS // width]
        )
    light = light.reshape(2, rows, SECTORS, columns, 3).mean(axis=(1, 3))
    half = float(np.sin(0.5 * _reach(height)))
    return np.array([half, -half]), light


def _growth(plate: Floats | YuvImage, fine: Floats) -> NDArray[np.float32]:
    """Return the factors (128, 256, 3) by which a plate's clipped channels lost light, see `unclipped`; 1 elsewhere.

    fine: its `small_picture`.
    """
    shown = np.maximum(reduce_map(fine, COARSE_COLUMNS, COARSE_ROWS), _LEAST_LIGHT)
    wide = plate.spec.is_wide if isinstance(plate, YuvImage) else float(np.max(plate)) > DISPLAY_WHITE
    return np.asarray(np.ones_like(shown) if wide else unclipped(shown) / shown, np.float32)


def _reach(height: int) -> float:
    """Return the half height [rad] of the band about the horizon that is read of a frame: one row at least."""
    return float(max(BAND_RAD, np.pi / height))


@shared(keep=2)
def _places(width: int, height: int, up: bytes) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the columns and rows (2 `_SAMPLES[0]`, n) of the pixels about the horizon. up: of `upward`, float64."""
    rows, columns = _SAMPLES
    elevation = _reach(height) * (1.0 - (np.arange(2 * rows) + 0.5) / rows)
    turn = (np.arange(SECTORS * columns) + 0.5) / (SECTORS * columns)
    level = direction_from_frame(turn[None, :], 0.5 - elevation[:, None] / np.pi, 1, 1)
    seen = level @ level_matrix(*map(float, roll_pitch(np.frombuffer(up))))
    x, y = frame_from_direction(seen, width, height)
    return x.astype(np.int64) % width, np.clip(y.astype(np.int64), 0, height - 1)


def _pixels(plate: Floats | YuvImage, row: NDArray[np.int64], column: NDArray[np.int64]) -> Floats:
    """Return the linear light (h, w, 3) of pixels, not clipped."""
    if not isinstance(plate, YuvImage):
        return np.asarray(plate[row, column], np.float64)
    from mr360uw.yuv.decoding import linear_from_planes

    ratio = [-(-a // b) for a, b in zip(plate.y.shape, plate.u.shape, strict=True)]
    coarse = row // ratio[0], column // ratio[1]
    picked = YuvImage(plate.y[row, column], plate.u[coarse], plate.v[coarse], plate.spec)
    return linear_from_planes(picked, wrap=False)


def small_picture(plate: Floats | YuvImage) -> Floats:
    """Return the light of decoded planes, at most 512 x 256; of a linear plate itself."""
    if not isinstance(plate, YuvImage):
        return np.asarray(plate, np.float32)
    import cv2

    from mr360uw.yuv.decoding import linear_from_planes

    height, width = plate.y.shape
    size = min(width, _FINER * ENVIRONMENT_COLUMNS), min(height, _FINER * ENVIRONMENT_ROWS)
    fine = (_by_whole_factor(plane, size) for plane in (plate.y, plate.u, plate.v))
    y, u, v = (cv2.resize(plane, size, interpolation=cv2.INTER_AREA) for plane in fine)
    return linear_from_planes(YuvImage(y, u, v, plate.spec))


def _by_whole_factor(plane: NDArray[Any], size: tuple[int, int]) -> NDArray[Any]:
    """Return a plane that is reduced by the largest whole factor that leaves it a size or more: that is fast."""
    import cv2

    height, width = plane.shape
    factors = range(min(width // size[0], height // size[1]), 1, -1)
    factor = next((f for f in factors if width % f == 0 and height % f == 0), 1)
    if factor == 1:
        return plane
    return np.asarray(cv2.resize(plane, (width // factor, height // factor), interpolation=cv2.INTER_AREA))


_TYPICAL_SUN_UP = 0.85
"""Sine of the elevation, in the water, of that sun."""
_SKY_UP = 0.83
"""Sine of elevation in the water of a beam that fades like skylight, the mean of a refracted uniform sky."""
_THIN_POWER = 20.0
"""Power of the fraction of the light at the surface that reaches the camera, by which the sun of the plate counts
against the solved beam: half at a loss of 3.5 %. Twice as large: at 1.7 %. Glitter under water is no glow of the sky.
"""
_LEAST_LIGHT = 1e-30
"""Least light that is divided by."""
_FROM, _TO = 0.8, 0.95
"""Radiance of a pixel of the environment, a mean over hundreds of the plate's, from which it counts as partly and as
wholly clipped. A sky that is as bright without clipping is raised too, as far as the whole light is too weak."""
_MOST = 2.0
"""Greatest ratio of restored to shown light: one stop. A type of water that is not the plate's misleads by no more."""
_LEAST_SUN = 0.5
"""Least ratio of a sun's strength by the whole light to that by its share of it: one stop, as of `_MOST`."""
_GLITTER, _DISC = 0.25, 0.5
"""Light of a sharp spot that is not clipped, over that of the solved beam, up to which it is a glint of the waves and
from which it is the sun's disc: a wave shows a part of the sun that is never steady from frame to frame."""
_LEAST_SHARE = 0.02
"""Fraction of the ambient light that clipped pixels must bring for them to be raised; wholly from twice as much on."""
_GREATEST_ALBEDO = 0.6
"""Albedo of white coral sand; but for fresh snow, 0.9, no ground is brighter."""
_LEAST_DIRECT_SHARE = 1e-6
"""Fraction of the light that is a setting sun's, at least: light is divided by it."""
_LEAST_DIRECT, _MOST_DIRECT = 0.05, 4.0
"""Bounds of the ratio of direct to diffuse irradiance."""


def _clearness(table: MediumTable) -> float:
    """Return how far the plate's own sun counts against the solved beam: 1 without water, 0 under much of it."""
    return float(np.clip(luminance(1.0 / ambient_ratio(table, 0.0)), 0.0, 1.0)) ** _THIN_POWER


class EnvironmentReader:
    """Measures the light of frames by a scene's `[light]` settings. table: of its water, or None. camera_at: position
    and rotation of the camera at a time.

    Suns of the scene and of a track are in world axes; `of` returns its result in camera axes.
    """

    def __init__(
        self, scene: Scene, table: MediumTable | None, camera_at: Callable[[float], tuple[Floats, Floats]]
    ) -> None:
        self._water, self._settings, self._camera_at, self._table = scene.water, scene.light, camera_at, table
        self._clearness, settings = None if table is None else _clearness(table), scene.light
        self._sun: Floats | Literal["detect"] | None = "detect"
        if settings.sun == "none":
            self._sun = None
        elif settings.sun in ("given", "date"):
            self._sun = settings.given_direction
            if self._sun is not None and settings.sun == "date" and table is not None:
                self._sun = refract_to_water(self._sun, scene.water.refractive_index)

    def of(
        self,
        plate: Floats | YuvImage,
        sun: Sun | Literal["scene"] | None = "scene",
        *,
        time_s: float = 0.0,
        glossy: bool = False,
    ) -> Environment:
        """Return the light of a linear plate (H, W, 3) or of decoded planes.

        sun: "scene" takes the scene's own; a smoothed track gives its own, or None. time_s: of the frame, for the
        tilt of the camera.
        """
        world_from_camera = self.world_from_camera(time_s)
        chosen = self._sun if isinstance(sun, str) else sun
        if isinstance(chosen, Sun):
            chosen = replace(chosen, direction=chosen.direction @ world_from_camera)
        elif isinstance(chosen, np.ndarray):
            chosen = chosen @ world_from_camera
        settings, up, index = self._settings, upward(world_from_camera[1]), self._water.refractive_index
        read = (
            plate_of_yuv(plate, settings, up, index)
            if isinstance(plate, YuvImage)
            else LinearPlate(checked_plate(plate), settings, up, index)
        )
        found = light_of(read, settings, chosen, self._table is not None, glossy, self._clearness)
        if found.sun is None or isinstance(chosen, Sun) or self._table is None:
            return found
        lit = self._water_colored(found, found.sun, world_from_camera[1])
        return sunlit(found.residual, found.ambient, found.glossy, found.glossy_roughness, lit, detail=found.detail)

    def _water_colored(self, found: Environment, sun: Sun, up: Floats) -> Sun:
        """Return the sun with the colour of its solved beam in the water; clipped pixels have none of their own.

        The beam is solved as its ratio to the rest of the light, in each channel. The thinner the water, and the more
        the plate shows of the sun, the more the sun as the plate shows it counts (geometric mean): no water is the
        limit of thin water. The strength is that of the mixture where the closure chose it. up: (3,) of the world, in
        the camera's axes.
        """
        assert self._table is not None
        sun_up = max(float(sun.direction @ up), MINIMUM_SUN_UP)
        depth, in_air = self._table.camera_depth_m, _sine_in_air(sun_up, self._water.refractive_index)
        share = self._water.sun_share or max(direct_share(in_air), _LEAST_DIRECT_SHARE)
        direct = beam_below(share, in_air)
        left = beam_fraction(self._table, depth, sun_up)
        beam = direct * left
        white = np.maximum(1.0 / ambient_ratio(self._table, 0.0) - share * left, share * left / _MOST_DIRECT)
        # the rest is blue skylight, and what has left the yellow beam; scattered light divides as the direct light does
        sky = (1.0 - share) * beam_fraction(self._table, depth, _SKY_UP)
        of_sky = np.minimum(sky / np.maximum(sky + share * left, _LEAST_LIGHT) * (white + share * left), white)
        rest = of_sky * CLEAR_SKY + (white - of_sky) * direct / share
        solved = environment_lookup(found.ambient, up) * beam / np.maximum(rest, _LEAST_LIGHT) / sun_up
        if float(luminance(solved)) <= 0.0:
            return sun
        of_beam = float(luminance(sun.irradiance) / luminance(solved))
        sun = replace(sun, shown=sun.shown * float(np.clip((of_beam - _GLITTER) / (_DISC - _GLITTER), 0.0, 1.0)))
        clear = max(self._clearness or 0.0, sun.shown)
        mixed = np.maximum(solved, _LEAST_LIGHT) ** (1.0 - clear) * np.maximum(sun.irradiance, _LEAST_LIGHT) ** clear
        if self._settings.direct_to_diffuse is not None or self._settings.operator != "closure":
            mixed *= luminance(sun.irradiance) / luminance(mixed)
        return replace(sun, irradiance=mixed.astype(np.float32))

    def sun_found(self, plate: Floats | YuvImage, time_s: float) -> tuple[str, str]:
        """Return what is found of a sun in a plate's frame; see `detect.sun_found`."""
        world_from_camera, settings = self.world_from_camera(time_s), self._settings
        options: Any = {"up": world_from_camera[1], "refractive_index": self._water.refractive_index}
        if isinstance(plate, YuvImage):
            seen: Plate = plate_of_yuv(plate, settings, **options)
        else:
            seen = LinearPlate(checked_plate(plate), settings, **options)
        return sun_found(seen, world_from_camera, underwater=self._table is not None)

    def world_from_camera(self, time_s: float) -> Floats:
        """Return the rotation (3, 3) of the camera at `time_s`."""
        return self._camera_at(time_s)[1]

    def sun(self, plate: Floats | YuvImage, time_s: float) -> Sun | None:
        """Return the sun of a plate's frame in world axes; None if there is none."""
        sun = self.of(plate, time_s=time_s).sun
        return None if sun is None else replace(sun, direction=self.world_from_camera(time_s) @ sun.direction)


def _sine_in_air(sine: float, refractive_index: float) -> float:
    """Return the sine of the elevation above a flat surface of light with a sine of elevation below it."""
    along = refractive_index * math.sqrt(max(1.0 - sine * sine, 0.0))
    return math.sqrt(max(1.0 - along * along, 0.0))


def direct_to_diffuse(table: MediumTable) -> float:
    """Return the ratio of direct to diffuse horizontal irradiance at the camera, for a clear sky above this water.

    The beam fades faster than all light; what is scattered out of it forwards becomes diffuse.
    """
    direct = CLEAR_SKY_DIRECT * float(luminance(1.0 / beam_ratio(table, 0.0, _TYPICAL_SUN_UP)))
    diffuse = float(luminance(1.0 / ambient_ratio(table, 0.0))) - direct
    return float(np.clip(direct / max(diffuse, 1e-6), _LEAST_DIRECT, _MOST_DIRECT))


def may_be_clipped(pixels: Floats | YuvImage, settings: LightSettings) -> bool:
    """Return whether a plate ends at display white, so that its light may be more than it shows."""
    if settings.operator != "closure":
        return False
    return isinstance(pixels, YuvImage) or float(pixels.max()) <= DISPLAY_WHITE


def restored(light: Environment, medium: Medium, up: Floats, *, keep_sun: bool) -> Environment:
    """Return the light of a clipped plate with what its clipped pixels lost.

    medium: of the camera, with the gain of the plate's veil; of mode "table" or "plate", others have no solved
    irradiance and change nothing. up: (3,) of the world in the environment's axes. keep_sun: whether the sun's strength
    is known; otherwise it gets what the ambient light leaves of the whole.
    """
    if medium.mode not in ("table", "plate"):
        return light
    sun_up = None if light.sun is None else max(float(light.sun.direction @ up), MINIMUM_SUN_UP)
    direct = np.zeros(3)
    if isinstance(medium.sky, tuple):
        sun_up = medium.sky[1]
    if sun_up is not None:  # the sky is bluer than the beam
        in_air = _sine_in_air(sun_up, medium.refractive_index)
        of_sun = medium.sky[2] if isinstance(medium.sky, tuple) else max(direct_share(in_air), _LEAST_DIRECT_SHARE)
        beam_part = beam_below(of_sun, in_air)
        direct = np.asarray(beam_part / (beam_part + (1.0 - of_sun) * CLEAR_SKY))
    shown = np.maximum(environment_lookup(light.ambient, up), 1e-12)
    above = (directions(*light.residual.shape[1::-1]) @ up > 0.0)[..., None]
    white = np.clip((light.residual - _FROM) / (_TO - _FROM), 0.0, 1.0) * light.residual * above
    of_white = cosine_filter(1)(white)
    share = environment_lookup(of_white, up) / shown
    by_share = np.clip(share / _LEAST_SHARE - 1.0, 0.0, 1.0)
    by_sun = 0.0
    if light.sun is not None:
        by_sun = (1.0 - light.sun.shown) * light.sun.confidence
    # thin water has little light of its own to tell
    told = np.maximum(by_share, by_sun) * (1.0 - _clearness(medium.unit_table))
    if not np.any(told > 0.0):
        return light
    whole = irradiance_from_level(medium, sun_up, direct, light_below_horizon(light.residual, up))
    beam = np.zeros(3) if light.sun is None else light.sun.irradiance * max(float(light.sun.direction @ up), 0.0)
    wanted = whole - beam if keep_sun else shown * whole / (shown + beam)
    growth = told * (np.clip(wanted / shown, 1.0, _MOST) - 1.0)
    # what is missing lies in clipped pixels, or else in the whole sky about a clipped sun
    sky = light.residual * above
    of_sky = cosine_filter(1)(sky)
    in_white = growth * by_share / np.maximum(share, _LEAST_SHARE)
    in_sky = growth * (1.0 - by_share) * shown / np.maximum(environment_lookup(of_sky, up), _LEAST_LIGHT)
    stronger = np.ones(3)
    if light.sun is not None and not keep_sun:
        left = np.clip((whole - shown * (1.0 + growth)) / np.maximum(beam, 1e-12), _LEAST_SUN, _MOST)
        stronger += told.max() * (left - 1.0)
    if not np.any(growth > 0.0) and np.all(stronger == 1.0):
        return light
    return _brighter(light, in_white * white + in_sky * sky, in_white * of_white + in_sky * of_sky, stronger)


def lit_as_its_ground(light: Environment, up: Floats) -> Environment:
    """Return the light of a plate with as much from above as its ground must have; see the module's text.

    Of what is missing the sun gets the sine of its elevation, for a picture loses most of a high sun, and the sky gets
    the rest. up: (3,) of the world in the environment's axes.
    """
    sun_up = 0.0 if light.sun is None else max(float(light.sun.direction @ up), 0.0)
    beam = np.zeros(3) if light.sun is None else light.sun.irradiance
    shown, below = (environment_lookup(light.ambient, way).astype(np.float64) for way in (up, -up))
    missing = np.maximum(below / _GREATEST_ALBEDO - shown - sun_up * beam, 0.0)
    if not np.any(missing > 0.0):
        return light
    above = directions(*light.residual.shape[1::-1]) @ up > 0.0
    sky = np.repeat((luminance(light.residual) * above)[..., None], 3, axis=-1)
    received = cosine_filter(1)(sky)
    growth = (1.0 - sun_up) * missing / np.maximum(environment_lookup(received, up), _LEAST_LIGHT)
    return _brighter(light, growth * sky, growth * received, 1.0 + missing / np.maximum(beam, _LEAST_LIGHT))


def _brighter(light: Environment, radiance: Floats, irradiance: Floats, of_sun: Floats) -> Environment:
    """Return an environment with more radiance (32, 64, 3), whose cosine integral is given, and a stronger sun."""
    sun: Sun | None = None
    if light.sun is not None:
        sun = replace(light.sun, irradiance=(light.sun.irradiance * of_sun).astype(np.float32))
    residual = (light.residual + radiance).astype(np.float32)
    ambient = (light.ambient + irradiance).astype(np.float32)
    roughness = tuple(float(r) for r in light.glossy_roughness)
    glossy = light.glossy + glossy_levels(radiance, roughness) if len(light.glossy) else light.glossy
    return sunlit(residual, ambient, glossy, light.glossy_roughness, sun, detail=light.detail)
