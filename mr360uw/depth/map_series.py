# SPDX-License-Identifier: Apache-2.0
"""Distance maps of other programs: which files of a folder they are, in which order, and whether they fit the plate."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from mr360uw.errors import VideoError
from mr360uw.reading.numbered_files import is_pattern, matching_files
from mr360uw.reading.picture_size import picture_size
from mr360uw.video.exr import check_exr

_SUFFIXES = (".exr", ".png")
_NUMBERED = re.compile(r"(.*?)(\d+)(\D*)")
"""Name of a numbered file, whose last number counts."""
_PNG_HEAD, _PNG_TAIL = 32, 64
"""Bytes at the beginning of a PNG that hold its size and kind, and at its end that hold its last chunk."""
_GREY = (0, 4)
"""Kinds of PNG without colours (PNG specification, table 11.1)."""


@dataclass(frozen=True, slots=True)
class MapSeries:
    """Maps in the order of their numbers: the k-th is that of frame k.

    notes: what else there is to know. problems: why they cannot be used, one line each.
    """

    files: tuple[Path, ...] = ()
    notes: tuple[str, ...] = ()
    problems: tuple[str, ...] = ()


def map_series(path: Path) -> MapSeries:
    """Return the maps that a folder, a pattern of numbered files or a name stands for; hidden files are left out."""
    if is_pattern(path):
        return _in_order(path, matching_files(path), ())
    if not path.is_dir():
        return MapSeries((path,))
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
        return MapSeries(tuple(others))
    if series:
        got = ", ".join(f"{len(of)} of {name}" for name, of in series.items())
        problem = f'several series of pictures (got {got:.300}) - name the maps: "{path.name}/{next(iter(series))}"'
    elif others:
        problem = f"maps whose names have no number (got {_some(others)}) - number them as the frames of the plate"
    else:
        problem = "no maps (got no .exr and no .png) - run mr360uw depth into it"
    return MapSeries(problems=(f"{path} - holds {problem}",))


def _in_order(path: Path, numbered: list[tuple[int, Path]], others: Iterable[Path]) -> MapSeries:
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
    return MapSeries(tuple(one for _, one in numbered), tuple(notes), tuple(problems))


@dataclass(frozen=True, slots=True)
class MapHeader:
    """What a map's file says of it. grey: whether it has one value for a pixel. whole: whether it holds all pixels."""

    size: tuple[int, int]
    grey: bool
    whole: bool = True


def map_header(path: Path) -> MapHeader:
    """Return what a map's file says of it; raise `VideoError` where it is cut or of another kind, and `OSError`."""
    if path.suffix.lower() == ".exr":
        parts = check_exr(path)
        part = next((one for one in parts if "Z" in one.channels), parts[0])
        return MapHeader((part.width, part.height), bool({"Z", "Y"} & set(part.channels)), part.whole)
    with path.open("rb") as file:
        head = file.read(_PNG_HEAD)
        file.seek(max(file.seek(0, 2) - _PNG_TAIL, 0))
        tail = file.read()
    size = picture_size(head)
    if size is None or len(head) < _PNG_HEAD or b"IEND" not in tail:
        raise VideoError(f"{path} - is no PNG that can be read, or it is cut short - copy or write it again")
    return MapHeader(size, head[25] in _GREY)


def header_problems(files: Sequence[Path], plate: tuple[int, int]) -> tuple[list[str], list[Path]]:
    """Return why maps do not fit a plate of width x height, a line for each reason, and the maps that have colours."""
    # Read what each file says of itself
    problems, headers = [], dict[Path, MapHeader]()
    for path in files:
        try:
            headers[path] = map_header(path)
        except VideoError as error:
            problems.append(str(error))
        except OSError as error:
            problems.append(f"{path} - cannot be read (got {error.strerror}) - check its rights")
    # Name each kind of misfit once, by its first file
    if cropped := [path for path, header in headers.items() if not header.whole]:
        problems.append(
            f"{_some(cropped)} - holds a part of the frame (its data window is not the display window) - write it whole"
        )
    if other := [path for path, header in headers.items() if not _is_panorama(header.size, plate)]:
        problems.append(
            f"{_some(other)} - is no panorama of the plate's shape (got {_shape(headers[other[0]].size)} for a plate "
            f"of {_shape(plate)}) - make it from the same frames, 2:1"
        )
    sizes = {header.size: path for path, header in headers.items()}
    if len(sizes) > 1:
        got = ", ".join(f"{path.name} of {_shape(size)}" for size, path in sizes.items())
        problems.append(f"{files[0].parent} - holds maps of several sizes (got {got:.300}) - make all of one size")
    return problems, [path for path, header in headers.items() if not header.grey]


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
