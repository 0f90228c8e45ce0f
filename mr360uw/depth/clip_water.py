# SPDX-License-Identifier: Apache-2.0
"""Water of a tracked clip whose distances are known: frames of one shot, their maps, and the fit to them."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np

from mr360uw.depth.clip_depth import poses_of
from mr360uw.depth.depth_files import DepthClip
from mr360uw.depth.seen_places import LitFrame, seen_places
from mr360uw.errors import ParameterError
from mr360uw.medium.fit.water_by_distance import WaterByDistance, water_by_distance
from mr360uw.progress import Progress, Steps
from mr360uw.shapes import checked
from mr360uw.track.camera_track import CameraTrack
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
    `medium/fit/water_by_distance.py`. The exposure must be the same in all frames.

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
        position, rotation, shot = poses_of(video, clip, track, eye)
        longest = int(np.bincount(shot[shot >= 0]).argmax())
        frames = np.flatnonzero(shot == longest)
        chosen = np.unique(frames[np.round(np.linspace(0, len(frames) - 1, _FRAMES)).astype(int)]).tolist()
        if len(chosen) < _LEAST_FRAMES:
            raise ParameterError(
                f"{video} - is too short to tell its water (got {len(chosen)} frames with a pose) - give a clip of "
                f"{_LEAST_FRAMES} or more"
            )
        maps, steps, lit = DepthClip(Path(folder), size=(clip.width, clip.height)), Steps(progress, len(chosen)), []
        for frame in clip.frames(chosen[0], chosen[-1] + 1):
            if frame.index not in chosen:
                continue
            found = maps.at(frame.index)
            image = np.asarray(frame.image_linear, np.float32)
            if image.shape[:2] != found.distance_m.shape:
                size = found.distance_m.shape[::-1]
                image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.float32)
            lit.append(LitFrame(image, found, position[frame.index], rotation[frame.index]))
            steps.done(1)
    return water_by_distance(seen_places(lit))
