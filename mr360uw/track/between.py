# SPDX-License-Identifier: Apache-2.0
"""Poses of all frames of a shot from those of its key frames."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mr360uw.sphere import direction_from_frame
from mr360uw.track.key_frames import KeyFrames, grey_picture
from mr360uw.track.key_poses import KeyPoses
from mr360uw.track.resection import Pose, follow, resect
from mr360uw.track.steps import BETWEEN, Steps
from mr360uw.types import Floats
from mr360uw.video import VideoReader


def solve_between(
    clip: VideoReader, keys: KeyFrames, poses: KeyPoses, steps: Steps
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return positions, rotations and residuals [px] of all frames, and the directions that were observed."""
    import cv2

    position, rotation = _interpolated(keys.time_s, poses)
    residual = np.full(len(keys.time_s), np.nan)
    residual[poses.index] = poses.residual_px
    observed = [
        direction_from_frame(marks.pixel[:, 0], marks.pixel[:, 1], keys.width, keys.height) for marks in poses.landmarks
    ]
    if poses.kind == "still":
        residual = np.interp(np.arange(len(residual)), poses.index, np.nan_to_num(poses.residual_px))
        return position, rotation, residual, np.concatenate(observed)
    pixel_rad = 2.0 * np.pi / keys.width
    solved = set(poses.index.tolist())
    held: tuple[int, NDArray[np.uint8]] | None = None
    for frame in clip.frames(keys.first, keys.first + len(keys.time_s)):
        steps.done(BETWEEN)
        n = frame.index - keys.first
        nearest = int(np.argmin(np.abs(poses.index - n)))
        if n in solved or abs(int(poses.index[nearest]) - n) > float(clip.frame_rate):
            continue
        if held is None or held[0] != nearest:
            held = nearest, np.asarray(cv2.imread(str(poses.paths[nearest]), cv2.IMREAD_GRAYSCALE), np.uint8)
        marks, seen = follow(held[1], grey_picture(frame), poses.landmarks[nearest], position[n], rotation[n])
        pose: Pose | None = resect(marks, seen, position[n], rotation[n], pixel_rad)
        if pose is not None:
            position[n], rotation[n] = pose.position, pose.rotation
            residual[n] = pose.residual_rad / pixel_rad
    return position, rotation, residual, np.concatenate(observed)


def _interpolated(time_s: Floats, poses: KeyPoses) -> tuple[Floats, Floats]:
    """Return positions by a monotone cubic and rotations by slerp at all times, at rest beyond the solved keys."""
    from scipy.interpolate import PchipInterpolator
    from scipy.spatial.transform import Rotation, Slerp

    at = time_s[poses.index]
    clamped = np.clip(time_s, at[0], at[-1])
    position = np.asarray(PchipInterpolator(at, poses.position)(clamped))
    return position, np.asarray(Slerp(at, Rotation.from_matrix(poses.rotation))(clamped).as_matrix())
