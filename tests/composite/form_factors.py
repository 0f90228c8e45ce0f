# SPDX-License-Identifier: Apache-2.0
"""Form factors in closed form: the fraction of a uniform sky's irradiance on a small surface that a body takes away.

A body in front of a uniform hemisphere blocks the fraction that it would light by itself if it were as bright. The
small surface lies at `point` and faces `normal`, a unit vector.
"""

from __future__ import annotations

import numpy as np

from mr360uw.types import Floats


def sphere_form_factor(points: Floats, normal: Floats, center: Floats, radius: float) -> Floats:
    """Return (R^2/D^2) cos theta (n,) at points (n, 3): a sphere wholly above the horizon of every point."""
    towards = center - points
    distance = np.linalg.norm(towards, axis=-1)
    height = towards @ normal
    assert np.all(height >= radius * (1.0 - 1e-9)), "the sphere dips below the horizon"
    return np.asarray(radius**2 * height / distance**3)


def polygon_form_factor(point: Floats, normal: Floats, corners: Floats) -> float:
    """Return the form factor of a plane polygon of corners (k, 3), of either winding (Lambert 1760).

    F = |sum_i angle_i (n . g_i)| / 2 pi over the edges, with angle_i the angle that an edge subtends at the point and
    g_i the unit normal of the plane through the point and the edge. What lies below the horizon is cut off.
    """
    above = _above(np.asarray(corners, np.float64) - point, normal)
    if len(above) < 3:
        return 0.0
    ray = above / np.linalg.norm(above, axis=-1, keepdims=True)
    after = np.roll(ray, -1, axis=0)
    side = np.cross(ray, after)
    sine = np.linalg.norm(side, axis=-1)
    angle = np.arctan2(sine, np.sum(ray * after, axis=-1))
    edge = sine > 0.0
    return float(abs(np.sum(angle[edge] * (side[edge] @ normal) / sine[edge])) / (2.0 * np.pi))


def box_form_factor(point: Floats, normal: Floats, low: Floats, high: Floats) -> float:
    """Return the form factor of a box along the axes between two corners (3,), seen from outside: that of the faces
    that face the point, which do not hide each other.
    """
    low, high = np.asarray(low, np.float64), np.asarray(high, np.float64)
    total = 0.0
    for axis in range(3):
        for end, seen in ((low, point[axis] < low[axis]), (high, point[axis] > high[axis])):
            if seen:
                across = [k for k in range(3) if k != axis]
                corners = np.empty((4, 3))
                corners[:, axis] = end[axis]
                corners[:, across[0]] = [low[across[0]], high[across[0]], high[across[0]], low[across[0]]]
                corners[:, across[1]] = [low[across[1]], low[across[1]], high[across[1]], high[across[1]]]
                total += polygon_form_factor(point, normal, corners)
    return total


def _above(corners: Floats, normal: Floats) -> Floats:
    """Return the corners of the part of a polygon about the origin that is above the horizon (Sutherland & Hodgman)."""
    height = corners @ normal
    kept = []
    for k in range(len(corners)):
        after = (k + 1) % len(corners)
        if height[k] >= 0.0:
            kept.append(corners[k])
        if (height[k] >= 0.0) != (height[after] >= 0.0):
            kept.append(corners[k] + (corners[after] - corners[k]) * height[k] / (height[k] - height[after]))
    return np.array(kept).reshape(-1, 3)
