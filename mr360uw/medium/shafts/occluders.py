# SPDX-License-Identifier: Apache-2.0
"""Bodies that take light away: visibility of a distant disc of light from points, and first hits of camera rays.

A point needs shadow rays only where its cone of directions meets a body's bounding sphere. With t the distance of the
sphere's centre along the cone's axis, h that across it, R its radius and alpha the half angle of the cone:

    t > -R        h < R/cos(alpha) + max(t, 0) tan(alpha)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from mr360uw.errors import ParameterError
from mr360uw.rays import RayScene
from mr360uw.shapes import numbers
from mr360uw.types import Floats

Array = NDArray[np.float64]

_BEYOND_M = 1e-4
"""How far [m] behind a hit the next one is searched for: above the roundings of rays, below the size of a body."""
_ROUND = 1.001
"""Factor on the radius of a body's sphere within which rays are cast at it: above the roundings of rays."""
GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)
"""Step from place to place along a segment, as a fraction of it."""


@runtime_checkable
class Occluder(Protocol):
    """A body of any kind. Origins (n, 3) [m] in the world, directions (n, 3) unit.

    An attribute `bounding_sphere`, (centre (3,), radius) [m], spares rays to points that the body cannot shade.
    """

    def occluded(self, origins: Floats, directions: Floats, reach_m: Floats | float = np.inf) -> NDArray[np.bool_]:
        """Return whether each ray (n,) meets the body nearer than `reach_m` [m]."""

    def distance(self, origins: Floats, directions: Floats) -> Floats:
        """Return the distance (n,) [m] at which each ray meets the body first, infinity where it does not."""


@dataclass(frozen=True, slots=True, eq=False)
class Bodies:
    """Bodies with the spheres around them. centre: (k, 3), radius: (k,) [m]; infinite where it is not known.

    passed: (k,) fraction of light that each lets through; rays of the camera end at those of none.
    """

    occluders: tuple[Occluder, ...]
    centre: Array
    radius: Array
    passed: Array

    def first_clear_m(self, origin: Array, directions: Array) -> tuple[Array, Array]:
        """Return the distance (n,) [m] of the nearest body that lets light through along rays (n, 3), infinity for
        none, and the fraction (n,) that all of them let through together.
        """
        nearest, passed = np.full(len(directions), np.inf), np.ones(len(directions))
        for number in np.flatnonzero(self.passed > 0.0).tolist():
            distance = self.occluders[number].distance(origin, directions)
            nearest = np.minimum(nearest, distance)
            passed[np.isfinite(distance)] *= self.passed[number]
        return nearest, passed

    def first_hit_m(self, origin: Array, directions: Array) -> Array:
        """Return the distance (n,) [m] of the nearest opaque body along rays (n, 3) from one point, else infinity."""
        nearest = np.full(len(directions), np.inf)
        for number in np.flatnonzero(self.passed == 0.0).tolist():
            body, centre, radius = self.occluders[number], self.centre[number], _ROUND * self.radius[number]
            to = np.broadcast_to(centre - origin, directions.shape)
            along, away = np.einsum("nk,nk->n", to, directions), np.einsum("nk,nk->n", to, to)
            outside = away - radius**2
            near = np.flatnonzero((outside <= 0.0) | ((along > 0.0) & (along * along >= outside)))
            start = np.broadcast_to(origin, directions.shape)[near]
            nearest[near] = np.minimum(nearest[near], body.distance(start, directions[near]))
        return nearest

    def inside_m(self, origin: Array, directions: Array) -> tuple[Array, Array]:
        """Return the distances (n,) [m] between which rays (n, 3) from one point are inside their first opaque body."""
        enter = self.first_hit_m(origin, directions)
        leave = np.full(len(directions), np.inf)
        met = np.flatnonzero(np.isfinite(enter))
        start = origin + (enter[met, None] + _BEYOND_M) * directions[met]
        for body in (b for b, passed in zip(self.occluders, self.passed, strict=True) if passed == 0.0):
            leave[met] = np.minimum(leave[met], enter[met] + _BEYOND_M + body.distance(start, directions[met]))
        return enter, leave

    def visible(self, point: Array, directions: Array, along: Array | None = None) -> Array:
        """Return the fraction (n,) of the light of k directions (k, 3) about one axis that is left at points (n, 3).

        along: (n, 3) [m] of straight segments about the points, over which the fraction is averaged: each direction is
        tested from its own place.
        """
        places = np.remainder(np.arange(len(directions)) * GOLDEN + 0.5, 1.0) - 0.5
        left = np.ones((len(directions), len(point)))
        axis = directions.mean(axis=0)
        axis = axis / np.linalg.norm(axis)
        cosine = float(np.min(directions @ axis))
        bodies = zip(self.occluders, self.centre, self.radius, self.passed, strict=True)
        for body, centre, radius, passed in bodies:
            wide = float(radius) + (0.0 if along is None else 0.5 * np.linalg.norm(along, axis=-1))
            near = np.flatnonzero(_meets_cone(centre - point, axis, min(cosine, 1.0), wide))
            for k, direction in enumerate(directions):
                start = point[near] if along is None else point[near] + places[k] * along[near]
                shaded = body.occluded(start, np.broadcast_to(direction, (len(near), 3)))
                left[k, near[shaded]] *= passed
        return np.asarray(left.mean(axis=0))

    def visible_from(self, point: Array, place: Array, least_m: float) -> Array:
        """Return the fraction (n,) of light from a place (3,) that is left at points (n, 3).

        least_m: distance [m] from the place within which nothing takes its light away.
        """
        away = place - point
        length = np.linalg.norm(away, axis=-1)
        towards = away / np.maximum(length, 1e-9)[:, None]
        seen = np.ones(len(point))
        for body, passed in zip(self.occluders, self.passed, strict=True):
            seen[body.occluded(point, towards, np.maximum(length - least_m, 0.0))] *= passed
        return seen


def _meets_cone(to_centre: Array, axis: Array, cosine: float, radius: Floats | float) -> NDArray[np.bool_]:
    along = to_centre @ axis
    across = np.sqrt(np.maximum(np.sum(to_centre * to_centre, axis=-1) - along * along, 0.0))
    tangent = np.sqrt(1.0 - cosine * cosine) / cosine
    return np.asarray((along > -radius) & (across <= radius / cosine + np.maximum(along, 0.0) * tangent))


def bodies_of(bodies: Sequence[Any] | Bodies) -> Bodies:
    """Return bodies that are given as triangles (T, 3, 3) [m] in the world, objects with such `triangles`, or
    `Occluder`s.

    Raises `ParameterError` for anything else.
    """
    if isinstance(bodies, Bodies):
        return bodies
    occluders: list[Occluder] = []
    centres, radii = [np.zeros((0, 3))], []
    for body in bodies:
        triangles = body if isinstance(body, np.ndarray) else getattr(body, "triangles", None)
        if triangles is None:
            if not isinstance(body, Occluder):
                raise ParameterError(
                    f"bodies - not a body (got {type(body).__name__}) - give triangles (T, 3, 3), a mesh with "
                    "`triangles`, or an object with the methods of `Occluder`"
                )
            occluders.append(body)
            centre, radius = getattr(body, "bounding_sphere", (np.zeros(3), np.inf))
            centres.append(np.asarray(centre, np.float64)[None])
            radii.append(float(radius))
            continue
        corners = numbers("bodies", triangles).astype(np.float64, copy=False)
        if corners.ndim != 3 or corners.shape[1:] != (3, 3):
            raise ParameterError(
                f"bodies - triangles must be (T, 3, 3) (got {corners.shape}) - give three corners each"
            )
        if len(corners):
            points = corners.reshape(-1, 3)
            centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
            occluders.append(RayScene(corners))
            centres.append(centre[None])
            radii.append(float(np.linalg.norm(points - centre, axis=-1).max()))
    return Bodies(tuple(occluders), np.concatenate(centres), np.array(radii), np.zeros(len(radii)))
