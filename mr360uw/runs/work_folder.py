# SPDX-License-Identifier: Apache-2.0
"""Work of runs that is kept: the clip analysis as a file, the keys by which work is recognised, and the folder beside
an output that holds its segments, or the list of its numbered pictures, until it is complete.
"""

from __future__ import annotations

import dataclasses
import hashlib
import itertools
import json
import secrets
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from types import NoneType
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np
from filelock import Timeout
from numpy.typing import NDArray

from mr360uw.base.disk_cache import (
    cache_file,
    read_arrays,
    sources_stamp,
    write_arrays,
)
from mr360uw.base.files import (
    LOCK,
    MARKER,
    SUFFIX,
    WrittenFiles,
    files_named,
    is_work_folder,
    locked_work_folder,
    remove_work_folder,
    work_lock,
    work_path,
    write_whole,
)
from mr360uw.base.input_files import InputFile, input_file, read_json, stamp
from mr360uw.errors import OutputError
from mr360uw.render.first_pass import ClipAnalysis
from mr360uw.render.loaded import Loaded
from mr360uw.scene.model import Scene, files_of
from mr360uw.scene.toml_model import dotted
from mr360uw.video import VideoReader
from mr360uw.video.clip import projection_of
from mr360uw.video.writer import Segment, stored_segments

# The clip analysis as a file: measured once, and kept for later runs over the same plate and settings.


def analysis_file(loaded: Loaded, video: VideoReader, keys: WorkKeys) -> Path | None:
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


def load_analysis(path: Path, *, kept: bool = False) -> ClipAnalysis | None:
    """Return the analysis of a file, or None where there is none, or it is damaged or lacks some.

    kept: it is one of the cache.
    """
    arrays = read_arrays(path, kept=kept)
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


Part = tuple[int, int]
"""Frames [start, stop) of a clip."""


def segment_bounds(start: int, stop: int, length: int) -> list[Part]:
    """Return the parts [a, b) of a range: cut at multiples of `length`, so that ranges share the parts inside them."""
    cuts = [start, *range((start // length + 1) * length, stop, length), stop]
    return list(itertools.pairwise(cuts))


def joined_bounds(parts: list[Part]) -> list[Part]:
    """Return ascending parts with those that follow each other made one."""
    found: list[Part] = []
    for start, stop in parts:
        follows = bool(found) and found[-1][1] == start
        found.append((found.pop()[0] if follows else start, stop))
    return found


_KEYS, _ANALYSIS, _WRITTEN, _EARLIER = "run.json", "analysis.npz", "written-", "earlier-"


@dataclass(frozen=True, slots=True)
class WorkFolder:
    """Work of one run, or of a killed one that it continues.

    keys: what it depends on. notes: what of it was kept or is done again. overwrite: whether files of others may be
    replaced.
    """

    path: Path
    keys: WorkKeys
    notes: tuple[str, ...] = ()
    overwrite: bool = False

    def analysis(self) -> ClipAnalysis | None:
        """Return the stored analysis of the clip, or None."""
        return load_analysis(self.path / _ANALYSIS)

    def keep_analysis(self, analysis: ClipAnalysis) -> None:
        """Store the analysis of the clip."""
        write_arrays(self.path / _ANALYSIS, arrays_of_analysis(analysis))

    def segments(self) -> list[Segment]:
        """Return the complete segments by their first frame."""
        return stored_segments(self.path)

    def files(self, start: int = 0) -> WrittenFiles:
        """Return the record of pictures and layers. start: first frame of the range that writes, which has a log."""
        logs, earlier = (sorted(self.path.glob(f"{kind}*")) for kind in (_WRITTEN, _EARLIER))
        return WrittenFiles(
            self.path / f"{_WRITTEN}{start}", self.path.parent, logs=logs, earlier=earlier, scratch=self.path,
            overwrite=self.overwrite,
        )  # fmt: skip


@contextmanager
def work_folder(out: Path, keys: WorkKeys, *, fresh: bool = False, overwrite: bool = False) -> Iterator[WorkFolder]:
    """Yield an output's work folder, locked; it is removed at the end, or kept where an exception leaves work to reuse.

    fresh: nothing of an earlier run is used. overwrite: files of others may be replaced. Raises `OutputExistsError` if
    another run holds it, `OutputError` where the name is that of something else, and `OSError`.
    """
    with locked_work_folder(work_path(out), out, _has_work) as path:
        yield WorkFolder(path, keys, _continued(path, keys, fresh=fresh), overwrite)


def _continued(path: Path, keys: WorkKeys, *, fresh: bool) -> tuple[str, ...]:
    """Remove what does not fit the keys, but for the names of files that were written; return notes about it."""
    before = _stored_keys(path)
    notes = []
    same_pass = not fresh and before.get("first_pass") == keys.first_pass
    same_pictures = not fresh and before.get("pictures") == keys.pictures
    if before and not fresh and not same_pictures:
        kept = "the first pass is kept" if same_pass else "the first pass too"
        notes.append(f"the scene changed since the run that was stopped: its frames are made again, {kept}")
    for file in path.iterdir():
        keeps = file.name in (LOCK, MARKER) or (same_pass if file.name == _ANALYSIS else same_pictures)
        if file.name.startswith(_WRITTEN) and not keeps:
            file.rename(path / f"{_EARLIER}{secrets.token_hex(4)}")
        elif not (keeps or file.name.startswith(_EARLIER)):
            file.unlink()
    write_whole(path / _KEYS, json.dumps(asdict(keys), indent=2) + "\n")
    return tuple(notes)


def _has_work(path: Path) -> bool:
    """Return whether a folder holds segments, notes of files that were written, or a measured analysis."""
    analysis = load_analysis(path / _ANALYSIS)
    measured = analysis is not None and any(
        one is not None for one in (analysis.sun, analysis.gain, analysis.background)
    )
    return measured or bool(stored_segments(path)) or any(path.glob(f"{_WRITTEN}*")) or any(path.glob(f"{_EARLIER}*"))


def _stored_keys(path: Path) -> dict[str, Any]:
    try:
        found = read_json(path / _KEYS, OutputError)
    except OutputError:
        return {}
    return found if isinstance(found, dict) else {}


def remove_stale(where: Path, *, dry_run: bool) -> list[str]:
    """Remove the work folders in a folder that no run holds, or only list them; return a line for each."""
    lines = []
    for path in stale_work(where):
        size = sum(file.stat().st_size for file in path.iterdir())
        if not dry_run:
            remove_work_folder(path)
        lines.append(f"{'found' if dry_run else 'removed'} {path} ({size / 1e6:.1f} MB)")
    return lines


def stale_notes(where: Path) -> list[str]:
    """Return a line for each folder of finished parts that a stopped run left in a folder."""
    advice = "the same command goes on, mr360uw clean removes them"
    return [
        f"note      {path} - holds finished parts of a run that was stopped - {advice}" for path in stale_work(where)
    ]


def stale_work(where: Path) -> list[Path]:
    """Return the work folders in a folder that no run holds."""
    found = []
    for path in sorted(where.glob(f"*{SUFFIX}")):
        if is_work_folder(path):
            try:
                with work_lock(path).acquire(timeout=0):
                    found.append(path)
            except Timeout:
                continue
    return found
