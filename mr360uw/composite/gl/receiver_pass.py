# SPDX-License-Identifier: Apache-2.0
"""The receiver on OpenGL 3.3: ratio and veil of the plate's ground.

Light that varies slowly is evaluated at the corners of blocks of pixels (ground.py) and interpolated. Blocks with a
shadow's edge, caustics or an uneven shape are drawn pixel by pixel; only those are read back.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import Cache, Same
from mr360uw.composite.ambient.solver import AmbientLight
from mr360uw.composite.gl.ground_shader import GroundShader
from mr360uw.composite.gl.ground_sight import NO_EDGE, SHARP, SOFT, sun_sight
from mr360uw.composite.gl.light_textures import LightTextures
from mr360uw.composite.gl.targets import Targets
from mr360uw.composite.receiver.block_light import corner_light, enlarged, free_images
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
        of_sight = self._of_sight(shot, ground, blocks, shaded)
        sight = self._cache.get("sun on ground", of_sight, partial(sun_sight, self._shader, shot, ground, shaded))
        corner[(*sight.at, SEEN)] = sight.value
        edge, umbra, halo = sight.edge[j, i], sight.umbra[j, i], sight.halo[j, i]
        of_sun = self._shader.of_sun & _wanted(receiver)
        wavy = ~umbra & ("CAUSTICS" in of_sun)
        if receiver.plane_y is None:
            edge = np.where(edge == SOFT, SHARP, edge)  # other shapes are given at pixels only
        # kinds of blocks: mask, features to compute, samples along a block
        kinds = (
            (~rough & (edge == SOFT) & ~wavy, {"SHADOW"}, BLOCK // 2),
            (~rough & (edge == SHARP) & ~wavy, {"SHADOW"}, BLOCK),
            (~rough & (edge != NO_EDGE) & wavy, {"SHADOW", "CAUSTICS"}, BLOCK),
            (~rough & (edge == NO_EDGE) & wavy, {"CAUSTICS"}, BLOCK),
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
            make = partial(self._pixels, shot, ground, gaps, j[which], i[which], halo[which], wanted, side)
            of_pixels = of_sight, Same(gaps), which.tobytes()
            falls, *own = self._cache.get(f"ground {side}", of_pixels, make) if wanted == {"SHADOW"} else make()
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

    def _of_sight(
        self, shot: Shot, ground: Ground, blocks: NDArray[np.bool_], shaded: NDArray[np.bool_]
    ) -> tuple[Hashable, ...]:
        """Return the key of what blocks (R, C) of the ground see of the sun."""
        through = None if shot.medium is None else Same(shot.medium.unscattered)
        return Same(ground), self._shader.sun_key, through, blocks.tobytes(), shaded.tobytes(), shot.receiver

    def _pixels(
        self,
        shot: Shot,
        ground: Ground,
        gaps: Gaps,
        j: Indices,
        i: Indices,
        halo: NDArray[np.float32],
        wanted: frozenset[str],
        side: int,
    ) -> list[NDArray[np.float32]]:
        """Return `GroundShader.pixels`, with the light in the gaps of pixels where those are drawn one by one."""
        images = self._shader.pixels(shot, ground, j, i, halo, wanted, side)
        some, block = ground.gaps_in(gaps, j, i)
        if len(block) and side == BLOCK:
            at = block, some.row % BLOCK, some.column % BLOCK
            for image, values in zip(images, self._shader.at_gaps(shot, ground, some, wanted), strict=True):
                image[at] = values
        return images


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
