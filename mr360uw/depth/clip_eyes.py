# SPDX-License-Identifier: Apache-2.0
"""Distances of every frame of a stereo plate, of both eyes, written as numbered EXR files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from mr360uw.base.files import check_folder, files_named
from mr360uw.base.input_files import content_of
from mr360uw.base.parameters import checked
from mr360uw.base.progress import Progress
from mr360uw.depth.clip_depth import DepthReport, MapRun, map_width
from mr360uw.depth.sphere_stereo import SURE, DepthMap, enlarged_map, lowest, smoothed
from mr360uw.depth.warping import Map, resized, window_mean
from mr360uw.errors import ParameterError
from mr360uw.jit import fast
from mr360uw.track.key_frames import luma_codes
from mr360uw.video import VideoFrame, open_video
from mr360uw.video.layout import EYES_APART_M, Layout

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
    # Check the arguments
    folder = Path(folder)
    check_folder(folder)
    if not 0.0 < eyes_apart_m < 1.0:
        raise ParameterError(f"eyes_apart_m - must be a distance of eyes (got {eyes_apart_m:g}) - give 0.064")
    with open_video(video, eye="both", layout=layout) as clip:
        width = map_width(width, clip, "2048, or 1024 for a draft")
        count = clip.frame_count or 1  # None of a still
        # Continue maps of the same inputs; make the missing ones
        inputs = {"method": _METHOD, "clip": content_of(files_named(Path(video))), "width": width}
        inputs |= {"eyes_apart_m": eyes_apart_m, "layout": layout}
        with MapRun(folder, inputs, count, overwrite=overwrite, progress=progress) as run:
            missing = frozenset(run.missing)
            for frame in clip.frames(min(missing), max(missing) + 1) if missing else ():
                if frame.index in missing:
                    run.add(_make, run, frame, width, eyes_apart_m)
            return run.report()


def _make(run: MapRun, frame: VideoFrame, width: int, apart_m: float) -> float:
    """Write the maps of a frame's eyes; return the coverage of both."""
    assert frame.right is not None
    eyes = [resized(luma_codes(eye), width) for eye in (frame, frame.right)]
    return run.write(frame.index, *eye_distances(eyes[0], eyes[1], apart_m))


# Distances of both eyes of a stereo panorama, from its disparity alone.
#
# The rays of an eye start on the viewing circle (`types.py`): a point at the distance t along its ray is seen by
# both eyes at one latitude, and
#
#     2 atan(e/t)
#
# farther to the right by the left eye than by the right one; e: half the distance between the eyes. Rows are compared
# with shifted rows: a sweep at 1024 columns at most, smoothed semi-globally, then steps of fractions of a pixel about
# what was found, windows slanted with it. A distance is sure where both eyes find the same disparity, where the windows
# resemble each other, and where the disparity is so large that its error counts little; but not in even water beside
# something near, whose windows see that.

_SWEPT = 1024
"""Columns of the sweep at most [px]."""
_NEAREST = 9.0
"""Least distance that is found, over half the distance of the eyes: 0.29 m for eyes as they are in people."""
_SIDE, _FINE_RAD = 11, 0.064
"""Side of the windows of the sweep [px], and width [rad] of those of the steps: 21 of 2048 pixels. Half as wide: a
quarter more error; double: edges are wider."""
_SMALL, _LARGE = 0.03, 0.3
"""Penalties of the smoothing for neighbours a pixel of disparity, and more, apart."""
_FINE_SMALL, _FINE_LARGE = 0.03, 0.18
_STEPS = (0.5, 0.25, 0.25)
"""Steps [px] about what was found, one refinement each; two on either side."""
_AROUND = 2
_LEAST_CODES = 1.5
"""Deviation [codes] that is added to those of windows: flat ones do not resemble each other."""
_ALIKE, _SAME_PX, _WIDE_PX = 0.5, 0.6, 3.5
"""Correlation, difference of the eyes' disparities [px], and disparity [px] from which on a distance counts as sure."""
_EVEN_CODES, _BEHIND_PX = 3.0, 1.5
"""Deviation [codes] in five pixels below which a picture is even, and disparity [px] by which something is behind."""


@checked
def eye_distances(left: Map, right: Map, eyes_apart_m: float = EYES_APART_M) -> tuple[DepthMap, DepthMap]:
    """Return the distances along the rays of the left and of the right eye of a stereo panorama.

    Rows are compared, as both eyes of omnidirectional stereo see a point at one latitude. Where one eye alone sees
    something, or rows show nothing that can be told apart, the confidence is below a half.

    Parameters
    ----------
    left, right : ndarray
        Grey pictures (H, W) of the eyes, codes in [0, 255], twice as wide as high.
    eyes_apart_m : float
        Distance [m] of the eyes, to which all distances are proportional.

    Returns
    -------
    tuple of DepthMap
        Distances [m] and confidences (H, W) of each eye.

    Raises
    ------
    ParameterError
        If the pictures are no panoramas of one size.

    See Also
    --------
    uw.depth.depth_of_eyes : The same for a file, written as numbered EXR files.
    uw.depth.distances : Distances from several frames with their poses.

    Notes
    -----
    Omnidirectional stereo (Ishiguro 1992; Peleg 2001) with semi-global matching (Hirschmueller 2008).

    Examples
    --------
    A mottled wall all around, 2 m away:

    >>> rows = np.random.default_rng(1).normal(0.0, 1.0, (64, 128)).cumsum(axis=0)
    >>> left = 128.0 + 6.0 * np.kron(rows - rows.mean(axis=0), np.ones((4, 4))).astype(np.float32)
    >>> shift = round(2.0 * np.arctan(0.032 / 2.0) * 512 / (2.0 * np.pi))
    >>> found, _ = uw.depth.eye_distances(left, np.roll(left, -shift, axis=1))
    >>> bool(1.5 < np.median(found.distance_m) < 2.5)
    True
    """
    left, right = (np.asarray(one, np.float32) for one in (left, right))
    if left.shape != right.shape or left.ndim != 2 or not left.size or left.shape[1] != 2 * left.shape[0]:
        raise ParameterError(
            f"left, right - must be twice as wide as high, and alike (got {left.shape}, {right.shape}) - resize them"
        )
    half = 0.5 * eyes_apart_m
    (a, alike_a), (b, alike_b) = _disparity(left, right, 1.0), _disparity(right, left, -1.0)
    pixel = 2.0 * np.pi / left.shape[1]
    maps = []
    for own, other, alike, sign in ((a, b, alike_a, 1.0), (b, a, alike_b, -1.0)):
        apart = np.abs(own - _shifted(other, own, sign))
        sure = np.minimum.reduce([
            _graded(alike - _ALIKE, 0.3), _graded(_SAME_PX - apart, _SAME_PX), _graded(own - _WIDE_PX, _WIDE_PX),
        ])  # fmt: skip
        with np.errstate(divide="ignore"):
            far = half / np.tan(0.5 * pixel * np.maximum(own, 0.0))
        _without_rims(left if sign > 0.0 else right, own, sure)
        maps.append(DepthMap(far.astype(np.float32), np.where(np.isfinite(far), sure, 0.0).astype(np.float32)))
    return maps[0], maps[1]


def _without_rims(grey: Map, disparity: Map, confidence: Map) -> None:
    """Set confidences (H, W) to 0 in the rims of what is near.

    The window of a pixel of even water beside something near sees that, and takes its disparity: a rim of half a
    window. Even pixels are looked at first, then those within two pixels of what was found.
    """
    import cv2

    picture = np.ascontiguousarray(grey, np.float32)
    even = np.sqrt(np.maximum(window_mean(picture * picture, 5) - window_mean(picture, 5) ** 2, 0.0)) < _EVEN_CODES
    reach = round(0.5 * _FINE_RAD * grey.shape[1] / (2.0 * np.pi)) + 2
    known = confidence >= np.float32(SURE)
    _drop_rims(picture, disparity, known, even, even, reach, confidence)
    left = confidence >= np.float32(SURE)
    beside = cv2.dilate((known & ~left).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    _drop_rims(picture, disparity, left, even, beside & ~even, reach, confidence)


@fast
def _drop_rims(grey: Any, disparity: Any, known: Any, even: Any, tested: Any, reach: Any, confidence: Any) -> None:
    """Set the confidence of tested pixels (H, W) that look like what is behind to 0.

    Such a pixel is compared with the mean of what has its disparity and is not even, and of what is farther or unknown,
    within `reach` pixels.
    """
    height, width = grey.shape
    for j in range(height):
        for i in range(width):
            if not (known[j, i] and tested[j, i]):
                continue
            near, behind = np.float32(0.0), np.float32(0.0)
            nears, behinds = 0, 0
            # Average the light of what lies behind around it, and of what is as near and uneven
            for b in range(max(j - reach, 0), min(j + reach + 1, height)):
                for a in range(i - reach, i + reach + 1):
                    column = a % width
                    if not known[b, column] or disparity[b, column] < disparity[j, i] - np.float32(_BEHIND_PX):
                        behind += grey[b, column]
                        behinds += 1
                    elif not even[b, column]:
                        near += grey[b, column]
                        nears += 1
            if behinds == 0:
                continue
            # Drop a pixel that is more like what lies behind
            to_behind = abs(grey[j, i] - behind / np.float32(behinds))
            if nears == 0 or to_behind < abs(grey[j, i] - near / np.float32(nears)):
                confidence[j, i] = np.float32(0.0)


def _graded(over: Map, scale: float) -> Map:
    """Return 0 to 1, a half where `over` is 0."""
    return np.clip(0.5 + 0.5 * over / scale, 0.0, 1.0).astype(np.float32)


def _disparity(own: Map, other: Map, sign: float) -> tuple[Map, Map]:
    """Return the disparity (H, W) [px] of an eye's picture, 0 or more, and the correlation with the other's there.

    sign: 1 for the left eye, to which things are farther to the right.
    """
    import cv2

    width = own.shape[1]
    size = min(width, _SWEPT)
    small, beside = resized(own, size), resized(other, size)
    most = int(np.ceil(2.0 * np.arctan(1.0 / _NEAREST) * size / (2.0 * np.pi)))
    trials = np.arange(-2, most + 2)
    rolled = (np.roll(beside, round(sign * shift), axis=1) for shift in trials)
    cost = np.stack([1.0 - _correlation(small, one, _SIDE) for one in rolled], axis=-1)
    step, _ = lowest(smoothed(cost, _SMALL, _LARGE))
    found = enlarged_map((step + trials[0]).astype(np.float32), width) * np.float32(width / size)
    side = 2 * round(0.5 * _FINE_RAD * width / (2.0 * np.pi)) + 1
    for pixels in _STEPS:
        offsets = pixels * np.arange(-_AROUND, _AROUND + 1)
        shifted = (_shifted(other, found + np.float32(offset), sign) for offset in offsets)
        cost = np.stack([1.0 - _correlation(own, one, side) for one in shifted], axis=-1)
        step, best = lowest(smoothed(cost, _FINE_SMALL, _FINE_LARGE))
        found = (found + np.float32(pixels) * (step - _AROUND)).astype(np.float32)
        found = np.asarray(cv2.medianBlur(found, 3), np.float32)  # without single pixels that differ
    return found, np.asarray(1.0 - np.take_along_axis(cost, best[..., None], -1)[..., 0], np.float32)


def _shifted(picture: Map, shift: Map, sign: float) -> Map:
    """Return a picture (H, W) looked up as many pixels to the left (sign 1) or right (-1) as `shift` (H, W) says."""
    import cv2

    height, width = picture.shape
    margin = 8
    wide = cv2.copyMakeBorder(picture, 0, 0, margin, margin, cv2.BORDER_WRAP)
    x = (np.mod(np.arange(width) - sign * shift, width) + margin).astype(np.float32)
    y = np.broadcast_to(np.arange(height, dtype=np.float32)[:, None], x.shape)
    return np.asarray(cv2.remap(wide, x, np.ascontiguousarray(y), cv2.INTER_CUBIC), np.float32)


def _correlation(one: Map, other: Map, side: int) -> Map:
    """Return the correlation (H, W) of two pictures in windows, in [-1, 1]."""
    mean_a, mean_b = window_mean(one, side), window_mean(other, side)
    both = window_mean(one * other, side) - mean_a * mean_b
    a, b = (
        np.sqrt(np.maximum(window_mean(v * v, side) - m * m, 0.0)) + np.float32(_LEAST_CODES)
        for v, m in ((one, mean_a), (other, mean_b))
    )
    return np.clip(both / (a * b), -1.0, 1.0).astype(np.float32)
