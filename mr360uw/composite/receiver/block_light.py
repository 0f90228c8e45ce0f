# SPDX-License-Identifier: Apache-2.0
"""Unshadowed irradiance on the receiver, at block corners and per pixel where interpolation is not accurate enough."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.ambient.light import GroundField
from mr360uw.composite.lighting.light_sources import light_sources
from mr360uw.composite.lighting.shading import veil_ahead
from mr360uw.composite.receiver.ground import BLOCK, Ground, Indices, mark_changed, survey_blocks
from mr360uw.composite.receiver.ratio import ambient_share
from mr360uw.composite.receiver.receiver_kernel import (
    CORNER_CHANNELS,
    FREE,
    SEEN,
    SHARE,
    VEIL,
    Gathered,
    PixelImages,
    gather_images,
)
from mr360uw.composite.sampling import Gaps
from mr360uw.composite.shot import Shot
from mr360uw.types import Floats

_PAST_THE_LAST = 5.0 / 32.0
"""Error of a straight line a quarter step past its samples, in second differences: (1/4)(5/4)/2; between them 1/8."""
_PART_OF_GAP = 0.25
"""Reach of a block over the height of a body above the ground, below which corners and middle miss nothing."""
SMOOTH = 0.004
"""Largest interpolation error at the middle of a block, in linear light: less than a code value. Twice as large, blocks
show in smooth shadows."""


def free_corners(ground: Ground, blocks: NDArray[np.bool_], field: GroundField) -> NDArray[np.float32]:
    """Return corner light (R + 1, C + 1, 10) for receiver_kernel.py with the ambient light that bodies leave at the
    corners of blocks, and the sun fully visible; `set_plate_light` fills in the other channels.
    """
    corner = np.zeros((ground.rows + 1, ground.columns + 1, CORNER_CHANNELS), np.float32)
    j, i = np.nonzero(ground.corners_of(blocks))
    point, normal = (a[j, i].astype(np.float64) for a in (ground.corner_point, ground.corner_normal))
    corner[j, i, FREE] = field.at(point, normal)
    corner[j, i, SEEN] = 1.0
    return corner


def changed_blocks(
    shot: Shot,
    ground: Ground,
    blocks: NDArray[np.bool_],
    corner: NDArray[np.float32],
    field: GroundField,
) -> NDArray[np.bool_]:
    """Return those of some blocks (R, C) in which bodies may change the receiver by more than `Shot.unseen`.

    Ambient and direct light have weights that add up to 1 (see ratio.py and pattern.py), and each factor on them is
    linear between the corners; only near a body and where the ambient light jumps it may be farther from 1 inside.
    """
    j, i = np.nonzero(blocks)
    marks = ground.broken[j, i] | _crossed(ground, field)[j, i]
    factors = corner[..., FREE.start :]
    mark_changed(j, i, factors, ground.middle_point, ground.reach_m, _balls(shot), np.float32(shot.unseen), marks)
    changed = np.zeros_like(blocks)
    changed[j[marks], i[marks]] = True
    return changed


def set_plate_light(shot: Shot, ground: Ground, blocks: NDArray[np.bool_], corner: NDArray[np.float32]) -> None:
    """Set the ambient share and the veil of the plate at the corners of blocks (R, C)."""
    j, i = np.nonzero(ground.corners_of(blocks))
    point, normal = (a[j, i].astype(np.float64) for a in (ground.corner_point, ground.corner_normal))
    of = slice(None)
    if shot.receiver is not None and shot.receiver.plane_y is not None and len(point):
        there = int(np.argmax(point[:, 1] != 0.0))
        of = slice(there, there + 1)  # a horizontal plane has the same share everywhere
    corner[j, i, SHARE] = ambient_share(shot, light_sources(shot), point[of], normal[of])
    if shot.medium is not None:
        distance = np.linalg.norm(point, axis=-1)
        corner[j, i, VEIL] = veil_ahead(shot.medium, distance, point / np.maximum(distance, 1e-9)[:, None])


def free_images(
    shot: Shot,
    ground: Ground,
    corner: Floats,
    j: Indices,
    i: Indices,
    field: GroundField,
    gaps: Gaps,
) -> PixelImages:
    """Return the unblocked ambient fraction per pixel, for blocks where interpolation from corners is not accurate.

    Partly covered pixels take it in their gaps.
    """
    # Find the blocks whose light at the middle is not that between their corners, or may jump
    broken, rough = ground.broken[j, i], ground.rough[j, i]
    change, near = np.zeros(len(j), np.float32), np.zeros(len(j), np.bool_)
    survey_blocks(j, i, corner[..., FREE], ground.middle_point, ground.reach_m, _balls(shot), change, near)
    near &= ground.reach_m[j, i] > _PART_OF_GAP * field.gap_m
    uneven = ~broken & (near | rough | (change > SMOOTH))
    asked = j[uneven], i[uneven]
    at_middle = _free(field, ground.middle_point[asked], ground.middle_normal[asked])
    missed = np.zeros(len(j))
    missed[uneven] = np.abs(at_middle - ground.middle_between(corner[..., FREE], *asked)).max(axis=-1)
    crossed = _crossed(ground, field)
    uneven = ((missed > SMOOTH) | (near & (change > SMOOTH)) | crossed[j, i]) & ~broken
    # Take it at every second pixel of these; where that misses it, and at edges of the ground, at each
    parts: Gathered = []
    if np.any(uneven):
        of = j[uneven], i[uneven]
        quarters = _free(field, *_quarter_places(shot, ground, *of))
        free = np.maximum(enlarged(quarters), 0.0)  # past the outer samples lines go on
        sharp = crossed[of] | (missed_between(quarters) > SMOOTH)
        if np.any(sharp):
            free[sharp] = _free(field, *_pixel_places(shot, ground, of[0][sharp], of[1][sharp]))
        parts.append((uneven, free))
    if np.any(broken):
        parts.append((broken, _free(field, *_pixel_places(shot, ground, j[broken], i[broken]))))
    # Partly covered pixels take it in their gaps
    images = gather_images(len(j), 3, parts)
    own = np.flatnonzero(images.at >= 0)
    some, block = ground.gaps_in(gaps, j[own], i[own])
    if len(block):
        at = images.at[own][block], some.row % BLOCK, some.column % BLOCK
        images.image[at] = _free(field, *ground.meet(shot, *some.place.T))
    return images


def _balls(shot: Shot) -> Floats:
    """Return middles from the camera and radii (n, 4) [m] of balls around the bodies that shade."""
    balls = [
        (*(placed.to_world(placed.mesh.center_m) - shot.view.position), placed.mesh.radius_m * placed.scale)
        for placed in shot.casters
    ]
    return np.array(balls, np.float64).reshape(-1, 4)


def _crossed(ground: Ground, field: GroundField) -> NDArray[np.bool_]:
    """Return the mask (R, C) of blocks within which the ambient light that bodies leave jumps, or a pixel beside."""
    crossed = np.zeros((ground.rows, ground.columns), np.bool_)
    view, place = field.shot.view, field.jumps()
    if len(place):
        width, height = view.width, view.height
        x, y = view.places(place)
        wide = np.minimum(1.0 / np.maximum(np.sin(np.pi * y / height), 1.0 / BLOCK), BLOCK)  # near a pole [pixels]
        for down in (-1.0, 1.0):
            for right in (-1.0, 0.0, 1.0):
                i, j = np.floor(x + right * wide).astype(np.int64) % width, np.floor(y + down).astype(np.int64)
                crossed[np.clip(j, 0, height - 1) // BLOCK, i // BLOCK] = True
    return crossed


def _quarter_places(shot: Shot, ground: Ground, j: Indices, i: Indices) -> tuple[Floats, Floats]:
    """Return points and normals (n, B/2, B/2, 3) of the receiver between every four pixels of blocks."""
    inside = np.arange(1.0, BLOCK, 2.0)
    x, y = BLOCK * i[:, None, None] + inside, BLOCK * j[:, None, None] + inside[:, None]
    return ground.meet(shot, *np.broadcast_arrays(x, np.minimum(y, shot.view.height)))


def missed_between(images: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the largest error (n,) of straight lines between samples (n, s, s, k), and a quarter step past the outer
    ones, as second differences tell it.
    """
    bends = [np.abs(np.diff(images, 2, axis=axis)).reshape(len(images), -1).max(axis=1) for axis in (1, 2)]
    return np.asarray(_PAST_THE_LAST * np.maximum(*bends), np.float32)


def _free(field: GroundField, point: Floats, normal: Floats) -> NDArray[np.float32]:
    """Return the fraction (..., 3) of the ambient light that bodies leave at points and normals (..., 3)."""
    return field.at(np.asarray(point, np.float64), np.asarray(normal, np.float64)).astype(np.float32)


def enlarged(images: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return images (n, s, s, k) at the pixels of blocks, (n, B, B, k): straight lines, also past the outer samples."""
    side = images.shape[1]
    place = (np.arange(BLOCK) + 0.5) * side / BLOCK - 0.5
    lower = np.clip(np.floor(place).astype(np.int64), 0, side - 2)
    weights = np.zeros((BLOCK, side), np.float32)
    weights[np.arange(BLOCK), lower] = 1.0 - (place - lower)
    weights[np.arange(BLOCK), lower + 1] = place - lower
    along = weights @ images.transpose(0, 3, 1, 2) @ weights.T
    return np.ascontiguousarray(along.transpose(0, 2, 3, 1), np.float32)


def _pixel_places(shot: Shot, ground: Ground, j: Indices, i: Indices) -> tuple[Floats, Floats]:
    """Return points and normals (n, B, B, 3) of the receiver at the pixels of blocks, float32."""
    pixels = ground.pixels(shot, j, i)
    inside = np.arange(BLOCK) + 0.5
    x, y = BLOCK * i[:, None, None] + inside, BLOCK * j[:, None, None] + inside[:, None]
    point = shot.view.points(shot.view.directions(x, y), pixels[..., 3])
    return point.astype(np.float32), pixels[..., :3]
