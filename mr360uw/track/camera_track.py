# SPDX-License-Identifier: Apache-2.0
"""The solved path of a camera: poses, scene points, floor, residuals; its place in the world; CSV and JSON."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from mr360uw.base.files import check_outputs, write_whole
from mr360uw.base.parameters import checked
from mr360uw.base.sphere import unit
from mr360uw.errors import ParameterError
from mr360uw.ibl.tilt import estimate_horizon, level_matrix
from mr360uw.medium.spectra import read_table
from mr360uw.types import Floats

Kind = Literal["still", "turning", "moving"]
"""The camera stands still, turns on the spot, or moves."""
_SUFFIXES = (".csv", ".json")


@dataclass(frozen=True, slots=True)
class FittedFloor:
    """Plane fitted to the points below the camera.

    height_m: of the plane at the first camera's position, negative. tilt_deg: between its normal and up. support: share
    (0 to 1) of the points below the camera that lie on the plane. points: their number.
    """

    height_m: float
    tilt_deg: float
    support: float
    points: int


@dataclass(frozen=True, slots=True, eq=False)
class CameraTrack:
    """Path of a camera in the world of its first frame: +y up, the first camera at the origin, looking towards -z.

    kind: whether the camera stands still, turns on the spot, or moves. time_s (n,). position (n, 3) [m], as far as the
    scale is known. rotation (n, 3, 3): rotates camera axes (right, up, back) to the world's. residual_px,
    residual_deg (n,): median distance between observed and predicted features of a frame, in pixels of a frame of
    `width` columns and degrees; NaN where a frame was interpolated. key_frames (k,): frames that COLMAP or the matches
    solved. points (m, 3) [m], point_error_px (m,): scene points and their mean reprojection errors. coverage: share of
    the sphere of directions with features, 0 to 1. up, scale: sentences that say where they are from. slip_px,
    worst_slip_px: median and largest slip of the ground over key frames, held_out_px: median error of single features,
    as `structure` defines them, in pixels of a panorama 2048 wide. depth_m: of the first camera, of a depth log.
    agreed: share of what is seen again after half a second and more that fits the path. slip_m: predicted slip [m] of
    what is placed 5 m away, rms over pairs of frames (`slip.predicted_slip`); None of cameras that do not move.
    light_m: how far [m] light that drifts over the floor had carried the path off, which is taken out.
    """

    kind: Kind
    time_s: Floats
    position: Floats
    rotation: Floats
    residual_px: Floats
    residual_deg: Floats
    key_frames: np.ndarray
    points: Floats
    point_error_px: Floats
    coverage: float
    width: int
    floor: FittedFloor | None
    up: str
    scale: str
    slip_px: float | None = None
    worst_slip_px: float | None = None
    held_out_px: float | None = None
    depth_m: float | None = None
    agreed: float | None = None
    slip_m: float | None = None
    light_m: float = 0.0

    @property
    def quaternion(self) -> Floats:
        """Rotations as quaternions (n, 4), x, y, z, w, without jumps of sign."""
        return smooth_quaternions(self.rotation)

    def csv(self) -> str:
        """Return the table that `camera.track` of a scene reads: time_s, x, y, z, qx, qy, qz, qw."""
        rows = np.column_stack([self.time_s, self.position, self.quaternion])
        lines = (",".join(f"{value:.9g}" for value in row) for row in rows)
        return "\n".join(["time_s,x,y,z,qx,qy,qz,qw", *lines, ""])

    def json(self) -> str:
        """Return everything as JSON; residuals of interpolated frames are null."""
        return json.dumps({
            "format": "mr360uw camera track 1", "kind": self.kind, "up": self.up, "scale": self.scale,
            "coverage": round(self.coverage, 4), "width": self.width, "slip_px": self.slip_px,
            "worst_slip_px": self.worst_slip_px, "held_out_px": self.held_out_px, "depth_m": self.depth_m,
            "agreed": self.agreed, "slip_m": self.slip_m,
            "light_m": self.light_m,
            "key_frames": self.key_frames.tolist(),
            "floor": None if self.floor is None else asdict(self.floor),
            "time_s": self.time_s.tolist(), "position_m": self.position.tolist(),
            "quaternion_xyzw": self.quaternion.tolist(), "residual_px": _nullable(self.residual_px),
            "residual_deg": _nullable(self.residual_deg), "points_m": self.points.round(5).tolist(),
            "point_error_px": self.point_error_px.round(4).tolist(),
        })  # fmt: skip

    @checked
    def save(self, out: str | Path, *, overwrite: bool = False) -> tuple[Path, Path]:
        """Write the table (.csv) and everything (.json) beside each other; return both paths.

        out: the name of either. Raises `ParameterError` or `OutputExistsError`.
        """
        paths = track_files(out, overwrite=overwrite)
        for path, text in zip(paths, (self.csv(), self.json()), strict=True):
            write_whole(path, text)
        return paths


def smooth_quaternions(rotation: Floats) -> Floats:
    """Return rotations (n, 3, 3) as quaternions (n, 4), x, y, z, w, without jumps of sign."""
    from scipy.spatial.transform import Rotation

    found = Rotation.from_matrix(rotation).as_quat()
    signs = np.where(np.sum(found[1:] * found[:-1], axis=1) < 0.0, -1.0, 1.0)
    return np.asarray(found * np.concatenate([[1.0], np.cumprod(signs)])[:, None])


def track_files(out: str | Path, inputs: Iterable[Path] = (), *, overwrite: bool) -> tuple[Path, Path]:
    """Return the paths of the table and of the JSON for the name of either.

    inputs: files that were read for them. Raises `ParameterError`, or `OutputError` where they may not be written.
    """
    out = Path(out)
    if out.suffix.lower() not in _SUFFIXES:
        raise ParameterError(
            f"{out} - is no name of a track (got {out.suffix!r}) - end it in .csv or .json (with --from: .chan, .py)"
        )
    paths = out.with_suffix(".csv"), out.with_suffix(".json")
    check_outputs(paths, inputs=inputs, overwrite=overwrite)
    return paths


def shot_path(out: Path, number: int) -> Path:
    """Return the name of the track of a shot, counted from 1, of a clip with cuts."""
    return out.with_name(f"{out.stem}.shot{number}{out.suffix}")


def _nullable(values: Floats) -> list[float | None]:
    return [round(float(v), 5) if np.isfinite(v) else None for v in values]


# Places a solved path in the world: up, the floor below the camera, scale, heading of the first frame.
#
# Up is told by Snell's window, the bright circle of sky overhead that every frame shows.

_FRAMES = 6
"""Key frames that are looked at, evenly spaced."""
_LARGEST_SPREAD = np.radians(4.0)
"""Largest angle of a frame's window from the mean of all in the scene's axes; waves shift it by a degree or two."""
_MAP = (64, 32)


def window_up(paths: tuple[Path, ...], rotation: Floats) -> Floats | None:
    """Return up (3,) in the scene's axes; None where fewer than half of the frames show a window, or they disagree.

    paths, rotation (k, 3, 3): key frames, and their rotations from camera axes to the scene.
    """
    import cv2

    chosen = np.unique(np.linspace(0, len(paths) - 1, _FRAMES).astype(int))
    ups = []
    for k in chosen.tolist():
        grey = np.asarray(cv2.imread(str(paths[k]), cv2.IMREAD_GRAYSCALE), np.float64)
        light = cv2.resize((grey / 255.0) ** 2.2, _MAP, interpolation=cv2.INTER_AREA)
        found = estimate_horizon(np.repeat(light[..., None], 3, axis=-1))
        if found.reliable:
            ups.append(rotation[k] @ level_matrix(found.roll_rad, found.pitch_rad)[1])
    if 2 * len(ups) < len(chosen) or not ups:
        return None
    mean = unit(np.mean(ups, axis=0))
    apart = np.arccos(np.clip(np.array(ups) @ mean, -1.0, 1.0))
    return mean if apart.max() <= _LARGEST_SPREAD else None


GUESSED_HEIGHT_M, GUESSED_DISTANCE_M = 2.0, 5.0
"""Height over the floor, or median distance of the points, that is assumed where no measure is given."""
_LARGEST_SLOPE = np.radians(30.0)
"""Largest angle between the floor's normal and up."""
_BELOW = np.sin(np.radians(20.0))
"""Sine of the depression below which points are looked at for a floor."""
_TRIALS = 400
_THICKNESS = 0.08
"""Distance from the plane over the camera's height up to which a point lies on it: sand ripples and stones."""
_LEAST_POINTS, _LEAST_SUPPORT = 30, 0.15
"""Fewest points, and least share of the points below the camera, of a floor."""
_USUAL_SLOPE = np.radians(10.0)
"""Deviation of a floor's slope: of planes with as many points the more level one is taken. Without this rule, and that
nothing lies below a floor, planes through rocks were taken under strong caustics, whose heights were 11 to 32 % off."""
_LEVEL_SUPPORT, _LEVEL_SLOPE = 0.5, np.radians(15.0)
"""Least support and largest slope against the frames' own up of a floor that is taken for level."""
_LEVELLED = np.radians(1.0)
"""Largest rms angle of the frames' own up about its mean of a clip that is levelled by the camera."""
_WINDOW_OFF = np.radians(3.0)
"""Angle of Snell's window from the frames' own up above which it is believed: twice the error of its edge."""
_SEED = 1


def fit_floor(points: Floats, camera: Floats, up: Floats) -> tuple[Floats, float, float, int] | None:
    """Return the plane normal . x = offset of most points (n, 3) below a camera (3,) that is level and has few points
    below itself; None where none has enough. With normal (3,) and offset: its share of the points below the camera, and
    their number.

    Planes through three random points are tried (Fischler & Bolles 1981), and the best is fitted to its points. Its
    normal is within 30 degrees of `up` (3,), and it is below the camera.
    """
    # Take points that lie clearly below the camera
    away = points - camera
    below = away[(away @ up) < -_BELOW * np.linalg.norm(away, axis=1)]
    if len(below) < _LEAST_POINTS:
        return None
    # Try planes through three random points each: RANSAC
    rng = np.random.default_rng(_SEED)
    corner = below[rng.integers(0, len(below), (_TRIALS, 3))]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    length = np.linalg.norm(normal, axis=1)
    real = length > 1e-12
    normal, corner = normal[real] / length[real, None], corner[real]
    normal *= np.where(normal @ up < 0.0, -1.0, 1.0)[:, None]
    height = -np.sum(normal * corner[:, 0], axis=1)
    fit = (normal @ up > np.cos(_LARGEST_SLOPE)) & (height > 0.0)
    normal, height = normal[fit], height[fit]
    if not len(normal):
        return None
    # Take a level plane with most points on it and few below it, and fit it to its points again and again
    over = (normal @ below.T) / height[:, None] + 1.0
    slope = np.arccos(np.clip(normal @ up, -1.0, 1.0))
    on = np.mean(np.abs(over) < _THICKNESS, axis=1) * np.exp(-0.5 * np.square(slope / _USUAL_SLOPE))
    best = int(np.argmax(on - np.mean(over < -_THICKNESS, axis=1)))
    n, h = normal[best], float(height[best])
    for _ in range(5):
        on = below[np.abs(below @ n + h) < _THICKNESS * h]
        if len(on) < 3:
            return None
        centre = on.mean(axis=0)
        n = np.linalg.svd(on - centre, full_matrices=False)[2][-1]
        n = n * np.sign(n @ up)
        h = -float(n @ centre)
        if h <= 0.0:
            return None
    # Refuse a plane that too few points lie on
    inside = np.abs(below @ n + h) < _THICKNESS * h
    support = float(np.mean(inside))
    if np.count_nonzero(inside) < _LEAST_POINTS or support < _LEAST_SUPPORT:
        return None
    return n, float(n @ camera) - h, support, int(np.count_nonzero(inside))


@dataclass(frozen=True, slots=True, eq=False)
class World:
    """Similarity from a solved scene to the world: x -> scale rotation (x - origin); sentences on up and scale.

    depth_m: of the first camera, of a depth log.
    """

    origin: Floats
    rotation: Floats
    scale: float
    up: str
    scale_from: str
    floor: FittedFloor | None
    depth_m: float | None = None

    def place(self, points: Floats) -> Floats:
        """Return points (n, 3) of the solved scene in the world [m]."""
        placed: Floats = self.scale * (points - self.origin) @ self.rotation.T
        return placed


def rotation_to_world(up: Floats, first: Floats) -> Floats:
    """Return the rotation (3, 3) that takes `up` to +y and the level heading of a camera (3, 3) to -z."""
    y = unit(up)
    forward = -first[:, 2]
    level = forward - (forward @ y) * y
    if np.linalg.norm(level) < 1e-3:  # it looks straight up or down: the top of its picture is the heading
        level = first[:, 1] - (first[:, 1] @ y) * y
    z = -unit(level)
    return np.stack([np.cross(y, z), y, z])


def world_of(
    position: Floats,
    rotation: Floats,
    points: Floats,
    gravity_up: Floats | None,
    window: Floats | None = None,
    measure: Measure | None = None,
    time_s: Floats | None = None,
    by: str = "the clip's gravity",
) -> World:
    """Return where a solved scene is in the world.

    position (n, 3), rotation (n, 3, 3), time_s (n,): cameras, the first at the shot's start. points (m, 3). gravity_up
    (n, 3): up in each camera's axes, of the clip's metadata, if there is; by: of which of these. window (3,): up by
    Snell's window. Up is gravity's, or else the frames' own on average; where the window is more than three degrees
    off, the window's; else,
    of clips that roll and pitch, the normal of a floor that is nearly level for the frames. measure: of the scale;
    without one it is a guess.
    """
    measure = Measure() if measure is None else measure
    own = rotation[:, :, 1] if gravity_up is None else np.einsum("nij,nj->ni", rotation, gravity_up)
    up: Floats = unit(np.mean(own, axis=0))
    words = "the frames' own up on average" if gravity_up is None else by
    plane = fit_floor(points, position[0], up) if len(points) else None
    rolls = float(np.sqrt(np.mean(np.sum(np.square(own - up), axis=1)))) > _LEVELLED
    if gravity_up is None and window is not None and _angle(window, up) > _WINDOW_OFF:
        words = f"the window of light overhead, {np.degrees(_angle(window, up)):.1f} degrees off the frames' own up"
        up = window
    elif gravity_up is None and rolls and plane is not None and plane[2] >= _LEVEL_SUPPORT:
        slope = _angle(plane[0], up)
        if slope <= _LEVEL_SLOPE:
            up, words = plane[0], f"the floor's normal, {np.degrees(slope):.1f} degrees off the frames' own up"
    turned = rotation_to_world(up, rotation[0])
    height = None  # along up from the first camera to the plane
    if plane is not None:
        normal, offset, support, count = plane
        height = (float(normal @ position[0]) - offset) / float(normal @ up)
    scale, sentence, depth = _scale(position, rotation, points, up, height, measure, time_s)
    floor = None
    if height is not None:
        floor = FittedFloor(-scale * height, float(np.degrees(_angle(normal, up))), support, count)
    return World(position[0], turned, scale, words, sentence, floor, depth)


def _angle(a: Floats, b: Floats) -> float:
    return float(np.arccos(np.clip(a @ b, -1.0, 1.0)))


def _scale(
    position: Floats, rotation: Floats, points: Floats, up: Floats, height: float | None, measure: Measure,
    time_s: Floats | None,
) -> tuple[float, str, float | None]:  # fmt: skip
    """Return metres per unit of the scene, a sentence on where that is from, and the camera's depth [m] if known.

    height: of the first camera over the floor in the scene, None without a floor.
    """
    # Take what is known best: a length, a depth log, the height over the floor
    if not len(points):
        return 1.0, "none is needed: the camera stays where it is", None
    if measure.length is not None:
        looks = looks_of(measure.length, measure.frame_width, rotation[0])
        scale = scale_from_length(points, position[0], looks, measure.length[2])
        return scale, f"the two pixels of --length are {measure.length[2]:g} m apart, as given", None
    if measure.depth_log is not None and time_s is not None:
        scale, depth, start = scale_from_depths(
            measure.depth_log, measure.depth_offset_s, time_s, (position - position[0]) @ up
        )
        found = "as given" if measure.depth_offset_s is not None else "as found"
        return scale, f"the depth log; the shot starts at {start:.2f} s of it, {found}", depth
    if height is not None:
        wanted = GUESSED_HEIGHT_M if measure.height_m is None else measure.height_m
        given = "as given" if measure.height_m is not None else "a guess: give --height, --length or --depth-log"
        return wanted / height, f"the camera is {wanted:g} m over the floor at the first frame, {given}", None
    # Nothing is known: guess by the typical distance
    distance = float(np.median(np.linalg.norm(points - position[0], axis=1)))
    words = f"half of the points are nearer than {GUESSED_DISTANCE_M:g} m, a guess"
    words += ": no floor was found for --height" if measure.height_m is not None else ": give --length or --depth-log"
    return GUESSED_DISTANCE_M / distance, words, None


# Scale of a solved scene: from the camera's height, a length between two pixels, or the log of a dive computer.

_NEAR = np.radians(4.0)
"""Largest angle between a picked pixel and the solved points that tell its distance."""
_NEIGHBOURS = 5
_LEAST_RISE_M = 0.15
"""Least standard deviation [m] of the depths of a log that tells a scale: three times the resolution of a computer."""
_LEAST_AGREEMENT = 0.9
"""Least correlation between the depths of a log and the heights of a path."""
_OFFSET_STEP_S = 0.25


Length = tuple[tuple[float, float], tuple[float, float], float]
"""Two pixels (column, row) of the first frame, and the length [m] between what they show."""


def parse_length(text: str) -> Length:
    """Return a length of the form X,Y:X,Y=METRES; raise `ParameterError`."""
    number = r"\s*(\d+\.?\d*)\s*"
    match = re.fullmatch(f"{number},{number}:{number},{number}={number}", text)
    if match is None:
        raise ParameterError(
            f"--length - must be two pixels and metres (got {text!r}) - write X,Y:X,Y=METRES, as in 812,700:990,705=1.5"
        )
    x, y, u, v, metres = (float(group) for group in match.groups())
    if metres <= 0.0:
        raise ParameterError(f"--length - must be more than 0 (got {metres:g}) - give metres")
    return (x, y), (u, v), metres


@dataclass(frozen=True, slots=True)
class Measure:
    """What tells the scale; nothing, or one of three.

    height_m: of the camera over the floor at the first frame. length: in a frame of `frame_width` columns. depth_log:
    CSV file of a dive computer with the columns time_s and depth_m; depth_offset_s: its time at the clip's start, None
    searches for it.
    """

    height_m: float | None = None
    length: Length | None = None
    depth_log: Path | None = None
    depth_offset_s: float | None = None
    frame_width: int = 0

    def __post_init__(self) -> None:
        if sum(v is not None for v in (self.height_m, self.length, self.depth_log)) > 1:
            raise ParameterError("scale - is given twice (got several of --height, --length, --depth-log) - give one")
        if self.height_m is not None and not (np.isfinite(self.height_m) and self.height_m > 0.0):
            raise ParameterError(f"--height - must be more than 0 (got {self.height_m}) - give metres over the floor")


def scale_from_length(points: Floats, camera: Floats, looks: Floats, metres: float) -> float:
    """Return metres per unit of a scene, from the length between what two directions (2, 3) of a camera (3,) show.

    points (n, 3): of the scene; each direction's distance is the median of the five nearest by angle. Raises
    `ParameterError` where there are none within four degrees.
    """
    away = points - camera
    distance = np.linalg.norm(away, axis=1)
    ends = []
    for name, look in zip(("first", "second"), looks, strict=True):
        angle = np.linalg.norm(away / distance[:, None] - look, axis=1)
        order = np.argsort(angle, kind="stable")[:_NEIGHBOURS]
        order = order[angle[order] < _NEAR]
        if not len(order):
            raise ParameterError(
                f"--length - no point was solved near its {name} pixel (the nearest is {np.degrees(angle.min()):.0f} "
                "degrees away) - pick a place with texture"
                if len(angle)
                else "--length - no points were solved, as the camera does not move - leave it out"
            )
        ends.append(look * np.median(distance[order]))
    apart = float(np.linalg.norm(ends[0] - ends[1]))
    if apart <= 0.0:
        raise ParameterError("--length - is between equal pixels - pick two places")
    return metres / apart


def _read_depth_log(path: Path) -> tuple[Floats, Floats]:
    """Return times [s] and depths [m] of a log; raise `ParameterError`."""
    table = read_table(path)
    missing = [name for name in ("time_s", "depth_m") if name not in table]
    if missing:
        raise ParameterError(f"{path} - columns are missing (got no {', '.join(missing)}) - give time_s, depth_m")
    known = np.isfinite(table["time_s"]) & np.isfinite(table["depth_m"])
    times, depths = table["time_s"][known], table["depth_m"][known]
    if len(times) < 2 or np.any(np.diff(times) <= 0.0):
        raise ParameterError(f"{path} - times must ascend (got {len(times)} rows) - sort the rows")
    return times, depths


def scale_from_depths(log: Path, offset_s: float | None, time_s: Floats, height: Floats) -> tuple[float, float, float]:
    """Return metres per unit of a scene, the depth [m] at the first frame, and the log's time [s] at the first frame.

    log, offset_s: see `Measure`. height (n,): of the camera in the scene, upwards, at times (n,) from the clip's start.
    Least squares of depth = first depth - scale (height - first height); an unknown start of the clip in the log is
    that of the best correlation, in steps of a quarter of a second. Raises `ParameterError` where both disagree.
    """
    times, depths = _read_depth_log(log)
    span = float(time_s[-1] - time_s[0])
    if offset_s is None:
        starts = np.arange(times[0], max(times[-1] - span, times[0]) + 1e-9, _OFFSET_STEP_S)
    else:
        starts = np.array([offset_s])
    best = max(starts, key=lambda start: _agreement(np.interp(time_s - time_s[0] + start, times, depths), height))
    depth = np.interp(time_s - time_s[0] + best, times, depths)
    agreement = _agreement(depth, height)
    if agreement < _LEAST_AGREEMENT:
        raise ParameterError(
            f"{log} - its depths do not fit the camera's path (correlation {agreement:.2f}, depths change by "
            f"{np.ptp(depth):.2f} m) - check the clip's start in the log, or give --height"
        )
    a = height - height.mean()
    scale = -float(a @ (depth - depth.mean())) / float(a @ a)
    return scale, float(depth.mean() - scale * (height[0] - height.mean())), float(best)


def _agreement(depth: Floats, height: Floats) -> float:
    """Return the correlation of depth and height, positive where one falls as the other rises; -1 for level dives."""
    if np.std(depth) < _LEAST_RISE_M or np.std(height) <= 0.0:
        return -1.0
    return -float(np.corrcoef(depth, height)[0, 1])


def looks_of(length: Length, width: int, rotation: Floats) -> Floats:
    """Return the directions (2, 3) in the scene of a length's pixels of a frame of `width` columns."""
    from mr360uw.base.sphere import direction_from_frame

    first, second, _ = length
    x, y = np.array([first, second]).T
    if not (np.all(x <= width) and np.all(y <= width / 2)):
        raise ParameterError(f"--length - a pixel is outside of the frame (got {first}, {second})")
    return unit(direction_from_frame(x, y, width, width // 2)) @ rotation.T
