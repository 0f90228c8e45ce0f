# SPDX-License-Identifier: Apache-2.0
"""Attenuation and veil of a water from places that are seen at several distances, in each channel.

A place of a scene sends the light L0, unknown and its own in each channel. From the distance d, in a direction whose y
is u, a camera sees

    L = L0 exp(-c d) + V(u) (1 - exp(-e(u) d)) + s V (exp(-D c d) - exp(-c d))
    e(u) = c (a - k u)        V(u) = V exp(g u + h u^2 + p x + q z)

x, z: of the direction. c: attenuation [1/m]. V: light of open water along the horizon, the veil of a long way. The
veil of ways that lead down fills up faster and to less; that of a channel whose longer waves are lost soon fills up
more slowly than things fade, as its shorter waves come from farther: a = (c/c')^-0.75, c' of the next shorter channel.
So it is, nearly, in the solved light fields of all types of water; in plain haze (Koschmieder 1924), a is 1 and g, h,
k, p and q are 0. Either is likely before a clip is seen, and what lies between them. s: light of large surfaces, of
which water scatters some into the rays to each of their places, so that it fades D times as fast; in both it is 0.

L0 is eliminated for each place by least squares. Light that moves over a place (caustics) changes L0 from frame to
frame; the more a place changes, the less it counts, and large deviations are clipped, all relative to exp(-c d), so
that near and far frames are treated alike.

Intervals are of the bootstrap over parts of the scene and over frames, with k and exposure drawn too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mr360uw.medium.closed_form import LEAST_M, MOST_M, visibility_m
from mr360uw.medium.medium import Medium
from mr360uw.medium.water import JERLOV_TYPES, JerlovType, Water
from mr360uw.types import Array

_FASTER, _FASTER_SPREAD = 0.35, 0.3
"""k, and its standard deviation: .55 in the solved fields of Jerlov types IB to 7C at 5 m, 0 in plain haze."""
_SLOWER, _SLOWER_SPREAD, _SLOWER_LEAST = 0.45, 0.4, 0.1
"""Minus the logarithm of a for that of c/c', and its standard deviation, for that and at least: .75 in these fields, 0
in plain haze."""
_SLOPE, _SLOPE_SPREAD = 0.9, 0.7
"""g, and its standard deviation: 1.4 in these fields, 0 in plain haze."""
_SIDE_SPREAD = 0.6
"""Standard deviation of p and of q: the veil is brighter towards the sun, and darker before a reef. With
half of it more intervals of turbid water miss the truth."""
_DIFFUSE, _AROUND_SPREAD = 0.25, 1.5
"""D, and the standard deviation of s. Of twelve path-traced worlds 72 % of the attenuation's intervals hold the truth,
69 % with 0.4 and 0.7, and 56 % without s."""
_BEND_SPREAD = 0.5
"""Standard deviation of h, whose mean is 0."""
_CLEAREST, _MURKIEST = 0.005, 3.0
"""Range of attenuations [1/m]: below that of pure water in blue, above that of type 9C."""
_STARTS = (0.06, 0.3)
"""Attenuations [1/m] that fits begin at; the better end counts."""
_ROUNDS = 3
"""Times the weights are made anew from what the last fit left over."""
_CLIP = 2.0
"""Deviations, in standard deviations of a place, beyond which they count linearly (Huber)."""
_STEPS, _RELATIVE = 0.0015, 0.02
"""Noise of a place's light: a third of a code of 8 bits in the dark, and the error of poses and distances."""
_OPEN_NOISE, _OPEN_HIGH, _OPEN_STEP = 0.03, 0.35, 0.0005
"""Standard deviation of the logarithm of the light of open water about the model along the horizon, what is added per
unit of u above it, where the surface comes into view, and the step of a code in the dark."""
_ALIKE = 24.0
"""Rows that deviate alike: those of a place, and of places beside each other under the same caustics."""
_LEAST_FRAMES = 3
"""Frames that must show a place."""
_MOST_PLACES = 800
"""Places that are used; of more a random sample, as many more only make smaller what other errors outweigh."""
_DRAWS = 30
"""Samples of the bootstrap."""
_DRIFT, _COMMON = 0.01, 0.04
"""Standard deviations of the logarithm of exposure between near and far frames, and of attenuation and veil by errors
that all frames share (the model, the scale of the maps), which draws add."""
_NINETY = (5.0, 95.0)
"""Percentiles between which the interval lies."""
LEAST_PLACES, LEAST_RANGE, MOST_SPREAD = 60, 1.25, 2.5
"""Places needed, median ratio of their largest over their least distance, and ratio of the ends of an interval from
which a channel is not told."""
_SCALE_SPREAD = 0.3
"""Standard deviation of the logarithm of a common factor on the attenuation of a type: waters of a colour are clearer
or murkier."""
_DEPTH_M = 5.0
"""Depth [m] at which types are compared: a ray of 10 m changes by a few per cent with it."""


@dataclass(frozen=True, slots=True, eq=False)
class SeenPlaces:
    """Places of a scene in frames of a clip, and its open water.

    light: (n, k, 3) linear light of n places in k frames. distance_m, up, across: (n, k) from the camera, y of the
    direction from it, and (n, k, 2) its x and z. seen: (n, k) whether a place is seen in a frame. part: (n,) number of
    the part of the scene that a place belongs to; parts are resampled whole. open_up: (m,), open_light: (m, 3) typical
    light of open water in directions, none where it is not seen.
    """

    light: Array
    distance_m: Array
    up: Array
    across: Array
    seen: NDArray[np.bool_]
    part: NDArray[np.int64]
    open_up: Array
    open_light: Array


@dataclass(frozen=True, slots=True, eq=False)
class WaterByDistance:
    """Attenuation and veil of a water, in red, green and blue, and where nine of ten of their bootstrap lie.

    attenuation: (3,) [1/m] of the light of things. veil: (3,) linear light of open water along the horizon, in the
    exposure of the clip. low and high: the same, ends of the interval. visibility_m: with its ends
    `visibility_range_m`. water_type: the nearest of the Jerlov types, None for none. places: number that are seen at
    several distances. distance_range: median ratio of the largest and the least distance of a place. problem: why the
    water is not identifiable, "" if it is; values are then not to be used.
    """

    attenuation: Array
    attenuation_low: Array
    attenuation_high: Array
    veil: Array
    veil_low: Array
    veil_high: Array
    visibility_m: float
    visibility_range_m: tuple[float, float]
    water_type: JerlovType | None
    places: int
    distance_range: float
    problem: str = ""

    @property
    def overrides(self) -> list[str]:
        """The water as `--set` and a scene file take it; none where the clip does not tell it."""
        if self.problem:
            return []
        return [f'water.type="{self.water_type}"', f"water.visibility_m={self.visibility_m:.3g}"]

    def __str__(self) -> str:
        if self.problem:
            return f"the clip does not tell its water: {self.problem}"
        rows = [
            f"{name:6s} attenuation {c:.3f} /m ({low:.3f} to {high:.3f}), veil {v:.4f} ({a:.4f} to {b:.4f})"
            for name, c, low, high, v, a, b in zip(
                ("red", "green", "blue"), self.attenuation, self.attenuation_low, self.attenuation_high, self.veil,
                self.veil_low, self.veil_high, strict=True,
            )
        ]  # fmt: skip
        low, high = self.visibility_range_m
        seen = f"{self.places} places at distances that vary by {self.distance_range:.2f}"
        told = f"visibility {self.visibility_m:.1f} m ({low:.1f} to {high:.1f}), nearest type {self.water_type}; {seen}"
        return "\n".join([*rows, told])


def water_by_distance(seen: SeenPlaces, seed: int = 1) -> WaterByDistance:
    """Return attenuation and veil from places at several distances. seed: of the bootstrap's draws."""
    rng = np.random.default_rng([seed, 0x3A7E])
    enough = seen.seen.sum(axis=1) >= _LEAST_FRAMES
    far, near = (np.where(seen.seen, seen.distance_m, fill).T for fill in (-np.inf, np.inf))
    span = np.ones(len(seen.part))
    span[enough] = far.max(axis=0)[enough] / near.min(axis=0)[enough]
    ratio = float(np.median(span[enough])) if np.any(enough) else 1.0
    used = np.flatnonzero(span > LEAST_RANGE)
    if len(used) < LEAST_PLACES:
        return _untold(len(used), ratio)
    chosen = rng.permutation(used)[:_MOST_PLACES]
    draws = [_Draw.random(seen, chosen, rng) for _ in range(_DRAWS)]
    whole = _Draw(np.ones(len(chosen)), np.ones(seen.light.shape[1]), np.zeros(7))
    best, found = np.zeros((3, 2)), np.zeros((3, _DRAWS, 2))
    for channel in (2, 1, 0):  # each is compared with the next shorter waves
        one, shorter = _Channel(seen, chosen, channel), channel + 1
        theta = one.fit(whole, None if channel == 2 else best[shorter, 0])
        weight = one.weight(theta)
        best[channel] = theta[:2]
        for k, draw in enumerate(draws):
            _, again = one.fit_from(theta, draw, None if channel == 2 else found[shorter, k, 0], weight)
            found[channel, k] = again[:2] + _COMMON * rng.standard_normal(2)
    found += (best - np.median(found, axis=1))[:, None]
    c, v = np.exp(best.T)
    low, high = np.percentile(np.exp(found), _NINETY, axis=1)
    reach = np.percentile(seen.distance_m[chosen][seen.seen[chosen]], (10.0, 90.0))
    spread = np.log(high[:, 0] / low[:, 0])
    kind, sight = _nearest_type(c, spread, reach)
    ends = np.percentile([_nearest_type(np.exp(draw), spread, reach)[1] for draw in found[..., 0].T], _NINETY)
    return WaterByDistance(
        c, low[:, 0], high[:, 0], v, low[:, 1], high[:, 1], sight, (float(ends[0]), float(ends[1])), kind, len(used),
        ratio, _doubt(spread),
    )  # fmt: skip


def _doubt(spread: Array) -> str:
    """Return why attenuations with these logarithms (3,) of the ends of their intervals do not tell a water, or ""."""
    wide = spread[1:] > np.log(MOST_SPREAD)
    if not np.any(wide):
        return ""
    names = " and ".join(np.array(["green", "blue"])[wide])
    return (
        f"its attenuation in {names} is uncertain by more than a factor of {MOST_SPREAD:g}, as under strong caustics - "
        "film walls and rocks in the shade from near and from far"
    )


def _untold(places: int, ratio: float) -> WaterByDistance:
    """Return the answer for a clip that shows too few places at different distances."""
    none, nan = np.full(3, np.nan), float("nan")
    problem = (
        f"{places} places are seen at distances that vary enough, by {ratio:.2f} at the median (needed: {LEAST_PLACES} "
        f"places, {LEAST_RANGE:g}) - film the same rocks from near and far"
    )
    return WaterByDistance(none, none, none, none, none, none, nan, (nan, nan), None, places, ratio, problem)


@dataclass(frozen=True, slots=True, eq=False)
class _Draw:
    """A sample of places and frames. places: (n,) and frames: (k,) how often each counts.

    before: (7,) of g, h, log a, k, p, q and s, and open_off: of open water, in standard deviations from what is
    expected. drift: of the logarithm of light with that of distance.
    """

    places: Array
    frames: Array
    before: Array
    drift: float = 0.0
    open_off: float = 0.0

    @classmethod
    def random(cls, seen: SeenPlaces, chosen: NDArray[np.int64], rng: np.random.Generator) -> _Draw:
        """Return a draw with replacement of parts of the scene and of frames."""
        parts, number = np.unique(seen.part[chosen], return_inverse=True)
        count = seen.light.shape[1]
        often, frames = (np.bincount(rng.integers(0, n, n), minlength=n) for n in (len(parts), count))
        *before, drift, off = rng.standard_normal(9)
        return cls(often[number].astype(float), frames.astype(float), np.array(before), _DRIFT * drift, off)


class _Channel:
    """The light of places in one channel, as one row for each place and frame that shows it.

    Fits of it are theta (9,): log c, log V, g, h, log a, k, p, q and s of the module's text. shorter: log c of the next
    shorter waves, None for blue.
    """

    def __init__(self, seen: SeenPlaces, chosen: NDArray[np.int64], channel: int) -> None:
        shown = seen.seen[chosen]
        self._place, self._frame = np.nonzero(shown)
        self._count = shown.sum(axis=1)
        self._light = seen.light[chosen, :, channel][shown]
        self._distance, self._up = seen.distance_m[chosen][shown], seen.up[chosen][shown]
        self._across = seen.across[chosen][shown]
        self._far = np.log(self._distance) - np.mean(np.log(self._distance))
        self._open_up = seen.open_up
        self._open = np.log(np.maximum(seen.open_light[:, channel], _STEPS))
        coarse = _OPEN_STEP / np.maximum(seen.open_light[:, channel], _OPEN_STEP)
        self._open_noise = np.hypot(np.hypot(_OPEN_NOISE, _OPEN_HIGH * np.maximum(seen.open_up, 0.0)), coarse)

    _low = np.array([np.log(_CLEAREST), np.log(1e-5), -1.0, -2.0, -1.5, 0.0, -1.5, -1.5, -2.0])
    _high = np.array([np.log(_MURKIEST), np.log(4.0), 4.0, 2.0, 0.5, 1.0, 1.5, 1.5, 3.0])

    def fit(self, whole: _Draw, shorter: float | None) -> Array:
        """Return the fit of all places and frames."""
        veil = float(np.median(self._open if len(self._open) else np.log(np.maximum(self._light, 1e-4))))
        ends: list[tuple[float, Array]] = []
        for first in _STARTS:
            theta = np.array([np.log(first), veil, _SLOPE, 0.0, 0.0, _FASTER, 0.0, 0.0, 0.0])
            for _ in range(_ROUNDS):
                _, theta = self.fit_from(theta, whole, shorter, self.weight(theta))
            ends.append(self.fit_from(theta, whole, shorter, self.weight(ends[0][1] if ends else theta)))
        return min(ends, key=lambda end: end[0])[1]

    def fit_from(self, start: Array, draw: _Draw, shorter: float | None, weight: Array) -> tuple[float, Array]:
        """Return half the sum of squares of the fit to a draw, and the fit. weight: of each row."""
        from scipy.optimize import least_squares

        light = self._light * np.exp(draw.drift * self._far)
        root = np.sqrt(draw.places[self._place] * draw.frames[self._frame] * weight)
        found = least_squares(
            self._residuals, np.clip(start, self._low + 1e-6, self._high - 1e-6), bounds=(self._low, self._high),
            x_scale=(0.1, 0.1, 0.3, 0.3, 0.1, 0.1, 0.3, 0.3, 0.3), xtol=1e-4, ftol=1e-5, max_nfev=20,
            args=(draw, shorter, light, root),
        )  # fmt: skip
        return float(found.cost), found.x

    def weight(self, theta: Array) -> Array:
        """Return the weight of each row: less where a place's light changes, and for single deviations."""
        left, passed = self._left(theta, self._light, np.ones(len(self._light)))
        noise = np.hypot(_STEPS, _RELATIVE * self._light)
        square = np.bincount(self._place, (left / passed) ** 2, len(self._count))
        change = np.sqrt(square / np.maximum(self._count - 1, 1))
        sigma = np.hypot(change[self._place] * passed, noise)
        return np.asarray(np.minimum(1.0, _CLIP * sigma / np.maximum(np.abs(left), 1e-12)) / sigma**2)

    def _left(self, theta: Array, light: Array, weight: Array) -> tuple[Array, Array]:
        """Return what a fit leaves over of each row's light, and its transmittance."""
        slope, bend = theta[2:4]
        c, full, slower = np.exp(theta[[0, 1, 4]])
        passed, up = np.exp(-c * self._distance), self._up
        fills = c * np.maximum(slower - theta[5] * up, 0.1)
        veil = full * np.exp(slope * up + bend * up * up + self._across @ theta[6:8])
        beyond = light + veil * np.expm1(-fills * self._distance)
        beyond -= theta[8] * full * (np.exp(-_DIFFUSE * c * self._distance) - passed)
        above, below = (np.bincount(self._place, weight * passed * one, len(self._count)) for one in (beyond, passed))
        return beyond - (above / np.maximum(below, 1e-12))[self._place] * passed, passed

    def _residuals(self, theta: Array, draw: _Draw, shorter: float | None, light: Array, root: Array) -> Array:
        """Return residuals: of places in frames, of open water, and of what is known beforehand of all but c and V."""
        left, _ = self._left(theta, light, root * root)
        up, (c, full, slope, bend) = self._open_up, theta[:4]
        of_open = full + slope * up + bend * up * up - self._open
        # In standard deviations; the longer the waves of a channel, the less is known of a
        longer = 0.0 if shorter is None else max(float(c) - shorter, 0.0)
        expected = np.array([_SLOPE, 0.0, -_SLOWER * longer, _FASTER, 0.0, 0.0, 0.0])
        slower = _SLOWER_LEAST + _SLOWER_SPREAD * longer
        spread = np.array(
            [_SLOPE_SPREAD, _BEND_SPREAD, slower, _FASTER_SPREAD, _SIDE_SPREAD, _SIDE_SPREAD, _AROUND_SPREAD]
        )
        before = (theta[2:] - expected) / spread - draw.before
        return np.concatenate([left * root / np.sqrt(_ALIKE), of_open / self._open_noise - draw.open_off, before])


def _nearest_type(attenuation: Array, spread: Array, reach_m: Array) -> tuple[JerlovType, float]:
    """Return the Jerlov type nearest to attenuations (3,) [1/m], and the visibility [m] of that type made as murky.

    spread: (3,) of the logarithm of each. reach_m: (2,) distances between which they were measured.
    """
    sigma = np.maximum(0.3 * spread, 0.05)
    found = []
    for name in JERLOV_TYPES:
        of_type = np.log(_of_type(name, float(reach_m[0]), float(reach_m[1])))
        apart, weight = np.log(attenuation) - of_type, 1.0 / sigma**2
        factor = (weight * apart).sum() / (weight.sum() + 1.0 / _SCALE_SPREAD**2)
        misfit = (weight * (apart - factor) ** 2).sum() + (factor / _SCALE_SPREAD) ** 2
        found.append((float(misfit), name, float((weight * apart).sum() / weight.sum())))
    _, name, factor = min(found)
    return name, float(np.clip(visibility_m(Water.jerlov(name)) * np.exp(-factor), LEAST_M, MOST_M))


def _of_type(name: JerlovType, near_m: float, far_m: float) -> Array:
    """Return the attenuation (3,) [1/m] of a type between two distances, as the default sensor sees it."""
    passed = Medium(Water.jerlov(name)).transmittance(np.array([near_m, max(far_m, near_m + 0.1)]), _DEPTH_M, 0.0)
    return np.asarray(np.log(passed[0] / passed[1]) / (max(far_m, near_m + 0.1) - near_m))
