# SPDX-License-Identifier: Apache-2.0
"""Irradiance ratio E_with/E_without of the receiver: its change by objects, waves and lamps.

    ratio = 1 + w (share free + (1 - share) seen waves + added - 1)

with share the ambient fraction of the plate's irradiance, free the fraction of it that bodies leave, with what they
send there themselves, seen the visible fraction of the plate's direct light, waves the caustic factor on it, added the
irradiance of lamps over that of the plate, and w the weight that fades out towards the receiver's end.

Over blocks of pixels it is worked out line by line (`tile_blend`), with the plate's own pattern (pattern.py).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.constants import BRIGHTEST, DARK
from mr360uw.base.texels import smoothstep
from mr360uw.base.tile_blend import BLOCK, NO_BLURS, NO_MEAN, BlockGround, GroundLines, PixelImages
from mr360uw.composite.light_sources import LightSource
from mr360uw.composite.receiver.pattern import direct_pattern, lost_light
from mr360uw.composite.shading import ambient_there
from mr360uw.composite.shot import Shot
from mr360uw.composite.tiles import places_in_mask
from mr360uw.ibl.lookup import environment_lookup
from mr360uw.types import Floats, Rectangle

FADE_FROM = 0.8
"""Fraction of its extent from which the receiver fades out, so that shadow and waves end without a line."""
SHARE, VEIL, FREE, SEEN = slice(0, 3), slice(3, 6), slice(6, 9), 9
"""Channels of `GroundLines.corner`."""


def ambient_share(shot: Shot, sources: Sequence[LightSource], point: Floats, normal: Floats) -> Floats:
    """Return the ambient fraction (n, 3) of the plate's irradiance on the receiver; 0 in the dark."""
    ambient, beam = _plate_light(shot, sources, point, normal)
    return ambient / np.maximum(ambient + beam, DARK)


def _plate_light(shot: Shot, sources: Sequence[LightSource], point: Floats, normal: Floats) -> tuple[Floats, Floats]:
    """Return the ambient and the direct irradiance (n, 3) of the plate on the receiver."""
    at_camera = environment_lookup(shot.environment.ambient, normal)
    ambient, beam = ambient_there(shot, at_camera, point, normal), np.zeros((len(point), 3))
    for source in sources:
        if source.in_plate:
            direction, irradiance, _ = source.arrival(point)
            beam = beam + irradiance * np.maximum(np.sum(normal * direction, -1), 0.0)[:, None]
    return ambient, beam


def added_light(
    shot: Shot,
    sources: Sequence[LightSource],
    point: Floats,
    normal: Floats,
    sides: Floats | None = None,
    *,
    shadows: bool = True,
) -> Floats:
    """Return the irradiance (n, 3) of sources that are not in the plate, over that of the plate.

    sides: (n, 2, 3) [m] of footprints, over which shadows are averaged; None for points.
    """
    added = np.zeros((len(point), 3))
    for source in sources:
        if source.in_plate:
            continue
        direction, irradiance, _ = source.arrival(point)
        cosine = np.maximum(np.sum(normal * direction, -1), 0.0)
        seen = source.visibility(point, sides) if shadows else np.ones(len(point))
        added = added + irradiance * (cosine * seen)[:, None]
    if np.any(added):
        ambient, beam = _plate_light(shot, sources, point, normal)
        added = np.minimum(added / np.maximum(ambient + beam, DARK), BRIGHTEST)
    return added


def receiver_ratio(
    shot: Shot,
    sources: Sequence[LightSource],
    free: Floats,
    point: Floats,
    normal: Floats,
    distance_m: Floats,
    plate: tuple[Floats, Floats, Floats] | None = None,
    sides: Floats | None = None,
) -> Floats:
    """Return E_with/E_without (n, 3) at points of the receiver, 1 where it ends.

    free: (n, 3) fraction of the ambient light that bodies leave there, with what they send. plate: its light, its calm
    light and its veil there, each (n, 3), where it has a pattern (see pattern.py). sides: (n, 2, 3) [m] of the pixels
    on the receiver, over which shadows are averaged; None for points.
    """
    receiver = shot.receiver
    assert receiver is not None
    seen: Floats = np.ones(len(point))
    waves: Floats = np.ones((len(point), 3))
    for source in sources:
        if source.in_plate:
            seen = source.visibility(point, sides, on_ground=True) if receiver.shadow else seen
            waves = source.pattern(point, distance_m * np.pi / shot.view.height) if receiver.caustics else waves
    share = ambient_share(shot, sources, point, normal)
    r = np.ones_like(share) if plate is None else direct_pattern(*plate, share)
    lost = np.ones_like(r) if plate is None or shot.pattern is None else lost_light(plate[0], r, shot.pattern.white)
    r = r * lost
    ratio = share * free + (r - share) * seen[:, None] * waves
    ratio = (ratio + added_light(shot, sources, point, normal, sides)) / r
    ratio = np.where(ratio < 1.0, np.minimum(ratio * lost, 1.0), ratio)  # what is shaded of it may still be clipped
    weight = 1.0 - smoothstep(distance_m / receiver.extent_m, FADE_FROM, 1.0)
    return 1.0 + weight[:, None] * (ratio - 1.0)


# --- over blocks of pixels -------------------------------------------------------------------------------------------


Gathered = list[tuple[NDArray[np.bool_], NDArray[np.float32]]]
"""Pairs of a mask (n,) of m blocks and their images (m, B, B, k)."""


def gather_images(count: int, channels: int, parts: Gathered) -> PixelImages:
    """Return the images of `count` blocks from parts, each block in one part at most."""
    at, first, every = np.full(count, -1, np.int32), 0, [np.zeros((0, BLOCK, BLOCK, channels), np.float32)]
    for which, images in parts:
        at[which] = first + np.arange(len(images))
        first += len(images)
        every.append(images)
    return PixelImages(at, np.concatenate(every))


def four_corners(corner: Floats, j: NDArray[np.int64], i: NDArray[np.int64]) -> Floats:
    """Return the corners of blocks, (n, 4, ...): above left and right, below left and right."""
    return np.stack([corner[j, i], corner[j, i + 1], corner[j + 1, i], corner[j + 1, i + 1]], axis=1)


def ground_of(
    shot: Shot, blocks: NDArray[np.bool_], corner: NDArray[np.float32], images: tuple[PixelImages, ...]
) -> BlockGround:
    """Return the light on blocks (R, C) of a shot's receiver, n of them, row by row, as it is laid over the plate.

    corner: (R + 1, C + 1, 10), channels SHARE, VEIL, FREE, SEEN. images: of `GroundLines`.
    """
    row, column = places_in_mask(blocks)
    width, height, pattern = shot.view.width, shot.view.height, shot.pattern
    # Blur the plate over all of them, where no mean of the clip is known
    blurs, mean, strength = NO_BLURS, NO_MEAN, 0.0
    if pattern is not None and len(row):
        left, top, right, bottom = BLOCK * np.array([column.min(), row.min(), column.max() + 1, row.max() + 1])
        hull = Rectangle(int(left), int(top), int(min(right, width) - left), int(min(bottom, height) - top))
        blurs = pattern.blurs(hull)
        strength = pattern.strength
        mean = NO_MEAN if pattern.mean is None else np.asarray(pattern.mean, np.float16).view(np.uint16)
    first = np.searchsorted(row, np.arange(len(corner)))
    lines = GroundLines(
        first, column, corner, images, height, np.float32(np.min(shot.unseen)), pattern is not None, mean, blurs,
        np.float32(strength), np.float32(np.inf if pattern is None else pattern.white),
    )  # fmt: skip
    return BlockGround(lines, None if pattern is None else pattern.picture)
