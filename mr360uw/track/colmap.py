# SPDX-License-Identifier: Apache-2.0
"""Features of key frames and their matches, by COLMAP (Schoenberger & Frahm 2016).

Its panoramic camera model is the mapping of
`mr360uw.base.sphere`. Seeds are fixed and everything runs on one thread, so that a solve can be repeated.

Features of a rig, a housing, a diver or the inside of a car stay at the same pixels while the others move. Where most
features of a picture are on the rig, the geometry of two views would be fitted to the rig, as if the camera stood
still: their matches are left out first.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.progress import Steps
from mr360uw.base.sphere import direction_from_frame, frame_from_direction
from mr360uw.errors import Mr360uwError, install_command
from mr360uw.track.camera_track import Kind
from mr360uw.types import Floats

Indices = NDArray[np.uint32]
_EXTRACTED, _MATCHED = 10, 4
"""Steps of progress that a key frame's features and a matched pair take, over reading a frame."""
_STATIC_PX = 1.0
"""Largest motion [px] of a feature that stays where it is. Half: noisy features of a rig remain; double: distant ones
ahead of the camera are lost."""
_WRONG = np.radians(10.0)
"""Motion [rad] between neighbouring key frames above which a match is taken for wrong: four times what makes a key."""
_LEAST_MOVING, _MOVING_SHARE = 20, 0.1
"""Fewest features, and least share of them, that move between two key frames of a camera that moves."""
_LEAST_MOTION_PX = 3.0
"""Least median motion [px] of the features that move. Leaves and algae in the current sway by one or two."""


def without_riding(
    directions: tuple[Floats, ...], matches: Mapping[tuple[int, int], Indices], pixel_rad: float
) -> dict[tuple[int, int], Indices]:
    """Return the matches without those of features that move along with the camera.

    directions: (n, 3) of the features of each key frame, in its camera's axes. matches: pairs of features (m, 2) of
    pairs of key frames. pixel_rad: angle of a pixel. Pairs of key frames between which the camera pauses keep all; so
    does a clip that pauses in more than half of its neighbouring key frames.
    """
    motion = {
        (i, j): np.linalg.norm(directions[i][pair[:, 0]] - directions[j][pair[:, 1]], axis=1) / pixel_rad
        for (i, j), pair in matches.items()
    }
    near = {i: pixels[pixels < _WRONG / pixel_rad] for (i, j), pixels in motion.items() if j == i + 1}
    moves = np.array([i in near and _moves(near[i]) for i in range(len(directions))])  # to the next key frame
    if 2 * np.count_nonzero(moves) < max(len(near), 1):
        return dict(matches)
    return {(i, j): pair[motion[i, j] >= _STATIC_PX] if moves[i:j].any() else pair for (i, j), pair in matches.items()}


def _moves(motion_px: Floats) -> bool:
    """Return whether enough features move far enough between two key frames for a camera that moves."""
    moving = motion_px[motion_px >= _STATIC_PX]
    enough = len(moving) >= max(_LEAST_MOVING, _MOVING_SHARE * len(motion_px))
    return enough and float(np.median(moving)) >= _LEAST_MOTION_PX


_FEATURES = 6000
"""Most features of a frame; the largest are kept. Half: a third faster, rotations drift twice as much."""
_UPSAMPLED = -1
"""First octave: pictures are enlarged twice before features are found, which halves the drift of the rotation."""
_RATIO = 0.9
"""Largest distance of the best match over that of the second. Sand is alike everywhere: 0.8 loses a third of it."""
_LOOP_FRAMES = 10
"""Evenly spaced key frames that are all matched with each other, so that a path that comes back closes."""
SEED = 1
DATABASE = "matches.db"
"""File of a folder with the matches that agree with two views' geometry."""
_CHUNK = 16
"""Pictures, or pairs of them, after which a run that is stopped goes on."""


def load_colmap() -> Any:
    """Return pycolmap; raise `Mr360uwError` where it is not installed."""
    try:
        import pycolmap
    except ImportError as error:
        raise Mr360uwError(f"track - needs pycolmap, which is not installed - {install_command('track')}") from error
    return pycolmap


@contextmanager
def quiet_colmap() -> Iterator[Any]:
    """Yield pycolmap with its messages off and its random numbers seeded; afterwards messages are as before."""
    pycolmap = load_colmap()
    before = pycolmap.logging.minloglevel
    pycolmap.logging.minloglevel = int(pycolmap.logging.Level.FATAL)
    pycolmap.set_random_seed(SEED)
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


CALM_S, _LONG_S = 0.5, 2.0
"""Times between key frames over which light that drifts has moved on, as caustics change within a third of the first,
and things are still in sight."""
_FITS_PX, _NEAR_RAD = 1.5, 0.35
"""Distance from the plane of its rays up to which a match fits a path, and greatest motion of a match in that time."""
_RESTING, _RESTING_CELLS, _RESTING_OVER = 0.05, 12, 1.0 / 3.0
"""Least share of such matches that stand still; least number of cells of the sphere that hold both what stands still
and what does not, and least share of the cells with any match: a rig hides what is behind it. Over boulders, under
strong caustics, a fifth stands still where the camera does, and 1 in 160 where it swims at 0.3 m/s."""
_CELLS = (12, 6)
"""Cells around the sphere, and from pole to pole."""


def at_rest(matches: Matches, time_s: Floats, pixel_rad: float) -> Matches | None:
    """Return the matches that stand still, of a camera at rest over which light drifts; None where too few do for that.

    matches: of `all_matches`. time_s: (k,) of the key frames.
    """
    # Part the matches by whether they stand still, and count those of frames that are some time apart, cell by cell
    still, count = {}, np.zeros((2, _CELLS[0] * _CELLS[1]), np.int64)
    for (i, j), (a, b) in matches.items():
        stays = np.linalg.norm(a - b, axis=1) < _STATIC_PX * pixel_rad
        if np.count_nonzero(stays) >= _MINIMUM_MATCHES:
            still[i, j] = a[stays], b[stays]
        if time_s[j] - time_s[i] >= CALM_S:
            x, y = frame_from_direction(a, *_CELLS)
            cell = np.minimum(y.astype(np.int64), _CELLS[1] - 1) * _CELLS[0] + x.astype(np.int64) % _CELLS[0]
            np.add.at(count, (stays.astype(np.int64), cell), 1)
    moved, stayed = count
    both, any_ = np.count_nonzero((moved > 0) & (stayed > 0)), np.count_nonzero(moved + stayed)
    enough = both >= max(_RESTING_CELLS, _RESTING_OVER * any_)
    return still if still and enough and stayed.sum() >= _RESTING * count.sum() else None


def agreement(matches: Matches, time_s: Floats, pixel_rad: float, position: Floats, rotation: Floats) -> float | None:
    """Return the share of the matches between key frames some time apart that fit their solved poses; None of too few.

    position (k, 3), rotation (k, 3, 3): of the key frames, NaN where not solved. The other arguments are those of
    `at_rest`. Light that drifts over a floor fits a path from one frame to the next, but is not seen again: a third
    fits where it made the path, and 19 of 20 where the floor did.
    """
    fits = number = 0
    for (i, j), (a, b) in matches.items():
        moved, way = np.linalg.norm(a - b, axis=1), position[j] - position[i]
        # What rides along with the camera tells nothing of its path
        some = (moved >= _STATIC_PX * pixel_rad) & (moved <= _NEAR_RAD)
        if not CALM_S <= time_s[j] - time_s[i] <= _LONG_S or not np.linalg.norm(way) > 0.0:
            continue
        # Rays to one point lie in a plane with the way between both cameras
        across = np.cross(way, a[some] @ rotation[i].T)
        across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)
        off = np.abs(np.sum(across * (b[some] @ rotation[j].T), axis=1))
        fits, number = fits + int(np.count_nonzero(off <= _FITS_PX * pixel_rad)), number + len(off)
    return fits / number if number >= _MINIMUM_MATCHES else None


def all_matches(paths: tuple[Path, ...], folder: Path, width: int, height: int) -> Matches:
    """Return all matches of key frames, verified or not; none where a run that was stopped late goes on without them.

    folder: in which `match_features` has left its databases.
    """
    found = folder / "features.db"
    if not found.is_file():
        return {}
    with load_colmap().Database.open(found) as stored:
        pixel, matched = _read_matches(stored, paths, pairs_to_match(len(paths)))
    directions = tuple(direction_from_frame(p[:, 0], p[:, 1], width, height) for p in pixel)
    return {(i, j): (directions[i][m[:, 0]], directions[j][m[:, 1]]) for (i, j), m in matched.items()}


def match_features(
    paths: tuple[Path, ...], mask: Path, width: int, height: int, folder: Path, steps: Steps, *, riding: bool = False
) -> tuple[tuple[Floats, ...], Matches]:
    """Return the pixels (n, 2) of each key frame's features, and the matches that agree with two views' geometry.

    It goes on with what a run before left in the folder.

    mask: picture that is black where features are left out. folder: for COLMAP's databases. riding: keep features that
    move along with the camera.
    """
    found, verified = folder / "features.db", folder / DATABASE
    pairs = pairs_to_match(len(paths))
    steps.expect(_EXTRACTED * len(paths) + _MATCHED * len(pairs))
    with quiet_colmap() as pycolmap:
        if not verified.exists():
            _extract(pycolmap, paths, mask, (width, height), found, steps)
            _match(pycolmap, paths, pairs, found, steps)
            part = folder / "verified.part.db"
            shutil.copyfile(found, part)
            _keep_verified(pycolmap, paths, pairs, part, width, height, riding=riding)
            part.replace(verified)
        with pycolmap.Database.open(verified) as stored:
            pixel, matched = _read_matches(stored, paths, pairs)
            directions = tuple(direction_from_frame(p[:, 0], p[:, 1], width, height) for p in pixel)
            return pixel, _verified(stored, paths, matched, directions)


def feature_sizes(database: Path) -> dict[int, Floats]:
    """Return the sizes [px] of the features of each picture, by COLMAP's numbers of pictures."""
    with load_colmap().Database.open(database) as stored:
        shape = {
            image.image_id: np.asarray(stored.read_keypoints(image.image_id), np.float64).reshape(-1, 6)[:, 2:]
            for image in stored.read_all_images()
        }
    return {k: np.sqrt(np.abs(a[:, 0] * a[:, 3] - a[:, 1] * a[:, 2])) for k, a in shape.items()}


def _extract(
    pycolmap: Any, paths: tuple[Path, ...], mask: Path, size: tuple[int, int], database: Path, steps: Steps
) -> None:
    """Find the features of pictures that a database has not yet."""
    reading = pycolmap.ImageReaderOptions()
    reading.camera_model, reading.camera_params = "EQUIRECTANGULAR", f"{size[0]},{size[1]}"
    reading.camera_mask_path = mask
    options = pycolmap.FeatureExtractionOptions()
    options.sift.max_num_features, options.sift.first_octave = _FEATURES, _UPSAMPLED
    options.num_threads = 1
    for at in range(0, len(paths), _CHUNK):
        names = [path.name for path in paths[at : at + _CHUNK]]
        if at:  # all pictures are of one camera, which the first made
            with pycolmap.Database.open(database) as stored:
                reading.existing_camera_id = stored.read_all_cameras()[0].camera_id
        pycolmap.extract_features(
            database, paths[0].parent, names, pycolmap.CameraMode.SINGLE, reading, options, pycolmap.Device.cpu
        )
        steps.done(_EXTRACTED * len(names))


def _match(pycolmap: Any, paths: tuple[Path, ...], pairs: list[tuple[int, int]], database: Path, steps: Steps) -> None:
    """Match the features of pairs of pictures that are not matched yet."""
    pairing, options = pycolmap.ImportedPairingOptions(), pycolmap.FeatureMatchingOptions()
    options.sift.max_ratio, options.num_threads = _RATIO, 1
    options.skip_geometric_verification = True
    pairing.match_list_path = database.with_suffix(".pairs.txt")
    for at in range(0, len(pairs), _CHUNK):
        some = pairs[at : at + _CHUNK]
        _list_pairs(pairing.match_list_path, paths, some)
        pycolmap.match_image_pairs(database, options, pairing, device=pycolmap.Device.cpu)
        steps.done(_MATCHED * len(some))


def _list_pairs(listed: Path, paths: tuple[Path, ...], pairs: list[tuple[int, int]]) -> None:
    listed.write_text("".join(f"{paths[i].name} {paths[j].name}\n" for i, j in pairs), "utf-8")


def _keep_verified(
    pycolmap: Any, paths: tuple[Path, ...], pairs: list[tuple[int, int]], database: Path, width: int, height: int, *,
    riding: bool,
) -> None:  # fmt: skip
    """Leave out matches of what moves along with the camera, unless `riding`; fit two views' geometry to the others."""
    with pycolmap.Database.open(database) as stored:
        pixel, matched = _read_matches(stored, paths, pairs)
        directions = tuple(direction_from_frame(p[:, 0], p[:, 1], width, height) for p in pixel)
        kept = matched if riding else without_riding(directions, matched, 2.0 * np.pi / width)
        _write_matches(stored, paths, kept)
    options = pycolmap.TwoViewGeometryOptions()
    options.ransac.random_seed, options.ransac.max_error, options.detect_watermark = SEED, 2.0, False
    listed = database.with_suffix(".pairs.txt")
    _list_pairs(listed, paths, list(kept))
    pycolmap.verify_matches(database, listed, options)


def _numbers(stored: Any, paths: tuple[Path, ...]) -> list[int]:
    """Return COLMAP's numbers of pictures."""
    number = {image.name: image.image_id for image in stored.read_all_images()}
    return [number[path.name] for path in paths]


def _read_matches(
    stored: Any, paths: tuple[Path, ...], pairs: list[tuple[int, int]]
) -> tuple[tuple[Floats, ...], dict[tuple[int, int], Indices]]:
    """Return the pixels (n, 2) of each picture's features, and the matched features (m, 2) of pairs of pictures."""
    ids = _numbers(stored, paths)
    pixel = tuple(np.asarray(stored.read_keypoints(k), np.float64).reshape(-1, 6)[:, :2] for k in ids)
    found = {(i, j): np.asarray(stored.read_matches(ids[i], ids[j]), np.uint32).reshape(-1, 2) for i, j in pairs}
    return pixel, {pair: indices for pair, indices in found.items() if len(indices)}


def _write_matches(stored: Any, paths: tuple[Path, ...], matches: dict[tuple[int, int], Indices]) -> None:
    """Replace the matches of a database."""
    ids = _numbers(stored, paths)
    stored.clear_matches()
    stored.clear_two_view_geometries()
    for (i, j), indices in matches.items():
        stored.write_matches(ids[i], ids[j], indices)


def _verified(
    stored: Any, paths: tuple[Path, ...], matches: dict[tuple[int, int], Indices], directions: tuple[Floats, ...]
) -> Matches:
    """Return the matches that agree with two views' geometry, or all of a pair without such a geometry."""
    ids, agreed = _numbers(stored, paths), {}
    for (i, j), indices in matches.items():
        found = indices
        if stored.exists_two_view_geometry(ids[i], ids[j]):
            inliers = np.asarray(stored.read_two_view_geometry(ids[i], ids[j]).inlier_matches).reshape(-1, 2)
            found = inliers if len(inliers) >= _MINIMUM_MATCHES else indices
        if len(found) >= _MINIMUM_MATCHES:
            agreed[i, j] = directions[i][found[:, 0]], directions[j][found[:, 1]]
    return agreed


# Rotations between sets of matched directions, and whether a camera stands still, turns on the spot or moves.
#
# A camera that turns without moving sees every point at a = R b, whatever its distance. R is the solution of Wahba's
# problem (Wahba 1965) by singular values (Kabsch 1976), found robustly from random pairs of matches (Fischler & Bolles
# 1981). The rotations of all pairs of frames are then averaged on the group of rotations (Govindu 2004).

_TRIALS = 200
"""Random pairs of matches. With half of the matches wrong, all are bad once in 10^24."""
_REFINEMENTS = 5
_STILL_SHARE = 0.9
"""Least number of matches within half a pixel of no motion, over that within half a pixel of the best rotation."""
_TURNING_SHARE = 0.85
"""Least share of matches that a rotation explains. Open water has no features, so a camera that moves through a scene
whose points are 20 times its path away counts as turning."""
_AVERAGINGS = 20
_MINIMUM_MATCHES = 20
"""Fewest matches of a pair of frames that say anything."""

Matches = Mapping[tuple[int, int], tuple[Floats, Floats]]
"""Directions (n, 3) in the axes of frame i and of frame j, of the same points, for pairs (i, j)."""


def wahba(a: Floats, b: Floats) -> Floats:
    """Return the rotation R (3, 3) that minimises sum |a - R b|^2 of unit vectors a, b (n, 3)."""
    u, _, vt = np.linalg.svd(a.T @ b)
    fitted: Floats = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return fitted


def robust_rotation(a: Floats, b: Floats, limit_rad: float) -> tuple[Floats, np.ndarray]:
    """Return the rotation with a = R b that most matches (n, 3) agree on within `limit_rad`, and which do (n,)."""
    pairs = np.random.default_rng(0).integers(0, len(a), (_TRIALS, 2))
    trials = [wahba(a[pair], b[pair]) for pair in pairs]
    best = max(trials, key=lambda trial: np.count_nonzero(_agree(a, b, trial, limit_rad)))
    inside = _agree(a, b, best, limit_rad)
    for _ in range(_REFINEMENTS):
        if np.count_nonzero(inside) < 3:
            break
        best = wahba(a[inside], b[inside])
        inside = _agree(a, b, best, limit_rad)
    return best, inside


def _agree(a: Floats, b: Floats, rotation: Floats, limit_rad: float) -> np.ndarray:
    """Return which chords |a - R b| are within the limit; for small angles a chord is the angle."""
    return np.asarray(np.sum(np.square(a - b @ rotation.T), axis=1) <= limit_rad * limit_rad)


def classify(matches: Matches, pixel_rad: float) -> Kind:
    """Return whether the camera stands still, turns on the spot or moves.

    matches: of pairs of frames, near and far apart; the widest pair of every frame counts. pixel_rad: angle of a pixel.
    Turning: a rotation explains most matches within a pixel. Still: no rotation explains many more within half a pixel
    than none does.
    """
    widest: dict[int, tuple[int, int]] = {}
    for i, j in matches:
        if len(matches[i, j][0]) >= _MINIMUM_MATCHES and (i not in widest or j > widest[i][1]):
            widest[i] = (i, j)
    pairs = [matches[pair] for pair in widest.values()]
    turns = [robust_rotation(a, b, pixel_rad)[0] for a, b in pairs]
    explained = [np.mean(_agree(a, b, turn, pixel_rad)) for (a, b), turn in zip(pairs, turns, strict=True)]
    if not pairs or np.median(explained) < _TURNING_SHARE:
        return "moving"
    turned = [np.mean(_agree(a, b, turn, 0.5 * pixel_rad)) for (a, b), turn in zip(pairs, turns, strict=True)]
    at_rest = [np.mean(_agree(a, b, np.eye(3), 0.5 * pixel_rad)) for a, b in pairs]
    return "still" if np.median(at_rest) >= _STILL_SHARE * np.median(turned) else "turning"


def average_rotations(count: int, matches: Matches, pixel_rad: float) -> Floats:
    """Return the rotations (count, 3, 3) from each frame's axes to those of frame 0 that fit all pairs best.

    They are chained from pair to pair, then refined together: the residual rotation vectors of the pairs are shared
    out by least squares, weighted by their numbers of agreeing matches, until they no longer change.
    """
    from scipy.spatial.transform import Rotation

    # Find the rotation of each pair, and chain them
    known = [pair for pair in sorted(matches) if len(matches[pair][0]) >= _MINIMUM_MATCHES]
    fits = [robust_rotation(*matches[pair], 2.0 * pixel_rad) for pair in known]
    relative = np.reshape([turn for turn, _ in fits], (-1, 3, 3))
    weight = np.sqrt([np.count_nonzero(inside) for _, inside in fits])
    absolute, chained = np.repeat(np.eye(3)[None], count, axis=0), {0}
    for (i, j), turn in zip(known, relative, strict=True):
        if i in chained and j not in chained:
            absolute[j] = absolute[i] @ turn
            chained.add(j)
    # Share out what is left; frame 0 stays
    first, second = np.array(known, int).reshape(-1, 2).T
    design = weight[:, None] * (np.eye(count)[second] - np.eye(count)[first])
    design = np.vstack([design, 1e3 * np.eye(count)[:1]])
    for _ in range(_AVERAGINGS):
        left = Rotation.from_matrix(absolute[first] @ relative @ np.swapaxes(absolute[second], 1, 2)).as_rotvec()
        change = np.linalg.lstsq(design, np.vstack([weight[:, None] * left, np.zeros((1, 3))]), rcond=None)[0]
        absolute = Rotation.from_rotvec(change).as_matrix() @ absolute
        if np.abs(change).max() < 1e-9:
            break
    return np.asarray(absolute)
