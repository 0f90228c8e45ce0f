# SPDX-License-Identifier: Apache-2.0
"""Match stage: the look of a plate, measured at fixed frames of its clip.

Its colour is taken off every frame before its light is read, and laid on again with the composite; its softness and
sharpening are given to the bodies of a frame's layer.

A patch of known distance is solved with the water before it, as frames are drawn in it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.cache import Cache
from mr360uw.base.color import decode_signal, encode, ycbcr_from_rgb
from mr360uw.base.sphere import disc_directions, frame_from_direction
from mr360uw.composite.grading.colour_grade import NO_GRADE, ColourGrade, Three, code_of, graded_spec, luma_weights_of
from mr360uw.composite.grading.patch_solve import Patch
from mr360uw.composite.grading.settings import MatchSettings, PatchSettings, PlateGrade
from mr360uw.errors import DamagedFrameError, ParameterError, VideoError
from mr360uw.medium import Medium
from mr360uw.medium.closed_form import CONTRAST_LENGTHS
from mr360uw.medium.lookup import ambient_ratio, transmittance_lookup, veil_lookup
from mr360uw.medium.open_water import upwelling
from mr360uw.medium.veil_gain import fit_level
from mr360uw.render.lights import level_view, plate_map
from mr360uw.render.loaded import Loaded
from mr360uw.render.surroundings import Surroundings
from mr360uw.types import Floats, Layer, MediumTable, Rectangle
from mr360uw.video import VideoFrame, VideoReader

FRAMES = 5
"""Frames of a clip whose look is measured, evenly spread; each is the keyframe before its place."""


def clip_grade(loaded: Loaded, video: VideoReader) -> PlateGrade | None:
    """Return the look of a clip's plate; None where the plan measures none, or no frame of these can be decoded.

    The frames depend on the clip and the patches alone, so that any range of it has one look. Raises `VideoError`.
    """
    settings = loaded.scene.match
    if not loaded.plan.match.runs or not settings.measures:
        return None
    count = video.intact_frames or video.frame_count or 1
    places = [video.entry_before(int(index)) for index in np.linspace(0, count - 1, FRAMES)]
    seen = list(_intact(video, places))
    shown = patch_frames(settings, video)
    at = {frame.index: frame for frame in _intact(video, shown)}
    if not seen or not all(index in at for index in shown):
        return None
    with_patches = [at[index] for index in shown]
    return _look(settings.measured, tuple(seen), tuple(with_patches), _surroundings(loaded, with_patches))


def patch_frames(settings: MatchSettings, video: VideoReader) -> list[int]:
    """Return the numbers of the frames of a clip that show the patches; raise `VideoError` for one after its end."""
    count = video.intact_frames or video.frame_count or 1
    rate = float(video.frame_rate) if video.frame_rate else 0.0
    for k, patch in enumerate(settings.patch):
        if video.frame_count and patch.time_s * rate > video.frame_count:
            raise VideoError(
                f"match.patch[{k}].time_s - is after the plate's end, {video.frame_count / rate:.2f} s (got "
                f"{patch.time_s:g}) - give the time of a frame that shows the patch"
            )
    return [min(round(patch.time_s * rate), count - 1) for patch in settings.patch]


def _surroundings(loaded: Loaded, frames: Iterable[VideoFrame]) -> tuple[Surroundings, ...]:
    return tuple(loaded.surroundings_at(frame.time_s) for frame in frames)


def _look(
    settings: MatchSettings,
    frames: tuple[VideoFrame, ...],
    shown: tuple[VideoFrame, ...],
    surroundings: tuple[Surroundings, ...],
) -> PlateGrade:
    """Return the look of a plate's frames, as far as a scene's settings leave it open.

    shown: for each patch of the settings, the frame that shows it. surroundings: of each of these.
    """
    from mr360uw.composite.grading.patch_solve import patched_colour
    from mr360uw.composite.grading.softness import point_spread

    grade = PlateGrade(columns=frames[0].shape[1])
    found: tuple[str, ...] = ()
    if settings.softness == "auto":
        grade = replace(grade, softness_px=point_spread([_luma(frame) for frame in frames]).softness_px)
        soft = f"blur of {grade.softness_px:.2f} px" if grade.softness_px > 0.0 else "blur: not told by this plate"
        found = (soft,)
    if settings.open_keys:
        patches, in_water = [read_patch(*one) for one in zip(shown, settings.patch, strict=True)], None
        there = any(now.medium is not None for now in surroundings)
        if there and any(patch.distance_m is not None for patch in settings.patch):
            in_water = partial(patches_in_water, patches, settings.patch, surroundings, shown)
        colour, line = patched_colour(settings, patches, shown[0].spec, in_water)
        grade, found = replace(grade, colour=colour), (*found, line)
    return replace(grade, found=found)


def asked_grade(loaded: Loaded, grade: PlateGrade | None, plate: VideoFrame, cache: Cache) -> PlateGrade:
    """Return the look that a frame's bodies are given; one that changes nothing where the plan has none.

    grade: of the clip; None measures it in this frame alone. plate: as the file has it. cache: holds the look that was
    measured last.
    """
    settings = loaded.scene.match
    if not loaded.plan.match.runs:
        return PlateGrade()
    if grade is None:
        grade = PlateGrade()
        if settings.measures:
            grade = grade_in_frame(loaded, plate, [plate for _ in settings.patch], cache)
    return grade.of_scene(settings, loaded.width, loaded.scene.plate.scale)


def ungraded(loaded: Loaded, grade: PlateGrade | None, plate: VideoFrame, cache: Cache) -> VideoFrame:
    """Return a frame whose light is read without the colour of its grade; the frame itself where it has none.

    grade: of the clip; None measures it in this frame alone.
    """
    colour = asked_grade(loaded, grade, plate, cache).colour
    return plate if colour == NO_GRADE else cache.of(VideoFrame.graded_by, plate, colour)


def grade_in_frame(loaded: Loaded, plate: VideoFrame, shown: list[VideoFrame], cache: Cache) -> PlateGrade:
    """Return the look of a plate as one frame has it, and its patches. shown: for each patch the frame that shows it.

    cache: holds the look that was measured last.
    """
    return cache.of(_look, loaded.scene.match.measured, (plate,), tuple(shown), _surroundings(loaded, shown))


def clip_colour(loaded: Loaded, grade: PlateGrade | None) -> ColourGrade | None:
    """Return the colour of a clip's grade; None where it has none. grade: of the clip, as measured."""
    if not loaded.plan.match.runs:
        return None
    colour = (grade or PlateGrade()).of_scene(loaded.scene.match, loaded.width).colour
    return colour if colour.changes else None


def with_grade(layer: Layer, grade: PlateGrade, plate: VideoFrame) -> Layer:
    """Return a frame's layer whose bodies have a look."""
    from mr360uw.composite.grading.softness import matched_layer

    return matched_layer(layer.laid(), grade, plate.linear)


def _intact(video: VideoReader, places: list[int]) -> Iterator[VideoFrame]:
    """Yield the frames of a clip at places, each once; those that cannot be decoded are left out."""
    for index in dict.fromkeys(places):
        try:
            yield next(iter(video.frames(index, index + 1)))
        except DamagedFrameError:
            continue


def _luma(frame: VideoFrame) -> NDArray[Any]:
    """Return the luma (H, W) of a frame as its codes have it, that of sRGB where it has none of its own."""
    if frame.yuv is not None:
        return frame.yuv.y
    weights = ycbcr_from_rgb("bt709")[0]
    return np.asarray(encode(frame.image_linear, "srgb") @ weights, np.float32)


_PATCH_SAMPLES = 64
"""Pixels that are read of a patch, evenly over its disc."""


def read_patch(frame: VideoFrame, patch: PatchSettings) -> Patch:
    """Return a patch as a frame shows it, as the file has it: the median code of its disc in each channel."""
    directions = disc_directions(patch.direction, math.radians(0.5 * patch.size_deg), _PATCH_SAMPLES)
    height, width = frame.shape
    x, y = frame_from_direction(directions, width, height)
    column, row = x.astype(int) % width, np.clip(y.astype(int), 0, height - 1)
    first, last = int(row.min()), int(row.max())
    light = np.asarray(frame.linear(Rectangle(0, first, width, last - first + 1)))[row - first, column]
    return Patch(_three(np.median(code_of(light, frame.spec), axis=0)), patch.reflected)


_TINY = 1e-12
_LOST = np.exp(-CONTRAST_LENGTHS)
"""Transmittance at the visibility of a water: black is then a code of 8 bits darker than the brightest open water."""
_TRIED_M = np.geomspace(0.01, 100.0, 400)
"""Distances [m] among which the farthest is looked for at which anything is seen."""


def patches_in_water(
    patches: Sequence[Patch],
    settings: Sequence[PatchSettings],
    surroundings: Sequence[Surroundings],
    shown: Sequence[VideoFrame],
    colour: ColourGrade,
    stretch: float,
) -> list[Patch]:
    """Return patches with the water before each, in frames whose light is read without a grade's colour.

    surroundings, shown: of the frames that show them. stretch: factor on their distances. Raises `ParameterError` for
    a patch above the water, or so far away that the plate shows nothing but water there.
    """
    grade = colour if colour.changes else None
    plain = {id(frame): frame.graded_by(grade) for frame in shown}  # patches of one frame share its light
    found = []
    for number, (patch, of_patch, one, now) in enumerate(zip(patches, settings, shown, surroundings, strict=True)):
        where, frame = f"match.patch[{number}].distance_m", plain[id(one)]
        found.append(_behind_water(patch, of_patch, frame, now, colour, stretch, where))
    return found


def _behind_water(
    patch: Patch, settings: PatchSettings, frame: VideoFrame, now: Surroundings, colour: ColourGrade, stretch: float,
    where: str,
) -> Patch:  # fmt: skip
    """Return a patch with the water before it. frame: without the grade of a colour, which its codes have."""
    if settings.distance_m is None or now.medium is None:
        return patch
    distance_m, rotation = stretch * settings.distance_m, now.camera.at(frame.time_s)[1]
    up, medium = float((rotation @ settings.direction)[1]), _as_read(now, frame)
    _check(where, distance_m, medium.unit_table, up)
    passed = transmittance_lookup(medium.unit_table, distance_m, up)
    passed = passed * ambient_ratio(medium.unit_table, medium.camera_depth_m - distance_m * up)
    level = medium.gain * medium.level_radiance(np.zeros(1))[0]
    # in the primaries that the patches of a plate are solved in
    seen = veil_lookup(medium.table, distance_m, up), level
    near, far = (np.asarray(decode_signal(code_of(light, frame.spec), graded_spec(frame.spec))) for light in seen)
    code = None
    if now.water.fits_gain:
        code = _three(colour.graded(code_of(level, frame.spec), luma_weights_of(frame.spec)))
    grown = near / np.maximum(far, _TINY)
    return replace(patch, passed=_three(passed), grown=_three(grown), water=_three(far), water_code=code)


def _as_read(now: Surroundings, frame: VideoFrame) -> Medium:
    """Return the medium of a frame, with the gain of its open water where the scene gives none."""
    medium, up = now.medium_at(frame.time_s), now.camera.at(frame.time_s)[1][1]
    assert medium is not None
    if now.water.fits_gain:
        medium = medium.scaled(fit_level(medium, level_view(frame.pixels, up))[0])
    if medium.floor_m is None:
        return medium
    return medium.lit_by_floor(medium.floor_seen(medium.gain, upwelling(plate_map(frame.pixels, up))))


def _check(where: str, distance_m: float, table: MediumTable, up: float) -> None:
    """Raise `ParameterError` where a patch is above the water, or where it is lost in it in every channel."""
    surface_m = table.camera_depth_m / max(up, _TINY)
    if distance_m >= surface_m:
        raise ParameterError(
            f"{where} - is above the water, whose surface is {surface_m:.3g} m away there (got {distance_m:g}) - give "
            "the distance of something in the water"
        )
    seen = transmittance_lookup(table, _TRIED_M, up).max(axis=-1) > _LOST
    if transmittance_lookup(table, distance_m, up).max() <= _LOST:
        raise ParameterError(
            f"{where} - is so far that only water is seen: all else is lost beyond {_TRIED_M[seen].max():.2g} m "
            f"there (got {distance_m:g}) - mark something nearer, or check the distance and the water"
        )


def _three(values: Floats) -> Three:
    red, green, blue = (float(value) for value in values)
    return red, green, blue
