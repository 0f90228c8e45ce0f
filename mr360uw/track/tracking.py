# SPDX-License-Identifier: Apache-2.0
"""Tracks the camera of a clip shot by shot: reads it twice, solves key frames, then the frames between."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.files import check_work_folder, make_work_folder, remove_work_folder, write_whole
from mr360uw.base.input_files import holds_text, stamp
from mr360uw.base.parameters import checked
from mr360uw.base.progress import Progress, Steps
from mr360uw.errors import ParameterError, VideoError
from mr360uw.track.camera_track import CameraTrack, Measure, World, window_up, world_of
from mr360uw.track.colmap import load_colmap
from mr360uw.track.floor_mesh import FloorMesh
from mr360uw.track.key_frames import KeyFrames, key_frames_of_shot, read_key_frames
from mr360uw.track.key_poses import BETWEEN, MASK, WIDTH, KeyPoses, solve_between, solve_key_frames
from mr360uw.track.slip import drifting_light, predicted_slip
from mr360uw.types import Floats
from mr360uw.video import VideoReader, open_video

_KEPT = "key frames and matches 2"
"""Names what a kept folder holds; another number where that changes."""


@dataclass(frozen=True, slots=True, eq=False)
class TrackedShot:
    """Frames start <= index < stop of a clip, their track, or why there is none."""

    start: int
    stop: int
    track: CameraTrack | None
    problem: str = ""


@checked
def track_camera(
    video: str | Path,
    *,
    height_m: float | None = None,
    measure: Measure | None = None,
    mask: str | Path | None = None,
    eye: Literal["left", "right"] | None = None,
    mask_only: bool = False,
    keep: str | Path | None = None,
    progress: Progress | None = None,
) -> CameraTrack:
    """Return the path of the camera of a 360 clip without cuts, solved from its pictures.

    The first camera is the origin and looks towards -z. Without `height_m` or `measure` the scale is a guess: a camera
    2 m over the floor.

    Parameters
    ----------
    video : str or Path
        The clip.
    height_m : float, optional
        Height [m] of the camera over the floor at time 0; sets the scale, which pictures alone do not tell.
    measure : Measure, optional
        Another measure of the scale.
    mask : str or Path, optional
        Picture of the clip's size, black where nothing is tracked; what stands still in a picture that moves is left
        out anyway, unless `mask_only`.
    eye : {"left", "right"}, optional
        Eye of a stereo plate.
    mask_only : bool
        Leave out nothing besides the mask.
    keep : str or Path, optional
        Folder for key frames and matches, from which a run that was stopped goes on.
    progress : callable, optional
        Is called with (steps done, all of them).

    Returns
    -------
    CameraTrack
        Positions, rotations, floor points and how good they are.

    Raises
    ------
    Mr360uwError
        If pycolmap is not installed.
    VideoError
        If the clip cannot be read.
    ParameterError
        If it cannot be tracked, or has cuts: see `track_shots`.

    See Also
    --------
    uw.CameraTrack : What is returned.
    uw.depth_of_clip : Finds the distances in the clip with the track.
    uw.floor_from_track : Makes a mesh of the floor from its points.

    Examples
    --------
    >>> try:
    ...     track = uw.track_camera("missing.mp4", height_m=1.5)
    ... except uw.Mr360uwError as error:
    ...     print(type(error).__name__)
    Mr360uwError
    """
    measure = measure if height_m is None else Measure(height_m=height_m)
    found = track_shots(
        video, measure=measure, mask=mask, eye=eye, mask_only=mask_only, keep=keep, progress=progress, whole=True
    )[0].track
    assert found is not None  # of a clip without cuts the problem is raised
    return found


def track_shots(
    video: str | Path,
    *,
    measure: Measure | None = None,
    mask: str | Path | None = None,
    eye: Literal["left", "right"] | None = None,
    mask_only: bool = False,
    keep: str | Path | None = None,
    progress: Progress | None = None,
    whole: bool = False,
) -> list[TrackedShot]:
    """Return the shots of a 360 clip, each tracked in a world of its own; arguments and errors of `track_camera`.

    A shot that cannot be tracked says why; of a clip without cuts that is raised. whole: refuse a clip with cuts.
    """
    # Check what is asked for before the clip is read
    load_colmap()
    if keep is not None:
        check_work_folder(Path(keep))
    with open_video(video, eye=eye) as clip:
        left_out = None if mask is None else _read_mask(Path(mask), clip)
    with open_video(video, eye=eye) as clip, _folder(video, mask, (eye, mask_only), keep) as folder:
        # Read the clip once: key frames of each shot, and its cuts
        measure = replace(measure or Measure(), frame_width=clip.width)
        steps = Steps(progress, (clip.frame_count or 0) * (1 + BETWEEN))
        (folder / "keys").mkdir(exist_ok=True)
        reading = read_key_frames(clip, folder / "keys", steps)
        if whole and reading.cuts:
            cuts = ", ".join(map(str, reading.cuts))
            raise ParameterError(f"{video} - is cut (got new shots at frames {cuts}) - give one shot, or track_shots")
        # Solve each shot by itself; one that fails leaves the others
        stated = stated_up(clip, np.array(reading.times_s))
        shots = []
        for start, stop in reading.shots:
            where = f"{video}" if len(reading.shots) == 1 else f"{video} frames {start}:{stop}"
            try:
                keys = key_frames_of_shot(reading, folder / "keys", start, stop, where)
                own = folder / f"shot{start:08d}"
                own.mkdir(exist_ok=True)
                level = None if stated is None else (stated[0][start:stop], stated[1])
                track = _solved(where, clip, keys, (left_out, mask_only), own, steps, level, measure)
                shots.append(TrackedShot(start, stop, track))
            except ParameterError as error:
                if len(reading.shots) == 1:
                    raise
                shots.append(TrackedShot(start, stop, None, str(error)))
    return shots


def _solved(
    where: str, clip: VideoReader, keys: KeyFrames, masking: tuple[NDArray[np.bool_] | None, bool], folder: Path,
    steps: Steps, stated: tuple[Floats, str] | None, measure: Measure,
) -> CameraTrack:  # fmt: skip
    """Return the track of a shot."""
    poses = solve_key_frames(where, keys, masking[0], folder, steps, mask_only=masking[1])
    frames = solve_between(clip, keys, poses, steps)
    window = window_up(poses.paths, poses.rotation) if stated is None else None
    gravity, by = stated or (None, "")
    world = world_of(*frames[:2], poses.points, gravity, window, measure, keys.time_s, by)
    return _in_world(keys, poses, frames, world, folder / MASK)


@contextmanager
def _folder(
    video: str | Path, mask: str | Path | None, settings: tuple[str | None, bool], keep: str | Path | None
) -> Iterator[Path]:
    """Yield the folder of key frames and matches: a temporary one, or one that is kept and emptied for other input."""
    if keep is None:
        with tempfile.TemporaryDirectory(prefix="mr360uw-track-") as made:
            yield Path(made)
        return
    folder, files = Path(keep), [Path(video)] + ([] if mask is None else [Path(mask)])
    of = json.dumps([_KEPT, settings, *(stamp(path) for path in files)])
    note = folder / "input.json"
    make_work_folder(folder)
    if not holds_text(note, of):
        remove_work_folder(folder)
        make_work_folder(folder)
        write_whole(note, of)
    yield folder


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


def stated_up(clip: VideoReader, time_s: Floats) -> tuple[Floats, str] | None:
    """Return up in the camera's axes (n, 3) that a clip states, and where: by its GoPro's gravity, or else by the pose
    of the panorama. None where it states neither.
    """
    from mr360uw.ibl.tilt import level_at, level_from_gpmf, level_matrix
    from mr360uw.video.demux import gpmf_payloads

    try:
        level = level_from_gpmf(gpmf_payloads(clip.path), float(clip.frame_rate))
    except (VideoError, ParameterError):  # clips of other cameras have none
        _, pitch, roll = np.radians(clip.pose_deg).tolist()
        up = level_matrix(roll, pitch)[1]
        return (np.tile(up, (len(time_s), 1)), "the pose that its file states") if roll or pitch else None
    return np.stack([level_at(level, float(t))[1] for t in time_s]), "the clip's gravity"


def _in_world(
    keys: KeyFrames, poses: KeyPoses, frames: tuple[Floats, Floats, Floats, Floats], world: World, mask: Path
) -> CameraTrack:
    """Return the track of all frames in the world's axes."""
    residual, observed = frames[2:]
    position, rotation, points = world.place(frames[0]), world.rotation @ frames[1], world.place(poses.points)
    (slip, feature), slip_m = poses.held_out, None
    # Free the path from light that carried it along, and predict its slip
    away, unsure, drifts = drifting_light(poses.paths, mask, poses.index, keys.time_s, (position, rotation), points)
    position = position - away
    if poses.others:
        own = poses.position, poses.rotation
        # Light that drifts pulls all measures; where it made them, the floor does, and the path is as good as the least
        choice = np.min if away.any() else np.max if drifts else np.median
        predicted = world.scale * predicted_slip(own, poses.others, _DISTANCE_M / world.scale, choice)
        # Two paths of which one drifts along differ by that between all pairs of frames
        slip_m = float(np.hypot(predicted, np.sqrt(2.0) * np.linalg.norm(unsure.std(axis=0))))
    column = np.floor(12.0 * (np.arctan2(observed[:, 0], -observed[:, 2]) / (2.0 * np.pi) + 0.5)).clip(0, 11)
    coverage = len(np.unique(6.0 * column + np.floor(3.0 - 3.0 * observed[:, 1]).clip(0, 5))) / 72.0
    return CameraTrack(
        poses.kind, keys.time_s, position, rotation, residual, residual * 360.0 / keys.width, poses.index, points,
        poses.error_px, coverage, keys.width,
        world.floor, world.up, world.scale_from, _known(np.median, slip), _known(np.max, slip),
        _known(np.median, feature), world.depth_m, poses.agreed, slip_m,
        float(np.linalg.norm(away, axis=1).max()),
    )  # fmt: skip


def _known(middle: Callable[[Floats], float], values: Floats) -> float | None:
    """Return the median or largest of the values that are known, None if none is."""
    known = values[np.isfinite(values)]
    return float(middle(known)) if len(known) else None


# The reports of a solved camera and of a floor in plain words.

_LEVEL_DEG = 1.0
"""Tilt [degrees] below which a flat floor may be taken for level: 5 cm over 3 m."""


def floor_lines(floor: FloorMesh, track: Path, mesh: Path) -> list[str]:
    """Return the printed report of a floor: its shape, how far it is known, and the lines of a scene that use it."""
    shape = "a plane" if floor.flat else "a relief"
    lines = [
        f"floor     {shape}, tilt {floor.tilt_deg:.1f} degrees, the camera {floor.camera_m:.2f} m above it",
        f"points    {floor.points}, {100.0 * floor.outliers:.0f} % of them left out; the others are within "
        f"{100.0 * floor.spread_m:.1f} cm of it",
        f"known     {floor.known_m2:.0f} square metres; beyond, it runs out into a plane",
        f'scene     [receiver] kind = "mesh", path = "{mesh.name}"   # with camera.track = "{track.stem}.csv"',
    ]
    if floor.flat and floor.tilt_deg < _LEVEL_DEG:
        lines.append(f'          or kind = "plane", height_m = {floor.plane_y_m:.2f}: it is level')
    return lines


_DISTANCE_M = 5.0
"""Distance [m] of an object whose slip is told."""
_GOOD_PX, _USABLE_PX = 0.6, 1.2
"""Largest median residual [px] of a good and of a usable track. Below, codec noise; above, features slip."""
_GOOD_SHARE, _USABLE_SHARE = 0.9, 0.6
"""Least share of frames that were solved rather than interpolated."""
_GOOD_AGREED, _USABLE_AGREED = 0.8, 0.75
"""Least share of what is seen again that fits the path. Of paths that light made over textured floors it is 0.1 to
0.79, as of all before they are freed from it; of paths by the floor 0.5 to 0.98."""
_GOOD_SLIP, _USABLE_SLIP = 0.015, 0.05
"""Largest predicted slip over the length of the path. The true one may be twice as large."""
_FAR = 50.0
"""Largest extent of a path over the median distance of its points; a wrong pose reaches thousands."""
_KINDS = {"still": "stands still", "turning": "turns on the spot", "moving": "moves"}


def _length_m(track: CameraTrack) -> float:
    return float(np.linalg.norm(np.diff(track.position, axis=0), axis=1).sum())


def verdict(track: CameraTrack) -> str:
    """Return one line that says how good a track is."""
    solved = np.isfinite(track.residual_px)
    share, residual = float(np.mean(solved)), float(np.nanmedian(track.residual_px))
    agreed = 1.0 if track.agreed is None else track.agreed
    slips = 0.0 if track.slip_m is None else track.slip_m / max(_length_m(track), 1e-9)
    usable = residual <= _USABLE_PX and share >= _USABLE_SHARE and agreed >= _USABLE_AGREED and slips <= _USABLE_SLIP
    good = residual <= _GOOD_PX and share >= _GOOD_SHARE and agreed >= _GOOD_AGREED and slips <= _GOOD_SLIP
    # A path that leaves its own points behind is doubtful, and one that was freed from light is not good
    away = np.linalg.norm(track.points - track.position[0], axis=1)
    lost = len(away) and np.ptp(track.position, axis=0).max() > _FAR * np.median(away)
    word = "doubtful" if lost or not usable else "good" if good and not track.light_m else "usable"
    slip_m = _DISTANCE_M * np.radians(np.nanmedian(track.residual_deg)) if track.slip_m is None else track.slip_m
    return (
        f"{word}: objects stay in place to {100.0 * slip_m:.1f} cm at {_DISTANCE_M:g} m"
        f"{', at best' if agreed < _USABLE_AGREED else ''}; "
        f"{np.count_nonzero(solved)} of {len(solved)} frames solved; residual {residual:.2f} px"
    )


def report_lines(track: CameraTrack) -> list[str]:
    """Return the printed report: what the camera does, the verdict, up, scale, floor."""
    lines = [f"the camera {_KINDS[track.kind]}"]
    if np.isfinite(track.residual_px).any():
        lines.append(verdict(track))
    if track.kind == "moving":
        seen = f"; {len(track.points)} points; features over {100.0 * track.coverage:.0f} % of the sphere"
        path = f"path      {_length_m(track):.2f} m in {np.ptp(track.time_s):.1f} s"
        lines.append(path + seen if len(track.points) else path)
    if track.agreed is not None:
        drifts = "" if track.agreed >= _GOOD_AGREED else ": light that drifts, as caustics do, may have made it"
        lines.append(f"seen again {100.0 * track.agreed:.0f} % of the matches over half a second fit the path{drifts}")
    if track.light_m:
        lines.append(
            f"light     drifts over the floor and had carried the path off by {track.light_m:.2f} m: taken out"
        )
    if track.held_out_px is not None:
        ground = ""
        if track.slip_px is not None:
            ground = f"the ground slips by {track.slip_px:.2f} px (worst key frame {track.worst_slip_px:.2f}), "
        lines.append(
            f"held out  {ground}single features by {track.held_out_px:.2f} px, in key frames that did not place them; "
            f"px of a panorama {WIDTH} wide"
        )
    lines += [f"up        {track.up}", f"scale     {track.scale}"]
    if track.depth_m is not None:
        lines.append(f"depth     [camera] depth_m = {track.depth_m:.2f}")
    if (floor := track.floor) is not None:
        lines.append(
            f"floor     [receiver] height_m = {floor.height_m:.2f}   # tilt {floor.tilt_deg:.1f} degrees; "
            f"{floor.points} points, {100.0 * floor.support:.0f} % of those below the camera"
        )
    return lines
