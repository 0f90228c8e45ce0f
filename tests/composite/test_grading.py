# SPDX-License-Identifier: Apache-2.0
"""The plate's look: what is found in pictures of known blur, and what bodies are given."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from mr360uw.composite.grading.settings import MatchSettings, PlateGrade
from mr360uw.composite.grading.softness import matched_layer, point_spread
from mr360uw.composite.tiles import empty_tile, over
from mr360uw.types import Floats, Layer, Rectangle
from tests.composite import tolerances as tol


def texture(seed: int = 1, height: int = 256) -> Floats:
    """Return luma (H, 2 H) in 8-bit codes whose power falls as f^-2, box-filtered over pixels, partly flat."""
    rng = np.random.default_rng(seed)
    down, along = np.fft.fftfreq(2 * height)[:, None], np.fft.rfftfreq(4 * height)
    fall = 1.0 / np.maximum(np.hypot(down, along), 1e-3)
    large = np.fft.irfft2(np.fft.rfft2(rng.standard_normal((2 * height, 4 * height))) * fall)
    small = cv2.resize(large, (2 * height, height), interpolation=cv2.INTER_AREA)
    small *= 20.0 / small.std()
    small[:, : 2 * height // 3] = 0.0
    return 120.4 + small


def coded(luma: Floats, seed: int = 2) -> Floats:
    return np.clip(np.floor(luma + np.random.default_rng(seed).random(luma.shape)), 0.0, 255.0)


def test_a_sharp_picture_a_flat_one_and_a_small_one_show_nothing() -> None:
    sharp = coded(texture())
    assert point_spread([sharp]) == PlateGrade()
    assert point_spread([coded(np.full((256, 512), 90.5))]) == PlateGrade()
    assert point_spread([np.full((256, 512), 90.0)]) == PlateGrade()
    assert point_spread([sharp[:32, :64]]) == point_spread([]) == PlateGrade()


@pytest.mark.parametrize("deviation_px", [0.8, 1.0, 1.5])
def test_blur_is_found(deviation_px: float) -> None:
    found = point_spread([coded(cv2.GaussianBlur(texture(), (0, 0), deviation_px))])
    assert found.softness_px == pytest.approx(deviation_px, rel=tol.BLUR_FOUND)


def test_blur_is_found_under_grain_but_not_where_grain_hides_the_detail() -> None:
    grain = cv2.GaussianBlur(np.random.default_rng(3).standard_normal((256, 512)), (0, 0), 0.6)
    grain /= grain.std()
    soft = cv2.GaussianBlur(texture(), (0, 0), 1.0)
    assert point_spread([coded(soft + 0.5 * grain)]).softness_px == pytest.approx(1.0, rel=tol.BLUR_FOUND)
    assert point_spread([coded(soft + 8.0 * grain)]) == PlateGrade()


def test_numbers_stand_in_place_of_the_plate() -> None:
    found = PlateGrade(1.2, columns=1000)
    assert found.of_scene(MatchSettings(), 1000) == found
    by_hand = MatchSettings(softness=2.0, sharpening=0.5)
    assert found.of_scene(MatchSettings(sharpening=0.5), 500, 0.5) == PlateGrade(0.6, 0.5, 0.5, 500)
    assert found.of_scene(by_hand, 500, 0.5) == PlateGrade(1.0, 0.5, 0.5, 500)
    assert not found.of_scene(MatchSettings(softness=0.0), 1000).changes
    plain = MatchSettings(softness=0.0)
    assert not plain.changes
    assert not plain.measures
    assert MatchSettings().measures
    assert MatchSettings().measures


def disc(column: int, width: int = 64, height: int = 32) -> Layer:
    """Return a layer with a bright square of 8 pixels about a column of row 16, in pieces at the seam."""
    tiles = []
    for start in range(column - 4, column + 4):
        tile = empty_tile(Rectangle(start % width, 12, 1, 8))
        ratio = np.full_like(tile.ratio, 0.5)
        tiles.append(replace(tile, alpha=tile.alpha + 1, radiance=tile.radiance + np.float32(0.8), ratio=ratio))
    return Layer(height, width, tuple(tiles))


def plate(part: Rectangle) -> Floats:
    return np.full((part.height, part.width, 3), 0.2, np.float32)


def test_a_body_is_blurred_and_nothing_else() -> None:
    layer = disc(32)
    soft = matched_layer(layer, PlateGrade(softness_px=1.0), plate)
    expected = cv2.GaussianBlur(layer.alpha, (9, 9), 1.0)
    np.testing.assert_allclose(soft.alpha, np.where(expected < 1e-4, 0.0, expected), atol=tol.FLOAT32)
    np.testing.assert_allclose(soft.radiance, 0.8 * soft.alpha[..., None].repeat(3, -1), atol=tol.FLOAT32)
    np.testing.assert_array_equal(soft.ratio, layer.ratio)
    assert matched_layer(layer, PlateGrade(), plate) is layer
    assert matched_layer(Layer(32, 64, ()), PlateGrade(1.0), plate).tiles == ()


@pytest.mark.parametrize("grade", [PlateGrade(softness_px=1.3), PlateGrade(0.8, 0.7)])
def test_a_body_over_the_seam_is_as_one_in_the_middle(grade: PlateGrade) -> None:
    middle, seam = (matched_layer(disc(column), grade, plate) for column in (32, 0))
    for name in ("alpha", "radiance", "ratio"):
        np.testing.assert_allclose(
            np.roll(getattr(seam, name), 32, axis=1), getattr(middle, name), atol=tol.FLOAT32, err_msg=name
        )


@pytest.mark.parametrize("ratio", [1.0, 0.1])
def test_a_mask_takes_no_more_light_than_shines_through(ratio: float) -> None:
    """A black body, sharpened, before a bright plate in shadow: layer and composite have no negative light."""
    layer = disc(32)
    layer = replace(
        layer,
        tiles=tuple(replace(t, radiance=0.0 * t.radiance, ratio=np.full_like(t.ratio, ratio)) for t in layer.tiles),
    )
    matched = matched_layer(layer, PlateGrade(softness_px=1.0, sharpening=3.0), plate)
    assert min(float(tile.radiance.min()) for tile in matched.tiles) >= 0.0
    assert max(float(tile.alpha.max()) for tile in matched.tiles) <= 1.0
    assert over(plate(Rectangle(0, 0, 64, 32)), matched).min() >= 0.0


def test_a_mask_overshoots_as_that_of_the_whole_picture() -> None:
    layer, grade = disc(32), PlateGrade(softness_px=1.0, sharpening=0.6)
    layer = replace(layer, tiles=tuple(replace(t, ratio=np.ones_like(t.ratio)) for t in layer.tiles))
    whole = plate(Rectangle(0, 0, 64, 32))
    soft = over(whole, matched_layer(layer, replace(grade, sharpening=0.0), plate))
    expected = soft + 0.6 * (soft - cv2.GaussianBlur(soft, (9, 9), 1.0))
    matched = matched_layer(layer, grade, plate)
    found = over(whole, matched)
    body = matched.alpha > 0.0
    np.testing.assert_allclose(found[body], expected[body], atol=tol.MASK_AT_EDGE)
    assert found.max() > 0.81 > soft.max()
    np.testing.assert_array_equal(found[~body], whole[~body])
