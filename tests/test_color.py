# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from typing import get_args

import numpy as np
import pytest

from mr360uw.color import (
    TRANSFERS,
    ColorSpec,
    Matrix,
    Transfer,
    code_range,
    decode,
    encode,
    luminance,
    rgb_from_ycbcr,
    ycbcr_from_rgb,
)
from mr360uw.errors import ParameterError
from tests.tolerances import FLOAT64, TRANSFER_JOIN


@pytest.mark.parametrize("transfer", TRANSFERS)
def test_encode_undoes_decode_and_the_curve_rises_from_zero_to_one(transfer: Transfer) -> None:
    code = np.linspace(-0.2, 1.2, 1401)
    linear = decode(code, transfer)
    np.testing.assert_allclose(encode(linear, transfer), code, atol=TRANSFER_JOIN)
    assert np.all(np.diff(linear) > 0)
    np.testing.assert_allclose(decode(np.array([0.0, 1.0]), transfer), [0.0, 1.0], atol=FLOAT64)


def test_published_values() -> None:
    assert decode(0.5, "srgb") == pytest.approx(0.21404114, abs=1e-8)  # IEC 61966-2-1
    assert encode(0.018053968510807, "bt709") == pytest.approx(0.08124286, abs=1e-8)  # ITU-R BT.2020-2 table 4


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
