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

from mr360uw.cache import Cache, PartOf, Same, Scratch
from mr360uw.composite.ambient.solver import AmbientLight
from mr360uw.composite.gl.ground_shader import NO_EDGE, SHARP, SOFT, GroundShader, SunSight, sun_sight
from mr360uw.composite.gl.light_textures import LightTextures
from mr360uw.composite.gl.targets import Targets
from mr360uw.composite.lighting.lamps import lamps_of
from mr360uw.composite.lighting.sun import sun_of, widest_half_angle
from mr360uw.composite.receiver.block_light import (
    SMOOTH,
    changed_blocks,
    enlarged,
    free_corners,
    free_images,
    missed_between,
    set_plate_light,
)
from mr360uw.composite.receiver.ground import BLOCK, Ground, Indices
from mr360uw.composite.receiver.receiver_kernel import SEEN, BlockLight, Gathered, gather_images, lay_receiver
from mr360uw.composite.receiver.shape import (
    CoarseGrid,
    ReceiverShape,
    coarse_grid,
    kept_shape,
    rectangles_of_cells,
    touched_cells,
)
from mr360uw.composite.sampling import Gaps
from mr360uw.composite.shot import Receiver, Shot
from mr360uw.types import Rectangle, Tile

Reached = tuple[Ground, NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]
"""The ground, and upper bounds of its blocks (R, C) that a shot changes: at all, by the sun's shadow, by lamps."""


@dataclass(frozen=True, slots=True, eq=False)
class Changes:
    """Blocks (R, C) of the ground that a shot changes, the ones that lamps light among them, and light on them.

    of_sight: all that `sight` depends on. corner: of `BlockLight`. rectangles: of the frame, which cover the blocks.
    """

    ground: Ground
    blocks: NDArray[np.bool_]
    lamplit: NDArray[np.bool_]
    of_sight: tuple[object, ...]
    sight: SunSight
    corner: NDArray[np.float32]
    rectangles: list[Rectangle]


class ReceiverPass:
    """Draws the receivers of shots; caches the geometry of a receiver while the camera is at rest."""

    def __init__(self, targets: Targets, light: LightTextures, cache: Cache) -> None:
        self._shader, self._cache, self._scratch = GroundShader(targets, light), cache, Scratch()

    def reach(self, shot: Shot) -> Reached | None:
        """Return where the receiver may change, by the bodies' boxes; None where it does not."""
        if shot.receiver is None:
            return None
        shape = kept_shape(shot.receiver, shot.view.position, self._cache)
        ground = self._cache.of(_ground, PartOf(shot, shot.view), shape)
        # the grid depends on the water's attenuation alone, which does not change when the veil is scaled to the plate
        through = None if shot.medium is None else Same(shot.medium.attenuation)
        grid = self._cache.of(_grid, PartOf(shot, shot.view, through), shape)
        sun = sun_of(shot)
        of_light = None if sun is None else sun.direction, widest_half_angle(shot), shot.caustics is None
        alike = PartOf(shot, shot.receiver, shot.casters, *of_light)
        masks = _reached(alike, ground, grid) if lamps_of(shot) else self._cache.of(_reached, alike, ground, grid)
        return (ground, *masks) if np.any(masks[0]) else None

    def find(self, shot: Shot, reach: Reached | None, ambient: AmbientLight | None) -> Changes | None:
        """Return the blocks that change, by the light at their corners; None where there are none.

        ambient: solved ambient light among the bodies.
        """
        if reach is None or shot.receiver is None:
            return None
        ground, blocks, shaded, lamplit = reach
        ground.load_blocks(shot, blocks)
        corner = free_corners(shot, ground, blocks, ambient, self._cache)
        shaded = shaded & ("SHADOW" in self._shader.of_sun)
        through = None if shot.medium is None else Same(shot.medium.unscattered)
        of_sight = Same(ground), self._shader.of_sight, through, blocks, shaded, shot.receiver
        sight = self._cache.of(self._sight, PartOf(shot, *of_sight), ground, shaded)
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
        light = self._block_light(shot, changes, ambient, gaps)
        for tile in tiles:
            lay_receiver(light, tile, shot.view.width, shot.view.height, shot.pattern, self._scratch)

    def _sight(self, of_sight: PartOf[Shot], ground: Ground, shaded: NDArray[np.bool_]) -> SunSight:
        return sun_sight(self._shader, of_sight.whole, ground, shaded)

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
            blocks = j[which], i[which]
            if wanted == {"SHADOW"}:
                of_sight = PartOf(shot, changes.of_sight)
                falls = self._cache.of(self._shadow, of_sight, ground, gaps, blocks, halo[which], side, keep=2)
                own: list[NDArray[np.float32]] = []
            else:
                falls, *own = self._pixels(shot, ground, gaps, blocks, halo[which], wanted, side)
            if "SHADOW" in wanted:
                seen.append((which, falls[..., -1:]))
            if "CAUSTICS" in wanted:
                waves.append((which, falls[..., :3]))
            if own:
                shape.append((which, np.concatenate([own[0], own[1][..., :3]], axis=-1)))
            if "LAMPS" in wanted:
                added.append((which, own[2][..., :3]))
        own_pixels = (gather_images(len(j), k, of) for k, of in ((1, seen), (3, waves), (7, shape), (3, added)))
        return BlockLight(j, i, corner, free, *own_pixels)

    def _shadow(
        self,
        alike: PartOf[Shot],
        ground: Ground,
        gaps: Gaps,
        blocks: tuple[Indices, Indices],
        halo: NDArray[np.float32],
        side: int,
    ) -> NDArray[np.float32]:
        """Return the sun's visible fraction (n, B, B, 1) on blocks: at every second pixel, with straight lines between.

        side: samples along a block; with `BLOCK` of them, blocks that the lines miss are drawn at every pixel. So is
        all that is no level plane: other shapes are given at pixels only.
        """
        wanted, receiver = frozenset({"SHADOW"}), alike.whole.receiver
        assert receiver is not None
        if receiver.plane_y is None:
            return self._pixels(alike.whole, ground, gaps, blocks, halo, wanted, BLOCK)[0][..., -1:]
        few = self._pixels(alike.whole, ground, gaps, blocks, halo, wanted, BLOCK // 2)[0][..., -1:]
        seen = np.clip(enlarged(few), 0.0, 1.0)
        if side == BLOCK:
            (j, i), sharp = blocks, missed_between(few) > SMOOTH
            sharp[ground.gaps_in(gaps, j, i)[1]] = True
            if np.any(sharp):
                rest = (j[sharp], i[sharp]), halo[sharp]
                seen[sharp] = self._pixels(alike.whole, ground, gaps, *rest, wanted, BLOCK)[0][..., -1:]
        return seen

    def _pixels(
        self,
        shot: Shot,
        ground: Ground,
        gaps: Gaps,
        blocks: tuple[Indices, Indices],
        halo: NDArray[np.float32],
        wanted: frozenset[str],
        side: int,
    ) -> list[NDArray[np.float32]]:
        """Return `GroundShader.pixels`, with the light in the gaps of pixels where those are drawn one by one."""
        j, i = blocks
        images = self._shader.pixels(shot, ground, j, i, halo, wanted, side)
        some, block = ground.gaps_in(gaps, j, i)
        if len(block) and side == BLOCK:
            at = block, some.row % BLOCK, some.column % BLOCK
            for image, values in zip(images, self._shader.at_gaps(shot, ground, some, wanted), strict=True):
                image[at] = values
        return images


def _ground(of_view: PartOf[Shot], shape: ReceiverShape) -> Ground:
    return Ground(of_view.whole, shape)


def _grid(of_view: PartOf[Shot], shape: ReceiverShape) -> CoarseGrid:
    return coarse_grid(of_view.whole, shape)


def _reached(
    alike: PartOf[Shot], ground: Ground, grid: CoarseGrid
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
    at_all, by_shadow, by_lamps = (_blocks(grid, marks, ground) for marks in touched_cells(alike.whole, grid))
    return at_all, by_shadow, by_lamps


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
