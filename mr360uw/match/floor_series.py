# SPDX-License-Identifier: Apache-2.0
"""Light of a plate's floor over time, and what our caustics on it need: sun, water, footprint of the pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mr360uw.color import encode, luminance
from mr360uw.match.floor_region import FloorGrid, FloorView
from mr360uw.medium import Medium
from mr360uw.medium.fit.level import fit_level
from mr360uw.optics import refract_to_air
from mr360uw.progress import Progress
from mr360uw.render.plate_map import level_view
from mr360uw.render.surroundings import load_surroundings
from mr360uw.scene.inputs import open_plate
from mr360uw.scene.model import Scene, at_scale
from mr360uw.types import Floats

Array = NDArray[np.float64]

DEFAULT_S = 2.0
"""Length [s] of the part of a clip that is measured unless frames are given. Waves of 8 m have a period of 2.3 s."""
_STEP_S = 1.0 / 6.0
"""Time [s] between the frames that are read: waves of 0.25 m, the shortest that matter, have twice that period."""
_ROWS = 384
"""Rows that larger plates are reduced to: 0.5 degrees each, 3 cm on a floor 3.5 m below."""
_COUNT = 128
"""Pixels across the region."""
_SUNS = 4
"""Frames in which the sun is looked for: waves move it by degrees."""
_LEAST_HEIGHT_M = 0.3
_LEAST_FRAMES = 8


class NoMatchError(Exception):
    """A plate that shows nothing that could be matched; the text is the reason."""


@dataclass(frozen=True, slots=True, eq=False)
class FloorSeries:
    """The floor of a plate over time.

    light: (T, n, n) luminance of the floor as it arrives at the camera. color: (3,) its mean, RGB. codes: its standard
    deviation over time in 8-bit code values of the plate. time_s: (T,) of the frames, evenly spaced. footprint_m:
    (n, n) of a pixel. views: (T,) where each frame shows the region. sun_in_air: (3,) towards the sun. medium: the
    water. floor_depth_m: below the mean surface.
    """

    grid: FloorGrid
    light: Floats
    color: Array
    codes: float
    time_s: Array
    footprint_m: Array
    views: tuple[FloorView, ...]
    sun_in_air: Array
    medium: Medium
    floor_depth_m: float

    @property
    def step_s(self) -> float:
        """Time [s] between frames."""
        return float(self.time_s[1] - self.time_s[0])


def floor_series(scene: Scene, frames: tuple[int, int] | None = None, progress: Progress | None = None) -> FloorSeries:
    """Return the light of a scene's floor over frames [a, b), by default the first two seconds.

    It is that of the square below and around the camera. Raises `NoMatchError` with a reason where the scene or
    the plate shows no floor, no water or no sun; `VideoError`, `ParameterError`.
    """
    floor_y = _floor_of(scene)
    with open_plate(scene) as video:
        if video.is_still:
            raise NoMatchError("The plate is one picture: moving light cannot be told from the texture of the floor.")
        rows, rate = video.height, float(video.frame_rate)
    small = at_scale(scene, min(scene.plate.scale, scene.plate.scale * _ROWS / rows))
    surroundings = load_surroundings(small)
    if surroundings.medium is None:
        raise NoMatchError("The scene has no water, so its surface casts no caustics.")
    with open_plate(small) as video:
        start, stop = (0, None) if frames is None else frames
        if frames is None and video.frame_count is not None:
            stop = min(video.frame_count, round(DEFAULT_S * rate))
        start, stop = video.check_range(start, stop)
        step = max(1, round(_STEP_S * rate))
        times = np.arange(start, stop, step) / rate
        if len(times) < _LEAST_FRAMES:
            need = _LEAST_FRAMES * step / rate
            raise NoMatchError(f"The frames {start}:{stop} are too short a time; waves need {need:.1f} s at least.")
        places = [surroundings.camera.at(float(t)) for t in times]
        positions = np.array([position for position, _ in places])
        if positions[:, 1].min() - floor_y < _LEAST_HEIGHT_M:
            raise NoMatchError("The floor is not below the camera; set receiver.height_m.")
        grid = FloorGrid.below(positions, floor_y, _COUNT)
        views = _views(grid, places, video.width, video.height)
        seen, suns, gains = [], [], []
        for frame in video.frames(start, stop):
            number, left = divmod(frame.index - start, step)
            if left:
                continue
            view, up = views[number], places[number][1][1]
            seen.append(view.read(frame.image_linear[slice(*view.rows)]))
            gains.append(fit_level(surroundings.medium, level_view(frame.pixels, up))[0])
            if number % -(-len(times) // _SUNS) == 0:
                suns.append(surroundings.light.sun(frame.pixels, frame.time_s))
            if progress is not None:
                progress(number + 1, len(times))
        footprint = grid.footprint_m(positions.mean(axis=0), np.pi / video.height)
    found = [sun.direction for sun in suns if sun is not None and sun.direction[1] > 0.0]
    if not found:
        raise NoMatchError('No sun is found in the plate; set light.sun = "given" with its azimuth and elevation.')
    sun = refract_to_air(np.mean(found, axis=0), scene.water.refractive_index)
    # one gain for all frames: that of each moves with the waves, and its floor with it
    table = surroundings.medium.scaled(np.median(gains, axis=0)).table
    light = np.array([grid.light(one, position, table) for one, position in zip(seen, positions, strict=True)])
    return FloorSeries(
        grid, luminance(light), np.maximum(light.mean(axis=(0, 1, 2)), 0.0), _codes(np.array(seen)), times, footprint,
        views, sun, surroundings.medium, scene.camera.depth_m - floor_y,
    )  # fmt: skip


def _views(grid: FloorGrid, places: list[tuple[Floats, Floats]], width: int, height: int) -> tuple[FloorView, ...]:
    """Return where each frame shows a region, one view for frames between which the camera does not move."""
    views: list[FloorView] = []
    for k, place in enumerate(places):
        still = k > 0 and all(map(np.array_equal, places[k - 1], place))
        views.append(views[-1] if still else FloorView.of(grid, *place, width, height))
    return tuple(views)


def _codes(seen: Floats) -> float:
    """Return the standard deviation over time of linear light (T, n, n, 3), in 8-bit code values of its luminance."""
    shown = 255.0 * encode(np.clip(luminance(seen), 0.0, 1.0), "srgb")
    return float(np.sqrt(np.mean(shown.var(axis=0))))


def _floor_of(scene: Scene) -> float:
    """Return the height [m] of the floor in the world."""
    receiver = scene.receiver
    if receiver is None or receiver.kind != "plane":
        got = "none" if receiver is None else f"a {receiver.kind}"
        raise NoMatchError(f"The scene has no level floor (its receiver is {got}); set a receiver of kind plane.")
    if scene.camera.depth_m - receiver.height_m <= 0.0:
        raise NoMatchError("The receiver lies above the water; set receiver.height_m.")
    return receiver.height_m
