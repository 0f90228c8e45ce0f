# SPDX-License-Identifier: Apache-2.0
"""Structure from motion of matched key frames, by COLMAP (Schoenberger & Frahm 2016).

COLMAP's camera axes are right, down, forward; ours are right, up, back.

The held-out error of a solved path is that of points from half of the key frames, looked for in the other half: how
far an object that stands on such a point slips against the picture in frames that did not place it.
"""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.progress import Steps
from mr360uw.sphere import direction_from_frame
from mr360uw.track.colmap import DATABASE, SEED, quiet_colmap
from mr360uw.types import Floats

_MAPPED = 6
"""Steps of progress that a key frame in the map takes, over reading a frame."""
WIDTH = 2048
"""Width of the panorama [px] whose pixels the error is counted in."""
_ROUNDS = 4
"""Fits of a point, each weighted by the distances that the one before found."""
_LEAST_OBSERVED = 20
"""Least number of held-out features of a key frame that has a slip; half as many make its noise 1.4 times as large."""


def held_out_errors(scene: Solution) -> tuple[Floats, Floats]:
    """Return the errors of points from half of the key frames in the other half, for each key frame: slip and feature.

    Both (k,) are in pixels of a panorama 2048 wide, NaN where too few points are seen. Slip: length of the median
    error, as a vector, of the features below the horizon: how far the ground as a whole, and a body on it, is off.
    Feature: median length of the errors of single features, which contains their noise.

    Points that at least two even key frames see are triangulated from these alone, and compared with where odd ones
    see them; then the other way round. Errors are in the tangent plane: along the parallel and along the meridian.
    """
    kept = np.flatnonzero(scene.solved)
    frame = np.concatenate([np.full(len(scene.point[k]), k) for k in kept])
    order = np.searchsorted(kept, frame)
    point = np.concatenate([scene.point[k] for k in kept])
    own = np.concatenate([scene.direction[k] for k in kept])
    look = np.concatenate([scene.direction[k] @ scene.rotation[k].T for k in kept])
    eye = scene.position[frame]
    error = np.full((len(frame), 2), np.nan)
    for parity in (0, 1):
        using = order % 2 == parity
        place = triangulate(point[using], eye[using], look[using], len(scene.points))
        towards = np.einsum("nji,nj->ni", scene.rotation[frame[~using]], place[point[~using]] - eye[~using])
        error[~using] = _tangent(own[~using], towards) * WIDTH / (2.0 * np.pi)
    slip, feature = np.full(len(scene.solved), np.nan), np.full(len(scene.solved), np.nan)
    for k in kept:
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


_AXES = np.diag([1.0, -1.0, -1.0])
"""From COLMAP's camera axes to ours, and back."""
_STARTS = ((8.0, 50, 1.5), (3.0, 50, 0.5), (3.0, 25, 0.5), (1.5, 20, 0.3))
"""Starts that are tried in this order: least angle [deg] between the rays to the points of the first two frames, their
fewest matches, and least angle [deg] of a point. Safe ones are first: short bases make bent paths."""
_ENOUGH = 0.9
"""Share of solved key frames from which no further start is tried."""
_LEAST_SEEN, _LEAST_SHARE = 15, 0.15
"""Fewest known points, and least share of a frame's matches, that place another frame."""


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """A solved scene in arbitrary axes and scale.

    position (k, 3) and rotation (k, 3, 3) of key frames, camera axes to world; `solved` (k,): which were found.
    residual_px (k,): median reprojection errors. pixel, direction, point: observed pixels (n, 2), their directions
    (n, 3) in camera axes and numbers of their points (n,), for each frame. points (m, 3), error_px (m,): mean
    reprojection error of each.
    """

    position: Floats
    rotation: Floats
    solved: NDArray[np.bool_]
    residual_px: Floats
    pixel: tuple[Floats, ...]
    direction: tuple[Floats, ...]
    point: tuple[NDArray[np.int64], ...]
    points: Floats
    error_px: Floats


def solve_structure(paths: tuple[Path, ...], folder: Path, steps: Steps) -> Solution | None:
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
        return None if best is None else _solution(best, [path.name for path in paths])


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


def _solution(scene: Any, names: list[str]) -> Solution:
    """Return a COLMAP reconstruction as arrays in our camera axes."""
    ids = sorted(scene.points3D)
    row = {point: index for index, point in enumerate(ids)}
    points = np.array([scene.points3D[i].xyz for i in ids]).reshape(-1, 3)
    error = np.array([scene.points3D[i].error for i in ids])
    count = len(names)
    position, rotation = np.zeros((count, 3)), np.repeat(np.eye(3)[None], count, axis=0)
    solved, residual = np.zeros(count, bool), np.full(count, np.nan)
    pixels: list[Floats] = [np.zeros((0, 2))] * count
    directions: list[Floats] = [np.zeros((0, 3))] * count
    numbers: list[NDArray[np.int64]] = [np.zeros(0, np.int64)] * count
    for image in scene.images.values():
        if not image.has_pose:
            continue
        k = names.index(image.name)
        observed = image.get_observation_points2D()
        position[k] = image.projection_center()
        rotation[k] = image.cam_from_world().rotation.matrix().T @ _AXES
        pixels[k] = np.array([p.xy for p in observed]).reshape(-1, 2)
        numbers[k] = np.array([row[p.point3D_id] for p in observed], np.int64)
        solved[k] = True
        camera = scene.cameras[image.camera_id]
        seen = directions[k] = direction_from_frame(pixels[k][:, 0], pixels[k][:, 1], camera.width, camera.height)
        to_point = (points[numbers[k]] - position[k]) @ rotation[k]
        chord = np.linalg.norm(seen - to_point / np.linalg.norm(to_point, axis=1, keepdims=True), axis=1)
        residual[k] = float(np.median(chord)) * camera.width / (2.0 * np.pi) if len(chord) else np.nan
    return Solution(
        position, rotation, solved, residual, tuple(pixels), tuple(directions), tuple(numbers), points, error
    )
