# SPDX-License-Identifier: Apache-2.0
"""Blending on the device against the processor's, code by code, and when it is used."""

from __future__ import annotations

import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mr360uw as uw
from mr360uw.color import ColorSpec
from mr360uw.composite.gl.plate_pass import PlatePass, plate_pass
from mr360uw.composite.over import over_tile
from mr360uw.gl.context import gl_device
from mr360uw.reading.disk_cache import FOLDER
from mr360uw.render import blend_trial
from mr360uw.render.backends import make_backend
from mr360uw.render.blend_trial import EQUAL, random_layer, random_plate
from mr360uw.sample import SampleDive
from mr360uw.scene.model import load_scene
from mr360uw.types import Layer, YuvImage
from mr360uw.video import VideoFrame
from mr360uw.video.pixels.planes import changed_pixels
from tests.video.clips import SIZE, SPECS, yuv_image

pytestmark = pytest.mark.usefixtures("gl")


def planes_of(frame: VideoFrame) -> list[np.ndarray]:
    image = frame.yuv
    assert image is not None
    return [plane.astype(np.int64) for plane in (image.y, image.u, image.v)]


def on_device(plate: VideoFrame, layer: Layer, grain: float = 0.0) -> VideoFrame:
    return plate.over(layer, over_tile, grain, plate_pass().over)


def check_agree(found: VideoFrame, expected: VideoFrame) -> None:
    for a, b in zip(planes_of(found), planes_of(expected), strict=True):
        assert np.abs(a - b).max() <= 1
        assert np.mean(a == b) >= EQUAL


@pytest.mark.parametrize("spec", SPECS, ids=str)
@pytest.mark.parametrize("subsampling", ["420", "422", "444"])
def test_codes_agree(spec: ColorSpec, subsampling: str, rng) -> None:
    image = yuv_image(1, spec, subsampling)
    for wrap in (True, False):
        plate = replace(random_plate(rng, spec, SIZE), yuv=image, wrap=wrap)
        layer = random_layer(rng, SIZE)
        expected = plate.over(layer, over_tile)
        assert np.mean(planes_of(expected)[0] != planes_of(plate)[0]) > 0.2
        check_agree(on_device(plate, layer), expected)


@pytest.mark.parametrize("size", [(255, 127), (66, 25)])
def test_codes_agree_in_frames_of_odd_sizes(size: tuple[int, int], rng) -> None:
    plate, layer = random_plate(rng, SPECS[0], size), random_layer(rng, size)
    check_agree(on_device(plate, layer), plate.over(layer, over_tile))


@pytest.mark.parametrize("first_row", [10, 11])
def test_bands_of_large_tiles_do_not_show(first_row: int, rng, monkeypatch: pytest.MonkeyPatch) -> None:
    plate, layer = random_plate(rng, SPECS[0]), random_layer(rng)
    layer = replace(layer, tiles=tuple(replace(tile, row=first_row) for tile in layer.tiles))
    whole = on_device(plate, layer)
    monkeypatch.setattr("mr360uw.composite.gl.plate_pass._AT_ONCE", 1000)
    for a, b in zip(planes_of(on_device(plate, layer)), planes_of(whole), strict=True):
        np.testing.assert_array_equal(a, b)
    check_agree(whole, plate.over(layer, over_tile))


@pytest.mark.parametrize("spec", [SPECS[0], SPECS[3]], ids=str)
def test_pixels_that_nothing_touches_keep_every_bit(spec: ColorSpec, rng) -> None:
    plate, layer = random_plate(rng, spec), random_layer(rng)
    touched = np.zeros(plate.shape, bool)
    for tile in layer.tiles:
        # all of the sky
        tile.alpha[:20], tile.radiance[:20], tile.ratio[:20] = 0.0, 0.0, 1.0
        if tile.shafts is not None:
            tile.shafts[:20] = 0.0
        touched[tile.window] = changed_pixels(tile)
    assert 0.2 < touched.mean() < 0.6
    blocks = touched.reshape(plate.shape[0] // 2, 2, -1, 2).any(axis=(1, 3))
    found = planes_of(on_device(plate, layer))
    for new, old, changed in zip(found, planes_of(plate), (touched, blocks, blocks), strict=True):
        np.testing.assert_array_equal(new[~changed], old[~changed])


def test_frames_that_the_device_does_not_blend_are_the_processor_s(rng) -> None:
    """Grain, and tiles that share a sample of chroma; of a layer that changes nothing all codes stay."""
    plate, layer = random_plate(rng, SPECS[0]), random_layer(rng)
    left, right = layer.tiles
    one_less = {name: getattr(left, name)[:, :-1] for name in ("radiance", "alpha", "distance_m", "ratio", "veil")}
    more = {
        name: np.concatenate([getattr(right, name)[:, :1], getattr(right, name)], axis=1)
        for name in ("radiance", "alpha", "distance_m", "ratio", "veil", "shafts")
    }
    sharing = replace(layer, tiles=(replace(left, **one_less), replace(right, column=right.column - 1, **more)))
    for layers, grain in ((layer, 1.0), (sharing, 0.0)):
        for a, b in zip(
            planes_of(on_device(plate, layers, grain)), planes_of(plate.over(layers, over_tile, grain)), strict=True
        ):
            np.testing.assert_array_equal(a, b)
    nothing = replace(left, radiance=0.0 * left.radiance, alpha=0.0 * left.alpha, ratio=np.ones_like(left.ratio))
    for a, b in zip(planes_of(on_device(plate, replace(layer, tiles=(nothing,)))), planes_of(plate), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.fixture
def card(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[threading.Thread]:
    """This device as if it were a card of which nothing is known; returns the threads that blend on it."""
    device = replace(gl_device(), software=False, version=str(tmp_path))
    monkeypatch.setattr("mr360uw.gl.context.gl_device", lambda: device)
    monkeypatch.setattr(blend_trial, "gl_device", lambda: device)
    monkeypatch.setenv(FOLDER, str(tmp_path / "kept"))
    threads: list[threading.Thread] = []
    real = PlatePass.over

    def over(self: PlatePass, old: YuvImage, new: YuvImage, layer: Layer, index: int, wrap: bool) -> bool:
        threads.append(threading.current_thread())
        return real(self, old, new, layer, index, wrap)

    monkeypatch.setattr(PlatePass, "over", over)
    return threads


def frames_of(path: Path) -> list[VideoFrame]:
    with uw.open_video(path) as video:
        return list(video.frames())


def test_a_clip_that_a_card_blends_is_that_of_the_processor(
    dive: SampleDive, tmp_path: Path, card: list[threading.Thread], monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = load_scene(dive.scene, ["output.quality=lossless"])
    uw.composite_video(scene, tmp_path / "card.mp4", backend="gl")
    on_a_thread = [thread for thread in card if thread is not threading.main_thread()]
    assert len(on_a_thread) == 8
    monkeypatch.setattr("mr360uw.gl.context.gl_device", gl_device)
    del card[:]
    uw.composite_video(scene, tmp_path / "processor.mp4", backend="gl")
    assert not card
    plate, made = frames_of(dive.plate), frames_of(tmp_path / "card.mp4")
    for old, found, expected in zip(plate, made, frames_of(tmp_path / "processor.mp4"), strict=True):
        check_agree(found, expected)
        assert np.mean(planes_of(expected)[0] != planes_of(old)[0]) > 0.005


def test_pictures_and_results_with_light_are_the_processor_s(
    dive: SampleDive, tmp_path: Path, card: list[threading.Thread]
) -> None:
    scene = load_scene(dive.scene)
    assert make_backend("gl")[0].blends
    del card[:]
    uw.composite_video(scene, tmp_path / "####.exr", frames=(0, 1), backend="gl")
    assert [path.name for path in tmp_path.glob("*.exr")] == ["0000.exr"]
    plate = frames_of(dive.plate)[0]
    uw.render_frame(plate.image_linear, scene, plate.time_s, "gl")
    assert not card


def test_a_card_that_blends_wrongly_does_not_blend(
    card: list[threading.Thread], monkeypatch: pytest.MonkeyPatch
) -> None:
    real = PlatePass.over

    def over(self: PlatePass, old: YuvImage, new: YuvImage, layer: Layer, index: int, wrap: bool) -> bool:
        done = real(self, old, new, layer, index, wrap)
        new.u[5] ^= 4
        return done

    monkeypatch.setattr(PlatePass, "over", over)
    backend, why = make_backend("gl")
    assert (backend.name, backend.blends) == ("gl", False)
    assert "blends wrongly, so the processor blends" in why
    assert card
    monkeypatch.setattr(blend_trial, "blend_trial", None)
    assert not make_backend("gl")[0].blends, "it is asked once"
