# SPDX-License-Identifier: Apache-2.0
"""Poses of a shot: of its key frames by structure from motion or rotations alone, of all frames from these."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mr360uw.errors import ParameterError
from mr360uw.progress import Steps
from mr360uw.sphere import direction_from_frame
from mr360uw.track.bearings import Matches, average_rotations, classify
from mr360uw.track.camera_track import Kind
from mr360uw.track.colmap import match_features
from mr360uw.track.key_frames import KeyFrames, grey_picture
from mr360uw.track.resection import Landmarks, follow, resect
from mr360uw.track.structure import held_out_errors, solve_structure
from mr360uw.types import Floats
from mr360uw.video import VideoReader

BETWEEN = 2
"""Steps of progress that a frame between key frames takes, over reading a frame."""


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
        pose = resect(marks, seen, position[n], rotation[n], pixel_rad)
        if pose is not None:
            position[n], rotation[n], residual[n] = pose[0], pose[1], pose[2] / pixel_rad
    return position, rotation, residual, np.concatenate(observed)


def _interpolated(time_s: Floats, poses: KeyPoses) -> tuple[Floats, Floats]:
    """Return positions by a monotone cubic and rotations by slerp at all times, at rest beyond the solved keys."""
    from scipy.interpolate import PchipInterpolator
    from scipy.spatial.transform import Rotation, Slerp

    at = time_s[poses.index]
    clamped = np.clip(time_s, at[0], at[-1])
    position = np.asarray(PchipInterpolator(at, poses.position)(clamped))
    return position, np.asarray(Slerp(at, Rotation.from_matrix(poses.rotation))(clamped).as_matrix())


_LANDMARKS = 600
"""Most features that are followed from a key frame; more take longer and change the pose by less than 0.001 degree."""
_LEAST_SOLVED = 0.5
"""Least share of key frames that must be solved."""
_LEAST_MATCHED = 0.5
"""Least share of key frames that must be matched with another."""


@dataclass(frozen=True, slots=True, eq=False)
class KeyPoses:
    """Solved key frames: numbers (k,), positions (k, 3), rotations (k, 3, 3), residuals (k,) [px], landmarks of each.

    points (m, 3), error_px (m,): of the scene. held_out: see `held_out_errors`, of a camera that moves.
    """

    kind: Kind
    index: NDArray[np.int64]
    paths: tuple[Path, ...]
    position: Floats
    rotation: Floats
    residual_px: Floats
    landmarks: tuple[Landmarks, ...]
    points: Floats
    error_px: Floats
    held_out: tuple[Floats, Floats] | None


def solve_key_frames(
    where: str, keys: KeyFrames, left_out: NDArray[np.bool_] | None, folder: Path, steps: Steps, *, mask_only: bool
) -> KeyPoses:
    """Return the poses of a shot's key frames.

    where: names the shot in messages. left_out: (H, W), where nothing is tracked. mask_only: also track what moves with
    the camera. folder: for files, some of which a run before may have left there. Raises `ParameterError` where the
    pictures do not tell a path.
    """
    pixels, matches = _matched(where, keys, left_out, folder, steps, mask_only=mask_only)
    kind = classify(matches, 2.0 * np.pi / keys.width)
    return _moving(where, keys, folder, steps) if kind == "moving" else _resting(kind, keys, pixels, matches)


def _matched(
    where: str, keys: KeyFrames, left_out: NDArray[np.bool_] | None, folder: Path, steps: Steps, *, mask_only: bool
) -> tuple[tuple[Floats, ...], Matches]:
    """Return what `match_features` does; raise `ParameterError` where too few key frames match another."""
    import cv2

    mask = keys.fixed.copy() if keys.fixed.size and not mask_only else np.zeros((keys.height, keys.width), bool)
    if left_out is not None:
        size = (keys.width, keys.height)
        mask |= cv2.resize(left_out.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST).astype(bool)
    path = folder / "mask.png"
    cv2.imwrite(str(path), np.where(mask, 0, 255).astype(np.uint8))
    pixels, matches = match_features(keys.paths, path, keys.width, keys.height, folder, steps, riding=mask_only)
    matched = {i for pair in matches for i in pair}
    if len(matched) < max(2, _LEAST_MATCHED * len(keys.index)):
        raise ParameterError(
            f"{where} - too few features are seen again (got {len(matched)} of {len(keys.index)} key frames) - give a "
            "clip that shows more of the floor or a reef, or a smaller mask"
        )
    return pixels, matches


def _moving(where: str, keys: KeyFrames, folder: Path, steps: Steps) -> KeyPoses:
    """Return the key frames of a camera that moves, by structure from motion."""
    scene = solve_structure(keys.paths, folder, steps)
    if scene is None or np.mean(scene.solved) < _LEAST_SOLVED:
        count = 0 if scene is None else int(np.count_nonzero(scene.solved))
        raise ParameterError(
            f"{where} - no path explains its pictures (got {count} of {len(keys.index)} key frames) - cut it where the "
            "scene changes, mask what moves with the camera, or give a clip with more texture"
        )
    kept = np.flatnonzero(scene.solved)
    landmarks = []
    for k in kept:
        order = np.argsort(scene.error_px[scene.point[k]], kind="stable")[:_LANDMARKS]
        landmarks.append(Landmarks(scene.pixel[k][order], scene.points[scene.point[k][order]], far=False))
    return KeyPoses(
        "moving", keys.index[kept], tuple(keys.paths[k] for k in kept), scene.position[kept], scene.rotation[kept],
        scene.residual_px[kept], tuple(landmarks), scene.points, scene.error_px,
        held_out_errors(scene),
    )  # fmt: skip


def _resting(kind: Kind, keys: KeyFrames, pixels: tuple[Floats, ...], matches: Matches) -> KeyPoses:
    """Return the key frames of a camera that stands still or turns on the spot, by rotations alone."""
    count, pixel_rad = len(keys.index), 2.0 * np.pi / keys.width
    rotation: Floats = np.repeat(np.eye(3)[None], count, axis=0)
    if kind == "turning":
        rotation = average_rotations(count, matches, pixel_rad)
    residual: list[list[float]] = [[] for _ in range(count)]
    for (i, j), (a, b) in matches.items():
        chord = np.linalg.norm(a @ rotation[i].T - b @ rotation[j].T, axis=1)
        for k in (i, j):
            residual[k].append(float(np.median(chord)) / pixel_rad)
    landmarks = []
    for k in range(count):
        every = pixels[k][:: max(1, len(pixels[k]) // _LANDMARKS)]
        directions = direction_from_frame(every[:, 0], every[:, 1], keys.width, keys.height)
        landmarks.append(Landmarks(every, directions @ rotation[k].T, far=True))
    medians = np.array([np.median(r) if r else np.nan for r in residual])
    return KeyPoses(
        kind, keys.index, keys.paths, np.zeros((count, 3)), rotation, medians, tuple(landmarks), np.zeros((0, 3)),
        np.zeros(0), None,
    )  # fmt: skip
