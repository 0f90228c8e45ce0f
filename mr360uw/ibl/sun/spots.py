# SPDX-License-Identifier: Apache-2.0
"""Bright spots of a plate: measures them, judges whether one is a sun, and says what speaks against it.

Each kind of evidence is a number from 0 to 1. What is lacking of them adds up, and the sum gives the confidence:

    doubt = sum of (1 - evidence)        confidence: 1 up to a doubt of 0.2, a half at 0.5, 0 from 0.8 on

No single evidence decides: two that are half there weigh as much as one that is missing. What is asked of a spot
depends on what the plate can show:

    unclipped   it stands far above the middle of the map, or outshines the sky while it ends sharply; most light as
                bright lies in it. Any size up to `_WIDEST_SUN_DEG`: haze and thin cloud widen a sun
    clipped     white, not as wide as a sky, not wide and dark about as a lamp; told from other spots by holding most of
                the white
    in air too  a sharp edge or dark surroundings; a glow that falls on all sides; no dark ground under a sky whose
                gradient points away. A sun among clouds as white is told by that gradient, or by a sky brighter on its
                side over a lit ground

All of them fall or rise with radius, exposure and contrast, so that no wider or darker spot is a sun where a smaller or
brighter one is none, apart from the limits of size.

Air and lens scatter the sun's light into a gradient around it. A sun among clipped clouds is one white spot of many.
What tells it apart is the sky that did not clip:

    log (least channel) = a + b exp(-elevation / 8 deg) + c exp(-angle to the sun / width)

(in the form of the all-weather sky of Perez 1993, whose circumsolar term is an exponential of that angle). The least
channel is red in a blue sky, so it sees the white glow best. The fit is to a low quantile, as clouds only ever add
light. The direction with the least loss is where the sky says that the sun is; how much of the sky's variation it
explains says how surely.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.constants import ENVIRONMENT_COLUMNS, ENVIRONMENT_ROWS
from mr360uw.base.sphere import directions, row_solid_angle, unit
from mr360uw.base.texels import smoothstep
from mr360uw.ibl.lookup import reduce_map, reduce_maximum
from mr360uw.ibl.plate import Plate, coarse_directions, coarse_solid_angle, patch_directions, patch_step, plate_sines
from mr360uw.ibl.tilt import elevation_sine
from mr360uw.types import Array, Floats

_DOUBT = (0.2, 0.8)
"""Doubt up to which a spot surely is a sun, and from which it is none. The middle is that of the gap, 0.31 to 0.72,
between the suns in the first half of `benchmarks/suns.py verdict`, all but one, and what is none there."""
_HALF_TAKEN = 0.5
"""Confidence at which half of a detected sun's light is its beam. Twice as much: only the surest suns cast shadows."""
_WIDEST_SUN_DEG = (8.0, 15.0)
"""Radius [deg] of an unclipped spot up to which it may be a sun, and from which it is a bright part of the sky."""
_WIDEST_GLARE_DEG = (5.0, 18.0)
"""The same of a clipped spot, which lens, haze and exposure widen."""
_REFRACTED = 1.5
"""Factor of the radius under water, where waves spread the sun."""
_LAMP_DEG, _LAMP_HALO = (7.0, 4.0), (0.05, 0.2)
"""Radius [deg] and halo of a clipped spot from and up to which it is a lamp or a gap in a rock: the glare that makes a
sun so wide does not end there."""
_HELD, _HELD_RAD = (0.5, 0.2), np.radians(15.0)
"""Share of the white that a clipped spot holds from which it is alone, and up to which it is one of many; and the angle
[rad] under water within which waves scatter the glitter of one sun."""
_GLOW_EXTENTS, _GLOW_RAD, _GLOW_PIXELS, _RINGS = 5.0, (np.radians(8.0), np.radians(50.0)), 61, 15
"""Radius of the patch a glow is looked for in, in extents of the spot, its limits [rad], pixels, and rings."""
_DARK = 1e-3
"""Brightness below which differences are noise."""
_LIT_RATIO, _LAMPLIT_RATIO = (0.7, 0.15), (5.0, 10.0)
"""Ratio of direct to diffuse light that the ground speaks for, from which it is lit and up to which it is not; and up
to which a sun may have lit it, in the clearest air, and from which it says nothing: lamps do, and snow looks so."""
_BESIDE_DEG = (6.0, 9.0)
"""Degrees from a spot's rim to where the gradient points, up to which it is that spot's, and from which it is not."""
_SIDE_RAD = np.radians(20.0)
"""Radius [rad] about the sun, and about the place across the sky from it, whose brightness is compared."""


@dataclass(frozen=True, slots=True)
class PlateSurvey:
    """What is known of a plate beside its spots.

    weight: (128, 256) light of what is as bright as a sun may be. middle: brightness in the middle of the map, 0 where
    it says nothing. lowest_sine: of the elevation of a sun. clipped: whether it ends at display white. ground: ratio of
    direct to diffuse light that it speaks for. glow: of `find_glow`, if it was looked for.
    """

    plate: Plate
    weight: Floats
    middle: float
    lowest_sine: float
    underwater: bool
    clipped: bool
    ground: float
    glow: Glow | None = None

    @property
    def lit(self) -> float:
        """Whether the ground speaks for a sun, 0 to 1."""
        return _falling(self.ground, *_LIT_RATIO) * _falling(self.ground, *_LAMPLIT_RATIO)

    def judge(self, blob: Blob, *, by_glow: bool = False) -> Blob:
        """Return a spot with the verdict on it. by_glow: whether it is where the sky's gradient points."""
        if not self.clipped:
            evidence = self._unclipped(blob)
        elif self.underwater:
            evidence = [*self._white(blob), self._alone(blob, _HELD_RAD, *_HELD)]
        else:
            told = self._pointed(blob) if by_glow else self._alone(blob, 0.0, *_HELD)
            evidence = [*self._white(blob, grey=by_glow), told, _edged(blob), self._glowing(blob), self._agreed(blob)]
        doubt = sum(1.0 - value for value, _ in evidence)
        value, reason = min(evidence)
        return replace(blob, confidence=_falling(doubt, *_DOUBT), reason=reason if value < 1.0 else "")

    def _unclipped(self, blob: Blob) -> list[tuple[float, str]]:
        contrast = blob.peak / max(self.middle, 1e-6 * blob.peak) if self.middle >= 0.0 else 0.0
        # irradiance over that of a sky that is everywhere as bright as the middle of the map
        beam = contrast * float(np.sin(blob.radius_rad)) ** 2
        outshines = _falling(np.log10(max(beam, 1e-9)), 0.0, -1.0) * _falling(blob.halo, 0.1, 0.3)
        stands_out = _falling(np.log10(max(contrast, 1e-9)), 3.6, 2.6)
        return [
            self._small(blob, _WIDEST_SUN_DEG),
            (max(stands_out, outshines), f"too dim: {contrast:.3g} times the middle of the map"),
            self._alone(blob, 0.0, 0.9, 0.6),
        ]

    def _white(self, blob: Blob, *, grey: bool = False) -> list[tuple[float, str]]:
        """Return evidence that a clipped spot is white, not too wide, and no lamp. grey: as tone mapping makes it."""
        radius = float(np.degrees(blob.radius_rad))
        lamp = _falling(radius, *_LAMP_DEG) * _falling(blob.halo, *_LAMP_HALO)
        darkest = (0.78, 0.65) if grey else (CLIPPED, CLIPPED - (0.2 if self.underwater else 0.1))
        return [
            self._small(blob, _WIDEST_GLARE_DEG),
            (_falling(blob.peak, *darkest), f"not white: {blob.peak:.2f} of display white"),
            (1.0 - lamp, f"a lamp or an opening: {radius:.1f} degrees of radius, dark about it"),
        ]

    def _small(self, blob: Blob, widest_deg: tuple[float, float]) -> tuple[float, str]:
        radius = float(np.degrees(blob.radius_rad)) / (_REFRACTED if self.underwater else 1.0)
        # a lit ground says that there is a sun somewhere in a sky that is clipped far and wide
        return max(_falling(radius, *widest_deg), 0.5 * self.lit), f"as wide as a sky: {radius:.1f} degrees of radius"

    def _alone(self, blob: Blob, reach: float, most: float, least: float) -> tuple[float, str]:
        """Return evidence that most of what is as bright is near. reach: least angle [rad] that is near."""
        near = coarse_directions() @ blob.direction > np.cos(max(2.0 * blob.radius_rad, reach, np.radians(4.0)))
        held = float(self.weight[near].sum() / self.weight.sum())
        kind = "many" if self.clipped else "several"
        return _falling(held, most, least), f"one of {kind}: it holds {100.0 * held:.0f} % of the light as bright"

    def _pointed(self, blob: Blob) -> tuple[float, str]:
        """Return evidence that the sky's gradient, or its brighter side over a lit ground, tells a spot from others."""
        explained = 0.0 if self.glow is None else self.glow[1]
        up = self.plate.up
        across = 2.0 * float(blob.direction @ up) * up - blob.direction
        value = np.minimum(brightness(self.plate.coarse), 1.0) * coarse_solid_angle()
        above = plate_sines(self.plate) > self.lowest_sine
        near, far = (above & (coarse_directions() @ place > np.cos(_SIDE_RAD)) for place in (blob.direction, across))
        ratio = float(np.mean(value[near])) / max(float(np.mean(value[far])), _DARK * float(np.mean(value)))
        side = _falling(math.log(max(ratio, _DARK)), 0.8, 0.2) * self.lit
        reason = f"the sky's glow explains {100.0 * explained:.0f} % of its shades"
        return max(_falling(explained, 0.45, 0.3), side), reason

    def _glowing(self, blob: Blob) -> tuple[float, str]:
        """Return evidence that brightness about a clipped spot is a matter of the angle from it."""
        radius = float(np.clip(_GLOW_EXTENTS * blob.extent_rad, *_GLOW_RAD))
        look = patch_directions(blob.direction, radius, _GLOW_PIXELS)
        angle = np.arccos(np.clip(look @ blob.direction, -1.0, 1.0))
        seen = (elevation_sine(look, self.plate.up) > self.lowest_sine) & (angle < radius)
        value = np.log(np.minimum(brightness(self.plate.look(look)), 1.0)[seen] + _DARK)
        ring = (angle[seen] * (_RINGS / radius)).astype(np.int64)
        mean = np.bincount(ring, value, _RINGS) / np.maximum(np.bincount(ring, minlength=_RINGS), 1)
        explained = 1.0 - float(np.mean((value - mean[ring]) ** 2)) / max(float(np.var(value)), 1e-9)
        return _falling(explained, 0.3, 0.08), f"no glow: its light falls off on some sides only ({explained:.2f} of 1)"

    def _agreed(self, blob: Blob) -> tuple[float, str]:
        """Return evidence that ground and sky do not contradict: a dark ground under a gradient that points away."""
        if self.glow is None:
            return 1.0, ""
        direction, explained = self.glow
        angle = math.acos(min(max(float(direction @ blob.direction), -1.0), 1.0))
        there = _falling(math.degrees(angle - blob.radius_rad), *_BESIDE_DEG)
        away = (1.0 - there) * _falling(explained, 0.45, 0.2) * (1.0 - _falling(self.ground, *_LIT_RATIO))
        reason = (
            f"a gap in clouds: the ground is not lit, and the glow points {math.degrees(angle):.0f} degrees beside it"
        )
        return 1.0 - away, reason


def _falling(x: float, one: float, zero: float) -> float:
    """Return 1 for x on the side of `one`, 0 on that of `zero`, a smooth step between."""
    return float(smoothstep(x, zero, one))


def taken_share(confidence: float) -> float:
    """Return the share of a detected sun's light that is taken for its beam, smooth in the confidence.

    It is 0 up to half of `_HALF_TAKEN`, and 1 from half above it.
    """
    return _falling(confidence, 1.5 * _HALF_TAKEN, 0.5 * _HALF_TAKEN)


def _edged(blob: Blob) -> tuple[float, str]:
    edge = max(_falling(blob.halo, 0.55, 0.8), _falling(blob.radius_rad / max(blob.extent_rad, 1e-9), 0.7, 0.4))
    return edge, f"no edge: the sky about it is {100.0 * blob.halo:.0f} % as bright"


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


Glow = tuple[Floats, float]
"""Unit direction (3,) to which the sky's gradient points, and the share of its variation so explained, 0 to 1."""


def find_glow(plate: Plate) -> Glow | None:
    """Return where the gradient of a clipped plate's sky points; None where no sky is to be seen.

    Only directions in which the plate is nearly white are tried.
    """
    # Search them on a small map, to within some 5 degrees
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
    return _refined(plate, place), float(1.0 - loss / without)


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


# --- A bright spot --------------------------------------------------------------------------------------------------

# Measures one bright spot of a plate: centre, radius, peak, sharpness of its edge.
#
# The spot is the set of pixels near the local maximum. Where the plate is clipped, the set is a plateau without
# structure whose outline also takes in cloud; its centre is that of the plateau *opened* by a disc of 0.7 of its
# inscribed radius, which drops everything that hangs on to the round part. Where it is not clipped the set is the upper
# half of the peak, weighted by its excess, and its radius that of the disc which, as bright as its middle, would hold
# as much light: pixels that the rim cuts count in part. Everything happens in a tangent patch, without seam and pole.


Mask = NDArray[np.bool_]

CLIPPED = 0.95
"""A spot of a display-referred plate whose peak reaches this is clipped: white, less what compression takes away."""

_OPENING = 0.7
"""Radius of the opening disc over the inscribed radius of the plateau. Nearer to 1 a ragged sun loses its rim, nearer
to 0 cloud beside the sun stays attached and moves the centre."""
_CLIPPED_LEVELS = (0.99, 0.95, 0.85)
"""Thresholds of a clipped plateau over its peak, tried in turn until the set is as wide as a sun."""
_UNCLIPPED_LEVEL = 0.5
"""Threshold of an unclipped spot over its peak: the half width of a blurred disc is that of the disc."""
_LARGEST_DISC_RAD = np.radians(0.8)
"""Radius [rad] above which a plateau is a clipped one: three times the sun's 0.27 degrees."""
_UNCLIPPED_HALO = 0.3
"""Halo of an unclipped spot up to which it is a disc, not the maximum of a bright sky."""
_CUT_OFF = 0.1
"""Solid angle of the top of a spot over that above half-way down, from which it is cut off; 0.02 of a Gaussian's."""
_SHARP_RIM, _DARK_HALO = 1.08, 0.5
"""Radius half-way down a clipped disc's rim over that of its top, and halo, up to which it is the disc itself that is
seen: glare that falls with the third power of the angle has a rim of 1.13, of the second power 1.22."""
_SMALLEST_BLOB_RAD = np.radians(0.4)
"""Radius [rad] below which a plateau is taken for noise and the next threshold is tried."""
_LOOKS = ((41, None), (41, 3.5), (73, 3.0))
"""Patches of successive looks: pixels across, radius in extents of the spot (None: `_FIRST_RAD`)."""
_NEAREST_RING_RAD = np.radians(1.0)
"""Least radius [rad] about which the halo is measured: nearer to a small disc its aureole is bright in any sky."""
_HOLE_PIXELS = 3
"""Side [pixels] of the holes that noise and quantisation leave in a plateau, closed before it is measured."""
_FIRST_RAD, _NARROWEST_RAD, _WIDEST_RAD = np.radians(4.0), np.radians(2.0), np.radians(50.0)
"""Radius [rad] of the first patch, and limits of the later ones."""


@dataclass(frozen=True, slots=True)
class Blob:
    """A bright spot.

    direction: (3,) unit. radius_rad: of the disc of the same solid angle. peak: its largest value. level: the value
    that bounds it. extent_rad: the same of everything nearly as bright. halo: median value about two extents out,
    over the peak. clipped: a plateau. sharp: a disc, not the maximum of a sky nor the glare about a smaller disc. flat:
    its top is cut off, as by clipping. Of a spot that was judged, confidence: that it is the sun, 0 to 1; reason: what
    speaks against it most ("" for nothing).
    """

    direction: Floats
    radius_rad: float
    extent_rad: float
    peak: float
    level: float
    halo: float
    clipped: bool
    sharp: bool
    flat: bool
    confidence: float = 0.0
    reason: str = ""


def brightness(linear: Floats) -> Floats:
    """Return the value that spots are judged by, (...,): luminance and the weakest channel in equal parts.

    The weakest channel is the last to clip, so the sun still exceeds a white cloud in it.
    """
    red, green, blue = linear[..., 0], linear[..., 1], linear[..., 2]
    value = 0.1063 * red + 0.3576 * green + 0.0361 * blue
    return value + 0.5 * np.minimum(np.minimum(red, green), blue)


def examine(plate: Plate, seed: Floats, lowest_sine: float, *, white: float = 1.0) -> Blob | None:
    """Return the brightest spot about `seed` (3,), looking only at elevations whose sine exceeds `lowest_sine`.

    white: value at which the plate clips, 1 of a display-referred one, infinite of scene radiance. Tone mapping makes a
    sun greyer than the clouds about it; they then count as no brighter than it.
    """
    direction: Floats = unit(seed)
    radius = _FIRST_RAD
    blob: Blob | None = None
    for size, reach in _LOOKS:
        if blob is not None and reach is not None:
            direction = blob.direction
            radius = float(np.clip(reach * blob.extent_rad, _NARROWEST_RAD, _WIDEST_RAD))
        blob = _spot(plate, direction, radius, size, lowest_sine, white)
        if blob is None:
            return None
    return blob


def _spot(plate: Plate, centre: Floats, radius: float, size: int, lowest_sine: float, white: float) -> Blob | None:
    look = patch_directions(centre, radius, size)
    step = patch_step(radius, size)
    value = np.where(elevation_sine(look, plate.up) > lowest_sine, brightness(plate.look(look)), 0.0)
    value = np.minimum(value, white)  # codes above white are noise of the encoder, not a brighter sun
    peak = float(value.max())
    if peak <= 0.0:
        return None
    top = step**2 * np.count_nonzero(value >= _CLIPPED_LEVELS[0] * peak)
    half = step**2 * np.count_nonzero(value >= _UNCLIPPED_LEVEL * peak)
    # at display white the peak says nothing of how far the sun stands above its aureole, however small the disc
    plateau = top > 0.25 * half or top > np.pi * _LARGEST_DISC_RAD**2
    clipped = np.isfinite(white) and (plateau or peak >= CLIPPED * white)
    level, mask = _UNCLIPPED_LEVEL, value >= _UNCLIPPED_LEVEL * peak
    if clipped:
        for level in _CLIPPED_LEVELS:
            mask = _plateau(value, level * peak)
            if _inscribed(mask).max() * step >= _SMALLEST_BLOB_RAD:
                break
    mask = _opened(mask)
    weight = mask if clipped else mask * (value - 0.9 * level * peak)
    direction = unit(weight.ravel() @ look.reshape(-1, 3))
    blob_radius = step * _disc_radius(mask)
    wide = _opened(_plateau(value, _CLIPPED_LEVELS[-1] * peak)) if clipped else mask
    extent = max(step * _disc_radius(wide), blob_radius)
    along = look @ direction
    beyond = max(extent, _NEAREST_RING_RAD)
    ring = value[(along < np.cos(1.5 * beyond)) & (along > np.cos(2.5 * beyond)) & (value > 0.0)]
    halo = float(np.median(ring)) / peak if ring.size else 1.0
    sharp = halo <= _UNCLIPPED_HALO
    flat = top > _CUT_OFF * step**2 * np.count_nonzero(_opened(value >= 0.5 * (1.0 + halo) * peak))
    if clipped:
        rim = _disc_radius(_opened(value >= 0.5 * (1.0 + halo) * peak)) / max(_disc_radius(mask), 1e-9)
        sharp = rim <= _SHARP_RIM and halo <= _DARK_HALO
    else:
        blob_radius = step * _held_radius(value, mask, halo * peak)
    return Blob(direction, blob_radius, extent, peak, level * peak, halo, bool(clipped), bool(sharp), bool(flat))


def _held_radius(value: Floats, mask: Mask, floor: float) -> float:
    """Return the radius [pixels] of a disc as bright as the middle of a spot that holds as much light above a floor."""
    import cv2

    middle = float(np.median(value[mask])) - floor
    around = cv2.dilate(
        mask.astype(np.uint8), np.ones((5, 5), np.uint8), iterations=max(int(_disc_radius(mask) / 8.0), 1)
    )
    held = np.clip((value - floor) / max(middle, 1e-12), 0.0, 1.0)
    return float(np.sqrt(held[around > 0].sum() / np.pi))


def _disc_radius(mask: Mask) -> float:
    """Return the radius [pixels] of the disc that has as many pixels as a mask."""
    return float(np.sqrt(np.count_nonzero(mask) / np.pi))


def _plateau(value: Floats, level: float) -> Mask:
    """Return where values reach a level, small holes closed."""
    import cv2

    kernel = cv2.getStructuringElement(cv2.MORPH_RECT, (_HOLE_PIXELS, _HOLE_PIXELS))
    closed: Mask = cv2.morphologyEx((value >= level).astype(np.uint8), cv2.MORPH_CLOSE, kernel) > 0
    return closed


def _inscribed(mask: Mask) -> Floats:
    """Return the distance [pixels] of every pixel of a mask to its outside, the patch's border included."""
    import cv2

    padded = cv2.copyMakeBorder(mask.astype(np.uint8), 1, 1, 1, 1, cv2.BORDER_CONSTANT)
    return cv2.distanceTransform(padded, cv2.DIST_L2, 5)[1:-1, 1:-1]


def _opened(mask: Mask) -> Mask:
    """Return the part of a mask that discs of `_OPENING` of its largest inscribed radius reach, in one piece."""
    import cv2

    depth = _inscribed(mask)
    reach = _OPENING * float(depth.max())
    row, column = np.unravel_index(int(depth.argmax()), depth.shape)
    _, label = cv2.connectedComponents((depth >= reach).astype(np.uint8), connectivity=8)
    outside = (label != label[row, column]).astype(np.uint8)
    reached: Mask = cv2.distanceTransform(outside, cv2.DIST_L2, 5) <= reach
    return mask & reached
