# SPDX-License-Identifier: Apache-2.0
"""Both eyes of a stereo plate, from the file to the file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import OpenEXR
import pytest

import mr360uw as uw
from mr360uw.base.cache import Cache
from mr360uw.errors import Mr360uwError, ParameterError, VideoError
from mr360uw.render.first_pass import ClipAnalysis
from mr360uw.render.frame import composite_frame, make_backend
from mr360uw.render.loaded import load
from mr360uw.render.mattes import GreyClip
from mr360uw.scene.model import Scene, scene_from_dict
from mr360uw.scene.resolved import open_plate
from mr360uw.video import create_video, open_video, read_spherical
from mr360uw.video.spherical import SphericalMetadata, Stereo, write_spherical
from tests.scenes import gradient_plate
from tests.video.clips import write_clip

Run = Callable[..., tuple[int, str, str]]
WIDTH = 96


def two_eyes(path: Path, width: int = WIDTH, height: int = WIDTH // 2) -> Path:
    """Write a top-bottom still whose right eye is the left one, a column to the right."""
    left = np.round(255.0 * gradient_plate(width, height) ** (1 / 2.2)).astype(np.uint8)
    cv2.imwrite(str(path), np.concatenate([left, np.roll(left, 1, axis=1)])[..., ::-1])
    return path


def scene_of(folder: Path, mesh: Path, **tables: object) -> Scene:
    """Return a scene of a stereo still in air, with a body over a floor that catches its shadow."""
    plate = folder / "plate.png"
    if not plate.exists():
        two_eyes(plate)
    data = {
        "plate": {"path": str(plate), "eye": "both"}, "water": {"type": "none"}, "light": {"sun": "detect"},
        "object": [{"mesh": str(mesh), "position_m": [0.0, -0.6, -1.6], "rotation_deg": [30.0, 0.0, 0.0]}],
        "receiver": {"kind": "plane", "height_m": -1.2},
    }  # fmt: skip
    return scene_from_dict(data | tables, folder)


def test_a_still_of_both_eyes(whale: Path, tmp_path: Path, backend: str) -> None:
    scene = scene_of(tmp_path, whale)
    uw.composite_video(scene, tmp_path / "out.png", backend=backend, layers=tmp_path / "layers_%04d.exr")
    before, after = (cv2.imread(str(tmp_path / name)).astype(int) for name in ("plate.png", "out.png"))
    assert after.shape == before.shape
    changed = [np.any(a != b, axis=-1) for a, b in zip(np.split(after, 2), np.split(before, 2), strict=True)]
    assert all(0.02 < eye.mean() < 0.8 for eye in changed)  # a body, and untouched codes around it
    with OpenEXR.File(str(tmp_path / "layers_0000.exr")) as file:
        views = {part.name(): part.header["view"] for part in file.parts}
        moved = [np.concatenate([c.pixels for c in p.channels.values()]) for p in file.parts if "ward." in p.name()]
    assert len(moved) == 4
    assert not np.any(moved)  # a body and a camera at rest, seen from beside the middle
    assert {name.rpartition(".")[2] == view for name, view in views.items()} == {True}
    assert next(iter(views)) == "rgba.left"
    assert list(views.values()).count("left") == list(views.values()).count("right")


def test_light_is_measured_once_and_shared(whale: Path, tmp_path: Path) -> None:
    scene = scene_of(tmp_path, whale)
    with open_plate(scene) as video:
        plate = next(iter(video.frames(0, 1)))
        loaded = load(scene, video.width, video.height, clip=False)
    backend = make_backend("reference", Cache(scene.plate.eyes))[0]
    frame = composite_frame(loaded, ClipAnalysis(), backend, plate, 0.0)
    assert frame.right is not None
    assert frame.light is frame.right.light
    assert frame.medium is frame.right.medium
    shifts = [np.average(np.arange(WIDTH), weights=eye.layer.alpha.sum(axis=0) + 1e-9) for eye in (frame, frame.right)]
    near, far = (scene.camera.ipd_m / metres * WIDTH / (2 * np.pi) for metres in (0.7, 2.8))
    assert far < shifts[0] - shifts[1] < near  # of a body of 2 m about 1.7 m away


def test_one_panorama_is_no_frame_of_both_eyes(whale: Path, tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match="has one eye"):
        uw.render_frame(gradient_plate(64, 32), scene_of(tmp_path, whale), backend="reference")


@pytest.mark.parametrize(
    ("stereo", "size", "written"),
    [
        ("top-bottom", (128, 128), "top-bottom"), ("top-bottom", (128, 64), "top-bottom"),
        ("left-right", (256, 64), "left-right"), ("right-left", (256, 64), "left-right"),
    ],
)  # fmt: skip
def test_both_eyes_are_written_as_they_are_read(
    tmp_path: Path, stereo: Stereo, size: tuple[int, int], written: Stereo
) -> None:
    plate = write_clip(tmp_path / "in.mp4", 2, size=size)
    write_spherical(plate, SphericalMetadata(stereo=stereo))
    from mr360uw.video.clip import EncodeSettings

    with open_video(plate, eye="both") as video:
        frames = list(video.frames())
        with create_video(tmp_path / "out.mp4", video, EncodeSettings(quality="lossless")) as out:
            for frame in frames:
                out.write(frame)
    marks = read_spherical(tmp_path / "out.mp4")
    assert marks is not None
    assert marks.stereo == written
    for eye in ("left", "right"):
        with open_video(tmp_path / "out.mp4", eye=eye) as video, open_video(plate, eye=eye) as source:
            for frame, expected in zip(video.frames(), source.frames(), strict=True):
                np.testing.assert_array_equal(frame.yuv.y, expected.yuv.y)
                np.testing.assert_array_equal(frame.yuv.u, expected.yuv.u)


def test_mattes_hold_both_eyes(tmp_path: Path) -> None:
    rows = np.concatenate([np.zeros((16, 32), np.uint8), np.full((16, 32), 255, np.uint8)])
    cv2.imwrite(str(tmp_path / "above.png"), rows)
    cv2.imwrite(str(tmp_path / "beside.png"), np.concatenate(np.split(rows, 2), axis=1))
    for name in ("above", "beside"):
        clip = GreyClip(tmp_path / f"{name}.png", 64, 32, both=True)
        assert [clip.at(0, eye).values.mean() for eye in (0, 1)] == [0.0, 1.0]
        assert clip.at(1, 1) is clip.at(0, 1)
    cv2.imwrite(str(tmp_path / "one.png"), rows[:16])
    with pytest.raises(VideoError, match="both eyes of 64x32"):
        GreyClip(tmp_path / "one.png", 64, 32, both=True)


@pytest.mark.parametrize(
    ("size", "settings", "says"),
    [
        ((64, 32), 'plate.eye="both"', 'no "both" eye'),
        ((64, 66), 'plate.layout="top-bottom"', "cannot be divided"),
        ((66, 64), 'plate.layout="left-right"', "cannot be divided"),
        ((64, 200), 'plate.layout="top-bottom"', "not a 360 degree panorama"),
        ((64, 64), "camera.ipd_m=0.5", "must be"),
        ((64, 64), "camera.ipd_m=0.001", "must be"),
        ((64, 64), 'plate.layout="crossed"', "crossed"),
        ((64, 64), "object.0.position_m=[0.0,5.0,-3.0]", "surface"),
        ((64, 64), 'surface.objects="all"', "surface"),
    ],
)
def test_plates_that_have_no_two_eyes(
    whale: Path, tmp_path: Path, run: Run, size: tuple[int, int], settings: str, says: str
) -> None:
    cv2.imwrite(str(tmp_path / "plate.png"), np.zeros((size[1], size[0], 3), np.uint8))
    (tmp_path / "scene.toml").write_text(
        f'plate = {{path = "plate.png", eye = "both"}}\n[water]\ntype = "IB"\n[[object]]\nmesh = "{whale}"\n'
        "position_m = [0.0, -1.0, -3.0]\n"
    )
    code, _, err = run("check", tmp_path / "scene.toml", "--set", settings, "--backend", "reference")
    assert code == 2
    assert says in err


def test_a_body_below_the_surface_is_drawn_without_its_mirror_image(whale: Path, tmp_path: Path, run: Run) -> None:
    cv2.imwrite(str(tmp_path / "plate.png"), np.full((64, 64, 3), 90, np.uint8))
    (tmp_path / "scene.toml").write_text(
        f'plate = {{path = "plate.png", eye = "both"}}\n[water]\ntype = "IB"\n[[object]]\nmesh = "{whale}"\n'
        "position_m = [0.0, 3.5, -3.0]\n"
    )
    code, out, _ = run("check", tmp_path / "scene.toml", "--backend", "reference")
    assert code == 0
    assert "its mirror image is not drawn for both eyes" in out


def test_a_squeezed_panorama_is_lit_like_the_whole_one(tmp_path: Path) -> None:
    """Tagged or stated shapes other than 2:1 are panoramas with pixels that are wider than high."""
    whole = gradient_plate(256, 128)
    tall = cv2.resize(whole, (128, 128), interpolation=cv2.INTER_AREA)
    lights = [uw.ibl.environment(picture, sun=None).radiance for picture in (whole, tall)]
    assert np.abs(lights[1] / lights[0] - 1.0).max() < 0.02  # means of the same areas, but for the clipped sun
    cv2.imwrite(str(tmp_path / "tall.png"), np.zeros((128, 128, 3), np.uint8))
    with pytest.raises(Mr360uwError, match="stereo"):
        open_video(tmp_path / "tall.png")
    assert open_video(tmp_path / "tall.png", layout="mono").height == 128
