# SPDX-License-Identifier: Apache-2.0
"""The clip analysis as a file: measured once, and kept for later runs over the same plate and settings."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import NoneType
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from mr360uw.files import files_named
from mr360uw.progress import Progress
from mr360uw.reading.disk_cache import (
    Arrays,
    cache_file,
    keep_arrays,
    read_arrays,
    read_kept_arrays,
    sources_stamp,
    stamp,
    write_arrays,
)
from mr360uw.reading.input_files import InputFile, input_file
from mr360uw.render.first_pass import ClipAnalysis, clip_analysis
from mr360uw.render.loaded import Loaded
from mr360uw.scene.model import Scene, files_of
from mr360uw.scene.toml_model import dotted
from mr360uw.video import VideoReader
from mr360uw.video.formats import projection_of


def measured_analysis(
    loaded: Loaded,
    video: VideoReader,
    frames: tuple[int, int],
    keys: WorkKeys,
    progress: Progress | None = None,
    *,
    fresh: bool = False,
) -> ClipAnalysis:
    """Return the analysis of a clip's frames [a, b), of an earlier run if there was one over the same with the same.

    fresh: measure them anyway. Raises as `clip_analysis`.
    """
    path = _file_of(loaded, video, keys)
    stored = None if path is None or fresh else _analysis_if_whole(read_kept_arrays(path))
    if stored is not None:
        return stored
    analysis = clip_analysis(loaded, video, progress, frames=frames)
    if path is not None:
        keep_arrays(path, arrays_of_analysis(analysis))
    return analysis


def _file_of(loaded: Loaded, video: VideoReader, keys: WorkKeys) -> Path | None:
    """Return the file of the analysis, under the key of the first pass, what the plan asks of it and the plate's files.

    None where nothing is kept: plates of two lenses and configs of OpenColorIO may lie in files that the scene does
    not name.
    """
    plate, plan = loaded.scene.plate, loaded.plan
    if projection_of(plate.path, plate.projection) != "equirectangular" or plate.ocio is not None:
        return None
    wanted = plan.track_sun.runs, plan.track_gain.runs, plan.pattern.runs, plan.match.runs
    files = [(str(file), stamp(file)) for file in files_named(plate.path)]
    return cache_file("first-pass", (keys.first_pass, wanted, video.width, video.height, files))


def arrays_of_analysis(part: Any, prefix: str = "") -> dict[str, Any]:
    """Return a clip's analysis, with a track of the sun or none, as arrays by the dotted names of its fields."""
    arrays: dict[str, Any] = {}
    for one in dataclasses.fields(part):
        value, name = getattr(part, one.name), f"{prefix}{one.name}"
        if dataclasses.is_dataclass(value):
            arrays |= arrays_of_analysis(value, f"{name}.")
        elif value is not None:
            arrays[name] = np.asarray(value)
    return arrays


def analysis_of_arrays(arrays: Mapping[str, NDArray[Any]], kind: type = ClipAnalysis, prefix: str = "") -> Any:
    """Return the analysis, or the part of one of a kind, that `arrays_of_analysis` was given."""
    values: dict[str, Any] = {}
    for field, hint in get_type_hints(kind).items():
        name = f"{prefix}{field}"
        if any(one.startswith(f"{name}.") for one in arrays):
            held: Any = next(filter(dataclasses.is_dataclass, get_args(hint) or (hint,)))
            values[field] = analysis_of_arrays(arrays, held, f"{name}.")
        elif name in arrays:
            array = arrays[name]
            plain = array.item() if array.ndim == 0 else array
            values[field] = tuple(array.tolist()) if get_origin(hint) is tuple else plain
        elif NoneType in get_args(hint):
            values[field] = None
    return kind(**values)


def save_analysis(analysis: ClipAnalysis, path: Path) -> None:
    """Write a clip's analysis to a file."""
    write_arrays(path, arrays_of_analysis(analysis))


def load_analysis(path: Path) -> ClipAnalysis | None:
    """Return the analysis of a file, or None where there is none, or it is damaged or lacks some."""
    return _analysis_if_whole(read_arrays(path))


def _analysis_if_whole(arrays: Arrays | None) -> ClipAnalysis | None:
    try:
        return None if arrays is None else analysis_of_arrays(arrays)
    except TypeError:  # a field is missing
        return None


# Keys by which kept work is recognised: hashes of a scene, of the files that it names, and of the sources.

_FIRST_PASS = ("plate", "camera", "water", "light", "receiver", "sea", "caustics", "match")
"""Tables of a scene that the first pass depends on."""
_JOINED = ("sound",)
"""Settings of the output that act when segments are joined."""


@dataclass(frozen=True, slots=True)
class WorkKeys:
    """What kept work depends on. first_pass: of the clip's analysis. pictures: of the composited frames, encoded."""

    first_pass: str
    pictures: str


def input_fingerprints(loaded: Loaded) -> tuple[InputFile, ...]:
    """Return the fingerprints of all files that a scene reads, each once: those it names, and those that these name."""
    paths = dict.fromkeys([*_named(loaded.scene), *loaded.object_files, *loaded.other_files])
    return tuple(input_file(path) for path in paths if path.is_file())


def work_keys(loaded: Loaded, inputs: tuple[InputFile, ...], backend: str, measured: tuple[int, int]) -> WorkKeys:
    """Return the keys of a scene's work by a renderer. measured: frames [a, b) that its first pass reads."""
    scene = loaded.scene
    tables = scene.model_dump(mode="json")
    for name in _JOINED:
        del tables["output"][name]
    part = scene.model_copy(update={"objects": (), "lamps": (), "holdouts": ()})
    read = {*_named(part), *loaded.other_files}
    of_first_pass = [_mark(f) for f in inputs if f.path in read]
    keyed = [key for key in tables["keys"] if dotted(key["parameter"])[0] in _FIRST_PASS]
    first = [sources_stamp(), {name: tables[name] for name in _FIRST_PASS}, keyed, of_first_pass, measured]
    pictures = [sources_stamp(), tables, [_mark(f) for f in inputs], measured, backend]
    return WorkKeys(_hash(first), _hash(pictures))


def _named(scene: Scene) -> Iterator[Path]:
    """Yield the files that a scene names."""
    return (file for path in files_of(scene) for file in files_named(path))


def _mark(file: InputFile) -> list[Any]:
    return [str(file.path), file.size, file.digest, file.changed_ns]


def _hash(value: Any) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()
