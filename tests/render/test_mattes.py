# SPDX-License-Identifier: Apache-2.0
"""Mattes and distance maps in step with the plate: stills, sequences, videos; what is wrong with them is said."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest

from mr360uw import composite_video
from mr360uw.base.sphere import directions
from mr360uw.composite.settings import HoldoutSettings, ReceiverSettings
from mr360uw.errors import VideoError
from mr360uw.render.first_pass import ClipAnalysis
from mr360uw.render.frame import composite_frame, make_backend
from mr360uw.render.loaded import load
from mr360uw.render.mattes import GreyClip, Mattes, ReceiverClip
from mr360uw.scene.model import Scene
from mr360uw.types import Floats
from mr360uw.video import VideoFrame, write_exr
from tests import tolerances as tol
from tests.scenes import gradient_plate, scene_with

SIZE = (128, 64)
FAR_M = 12.0


def floor(height_m: float, size: tuple[int, int] = SIZE) -> Floats:
    """Return the distances of a floor, infinite above the horizon."""
    up = directions(*size)[..., 1]
    with np.errstate(divide="ignore"):
        return np.where(up < 0.0, height_m / up, np.inf)


def save(path: Path, distance_m: Floats, dtype: Any = np.uint16) -> Path:
    """Write distances in codes, black (no surface) where they are farther than FAR_M."""
    seen = distance_m < FAR_M
    codes = np.where(seen, distance_m, 0.0) / FAR_M * np.iinfo(dtype).max
    assert cv2.imwrite(str(path), np.round(codes).astype(dtype))
    return path


def save_video(path: Path, maps: list[Floats]) -> Path:
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=Fraction(30))
        stream.width, stream.height, stream.pix_fmt = SIZE[0], SIZE[1], "yuv420p"
        stream.options = {"qp": "0"}
        for distance in maps:
            codes = np.full((SIZE[1] * 3 // 2, SIZE[0]), 128, np.uint8)
            part = np.where(distance < FAR_M, distance, 0.0) / FAR_M
            codes[: SIZE[1]] = np.round(16.0 + 219.0 * part)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(codes, format="yuv420p")))
        container.mux(stream.encode())
    return path


def receiver(path: Path, **more: Any) -> ReceiverSettings:
    return ReceiverSettings(kind="distance", path=path, range_m=(0.0, FAR_M), **more)


def map_of(clip: ReceiverClip, index: int) -> Floats:
    distance = clip.at(index).distance_m
    assert distance is not None
    return distance


def test_threads_that_are_frames_apart_get_their_own_maps(tmp_path: Path) -> None:
    maps = [floor(-1.0 - 0.25 * k) for k in range(6)]
    clip = ReceiverClip(receiver(save_video(tmp_path / "map.mkv", maps)), *SIZE)
    alone = ReceiverClip(receiver(tmp_path / "map.mkv"), *SIZE)
    true = [map_of(alone, k) for k in range(6)]
    with ThreadPoolExecutor(2) as pool:
        ahead = pool.map(lambda k: map_of(clip, k), range(6))
        behind = pool.map(lambda k: map_of(clip, k), range(6))
        for of_thread in (ahead, behind):
            for got, want in zip(of_thread, true, strict=True):
                np.testing.assert_array_equal(got, want)
    assert clip.at(5) is clip.at(5)


def test_a_still_is_one_receiver_for_all_frames(tmp_path: Path) -> None:
    clip = ReceiverClip(receiver(save(tmp_path / "map.png", floor(-1.5))), 256, 128)
    assert clip.at(0) is clip.at(7)
    clip.check(10**6)
    got, true = map_of(clip, 0), floor(-1.5)
    seen = true < FAR_M
    np.testing.assert_allclose(got[seen], true[seen], atol=FAR_M / 65535.0)
    assert np.all(np.isinf(got[~seen]))


def test_a_sequence_is_a_new_receiver_for_each_frame_in_any_order(tmp_path: Path) -> None:
    heights = [-1.8, -1.5, -1.2]
    for k, height in enumerate(heights):
        save(tmp_path / f"map_{k:03d}.png", floor(height))
    clip = ReceiverClip(receiver(tmp_path / "map_%03d.png"), *SIZE)
    first = clip.at(0)
    assert clip.at(0) is first
    assert clip.at(1) is not first
    for k in (2, 0, 1, 1, 2):
        assert map_of(clip, k)[-1].mean() == pytest.approx(-heights[k], rel=1e-3)


def test_a_video_is_read_with_its_steps_taken_off(tmp_path: Path) -> None:
    path = save_video(tmp_path / "map.mp4", [floor(h, SIZE) for h in (-1.8, -1.2)])
    clip = ReceiverClip(receiver(path), *SIZE)
    for k, height in enumerate((-1.8, -1.2)):
        true = floor(height)
        near = true < 0.8 * FAR_M
        got = map_of(clip, k)
        assert np.abs(got[near] - true[near]).max() < 2.0 * FAR_M / 219.0
        assert np.all(np.isinf(got[true == np.inf]))
        code = got[near] * 219.0 / FAR_M
        assert np.abs(code - np.round(code)).max() > 0.2


@pytest.mark.parametrize("channel", ["Z", "RGB", "layers"])
def test_exr_holds_metres_whatever_the_range(channel: str, tmp_path: Path) -> None:
    metres = floor(-1.5).astype(np.float32)
    metres[40, 10:14] = 0.0, np.nan, np.inf, -np.inf
    parts: Any = {"": {channel: metres if channel == "Z" else np.repeat(metres[..., None], 3, -1)}}
    if channel == "layers":
        beauty = np.full((*metres.shape, 4), 0.5, np.float16)
        parts = {"beauty": {"RGBA": beauty}, "depth": {"Z": metres}}
    write_exr(tmp_path / "map.exr", parts)
    for settings in (receiver(tmp_path / "map.exr"), ReceiverSettings(kind="distance", path=tmp_path / "map.exr")):
        got = map_of(ReceiverClip(settings, *SIZE), 0)
        expected = np.where(np.isfinite(metres) & (metres > 0.0), metres, np.inf)
        np.testing.assert_allclose(got, expected, rtol=tol.FLOAT32)


def scene_of(folder: Path, whale: Path, receiver_table: dict[str, Any], **tables: Any) -> Scene:
    near = [{"mesh": str(whale), "position_m": [0.2, -0.6, -2.5], "rotation_deg": [-70.0, 5.0, 0.0]}]
    sun = {"sun": "given", "sun_azimuth_deg": 20.0, "sun_elevation_deg": 70.0}
    return scene_with(
        folder, whale, object=near, receiver=receiver_table, light=sun, caustics={"enabled": False}, **tables
    )


def ratios(scene: Scene, backend: str, count: int) -> list[Floats]:
    loaded, (renderer, _) = load(scene, *SIZE, clip=False), make_backend(backend)
    plates = [VideoFrame.of_linear(gradient_plate(*SIZE, sun=None), k) for k in range(count)]
    return [composite_frame(loaded, ClipAnalysis(), renderer, plate, 0.0).layer.ratio for plate in plates]


def test_a_floor_that_rises_takes_the_shadow_with_it(tmp_path: Path, whale: Path, backend: str) -> None:
    """Frame by frame as the plane receiver at that height."""
    heights = [-2.0, -1.4]
    for k, height in enumerate(heights):
        write_exr(tmp_path / f"floor_{k}.exr", {"": {"Z": floor(height, (512, 256)).astype(np.float32)}})
    table = {"kind": "distance", "path": str(tmp_path / "floor_%d.exr"), "extent_m": 8.0}
    got = ratios(scene_of(tmp_path, whale, table), backend, 2)
    for k, height in enumerate(heights):
        expected = ratios(scene_of(tmp_path, whale, {"height_m": height, "extent_m": 8.0}), backend, 1)[0]
        assert expected.min() < 0.8
        off = np.abs(got[k] - expected).max(axis=-1)
        # the device interpolates ambient light on a plane, and sweeps every pixel of a map
        between = 0.0 if backend == "reference" else tol.BETWEEN_SWEEPS
        assert off.max() <= tol.MAP_RATIO + between
        assert np.mean(off <= tol.MAP_RATIO + 0.25 * between) >= tol.AGREEMENT_FRACTION
    assert np.abs(got[0] - got[1]).max() > 0.1


def test_a_map_that_ends_early_is_said_before_anything_is_written(tmp_path: Path, whale: Path) -> None:
    cv2.imwrite(str(tmp_path / "plate.png"), np.full((64, 128, 3), 90, np.uint8))
    for k in range(3):
        save(tmp_path / f"map_{k}.png", floor(-1.5))
        cv2.imwrite(str(tmp_path / f"matte_{k}.png"), np.zeros((64, 128), np.uint8))
    table = {"kind": "distance", "path": str(tmp_path / "map_%d.png"), "range_m": [0.0, FAR_M]}
    scene = scene_of(tmp_path, whale, table)
    with pytest.raises(VideoError, match=r"map_%d\.png - ends before the plate \(got 3 frames .* 0:3"):
        composite_video(scene, tmp_path / "out_%d.png", frames=(0, 5), backend="reference")
    assert not list(tmp_path.glob("out*"))
    holdout = scene_of(tmp_path, whale, {}, holdout=[{"path": str(tmp_path / "matte_%d.png")}])
    with pytest.raises(VideoError, match=r"matte_%d\.png - ends before the plate"):
        composite_video(holdout, tmp_path / "out_%d.png", frames=(2, 4), backend="reference")
    clip = GreyClip(tmp_path / "map_%d.png", *SIZE)
    with pytest.raises(VideoError, match=r"map_%d\.png"):
        clip.at(3)


def test_another_shape_than_the_plates_is_refused(tmp_path: Path) -> None:
    path = save(tmp_path / "square.png", floor(-1.5, (64, 64)))
    with pytest.raises(VideoError, match=r"square\.png .* \(got 64x64 for 128x64\)"):
        ReceiverClip(receiver(path), *SIZE)
    with pytest.raises(VideoError, match=r"nothing\.png"):
        ReceiverClip(receiver(tmp_path / "nothing.png"), *SIZE)


def test_holdouts_by_distance_have_holes_too(tmp_path: Path) -> None:
    """A hole is nothing in front, at any size of the map; metres of EXR are metres."""
    metres = np.full((32, 64), 3.0, np.float32)
    metres[10:20, 5:15], metres[0:3, 30:40] = 0.0, np.nan
    write_exr(tmp_path / "front.exr", {"": {"Z": metres}})
    table = [{"path": str(tmp_path / "front.exr"), "kind": "distance"}]
    mattes = Mattes(scene_with(tmp_path, None, holdout=table).holdouts, *SIZE)
    mask, distance = mattes.at(4)
    assert mask is None
    assert distance is not None
    assert distance.shape == SIZE[::-1]
    expected = np.repeat(np.repeat(np.where(metres > 0.0, metres, np.inf), 2, axis=0), 2, axis=1)
    assert np.array_equal(distance, expected)
    assert mattes.at(5)[1] is not None


def test_several_holdouts_hide_what_any_of_them_hides(tmp_path: Path) -> None:
    left, but_right = np.zeros(SIZE[::-1], np.uint8), np.full(SIZE[::-1], 255, np.uint8)
    left[:, :32], but_right[:, 96:] = 255, 0
    masks = {"left.png": left, "but_right.png": but_right}
    assert all(cv2.imwrite(str(tmp_path / name), codes) for name, codes in masks.items())
    maps = {"low.png": floor(-1.5), "high.png": floor(-1.0)}
    given = [HoldoutSettings(path=tmp_path / name, invert=name == "but_right.png") for name in masks]
    given += [
        HoldoutSettings(path=save(tmp_path / name, one), kind="distance", range_m=(0.0, FAR_M))
        for name, one in maps.items()
    ]
    mask, metres = Mattes(given, *SIZE).at(0)
    np.testing.assert_array_equal(mask, (left > 0) | (but_right == 0))
    near = maps["high.png"] < FAR_M
    assert metres is not None
    np.testing.assert_allclose(metres[near], maps["high.png"][near], atol=FAR_M / 65535.0)
