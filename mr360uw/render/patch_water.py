# SPDX-License-Identifier: Apache-2.0
"""Water between the camera and the patches of a plate whose distance is known, as frames are drawn in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mr360uw.color import ColorSpec, decode_signal
from mr360uw.composite.grading.colour_grade import ColourGrade, Three, code_of, graded_spec, luma_weights_of
from mr360uw.composite.grading.patch_solve import PatchWater
from mr360uw.composite.grading.settings import PatchSettings
from mr360uw.errors import ParameterError
from mr360uw.medium import Medium
from mr360uw.medium.fit.level import fit_level
from mr360uw.medium.fit.profile import upwelling
from mr360uw.medium.lookup import ambient_ratio, transmittance_lookup, veil_lookup
from mr360uw.medium.visibility import CONTRAST_LENGTHS
from mr360uw.render.plate_map import level_view, plate_map
from mr360uw.render.surroundings import Surroundings
from mr360uw.types import Floats, MediumTable
from mr360uw.video import VideoFrame

_TINY = 1e-12
_LOST = np.exp(-CONTRAST_LENGTHS)
"""Transmittance at the visibility of a water: black is then a code of 8 bits darker than the brightest open water."""
_TRIED_M = np.geomspace(0.01, 100.0, 400)
"""Distances [m] among which the farthest is looked for at which anything is seen."""


def waters_before(
    patches: tuple[PatchSettings, ...],
    surroundings: Sequence[Surroundings],
    shown: Sequence[VideoFrame],
    colour: ColourGrade,
    stretch: float,
) -> list[PatchWater | None]:
    """Return the water before each patch, in frames whose light is read without a grade's colour; None for none.

    surroundings, shown: of the frames that show them. stretch: factor on their distances. Raises `ParameterError` for
    a patch above the water, or so far away that the plate shows nothing but water there.
    """
    grade = colour if colour.changes else None
    plain = {id(frame): frame.graded_by(grade) for frame in shown}  # patches of one frame share its light
    seen = enumerate(zip(patches, shown, surroundings, strict=True))
    return [_before(k, patch, plain[id(frame)], now, colour, stretch) for k, (patch, frame, now) in seen]


def _before(
    number: int, patch: PatchSettings, frame: VideoFrame, now: Surroundings, colour: ColourGrade, stretch: float
) -> PatchWater | None:
    """Return the water before a patch. frame: without the grade of a colour, which its codes have."""
    if patch.distance_m is None or now.medium is None:
        return None
    distance_m, rotation = stretch * patch.distance_m, now.camera.at(frame.time_s)[1]
    up, medium = float((rotation @ patch.direction)[1]), _as_read(now, frame)
    _check(f"match.patch[{number}].distance_m", distance_m, medium.unit_table, up)
    passed = transmittance_lookup(medium.unit_table, distance_m, up)
    passed = passed * ambient_ratio(medium.unit_table, medium.camera_depth_m - distance_m * up)
    level = medium.gain * medium.level_radiance(np.zeros(1))[0]
    near, far = (_as_coded(light, frame.spec) for light in (veil_lookup(medium.table, distance_m, up), level))
    water = PatchWater(_three(passed), _three(near / np.maximum(far, _TINY)), _three(far))
    if not now.water.fits_gain:
        return water
    code = colour.graded(code_of(level, frame.spec), luma_weights_of(frame.spec))
    return replace(water, code=_three(code))


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


def _as_coded(light: Floats, spec: ColorSpec) -> Floats:
    """Return linear Rec.709 light (3,) in the primaries that the patches of a plate are solved in."""
    return np.asarray(decode_signal(code_of(light, spec), graded_spec(spec)))


def _three(values: Floats) -> Three:
    red, green, blue = (float(value) for value in values)
    return red, green, blue
