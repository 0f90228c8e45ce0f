# SPDX-License-Identifier: Apache-2.0
"""Textures and buffers of a context that are used again, for a driver takes longer to make one than to fill it.

What is lent goes back by itself once nothing refers to it, and is lent anew from the next frame on: the device may
still read it in this one.
"""

from __future__ import annotations

from collections import deque
from typing import Any

import moderngl

_IDLE_FRAMES = 8
"""Frames after which what nobody has asked for is let go of."""

_FEWEST = 4
"""Rows of the smallest textures whose height varies."""
_Key = tuple[object, ...]


class _Lent:
    """Something of a pool, which goes back to it in the end. extra: the pool's list of these, its key, and itself."""

    extra: tuple[deque[tuple[_Key, Any]], _Key, Any]

    def __del__(self) -> None:
        back, key, own = self.extra
        back.append((key, own))


class _LentTexture(_Lent, moderngl.Texture):
    """A texture of a pool."""


class _LentArray(_Lent, moderngl.TextureArray):
    """A texture array of a pool."""


class _LentBuffer(_Lent, moderngl.Buffer):
    """A buffer of a pool."""


class TexturePool:
    """Lends textures and buffers of a context by size and format, with any contents. Used on the context's thread."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._free: dict[_Key, list[tuple[int, Any]]] = {}
        self._back: deque[tuple[_Key, Any]] = deque()
        self._framebuffers: dict[moderngl.Texture, moderngl.Framebuffer] = {}
        self._own: set[Any] = set()  # all of it, or the garbage collector would end what is lent with who borrowed it
        self._frame = 0

    def texture(self, size: tuple[int, int], channels: int, dtype: str = "f4") -> moderngl.Texture:
        """Return a texture of size (columns, rows), unfiltered."""
        return self._unfiltered(self._lend(_LentTexture, self._context.texture, size, channels, dtype=dtype))

    def texture_array(self, size: tuple[int, int, int], channels: int) -> moderngl.TextureArray:
        """Return a float texture array of size (columns, rows, layers), unfiltered."""
        return self._unfiltered(self._lend(_LentArray, self._context.texture_array, size, channels, dtype="f4"))

    def buffer(self, size: int) -> moderngl.Buffer:
        """Return a buffer of some bytes."""
        found: moderngl.Buffer = self._lend(_LentBuffer, self._context.buffer, reserve=size)
        return found

    def framebuffer(self, texture: moderngl.Texture) -> moderngl.Framebuffer:
        """Return a framebuffer that draws into a texture of this pool, the same for as long as the pool has it."""
        _, _, own = texture.extra
        if own not in self._framebuffers:
            self._framebuffers[own] = self._context.framebuffer([own])
        return self._framebuffers[own]

    def next_frame(self) -> None:
        """Take back what is no longer referred to, and let go of what nobody has asked for in the last frames."""
        self._frame += 1
        self._take_back(_IDLE_FRAMES)

    def release_free(self) -> None:
        """Take back what is no longer referred to, and let go of all that is not lent."""
        self._take_back(-1)

    def _take_back(self, idle: int) -> None:
        """Take back what is no longer referred to, and let go of what has been free for more than `idle` frames."""
        while self._back:
            key, own = self._back.popleft()
            self._free.setdefault(key, []).append((self._frame, own))
        for key, free in list(self._free.items()):
            while free and free[0][0] < self._frame - idle:
                _, own = free.pop(0)
                self._own.remove(own)
                self._framebuffers.pop(own, None)
            if not free:
                del self._free[key]

    def _lend(self, kind: Any, make: Any, *given: Any, **named: Any) -> Any:
        """Return an object of a kind that is free, the last one returned first, or a new one."""
        key = (kind, *given, *named.items())
        own = self._free[key].pop()[1] if self._free.get(key) else make(*given, **named)
        self._own.add(own)
        lent = kind.__new__(kind)
        vars(lent).update(vars(own))
        lent.extra = self._back, key, own
        return lent

    def _unfiltered(self, texture: Any) -> Any:
        texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        return texture


def roomy(count: int, most: int) -> int:
    """Return at least `count`, at most `most`: a power of two from 4 on or 1.5 times one, so that few sizes occur."""
    power = max(1 << max(count - 1, 0).bit_length(), _FEWEST)
    return max(count, min(3 * power // 4 if _FEWEST < count <= 3 * power // 4 else power, most))
