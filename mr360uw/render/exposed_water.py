# SPDX-License-Identifier: Apache-2.0
"""Medium table of a frame: for the camera's depth, its veil matched to the plate, its daylight split.

    A(d) = (A + S) r(d) - S s(d)        r(d) = E(d)/E(camera), all light;  s(d) the same of the beam

A, S: horizontal irradiance of ambient light and of the sun at the camera. What leaves the beam becomes ambient light:
both together are the solved irradiance at every depth.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mr360uw.constants import BRIGHTEST_LOG, MINIMUM_SUN_UP
from mr360uw.ibl.lookup import environment_lookup
from mr360uw.medium.fit.open_water import visible_gain
from mr360uw.medium.lookup import path_attenuation
from mr360uw.medium.tabulate import STEP, lengths
from mr360uw.render.plate_light import FrameLight
from mr360uw.render.surroundings import Surroundings
from mr360uw.types import Floats, MediumTable

_LEAST_AMBIENT = 0.05
"""Least fraction of all light at a depth that is ambient, where a given sun is too bright for its water."""


def exposed_water(surroundings: Surroundings, light: FrameLight, time_s: float) -> MediumTable | None:
    """Return the table of the water at a time, matched to the light of a frame; None without water."""
    table = _veiled(surroundings, light, time_s)
    if table is None or light.environment.sun is None:
        return table
    up, sun = surroundings.camera.at(time_s)[1][1], light.environment.sun
    sun_up = max(float(sun.direction @ up), MINIMUM_SUN_UP)
    return with_ambient(table, environment_lookup(light.environment.ambient, up), sun.irradiance, sun_up)


def with_ambient(table: MediumTable, ambient: Floats, sun: Floats, sun_up: float) -> MediumTable:
    """Return a table whose `diffuse` is of ambient light alone, beside a sun.

    ambient: (3,) horizontal irradiance at the camera without the sun. sun: (3,) irradiance of its beam there,
    perpendicular to it. sun_up: y of its direction.
    """
    camera, whole = table.camera_depth_m, np.maximum(ambient + sun * sun_up, np.finfo(np.float32).tiny)
    depth = lengths(len(table.diffuse), table.length_m)
    depth = np.where(np.abs(depth - camera) > STEP * (table.length_m + camera), depth, camera + STEP * table.length_m)
    below = (depth - camera)[:, None]
    # logarithms: far down nothing is left that a quotient could be made of
    all_light = -table.diffuse * below
    here = path_attenuation(table, table.beam, camera, sun_up)
    beam = np.minimum(here - path_attenuation(table, table.beam, depth, sun_up) - all_light, BRIGHTEST_LOG)
    left = np.log(np.maximum(1.0 - sun * sun_up / whole * np.exp(beam), _LEAST_AMBIENT))
    at_camera = np.log(np.maximum(ambient / whole, _LEAST_AMBIENT))
    return replace(table, diffuse=((at_camera - all_light - left) / below).astype(np.float32))


def _veiled(surroundings: Surroundings, light: FrameLight, time_s: float) -> MediumTable | None:
    medium = surroundings.medium_at(time_s)
    if medium is None:
        return None
    if light.gain is None:
        return medium.table
    if light.plate_ratio is None:
        return medium.scaled(light.gain).table
    return replace(medium.scaled(visible_gain(medium, light.gain)).table, plate_ratio=light.plate_ratio)
