# SPDX-License-Identifier: Apache-2.0
"""A matte of something in the plate, from a rough outline, strokes, or both: GrabCut, edges as the picture has them.

What is outside of an outline is taken as background, what is inside as one or the other by its colours (Rother et al.
2004, "GrabCut"). Strokes over the thing and beside it say what its pixels and those of the background are; without an
outline all others go by the colours of both. The edge follows the picture by a guided filter (He et al. 2013).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Literal, get_args

import cv2
import numpy as np
from numpy.typing import NDArray

from mr360uw.errors import ParameterError
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
    height, width = matte.shape
    if width > _OUTLINE_PX:
        matte = cv2.resize(matte, (_OUTLINE_PX, round(_OUTLINE_PX * height / width)), interpolation=cv2.INTER_AREA)
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
