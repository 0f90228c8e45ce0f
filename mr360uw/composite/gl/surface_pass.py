# SPDX-License-Identifier: Apache-2.0
"""Visible surfaces of pixels on OpenGL 3.3.

Triangles are listed by blocks of pixels (triangles.py), and rays are intersected with the triangles of their block
(visible.frag). If eight classification rays hit one smooth piece and no other triangle reaches into the pixel, it is
interior and becomes one fragment. Other pixels get all rays of the pattern, grouped as in raycast/pixel_samples.py.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import Cache, PartOf
from mr360uw.composite.gl.fragments import NOTHING, Fragments, joined_fragments
from mr360uw.composite.gl.targets import BLOCK, Targets, bind
from mr360uw.composite.gl.triangles import (
    FACET_COLUMNS,
    Blocks,
    FacetPass,
    make_blocks,
    of_eye,
)
from mr360uw.composite.gl.upload import MeshBuffers, list_texture, write_uniform
from mr360uw.composite.mesh.mesh import Mesh
from mr360uw.composite.sampling import (
    BLEND_LAYERS,
    GROUPS,
    PIXEL_FILTER,
    PLANE_TOLERANCE,
    WHOLE_PIXEL,
    Pattern,
    find_gaps,
    frame_areas,
    nearest_to_mean,
    pattern,
    read_groups,
)
from mr360uw.composite.shot import PlacedObject, Shot
from mr360uw.gl.context import set_uniforms
from mr360uw.types import Floats

_PROBES = np.array(
    [(0.5, 0.5), (0.5, 0.17), (0.79, 0.67), (0.21, 0.67), (0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)]
)
"""Classification rays: eight per pixel, the centre, three around it and the corners. If all hit the same smooth
surface, the pixel is interior and is shaded from one sample."""
_BLOCKS_AT_ONCE = 8192
"""Blocks in one draw call: bounds the size of targets."""
_WORD_BITS = 24
"""Bits of a word: as many as single floats hold exactly, six fours; three words hold the most rays of a pixel."""
_SAMPLES_AT_ONCE = 32
"""Rays of a pixel in one draw call where every sample is kept: eight targets of four."""


@dataclass(frozen=True, slots=True, eq=False)
class _Draw:
    """Inputs that all rays of a set of blocks share."""

    shot: Shot
    textures: Mapping[str, Any]
    defines: Mapping[str, int]
    layer: int


class SurfacePass:
    """Finds the visible surfaces of shots. buffers: returns the device's copy of a mesh."""

    def __init__(self, targets: Targets, buffers: Callable[[Mesh], MeshBuffers], cache: Cache) -> None:
        self._targets = targets
        self._facets = FacetPass(targets, buffers, cache)

    def find(self, sampled: PartOf[Shot], objects: Sequence[PlacedObject]) -> tuple[list[Fragments], NDArray[np.int64]]:
        """Return the layers of fragments, nearest first, opaque ones last; and each object's first triangle."""
        shot = sampled.whole
        facets = self._facets.draw(shot, objects)
        blocks = make_blocks(facets.rectangles, facets.numbers, facets.kinds, shot.view.width)
        textures = facets.textures | {"members": list_texture(blocks.members, 1), "masks": list_texture(blocks.masks)}
        defines = of_eye(shot) | ({"CUTOUTS": 1} if "cutouts" in textures else {})
        blended = blocks.some(blocks.bounds[:, 2] < blocks.bounds[:, 3])
        opaque = blocks.some(blocks.bounds[:, 0] < blocks.bounds[:, 2])
        layers = self._blended(shot, blended, textures, defines | {"BLENDED": 1})
        return [*layers, self._layer(shot, opaque, textures, defines)], facets.first

    def _blended(
        self, shot: Shot, blocks: Blocks, textures: Mapping[str, Any], defines: Mapping[str, int]
    ) -> list[Fragments]:
        """Return the layers of blended fragments in blocks, nearest first."""
        layers: list[Fragments] = []
        while len(layers) < BLEND_LAYERS:
            found = self._layer(shot, blocks, textures, defines, len(layers))
            if len(found) == 0:
                break
            layers.append(found)
        return layers

    def _layer(
        self, shot: Shot, blocks: Blocks, textures: Mapping[str, Any], defines: Mapping[str, int], layer: int = 0
    ) -> Fragments:
        """Return the opaque fragments in blocks, or with the define BLENDED a layer of blended ones in front."""
        parts = [NOTHING]
        for start in range(0, len(blocks.corner), _BLOCKS_AT_ONCE):
            chunk = blocks.some(np.s_[start : start + _BLOCKS_AT_ONCE])
            lists = list_texture(np.concatenate([chunk.corner, chunk.bounds[:, :2]], axis=1))
            more = list_texture(chunk.bounds[:, 2:], 2)
            draw = _Draw(shot, {**textures, "lists": lists, "more_lists": more}, defines, layer)
            parts += self._surfaces(draw, chunk)
        return joined_fragments(parts)

    def _surfaces(self, draw: _Draw, blocks: Blocks) -> list[Fragments]:
        """Return the fragments of the pixels of blocks, in disjoint sets."""
        shot = draw.shot
        samples = pattern(shot.draw.samples)
        row, column = blocks.pixels()
        inside = (row < shot.view.height) & (column < shot.view.width)
        if shot.draw.shading == "sample":
            return [self._by_sample(draw, samples, row, column, inside)]
        number, found = np.flatnonzero(inside), []
        if samples.count > len(_PROBES) and "BLENDED" not in draw.defines:
            shown = self._rays(draw, _PROBES, {"WHOLE": 1}, len(row), (1,))[:, 0]
            whole, number = number[shown[number] > 0.0], number[shown[number] < 0.0]
            center = np.stack([column[whole], row[whole]], axis=-1) + 0.5
            triangle = shown[whole].astype(np.int64) - 1
            area, weight = np.tile(WHOLE_PIXEL, (len(whole), 1)), np.ones(len(whole))
            found = [Fragments(row[whole], column[whole], np.arange(len(whole)), triangle, center, area, weight)]
        return [*found, self._grouped(draw, samples, row[number], column[number], number)]

    def _grouped(
        self,
        draw: _Draw,
        samples: Pattern,
        row: NDArray[np.int64],
        column: NDArray[np.int64],
        number: NDArray[np.int64],
    ) -> Fragments:
        """Return the groups of samples of pixels; number: their indices among the pixels of all blocks."""
        per_block = BLOCK * BLOCK
        picked = list_texture(np.stack([number // per_block, number % per_block], axis=-1), 2)
        draw = replace(draw, textures={**draw.textures, "picked": picked})
        words = -(-samples.count // _WORD_BITS)
        channels = (4,) * (GROUPS * (1 + words) // 4)
        defines = {"PICKED": 1, "WORDS": words, "WORD_BITS": _WORD_BITS}
        shown = self._rays(draw, samples.positions, defines, len(row), channels, samples.cells)
        shown = shown.reshape(len(row), GROUPS, 1 + words)
        groups = np.count_nonzero(shown[..., 0])
        there = np.flatnonzero(shown[..., 0].any(axis=1))
        (pixel, triangle), first = np.empty((2, groups), np.int64), np.empty(len(there), np.int64)
        member, covered = (np.empty((n, samples.count), np.bool_) for n in (groups, len(there)))
        weight = np.empty(groups)
        read_groups(shown, _WORD_BITS, pixel, triangle, member, weight, first, covered)
        rank = nearest_to_mean(samples, member)
        place = np.stack([column[pixel], row[pixel]], axis=-1) + samples.positions[rank]
        area = frame_areas(samples, member, rank)
        gaps = find_gaps(samples, row[there], column[there], covered)
        return Fragments(row[there], column[there], first, triangle, place, area, weight, gaps)

    def _by_sample(
        self,
        draw: _Draw,
        samples: Pattern,
        row: NDArray[np.int64],
        column: NDArray[np.int64],
        inside: NDArray[np.bool_],
    ) -> Fragments:
        """Return every sample as a fragment of its own."""
        rays, counts = [], []
        for start in range(0, samples.count, _SAMPLES_AT_ONCE):
            positions = samples.positions[start : start + _SAMPLES_AT_ONCE]
            counts.append(len(positions))
            channels = (4,) * -(-len(positions) // 4)
            rays.append(self._rays(draw, positions, {"BY_SAMPLE": 1}, len(row), channels))
        shown = [of_rays[:, :count] for of_rays, count in zip(rays, counts, strict=True)]
        triangle = np.concatenate(shown, axis=1) * inside[:, None]
        pixel, rank = np.nonzero(triangle)
        there, first = np.unique(pixel, return_index=True)
        place = np.stack([column[pixel], row[pixel]], axis=-1) + samples.positions[rank]
        one = np.array(WHOLE_PIXEL) * samples.count**-0.5
        area, weight = np.tile(one, (len(pixel), 1)), np.full(len(pixel), 1.0 / samples.count)
        gaps = find_gaps(samples, row[there], column[there], triangle[there] > 0.0)
        numbers = triangle[pixel, rank].astype(np.int64) - 1
        return Fragments(row[there], column[there], first, numbers, place, area, weight, gaps)

    def _rays(
        self,
        draw: _Draw,
        positions: Floats,
        defines: Mapping[str, int],
        count: int,
        channels: tuple[int, ...],
        cells: NDArray[np.int64] | None = None,
    ) -> Floats:
        """Return the outputs (count, channels) of visible.frag for `count` pixels with rays at positions (r, 2)."""
        if count == 0:
            return np.zeros((0, sum(channels)), np.float32)
        shot, fours = draw.shot, -(-len(positions) // 4)
        every: dict[str, str | int | float] = {
            "FOURS": fours, "EACH_FOUR(DO)": " ".join(f"DO({k})" for k in range(fours)), "GROUPS": GROUPS,
            "LAST": f"vec4({', '.join('1.0' if 4 * fours - 4 + k < len(positions) else '0.0' for k in range(4))})",
            "FACET_COLUMNS": FACET_COLUMNS, "PLANE_TOLERANCE": PLANE_TOLERANCE, "PIXEL_FILTER": PIXEL_FILTER,
        }  # fmt: skip
        shader = self._targets.program("visible", {**every, **draw.defines, **defines})
        bind(shader, draw.textures)
        size = (shot.view.width, shot.view.height)
        set_uniforms(shader, frame_size=size, layer=draw.layer, eye_m=shot.view.eye_m, ray_count=4 * fours)
        filled = np.concatenate([positions, positions[-1:].repeat(4 * fours - len(positions), axis=0)])
        write_uniform(shader, "turns", _turns(shot, filled))
        steps = shot.draw.samples**-0.5 * np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (0.0, 0.0)])
        write_uniform(shader, "beside", _turns(shot, positions[0] + steps))
        if cells is not None:
            write_uniform(shader, "cells", np.resize(cells, (4 * fours, 2)).astype(np.float32))
        return self._targets.items(shader, "visible", count, channels)


def _turns(shot: Shot, positions: Floats) -> Floats:
    """Return (cosine, sine) of longitude and latitude of positions (r, 2) relative to a pixel's corner, (r, 4)."""
    angles = positions * (2.0 * np.pi / shot.view.width, -np.pi / shot.view.height)
    turns = np.stack([np.cos(angles), np.sin(angles)], axis=-1).reshape(-1, 4)
    return turns.astype(np.float32)
