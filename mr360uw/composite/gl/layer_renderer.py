# SPDX-License-Identifier: Apache-2.0
"""The gl renderer: the layer of a frame on OpenGL 3.3, with the samples, groups and light of the reference renderer.

Only pixels that objects and their shadows may change are drawn and read back. The cache keeps meshes, the shadow atlas,
the samples of objects at rest and the geometry of the receiver from frame to frame.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import Cache, Steps
from mr360uw.composite.ambient.light import ambient_light
from mr360uw.composite.ambient.solver import AmbientLight
from mr360uw.composite.aovs import AovFrame, Aovs
from mr360uw.composite.gl.light_textures import LightTextures
from mr360uw.composite.gl.object_pass import ObjectPass, Surfaces
from mr360uw.composite.gl.receiver_pass import ReceiverPass
from mr360uw.composite.gl.targets import Targets, finished, side_by_side
from mr360uw.composite.gl.upload import MeshBuffers, StillBuffers, upload_mesh, upload_still
from mr360uw.composite.mesh.mesh import Mesh
from mr360uw.composite.over import empty_tile, hold_out
from mr360uw.composite.raycast.geometry import object_rectangles
from mr360uw.composite.sampling import NO_GAPS
from mr360uw.composite.shot import Shot
from mr360uw.composite.tiles import even_tiles
from mr360uw.gl.context import next_frame
from mr360uw.threads import one_blas_thread
from mr360uw.types import Layer

_KEPT_MESHES = 64
"""Meshes on the device. Poses are kept as many as a shot has: the next shot has others."""


class LayerRenderer:
    """Draws the layers of shots. cache: values kept between shots. One renderer for each OpenGL thread."""

    def __init__(self, cache: Cache | None = None) -> None:
        self._cache = Cache() if cache is None else cache
        self._poses = 1
        self._places: dict[Mesh, NDArray[np.int64]] = {}
        self._light = LightTextures(self._cache, self._buffers)
        targets = Targets()
        self._objects = ObjectPass(targets, self._light, self._buffers, self._cache)
        self._receiver = ReceiverPass(targets, self._light, self._cache)

    def render(self, shot: Shot) -> Layer:
        """Return the layer of a shot, as `reference.render_layer` does."""
        with one_blas_thread():
            return self._render(shot, None)

    def render_aovs(self, shot: Shot) -> tuple[Layer, Aovs]:
        """Return the layer of a shot and its output variables, as `reference.render_aovs` does."""
        frame = AovFrame(shot)
        with one_blas_thread():
            layer = self._render(shot, frame)
        return layer, frame.finish(shot, layer)

    def _render(self, shot: Shot, frame: AovFrame | None) -> Layer:
        next_frame()
        view = shot.view
        self._poses = max(len({placed.mesh for placed in shot.objects if placed.mesh.rest is not None}), 1)
        object_parts = self._cache.of(object_rectangles, view, shot.objects)
        reach = self._receiver.reach(shot)
        if not object_parts and reach is None:
            return Layer(view.height, view.width, ())
        ambient = ambient_light(shot, self._cache)
        self._places = _places(ambient)
        self._light.update(shot)
        find: list[Steps[Surfaces]] = [self._objects.find(shot)] if object_parts else []
        *found, changes = finished(side_by_side(*find, self._receiver.find(shot, reach, ambient)))
        parts = object_parts + (changes.rectangles if changes is not None else [])
        tiles = even_tiles(parts, view.width, view.height)
        drawn = [empty_tile(part) for part in tiles]
        gaps = found[0].gaps if found else NO_GAPS
        draws = [self._objects.draw(shot, surfaces, drawn, frame, ambient) for surfaces in found]
        *_, light = finished(side_by_side(*draws, self._receiver.light(shot, changes, ambient, gaps)))
        self._receiver.lay(shot, light, drawn)
        return Layer(view.height, view.width, tuple(hold_out(shot, tile) for tile in drawn))

    def _buffers(self, mesh: Mesh) -> MeshBuffers:
        still, places = mesh.still, self._places.get(mesh.still)
        if mesh.rest is None:
            return self._cache.of(upload_mesh, mesh, places, keep=_KEPT_MESHES)
        shared = self._cache.of(upload_still, still, places, keep=_KEPT_MESHES)
        return self._cache.of(_posed, mesh, shared, keep=self._poses)


def _posed(mesh: Mesh, still: StillBuffers) -> MeshBuffers:
    return upload_mesh(mesh, still=still)


def _places(ambient: AmbientLight | None) -> dict[Mesh, NDArray[np.int64]]:
    """Return the points of ambient light, for each mesh at rest whose values are to be read."""
    if ambient is None:
        return {}
    bodies = zip(ambient.layout.bodies, ambient.values, strict=False)
    return {body.placed.mesh.still: body.transfer.lattice.places for body, values in bodies if values is not None}
