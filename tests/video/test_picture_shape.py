# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from mr360uw.errors import VideoError
from mr360uw.video import open_video
from mr360uw.video.read.picture_shape import Shape, picture_shape, way_out
from tests.video.other_projections import dual_fisheye, eac_row, equirectangular, fisheye, world, write_tracks

SIZE = 128


def textured(direction: np.ndarray) -> np.ndarray:
    """Luma with detail on a gradient from the surface down to the floor."""
    detail = 25.0 * np.sin(11.0 * direction[..., 0] + 4.0) * np.sin(13.0 * direction[..., 2])
    return np.clip(world(direction)[0] + 30.0 * direction[..., 1] + detail, 0.0, 255.0)


def flat(width: int, height: int) -> np.ndarray:
    u, v = np.meshgrid(np.linspace(-1.0, 1.0, width), np.linspace(-1.0, 1.0, height) * height / width)
    look = np.stack([u, -v - 0.4, np.full_like(u, -1.0)], axis=-1)
    return textured(look / np.linalg.norm(look, axis=-1, keepdims=True))


def panorama() -> np.ndarray:
    return textured(equirectangular(2 * SIZE))


def black_caps() -> np.ndarray:
    picture = panorama()
    picture[: SIZE // 6] = picture[-SIZE // 6 :] = 16.0
    return picture


def uneven_lenses() -> np.ndarray:
    """One half of the sphere exposed brighter, with the step at the seam."""
    return panorama() * np.where(np.arange(2 * SIZE) < SIZE, 1.15, 1.0)


def logo_at_nadir() -> np.ndarray:
    picture = panorama()
    picture[-8:] = np.random.default_rng(1).uniform(0.0, 255.0, (8, 2 * SIZE))
    return picture


def one_circle() -> np.ndarray:
    look, inside = fisheye(SIZE, 200.0, ahead=True)
    return np.where(inside, textured(look), 16.0)


def eac() -> np.ndarray:
    return np.concatenate([eac_row(SIZE // 2, row)[0] for row in (0, 1)])


PICTURES: list[tuple[Shape, object]] = [
    ("panorama", panorama), ("panorama", black_caps), ("panorama", uneven_lenses), ("panorama", logo_at_nadir),
    ("panorama", lambda: np.full((64, 128), 16.0)), ("panorama", lambda: 0.1 * panorama()),
    ("dual fisheye", lambda: dual_fisheye(SIZE, 200.0)[0]), ("fisheye", one_circle), ("EAC", eac),
    ("flat", lambda: flat(256, 144)), ("flat", lambda: flat(256, 128)),
    ("EAC track", lambda: cv2.resize(flat(568, 184), (2272, 736))),
]  # fmt: skip


@pytest.mark.parametrize(("shape", "picture"), PICTURES)
def test_a_picture_is_recognised(shape, picture) -> None:
    codes = np.rint(picture()).astype(np.uint8)
    assert picture_shape(codes) == shape
    assert picture_shape(codes.astype(np.uint16) * 4, 1020.0) == shape
    assert bool(way_out(shape, Path("a.mp4"))) == bool(way_out(shape, Path("a.png"))) == (shape != "panorama")


@pytest.mark.parametrize(
    ("picture", "message"),
    [
        (lambda: flat(256, 144), r"not a 360 degree panorama of 2:1 \(got 256x144\) - looks like the flat picture"),
        (eac, r"not a 360.*shows six faces of a cube.*turn it by ffmpeg -i plate.png -vf v360=eac:e out.png"),
        (one_circle, "shows the circle of one lens.*insv"),
    ],
)
def test_plates_of_another_size_are_refused_with_the_way_out(tmp_path, picture, message) -> None:
    path = tmp_path / "plate.png"
    cv2.imwrite(str(path), picture())
    with pytest.raises(VideoError, match=message):
        open_video(path)


def test_a_clip_of_cube_faces_is_refused_with_the_setting(tmp_path) -> None:
    rows = zip(eac_row(96, 0), eac_row(96, 1), strict=True)
    clip = write_tracks(tmp_path / "plate.mp4", [[[np.concatenate(planes) for planes in rows]]])
    with pytest.raises(VideoError, match=r'six faces of a cube.*plate.projection = "eac"'):
        open_video(clip)


def test_check_says_what_a_plate_of_two_to_one_shows(tmp_path, run) -> None:
    cv2.imwrite(str(tmp_path / "plate.png"), dual_fisheye(SIZE, 200.0)[0])
    (tmp_path / "scene.toml").write_text('[plate]\npath = "plate.png"\n[water]\ntype = "none"\n')
    code, out, _ = run("check", tmp_path / "scene.toml")
    assert code == 0
    assert "two fisheye circles side by side: turn it by ffmpeg -i plate.png -vf v360=dfisheye:e:ih_fov=200" in out
    code, out, _ = run("check", tmp_path / "scene.toml", "--set", 'plate.projection="equirectangular"')
    assert code == 0
    assert "fisheye circles" not in out
