# SPDX-License-Identifier: Apache-2.0
"""Measures one bright spot of a plate: centre, radius, peak, sharpness of its edge.

The spot is the set of pixels near the local maximum. Where the plate is clipped, the set is a plateau without
structure whose outline also takes in cloud; its centre is that of the plateau *opened* by a disc of 0.7 of its
inscribed radius, which drops everything that hangs on to the round part. Where it is not clipped the set is the upper
half of the peak, weighted by its excess, and its radius that of the disc which, as bright as its middle, would hold as
much light: pixels that the rim cuts count in part. Everything happens in a tangent patch, without seam and pole.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mr360uw.ibl.plate import Plate, patch_directions, patch_step
from mr360uw.ibl.tilt import elevation_sine
from mr360uw.sphere import unit
from mr360uw.types import Floats

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
    its top is cut off, as by clipping.
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
