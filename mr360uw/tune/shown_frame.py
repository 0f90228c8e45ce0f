# SPDX-License-Identifier: Apache-2.0
"""Frame that is shown: its intermediate results, the scene it is of, and the renderer that made it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mr360uw.composite.shot import PlacedObject, Receiver
from mr360uw.ibl.lighting import turned
from mr360uw.render.backends import Backend
from mr360uw.render.frame import Frame
from mr360uw.render.loaded import Loaded
from mr360uw.tune.drawing import DARK, LIGHT, Palette
from mr360uw.types import Sun, View


@dataclass(frozen=True, slots=True, eq=False)
class ShownFrame:
    """A frame to be looked at. renderer: to be used in its own thread alone. duration_s: of the clip, 0 for a still.

    dark: whether the page around the picture is dark.
    """

    frame: Frame
    loaded: Loaded
    renderer: Backend
    duration_s: float = 0.0
    dark: bool = True

    @property
    def palette(self) -> Palette:
        """Colours of charts."""
        return DARK if self.dark else LIGHT

    @property
    def time_s(self) -> float:
        """Time of the frame [s]."""
        return self.frame.plate.time_s

    def view_of(self, width: int) -> View:
        """Return the camera's view with frames of another width."""
        return replace(self.loaded.view(self.time_s), width=width, height=width // 2)

    @property
    def receiver(self) -> Receiver | None:
        """The receiver as it is in this frame, or None."""
        return self.loaded.receiver_at(self.frame.plate.index, self.time_s)

    @property
    def sun(self) -> Sun | None:
        """The frame's sun in the world's axes, or None."""
        if self.frame.light is None:
            return None
        return turned(self.frame.light.environment, self.loaded.view(self.time_s).world_from_camera).sun

    @property
    def placed(self) -> tuple[PlacedObject, ...]:
        """The objects as they are at this time."""
        view, index = self.loaded.view(self.time_s), self.frame.plate.index
        return tuple(o.at(self.time_s, index, view.position, view.world_from_camera) for o in self.loaded.objects)

    @property
    def ground_y(self) -> tuple[float, str]:
        """Height [m] at which caustics are shown, and of what it is: the receiver, the lowest object or the camera."""
        receiver = self.receiver
        if receiver is not None and receiver.plane_y is not None:
            return receiver.plane_y, "receiver"
        if receiver is not None and receiver.mesh is not None:
            return float(np.mean(receiver.mesh[..., 1])), "receiver's mean height"
        if self.placed:
            return min(float(one.to_world(one.mesh.hull)[..., 1].min()) for one in self.placed), "lowest object"
        return float(self.loaded.view(self.time_s).position[1]), "camera"
