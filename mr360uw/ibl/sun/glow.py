# SPDX-License-Identifier: Apache-2.0
"""Where the sun stands by the glow of the sky about it: air and lens scatter its light into a gradient around it.

A sun among clipped clouds is one white spot of many. What tells it apart is the sky that did not clip:

    log (least channel) = a + b exp(-elevation / 8 deg) + c exp(-angle to the sun / width)

(in the form of the all-weather sky of Perez 1993, whose circumsolar term is an exponential of that angle). The least
channel is red in a blue sky, so it sees the white glow best. The fit is to a low quantile, as clouds only ever add
light. The direction with the least loss is where the sky says that the sun is; how much of the sky's variation it
explains says how surely.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mr360uw.constants import ENVIRONMENT_COLUMNS, ENVIRONMENT_ROWS
from mr360uw.ibl.level.tilt import elevation_sine
from mr360uw.ibl.plate import Plate, patch_directions
from mr360uw.ibl.reduce import reduce_map, reduce_maximum
from mr360uw.ibl.sun.blob import brightness
from mr360uw.sphere import directions, row_solid_angle
from mr360uw.types import Floats

Array = NDArray[np.float64]

_QUANTILE = 0.3
"""Share of the sky that is darker than the fit: the clear part between clouds."""
_ROUNDS = 6
"""Rounds of reweighting."""
_LEAST_RESIDUAL = 0.02
"""Residual [log] below which weights grow no further; 2 % is the step of an 8 bit code in the middle of the curve."""
_WIDTHS_RAD = np.radians([10.0, 20.0, 40.0])
_LOCAL_WIDTHS_RAD = np.radians([3.0, 5.0, 8.0, 13.0])
_HAZE_RAD = np.radians(8.0)
"""Height [rad] of the bright band above the horizon."""
_LOWEST_SINE = 0.05
"""Least sine of the elevation of the sky that is fitted: below it there are hills and trees."""
_MOST_PLACES = 60
"""Directions tried in the first search."""
_LEAST_SKY = 60
"""Least number of unclipped pixels of sky."""
_WHITE, _UNCLIPPED = 0.72, 0.93
"""Brightness over the plate's peak from which a place may hold the sun, which tone mapping makes greyer than clouds,
and up to which a pixel shows the sky."""
_LOOK_RAD, _LOOK_PIXELS = np.radians(18.0), 41
"""Radius [rad] and size of the patch that the second search fits."""
_SEARCHES = ((np.radians(9.0), np.radians(1.8)), (np.radians(3.0), np.radians(0.6)))
"""Radius and step [rad] of the second search and of the third."""


@dataclass(frozen=True, slots=True)
class Glow:
    """Where the sky's gradient points. direction: (3,) unit. explained: share of its variation so explained, 0 to 1."""

    direction: Floats
    explained: float


def find_glow(plate: Plate) -> Glow | None:
    """Return the direction that best explains the gradient of a clipped plate's sky; None where no sky is to be seen.

    Only directions in which the plate is nearly white are tried.
    """
    glow = rough_glow(plate)
    return None if glow is None else replace(glow, direction=_refined(plate, glow.direction))


def rough_glow(plate: Plate) -> Glow | None:
    """Return the same to within some 5 degrees, in a fraction of the time."""
    size = ENVIRONMENT_COLUMNS, ENVIRONMENT_ROWS
    look, brightest = directions(*size), reduce_maximum(plate.brightest, *size)
    sine, peak = elevation_sine(look, plate.up), float(plate.brightest.max())
    sky = (sine > _LOWEST_SINE) & (brightest < _UNCLIPPED * peak)
    places = look[(sine > 0.0) & (brightest >= _WHITE * peak)]
    if np.count_nonzero(sky) < _LEAST_SKY or len(places) == 0:
        return None
    value = _logarithm(reduce_map(plate.coarse, *size))[sky]
    weight = np.broadcast_to(row_solid_angle(*size)[:, None], sky.shape)[sky]
    haze = np.exp(-np.arcsin(sine[sky]) / _HAZE_RAD)
    without = float(_losses(np.stack([np.ones_like(haze), haze], axis=-1)[None], value, weight)[0][0])
    places = places[:: len(places) // _MOST_PLACES + 1]
    loss, place = _best(places, look[sky], haze, value, weight, _WIDTHS_RAD)
    if place is None or without <= 0.0:
        return None
    return Glow(place, float(1.0 - loss / without))


def _refined(plate: Plate, place: Floats) -> Floats:
    """Return a direction improved by the sky near it."""
    peak = float(plate.brightest.max())
    for reach, step in _SEARCHES:
        look = patch_directions(place, _LOOK_RAD, _LOOK_PIXELS)
        seen, sine = plate.look(look), elevation_sine(look, plate.up)
        sky = (brightness(seen) < _UNCLIPPED * peak) & (sine > _LOWEST_SINE)
        grid = patch_directions(place, reach, 2 * round(reach / step) + 1)
        near = grid[(brightness(plate.look(grid)) >= _WHITE * peak) & (elevation_sine(grid, plate.up) > 0.0)]
        if np.count_nonzero(sky) < _LEAST_SKY or len(near) == 0:
            break
        value, weight = _logarithm(seen)[sky], np.ones(np.count_nonzero(sky))
        better = _best(near, look[sky], sine[sky], value, weight, _LOCAL_WIDTHS_RAD)[1]
        place = place if better is None else better
    return place


def _logarithm(colour: Floats) -> Array:
    return np.log(np.maximum(colour.min(axis=-1).astype(np.float64), 1e-3))


def _best(
    places: Floats, look: Floats, other: Floats, value: Array, weight: Array, widths: Array
) -> tuple[float, Floats | None]:
    """Return the least loss of all places (k, 3) and widths, and its place; None where the sky darkens to every one.

    look (n, 3): of the sky's pixels. other (n,): the term that does not depend on the sun.
    """
    angle = np.arccos(np.clip(places @ look.T, -1.0, 1.0))
    steady = np.stack([np.ones_like(other), other], axis=-1)
    best: tuple[float, Floats | None] = (np.inf, None)
    for width in widths:
        terms = np.concatenate(
            [np.broadcast_to(steady, (len(places), *steady.shape)), np.exp(-angle / width)[..., None]], axis=-1
        )
        loss, fitted = _losses(terms, value, weight)
        loss = np.where(fitted[:, 2] > 0.0, loss, np.inf)
        k = int(loss.argmin())
        if loss[k] < best[0]:
            best = float(loss[k]), places[k]
    return best


def _losses(terms: Array, value: Array, weight: Array) -> tuple[Array, Array]:
    """Return the losses (k,) of linear models (k, n, m) of values (n,) at a low quantile, and their factors (k, m)."""
    share = np.broadcast_to(weight / weight.sum(), terms.shape[:2])
    trust = share
    calm = 1e-9 * np.eye(terms.shape[2])
    for _ in range(_ROUNDS):
        weighted = (terms * trust[..., None]).transpose(0, 2, 1)
        factors = np.linalg.solve(weighted @ terms + calm, weighted @ value[:, None])
        residual = value - (terms @ factors)[..., 0]
        side = np.where(residual > 0.0, _QUANTILE, 1.0 - _QUANTILE)
        trust = share * side / np.maximum(np.abs(residual), _LEAST_RESIDUAL)
    return (share * side * np.abs(residual)).sum(axis=1), factors[..., 0]
