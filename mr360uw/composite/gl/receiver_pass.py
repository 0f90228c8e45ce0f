# SPDX-License-Identifier: Apache-2.0
"""The receiver on OpenGL 3.3: ratio and veil of the plate's ground.

Light that varies slowly is evaluated at the corners of blocks of pixels (ground.py) and interpolated. Blocks with a
shadow's edge, caustics or an uneven shape are drawn pixel by pixel; only those are read back.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import Cache, Same
from mr360uw.composite.ambient.solver import AmbientLight
from mr360uw.composite.gl.ground_shader import GroundShader
from mr360uw.composite.gl.light_textures import LightTextures
from mr360uw.composite.gl.targets import Targets
from mr360uw.composite.lighting.sun import scattered_share, sun_of, widest_half_angle
from mr360uw.composite.receiver.block_light import SMOOTH, corner_light, enlarged, free_images
from mr360uw.composite.receiver.ground import BLOCK, Ground, Indices
from mr360uw.composite.receiver.plate_distance import kept_shape
from mr360uw.composite.receiver.receiver_kernel import SEEN, BlockLight, Gathered, gather_images, lay_receiver
from mr360uw.composite.receiver.shape import (
    CoarseGrid,
    ReceiverShape,
    Touched,
    coarse_grid,
    receiver_rectangles,
    touched_cells,
)
from mr360uw.composite.sampling import Gaps
from mr360uw.composite.shot import Receiver, Shot
from mr360uw.types import Rectangle, Tile

_NO_EDGE, _SOFT, _SHARP = 0, 1, 2
_PART_OF_DISC, _WHOLE_DISC = 2.0, 3.0
"""Occlusion codes of coarse.frag: bodies may occlude part of the sun's disc, or occlude all of it."""
_WIDE = 1.5
"""Width of a penumbra, in radii of a block, above which corners and middle represent it. Half as large, narrow
penumbrae are missed; twice as large, more blocks are drawn pixel by pixel."""
_HALVED = 12.0
"""Interpolation error at a block's middle, over `SMOOTH`, up to which samples at every second pixel are enough. The
error grows with the square of the spacing, so they allow 16; the margin is for penumbrae of uneven curvature."""


@dataclass(frozen=True, slots=True, eq=False)
class Changes:
    """Parts of the receiver that a shot may change: rectangles of the frame, and cells of a grid."""

    rectangles: list[Rectangle]
    grid: CoarseGrid
    touched: Touched


class ReceiverPass:
    """Draws the receivers of shots; caches the geometry of a receiver while the camera is at rest."""

    def __init__(self, targets: Targets, light: LightTextures, cache: Cache) -> None:
        self._shader, self._cache = GroundShader(targets, light), cache

    def find(self, shot: Shot) -> Changes | None:
        """Return the parts of the receiver that may change; None without a receiver."""
        if shot.receiver is None:
            return None
        grid = self._coarse_grid(shot, shot.receiver)
        touched = touched_cells(shot, grid)
        return Changes(receiver_rectangles(shot, grid, touched), grid, touched)

    def draw(
        self, shot: Shot, changes: Changes | None, tiles: Sequence[Tile], ambient: AmbientLight | None, gaps: Gaps
    ) -> None:
        """Write ratio and veil of the changed parts into the tiles.

        ambient: solved ambient light among the bodies. gaps: of pixels that they cover partly.
        """
        if changes is None or not changes.rectangles or shot.receiver is None:
            return
        ground = self._ground(shot, shot.receiver)
        blocks = _blocks(changes.grid, changes.touched.at_all, ground)
        shaded = _blocks(changes.grid, changes.touched.by_shadow, ground) & ("SHADOW" in self._shader.of_sun)
        ground.load_blocks(shot, blocks)
        lamplit = _blocks(changes.grid, changes.touched.by_lamps, ground)
        light = self._block_light(shot, ground, blocks, shaded, lamplit, ambient, gaps)
        for tile in tiles:
            lay_receiver(light, tile, shot.view.width, shot.view.height, shot.pattern)

    # --- cached geometry ---------------------------------------------------------------------------------------------

    def _shape(self, shot: Shot, receiver: Receiver) -> ReceiverShape:
        return kept_shape(receiver, shot.view.position, self._cache)

    def _coarse_grid(self, shot: Shot, receiver: Receiver) -> CoarseGrid:
        # the grid depends on the water's attenuation alone, which does not change when the veil is scaled to the plate
        through = None if shot.medium is None else Same(shot.medium.attenuation)
        key = (receiver, shot.view.key, through)
        return self._cache.get("receiver grid", key, lambda: coarse_grid(shot, self._shape(shot, receiver)))

    def _ground(self, shot: Shot, receiver: Receiver) -> Ground:
        key = (receiver, shot.view.key)
        return self._cache.get("ground", key, lambda: Ground(shot, self._shape(shot, receiver)))

    # --- light on blocks ---------------------------------------------------------------------------------------------

    def _block_light(
        self,
        shot: Shot,
        ground: Ground,
        blocks: NDArray[np.bool_],
        shaded: NDArray[np.bool_],
        by_lamps: NDArray[np.bool_],
        ambient: AmbientLight | None,
        gaps: Gaps,
    ) -> BlockLight:
        receiver = shot.receiver
        assert receiver is not None
        j, i = np.nonzero(blocks)
        lamplit = by_lamps[j, i]
        rough = ground.rough[j, i] | lamplit
        corner = corner_light(shot, ground, blocks, ambient, self._cache)
        free = free_images(shot, ground, corner, j, i, ambient, self._cache, gaps)
        edge, umbra, halo = self._see_sun(shot, ground, shaded, corner, j, i)
        of_sun = self._shader.of_sun & _wanted(receiver)
        wavy = ~umbra & ("CAUSTICS" in of_sun)
        if receiver.plane_y is None:
            edge[edge == _SOFT] = _SHARP  # other shapes are given at pixels only
        # kinds of blocks: mask, features to compute, samples along a block
        kinds = (
            (~rough & (edge == _SOFT) & ~wavy, {"SHADOW"}, BLOCK // 2),
            (~rough & (edge == _SHARP) & ~wavy, {"SHADOW"}, BLOCK),
            (~rough & (edge != _NO_EDGE) & wavy, {"SHADOW", "CAUSTICS"}, BLOCK),
            (~rough & (edge == _NO_EDGE) & wavy, {"CAUSTICS"}, BLOCK),
            (rough & ~lamplit, {"ROUGH", "SHADOW", "CAUSTICS"}, BLOCK),
            (lamplit, {"ROUGH", "SHADOW", "CAUSTICS", "LAMPS"}, BLOCK),
        )
        seen: Gathered = []
        waves: Gathered = []
        shape: Gathered = []
        added: Gathered = []
        for which, asked, side in kinds:
            if not np.any(which):
                continue
            wanted = frozenset(asked) & {"ROUGH", "LAMPS", *of_sun}
            falls, *own = self._shader.pixels(shot, ground, j[which], i[which], halo[which], wanted, side)
            some, block = ground.gaps_in(gaps, j[which], i[which])
            if len(block) and side == BLOCK:
                at = block, some.row % BLOCK, some.column % BLOCK
                for image, values in zip([falls, *own], self._shader.at_gaps(shot, ground, some, wanted), strict=True):
                    image[at] = values
            if "SHADOW" in wanted:
                seen.append((which, falls[..., -1:] if side == BLOCK else np.clip(enlarged(falls), 0.0, 1.0)))
            if "CAUSTICS" in wanted:
                waves.append((which, falls[..., :3]))
            if own:
                shape.append((which, np.concatenate([own[0], own[1][..., :3]], axis=-1)))
            if "LAMPS" in wanted:
                added.append((which, own[2][..., :3]))
        own_pixels = (gather_images(len(j), k, of) for k, of in ((1, seen), (3, waves), (7, shape), (3, added)))
        return BlockLight(j, i, corner, free, *own_pixels)

    def _see_sun(
        self,
        shot: Shot,
        ground: Ground,
        shaded: NDArray[np.bool_],
        corner: NDArray[np.float32],
        j: Indices,
        i: Indices,
    ) -> tuple[NDArray[np.int8], NDArray[np.bool_], NDArray[np.float32]]:
        """Set the visible fraction of the sun at the corners of the shaded blocks (R, C).

        Returns, for each of the blocks (j, i): the kind of shadow edge inside that interpolation does not represent;
        whether it lies in the umbra; and the visible fraction of the halo at its corners (n, 4), negative where block
        corners do not represent the pixels inside.
        """
        edge, umbra = np.full(shaded.shape, _NO_EDGE, np.int8), np.zeros(shaded.shape, np.bool_)
        halo = np.full((*shaded.shape, 4), -1.0, np.float32)
        if np.any(shaded) and (sun := sun_of(shot)) is not None:
            cj, ci = np.nonzero(ground.corners_of(shaded))
            mj, mi = np.nonzero(shaded)
            places = np.zeros((len(cj) + len(mj), 4), np.float32)
            places[: len(cj), :3] = ground.corner_point[cj, ci]
            places[len(cj) :, :3], places[len(cj) :, 3] = ground.middle_point[mj, mi], ground.reach_m[mj, mi]
            visible = self._shader.sun_at(places)
            corner[cj, ci, SEEN] = visible[: len(cj), 0]
            at_corners = np.zeros(corner.shape[:2], np.float32)
            at_corners[cj, ci] = visible[: len(cj), 1]
            seen, halo_seen, kept, gap = visible[len(cj) :].T
            reach = ground.reach_m[mj, mi]
            of_disc, of_halo = 2.0 * np.tan(sun.half_angle_rad) * gap, 2.0 * np.tan(widest_half_angle(shot)) * gap
            missed = np.abs(seen - ground.middle_between(corner[..., SEEN], mj, mi))
            narrow = np.where(kept == _PART_OF_DISC, of_disc, of_halo) < _WIDE * reach
            sharp = narrow | (missed > _HALVED * SMOOTH)
            found = np.where(sharp, _SHARP, np.where(missed > SMOOTH, _SOFT, _NO_EDGE))
            umbra[mj, mi] = kept == _WHOLE_DISC
            edge[mj, mi] = np.where((kept > 0.0) & (kept < _WHOLE_DISC), found, _NO_EDGE)
            missed = np.abs(halo_seen - ground.middle_between(at_corners, mj, mi))
            missed *= scattered_share(shot, ground.middle_point[mj, mi])
            interpolable = (of_halo >= _WIDE * reach) & (missed <= SMOOTH)
            halo[mj, mi] = np.where(interpolable[:, None], ground.four(at_corners, mj, mi), -1.0)
        return edge[j, i], umbra[j, i], halo[j, i]


def _wanted(receiver: Receiver) -> frozenset[str]:
    """Return the features of the sun that a receiver shows."""
    shown = {"SHADOW": receiver.shadow, "CAUSTICS": receiver.caustics}
    return frozenset(name for name, shows in shown.items() if shows)


def _blocks(grid: CoarseGrid, marks: NDArray[np.bool_], ground: Ground) -> NDArray[np.bool_]:
    """Return the mask (R, C) of blocks that overlap a marked cell (n,)."""
    blocks = np.zeros((ground.rows, ground.columns), np.bool_)
    width, height = grid.cell
    row, column = np.divmod(grid.index[marks], grid.shape[1])
    for down in range(0, height + BLOCK - 1, BLOCK):
        for right in range(0, width + BLOCK - 1, BLOCK):
            j = (height * row + min(down, height - 1)) // BLOCK
            i = (width * column + min(right, width - 1)) // BLOCK
            blocks[np.minimum(j, ground.rows - 1), np.minimum(i, ground.columns - 1)] = True
    return blocks
