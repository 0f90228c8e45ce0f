# SPDX-License-Identifier: Apache-2.0
"""The light of a plate's level floor over time, laid out in the world (column = +x, row = +z), and its measures.

The camera's position and rotation are taken from every frame's place in the world, so a floor that stands still stands
still here. Seen from above with forward (-z) at the top.

The plate's floor and our caustics are read through the same pixels by the same interpolation. A pattern that is read in
another way differs in its finest detail by 10 to 20 %, and so does the wind that is fitted to it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.caustic_lookup import along_beam, mip_level, mip_levels
from mr360uw.base.color import encode, luminance
from mr360uw.base.constants import GRAVITY_M_S2, REFRACTIVE_INDEX_SEA
from mr360uw.base.optics import refract_to_air, refract_to_water
from mr360uw.base.progress import Progress
from mr360uw.base.sphere import direction_from_frame, frame_from_direction
from mr360uw.caustics import CausticSettings, caustic_stack
from mr360uw.caustics.settings import Sea
from mr360uw.errors import ParameterError
from mr360uw.ibl.sun.split import CLEAR_SKY, CLEAR_SKY_DIRECT
from mr360uw.medium import Medium
from mr360uw.medium.lookup import ambient_ratio, beam_fraction, unscattered_share, veil_lookup
from mr360uw.medium.scattered_light import spread_of
from mr360uw.medium.veil_gain import fit_level
from mr360uw.render.lights import level_view
from mr360uw.render.surroundings import load_surroundings
from mr360uw.scene.model import Scene, at_scale
from mr360uw.scene.resolved import open_plate
from mr360uw.types import Array, BeamSpread, Floats, MediumTable

_FINER = 2
"""Points across a pixel of the region, whose mean it is: the plate's pixels below the camera are finer."""
_LEAST_DOWN = 0.02
"""Sine of the angle below the horizon that pixels are taken to have at least: rays that miss the floor are not read."""
_MOST_BLUR = 0.7
"""Greatest standard deviation [pixels] of a blur by three taps; beyond, the middle one would vanish."""


class FloorView:
    """Pixels in which a frame shows a region, for a camera at `position` (3,), `rotation` (3, 3) world_from_camera.

    rows: of the frame that hold the region. x_m, z_m, footprint_m: (h, W) of these pixels on the floor, the footprint
    as the side of a square of their area.
    """

    def __init__(self, grid: FloorGrid, position: Floats, rotation: Floats, width: int, height: int) -> None:
        # Find where points of the region lie, in the picture of the rows that hold it with a border of one pixel
        x, z = grid.places(_FINER)
        ray = np.stack([x - position[0], np.full_like(x, grid.floor_y - position[1]), z - position[2]], axis=-1)
        column, row = frame_from_direction(ray @ rotation, width, height)
        first, last = max(int(row.min() - 0.5), 0), min(int(row.max() + 0.5) + 1, height)
        self.rows = slice(first, last)
        self._at = (column + 0.5).astype(np.float32), (row - first + 0.5).astype(np.float32)
        # Find where these pixels lie on the floor
        pixels = direction_from_frame(np.arange(width) + 0.5, np.arange(first, last)[:, None] + 0.5, width, height)
        across, down, along = np.moveaxis(pixels @ np.asarray(rotation, np.float64).T, -1, 0)
        sine = np.maximum(-down, _LEAST_DOWN)
        distance = (position[1] - grid.floor_y) / sine
        self.x_m, self.z_m = position[0] + distance * across, position[2] + distance * along
        self.footprint_m = distance * (np.pi / height) / np.sqrt(sine)

    def read(self, picture: Any, blur: float = 0.0) -> NDArray[np.float32]:
        """Return the region (n, n, ...) in a picture (h, W, ...) of the rows. blur: standard deviation [pixels]."""
        import cv2

        around = cv2.copyMakeBorder(np.asarray(picture, np.float32), 1, 1, 1, 1, cv2.BORDER_REPLICATE)
        around[1:-1, 0], around[1:-1, -1] = picture[:, -1], picture[:, 0]
        if blur > 0.0:
            side = 0.5 * min(blur, _MOST_BLUR) ** 2
            taps = np.array([side, 1.0 - 2.0 * side, side])
            around = cv2.sepFilter2D(around, -1, taps, taps, borderType=cv2.BORDER_REPLICATE)
        fine = cv2.remap(around, *self._at, cv2.INTER_LINEAR)
        n = len(fine) // _FINER
        return np.asarray(fine.reshape(n, _FINER, n, _FINER, *fine.shape[2:]).mean(axis=(1, 3)))


_SIDE_PER_HEIGHT = 4.0
"""Side of the region by default, over the camera's height above it: rays fall at 20 degrees and steeper. Half as large,
it holds a quarter of the waves; twice as large, pixels at its edges show no detail of caustics."""


@dataclass(frozen=True, slots=True, eq=False)
class FloorGrid:
    """The pixels of a square region on the level floor, `count` across.

    x_m, z_m: its middle in the world. size_m: its side. floor_y: height of the floor.
    """

    x_m: float
    z_m: float
    size_m: float
    floor_y: float
    count: int

    @property
    def pixel_m(self) -> float:
        """Side of a pixel [m]."""
        return self.size_m / self.count

    def places(self, finer: int = 1) -> tuple[Array, Array]:
        """Return x and z (n, n) [m] of the pixels' centres, or of `finer` points across each."""
        n = self.count * finer
        along = ((np.arange(n) + 0.5) / n - 0.5) * self.size_m
        x, z = np.broadcast_arrays(self.x_m + along, (self.z_m + along)[:, None])
        return x, z

    def footprint_m(self, position: Array, pixel_rad: float) -> Array:
        """Return the width (n, n) [m] of the square that `FloorView.read` averages over at each pixel.

        A pixel of the plate is a square w wide, of the same area; it has the variance w^2/12, the linear interpolation
        between pixels w^2/6, and a pixel of the grid p^2/12: together those of a square of the width sqrt(3 w^2 + p^2).
        pixel_rad: angle of a pixel of the plate.
        """
        distance, down = self._distance_m(position)
        return np.sqrt(3.0 * (distance * pixel_rad) ** 2 * distance / down + self.pixel_m**2)

    def light(self, seen: Floats, position: Array, table: MediumTable) -> NDArray[np.float32]:
        """Return the light (n, n, 3) of the floor as it arrives at the camera, without the veil.

        seen: (n, n, 3) of the plate. table: of the water, its veil matched to the plate.
        """
        distance, down = self._distance_m(position)
        return np.asarray(seen - veil_lookup(table, distance, -down / distance), np.float32)

    def _distance_m(self, position: Array) -> tuple[Array, float]:
        """Return the distances (n, n) [m] of the pixels from a camera at a position (3,), and its height over them."""
        x, z = self.places()
        down = position[1] - self.floor_y
        return np.sqrt((x - position[0]) ** 2 + (z - position[2]) ** 2 + down**2), down


_DEFAULT_S = 2.0
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


def floor_series(
    scene: Scene, frames: tuple[int, int] | None = None, progress: Progress | None = None
) -> tuple[Floats, ModelledFloor, float]:
    """Return the light of a scene's floor over frames [a, b), by default the first two seconds: (T, n, n) luminance as
    it arrives at the camera; what makes our light of that floor under a sea; and the width [m] of its typical pixel.

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
            stop = min(video.frame_count, round(_DEFAULT_S * rate))
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
        x, y, z = positions.mean(axis=0).tolist()
        grid = FloorGrid(x, z, _SIDE_PER_HEIGHT * (y - floor_y), floor_y, _COUNT)
        views = _views(grid, places, video.width, video.height)
        seen, suns, gains = [], [], []
        for frame in video.frames(start, stop):
            number, left = divmod(frame.index - start, step)
            if left:
                continue
            view, up = views[number], places[number][1][1]
            seen.append(view.read(frame.image_linear[view.rows]))
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
    medium, depth_m = surroundings.medium, scene.camera.depth_m - floor_y
    table = medium.scaled(np.median(gains, axis=0)).table
    light = np.array([grid.light(one, position, table) for one, position in zip(seen, positions, strict=True)])
    color = np.maximum(light.mean(axis=(0, 1, 2)), 0.0)
    floor = ModelledFloor(
        views, grid.pixel_m, times, depth_m, sun, *_beam_fractions(medium, depth_m, sun, color, scene.water.sun_share),
        spread_of(medium), medium.refractive_index, _codes(np.array(seen)),
    )  # fmt: skip
    return luminance(light), floor, float(np.median(footprint))


def _views(grid: FloorGrid, places: list[tuple[Floats, Floats]], width: int, height: int) -> tuple[FloorView, ...]:
    """Return where each frame shows a region, one view for frames between which the camera does not move."""
    views: list[FloorView] = []
    for k, place in enumerate(places):
        still = k > 0 and all(map(np.array_equal, places[k - 1], place))
        views.append(views[-1] if still else FloorView(grid, *place, width, height))
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


# Our caustics of a sea on the region of floor that a plate shows, read through the pixels of its camera.
#
#     E/<E> = 1 + f (s (C - 1) + (1 - s) (B - 1))        f = (1 - (1 - q) sky) b(d)/r(d)
#
# f: fraction of the daylight on the floor, at the depth d, that is the sun's beam; q: the same just below the surface;
# sky: colour of the rest; b, r: fractions of the beam and of all light that reach d; s: fraction of the beam that has
# not turned; C: caustic ratio of that part, B: of the rest. The fractions are means over R, G and B, weighted by the
# luminance of each in the floor that is seen. C and B are averaged over the footprint of each of the plate's pixels;
# the region is then read from the pixels as it is from the plate's.

_SIZES = (64, 512)
"""Least and most pixels of a map across the sea's tile."""
_GRID_PER_WAVE = 5
"""Cells of the surface in its shortest wave. Three make a pattern that is less sharp: the wind that fits a finer one is
then 5 to 20 % too strong. Twice as many move it by 2 to 8 %, the most in the weakest winds."""
_GRIDS = (64, 256)


_MOST_LOST, _MOST_SPREAD, _WIDEST_BLUR = 0.07, 0.6, 0.5
"""Most of the pattern's amplitude that a codec takes, and most of its blur [pixels of the plate], times the pattern's
standard deviation in code values; the last is the most of any. Codecs drop what is below a step: of 2 code values H.264
took 0 to 4 % of the amplitude, of 14 or more below 1 %."""


@dataclass(frozen=True, slots=True, eq=False)
class ModelledFloor:
    """Makes the light of a floor under seas.

    views: (T,) where the frame at each time shows the region. pixel_m: of the region. time_s: (T,) evenly spaced.
    depth_m: below the mean surface. sun_in_air: (3,) towards the sun. beam, unturned: fractions f and s above. codes:
    standard deviation of the light over time, in 8-bit code values of the plate. blur: standard deviation [pixels of
    the plate] of what blurs its frames: a codec.
    """

    views: tuple[FloorView, ...]
    pixel_m: float
    time_s: Array
    depth_m: float
    sun_in_air: Array
    beam: float
    unturned: float
    spread: BeamSpread | None = None
    refractive_index: float = REFRACTIVE_INDEX_SEA
    codes: float = math.inf
    blur: float = 0.0

    @property
    def step_s(self) -> float:
        """Time [s] between frames."""
        return float(self.time_s[1] - self.time_s[0])

    def as_coded(self, beam: float, codec: float) -> ModelledFloor:
        """Return the floor with `beam` times the beam's fraction, through a codec that takes the part `codec` (0 to 1)
        of the most that codecs take of a pattern of so few code values."""
        lost = codec * min(_MOST_LOST / self.codes, 0.5)
        blur = codec * min(_MOST_SPREAD / self.codes, _WIDEST_BLUR)
        return replace(self, beam=min(self.beam * beam, 1.0) * (1.0 - lost), blur=blur)

    def light(self, sea: Sea) -> NDArray[np.float32]:
        """Return the light (T, n, n) of the floor under a sea, relative to that under a flat one."""
        size = 2.0 ** np.ceil(np.log2(sea.tile_m / self.pixel_m))
        shortest = getattr(sea, "shortest_wavelength_m", None) or sea.tile_m / 40.0
        grid = _GRID_PER_WAVE * sea.tile_m / shortest
        settings = CausticSettings(size=int(np.clip(size, *_SIZES)), grid=int(np.clip(grid, *_GRIDS)))
        times = zip(self.views, self.time_s, strict=True)
        return np.array([self._at(sea, float(time_s), view, settings) for view, time_s in times])

    def _at(self, sea: Sea, time_s: float, view: FloorView, settings: CausticSettings) -> NDArray[np.float32]:
        at = np.array([self.depth_m])
        stack = caustic_stack(sea, self.sun_in_air, at, time_s, settings, self.refractive_index, self.spread)
        pattern = self.unturned * (stack.ratio[..., 1:2] - 1.0)
        if stack.soft is not None:
            pattern = pattern + (1.0 - self.unturned) * (stack.soft - 1.0)
        u, v = along_beam(stack, view.x_m, at, view.z_m)
        seen = _read(mip_levels(pattern), u, v, view.footprint_m / stack.tile_m)
        return 1.0 + np.float32(self.beam) * view.read(seen, self.blur)


def _beam_fractions(
    medium: Medium, depth_m: float, sun_in_air: Array, color: Array, sun_share: float
) -> tuple[float, float]:
    """Return f and s above of a floor. color: (3,) of what is seen of it. sun_share: q, 0 for that of a clear sky."""
    sun_share = sun_share or CLEAR_SKY_DIRECT
    at, up = np.array([depth_m]), float(refract_to_water(sun_in_air, medium.refractive_index)[1])
    whole = ambient_ratio(medium.unit_table, at) / ambient_ratio(medium.unit_table, 0.0)
    direct = (1.0 - (1.0 - sun_share) * CLEAR_SKY) * beam_fraction(medium.unit_table, at, up)
    seen = luminance(np.diag(color)) / max(float(luminance(color)), 1e-12)
    fraction = (direct / whole)[0] * seen
    beam = float(np.sum(fraction))
    return beam, float(np.sum(unscattered_share(medium.unit_table, at, up)[0] * fraction)) / max(beam, 1e-12)


def _read(levels: list[Floats], u: Floats, v: Floats, footprint: Floats) -> NDArray[np.float32]:
    """Return mip levels (1, size, size, 1) at places of a tile, averaged over footprints; all (h, w), in tiles."""
    import cv2

    level = mip_level(footprint, 1.0 / levels[0].shape[1], len(levels) - 1.0)
    image = np.zeros(u.shape, np.float32)
    for k, texels in enumerate(levels):
        weight = np.maximum(1.0 - np.abs(level - k), 0.0).astype(np.float32)
        if weight.any():
            size = texels.shape[1]
            x, y = (np.remainder(a * size - 0.5, size).astype(np.float32) for a in (u, v))
            picture = texels[0, ..., 0].astype(np.float32)
            image += weight * cv2.remap(picture, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
    return image


# Measures of a moving pattern of light on a level floor: contrast, scale, speed and direction of travel.
#
#     C(x, t) = E(x, t)/<E(x)>_t - 1        P(k, w) = |F{h C}|^2 / (n sum h^2)
#
# E: light of the floor at world (x, z), <>_t its mean over time, which takes the texture of the floor with it. h: Hann
# window over x, z and t. P sums to the variance of C. A wave cos(k.x - w t) has its power at -k where w > 0 in the sign
# of the transform: it travels along +k. Waves and what they focus travel alike, so directions have their sign.
#
# Pictures show the plate's caustics on the floor beside ours, and their spectra. North (-z) is at the top.

Codes = NDArray[np.uint8]

_SIDE = 320
"""Pixels of one square."""
_LABEL_ROWS, _GAP = 26, 6
_BRIGHTEST = 3.0
"""Standard deviations of the plate's light above its mean that are white; as many below are black."""
_FINEST_M = 0.25
"""Wavelength [m] at the edge of the spectra."""
_DECADES = 3.0
"""Powers of ten of a spectrum between black and white."""
_NAMES = ("plate", "ours before", "ours after")


def floor_pictures(shown: Sequence[PatternMeasures]) -> Codes:
    """Return the light of floors (plate, before, after) side by side, (H, W, 3), on one scale."""
    reach = _BRIGHTEST * max(float(np.std(shown[0].relative)), 1e-6)
    grey = [np.clip(0.5 + 0.5 * one.relative / reach, 0.0, 1.0) for one in shown]
    labels = [f"{name}, contrast {100 * one.contrast:.0f} %" for name, one in zip(_NAMES, shown, strict=False)]
    return _side_by_side(grey, labels)


def spectrum_pictures(shown: Sequence[PatternMeasures], pixel_m: float) -> Codes:
    """Return the power over wave vectors of travel, long waves in the middle, as logarithms on one scale."""
    parts = []
    top = max(float(shown[0].spectrum.max()), 1e-30)
    for one in shown:
        power = one.spectrum
        n = len(power)
        half = int(np.clip(round(n * pixel_m / _FINEST_M), 2, n // 2 - 1))
        middle = slice(n // 2 - half, n // 2 + half + 1)
        level = np.log10(np.maximum(power[middle, middle], 1e-30) / top)
        parts.append(np.clip(1.0 + level / _DECADES, 0.0, 1.0))
    labels = [
        f"{name}, {one.scale_m:.2f} m to {one.azimuth_deg:.0f} deg" for name, one in zip(_NAMES, shown, strict=False)
    ]
    return _side_by_side(parts, labels)


def _side_by_side(parts: Sequence[Floats], labels: Sequence[str]) -> Codes:
    """Return pictures (n, n) of 0 to 1 as squares in a row, (H, W, 3), each with its label below."""
    import cv2

    sheet = np.full((_SIDE + _LABEL_ROWS, len(parts) * (_SIDE + _GAP) - _GAP, 3), 24, np.uint8)
    for number, (part, label) in enumerate(zip(parts, labels, strict=True)):
        left = number * (_SIDE + _GAP)
        codes = np.asarray(255.0 * part + 0.5, np.float32).astype(np.uint8)
        square = cv2.resize(codes, (_SIDE, _SIDE), interpolation=cv2.INTER_LINEAR)
        sheet[:_SIDE, left : left + _SIDE] = square[..., None]
        at = left + 4, _SIDE + _LABEL_ROWS - 8
        cv2.putText(sheet, label, at, cv2.FONT_HERSHEY_SIMPLEX, 0.5, (235, 235, 235), 1, cv2.LINE_AA)
    return sheet


_BANDS_PER_OCTAVE = 2
"""Bands of wavelength in an octave. Twice as many, each holds half the waves and varies more by chance."""
_FEWEST_PERIODS = 3.0
"""Least number of wavelengths across the region in its longest band; the window halves them."""
_BROADEST = 0.15
"""Standard deviation, over the region's side, of the blur that is taken out: a wave as long as the longest band keeps
0.99 of its amplitude. Twice as large, that of the exposure stays in."""
_TINY = 1e-30


@dataclass(frozen=True, slots=True, eq=False)
class PatternMeasures:
    """Measures of a pattern over a square region.

    contrast: standard deviation over mean. wavelength_m: (b,) middle of each band, ascending. power: (b,) variance of
    the relative light in each band. frequency_rad_s: (b,) mean angular frequency of each band, weighted by power.
    direction: (2,) over (x, z), mean unit vector of travel weighted by power; its length is 0 for a pattern without
    direction and 1 for a plane wave. spectrum: (n, n) power over wave vectors of travel, zero in the middle. relative:
    (n, n) C at the time in the middle.
    """

    contrast: float
    wavelength_m: Array
    power: Array
    frequency_rad_s: Array
    direction: Array
    spectrum: Array
    relative: Floats

    @property
    def scale_m(self) -> float:
        """Mean wavelength [m] of the bands, of the logarithm and weighted by power."""
        return float(np.exp(np.average(np.log(self.wavelength_m), weights=np.maximum(self.power, _TINY))))

    @property
    def dispersion(self) -> float:
        """Median over the bands of the frequency over that of deep-water waves of the same length, sqrt(g k).

        About 1 for caustics at the right scale; it grows with the square root of a floor's height that is too large.
        """
        waves = np.sqrt(GRAVITY_M_S2 * 2.0 * np.pi / self.wavelength_m)
        return float(np.median(self.frequency_rad_s / waves))

    @property
    def azimuth_deg(self) -> float:
        """Azimuth [deg] of the direction of travel, 0 = forward (-z), 90 = right (+x), in [0, 360)."""
        return float(np.degrees(np.arctan2(self.direction[0], -self.direction[1]))) % 360.0


def relative_light(light: Floats) -> NDArray[np.float32]:
    """Return C (T, n, n) of a series of the light (T, n, n) of a floor; 0 where the mean is not positive.

    What changes over more than `_BROADEST` of the region is taken out of every frame: exposure, shade, shafts.
    """
    import cv2

    mean = light.mean(axis=0, dtype=np.float64)
    lit = mean > 0.0
    relative = np.where(lit, light / np.where(lit, mean, 1.0) - 1.0, 0.0).astype(np.float32)
    sigma = _BROADEST * light.shape[1]
    return np.array([one - cv2.GaussianBlur(one, (0, 0), sigma, borderType=cv2.BORDER_REFLECT) for one in relative])


def bands(size_m: float, finest_m: float) -> Array:
    """Return the edges (b + 1,) [m], ascending, of the bands of wavelength that a region shows.

    size_m: side of the region. finest_m: shortest wavelength that is seen. Raises `ParameterError` where not one band
    lies between.
    """
    longest = size_m / _FEWEST_PERIODS
    count = int(np.floor(_BANDS_PER_OCTAVE * np.log2(longest / finest_m))) if longest > finest_m else 0
    if count < 1:
        raise ParameterError(
            f"region - is too small for its pixels (got {size_m:.2g} m for waves from {finest_m:.2g} m up) - take a "
            "larger one, or a plate with more pixels"
        )
    return longest * 2.0 ** (np.arange(-count, 1) / _BANDS_PER_OCTAVE)


def pattern_measures(relative: Floats, pixel_m: float, step_s: float, edges_m: Array) -> PatternMeasures:
    """Return the measures of C (T, n, n). pixel_m: of the region. step_s: between frames. edges_m: see `bands`."""
    frames, n = relative.shape[:2]
    space, time = np.hanning(n + 2)[1:-1], np.hanning(frames + 2)[1:-1]
    window = time[:, None, None] * space[:, None] * space
    seen = (relative.astype(np.float64) - relative.mean()) * window
    transform = np.fft.fft2(np.fft.rfft(seen, axis=0))
    power = np.abs(transform) ** 2 / (relative.size * np.sum(window**2))
    power[1 : (frames + 1) // 2] *= 2.0
    frequency = 2.0 * np.pi / (frames * step_s) * np.arange(len(power))
    k = 2.0 * np.pi * np.fft.fftfreq(n, pixel_m)
    length = np.hypot(k, k[:, None])
    of_band = np.digitize(2.0 * np.pi / np.maximum(length, _TINY), edges_m) - 1
    count = len(edges_m) - 1
    inside = (of_band >= 0) & (of_band < count)
    still, moving = power.sum(axis=0), np.tensordot(frequency, power, 1)
    banded = np.bincount(of_band[inside], still[inside], count).astype(np.float64)
    rate = np.bincount(of_band[inside], moving[inside], count).astype(np.float64) / np.maximum(banded, _TINY)
    # the frequency 0 has no sense of travel
    gone = power[1:].sum(axis=0)
    travel = -np.stack([np.broadcast_to(k, length.shape), np.broadcast_to(k[:, None], length.shape)])
    unit = travel / np.maximum(length, _TINY)
    direction = np.array([np.sum((u * gone)[inside]) for u in unit]) / max(float(gone[inside].sum()), _TINY)
    middle = np.sqrt(edges_m[:-1] * edges_m[1:])
    shown = np.fft.fftshift(np.roll(gone[::-1, ::-1], (1, 1), (0, 1)))
    return PatternMeasures(float(relative.std()), middle, banded, rate, direction, shown, relative[frames // 2].copy())
