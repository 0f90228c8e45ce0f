# SPDX-License-Identifier: Apache-2.0
"""Bounds of bodies in the frame of an eye beside the middle, from those seen from the middle (types/frames.py)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from mr360uw.composite.tiles import rectangles_of_bodies
from mr360uw.types import Floats, Rectangle, View

NEAREST = 2.0
"""Distance of a body, in radii of the viewing circle, below which it is taken to reach into any part of the frame."""


def seen_rectangle(rectangle: Rectangle, nearest_m: float, eye_m: float, width: int, height: int) -> Rectangle:
    """Return a rectangle of a width x height frame that holds what an eye sees of a body.

    rectangle: of the body seen from the middle. nearest_m: its least distance from there, or less.
    """
    if not eye_m:
        return rectangle
    ratio = abs(eye_m) / max(nearest_m, 1e-12)
    if ratio > 1.0 / NEAREST:
        return Rectangle(0, 0, width, height)
    beside = math.ceil(width * math.asin(ratio) / (2.0 * math.pi))
    # the sine of a latitude grows by up to 1/sqrt(1 - ratio^2), its cosine falls by up to 1/sqrt(1 + ratio^2)
    over = math.ceil(height * ratio * ratio / math.pi)
    column, row, columns, rows = rectangle
    top, bottom = max(row - over, 0), min(row + rows + over, height)
    columns = min(columns + beside, width)
    return Rectangle((column - (beside if eye_m > 0.0 else 0)) % width, top, columns, bottom - top)


def seen_rectangles(bodies: Sequence[Floats], view: View) -> list[Rectangle]:
    """Return the rectangle of each body's triangles (T, 3, 3) [m] from the middle, in the camera's axes, in a view."""
    whole = rectangles_of_bodies(bodies, view.width, view.height)
    if not view.eye_m:
        return whole
    size = view.width, view.height
    return [seen_rectangle(r, nearest_m(body), view.eye_m, *size) for r, body in zip(whole, bodies, strict=True)]


def nearest_m(triangles: Floats) -> float:
    """Return a lower bound of the distance [m] of triangles (T, 3, 3) from the origin."""
    corner = np.sqrt(np.min(np.sum(np.square(triangles), axis=-1), axis=-1))
    edges = triangles - np.roll(triangles, 1, axis=1)
    longest = np.sqrt(np.max(np.sum(np.square(edges), axis=-1), axis=-1))
    normal = np.cross(edges[:, 0], edges[:, 1])
    plane = np.abs(np.sum(normal * triangles[:, 0], -1)) / np.maximum(np.linalg.norm(normal, axis=-1), 1e-30)
    # no point of a triangle is farther from its nearest corner than the circumradius of its longest edge
    return float(np.min(np.maximum(corner - longest / math.sqrt(3.0), plane), initial=np.inf))
