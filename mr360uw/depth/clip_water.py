# SPDX-License-Identifier: Apache-2.0
"""Water of a tracked clip whose distances are known: frames of one shot, their maps, and the fit to them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.parameters import checked
from mr360uw.base.progress import Progress, Steps
from mr360uw.base.sphere import directions, frame_from_direction
from mr360uw.depth.clip_depth import ClipPath
from mr360uw.depth.depth_files import DepthClip
from mr360uw.depth.sphere_stereo import SURE, DepthMap
from mr360uw.errors import ParameterError
from mr360uw.medium.open_water import structure
from mr360uw.medium.water_by_distance import SeenPlaces, WaterByDistance, water_by_distance
from mr360uw.track.camera_track import CameraTrack
from mr360uw.types import Array, Floats
from mr360uw.video import open_video

_FRAMES = 24
"""Frames of the clip that are compared, evenly spread. Half: caustics count for more; double: twice the time."""
_LEAST_FRAMES = 6


@checked
def water_of_clip(
    video: str | Path,
    folder: str | Path,
    track: CameraTrack | str | Path,
    *,
    eye: Literal["left", "right"] | None = None,
    progress: Progress | None = None,
) -> WaterByDistance:
    """Return attenuation and veil of the water in a 360 clip, from what it shows at several distances.

    The light of rocks and walls fades with distance, and the veil of the water comes instead. Both are told for each
    channel, with the interval that nine of ten resampled clips lie in.

    Parameters
    ----------
    video : str or Path
        The clip, of a camera that moves.
    folder : str or Path
        Folder of its distances, which `depth_of_clip` wrote.
    track : CameraTrack or str or Path
        Path of the camera that the distances were made with. Its scale is that of the attenuations.
    eye : {"left", "right"}, optional
        Eye of a stereo plate.
    progress : callable, optional
        Is called with (steps done, all of them).

    Returns
    -------
    WaterByDistance
        Attenuation [1/m], veil in the light of the clip, visibility [m] and the nearest Jerlov type. `problem` says
        why the clip does not tell them, if so.

    Raises
    ------
    ParameterError
        For a camera that stands, a track of another clip, and fewer than six frames with a pose.
    VideoError
        Where maps are missing.

    See Also
    --------
    uw.depth_of_clip : Writes the distances.
    uw.track_camera : Solves the path of the camera.
    uw.medium.fit_water : The water by the look of one picture.

    Notes
    -----
    Light along a ray as by Akkaynak & Treibitz 2018, with the light of each place eliminated: see
    `medium/water_by_distance.py`. The exposure must be the same in all frames.

    Examples
    --------
    >>> try:
    ...     uw.depth.water_of_clip("dive.mp4", "depth", "track.csv")
    ... except uw.Mr360uwError as error:
    ...     print("track.csv" in str(error))
    True
    """
    import cv2

    with open_video(video, eye=eye) as clip:
        # Choose frames of the longest shot, spread over it
        path = ClipPath(video, clip, track, eye)
        frames = np.flatnonzero(path.shot == np.bincount(path.shot[path.shot >= 0]).argmax())
        chosen = np.unique(frames[np.round(np.linspace(0, len(frames) - 1, _FRAMES)).astype(int)]).tolist()
        if len(chosen) < _LEAST_FRAMES:
            raise ParameterError(
                f"{video} - is too short to tell its water (got {len(chosen)} frames with a pose) - give a clip of "
                f"{_LEAST_FRAMES} or more"
            )
        # Read light and distances of each, of one size
        maps, steps, lit = DepthClip(Path(folder), size=(clip.width, clip.height)), Steps(progress, len(chosen)), []
        for frame in clip.frames(chosen[0], chosen[-1] + 1):
            if frame.index not in chosen:
                continue
            found = maps.at(frame.index)
            image = np.asarray(frame.image_linear, np.float32)
            if image.shape[:2] != found.distance_m.shape:
                size = found.distance_m.shape[::-1]
                image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.float32)
            lit.append(LitFrame(image, found, path.position[frame.index], path.rotation[frame.index]))
            steps.done(1)
    return water_by_distance(seen_places(lit))


# Places of a scene that frames with known poses and distances show, and their light in every frame.
#
# A place is a window of pixels of one frame whose distances are sure and lie on a plane. Its points are looked up in
# all other frames; a place counts in a frame that shows it as far away as it is, not what is in front of it.


_SIDE_RAD = 0.08
"""Width of a window [rad]: 13 pixels of 1024. Half: pixels of its edges count as much as those inside; double: few
windows are level."""
_POINTS = 7
"""Points along each side of a window."""
_EVERY = 3
"""Every third frame gives places of its own."""
_STEP_RAD = 0.12
"""Distance [rad] of windows in a frame."""
_LEVEL = 0.35
"""Greatest range of distances in a window, over their mean: more is the edge of something."""
_SURE_SHARE = 0.9
"""Share of a window whose distances are sure."""
_AGREE, _AGREES = 0.06, 0.8
"""Difference of distances, relative, up to which a frame shows a point itself, and share of points that must be."""
_RESOLVED_PX = 0.5
"""Standard deviation [px] of what a pixel and its interpolation average over."""
_BLURS_PX = np.array([0.0, 0.3, 0.6, 0.9, 1.3, 2.0])
"""Blurs that are made of a frame [px]."""
_HIGHEST = 0.8
"""Greatest y of directions, either way: nearer the poles is the camera's own rig or its float."""
_CLIPPED, _BLACK = 0.95, 0.001
"""Linear light between which a pixel tells its light."""
_PART_M = 1.0
"""Side [m] of the cubes that are resampled whole."""
_OPEN_UP, _OPEN_BINS = (-0.2, 0.35), 11
"""Range of y in which open water is looked for, and into how many bands it is divided."""
_LEAST_RED = 0.3
"""Rank in red up to which a smooth direction counts as open water."""
_SMOOTH = 0.03
"""Structure (`medium.open_water.structure`) up to which a direction may be open water."""
_LEAST_OPEN = 0.004
"""Share of a band's pixels that must be open water."""
_LARGEST_STEP = 0.35
"""Difference of the logarithm of light from one band to the next above which one of the two is something else: the
shade of rocks whose distance is not sure. Open water has .1."""


@dataclass(frozen=True, slots=True, eq=False)
class LitFrame:
    """A frame with its pose and distances. image: (H, W, 3) linear light. found: its map, (H, W). position: (3,) [m];
    rotation: (3, 3), world from camera axes.
    """

    image: Floats
    found: DepthMap
    position: Floats
    rotation: Floats


def seen_places(frames: Sequence[LitFrame]) -> SeenPlaces:
    """Return the places that frames show, in all of them, and the open water."""
    points = np.concatenate([_windows(frame) for frame in frames[::_EVERY]])
    count, middle = len(points), points.mean(axis=1)
    away = middle[:, None] - np.array([frame.position for frame in frames])
    distance = np.maximum(np.linalg.norm(away, axis=-1), 1e-6)
    up = away[..., 1] / distance
    across = away[..., ::2] / distance[..., None]
    seen = np.stack([_shows(points, frame) for frame in frames], axis=1) & (np.abs(up) < _HIGHEST)
    farthest = np.where(seen, distance, 0.0).max(axis=1)
    light = np.zeros((count, len(frames), 3))
    for k, frame in enumerate(frames):
        blur = _RESOLVED_PX * np.sqrt(np.maximum((farthest / distance[:, k]) ** 2 - 1.0, 0.0))
        light[:, k], told = _light(points, frame, blur)
        seen[:, k] &= told
    part = np.unique(np.floor(middle / _PART_M).astype(np.int64), axis=0, return_inverse=True)[1].ravel()
    open_up, open_light = _open_water(frames)
    return SeenPlaces(light, distance, up, across, seen, part, open_up, open_light)


def _windows(frame: LitFrame) -> Array:
    """Return the points (n, p, 3) of a frame's windows in the world."""
    # Spread windows evenly over the sphere, each a grid of points
    height, width = frame.found.distance_m.shape
    half = max(round(0.5 * _SIDE_RAD * width / (2.0 * np.pi)), 2)
    rows, columns = [], []
    for latitude in np.arange(-np.arcsin(_HIGHEST), np.arcsin(_HIGHEST), _STEP_RAD):
        around = np.arange(0.0, 2.0 * np.pi, _STEP_RAD / np.cos(latitude))
        columns.append(around * width / (2.0 * np.pi))
        rows.append(np.full(len(around), height * (0.5 - latitude / np.pi)))
    row, column = (np.concatenate(one).astype(np.int64) for one in (rows, columns))
    offset = np.round(np.linspace(-half, half, _POINTS)).astype(np.int64)
    stretch = 1.0 / np.cos(np.pi * (0.5 - (row + 0.5) / height))
    j = np.clip(row[:, None, None] + offset[:, None], 0, height - 1) + 0 * offset
    across = np.round(stretch[:, None, None] * offset).astype(np.int64)
    i = (column[:, None, None] + across + 0 * offset[:, None]) % width
    j, i = j.reshape(len(row), -1), i.reshape(len(row), -1)
    # Keep those whose distances are sure, lie on a plane, and differ little
    far, sure = frame.found.distance_m[j, i], frame.found.confidence[j, i] >= SURE
    kept = (sure.mean(axis=1) > _SURE_SHARE) & np.all(np.isfinite(far), axis=1)
    j, i, far = j[kept], i[kept], far[kept]
    rays = directions(width, height)[j, i]
    far = _on_plane(rays, far.astype(np.float64))
    good = np.all(np.isfinite(far), axis=1)
    good &= np.ptp(np.where(np.isfinite(far), far, 0.0), axis=1) < _LEVEL * np.median(far, axis=1)
    return np.asarray(frame.position + far[good][..., None] * rays[good] @ frame.rotation.T)


def _on_plane(rays: Array, far_m: Array) -> Array:
    """Return distances (n, p) of the planes through windows: inverse distances are linear in the ray's direction.

    NaN where the window is no plane: its distances are off by more than a few per cent.
    """
    out = np.full(far_m.shape, np.nan)
    for n, (d, s) in enumerate(zip(rays, far_m, strict=True)):
        normal, *_ = np.linalg.lstsq(d, 1.0 / s, rcond=None)
        inverse = d @ normal
        if np.all(inverse > 0.0) and np.sqrt(np.mean((inverse * s - 1.0) ** 2)) < 0.5 * _AGREE:
            out[n] = 1.0 / inverse
    return out


def _places(points: Array, frame: LitFrame) -> tuple[Array, Array, Array]:
    """Return frame coordinates x, y and distances (n, p) [m] of points (n, p, 3) of the world."""
    height, width = frame.found.distance_m.shape
    local = (points - frame.position) @ frame.rotation
    x, y = frame_from_direction(local, width, height)
    return x, y, np.linalg.norm(local, axis=-1)


def _shows(points: Array, frame: LitFrame) -> NDArray[np.bool_]:
    """Return whether a frame shows windows (n, p, 3): its map has most of their points at their distance."""
    height, width = frame.found.distance_m.shape
    x, y, far = _places(points, frame)
    i, j = x.astype(np.int64) % width, np.minimum(y.astype(np.int64), height - 1)
    agrees = (np.abs(frame.found.distance_m[j, i] / far - 1.0) < _AGREE) & (frame.found.confidence[j, i] >= SURE)
    return np.asarray(agrees.mean(axis=1) > _AGREES)


def _light(points: Array, frame: LitFrame, blur_px: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return the mean light (n, 3) of windows (n, p, 3) in a frame, and whether it is neither clipped nor black.

    blur_px: (n,) standard deviation of a blur before, which makes near views as coarse as the farthest: else places
    would take on more of the light around them the farther away they are, as if contrast was lost in the water.
    """
    import cv2

    x, y, _ = _places(points, frame)
    level = np.searchsorted(0.5 * (_BLURS_PX[1:] + _BLURS_PX[:-1]), blur_px)
    light, told = np.zeros((len(points), 3)), np.zeros(len(points), bool)
    margin = 8
    wide = cv2.copyMakeBorder(np.asarray(frame.image, np.float32), 0, 0, margin, margin, cv2.BORDER_WRAP)
    for number, sigma in enumerate(_BLURS_PX):
        use = level == number
        if not np.any(use):
            continue
        soft = wide if sigma == 0.0 else cv2.GaussianBlur(wide, (0, 0), sigma)
        place = (x[use] - 0.5 + margin).astype(np.float32), (y[use] - 0.5).astype(np.float32)
        value = cv2.remap(soft, *place, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        light[use] = value.mean(axis=1, dtype=np.float64)
        most = value.max(axis=-1)
        told[use] = np.all((most < _CLIPPED) & (most > _BLACK), axis=1)
    return light, told


def _open_water(frames: Sequence[LitFrame]) -> tuple[Array, Array]:
    """Return y of directions (m,) and the typical light (m, 3) of open water there.

    Open water has no sure distance, is smooth, and no redder than most of what is.
    """
    # Gather directions that may be open water: smooth, and far from all sure distances
    edges = np.linspace(*_OPEN_UP, _OPEN_BINS + 1)
    ups, lights = [], []
    for frame in frames[::_EVERY]:
        height, width = frame.found.distance_m.shape
        up = directions(width, height) @ frame.rotation[1]
        free = _far_from_sure(frame.found) & (structure(frame.image, 0.002) < _SMOOTH)
        free &= (up > edges[0]) & (up < edges[-1])
        ups.append(up[free])
        lights.append(frame.image[free].astype(np.float64))
    up, light = np.concatenate(ups), np.concatenate(lights)
    # Take the least red of each band of elevation, as what is nearer has more red
    red = light[:, 0] / np.maximum(light.sum(axis=1), 1e-9)
    number = np.digitize(up, edges) - 1
    total = sum(frame.found.distance_m.size for frame in frames[::_EVERY]) * 0.5 * (edges[1] - edges[0])
    found = []
    for n in range(_OPEN_BINS):
        inside = number == n
        if inside.sum() > _LEAST_OPEN * total:
            least = red[inside] <= np.quantile(red[inside], _LEAST_RED)
            found.append((np.median(up[inside]), np.median(light[inside][least], axis=0)))
    if not found:
        return np.zeros(0), np.zeros((0, 3))
    # Keep the longest run of bands without a jump of their light
    band_up, band_light = np.array([one[0] for one in found]), np.array([one[1] for one in found])
    step = np.abs(np.diff(np.log(np.maximum(band_light, _BLACK)), axis=0)).max(axis=1)
    run = np.concatenate([[0], np.cumsum(step > _LARGEST_STEP)])
    longest = run == np.bincount(run).argmax()
    return band_up[longest], band_light[longest]


def _far_from_sure(found: DepthMap) -> NDArray[np.bool_]:
    """Return the pixels (H, W) about which no distance is sure."""
    import cv2

    size = max(round(0.02 * found.distance_m.shape[1] / (2.0 * np.pi)), 1) * 2 + 1
    sure = (found.confidence >= SURE).astype(np.uint8)
    return np.asarray(cv2.dilate(sure, np.ones((size, size), np.uint8)) == 0)
