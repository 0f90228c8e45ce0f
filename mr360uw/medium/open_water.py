# SPDX-License-Identifier: Apache-2.0
"""Open water in a plate: its colour over elevation, and its light by direction.

The colour is a profile over elevation that is robust against animals, divers and rocks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.base.cache import shared
from mr360uw.base.color import luminance
from mr360uw.base.constants import PI
from mr360uw.base.parameters import numbers, real
from mr360uw.base.texels import smoothstep
from mr360uw.errors import ParameterError
from mr360uw.medium.medium import Medium
from mr360uw.types import Array, Floats

_BLACK = 1e-30
_OPEN, _CLOSED = 0.3, 0.7
"""Ranks in red, 0 for least, between which the weight of an azimuth falls from 1 (open water) to 0 (bodies, rocks)."""
_MIDDLE = 0.3
"""Fraction of the values about the median that is averaged: 35 % on either side may be outliers."""
LEVEL_RAD = np.radians(12.0)
"""Elevation [rad] up to which rows show water rather than surface or ground; twice as large, both come into view."""


def row_up(rows: int) -> Array:
    """Return the y of the direction of each row of an equirectangular map, (rows,), top row first."""
    return np.sin(np.pi * (0.5 - (np.arange(rows) + 0.5) / rows))


def upwelling(light: Floats) -> Array:
    """Return the irradiance (3,) of a level plane that faces down, in a levelled map (H, W, 3) of light."""
    up = row_up(len(light))
    of_row = np.maximum(-up, 0.0) * np.sqrt(1.0 - up**2) * (2.0 * PI * PI / light[..., 0].size)
    return np.asarray(np.einsum("r,rck->k", of_row, light))


def _check_map(radiance_map: Floats) -> Array:
    """Return a radiance map (H, W, 3) as float64; raise `ParameterError` for another shape or values."""
    m = real("radiance_map", radiance_map).astype(np.float64)
    if m.ndim != 3 or m.shape[2] != 3 or m.shape[0] < 8 or not np.all(np.isfinite(m)) or np.any(m < 0.0):
        raise ParameterError(
            f"radiance_map - must be an equirectangular map (H, W, 3), finite, >= 0 (got {m.shape}) - "
            "pass the environment's radiance"
        )
    return m


@dataclass(frozen=True, slots=True, eq=False)
class PlateProfile:
    """Colour of a plate's water over elevation.

    up: (r,) ascending, radiance: (r, 3).
    """

    up: Array
    radiance: Array

    def __call__(self, up: ArrayLike) -> Array:
        """Return the radiance (..., 3) in directions with the y component `up`."""
        mu = numbers("up", up).astype(np.float64, copy=False)
        return np.stack([np.interp(mu, self.up, channel) for channel in self.radiance.T], axis=-1)

    @classmethod
    def from_map(cls, radiance_map: Floats) -> PlateProfile:
        """Return the typical colour of each row where the view is open, smoothed over three rows.

        Azimuths with less red about the horizon than the others count as open, because water absorbs red first. Typical
        is the trimmed mean of the logarithm over them, which ignores bodies that cover a third. All weights are
        continuous, so the profile of a clip changes no faster than its picture.
        """
        m = _check_map(radiance_map)
        level = m[np.abs(np.arcsin(row_up(len(m)))) <= LEVEL_RAD].sum(axis=0)
        x = np.log(np.maximum(m, 1e-6 * max(float(m.max()), _BLACK)))
        middle = np.exp(typical(x, openness(level), _MIDDLE))
        rows = np.where(m.max(axis=1) > 0.0, middle, 0.0)[::-1]
        padded = np.pad(rows, ((1, 1), (0, 0)), mode="edge")
        calm = np.median([padded[:-2], padded[1:-1], padded[2:]], axis=0)
        padded = np.pad(calm, ((1, 1), (0, 0)), mode="edge")
        smooth = 0.25 * padded[:-2] + 0.5 * padded[1:-1] + 0.25 * padded[2:]
        return cls(row_up(len(m))[::-1].copy(), smooth)


def openness(level: Array) -> Array:
    """Return the weight (c,) of azimuths by the rank in red of their light (c, 3): 1 for the least, 0 for the most."""
    red = level[:, 0] / np.maximum(level.sum(axis=1), _BLACK)
    rank = (np.argsort(np.argsort(red, kind="stable")) + 0.5) / len(red)
    return smoothstep(rank, _CLOSED, _OPEN)


def typical(values: Array, weight: Array, middle: float) -> Array:
    """Return the weighted mean (..., 3) of the middle of values (..., c, 3) of azimuths, by rank in each channel.

    weight: (c,). middle: fraction of the azimuths about the median that is averaged.
    """
    order = np.argsort(values, axis=-2, kind="stable")
    share = np.take_along_axis(np.broadcast_to((weight / weight.sum())[:, None], values.shape), order, -2)
    end = np.cumsum(share, axis=-2)
    low, high = 0.5 - 0.5 * middle, 0.5 + 0.5 * middle
    inside = np.clip(end, low, high) - np.clip(end - share, low, high)
    return np.asarray((inside * np.take_along_axis(values, order, -2)).sum(axis=-2) / inside.sum(axis=-2))


TYPICAL_RANK = 0.3
"""Rank in red of an azimuth that shows water alone, as long as bodies and rocks leave a third of the horizon."""
MIDDLE = 0.5
"""Fraction of the open azimuths about the median that is averaged; bodies may cover a quarter of them unseen."""


# Light of open water by direction, over that of the solved field: it scales the veil of distant things.
#
#     r(d) = V(d)/(g L(up))        veil(d, s) = r(d) g veil(up, s)
#
# V: the plate; g, L: gain and solved light of open water from a direction, without bodies, with what a level floor
# sends up. Where the plate shows open water, r makes the veil of a long way the plate's own. Elsewhere log (r/R) is
# harmonic over the sphere: it takes its values from the water around, so that a diver's suit is not in it, and varies
# about the sun as R, the solved light does (`around_sun`); what a floor sends is alike on all sides. Where no open
# water is seen, r is R; without a sun R is 1.
#
# Open water is smooth over a few degrees and no redder than the rest of it. It is what is seen on long ways: not near
# the zenith, where the surface shows, nor where the ground is near. Where the plate goes on below the horizon as its
# water does, and not as its ground would, the ground falls away, and L is the veil of a long way.
#
# Harmonic: `filled` minimises over u
#
#     integral of  w (u - v)^2 + l^2 |grad u|^2 + e u^2        (Laplace's equation where w = 0)
#
# v, w: values and how far they are known; l: length over which values that are known are smoothed; e: so small that it
# only decides where nothing is known, for 0.
#
# Over a clip it is looked for every two seconds, averaged over some more, and interpolated in between: what swims by
# hides other directions in the next seconds, so that the mean over a few looks knows more of them than one. The gain of
# the veil has the clip's exposure; the ratio to it changes slowly.

COLUMNS, ROWS = 256, 128
"""Size of the map: 1.4 degrees. Between its pixels the water about a sun is off by a tenth of a code."""
FINER = 2
"""Factor by which a plate is read finer than the map."""
_FINE_DEG, _COARSE_DEG, _WIDE_DEG = 0.4, 1.6, 1.0
"""Deviations of the blurs between which structure is taken, and over which it is averaged."""
_SMOOTH, _ROUGH = 0.02, 0.05
"""Structure, rms of the logarithm of light, from which a direction counts less as open water, and not at all."""
_REDDER, _REDDEST = 1.15, 1.6
"""Share of red, over that of the least red smooth directions, between which a direction loses its weight."""
_LEVEL = 0.25
"""Sine of elevation over which directions fall off in what is typical: there ways are long."""
_FAR, _NEAR = 0.05, 0.25
"""Share of light from beyond the water between which a direction loses its weight."""
_GROUND, _WATER = 0.1, 0.3
"""Least amount by which the logarithm of light is nearer to water that goes on than to ground, for any weight,
and at which it has all of it."""
_STRAYS = 0.3
"""Difference of the logarithm of light from water that goes on, up to which it may be that: half of it counts less."""
_HORIZON = 0.03
"""Sine of elevation over which directions tell the water of the horizon in their azimuth."""
_UNLIKE, _UNLIKEST = 0.8, 1.2
"""Logarithm of the light over the typical one between which a direction loses its weight: bodies that fill the view."""
DARKEST = 1e-4
"""Light of open water that is told from black: a third of an 8-bit code."""
_TINY = 1e-300
_DIM = 0.05
"""Light, over that of open water, that is added before logarithms and shares are taken: grain is no structure."""
_LEAST_SEEN = 0.002
"""Fraction of the sphere that must be open water for the plate to be believed; half as much: half believed."""


@dataclass(frozen=True, slots=True, eq=False)
class OpenWater:
    """Open water of a plate. level: (ROWS, COLUMNS, 3) log V/L of the module's text, world axes.

    weight: (ROWS, COLUMNS) how far each direction is open water, 0 to 1. least_gain: (3,) see `visible_gain`. around:
    (ROWS, COLUMNS, 3) log R, or 0.
    """

    level: Array
    weight: Array
    least_gain: Array
    around: Array | float = 0.0

    def ratio(self, gain: ArrayLike) -> NDArray[np.float32]:
        """Return the ratio r (ROWS, COLUMNS, 3) of the module's text for a gain (3,)."""
        return np.exp(_mean_log_ratio([self], [gain], [1.0])).astype(np.float32)


def _mean_log_ratio(looks: Sequence[OpenWater], gains: Sequence[ArrayLike], shares: Sequence[float]) -> Array:
    """Return the logarithm of the ratio (ROWS, COLUMNS, 3) from several looks, each for a gain (3,), with a share."""
    known = np.zeros((ROWS, COLUMNS))
    total, around = np.zeros((ROWS, COLUMNS, 3)), np.zeros((ROWS, COLUMNS, 3))
    for look, gain, share in zip(looks, gains, shares, strict=True):
        weight = share * look.weight
        known += weight
        total += weight[..., None] * (look.level - np.log(np.maximum(gain, look.least_gain)))
        around += share / sum(shares) * look.around
    return around + filled(total / np.maximum(known, _TINY)[..., None] - around, known / sum(shares))


def beside_floor(around: Floats, of_floor: Floats) -> Array:
    """Return R (ROWS, COLUMNS, 3) of light of which a share (ROWS, 3) is a floor's: that is alike in all azimuths."""
    return np.asarray(of_floor[:, None] + (1.0 - of_floor[:, None]) * around)


def visible_gain(medium: Medium, gain: ArrayLike) -> Array:
    """Return a gain (3,) raised so far that open water at the horizon has a third of a code in every channel."""
    return np.maximum(gain, DARKEST / np.maximum(medium.level_radiance(np.zeros(1))[0], _TINY))


def open_water(
    medium: Medium, gain: ArrayLike, shown: Floats, above_ground_m: float | None = None, around: Floats | None = None
) -> OpenWater:
    """Return the open water of a plate. shown: (h, w, 3) its linear light, equirectangular, in world axes.

    gain: (3,) of the medium's veil, near which open water is looked for. above_ground_m: height of the camera over a
    level ground, None where there is none. around: (ROWS, COLUMNS, 3) R of the module's text, None for 1.
    """
    import cv2

    size = FINER * COLUMNS, FINER * ROWS
    shown = np.asarray(cv2.resize(np.maximum(shown, 0.0).astype(np.float64), size, interpolation=cv2.INTER_AREA))
    small = np.maximum(cv2.resize(shown, (COLUMNS, ROWS), interpolation=cv2.INTER_AREA), DARKEST)
    up, used = row_up(ROWS), visible_gain(medium, gain)
    floor = medium.floor_seen(used, upwelling(small))
    level, of_floor = medium.far_light(up, used, floor)
    light = used * np.repeat(level[:, None], COLUMNS, axis=1)
    around = np.ones(light.shape) if around is None else beside_floor(around, of_floor)
    dim = _DIM * float(luminance(light).max()) + DARKEST
    seen = smoothstep(_from_beyond(medium, up, above_ground_m), _NEAR, _FAR)[:, None]
    sharp = _eroded(smoothstep(structure(shown, dim), _ROUGH, _SMOOTH))
    smooth = np.asarray(cv2.resize(sharp, (COLUMNS, ROWS), interpolation=cv2.INTER_AREA))
    weight = smooth * seen
    if above_ground_m is not None:
        down = up < 0.0
        far = used * medium.far_veil(up[down], used, floor)[:, None]
        horizon = weight * np.exp(-((up / _HORIZON) ** 2))[:, None]
        usual = _usual(small, light * around, horizon)
        ground, water = (usual * one for one in (light[down] * around[down], far * around[down]))
        goes_on = _goes_on(small[down], ground, water) * np.minimum(horizon.sum(axis=0), 1.0)
        either = goes_on + seen[down] * (1.0 - goes_on)  # 1 - (1 - a)(1 - b) is rounded to 0 where both are tiny
        part = (goes_on / np.maximum(either, _TINY))[..., None]
        light[down] *= (far / np.maximum(light[down], _TINY)) ** part
        weight[down] = smooth[down] * either
    area = np.sqrt(1.0 - up**2)[:, None] * np.ones(COLUMNS)
    about = area * np.exp(-((up / _LEVEL) ** 2))[:, None]
    red = (small[..., 0] + dim) / (small.sum(axis=-1) + 3.0 * dim)
    bright = luminance(small) / luminance(light)
    weight = weight * smoothstep(red / weighted_quantile(red, weight * about * bright, TYPICAL_RANK), _REDDEST, _REDDER)
    typical = weighted_quantile(bright, weight * about * bright, 0.5)
    weight = weight * smoothstep(np.abs(np.log(bright / typical)), _UNLIKEST, _UNLIKE)
    share = float((weight * area).sum() / area.sum())
    weight = weight * min(share / _LEAST_SEEN, 1.0)
    level, least = np.log(used * small / np.maximum(light, _TINY)), visible_gain(medium, np.zeros(3))
    return OpenWater(level, weight, least, np.log(np.maximum(around, DARKEST)))


def _usual(small: Array, light: Array, weight: Array) -> Array:
    """Return the mean ratio (c, 3) of a plate (n, c, 3) to light (n, c, 3) in each column; weight: (n, c)."""
    log = (weight[..., None] * np.log(small / np.maximum(light, _TINY))).sum(axis=0)
    return np.asarray(np.exp(log / np.maximum(weight.sum(axis=0), _TINY)[:, None]))


def _goes_on(small: Array, ground: Array, water: Array) -> Array:
    """Return the weight (r, c), 0 to 1, with which a plate (r, c, 3) below the horizon looks like water without ground.

    ground, water: (r, c, 3) what it would be with a level ground and without.
    """
    dim = (_DIM * luminance(water[0]) + DARKEST)[:, None]
    to_ground, to_water = (np.abs(np.log((small + dim) / (one + dim))).max(axis=-1) for one in (ground, water))

    def like(one: Array, other: Array) -> Array:
        return smoothstep(one - other, -_GROUND, -_WATER) * smoothstep(one, _STRAYS, 0.5 * _STRAYS)

    above_ground = 1.0 - np.maximum.accumulate(like(to_ground, to_water), axis=0)  # below it ground is nearer still
    return like(to_water, to_ground) * above_ground


def _from_beyond(medium: Medium, up: Array, above_ground_m: float | None) -> Array:
    """Return the share (r,) of light from the surface, or from a level ground, in directions of y `up`."""
    depth, whole = medium.camera_depth_m, luminance(medium.level_radiance(up))
    to_surface = depth / np.maximum(up, 1e-6)
    veil = luminance(medium.unit_veil(to_surface, np.maximum(up, 1e-6)))
    share = np.where(up > 0.0, 1.0 - veil / np.maximum(whole, _TINY), 0.0)
    if above_ground_m is None:
        return share
    to_ground = max(above_ground_m, 0.0) / np.maximum(-up, 1e-6)
    left = medium.transmittance(to_ground, depth, np.minimum(up, 0.0)).max(axis=-1)
    return np.where(up < 0.0, left, share)


def structure(shown: Floats, dim: float) -> Array:
    """Return the structure (h, w) of a panorama (h, w, 3) of linear light: the rms of its logarithm over a few degrees.

    dim: light that is added before, of which differences are not seen.
    """
    import cv2

    scale = len(shown) / 180.0
    margin = round(4.0 * (_COARSE_DEG + _WIDE_DEG) * scale)

    def blur(values: Array, degrees: float) -> Array:
        return np.asarray(cv2.GaussianBlur(values, (0, 0), degrees * scale))

    light = np.pad(luminance(shown), ((0, 0), (margin, margin)), mode="wrap")
    log = np.log(blur(light, _FINE_DEG) + dim)
    return np.sqrt(blur((log - blur(log, _COARSE_DEG)) ** 2, _WIDE_DEG))[:, margin:-margin]


def _eroded(weight: Array) -> Array:
    """Return the least weight (h, w) among neighbours, so that edges of bodies are not open water."""
    import cv2

    wide = np.pad(weight, ((0, 0), (2, 2)), mode="wrap")
    return np.asarray(cv2.erode(wide, np.ones((3, 3))))[:, 2:-2]


def weighted_quantile(values: Floats, weight: Floats, rank: float) -> float:
    """Return the weighted quantile of values; that of all where none has a weight."""
    if not np.any(weight > 0.0):
        return float(np.quantile(values, rank))
    order = np.argsort(values, axis=None, kind="stable")
    share = np.cumsum(weight.ravel()[order])
    return float(values.ravel()[order][np.searchsorted(share, rank * share[-1])])


_SMOOTHED = 0.5
"""l in pixels of the equator."""
_NOTHING = 1e-7
"""e: a millionth of what a pixel that is known counts."""
_TURNS, _SWEEPS, _RELAXED = 3, 4, 0.8
"""Turns of both grids, sweeps over the fine one in each, and the part of a step that a sweep takes. The logarithm of
light is within .006 of the exact one, .0003 at the median; with two turns .026, with four .005, beside the poles."""


def filled(values: Array, weight: Array) -> Array:
    """Return an equirectangular map (h, w, k) that follows values where weights (h, w) of 0 to 1 say they are known.

    Two grids, h and w even: what a map of half the size leaves over is relaxed on the whole one, in turns.
    """
    import cv2
    from scipy.sparse import diags
    from scipy.sparse.linalg import splu

    height, width, channels = values.shape

    def halved(fine: Array) -> Array:
        whole = fine.reshape(height // 2, 2, width // 2, 2, -1).sum(axis=(1, 3))
        return np.asarray(whole.reshape(height * width // 4, -1))

    def doubled(coarse: Array) -> Array:
        small = coarse.reshape(height // 2, width // 2, channels)
        around = np.pad(np.pad(small, ((0, 0), (1, 1), (0, 0)), mode="wrap"), ((1, 1), (0, 0), (0, 0)), mode="edge")
        large = cv2.resize(around, (width + 4, height + 4), interpolation=cv2.INTER_LINEAR)
        return np.asarray(large[2:-2, 2:-2].reshape(height * width, channels))

    # What holds each pixel to its own value, and to those beside it
    area, stiffness = _sphere(height, width)
    held = (weight.ravel() + _NOTHING) * area
    whole = (stiffness + diags(held)).tocsr()
    coarse = splu((_sphere(height // 2, width // 2)[1] + diags(halved(held)[:, 0])).tocsc(), permc_spec="MMD_AT_PLUS_A")
    wanted = (weight.ravel() * area)[:, None] * values.reshape(-1, channels)
    # Solve what is left over, smoothly on the coarse grid, then pixel by pixel
    found, step = np.zeros_like(wanted), _RELAXED / whole.diagonal()[:, None]
    for _ in range(_TURNS):
        found += doubled(coarse.solve(halved(wanted - whole @ found)))
        for _ in range(_SWEEPS):
            found += step * (wanted - whole @ found)
    return found.reshape(values.shape)


@shared(keep=2)
def _sphere(height: int, width: int) -> tuple[Array, Any]:
    """Return the areas (n,) of pixels, of 1 at the equator, and the sparse matrix (n, n) of l^2 |grad u|^2."""
    from scipy.sparse import coo_matrix

    number = np.arange(height * width).reshape(height, width)
    latitude = np.pi * (0.5 - (np.arange(height) + 0.5) / height)
    edge = np.cos(np.pi * (0.5 - np.arange(1, height) / height))
    across = np.broadcast_to(1.0 / np.cos(latitude)[:, None], (height, width))  # height over width of a pixel
    pairs = [
        (number, np.roll(number, -1, axis=1), across),
        (number[:-1], number[1:], np.broadcast_to(edge[:, None], (height - 1, width))),
    ]
    one, other = (np.concatenate([pair[k].ravel() for pair in pairs]) for k in (0, 1))
    weight = _SMOOTHED**2 * np.concatenate([pair[2].ravel() for pair in pairs])
    rows, columns = np.concatenate([one, other, one, other]), np.concatenate([one, other, other, one])
    matrix = coo_matrix((np.concatenate([weight, weight, -weight, -weight]), (rows, columns)))
    return np.repeat(np.cos(latitude), width), matrix.tocsr()


_STEP_S = 2.0
"""Time [s] between two looks: the sea's colour in a direction lasts longer, unless the camera turns unknown."""
_KERNEL = np.array([1.0, 2.0, 3.0, 2.0, 1.0]) / 3.0
"""Weights of neighbouring looks: over 4 s on either side, within the margin that the first pass reads."""


@dataclass(frozen=True, slots=True, eq=False)
class OpenWaterTrack:
    """Ratio of a clip's open water to its veil.

    index: (K,) frames of the clip, ascending. log_ratio: (K, ROWS, COLUMNS, 3) its logarithm there, float16. cuts: (C,)
    frames of the clip that begin a shot.
    """

    index: NDArray[np.int64]
    log_ratio: NDArray[np.float16]
    cuts: NDArray[np.int64]

    def ratio_at(self, index: int) -> NDArray[np.float32] | None:
        """Return the ratio (ROWS, COLUMNS, 3) of a frame, None in a shot that was not looked at."""
        here = np.flatnonzero(self._shot(self.index) == self._shot(np.array([index])))
        if len(here) == 0:
            return None
        place = float(np.interp(index, self.index[here], np.arange(len(here))))
        before = int(place)
        after, share = min(before + 1, len(here) - 1), np.float32(place - before)
        one, other = (self.log_ratio[here[k]].astype(np.float32) for k in (before, after))
        return np.exp((1.0 - share) * one + share * other)

    def _shot(self, index: NDArray[np.int64]) -> NDArray[np.int64]:
        return np.searchsorted(self.cuts, index, side="right")


class OpenWaterLooks:
    """Looks at the open water of a clip, in its frames' order."""

    def __init__(self, frame_rate: float) -> None:
        self._step = max(round(_STEP_S * frame_rate), 1)
        self._index: list[int] = []
        self._looks: list[OpenWater] = []

    def due(self, index: int) -> bool:
        """Return whether frame `index` of the clip is looked at; that depends on the index alone."""
        return index % self._step == 0

    def add(self, index: int, look: OpenWater) -> None:
        """Add the open water of a frame that is due."""
        self._index.append(index)
        self._looks.append(look)

    def track(self, gain: Floats, first: int, cuts: NDArray[np.int64]) -> OpenWaterTrack | None:
        """Return the track for a steady gain (N, 3) of frames `first` and on; None without a look.

        cuts: (C,) places in it that begin a shot.
        """
        if not self._index:
            return None
        index, cuts = np.array(self._index), cuts + first
        shot, half = np.searchsorted(cuts, index, side="right"), len(_KERNEL) // 2
        maps = []
        for k in range(len(index)):
            near = [j for j in range(max(k - half, 0), min(k + half + 1, len(index))) if shot[j] == shot[k]]
            share = [_KERNEL[j - k + half] for j in near]
            looks, gains = [self._looks[j] for j in near], [gain[index[j] - first] for j in near]
            maps.append(_mean_log_ratio(looks, gains, share))
        return OpenWaterTrack(index, np.array(maps, np.float16), cuts)
