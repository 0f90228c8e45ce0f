# SPDX-License-Identifier: Apache-2.0
"""Height of a level sea floor from points that are clicked on it, or from points of a camera track.

Rays alone leave the scale of a scene open, so that one length has to be known: the camera's height above the floor,
distances from the camera, or lengths between clicked points. All fits assume a level floor and a levelled camera:
with an error e [rad] of its level, a height found at a distance D along the ground is wrong by D tan e.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mr360uw.errors import ParameterError
from mr360uw.tune.placing import Point, ray
from mr360uw.types import Floats, View


@dataclass(frozen=True, slots=True, eq=False)
class FloorFit:
    """A level floor. height_m: of the plane in the world, as `receiver.height_m`. points: (n, 3) in the world.

    error_m: root mean square deviation from what was given, 0 where nothing is left to compare. assumed: in words.
    """

    height_m: float
    points: Floats
    error_m: float
    assumed: str


def floor_from_height(camera: View, clicks: Sequence[Point], camera_height_m: float) -> FloorFit:
    """Return the floor that lies `camera_height_m` below the camera, and where the clicked rays meet it.

    The clicks do not change the height: `points` show the distances that follow. Raises `ParameterError`.
    """
    slope = _per_height(camera, clicks)
    height = _positive("height of the camera above the floor", camera_height_m)
    points = camera.position + height * slope
    assumed = f"the camera is {height:g} m above a level floor"
    return FloorFit(float(camera.position[1]) - height, points, 0.0, assumed)


def floor_from_distances(camera: View, clicks: Sequence[Point], distance_m: Sequence[float]) -> FloorFit:
    """Return the level floor nearest to points that are clicked at known distances [m] along their rays.

    Least squares over the vertical deviations: the mean of the points' heights. Raises `ParameterError`.
    """
    _per_height(camera, clicks)
    reach = [_positive("distance of a clicked point", d) for d in distance_m]
    _same_count(clicks, reach, "distances")
    points = np.stack([camera.position + d * ray(camera, p) for d, p in zip(reach, clicks, strict=True)])
    height = float(np.mean(points[:, 1]))
    error = float(np.std(points[:, 1]))
    return FloorFit(height, points, error, "the floor is level, and the points are as far from the camera as given")


def floor_from_lengths(camera: View, clicks: Sequence[Point], length_m: Sequence[float]) -> FloorFit:
    """Return the level floor on which clicked points are known lengths [m] apart, the first from the second and so on.

    For a camera h above the floor the lengths are h times those for h = 1; h is their least squares fit. Raises
    `ParameterError`.
    """
    slope = _per_height(camera, clicks)
    lengths = np.array([_positive("length on the floor", one) for one in length_m])
    _same_count(clicks[1:], lengths, "lengths")
    unit_lengths = np.linalg.norm(np.diff(slope, axis=0), axis=-1)
    if not np.any(unit_lengths > 0.0):
        raise ParameterError("floor - all clicked points are the same (got no length) - click points that are apart")
    height = float(unit_lengths @ lengths / (unit_lengths @ unit_lengths))
    error = float(np.sqrt(np.mean((height * unit_lengths - lengths) ** 2)))
    points = camera.position + height * slope
    return FloorFit(
        float(camera.position[1]) - height, points, error, "the floor is level, and lengths on it are known"
    )


def floor_from_track(points: Floats) -> FloorFit:
    """Return the level floor through points (n, 3) of a camera track [m]: their median height, which strays by few.

    error_m: 1.4826 times the median deviation, the standard deviation where it is Gaussian. Raises `ParameterError`.
    """
    points = np.asarray(points, np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or not len(points) or not np.all(np.isfinite(points)):
        raise ParameterError(f"floor - must be points (n, 3) (got shape {points.shape}) - give finite points")
    height = float(np.median(points[:, 1]))
    error = 1.4826 * float(np.median(np.abs(points[:, 1] - height)))
    return FloorFit(height, points, error, "the floor is level, and most of the track's points lie on it")


def _per_height(camera: View, clicks: Sequence[Point]) -> Floats:
    """Return what rays meet on a floor 1 m below the camera, from the camera, (n, 3); raise `ParameterError`."""
    if not clicks:
        raise ParameterError("floor - no point is clicked (got 0) - click on the floor")
    rays = np.stack([ray(camera, point) for point in clicks])
    for number, one in enumerate(rays):
        if one[1] >= 0.0:
            elevation = np.degrees(np.arcsin(one[1]))
            raise ParameterError(
                f"floor - point {number + 1} is above the horizon (got {elevation:.1f} deg) - click lower, or correct "
                "the camera's roll and pitch"
            )
    return rays / -rays[:, 1:2]


def _positive(what: str, value: float) -> float:
    if not 0.0 < value < np.inf:
        raise ParameterError(f"floor - the {what} must be above 0 m (got {value:g}) - measure or estimate it")
    return float(value)


def _same_count(clicks: Sequence[Point], given: Sequence[float] | Floats, what: str) -> None:
    if len(clicks) != len(given):
        raise ParameterError(f"floor - clicked points need {len(clicks)} {what} (got {len(given)}) - give one for each")
