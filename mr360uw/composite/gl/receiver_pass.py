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

from mr360uw.cache import Cache, Room, Same
from mr360uw.composite.ambient.solved_light import AmbientLight
from mr360uw.composite.gl.ground_shader import GroundShader
from mr360uw.composite.gl.ground_sight import NO_EDGE, SHARP, SOFT, SunSight, sun_sight
from mr360uw.composite.gl.light_textures import LightTextures
from mr360uw.composite.gl.targets import Targets
from mr360uw.composite.lighting.lamps import lamps_of
from mr360uw.composite.lighting.sun import sun_of, widest_half_angle
from mr360uw.composite.receiver.block_light import (
    changed_blocks,
    enlarged,
    free_corners,
    free_images,
    set_plate_light,
)
from mr360uw.composite.receiver.ground import BLOCK, Ground, Indices
from mr360uw.composite.receiver.plate_distance import kept_shape
from mr360uw.composite.receiver.receiver_kernel import SEEN, BlockLight, Gathered, gather_images, lay_receiver
from mr360uw.composite.receiver.shape import (
    CoarseGrid,
    ReceiverShape,
    coarse_grid,
    rectangles_of_cells,
    touched_cells,
)
from mr360uw.composite.sampling import Gaps
from mr360uw.composite.shot import Receiver, Shot
from mr360uw.types import Rectangle, Tile


@dataclass(frozen=True, slots=True, eq=False)
class ReachedBlocks:
    """Blocks (R, C) of the ground that a shot may change: at all, by the sun's shadow, and by lamps. An upper bound."""

    ground: Ground
    blocks: NDArray[np.bool_]
    shaded: NDArray[np.bool_]
    lamplit: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Changes:
    """Blocks (R, C) of the ground that a shot changes, the ones that lamps light among them, and light on them.

    of_sight: key of `sight`. corner: of `BlockLight`. rectangles: of the frame, which cover the blocks.
    """

    ground: Ground
    blocks: NDArray[np.bool_]
    lamplit: NDArray[np.bool_]
    of_sight: Hashable
    sight: SunSight
    corner: NDArray[np.float32]
    rectangles: list[Rectangle]


class ReceiverPass:
    """Draws the receivers of shots; caches the geometry of a receiver while the camera is at rest."""

    def __init__(self, targets: Targets, light: LightTextures, cache: Cache) -> None:
        self._shader, self._cache = GroundShader(targets, light), cache

    def reach(self, shot: Shot) -> ReachedBlocks | None:
        """Return where the receiver may change, by the bodies' boxes; None where it does not."""
        if shot.receiver is None:
            return None
        ground, grid = self._ground(shot, shot.receiver), self._coarse_grid(shot, shot.receiver)

        def make() -> ReachedBlocks:
            touched = touched_cells(shot, grid)
            marks = touched.at_all, touched.by_shadow, touched.by_lamps
            return ReachedBlocks(ground, *(_blocks(grid, of, ground) for of in marks))

        sun, wide = sun_of(shot), widest_half_angle(shot)
        seen = None if sun is None else np.asarray(sun.direction).tobytes(), wide, shot.caustics is None
        key = Same(ground), Same(grid), shot.receiver, tuple(placed.key for placed in shot.casters), seen
        found = make() if lamps_of(shot) else self._cache.get("receiver reach", key, make)
        return found if np.any(found.blocks) else None

    def find(self, shot: Shot, reach: ReachedBlocks | None, ambient: AmbientLight | None) -> Changes | None:
        """Return the blocks that change, by the light at their corners; None where there are none.

        ambient: solved ambient light among the bodies.
        """
        if reach is None or shot.receiver is None:
            return None
        ground, blocks, lamplit = reach.ground, reach.blocks, reach.lamplit
        ground.load_blocks(shot, blocks)
        corner = free_corners(shot, ground, blocks, ambient, self._cache)
        shaded = reach.shaded & ("SHADOW" in self._shader.of_sun)
        of_sight = self._of_sight(shot, ground, blocks, shaded)
        sight = self._cache.get("sun on ground", of_sight, partial(sun_sight, self._shader, shot, ground, shaded))
        corner[(*sight.at, SEEN)] = sight.value
        if "CAUSTICS" not in self._shader.of_sun & _wanted(shot.receiver):
            changed = changed_blocks(shot, ground, blocks, corner, ambient, self._cache)
            blocks = changed | (blocks & (lamplit | (sight.edge != NO_EDGE)))
        rectangles = rectangles_of_cells(blocks, (BLOCK, BLOCK), shot.view)
        set_plate_light(shot, ground, blocks, corner)
        return Changes(ground, blocks, lamplit, of_sight, sight, corner, rectangles) if rectangles else None

    def draw(
        self, shot: Shot, changes: Changes | None, tiles: Sequence[Tile], ambient: AmbientLight | None, gaps: Gaps
    ) -> None:
        """Write ratio and veil of the changed parts into the tiles.

        ambient: solved ambient light among the bodies. gaps: of pixels that they cover partly.
        """
        if changes is None:
            return
        light, room = self._block_light(shot, changes, ambient, gaps), self._cache.get("plate room", None, Room)
        for tile in tiles:
            lay_receiver(light, tile, shot.view.width, shot.view.height, shot.pattern, room)

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

    def _block_light(self, shot: Shot, changes: Changes, ambient: AmbientLight | None, gaps: Gaps) -> BlockLight:
        receiver, ground, sight, corner = shot.receiver, changes.ground, changes.sight, changes.corner
        assert receiver is not None
        j, i = np.nonzero(changes.blocks)
        lamplit = changes.lamplit[j, i]
        rough = ground.rough[j, i] | lamplit
        free = free_images(shot, ground, corner, j, i, ambient, self._cache, gaps)
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
            of_pixels = changes.of_sight, Same(gaps), j[which].tobytes(), i[which].tobytes()
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
