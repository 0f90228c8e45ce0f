# SPDX-License-Identifier: Apache-2.0
"""The receiver on OpenGL 3.3: ratio and veil of the plate's ground.

Light that varies slowly is evaluated at the corners of blocks of pixels (ground.py) and interpolated. Blocks with a
shadow's edge, caustics or an uneven shape are drawn pixel by pixel; only those are read back.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import Cache, PartOf, Same
from mr360uw.composite.ambient.light import GroundField, ground_field
from mr360uw.composite.ambient.solver import AmbientLight
from mr360uw.composite.gl.device import Targets, bind, of_eye
from mr360uw.composite.gl.light_textures import ShotLight, sun_defines
from mr360uw.composite.lighting.light_sources import lamps_of, scattered_share, sun_of, widest_half_angle
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
from mr360uw.composite.receiver.ratio import FADE_FROM
from mr360uw.composite.receiver.receiver_kernel import SEEN, BlockLight, Gathered, gather_images, lay_receiver
from mr360uw.composite.receiver.shape import (
    CoarseGrid,
    ReceiverShape,
    coarse_grid,
    kept_shape,
    rectangles_of_cells,
    touched_cells,
)
from mr360uw.composite.sampling import WHOLE_PIXEL, Gaps
from mr360uw.composite.shot import Receiver, Shot
from mr360uw.gl.context import set_uniforms, texture_from_array
from mr360uw.types import Floats, Rectangle, Tile


@dataclass(frozen=True, slots=True, eq=False)
class Reached:
    """The ground that a shot may change.

    blocks, shaded, lamplit: upper bounds (R, C) of its blocks that change: at all, by the sun's shadow, by lamps.
    ambient: what bodies leave of its light. corner: of `BlockLight`, as if the sun were visible everywhere.
    """

    ground: Ground
    blocks: NDArray[np.bool_]
    shaded: NDArray[np.bool_]
    lamplit: NDArray[np.bool_]
    ambient: GroundField
    corner: NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class Changes:
    """Blocks of the ground that a shot changes, n of them, by rows and columns (n,).

    light: of the shot. rectangles: of the frame, which cover the blocks. of_sight: all that what they see of the sun
    depends on. edge, halo: (n,), (n, 4) of `SunSight`; where other shapes than planes have an edge it is `SHARP`.
    rough, lamplit: (n,) whether the ground is uneven or lamps light it; whether lamps do. wavy: (n,) whether caustics
    show. shadowed: (n,) whether a shadow's edge alone changes a block. few: (m, s, s, 1) the sun's visible fraction at
    every second pixel of these m; None unless the receiver is a plane.
    """

    reach: Reached
    light: ShotLight
    rows: Indices
    columns: Indices
    rectangles: list[Rectangle]
    of_sight: tuple[object, ...]
    edge: NDArray[np.int8]
    halo: NDArray[np.float32]
    rough: NDArray[np.bool_]
    lamplit: NDArray[np.bool_]
    wavy: NDArray[np.bool_]
    shadowed: NDArray[np.bool_]
    few: NDArray[np.float32] | None = None


_Lit = tuple[Shot, ShotLight]
Masks = tuple[Ground, NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]
"""The ground, and the first three of `Reached`."""


class ReceiverPass:
    """Draws the receivers of shots; caches the geometry of a receiver while the camera is at rest."""

    def __init__(self, targets: Targets, cache: Cache) -> None:
        self._shader, self._cache = GroundShader(targets), cache

    def masks(self, shot: Shot) -> Masks | None:
        """Return where the receiver may change, by the bodies' boxes; None where it does not."""
        if shot.receiver is None:
            return None
        shape = kept_shape(shot.receiver, shot.view.position, self._cache)
        ground = self._cache.of(_ground, PartOf(shot, shot.view), shape)
        grid = self._cache.of(_grid, PartOf(shot, shot.view), shape)
        sun = sun_of(shot)
        of_light = None if sun is None else sun.direction, widest_half_angle(shot), shot.caustics is None
        # of the water its attenuation alone counts, which does not change when the veil is scaled to the plate
        through = None if shot.medium is None else Same(shot.medium.attenuation)
        alike = PartOf(shot, shot.receiver, shot.casters, *of_light, through)
        masks = _reached(alike, ground, grid) if lamps_of(shot) else self._cache.of(_reached, alike, ground, grid)
        return (ground, *masks) if np.any(masks[0]) else None

    def reached(self, shot: Shot, masks: Masks | None, ambient: AmbientLight | None) -> Reached | None:
        """Return the ground where it may change, with all that does not need the device. ambient: of the bodies."""
        if masks is None:
            return None
        ground, blocks, shaded, lamplit = masks
        ground.load_blocks(shot, blocks)
        field = ground_field(shot, ambient, self._cache)
        corner = free_corners(ground, blocks, field)
        shaded = shaded & ("SHADOW" in sun_defines(shot))
        return Reached(ground, blocks, shaded, lamplit, field, corner)

    def find(self, shot: Shot, light: ShotLight, reach: Reached | None) -> Changes | None:
        """Return the blocks that change, by the light at their corners; None where there are none."""
        if reach is None or shot.receiver is None:
            return None
        ground, blocks, lamplit, corner = reach.ground, reach.blocks, reach.lamplit, reach.corner
        through = None if shot.medium is None else Same(shot.medium.unscattered)
        of_sight = Same(ground), light.of_sight, through, blocks, reach.shaded, shot.receiver
        sight = self._cache.of(self._sight, PartOf((shot, light), *of_sight), ground, reach.shaded)
        corner[(*sight.at, SEEN)] = sight.value
        if "CAUSTICS" not in light.of_sun & _wanted(shot.receiver):
            changed = changed_blocks(shot, ground, blocks, corner, reach.ambient)
            blocks = changed | (blocks & (lamplit | (sight.edge != NO_EDGE)))
        rectangles = rectangles_of_cells(blocks, (BLOCK, BLOCK), shot.view)
        set_plate_light(shot, ground, blocks, corner)
        if not rectangles:
            return None
        j, i = np.nonzero(blocks)
        edge, lamplit = sight.edge[j, i], lamplit[j, i]
        if shot.receiver.plane_y is None:
            edge = np.where(edge == SOFT, SHARP, edge)  # other shapes are given at pixels only
        rough = ground.rough[j, i] | lamplit
        wavy = ~sight.umbra[j, i] & ("CAUSTICS" in light.of_sun & _wanted(shot.receiver))
        shadowed = ~rough & (edge != NO_EDGE) & ~wavy
        changes = Changes(
            reach, light, j, i, rectangles, of_sight, edge, sight.halo[j, i], rough, lamplit, wavy, shadowed
        )
        if shot.receiver.plane_y is None or not np.any(shadowed):
            return changes
        of_shadowed = ground, (j[shadowed], i[shadowed]), changes.halo[shadowed]
        few = self._cache.of(self._few, PartOf((shot, light), *of_sight), *of_shadowed)
        return replace(changes, few=few)

    def lay(self, shot: Shot, light: BlockLight | None, tiles: Sequence[Tile]) -> None:
        """Write ratio and veil of the blocks with light on them into the tiles."""
        if light is not None:
            lay_receiver(light, tiles, shot.view.width, shot.view.height, shot.pattern)

    def _sight(self, of_sight: PartOf[_Lit], ground: Ground, shaded: NDArray[np.bool_]) -> SunSight:
        return sun_sight(self._shader, *of_sight.whole, ground, shaded)

    def _few(
        self, of_sight: PartOf[_Lit], ground: Ground, blocks: tuple[Indices, Indices], halo: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """Return the sun's visible fraction (n, B / 2, B / 2, 1) at every second pixel of blocks."""
        drawn = self._shader.pixels(*of_sight.whole, ground, *blocks, halo, frozenset({"SHADOW"}), BLOCK // 2)
        return drawn[0][..., -1:]

    # --- light on blocks ---------------------------------------------------------------------------------------------

    def light(self, shot: Shot, changes: Changes | None, gaps: Gaps) -> BlockLight | None:
        """Return the light on the blocks that change. gaps: of pixels that bodies cover partly."""
        if changes is None:
            return None
        assert shot.receiver is not None
        j, i, edge, reach = changes.rows, changes.columns, changes.edge, changes.reach
        of_sun = changes.light.of_sun & _wanted(shot.receiver)
        even, has_edge = ~changes.rough, edge != NO_EDGE
        # kinds of blocks: mask, features to compute, samples along a block
        kinds = (
            (changes.shadowed & (edge == SOFT), {"SHADOW"}, BLOCK // 2),
            (changes.shadowed & (edge == SHARP), {"SHADOW"}, BLOCK),
            (even & has_edge & changes.wavy, {"SHADOW", "CAUSTICS"}, BLOCK),
            (even & ~has_edge & changes.wavy, {"CAUSTICS"}, BLOCK),
            (changes.rough & ~changes.lamplit, {"ROUGH", "SHADOW", "CAUSTICS"}, BLOCK),
            (changes.lamplit, {"ROUGH", "SHADOW", "CAUSTICS", "LAMPS"}, BLOCK),
        )
        drawn = [
            (which, frozenset(asked) & {"ROUGH", "LAMPS", *of_sun}, side) for which, asked, side in kinds if which.any()
        ]
        images = [self._of_kind(shot, changes, gaps, *kind) for kind in drawn]
        seen: Gathered = []
        waves: Gathered = []
        shape: Gathered = []
        added: Gathered = []
        for (which, wanted, _), (falls, *own) in zip(drawn, images, strict=True):
            if "SHADOW" in wanted:
                seen.append((which, falls[..., -1:]))
            if "CAUSTICS" in wanted:
                waves.append((which, falls[..., :3]))
            if own:
                shape.append((which, np.concatenate([own[0], own[1][..., :3]], axis=-1)))
            if "LAMPS" in wanted:
                added.append((which, own[2][..., :3]))
        free = free_images(shot, reach.ground, reach.corner, j, i, reach.ambient, gaps)
        own_pixels = (gather_images(len(j), k, of) for k, of in ((1, seen), (3, waves), (7, shape), (3, added)))
        return BlockLight(j, i, reach.corner, free, *own_pixels)

    def _of_kind(
        self,
        shot: Shot,
        changes: Changes,
        gaps: Gaps,
        which: NDArray[np.bool_],
        wanted: frozenset[str],
        side: int,
    ) -> list[NDArray[np.float32]]:
        """Return the images of some of the blocks, `which` (n,), as `GroundShader.pixels` does."""
        blocks, halo = (changes.rows[which], changes.columns[which]), changes.halo[which]
        if wanted != {"SHADOW"}:
            return self._pixels((shot, changes.light), changes.reach.ground, gaps, blocks, halo, wanted, side)
        few = None if changes.few is None else changes.few[which[changes.shadowed]]
        of_sight = PartOf((shot, changes.light), changes.of_sight)
        of_blocks = changes.reach.ground, gaps, blocks, halo, side, PartOf(few)
        return [self._cache.of(self._shadow, of_sight, *of_blocks, keep=2)]

    def _shadow(
        self,
        alike: PartOf[_Lit],
        ground: Ground,
        gaps: Gaps,
        blocks: tuple[Indices, Indices],
        halo: NDArray[np.float32],
        side: int,
        few_of: PartOf[NDArray[np.float32] | None],
    ) -> NDArray[np.float32]:
        """Return the sun's visible fraction (n, B, B, 1) on blocks: straight lines between every second pixel.

        side: samples along a block; with `BLOCK` of them, blocks that the lines miss are drawn at every pixel. few_of:
        those at every second pixel, which follow from the rest; None where the receiver is no level plane, which is
        drawn at every pixel.
        """
        wanted, few = frozenset({"SHADOW"}), few_of.whole
        if few is None:
            return self._pixels(alike.whole, ground, gaps, blocks, halo, wanted, BLOCK)[0][..., -1:]
        seen = np.clip(enlarged(few), 0.0, 1.0)
        if side == BLOCK:
            (j, i), sharp = blocks, missed_between(few) > SMOOTH
            sharp[ground.gaps_in(gaps, j, i)[1]] = True
            if np.any(sharp):
                rest = (j[sharp], i[sharp]), halo[sharp]
                drawn = self._pixels(alike.whole, ground, gaps, *rest, wanted, BLOCK)
                seen[sharp] = drawn[0][..., -1:]
        return seen

    def _pixels(
        self,
        lit: _Lit,
        ground: Ground,
        gaps: Gaps,
        blocks: tuple[Indices, Indices],
        halo: NDArray[np.float32],
        wanted: frozenset[str],
        side: int,
    ) -> list[NDArray[np.float32]]:
        """Return `GroundShader.pixels`, with the light in the gaps of pixels where those are drawn one by one."""
        j, i = blocks
        images = self._shader.pixels(*lit, ground, j, i, halo, wanted, side)
        some, block = ground.gaps_in(gaps, j, i)
        if len(block) and side == BLOCK:
            of_gaps = self._shader.at_gaps(*lit, ground, some, wanted)
            for image, value in zip(images, of_gaps, strict=True):
                image[block, some.row % BLOCK, some.column % BLOCK] = value
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


_BLOCKS_ACROSS = 32
_PLACES_ACROSS = 256


class GroundShader:
    """Runs coarse.frag and receiver.frag with the light of a shot."""

    def __init__(self, targets: Targets) -> None:
        self._targets = targets

    def sun_at(self, light: ShotLight, places: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the outputs (n, 4) of coarse.frag for balls (n, 4), position and radius [m]."""
        rows = -(-len(places) // _PLACES_ACROSS)
        listed = np.zeros((rows * _PLACES_ACROSS, 4), np.float32)
        listed[: len(places)] = places
        defines = frozenset(light.defines) & {"SUN", "SHADOW", "MEDIUM", "HALO", "TRANSLUCENT"}
        shader = self._targets.program("coarse", dict.fromkeys(defines, 1))
        bind(shader, {"places": texture_from_array(listed.reshape(rows, -1, 4)), **light.textures})
        light.set(shader)
        (sun,) = self._targets.draw(shader, "coarse", _PLACES_ACROSS, rows, (4,))
        return sun.reshape(-1, 4)[: len(places)]

    def pixels(
        self,
        shot: Shot,
        light: ShotLight,
        ground: Ground,
        j: Indices,
        i: Indices,
        halo: NDArray[np.float32],
        wanted: frozenset[str],
        side: int,
    ) -> list[NDArray[np.float32]]:
        """Return the outputs of receiver.frag for blocks, images (n, side, side, k).

        halo: (n, 4) visible fraction of the halo at the corners of each block, negative where block corners do not
        represent the pixels inside. wanted: features to compute, of SHADOW, CAUSTICS, ROUGH (all light, for rough
        blocks) and, with ROUGH, LAMPS. side: samples along a block.
        """
        shape = None if _on_plane(shot, wanted) else ground.pixels(shot, j, i)
        area = np.tile(WHOLE_PIXEL[2:], (len(j), 1))
        of_blocks = {"blocks": float(BLOCK) * np.stack([i, j], axis=-1), "areas": area, "halos": halo}
        return self._samples(shot, light, of_blocks, shape, wanted, side, BLOCK // side)

    def at_gaps(
        self, shot: Shot, light: ShotLight, ground: Ground, gaps: Gaps, wanted: frozenset[str]
    ) -> list[NDArray[np.float32]]:
        """Return the outputs (n, k) of receiver.frag in gaps, with shadows averaged over their areas."""
        shape = None
        if not _on_plane(shot, wanted):
            point, normal = ground.meet(shot, *gaps.place.T)
            shape = np.append(normal, np.linalg.norm(point, axis=-1)[:, None], axis=1)[:, None, None]
        halo = np.full((len(gaps.place), 4), -1.0)
        of_gaps = {"blocks": gaps.place - 0.5, "areas": gaps.area[:, 2:], "halos": halo}
        images = self._samples(shot, light, of_gaps, shape, wanted, 1, 1)
        return [image[:, 0, 0] for image in images]

    def _samples(
        self,
        shot: Shot,
        light: ShotLight,
        of_blocks: dict[str, Floats],
        shape: Floats | None,
        wanted: frozenset[str],
        side: int,
        spacing: int,
    ) -> list[NDArray[np.float32]]:
        """Return images (n, side, side, k) of blocks of samples `spacing` pixels apart.

        of_blocks: their corners (n, 2) in frame coordinates, the matrix (n, 3) of the area of the frame that each
        sample represents (`sampling.frame_areas`), and the halo (n, 4). shape: (n, side, side, 4) normal and distance;
        None for a plane.
        """
        assert shot.receiver is not None
        count = len(of_blocks["blocks"])
        rows = -(-count // _BLOCKS_ACROSS)
        width, height = _BLOCKS_ACROSS * side, rows * side
        atlases = {name: _atlas(values[:, None, None], rows) for name, values in of_blocks.items()}
        if shape is not None:
            atlases["shape"] = _atlas(shape, rows)
        textures = {name: texture_from_array(atlas) for name, atlas in atlases.items()}
        textures |= light.textures
        defines = (wanted - {"LAMPS"}) | (frozenset(light.defines) & {"SUN", "MEDIUM", "HALO", "SOFT", "TRANSLUCENT"})
        defines |= {"PLANE"} if shape is None else set()
        numbers = {"LAMPS": light.defines["LAMPS"]} if "LAMPS" in wanted else {}
        shader = self._targets.program("receiver", {**dict.fromkeys(defines, 1), **numbers, **of_eye(shot)})
        bind(shader, textures)
        light.set(shader)
        extent = shot.receiver.extent_m
        set_uniforms(
            shader,
            world_from_camera=shot.view.world_from_camera.T,
            frame_size=(shot.view.width, shot.view.height),
            eye_m=shot.view.eye_m,
            side=side,
            spacing=float(spacing),
            plane_height=(shot.receiver.plane_y or 0.0) - float(shot.view.position[1]),
            fade=(FADE_FROM * extent, extent),
        )
        if "ROUGH" in wanted:
            channels: tuple[int, ...] = (4,) * (4 if "LAMPS" in wanted else 3)
        else:
            channels = (4,) if "CAUSTICS" in wanted else (1,)
        images = []
        for atlas in self._targets.draw(shader, "receiver", width, height, channels):
            apart = atlas.reshape(-1, side, _BLOCKS_ACROSS, side, atlas.shape[-1]).transpose(0, 2, 1, 3, 4)
            images.append(np.ascontiguousarray(apart).reshape(-1, side, side, atlas.shape[-1])[:count])
        return images


def _on_plane(shot: Shot, wanted: frozenset[str]) -> bool:
    """Return whether receiver.frag intersects rays with the receiver itself: a plane without rough blocks."""
    return shot.receiver is not None and shot.receiver.plane_y is not None and "ROUGH" not in wanted


def _atlas(images: NDArray[np.float32], rows: int) -> NDArray[np.float32]:
    """Return images (n, side, side, k) next to each other, `_BLOCKS_ACROSS` in a row."""
    side, channels = images.shape[2:]
    whole = np.zeros((rows * _BLOCKS_ACROSS, side, side, channels), np.float32)
    whole[: len(images)] = images
    apart = whole.reshape(rows, _BLOCKS_ACROSS, side, side, channels).transpose(0, 2, 1, 3, 4)
    return apart.reshape(rows * side, _BLOCKS_ACROSS * side, channels)


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


def sun_sight(
    shader: GroundShader, shot: Shot, light: ShotLight, ground: Ground, shaded: NDArray[np.bool_]
) -> SunSight:
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
    visible = shader.sun_at(light, places)
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
