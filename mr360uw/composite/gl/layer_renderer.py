# SPDX-License-Identifier: Apache-2.0
"""The layer of a frame on OpenGL 3.3: the same samples, groups and light as the reference renderer.

Only what objects and their shadows touch is drawn and read back. What has not changed since the frame before is kept in
the cache: meshes, shadow atlas, the samples of objects that stand still and the shape of the receiver.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import Cache
from mr360uw.composite.ambient.light import ambient_light
from mr360uw.composite.ambient.solver import AmbientLight
from mr360uw.composite.aovs import AovFrame, Aovs
from mr360uw.composite.gl.light_textures import LightTextures
from mr360uw.composite.gl.object_pass import ObjectPass
from mr360uw.composite.gl.receiver_pass import ReceiverPass
from mr360uw.composite.gl.targets import Targets
from mr360uw.composite.gl.upload import MeshBuffers, upload_mesh
from mr360uw.composite.holdout import hold_out
from mr360uw.composite.mesh.mesh import Mesh
from mr360uw.composite.over import empty_tile
from mr360uw.composite.raycast.geometry import object_rectangles
from mr360uw.composite.shot import Shot
from mr360uw.composite.tiles import even_tiles
from mr360uw.gl.context import gl_context
from mr360uw.types import Layer

_KEPT_MESHES = 64


class LayerRenderer:
    """Draws shots. cache: keeps on the device what the next one can use. One for each OpenGL thread."""

    def __init__(self, cache: Cache | None = None) -> None:
        self._cache = Cache() if cache is None else cache
        self._places: dict[Mesh, NDArray[np.int64]] = {}
        self._light = LightTextures(self._cache, self._buffers)
        targets = Targets()
        self._objects = ObjectPass(targets, self._light, self._buffers, self._cache)
        self._receiver = ReceiverPass(targets, self._light, self._cache)

    def render(self, shot: Shot) -> Layer:
        """Return the layer of a shot, as `reference.render_layer` does."""
        return self._render(shot, None)

    def render_aovs(self, shot: Shot) -> tuple[Layer, Aovs]:
        """Return the layer of a shot and its output variables, as `reference.render_aovs` does."""
        frame = AovFrame(shot)
        layer = self._render(shot, frame)
        return layer, frame.finish(shot, layer)

    def _render(self, shot: Shot, frame: AovFrame | None) -> Layer:
        gl_context().gc()
        view = shot.view
        object_parts = object_rectangles(shot)
        changes = self._receiver.find(shot)
        parts = object_parts + (changes.rectangles if changes is not None else [])
        tiles = even_tiles(parts, view.width, view.height)
        if not tiles:
            return Layer(view.height, view.width, ())
        ambient = ambient_light(shot, self._cache)
        self._places = _places(ambient)
        self._light.update(shot)
        drawn = [empty_tile(part) for part in tiles]
        if object_parts:
            self._objects.draw(shot, drawn, frame, ambient)
        self._receiver.draw(shot, changes, drawn, ambient)
        return Layer(view.height, view.width, tuple(hold_out(shot, tile) for tile in drawn))

    def _buffers(self, mesh: Mesh) -> MeshBuffers:
        key = (mesh, mesh in self._places)
        return self._cache.get("mesh", key, lambda: upload_mesh(mesh, self._places.get(mesh)), keep=_KEPT_MESHES)


def _places(ambient: AmbientLight | None) -> dict[Mesh, NDArray[np.int64]]:
    """Return the knots of ambient light of the meshes whose values are to be read."""
    if ambient is None:
        return {}
    bodies = zip(ambient.layout.bodies, ambient.values, strict=False)
    return {body.placed.mesh: body.transfer.lattice.places for body, values in bodies if values is not None}
