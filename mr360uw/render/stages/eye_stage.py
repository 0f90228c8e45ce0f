# SPDX-License-Identifier: Apache-2.0
"""Eyes of a frame: one camera, or both eyes of a stereo plate, each with its plate and its place on the viewing circle.

What both eyes see is found once: light, sun, gain and water in the left eye's picture, so that no difference between
the pictures makes their objects differ; caustics, shadow maps and ambient light do not depend on the view. The plate's
own caustics are smoothed in each eye's picture alike: a clip's mean is kept of the left eye alone.
"""

from __future__ import annotations

from dataclasses import dataclass

from mr360uw.errors import ParameterError, SceneError
from mr360uw.render.background import Background
from mr360uw.scene.model import Scene
from mr360uw.video import VideoFrame


@dataclass(frozen=True, slots=True, eq=False)
class Eye:
    """One eye of a frame.

    plate: what it shows. eye_m: distance to the right of the middle [m]. number: 1 for the right eye of two, else 0.
    """

    plate: VideoFrame
    eye_m: float = 0.0
    number: int = 0


def eyes_of(scene: Scene, plate: VideoFrame) -> tuple[Eye, ...]:
    """Return the eyes of a plate's frame: itself, or left and right where the scene works on both.

    Raises `ParameterError` where the scene works on both and the frame is one panorama.
    """
    if scene.plate.eye != "both":
        return (Eye(plate),)
    if plate.right is None:
        raise ParameterError(
            'plate.eye - is "both", but the frame has one eye - take frames that open_video(..., eye="both") reads, or '
            "leave out plate.eye"
        )
    half_m = 0.5 * scene.camera.ipd_m
    return Eye(plate, -half_m, 0), Eye(plate.right, half_m, 1)


def background_of(background: Background | None, eye: Eye) -> Background | None:
    """Return a clip's background for one eye: without the mean of the left eye's pictures where there are two."""
    return background if background is None or not eye.eye_m else Background(None, background.strength)


def check_eyes(scene: Scene, *, at_surface: bool) -> None:
    """Raise `SceneError` where a scene needs a stage that both eyes do not have. at_surface: whether its plan does."""
    if scene.plate.eye == "both" and at_surface:
        raise SceneError(
            "scene",
            [
                "surface - bodies that the water's surface cuts or mirrors are drawn from one point, not for both eyes "
                '(got plate.eye = "both") - place the objects deeper, or set surface.objects = "none"'
            ],
        )
