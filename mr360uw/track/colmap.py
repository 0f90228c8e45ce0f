# SPDX-License-Identifier: Apache-2.0
"""Features, matches and structure from motion of key frames, by COLMAP (Schoenberger & Frahm 2016).

COLMAP's camera axes are right, down, forward; ours are right, up, back. Its panoramic camera model is the mapping of
`mr360uw.sphere`. Seeds are fixed and everything runs on one thread, so that a solve can be repeated.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.errors import Mr360uwError
from mr360uw.sphere import direction_from_frame
from mr360uw.track.bearings import MINIMUM_MATCHES, Matches
from mr360uw.types import Floats

_AXES = np.diag([1.0, -1.0, -1.0])
"""From COLMAP's camera axes to ours, and back."""
_FEATURES = 6000
"""Most features of a frame; the largest are kept. Half: a third faster, rotations drift twice as much."""
_UPSAMPLED = -1
"""First octave: pictures are enlarged twice before features are found, which halves the drift of the rotation."""
_RATIO = 0.9
"""Largest distance of the best match over that of the second. Sand is alike everywhere: 0.8 loses a third of it."""
_LOOP_FRAMES = 10
"""Evenly spaced key frames that are all matched with each other, so that a path that comes back closes."""
_LEAST_ANGLE_DEG = (8.0, 3.0, 1.0)
"""Least angle between the rays to the points of the first two frames; smaller ones are tried where larger fail."""
_SEED = 1


@dataclass(frozen=True, slots=True, eq=False)
class Features:
    """Features of key frames: pixels (n, 2) of each frame, and the matches that agree with two views' geometry."""

    pixel: tuple[Floats, ...]
    matches: Matches


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """A solved scene in arbitrary axes and scale.

    position (k, 3) and rotation (k, 3, 3) of key frames, camera axes to world; `solved` (k,): which were found.
    residual_px (k,): median reprojection errors. pixel, point: observed pixels (n, 2) and numbers of their points (n,),
    for each frame. points (m, 3), error_px (m,): mean reprojection error of each.
    """

    position: Floats
    rotation: Floats
    solved: NDArray[np.bool_]
    residual_px: Floats
    pixel: tuple[Floats, ...]
    point: tuple[NDArray[np.int64], ...]
    points: Floats
    error_px: Floats


def load_colmap() -> Any:
    """Return pycolmap; raise `Mr360uwError` where it is not installed."""
    try:
        import pycolmap
    except ImportError as error:
        raise Mr360uwError("track - needs pycolmap, which is not installed - pip install mr360uw[track]") from error
    return pycolmap


@contextmanager
def quiet_colmap() -> Iterator[Any]:
    """Yield pycolmap with its messages off and its random numbers seeded; afterwards messages are as before."""
    pycolmap = load_colmap()
    before = pycolmap.logging.minloglevel
    pycolmap.logging.minloglevel = int(pycolmap.logging.Level.FATAL)
    pycolmap.set_random_seed(_SEED)
    try:
        yield pycolmap
    finally:
        pycolmap.logging.minloglevel = before


def pairs_to_match(count: int) -> list[tuple[int, int]]:
    """Return pairs of frames (i < j): neighbours, gaps of powers of two, and evenly spaced frames with each other."""
    gaps = [1, 2, 3, *(2**k for k in range(2, 7))]
    pairs = {(i, i + gap) for gap in gaps for i in range(count - gap)}
    spread = np.unique(np.linspace(0, count - 1, min(count, _LOOP_FRAMES)).astype(int)).tolist()
    return sorted(pairs | {(i, j) for i in spread for j in spread if i < j})


def match_features(
    paths: tuple[Path, ...], mask: Path, width: int, height: int, database: Path, tell: Iterator[None]
) -> Features:
    """Find and match features of key frames.

    mask: picture that is black where features are left out. database: file that COLMAP makes. tell: is advanced after
    each frame.
    """
    with quiet_colmap() as pycolmap:
        reading = pycolmap.ImageReaderOptions()
        reading.camera_model, reading.camera_params = "EQUIRECTANGULAR", f"{width},{height}"
        reading.camera_mask_path = mask
        extraction = pycolmap.FeatureExtractionOptions()
        extraction.sift.max_num_features, extraction.sift.first_octave = _FEATURES, _UPSAMPLED
        extraction.num_threads = 1
        pycolmap.extract_features(
            database, paths[0].parent, [path.name for path in paths], pycolmap.CameraMode.SINGLE, reading, extraction,
            pycolmap.Device.cpu,
        )  # fmt: skip
        pairs = pairs_to_match(len(paths))
        listed = database.with_suffix(".pairs.txt")
        listed.write_text("".join(f"{paths[i].name} {paths[j].name}\n" for i, j in pairs), "utf-8")
        pairing, verification = pycolmap.ImportedPairingOptions(), pycolmap.TwoViewGeometryOptions()
        matching = pycolmap.FeatureMatchingOptions()
        matching.sift.max_ratio, matching.num_threads = _RATIO, 1
        pairing.match_list_path = listed
        verification.ransac.random_seed, verification.ransac.max_error = _SEED, 2.0
        verification.detect_watermark = False
        pycolmap.match_image_pairs(database, matching, pairing, verification, pycolmap.Device.cpu)
        for _ in paths:
            next(tell)
        with pycolmap.Database.open(database) as read:
            number = {image.name: image.image_id for image in read.read_all_images()}
            ids = [number[path.name] for path in paths]
            pixel = tuple(np.asarray(read.read_keypoints(image)[:, :2], np.float64) for image in ids)
            directions = [direction_from_frame(p[:, 0], p[:, 1], width, height) for p in pixel]
            matches = {}
            for i, j in pairs:
                found = np.asarray(read.read_two_view_geometry(ids[i], ids[j]).inlier_matches)
                if len(found) < MINIMUM_MATCHES:
                    found = np.asarray(read.read_matches(ids[i], ids[j]))
                if len(found) >= MINIMUM_MATCHES:
                    matches[i, j] = directions[i][found[:, 0]], directions[j][found[:, 1]]
    return Features(pixel, matches)


def solve_structure(
    paths: tuple[Path, ...], database: Path, folder: Path, advance: Callable[[], None]
) -> Solution | None:
    """Return the largest scene that COLMAP maps from matched key frames; None where it finds none.

    folder: for its files. advance: is called after each frame that is added.
    """
    with quiet_colmap() as pycolmap:
        for angle in _LEAST_ANGLE_DEG:
            options = pycolmap.IncrementalPipelineOptions()
            options.multiple_models, options.extract_colors, options.min_model_size = False, False, 3
            options.num_threads, options.random_seed = 1, _SEED
            options.ba_refine_focal_length = options.ba_refine_extra_params = False
            options.mapper.init_min_tri_angle, options.mapper.init_min_num_inliers = angle, 50
            options.mapper.filter_max_reproj_error, options.mapper.abs_pose_max_error = 2.0, 6.0
            if angle < _LEAST_ANGLE_DEG[0]:
                options.triangulation.min_angle = options.mapper.filter_min_tri_angle = 0.5
            found = pycolmap.incremental_mapping(
                database, paths[0].parent, folder, options, next_image_callback=advance
            )
            if found:
                best = max(found.values(), key=lambda scene: scene.num_reg_images())
                return _solution(best, [path.name for path in paths])
    return None


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
        seen = direction_from_frame(pixels[k][:, 0], pixels[k][:, 1], camera.width, camera.height)
        to_point = (points[numbers[k]] - position[k]) @ rotation[k]
        chord = np.linalg.norm(seen - to_point / np.linalg.norm(to_point, axis=1, keepdims=True), axis=1)
        residual[k] = float(np.median(chord)) * camera.width / (2.0 * np.pi) if len(chord) else np.nan
    return Solution(position, rotation, solved, residual, tuple(pixels), tuple(numbers), points, error)
