# SPDX-License-Identifier: Apache-2.0
"""What blocks of the receiver see of the sun, and which of them a shadow's edge crosses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.gl.ground_shader import GroundShader
from mr360uw.composite.lighting.sun import scattered_share, sun_of, widest_half_angle
from mr360uw.composite.receiver.block_light import SMOOTH
from mr360uw.composite.receiver.ground import Ground, Indices
from mr360uw.composite.shot import Shot

NO_EDGE, SOFT, SHARP = 0, 1, 2
"""Kinds of shadow edges in a block: none, one for samples at every second pixel, one for all."""
_PART_OF_DISC, _WHOLE_DISC = 2.0, 3.0
"""Occlusion codes of coarse.frag: bodies may occlude part of the sun's disc, or occlude all of it."""
_WIDE = 1.5
"""Width of a penumbra, in radii of a block, above which corners and middle represent it. Half as large, narrow
penumbrae are missed; twice as large, more blocks are drawn pixel by pixel."""
_HALVED = 12.0
"""Interpolation error at a block's middle, over `SMOOTH`, up to which samples at every second pixel are enough. The
error grows with the square of the spacing, so they allow 16; the margin is for penumbrae of uneven curvature."""


@dataclass(frozen=True, slots=True, eq=False)
class SunSight:
    """What shaded blocks see of the sun.

    at: rows and columns (n,) of corners of blocks; value: (n,) visible fraction of the sun there. edge: (R, C) kind of
    shadow edge inside a block that interpolation does not represent. umbra: (R, C) whether it lies in the umbra. halo:
    (R, C, 4) visible fraction of the halo at its corners, negative where they do not represent the pixels inside.
    """

    at: tuple[Indices, Indices]
    value: NDArray[np.float32]
    edge: NDArray[np.int8]
    umbra: NDArray[np.bool_]
    halo: NDArray[np.float32]


def sun_sight(shader: GroundShader, shot: Shot, ground: Ground, shaded: NDArray[np.bool_]) -> SunSight:
    """Return what the shaded blocks (R, C) of the ground see of a shot's sun."""
    edge, umbra = np.full(shaded.shape, NO_EDGE, np.int8), np.zeros(shaded.shape, np.bool_)
    halo = np.full((*shaded.shape, 4), -1.0, np.float32)
    sun = sun_of(shot)
    if not np.any(shaded) or sun is None:
        return SunSight((np.zeros(0, np.int64),) * 2, np.zeros(0, np.float32), edge, umbra, halo)
    cj, ci = np.nonzero(ground.corners_of(shaded))
    mj, mi = np.nonzero(shaded)
    places = np.zeros((len(cj) + len(mj), 4), np.float32)
    places[: len(cj), :3] = ground.corner_point[cj, ci]
    places[len(cj) :, :3], places[len(cj) :, 3] = ground.middle_point[mj, mi], ground.reach_m[mj, mi]
    visible = shader.sun_at(places)
    at_corners = np.zeros((2, shaded.shape[0] + 1, shaded.shape[1] + 1), np.float32)
    at_corners[:, cj, ci] = visible[: len(cj), :2].T
    seen, halo_seen, kept, gap = visible[len(cj) :].T
    reach = ground.reach_m[mj, mi]
    of_disc, of_halo = 2.0 * np.tan(sun.half_angle_rad) * gap, 2.0 * np.tan(widest_half_angle(shot)) * gap
    missed = np.abs(seen - ground.middle_between(at_corners[0], mj, mi))
    narrow = np.where(kept == _PART_OF_DISC, of_disc, of_halo) < _WIDE * reach
    sharp = narrow | (missed > _HALVED * SMOOTH)
    found = np.where(sharp, SHARP, np.where(missed > SMOOTH, SOFT, NO_EDGE))
    umbra[mj, mi] = kept == _WHOLE_DISC
    edge[mj, mi] = np.where((kept > 0.0) & (kept < _WHOLE_DISC), found, NO_EDGE)
    missed = np.abs(halo_seen - ground.middle_between(at_corners[1], mj, mi))
    missed *= scattered_share(shot, ground.middle_point[mj, mi])
    interpolable = (of_halo >= _WIDE * reach) & (missed <= SMOOTH)
    halo[mj, mi] = np.where(interpolable[:, None], ground.four(at_corners[1], mj, mi), -1.0)
    return SunSight((cj, ci), visible[: len(cj), 0], edge, umbra, halo)
