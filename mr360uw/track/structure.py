# SPDX-License-Identifier: Apache-2.0
"""Structure from motion of matched key frames, by COLMAP (Schoenberger & Frahm 2016).

COLMAP's camera axes are right, down, forward; ours are right, up, back.
"""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.sphere import direction_from_frame
from mr360uw.track.colmap import DATABASE, SEED, quiet_colmap
from mr360uw.track.steps import MAPPED, Steps
from mr360uw.types import Floats

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
    steps.expect(MAPPED * len(paths))
    with quiet_colmap() as pycolmap:
        for number, start in enumerate(_STARTS):
            into = folder / f"scene{number}"
            shutil.rmtree(into, ignore_errors=True)
            into.mkdir()
            found = pycolmap.incremental_mapping(
                folder / DATABASE, paths[0].parent, into, _mapping(pycolmap, *start),
                next_image_callback=lambda: steps.done(MAPPED),
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
