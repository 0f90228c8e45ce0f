# SPDX-License-Identifier: Apache-2.0
"""A synthetic 360 dive as files: clip, mesh, scene file, and the sun, sea, water and depths that made it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

from mr360uw.errors import OutputExistsError, ParameterError
from mr360uw.files import write_whole
from mr360uw.optics import refract_to_water
from mr360uw.progress import Progress
from mr360uw.sample.dive_plate import SENSOR, SUN_SHARE, DivePlate, DiveSettings
from mr360uw.sample.whale import write_whale
from mr360uw.threads import one_blas_thread, prefetch
from mr360uw.types import Floats


@dataclass(frozen=True, slots=True)
class SampleDive:
    """The files of a sample dive. truth: JSON with the sun's directions, the sea, the water and the depths."""

    plate: Path
    mesh: Path
    scene: Path
    truth: Path


def sample_dive(
    folder: str | Path,
    *,
    width: int = 1024,
    frames: int = 48,
    frame_rate: Fraction = Fraction(24),
    settings: DiveSettings | None = None,
    seed: int = 1,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> SampleDive:
    """Make `folder` with a synthetic 360 clip (sound, spherical metadata), a whale, a scene file and the truth.

    width: of the frame, a multiple of 4; the height is half of it. Raises `ParameterError`, `OutputExistsError` or
    `VideoError`; each file appears when it is complete.
    """
    from mr360uw.sample.recording import record
    from mr360uw.scene.template import scene_text

    if width < 64 or width % 4:
        raise ParameterError(f"width - must be a multiple of 4 from 64 up (got {width}) - take 1024 or 2048")
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
    write_whole(dive.truth, json.dumps(_truth(settings), indent=2) + "\n")
    write_whole(dive.scene, scene_text(_scene(settings)))
    return dive


def _scene(settings: DiveSettings) -> dict[str, object]:
    """Return the keys of a scene that differ from their defaults."""
    return {
        "plate": {"path": "dive.mp4"},
        "camera": {"depth_m": settings.camera_depth_m},
        "water": {"type": settings.water, "sensor": SENSOR},
        "sea": settings.sea.model_dump(exclude_unset=True),
        "object": [{"mesh": "whale.glb", "position_m": [0.4, -0.6, -3.6], "rotation_deg": [-60.0, 4.0, 0.0]}],
        "receiver": {"height_m": settings.camera_depth_m - settings.floor_depth_m},
    }


def _truth(settings: DiveSettings) -> dict[str, object]:
    return {
        "sun_direction_in_air": settings.sun_in_air.tolist(),
        "sun_direction_in_water": refract_to_water(settings.sun_in_air).tolist(),
        "sun_share_of_surface_irradiance": SUN_SHARE,
        "camera_depth_m": settings.camera_depth_m,
        "floor_depth_m": settings.floor_depth_m,
        "water": settings.water,
        "sea": settings.sea.model_dump(mode="json"),
    }
