# SPDX-License-Identifier: Apache-2.0
"""Distances of an equirectangular frame from its neighbours with known poses.

A sweep of trial distances at a quarter of the size (256 columns at least), smoothed semi-globally, finds the surface;
steps around it at half and full size refine it. There each pixel of a window is warped by its own distance, so that
windows slant with the surface. The trials are even in the parallax of the largest baseline: nothing depends on the unit
of the poses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mr360uw.depth.semi_global import smoothed
from mr360uw.depth.trust import Evidence, confidence
from mr360uw.depth.warping import Map, Panorama, Warped, resized
from mr360uw.errors import ParameterError

_TRIALS = 96
"""Trial distances of the sweep. Half: steps of two pixels of parallax, which neighbouring trials no longer resolve."""
_WIDEST_RAD = 1.15
"""Largest parallax [rad] over the largest baseline: distances from 0.45 baselines on are found."""
_SMALL, _LARGE = 0.04, 0.35
"""Penalties of the smoothing for neighbours one trial, and more, apart. Half: more pixels are off under caustics three
times as strong; double: rocks lose their edges."""
_LEAST_WIDTH = 256
"""Least width of the sweep [px]: in smaller pictures textures are gone."""
_SWEEP_SIDE = 5
"""Side of the windows of the sweep [px of its size]."""


@dataclass(frozen=True, slots=True)
class _Level:
    """A refinement.

    scale: the size is divided by. side: of windows [px]. step: between trials, in pixels of parallax. every: takes
    every one, or every second neighbour.
    """

    scale: int
    side: int
    step: float
    every: int


_LEVELS = (_Level(2, 7, 0.5, 1), _Level(2, 7, 0.25, 1), _Level(1, 9, 0.4, 2))
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
    least = min(width, _LEAST_WIDTH)
    swept = Warped(reference, neighbours, max(width // 4, least), _SWEEP_SIDE)
    inverse, evidence = _swept(swept, baseline)
    cost, warped = evidence.cost, swept
    for level in _LEVELS:
        size = max(width // level.scale, least)
        if (warped.width, warped.side) != (size, level.side):
            warped = Warped(reference, neighbours[:: level.every], size, level.side)
        inverse, cost = _refined(warped, _enlarged(inverse, warped.width), baseline, level.step)
    with np.errstate(divide="ignore"):
        metres = (np.float32(1.0) / inverse).astype(np.float32)
    grey = resized(reference.grey, width)
    sure = confidence(evidence, cost, warped.parallax(inverse), inverse * np.float32(baseline), grey, len(neighbours))
    return DepthMap(metres, sure)


def _swept(warped: Warped, baseline_m: float) -> tuple[Map, Evidence]:
    """Return inverse distances (h, w) [1/m] by a sweep, and what it tells of their reliability."""
    trials = (np.tan(np.linspace(0.0, _WIDEST_RAD, _TRIALS)) / baseline_m).astype(np.float32)
    cost = np.empty((warped.height, warped.width, _TRIALS), np.float32)
    zero = np.zeros(cost.shape[:2], np.float32)
    for k, inverse in enumerate(trials):
        cost[..., k] = warped.cost(zero + inverse, zero)
    total = smoothed(cost, _SMALL, _LARGE)
    step, best = _lowest(total)
    low = np.clip(step.astype(np.int64), 0, _TRIALS - 2)
    found = (trials[low] + (step - low) * (trials[low + 1] - trials[low])).astype(np.float32)
    return found, Evidence.of(cost, total, best)


def _refined(warped: Warped, inverse: Map, baseline_m: float, step_px: float) -> tuple[Map, Map]:
    """Return inverse distances (h, w) [1/m] near given ones, and their costs (h, w)."""
    import cv2

    pixel = np.float32(step_px * 2.0 * np.pi / warped.width / baseline_m)
    unit = pixel * (1.0 + np.square(inverse * np.float32(baseline_m)))
    offsets = np.arange(-_AROUND, _AROUND + 1)
    cost = np.empty((*inverse.shape, len(offsets)), np.float32)
    for k, offset in enumerate(offsets):
        cost[..., k] = warped.cost(inverse, (np.float32(offset) * unit).astype(np.float32))
    step, best = _lowest(smoothed(cost, _FINE_SMALL, _FINE_LARGE))
    found = np.maximum(inverse + (step - _AROUND) * unit, 0.0).astype(np.float32)
    least = np.take_along_axis(cost, best[..., None], -1)[..., 0]
    return np.asarray(cv2.medianBlur(found, 3), np.float32), least


def _lowest(cost: Map) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Return the places (h, w) of the minima of costs (h, w, n), by a parabola between trials, and whole trials."""
    count = cost.shape[-1]
    best = np.clip(cost.argmin(axis=-1), 1, count - 2)
    before, at, after = (np.take_along_axis(cost, (best + k)[..., None], -1)[..., 0] for k in (-1, 0, 1))
    bend = before - 2.0 * at + after
    shift = np.where(bend > 1e-6, 0.5 * (before - after) / np.maximum(bend, 1e-6), 0.0)
    return (best + np.clip(shift, -1.0, 1.0)).astype(np.float32), best


def _enlarged(values: Map, width: int) -> Map:
    """Return a map (h, w) with another width, bilinear, the seam closed."""
    import cv2

    if values.shape[1] == width:
        return values
    factor = width // values.shape[1]
    wide = np.concatenate([values[:, -1:], values, values[:, :1]], axis=1)
    large = cv2.resize(wide, None, fx=factor, fy=factor, interpolation=cv2.INTER_LINEAR)
    return np.ascontiguousarray(large[:, factor:-factor], np.float32)
