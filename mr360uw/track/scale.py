# SPDX-License-Identifier: Apache-2.0
"""Scale of a solved scene: from the camera's height, a length between two pixels, or the log of a dive computer."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mr360uw.errors import ParameterError
from mr360uw.medium.tables import read_table
from mr360uw.sphere import unit
from mr360uw.types import Floats

_NEAR = np.radians(4.0)
"""Largest angle between a picked pixel and the solved points that tell its distance."""
_NEIGHBOURS = 5
_LEAST_RISE_M = 0.15
"""Least standard deviation [m] of the depths of a log that tells a scale: three times the resolution of a computer."""
_LEAST_AGREEMENT = 0.9
"""Least correlation between the depths of a log and the heights of a path."""
_OFFSET_STEP_S = 0.25


Length = tuple[tuple[float, float], tuple[float, float], float]
"""Two pixels (column, row) of the first frame, and the length [m] between what they show."""


def parse_length(text: str) -> Length:
    """Return a length of the form X,Y:X,Y=METRES; raise `ParameterError`."""
    number = r"\s*(\d+\.?\d*)\s*"
    match = re.fullmatch(f"{number},{number}:{number},{number}={number}", text)
    if match is None:
        raise ParameterError(
            f"--length - must be two pixels and metres (got {text!r}) - write X,Y:X,Y=METRES, as in 812,700:990,705=1.5"
        )
    x, y, u, v, metres = (float(group) for group in match.groups())
    if metres <= 0.0:
        raise ParameterError(f"--length - must be more than 0 (got {metres:g}) - give metres")
    return (x, y), (u, v), metres


@dataclass(frozen=True, slots=True)
class Measure:
    """What tells the scale; nothing, or one of three.

    height_m: of the camera over the floor at the first frame. length: in a frame of `frame_width` columns. depth_log:
    CSV file of a dive computer with the columns time_s and depth_m; depth_offset_s: its time at the clip's start, None
    searches for it.
    """

    height_m: float | None = None
    length: Length | None = None
    depth_log: Path | None = None
    depth_offset_s: float | None = None
    frame_width: int = 0

    def __post_init__(self) -> None:
        if sum(v is not None for v in (self.height_m, self.length, self.depth_log)) > 1:
            raise ParameterError("scale - is given twice (got several of --height, --length, --depth-log) - give one")
        if self.height_m is not None and not (np.isfinite(self.height_m) and self.height_m > 0.0):
            raise ParameterError(f"--height - must be more than 0 (got {self.height_m}) - give metres over the floor")


def scale_from_length(points: Floats, camera: Floats, looks: Floats, metres: float) -> float:
    """Return metres per unit of a scene, from the length between what two directions (2, 3) of a camera (3,) show.

    points (n, 3): of the scene; each direction's distance is the median of the five nearest by angle. Raises
    `ParameterError` where there are none within four degrees.
    """
    away = points - camera
    distance = np.linalg.norm(away, axis=1)
    ends = []
    for name, look in zip(("first", "second"), looks, strict=True):
        angle = np.linalg.norm(away / distance[:, None] - look, axis=1)
        order = np.argsort(angle, kind="stable")[:_NEIGHBOURS]
        order = order[angle[order] < _NEAR]
        if not len(order):
            raise ParameterError(
                f"--length - no point was solved near its {name} pixel (the nearest is {np.degrees(angle.min()):.0f} "
                "degrees away) - pick a place with texture"
                if len(angle)
                else "--length - no points were solved, as the camera does not move - leave it out"
            )
        ends.append(look * np.median(distance[order]))
    apart = float(np.linalg.norm(ends[0] - ends[1]))
    if apart <= 0.0:
        raise ParameterError("--length - is between equal pixels - pick two places")
    return metres / apart


def read_depth_log(path: Path) -> tuple[Floats, Floats]:
    """Return times [s] and depths [m] of a log; raise `ParameterError`."""
    table = read_table(path)
    missing = [name for name in ("time_s", "depth_m") if name not in table]
    if missing:
        raise ParameterError(f"{path} - columns are missing (got no {', '.join(missing)}) - give time_s, depth_m")
    known = np.isfinite(table["time_s"]) & np.isfinite(table["depth_m"])
    times, depths = table["time_s"][known], table["depth_m"][known]
    if len(times) < 2 or np.any(np.diff(times) <= 0.0):
        raise ParameterError(f"{path} - times must ascend (got {len(times)} rows) - sort the rows")
    return times, depths


def scale_from_depths(log: Path, offset_s: float | None, time_s: Floats, height: Floats) -> tuple[float, float, float]:
    """Return metres per unit of a scene, the depth [m] at the first frame, and the log's time [s] at the first frame.

    log, offset_s: see `Measure`. height (n,): of the camera in the scene, upwards, at times (n,) from the clip's start.
    Least squares of depth = first depth - scale (height - first height); an unknown start of the clip in the log is
    that of the best correlation, in steps of a quarter of a second. Raises `ParameterError` where both disagree.
    """
    times, depths = read_depth_log(log)
    span = float(time_s[-1] - time_s[0])
    if offset_s is None:
        starts = np.arange(times[0], max(times[-1] - span, times[0]) + 1e-9, _OFFSET_STEP_S)
    else:
        starts = np.array([offset_s])
    best = max(starts, key=lambda start: _agreement(np.interp(time_s - time_s[0] + start, times, depths), height))
    depth = np.interp(time_s - time_s[0] + best, times, depths)
    agreement = _agreement(depth, height)
    if agreement < _LEAST_AGREEMENT:
        raise ParameterError(
            f"{log} - its depths do not fit the camera's path (correlation {agreement:.2f}, depths change by "
            f"{np.ptp(depth):.2f} m) - check the clip's start in the log, or give --height"
        )
    a = height - height.mean()
    scale = -float(a @ (depth - depth.mean())) / float(a @ a)
    return scale, float(depth.mean() - scale * (height[0] - height.mean())), float(best)


def _agreement(depth: Floats, height: Floats) -> float:
    """Return the correlation of depth and height, positive where one falls as the other rises; -1 for level dives."""
    if np.std(depth) < _LEAST_RISE_M or np.std(height) <= 0.0:
        return -1.0
    return -float(np.corrcoef(depth, height)[0, 1])


def looks_of(length: Length, width: int, rotation: Floats) -> Floats:
    """Return the directions (2, 3) in the scene of a length's pixels of a frame of `width` columns."""
    from mr360uw.sphere import direction_from_frame

    first, second, _ = length
    x, y = np.array([first, second]).T
    if not (np.all(x <= width) and np.all(y <= width / 2)):
        raise ParameterError(f"--length - a pixel is outside of the frame (got {first}, {second})")
    return unit(direction_from_frame(x, y, width, width // 2)) @ rotation.T
