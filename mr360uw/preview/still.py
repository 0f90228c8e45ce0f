# SPDX-License-Identifier: Apache-2.0
"""One composited frame of a scene, whole or as the view of an ordinary camera into it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from mr360uw.color import in_plate_primaries
from mr360uw.errors import ParameterError
from mr360uw.output_gate import check_outputs
from mr360uw.preview.live import LivePreview
from mr360uw.preview.perspective import Perspective, look
from mr360uw.reading.input_files import files_read
from mr360uw.scene.inputs import open_plate
from mr360uw.scene.model import Scene, files_of
from mr360uw.video import VideoFrame
from mr360uw.video.pixels.rgb import codes_from_linear
from mr360uw.video.read.projection import PICTURE_SUFFIXES
from mr360uw.video.video_frame import whole_frame
from mr360uw.video.write.image_writer import write_picture

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
