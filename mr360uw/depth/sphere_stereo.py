# SPDX-License-Identifier: Apache-2.0
"""Distances of an equirectangular frame from its neighbours with known poses.

A sweep of trial distances at half the size (256 to 512 columns), smoothed semi-globally, finds the surface; steps
around it at half and full size refine it. There each pixel of a window is warped by its own distance, so that windows
slant with the surface. Sweeps of frames nearby serve as well as one of the frame itself: they are carried to it by the
poses, and each pixel takes the distance under which the pictures agree best. The trials are even in the parallax of the
largest baseline: nothing depends on the unit of the poses.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.parameters import checked
from mr360uw.depth.warping import Map, Panorama, Warped, carried, of_windows, resized, window_mean
from mr360uw.errors import ParameterError
from mr360uw.jit import fast_making
from mr360uw.types import Floats

_TRIALS = 64
"""Trial distances of the sweep, a pixel and a half of parallax apart at 512 columns."""
_WIDEST_RAD = 1.15
"""Largest parallax [rad] over the largest baseline: distances from 0.45 baselines on are found."""
_SMALL, _LARGE = 0.04, 0.7
"""Penalties of the smoothing for neighbours one trial, and more, apart. Half the large one: a sixth more of a floor is
lost under caustics three times as strong."""
_SWEEP_WIDTHS = 256, 512
"""Least and largest width of the sweep [px]: half that of the picture. In smaller ones textures are gone."""
_SWEEP_SIDE, _SIDE = 5, 7
"""Sides of the windows of the sweep, and of the refinements [px]."""
_STEPS_PX = 0.5, 0.4
"""Steps of the refinements [px of parallax], at half and at full size."""
_EVERY, _ALL_WIDTH = 2, 512
"""Every second neighbour is used at full size; at half size every one up to a width, above it the fewer the wider. Maps
of 2048 columns are judged at half size, where windows span what they do in those of the regression."""
_EDGE_RADIUS, _EDGE_SIDE, _EDGE = 5, 5, 0.05
"""Radius [px] about a pixel whose nearest and farthest distances it may take at full size, side of the windows that are
compared for that, and the penalty of the smoothing where neighbours choose differently. Without this step the edges of
near things reach as far into what is behind as the windows of the sweep: a quarter of the pixels there are lost."""
_AROUND = 2
"""Trials on either side of a distance that is refined."""
_FINE_SMALL, _FINE_LARGE = 0.01, 0.06
"""Penalties of the smoothing when distances are refined."""
_LEAST_BASELINE_M = 1e-6


SURE = 0.5
"""Confidence from which on a distance is used."""


@dataclass(frozen=True, slots=True, eq=False)
class DepthMap:
    """Distances of a frame. distance_m: (H, W) float32 along the rays [m], infinite where none was found.

    confidence: (H, W) float32, 0 to 1; pixels with a half or more are to be used.
    """

    distance_m: Map
    confidence: Map


@checked
def distances(reference: Panorama, neighbours: Sequence[Panorama]) -> DepthMap:
    """Return the distances of a frame from neighbours with known poses, in the unit of these.

    The more neighbours at different times, the less moving caustics disturb: 16 before and after a frame withstand such
    of three times the usual strength. Baselines should reach a seventh of the distances that matter.

    Confidences hold for frames of 512 columns or more: in smaller ones windows reach across the edges of things.

    Parameters
    ----------
    reference : Panorama
        The frame: twice as wide as high, its width a multiple of 8.
    neighbours : sequence of Panorama
        Frames of the same size from other places.

    Returns
    -------
    DepthMap
        Distances along the rays and confidences, (H, W).

    Raises
    ------
    ParameterError
        Without neighbours, for pictures that are no panoramas of one size, and for neighbours where the frame is.

    See Also
    --------
    uw.depth_of_clip : The same for all frames of a clip, as files.
    uw.depth.Panorama : A frame with its pose.

    Notes
    -----
    A sweep of spheres with normalised correlation over all pairs, semi-global smoothing (Hirschmueller 2008), and
    refinement with windows that are warped pixel by pixel.

    Examples
    --------
    Inside of a mottled ball of radius 3 m:

    >>> from mr360uw.depth import Panorama, distances
    >>> x, y = np.meshgrid(np.arange(256) + 0.5, np.arange(128) + 0.5)
    >>> rays = uw.types.View(256, 128).directions(x, y).astype(float)
    >>> waves = np.random.default_rng(1).normal(0.0, 4.0, (3, 40))
    >>> def seen_from(place):
    ...     along = rays @ place
    ...     far = np.sqrt(along**2 + 9.0 - place @ place) - along
    ...     grey = 128.0 + 10.0 * np.cos((place + far[..., None] * rays) @ waves).sum(axis=-1)
    ...     return Panorama(grey.astype(np.float32), place, np.eye(3))
    >>> places = [np.array([0.12 * k, 0.0, 0.0]) for k in (-3, -2, -1, 0, 1, 2, 3)]
    >>> frames = [seen_from(place) for place in places]
    >>> found = distances(frames[3], frames[:3] + frames[4:])
    >>> round(float(np.median(found.distance_m[found.confidence > 0.5])), 1)
    3.0
    """
    return refined(reference, neighbours, [sweep(reference, neighbours)])


Sweep = tuple[Map, Panorama]
"""Inverse distances (h, w) [1/m] of a frame before they are refined, and where it was taken."""


def sweep(reference: Panorama, neighbours: Sequence[Panorama]) -> Sweep:
    """Return the distances of a frame that a sweep over all of them finds."""
    baseline = _baseline(reference, neighbours)
    least, most = _SWEEP_WIDTHS
    width = reference.grey.shape[1]
    warped = Warped(reference, neighbours, min(max(width // 2, least), most, width))
    small = resized(reference.grey, warped.width)
    return _swept(warped, baseline), Panorama(small, reference.position, reference.rotation)


def _seen_from(reference: Panorama, swept: Sweep, width: int) -> Map:
    """Return the inverse distances (h, w) [1/m] of a sweep as seen from a frame, of a width."""
    inverse, place = swept
    if np.array_equal(place.position, reference.position) and np.array_equal(place.rotation, reference.rotation):
        return enlarged_map(inverse, width)
    return carried(inverse, place, reference, width)


def refined(reference: Panorama, neighbours: Sequence[Panorama], sweeps: Sequence[Sweep]) -> DepthMap:
    """Return the distances of a frame from sweeps of it or of frames nearby, with the frame's own neighbours."""
    # Choose among the sweeps at half size, and refine the distances there and at full size
    baseline = _baseline(reference, neighbours)
    width = reference.grey.shape[1]
    half = max(width // 2, min(width, _SWEEP_WIDTHS[0]))
    every = max(half // _ALL_WIDTH, 1)
    warped = Warped(reference, neighbours[::every], half)
    inverse = _best(warped, [_seen_from(reference, one, half) for one in sweeps])
    if half > sweeps[0][0].shape[1]:
        inverse = _at_edges(warped, inverse)
    inverse = _around(warped, inverse, baseline, _STEPS_PX[0])
    fine = Warped(reference, neighbours[:: _EVERY * every], width)
    inverse = _at_edges(fine, enlarged_map(inverse, width))
    inverse = _around(fine, inverse, baseline, _STEPS_PX[1])
    # Judge every pixel by the pictures, and by the expected error of the poses; the rig has no confidence
    judged = fine if every == 1 else warped
    at_judged = np.ascontiguousarray(inverse[:: width // judged.width, :: width // judged.width])
    seen = evidence(reference, neighbours, judged, at_judged, baseline)
    logit = np.tensordot(_COEFFICIENTS, seen, 1) + _FEW * np.log(min(len(neighbours) / _MANY, 1.0))
    rig, step = _of_rig(judged, at_judged, seen, baseline), judged.width // half
    compared = ((logit > 0.0) & ~rig)[::step, ::step]
    error = _error_of_poses(warped, at_judged[::step, ::step], compared, baseline)
    logit -= enlarged_map((error / np.float32(_LARGEST_ERROR)) ** 4, judged.width)
    sure = np.where(rig, np.float32(0.0), confidence(logit))
    with np.errstate(divide="ignore"):
        metres = (np.float32(1.0) / inverse).astype(np.float32)
    return DepthMap(metres, enlarged_map(sure, width))


def _baseline(reference: Panorama, neighbours: Sequence[Panorama]) -> float:
    """Return the largest distance of neighbours from a frame [m]; raise `ParameterError` where they do not fit it."""
    width = reference.grey.shape[1]
    if not neighbours or any(one.grey.shape != reference.grey.shape for one in neighbours):
        raise ParameterError(
            f"neighbours - must be of the frame's size (got {[one.grey.shape for one in neighbours]!r:.80}) - "
            "give one or more of the same size"
        )
    if reference.grey.shape != (width // 2, width) or width % 8:
        raise ParameterError(
            f"reference - must be twice as wide as high, and a multiple of 8 (got {reference.grey.shape}) - resize it"
        )
    baseline = max(float(np.linalg.norm(one.position - reference.position)) for one in neighbours)
    if baseline < _LEAST_BASELINE_M:
        raise ParameterError(
            f"neighbours - stand where the frame does (got a baseline of {baseline:.1g} m) - give such of a camera "
            "that moves"
        )
    return baseline


def _swept(warped: Warped, baseline_m: float) -> Map:
    """Return inverse distances (h, w) [1/m] by a sweep."""
    trials = (np.tan(np.linspace(0.0, _WIDEST_RAD, _TRIALS)) / baseline_m).astype(np.float32)
    zero = np.zeros((warped.height, warped.width), np.float32)
    cost = np.stack([warped.cost(zero + inverse, _SWEEP_SIDE) for inverse in trials], axis=-1)
    step, _ = lowest(smoothed(cost, _SMALL, _LARGE))
    low = np.clip(step.astype(np.int64), 0, _TRIALS - 2)
    return np.asarray(trials[low] + (step - low) * (trials[low + 1] - trials[low]), np.float32)


def _around(warped: Warped, inverse: Map, baseline_m: float, step_px: float) -> Map:
    """Return inverse distances (h, w) [1/m] near given ones."""
    import cv2

    unit = _unit(warped, inverse, baseline_m, step_px)
    tried = ((inverse + np.float32(k) * unit).astype(np.float32) for k in range(-_AROUND, _AROUND + 1))
    cost = np.stack([warped.cost(one, _SIDE) for one in tried], axis=-1)
    step, _ = lowest(smoothed(cost, _FINE_SMALL, _FINE_LARGE))
    found = np.maximum(inverse + (step - _AROUND) * unit, 0.0).astype(np.float32)
    return np.asarray(cv2.medianBlur(found, 3), np.float32)


def _unit(warped: Warped, inverse: Map, baseline_m: float, step_px: float) -> Map:
    """Return the steps (h, w) [1/m] of inverse distances that are some pixels of parallax at the largest baseline."""
    pixel = np.float32(step_px * 2.0 * np.pi / warped.width / baseline_m)
    return np.asarray(pixel * (1.0 + np.square(inverse * np.float32(baseline_m))), np.float32)


def _at_edges(warped: Warped, inverse: Map) -> Map:
    """Return inverse distances (h, w), each the given one or the least or largest nearby, whichever agrees best."""
    import cv2

    least, most = (of_windows(extreme, inverse, 2 * _EDGE_RADIUS + 1) for extreme in (cv2.erode, cv2.dilate))
    return _best(warped, [least, inverse, most])


def _best(warped: Warped, choice: Sequence[Map]) -> Map:
    """Return inverse distances (h, w), in each pixel those of the maps (h, w) under which the pictures agree best."""
    if len(choice) == 1:
        return choice[0]
    cost = np.stack([warped.cost(one, _EDGE_SIDE) for one in choice], axis=-1)
    return np.asarray(np.choose(smoothed(cost, _EDGE, _EDGE).argmin(axis=-1), choice), np.float32)


def lowest(cost: Map) -> tuple[Map, NDArray[np.int64]]:
    """Return the places (h, w) of the minima of costs (h, w, n) by parabolas, and the whole steps next to them."""
    best = np.clip(cost.argmin(axis=-1), 1, cost.shape[-1] - 2)
    before, at, after = (np.take_along_axis(cost, (best + k)[..., None], -1)[..., 0] for k in (-1, 0, 1))
    bend = before - 2.0 * at + after
    shift = np.where(bend > 1e-6, 0.5 * (before - after) / np.maximum(bend, 1e-6), 0.0)
    return np.asarray(best + np.clip(shift, -1.0, 1.0), np.float32), best


def enlarged_map(values: Map, width: int) -> Map:
    """Return a map (h, w) at another width, bilinear, its seam closed."""
    import cv2

    if values.shape[1] == width:
        return values
    wide = np.concatenate([values[:, -1:], values, values[:, :1]], axis=1).astype(np.float32)
    factor = width / values.shape[1]
    size = round(factor * wide.shape[1]), width // 2
    margin = round(factor)
    return np.ascontiguousarray(cv2.resize(wide, size, interpolation=cv2.INTER_LINEAR)[:, margin : margin + width])


# Semi-global smoothing of matching costs on the sphere (Hirschmueller 2008), along eight directions, seam closed.

_PATHS = ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1))


@fast_making
def _add_path(cost: Any, total: Any, down: int, right: int, small: Any, large: Any) -> None:
    """Add the path costs of a direction to total (h, w, n). Rows are gone round twice to begin as they end."""
    height, width, count = cost.shape
    last = np.zeros((width, count), np.float32)
    row = np.zeros((width, count), np.float32)
    for j0 in range(height):
        j = j0 if down >= 0 else height - 1 - j0
        # Go along the path; a path along a row goes round the sphere twice
        for turn in range(2 if down == 0 else 1):
            for i0 in range(width):
                i = i0 if right >= 0 else width - 1 - i0
                before = (i - right) % width
                path = row[before] if down == 0 else last[before]
                if (down != 0 and j0 == 0) or (down == 0 and turn == 0 and i0 == 0):
                    for k in range(count):
                        row[i, k] = cost[j, i, k]
                else:
                    # Continue at the least cost: the same distance, the next one, or a jump
                    least = path[0]
                    for k in range(1, count):
                        least = min(least, path[k])
                    for k in range(count):
                        best = min(path[k], least + large)
                        if k > 0:
                            best = min(best, path[k - 1] + small)
                        if k < count - 1:
                            best = min(best, path[k + 1] + small)
                        row[i, k] = cost[j, i, k] + best - least
                # Add the costs, of the second round alone
                if down != 0 or turn == 1:
                    for k in range(count):
                        total[j, i, k] += row[i, k]
        for i in range(width):
            for k in range(count):
                last[i, k] = row[i, k]


def smoothed(cost: Floats, small: float, large: float) -> Floats:
    """Return the mean path costs (h, w, n), float32, of matching costs (h, w, n) over n trial distances.

    small: penalty of neighbours that differ by one trial; large: by more.
    """
    total = np.zeros_like(cost)
    for down, right in _PATHS:
        _add_path(cost, total, down, right, np.float32(small), np.float32(large))
    return np.asarray(total / np.float32(len(_PATHS)))


# Confidence of distances: the probability that one is within 6 % of the truth, by logistic regression.
#
# Regressed on synthetic dives with particles, poles and fish, under caustics as they are and three times as strong;
# `benchmarks/depth.py` measures it on others. No wrong distance makes the caustics of many instants agree, but all
# pairs of pictures also agree on what is behind a fish that passes, which stands still and is hidden in this frame
# alone. So what tells most is that the frame itself agrees with the mean of the others, as much as these agree with
# each other.

_SIDES = 7, 11, 21
"""Sides of windows [px] in which correlations are taken."""
_LEAST = 1e-3
"""Least parallax [rad], and inverse distance in baselines, of which a logarithm is taken."""
_SPREAD_SIDES, _LEVEL_SIDE = (9, 27), 5
"""Windows [px] of the spread of the distances, and of the brightness."""
_LEAST_SPREAD, _LEAST_WEIGHT = 0.01, 0.03
"""Spread of logarithms of distance, and fraction of the neighbours, that are added before a logarithm is taken."""
_COEFFICIENTS = np.array([1.92, 2.11, -13.75, 2.84, 3.42, 10.74, -0.87, 0.55, -0.47, -0.72, 4.55, -2.46], np.float32)
"""Of the evidence, in its order."""
_FILLED, _ERODED = 5, 9
"""Windows [px] of the largest, and then of the least logit about a pixel. 1 and 1: at the same coverage, three times as
many pixels of fish are confident of a wrong distance."""
_FAR = 30.0
"""Baselines beyond which nothing is taken to be seen that stands still."""
_RIG_ALIKE, _RIG_MORE = 0.25, 0.1
"""Correlation of pictures as they are from which on a pixel is of the camera's rig, and how much more than warped ones
it must be, where these are not warped by infinity. .5: a quarter of a mottled disc is missed."""
_RIG_PX, _RIG_SIDE = 1.0, 9
"""Least movement [px] of what is far, where a rig can be told from it, and pixels about a rig that are left out too."""
_MANY, _FEW = 32, 2.0
"""Neighbours of the dives of the regression, and what one e-th of them takes off the logit: by chance the caustics of
few instants agree."""
_PARTS_PX, _UNTOLD = 1.5, 0.02
"""Step [px] by which distances of some of the neighbours are searched, and fraction of it that two differ by with exact
poses too. 0: with exact poses a sixtieth of the confident pixels is lost at 640 columns."""
_WIDE = 1.0 / 3.0
"""Side of the windows in which differences are averaged, over the width. A tenth: under caustics three times as strong
a seventh of the confident pixels is lost with exact poses at 512 columns."""
_LARGEST_ERROR = 0.006
"""Expected relative error by wrong poses that takes one off the logit. .005: of paths .6 cm off a tenth less is used;
.007: of one 2.6 cm off twice as much is, a tenth of it wrong."""
_LEAST_COMPARED = 0.05
"""Least fraction of the picture that is compared: of fewer pixels the median difference is by chance."""
_HALF = 0.6
"""Probability that is given the confidence of a half. Higher: less is used, and more of that is right."""


def evidence(
    reference: Panorama, neighbours: Sequence[Panorama], warped: Warped, inverse: Map, baseline_m: float
) -> Floats:
    """Return what tells whether inverse distances (H, W) [1/m] are right, (12, H, W) float32.

    warped: neighbours at the size of the frame. Correlations of all pairs in windows of three sizes; of the frame with
    the mean of the others, likewise; difference of the frame's brightness from their mean, in deviations of theirs;
    logarithms of the parallax, of the spread of distances near and about the pixel, and of the fraction of the
    neighbours that count; and one.
    """
    import cv2

    # Compare with what neighbours show there, and again in pictures of half the size
    sums = warped.sums(inverse)
    size = inverse.shape[::-1]
    brightness = functools.partial(window_mean, side=_LEVEL_SIDE)
    small = Warped(reference, neighbours, max(warped.width // 2, min(warped.width, 256)), brightness)
    level = small.sums(resized(inverse, small.width))
    mean = level[0] / np.maximum(level[3], _LEAST)
    variance = np.maximum(level[2] / np.maximum(level[3], _LEAST) - mean * mean, 0.0)
    differs = cv2.resize(np.abs(small.own - mean) / np.sqrt(variance + 1.0), size, interpolation=cv2.INTER_LINEAR)
    # Measure how far depths spread around each pixel
    depth = np.log(np.maximum(inverse * np.float32(baseline_m), _LEAST)).astype(np.float32)
    spreads = []
    for side in _SPREAD_SIDES:
        around = np.ones((side, side), np.uint8)
        spreads.append(np.log(cv2.dilate(depth, around) - cv2.erode(depth, around) + _LEAST_SPREAD))
    return np.stack(
        [
            *(1.0 - warped.cost_of(sums, side) for side in _SIDES),
            *(_agreement(warped.own, sums[0], side) for side in _SIDES),
            np.minimum(differs, 4.0),
            np.log(np.maximum(warped.parallax(inverse), _LEAST)),
            *spreads,
            np.log(sums[3] / warped.count + _LEAST_WEIGHT),
            np.ones_like(depth),
        ]
    ).astype(np.float32)


def _agreement(own: Map, others: Map, side: int) -> Map:
    """Return the correlation (h, w) of a picture with the sum of others within windows."""
    power = window_mean(own * own, side) * window_mean(others * others, side)
    return np.asarray(window_mean(own * others, side) / np.sqrt(np.maximum(power, 1e-6)), np.float32)


def _of_rig(warped: Warped, inverse: Map, seen: Floats, baseline_m: float) -> NDArray[np.bool_]:
    """Return the pixels (H, W) that move with the camera: a tripod, a hand, a stick.

    Pictures there agree as they are, though what stands still would have moved, however far it is; and warped by the
    distances that were found, inverse (H, W) [1/m], they agree less, or these are infinite. seen: the evidence.
    """
    import cv2

    alike = warped.unwarped(_SIDES[1])
    found = (inverse * np.float32(baseline_m) > 1.0 / _FAR) & (alike < seen[1] + _RIG_MORE)
    if not np.any(alike[~found] > _RIG_ALIKE):
        return np.zeros(alike.shape, bool)
    moves = warped.shifted(1.0 / (_FAR * baseline_m)) > _RIG_PX * 2.0 * np.pi / warped.width
    rig = (alike > _RIG_ALIKE) & ~found & moves
    return np.asarray(cv2.dilate(rig.astype(np.uint8), np.ones((_RIG_SIDE, _RIG_SIDE), np.uint8)) > 0)


def _error_of_poses(warped: Warped, inverse: Map, sure: NDArray[np.bool_], baseline_m: float) -> Map:
    """Return the relative errors (h, w) that inverse distances (h, w) [1/m] are expected to have by wrong poses.

    Two halves of the neighbours each find their own distances: first the earlier half and the later one, which a wrong
    pose of the frame itself shifts to opposite sides, so that their mean is nearly right; then the inner half, near to
    the frame in time, and the outer one, which a bent path parts. The error is the geometric mean of both differences,
    as a length across the rays that is the same for all pixels. sure: pixels that are compared.
    """
    if warped.count < 4 or np.mean(sure) < _LEAST_COMPARED:
        return np.zeros_like(inverse)
    # Warp each quarter of the neighbours by the distances, and by such a step nearer and farther
    unit = _unit(warped, inverse, baseline_m, _PARTS_PX)
    quarters = (warped.part(slice(k * warped.count // 4, (k + 1) * warped.count // 4)) for k in range(4))
    sums = [[part.sums(inverse + np.float32(k) * unit) for k in (-1, 0, 1)] for part in quarters]
    across = np.maximum(warped.parallax(np.ones_like(inverse)), np.float32(_LEAST * baseline_m))
    step = unit * across / np.maximum(inverse, np.float32(_LEAST / baseline_m))
    # Average the differences over wide windows, in which what caustics do to them is lost
    side, apart = int(_WIDE * warped.width) | 1, []
    share = np.maximum(window_mean(sure.astype(np.float32), side), np.float32(_LEAST))
    for pair in (((0, 1), (2, 3)), ((1, 2), (0, 3))):
        costs = [[warped.cost_of(a + b, _SIDES[1]) for a, b in zip(sums[i], sums[j], strict=True)] for i, j in pair]
        one, other = (lowest(np.stack(cost, axis=-1))[0] for cost in costs)
        mean = window_mean(np.where(sure, (one - other) * step, np.float32(0.0)), side) / share
        apart.append(max(np.median(np.abs(mean[sure])) - _UNTOLD * np.median(step[sure]), 0.0))
    return np.asarray(np.sqrt(apart[0] * apart[1]) / across, np.float32)


def confidence(logit: Map) -> Map:
    """Return confidences (H, W), 0 to 1, from the logits (H, W) of single pixels.

    Pixels that are surrounded by sure ones are so too; then those within some pixels of doubtful ones are doubtful: the
    rim of a fish, whose windows hold more of what is behind it than of the fish.
    """
    import cv2

    reach = _ERODED // 2
    wide = cv2.copyMakeBorder(logit.astype(np.float32), 0, 0, reach, reach, cv2.BORDER_WRAP)
    filled = cv2.dilate(wide, np.ones((_FILLED, _FILLED), np.uint8))
    least = cv2.erode(filled, np.ones((_ERODED, _ERODED), np.uint8))[:, reach:-reach]
    shifted = np.clip(least - np.log(_HALF / (1.0 - _HALF)), -30.0, 30.0)
    return np.asarray(1.0 / (1.0 + np.exp(-shifted)), np.float32)
