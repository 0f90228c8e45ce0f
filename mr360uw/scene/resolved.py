# SPDX-License-Identifier: Apache-2.0
"""Resolved scenes: the plate, opened; values at a time; tables of water whose parameters are keyed."""

from __future__ import annotations

import itertools
import math
from typing import Any

from pydantic.fields import FieldInfo

from mr360uw.base.color import PlateMapping
from mr360uw.base.files import files_named
from mr360uw.base.input_files import read_data
from mr360uw.base.parameters import bounds_of, stated
from mr360uw.errors import VideoError
from mr360uw.medium.models import CLOSED_FORMS
from mr360uw.medium.settings import WaterSettings
from mr360uw.scene.key_targets import KeyedParameter, Target, key_times, target_of, with_values
from mr360uw.scene.model import PlateSettings, Scene
from mr360uw.video import VideoReader, open_video
from mr360uw.video.clip import PICTURE_SUFFIXES, projection_of
from mr360uw.video.layout import Shape, eyes_seen, shape_of_codes, way_out
from mr360uw.video.picture_tags import read_tags
from mr360uw.video.reader import scaled
from mr360uw.yuv.ocio_transform import CubeMapping, cube_mapping, ocio_mapping


def open_plate(scene: Scene) -> VideoReader:
    """Return the scene's plate, opened as its table says; raise `VideoError`."""
    plate = scene.plate
    video = open_video(
        plate.path, transfer=plate.transfer, primaries=plate.primaries, eye=plate.eye, frame_rate=plate.frame_rate,
        damaged=plate.damaged, projection=plate.projection, fisheye_fov_deg=plate.fisheye_fov_deg, layout=plate.layout,
        decoder=plate.decoder,
    )  # fmt: skip
    mapping = _mapping(plate)
    if mapping is not None:
        video.spec = video.spec.mapped(mapping)
        video.notes += _clipping(plate, mapping)
    return scaled(video, plate.scale)


def pose_of_plate(plate: PlateSettings) -> tuple[float, float, float]:
    """Return yaw, pitch and roll [deg] that a plate's file states for its panorama; zeros without."""
    file = next(files_named(plate.path), plate.path)
    if projection_of(plate.path, plate.projection) != "equirectangular" or not file.is_file():
        return 0.0, 0.0, 0.0
    suffix = file.suffix.lower()
    if suffix in PICTURE_SUFFIXES:
        return read_tags(read_data(file, VideoError), suffix, (1, 1))[0].pose_deg
    from mr360uw.video.container import stated_pose

    return stated_pose(file)


def _clipping(plate: PlateSettings, mapping: PlateMapping) -> tuple[str, ...]:
    """Return a note where the table of a plate shows many values as one light."""
    found = mapping.clipped_greys if isinstance(mapping, CubeMapping) else ""
    note = f"{plate.lut} - clips greys {found}: what is drawn as bright or as dark gets the nearest value"
    return (note,) if found else ()


def _mapping(plate: PlateSettings) -> PlateMapping | None:
    """Return the table or the colour spaces that a plate is read through, None where it has a curve."""
    if plate.lut is not None:
        return cube_mapping(plate.lut, plate.lut_to, plate.levels)
    return None if plate.ocio is None else ocio_mapping(plate.ocio, plate.levels)


def projection_notes(scene: Scene, video: VideoReader, index: int = 0) -> tuple[str, ...]:
    """Return a note where a frame of a scene's plate does not look like a panorama.

    None where the projection is set, to "equirectangular" too.
    """
    if scene.plate.projection != "auto" or projection_of(scene.plate.path, "auto") != "equirectangular":
        return ()
    found = way_out(shape_of_frame(video, index), video.path)
    leave = 'if that is wrong, set plate.projection = "equirectangular"'
    return (f"{video.path} - {found}; {leave}",) if found else ()


def eyes_of_plate(scene: Scene) -> tuple[str, float | None]:
    """Return what the two eyes of a scene's plate show in its first frame: a doubt, or ""; and the height [m] of the
    camera over the ground, None where it is not told.
    """
    if scene.plate.eye is None:
        return "", None
    with open_plate(scene.model_copy(update={"plate": scene.plate.model_copy(update={"eye": "both"})})) as video:
        frame = next(iter(video.frames(0, 1)))
        assert frame.right is not None
        tagged = video.spherical.stereo if video.spherical is not None else "mono"
        layout = scene.plate.layout or (video.stereo if tagged == "mono" else tagged)
        doubt, floor_m = eyes_seen(frame.image_linear, frame.right.image_linear, layout)
    return f"{scene.plate.path} - {doubt}" if doubt else "", floor_m


def shape_of_frame(video: VideoReader, index: int = 0) -> Shape:
    """Return what a frame of a plate looks like."""
    frame = next(iter(video.frames(index, index + 1)))
    codes = frame.yuv if frame.yuv is not None else frame.rgb
    return "panorama" if codes is None else shape_of_codes(codes, frame.spec.bits)


# Tables of water are made for a few waters on the way and interpolated between them. To tabulate a solved light field
# takes a third of a second, all else of a water a hundredth. From each key to the next the way of the parameters is cut
# into even steps (`_RATIO`, `_STEPS`). Tables are made at the ends of the steps, as many as the water changes and not
# as the clip has frames. They depend on the keys alone, so a frame does not depend on those before it. At the times of
# keys the tables are exact.

_SHOWN = 6
"""Most keys of a parameter that its line shows one by one."""


def scene_at(scene: Scene, time_s: float) -> Scene:
    """Return a scene with the values of its keyed parameters at a time [s], and without keys; itself if it has none.

    The values were checked when the scene was made: between keys they stay between those of the keys.
    """
    if not scene.keys:
        return scene
    return with_values(scene, scene.keys, time_s).model_copy(update={"keys": ()})


def keyed_in_words(scene: Scene) -> list[str]:
    """Return a line for each keyed parameter: its values, their times and how it goes between them."""
    return [_in_words(scene, key) for key in scene.keys]


def _in_words(scene: Scene, key: KeyedParameter) -> str:
    unit = stated(target_of(scene, key.parameter).field, "unit")
    values = [str(list(v)) if isinstance(v, tuple) else f"{v:g}" for v in key.value]
    times = [f"{time:g}" for time in key.time_s]
    if len(times) > _SHOWN:
        values, times = ([*row[:2], "...", *row[-2:]] for row in (values, times))
    unit = "" if unit in ("", "1") else f" {unit}"
    return f"{key.parameter}: {', '.join(values)}{unit} at {', '.join(times)} s, {key.interpolation}"


_RATIO = 1.03
"""Ratio of neighbouring values of a parameter that spans more than `_STEPS` times its least value (visibility,
chlorophyll). The largest error of a veil is 0.03 % for visibilities of 10 to 20 m, 1.3 % for 30 to 3 m; twice the step
gives up to four times that."""
_STEPS = 64.0
"""Steps of any other parameter over its whole range. The largest error of a veil is 1.8 %, for mean cosines to 0.95."""
TABLE_S = 0.35
"""About how long [s] it takes to tabulate a water, on a core of 2.5 GHz."""
_HALVINGS = 60
"""Bisections for the time of a step: to the last digit of a clip's time."""


WaterBetween = tuple[WaterSettings, WaterSettings, float]
"""Two waters that the water of a time lies between, and the fraction of the way from the first to the second."""


def water_between(scene: Scene, time_s: float) -> WaterBetween | None:
    """Return the waters that the keyed water of a scene lies between at a time; None where it needs no others."""
    way = next((way for way in _ways(scene) if way.start < time_s < way.stop), None)
    return None if way is None else way.between(time_s)


def tables_on_the_way(scene: Scene) -> int:
    """Return how many tables keyed water takes over a clip, beside those of the keys themselves."""
    return sum(max(way.steps - 1, 0) for way in _ways(scene))


def _ways(scene: Scene) -> list[_Way]:
    """Return the ways of the water from each key to the next."""
    targets = [(key, target_of(scene, key.parameter)) for key in scene.keys]
    keyed = [(k, t) for k, t in targets if t.path[0] == "water" and t.path[1] != "gain"]
    if not keyed or scene.water.mode in CLOSED_FORMS:  # quick enough for each frame
        return []
    times = key_times(key for key, _ in keyed)
    return [_Way(scene, keyed, start, stop) for start, stop in itertools.pairwise(times)]


class _Way:
    """The way of a water's parameters from one key to the next."""

    def __init__(self, scene: Scene, keyed: list[tuple[KeyedParameter, Target]], start: float, stop: float) -> None:
        self._scene, self.start, self.stop = scene, start, stop
        self._held = [key for key, _ in keyed if key.interpolation == "hold"]
        self._moving = [(key, target) for key, target in keyed if key.interpolation != "hold"]
        self._from = [_place(t.field, t.value(k, start)) for k, t in self._moving]
        self._length = self._gone(stop)
        self.steps = math.ceil(self._length)

    def between(self, time_s: float) -> WaterBetween | None:
        """Return the waters at the ends of the step that a time is in; None where the water stays as it is."""
        if self.steps == 0:
            return None
        along = self._gone(time_s) / self._length * self.steps
        step = min(math.floor(along), self.steps - 1)
        first, second = (self._water(end * self._length / self.steps) for end in (step, step + 1))
        return first, second, along - step

    def _gone(self, time_s: float) -> float:
        """Return the length of the way that is behind at a time, in steps; between keys all values are monotone."""
        now = [_place(t.field, t.value(k, time_s)) for k, t in self._moving]
        return sum(abs(a - b) for a, b in zip(now, self._from, strict=True))

    def _water(self, gone: float) -> WaterSettings:
        """Return the water a length into the way, without gain."""
        low, high = self.start, self.stop
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self._gone(middle) < gone else (low, middle)
        scene = with_values(self._scene, self._held, self.start)
        return without_gain(with_values(scene, [key for key, _ in self._moving], low if gone == 0.0 else high).water)


def without_gain(water: WaterSettings) -> WaterSettings:
    """Return the settings of a water with no gain of its own."""
    return water.model_copy(update={"gain": "auto"})


def _place(field: FieldInfo, value: Any) -> float:
    """Return a value of a parameter in steps."""
    low, high = bounds_of(field)
    assert low is not None
    assert high is not None
    if low > 0.0 and high > _STEPS * low:
        return math.log(value) / math.log(_RATIO)
    return _STEPS * float(value - low) / (high - low)
