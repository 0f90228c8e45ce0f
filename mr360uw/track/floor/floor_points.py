# SPDX-License-Identifier: Apache-2.0
"""Reads what a camera track knows of the floor: scene points below the camera, and how far each can be trusted."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mr360uw.errors import ParameterError
from mr360uw.reading.input_files import read_text
from mr360uw.track.camera_track import CameraTrack
from mr360uw.types import Floats

_DEPRESSION = np.sin(np.radians(12.0))
"""Sine of the angle below a camera's horizon under which points are the floor's. Half of it: 9 camera heights away,
where a pixel spans half a metre of floor; twice: a third of the floor that is used now."""
_LARGEST_ERROR_PX = 2.0
"""Mean reprojection error [px] from which on a point is left out: it moved, or was matched wrongly."""
LEAST_POINTS = 30
"""Fewest points of a floor."""


@dataclass(frozen=True, slots=True, eq=False)
class FloorPoints:
    """Points of a floor in the world of a track.

    point (n, 3) [m]. weight (n,): inverse variance of the heights, 1 straight below the camera. height_m: median height
    of the nearest camera over a point.
    """

    point: Floats
    weight: Floats
    height_m: float


def floor_points(track: CameraTrack | str | Path) -> FloorPoints:
    """Return the points of a track, or of its JSON file, that may lie on the floor; raise `ParameterError`."""
    where, camera, point, error_px = _read(track)
    if not len(point):
        raise ParameterError(
            f"{where} - has no points (a camera that turns on the spot or stands still sees no distances) - give a "
            'track of a camera that moves, or set [receiver] kind = "plane" and its height_m'
        )
    keep = np.isfinite(point).all(axis=1) & (error_px <= _LARGEST_ERROR_PX)
    away = _from_nearest(point[keep], camera)
    distance = np.maximum(np.linalg.norm(away, axis=1), 1e-9)
    below = away[:, 1] < -_DEPRESSION * distance
    if not np.any(below):
        raise ParameterError(
            f"{where} - no point is below the camera (got {len(point)} points, all level or above) - is the track "
            "upside down, or does the clip show no floor? Set [receiver] height_m by hand"
        )
    if np.count_nonzero(below) < LEAST_POINTS:
        raise ParameterError(
            f"{where} - too few points are below the camera (got {np.count_nonzero(below)}, at least {LEAST_POINTS} "
            "are needed) - track a clip that shows more of the floor, or set [receiver] height_m by hand"
        )
    height = -away[below, 1]
    # a pixel along the ray at distance d and height h: d^2 / h on the floor, of which the height takes h / d
    weight = np.square(height / distance[below]) / np.square(np.maximum(distance[below] / np.median(height), 1.0))
    return FloorPoints(point[keep][below], weight, float(np.median(height)))


def _from_nearest(point: Floats, camera: Floats) -> Floats:
    """Return the vectors (n, 3) to points from the camera position (m, 3) that is nearest to each."""
    from scipy.spatial import cKDTree

    return point - camera[cKDTree(camera).query(point)[1]] if len(point) else point


def _read(track: CameraTrack | str | Path) -> tuple[str, Floats, Floats, Floats]:
    """Return a name, camera positions (m, 3), points (n, 3) and their errors [px]."""
    if isinstance(track, CameraTrack):
        return "track", track.position, track.points, track.point_error_px
    path = Path(track)
    if path.suffix.lower() == ".csv":
        raise ParameterError(f"{path} - a table of poses has no points - give the .json that is written beside it")
    text = read_text(path, ParameterError)
    try:
        said: Any = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ParameterError(_no_track(path, f"{error!s:.60}")) from None
    if not isinstance(said, dict) or not str(said.get("format", "")).startswith("mr360uw camera track"):
        raise ParameterError(_no_track(path, "no such format"))
    camera, point = (_table(path, said, key, 3) for key in ("position_m", "points_m"))
    error_px = _table(path, said, "point_error_px", 0)
    if not len(camera) or len(error_px) != len(point) or not np.isfinite(camera).all():
        raise ParameterError(_no_track(path, f"{len(camera)} poses, {len(point)} points, {len(error_px)} errors"))
    return str(path), camera, point, error_px


def _table(path: Path, said: dict[str, Any], key: str, columns: int) -> Floats:
    """Return a list of numbers (n,) or of rows (n, columns)."""
    try:
        values = np.array(said[key], np.float64)
    except (KeyError, ValueError, TypeError):
        raise ParameterError(_no_track(path, f"no numbers at {key!r}")) from None
    shape = (0, columns) if columns else (0,)
    if not values.size:
        return np.zeros(shape)
    if values.ndim != len(shape) or (columns and values.shape[1] != columns):
        raise ParameterError(_no_track(path, f"{key} of shape {values.shape}"))
    return values


def _no_track(path: Path, got: str) -> str:
    return f"{path} - is no camera track (got {got}) - give the track.json that `mr360uw track` writes"
