# SPDX-License-Identifier: Apache-2.0
"""A synthetic 360 dive as files: clip, mesh, scene file, and the sun, sea, water and depths that made it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from mr360uw.errors import ParameterError
from mr360uw.files import write_whole
from mr360uw.output_gate import check_folder, check_outputs, made_folder
from mr360uw.progress import Progress
from mr360uw.reading.limits import FRAMES, PICTURE
from mr360uw.sample.dive_settings import DiveSettings
from mr360uw.sample.recording import record, with_noise
from mr360uw.sample.rendered_dive import SENSOR, Dive
from mr360uw.sample.truth import dive_truth, write_frame_truth
from mr360uw.sample.whale import write_whale
from mr360uw.shapes import checked, file_path, instance
from mr360uw.threads import one_blas_thread, prefetch
from mr360uw.types import Floats

TRACK = "camera.csv"
"""Name of the file with the camera's motion, beside the scene, where the camera moves."""
TRUTH_FOLDER = "truth"
"""Name of the folder with the frames' distances and masks."""
_CALF_M = 4.0
"""Length of the whale: a newborn humpback, which is near enough over sand to catch the caustics whole."""
_FINE = 512
"""Pixels across a frame from which on the whale is fine and swims: in smaller frames, for quick tries, a coarse, rigid
one looks the same."""


@dataclass(frozen=True, slots=True)
class SampleDive:
    """The files of a sample dive. truth: JSON of `dive_truth`; beside it is the folder `truth` with .npz files."""

    plate: Path
    mesh: Path
    scene: Path
    truth: Path


@checked
def sample_dive(
    folder: str | Path,
    settings: DiveSettings | None = None,
    *,
    width: int = 1024,
    frames: int = 48,
    frame_rate: Fraction = Fraction(24),
    seed: int = 1,
    samples: int = 1,
    truth: bool = False,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> SampleDive:
    """Make a folder with a synthetic 360 clip (sound, spherical metadata), a whale, a scene file and the truth.

    For a first try without footage, and for checks against a light, a water and a camera that are known. Frames are
    rendered by rays through moving waves.

    Parameters
    ----------
    folder : str or Path
        Folder of the files, which is made.
    settings : DiveSettings, optional
        Water, sun, sea and floor of the dive.
    width : int
        Pixels across the frame, a multiple of 4; the height is half of it.
    frames : int
        Length of the clip.
    frame_rate : Fraction
        Frames a second.
    seed : int
        Seed of sea, floor and noise, without settings.
    samples : int
        Rays of a pixel along each axis.
    truth : bool
        Distances and masks of every frame, not of the first alone.
    overwrite : bool
        Replace files that are there.
    progress : callable, optional
        Is called with (done, total) frames.

    Returns
    -------
    SampleDive
        Paths of the plate, the mesh, the scene and the truth.

    Raises
    ------
    ParameterError
        If a setting is out of range.
    OutputExistsError
        If files are there already.
    VideoError
        If the clip cannot be written.

    See Also
    --------
    uw.load_scene : Reads the scene file.
    uw.surface.SeaScene : Renders pictures of a sea in memory.

    Examples
    --------
    >>> dive = uw.sample_dive("try", width=64, frames=1)
    >>> dive.scene.name
    'scene.toml'
    """
    from mr360uw.scene.handbook import scene_text

    settings = DiveSettings(seed=seed) if settings is None else instance("settings", settings, DiveSettings, "make one")
    check_recording(width, frames, samples)
    folder = file_path("folder", folder)
    made = SampleDive(folder / "dive.mp4", folder / "whale.glb", folder / "scene.toml", folder / "truth.json")
    outputs = [made.plate, made.mesh, made.scene, made.truth, *([folder / TRACK] if settings.moves else [])]
    check_outputs(outputs, overwrite=overwrite, folder=folder)
    check_folder(folder / TRUTH_FOLDER)
    dive = Dive(settings, width, width // 2, samples=samples)
    times = [float(index / frame_rate) for index in range(frames)]

    def image(index: int) -> Floats:
        seen = dive.picture(times[index])
        if truth or index == 0:
            write_frame_truth(folder / TRUTH_FOLDER / f"{index:05d}.npz", dive, seen)
        light = (dive.exposure * seen.radiance).astype(np.float32)
        return with_noise(light, settings.noise, settings.seed, index)

    def images() -> Iterator[Floats]:
        for index, light in enumerate(prefetch(map(image, range(frames)), depth=1)):
            yield light
            if progress is not None:
                progress(index + 1, frames)

    with made_folder(folder / TRUTH_FOLDER):
        with one_blas_thread():
            record(made.plate, images(), frame_rate, settings.seed, settings.transfer, settings.bits)
        fine = width >= _FINE
        write_whale(made.mesh, _CALF_M, detail="high" if fine else "low", seed=settings.seed, swims=fine)
        if settings.moves:
            write_whole(folder / TRACK, _track(settings, times))
        write_whole(made.truth, json.dumps(dive_truth(dive, times), indent=1) + "\n")
        write_whole(made.scene, scene_text(dive_scene(dive)))
    return made


@checked
def check_recording(width: int, frames: int, samples: int) -> None:
    """Raise `ParameterError` with a line for each wrong number."""
    wrong = []
    if width < 64 or width % 4:
        wrong.append(f"width - must be a multiple of 4 from 64 up (got {width}) - take 1024 or 2048")
    if frames < 1:
        wrong.append(f"frames - must be at least 1 (got {frames}) - take 48")
    if not 1 <= samples <= 8:
        wrong.append(f"samples - must be 1 to 8 (got {samples}) - take 1, or 2 for smooth edges")
    if wrong:
        raise ParameterError("\n".join(wrong))
    PICTURE.check("width", width * width // 2, ParameterError)
    FRAMES.check("frames", frames, ParameterError)


def dive_scene(dive: Dive) -> dict[str, object]:
    """Return the keys of the dive's scene that differ from their defaults."""
    settings, sun = dive.settings, dive.sun_in_water
    water: dict[str, Any] = {"type": settings.water, "sensor": SENSOR}
    light: dict[str, Any] = {}
    if sun is None:
        light = {"light": {"sun": "none"}}
    else:
        elevation = round(float(np.degrees(np.arcsin(sun[1]))), 3)
        azimuth = round(float(np.degrees(np.arctan2(sun[0], -sun[2]))), 3)
        water |= {"sun_share": round(dive.sky.sun_share, 4), "sun_elevation_deg": elevation}
        light = {"light": {"sun": "given", "sun_azimuth_deg": azimuth, "sun_elevation_deg": elevation}}
    plate: dict[str, Any] = {"path": "dive.mp4"}
    if settings.transfer != "srgb":
        plate["transfer"] = settings.transfer
    track: dict[str, object] = {"track": TRACK} if settings.moves else {}
    return {
        "plate": plate,
        "camera": {"depth_m": settings.depth_m} | track,
        "water": water,
        **light,
        "sea": settings.sea.model_dump(exclude_unset=True),
        "object": [
            {"mesh": "whale.glb", "position_m": [0.4, -0.6, -3.6], "face": -60.0, "rotation_deg": [0.0, 4.0, 0.0]}
        ],
        "receiver": {"height_m": settings.depth_m - settings.floor_depth_m},
    }


def _track(settings: DiveSettings, times_s: list[float]) -> str:
    """Return the camera's motion as CSV."""
    from scipy.spatial.transform import Rotation

    rows = ["time_s,x,y,z,qx,qy,qz,qw"]
    for time_s in times_s:
        position, rotation = settings.camera_at(time_s)
        numbers = (time_s, *position, *Rotation.from_matrix(rotation).as_quat())
        rows.append(",".join(repr(float(number)) for number in numbers))
    return "\n".join(rows) + "\n"
