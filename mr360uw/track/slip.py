# SPDX-License-Identifier: Apache-2.0
"""Path of a mapped scene by fine features that are seen again, and its slip, predicted from paths by other features.

Light that drifts over a floor is mapped along with it. By half a second later caustics have changed, and points that
are seen again are the floor's; a pattern that drifts without changing is seen again too, but is coarser than sand.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.track.colmap import CALM_S, DATABASE, feature_sizes, quiet_colmap
from mr360uw.track.key_frames import KeyFrames
from mr360uw.types import Floats

_AXES = np.diag([1.0, -1.0, -1.0])
"""From COLMAP's camera axes to ours, and back."""
_LOSS_PX = 0.25
"""Error [px] at which a feature counts half. Four times as large: a pattern that drifts pulls the path a fifth more."""
_LEAST_OF_FRAME, _LEAST_OF_POSE = 15, 12
"""Features of a frame below which coarse ones are taken too, and below which it has no pose: half of it in halves."""
_ITERATIONS = 10
"""Steps of a fit. Three times as many: the path moves by a tenth of its error, and tracking takes 8 % longer."""
_LARGEST_PX = 2.0
"""Mean error [px] above which a point is left out, as when it was mapped."""


def settled_scenes(scene: Any, keys: KeyFrames, folder: Path) -> tuple[Any, ...]:
    """Return COLMAP's scene fitted to fine features that are seen again, then the scenes that other features make.

    The others: the scene as it was mapped, by all features; by coarse ones that are seen again; by two halves of the
    fine ones. Of a shot shorter than a second, seen again is over half of its time. folder: with the matches.
    """
    # Measure for how long points are seen, and how large their features are
    at_s = dict(zip((path.name for path in keys.paths), keys.time_s[keys.index], strict=True))
    time_s = {number: at_s[image.name] for number, image in scene.images.items()}
    size_px = feature_sizes(folder / DATABASE)
    points = np.array(sorted(scene.points3D))
    tracks = [scene.points3D[i].track.elements for i in points.tolist()]
    span = np.array([np.ptp([time_s[e.image_id] for e in track]) for track in tracks])
    size = np.array([np.median([size_px[e.image_id][e.point2D_idx] for e in track]) for track in tracks])
    # Choose the finer half of what is seen again, and coarser features in frames with too few of these
    lasting = span >= min(CALM_S, 0.5 * float(np.ptp(keys.time_s)))
    if scene.num_reg_images() > 2 * len(_with_at_least(_LEAST_OF_POSE, tracks, lasting)):
        lasting[:] = True  # the camera swims so fast that nothing is in sight for long
    fine = lasting & (size <= np.median(size[lasting]))
    enough = _with_at_least(_LEAST_OF_FRAME, tracks, fine)
    helped = np.array([any(e.image_id not in enough for e in track) for track in tracks])
    chosen = points[fine | lasting & helped]
    # Fit the poses to them, to the coarse ones alone, and to every other one
    every = _fitted(scene, points[lasting])
    settled = _fitted(every, chosen)
    parts = ((every, points[lasting & ~fine]), (settled, chosen[::2]), (settled, chosen[1::2]))
    others = (_fitted(start, part, least=_LEAST_OF_POSE // 2) for start, part in parts)
    return _fitted(scene, points, settled), scene, *others


def _with_at_least(count: int, tracks: list[Any], chosen: NDArray[np.bool_]) -> set[int]:
    """Return the numbers of the pictures that see at least so many of the chosen points."""
    seen = Counter(e.image_id for track, taken in zip(tracks, chosen, strict=True) if taken for e in track)
    return {number for number, times in seen.items() if times >= count}


def _fitted(scene: Any, points: NDArray[np.int64], posed: Any = None, *, least: int = _LEAST_OF_POSE) -> Any:
    """Return a scene of some of its points, with poses that fit them, or with those of another scene.

    Frames that see fewer than the least points have no pose; points that then err by more than two pixels are left out.
    """
    with quiet_colmap() as pycolmap:
        # Leave out the other points, and frames that too few are seen in
        found, config = pycolmap.Reconstruction(scene), pycolmap.BundleAdjustmentConfig()
        for point in set(found.points3D) - set(points.tolist()):
            found.delete_point3D(point)
        for image in [image for image in found.images.values() if image.has_pose]:
            if image.num_points3D < least or (posed and not posed.images[image.image_id].has_pose):
                found.deregister_frame(image.frame_id)
                continue
            if posed:
                found.frames[image.frame_id].rig_from_world = posed.frames[image.frame_id].rig_from_world
            config.add_image(image.image_id)
        # Adjust poses and points, with a robust loss
        options = pycolmap.BundleAdjustmentOptions()
        options.refine_focal_length = options.refine_extra_params = options.print_summary = False
        options.ceres.loss_function_type, options.ceres.loss_function_scale = pycolmap.LossFunctionType.CAUCHY, _LOSS_PX
        solver = options.ceres.solver_options
        solver.num_threads, solver.max_num_iterations, solver.function_tolerance = 1, _ITERATIONS, 1e-6
        options.refine_rig_from_world = posed is None
        config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
        if found.num_reg_images() >= 2:
            pycolmap.create_default_bundle_adjuster(options, config, found).solve()
        # Leave out points that err by more than the map allows
        found.update_point_3d_errors()
        for point in [number for number, point in found.points3D.items() if not point.error <= _LARGEST_PX]:
            found.delete_point3D(point)
    return found


def cameras_of(scene: Any, paths: tuple[Path, ...]) -> tuple[Floats, Floats]:
    """Return positions (k, 3) and rotations (k, 3, 3) of pictures in our camera axes; NaN of those without a pose."""
    image = {image.name: image for image in scene.images.values() if image.has_pose}
    position, rotation = np.full((len(paths), 3), np.nan), np.full((len(paths), 3, 3), np.nan)
    for k, path in enumerate(paths):
        if path.name in image:
            position[k] = image[path.name].projection_center()
            rotation[k] = image[path.name].cam_from_world().rotation.matrix().T @ _AXES
    return position, rotation


Poses = tuple[Floats, Floats]
_COMPARED = 48
"""Most frames of two paths that are compared."""
_BEARINGS, _BELOW = np.radians(np.linspace(-45.0, 45.0, 7)), 0.4
"""Bearings [rad] of the points that are placed, from ahead, and sine of their depression: 2 m below in 5 m."""


def predicted_slip(path: Poses, others: Sequence[Poses], distance: float, choice: Any = np.median) -> float:
    """Return how far what is placed at a distance by a path is expected to slip, rms.

    others: paths of `settled_scenes`. It is the median of three measures: how far things slip between the path and the
    mapped one, between the path and that of coarse features, and half as far as they do between the halves', which is
    the standard error. Light that drifts moves the first two; the median leaves out a mapped path that was far off.
    choice: function of the array of measures that takes another than the median.
    """
    mapped, coarse, half, rest = others
    apart = [slip_between(*pair, distance) for pair in ((path, mapped), (path, coarse), (half, rest))]
    return float(choice(np.array([apart[0], apart[1], 0.5 * apart[2]])))


def slip_between(one: Poses, other: Poses, distance: float) -> float:
    """Return how far apart two paths see points that are placed in one of their frames from each other one, rms.

    one, other: positions (k, 3) and rotations (k, 3, 3), NaN where not solved; the other is scaled to the extent of
    the one. distance: of the points from the camera that places them. If less than half of the frames are in both, the
    distance itself.
    """
    # Take frames that both have, evenly spaced, and give both paths the same extent
    known = np.flatnonzero(np.isfinite(one[0] + other[0]).all(axis=1))
    if len(known) < max(2, len(one[0]) / 2):
        return distance
    known = known[np.unique(np.linspace(0, len(known) - 1, min(len(known), _COMPARED)).astype(int))]
    eyes = [path[0][known] - path[0][known].mean(axis=0) for path in (one, other)]
    eyes[1] *= np.linalg.norm(eyes[0]) / max(float(np.linalg.norm(eyes[1])), 1e-12)
    # Place points in each frame, and look at them from each other one: (placing frame, looking frame, point, axis)
    level = np.sqrt(1.0 - _BELOW**2)
    look = [level * np.sin(_BEARINGS), np.full(len(_BEARINGS), -_BELOW), -level * np.cos(_BEARINGS)]
    seen = []
    for eye, rotation in zip(eyes, (one[1][known], other[1][known]), strict=True):
        placed = eye[:, None] + distance * np.einsum("iab,bn->ina", rotation, np.array(look))
        seen.append(np.einsum("jab,ijna->ijnb", rotation, placed[:, None] - eye[None, :, None]))
    return float(np.sqrt(np.mean(np.sum(np.square(seen[0] - seen[1]), axis=-1))))
