# SPDX-License-Identifier: Apache-2.0
"""Grain: found as it was put in, and added as it was found."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import cv2
import numpy as np
import pytest

from mr360uw.base.color import ColorSpec, code_range, decode
from mr360uw.types import Floats, Layer, Rectangle, Tile, YuvImage
from mr360uw.video.planes import NO_GRAIN, add_grain, grain_of_planes, grain_of_rgb, white_noise
from mr360uw.video.reader import VideoFrame
from tests.video import tolerances as tol

SIZE = (1024, 512)


def spread(rng: np.random.Generator, shape: tuple[int, ...], blur_px: float) -> Floats:
    """Return white noise, or noise blurred by a Gaussian, of variance 1."""
    white = rng.standard_normal(shape)
    if blur_px == 0.0:
        return white
    soft = cv2.GaussianBlur(white, (0, 0), blur_px, borderType=cv2.BORDER_REFLECT)
    tap = cv2.getGaussianKernel(2 * int(6 * blur_px) + 1, blur_px)
    return soft / np.sum(tap**2)


def noisy(
    rng: np.random.Generator,
    luma_std: float,
    chroma_std: float = 0.0,
    blur_px: float = 0.0,
    texture: Floats | float = 0.0,
    spec: ColorSpec | None = None,
) -> YuvImage:
    """Return a vertical gradient with grain of so many 8-bit codes, rounded to the codes of `spec`."""
    spec = spec or ColorSpec()
    width, height = SIZE
    scale, dtype = 1 << (spec.bits - 8), np.uint8 if spec.bits == 8 else np.uint16
    base = np.linspace(50.0, 190.0, height)[:, None] + texture
    y = base + luma_std * spread(rng, (height, width), blur_px)
    c = [128.0 + chroma_std * spread(rng, (height // 2, width // 2), blur_px) for _ in range(2)]
    return YuvImage(*(np.round(scale * plane).astype(dtype) for plane in (y, *c)), spec)


def in_codes(image: YuvImage) -> tuple[Floats, Floats, Floats]:
    """Return the standard deviations found in the three planes, in 8-bit codes, in the middle of the range."""
    _, y_span, _, c_span = code_range(replace(image.spec, bits=8))
    found = grain_of_planes(image).deviation[:, 16:48]
    return found[0] * y_span, found[1] * c_span, found[2] * c_span


def neighbours(noise: Floats) -> float:
    return float(np.mean(noise[:, 1:] * noise[:, :-1]) / np.mean(noise**2))


# --- measuring -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("bits", [8, 10])
@pytest.mark.parametrize(("std", "blur_px"), [(1.5, 0.0), (4.0, 0.0), (2.0, 0.7), (3.0, 1.0)])
def test_known_grain_is_found(std: float, blur_px: float, bits: int, rng: np.random.Generator) -> None:
    image = noisy(rng, std, 0.6 * std, blur_px, spec=ColorSpec(bits=bits))
    for found, true in zip(in_codes(image), (std, 0.6 * std, 0.6 * std), strict=True):
        # the picture was rounded (1/12), and what is laid over it will be rounded with dither (1/6)
        added = np.sqrt(true**2 + (1.0 / 12.0 - 1.0 / 6.0) / 4.0 ** (bits - 8))
        np.testing.assert_allclose(found, added, rtol=tol.GRAIN_STD)
    grain = grain_of_planes(image)
    for plane in range(3):
        got = grain.noise(plane, 0, Rectangle(0, 0, 512, 512), 1024)
        true = neighbours(spread(rng, (512, 512), blur_px))
        assert neighbours(got) == pytest.approx(true, abs=tol.GRAIN_CORRELATION)
        assert neighbours(got.T) == pytest.approx(true, abs=tol.GRAIN_CORRELATION)
        assert got.var() == pytest.approx(1.0, abs=tol.GRAIN_VARIANCE)


@pytest.mark.parametrize("blur_px", [0.0, 1.0])
def test_texture_is_no_grain(blur_px: float, rng: np.random.Generator) -> None:
    """Half of the frame is covered with patches of waves five times as strong as the grain."""
    width, height = SIZE
    where = np.clip(spread(rng, (height, width), 60.0), 0.0, 1.0)
    image = noisy(rng, 2.0, 1.0, blur_px, texture=10.0 * where * spread(rng, (height, width), 3.0))
    luma, u, v = in_codes(image)
    np.testing.assert_allclose(luma, 2.0, rtol=tol.GRAIN_TEXTURED)
    np.testing.assert_allclose([u, v], 1.0, rtol=tol.GRAIN_TEXTURED)


def test_where_all_is_textured_at_some_brightness_the_rest_bounds_it(rng: np.random.Generator) -> None:
    width, height = SIZE
    texture = np.where(np.arange(height)[:, None] < height // 2, 25.0, 0.0) * spread(rng, (height, width), 1.5)
    found = in_codes(noisy(rng, 1.5, texture=texture))[0]
    assert found[-8:] == pytest.approx(1.5, rel=tol.GRAIN_TEXTURED)
    assert found[:8].max() < 4.0


def test_grain_follows_brightness(rng: np.random.Generator) -> None:
    image = noisy(rng, 0.0, spec=ColorSpec(bits=10))
    luma = (image.y / 4.0 - 16.0) / 219.0
    y = image.y + 4.0 * (3.0 - 2.0 * luma) * rng.standard_normal(image.y.shape)
    grain = grain_of_planes(replace(image, y=np.round(y).astype(np.uint16)))
    at = np.array([0.3, 0.5, 0.65])
    np.testing.assert_allclose(219.0 * grain.at(0, at), 3.0 - 2.0 * at, rtol=tol.GRAIN_STD)


@pytest.mark.parametrize("slope", [0.0, 0.02, 0.3])
def test_a_clean_gradient_has_none(slope: float, rng: np.random.Generator) -> None:
    """Steps of rounding are not grain, nor is what dither does about them."""
    image = noisy(rng, 0.0, texture=slope * np.arange(SIZE[0]) - 100.0 * slope)
    assert not grain_of_planes(image).deviation.any()
    base = np.linspace(50.0, 190.0, SIZE[1])[:, None] + slope * np.arange(SIZE[0]) - 100.0 * slope
    dithered = np.floor(base + rng.random(image.y.shape))
    assert in_codes(replace(image, y=dithered.astype(np.uint8)))[0].max() < tol.GRAIN_DITHER_CODES
    light = np.repeat(decode(image.y / 255.0 * 0.0 + np.linspace(0.2, 0.7, 512)[:, None], "srgb")[..., None], 3, -1)
    assert grain_of_rgb(light.astype(np.float32), "linear").deviation.max() < tol.FLOAT32


def test_clipped_and_flat_parts_do_not_count(rng: np.random.Generator) -> None:
    image = noisy(rng, 2.0, 1.0)
    y = image.y.copy()
    y[:, :300], y[:, 400:600] = 235, 90
    np.testing.assert_allclose(in_codes(replace(image, y=y))[0], 2.0, rtol=tol.GRAIN_STD)
    blank = replace(image, y=np.full_like(y, 16))
    assert grain_of_planes(blank) is NO_GRAIN
    small = YuvImage(image.y[:48], image.u[:24], image.v[:24], image.spec)
    assert grain_of_planes(small) is NO_GRAIN


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_grain_of_rgb_pictures(dtype: type, rng: np.random.Generator) -> None:
    """Equal grain in R', G' and B' is the luma's; what they do not share goes into chroma by the matrix."""
    base = np.linspace(0.2, 0.7, 512)[:, None, None] + np.zeros((1, 1024, 3))
    codes = base + (2.0 / 255.0) * rng.standard_normal((512, 1024, 1))
    peak = np.iinfo(dtype).max if dtype is not np.float32 else 0
    picture = np.round(codes * peak).astype(dtype) if peak else decode(codes, "srgb").astype(dtype)
    found = 255.0 * grain_of_rgb(picture, "srgb" if peak else "linear").deviation[:, 16:48]
    np.testing.assert_allclose(found[0], 2.0, rtol=tol.GRAIN_STD)
    assert found[1:].max() < 0.1


# --- adding --------------------------------------------------------------------------------------------------------


def frame_of(image: YuvImage, index: int = 0) -> VideoFrame:
    return VideoFrame(index, index, Fraction(1, 25), index / 25, 1, image.spec, yuv=image)


def grey_tile(alpha: Floats, column: int = 0, row: int = 0, luma: float = 0.5, ratio: float = 1.0) -> Tile:
    light = float(decode(np.array(luma), "srgb"))
    full = np.ones((*alpha.shape, 3), np.float32)
    cover = alpha.astype(np.float32)
    return Tile(column, row, light * cover[..., None] * full, cover, full[..., 0], ratio * full, 0.0 * full)


def laid(image: YuvImage, amount: float, *tiles: Tile, index: int = 0) -> YuvImage:
    height, width = image.y.shape
    result = frame_of(image, index).over(Layer(height, width, tiles), amount).yuv
    assert result is not None
    return result


@pytest.mark.parametrize("bits", [8, 10])
@pytest.mark.parametrize(("amount", "alpha"), [(1.0, 1.0), (0.5, 1.0), (2.0, 0.5)])
def test_what_is_added_is_amount_times_estimate_times_alpha(
    amount: float, alpha: float, bits: int, rng: np.random.Generator
) -> None:
    image = noisy(rng, 4.0, 3.0, spec=ColorSpec(bits=bits))
    tile = grey_tile(np.full((200, 301), alpha), 101, 51)
    plain, grainy = laid(image, 0.0, tile), laid(image, amount, tile)
    _, y_span, _, c_span = code_range(image.spec)
    grain = grain_of_planes(image)
    luma = (plain.y[tile.window].mean() - 16.0 * (1 << (bits - 8))) / y_span
    for n, span in enumerate((y_span, c_span, c_span)):
        inner = (slice(51, 251), slice(101, 402)) if n == 0 else (slice(27, 124), slice(52, 199))
        before, after = ((p.y, p.u, p.v)[n][inner].astype(float) for p in (plain, grainy))
        expected = amount * alpha * span * float(grain.at(n, np.array(luma)))
        # both are rounded with the same dither: what they differ by carries up to a step's own noise
        assert np.sqrt((after - before).var() - 1.0 / 6.0) == pytest.approx(expected, rel=tol.GRAIN_ADDED)
        assert (after - before).mean() == pytest.approx(0.0, abs=tol.GRAIN_MEAN_CODES * (1 << (bits - 8)))


def test_nothing_is_added_without_coverage(rng: np.random.Generator) -> None:
    image = noisy(rng, 4.0, 3.0)
    alpha = np.zeros((80, 120))
    alpha[20:40, 30:60] = 1.0
    shadow = grey_tile(alpha, 200, 100, ratio=0.7)
    plain, grainy = laid(image, 0.0, shadow), laid(image, 1.0, shadow)
    differs = plain.y != grainy.y
    assert differs[120:140, 230:260].mean() > 0.5
    differs[120:140, 230:260] = False
    assert not differs.any()
    for before, after in ((plain.u, grainy.u), (plain.v, grainy.v)):
        differs = before != after
        differs[60:70, 115:131] = False  # one more column: its filter reaches into the covered block
        assert not differs.any()
    outside = np.ones(image.y.shape, bool)
    outside[shadow.window] = False
    assert np.array_equal(grainy.y[outside], image.y[outside])


def test_no_grain_is_bit_identical(rng: np.random.Generator) -> None:
    tile = grey_tile(rng.random((80, 120)), 200, 100)
    clean, grainy = noisy(rng, 0.0), noisy(rng, 3.0)
    for image, amount in ((clean, 1.0), (grainy, 0.0)):
        height, width = image.y.shape
        today = frame_of(image).over(Layer(height, width, (tile,))).yuv
        got = laid(image, amount, tile)
        assert today is not None
        for a, b in ((today.y, got.y), (today.u, got.u), (today.v, got.v)):
            assert np.array_equal(a, b)


def test_noise_depends_on_place_and_frame_alone(rng: np.random.Generator) -> None:
    grain = grain_of_planes(noisy(rng, 3.0, 2.0, 0.7))
    whole = grain.noise(0, 5, Rectangle(0, 0, 256, 64), 256)
    part = grain.noise(0, 5, Rectangle(37, 11, 50, 20), 256)
    np.testing.assert_allclose(part, whole[11:31, 37:87], atol=tol.FLOAT32)
    over_seam = grain.noise(0, 5, Rectangle(200, 0, 112, 64), 256)
    np.testing.assert_allclose(over_seam, np.hstack([whole[:, 200:], whole[:, :56]]), atol=tol.FLOAT32)
    big = [grain.noise(p, k, Rectangle(0, 0, 1024, 512), 1024) for p, k in ((0, 5), (0, 6), (1, 5), (0, 5 + 64))]
    for other in big[1:]:
        assert np.mean(big[0] * other) == pytest.approx(0.0, abs=tol.GRAIN_VARIANCE)
    assert neighbours(grain.noise(0, 5, Rectangle(960, 0, 128, 512), 1024)[:, 60:68]) > 0.4  # no edge at the seam


def test_two_tiles_at_the_seam_are_one(rng: np.random.Generator) -> None:
    """The same noise whichever tile a pixel lies in: a tile cut in two gives the same codes."""
    image = noisy(rng, 3.0, 2.0)
    whole = laid(image, 1.0, grey_tile(np.ones((64, 100)), 300, 90), index=3)
    cut = laid(
        image, 1.0, grey_tile(np.ones((64, 40)), 300, 90), grey_tile(np.ones((64, 60)), 340, 90), index=3
    )  # fmt: skip
    assert np.array_equal(whole.y, cut.y)
    assert np.mean(whole.u != cut.u) < 1e-3  # a sample beside the cut is rounded twice


def test_grain_on_rgb_codes(rng: np.random.Generator) -> None:
    """The same through R'G'B': luma grain moves the three channels together."""
    base = np.linspace(0.3, 0.6, 512)[:, None, None] + np.zeros((1, 1024, 3))
    codes = np.round(65535.0 * (base + 0.01 * rng.standard_normal((512, 1024, 1)))).astype(np.uint16)
    frame = VideoFrame(0, 0, Fraction(1, 25), 0.0, 1, ColorSpec(full_range=True, bits=16), rgb=codes)
    tile = grey_tile(np.full((200, 300), 0.8), 600, 100, luma=0.45)
    layer = Layer(512, 1024, (tile,))
    plain, grainy = (frame.over(layer, amount).rgb for amount in (0.0, 1.0))
    assert plain is not None
    assert grainy is not None
    change = (grainy[tile.window].astype(float) - plain[tile.window]) / 65535.0
    assert change.std() == pytest.approx(0.8 * 0.01, rel=tol.GRAIN_ADDED)
    assert (change[..., 0] - change[..., 1]).std() < 0.05 * change.std()
    outside = np.ones((512, 1024), bool)
    outside[tile.window] = False
    assert np.array_equal(grainy[outside], codes[outside])


def test_a_tile_without_coverage_is_returned_as_it_is(rng: np.random.Generator) -> None:
    linear = rng.random((8, 9, 3)).astype(np.float32)
    tile = grey_tile(np.zeros((8, 9)))
    assert add_grain(linear, tile, grain_of_planes(noisy(rng, 3.0)), 1.0, 64, 0) is linear


def test_the_generator_is_white_and_even() -> None:
    noise = np.empty((512, 512), np.float32)
    white_noise(7, 0, -3, 1020, 1024, noise)
    assert noise.mean() == pytest.approx(0.0, abs=tol.GRAIN_VARIANCE)
    assert noise.var() == pytest.approx(1.0, abs=tol.GRAIN_VARIANCE)
    power = np.abs(np.fft.fft2(noise)) ** 2 / noise.size
    blocks = power[1:, 1:][:504, :504].reshape(8, 63, 8, 63).mean((1, 3))
    np.testing.assert_allclose(blocks, 1.0, atol=tol.GRAIN_SPECTRUM)


@pytest.mark.parametrize("light", [0.0, 0.004])
def test_grain_takes_no_more_light_than_there_is(light: float, rng: np.random.Generator) -> None:
    """A dark body under strong grain, luma and chroma, stays in the gamut, and shows no negative light at all."""
    image = noisy(rng, 6.0, 8.0)
    tile = grey_tile(np.ones((128, 128)), 300, 90, luma=0.0)
    tile = replace(tile, radiance=np.full_like(tile.radiance, light) * np.float32([0.1, 1.0, 1.0]))
    dark, bright = (
        frame_of(image).over(Layer(512, 1024, (one,)), 4.0) for one in (tile, grey_tile(np.ones((128, 128)), 300, 90))
    )
    inner = slice(94, 214), slice(304, 424)
    assert bright.image_linear[inner].std() > 0.05
    assert dark.image_linear[inner].min() > tol.GRAIN_BELOW_BLACK
    assert dark.light.min() >= min(float(frame_of(image).image_linear.min()), 0.0) - tol.FLOAT32
