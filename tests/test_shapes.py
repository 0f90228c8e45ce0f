# SPDX-License-Identifier: Apache-2.0
"""Shapes at the calls of `sphere` and `color`."""

from __future__ import annotations

import inspect

import numpy as np
import pytest

from mr360uw.base import color, sphere
from tests.shapes import Refused, Returns, called, check_refused, check_returned, filled, towards

RETURNS: Returns = {
    "direction_from_frame": (lambda b: sphere.direction_from_frame(filled(*b), 2.0, 64, 32), lambda b: (*b, 3)),
    "frame_from_direction": (lambda b: sphere.frame_from_direction(towards(b), 64, 32), lambda b: (b, b)),
    "directions": (lambda _: sphere.directions(10, 5), lambda _: (5, 10, 3)),
    "row_solid_angle": (lambda _: sphere.row_solid_angle(10, 5), lambda _: (5,)),
    "unit": (lambda b: sphere.unit(3.0 * towards(b)), lambda b: (*b, 3)),
    "direction_from_angles": (lambda _: sphere.direction_from_angles(0.2, 0.3), lambda _: (3,)),
    "yaw_matrix": (lambda _: sphere.yaw_matrix(0.2), lambda _: (3, 3)),
    "basis": (lambda _: sphere.basis([0.0, 0.6, 0.8]), lambda _: (3, 3)),
    "disc_offsets": (lambda _: sphere.disc_offsets(7), lambda _: (7, 2)),
    "disc_directions": (lambda _: sphere.disc_directions([0.0, 0.6, 0.8], 0.1, 7), lambda _: (7, 3)),
    "effective_half_angle": (lambda b: sphere.effective_half_angle(filled(*b), 0.1), lambda b: b),
    "luminance": (lambda b: color.luminance(filled(*b, 3)), lambda b: b),
    "decode": (lambda b: color.decode(filled(*b), "srgb"), lambda b: b),
    "encode": (lambda b: color.encode(filled(*b), "srgb"), lambda b: b),
    "rgb_from_ycbcr": (lambda _: color.rgb_from_ycbcr("bt709"), lambda _: (3, 3)),
    "ycbcr_from_rgb": (lambda _: color.ycbcr_from_rgb("bt709"), lambda _: (3, 3)),
    "decode_signal": (lambda b: color.decode_signal(filled(*b), color.ColorSpec()), lambda b: b),
    "encode_signal": (lambda b: color.encode_signal(filled(*b), color.ColorSpec()), lambda b: b),
    "in_rec709": (
        lambda b: color.in_rec709(filled(*b, 3), color.ColorSpec("bt2020")),
        lambda b: (*b, 3),
    ),
    "in_plate_primaries": (
        lambda b: color.in_plate_primaries(filled(*b, 3), color.ColorSpec("bt2020")),
        lambda b: (*b, 3),
    ),
    "rec709_from_plate": (lambda _: color.rec709_from_plate("bt2020"), lambda _: (3, 3)),
    "rec709_from_xyz": (lambda _: color.rec709_from_xyz(np.ones(3)), lambda _: (3, 3)),
    "rec709_from_chromaticities": (
        lambda _: color.rec709_from_chromaticities(np.array([(0.7, 0.3), (0.2, 0.7), (0.1, 0.1), (0.3, 0.3)])),
        lambda _: (3, 3),
    ),
}
REFUSED: Refused = {
    "direction_from_frame": lambda: sphere.direction_from_frame(filled(4), filled(3), 64, 32),
    "frame_from_direction": lambda: sphere.frame_from_direction(filled(4, 2), 64, 32),
    "unit": lambda: sphere.unit(filled(4, 2)),
    "unit, a number": lambda: sphere.unit(1.0),
    "luminance": lambda: color.luminance(filled(3, 4)),
}


def test_every_public_function_is_here() -> None:
    public = {
        name
        for module in (sphere, color)
        for name, item in inspect.getmembers(module, inspect.isfunction)
        if not name.startswith("_") and item.__module__ == module.__name__
    }
    assert public - called(RETURNS) == {"code_range"}


def test_what_comes_out(subtests: pytest.Subtests) -> None:
    check_returned(RETURNS, subtests)


def test_other_shapes_are_refused(subtests: pytest.Subtests) -> None:
    check_refused(REFUSED, subtests)


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_colours_keep_their_type(kind: type) -> None:
    assert color.decode(filled(4).astype(kind), "srgb").dtype == kind
    assert color.encode(filled(4).astype(kind), "bt709").dtype == kind
