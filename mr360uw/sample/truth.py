# SPDX-License-Identifier: Apache-2.0
"""The truth of a synthetic dive: its light, water, waves and camera as JSON, its distances and masks as pictures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from mr360uw.color import luminance
from mr360uw.medium import Water
from mr360uw.sample.rendered_dive import SENSOR, Dive
from mr360uw.sample.sea_bed import BED_TILE_M
from mr360uw.surface.sea_picture import SurfacePicture
from mr360uw.types import Floats

_BANDS_NM = np.arange(400.0, 701.0, 25.0)


def dive_truth(dive: Dive, times_s: list[float]) -> dict[str, Any]:
    """Return the fields of `truth.json`, as docs/sample.md lists them. Light is relative to that just below a level
    surface, angles are in degrees, vectors are in the world.
    """
    settings = dive.settings
    wet, waves = Water.jerlov(settings.water), settings.sea.waves
    up = None if dive.sun_in_air is None else (dive.sun_in_air, dive.sun_in_water)
    return {
        "sun_direction_in_air": _listed(None if up is None else up[0]),
        "sun_direction_in_water": _listed(None if up is None else up[1]),
        "sun_half_angle_rad": None if dive.sky.sun is None else dive.sky.sun.half_angle_rad,
        "sun_irradiance_in_air": _listed(None if dive.sky.sun is None else dive.sky.sun.irradiance),
        "sun_share_of_surface_irradiance": dive.sky.sun_share,
        "irradiance": {
            "just_below_surface": _shares(dive.sky.sky_below, dive.sky.sun_below),
            "camera": _shares(*_level(dive, settings.depth_m)),
            "floor": _listed(dive.floor_irradiance),
        },
        "camera_depth_m": settings.depth_m,
        "camera_speed_m_s": settings.speed_m_s,
        "floor_depth_m": settings.floor_depth_m,
        "floor_tile_m": BED_TILE_M,
        "floor_mean_albedo": _listed(dive.scene.floor.mean_albedo),
        "level_radiance_linear": _listed(dive.level_radiance),
        "exposure": dive.exposure,
        "sensor": SENSOR,
        "water": settings.water,
        "water_properties": {
            "wavelength_nm": _BANDS_NM.tolist(),
            "absorption_per_m": _listed(wet.absorption(_BANDS_NM)),
            "scattering_per_m": _listed(wet.scattering(_BANDS_NM)),
        },
        "sea": settings.sea.model_dump(mode="json"),
        "waves": {
            "wave_vector_rad_per_m": _listed(waves.wave_vector),
            "amplitude_m": _listed(waves.amplitude_m),
            "steepness": _listed(waves.steepness),
            "phase_rad": _listed(waves.phase_rad),
            "angular_frequency_rad_per_s": _listed(waves.angular_frequency),
        },
        "settings": settings.model_dump(mode="json"),
        "frames": [_frame(dive, k, time_s) for k, time_s in enumerate(times_s)],
    }


def write_frame_truth(path: Path, dive: Dive, seen: SurfacePicture) -> None:
    """Write distances, masks and normals of a frame's pixel centres as arrays of an .npz file.

    distance_m: (H, W) to surface or floor. in_water_m: (H, W). surface, floor: (H, W) masks. normal: (H, W, 3) of the
    surface. radiance: (H, W, 3), exposed, not clipped, float16.
    """
    from mr360uw.files import whole_file

    with whole_file(path) as partial, partial.open("wb") as file:
        np.savez_compressed(
            file, distance_m=seen.distance_m.astype(np.float32), in_water_m=seen.in_water_m.astype(np.float32),
            surface=seen.surface, floor=seen.floor, normal=seen.normal.astype(np.float16),
            radiance=np.minimum(dive.exposure * seen.radiance, 6e4).astype(np.float16),
        )  # fmt: skip


def _frame(dive: Dive, index: int, time_s: float) -> dict[str, Any]:
    """Return what is known of one frame; the horizon is the direction up, in the camera's axes."""
    position, rotation = dive.settings.camera_at(time_s)
    sun = dive.sun_in_water
    return {
        "index": index,
        "time_s": time_s,
        "position_m": _listed(position),
        "world_from_camera": _listed(rotation),
        "up_in_camera": _listed(rotation[1]),
        "sun_in_camera": _listed(None if sun is None else sun @ rotation),
        "depth_m": dive.settings.depth_m - float(position[1]),
    }


def _level(dive: Dive, depth_m: float) -> tuple[Floats, Floats]:
    """Return the irradiance (3,) of a level plane at a depth: ambient, and by the beam."""
    ambient, beam = dive.irradiance(depth_m)
    return ambient, beam * dive.water.sun_up


def _shares(sky: Floats, sun: Floats) -> dict[str, Any]:
    return {"sky": _listed(sky), "sun": _listed(sun), "luminance": float(luminance(sky + sun))}


def _listed(values: Floats | None) -> Any:
    return None if values is None else np.asarray(values, np.float64).tolist()
