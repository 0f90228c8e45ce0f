# SPDX-License-Identifier: Apache-2.0
"""A matte of something in the plate, from a rough outline, strokes, or both: GrabCut, edges as the picture has them.

What is outside of an outline is taken as background, what is inside as one or the other by its colours (Rother et al.
2004, "GrabCut"). Strokes over the thing and beside it say what its pixels and those of the background are; without an
outline all others go by the colours of both. The edge follows the picture by a guided filter (He et al. 2013).
"""

from __future__ import annotations

import hashlib
import re
import struct
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Literal, get_args

import cv2
import numpy as np
from numpy.typing import NDArray

from mr360uw.base.files import matching_files, write_whole
from mr360uw.base.sphere import basis, direction_from_frame, frame_from_direction, row_solid_angle, unit
from mr360uw.errors import OutputError, ParameterError
from mr360uw.preview.screen import narrowed
from mr360uw.tune.placing import Point, pixel_of_point
from mr360uw.types import Floats

Stroke = tuple[Point, ...]
Kind = Literal["outline", "inside", "outside"]
"""What is drawn: points or a line around the thing, a stroke over it, or one over what it is not."""
Line = tuple[Kind, Stroke]

_MARGIN = 0.35
"""Picture beside the outline whose colours are those of the background, over the outline's longer side."""
_BESIDE = 1.0
"""The same for strokes without an outline, whose thing may reach beyond them."""
_CUT_PX = 480
"""Longer side of the picture that is cut: a second on one core."""
_STROKE_PX = 5
"""Width of a stroke in the picture that is cut: a finger's line, well inside of things that fill a tenth of it."""
_ROUNDS = 4
_EDGE_PX, _EDGE_SPREAD = 2, 1e-2
"""Radius of the filter of edges, in pixels of the picture that is cut, and the variance of values that is no edge: with
a tenth of it the matte follows noise, with a radius of 6 edges are twice as far off."""
_OUTLINE_PX = 1024
"""Width of the panorama in which outlines of mattes are looked for; finer ones cannot be told apart on a screen."""


def is_whole(lines: Sequence[Line]) -> bool:
    """Return whether lines say what a matte is of: an outline of three points, or strokes over and beside the thing."""
    outline, inside, outside = _sorted(lines)
    return len(outline) > 2 or bool(not outline and inside and outside)


def _sorted(lines: Sequence[Line]) -> tuple[Stroke, list[Stroke], list[Stroke]]:
    """Return the outline, the strokes over the thing, and those beside it. Lines around it are one, in turn."""
    outline, inside, outside = ([points for kind, points in lines if kind == wanted] for wanted in get_args(Kind))
    return tuple(point for points in outline for point in points), inside, outside


def matte_of_lines(picture: NDArray[np.uint8], lines: Sequence[Line]) -> NDArray[np.uint8]:
    """Return the matte (h, w), 0 to 255, of what is drawn around or over in a panorama (h, w, 3).

    lines: may cross the seam, and no pole. Raises `ParameterError` where too little is drawn, or nothing stands out.
    """
    height, width = picture.shape[:2]
    outline, inside, outside = _sorted(lines)
    if not is_whole(lines):
        raise ParameterError(
            "matte - needs an outline of three points, or a stroke over the thing and one beside it "
            f"(got {len(outline)} points, {len(inside)} and {len(outside)} strokes) - click around the thing"
        )
    first = (outline or inside[0])[0]
    turn = int(width // 2 - pixel_of_point(first, width, height)[0])
    around, *strokes = (_turned(line, turn, width, height) for line in (outline, *inside, *outside))
    over, beside = strokes[: len(inside)], strokes[len(inside) :]  # the first point is in the middle: the seam is far
    bounded = np.concatenate([around, *over] if outline else strokes)
    low, high = bounded.min(axis=0), bounded.max(axis=0)
    margin = (_MARGIN if outline else _BESIDE) * float((high - low).max()) + 4.0
    x0, y0 = (max(int(v), 0) for v in low - margin)
    x1, y1 = (min(int(v) + 1, most) for v, most in zip(high + margin, (width, height), strict=True))
    part = np.ascontiguousarray(np.roll(picture, turn, axis=1)[y0:y1, x0:x1])
    alpha = _cut_out(part, *([line - (x0, y0) for line in some] for some in ([around], over, beside)))
    whole = np.zeros((height, width), np.uint8)
    whole[y0:y1, x0:x1] = alpha
    return np.roll(whole, -turn, axis=1)


def _turned(line: Sequence[Point], turn: int, width: int, height: int) -> Floats:
    """Return the pixels (n, 2) of points in a panorama that is rolled by `turn` columns."""
    places = np.array([pixel_of_point(point, width, height) for point in line]).reshape(-1, 2)
    places[:, 0] = (places[:, 0] + turn) % width
    return places


def _cut_out(
    part: NDArray[np.uint8], around: Sequence[Floats], inside: Sequence[Floats], outside: Sequence[Floats]
) -> NDArray[np.uint8]:
    """Return the matte (h, w) of a part of a picture (h, w, 3). around: the outline. Lines: (n, 2) of x and y."""
    (outline,), (height, width) = around, part.shape[:2]
    scale = min(_CUT_PX / max(height, width), 1.0)
    size = max(round(width * scale), 8), max(round(height * scale), 8)
    small = cv2.resize(part, size, interpolation=cv2.INTER_AREA)
    per_pixel = np.divide(size, (width, height))
    within = np.zeros(small.shape[:2], np.uint8)
    if len(outline):
        cv2.fillPoly(within, [np.rint(outline * per_pixel).astype(np.int32)], 1)
        if not np.any(within):
            raise ParameterError("matte - the outline holds no pixel (got a line) - click around the thing")
    labels = np.where(within > 0, cv2.GC_PR_FGD, cv2.GC_BGD).astype(np.uint8)
    over, beside = (_painted(some, per_pixel, small.shape[:2]) for some in (inside, outside))
    labels[beside] = cv2.GC_BGD
    labels[over] = cv2.GC_FGD
    cv2.setRNGSeed(0)  # its first clusters are drawn at random
    try:
        if len(outline):
            cv2.grabCut(small, labels, None, np.zeros((1, 65)), np.zeros((1, 65)), _ROUNDS, cv2.GC_INIT_WITH_MASK)
        else:
            labels = _cut_by_strokes(small, over, beside & ~over)
    except cv2.error:
        labels[:] = cv2.GC_BGD
    found = ((labels == cv2.GC_FGD) | (labels == cv2.GC_PR_FGD)).astype(np.float32)
    if not np.any(found):
        raise ParameterError("matte - nothing stands out there (got one colour) - draw the outline wider")
    found = cv2.resize(found, (width, height), interpolation=cv2.INTER_LINEAR)
    guide = part.astype(np.float32) / 255.0
    soft = cv2.ximgproc.guidedFilter(guide, found, max(round(_EDGE_PX / scale), 1), _EDGE_SPREAD)
    return np.rint(255.0 * np.clip(soft, 0.0, 1.0)).astype(np.uint8)


def _painted(strokes: Sequence[Floats], per_pixel: Floats, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Return the pixels (h, w) of a small picture that strokes cover. per_pixel: its pixels for one of theirs, (2,)."""
    covered = np.zeros(shape, np.uint8)
    for stroke in strokes:
        places = np.rint(stroke * per_pixel).astype(np.int32)
        cv2.circle(covered, places[0].tolist(), _STROKE_PX // 2, 1, -1)
        for one, other in pairwise(places.tolist()):
            cv2.line(covered, one, other, 1, _STROKE_PX)
    return covered > 0


def _cut_by_strokes(small: NDArray[np.uint8], over: NDArray[np.bool_], beside: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Return GrabCut's labels (h, w) of a picture (h, w, 3) of which strokes alone are known.

    Colours are learnt from the strokes, then everything is labelled by them, and learnt from that. What is not joined
    to a stroke over the thing is none of it.
    """
    known = np.concatenate([small[over], small[beside]])[:, None]
    of_known = np.full((len(known), 1), cv2.GC_BGD, np.uint8)
    of_known[: int(over.sum())] = cv2.GC_FGD
    background, thing = np.zeros((1, 65)), np.zeros((1, 65))
    cv2.grabCut(known, of_known, None, background, thing, 0, cv2.GC_INIT_WITH_MASK)
    labels = np.full(small.shape[:2], cv2.GC_PR_BGD, np.uint8)
    labels[beside] = cv2.GC_BGD
    labels[over] = cv2.GC_FGD
    cv2.grabCut(small, labels, None, background, thing, 1, cv2.GC_EVAL_FREEZE_MODEL)
    cv2.grabCut(small, labels, None, background, thing, _ROUNDS - 1, cv2.GC_EVAL)
    found = np.isin(labels, (cv2.GC_FGD, cv2.GC_PR_FGD))
    _, pieces = cv2.connectedComponents(found.astype(np.uint8), connectivity=4)
    labels[found & ~np.isin(pieces, np.unique(pieces[over & found]))] = cv2.GC_PR_BGD
    return labels


def outlines_of_matte(matte: NDArray[np.uint8]) -> list[list[Point]]:
    """Return closed lines around the parts of a matte (h, w), 0 to 255, where it is half covered."""
    matte = narrowed(matte, _OUTLINE_PX)
    height, width = matte.shape
    turn = -int(np.argmin(matte.sum(axis=0, dtype=np.int64)))  # the seam is where there is least of it
    found, _ = cv2.findContours(
        (np.roll(matte, turn, axis=1) > 127).astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE
    )
    lines = []
    for contour in found:
        places = cv2.approxPolyDP(contour, 0.6, closed=True)[:, 0] + 0.5
        longitude = ((places[:, 0] - turn) % width / width - 0.5) * 2.0 * np.pi
        latitude = (0.5 - places[:, 1] / height) * np.pi
        points = [Point(float(a), float(b)) for a, b in zip(longitude, latitude, strict=True)]
        lines.append([*points, points[0]])
    return lines


_NAMES = re.compile(r"matte-\d+")


def is_matte_name(name: str) -> bool:
    """Return whether a name is one that `free_name` gives."""
    return _NAMES.fullmatch(name) is not None


def free_name(folder: Path) -> str:
    """Return the first name of a matte, as "matte-1", that no picture and no folder has in a folder."""
    taken = {path.stem for path in folder.iterdir()}
    return next(name for k in range(1, 1 << 20) if (name := f"matte-{k}") not in taken)


# Mattes that move: drawn at some frames of a clip, the keys, and carried from one to the next.
#
# A matte of a clip is a folder beside the scene: `key-0012.png` is what was drawn at frame 12, `0000.png` and so on are
# the pictures of all frames, a sequence as `holdout.path` takes it. One key alone is a still that serves all frames.
#
# Between two keys the middle of the thing moves along a great circle, and its outline changes evenly: signed distances
# [pixels] to the outlines of both keys, positive inside, each about its own middle and upright, are weighted by time.
# That needs no picture, and holds across the seam; things that turn about between two keys need more of them.
#
# Every picture ends in a comment with the hash of the rest: one without it, or changed since, is never replaced.

FRAMES = "%04d.png"
"""Names of the pictures of all frames in a matte's folder."""
_KEYS = "key-%04d.png"
_KEY_EDGE_PX = 2.0
"""Width [pixels of the plate] over which a carried matte goes from 0 to 1, about that of a lens's edge."""
_ROOM = 1.1
"""Radius of the part that is carried, over that of the matte about its middle: room for the outline's distances."""
_PART_PX = (32, 1024)
"""Least and most pixels across that part; more of them than pixels of the plate show nothing."""

_END, _SEAL = 12, 12 + len(b"mr360uw matte\0") + 64
"""Bytes of a PNG's last chunk, and of the chunk with its hash."""

Matte = NDArray[np.uint8]
"""(h, w) of the plate's shape, 0 to 255: white is before the objects."""


def png(matte: Matte) -> bytes:
    """Return a matte as PNG, with the comment by which `check_own` knows it."""
    return _sealed(bytes(cv2.imencode(".png", matte, (cv2.IMWRITE_PNG_COMPRESSION, 1))[1]))


def _sealed(plain: bytes) -> bytes:
    """Return a PNG with a text chunk of its hash before its last chunk."""
    text = b"tEXtmr360uw matte\0" + hashlib.sha256(plain).hexdigest().encode()
    seal = struct.pack(">I", len(text) - 4) + text + struct.pack(">I", zlib.crc32(text))
    return plain[:-_END] + seal + plain[-_END:]


def check_own(files: Iterable[Path]) -> None:
    """Raise `OutputError` where one of the files is there and is not what was written from `png`, unchanged."""
    for file in files:
        data = file.read_bytes() if file.is_file() else b""
        if file.exists() and data != _sealed(data[: -_END - _SEAL] + data[-_END:]):
            raise OutputError(
                f"{file} - is no matte that was drawn here, or was changed since - draw a new matte, or move it away"
            )


def pictures_at_stake(folder: Path, index: int) -> list[Path]:
    """Return the pictures of a matte's folder that a new key at a frame may replace."""
    return [key_file(folder, index), *(file for _, file in matching_files(folder / FRAMES))]


def key_file(folder: Path, index: int) -> Path:
    """Return the picture of a matte's key at a frame."""
    return folder / (_KEYS % index)


def key_files(folder: Path) -> dict[int, Path]:
    """Return the pictures of a matte's keys by frame, ascending."""
    return dict(matching_files(folder / _KEYS))


def named_path(folder: Path) -> Path:
    """Return what `holdout.path` names for a matte's folder: its only key, or the pictures of all frames."""
    keys = key_files(folder)
    return next(iter(keys.values())) if len(keys) == 1 else folder / FRAMES


def write_frames(folder: Path, count: int, around: int, progress: Callable[[int, int], None]) -> None:
    """Write the pictures of a clip's frames that the key at a frame, set or removed, has changed: up to its neighbours.

    count: frames of the clip. progress: called with (done, total). Of two keys, and where pictures are missing, all are
    written; of a single key none. Raises `OSError`, and `ParameterError` where a key is no matte of the others' size.
    """
    keys = key_files(folder)
    if len(keys) < 2:
        return
    there = {index for index, _ in matching_files(folder / FRAMES)}
    before = max((k for k in keys if k < around), default=-1)
    after = min((k for k in keys if k > around), default=count)
    todo = [k for k in range(count) if len(keys) == 2 or before < k < after or k not in there]
    matte = CarriedMatte({index: read_matte(file) for index, file in keys.items()})
    last, data = None, b""
    for done, index in enumerate(todo):
        progress(done, len(todo))
        now = matte.at(index)
        last, data = now, data if now is last else png(now)
        write_whole(folder / (FRAMES % index), data)
    progress(len(todo), len(todo))


def read_matte(file: Path) -> Matte:
    """Return the matte of a file; raise `ParameterError` where it is none."""
    found = cv2.imdecode(np.frombuffer(file.read_bytes(), np.uint8), cv2.IMREAD_GRAYSCALE)
    if found is None:
        raise ParameterError(f"{file} - is no picture that can be read (got none) - remove it, and draw it again")
    return found.astype(np.uint8, copy=False)


class CarriedMatte:
    """A matte over the frames of a clip. keys: mattes of one shape (h, w) by frame, ascending."""

    def __init__(self, keys: Mapping[int, Matte]) -> None:
        self._keys, self._between = dict(keys), dict[tuple[int, int], _Carrier]()
        shapes = {matte.shape for matte in keys.values()}
        if len(shapes) > 1:
            raise ParameterError(f"matte - its keys differ in size (got {sorted(shapes)}) - draw them again")

    def at(self, index: int) -> Matte:
        """Return the matte (h, w) of a frame; before the first and after the last key theirs, the same object."""
        earlier, later = [k for k in self._keys if k <= index], [k for k in self._keys if k >= index]
        if not earlier or not later:
            return self._keys[max(earlier) if earlier else min(later)]
        start, end = max(earlier), min(later)
        if start == end:
            return self._keys[start]
        if (start, end) not in self._between:
            self._between = {(start, end): _Carrier(self._keys[start], self._keys[end])}
        return self._between[start, end].at((index - start) / (end - start))


class _Carrier:
    """Goes from one matte (h, w) to another one.

    Both are sampled about their middles, upright, on planes where angles from the middle are lengths (azimuthal
    equidistant): (n, n) points up to `_radius` [rad] to each side.
    """

    def __init__(self, start: Matte, end: Matte) -> None:
        self._shape, width = start.shape, start.shape[1]
        around = [_middle(matte) for matte in (start, end)]
        self._middle = [middle for middle, _ in around]
        self._radius = _ROOM * max(radius for _, radius in around) + 4.0 * 2.0 * np.pi / width
        wanted = round(2.0 * self._radius * width / (2.0 * np.pi))
        self._count = int(np.clip(wanted, *_PART_PX))
        self._pixel = 2.0 * np.pi / width / (2.0 * self._radius / self._count)  # of the plate, in points
        both = zip((start, end), self._middle, strict=True)
        self._distance = [_signed_distance(self._about(matte, middle)) for matte, middle in both]

    def at(self, share: float) -> Matte:
        """Return the matte at a share of the way, 0 to 1."""
        one, other = self._middle
        angle = float(np.arctan2(np.linalg.norm(np.cross(one, other)), one @ other))
        middle = one if angle < 1e-9 else unit(np.sin((1.0 - share) * angle) * one + np.sin(share * angle) * other)
        distance = (1.0 - share) * self._distance[0] + share * self._distance[1]
        part = np.clip(0.5 + distance / (_KEY_EDGE_PX * self._pixel), 0.0, 1.0).astype(np.float32)
        whole, (rows, columns) = np.zeros(self._shape, np.uint8), self._window(middle)
        x, y = columns + 0.5, rows[:, None] + 0.5
        right, up, away = np.moveaxis(direction_from_frame(x, y, *self._shape[::-1]) @ _axes(middle).T, -1, 0)
        beside = np.hypot(right, up)
        scale = np.arctan2(beside, away) / np.maximum(beside, 1e-12) * self._count / (2.0 * self._radius)
        half = 0.5 * self._count - 0.5
        places = [(half + scale * right).astype(np.float32), (half - scale * up).astype(np.float32)]
        found = cv2.remap(part, places[0], places[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0.0)
        whole[rows[:, None], columns % self._shape[1]] = np.rint(255.0 * found)
        return whole

    def _window(self, middle: Floats) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the rows and the columns, which may pass the seam, that lie within the radius about a middle."""
        height, width = self._shape
        latitude = float(np.arcsin(np.clip(middle[1], -1.0, 1.0)))
        longitude = float(np.arctan2(middle[0], -middle[2]))
        top, bottom = ((0.5 - (latitude + side * self._radius) / np.pi) * height for side in (1.0, -1.0))
        rows = np.arange(max(int(top), 0), min(int(bottom) + 1, height))
        wide = np.pi  # about a pole
        if abs(latitude) + self._radius < 0.5 * np.pi:
            wide = float(np.arcsin(np.sin(self._radius) / np.cos(latitude)))
        left, right = ((0.5 + (longitude + side * wide) / (2.0 * np.pi)) * width for side in (-1.0, 1.0))
        return rows, np.arange(int(np.floor(left)), min(int(right) + 1, int(np.floor(left)) + width))

    def _about(self, matte: Matte, middle: Floats) -> Floats:
        """Return a matte about its middle, (n, n) in [0, 1]."""
        steps = (np.arange(self._count) + 0.5) * (2.0 * self._radius / self._count) - self._radius
        right, up = steps[None, :], -steps[:, None]
        angle = np.hypot(right, up)
        beside = np.sinc(angle / np.pi)
        local = np.stack(np.broadcast_arrays(beside * right, beside * up, np.cos(angle)), axis=-1)
        height, width = self._shape
        places = frame_from_direction(local @ _axes(middle), width, height)
        x, y = ((place - 0.5).astype(np.float32) for place in places)
        found = cv2.remap(matte, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
        return found.astype(np.float64) / 255.0


def _axes(middle: Floats) -> Floats:
    """Return rows (3, 3): right, up and the direction of a middle, upright."""
    level, up, away = basis(middle)
    return np.stack([-level, up, away])


def _middle(matte: Matte) -> tuple[Floats, float]:
    """Return the direction (3,) of a matte's middle and the radius [rad] about it that holds the matte."""
    covered = np.argwhere(matte > 127)
    if not len(covered):
        raise ParameterError("matte - a key is empty (got no white) - remove it, and draw it again")
    height, width = matte.shape
    row, column = covered.T
    d = direction_from_frame(column + 0.5, row + 0.5, width, height)
    middle = unit(row_solid_angle(width, height)[row] @ d)
    return middle, float(np.arccos(np.clip(d @ middle, -1.0, 1.0).min()))


def _signed_distance(part: Floats) -> Floats:
    """Return the distance [points] to the outline of a matte (n, n) in [0, 1], positive inside."""
    thing = (part > 0.5).astype(np.uint8)
    inside, outside = (cv2.distanceTransform(one, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) for one in (thing, 1 - thing))
    return np.where(thing > 0, inside - 0.5, 0.5 - outside)
