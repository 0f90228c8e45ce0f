# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mr360uw.base.color import ColorSpec, in_plate_primaries, in_rec709
from mr360uw.composite.tiles import empty_tile, hold_out, mean_layer, over, over_tile
from mr360uw.errors import ParameterError
from mr360uw.types import Layer, Rectangle, Tile
from tests.composite import tolerances as tol
from tests.composite.scenes import shot


def random_tile(rng: np.random.Generator, height: int = 6, width: int = 8) -> Tile:
    tile = empty_tile(Rectangle(4, 2, width, height))
    alpha = rng.uniform(0, 1, (height, width)).astype(np.float32)
    return replace(
        tile,
        alpha=alpha,
        radiance=(alpha[..., None] * rng.uniform(0, 1, (height, width, 3))).astype(np.float32),
        ratio=rng.uniform(0.2, 1.2, (height, width, 3)).astype(np.float32),
        veil=rng.uniform(0, 0.2, (height, width, 3)).astype(np.float32),
    )


def test_outside_the_tiles_and_under_empty_ones_the_plate_is_bit_identical(rng: np.random.Generator) -> None:
    plate = rng.uniform(0, 1, (16, 32, 3)).astype(np.float32)
    veiled = replace(empty_tile(Rectangle(20, 4, 8, 6)), veil=rng.uniform(0, 1, (6, 8, 3)).astype(np.float32))
    layer = Layer(16, 32, (random_tile(rng), veiled))
    image = over(plate, layer)
    outside = np.ones((16, 32), bool)
    outside[layer.tiles[0].window] = False
    assert np.array_equal(image[outside], plate[outside])
    assert not np.array_equal(image, plate)


def test_haze_is_not_shadowed(rng: np.random.Generator) -> None:
    tile = replace(random_tile(rng), alpha=np.zeros((6, 8), np.float32), radiance=np.zeros((6, 8, 3), np.float32))
    np.testing.assert_allclose(over_tile(tile.veil, tile), tile.veil, atol=tol.FLOAT32)
    darker = 0.5 * tile.veil  # a plate below its veil has no surface part that could be shadowed
    np.testing.assert_allclose(over_tile(darker, tile), darker, atol=tol.FLOAT32)


def test_over_is_linear_in_the_layer_and_opaque_objects_hide_the_plate(rng: np.random.Generator) -> None:
    tile = random_tile(rng)
    opaque = replace(tile, alpha=np.ones_like(tile.alpha))
    assert np.array_equal(over_tile(rng.uniform(0, 1, (6, 8, 3)).astype(np.float32), opaque), tile.radiance)


def test_sizes_must_agree() -> None:
    with pytest.raises(ParameterError, match="as large as the layer"):
        over(np.zeros((8, 16, 3), np.float32), Layer(16, 32, ()))


def test_the_mean_of_sub_frames_moves_energy_and_keeps_it(rng: np.random.Generator) -> None:
    first = random_tile(rng)
    second = replace(first, column=10)
    blurred = mean_layer([Layer(16, 32, (first,)), Layer(16, 32, (second,))])
    np.testing.assert_allclose(blurred.alpha.sum(), first.alpha.sum(), rtol=tol.FLOAT32)
    np.testing.assert_allclose(blurred.radiance.sum(), first.radiance.sum(), rtol=tol.FLOAT32)
    assert np.array_equal(mean_layer([Layer(16, 32, (first,))] * 2).alpha, Layer(16, 32, (first,)).alpha)
    far, near = (replace(first, distance_m=np.full_like(first.alpha, metres)) for metres in (3.0, 2.0))
    nearest = mean_layer([Layer(16, 32, (far,)), Layer(16, 32, (near,))])
    assert np.array_equal(nearest.distance_m, Layer(16, 32, (near,)).distance_m)


def test_shafts_are_added_to_the_plate_and_never_make_it_negative(rng: np.random.Generator) -> None:
    """L' = layer + (1 - alpha)(veil + (plate - veil) ratio + shafts), clamped at zero behind the layer."""
    plate = rng.uniform(0.2, 1.0, (16, 32, 3)).astype(np.float32)
    tile = random_tile(rng)
    shafts = rng.uniform(-0.15, 0.15, tile.ratio.shape).astype(np.float32)
    here = plate[tile.window]
    background = np.minimum(tile.veil, here) + (here - np.minimum(tile.veil, here)) * tile.ratio + shafts
    expected = tile.radiance + (1.0 - tile.alpha[..., None]) * np.maximum(background, 0.0)
    np.testing.assert_allclose(over_tile(here, replace(tile, shafts=shafts)), expected, atol=tol.FLOAT32)
    dark = replace(empty_tile(tile.rectangle), shafts=np.full_like(shafts, -2.0))
    assert over_tile(here, dark).max() == 0.0
    none = replace(tile, shafts=np.zeros_like(shafts))
    assert np.array_equal(over_tile(here, none), over_tile(here, tile))


HDR = [ColorSpec("bt2020", False, name, 10) for name in ("hlg", "pq")]


@pytest.mark.parametrize("spec", HDR, ids=str)
@pytest.mark.parametrize("with_shafts", [False, True])
def test_light_is_negative_only_where_the_plate_is(
    spec: ColorSpec, with_shafts: bool, rng: np.random.Generator
) -> None:
    """In Rec.709, where saturated colours of BT.2020 are negative; and in BT.2020, where a plate's codes may be."""
    own = rng.uniform(-0.02, 1.0, (60, 80, 3)).astype(np.float32) ** 3
    plate = in_rec709(own, spec)
    assert np.mean(plate < 0.0) > 0.1
    shafts = rng.uniform(-0.2, 0.2, own.shape).astype(np.float32) if with_shafts else None
    tile = replace(random_tile(rng, *own.shape[:2]), shafts=shafts)
    image = over_tile(plate, tile)
    for found, before in ((image, plate), (in_plate_primaries(image, spec), in_plate_primaries(plate, spec))):
        assert np.all(found >= np.minimum(before, 0.0) - tol.FLOAT32)


def test_a_saturated_colour_in_shadow_keeps_its_hue() -> None:
    """Cyan of BT.2020, whose red is negative in Rec.709: a quarter of its light is a quarter of each channel."""
    plate = np.broadcast_to(in_rec709(np.float32([0.0, 0.6, 0.5]), HDR[0]), (6, 8, 3)).copy()
    assert plate.min() < -0.1
    tile = replace(empty_tile(Rectangle(4, 2, 8, 6)), ratio=np.full((6, 8, 3), 0.25, np.float32))
    np.testing.assert_allclose(over_tile(plate, tile), 0.25 * plate, rtol=tol.FLOAT32)


def test_shafts_pass_blur_and_mattes(rng: np.random.Generator) -> None:
    tile = replace(random_tile(rng), shafts=np.full((6, 8, 3), 0.1, np.float32))
    layers = [Layer(16, 32, (tile,)), Layer(16, 32, (replace(tile, shafts=None),))]
    np.testing.assert_allclose(mean_layer(layers).shafts[tile.window], 0.05, rtol=tol.FLOAT32)
    matte = np.full((16, 32), 0.25)
    held = hold_out(shot(width=32, holdout=matte), tile)
    assert held.shafts is not None
    np.testing.assert_allclose(held.shafts, 0.075, rtol=tol.FLOAT32)
