# SPDX-License-Identifier: Apache-2.0
"""Medium table of a frame: for the camera's depth, its veil matched to the plate, its ambient light such that it goes
on from what the plate shows at the camera (`medium.ambient`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mr360uw.constants import MINIMUM_SUN_UP
from mr360uw.ibl.lookup import environment_lookup
from mr360uw.medium.ambient import LightAtCamera, ambient_parts
from mr360uw.medium.fit.open_water import visible_gain
from mr360uw.render.plate_light import FrameLight
from mr360uw.render.surroundings import Surroundings
from mr360uw.types import MediumTable


def exposed_water(surroundings: Surroundings, light: FrameLight, time_s: float) -> MediumTable | None:
    """Return the table of the water at a time, matched to the light of a frame; None without water."""
    medium = surroundings.medium_at(time_s)
    if medium is None:
        return None
    up, environment = surroundings.camera.at(time_s)[1][1], light.environment
    sun = environment.sun
    measured = LightAtCamera(
        down=environment_lookup(environment.ambient, up),
        up=environment_lookup(environment.ambient, -up),
        sun=np.zeros(3) if sun is None else sun.irradiance,
        sun_up=1.0 if sun is None else max(float(sun.direction @ up), MINIMUM_SUN_UP),
    )
    diffuse, floor = ambient_parts(medium, measured)
    if light.gain is not None:
        medium = medium.scaled(light.gain if light.plate_ratio is None else visible_gain(medium, light.gain))
    if light.plate_ratio is not None:  # which was found over this floor
        floor = medium.floor_seen(medium.gain, measured.up)
    table, ratio = medium.lit_by_floor(floor).table, light.plate_ratio
    if ratio is None:
        ratio = surroundings.around_sun(time_s, medium, sun, fitted=light.gain is not None)
    return replace(table, diffuse=diffuse.astype(np.float32), plate_ratio=ratio)
