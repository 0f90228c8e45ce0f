# SPDX-License-Identifier: Apache-2.0
"""The receiver on OpenGL 3.3: what objects and waves change on the ground of the plate.

What bodies keep off is found on a coarse raster first, and pixel by pixel only where it varies (receiver.frag).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from mr360uw.composite.gl_light import LightTextures
from mr360uw.composite.gl_targets import Targets, bind
from mr360uw.composite.receiver import (
    CoarseGrid,
    ReceiverShape,
    coarse_grid,
    receiver_rectangles,
    shadow_rectangles,
)
from mr360uw.composite.shot import Shot
from mr360uw.composite.tiles import Rectangle, common_part, joined
from mr360uw.gl.context import set_uniforms, texture_from_array
from mr360uw.types import Floats

if TYPE_CHECKING:
    import moderngl

_STRIDE = 4
"""What bodies keep off a receiver is found at every so many pixels, and between where it varies."""
_KEPT_MAPS = 8


class ReceiverPass:
    """Draws the receivers of shots; keeps the shape of one that stands still before the camera."""

    def __init__(self, targets: Targets, light: LightTextures) -> None:
        self._targets, self._light = targets, light
        self._shape: tuple[object, ReceiverShape] | None = None
        self._grid: tuple[object, CoarseGrid] | None = None
        self._maps: dict[object, moderngl.Texture] = {}

    def rectangles(self, shot: Shot) -> list[Rectangle]:
        """Return the rectangles of the frame in which the receiver may change; none without one."""
        if shot.receiver is None:
            return []
        return receiver_rectangles(shot, self._coarse_grid(shot, self._receiver_shape(shot)))

    def draw(self, shot: Shot, parts: Sequence[Rectangle]) -> Iterator[tuple[Rectangle, dict[str, Floats]]]:
        """Yield rectangles of the frame that cover `parts`, each with its ratio and veil."""
        if not parts:
            return
        shape = self._receiver_shape(shot)
        shadow_parts = shadow_rectangles(shot, self._coarse_grid(shot, shape))
        for rectangle in joined(parts, shot.width):
            ratio, veil = self._draw_receiver(shot, shape, rectangle, shadow_parts)
            yield rectangle, {"ratio": ratio, "veil": veil}

    def _receiver_shape(self, shot: Shot) -> ReceiverShape:
        assert shot.receiver is not None
        key = (id(shot.receiver), shot.camera_position.tobytes())
        if self._shape is None or self._shape[0] != key:
            self._shape = key, ReceiverShape(shot.receiver, shot.camera_position)
            self._maps.clear()
        return self._shape[1]

    def _coarse_grid(self, shot: Shot, shape: ReceiverShape) -> CoarseGrid:
        key = (id(shape), shot.width, shot.height, shot.world_from_camera.tobytes(), id(shot.medium))
        if self._grid is None or self._grid[0] != key:
            self._grid = key, coarse_grid(shot, shape)
        return self._grid[1]

    def _draw_receiver(
        self, shot: Shot, shape: ReceiverShape, rectangle: Rectangle, shadow_parts: Sequence[Rectangle]
    ) -> tuple[Floats, Floats]:
        """Return ratio and veil of a rectangle of the frame; the sun's shadow is looked for in `shadow_parts` only."""
        assert shot.receiver is not None
        column, row, width, height = rectangle
        key = (rectangle, shot.width, shot.height, shot.world_from_camera.tobytes())
        if key not in self._maps:
            if len(self._maps) > _KEPT_MAPS:
                self._maps.clear()
            x, y = column + np.arange(width) + 0.5, (row + np.arange(height) + 0.5)[:, None]
            distance, normal = shape.meet(shot, x, y)
            place = np.where(np.isfinite(distance), distance, 0.0)[..., None]
            self._maps[key] = texture_from_array(np.concatenate([normal, place], axis=-1))
        unwanted = {"SHADOW": not shot.receiver.shadow, "CAUSTICS": not shot.receiver.caustics}
        defines = {name for name in self._light.defines if not unwanted.get(name)}
        view = {
            "world_from_camera": shot.world_from_camera.T, "frame_size": (shot.width, shot.height),
            "window": (column, row), "surfel_count": self._light.surfels,
        }  # fmt: skip
        textures = {"shape": self._maps[key], **self._light.textures}
        if shot.receiver.occlusion and self._light.surfels:
            defines.add("OCCLUSION")
        wide = width // _STRIDE + 2, height // _STRIDE + 2
        coarse = self._targets.program(
            "coarse", dict.fromkeys(defines & {"OCCLUSION", "SHADOW", "SUN"}, 1) | {"STRIDE": _STRIDE}
        )
        bind(coarse, textures)
        self._light.set(coarse, 0.0)
        set_uniforms(coarse, last=(width - 1, height - 1), **view)
        textures["coarse"] = self._targets.draw(coarse, "coarse", *wide, (2,))
        shadowed = [part for p in shadow_parts if (part := common_part(p, rectangle, shot.width)) is not None]
        areas = [(defines - {"SHADOW"}, (0, 0, width, height))]
        areas += [(defines, part) for part in shadowed if "SHADOW" in defines]
        for wanted, part in areas:
            shader = self._targets.program("receiver", dict.fromkeys(wanted, 1) | {"STRIDE": _STRIDE})
            bind(shader, textures)
            self._light.set(shader, 0.0)
            set_uniforms(shader, **view)
            self._targets.draw(shader, "receiver", width, height, (4, 4), part)
        ratio, veil = self._targets.read("receiver", width, height)
        return ratio[..., :3], veil[..., :3]
