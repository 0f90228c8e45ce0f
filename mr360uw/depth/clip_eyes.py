# SPDX-License-Identifier: Apache-2.0
"""Distances of every frame of a stereo plate, of both eyes, written as numbered EXR files."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from os import cpu_count
from pathlib import Path

import numpy as np

from mr360uw.depth.clip_depth import LEAST_WIDTH, DepthReport
from mr360uw.depth.depth_files import depth_file, own_maps, write_depth
from mr360uw.depth.eye_stereo import eye_distances
from mr360uw.depth.sphere_stereo import SURE
from mr360uw.depth.warping import resized
from mr360uw.errors import ParameterError
from mr360uw.files import WrittenFiles
from mr360uw.output_gate import check_folder
from mr360uw.progress import Progress, Steps
from mr360uw.reading.input_files import content_of
from mr360uw.reading.numbered_files import files_named
from mr360uw.shapes import checked
from mr360uw.threads import one_blas_thread
from mr360uw.track.key_frames import luma_codes
from mr360uw.video import VideoFrame, VideoReader, open_video
from mr360uw.video.eyes_seen import EYES_APART_M
from mr360uw.video.read.layout import Layout

_METHOD = "distances of eyes 1"
"""Names how maps are found; another number where that changes, so that maps of before are not kept."""


@checked
def depth_of_eyes(
    video: str | Path,
    folder: str | Path,
    *,
    width: int = 2048,
    eyes_apart_m: float = EYES_APART_M,
    layout: Layout | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> DepthReport:
    """Write the distances of both eyes of a stereo plate into a folder; return what was done.

    One picture is enough, and the camera may stand: what the eyes see differently tells how far away it is. Each file
    holds a part for each eye, with the channels of `depth_of_clip`.

    Parameters
    ----------
    video : str or Path
        A stereo plate: a clip or a picture.
    folder : str or Path
        Folder of the maps, depth_00000.exr for frame 0 and so on; finished maps of the same plate and width stay.
    width : int
        Columns of the maps, at most those of an eye: a multiple of 8. Half as many tell half as far.
    eyes_apart_m : float
        Distance [m] of the eyes, to which all distances are proportional: `camera.ipd_m` of the scene.
    layout : str, optional
        Arrangement of the eyes in a frame, where the file does not say it.
    overwrite : bool
        Replace maps that an earlier call made of other inputs; files of others are never replaced.
    progress : callable, optional
        Is called with (steps done, all of them).

    Returns
    -------
    DepthReport
        How many maps were written and found, and how much of the sphere they tell.

    Raises
    ------
    ParameterError
        For a width that is too small.
    VideoError
        For a plate that is not stereo.
    OutputExistsError
        For a folder with maps of other inputs.

    See Also
    --------
    uw.depth.eye_distances : The same for two pictures in memory, and the method.
    uw.depth_of_clip : Distances from the motion of the camera, for one eye.

    Examples
    --------
    >>> try:
    ...     uw.depth.depth_of_eyes("dive.mp4", "depth")
    ... except uw.Mr360uwError as error:
    ...     print("is not stereo" in str(error))
    True
    """
    folder = Path(folder)
    check_folder(folder)
    if not 0.0 < eyes_apart_m < 1.0:
        raise ParameterError(f"eyes_apart_m - must be a distance of eyes (got {eyes_apart_m:g}) - give 0.064")
    with open_video(video, eye="both", layout=layout) as clip:
        width = min(width, clip.width)
        if width < LEAST_WIDTH or width % 8:
            raise ParameterError(
                f"width - must be a multiple of 8 from {LEAST_WIDTH} up (got {width}) - take 2048, or 1024 for a draft"
            )
        count = clip.frame_count
        if count is None:
            _, count = clip.check_range()
        inputs = {"method": _METHOD, "clip": content_of(files_named(Path(video))), "width": width}
        inputs |= {"eyes_apart_m": eyes_apart_m, "layout": layout}
        with own_maps(folder, inputs, count, overwrite=overwrite) as maps:
            missing = [index for index in range(count) if not maps.has(depth_file(folder, index))]
            steps = Steps(progress, count)
            steps.done(count - len(missing))
            coverage = _write(clip, folder, maps, missing, width, eyes_apart_m, steps)
        return DepthReport(folder, len(missing), count - len(missing), 0, coverage)


def _write(
    clip: VideoReader, folder: Path, maps: WrittenFiles, missing: list[int], width: int, apart_m: float, steps: Steps
) -> float:
    """Make the maps that are missing, two frames or more side by side; return their mean coverage, NaN for none."""
    covered: list[float] = []
    threads = cpu_count() or 1
    with one_blas_thread(), ThreadPoolExecutor(threads) as pool:
        running: deque[Future[float]] = deque()
        for frame in _missing_frames(clip, missing):
            running.append(pool.submit(_make, folder, maps, frame, width, apart_m))
            if len(running) > threads:
                covered.append(running.popleft().result())
                steps.done(1)
        for one in running:
            covered.append(one.result())
            steps.done(1)
    return float(np.mean(covered)) if covered else float("nan")


def _missing_frames(clip: VideoReader, missing: list[int]) -> Iterator[VideoFrame]:
    """Yield the frames whose maps are missing."""
    if missing:
        wanted = frozenset(missing)
        yield from (frame for frame in clip.frames(missing[0], missing[-1] + 1) if frame.index in wanted)


def _make(folder: Path, maps: WrittenFiles, frame: VideoFrame, width: int, apart_m: float) -> float:
    """Write the maps of a frame's eyes; return the coverage of both."""
    assert frame.right is not None
    eyes = [resized(luma_codes(eye), width) for eye in (frame, frame.right)]
    left, right = eye_distances(eyes[0], eyes[1], apart_m)
    write_depth(depth_file(folder, frame.index), left, right, file=maps.file)
    return float(np.mean([one.confidence >= SURE for one in (left, right)]))
