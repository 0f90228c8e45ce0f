# SPDX-License-Identifier: Apache-2.0
"""One composited frame of a scene, whole or as the view of an ordinary camera into it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from mr360uw.color import in_plate_primaries
from mr360uw.errors import ParameterError
from mr360uw.output_gate import check_outputs
from mr360uw.preview.live import LivePreview
from mr360uw.reading.input_files import files_read
from mr360uw.scene.inputs import open_plate
from mr360uw.scene.model import Scene, files_of
from mr360uw.sphere import frame_from_direction, yaw_matrix
from mr360uw.types import Floats
from mr360uw.video import VideoFrame
from mr360uw.video.pixels.rgb import codes_from_linear
from mr360uw.video.read.projection import PICTURE_SUFFIXES
from mr360uw.video.video_frame import whole_frame
from mr360uw.video.write.image_writer import write_picture

_MARGIN = 4
"""Pixels that are repeated around the panorama, for the cubic filter and the step over its seam."""


@dataclass(frozen=True, slots=True)
class Perspective:
    """Direction and field of view of a picture without distortion.

    yaw_deg: of its centre, 0 = ahead, + = right. pitch_deg: + = up. fov_deg: from its left to its right edge.
    """

    yaw_deg: float = 0.0
    pitch_deg: float = 0.0
    fov_deg: float = 75.0
    width: int = 1280
    height: int = 720

    def __post_init__(self) -> None:
        for name, low, high, unit in (
            ("yaw_deg", -360.0, 360.0, "deg"),
            ("pitch_deg", -90.0, 90.0, "deg"),
            ("fov_deg", 1.0, 150.0, "deg"),
            ("width", 16, 16384, "pixels"),
            ("height", 16, 16384, "pixels"),
        ):
            value = getattr(self, name)
            if not low <= value <= high:
                raise ParameterError(f"view.{name} - must be in [{low:g}, {high:g}] {unit} (got {value}) - change it")

    def directions(self) -> Floats:
        """Return the unit direction of every pixel's centre, (height, width, 3)."""
        return self.direction_at(np.arange(self.width) + 0.5, (np.arange(self.height) + 0.5)[:, None])

    def direction_at(self, x: ArrayLike, y: ArrayLike) -> Floats:
        """Return the unit directions (..., 3) seen at continuous coordinates, pixel centres at i + .5."""
        across = self._reach * (np.asarray(x, np.float64) / (0.5 * self.width) - 1.0)
        up = self._reach * (self.height - 2.0 * np.asarray(y, np.float64)) / self.width
        ray = np.stack(np.broadcast_arrays(across, up, -1.0), axis=-1)
        ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
        return np.asarray(ray @ self._rotation.T)

    @property
    def _reach(self) -> float:
        """Tangent of half the field of view."""
        return float(np.tan(0.5 * np.radians(self.fov_deg)))

    @property
    def _rotation(self) -> Floats:
        """Rotation (3, 3) from the view's axes to the panorama's: pitch, then yaw."""
        c, s = np.cos(np.radians(self.pitch_deg)), np.sin(np.radians(self.pitch_deg))
        return yaw_matrix(np.radians(self.yaw_deg)) @ np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def look(panorama: Floats, view: Perspective) -> Floats:
    """Return the view (height, width, 3) float32 of a panorama (H, 2 H, 3) of linear light.

    Cubic interpolation; where the view is coarser than the panorama, the panorama is reduced first. Values are not
    less than 0.
    """
    import cv2

    pixel = 2.0 * np.tan(0.5 * np.radians(view.fov_deg)) / view.width  # at the centre, where it is largest
    factor = min(1.0, (np.pi / panorama.shape[0]) / pixel)
    image = np.asarray(panorama, np.float32)
    if factor < 1.0:
        rows = max(8, round(factor * panorama.shape[0]))
        image = np.asarray(cv2.resize(image, (2 * rows, rows), interpolation=cv2.INTER_AREA))
    height, width = image.shape[:2]
    x, y = frame_from_direction(view.directions(), width, height)
    # beyond a pole a panorama goes on half a turn away
    over = np.roll(image, width // 2, axis=1)
    tall = np.concatenate([over[:_MARGIN][::-1], image, over[-_MARGIN:][::-1]])
    around = cv2.copyMakeBorder(tall, 0, 0, _MARGIN, _MARGIN, cv2.BORDER_WRAP)
    where = ((x + _MARGIN - 0.5).astype(np.float32), (y + _MARGIN - 0.5).astype(np.float32))
    seen = cv2.remap(around, *where, cv2.INTER_CUBIC)
    return np.maximum(seen, np.float32(0.0))


_LATEST_S = 1e6
"""Largest time within a clip [s]: eleven days."""


def still_of(
    live: LivePreview,
    scene: Scene,
    *,
    frame: int | None = None,
    time_s: float | None = None,
    view: Perspective | None = None,
) -> VideoFrame:
    """Return one composited frame of a scene's plate, the left eye's with the right one of two, or a view into it.

    frame: its number, as a sequence's files are numbered; or time_s, for the frame that is shown then. The sun and the
    veil are measured in this frame alone; a composite of the clip takes them from all of it, so that its light may
    differ a little. Raises what `composite_video` raises.
    """
    if frame is not None and time_s is not None:
        raise ParameterError("frame, time_s - say the same thing (got both) - give one of them")
    index = 0 if not frame else live.plates.reader(scene).numbered_range(frame, frame + 1)[0]
    if time_s is not None and not 0.0 <= time_s <= _LATEST_S:
        raise ParameterError(f"time_s - is no time of a clip (got {time_s:g}) - give seconds from its start, 0 or more")
    if time_s is not None:
        index = int(time_s * float(live.clip(scene).frame_rate) + 1e-6)
    picture = live.frame(scene, index).picture
    return picture if view is None else _seen(picture, view)


Still = Callable[[LivePreview, Scene], VideoFrame]
"""`still_of` with its frame or time and its view given."""


def save_still(
    path: Path, scene: Scene, still: Still = still_of, *, backend: str = "auto", overwrite: bool = False
) -> None:
    """Write a still as a picture, whose kind follows the suffix.

    Raises `ParameterError` where the name is no picture's, `OutputExistsError` where it is there, unless `overwrite`,
    and `OutputError`.
    """
    if path.suffix.lower() not in PICTURE_SUFFIXES:
        raise ParameterError(f"{path} - is no name of a picture (got {path.suffix!r}) - end it in .png, .jpg or .exr")
    check_outputs([path], inputs=files_of(scene), overwrite=overwrite)
    with files_read() as read, LivePreview(backend) as live:
        picture = still(live, scene)
    check_outputs([path], inputs=read, overwrite=overwrite)  # textures and the like, which only meshes name
    with open_plate(scene) as plate:
        write_picture(path, whole_frame(picture, plate.stereo))


def _seen(picture: VideoFrame, view: Perspective) -> VideoFrame:
    """Return a view into a frame, in the frame's own codes."""
    light, spec = look(picture.image_linear, view), picture.spec
    values = light if spec.mapping is None else in_plate_primaries(light, spec)
    if spec.bits == 32:
        return replace(picture, yuv=None, native=None, rgb=values, wrap=False, right=None, clipped=())
    bits = 8 if spec.bits == 8 else 16
    own = replace(spec, matrix="bt709", bits=bits, primaries=None)
    codes = codes_from_linear(values, spec.transfer, f"uint{bits}", picture.index)
    return replace(picture, yuv=None, native=None, rgb=codes, spec=own, wrap=False, right=None, clipped=())
