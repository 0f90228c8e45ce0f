# SPDX-License-Identifier: Apache-2.0
"""The plate's own caustics in a frame, as shadows on the receiver take them away.

Where the camera stands, the clip's mean is the plate without caustics. Where it moves, or of a single picture, detail
of the size of caustics is smoothed, by the fraction of its variance that the scene's own sea explains.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mr360uw.cache import Cache
from mr360uw.caustics import CausticSettings, caustic_stack
from mr360uw.caustics.settings import Sea
from mr360uw.color import LUMINANCE, luminance
from mr360uw.composite.receiver.pattern import PlatePattern
from mr360uw.composite.shot import Receiver
from mr360uw.medium.lookup import ambient_ratio, beam_ratio, unscattered_share
from mr360uw.medium.scattered_light import spread_of
from mr360uw.render.lights import direct_to_diffuse, small_picture
from mr360uw.render.loaded import Loaded
from mr360uw.render.mattes import ReceiverClip
from mr360uw.scene.model import Scene
from mr360uw.scene.resolved import without_gain
from mr360uw.types import BeamSpread, Floats, MediumTable, Rectangle
from mr360uw.video import VideoFrame

FRAMES = 240
"""Frames that the mean of a clip is taken over, from the first that is read on: ten seconds, many periods of waves."""
_EVERY = 4
"""Frames between those that are read: a sixth of a second, in which caustics move by their own width."""
_LEAST_FRAMES = 8
"""Frames below which a mean still shows the caustics themselves; if the camera moves in them, none is taken."""
_MEASURED = 3
"""Frames whose detail is measured: its variance is that of thousands of filaments in each."""
_COLUMNS = 512
_ROWS = 32
_SHIFT = 2
_GROUPS = 4
"""Successive groups of frames; where the camera stands, the mean of each lies best on the mean of the others without a
shift. By chance that happens once in 25^4. Means show a fainter ground under stronger caustics than single frames."""
_DETAIL_ROWS = (0.6, 0.9)
"""Part of the frame's height over which the detail of the ground is measured: 18 to 72 degrees below the horizon."""


@dataclass(frozen=True, slots=True, eq=False)
class Background:
    """The ground of a clip in the mean light of its waves.

    mean: (rows, W, 3) float16 of the plate's last rows, those that can show the ground; None where the camera moves or
    there is one picture. strength: fraction of the variance of the ground's detail that is caustics, for smoothing
    instead; 1 where no picture is smoothed.
    """

    mean: Floats | None
    strength: float


class BackgroundSeries:
    """Collects the first frames of a clip, or of a range.

    height_m: of the camera above the ground. contrast: standard deviation over mean of the light on the ground that the
    scene's sea makes. sky: fraction of a frame's rows, from the top, that cannot show the ground.
    """

    def __init__(self, height_m: float, contrast: float, sky: float = 0.0) -> None:
        self._height_m, self._contrast, self._sky = height_m, contrast, sky
        self.clear()

    def clear(self) -> None:
        """Forget all frames; the next one is the first."""
        self._first: int | None = None
        self._sum: NDArray[np.float32] | None = None
        self._held: list[VideoFrame] = []
        self._small: list[Floats] = []
        self._measured: list[VideoFrame] = []

    def add(self, frame: VideoFrame) -> None:
        """Take a frame in, where it is one of those that count."""
        if self._first is None:
            self._first = frame.index
        place = frame.index - self._first
        if place >= FRAMES or place % _EVERY:
            return
        if len(self._measured) < _MEASURED:
            self._measured.append(replace(frame))  # without what was worked out from its codes
        if len(self._small) >= _LEAST_FRAMES and self._sum is None:
            return  # the camera moves, and no mean is of use
        self._small.append(_without_its_blur(frame))
        self._held.append(replace(frame))
        if len(self._small) == _LEAST_FRAMES and stands(self._small):
            height, width = frame.shape
            self._sum = np.zeros((height - int(self._sky * height), width, 3), np.float32)
        if self._sum is not None:
            for held in self._held:
                _add_light(held, self._sum)
        if len(self._small) >= _LEAST_FRAMES:
            self._held = []

    def result(self) -> Background:
        """Return what the frames show; without any, that nothing is caustics."""
        if not self._measured:
            return Background(None, 0.0)
        mean, strength = None, 1.0
        if self._sum is not None and stands(self._small):
            mean = (self._sum / np.float32(len(self._small))).astype(np.float16)
        if mean is None or self._measured[0].right is not None:  # the mean is of the left eye's pictures
            variance = float(np.mean([self._detail(frame) for frame in self._measured]))
            strength = min(1.0, self._contrast**2 / max(variance, 1e-9))
        return Background(mean, strength)

    def _detail(self, frame: VideoFrame) -> float:
        """Return the variance of the ground's detail over its smooth light."""
        import cv2

        height, width = frame.shape
        first, last = (int(part * height) for part in _DETAIL_ROWS)
        last = max(last, first + 1)
        light = PlatePattern(frame, None, self._height_m, 1.0).light(Rectangle(0, first, width, last - first))
        shown, background = (cv2.transform(one, LUMINANCE[None]) for one in light)
        return float(np.var(shown / np.maximum(background, 1e-3), dtype=np.float64))


def _without_its_blur(frame: VideoFrame) -> Floats:
    """Return the luminance (h, w) of a small picture of a frame below the horizon, less its own blur."""
    import cv2

    size = (_COLUMNS, _COLUMNS // 2)
    small = cv2.resize(small_picture(frame.pixels), size, interpolation=cv2.INTER_AREA)
    below = luminance(small[_COLUMNS // 4 :]).astype(np.float32)
    return np.asarray(below - cv2.GaussianBlur(below, (0, 0), 4.0))


def _add_light(frame: VideoFrame, total: NDArray[np.float32]) -> None:
    """Add the linear light of a frame's last rows to a sum (rows, W, 3), some at a time, which stay in the cache."""
    height, width = frame.shape
    first = height - len(total)
    for row in range(first, height, _ROWS):
        part = Rectangle(0, row, width, min(_ROWS, height - row))
        total[row - first : row - first + part.height] += frame.linear(part)


def stands(pictures: list[Floats]) -> bool:
    """Return whether small pictures (h, w), less their own blur, show one scene from one place.

    The mean of each group of them is laid over the mean of the others at shifts of up to two pixels; where it fits best
    without one, nothing has moved.
    """
    groups = [
        np.sum(pictures[k * len(pictures) // _GROUPS : (k + 1) * len(pictures) // _GROUPS], axis=0)
        for k in range(_GROUPS)
    ]
    total = np.sum(groups, axis=0)
    shifts = [(j, i) for j in range(-_SHIFT, _SHIFT + 1) for i in range(-_SHIFT, _SHIFT + 1)]
    inside = slice(_SHIFT, -_SHIFT)
    for group in groups:
        others = total - group
        fits = [float(np.vdot(np.roll(group, shift, (0, 1))[inside], others[inside])) for shift in shifts]
        if shifts[int(np.argmax(fits))] != (0, 0):
            return False
    return True


_TYPICAL_HEIGHT_M = 2.0
"""Height of the camera above ground that a distance map gives."""
_LEAST_HEIGHT_M = 0.2
_TYPICAL_SUN = (0.5, math.sqrt(0.75), 0.0)
"""Direction of a sun 60 degrees high in the air, for the contrast of the caustics that a sea makes: at 35 degrees it is
larger by 5 to 25 % between 4 and 8 m of depth."""


def background_series(loaded: Loaded) -> BackgroundSeries | None:
    """Return what collects a clip's ground without caustics; None where the plan leaves its caustics alone."""
    if not loaded.plan.pattern.runs or loaded.receiver is None:
        return None
    # A level camera sees a level floor, which lies below it, in the lower half of its frames
    camera, settings = loaded.surroundings.camera, loaded.scene.receiver
    level = camera.track is None and camera.tilt is None and loaded.plate_depth is None
    sky = 0.5 if level and settings is not None and settings.kind == "plane" else 0.0
    return BackgroundSeries(*_on_ground(loaded, loaded.receiver, Cache()), sky)


def _on_ground(loaded: Loaded, receiver: ReceiverClip, cache: Cache) -> tuple[float, float]:
    """Return the camera's height [m] above the ground, and the contrast of the light that the scene's sea makes there.

    cache: holds the contrast.
    """
    scene, medium, height_m = loaded.scene, loaded.surroundings.medium, _height_above(receiver.at(0), loaded)
    assert medium is not None
    contrast = cache.of(
        _expected_contrast, scene.sea, _resolution(scene), scene.water.refractive_index, medium.unit_table,
        spread_of(medium), scene.camera.depth_m + height_m,
    )  # fmt: skip
    return height_m, contrast


def plate_pattern(
    loaded: Loaded, background: Background | None, plate: VideoFrame, cache: Cache | None = None
) -> PlatePattern | None:
    """Return the pattern of a plate's frame on the receiver; None where the plan has none.

    background: of the clip; None finds it in this frame alone. cache: keeps the contrast of the scene's own caustics,
    which is the same for all frames.
    """
    if not loaded.plan.pattern.runs or loaded.receiver is None:
        return None
    cache = Cache() if cache is None else cache
    if background is None:
        background = cache.of(_background_of_frame, *_on_ground(loaded, loaded.receiver, cache), plate)
    height_m = _height_above(loaded.receiver.at(plate.index), loaded)
    return cache.of(PlatePattern, plate, background.mean, height_m, background.strength)


def _background_of_frame(height_m: float, contrast: float, plate: VideoFrame) -> Background:
    """Return the ground without caustics of a frame by itself."""
    series = BackgroundSeries(height_m, contrast)
    series.add(plate)
    return series.result()


def waves_of(scene: Scene) -> tuple[object, ...]:
    """Return the settings that the contrast of the caustics on the ground depends on."""
    return scene.sea, scene.camera.depth_m, without_gain(scene.water), _resolution(scene)


def _resolution(scene: Scene) -> CausticSettings:
    """Return the settings of the map that the contrast is taken from: the default ones, coarser where the scene's are.

    A map of 256 x 256 from a grid of 96 has a contrast lower by 0.6 % than one of 512 x 512 from 256.
    """
    settings = CausticSettings()
    return settings.model_copy(update={"size": min(settings.size, scene.caustics.size), "grid": scene.caustics.grid})


def _height_above(receiver: Receiver, loaded: Loaded) -> float:
    """Return about how high [m] the camera is above a receiver at the start of the clip."""
    camera_y = float(loaded.view(0.0).position[1])
    if receiver.plane_y is not None:
        below = camera_y - receiver.plane_y
    elif receiver.mesh is not None:
        below = camera_y - float(receiver.mesh[..., 1].mean())
    else:
        below = _TYPICAL_HEIGHT_M
    return max(abs(below), _LEAST_HEIGHT_M)


def _expected_contrast(
    sea: Sea, settings: CausticSettings, index: float, table: MediumTable, spread: BeamSpread | None, depth_m: float
) -> float:
    """Return the standard deviation over mean of the light that a sea throws on the ground at a depth."""
    at = np.array([depth_m])
    stack = caustic_stack(sea, _TYPICAL_SUN, at, 0.0, settings, index, spread)
    up = float(stack.sun_direction[1])
    direct = direct_to_diffuse(table) * beam_ratio(table, at, up) / ambient_ratio(table, at)
    sharp = float(luminance(unscattered_share(table, at, up))[0])
    pattern = sharp * stack.ratio[0, ..., 1] + (0.0 if stack.soft is None else (1.0 - sharp) * stack.soft[0, ..., 0])
    return float(pattern.std() * luminance(direct / (1.0 + direct))[0])
