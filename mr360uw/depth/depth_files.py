# SPDX-License-Identifier: Apache-2.0
"""Files of distance maps: those of `mr360uw depth`, and maps made elsewhere, as EXR or 16-bit PNG."""

from __future__ import annotations

import json
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.cache import Cache
from mr360uw.base.files import (
    NewFile,
    WrittenFiles,
    is_pattern,
    locked_work_folder,
    made_folder,
    matching_files,
    whole_file,
    work_path,
    write_whole,
)
from mr360uw.base.input_files import json_of, note_read, picture_size, read_text
from mr360uw.depth.sphere_stereo import DepthMap
from mr360uw.depth.warping import Map
from mr360uw.errors import OutputExistsError, VideoError
from mr360uw.video import read_picture
from mr360uw.video.exr import check_exr, read_exr, write_exr

Kind = Literal["metric", "inverse"]
_NOTE = "depth.json"
"""File in a folder of maps that says what they follow from, as JSON, and then has a line for each that was written."""
_MADE_BY = {"made_by": "mr360uw depth"}

LEFT, RIGHT = "left", "right"
"""Parts of a file with the maps of both eyes."""
_CONFIDENCE = "confidence"
"""Channel of a map's confidences, 0 to 1; a map without one is taken to be right everywhere."""
_APART = 4
"""Maps that are kept: renderers may be some frames apart."""


def depth_file(folder: Path, index: int) -> Path:
    """Return the name of the map of a frame."""
    return folder / f"depth_{index:05d}.exr"


def _inputs_of(folder: Path) -> dict[str, Any] | None:
    """Return what the maps in a folder follow from; None where this package did not write its note."""
    try:
        found = json_of(read_text(folder / _NOTE, VideoError).partition("\n")[0])
    except (VideoError, ValueError):
        return None
    return found if isinstance(found, dict) and found.items() >= _MADE_BY.items() else None


@contextmanager
def own_maps(folder: Path, inputs: Mapping[str, Any], count: int, *, overwrite: bool) -> Iterator[WrittenFiles]:
    """Yield the record of the maps of `count` frames in a folder, made if missing and locked.

    inputs: what the maps follow from; those of the same stay. overwrite: maps that were written from other inputs are
    removed. Raises `OutputExistsError` for these without it, and where files of others are in the way of any map: they
    are never replaced.
    """
    made, note = {**_MADE_BY, **inputs}, folder / _NOTE
    with made_folder(folder), locked_work_folder(work_path(folder / "depth"), folder) as scratch:
        # Refuse files of others, before anything is removed
        before = _inputs_of(folder)
        record = WrittenFiles(note, folder, logs=[note] if before is not None else (), scratch=scratch)
        maps = [depth_file(folder, index) for index in range(count)] if before else sorted(folder.glob("depth_*.exr"))
        foreign = [path for path in [note] * (before is None) + maps if not record.may_replace(path)]
        if foreign:
            more = f" and {len(foreign) - 1} more" * (len(foreign) > 1)
            raise OutputExistsError(
                f"{folder} - holds files that this command did not make, or that were changed since (got "
                f"{foreign[0].name}{more}) - move them, or name another folder"
            )
        # Say which of the inputs differ
        if before is not None and before != made and not overwrite:
            changed = ", ".join(
                sorted(name for name in before.keys() | made.keys() if before.get(name) != made.get(name))
            )
            raise OutputExistsError(
                f"{folder} - holds maps of another clip, track or width (got another {changed}) - name another folder, "
                "or let its maps be removed and made again with --overwrite"
            )
        # Remove what was written from other inputs, and begin a new record
        if before != made:
            for path in record.others(()):
                path.unlink()
            write_whole(note, json.dumps(made) + "\n")
            record = WrittenFiles(note, folder, scratch=scratch)
        yield record


def write_depth(path: Path, found: DepthMap, right: DepthMap | None = None, *, file: NewFile = whole_file) -> None:
    """Write a map as EXR: distances [m] in the channel Z, infinite where unknown, and confidences.

    right: of the right eye of a stereo plate, in a part of its own; the other is then the left eye's. file: opens the
    temporary file.
    """
    parts = {"": found} if right is None else {LEFT: found, RIGHT: right}
    channels: dict[str, dict[str, NDArray[Any]]] = {
        name: {"Z": one.distance_m, _CONFIDENCE: one.confidence.astype(np.float16)} for name, one in parts.items()
    }
    write_exr(path, channels, file=file)


class DepthClip:
    """Maps of a plate's frames: those of `mr360uw depth` in a folder, or others, the k-th by number for frame k.

    path: of the folder, or a pattern. kind: "metric" for distances, "inverse" for their inverse, in files of other
    programs. scale_m: metres for the value 1; of PNG files 1 is white. size: (width, height) of the plate, whose shape
    maps have, if not 2:1. Raises `VideoError` with a line for each problem.
    """

    def __init__(self, path: Path, kind: Kind = "metric", scale_m: float = 1.0, size: tuple[int, int] = (2, 1)) -> None:
        self._path, self._kind, self._scale = path, kind, scale_m
        self._kept = Cache()
        self._ours = path.is_dir() and _inputs_of(path) is not None
        self._files, notes, problems = ((), (), ()) if self._ours else _map_series(path)
        misfits, self._coloured = _header_problems(self._files, size)
        self._problems = [*problems, *misfits]
        self.notes = notes + self._other_notes()

    def _other_notes(self) -> tuple[str, ...]:
        """Return lines on what of the settings or of the folder has no effect."""
        if self._ours and (self._kind, self._scale) != ("metric", 1.0):
            return (
                f"plate.depth_kind, plate.depth_scale - change nothing (got {self._kind}, {self._scale:g}), as "
                f"{self._path} is of mr360uw depth, in metres - leave them out",
            )
        if not self._ours and (self._path / _NOTE).exists():
            return (
                f"{self._path / _NOTE} - is not of mr360uw depth, so that the maps beside it are taken for others'",
            )
        return ()

    def check(self, stop: int) -> None:
        """Raise `VideoError` if a map is missing or does not fit, up to the plate's frame `stop`."""
        self._raise([*self._problems, *self._missing(stop)])

    def check_all(self, stop: int, count: int | None) -> None:
        """Raise what `check` does, of maps that were changed or have colours too, and where they are more than frames.

        count: frames of the plate, None if they are not known. Takes the time to read the files.
        """
        problems, held = [*self._problems, *self._missing(stop)], len(self._files)
        if not self._ours and count is not None and held > count:
            problems.append(
                f"{self._path} - holds more maps than the plate has frames (got {held} for {count}) - remove those of "
                "other frames"
            )
        for path in [depth_file(self._path, k) for k in range(stop)] if self._ours else self._coloured:
            try:
                if path.is_file():
                    self._map(path)
            except VideoError as error:
                problems.append(str(error))
        self._raise(problems)

    def _missing(self, stop: int) -> list[str]:
        """Return a line on the maps that are missing."""
        if not self._ours:
            return [] if stop <= len(self._files) or self._problems else [
                f"{self._path} - has no map for frame {len(self._files)} (got {len(self._files)} files for {stop} "
                "frames) - add the missing ones"
            ]  # fmt: skip
        missing = [path for k in range(stop) if not (path := depth_file(self._path, k)).is_file()]
        more = f" ({len(missing)} of {stop} maps)"
        return [f"{one} - is missing{more} - run the same mr360uw depth again, which fills gaps" for one in missing[:1]]

    @staticmethod
    def _raise(problems: list[str]) -> None:
        if problems:
            raise VideoError("\n".join(problems))

    @property
    def of_both_eyes(self) -> bool:
        """Whether the first map has a part for each eye."""
        first = next(iter(sorted(self._path.glob("depth_*.exr"))), None) if self._ours else None
        return first is not None and RIGHT in read_exr(first)

    def at(self, index: int, *, right: bool = False) -> DepthMap:
        """Return the map of a frame at its own size, the same object while its file is unchanged.

        right: that of the right eye, of files that hold both eyes'.
        """
        self._raise([*self._problems, *(self._missing(index + 1) if not self._ours else ())])
        return self._map(depth_file(self._path, index) if self._ours else self._files[index], right=right)

    def _map(self, path: Path, *, right: bool = False) -> DepthMap:
        """Return the map in a file; raise `VideoError` where one of ours is not as it was written."""
        if self._ours and not self._kept.of(_record, self._path).has(path):
            what = "is not as mr360uw depth wrote it" if path.is_file() else "is missing"
            raise VideoError(f"{path} - {what} - run the same mr360uw depth again, which makes it anew")
        return self._kept.of(_read_map, path, self._kind, self._scale, self._ours, right, keep=_APART)


def _record(folder: Path) -> WrittenFiles:
    """Return the record of the maps that were written into a folder."""
    note_read(folder / _NOTE)
    return WrittenFiles(folder / _NOTE, folder, logs=[folder / _NOTE])


def _read_map(path: Path, kind: Kind, scale_m: float, ours: bool, right: bool) -> DepthMap:
    """Return the map in a file. ours: written by `write_depth`; else kind and scale count. right: of two eyes.

    Raises `VideoError` where there are different values in its channels red, green and blue.
    """
    confidence: Map | None = None
    if path.suffix.lower() == ".exr":
        parts = read_exr(path)
        if ours and RIGHT in parts:
            parts = {name: part for name, part in parts.items() if (name == RIGHT) == right}
        channels = {name: array for part in parts.values() for name, array in part.items()}
        confidence = channels.get(_CONFIDENCE)
        values = channels["Z"] if "Z" in channels else _grey(path, read_picture(path))
    else:
        codes = _grey(path, read_picture(path))
        values = codes / np.float32(np.iinfo(codes.dtype).max)
    metres = np.asarray(values, np.float32)
    if not ours:
        with np.errstate(divide="ignore"):
            metres = np.float32(scale_m) * (metres if kind == "metric" else np.float32(1.0) / metres)
    known = np.isfinite(metres) & (metres > 0.0)
    sure = np.ones(metres.shape, np.float32) if confidence is None else np.asarray(confidence, np.float32)
    return DepthMap(np.where(known, metres, np.float32(np.inf)), np.where(known, sure, np.float32(0.0)))


def _grey(path: Path, colours: NDArray[Any]) -> NDArray[Any]:
    """Return the one value of pixels whose channels are the same (H, W, 3); raise `VideoError` where they are not."""
    if any(not np.array_equal(colours[..., 0], colours[..., k], equal_nan=True) for k in (1, 2)):
        raise VideoError(
            f"{path} - is a picture in colours (got three different channels) - give distances, as grey or Z"
        )
    return colours[..., 0]


# Distance maps of other programs: which files of a folder they are, in which order, and whether they fit the plate.

_SUFFIXES = (".exr", ".png")
_NUMBERED = re.compile(r"(.*?)(\d+)(\D*)")
"""Name of a numbered file, whose last number counts."""
_PNG_HEAD, _PNG_TAIL = 32, 64
"""Bytes at the beginning of a PNG that hold its size and kind, and at its end that hold its last chunk."""
_GREY = (0, 4)
"""Kinds of PNG without colours (PNG specification, table 11.1)."""


_Series = tuple[tuple[Path, ...], tuple[str, ...], tuple[str, ...]]
"""Maps in the order of their numbers, of which the k-th is that of frame k; notes; and why they cannot be used."""


def _map_series(path: Path) -> _Series:
    """Return the maps that a folder, a pattern of numbered files or a name stands for; hidden files are left out."""
    if is_pattern(path):
        return _in_order(path, matching_files(path), ())
    if not path.is_dir():
        return (path,), (), ()
    # Group numbered pictures by what their names have in common
    files = [one for one in sorted(path.iterdir()) if one.suffix.lower() in _SUFFIXES and one.name[0] != "."]
    series = defaultdict[str, list[tuple[int, Path]]](list)
    others = [one for one in files if _NUMBERED.fullmatch(one.name) is None]
    for one in files:
        if found := _NUMBERED.fullmatch(one.name):
            series[f"{found[1]}%d{found[3]}"].append((int(found[2]), one))
    # Take the one series, or the one picture of a still; say why none is taken otherwise
    if len(series) == 1:
        return _in_order(path, next(iter(series.values())), others)
    if not series and len(others) == 1:
        return tuple(others), (), ()
    if series:
        got = ", ".join(f"{len(of)} of {name}" for name, of in series.items())
        problem = f'several series of pictures (got {got:.300}) - name the maps: "{path.name}/{next(iter(series))}"'
    elif others:
        problem = f"maps whose names have no number (got {_some(others)}) - number them as the frames of the plate"
    else:
        problem = "no maps (got no .exr and no .png) - run mr360uw depth into it"
    return (), (), (f"{path} - holds {problem}",)


def _in_order(path: Path, numbered: list[tuple[int, Path]], others: Iterable[Path]) -> _Series:
    """Return numbered maps in their order, with a problem where a number is missing or there twice."""
    numbered = sorted(numbered)
    problems = [] if numbered else [f"{path} - holds no maps (got no file of that pattern) - check the pattern"]
    for (first, one), (second, two) in pairwise(numbered):
        if second == first:
            problems.append(f"{two} - has the number of another map (got {one.name}) - remove one of them")
        elif second > first + 1:
            problems.append(f"{path} - lacks map {first + 1} (got {one.name} before {two.name}) - add the missing ones")
    notes = [f"{one} - has no number, so that it is not read as a map" for one in others]
    if numbered and numbered[0][0] > 1:
        notes.append(f"{path} - {numbered[0][1].name} is taken as the map of the plate's frame 0, the next of frame 1")
    return tuple(one for _, one in numbered), tuple(notes), tuple(problems)


def _map_header(path: Path) -> tuple[tuple[int, int], bool, bool]:
    """Return the size in a map's file, whether it has one value for a pixel, and whether it holds all pixels.

    Raises `VideoError` where it is cut or of another kind, and `OSError`.
    """
    if path.suffix.lower() == ".exr":
        parts = check_exr(path)
        part = next((one for one in parts if "Z" in one.channels), parts[0])
        return (part.width, part.height), bool({"Z", "Y"} & set(part.channels)), part.whole
    with path.open("rb") as file:
        head = file.read(_PNG_HEAD)
        file.seek(max(file.seek(0, 2) - _PNG_TAIL, 0))
        tail = file.read()
    size = picture_size(head)
    if size is None or len(head) < _PNG_HEAD or b"IEND" not in tail:
        raise VideoError(f"{path} - is no PNG that can be read, or it is cut short - copy or write it again")
    return size, head[25] in _GREY, True


def _header_problems(files: Sequence[Path], plate: tuple[int, int]) -> tuple[list[str], list[Path]]:
    """Return why maps do not fit a plate of width x height, a line for each reason, and the maps that have colours."""
    # Read what each file says of itself
    problems, sizes, cropped, coloured = [], dict[Path, tuple[int, int]](), [], []
    for path in files:
        try:
            sizes[path], grey, whole = _map_header(path)
            cropped += [] if whole else [path]
            coloured += [] if grey else [path]
        except VideoError as error:
            problems.append(str(error))
        except OSError as error:
            problems.append(f"{path} - cannot be read (got {error.strerror}) - check its rights")
    # Name each kind of misfit once, by its first file
    if cropped:
        problems.append(
            f"{_some(cropped)} - holds a part of the frame (its data window is not the display window) - write it whole"
        )
    if other := [path for path, size in sizes.items() if not _is_panorama(size, plate)]:
        problems.append(
            f"{_some(other)} - is no panorama of the plate's shape (got {_shape(sizes[other[0]])} for a plate "
            f"of {_shape(plate)}) - make it from the same frames, 2:1"
        )
    different = {size: path for path, size in sizes.items()}
    if len(different) > 1:
        got = ", ".join(f"{path.name} of {_shape(size)}" for size, path in different.items())
        problems.append(f"{files[0].parent} - holds maps of several sizes (got {got:.300}) - make all of one size")
    return problems, coloured


def _is_panorama(size: tuple[int, int], plate: tuple[int, int]) -> bool:
    """Return whether a size is that of a whole sphere, 2:1, or has the shape of the plate, to a row of either."""
    (width, height), (wide, high) = size, plate
    of_plate = abs(width * high - height * wide) <= max(width, wide)
    return abs(width - 2 * height) <= 2 or of_plate


def _shape(size: tuple[int, int]) -> str:
    return f"{size[0]}x{size[1]}"


def _some(files: list[Path]) -> str:
    """Return the first of files, and how many more there are."""
    return f"{files[0]}{f' and {len(files) - 1} more' * (len(files) > 1)}"
