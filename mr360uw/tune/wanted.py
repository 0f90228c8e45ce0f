# SPDX-License-Identifier: Apache-2.0
"""Pictures of the tuning page: what is asked for, what was made, and the renderer that makes them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from mr360uw.preview.drafts import COARSE_WIDTH
from mr360uw.scene.model import Scene

VIEW_NAMES = {
    "composite": "Composite",
    "plate": "Plate",
    "caustics": "Caustics",
    "surface": "Sea surface",
    "lights": "Lights",
    "difference": "Shadows and caustics",
    "water": "Water alone",
    "depth": "Distances",
    "plan": "Plan",
}
"""Views of a frame, see `views.VIEWS`, with their names for people."""


@dataclass(frozen=True, slots=True)
class Wanted:
    """A picture to be made.

    revision: of the document whose scene it is. index: of the frame. view: a key of `VIEW_NAMES`. dark: its charts.
    width: [pixels] of the full picture. full: whether to make that once nothing else is asked for.
    """

    scene: Scene
    revision: int
    index: int
    view: str
    width: int
    full: bool = True
    dark: bool = True

    @property
    def draft_width(self) -> int:
        """Width [pixels] of a draft."""
        return min(self.width // 2, COARSE_WIDTH)


@dataclass(frozen=True, slots=True)
class Jpeg:
    """A picture as JPEG, with its size [pixels].

    panorama: whether it is equirectangular. measured: whether its light is that of a clip that was measured.
    """

    data: bytes
    width: int
    height: int
    panorama: bool = True
    measured: bool = False


@dataclass(frozen=True, slots=True)
class MadePicture:
    """A picture that was made, as JPEG; or, where none could be made, the reasons.

    seconds: it took. panorama, measured: see `Jpeg`. stand_in: whether it is a draft of the nearest keyframe.
    """

    number: int
    wanted: Wanted
    width: int
    height: int
    draft: bool
    seconds: float
    data: bytes
    problems: tuple[str, ...] = ()
    panorama: bool = True
    stand_in: bool = False
    measured: bool = False


class Renderer(Protocol):
    """Makes pictures; belongs to the thread that made it."""

    def picture(self, wanted: Wanted, width: int) -> Jpeg:
        """Return a picture of about a width."""

    def stand_in(self, wanted: Wanted) -> int:
        """Return the frame to show while the one that is wanted is decoded, or that one."""

    def close(self) -> None:
        """Let go of everything."""
