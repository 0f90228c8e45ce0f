# SPDX-License-Identifier: Apache-2.0
"""One decoder, three readers: rectangles, directions and means over blocks see the same light in the same codes."""

from __future__ import annotations

import numpy as np
import pytest

from mr360uw.base.color import ColorSpec, Transfer
from mr360uw.base.sphere import directions
from mr360uw.ibl.lighting import plate_of_yuv
from mr360uw.ibl.settings import LightSettings
from mr360uw.types import YuvImage
from mr360uw.yuv.decoding import linear_from_planes, linear_in_directions
from tests.tolerances import YUV_NEAREST, YUV_NEAREST_WIDE, YUV_POLYNOMIAL

SPECS = [
    ColorSpec(),
    ColorSpec("bt601", True, "bt709"),
    ColorSpec("bt709", False, "bt1886", 10),
    ColorSpec("bt2020", False, "srgb", 10),
    ColorSpec("bt2020", False, "hlg", 10),
    ColorSpec("bt709", False, "slog3", 10, "sgamut3cine"),
]


def noisy(spec: ColorSpec, rng: np.random.Generator, width: int = 128) -> YuvImage:
    """Codes inside the gamut of R'G'B' from 0.25 to 0.85, another at every sample."""
    top, kind = 1 << spec.bits, np.uint8 if spec.bits == 8 else np.uint16
    y = rng.integers(int(0.45 * top), int(0.65 * top), (width // 2, width)).astype(kind)
    u, v = (rng.integers(int(0.46 * top), int(0.54 * top), (width // 4, width // 2)).astype(kind) for _ in range(2))
    return YuvImage(y, u, v, spec)


@pytest.mark.parametrize("spec", SPECS, ids=str)
def test_directions_see_what_rectangles_hold(spec: ColorSpec, rng: np.random.Generator) -> None:
    """At the pixels' own directions, with chroma that differs from sample to sample: values and siting agree."""
    image = noisy(spec, rng)
    height, width = image.y.shape
    seen, held = linear_in_directions(image, directions(width, height)), linear_from_planes(image)
    np.testing.assert_allclose(seen, np.maximum(held, 0.0), atol=YUV_NEAREST, rtol=YUV_NEAREST_WIDE * spec.is_wide)


@pytest.mark.parametrize("spec", SPECS, ids=str)
def test_blocks_hold_the_mean_of_their_light(spec: ColorSpec, rng: np.random.Generator) -> None:
    """A flat frame needs no mean: what is left is the decoder."""
    some = noisy(spec, rng, 8)
    for j, i in np.ndindex(some.u.shape):
        y, u, v = (
            np.full(shape, code, some.y.dtype)
            for shape, code in (((256, 512), some.y[j, i]), ((128, 256), some.u[j, i]), ((128, 256), some.v[j, i]))
        )
        image = YuvImage(y, u, v, spec)
        coarse = plate_of_yuv(image, LightSettings(operator="none")).coarse[64, 128]
        np.testing.assert_allclose(coarse, linear_from_planes(image)[100, 100], rtol=YUV_POLYNOMIAL)


@pytest.mark.parametrize("transfer", ["srgb", "linear"])
def test_left_siting_moves_no_column(transfer: Transfer) -> None:
    """Chroma sited on even columns: a step between two samples lies at its middle on the odd column."""
    spec = ColorSpec("bt709", True, transfer)
    y = np.full((64, 128), 128, np.uint8)
    u = np.full((32, 64), 128, np.uint8)
    v = u.copy()
    v[:, 32:] = 160
    red = linear_from_planes(YuvImage(y, u, v, spec), wrap=False)[32, :, 0]
    assert red[62] == red[0]
    assert red[64] == red[127]
    assert red[62] < red[63] < red[64]
