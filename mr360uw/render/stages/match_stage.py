# SPDX-License-Identifier: Apache-2.0
"""Match stage: the look of a plate, measured at fixed frames of its clip, on the bodies of a frame's layer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mr360uw.cache import Cache
from mr360uw.color import code_range, encode, ycbcr_from_rgb
from mr360uw.composite.grading.plate_grade import PlateGrade
from mr360uw.errors import DamagedFrameError
from mr360uw.render.loaded import Loaded
from mr360uw.types import Floats, Layer
from mr360uw.video import VideoFrame, VideoReader

FRAMES = 5
"""Frames of a clip whose look is measured, evenly spread; each is the keyframe before its place."""


def clip_look(loaded: Loaded, video: VideoReader) -> PlateGrade | None:
    """Return the look of a clip's plate; None where the plan measures none, or no frame of these can be decoded.

    The frames depend on the clip alone, so that any range of it has one look. Raises `VideoError`.
    """
    if not loaded.plan.match.runs or not loaded.scene.match.measures:
        return None
    count = video.intact_frames or video.frame_count or 1
    places = [video.entry_before(int(index)) for index in np.linspace(0, count - 1, FRAMES)]
    seen = []
    for index in dict.fromkeys(places):
        try:
            seen.append(next(iter(video.frames(index, index + 1))))
        except DamagedFrameError:
            continue
    return look_of(seen) if seen else None


def look_of(frames: list[VideoFrame]) -> PlateGrade:
    """Return the look of a plate's frames."""
    from mr360uw.composite.grading.point_spread import point_spread

    return replace(point_spread([_luma(frame) for frame in frames]), columns=frames[0].shape[1])


def asked_look(loaded: Loaded, look: PlateGrade | None, plate: VideoFrame, layer: Layer, kept: Cache) -> PlateGrade:
    """Return the look that bodies of a frame's layer are given; one that changes nothing where the plan has none.

    look: of the clip; None measures it in this frame alone. kept: holds the look of the frame measured last.
    """
    scene = loaded.scene
    if not loaded.plan.match.runs or not any(np.any(tile.alpha > 0.0) for tile in layer.tiles):
        return PlateGrade()
    if look is None:
        look = kept.get("look", plate, lambda: look_of([plate])) if scene.match.measures else PlateGrade()
    return look.of_scene(scene.match, loaded.width, scene.plate.scale)


def with_look(layer: Layer, look: PlateGrade, plate: VideoFrame) -> Layer:
    """Return a frame's layer whose bodies have a look; the layer itself where the look changes nothing."""
    if not look.changes:
        return layer
    from mr360uw.composite.grading.matched_layer import matched_layer

    return matched_layer(layer, look, plate.linear)


def _luma(frame: VideoFrame) -> Floats:
    """Return the luma (H, W) of a frame in 8-bit code values, sRGB where it has none of its own."""
    if frame.yuv is not None:
        offset, span, _, _ = code_range(frame.yuv.spec)
        return (frame.yuv.y.astype(np.float32) - np.float32(offset)) * np.float32(255.0 / span)
    weights = 255.0 * ycbcr_from_rgb("bt709")[0]
    return np.asarray(encode(frame.image_linear, "srgb") @ weights, np.float32)
