# SPDX-License-Identifier: Apache-2.0
"""Objects on OpenGL 3.3: shading of the visible fragments, and their sum in pixels.

Fragments are shaded as a list, one texel each (layer.frag), so pixels with few do not wait for pixels with many.
Objects that share a mesh are shaded together.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import Cache, PartOf, Same, Scratch
from mr360uw.composite.ambient.sample_points import FEW_CHANNELS, UNTOUCHED
from mr360uw.composite.ambient.solver import AmbientLight
from mr360uw.composite.aovs import SUMS, AovFrame
from mr360uw.composite.gl.fragments import (
    MeshFragments,
    SunGroups,
    add_behind,
    mesh_fragments,
    sun_groups,
    through,
)
from mr360uw.composite.gl.light_textures import ShotLight
from mr360uw.composite.gl.targets import Targets, bind
from mr360uw.composite.gl.visible_surfaces import Fragments, Surfaces, find_surfaces
from mr360uw.composite.gl.upload import MeshBuffers, device_order, joined_texture, list_texture, of_eye
from mr360uw.composite.lighting.sun import sun_of
from mr360uw.composite.mesh.material import MAPS
from mr360uw.composite.mesh.mesh import Mesh
from mr360uw.composite.sampling import filter_width
from mr360uw.composite.shot import PlacedObject, Shot
from mr360uw.gl.context import set_uniforms
from mr360uw.types import Floats, Tile

if TYPE_CHECKING:
    import moderngl

_CHANNELS = ((4, 1), (4,) * 6, (4,) * 4, (2,))
"""Outputs of layer.frag: radiance and distance, both halves of the output variables, what is seen of the sun."""
_BY_FRAGMENT, _SEEN = (0, 1, 2), 3
"""Numbers of those of every fragment, and of the last."""
_ORDERS = 64
"""Meshes of which the order of triangles on the device is kept."""
_PARTS = 256
"""Groups of fragments of one mesh in one layer, of which it is kept what they see of the sun."""
_KEPT = 1 << 21
"""Most fragments, about 100 bytes each, kept between frames."""


Bodies = tuple["moderngl.Texture", frozenset[Mesh]]
"""Texture of bodies, four texels each as layer.frag says, then values of ambient light at points; and the meshes that
have any."""
_Lit = tuple[Shot, ShotLight, Surfaces]
_Groups = SunGroups | None
"""None where what fragments see of the sun is known, or nothing is in its way."""


class ObjectPass:
    """Draws and shades the objects of shots; caches the fragments while objects and camera are at rest.

    buffers: returns the device's copy of a mesh.
    """

    def __init__(self, targets: Targets, buffers: Callable[[Mesh], MeshBuffers], cache: Cache) -> None:
        self._targets, self._buffers, self._cache, self._scratch = targets, buffers, cache, Scratch()

    def find(self, shot: Shot) -> Surfaces:
        """Return the visible surfaces of a shot's objects."""
        sampled = PartOf(shot, shot.view, shot.draw.samples, shot.draw.shading)
        surfaces = self._cache.of(find_surfaces, sampled, list(shot.visible), self._cache)
        if sum(len(layer) for layer in surfaces.layers) > _KEPT:
            self._cache.drop(find_surfaces)
            self._cache.drop(_cache_of)
        return surfaces

    def draw(
        self,
        shot: Shot,
        light: ShotLight,
        surfaces: Surfaces,
        tiles: Sequence[Tile],
        frame: AovFrame | None,
        ambient: AmbientLight | None,
    ) -> None:
        """Composite the surfaces of a shot behind the contents of tiles.

        frame: receives output variables, or None. ambient: solved ambient light among the bodies.
        """
        objects, layers, first = list(shot.visible), surfaces.layers, surfaces.first
        values, changed = self._body_list(shot, objects, ambient)
        cache = self._cache.of(_cache_of, Same(surfaces))
        bodies = joined_texture(values, self._scratch), changed
        for number, fragments in enumerate(layers):
            if len(fragments) == 0:
                continue
            body = np.searchsorted(first, fragments.triangle, side="right") - 1
            parts = cache.of(mesh_fragments, PartOf((objects, first, fragments, self._places), Same(fragments)), body, keep=len(layers))
            blended = number < len(layers) - 1
            values_of, *halves = (
                self._light_up((shot, light, surfaces), parts, len(fragments), bodies, blended, cache, outputs)
                for outputs in ((0,) if frame is None else _BY_FRAGMENT)
            )
            if frame is not None:
                seen = through(tiles, fragments)[fragments.pixel()] * fragments.weight * values_of[:, 3]
                _add_variables(frame, fragments, seen, np.concatenate(halves, axis=1), body)
            add_behind(tiles, fragments, values_of)

    def _body_list(
        self, shot: Shot, objects: Sequence[PlacedObject], ambient: AmbientLight | None
    ) -> tuple[list[NDArray[np.float32]], frozenset[Mesh]]:
        """Return where bodies are, and the values of ambient light on them, as `Bodies` has them."""
        table = np.zeros((len(objects), 4, 4), np.float32)
        values, texels = [table], 4 * len(objects)
        every = [None] * len(shot.objects) if ambient is None else ambient.values
        of_visible = [v for v, placed in zip(every, shot.objects, strict=True) if placed.visible]
        changed = {placed.mesh for placed, known in zip(objects, of_visible, strict=True) if known is not None}
        for row, placed, known in zip(table, objects, of_visible, strict=True):
            row[:3], row[3, 0] = placed.world_from_object[:3], placed.bias_m
            row[:3, 3] -= shot.view.position
            if placed.mesh not in changed:
                continue
            assert ambient is not None
            lattice = ambient.layout.bodies[shot.objects.index(placed)].transfer.lattice
            points = lattice.points * (2 if lattice.two_sided else 1)
            own = np.tile(np.array(UNTOUCHED[:FEW_CHANNELS], np.float32), (points, 1)) if known is None else known
            row[3, 1:4] = texels, lattice.points if lattice.two_sided else 0, own.shape[1] // 4
            values.append(own)
            texels += own.size // 4
        return values, frozenset(changed)

    def _places(self, mesh: Mesh) -> NDArray[np.int64]:
        """Return the places (T,) of a mesh's triangles on the device."""
        return self._cache.of(_device_places, mesh.still, keep=_ORDERS)

    def _sun_groups(self, lit: _Lit, part: MeshFragments, cache: Cache) -> _Groups:
        """Return the groups of fragments that see the same of the sun."""
        shot, light, surfaces = lit
        sun = sun_of(shot)
        if sun is None or "SHADOW" not in light.defines or cache.holds(self._see_sun, part, PartOf(0, light.of_sight)):
            return None
        return sun_groups(shot, part, surfaces.facets, sun.direction)

    def _light_up(
        self,
        lit: _Lit,
        parts: Sequence[MeshFragments],
        count: int,
        bodies: Bodies,
        blended: bool,
        cache: Cache,
        outputs: int,
    ) -> Floats:
        """Return the outputs (count, channels) of layer.frag for `count` fragments. outputs: see `_CHANNELS`."""
        values = np.empty((count, sum(_CHANNELS[outputs])), np.float32)
        for part in parts:
            extra = {}
            groups = self._sun_groups(lit, part, cache)
            if "SHADOW" in lit[1].defines:
                seen = PartOf((*lit, bodies, groups), lit[1].of_sight)
                extra["sun_seen"] = cache.of(self._see_sun, part, seen, keep=_PARTS)
            entries = cache.of(_entries, part, keep=_PARTS)
            values[part.chosen] = self._shade(lit, part, entries, bodies, outputs, blended=blended, textures=extra)
        return values

    def _see_sun(self, part: MeshFragments, seen: PartOf[tuple[*_Lit, Bodies, _Groups]]) -> moderngl.Texture:
        """Return the visible fractions of the sun's disc and halo of each fragment, as layer.frag reads them."""
        *_, bodies, groups = seen.whole
        lit = seen.whole[:3]
        assert groups is not None
        of_groups = np.zeros((len(groups.listed), sum(_CHANNELS[_SEEN])), np.float32)
        which = groups.first
        of_groups[which] = self._cast_rays(lit, part, groups.listed[which], bodies)
        which = groups.fill_between(of_groups)
        of_groups[which] = self._cast_rays(lit, part, groups.listed[which], bodies)
        fractions = np.ones((len(groups.of), of_groups.shape[1]), np.float32)
        there = groups.of >= 0
        fractions[there] = of_groups[groups.of[there]]
        return list_texture(fractions, 2)

    def _cast_rays(
        self, lit: _Lit, part: MeshFragments, listed: Floats, bodies: Bodies
    ) -> NDArray[np.float32]:
        """Return the visible fractions (m, 2) of the sun's disc and halo of listed fragments (m, 9) of a mesh."""
        if len(listed) == 0:
            return np.zeros((0, sum(_CHANNELS[_SEEN])), np.float32)
        few = replace(part, chosen=np.arange(len(listed)))
        return self._shade(lit, few, list_texture(listed, 3), bodies, _SEEN)

    def _shade(
        self,
        lit: _Lit,
        part: MeshFragments,
        entries: moderngl.Texture,
        bodies: Bodies,
        outputs: int,
        *,
        blended: bool = False,
        textures: Mapping[str, moderngl.Texture] | None = None,
    ) -> NDArray[np.float32]:
        """Return the outputs (n, channels) of layer.frag for a part of the fragments, which a texture lists."""
        (shot, light, _), mesh, count = lit, part.mesh, len(part.chosen)
        buffers = self._buffers(mesh)
        defines = of_eye(shot) | {"OUTPUTS": outputs} | _map_defines(mesh) | light.defines
        defines |= {"BLENDED": 1} if blended else {}
        defines |= {"AMONG_BODIES": 1} if mesh in bodies[1] and outputs != _SEEN else {}
        defines |= {"SMOOTH": 1} if mesh.glossy and outputs != _SEEN else {}
        shader = self._targets.program("layer", defines)
        bind(
            shader,
            {
                "fragments": entries,
                "bodies": bodies[0],
                "triangles": buffers.triangles,
                "materials": buffers.materials,
                "store": buffers.store,
                **(textures or {}),
                **light.textures,
            },
        )
        light.set(shader)
        set_uniforms(
            shader,
            world_from_camera=shot.view.world_from_camera.T,
            frame_size=(shot.view.width, shot.view.height),
            count=count,
            eye_m=shot.view.eye_m,
            filter_width=filter_width(shot.draw.samples, shot.draw.shading),
        )
        return self._targets.items(shader, f"layer {outputs}", count, _CHANNELS[outputs])


def _device_places(mesh: Mesh) -> NDArray[np.int64]:
    return np.argsort(device_order(mesh))


def _cache_of(_: Same) -> Cache:
    """Return the cache of what is made of a list of fragments, and goes with it."""
    return Cache()


def _entries(part: MeshFragments) -> moderngl.Texture:
    """Return the texture of what `MeshFragments` lists."""
    return list_texture(part.listed, 3)


def _add_variables(
    frame: AovFrame, fragments: Fragments, share: Floats, values: Floats, body: NDArray[np.int64]
) -> None:
    """Add the output variables (n, 40) of fragments that have a share (n,) in their pixels."""
    at = fragments.row, fragments.column
    for k, name in enumerate(SUMS):
        frame.sums[name][at] += fragments.sums(share[:, None] * values[:, 4 * k : 4 * k + 3])
    pixel = fragments.pixel()
    order = np.lexsort((-np.arange(len(pixel)), share))  # of several in a pixel, the largest is written last
    largest = np.full(len(fragments.row), -1, np.int64)
    largest[pixel[order]] = order
    larger = share[largest] > frame.share[at]
    rows, columns, chosen = fragments.row[larger], fragments.column[larger], largest[larger]
    frame.share[rows, columns], frame.object_id[rows, columns] = share[chosen], body[chosen] + 1


def _map_defines(mesh: Mesh) -> dict[str, int]:
    """Return a define for every kind of map that some material of a mesh has, and its further texture coordinates."""
    further = mesh.more_uv.shape[2]
    kinds = {kind.upper(): 1 for kind in MAPS if any(getattr(m, kind) is not None for m in mesh.materials)}
    return kinds | ({"MORE_UV": 1} if further else {})
