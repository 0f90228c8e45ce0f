# SPDX-License-Identifier: Apache-2.0
"""Inverse tone mapping, from floats and from decoded planes."""

from __future__ import annotations

from typing import get_args

import numpy as np
import pytest

import mr360uw.ibl as ibl
from mr360uw.base.color import DisplayTransfer, decode, encode
from mr360uw.base.sphere import directions, unit
from mr360uw.ibl.lighting import block_size, lit_frame, plate_of_yuv
from mr360uw.ibl.plate import LinearPlate
from mr360uw.ibl.settings import LightSettings
from mr360uw.types import YuvImage
from mr360uw.yuv.decoding import decode_polynomial
from tests.ibl.plates import angle_deg, clipped, planes, sky
from tests.ibl.tolerances import ENERGY_FLOAT32, FLOAT64, SUN_HDR_DEG, YUV_MEAN


def test_mr360_is_the_published_formula() -> None:
    code = np.linspace(0, 1, 11)
    plate = np.repeat(decode(code, "srgb")[None, :, None], 3, axis=2).astype(np.float32)
    got = ibl.expand(plate, LightSettings(operator="mr360", region="all"))
    np.testing.assert_allclose(got, plate * (10.0 * code**10 + 1.8)[None, :, None], rtol=ENERGY_FLOAT32)


@pytest.mark.parametrize("operator", ["mr360", "landis", "akyuz", "piecewise"])
def test_operators_are_monotonous_and_reach_their_white(operator: str) -> None:
    grey = np.repeat(np.linspace(0, 1, 200, dtype=np.float32)[None, :, None], 3, axis=2)
    chosen = LightSettings(operator=operator, region="all", peak=9.0)
    got = ibl.expand(grey, chosen)[0, :, 1]
    assert np.all(np.diff(got) > 0.0)
    assert got[-1] == pytest.approx(11.8 if operator == "mr360" else 9.0, rel=ENERGY_FLOAT32)


@pytest.mark.parametrize("operator", ["landis", "piecewise", "closure", "none"])
def test_what_is_dark_stays_as_it_is(operator: str) -> None:
    plate = np.full((4, 8, 3), 0.2, np.float32)
    np.testing.assert_array_equal(ibl.expand(plate, LightSettings(operator=operator)), plate)


def test_the_region_has_no_step() -> None:
    plate = np.full((180, 4, 3), 0.9, np.float32)
    rows = ibl.expand(plate, LightSettings(operator="mr360", region="upper"))[:, 0, 0]
    assert rows[-1] == plate[0, 0, 0]
    assert rows[0] > 3.0 * rows[-1]
    assert np.abs(np.diff(rows)).max() < 0.1 * (rows[0] - rows[-1])
    window = ibl.expand(plate, LightSettings(operator="mr360", region="snell"))[:, 0, 0]
    assert window[89] == plate[0, 0, 0]
    assert window[0] == rows[0]


def test_enhancement_spreads_from_the_clipped_area_up_to_edges() -> None:
    plate = np.full((128, 256, 3), 0.7, np.float32)
    plate[:, 128:] = 0.1
    plate[50:70, 50:70] = 1.0
    got = ibl.expand(plate, LightSettings(operator="kovaleski", region="all"))
    gains = (got / plate)[..., 0]
    assert gains[60, 60] > gains[60, 90] > 1.0 + ENERGY_FLOAT32
    assert gains[60, 200] == pytest.approx(1.0, abs=ENERGY_FLOAT32)


@pytest.mark.parametrize("transfer", get_args(DisplayTransfer))
def test_the_polynomial_follows_the_curve(transfer: str) -> None:
    slope, *c = decode_polynomial(transfer).astype(np.float64)
    x = np.linspace(0.0, 1.1, 500)
    got = x * np.maximum(np.polynomial.polynomial.polyval(x, c), slope)
    assert np.abs(got - decode(x, transfer)).mean() < YUV_MEAN * decode(x, transfer).mean()


@pytest.mark.parametrize("bits", [8, 10])
@pytest.mark.parametrize("operator", ["none", "closure", "mr360"])
def test_planes_give_the_light_of_the_decoded_frame(operator: str, bits: int) -> None:
    yuv = planes(clipped(sky(unit([0.3, 0.7, 0.2]), width=1024)), bits)
    chosen = LightSettings(operator=operator)
    fast, full = plate_of_yuv(yuv, chosen), LinearPlate(lit_frame(yuv), chosen)
    assert np.mean(np.abs(fast.coarse - full.coarse)) < YUV_MEAN * full.coarse.mean()
    a, b = ibl.environment_from_yuv(yuv, chosen), ibl.environment(lit_frame(yuv), chosen)
    assert a.sun is not None
    assert b.sun is not None
    assert angle_deg(a.sun.direction, b.sun.direction) < SUN_HDR_DEG
    assert np.mean(np.abs(a.irradiance - b.irradiance)) < 3 * YUV_MEAN * b.irradiance.mean()


@pytest.mark.parametrize("width", [960, 1440, 1680])
def test_sizes_that_do_not_nest(width: int, rng: np.random.Generator) -> None:
    height = width // 2
    assert block_size(width, height) % 2 == 0
    yuv = planes(np.clip(0.5 + 0.3 * directions(width, height) + rng.normal(0, 0.02, (height, width, 3)), 0, 1))
    fast = plate_of_yuv(yuv, LightSettings())
    full = LinearPlate(lit_frame(yuv), LightSettings())
    assert np.mean(np.abs(fast.coarse - full.coarse)) < YUV_MEAN * full.coarse.mean()


def test_other_chroma_formats_are_decoded_in_full() -> None:
    yuv = planes(clipped(sky(unit([0.3, 0.7, 0.2]), width=256)))
    wide = YuvImage(yuv.y, np.repeat(yuv.u, 2, 0), np.repeat(yuv.v, 2, 0), yuv.spec)
    a, b = ibl.environment_from_yuv(yuv), ibl.environment_from_yuv(wide)
    assert np.mean(np.abs(a.ambient - b.ambient)) < YUV_MEAN * b.ambient.mean()


def test_code_values_survive_encode_and_decode() -> None:
    code = np.linspace(0, 1, 256)
    for transfer in get_args(DisplayTransfer):
        np.testing.assert_allclose(encode(decode(code, transfer), transfer), code, atol=FLOAT64)
