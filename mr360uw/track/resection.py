# SPDX-License-Identifier: Apache-2.0
"""Poses of the frames between key frames: features are followed from the nearest key frame, then the pose is solved.

Features are followed by pyramidal optical flow (Lucas & Kanade 1981) that starts where the interpolated pose predicts
them. The pose minimises the distances between observed and predicted unit directions, by Gauss-Newton with Cauchy
weights, so that features on fish and caustics have little effect.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mr360uw.sphere import direction_from_frame, frame_from_direction
from mr360uw.types import Floats

_STEPS = 12
_WINDOW = 15
"""Side [px] of the patches that are followed. Half: noise moves them; double: they bend with the panorama."""
_EDGE_PX = 12
"""Features this near to the frame's edges are left out, where the patches end."""
_LARGEST_LATITUDE = np.radians(72.0)
"""Nearer to the poles [rad] the panorama is stretched by more than 3 and patches change their shape."""
LEAST_FEATURES = 12
"""Fewest agreeing features of a pose that is used; a frame with fewer keeps the interpolated one."""


@dataclass(frozen=True, slots=True, eq=False)
class Landmarks:
    """Features of a key frame: pixel (n, 2), and points (n, 3) in the world, or directions if they are far away."""

    pixel: Floats
    point: Floats
    far: bool


def predicted(landmarks: Landmarks, position: Floats, rotation: Floats) -> Floats:
    """Return the vectors (n, 3) from a camera to landmarks, in camera axes."""
    seen: Floats = (landmarks.point if landmarks.far else landmarks.point - position) @ rotation
    return seen


def resect(
    landmarks: Landmarks, observed: Floats, position: Floats, rotation: Floats, scale_rad: float
) -> tuple[Floats, Floats, float] | None:
    """Return position (3,), rotation (3, 3) and median residual [rad] of the camera that sees landmarks in the
    observed directions (n, 3); None if fewer than 12 agree.

    position, rotation: start. Far landmarks leave the position as it is. scale_rad: residual at which a weight is
    half.
    """
    from scipy.spatial.transform import Rotation

    if len(observed) < LEAST_FEATURES:
        return None
    for _ in range(_STEPS):
        seen = predicted(landmarks, position, rotation)
        distance = np.maximum(np.linalg.norm(seen, axis=1), 1e-9)
        direction = seen / distance[:, None]
        error = observed - direction
        weight = 1.0 / (1.0 + np.sum(np.square(error), axis=1) / scale_rad**2)
        turn = _cross_matrix(direction)  # of a small rotation after `rotation`
        jacobian = turn
        if not landmarks.far:
            across = np.eye(3) - direction[:, :, None] * direction[:, None, :]
            shift = -across @ rotation.T / distance[:, None, None]
            jacobian = np.concatenate([turn, shift], axis=2)
        normal = np.einsum("n,nij,nik->jk", weight, jacobian, jacobian)
        normal[np.diag_indices_from(normal)] *= 1.0 + 1e-9
        step = np.linalg.lstsq(normal, np.einsum("n,nij,ni->j", weight, jacobian, error), rcond=None)[0]
        rotation = rotation @ Rotation.from_rotvec(step[:3]).as_matrix()
        if not landmarks.far:
            position = position + step[3:]
        if np.abs(step).max() < 1e-9:
            break
    seen = predicted(landmarks, position, rotation)
    residual = np.linalg.norm(observed - seen / np.linalg.norm(seen, axis=1, keepdims=True), axis=1)
    agree = residual < 3.0 * scale_rad
    if np.count_nonzero(agree) < LEAST_FEATURES or not np.all(np.isfinite(position)):
        return None
    return position, rotation, float(np.median(residual[agree]))


def _cross_matrix(vector: Floats) -> Floats:
    """Return matrices (n, 3, 3) with M w = v x w."""
    matrix = np.zeros((len(vector), 3, 3))
    x, y, z = vector.T
    matrix[:, 0, 1], matrix[:, 0, 2], matrix[:, 1, 2] = -z, y, -x
    matrix[:, 1, 0], matrix[:, 2, 0], matrix[:, 2, 1] = z, -y, x
    return matrix


def follow(
    key: np.ndarray, grey: np.ndarray, landmarks: Landmarks, position: Floats, rotation: Floats
) -> tuple[Landmarks, Floats]:
    """Return the landmarks of a key frame that are found in another frame, and their directions (n, 3) there.

    key, grey: both frames (H, W), uint8. position, rotation: pose of the other frame, as interpolated.
    """
    import cv2

    height, width = grey.shape
    x, y = frame_from_direction(predicted(landmarks, position, rotation), width, height)
    start = np.stack([x, y], axis=1)
    inside = np.abs(np.pi * (0.5 - y / height)) < _LARGEST_LATITUDE
    for place in (landmarks.pixel, start):
        inside &= (place[:, 0] > _EDGE_PX) & (place[:, 0] < width - _EDGE_PX)
    if not inside.any():
        return Landmarks(landmarks.pixel[:0], landmarks.point[:0], landmarks.far), np.zeros((0, 3))
    # OpenCV's coordinates are 0 at the centre of a pixel
    before = (landmarks.pixel[inside] - 0.5).astype(np.float32)[:, None]
    guess = (start[inside] - 0.5).astype(np.float32)[:, None].copy()
    after, found, _ = cv2.calcOpticalFlowPyrLK(
        key, grey, before, guess, winSize=(_WINDOW, _WINDOW), maxLevel=2, flags=cv2.OPTFLOW_USE_INITIAL_FLOW
    )
    good = found.ravel().astype(bool)
    place = after[good, 0].astype(np.float64) + 0.5
    kept = Landmarks(landmarks.pixel[inside][good], landmarks.point[inside][good], landmarks.far)
    return kept, direction_from_frame(place[:, 0], place[:, 1], width, height)
