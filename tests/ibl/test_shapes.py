# SPDX-License-Identifier: Apache-2.0
"""Shapes at the calls of `mr360uw.ibl`."""

from __future__ import annotations

import numpy as np
import pytest

from mr360uw import ibl
from mr360uw.base.color import ColorSpec
from mr360uw.types import Environment, Sun, YuvImage
from tests.ibl.plates import sky
from tests.shapes import Refused, Returns, called, check_refused, check_returned, filled, functions_of, towards

UP = np.array([0.0, 1.0, 0.0])
SUN = Sun(UP, np.ones(3), 0.01, 1.0)
MAP = (32, 64, 3)
LIGHT = dict.fromkeys(("radiance", "irradiance", "residual", "ambient"), MAP) | {"detail": (128, 256, 3)}


def plate(height: int = 64, width: int = 128, channels: int = 3) -> np.ndarray:
    return filled(height, width, channels)


def planes(chroma: tuple[int, int], second: tuple[int, int] | None = None) -> YuvImage:
    full = [np.full(shape, 100, np.uint8) for shape in ((64, 128), chroma, second or chroma)]
    return YuvImage(full[0], full[1], full[2], ColorSpec())


def measured() -> Environment:
    return ibl.environment(plate(), sun=SUN)


RETURNS: Returns = {
    "expand": (lambda _: ibl.expand(plate(50, 70)), lambda _: (50, 70, 3)),
    "environment": (
        lambda _: ibl.environment(plate(50, 70), glossy=True),
        lambda _: LIGHT | {"glossy": (5, *MAP), "glossy_roughness": (5,)},
    ),
    "environment, no levels": (
        lambda _: ibl.environment(plate(), sun=UP),
        lambda _: LIGHT | {"glossy": (0, *MAP), "glossy_roughness": (0,)},
    ),
    "environment_from_yuv": (
        lambda _: [ibl.environment_from_yuv(planes(c)).residual for c in ((32, 64), (64, 64), (64, 128))],
        lambda _: (MAP, MAP, MAP),
    ),
    "detect_sun": (lambda _: ibl.detect_sun(sky(UP)), lambda _: {"direction": (3,), "irradiance": (3,)}),
    "irradiance": (lambda _: ibl.irradiance(plate(64, 128)), lambda _: MAP),
    "irradiance, sh9": (lambda _: ibl.irradiance(plate(32, 64), "sh9"), lambda _: MAP),
    "prefilter": (lambda _: ibl.prefilter(plate(32, 64), 0.5), lambda _: MAP),
    "glossy_beam": (lambda _: ibl.glossy_beam(UP, filled(3), 0.5), lambda _: MAP),
    "split_sum": (lambda b: ibl.split_sum(filled(*b), 0.5), lambda b: (b, b)),
    "measure_sun": (lambda _: ibl.measure_sun(measured(), 0.0, np.eye(3)), lambda _: {"thumbnail": (8, 16)}),
    "track_suns": (
        lambda _: ibl.track_suns([SUN] * 7),
        lambda _: dict.fromkeys(("raw_direction", "direction", "raw_irradiance", "irradiance"), (7, 3))
        | dict.fromkeys(("times_s", "half_angle_rad", "raw_confidence", "confidence", "exposure", "share"), (7,)),
    ),
}  # fmt: skip
REFUSED: Refused = {
    "expand": lambda: ibl.expand(plate(channels=4)),
    "expand, up": lambda: ibl.expand(plate(), up=towards((2,))),
    "environment": lambda: ibl.environment(filled(64, 128)),
    "environment, sun": lambda: ibl.environment(plate(), sun=towards((2,))),
    "environment_from_yuv": lambda: ibl.environment_from_yuv(planes((16, 64))),
    "environment_from_yuv, v": lambda: ibl.environment_from_yuv(planes((32, 64), (64, 64))),
    "detect_sun": lambda: ibl.detect_sun(filled(2, 64, 128, 3)),
    "irradiance": lambda: ibl.irradiance(plate(48, 96)),
    "prefilter": lambda: ibl.prefilter(plate(32, 32), 0.5),
    "glossy_beam": lambda: ibl.glossy_beam(towards((2,)), filled(3), 0.5),
    "glossy_beam, irradiance": lambda: ibl.glossy_beam(UP, filled(4), 0.5),
    "split_sum": lambda: ibl.split_sum(filled(4), filled(3)),
    "measure_sun": lambda: ibl.measure_sun(measured(), 0.0, np.eye(4)),
    "track_suns": lambda: ibl.track_suns([SUN] * 7, [0.0, 1.0]),
}


def test_every_public_function_is_here() -> None:
    assert functions_of(ibl) - called(RETURNS) == {"load_track", "save_track"}  # files
    assert called(REFUSED) >= called(RETURNS)


def test_what_comes_out(subtests: pytest.Subtests) -> None:
    check_returned(RETURNS, subtests)


def test_other_shapes_are_refused(subtests: pytest.Subtests) -> None:
    check_refused(REFUSED, subtests)
