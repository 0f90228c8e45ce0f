# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import av
import numpy as np
import pytest
from av.video.reformatter import Interpolation

from mr360uw.base.color import ColorSpec, code_range, decode, encode, rgb_from_ycbcr
from mr360uw.composite.tiles import empty_tile
from mr360uw.types import Layer, Rectangle, Tile, YuvImage
from mr360uw.video.planes import noise, planes_from_linear
from mr360uw.video.reader import VideoFrame
from mr360uw.yuv.decoding import linear_from_planes
from tests.video.clips import SIZE, SPECS, fill, yuv_image
from tests.video.tolerances import (
    VIDEO_CURVE_TABLE,
    VIDEO_DITHER_MEAN,
    VIDEO_OPAQUE_CODES,
    VIDEO_PQ_SATURATED,
    VIDEO_SEAM_CODES,
    VIDEO_SWSCALE,
    VIDEO_WIDE_TABLE,
)


def frame_of(image: YuvImage, index: int = 0, wrap: bool = True) -> VideoFrame:
    return VideoFrame(index, index, Fraction(1, 25), index / 25, 1, image.spec, yuv=image, wrap=wrap)


def tile_of(column, row, radiance, alpha, ratio=1.0, veil=0.0) -> Tile:
    h, w = alpha.shape
    full = np.ones((h, w, 3), np.float32)
    light = np.asarray(radiance, np.float32) * full
    return Tile(column, row, light, alpha.astype(np.float32), np.ones((h, w)), full * ratio, full * veil)


def over(image: YuvImage, *tiles: Tile, index: int = 0) -> YuvImage:
    height, width = image.y.shape
    result = frame_of(image, index).over(Layer(height, width, tiles)).yuv
    assert result is not None
    return result


# Chromaticities (x, y) of R, G, B: ITU-R BT.709-6 and BT.2020-2; white D65.
REC709 = np.array([(0.640, 0.330), (0.300, 0.600), (0.150, 0.060)])
REC2020 = np.array([(0.708, 0.292), (0.170, 0.797), (0.131, 0.046)])
D65 = np.array((0.3127, 0.3290))


def xyz_from_rgb(primaries):
    columns = np.stack([primaries[:, 0], primaries[:, 1], 1 - primaries.sum(1)]) / primaries[:, 1]
    white = np.array([D65[0], D65[1], 1 - D65.sum()]) / D65[1]
    return columns * np.linalg.solve(columns, white)


@pytest.mark.parametrize("spec", SPECS, ids=str)
def test_flat_colours_follow_the_standard(spec: ColorSpec, rng) -> None:
    """One colour over the whole frame needs no interpolation: the matrix and the curve remain."""
    y_offset, y_span, c_offset, c_span = code_range(spec)
    for luma, cb, cr in rng.uniform([0.1, -0.2, -0.2], [0.9, 0.2, 0.2], (20, 3)):
        y, u, v = round(y_offset + y_span * luma), round(c_offset + c_span * cb), round(c_offset + c_span * cr)
        dtype = np.uint8 if spec.bits == 8 else np.uint16
        image = YuvImage(np.full((4, 8), y, dtype), np.full((2, 4), u, dtype), np.full((2, 4), v, dtype), spec)
        ycbcr = np.array([(y - y_offset) / y_span, (u - c_offset) / c_span, (v - c_offset) / c_span])
        expected = decode(rgb_from_ycbcr(spec.matrix) @ ycbcr, spec.transfer)
        if spec.matrix == "bt2020":
            expected = np.linalg.solve(xyz_from_rgb(REC709), xyz_from_rgb(REC2020) @ expected)
        np.testing.assert_allclose(
            linear_from_planes(image)[1, 3], expected, atol=VIDEO_CURVE_TABLE, rtol=VIDEO_WIDE_TABLE * spec.is_wide
        )


@pytest.mark.parametrize(("matrix", "number"), [("bt709", 1), ("bt601", 6)])
@pytest.mark.parametrize("full_range", [False, True])
def test_reading_agrees_with_swscale(matrix, number, full_range) -> None:
    """FFmpeg's accurate conversion is an independent path to the same R'G'B'."""
    image = yuv_image(3, ColorSpec(matrix, full_range))
    native = av.VideoFrame(*SIZE, "yuvj420p" if full_range else "yuv420p")
    fill(native, (image.y, image.u, image.v))
    native.colorspace, native.color_range = number, 2 if full_range else 1
    flags = Interpolation.BILINEAR | Interpolation.ACCURATE_RND | Interpolation.FULL_CHR_H_INT
    theirs = native.reformat(format="rgb24", interpolation=flags).to_ndarray()
    ours = np.clip(encode(linear_from_planes(image), "srgb"), 0, 1) * 255
    inner = (slice(4, -4), slice(4, -4))  # swscale neither wraps nor pads as we do
    assert np.abs(ours - theirs)[inner].max() < VIDEO_SWSCALE


@pytest.mark.parametrize("spec", SPECS, ids=str)
@pytest.mark.parametrize("subsampling", ["420", "422", "444"])
def test_laying_the_plate_over_itself_changes_no_code(spec: ColorSpec, subsampling) -> None:
    image = yuv_image(1, spec, subsampling)
    h, w = 21, 33
    plate = linear_from_planes(image, Rectangle(11, 7, w, h))
    tile = tile_of(11, 7, plate * 0.5, np.zeros((h, w)), ratio=0.5)  # half of it as an object's, half as the plate's
    same = over(image, tile, index=5)
    for name in "yuv":
        # a dark channel of a bright saturated colour has fewer digits in Rec.709 than PQ has codes for it
        lost = np.mean(getattr(same, name) != getattr(image, name))
        assert lost <= (VIDEO_PQ_SATURATED if spec.transfer == "pq" else 0.0), name


@pytest.mark.parametrize("subsampling", ["420", "422", "444"])
def test_only_touched_blocks_change(subsampling, rng) -> None:
    image = yuv_image(2, ColorSpec(), subsampling)
    h, w = 31, 45
    alpha = (rng.random((h, w)) < 0.1).astype(float)
    touched = np.zeros(image.y.shape, bool)
    touched[9 : 9 + h, 13 : 13 + w] = alpha > 0
    new = over(image, tile_of(13, 9, alpha[..., None] * [0.7, 0.1, 0.1], alpha))
    np.testing.assert_array_equal(new.y[~touched], image.y[~touched])
    assert (new.y[touched] != image.y[touched]).mean() > 0.9
    step_y, step_x = image.y.shape[0] // image.u.shape[0], image.y.shape[1] // image.u.shape[1]
    blocks = touched.reshape(image.u.shape[0], step_y, image.u.shape[1], step_x).any((1, 3))
    for name in "uv":
        np.testing.assert_array_equal(getattr(new, name)[~blocks], getattr(image, name)[~blocks])
        assert (getattr(new, name)[blocks] != getattr(image, name)[blocks]).mean() > 0.9


def test_the_plate_itself_is_left_alone() -> None:
    image = yuv_image()
    before = image.y.copy(), image.u.copy(), image.v.copy()
    over(image, tile_of(0, 0, 0.3, np.ones((64, 128))))
    for plane, copy in zip((image.y, image.u, image.v), before, strict=True):
        np.testing.assert_array_equal(plane, copy)


@pytest.mark.parametrize(
    "spec", [ColorSpec(), ColorSpec("bt709", True), ColorSpec("bt709", False, "srgb", 10)], ids=str
)
def test_an_opaque_object_hides_a_busy_plate(spec: ColorSpec, rng) -> None:
    """Not a trace of the plate's chroma detail shines through."""
    noisy = yuv_image(0, spec)
    scale = 1 << (spec.bits - 8)
    noise = rng.integers(40, 216, (2, *noisy.u.shape)) * scale
    image = replace(noisy, u=noise[0].astype(noisy.u.dtype), v=noise[1].astype(noisy.u.dtype))
    colour = np.array([0.2, 0.5, 0.35])
    new = over(image, tile_of(20, 10, colour, np.ones((40, 60))))
    inside = (slice(7, 23), slice(12, 38))
    reference = over(replace(image, u=np.full_like(image.u, 128 * scale), v=np.full_like(image.v, 128 * scale)),
                     tile_of(20, 10, colour, np.ones((40, 60))))  # fmt: skip
    for name in "uv":
        difference = np.abs(getattr(new, name)[inside].astype(int) - getattr(reference, name)[inside])
        assert difference.max() <= VIDEO_OPAQUE_CODES
    mean = linear_from_planes(new)[15:45, 25:75].mean((0, 1))
    np.testing.assert_allclose(mean, colour, rtol=VIDEO_DITHER_MEAN)


def test_a_shadow_scales_the_light_of_the_plate() -> None:
    """Half the light, in linear light and not in code values."""
    image = yuv_image(1, ColorSpec(bits=10))
    new = over(image, tile_of(0, 0, 0.0, np.zeros((64, 128)), ratio=0.5))
    before, after = linear_from_planes(image), linear_from_planes(new)
    np.testing.assert_allclose(after.mean((0, 1)), 0.5 * before.mean((0, 1)), rtol=VIDEO_DITHER_MEAN)


def test_the_veil_takes_no_shadow() -> None:
    image = yuv_image(1, ColorSpec(bits=10))
    plate = linear_from_planes(image)
    new = over(image, Tile(0, 0, np.zeros_like(plate), np.zeros((64, 128)), np.ones((64, 128)),
                           np.zeros_like(plate), plate))  # fmt: skip
    np.testing.assert_array_equal(new.y, image.y)


def test_dither_keeps_the_mean_between_two_codes() -> None:
    """Without dither a slow gradient of light would stay on one code over many pixels: banding."""
    spec = ColorSpec()
    black = YuvImage(*(np.full(s, c, np.uint8) for s, c in (((64, 128), 16), ((32, 64), 128), ((32, 64), 128))), spec)
    for share in (0.1, 0.5, 0.8):
        light = decode(np.full((64, 128, 3), (100 + share) / 219), "srgb")
        codes = [over(black, tile_of(0, 0, light, np.ones((64, 128))), index=n).y for n in range(4)]
        assert set(np.unique(codes)) == {116, 117}
        assert np.mean(codes) - 116 == pytest.approx(share, abs=VIDEO_DITHER_MEAN)
        assert not np.array_equal(codes[0], codes[1])
    again = over(black, tile_of(0, 0, light, np.ones((64, 128))), index=3).y
    np.testing.assert_array_equal(codes[3], again)


def test_light_above_one_is_clipped_to_the_top_code() -> None:
    new = over(yuv_image(), tile_of(10, 10, 7.0, np.ones((20, 20))))
    assert (new.y[10:30, 10:30] == 235).all()
    assert (new.u[6:14, 6:14] == 128).all()


def test_the_seam_is_an_ordinary_place() -> None:
    """Rolling the planes rolls the light: interpolation goes round."""
    image = yuv_image(4)
    rolled = YuvImage(np.roll(image.y, 64, 1), np.roll(image.u, 32, 1), np.roll(image.v, 32, 1), image.spec)
    np.testing.assert_array_equal(np.roll(linear_from_planes(image), 64, 1), linear_from_planes(rolled))


def test_a_rectangle_is_part_of_the_whole() -> None:
    image = yuv_image(5)
    np.testing.assert_array_equal(
        linear_from_planes(image, Rectangle(7, 11, 121, 20)), linear_from_planes(image)[11:31, 7:128]
    )


def test_planes_of_a_picture_give_it_back() -> None:
    image = yuv_image(6, ColorSpec(bits=10), "444")
    light = np.clip(linear_from_planes(image), 0, 1)
    planes = YuvImage(np.zeros_like(image.y), np.zeros_like(image.u), np.zeros_like(image.v), image.spec)
    planes_from_linear(light, planes)
    legal = ((linear_from_planes(image) >= 0) & (linear_from_planes(image) <= 1)).all(-1)
    assert legal.mean() > 0.5
    assert np.abs(planes.y.astype(int) - image.y)[legal].max() <= 1


@pytest.mark.parametrize("split", [30, 31])
@pytest.mark.parametrize("subsampling", ["420", "422", "444"])
def test_an_object_in_two_tiles_has_no_seam(split, subsampling) -> None:
    image = yuv_image(2, ColorSpec(), subsampling)
    colour = np.array([0.6, 0.1, 0.05])
    one = over(image, tile_of(20, 10, colour, np.ones((30, 40))))
    left, right = np.ones((30, split - 20)), np.ones((30, 60 - split))
    two = over(image, tile_of(20, 10, colour, left), tile_of(split, 10, colour, right))
    np.testing.assert_array_equal(one.y, two.y)
    for name in "uv":
        difference = np.abs(getattr(one, name).astype(int) - getattr(two, name))
        assert difference.max() <= VIDEO_OPAQUE_CODES


def test_an_object_across_the_edge_of_the_frame_has_no_seam() -> None:
    """The same object in the middle of a rolled plate."""
    wave = np.round(128 + 40 * np.sin(2 * np.pi * np.arange(64) / 64) + np.zeros((32, 1))).astype(np.uint8)
    image = replace(yuv_image(2), u=wave, v=wave[:, ::-1].copy())
    rolled = YuvImage(np.roll(image.y, 64, 1), np.roll(image.u, 32, 1), np.roll(image.v, 32, 1), image.spec)
    colour = np.array([0.6, 0.1, 0.05])
    ends = over(image, tile_of(0, 10, colour, np.ones((30, 20))), tile_of(108, 10, colour, np.ones((30, 20))))
    middle = over(rolled, tile_of(44, 10, colour, np.ones((30, 40))))
    for name, shift in (("u", 32), ("v", 32), ("y", 64)):
        difference = np.abs(np.roll(getattr(ends, name), shift, 1).astype(int) - getattr(middle, name))
        assert difference.max() <= VIDEO_SEAM_CODES
        assert (difference > 0).mean() < 0.2


def test_a_flat_picture_is_flat_to_its_edges() -> None:
    planes = yuv_image()
    planes_from_linear(np.full((64, 128, 3), [0.01, 0.06, 0.12]), planes)
    for plane in (planes.y, planes.u, planes.v):
        assert np.ptp(plane) <= VIDEO_OPAQUE_CODES


def test_the_dither_of_a_part_is_that_of_the_whole() -> None:
    whole = noise(64, 96, 0, 0, 5)
    np.testing.assert_array_equal(noise(20, 30, 11, 37, 5), whole[11:31, 37:67])
    assert 0.0 < whole.min() < 0.05
    assert 0.95 < whole.max() < 1.0
    assert not np.array_equal(noise(64, 96, 0, 0, 6), whole)


def test_shafts_alone_change_the_codes() -> None:
    """Light in the water in front of the plate, with neither coverage nor shadow."""
    image = yuv_image()
    frame = frame_of(image)
    height, width = frame.shape
    tile = replace(empty_tile(Rectangle(16, 8, 32, 16)), shafts=np.full((16, 32, 3), 0.05, np.float32))
    changed = frame.over(Layer(height, width, (tile,)))
    assert changed.yuv is not None
    brighter = changed.yuv.y.astype(int) - image.y
    assert np.all(brighter[tile.window] > 0)
    brighter[tile.window] = 0
    assert not brighter.any()


@pytest.mark.parametrize("columns", [32, 24])
def test_a_halved_part_is_the_mean_of_its_pixels(columns: int) -> None:
    """As light, but for the rounding of the mean code; chroma lies where the pixels' does."""
    height, width = 64, 128
    x, y = (np.arange(width) + 0.5) / width, ((np.arange(height) + 0.5) / height)[:, None]
    wave = 0.5 + 0.3 * np.sin(2.0 * np.pi * x) * np.cos(np.pi * y)
    light = np.stack([wave, 0.7 * wave + 0.1, 0.6 - 0.4 * wave], axis=-1)
    image = YuvImage(*(np.zeros((height >> k, width >> k), np.uint8) for k in (0, 1, 1)), ColorSpec())
    planes_from_linear(light.astype(np.float32), image)
    frame = frame_of(image)
    part = Rectangle(16, 8, columns, 20)
    whole = frame.linear(part)
    mean = 0.25 * (whole[::2, ::2] + whole[1::2, ::2] + whole[::2, 1::2] + whole[1::2, 1::2])
    np.testing.assert_allclose(frame.halved(part), mean, atol=0.012)  # a code of luma, two of chroma, by rounding
