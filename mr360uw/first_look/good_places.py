# SPDX-License-Identifier: Apache-2.0
"""Finds where a thing is seen best in a panorama: before open water or sky, or standing on the ground.

The ground is taken as a level plane one camera height below, and laid out as seen from above, in camera heights: there
ground looks alike everywhere, while what rises from it ends in edges. Of every place of a foot the cost is what is seen
under it (edges, other colours than those of the ground near by, shade, nothing), the edges across the way to it, what
is hidden behind the body, and how far it is from where one looks first.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mr360uw.color import luminance
from mr360uw.first_look.water_or_air import red_ratio
from mr360uw.sphere import frame_from_direction
from mr360uw.types import Floats

_WIDE_DEG, _HIGH_DEG = 26.0, 18.0
"""Size [deg] of the part that is looked for: somewhat more than an object."""
_COARSE_DEG = 4.0
"""Standard deviation [deg] of the blur whose difference from the picture counts as texture."""
_STEP_DEG = 5.0
_DIM = 0.002
"""Light that is added before logarithms are taken: noise of dark plates is no texture."""
_RED, _BLACK, _WHITE = 1.5, 0.25, 1.5
"""Costs of red, of darkness (a factor of e) and of clipping, over those of texture (rms of the logarithm of light)."""
_CLIPPED = 0.97
"""Linear light from which a pixel counts as clipped. Under water that is the sun's glitter; in air, an overcast sky."""
_OFF_LEVEL, _OFF_MIDDLE = 0.008, 0.002
"""Costs for a degree from the wanted elevation, and from the middle of the frame: ties go to where one looks first."""


FreeView = tuple[float, float, tuple[float, float, float]]
"""A part of a panorama: azimuth and elevation [deg] of its middle, and its mean linear light."""


def free_view(image: Floats, elevation_deg: tuple[float, float], *, underwater: bool) -> FreeView:
    """Return the freest part of a levelled panorama (h, w, 3) of linear light, its middle within these elevations.

    underwater: parts with the veil's colour, without red, are preferred, and parts that are not clipped. The cost is
    texture and what the constants say.
    """
    import cv2

    height, width = image.shape[:2]
    scale = height / 180.0
    pad = width // 8
    wrapped = np.concatenate([image[:, -pad:], image, image[:, :pad]], axis=1).astype(np.float32)
    light = np.log(np.maximum(luminance(wrapped), 0.0) + _DIM)
    fine = light - cv2.GaussianBlur(light, (0, 0), _COARSE_DEG * scale)
    box = (round(_WIDE_DEG * scale), round(_HIGH_DEG * scale))

    def mean(values: Floats) -> Floats:
        return np.asarray(cv2.blur(np.asarray(values, np.float32), box)[:, pad : pad + width])

    texture = np.sqrt(np.maximum(mean(fine * fine), 0.0))
    bright = mean(light)
    cost = texture + _BLACK * np.maximum(np.quantile(bright, 0.8) - bright, 0.0)
    if underwater:
        cost += _WHITE * mean((wrapped.max(axis=-1) > _CLIPPED).astype(np.float32))
        cost += _RED * mean(np.nan_to_num(np.minimum(red_ratio(wrapped), 1.0), nan=0.0))
    elevation = 90.0 - (np.arange(height) + 0.5) / scale
    azimuth = ((np.arange(width) + 0.5) / width - 0.5) * 360.0
    low, high = elevation_deg
    cost += _OFF_LEVEL * np.abs(elevation - 0.5 * (low + high))[:, None] + _OFF_MIDDLE * np.abs(azimuth)
    cost[(elevation < low) | (elevation > high)] = np.inf
    row, column = np.unravel_index(int(np.argmin(cost)), cost.shape)
    color = tuple(float(mean(wrapped[..., k])[row, column]) for k in range(3))
    near_azimuth, near_elevation = (round(v / _STEP_DEG) * _STEP_DEG + 0.0 for v in (azimuth[column], elevation[row]))
    near_elevation = float(np.clip(near_elevation, low, high))
    return near_azimuth, near_elevation, (color[0], color[1], color[2])


Array = NDArray[np.float64]

_REACH, _CELL = 7.5, 0.05
"""Half the side of the layout and its cell, in camera heights."""
_DARK = 0.004
"""Linear light added before logarithms: noise of dark plates is no structure."""
_BLUR = 0.12
"""Standard deviation of the blur before edges are taken, in camera heights: grass and grain are finer."""
_NEAR_GROUND = (0.4, 1.2)
"""Distances, in camera heights, of the ground that other ground is compared with: what lies before one's feet."""
_COLOR = 0.7
"""Weight of a difference of colour (logarithm of red or blue over green) against one of light."""
_LEAST_SPREAD = 0.15
"""Spread of the ground's light and colour, as logarithms, that no ground falls below."""
_BARE = 0.018
"""Fine structure (mean change of the logarithm of light) of ground, at least: sand has 0.02, hazy open water 0.015."""
_EDGES, _UNLIKE, _SHADE, _PLAIN, _CROSSED = 2.0, 0.15, 0.5, 0.2, 1.0
"""Costs of edges under the foot, of each spread of difference, of a factor of e of darkness, of a factor of e of
missing structure, and of the strongest edge across the way."""
_HIDES, _ASIDE, _ODD = 0.2, 0.0012, 0.15
"""Costs of edges behind the body over the plate's mean, of a degree from the middle, of a factor of e of distance."""
_SHADE_FROM, _PLAIN_FROM = 0.4, 0.5
"""Logarithms of darkness and of missing structure that cost nothing."""
_WAY_FROM, _LANE = 0.8, 0.6
"""Where the way to a foot begins, and how wide a lane of it is, in camera heights."""
_ACROSS = 9
"""Points along a side of a foot, and of what a body hides."""
UNEVEN = 0.9
"""Cost above which a place is doubtful."""


Sides = tuple[float, float, float]
"""Of what has to find a place: across the line of sight, along it, and its height, all [m]."""


def ground_place(
    image: Floats, drop_m: float, body: Sides, distances_m: Array, azimuths_deg: Array, usual_m: float
) -> tuple[float, float, float]:
    """Return the best of some places on the ground of a levelled panorama (h, w, 3) of linear light.

    That is the azimuth of its middle [deg], its level distance [m], and its cost, 0.3 on even ground.

    drop_m: height of the camera over the ground. distances_m: (n,), level. azimuths_deg: (m,). usual_m: the distance
    that is preferred where all else is equal.
    """
    layout = _Layout.of(image)
    azimuth, distance = np.meshgrid(np.radians(azimuths_deg), distances_m / drop_m, indexing="ij")
    across, along = body[0] / drop_m, body[1] / drop_m
    side = np.linspace(-0.5, 0.5, _ACROSS)
    right, ahead = (points.ravel() for points in np.meshgrid(side * across, side * along))
    foot = layout.cells(azimuth[..., None], distance[..., None] + ahead, right)
    edges, fine = layout.edges[foot], layout.fine[foot].mean(axis=-1)
    shades = layout.shades[foot].mean(axis=-2)
    unlike = np.sqrt(np.mean(((shades - layout.usual) / layout.spread) ** 2, axis=-1))
    missing = np.log(max(layout.texture, _BARE) / np.maximum(fine, 1e-4))
    cost = _EDGES * (np.sqrt(np.mean(edges**2, axis=-1)) + 0.25 * edges.max(axis=-1)) + _UNLIKE * unlike
    cost += _SHADE * np.maximum(layout.usual[0] - shades[..., 0] - _SHADE_FROM, 0.0)
    cost += _PLAIN * np.maximum(missing - _PLAIN_FROM, 0.0) + np.maximum(np.log(_BARE / np.maximum(fine, 1e-4)), 0.0)
    cost += _CROSSED * _crossed(layout, azimuth[:, 0], distance[0] + 0.5 * along, across)
    cost += _HIDES * _hidden(image, azimuth, distance * drop_m, body, drop_m)
    cost += _ASIDE * np.abs(np.degrees(azimuth)) + _ODD * np.abs(np.log(distance * drop_m / usual_m))
    row, column = np.unravel_index(int(np.argmin(cost)), cost.shape)
    return float(azimuths_deg[row]), float(distances_m[column]), float(cost[row, column])


def shows_ground(image: Floats) -> bool:
    """Return whether a levelled panorama (h, w, 3) of linear light shows ground near by: it has structure there."""
    return _Layout.of(image).texture > _BARE


@dataclass(frozen=True, slots=True, eq=False)
class _Layout:
    """The plate's light on the level ground, seen from above, +x to the right and +z down, the camera in the middle.

    shades: (n, n, 3) logarithms of light, of red and of blue over green, blurred. edges: (n, n) change of them across
    the blur. fine: (n, n) fine structure. usual, spread: (3,) of the ground near by; texture: its fine structure.
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
        column, row = frame_from_direction(np.stack([x, np.full_like(x, -1.0), z], axis=-1), width, height)
        around = np.concatenate([image, image[:, :1]], axis=1).astype(np.float32)
        where = ((column - 0.5).astype(np.float32), (row - 0.5).astype(np.float32))
        seen = cv2.remap(around, *where, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        ground = np.log(np.maximum(seen, 0.0) + _DARK)
        light = np.log(np.maximum(luminance(seen), 0.0) + _DARK)
        shades = np.stack([light, *(_COLOR * (ground[..., k] - ground[..., 1]) for k in (0, 2))], axis=-1)
        blurred = cv2.GaussianBlur(shades, (0, 0), _BLUR / _CELL).astype(np.float64)
        change = np.stack(np.gradient(blurred, axis=(0, 1))) * (_BLUR / _CELL)
        fine = np.abs(light - blurred[..., 0])
        far = np.hypot(x, z)
        near = (far > _NEAR_GROUND[0]) & (far < _NEAR_GROUND[1])
        usual = np.median(blurred[near], axis=0)
        spread = np.maximum(1.48 * np.median(np.abs(blurred[near] - usual), axis=0), _LEAST_SPREAD)
        edges = np.sqrt(np.sum(change**2, axis=(0, -1)))
        return cls(blurred, edges, cv2.blur(fine, (9, 9)), usual, spread, float(np.median(fine[near])))

    def cells(self, azimuth: Array, ahead: Array, right: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the (row, column) of points ahead and to the right in some azimuths [rad], in camera heights.

        Those outside are taken to the rim.
        """
        x = ahead * np.sin(azimuth) + right * np.cos(azimuth)
        z = right * np.sin(azimuth) - ahead * np.cos(azimuth)
        row, column = (np.clip(((v + _REACH) / _CELL).astype(int), 0, len(self.edges) - 1) for v in (z, x))
        return row, column


def _crossed(layout: _Layout, azimuth: Array, ends: Array, width: float) -> Array:
    """Return the strongest edge (azimuths, ends) across the way from the camera to somewhat past some ends.

    The way is as wide as the foot; an edge counts where it crosses one of its lanes.
    """
    lanes = max(1, round(width / _LANE))
    ahead = np.arange(_WAY_FROM, _REACH, _BLUR)
    right = np.linspace(-0.5, 0.5, lanes * _ACROSS)[:, None] * max(width, _LANE)
    shades = layout.shades[layout.cells(azimuth[:, None, None], ahead, right)]
    shades = shades.reshape(len(azimuth), lanes, _ACROSS, len(ahead), 3).mean(axis=2)
    step = np.linalg.norm(shades[:, :, 2:] - shades[:, :, :-2], axis=-1).max(axis=1)
    last = np.searchsorted(ahead[1:-1], ends + 2.0 * _BLUR)
    return np.asarray(np.maximum.accumulate(step, axis=1)[:, np.minimum(last, step.shape[1] - 1)])


def _hidden(image: Floats, azimuth: Array, distance_m: Array, body: Sides, drop_m: float) -> Array:
    """Return how much is to be seen behind a body at some places: edges there over those of the whole plate, less 1."""
    import cv2

    height, width = image.shape[:2]
    scale = height / 180.0
    light = cv2.GaussianBlur(np.log(np.maximum(luminance(image), 0.0) + _DARK).astype(np.float32), (0, 0), scale)
    edges = np.hypot(*np.gradient(light)) * scale
    across, up = np.meshgrid(np.linspace(-0.5, 0.5, _ACROSS), np.linspace(0.1, 1.0, _ACROSS))
    longitude = azimuth[..., None] + np.arctan(across.ravel() * body[0] / distance_m[..., None])
    latitude = np.arctan2(up.ravel() * body[2] - drop_m, distance_m[..., None])
    column = np.floor((longitude / (2.0 * np.pi) + 0.5) * width).astype(int) % width
    row = np.clip(((0.5 - latitude / np.pi) * height).astype(int), 0, height - 1)
    behind = np.mean(edges[row, column], axis=-1) / max(float(np.mean(edges)), 1e-3)
    return np.asarray(np.maximum(behind - 1.0, -0.5))
