# SPDX-License-Identifier: Apache-2.0
"""The gl renderer: the layer of a frame on OpenGL 3.3, with the samples, groups and light of the reference renderer.

Only pixels that objects and their shadows may change are drawn and read back. The cache keeps meshes, the shadow atlas,
the samples of objects at rest and the geometry of the receiver from frame to frame.
"""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import Cache
from mr360uw.composite.ambient.light import ambient_light
from mr360uw.composite.ambient.solver import AmbientLight
from mr360uw.composite.aovs import AovFrame, Aovs
from mr360uw.composite.gl.light_textures import LightTextures
from mr360uw.composite.gl.object_pass import ObjectPass, Surfaces
from mr360uw.composite.gl.receiver_pass import ReceiverPass
from mr360uw.composite.gl.targets import Targets
from mr360uw.composite.gl.upload import MeshBuffers, StillBuffers, upload_mesh, upload_still
from mr360uw.composite.mesh.mesh import Mesh
from mr360uw.composite.over import empty_tile, hold_out
from mr360uw.composite.raycast.geometry import object_rectangles
from mr360uw.composite.sampling import NO_GAPS
from mr360uw.composite.shot import Shot
from mr360uw.composite.tiles import even_tiles
from mr360uw.gl.context import next_frame
from mr360uw.steps import Pause, Steps, finished, side_by_side
from mr360uw.threads import one_blas_thread
from mr360uw.types import Layer

_KEPT_MESHES = 64
"""Meshes on the device. Poses are kept as many as the shots under way have: the next shot has others."""


class LayerRenderer:
    """Draws the layers of shots. cache: values kept between shots. One renderer for each OpenGL thread."""

    def __init__(self, cache: Cache | None = None) -> None:
        self._cache = Cache() if cache is None else cache
        self._slots: set[int] = set()
        self._meshes, self._targets = _DeviceMeshes(self._cache), Targets()
        self._light = LightTextures(self._cache, self._meshes.buffers)
        self._objects = ObjectPass(self._targets, self._meshes.buffers, self._cache)
        self._receiver = ReceiverPass(self._targets, self._cache)

    def render(self, shot: Shot) -> Layer:
        """Return the layer of a shot, as `reference.render_layer` does."""
        with one_blas_thread():
            return finished(self.steps(shot))[0]

    def render_aovs(self, shot: Shot) -> tuple[Layer, Aovs]:
        """Return the layer of a shot and its output variables, as `reference.render_aovs` does."""
        with one_blas_thread():
            layer, variables = finished(self.steps(shot, variables=True))
        assert variables is not None
        return layer, variables

    def steps(self, shot: Shot, *, variables: bool = False) -> Steps[tuple[Layer, Aovs | None]]:
        """Return the layer of a shot, and its output variables if asked for."""
        own = object()
        frame = AovFrame(shot) if variables else None
        try:
            layer = yield from self._layer(shot, frame, own)
        finally:
            self._meshes.under_way.pop(own, None)
        return layer, None if frame is None else frame.finish(shot, layer)

    def answer(self) -> None:
        """Take from the device all that shots under way wait for."""
        self._targets.answer()

    def _layer(self, shot: Shot, frame: AovFrame | None, own: object) -> Steps[Layer]:
        view = shot.view
        object_parts = self._cache.of(object_rectangles, view, shot.objects)
        masks = self._receiver.masks(shot)
        if not object_parts and masks is None:
            return Layer(view.height, view.width, ())
        ambient = ambient_light(shot, self._cache)
        reach = self._receiver.reached(shot, masks, ambient)
        yield Pause.DEVICE
        next_frame()
        self._meshes.under_way[own] = len({placed.mesh for placed in shot.objects if placed.mesh.rest is not None})
        self._meshes.add_places(ambient)
        light = self._light.of(shot)
        slot = next(k for k in itertools.count() if k not in self._slots)
        self._slots.add(slot)
        try:
            find: list[Steps[Surfaces]] = [self._objects.find(shot, slot)] if object_parts else []
            *found, changes = yield from side_by_side(*find, self._receiver.find(shot, light, reach))
        finally:
            self._slots.discard(slot)
        parts = object_parts + (changes.rectangles if changes is not None else [])
        tiles = even_tiles(parts, view.width, view.height)
        drawn = [empty_tile(part) for part in tiles]
        gaps = found[0].gaps if found else NO_GAPS
        draws = [self._objects.draw(shot, light, surfaces, drawn, frame, ambient) for surfaces in found]
        *_, on_blocks = yield from side_by_side(*draws, self._receiver.light(shot, changes, gaps))
        self._receiver.lay(shot, on_blocks, drawn)
        return Layer(view.height, view.width, tuple(hold_out(shot, tile) for tile in drawn))


class _DeviceMeshes:
    """The device's copies of meshes. under_way: how many meshes in a pose each shot under way has."""

    def __init__(self, cache: Cache) -> None:
        self._cache = cache
        self.under_way: dict[object, int] = {}
        self._places: dict[Mesh, NDArray[np.int64]] = {}

    def add_places(self, ambient: AmbientLight | None) -> None:
        """Note the points of ambient light of meshes at rest whose values are to be read."""
        if ambient is None:
            return
        for body, values in zip(ambient.layout.bodies, ambient.values, strict=False):
            if values is not None:
                self._places.pop(body.placed.mesh.still, None)
                self._places[body.placed.mesh.still] = body.transfer.lattice.places
        while len(self._places) > max(_KEPT_MESHES, len(ambient.values)):
            del self._places[next(iter(self._places))]

    def buffers(self, mesh: Mesh) -> MeshBuffers:
        """Return the device's copy of a mesh."""
        still, places = mesh.still, self._places.get(mesh.still)
        if mesh.rest is None:
            return self._cache.of(upload_mesh, mesh, places, keep=_KEPT_MESHES)
        shared = self._cache.of(upload_still, still, places, keep=_KEPT_MESHES)
        return self._cache.of(_posed, mesh, shared, keep=max(sum(self.under_way.values()), 1))


def _posed(mesh: Mesh, still: StillBuffers) -> MeshBuffers:
    return upload_mesh(mesh, still=still)
