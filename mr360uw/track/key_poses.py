# SPDX-License-Identifier: Apache-2.0
"""Poses of a shot: of its key frames by structure from motion or rotations alone, of all frames from these.

From the nearest key frame features are followed by pyramidal optical flow (Lucas & Kanade 1981) that starts where the
interpolated pose predicts them. The pose minimises the distances between observed and predicted unit directions, by
Gauss-Newton with Cauchy weights, so that features on fish and caustics have little effect.
"""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation, Slerp

from mr360uw.base.progress import Steps
from mr360uw.base.sphere import direction_from_frame, frame_from_direction
from mr360uw.errors import ParameterError
from mr360uw.track.camera_track import Kind
from mr360uw.track.colmap import (
    DATABASE,
    SEED,
    Matches,
    agreement,
    all_matches,
    at_rest,
    average_rotations,
    classify,
    match_features,
    quiet_colmap,
)
from mr360uw.track.key_frames import KeyFrames, grey_picture
from mr360uw.track.slip import cameras_of, settled_scenes
from mr360uw.types import Floats
from mr360uw.video import VideoReader

_STEPS = 12
_WINDOW = 15
"""Side [px] of the patches that are followed. Half: noise moves them; double: they bend with the panorama."""
_EDGE_PX = 12
"""Features this near to the frame's edges are left out, where the patches end."""
_LARGEST_LATITUDE = np.radians(72.0)
"""Nearer to the poles [rad] the panorama is stretched by more than 3 and patches change their shape."""
_LEAST_FEATURES = 12
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
    if len(observed) < _LEAST_FEATURES:
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
    if np.count_nonzero(agree) < _LEAST_FEATURES or not np.all(np.isfinite(position)):
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


BETWEEN = 2
"""Steps of progress that a frame between key frames takes, over reading a frame."""


def solve_between(
    clip: VideoReader, keys: KeyFrames, poses: KeyPoses, steps: Steps
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return positions, rotations and residuals [px] of all frames, and the directions that were observed."""
    # Interpolate the poses of key frames; that is all for a camera that stands still
    position, rotation = _interpolated(keys.time_s, poses)
    residual = np.full(len(keys.time_s), np.nan)
    residual[poses.index] = poses.residual_px
    observed = [
        direction_from_frame(marks.pixel[:, 0], marks.pixel[:, 1], keys.width, keys.height) for marks in poses.landmarks
    ]
    if poses.kind == "still":
        residual = np.interp(np.arange(len(residual)), poses.index, np.nan_to_num(poses.residual_px))
        return position, rotation, residual, np.concatenate(observed)
    # Follow the features of the nearest key frame into each frame, and resect its pose
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

    points (m, 3), error_px (m,): of the scene. held_out: see `held_out_errors`; empty unless the camera moves. agreed:
    of `colmap.agreement`, of a camera that moves. others: positions and rotations of them by `slip.settled_scenes`.
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
    held_out: tuple[Floats, Floats]
    agreed: float | None = None
    others: tuple[tuple[Floats, Floats], ...] = ()


MASK = "mask.png"
"""File of a shot's folder that is black where nothing is tracked."""


def solve_key_frames(
    where: str, keys: KeyFrames, left_out: NDArray[np.bool_] | None, folder: Path, steps: Steps, *, mask_only: bool
) -> KeyPoses:
    """Return the poses of a shot's key frames.

    where: names the shot in messages. left_out: (H, W), where nothing is tracked. mask_only: also track what moves with
    the camera. folder: for files, some of which a run before may have left there. Raises `ParameterError` where the
    pictures do not tell a path.
    """
    pixels, matches = match_features(
        keys.paths, _mask(keys, left_out, folder, mask_only=mask_only), keys.width, keys.height, folder, steps,
        riding=mask_only,
    )  # fmt: skip
    # Light that drifts over a camera at rest looks like a floor that passes by, but for what stands still among it
    every, pixel_rad = all_matches(keys.paths, folder, keys.width, keys.height), 2.0 * np.pi / keys.width
    time_s = keys.time_s[keys.index]
    resting = at_rest(every, time_s, pixel_rad)
    if resting is not None:
        return _resting("still", keys, pixels, resting)
    matched = {i for pair in matches for i in pair}
    if len(matched) < max(2, _LEAST_MATCHED * len(keys.index)):
        raise ParameterError(
            f"{where} - too few features are seen again (got {len(matched)} of {len(keys.index)} key frames) - give a "
            "clip that shows more of the floor or a reef, or a smaller mask"
        )
    kind = classify(matches, pixel_rad)
    if kind != "moving":
        return _resting(kind, keys, pixels, matches)
    # Hold the path against what is seen again some time later
    found = _moving(where, keys, folder, steps)
    solved = np.isin(keys.index, found.index)
    position, rotation = np.full((len(solved), 3), np.nan), np.full((len(solved), 3, 3), np.nan)
    position[solved], rotation[solved] = found.position, found.rotation
    return replace(found, agreed=agreement(every, time_s, pixel_rad, position, rotation))


def _mask(keys: KeyFrames, left_out: NDArray[np.bool_] | None, folder: Path, *, mask_only: bool) -> Path:
    """Write a picture that is black where nothing is tracked into a folder; return its file."""
    mask = keys.fixed.copy() if keys.fixed.size and not mask_only else np.zeros((keys.height, keys.width), bool)
    if left_out is not None:
        size = (keys.width, keys.height)
        mask |= cv2.resize(left_out.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST).astype(bool)
    path = folder / MASK
    cv2.imwrite(str(path), np.where(mask, 0, 255).astype(np.uint8))
    return path


def _moving(where: str, keys: KeyFrames, folder: Path, steps: Steps) -> KeyPoses:
    """Return the key frames of a camera that moves, by structure from motion."""
    # Map it, and hold to what is seen again; solve it from other features too
    least = _LEAST_SOLVED * len(keys.index)
    scenes: tuple[Any, ...] = (_solve_structure(keys.paths, folder, steps),)
    if scenes[0] is not None and scenes[0].num_reg_images() >= least:
        scenes = settled_scenes(scenes[0], keys, folder)
    count = 0 if scenes[0] is None else scenes[0].num_reg_images()
    if count < least:
        raise ParameterError(
            f"{where} - no path explains its pictures (got {count} of {len(keys.index)} key frames) - cut it where the "
            "scene changes, mask what moves with the camera, or give a clip with more texture"
        )
    poses = _poses_of_scene(scenes[0], keys)
    return replace(poses, others=tuple(cameras_of(scene, poses.paths) for scene in scenes[1:]))


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
        np.zeros(0), (np.zeros(0), np.zeros(0)),
    )  # fmt: skip


# Structure from motion of matched key frames, by COLMAP (Schoenberger & Frahm 2016).
#
# COLMAP's camera axes are right, down, forward; ours are right, up, back.
#
# The held-out error of a solved path is that of points from half of the key frames, looked for in the other half: how
# far an object that stands on such a point slips against the picture in frames that did not place it.

_MAPPED = 6
"""Steps of progress that a key frame in the map takes, over reading a frame."""
WIDTH = 2048
"""Width of the panorama [px] whose pixels the error is counted in."""
_ROUNDS = 4
"""Fits of a point, each weighted by the distances that the one before found."""
_LEAST_OBSERVED = 20
"""Least number of held-out features of a key frame that has a slip; half as many make its noise 1.4 times as large."""


def held_out_errors(
    position: Floats, rotation: Floats, seen: Sequence[Floats], numbers: Sequence[NDArray[np.int64]], points: Floats
) -> tuple[Floats, Floats]:
    """Return the errors of points from half of the key frames in the other half, for each key frame: slip and feature.

    position (k, 3), rotation (k, 3, 3): of the key frames. seen, numbers: directions (n, 3) in the axes of each, and
    the numbers (n,) of the points (m, 3) that are seen there.

    Both (k,) are in pixels of a panorama 2048 wide, NaN where too few points are seen. Slip: length of the median
    error, as a vector, of the features below the horizon: how far the ground as a whole, and a body on it, is off.
    Feature: median length of the errors of single features, which contains their noise.

    Points that at least two even key frames see are triangulated from these alone, and compared with where odd ones
    see them; then the other way round. Errors are in the tangent plane: along the parallel and along the meridian.
    """
    # List all observations by key frame, every other key frame held out
    count = len(position)
    frame = np.repeat(np.arange(count), [len(one) for one in numbers])
    point, own = np.concatenate(numbers), np.concatenate(seen)
    look = np.concatenate([one @ turn.T for one, turn in zip(seen, rotation, strict=True)])
    eye = position[frame]
    error = np.full((len(frame), 2), np.nan)
    # Triangulate from one half, measure in the other
    for parity in (0, 1):
        using = frame % 2 == parity
        place = triangulate(point[using], eye[using], look[using], len(points))
        towards = np.einsum("nji,nj->ni", rotation[frame[~using]], place[point[~using]] - eye[~using])
        error[~using] = _tangent(own[~using], towards) * WIDTH / (2.0 * np.pi)
    # Take medians for each key frame: of single features, and of the ground as a whole
    slip, feature = np.full(count, np.nan), np.full(count, np.nan)
    for k in range(count):
        known = (frame == k) & np.isfinite(error[:, 0])
        ground = known & (own[:, 1] < 0.0)
        if np.count_nonzero(known) >= _LEAST_OBSERVED:
            feature[k] = np.median(np.linalg.norm(error[known], axis=1))
        if np.count_nonzero(ground) >= _LEAST_OBSERVED:
            slip[k] = np.linalg.norm(np.median(error[ground], axis=0))
    return slip, feature


def _tangent(seen: Floats, towards: Floats) -> Floats:
    """Return errors (n, 2) [rad] of unit directions (n, 3) in camera axes: along the parallel and the meridian."""
    expected = towards / np.linalg.norm(towards, axis=1, keepdims=True)
    level = np.maximum(np.hypot(expected[:, 0], expected[:, 2]), 1e-9)
    east = np.stack([-expected[:, 2], np.zeros(len(expected)), expected[:, 0]], axis=1) / level[:, None]
    off = seen - expected
    return np.stack([np.sum(off * east, axis=1), np.sum(off * np.cross(east, expected), axis=1)], axis=1)


def triangulate(point: np.ndarray, eye: Floats, look: Floats, count: int) -> Floats:
    """Return the points (count, 3) nearest to their rays, by angle; NaN for points of fewer than two rays.

    point (n,): number of the point that each ray belongs to. eye, look (n, 3): origins and unit directions of rays.
    Solves sum w (1 - d d^T)(x - eye) = 0 for each point, with w = 1/distance^2.
    """
    across = np.eye(3) - look[:, :, None] * look[:, None, :]
    weight = np.ones(len(point))
    place = np.full((count, 3), np.nan)
    seen = np.bincount(point, minlength=count)
    known = seen >= 2
    for _ in range(_ROUNDS):
        normal, right = np.zeros((count, 3, 3)), np.zeros((count, 3))
        np.add.at(normal, point, weight[:, None, None] * across)
        np.add.at(right, point, weight[:, None] * np.einsum("nij,nj->ni", across, eye))
        trace = np.trace(normal, axis1=1, axis2=2)
        regular = known & (np.abs(np.linalg.det(normal)) > 1e-12 * np.maximum(trace, 1e-300) ** 3)
        place[:] = np.nan
        place[regular] = np.linalg.solve(normal[regular], right[regular][:, :, None])[:, :, 0]
        weight = np.nan_to_num(1.0 / np.maximum(np.sum(np.square(place[point] - eye), axis=1), 1e-18), nan=0.0)
    return place


_STARTS = ((8.0, 50, 1.5), (3.0, 50, 0.5), (3.0, 25, 0.5), (1.5, 20, 0.3))
"""Starts that are tried in this order: least angle [deg] between the rays to the points of the first two frames, their
fewest matches, and least angle [deg] of a point. Safe ones are first: short bases make bent paths."""
_ENOUGH = 0.9
"""Share of solved key frames from which no further start is tried."""
_LEAST_SEEN, _LEAST_SHARE = 15, 0.15
"""Fewest known points, and least share of a frame's matches, that place another frame."""


def _solve_structure(paths: tuple[Path, ...], folder: Path, steps: Steps) -> Any:
    """Return the scene of most key frames that COLMAP maps from their matches; None where it finds none.

    Starts are tried in a fixed order until nine tenths of the key frames are solved. folder: with COLMAP's
    database of matches.
    """
    best: Any = None
    steps.expect(_MAPPED * len(paths))
    with quiet_colmap() as pycolmap:
        for number, start in enumerate(_STARTS):
            into = folder / f"scene{number}"
            shutil.rmtree(into, ignore_errors=True)
            into.mkdir()
            found = pycolmap.incremental_mapping(
                folder / DATABASE, paths[0].parent, into, _mapping(pycolmap, *start),
                next_image_callback=lambda: steps.done(_MAPPED),
            )  # fmt: skip
            for scene in found.values():
                if best is None or scene.num_reg_images() > best.num_reg_images():
                    best = scene
            if best is not None and best.num_reg_images() >= _ENOUGH * len(paths):
                break
        return best


def _mapping(pycolmap: Any, angle_deg: float, matches: int, point_deg: float) -> Any:
    """Return COLMAP's options for one of `_STARTS`."""
    options = pycolmap.IncrementalPipelineOptions()
    options.multiple_models, options.extract_colors, options.min_model_size = False, False, 3
    options.num_threads, options.random_seed = 1, SEED
    options.ba_refine_focal_length = options.ba_refine_extra_params = False
    mapper = options.mapper
    mapper.init_min_tri_angle, mapper.init_min_num_inliers = angle_deg, matches
    mapper.init_max_forward_motion = 1.0  # points all around fix a base in any direction
    mapper.filter_max_reproj_error, mapper.abs_pose_max_error = 2.0, 6.0
    mapper.abs_pose_min_num_inliers, mapper.abs_pose_min_inlier_ratio = _LEAST_SEEN, _LEAST_SHARE
    options.triangulation.min_angle = mapper.filter_min_tri_angle = point_deg
    return options


def _poses_of_scene(scene: Any, keys: KeyFrames) -> KeyPoses:
    """Return a COLMAP reconstruction of key frames in our camera axes, and in arbitrary ones of the world and scale."""
    # Number the scene's points in order
    ids = sorted(scene.points3D)
    row = {point: index for index, point in enumerate(ids)}
    points = np.array([scene.points3D[i].xyz for i in ids]).reshape(-1, 3)
    error = np.array([scene.points3D[i].error for i in ids])
    # Take the poses of the images that were solved, in the order of the clip
    images = sorted((image for image in scene.images.values() if image.has_pose), key=lambda image: image.name)
    solved = {image.name for image in images}
    kept = [k for k, path in enumerate(keys.paths) if path.name in solved]
    paths = tuple(keys.paths[k] for k in kept)
    position, rotation = cameras_of(scene, paths)
    # Take their observations: directions and numbers of points, the residual, and landmarks of the least errors
    directions, numbers, residual, landmarks = [], [], [], []
    for image, eye, turn in zip(images, position, rotation, strict=True):
        observed, camera = image.get_observation_points2D(), scene.cameras[image.camera_id]
        pixel = np.array([p.xy for p in observed]).reshape(-1, 2)
        number = np.array([row[p.point3D_id] for p in observed], np.int64)
        seen = direction_from_frame(pixel[:, 0], pixel[:, 1], camera.width, camera.height)
        to_point = (points[number] - eye) @ turn
        chord = np.linalg.norm(seen - to_point / np.linalg.norm(to_point, axis=1, keepdims=True), axis=1)
        residual.append(float(np.median(chord)) * camera.width / (2.0 * np.pi) if len(chord) else np.nan)
        order = np.argsort(error[number], kind="stable")[:_LANDMARKS]
        landmarks.append(Landmarks(pixel[order], points[number[order]], far=False))
        directions.append(seen)
        numbers.append(number)
    return KeyPoses(
        "moving", keys.index[kept], paths, position, rotation, np.array(residual),
        tuple(landmarks), points, error, held_out_errors(position, rotation, directions, numbers, points),
    )  # fmt: skip
