# SPDX-License-Identifier: Apache-2.0
"""The clip analysis as a file: measured once, and kept for later runs over the same plate and settings."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.grading.colour_grade import ColourGrade
from mr360uw.composite.grading.settings import PlateGrade
from mr360uw.ibl import SunTrack
from mr360uw.medium.fit.open_water_track import OpenWaterTrack
from mr360uw.progress import Progress
from mr360uw.reading.disk_cache import cache_file, keep_arrays, read_arrays, write_arrays
from mr360uw.reading.kept_reads import stamp
from mr360uw.reading.numbered_files import files_named
from mr360uw.render.calm import CalmPlate
from mr360uw.render.first_pass import ClipAnalysis, clip_facts
from mr360uw.render.loaded import Loaded
from mr360uw.runs.fingerprint import WorkKeys
from mr360uw.video import VideoReader
from mr360uw.video.read.projection import projection_of


def measured_facts(
    loaded: Loaded,
    video: VideoReader,
    frames: tuple[int, int],
    keys: WorkKeys,
    progress: Progress | None = None,
    *,
    fresh: bool = False,
) -> ClipAnalysis:
    """Return the facts of a clip's frames [a, b), of an earlier run if there was one over the same with the same.

    fresh: measure them anyway. Raises as `clip_facts`.
    """
    path = _file_of(loaded, video, keys)
    stored = None if path is None or fresh else load_facts(path)
    if stored is not None:
        return stored
    facts = clip_facts(loaded, video, progress, frames=frames)
    if path is not None:
        keep_arrays(path, arrays_of_facts(facts))
    return facts


def _file_of(loaded: Loaded, video: VideoReader, keys: WorkKeys) -> Path | None:
    """Return the file of the facts, under the key of the first pass, what the plan asks of it, and the plate's files.

    None where nothing is kept: plates of two lenses and configs of OpenColorIO may lie in files that the scene does
    not name.
    """
    plate, plan = loaded.scene.plate, loaded.plan
    if projection_of(plate.path, plate.projection) != "equirectangular" or plate.ocio is not None:
        return None
    wanted = plan.track_sun.runs, plan.track_gain.runs, plan.pattern.runs, plan.match.runs
    files = [(str(file), stamp(file)) for file in files_named(plate.path)]
    return cache_file("first-pass", (keys.first_pass, wanted, video.width, video.height, files))


_SUN, _LOOK, _OPEN_WATER = "sun_", "look_", "open_water_"
_PLAIN = ("softness_px", "sharpening", "sharpening_px", "columns")
"""Fields of a look that are numbers."""


def arrays_of_facts(facts: ClipAnalysis) -> dict[str, Any]:
    """Return a clip's facts, with a track of the sun or none, as arrays by name."""
    arrays: dict[str, Any] = {"notes": np.array(facts.notes, dtype=np.str_), "first": np.array(facts.first)}
    if isinstance(facts.sun, SunTrack):
        arrays |= {_SUN + field.name: getattr(facts.sun, field.name) for field in dataclasses.fields(SunTrack)}
    if facts.gain is not None:
        arrays["gain"] = facts.gain
    if facts.open_water is not None:
        track = facts.open_water
        arrays |= {_OPEN_WATER + field.name: getattr(track, field.name) for field in dataclasses.fields(track)}
    if facts.calm is not None:
        arrays["strength"] = facts.calm.strength
        if facts.calm.mean is not None:
            arrays["mean"] = facts.calm.mean
    if facts.look is not None:
        plain = {name: getattr(facts.look, name) for name in _PLAIN if getattr(facts.look, name) is not None}
        of_look = {"colour": facts.look.colour.numbers, "found": np.array(facts.look.found, dtype=np.str_), **plain}
        arrays |= {_LOOK + name: value for name, value in of_look.items()}
    return arrays


def facts_of_arrays(arrays: Mapping[str, NDArray[Any]]) -> ClipAnalysis:
    """Return the facts that `arrays_of_facts` was given."""
    of_sun, of_look, of_water = (_under(prefix, arrays) for prefix in (_SUN, _LOOK, _OPEN_WATER))
    if of_sun:
        of_sun["cuts"] = tuple(int(index) for index in of_sun["cuts"])
    calm = CalmPlate(arrays.get("mean"), float(arrays["strength"])) if "strength" in arrays else None
    notes = tuple(str(note) for note in arrays["notes"])
    return ClipAnalysis(
        SunTrack(**of_sun) if of_sun else None,
        arrays.get("gain"),
        calm,
        notes,
        int(arrays["first"]),
        _stored_look(of_look) if of_look else None,
        OpenWaterTrack(**of_water) if of_water else None,
    )


def _under(prefix: str, arrays: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
    return {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}


def save_facts(facts: ClipAnalysis, path: Path) -> None:
    """Write a clip's facts to a file."""
    write_arrays(path, arrays_of_facts(facts))


def load_facts(path: Path) -> ClipAnalysis | None:
    """Return the facts of a file, or None where there is none, or it is damaged or lacks some."""
    arrays = read_arrays(path)
    try:
        return None if arrays is None else facts_of_arrays(arrays)
    except KeyError:
        return None


def _stored_look(arrays: Mapping[str, NDArray[Any]]) -> PlateGrade:
    plain: dict[str, Any] = {name: arrays[name].item() for name in _PLAIN if name in arrays}
    found = tuple(str(line) for line in arrays["found"])
    return PlateGrade(colour=ColourGrade.of_numbers(arrays["colour"]), found=found, **plain)
