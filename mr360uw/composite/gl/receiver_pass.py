# SPDX-License-Identifier: Apache-2.0
"""The receiver on OpenGL 3.3: what objects and waves change on the ground of the plate.

What varies slowly along the ground is found at the corners of blocks of pixels (ground.py) and followed by straight
lines. Blocks in which a shadow has an edge, waves, or a shape of their own are drawn pixel by pixel; only those are
read back.
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
from mr360uw.composite.receiver.receiver_kernel import SEEN, BlockLight, Gathered, gather_images, lay_receiver
from mr360uw.composite.receiver.shape import (
    CoarseGrid,
    ReceiverShape,
    Touched,
    coarse_grid,
    receiver_rectangles,
    touched_cells,
)
from mr360uw.composite.shot import Receiver, Shot
from mr360uw.types import Rectangle, Tile

_NO_EDGE, _SOFT, _SHARP = 0, 1, 2
_OF_DISC, _ALL = 2.0, 3.0
"""What bodies keep off: part of the sun's disc, all of it (coarse.frag)."""
_WIDE = 1.5
"""A penumbra so many times as wide as a block reaches has no detail that the corners and the middle do not show."""
_HALVED = 12.0
"""What straight lines miss goes with the square of their length: with a sample at every second pixel, a sixteenth of
what the corners of a block miss. Some of the sixteen are kept for penumbrae that bend unevenly."""


@dataclass(frozen=True, slots=True, eq=False)
class Changes:
    """Where a shot changes its receiver: rectangles of the frame, and cells of a grid."""

    rectangles: list[Rectangle]
    grid: CoarseGrid
    touched: Touched


class ReceiverPass:
    """Draws the receivers of shots; keeps what is known of one that stands still before the camera."""

    def __init__(self, targets: Targets, light: LightTextures, cache: Cache) -> None:
        self._shader, self._cache = GroundShader(targets, light), cache

    def find(self, shot: Shot) -> Changes | None:
        """Return where the receiver may change; None without one."""
        if shot.receiver is None:
            return None
        grid = self._coarse_grid(shot, shot.receiver)
        touched = touched_cells(shot, grid)
        return Changes(receiver_rectangles(shot, grid, touched), grid, touched)

    def draw(self, shot: Shot, changes: Changes | None, tiles: Sequence[Tile], ambient: AmbientLight | None) -> None:
        """Write ratio and veil of what changes into the tiles. ambient: solved ambient light among the bodies."""
        if changes is None or not changes.rectangles or shot.receiver is None:
            return
        ground = self._ground(shot, shot.receiver)
        blocks = _blocks(changes.grid, changes.touched.at_all, ground)
        shaded = _blocks(changes.grid, changes.touched.by_shadow, ground) & ("SHADOW" in self._shader.of_sun)
        ground.load_blocks(shot, blocks)
        lamplit = _blocks(changes.grid, changes.touched.by_lamps, ground)
        light = self._block_light(shot, ground, blocks, shaded, lamplit, ambient)
        for tile in tiles:
            lay_receiver(light, tile, shot.view.width, shot.view.height)

    # --- what is kept ------------------------------------------------------------------------------------------------

    def _shape(self, shot: Shot, receiver: Receiver) -> ReceiverShape:
        key = (receiver, shot.view.position.tobytes())
        return self._cache.get("receiver shape", key, lambda: ReceiverShape(receiver, shot.view.position))

    def _coarse_grid(self, shot: Shot, receiver: Receiver) -> CoarseGrid:
        # of the water the grid needs what it lets through, which stays the same where its veil follows the plate
        through = None if shot.medium is None else Same(shot.medium.attenuation)
        key = (receiver, shot.view.key, through)
        return self._cache.get("receiver grid", key, lambda: coarse_grid(shot, self._shape(shot, receiver)))

    def _ground(self, shot: Shot, receiver: Receiver) -> Ground:
        key = (receiver, shot.view.key)
        return self._cache.get("ground", key, lambda: Ground(shot, self._shape(shot, receiver)))

    # --- what falls on blocks ----------------------------------------------------------------------------------------

    def _block_light(
        self,
        shot: Shot,
        ground: Ground,
        blocks: NDArray[np.bool_],
        shaded: NDArray[np.bool_],
        by_lamps: NDArray[np.bool_],
        ambient: AmbientLight | None,
    ) -> BlockLight:
        receiver = shot.receiver
        assert receiver is not None
        j, i = np.nonzero(blocks)
        lamplit = by_lamps[j, i]
        rough = ground.rough[j, i] | lamplit
        corner = corner_light(shot, ground, blocks, ambient, self._cache)
        free = free_images(shot, ground, corner, j, i, ambient, self._cache)
        edge, umbra, halo = self._see_sun(shot, ground, shaded, corner, j, i)
        of_sun = self._shader.of_sun & _wanted(receiver)
        wavy = ~umbra & ("CAUSTICS" in of_sun)
        if receiver.plane_y is None:
            edge[edge == _SOFT] = _SHARP  # of other shapes the pixels are known, nothing between them
        # blocks of one kind each: which, what is asked of them, samples along a block
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
        """Set the part of the sun seen at the corners of the shaded blocks (R, C).

        Returns which edge of a shadow each of the blocks (j, i) holds that its corners do not tell, which of them lie
        wholly in the umbra, and the part of the halo seen at their corners (n, 4), as `GroundShader.pixels` takes it.
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
            narrow = np.where(kept == _OF_DISC, of_disc, of_halo) < _WIDE * reach
            sharp = narrow | (missed > _HALVED * SMOOTH)
            found = np.where(sharp, _SHARP, np.where(missed > SMOOTH, _SOFT, _NO_EDGE))
            umbra[mj, mi] = kept == _ALL
            edge[mj, mi] = np.where((kept > 0.0) & (kept < _ALL), found, _NO_EDGE)
            missed = np.abs(halo_seen - ground.middle_between(at_corners, mj, mi))
            missed *= scattered_share(shot, ground.middle_point[mj, mi])
            told = (of_halo >= _WIDE * reach) & (missed <= SMOOTH)
            halo[mj, mi] = np.where(told[:, None], ground.four(at_corners, mj, mi), -1.0)
        return edge[j, i], umbra[j, i], halo[j, i]


def _wanted(receiver: Receiver) -> frozenset[str]:
    """Return what of the sun a receiver shows."""
    shown = {"SHADOW": receiver.shadow, "CAUSTICS": receiver.caustics}
    return frozenset(name for name, shows in shown.items() if shows)


def _blocks(grid: CoarseGrid, marks: NDArray[np.bool_], ground: Ground) -> NDArray[np.bool_]:
    """Return the blocks (R, C) that some marked cell (n,) overlaps."""
    blocks = np.zeros((ground.rows, ground.columns), np.bool_)
    width, height = grid.cell
    row, column = np.divmod(grid.index[marks], grid.shape[1])
    for down in range(0, height + BLOCK - 1, BLOCK):
        for right in range(0, width + BLOCK - 1, BLOCK):
            j = (height * row + min(down, height - 1)) // BLOCK
            i = (width * column + min(right, width - 1)) // BLOCK
            blocks[np.minimum(j, ground.rows - 1), np.minimum(i, ground.columns - 1)] = True
    return blocks
