# SPDX-License-Identifier: Apache-2.0
"""Tracks the camera of a clip: reads it twice, solves key frames, then the frames between."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mr360uw.errors import ParameterError, VideoError
from mr360uw.progress import Progress
from mr360uw.sphere import direction_from_frame
from mr360uw.track.bearings import average_rotations, classify
from mr360uw.track.camera_track import CameraTrack, Kind
from mr360uw.track.colmap import Features, load_colmap, match_features, solve_structure
from mr360uw.track.key_frames import KeyFrames, grey_picture, read_key_frames
from mr360uw.track.resection import Landmarks, Pose, follow, resect
from mr360uw.track.world_axes import World, world_of
from mr360uw.types import Floats
from mr360uw.video import VideoReader, open_video

_LANDMARKS = 600
"""Most features that are followed from a key frame; more take longer and change the pose by less than 0.001 degree."""
_LEAST_SOLVED = 0.5
"""Least share of key frames that must be solved."""
_LEAST_MATCHED = 0.5
"""Least share of key frames that must be matched with another."""


@dataclass(frozen=True, slots=True, eq=False)
class KeyPoses:
    """Solved key frames: numbers (k,), positions (k, 3), rotations (k, 3, 3), residuals (k,) [px], landmarks of each.

    points (m, 3), error_px (m,): of the scene.
    """

    index: NDArray[np.int64]
    paths: tuple[Path, ...]
    position: Floats
    rotation: Floats
    residual_px: Floats
    landmarks: tuple[Landmarks, ...]
    points: Floats
    error_px: Floats


def track_camera(
    video: str | Path,
    *,
    height_m: float | None = None,
    mask: str | Path | None = None,
    eye: Literal["left", "right"] | None = None,
    progress: Progress | None = None,
) -> CameraTrack:
    """Return the path of the camera of a 360 clip, solved from its pictures.

    height_m: of the camera over the floor at time 0; sets the scale, which pictures alone do not tell. mask: picture of
    the clip's size, black where nothing is tracked; what stands still in a picture that moves is left out anyway. eye:
    of a stereo plate. progress: is called with (steps done, all of them), about three for a frame.

    Raises `Mr360uwError` without pycolmap, `VideoError`, and `ParameterError` for clips that cannot be tracked.
    """
    load_colmap()
    if height_m is not None and not (np.isfinite(height_m) and height_m > 0.0):
        raise ParameterError(f"--height - must be more than 0 (got {height_m}) - give metres over the floor")
    with open_video(video, eye=eye) as clip, tempfile.TemporaryDirectory(prefix="mr360uw-track-") as folder:
        left_out = None if mask is None else _read_mask(Path(mask), clip)
        tell = _steps(progress, 2 * (clip.frame_count or 0))
        keys = read_key_frames(clip, _new(Path(folder) / "keys"), tell)
        matched = _matched(keys, left_out, Path(folder), tell)
        step = 2.0 * np.pi / keys.width
        kind = classify(matched.matches, step)
        solve = _moving if kind == "moving" else _turning
        poses = solve(kind, keys, matched, Path(folder), tell)
        frames = _between(clip, keys, poses, kind, tell)
    gravity = _gravity_up(Path(video), float(clip.frame_rate), keys.time_s)
    return _in_world(kind, keys, poses, frames, world_of(*frames[:2], poses.points, gravity, height_m))


def _new(folder: Path) -> Path:
    folder.mkdir()
    return folder


def _steps(progress: Progress | None, total: int) -> Iterator[None]:
    """Yield without end; each time `progress` is told of one more step, of `total` at least."""
    done = 0
    while True:
        done += 1
        if progress is not None:
            progress(done, max(total, done))
        yield


def _read_mask(path: Path, clip: VideoReader) -> NDArray[np.bool_]:
    """Return where a mask is black (H, W); raise `ParameterError` where it has not the clip's size."""
    from mr360uw.video import read_picture

    picture = read_picture(path)
    if picture.shape[:2] != (clip.height, clip.width):
        raise ParameterError(
            f"{path} - the mask has another size than the clip (got {picture.shape[1]}x{picture.shape[0]}) - make it "
            f"{clip.width}x{clip.height}"
        )
    light = picture if picture.ndim == 2 else picture[..., :3].max(axis=-1)
    half = 0.5 * np.iinfo(light.dtype).max if np.issubdtype(light.dtype, np.integer) else 0.5
    return np.asarray(light < half)


def _matched(keys: KeyFrames, left_out: NDArray[np.bool_] | None, folder: Path, tell: Iterator[None]) -> Features:
    """Return the matched features of key frames; raise `ParameterError` where too few match."""
    import cv2

    mask = keys.fixed.copy()
    if left_out is not None:
        size = (keys.width, keys.height)
        mask |= cv2.resize(left_out.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST).astype(bool)
    path = folder / "mask.png"
    cv2.imwrite(str(path), np.where(mask, 0, 255).astype(np.uint8))
    found = match_features(keys.paths, path, keys.width, keys.height, folder / "matches.db", tell)
    matched = {i for pair in found.matches for i in pair}
    if len(matched) < max(2, _LEAST_MATCHED * len(keys.index)):
        raise ParameterError(
            f"clip - too few features are seen again (got {len(matched)} of {len(keys.index)} key frames) - give a "
            "clip that shows more of the floor or a reef, or a smaller mask"
        )
    return found


def _moving(kind: Kind, keys: KeyFrames, features: Features, folder: Path, tell: Iterator[None]) -> KeyPoses:
    """Return the key frames of a camera that moves, by structure from motion."""
    del kind, features
    scene = solve_structure(keys.paths, folder / "matches.db", _new(folder / "scene"), lambda: next(tell))
    if scene is None or np.mean(scene.solved) < _LEAST_SOLVED:
        count = 0 if scene is None else int(np.count_nonzero(scene.solved))
        raise ParameterError(
            f"clip - no path explains its pictures (got {count} of {len(keys.index)} key frames) - cut it where the "
            "scene changes, mask what moves with the camera, or give a clip with more texture"
        )
    kept = np.flatnonzero(scene.solved)
    landmarks = []
    for k in kept:
        order = np.argsort(scene.error_px[scene.point[k]], kind="stable")[:_LANDMARKS]
        landmarks.append(Landmarks(scene.pixel[k][order], scene.points[scene.point[k][order]], far=False))
    return KeyPoses(
        keys.index[kept], tuple(keys.paths[k] for k in kept), scene.position[kept], scene.rotation[kept],
        scene.residual_px[kept], tuple(landmarks), scene.points, scene.error_px,
    )  # fmt: skip


def _turning(kind: Kind, keys: KeyFrames, features: Features, folder: Path, tell: Iterator[None]) -> KeyPoses:
    """Return the key frames of a camera that stands still or turns on the spot, by rotations alone."""
    del folder, tell
    count, pixel_rad = len(keys.index), 2.0 * np.pi / keys.width
    rotation: Floats = np.repeat(np.eye(3)[None], count, axis=0)
    if kind == "turning":
        rotation = average_rotations(count, features.matches, pixel_rad)
    residual: list[list[float]] = [[] for _ in range(count)]
    for (i, j), (a, b) in features.matches.items():
        chord = np.linalg.norm(a @ rotation[i].T - b @ rotation[j].T, axis=1)
        for k in (i, j):
            residual[k].append(float(np.median(chord)) / pixel_rad)
    landmarks = []
    for k in range(count):
        every = features.pixel[k][:: max(1, len(features.pixel[k]) // _LANDMARKS)]
        directions = direction_from_frame(every[:, 0], every[:, 1], keys.width, keys.height)
        landmarks.append(Landmarks(every, directions @ rotation[k].T, far=True))
    medians = np.array([np.median(r) if r else np.nan for r in residual])
    return KeyPoses(
        keys.index, keys.paths, np.zeros((count, 3)), rotation, medians, tuple(landmarks), np.zeros((0, 3)), np.zeros(0)
    )


def _between(
    clip: VideoReader, keys: KeyFrames, poses: KeyPoses, kind: Kind, tell: Iterator[None]
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return positions, rotations and residuals [px] of all frames, and the directions that were observed."""
    import cv2

    position, rotation = _interpolated(keys.time_s, poses)
    residual = np.full(len(keys.time_s), np.nan)
    residual[poses.index] = poses.residual_px
    observed = [
        direction_from_frame(marks.pixel[:, 0], marks.pixel[:, 1], keys.width, keys.height) for marks in poses.landmarks
    ]
    pixel_rad = 2.0 * np.pi / keys.width
    solved = set(poses.index.tolist())
    held: tuple[int, NDArray[np.uint8]] | None = None
    for frame in clip.frames():
        next(tell)
        n = frame.index
        if kind == "still":
            continue
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
    if kind == "still":
        residual = np.interp(np.arange(len(residual)), poses.index, np.nan_to_num(poses.residual_px))
    return position, rotation, residual, np.concatenate(observed)


def _interpolated(time_s: Floats, poses: KeyPoses) -> tuple[Floats, Floats]:
    """Return positions by a monotone cubic and rotations by slerp at all times, at rest beyond the solved keys."""
    from scipy.interpolate import PchipInterpolator
    from scipy.spatial.transform import Rotation, Slerp

    at = time_s[poses.index]
    clamped = np.clip(time_s, at[0], at[-1])
    position = np.asarray(PchipInterpolator(at, poses.position)(clamped))
    return position, np.asarray(Slerp(at, Rotation.from_matrix(poses.rotation))(clamped).as_matrix())


def _gravity_up(video: Path, frame_rate: float, time_s: Floats) -> Floats | None:
    """Return up in the camera's axes (n, 3) of a GoPro's gravity, or None where the clip has no such track."""
    from mr360uw.ibl.level.tilt import level_from_gpmf
    from mr360uw.video.metadata.gpmf import gpmf_payloads

    try:
        level = level_from_gpmf(gpmf_payloads(video), frame_rate)
    except (VideoError, ParameterError):  # clips of other cameras have none
        return None
    return np.stack([level.at(float(t))[1] for t in time_s])


def _in_world(
    kind: Kind, keys: KeyFrames, poses: KeyPoses, frames: tuple[Floats, Floats, Floats, Floats], world: World
) -> CameraTrack:
    """Return the track of all frames in the world's axes."""
    position, rotation, residual, observed = frames
    cell = np.floor(np.stack([
        12.0 * (np.arctan2(observed[:, 0], -observed[:, 2]) / (2.0 * np.pi) + 0.5), 6.0 * (0.5 - 0.5 * observed[:, 1])
    ])).astype(int)  # fmt: skip
    coverage = len(np.unique(np.clip(cell[0], 0, 11) * 6 + np.clip(cell[1], 0, 5))) / 72.0
    return CameraTrack(
        kind, keys.time_s, world.place(position), world.rotation @ rotation, residual, residual * 360.0 / keys.width,
        poses.index, world.place(poses.points), poses.error_px, coverage, keys.width, world.floor, world.up,
        world.scale_from,
    )  # fmt: skip
