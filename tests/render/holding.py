# SPDX-License-Identifier: Apache-2.0
"""The holding test: a card of the sand's own albedo that lies on the sand of a dive vanishes.

The dive is made by its own solved light, written as 8-bit video and composited like any other: the light is read from
the plate, carried down to the sand by the water, and must come out as bright as the sand that is there. The scene is
told the type of the water, the depths and the waves; the sun is found in the plate, or told.

Video cannot show it better than its codes do: an encoder may move Y', Cb and Cr of an even area by half a code.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.color import decode, encode, rgb_from_ycbcr
from mr360uw.base.optics import refract_to_water
from mr360uw.base.sphere import directions, row_solid_angle
from mr360uw.render.first_pass import first_pass
from mr360uw.render.frame import composite_frame, make_backend
from mr360uw.render.loaded import load
from mr360uw.sample.dive import dive_scene, record
from mr360uw.sample.dive_settings import DiveSettings
from mr360uw.sample.rendered_dive import Dive
from mr360uw.scene import scene_from_dict
from mr360uw.types import Floats
from mr360uw.video import open_video

HALF_SIDE_M = 1.0
"""The card is 2 m wide, below the camera: over caustics and ripples of a few decimetres."""
LIFTED_M = 2e-3
OBJ = "v -1 0 -1\nv 1 0 -1\nv 1 0 1\nv -1 0 1\nvn 0 1 0\nf 1//1 3//1 2//1\nf 1//1 4//1 3//1\n"
FRAME_RATE = 6


HALF_CODE = np.abs(rgb_from_ycbcr("bt709")) @ (0.5 / np.array([219.0, 224.0, 224.0]))
"""Largest change (3,) of R', G', B' where each of Y', Cb, Cr of limited range is half a code off."""
DARK = 20
"""Code of 8 bits below which a channel counts as dark."""
GLARE_RAD = np.radians(20.0)


@dataclass(frozen=True, slots=True)
class Held:
    """ratio: (3,) light of the card over that of the sand it covers, means over area and frames.

    rounding: (3,) largest change of it by half a code in the sky that is measured and in the sand that is covered.
    code: (3,) of 8 bits, of the covered sand's mean.
    """

    ratio: Floats
    rounding: Floats
    code: Floats

    def error(self) -> Floats:
        """Return how far (3,) the ratio is from 1."""
        return np.abs(self.ratio - 1.0)

    def within(self, most: float, most_dark: float) -> bool:
        """Return whether every channel holds: to `most`, dark ones to `most_dark`."""
        return bool(np.all(self.error() <= np.where(self.code < DARK, most_dark, most)))


def held(folder: Path, settings: DiveSettings, *, width: int = 512, frames: int = 6, sun_told: bool = True) -> Held:
    """Return how bright a card of sand on the sand of a dive is; the camera is over its middle.

    sun_told: whether the scene gives the sun's direction and its share of the light. A clip of one second shows the
    direction with an error of degrees, since waves displace its glitter.
    """
    plate, images = _filmed(settings, width, frames)
    (folder / "dive.mp4").unlink(missing_ok=True)
    record(folder / "dive.mp4", images, Fraction(FRAME_RATE), settings.seed)
    (folder / "card.obj").write_text(OBJ)
    height_m = settings.floor_depth_m - settings.depth_m
    below = directions(width, width // 2)[width // 4 :]
    place = np.abs(below * (height_m / np.maximum(-below[..., 1:2], 1e-6)))
    under = (place[..., 0] < HALF_SIDE_M) & (place[..., 2] < HALF_SIDE_M)
    x, z, footprint, *_ = on_level_floor(plate, width, 0.0)
    albedo = plate.scene.floor.albedo(x, z, footprint).reshape(-1, width, 3)
    card = {
        "mesh": "card.obj", "position_m": [0.0, LIFTED_M - height_m, 0.0],
        "base_color": albedo[under].mean(axis=0).tolist(), "metallic": 0.0, "roughness": 1.0,
        "casts_shadow": False,
    }  # fmt: skip
    keys = dive_scene(plate) | {"object": [card], "draw": {"samples": 5}}
    scene = scene_from_dict(keys if sun_told else _untold(keys), folder)
    backend, _ = make_backend("reference")
    shown, covered, pixels = np.zeros(3), np.zeros(3), 0
    with open_video(folder / "dive.mp4") as video:
        loaded = load(scene, width, width // 2)
        analysis = first_pass(loaded.surroundings, video)
        for frame in video.frames():
            made = composite_frame(loaded, analysis, backend, frame, 0.0)
            for tile in made.layer.tiles:
                inside = tile.alpha > 0.99
                shown += made.picture.image_linear[tile.window][inside].sum(axis=0)
                covered += frame.image_linear[tile.window][inside].sum(axis=0)
                pixels += int(np.count_nonzero(inside))
    code = 255.0 * encode(covered / pixels, "srgb")
    return Held(shown / covered, _rounding(images[0], settings, under), code)


def on_level_floor(plate: Dive, width: int, time_s: float) -> tuple[Floats, ...]:
    """Return x, z, footprint, distance [m] and y of the direction (n,) of a dive's pixels below the horizon, as if its
    floor was level.
    """
    view = plate.settings.view(width, width // 2, time_s)
    direction = directions(width, width // 2)[width // 4 :].reshape(-1, 3) @ view.world_from_camera.T
    distance = (plate.scene.floor.height_m - float(view.position[1])) / direction[:, 1]
    place = view.position.astype(np.float64) + distance[:, None] * direction
    footprint = distance * view.pixel_rad / np.sqrt(-direction[:, 1])
    return place[:, 0], place[:, 2], footprint, distance, direction[:, 1]


@lru_cache(maxsize=1)
def _filmed(settings: DiveSettings, width: int, frames: int) -> tuple[Dive, list[NDArray[np.float32]]]:
    plate = Dive(settings, width, width // 2)
    return plate, [plate.radiance(k / FRAME_RATE) for k in range(frames)]


def given_sun(settings: DiveSettings) -> dict[str, object]:
    """Return the keys of a scene's light that give the direction of a dive's sun, as the camera sees it."""
    elevation = float(np.degrees(np.arcsin(refract_to_water(settings.sun_in_air)[1])))
    return {"sun": "given", "sun_azimuth_deg": settings.sun_azimuth_deg, "sun_elevation_deg": elevation}


def _untold(keys: dict[str, object]) -> dict[str, object]:
    """Return the keys of a scene without what they tell of the sun."""
    water = {key: value for key, value in dict(keys["water"]).items() if not key.startswith("sun")}  # type: ignore[call-overload]
    return {key: value for key, value in keys.items() if key != "light"} | {"water": water}


def _rounding(image: Floats, settings: DiveSettings, under: NDArray[np.bool_]) -> Floats:
    """Return the sum (3,) of the relative changes of sky and sand by half a code."""
    height, width = image.shape[:2]
    view = directions(width, height)
    sky = np.maximum(view[..., 1], 0.0) * row_solid_angle(width, height)[:, None]
    sky *= view @ refract_to_water(settings.sun_in_air) < np.cos(GLARE_RAD)
    sand = np.concatenate([np.zeros_like(under), under]) * 1.0
    change = np.zeros(3)
    light = np.clip(image, 0.0, 1.0)
    step = decode(encode(light, "srgb") + HALF_CODE, "srgb") - light
    for weight in (sky, sand):
        change += np.tensordot(weight, step, 2) / np.tensordot(weight, light, 2)
    return change
