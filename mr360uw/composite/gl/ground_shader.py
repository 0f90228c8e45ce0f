# SPDX-License-Identifier: Apache-2.0
"""Light on the receiver computed on the device: at listed points, and in the pixels of listed blocks.

Found from these: what blocks of the receiver see of the sun, and which of them a shadow's edge crosses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.gl.facet_pass import of_eye
from mr360uw.composite.gl.light_textures import ShotLight
from mr360uw.composite.gl.targets import Targets, bind
from mr360uw.composite.lighting.sun import scattered_share, sun_of, widest_half_angle
from mr360uw.composite.receiver.block_light import SMOOTH
from mr360uw.composite.receiver.ground import BLOCK, Ground, Indices
from mr360uw.composite.receiver.ratio import FADE_FROM
from mr360uw.composite.sampling import WHOLE_PIXEL, Gaps
from mr360uw.composite.shot import Shot
from mr360uw.gl.context import set_uniforms, texture_from_array
from mr360uw.types import Floats

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
