# SPDX-License-Identifier: Apache-2.0
"""Length and size of a scene's plate, without decoding it."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Self

from mr360uw.scene.inputs import open_plate
from mr360uw.scene.model import Scene
from mr360uw.video import VideoReader


@dataclass(frozen=True, slots=True)
class PlateClip:
    """A scene's plate. width, height: [pixels], at full size. frame_count, duration_s: None for a still, which has as
    many frames as are asked for. frame_rate: [1/s].
    """

    frame_count: int | None
    frame_rate: Fraction
    width: int
    height: int
    duration_s: float | None

    @classmethod
    def of(cls, reader: VideoReader) -> Self:
        """Return the length and size of an open plate."""
        count, rate = reader.frame_count, reader.frame_rate
        return cls(count, rate, reader.width, reader.height, None if count is None else float(count / rate))


def clip_of(scene: Scene) -> PlateClip:
    """Return the length and size of a scene's plate; raise `VideoError`."""
    with open_plate(scene) as video:
        return PlateClip.of(video)
