# SPDX-License-Identifier: Apache-2.0
"""Unshadowed irradiance on the receiver, at block corners and per pixel where interpolation is not accurate enough."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.lighting.occlusion import ambient_blocked, surfel_table
from mr360uw.composite.lighting.sources import light_sources
from mr360uw.composite.receiver.ground import BLOCK, Ground, Indices
from mr360uw.composite.receiver.ratio import ambient_share, unblocked
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
from mr360uw.composite.shot import Shot
from mr360uw.medium.lookup import veil_lookup
from mr360uw.types import Floats

SMOOTH = 0.004
"""Largest interpolation error at the middle of a block, in linear light: less than a code value. Twice as large, blocks
show in smooth shadows."""


def corner_light(shot: Shot, ground: Ground, blocks: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return the corner light (R + 1, C + 1, 8) of blocks for receiver_kernel.py, with the sun fully visible."""
    corner = np.zeros((ground.rows + 1, ground.columns + 1, CORNER_CHANNELS), np.float32)
    j, i = np.nonzero(ground.corners_of(blocks))
    point, normal = (a[j, i].astype(np.float64) for a in (ground.corner_point, ground.corner_normal))
    of = slice(None)
    if shot.receiver is not None and shot.receiver.plane_y is not None:
        there = int(np.argmax(point[:, 1] != 0.0))
        of = slice(there, there + 1)  # a horizontal plane has the same share everywhere
    corner[j, i, SHARE] = ambient_share(shot, light_sources(shot), point[of], normal[of])
    if shot.medium is not None:
        distance = np.linalg.norm(point, axis=-1)
        corner[j, i, VEIL] = veil_lookup(shot.medium, distance, point[:, 1] / np.maximum(distance, 1e-9))
    corner[j, i, FREE] = _free(shot, ground.corner_point[j, i], ground.corner_normal[j, i])
    corner[j, i, SEEN] = 1.0
    return corner


def free_images(shot: Shot, ground: Ground, corner: Floats, j: Indices, i: Indices) -> PixelImages:
    """Return the unblocked ambient fraction per pixel, for blocks where interpolation from corners is not accurate."""
    rough = ground.rough[j, i]
    at_middle = _free(shot, ground.middle_point[j, i], ground.middle_normal[j, i])
    uneven = ~rough & (np.abs(at_middle - ground.middle_between(corner[..., FREE], j, i)) > SMOOTH)
    parts: Gathered = []
    if np.any(uneven):
        of = j[uneven], i[uneven]
        places = ground.between(ground.corner_point, *of), ground.between(ground.corner_normal, *of)
        parts.append((uneven, _free(shot, *places)[..., None]))
    if np.any(rough):
        parts.append((rough, _free(shot, *_pixel_places(shot, ground, j[rough], i[rough]))[..., None]))
    return gather_images(len(j), 1, parts)


def _free(shot: Shot, point: Floats, normal: Floats) -> Floats:
    """Return the fraction (...,) of the ambient light that bodies leave unblocked at points (..., 3), float32."""
    if shot.receiver is None or not shot.receiver.occlusion:
        return np.ones(point.shape[:-1], np.float32)
    return unblocked(ambient_blocked(point, normal, surfel_table(shot.casters, shot.view.position)))


def _pixel_places(shot: Shot, ground: Ground, j: Indices, i: Indices) -> tuple[Floats, Floats]:
    """Return points and normals (n, B, B, 3) of the receiver at the pixels of blocks, float32."""
    pixels = ground.pixels(shot, j, i)
    inside = np.arange(BLOCK) + 0.5
    x, y = BLOCK * i[:, None, None] + inside, BLOCK * j[:, None, None] + inside[:, None]
    point = shot.view.directions(x, y) * pixels[..., 3:]
    return point.astype(np.float32), pixels[..., :3]
