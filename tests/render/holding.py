# SPDX-License-Identifier: Apache-2.0
"""The holding test: a card of the sand's own albedo that lies on the sand of a dive vanishes.

The dive is made by its own solved light, written as 8-bit video and composited like any other: the light is read from
the plate, carried down to the sand by the water, and must come out as bright as the sand that is there.

Video cannot show it better than its codes do: an encoder may move Y', Cb and Cr of an even area by half a code.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mr360uw.color import decode, encode, rgb_from_ycbcr
from mr360uw.optics import refract_to_water
from mr360uw.render.backends import make_backend
from mr360uw.render.first_pass import first_pass
from mr360uw.render.frame import finished, frame_stages
from mr360uw.render.loaded import load
from mr360uw.sample.dive import dive_scene
from mr360uw.sample.dive_settings import DiveSettings
from mr360uw.sample.recording import record
from mr360uw.sample.rendered_dive import Dive
from mr360uw.scene import scene_from_dict
from mr360uw.sphere import directions, row_solid_angle
from mr360uw.types import Floats
from mr360uw.video import open_video
from tests.dives import over_sand

ABOVE_SAND_M = 2.0
HALF_SIDE_M = 1.0
"""The card is 2 m wide, below the camera: over caustics and ripples of a few decimetres."""
LIFTED_M = 2e-3
OBJ = "v -1 0 -1\nv 1 0 -1\nv 1 0 1\nv -1 0 1\nvn 0 1 0\nf 1//1 3//1 2//1\nf 1//1 4//1 3//1\n"


HALF_CODE = np.abs(rgb_from_ycbcr("bt709")) @ (0.5 / np.array([219.0, 224.0, 224.0]))
"""Largest change (3,) of R', G', B' where each of Y', Cb, Cr of limited range is half a code off."""
GLARE_RAD = np.radians(20.0)


@dataclass(frozen=True, slots=True)
class Held:
    """ratio: (3,) light of the card over that of the sand it covers, means over area and frames.

    rounding: (3,) largest change of it by half a code in the sky that is measured and in the sand that is covered.
    """

    ratio: Floats
    rounding: Floats


def held(
    folder: Path,
    water: str,
    depth_m: float,
    sun_deg: float,
    *,
    width: int = 512,
    frames: int = 6,
    sun_known: bool = False,
) -> Held:
    """Return how bright a card of sand on the sand is.

    depth_m: of the sand. sun_deg: elevation of the sun above the surface. sun_known: whether the scene gives the sun's
    direction; waves displace the glitter of a clip of one second by degrees.
    """
    camera_m, height = depth_m - ABOVE_SAND_M, width // 2
    settings = over_sand(depth_m=camera_m, floor_m=depth_m, water=water, sun_elevation_deg=sun_deg)
    plate = Dive(settings, width, height)
    images = [plate.radiance(k / 6.0) for k in range(frames)]
    (folder / "dive.mp4").unlink(missing_ok=True)
    record(folder / "dive.mp4", images, Fraction(6), settings.seed)
    (folder / "card.obj").write_text(OBJ)
    below = directions(width, height)[height // 2 :]
    place = np.abs(below * (ABOVE_SAND_M / np.maximum(-below[..., 1:2], 1e-6)))
    under = (place[..., 0] < HALF_SIDE_M) & (place[..., 2] < HALF_SIDE_M)
    card = {
        "mesh": "card.obj", "position_m": [0.0, LIFTED_M - ABOVE_SAND_M, 0.0],
        "base_color": plate.albedo[under].mean(axis=0).tolist(), "metallic": 0.0, "roughness": 1.0,
        "casts_shadow": False,
    }  # fmt: skip
    light = {"light": given_sun(settings)} if sun_known else {}
    scene = scene_from_dict(dive_scene(plate) | light | {"object": [card], "draw": {"samples": 5}}, folder)
    backend, _ = make_backend("reference")
    shown, covered = np.zeros(3), np.zeros(3)
    with open_video(folder / "dive.mp4") as video:
        loaded = load(scene, width, height)
        facts = first_pass(loaded.surroundings, video)
        for frame in video.frames():
            made = finished(frame_stages(loaded, facts, backend, frame, 0.0))
            for tile in made.layer.tiles:
                inside = tile.alpha > 0.99
                shown += made.picture.image_linear[tile.window][inside].sum(axis=0)
                covered += frame.image_linear[tile.window][inside].sum(axis=0)
    return Held(shown / covered, _rounding(images[0], settings, under))


def given_sun(settings: DiveSettings) -> dict[str, object]:
    """Return the keys of a scene's light that give the direction of a dive's sun, as the camera sees it."""
    elevation = float(np.degrees(np.arcsin(refract_to_water(settings.sun_in_air)[1])))
    return {"sun": "given", "sun_azimuth_deg": settings.sun_azimuth_deg, "sun_elevation_deg": elevation}


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
