# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math
from typing import get_args

import numpy as np
import pytest

from mr360uw.base.color import (
    WIDE_TRANSFERS,
    ColorSpec,
    DisplayTransfer,
    Matrix,
    Primaries,
    Transfer,
    code_range,
    decode,
    decode_signal,
    encode,
    encode_signal,
    luminance,
    rec709_from_plate,
    rgb_from_ycbcr,
    unseen_changes,
    ycbcr_from_rgb,
)
from mr360uw.errors import ParameterError
from tests.tolerances import DLOG_JOIN, FLOAT64, TRANSFER_JOIN, WIDE_ROUND_TRIP


@pytest.mark.parametrize("transfer", get_args(DisplayTransfer))
def test_encode_undoes_decode_and_the_curve_rises_from_zero_to_one(transfer: Transfer) -> None:
    code = np.linspace(-0.2, 1.2, 1401)
    linear = decode(code, transfer)
    np.testing.assert_allclose(encode(linear, transfer), code, atol=TRANSFER_JOIN)
    assert np.all(np.diff(linear) > 0)
    np.testing.assert_allclose(decode(np.array([0.0, 1.0]), transfer), [0.0, 1.0], atol=FLOAT64)


def test_published_values() -> None:
    assert decode(0.5, "srgb") == pytest.approx(0.21404114, abs=1e-8)  # IEC 61966-2-1
    assert encode(0.018053968510807, "bt709") == pytest.approx(0.08124286, abs=1e-8)  # ITU-R BT.2020-2 table 4


@pytest.mark.parametrize("transfer", WIDE_TRANSFERS)
def test_wide_curves_rise_and_round_trip(transfer: Transfer) -> None:
    """From below black to the brightest code; PQ ends there. D-Log's pieces meet at rounded numbers of its maker."""
    code = np.linspace(-0.05, 1.0, 2101)
    linear = decode(code, transfer)
    atol = DLOG_JOIN if transfer == "dlog" else WIDE_ROUND_TRIP
    np.testing.assert_allclose(encode(linear, transfer), code, atol=atol)
    assert np.all(np.diff(linear) > 0)
    assert np.all(np.isfinite(decode(np.array([-1.0, 2.0]), transfer)))


@pytest.mark.parametrize(
    ("transfer", "light", "code"),
    [
        ("pq", 1.0, 0.58069),  # ITU-R BT.2408-7 table 1: 203 cd/m2 is 58 %
        ("pq", 100.0 / 203.0, 0.50808),  # and 100 cd/m2 51 %
        ("hlg", 1.0, 0.75),  # the same: reference white
        ("slog3", 0.0, 95.0 / 1023.0),  # Sony, S-Gamut3.Cine/S-Log3 technical summary: codes of 0, 18 and 90 %
        ("slog3", 0.18, 420.0 / 1023.0),
        ("slog3", 0.90, 598.0 / 1023.0),
        ("vlog", 0.0, 128.0 / 1023.0),  # Panasonic, V-Log/V-Gamut reference manual: 0, 18 and 90 %
        ("vlog", 0.18, 433.0 / 1023.0),
        ("vlog", 0.90, 602.0 / 1023.0),
        ("dlog", 0.0, 95.0 / 1023.0),  # DJI, white paper on D-Log and D-Gamut: 0, 18 and 90 %
        ("dlog", 0.18, 408.0 / 1023.0),
        ("dlog", 0.90, 586.0 / 1023.0),
        ("gplog", 1.0, 1.0),
        ("gplog", 0.18, math.log(1.0 + 0.18 * 399.0) / math.log(400.0)),
    ],
)
def test_published_codes_of_wide_curves(transfer: Transfer, light: float, code: float) -> None:
    """Within half a 10-bit code: that is how the makers print them."""
    assert float(encode(np.array(light), transfer)) == pytest.approx(code, abs=0.5 / 1023.0)


@pytest.mark.parametrize("bits", [8, 10])
@pytest.mark.parametrize("transfer", ["slog3", "hlg"])
def test_log_codes_are_the_file_s_whatever_its_range(transfer: Transfer, bits: int) -> None:
    """S-Log3 puts black and grey at codes of the file; television curves at parts of the signal."""
    tagged = [ColorSpec(full_range=full, transfer=transfer, bits=bits) for full in (False, True)]
    codes = []
    for spec in tagged:
        low, span, _, _ = code_range(spec)
        codes.append(low + span * encode_signal(np.array([0.0, 0.18]), spec))
        np.testing.assert_allclose(decode_signal((codes[-1] - low) / span, spec), [0.0, 0.18], atol=WIDE_ROUND_TRIP)
    assert np.allclose(*codes, atol=1e-6) == (transfer == "slog3")


@pytest.mark.parametrize("primaries", get_args(Primaries))
def test_white_is_white_in_every_gamut(primaries: Primaries) -> None:
    np.testing.assert_allclose(rec709_from_plate(primaries) @ np.ones(3), 1.0, atol=FLOAT64)
    # a camera's gamut is wider: red of Rec.709 is a mixture of its primaries
    red = np.linalg.solve(rec709_from_plate(primaries), [1.0, 0.0, 0.0])
    assert primaries == "bt709" or red[0] < 0.9


def test_an_unknown_curve_is_named() -> None:
    with pytest.raises(ParameterError, match="logc"):
        decode(0.5, "logc")  # type: ignore[arg-type]


@pytest.mark.parametrize("matrix", get_args(Matrix))
def test_grey_has_no_chroma_and_the_matrices_are_inverse(matrix: Matrix) -> None:
    np.testing.assert_allclose(ycbcr_from_rgb(matrix) @ np.ones(3), [1, 0, 0], atol=FLOAT64)
    np.testing.assert_allclose(ycbcr_from_rgb(matrix) @ rgb_from_ycbcr(matrix), np.eye(3), atol=FLOAT64)
    # a pure primary reaches the end of its chroma axis
    assert (ycbcr_from_rgb(matrix) @ [0, 0, 1])[1] == pytest.approx(0.5)
    assert (ycbcr_from_rgb(matrix) @ [1, 0, 0])[2] == pytest.approx(0.5)


def test_code_ranges() -> None:
    assert code_range(ColorSpec()) == (16, 219, 128, 224)
    assert code_range(ColorSpec(bits=10)) == (64, 876, 512, 896)
    assert code_range(ColorSpec(full_range=True)) == (0, 255, 128, 255)


def test_luminance_of_white_is_one() -> None:
    assert luminance(np.ones((2, 3))) == pytest.approx(1.0)


@pytest.mark.parametrize("spec", [ColorSpec(), ColorSpec(transfer="bt709", full_range=True), ColorSpec(transfer="hlg")])
def test_a_change_of_light_that_is_not_seen_moves_no_code_by_more_than_half(spec: ColorSpec) -> None:
    low, span, _, _ = code_range(spec)
    changes = unseen_changes(spec)
    for code in range(round(low + 0.1 * span), round(low + span) + 1, 16):
        light = decode((np.arange(low + 0.06 * span, code + 1) - low) / span, spec.transfer)
        moved = span * np.abs(encode(light * (1.0 + changes[code]), spec.transfer) - encode(light, spec.transfer))
        assert 0.4 < moved.max() <= 0.51  # a gradient over steps of a hundredth of the signal


def test_codes_of_more_bits_show_smaller_changes_down_to_a_thousandth() -> None:
    found = [unseen_changes(ColorSpec(bits=bits))[-1] for bits in (8, 10, 16)]
    assert found[0] == pytest.approx(4.0 * found[1], rel=0.01)
    assert found[2] == 0.001
