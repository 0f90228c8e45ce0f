# SPDX-License-Identifier: Apache-2.0
"""The holding test: a card of the sand's own albedo that lies on the sand of a dive vanishes.

The dive is made by its own solved light, written as 8-bit video and composited like any other: the light is read from
the plate, carried down to the sand by the water, and must come out as bright as the sand that is there.
"""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np

from mr360uw.render.backends import make_backend
from mr360uw.render.first_pass import first_pass
from mr360uw.render.frame import finished, frame_stages
from mr360uw.render.loaded import load
from mr360uw.sample.dive import dive_scene
from mr360uw.sample.dive_plate import DivePlate
from mr360uw.sample.dive_settings import DiveSettings
from mr360uw.sample.recording import record
from mr360uw.scene import scene_from_dict
from mr360uw.sphere import directions
from mr360uw.types import Floats
from mr360uw.video import open_video

ABOVE_SAND_M = 2.0
HALF_SIDE_M = 1.0
"""The card is 2 m wide, below the camera: over caustics and ripples of a few decimetres."""
LIFTED_M = 2e-3
OBJ = "v -1 0 -1\nv 1 0 -1\nv 1 0 1\nv -1 0 1\nvn 0 1 0\nf 1//1 3//1 2//1\nf 1//1 4//1 3//1\n"


def held(folder: Path, water: str, depth_m: float, sun_deg: float, *, width: int = 512, frames: int = 6) -> Floats:
    """Return the light of the card over that of the sand it covers (3,), means over area and frames.

    depth_m: of the sand. sun_deg: elevation of the sun above the surface.
    """
    camera_m, height = depth_m - ABOVE_SAND_M, width // 2
    settings = DiveSettings(camera_m, depth_m, water, sun_elevation_rad=float(np.radians(sun_deg)))
    plate = DivePlate(settings, width, height)
    (folder / "dive.mp4").unlink(missing_ok=True)
    record(folder / "dive.mp4", [plate.radiance(k / 6.0) for k in range(frames)], Fraction(6), settings.seed)
    (folder / "card.obj").write_text(OBJ)
    below = directions(width, height)[height // 2 :]
    place = np.abs(below * (ABOVE_SAND_M / np.maximum(-below[..., 1:2], 1e-6)))
    sand = plate.albedo[(place[..., 0] < HALF_SIDE_M) & (place[..., 2] < HALF_SIDE_M)].mean(axis=0)
    card = {
        "mesh": "card.obj", "position_m": [0.0, LIFTED_M - ABOVE_SAND_M, 0.0], "base_color": sand.tolist(),
        "metallic": 0.0, "roughness": 1.0, "casts_shadow": False,
    }  # fmt: skip
    scene = scene_from_dict(dive_scene(settings) | {"object": [card], "draw": {"samples": 5}}, folder)
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
    return shown / covered
