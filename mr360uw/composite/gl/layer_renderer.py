# SPDX-License-Identifier: Apache-2.0
"""The gl renderer: the layer of a frame on OpenGL 3.3, with the samples, groups and light of the reference renderer.

Only pixels that objects and their shadows may change are drawn and read back. The cache keeps meshes, the columns of
shadows, the samples of objects at rest and the geometry of the receiver from frame to frame.
"""

from __future__ import annotations

import numpy as np

from mr360uw.cache import Cache, PartOf, Same
from mr360uw.composite.ambient.solver import AmbientLight
from mr360uw.composite.aovs import AovFrame, Aovs
from mr360uw.composite.gl.device import MeshBuffers, Places, Targets, upload_mesh, upload_still
from mr360uw.composite.gl.light_textures import LightTextures
from mr360uw.composite.gl.object_pass import ObjectPass
from mr360uw.composite.gl.receiver_pass import ReceiverPass
from mr360uw.composite.mesh.mesh import Mesh
from mr360uw.composite.over import empty_tile, hold_out
from mr360uw.composite.raycast import object_rectangles
from mr360uw.composite.receiver.blocks import Prepared, prepare, rectangles_of_blocks
from mr360uw.composite.receiver.ratio import ground_of
from mr360uw.composite.sampling import NO_GAPS
from mr360uw.composite.shot import Shot
from mr360uw.composite.tiles import even_tiles
from mr360uw.gl.context import gl_context
from mr360uw.threads import one_blas_thread
from mr360uw.types import Layer

_KEPT_MESHES = 64
"""Meshes on the device. Poses are kept as many as the shot has: the next one has others."""


class LayerRenderer:
    """Draws the layers of shots. cache: values kept between shots. One renderer for each OpenGL thread."""

    def __init__(self, cache: Cache | None = None) -> None:
        self._cache = Cache() if cache is None else cache
        self._meshes, self._targets = _DeviceMeshes(self._cache), Targets()
        self._light = LightTextures(self._cache)
        self._objects = ObjectPass(self._targets, self._meshes.buffers, self._cache)
        self._receiver = ReceiverPass(self._targets, self._cache)

    def render(self, shot: Shot) -> Layer:
        """Return the layer of a shot, as `reference.render_layer` does."""
        return self.layer(shot)[0].laid()

    def layer(
        self, shot: Shot, prepared: Prepared | None = None, *, variables: bool = False
    ) -> tuple[Layer, Aovs | None]:
        """Return the layer of a shot, and its output variables if asked for. prepared: what was found before of it."""
        frame = AovFrame(shot) if variables else None
        with one_blas_thread():
            layer = self._layer(shot, prepare(shot, self._cache) if prepared is None else prepared, frame)
        if frame is None:
            return layer, None
        layer = layer.laid()  # once for all that reads the variables
        return layer, frame.finish(shot, layer)

    def _layer(self, shot: Shot, prepared: Prepared, frame: AovFrame | None) -> Layer:
        view, ambient = shot.view, prepared.ambient
        object_parts = self._cache.of(object_rectangles, view, shot.objects)
        if not object_parts and prepared.reach is None:
            return Layer(view.height, view.width, ())
        gl_context().gc()  # releases what nothing refers to any more
        self._meshes.poses = len({placed.mesh for placed in shot.objects if placed.mesh.rest is not None})
        self._meshes.add_places(ambient)
        light = self._light.of(shot)
        surfaces = self._objects.find(shot) if object_parts else None
        gaps = surfaces.layers[-1].gaps if surfaces is not None and surfaces.layers else NO_GAPS
        on_blocks = self._receiver.light(shot, light, prepared.reach, gaps)
        parts = object_parts + ([] if on_blocks is None else rectangles_of_blocks(on_blocks.blocks, view))
        tiles = even_tiles(parts, view.width, view.height)
        drawn = [empty_tile(part, bare=on_blocks is not None) for part in tiles]
        if surfaces is not None:
            self._objects.draw((shot, light, surfaces), drawn, frame, ambient)
        ground = None
        if on_blocks is not None:
            ground = ground_of(on_blocks, view.width, view.height, shot.pattern, shot.unseen)
        layer = Layer(view.height, view.width, tuple(drawn), ground)
        if not shot.has_mattes:
            return layer
        return Layer(view.height, view.width, tuple(hold_out(shot, tile) for tile in layer.laid().tiles))


class _DeviceMeshes:
    """The device's copies of meshes. poses: how many meshes in a pose the shot has."""

    def __init__(self, cache: Cache) -> None:
        self._cache = cache
        self.poses = 0
        self._places: dict[Mesh, Places] = {}

    def add_places(self, ambient: AmbientLight | None) -> None:
        """Note the points of ambient light of meshes at rest whose values are to be read."""
        if ambient is None:
            return
        for body, values in zip(ambient.layout.bodies, ambient.values, strict=False):
            if values is None:
                continue
            still, places = body.placed.mesh.still, body.transfer.lattice.places
            known = self._places.pop(still, None)
            if known is None or (known.whole is not places and not np.array_equal(known.whole, places)):
                known = PartOf(places, Same(places))  # they count by identity: to read them takes a millisecond
            self._places[still] = known
        while len(self._places) > max(_KEPT_MESHES, len(ambient.values)):
            del self._places[next(iter(self._places))]

    def buffers(self, mesh: Mesh) -> MeshBuffers:
        """Return the device's copy of a mesh."""
        still, places = mesh.still, self._places.get(mesh.still)
        if mesh.rest is None:
            return self._cache.of(upload_mesh, mesh, places, keep=_KEPT_MESHES)
        shared = self._cache.of(upload_still, still, places, keep=_KEPT_MESHES)
        return self._cache.of(upload_mesh, mesh, None, shared, keep=max(self.poses, 1))
