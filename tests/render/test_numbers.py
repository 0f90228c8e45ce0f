# SPDX-License-Identifier: Apache-2.0
"""Frames stay finite and without negative light at the ends of the parameters' ranges, and say where they do not."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mr360uw as uw
from mr360uw.base.color import ColorSpec, Transfer, in_plate_primaries
from mr360uw.composite.tiles import empty_tile, over
from mr360uw.errors import RenderError
from mr360uw.medium import Medium, Water, fit_gain
from mr360uw.medium.lookup import veil_lookup
from mr360uw.medium.medium import MediumAtDepths
from mr360uw.render.frame import finite, finite_layer
from mr360uw.types import Layer, Rectangle, Tile, YuvImage
from mr360uw.video import VideoFrame
from tests.medium.tolerances import TABLE_SHALLOW
from tests.scenes import scene_with

BACKENDS = ["reference", "gl"]


@pytest.mark.parametrize("depth_m", [120.0, 200.0])
@pytest.mark.parametrize("name", ["7C", "9C"])
def test_deep_murky_water_has_a_veil(name: str, depth_m: float) -> None:
    plate = np.full((32, 64, 3), [0.02, 0.1, 0.05])
    medium = Medium(Water.jerlov(name), camera_depth_m=depth_m)
    gain, _ = fit_gain(medium, plate)
    assert np.all(np.isfinite(gain) & (gain > 0.0))
    for fitted in (medium.scaled(gain), MediumAtDepths(medium).at(depth_m).scaled(gain)):
        assert fitted.table.veil.dtype == np.float32
        np.testing.assert_allclose(veil_lookup(fitted.table, 1e6, 0.0), [0.02, 0.1, 0.05], rtol=0.05)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("height_m", [-1.0, 4.9, 9.0, 60.0])
def test_a_low_sun_and_bodies_above_the_surface(tmp_path: Path, whale: Path, backend: str, height_m: float) -> None:
    # within the water no sun is lower than 42 degrees: one degree is the path of 300 m through 9C
    scene = scene_with(
        tmp_path, None, water={"type": "9C"}, light={"sun": "given", "sun_elevation_deg": 1.0},
        object=[{"mesh": str(whale), "position_m": [0.0, height_m, -2.0]}], receiver={"height_m": -2.0},
    )  # fmt: skip
    rng = np.random.default_rng(1)
    plate = rng.uniform(0.0, 1.0, (64, 128, 3)).astype(np.float32)
    image = uw.render_frame(plate, scene, backend=backend).image_linear
    assert np.all(np.isfinite(image))
    assert np.min(image) >= 0.0


def test_tables_near_the_horizon_of_a_shallow_camera() -> None:
    medium = Medium(Water.jerlov("IB"), camera_depth_m=0.3)
    rng = np.random.default_rng(0)
    up = np.exp(rng.uniform(np.log(1e-3), np.log(0.2), 2000))
    s = np.minimum(np.exp(rng.uniform(np.log(0.05), np.log(300.0), 2000)), 0.3 / up)
    veil = medium.veil(s, 0.3, up)
    error = np.abs(veil_lookup(medium.table, s, up) - veil).max(axis=-1) / veil.max(axis=-1)
    assert error.max() < TABLE_SHALLOW


@pytest.mark.parametrize("seed", range(6))
def test_grain_makes_no_light_negative(tmp_path: Path, whale: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    plate = rng.uniform(0.0, 0.2, (64, 128, 3)).astype(np.float32) ** 2
    scene = scene_with(
        tmp_path, None, water={"type": "9C"}, draw={"grain": 1.0},
        object=[{"mesh": str(whale), "position_m": [0.0, 0.0, -2.5]}],
    )  # fmt: skip
    assert np.min(uw.render_frame(plate, scene, backend="reference", index=seed).image_linear) >= 0.0


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("transfer", ["pq", "hlg"])
def test_an_hdr_frame_has_no_negative_light_but_its_own(
    tmp_path: Path, whale: Path, backend: str, transfer: Transfer
) -> None:
    """Random codes of BT.2020, outside Rec.709 and below black too, under a body and its shadow."""
    spec = ColorSpec("bt2020", False, transfer, 10)
    rng = np.random.default_rng(3)
    y, u, v = (rng.integers(0, 1 << spec.bits, shape, np.uint16) for shape in ((64, 128), (32, 64), (32, 64)))
    plate = VideoFrame(5, 5, Fraction(1, 25), 0.2, 1, spec, yuv=YuvImage(y, u, v, spec))
    scene = scene_with(
        tmp_path, None, water={"type": "IB"}, receiver={"height_m": -2.0},
        object=[{"mesh": str(whale), "position_m": [0.0, -0.5, -2.5]}],
    )  # fmt: skip
    layer, own = uw.render_frame(plate.image_linear, scene, backend=backend).layer, plate.image_linear
    light, shown = over(own, layer), plate.over(layer).light
    assert np.mean(own < 0.0) > 0.1
    assert not np.array_equal(light, own)
    as_plate = [in_plate_primaries(one, spec) for one in (light, shown, own)]
    for found, before in ((light, own), *((one, as_plate[-1]) for one in as_plate[:2])):
        assert np.min(found - np.minimum(before, 0.0)) >= -1e-6 * np.abs(before).max()


@pytest.mark.parametrize("value", [np.inf, np.nan])
@pytest.mark.parametrize("matrix", ["bt709", "bt2020", None])
def test_a_layer_that_is_not_finite_is_not_written(matrix: Any, value: float) -> None:
    """Whether rows are laid over planes at once, or over light in other primaries, or over a picture."""
    planes = (np.full((8 >> k, 16 >> k), 90, np.uint16) for k in (0, 1, 1))
    frame = VideoFrame.of_linear(np.full((8, 16, 3), 0.2, np.float32), 3)
    if matrix is not None:
        spec = ColorSpec(matrix, False, "bt709", 10)
        frame = VideoFrame(3, 3, Fraction(1, 25), 0.12, 1, spec, yuv=YuvImage(*planes, spec))
    tile = empty_tile(Rectangle(4, 2, 6, 4))
    tile.alpha[1, 2], tile.radiance[1, 2] = 0.5, 0.1
    assert frame.over(Layer(8, 16, (tile,)), 0.0, finite_layer).plate is (frame if matrix else None)
    tile.radiance[1, 2, 0] = value
    with pytest.raises(RenderError, match=r"frame 3 - the layer .* 1 of 72 in radiance"):
        frame.over(Layer(8, 16, (tile,)), 0.0, finite_layer)


def test_the_stage_is_named() -> None:
    tile = empty_tile(Rectangle(0, 0, 4, 4))
    finite("layer", 3, Layer(4, 8, (tile,)))
    for name in ("radiance", "ratio", "veil"):
        values: Any = getattr(tile, name).copy()
        values[1, 2, 0] = np.nan
        broken: Tile = replace(tile, **{name: values})
        with pytest.raises(RenderError, match=f"frame 3 - the layer .* 1 of 48 in {name}"):
            finite("layer", 3, broken)
    huge = np.full((2, 2, 3), 3e38, np.float32)  # whose sum is infinite
    finite("layer", 3, replace(tile, radiance=huge))
