# SPDX-License-Identifier: Apache-2.0
"""Fits a scene's water to a patch of open water that a user marks in the plate.

The solved light of every water at the camera's depth, with the scene's sky, is compared with the patch: its colour and
how that changes with elevation (`medium.waterfit`). Exposure is free, a white balance is allowed at a cost.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from mr360uw.base.color import encode
from mr360uw.base.parameters import checked
from mr360uw.base.sphere import direction_from_angles, frame_from_direction
from mr360uw.errors import ParameterError
from mr360uw.medium import Medium, WaterSettings
from mr360uw.medium.medium import Mode
from mr360uw.medium.veil_gain import DOUBTFUL, LevelView, fit_level
from mr360uw.medium.water import JERLOV_TYPES
from mr360uw.medium.waterfit import CONFIDENT, WaterComparison, compare_waters, resampled
from mr360uw.render.lights import level_view
from mr360uw.render.surroundings import CameraPath
from mr360uw.scene.model import Scene
from mr360uw.scene.resolved import open_plate
from mr360uw.types import Array, Floats
from mr360uw.video import VideoFrame

_VISIBILITIES_M = (1.3, 1.8, 2.5, 3.5, 5.0, 7.0, 10.0, 14.0, 20.0, 28.0, 40.0, 56.0, 80.0)
"""Visibilities [m] that are tried where the scene gives one: steps of a factor of 1.4, less than types differ by."""
_BANDS = 31
"""Wavelengths of the light field: 10 nm apart, far finer than waters differ."""
_ROWS, _COLUMNS = 16, 32
"""Elevations and azimuths at which a patch is read."""
_MOST_FRAMES = 6
_DRAWS = 200
"""Draws of the frames, of which the share that names the same water is told: known to 3 %."""
_DARK = 1e-4
"""Linear light of a patch below which it is black."""
_TINY = 1e-12
_UNLIKE = 0.4
"""Rms deviation of the logarithm from the nearest water above which no water is named: dives have 0.02 to 0.15."""
_MOST_RED = 1.0
"""Red over green above which a patch is no water: water absorbs red first."""


@checked
@dataclass(frozen=True, slots=True)
class WaterPatch:
    """A square of open water. yaw_deg: of its middle, 0 = ahead, + = right; pitch_deg: + = up; size_deg: its side."""

    yaw_deg: float
    pitch_deg: float
    size_deg: float

    def __post_init__(self) -> None:
        half = 0.5 * self.size_deg
        if not (0.5 <= self.size_deg <= 90.0 and abs(self.pitch_deg) + half < 89.0):
            got = f"{self.yaw_deg:g},{self.pitch_deg:g},{self.size_deg:g}"
            raise ParameterError(f"water - is no patch (got {got}) - give yaw,pitch,size in degrees, size 0.5 to 90")


Changes = dict[str, str | float | tuple[float, float, float]]


@dataclass(frozen=True, slots=True, eq=False)
class WaterMatch:
    """The result of `match_water`.

    sentence: the result in words. changes: {key of the scene: value}; empty where the water is right or cannot be told.
    confidence: 0 to 1, see `WaterFit`. agreement: share of draws of the frames, with replacement, that name the same
    water; NaN for one frame. candidates: (name, likelihood, rms deviation of the logarithm), likeliest first.
    plate_code, before_code, after_code: (3,) sRGB code values, 0 to 255, of the patches in the plate and of the water
    of the scene, before and after the changes; rms_before, rms_after: deviation over rows and channels in code values,
    the second never above the first.
    """

    sentence: str
    changes: Changes = field(default_factory=dict)
    confidence: float = 0.0
    agreement: float = math.nan
    candidates: tuple[tuple[str, float, float], ...] = ()
    plate_code: tuple[float, float, float] = (0.0, 0.0, 0.0)
    before_code: tuple[float, float, float] = (0.0, 0.0, 0.0)
    after_code: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rms_before: float = math.nan
    rms_after: float = math.nan

    @property
    def overrides(self) -> tuple[str, ...]:
        """The changes as `load_scene` and `--set` take them."""
        return tuple(f"{key}={_toml(value)}" for key, value in self.changes.items())


_Veil = tuple[Changes, Array, float]
"""The veil of a setting in the patch: its changes, codes (r, 3), and their root mean square deviation from the plate.
"""


class _View:
    """Open water of a plate: light (r, 3) of the rows of a patch, the y `up` (r,) of their directions, and its horizon.

    frames: the light in each frame, of which `light` is the mean. Raises `ParameterError` for a patch that is black or
    no water.
    """

    def __init__(self, scene: Scene, patch: WaterPatch, frames: int | tuple[int, int]) -> None:
        # Read the rows of the patch, and the horizon, in a few frames
        start, stop = (frames, frames + 1) if isinstance(frames, int) else frames
        camera = CameraPath.of(scene)
        elevation, azimuth = _directions(patch)
        self.frames, levels = list[Array](), []
        with open_plate(scene) as video:
            start, stop = video.check_range(start, stop)
            chosen = np.unique(np.linspace(start, stop - 1, min(_MOST_FRAMES, stop - start)).astype(int))
            for index in chosen:
                frame = next(iter(video.frames(int(index), int(index) + 1)))
                rotation = camera.at(frame.time_s)[1]
                self.frames.append(_rows(frame, rotation, elevation, azimuth))
                levels.append(level_view(frame.pixels, rotation[1]))
        # Take their mean, if it may be water
        self.up, self.light = np.sin(elevation), np.mean(self.frames, axis=0)
        if float(self.light.max()) < _DARK:
            raise ParameterError(
                f"water - the patch is black (got {self.light.max():.2g} of white) - mark a lighter one"
            )
        if float(np.median(self.light[:, 0] / np.maximum(self.light[:, 1], _DARK))) > _MOST_RED:
            raise ParameterError("water - the patch is redder than water (got more red than green) - mark open water")
        self.level: LevelView = levels[0][0], np.mean([radiance for _, radiance in levels], axis=0)

    def veil(self, medium: Medium, gain: Floats, changes: Changes) -> _Veil:
        """Return the veil of a medium."""
        codes = _codes(gain * medium.level_radiance(self.up))
        return changes, codes, float(np.sqrt(np.mean((codes - _codes(self.light)) ** 2)))

    def fitted(self, medium: Medium, changes: Changes, *, from_patch: bool) -> _Veil:
        """Return the veil of a medium with the gain of the horizon, or one of the patch, which is one more change."""
        if not from_patch:
            return self.veil(medium, fit_level(medium, self.level)[0], changes)
        ratio = np.maximum(self.light, _DARK) / np.maximum(medium.level_radiance(self.up), _TINY)
        red, green, blue = (float(f"{g:.4g}") for g in np.exp(np.log(ratio).mean(axis=0)))
        return self.veil(medium, np.array([red, green, blue]), changes | {"water.gain": (red, green, blue)})


@checked
def match_water(scene: Scene, patch: WaterPatch, frames: int | tuple[int, int] = 0) -> WaterMatch:
    """Return the water whose solved veil is nearest to the plate in a patch of open water.

    frames: one, or a range [a, b) that a few are taken of. A scene with `water.visibility_m` and no type gets another
    visibility, any other a Jerlov type. The gain of the veil is found as well where the scene's is fixed, or the
    horizon shows no open water and the veil of long ways is not the plate's. Changes that bring the veil, in the
    scene's own mode, no nearer to the plate are not proposed. Raises `ParameterError` for a patch that is black or no
    water, `VideoError`.
    """
    # Read the light of the patch, unless there is no water to match
    water, depth = scene.water, scene.camera.depth_m
    if water.type == "none":
        return WaterMatch("Nothing is matched. The scene has no water; set water.type first.")
    if water.layers is not None:
        return WaterMatch("Nothing is matched. The scene's water has layers; leave water.layers out first.")
    view = _View(scene, patch, frames)
    # Compare the solved veils of all candidates with it, and with random draws of the frames
    tried = _candidates(water)
    media = {name: _medium(candidate, depth, "table") for name, candidate in tried.items()}
    lights = {n: np.maximum(m.level_radiance(view.up), _TINY) for n, m in media.items()}
    found = compare_waters(view.light, lights)
    agreement = math.nan
    if len(view.frames) > 1:
        drawn = resampled(lambda some: compare_waters(np.mean(some, axis=0), lights).nearest, view.frames, _DRAWS, 1)
        agreement = drawn.count(found.nearest) / _DRAWS
    # Fit the present water and the nearest one, and take what deviates less from the plate
    doubtful = not water.fits_ratio and fit_level(media[found.nearest], view.level)[1] >= DOUBTFUL
    from_patch = water.gain != "auto" or doubtful
    own = _medium(water, depth, water.mode)
    before = view.veil(own, fit_level(own, view.level)[0] if water.gain == "auto" else np.array(water.gain), {})
    proposed = [view.fitted(own, {}, from_patch=from_patch)]
    if found.residual[found.nearest] <= _UNLIKE and (changes := _change(water, found.nearest)):
        other = _medium(tried[found.nearest], depth, water.mode)
        proposed.insert(0, view.fitted(other, changes, from_patch=from_patch))
    after = next((veil for veil in proposed if veil[2] < before[2]), before)
    return WaterMatch(
        _sentence(water, found, before, after, doubtful, agreement),
        after[0],
        found.confidence,
        agreement,
        tuple(sorted(((str(n), found.likelihood[n], found.residual[n]) for n in media), key=lambda c: -c[1])),
        plate_code=_mean(_codes(view.light)),
        before_code=_mean(before[1]),
        after_code=_mean(after[1]),
        rms_before=before[2],
        rms_after=after[2],
    )


def _change(water: WaterSettings, nearest: str) -> Changes:
    """Return the change that makes a scene's water the nearest one; nothing where it is."""
    if water.of_visibility_alone:
        return {} if float(nearest) == water.visibility_m else {"water.visibility_m": float(nearest)}
    return {} if nearest == water.type else {"water.type": nearest}


def _candidates(water: WaterSettings) -> dict[str, WaterSettings]:
    """Return the waters that are tried, by the value of the key that makes them."""
    if water.of_visibility_alone:
        return {f"{v:g}": water.model_copy(update={"visibility_m": v}) for v in _VISIBILITIES_M}
    return {name: water.model_copy(update={"type": name}) for name in JERLOV_TYPES}


def _medium(water: WaterSettings, depth_m: float, mode: Mode) -> Medium:
    """Return the medium of a water in a mode, without a gain."""
    medium = water.model_copy(update={"bands": _BANDS, "mode": mode, "gain": (1.0, 1.0, 1.0)}).medium(depth_m)
    assert medium is not None
    return medium


def _directions(patch: WaterPatch) -> tuple[Array, Array]:
    """Return the elevations (r,) of the rows and their azimuths (r, c) [rad]."""
    rows = patch.pitch_deg + patch.size_deg * (0.5 - (np.arange(_ROWS) + 0.5) / _ROWS)
    stretched = (np.arange(_COLUMNS) + 0.5) / _COLUMNS - 0.5
    across = patch.yaw_deg + patch.size_deg * stretched / np.cos(np.radians(patch.pitch_deg))
    return np.radians(rows), np.broadcast_to(np.radians(across), (_ROWS, _COLUMNS))


def _rows(frame: VideoFrame, rotation: Floats, elevation: Array, azimuth: Array) -> Array:
    """Return the typical light (r, 3) of rows of a frame: the median over each, which passes by fish and particles."""
    picture = frame.image_linear
    high = np.broadcast_to(elevation[:, None], azimuth.shape)
    ray = np.moveaxis(direction_from_angles(azimuth, high), 0, -1) @ rotation  # type: ignore[arg-type]
    height, width = picture.shape[:2]
    column, row = frame_from_direction(ray, width, height)
    at = np.clip(row.astype(np.int64), 0, height - 1), column.astype(np.int64) % width
    return np.maximum(np.median(picture[at], axis=1), 0.0).astype(np.float64)


def _codes(light: Floats) -> Array:
    return np.asarray(255.0 * encode(np.clip(light, 0.0, 1.0), "srgb"), np.float64)


def _mean(codes: Array) -> tuple[float, float, float]:
    red, green, blue = codes.mean(axis=0).tolist()
    return red, green, blue


def _toml(value: str | float | tuple[float, ...]) -> str:
    if isinstance(value, tuple):
        return "[" + ", ".join(f"{v:g}" for v in value) + "]"
    return value if isinstance(value, str) else f"{value:g}"


def _sentence(
    water: WaterSettings, found: WaterComparison[str], before: _Veil, after: _Veil, doubtful: bool, agreement: float
) -> str:
    """Return the result in plain words."""
    if found.residual[found.nearest] > _UNLIKE:
        return (
            f"No water has the colour of the patch (nearest is {found.nearest}, off by a factor of "
            f"{math.exp(found.residual[found.nearest]):.1f}): a channel is black, the camera's white balance has "
            "changed it, or it shows something else. Set water.gain to fit the veil."
        )
    name = f"a visibility of {found.nearest} m" if water.of_visibility_alone else f"type {found.nearest}"
    sure = "clearly" if found.confidence >= CONFIDENT else "not surely"
    drawn = "" if math.isnan(agreement) else f", {100.0 * agreement:.0f} % of draws of the frames"
    text = f"The water is nearest to {name}, {sure} (confidence {found.confidence:.2f}{drawn}); "
    if not after[0]:
        return text + f"the veil differs from the patch by {before[2]:.1f} code values, and no change brings it nearer."
    text += f"the veil then differs from the patch by {after[2]:.1f} code values, before by {before[2]:.1f}."
    if doubtful:
        text += " The horizon shows little open water, so the gain of the veil is taken from the patch."
    return text
