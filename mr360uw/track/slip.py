# SPDX-License-Identifier: Apache-2.0
"""What light that drifts over a floor does to a path: the path by features that last, its slip, and how it is freed.

Light that drifts is mapped along with the floor. By half a second later caustics have changed, and points that are seen
again are the floor's; a pattern that drifts without changing is seen again too, but is coarser than sand. The slip is
predicted from paths by other features.

The logarithm of what a floor sends back is that of its albedo plus that of its light. A path solved from pictures holds
one of these layers still, whichever has more features. In pictures of the floor seen from above, laid out by the path,
the other one drifts by the difference of both velocities. Light is the layer that is coarser, as the sun's disc blurs
caustics, and more skewed to the bright side, as their lines are.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mr360uw.base.sphere import frame_from_direction
from mr360uw.track.camera_track import fit_floor, rotation_to_world
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


# --- light as a rigid pattern -----------------------------------------------------------------------------------------


Maps = NDArray[np.float32]
Pictures = Sequence[NDArray[np.uint8]]
_CELLS, _SIDE, _RADIUS = 256, 6.0, 2.0
"""Side of the maps of the floor [cells], the same in heights of the camera, and radius of what a frame shows of it:
farther out, pixels of a panorama 768 wide are longer than two cells."""
_LEAST, _MOST = 4, 16
"""Fewest and most frames that are compared: pairs of 16 in two seconds tell a drift to 1 cm/s in 0.2 s."""
_SPAN_S = 2.0
"""Time over which a drift is taken for even; longer clips are parted."""
_FINE, _COARSE = 0.5, 6.0
"""Standard deviations [cells] of blurs: finer than the first counts as fine, coarser than the second is left out. Fine
twice as large: the layers differ by a third less."""
_FASTEST, _SPEEDS, _APART = 0.45, 201, 0.035
"""Fastest drift [heights/s] that is looked for, number of speeds along each axis, and slowest drift that is told from
none: three cells in two seconds."""
_LASTS, _CLEAR = 10.0, 37.0
"""Least peak of the correlation, over its robust deviation, of a layer that lasts, and of one that counts as slip
though it is not told which is light. It is 22 to 90 where a path holds the floor still, 59 to 190 where it follows a
rigid pattern; 2 to 3 under light that evolves, or 24 among boulders."""
_OVERLAP, _NEAR = 0.42, 4.0
"""Least fraction of the texture of both layers that is at the same places, within a blur of so many cells. Light and
albedo have 0.47 to 0.79; boulders and two levels of a floor, whose parallax looks like a drift, 0.24 to 0.37."""
_SURE = 0.7
"""Least difference of both layers that tells which is light: half of the least that was found, 1.4 to 3.2."""
_SAME = 0.1
"""Fraction of a frequency's power added where it hardly moves, so that the layers cannot be parted there. Three times
as large: they differ by up to a tenth more or less."""


def drifting_light(
    paths: tuple[Path, ...], mask: Path, index: NDArray[np.int64], time_s: Floats, poses: tuple[Floats, Floats],
    points: Floats,
) -> tuple[Floats, Floats, bool]:  # fmt: skip
    """Return how far light that drifts has carried a path since its start (n, 3), how far it may have besides (n, 3),
    and whether any drifts over what the path holds still.

    paths, index: pictures and numbers of key frames among time_s (n,) and poses (n, 3), (n, 3, 3) in a world with +y
    up. mask: picture that is black where nothing is tracked. points (m, 3): of the scene, which the floor is fitted to.
    """
    # Turn and scale the floor to y = 0, and the camera to a height of 1
    (position, rotation), at = poses, time_s[index]
    plane = fit_floor(points, position[0], np.array([0.0, 1.0, 0.0])) if len(points) else None
    if plane is None:
        return np.zeros_like(position), np.zeros_like(position), False
    turn, height = rotation_to_world(plane[0], rotation[0]), float(np.median(position @ plane[0]) - plane[1])
    eyes, turns = (position[index] @ turn.T - [0.0, plane[1], 0.0]) / height, turn @ rotation[index]
    shown = np.asarray(cv2.imread(str(mask), cv2.IMREAD_GRAYSCALE), np.uint8)
    edges = np.linspace(time_s[0], time_s[-1], max(1, round(float(np.ptp(time_s)) / _SPAN_S)) + 1)
    speeds, drifts = np.zeros((2, len(edges), 3)), False
    for n, (begin, end) in enumerate(itertools.pairwise(edges), 1):
        # Find the drift in some key frames of a short time
        some = np.flatnonzero((at >= begin) & (at <= end))
        some = some[np.unique(np.linspace(0, len(some) - 1, min(len(some), _MOST)).astype(int))]
        if len(some) < _LEAST or np.ptp(at[some]) < 2.0 * CALM_S:
            continue
        pictures = [np.asarray(cv2.imread(str(paths[k]), cv2.IMREAD_GRAYSCALE)) for k in some]
        drift, light = drifting_layer(pictures, shown, at[some], eyes[some], turns[some])
        # A path that holds the light still is carried along as fast as the albedo drifts in it, known to half a cell
        drifts |= _SURE <= light < np.inf
        if light < _SURE:
            freed, error = light <= -_SURE, 0.5 * _SIDE / _CELLS / (end - begin) / np.linalg.norm(drift)
            speeds[:, n] = np.outer([freed, error if freed else 1.0], height * drift @ turn[::2])
    ways = np.cumsum(speeds * (edges[1] - edges[0]), axis=1)
    away, unsure = (np.column_stack([np.interp(time_s, edges, one) for one in way.T]) for way in ways)
    return away, unsure, drifts


def drifting_layer(
    pictures: Pictures, mask: NDArray[np.uint8], time_s: Floats, eyes: Floats, turns: Floats
) -> tuple[Floats, float]:
    """Return the drift (2,) [heights/s] over x and z of a layer of the floor y = 0, and whether it is the light:
    positive if so, negative if it is the albedo, infinite where none lasts.

    pictures: of codes (H, W), seen from eyes (k, 3) at heights of 1, with rotations (k, 3, 3) at time_s (k,). mask: 0
    where they show something else.
    """
    # Lay the frames out as seen from above, and find what drifts in them besides their mean
    maps, shown = _maps(pictures, mask, eyes, turns)
    spectra, time_s = np.fft.rfft2(maps), time_s - time_s.mean()
    drift, contrast = _drift(spectra - spectra.mean(axis=0), time_s)
    if contrast < _LASTS or not shown.any():
        return drift, np.inf
    # Part both layers by least squares in each frequency: spectra = still + turn moving
    frequency = drift[0] * np.fft.rfftfreq(_CELLS) + drift[1] * np.fft.fftfreq(_CELLS)[:, None]
    turn = np.exp(-2j * np.pi * _CELLS / _SIDE * time_s[:, None, None] * frequency)
    mean, moved, common = spectra.mean(axis=0), (turn.conj() * spectra).mean(axis=0), turn.mean(axis=0)
    parted = np.stack([mean - common * moved, moved - common.conj() * mean]) / (1.0 - np.abs(common) ** 2 + _SAME)
    layers = np.fft.irfft2(parted).astype(np.float32) * shown
    # Compare where their texture is, and how skewed and how fine it is
    power = np.sum(layers**2, axis=(1, 2))
    where = [cv2.GaussianBlur(one**2, (0, 0), _NEAR) / p for one, p in zip(layers, power, strict=True)]
    if float(np.minimum(*where).sum()) < _OVERLAP:
        return drift, np.inf
    skew = np.sum(layers**3, axis=(1, 2)) / power**1.5 * np.sqrt(shown.sum())
    fine = np.log([float(np.sum(_finer(one, shown, _FINE) ** 2)) for one in layers] / power)
    light = float(skew[1] - skew[0] + fine[0] - fine[1])
    return drift, light if abs(light) >= _SURE or contrast >= _CLEAR else np.inf


def _maps(pictures: Pictures, mask: NDArray[np.uint8], eyes: Floats, turns: Floats) -> tuple[Maps, Maps]:
    """Return logarithms of codes on the floor less their means around (k, n, n), and 1 where most frames show it."""
    cells = (np.arange(_CELLS) / _CELLS - 0.5) * _SIDE
    x, z = np.meshgrid(cells + np.median(eyes[:, 0]), cells + np.median(eyes[:, 2]))
    maps, weights = [], []
    for picture, eye, turn in zip(pictures, eyes, turns, strict=True):
        # Read the picture and the mask there; count what is near, and take away what is coarse
        away = np.stack([x - eye[0], np.full_like(x, -eye[1]), z - eye[2]], axis=-1)
        column, row = frame_from_direction(away @ turn, *picture.shape[::-1])
        at = np.stack([column - 0.5, row - 0.5], axis=-1).astype(np.float32)
        both = np.dstack([np.log(picture + 2.0), mask]).astype(np.float32)
        seen, free = cv2.split(cv2.remap(both, at, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP))
        near = np.hypot(away[..., 0], away[..., 2]) < _RADIUS
        weights.append((near & (free > 254.0)).astype(np.float32))
        maps.append(_finer(seen, weights[-1], _COARSE))
    return np.array(maps), (np.mean(weights, axis=0) > 0.5).astype(np.float32)


def _finer(picture: Maps, weight: Maps, size: float) -> Maps:
    """Return a map less its weighted mean around, over a standard deviation of `size` cells, times the weight."""
    blurred, near = (cv2.GaussianBlur(one, (0, 0), size) for one in (picture * weight, weight))
    return np.asarray((picture - blurred / np.maximum(near, 1e-3)) * weight)


def _drift(spectra: NDArray[np.complex128], time_s: Floats) -> tuple[Floats, float]:
    """Return the drift (2,) [heights/s] at which maps half a second and more apart correlate best, and its contrast.

    Correlations are of phases alone, where frequencies stand out of the noise.
    """
    # Add up the correlations of all pairs, each at the way that a drift makes in its time
    power = np.sqrt(np.mean(np.abs(spectra) ** 2, axis=0))
    white = spectra / np.maximum(power, 0.05 * power.max() + 1e-12)
    speed = np.linspace(-_FASTEST, _FASTEST, _SPEEDS)
    total = np.zeros((_SPEEDS, _SPEEDS))
    for i, j in zip(*np.nonzero(time_s - time_s[:, None] >= CALM_S), strict=True):
        found = np.fft.fftshift(np.fft.irfft2(white[i].conj() * white[j])).astype(np.float32)
        way = (speed * (time_s[j] - time_s[i]) * _CELLS / _SIDE + 0.5 * _CELLS).astype(np.float32)
        total += cv2.remap(found, np.dstack(np.meshgrid(way, way)), None, cv2.INTER_LINEAR)
    # Take the highest but for what stands still
    total -= np.median(total)
    peaks = np.where(np.hypot(speed, speed[:, None]) < _APART, 0.0, total)
    row, column = np.unravel_index(np.argmax(peaks), peaks.shape)
    return speed[[column, row]], float(peaks.max() / (1.4826 * np.median(np.abs(total)) + 1e-12))
