# SPDX-License-Identifier: Apache-2.0
"""A synthetic 360 dive as files: clip, mesh, scene file, and the sun, sea, water and depths that made it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np

from mr360uw.errors import OutputExistsError, ParameterError
from mr360uw.files import write_whole
from mr360uw.optics import refract_to_water
from mr360uw.progress import Progress
from mr360uw.reading.limits import FRAMES, PICTURE
from mr360uw.sample.dive_light import SENSOR, SUN_SHARE
from mr360uw.sample.dive_plate import DivePlate
from mr360uw.sample.dive_settings import DiveSettings
from mr360uw.sample.whale import write_whale
from mr360uw.threads import one_blas_thread, prefetch
from mr360uw.types import Floats

TRACK = "camera.csv"
"""Name of the file with the camera's motion, beside the scene, where the camera moves."""


@dataclass(frozen=True, slots=True)
class SampleDive:
    """The files of a sample dive. truth: JSON with the sun's directions, the sea, the water and the depths."""

    plate: Path
    mesh: Path
    scene: Path
    truth: Path


def sample_dive(
    folder: str | Path,
    settings: DiveSettings | None = None,
    *,
    width: int = 1024,
    frames: int = 48,
    frame_rate: Fraction = Fraction(24),
    seed: int = 1,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> SampleDive:
    """Make `folder` with a synthetic 360 clip (sound, spherical metadata), a whale, a scene file and the truth.

    settings: of the dive; seed: of sea and sand without them. width: of the frame, a multiple of 4; the height is half
    of it. Raises `ParameterError`, `OutputExistsError` or
    `VideoError`; each file appears when it is complete.
    """
    from mr360uw.sample.recording import record
    from mr360uw.scene.template import scene_text

    if width < 64 or width % 4:
        raise ParameterError(f"width - must be a multiple of 4 from 64 up (got {width}) - take 1024 or 2048")
    PICTURE.check("width", width * width // 2, ParameterError)
    FRAMES.check("frames", frames, ParameterError)
    if frames < 1:
        raise ParameterError(f"frames - must be at least 1 (got {frames}) - take 48")
    settings = settings if settings is not None else DiveSettings(seed=seed)
    folder = Path(folder)
    dive = SampleDive(folder / "dive.mp4", folder / "whale.glb", folder / "scene.toml", folder / "truth.json")
    if not overwrite:
        for path in (dive.plate, dive.mesh, dive.scene, dive.truth):
            if path.exists():
                raise OutputExistsError(f"{path} - is there already - name another folder, or give --overwrite")
    folder.mkdir(parents=True, exist_ok=True)
    write_whale(dive.mesh)
    plate = DivePlate(settings, width, width // 2)

    def images() -> Iterator[Floats]:
        times = (float(index / frame_rate) for index in range(frames))
        for index, image in enumerate(prefetch(map(plate.radiance, times), depth=1)):
            yield image
            if progress is not None:
                progress(index + 1, frames)

    with one_blas_thread():
        record(dive.plate, images(), frame_rate, settings.seed)
    if settings.speed_m_s:
        write_whole(folder / TRACK, _track(settings, frames, frame_rate))
    write_whole(dive.truth, json.dumps(_truth(settings, plate), indent=2) + "\n")
    write_whole(dive.scene, scene_text(dive_scene(settings)))
    return dive


def dive_scene(settings: DiveSettings) -> dict[str, object]:
    """Return the keys of the dive's scene that differ from their defaults."""
    sun_up = float(refract_to_water(settings.sun_in_air)[1])
    water = {"sun_share": SUN_SHARE, "sun_elevation_deg": round(float(np.degrees(np.arcsin(sun_up))), 3)}
    track: dict[str, object] = {"track": TRACK} if settings.speed_m_s else {}
    return {
        "plate": {"path": "dive.mp4"},
        "camera": {"depth_m": settings.camera_depth_m} | track,
        "water": {"type": settings.water, "sensor": SENSOR} | water,
        "sea": settings.sea.model_dump(exclude_unset=True),
        "object": [{"mesh": "whale.glb", "position_m": [0.4, -0.6, -3.6], "rotation_deg": [-60.0, 4.0, 0.0]}],
        "receiver": {"height_m": settings.camera_depth_m - settings.floor_depth_m},
    }


def _track(settings: DiveSettings, frames: int, frame_rate: Fraction) -> str:
    """Return the camera's motion as CSV."""
    rows = ["time_s,x,y,z,qx,qy,qz,qw"]
    for index in range(frames):
        time_s = float(index / frame_rate)
        x, y, z = settings.camera_at(time_s)
        rows.append(f"{time_s!r},{float(x)!r},{float(y)!r},{float(z)!r},0,0,0,1")
    return "\n".join(rows) + "\n"


def _truth(settings: DiveSettings, plate: DivePlate) -> dict[str, object]:
    return {
        "sun_direction_in_air": settings.sun_in_air.tolist(),
        "sun_direction_in_water": refract_to_water(settings.sun_in_air).tolist(),
        "sun_share_of_surface_irradiance": SUN_SHARE,
        "camera_depth_m": settings.camera_depth_m,
        "camera_speed_m_s": settings.speed_m_s,
        "floor_depth_m": settings.floor_depth_m,
        "floor_irradiance_over_surface": plate.floor_irradiance.tolist(),
        "level_radiance_linear": plate.level_radiance.tolist(),
        "water": settings.water,
        "sea": settings.sea.model_dump(mode="json"),
    }
