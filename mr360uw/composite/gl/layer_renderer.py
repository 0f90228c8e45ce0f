# SPDX-License-Identifier: Apache-2.0
"""The gl renderer: the layer of a frame on OpenGL 3.3, with the samples, groups and light of the reference renderer,
and its pass over the ground.

Only pixels that objects and their shadows may change are drawn and read back. The cache keeps meshes, the columns of
shadows, the samples of objects at rest and the geometry of the receiver from frame to frame.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.cache import Cache, PartOf, Same
from mr360uw.base.progress import one_blas_thread
from mr360uw.base.tile_blend import BLOCK, BlockGround
from mr360uw.composite.aovs import AovFrame, Aovs
from mr360uw.composite.gl.device import ShadingInputs, ShadingTextures, Targets, list_texture
from mr360uw.composite.gl.light_visibility import DISC, HALO, footprints_of
from mr360uw.composite.gl.object_pass import ObjectPass
from mr360uw.composite.light_sources import (
    ground_slopes,
    scattered_share,
    steepest_slope,
    sun_of,
    widest_half_angle,
)
from mr360uw.composite.receiver.blocks import (
    SMOOTH,
    Blocks,
    Ground,
    GroundReach,
    Indices,
    Prepared,
    changed_blocks,
    enlarged,
    free_images,
    missed_between,
    prepare,
    rectangles_of_blocks,
    set_plate_light,
)
from mr360uw.composite.receiver.ratio import (
    FADE_FROM,
    SEEN,
    Gathered,
    four_corners,
    gather_images,
    ground_of,
)
from mr360uw.composite.sampling import NO_GAPS, WHOLE_PIXEL, Gaps
from mr360uw.composite.shot import Shot
from mr360uw.composite.tiles import empty_tile, even_tiles, hold_out, object_rectangles, places_in_mask
from mr360uw.gl import gl_context
from mr360uw.types import Floats, Layer


class LayerRenderer:
    """Draws the layers of shots. cache: values kept between shots. One renderer for each OpenGL thread."""

    def __init__(self, cache: Cache | None = None) -> None:
        self._cache = Cache() if cache is None else cache
        self._light, targets = ShadingTextures(self._cache), Targets()
        self._objects, self._receiver = ObjectPass(targets, self._cache), ReceiverPass(targets, self._cache)

    def render(self, shot: Shot) -> Layer:
        """Return the layer of a shot, as `reference.render_layer` does."""
        return self.layer(shot)[0].laid()

    def layer(
        self, shot: Shot, prepared: Prepared | None = None, *, variables: bool = False
    ) -> tuple[Layer, Aovs | None]:
        """Return the layer of a shot, and its output variables if asked for. prepared: what was found before of it."""
        view, frame = shot.view, AovFrame(shot) if variables else None
        with one_blas_thread():
            prepared = prepare(shot, self._cache) if prepared is None else prepared
            object_parts = self._cache.of(object_rectangles, view, shot.objects)
            drawn, ground = [], None
            if object_parts or prepared.reach is not None:
                gl_context().gc()  # releases what nothing refers to any more
                # Find what of the bodies is seen, then the light on the ground around them
                light = self._light.of(shot)
                surfaces = self._objects.find(shot) if object_parts else None
                gaps = surfaces.layers[-1].gaps if surfaces is not None and surfaces.layers else NO_GAPS
                blocks, ground = self._receiver.light(shot, light, prepared.reach, gaps)
                # Lay both into as few tiles as hold them
                parts = object_parts + ([] if blocks is None else rectangles_of_blocks(blocks, view))
                tiles = even_tiles(parts, view.width, view.height)
                drawn = [empty_tile(part, bare=ground is not None) for part in tiles]
                if surfaces is not None:
                    self._objects.draw((shot, light, surfaces), drawn, frame, prepared.ambient)
            layer = Layer(view.height, view.width, tuple(drawn), ground)
            if drawn and shot.has_mattes:
                layer = Layer(view.height, view.width, tuple(hold_out(shot, tile) for tile in layer.laid().tiles))
        if frame is None:
            return layer, None
        layer = layer.laid()  # once for all that reads the variables
        return layer, frame.finish(shot, layer)


# --- The pass over the ground ---------------------------------------------------------------------------------------

# The receiver on OpenGL 3.3: ratio and veil of the plate's ground.
#
# Light that varies slowly is evaluated at the corners of blocks of pixels (receiver/blocks.py) and interpolated. What
# is seen of the sun is found at the corners and the middle of each block that a shadow may fall on; where those do not
# represent the pixels inside, at every second pixel, and where these do not, at the pixels themselves. Blocks with
# caustics or an uneven shape are drawn pixel by pixel; only those are read back.


_Lit = tuple[Shot, ShadingInputs]

_NO_EDGE, _SOFT, _SHARP = 0, 1, 2
"""Kinds of shadow edges in a block: none, one for samples at every second pixel, one for pixels where these differ."""
_PART_OF_DISC, _WHOLE_DISC = 2.0, 3.0
"""Numbers of `Visibility.hidden`: bodies may hide part of the sun's disc, or hide all of it."""
_WIDE = 1.5
"""Width of a penumbra, in radii of a block, above which corners and middle represent it. Half as large, narrow
penumbrae are missed; twice as large, more blocks are drawn pixel by pixel."""
_HALVED = 12.0
"""Interpolation error at a block's middle, over `SMOOTH`, up to which samples at every second pixel are enough. The
error grows with the square of the spacing, so they allow 16; the margin is for penumbrae of uneven curvature."""
_SHADOW = frozenset({"SHADOW"})


@dataclass(frozen=True, slots=True, eq=False)
class SunSight:
    """What the ground sees of the sun.

    at: rows and columns (n,) of corners of blocks; value: (n,) visible fraction of the sun there. edge: (R, C) whether
    shadows have an edge inside a block that interpolation does not represent. umbra: (R, C) whether it lies in the
    umbra. halo: (R, C, 4) visible fraction of the halo at its corners, negative where they do not represent the pixels
    inside. pixels: (m, B, B, 1) visible fraction of the sun at the pixels of the blocks with an edge that show nothing
    else, in order; none of other shapes than level ground, which are given at pixels.
    """

    at: tuple[Indices, Indices]
    value: NDArray[np.float32]
    edge: Blocks
    umbra: Blocks
    halo: NDArray[np.float32]
    pixels: NDArray[np.float32] | None


class ReceiverPass:
    """Finds the light on the receivers of shots. cache: keeps what is seen of the sun while nothing moves."""

    def __init__(self, targets: Targets, cache: Cache) -> None:
        self._targets, self._cache = targets, cache

    def light(
        self, shot: Shot, light: ShadingInputs, reach: GroundReach | None, gaps: Gaps
    ) -> tuple[Blocks, BlockGround] | tuple[None, None]:
        """Return the blocks that change and the light on them; None where none do. gaps: of pixels that bodies cover
        partly.
        """
        if reach is None or shot.receiver is None:
            return None, None
        # Find what is seen of the sun, which does not depend on its light; what was prepared serves other frames too
        reach = replace(reach, corner=reach.corner.copy())
        ground = reach.ground
        shown = {"SHADOW"} if shot.receiver.shadow else set()
        shown |= {"CAUSTICS"} if shot.receiver.caustics else set()
        of_sun = light.defines.keys() & shown
        shaded = reach.shaded & ("SHADOW" in light.defines)
        through = None if shot.medium is None else Same(shot.medium.unscattered)
        of_blocks = PartOf(reach, Same(ground), shaded, reach.lamplit)
        turned = () if shot.caustics is None else shot.caustics.slopes
        alike = PartOf((shot, light), light.visibility.of_sun, through, turned, shot.receiver)
        sight = self._cache.of(self._sight, alike, of_blocks, shaded, "CAUSTICS" in of_sun, gaps, keep=2)
        reach.corner[(*sight.at, SEEN)] = sight.value
        # Leave out the blocks that do not change by the light at their corners
        blocks = reach.blocks
        if "CAUSTICS" not in of_sun:
            blocks = changed_blocks(shot, reach, blocks) | (blocks & (reach.lamplit | sight.edge))
        set_plate_light(shot, reach, blocks)
        j, i = places_in_mask(blocks)
        if len(j) == 0:
            return None, None
        # Take the sun at pixels on edges of level ground; draw all else pixel by pixel, with the features that it needs
        edge, lamplit = sight.edge[j, i], reach.lamplit[j, i]
        rough = ground.rough[j, i] | lamplit
        wavy = ~rough & ~sight.umbra[j, i] & ("CAUSTICS" in of_sun)
        even = ~rough & ~wavy & edge
        parts = defaultdict[str, Gathered](list)
        if sight.pixels is not None:
            parts["seen"].append((even, sight.pixels))
        kinds = (
            (even & (sight.pixels is None), {"SHADOW"}),
            (wavy & edge, {"SHADOW", "CAUSTICS"}),
            (wavy & ~edge, {"CAUSTICS"}),
            (rough & ~lamplit, {"ROUGH", "SHADOW", "CAUSTICS"}),
            (lamplit, {"ROUGH", "SHADOW", "CAUSTICS", "LAMPS"}),
        )
        for which, asked in kinds:
            if np.any(which):
                wanted = frozenset(asked) & {"ROUGH", "LAMPS", *of_sun}
                at = j[which], i[which]
                drawn = self._pixels((shot, light), ground, gaps, *at, sight.halo[at], wanted)
                for name, image in drawn.items():
                    parts[name].append((which, image))
        free, count = free_images(shot, reach, j, i, gaps), len(j)
        seen, waves = gather_images(count, 1, parts["seen"]), gather_images(count, 3, parts["waves"])
        shape, added = gather_images(count, 7, parts["shape"]), gather_images(count, 3, parts["added"])
        return blocks, ground_of(shot, blocks, reach.corner, (free, seen, waves, shape, added))

    def _sight(
        self, alike: PartOf[_Lit], of_blocks: PartOf[GroundReach], shaded: Blocks, waves: bool, gaps: Gaps
    ) -> SunSight:
        """Return what the shaded blocks (R, C) of the ground see of a shot's sun. waves: whether caustics show."""
        (shot, light), ground, sun = alike.whole, of_blocks.whole.ground, sun_of(alike.whole[0])
        edge, umbra = np.zeros((2, *shaded.shape), np.bool_)
        halo = np.full((*shaded.shape, 4), -1.0, np.float32)
        if not np.any(shaded) or sun is None:
            return SunSight((np.zeros(0, np.int64),) * 2, np.zeros(0, np.float32), edge, umbra, halo, None)
        # Look at the sun from corners and middles; on level ground the beam is everywhere the same
        assert shot.receiver is not None
        level, plane_m = shot.receiver.plane_y is not None, _plane_m(shot)
        (cj, ci), (mj, mi) = places_in_mask(ground.corners_of(shaded)), places_in_mask(shaded)
        still = PartOf((shot, light), light.visibility.of_sun)
        footprints, halo_seen, kept, gap = self._cache.of(_unturned, still, of_blocks, shaded, steepest_slope(shot))
        slopes = ground_slopes(shot, footprints[:, :3])
        visible = light.visibility.seen(footprints, (DISC,), slopes=slopes)[:, 0]
        scattered = scattered_share(shot, np.array([[0.0, plane_m, 0.0]]) if level else footprints[:, :3])
        visible += scattered * (halo_seen - visible)
        at_corners = np.zeros((2, shaded.shape[0] + 1, shaded.shape[1] + 1), np.float32)
        at_corners[:, cj, ci] = visible[: len(cj)], halo_seen[: len(cj)]
        seen, reach = visible[len(cj) :], ground.reach_m[mj, mi]
        # Penumbrae that are narrow, or not straight between corners and middle, are edges
        of_disc, of_halo = 2.0 * np.tan(sun.half_angle_rad) * gap, 2.0 * np.tan(widest_half_angle(shot)) * gap
        bent = np.zeros(len(mj), np.bool_)
        if shot.caustics is not None and len(slopes):
            # Waves widen them, and bend them from one pixel of their map to the next but one
            of_disc = np.hypot(of_disc, 2.0 * slopes[len(cj) :, 2] * gap)
            bent = kept == _PART_OF_DISC
            bent &= reach > 2.0 * shot.caustics.tile_m / shot.caustics.slopes[0].shape[1]
        sun_four, halo_four = four_corners(at_corners[0], mj, mi), four_corners(at_corners[1], mj, mi)
        missed = np.abs(seen - sun_four.mean(axis=1))
        narrow = np.where(kept == _PART_OF_DISC, of_disc, of_halo) < _WIDE * reach
        sharp = narrow | (missed > _HALVED * SMOOTH) | bent
        found = (sharp | (missed > SMOOTH)) & (kept > 0.0) & (kept < _WHOLE_DISC)
        umbra[mj, mi], edge[mj, mi] = kept == _WHOLE_DISC, found
        missed = np.abs(halo_seen[len(cj) :] - halo_four.mean(axis=1)) * scattered[-len(mj) :]
        interpolable = (of_halo >= _WIDE * reach) & (missed <= SMOOTH)
        halo[mj, mi] = np.where(interpolable[:, None], halo_four, -1.0)
        # On level ground, refine those that show nothing else
        pixels, own = None, found & ~ground.rough[mj, mi] & ~of_blocks.whole.lamplit[mj, mi]
        if level and not waves and np.any(own):
            pixels = self._refined((shot, light), ground, gaps, mj[own], mi[own], halo[mj, mi][own], sharp[own])
        return SunSight((cj, ci), visible[: len(cj)].astype(np.float32), edge, umbra, halo, pixels)

    def _refined(
        self, lit: _Lit, ground: Ground, gaps: Gaps, j: Indices, i: Indices, halo: Floats, sharp: NDArray[np.bool_]
    ) -> NDArray[np.float32]:
        """Return the sun's visible fraction (n, B, B, 1) at the pixels of blocks of level ground: straight lines
        between every second pixel, and the pixels themselves of `sharp` blocks (n,) that these miss, or with gaps.
        """
        origin = float(BLOCK) * np.stack([i, j], axis=-1)
        few = self._samples(lit, origin, halo, _SHADOW, (BLOCK // 2, 2))["seen"]
        seen = np.clip(enlarged(few), 0.0, 1.0)
        bent = sharp & (missed_between(few) > SMOOTH)
        bent[ground.gaps_in(gaps, j, i)[1]] = True
        if np.any(bent):
            seen[bent] = self._pixels(lit, ground, gaps, j[bent], i[bent], halo[bent], _SHADOW)["seen"]
        return seen

    def _pixels(
        self, lit: _Lit, ground: Ground, gaps: Gaps, j: Indices, i: Indices, halo: Floats, wanted: frozenset[str]
    ) -> dict[str, NDArray[np.float32]]:
        """Return images (n, B, B, k) of blocks by their names in `light`: at the pixels, or in their gaps.

        wanted: features to compute, of SHADOW, CAUSTICS, ROUGH (all light, for rough blocks) and, with ROUGH, LAMPS.
        """
        # Rays are intersected with a plane itself, where no rough block wants the distance too
        receiver = lit[0].receiver
        assert receiver is not None
        on_plane = receiver.plane_y is not None and "ROUGH" not in wanted
        shape = None if on_plane else ground.pixels(j, i)
        named = self._samples(lit, float(BLOCK) * np.stack([i, j], axis=-1), halo, wanted, (BLOCK, 1), shape)
        # Partly covered pixels are looked at in their gaps, with shadows averaged over their areas
        some, block = ground.gaps_in(gaps, j, i)
        if len(block):
            in_gaps: Floats | None = None
            if not on_plane:
                point, normal = ground.meet(*some.place.T)
                in_gaps = np.append(normal, np.linalg.norm(point, axis=-1)[:, None], axis=1)[:, None, None]
            unknown = np.full((len(block), 4), -1.0)
            found = self._samples(lit, some.place - 0.5, unknown, wanted, (1, 1), in_gaps, some.area)
            for name, image in found.items():
                named[name][block, some.row % BLOCK, some.column % BLOCK] = image[:, 0, 0]
        return named

    def _samples(
        self, lit: _Lit, origin: Floats, halo: Floats, wanted: frozenset[str], grid: tuple[int, int],
        shape: Floats | None = None, area: Floats | None = None,
    ) -> dict[str, NDArray[np.float32]]:  # fmt: skip
        """Return images (n, side, side, k) of samples of blocks, by their names in `light`.

        grid: side, and pixels from one sample to the next. origin: (n, 2) frame coordinates of the blocks' corners.
        halo: (n, 4) visible fraction of the halo there, negative where it is found for each sample. shape: (n, side,
        side, 4) normal and distance; None for a plane. area: (n, 5) of the frame that samples represent; None for
        pixels.
        """
        (shot, light), side = lit, grid[0]
        named: dict[str, NDArray[np.float32]] = {}
        footprints: Floats = np.zeros((0, 12))
        if wanted & {"SHADOW", "LAMPS"}:
            of_frame = np.array(WHOLE_PIXEL) if area is None else area
            footprints = footprints_of(shot.view, origin, of_frame, grid, _plane_m(shot) if shape is None else shape)
        if "SHADOW" in wanted:
            known = np.full((len(footprints), 2), -1.0)
            # Of the halo, straight lines between its corners; what is negative at these stays negative
            place, (top, below) = (np.arange(side) + 0.5) / side, np.moveaxis(halo.reshape(-1, 2, 1, 2), 1, 0)
            sides = top + place[:, None] * (below - top)
            known[:, 1] = (sides[..., :1] + place * (sides[..., 1:] - sides[..., :1])).ravel()
            slopes = ground_slopes(shot, footprints[:, :3], footprints[:, 3:9].reshape(-1, 2, 3))
            disc, of_halo = light.visibility.seen(footprints, (DISC, HALO), known=known, slopes=slopes).T
            scattered = scattered_share(shot, footprints[: 1 if shape is None else None, :3])
            named["seen"] = (disc + scattered * (of_halo - disc)).astype(np.float32).reshape(-1, side, side, 1)
        if wanted & {"CAUSTICS", "ROUGH"}:
            named |= self._draw(lit, origin, wanted, side, shape, footprints)
        return named

    def _draw(
        self, lit: _Lit, origin: Floats, wanted: frozenset[str], side: int, shape: Floats | None, footprints: Floats
    ) -> dict[str, NDArray[np.float32]]:
        """Return the images of `_samples` that receiver.frag draws. footprints: of all."""
        # Compile what is wanted, and no more
        (shot, light), count = lit, len(origin) * side * side
        assert shot.receiver is not None
        textures = {"blocks": list_texture(origin, channels=2)}
        textures |= {} if shape is None else {"shape": list_texture(shape)}
        features = (wanted - {"LAMPS", "SHADOW"}) | (light.defines.keys() & {"SUN", "MEDIUM", "HALO", "SOFT", "EYE"})
        defines = dict.fromkeys(features | ({"PLANE"} if shape is None else set()), 1)
        if "LAMPS" in wanted:
            lamps = light.visibility.lamps
            defines["LAMPS"] = len(lamps)
            textures["lamps_seen"] = list_texture(light.visibility.seen(footprints, lamps), channels=1)
        # Give it the receiver, draw, and name the outputs
        extent, outputs = shot.receiver.extent_m, (1 if "ROUGH" not in wanted else 4 if "LAMPS" in wanted else 3) * (4,)
        uniforms = light.uniforms | {
            "side_bits": side.bit_length() - 1, "plane_height": _plane_m(shot), "fade": (FADE_FROM * extent, extent),
        }  # fmt: skip
        values = self._targets.shaded("receiver", defines, textures | light.textures, uniforms, count, outputs)
        values = values.reshape(-1, side, side, sum(outputs))
        named = {"waves": values[..., :3]} if "CAUSTICS" in wanted else {}
        named |= {"shape": values[..., 4:11]} if "ROUGH" in wanted else {}
        return named | ({"added": values[..., 12:15]} if "LAMPS" in wanted else {})


def _unturned(
    alike: PartOf[_Lit], of_blocks: PartOf[GroundReach], shaded: Blocks, steepest: float
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return what waves do not turn: footprints (n, 12) of the corners and the middles of shaded blocks, the visible
    fraction (n,) of the halo from there, and of `Visibility.hidden` what bodies may hide from the blocks, and how far
    these are.
    """
    visibility, ground = alike.whole[1].visibility, of_blocks.whole.ground
    corner, middle = places_in_mask(ground.corners_of(shaded)), places_in_mask(shaded)
    middles, reach = ground.middle_point[middle], ground.reach_m[middle]
    footprints = np.zeros((len(corner[0]) + len(middles), 12))
    footprints[:, :3] = np.concatenate([ground.corner_point[corner], middles])
    hidden = visibility.hidden(np.append(middles, reach[:, None], axis=1), steepest)
    return footprints, visibility.seen(footprints, (HALO,))[:, 0], *hidden.T


def _plane_m(shot: Shot) -> float:
    """Return the height [m] of a level receiver above the camera; any number for other shapes."""
    assert shot.receiver is not None
    return (shot.receiver.plane_y or 0.0) - float(shot.view.position[1])
