# SPDX-License-Identifier: Apache-2.0
"""Finds a place on the ground of a panorama where a thing can stand: even, like the ground around, nothing before it.

The ground is taken as a level plane, one camera height below. Laid out on it, the plate's ground looks alike everywhere,
while what rises from it is drawn out away from the camera and ends in edges. Of every place that a foot could have the
cost is what is seen under the foot (edges, other colours than most of the ground, shade, black caps, water without any
structure), less so what is hidden behind the body, and how far it is from where one looks first.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mr360uw.color import luminance
from mr360uw.sphere import frame_from_direction
from mr360uw.types import Floats

Array = NDArray[np.float64]

_REACH, _CELL = 6.0, 0.05
"""Half the side of the layout and its cell, in camera heights."""
_DARK = 0.004
"""Linear light added before logarithms: noise of dark plates is no structure."""
_EDGE = 0.12
"""Standard deviation of the blur before edges are taken, in camera heights: grass and grain are finer."""
_NEAR_GROUND = (0.4, 1.2)
"""Distances, in camera heights, of the ground that others are compared with: what lies before one's feet is ground."""
_COLOR = 0.7
"""Weight of a difference of colour (logarithm of red or blue over green) against one of light."""
_LEAST_SPREAD = 0.15
"""Spread of the ground's light and colour, as logarithms, that no ground falls below."""
_SMOOTH = 0.02
"""Fine structure under which no ground is seen: open water, caps of black or of one colour."""
_COSTS = {
    "edges": 2.0,
    "unlike": 0.15,
    "dark": 0.5,
    "smooth": 1.0,
    "plainer": 0.2,
    "hides": 0.2,
    "aside": 0.0012,
    "odd": 0.15,
    "crossed": 1.0,
}
"""Costs of edges under the foot (rms of the change of logarithms across the blur), of each spread of difference, of a
factor of e of darkness, of missing structure, of edges behind the body, of a degree from the middle, and of a factor of
e between the angle of the thing and the usual one."""
_WAY_FROM = 0.8
_ACROSS = 9
"""Points along a side of a foot."""
UNEVEN = 0.9
"""Cost above which no place is said to be good."""


@dataclass(frozen=True, slots=True)
class GroundPlace:
    """A place on the ground. azimuth_deg: of its middle. distance_m: level, from the camera. cost: 0.2 is even ground."""

    azimuth_deg: float
    distance_m: float
    cost: float


@dataclass(frozen=True, slots=True)
class Body:
    """What has to find a place: its sides across the line of sight and along it, its height, all [m]."""

    across_m: float
    along_m: float
    height_m: float


def ground_place(
    image: Floats, drop_m: float, body: Body, distances_m: Array, azimuths_deg: Array, usual_m: float
) -> GroundPlace:
    """Return the best of some places on the ground of a levelled panorama (h, w, 3) of linear light.

    drop_m: height of the camera over the ground. distances_m: (n,) level. usual_m: distance at which the body is seen
    under the usual angle.
    """
    layout = _Layout.of(image)
    azimuth, distance = np.meshgrid(np.radians(azimuths_deg), distances_m / drop_m, indexing="ij")
    side = np.linspace(-0.5, 0.5, _ACROSS)
    across, along = np.meshgrid(side * body.across_m / drop_m, side * body.along_m / drop_m)
    right, ahead = across.ravel(), distance[..., None] + along.ravel()
    sin, cos = np.sin(azimuth)[..., None], np.cos(azimuth)[..., None]
    foot = layout.cells(ahead * sin + right * cos, right * sin - ahead * cos)
    edges = np.sqrt(np.mean(layout.edges[foot] ** 2, axis=-1)) + 0.25 * layout.edges[foot].max(axis=-1)
    middle = layout.shades[foot].mean(axis=-2)
    unlike = np.sqrt(np.mean(((middle - layout.usual) / layout.spread) ** 2, axis=-1))
    smooth = np.maximum(np.log(_SMOOTH / np.maximum(layout.fine[foot].mean(axis=-1), 1e-4)), 0.0)
    cost = _COSTS["edges"] * edges + _COSTS["unlike"] * np.minimum(unlike, 5.0) + _COSTS["smooth"] * smooth
    cost += _COSTS["dark"] * np.maximum(layout.usual[0] - middle[..., 0] - 0.4, 0.0)
    cost += _COSTS["plainer"] * np.maximum(
        np.log(layout.texture / np.maximum(layout.fine[foot].mean(axis=-1), 1e-4)) - 0.5, 0.0
    )
    cost += _COSTS["crossed"] * _crossed(layout, azimuth, distance, body.across_m / drop_m, body.along_m / drop_m)
    cost += _COSTS["hides"] * _hidden(image, azimuth, distance, body, drop_m)
    cost += _COSTS["aside"] * np.abs(np.degrees(azimuth))
    cost += _COSTS["odd"] * np.abs(np.log(distance * drop_m / usual_m))
    row, column = np.unravel_index(int(np.argmin(cost)), cost.shape)
    import os

    if os.environ.get("DBG"):
        crossed = _crossed(layout, azimuth, distance, body.across_m / drop_m, body.along_m / drop_m)
        hid = _hidden(image, azimuth, distance, body, drop_m)
        fine = layout.fine[foot].mean(axis=-1)
        for q in [(row, column)] + [
            tuple(np.unravel_index(k, cost.shape)) for k in np.argsort(cost.ravel())[[30, 100, 250, 400]]
        ]:
            print(
                f"    az {azimuths_deg[q[0]]:5.0f} d {distances_m[q[1]]:.2f} cost {cost[q]:.2f}: edges {edges[q]:.3f} unlike {unlike[q]:.2f} fine {fine[q]:.3f} dark {layout.usual[0] - middle[q][0]:.2f} crossed {crossed[q]:.3f} hid {hid[q]:.2f}"
            )
    return GroundPlace(float(azimuths_deg[row]), float(distances_m[column]), float(cost[row, column]))


@dataclass(frozen=True, slots=True, eq=False)
class _Layout:
    """The plate's light on the level ground, seen from above, +x to the right and +z down, the camera in the middle.

    shades: (n, n, 3) logarithms of light, of red and of blue over green, blurred. edges: (n, n) change of them across
    the blur. fine: (n, n) fine structure. usual, spread: (3,) shades of the ground near by.
    """

    shades: Array
    edges: Array
    fine: Array
    usual: Array
    spread: Array
    texture: float

    @classmethod
    def of(cls, image: Floats) -> _Layout:
        """Return the layout of a panorama (h, w, 3)."""
        import cv2

        place = np.arange(-_REACH, _REACH, _CELL) + 0.5 * _CELL
        x, z = np.meshgrid(place, place)
        height, width = image.shape[:2]
        around = np.concatenate([image, image[:, :1]], axis=1).astype(np.float32)
        column, row = frame_from_direction(np.stack([x, np.full_like(x, -1.0), z], axis=-1), width, height)
        where = ((column - 0.5).astype(np.float32), (row - 0.5).astype(np.float32))
        ground = np.log(
            np.maximum(cv2.remap(around, *where, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), 0.0) + _DARK
        )
        light = np.log(np.maximum(luminance(np.exp(ground)), 0.0))
        shades = np.stack([light, *(_COLOR * (ground[..., k] - ground[..., 1]) for k in (0, 2))], axis=-1)
        blurred = cv2.GaussianBlur(shades, (0, 0), _EDGE / _CELL)
        dx, dz = (np.gradient(blurred, axis=axis) * (_EDGE / _CELL) for axis in (1, 0))
        fine = np.abs(light - cv2.GaussianBlur(light, (0, 0), _EDGE / _CELL))
        far = np.hypot(x, z)
        near = blurred[(far > _NEAR_GROUND[0]) & (far < _NEAR_GROUND[1])]
        usual = np.median(near, axis=0)
        spread = np.maximum(1.48 * np.median(np.abs(near - usual), axis=0), _LEAST_SPREAD)
        return cls(
            blurred,
            np.sqrt(np.sum(dx**2 + dz**2, axis=-1)),
            cv2.blur(fine, (9, 9)),
            usual,
            spread,
            float(np.median(fine[(far > _NEAR_GROUND[0]) & (far < _NEAR_GROUND[1])])),
        )

    def cells(self, x: Array, z: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the (row, column) of points, in camera heights; those outside are taken to the rim."""
        last = len(self.edges) - 1
        return tuple(np.clip(((v + _REACH) / _CELL).astype(int), 0, last) for v in (z, x))  # type: ignore[return-value]


def _crossed(layout: _Layout, azimuth: Array, distance: Array, across: float, along: float) -> Array:
    """Return the strongest edge that lies across the way from the camera to a foot, or across the foot."""
    path = np.arange(_WAY_FROM, _REACH, _EDGE)
    right = np.linspace(-0.5, 0.5, _ACROSS)[:, None] * max(across, 0.6)
    sin, cos = np.sin(azimuth[:, :1, None]), np.cos(azimuth[:, :1, None])
    shades = layout.shades[layout.cells(path * sin + right * cos, right * sin - path * cos)].mean(axis=1)
    step = (
        np.linalg.norm(np.diff(shades[:, 2:] + shades[:, 1:-1] - shades[:, 1:-1] - shades[:, :-2], axis=1), axis=-1)
        if False
        else np.linalg.norm(shades[:, 2:] - shades[:, :-2], axis=-1)
    )
    most = np.maximum.accumulate(step, axis=1)
    end = np.searchsorted(path[1:-1], distance[0] + 0.5 * along + 2.0 * _EDGE)
    return np.asarray(most[:, np.minimum(end, most.shape[1] - 1)])


def _hidden(image: Floats, azimuth: Array, distance: Array, body: Body, drop_m: float) -> Array:
    """Return how much there is to be seen behind a body at some places: edges there over those of the whole plate."""
    import cv2

    scale = image.shape[0] / 180.0
    light = np.log(np.maximum(luminance(image), 0.0) + _DARK).astype(np.float32)
    light = cv2.GaussianBlur(light, (0, 0), scale)
    edges = np.hypot(np.gradient(light, axis=0), np.gradient(light, axis=1)) * scale
    usual = max(float(np.mean(edges)), 1e-3)
    u, v = np.meshgrid(np.linspace(-0.5, 0.5, _ACROSS), np.linspace(0.1, 1.0, _ACROSS))
    away = distance[..., None] * drop_m
    longitude = azimuth[..., None] + np.arctan(u.ravel() * body.across_m / away)
    latitude = np.arctan2(v.ravel() * body.height_m - drop_m, away)
    height, width = edges.shape
    column = (np.floor((longitude / (2.0 * np.pi) + 0.5) * width).astype(int)) % width
    row = np.clip(((0.5 - latitude / np.pi) * height).astype(int), 0, height - 1)
    return np.asarray(np.mean(edges[row, column], axis=-1) / usual - 1.0).clip(-0.5)
