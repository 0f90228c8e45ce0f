# SPDX-License-Identifier: Apache-2.0
"""Programs and render targets that the passes of a layer share, kept from frame to frame; pixels on their way back.

Passes are written as steps (`mr360uw.steps`): one that needs what it has drawn sends it on its way (`Targets.send`),
pauses, and takes it when it goes on. Passes side by side send all that they have drawn before one of them waits, so
that they wait together, and once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.gl.context import gl_context, program, roomy_rows, set_uniforms
from mr360uw.types import Rectangle

if TYPE_CHECKING:
    import moderngl

_LEAST_BYTES = 1 << 20
"""Bytes of a buffer for pixels on their way back, at least."""


class _Batch:
    """Pixels that are read together from a buffer on the device: the first `used` bytes of it."""

    def __init__(self, buffer: moderngl.Buffer) -> None:
        self.buffer, self.used = buffer, 0
        self._data: bytes | None = None

    @property
    def is_read(self) -> bool:
        """Whether the device has been waited for, so that the buffer is free."""
        return self._data is not None

    def data(self) -> bytes:
        """Return the bytes of all pixels; wait until the device has drawn them."""
        if self._data is None:
            self._data = self.buffer.read(self.used)
        return self._data


class Pixels:
    """Images of a target that are on their way back from the device."""

    def __init__(self, batch: _Batch, places: Sequence[tuple[int, tuple[int, int, int]]]) -> None:
        self._batch, self._places = batch, places

    def images(self) -> list[NDArray[np.float32]]:
        """Return the images (h, w, c); wait for them, and for all that was sent before or since and not yet taken."""
        data = self._batch.data()
        return [
            np.frombuffer(data, np.float32, int(np.prod(shape)), start).reshape(shape) for start, shape in self._places
        ]

    def stacked(self) -> NDArray[np.float32]:
        """Return `images` as one array (n, h, w, c), of textures that have equally many channels."""
        start, shape = self._places[0]
        every = len(self._places), *shape
        return np.frombuffer(self._batch.data(), np.float32, int(np.prod(every)), start).reshape(every)


class Targets:
    """Compiled programs by name and defines; float targets by name and channels, which only grow."""

    def __init__(self) -> None:
        self._programs: dict[str, moderngl.Program] = {}
        self._triangles: dict[moderngl.Program, moderngl.VertexArray] = {}
        self._targets: dict[tuple[str, tuple[int, ...]], moderngl.Framebuffer] = {}
        self._batch: _Batch | None = None
        self._full: list[_Batch] = []

    def program(self, name: str, defines: Mapping[str, str | int | float]) -> moderngl.Program:
        """Return the full-screen program of composite/gl/shaders/<name>.frag with defines, compiled once."""
        key = f"{name} {sorted(defines.items())}"
        if key not in self._programs:
            self._programs[key] = program(fragment=f"composite/gl/shaders/{name}.frag", defines=defines)
        return self._programs[key]

    def target(
        self, name: str, width: int, height: int, channels: tuple[int, ...], types: tuple[str, ...] = ()
    ) -> moderngl.Framebuffer:
        """Return a kept target of at least width x height pixels, one texture for each number of channels.

        A target that has to grow is made anew, and its contents are lost. types: of the textures' numbers; floats
        where none are given.
        """
        target = self._targets.get((name, channels))
        if target is None or target.width < width or target.height < height:
            w, h = width, roomy_rows(height)
            if target is not None:
                w, h = max(w, target.width), max(h, target.height)
            of = zip(channels, types or ("f4",) * len(channels), strict=True)
            target = gl_context().framebuffer([gl_context().texture((w, h), c, dtype=kind) for c, kind in of])
            self._targets[name, channels] = target
        return target

    def fill(self, target: moderngl.Framebuffer, shader: moderngl.Program, part: Rectangle) -> None:
        """Run a full-screen program on a part of a target; discarded pixels keep their values."""
        if shader not in self._triangles:
            self._triangles[shader] = gl_context().vertex_array(shader, [])
        target.use()
        target.viewport = part
        gl_context().disable(gl_context().DEPTH_TEST | gl_context().BLEND)
        self._triangles[shader].render(vertices=3)

    def draw(self, shader: moderngl.Program, name: str, width: int, height: int, channels: tuple[int, ...]) -> Pixels:
        """Run a full-screen program on width x height pixels of a kept target; discarded pixels are zero.

        Returns these pixels on their way back.
        """
        target = self.target(name, width, height, channels)
        part = Rectangle(0, 0, width, height)
        target.use()
        target.clear(viewport=part)
        target.scissor = part
        self.fill(target, shader, part)
        target.scissor = None  # type: ignore[assignment]
        return self.send(target, part)

    def send(self, target: moderngl.Framebuffer, part: Rectangle, attachments: Sequence[int] | None = None) -> Pixels:
        """Send a part of some textures of a target on its way back, of all where none are named; do not wait for it.

        The target may be drawn into again at once.
        """
        every: Sequence[Any] = target.color_attachments
        chosen = range(len(every)) if attachments is None else attachments
        shapes = [(part.height, part.width, every[k].components) for k in chosen]
        sizes = [4 * int(np.prod(shape)) for shape in shapes]
        batch = self._open_batch(sum(sizes))
        places = []
        for attachment, shape, size in zip(chosen, shapes, sizes, strict=True):
            target.read_into(
                batch.buffer, part, shape[2], attachment=attachment, dtype="f4", alignment=1, write_offset=batch.used
            )
            places.append((batch.used, shape))
            batch.used += size
        return Pixels(batch, places)

    def answer(self) -> None:
        """Take all that was sent from the device; wait for it. Other threads may then take their pixels."""
        for batch in [*self._full, *([] if self._batch is None or not self._batch.used else [self._batch])]:
            batch.data()
        self._full.clear()

    def _open_batch(self, size: int) -> _Batch:
        """Return a batch with room for `size` more bytes: the last one, or a new one if that is read or full."""
        last = self._batch
        needed = size if last is None or last.is_read else last.used + size
        if last is None or needed > last.buffer.size:
            if last is not None and not last.is_read:
                self._full = [*(full for full in self._full if not full.is_read), last]
            room = 1 << max(2 * needed - 1, _LEAST_BYTES - 1).bit_length()
            self._batch = _Batch(gl_context().buffer(reserve=room))
        elif last.is_read:
            self._batch = _Batch(last.buffer)
        assert self._batch is not None
        return self._batch


def bind(shader: moderngl.Program, textures: Mapping[str, Any]) -> None:
    """Bind the textures that a program uses, each to a unit of its own."""
    unit = 0
    for name, texture in textures.items():
        if shader.get(name, None) is not None:  # `in` looks at one name after the other
            texture.use(unit)
            set_uniforms(shader, **{name: unit})
            unit += 1
