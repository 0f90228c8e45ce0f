# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh

from mr360uw.errors import VideoError
from mr360uw.video import open_video
from mr360uw.video.layout import Shape, picture_shape, way_out
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


def other_eye(picture: np.ndarray) -> np.ndarray:
    """Return a picture seen from beside: lower rows lie farther to the left."""
    rows, columns = picture.shape
    return np.stack([np.roll(row, -round(0.02 * columns * k / rows)) for k, row in enumerate(picture)])


def half_panorama() -> np.ndarray:
    return panorama()[:, SIZE // 2 : 3 * SIZE // 2]


def vr180(*, faded: bool = False) -> np.ndarray:
    """Both eyes of the half of the sphere in front; faded: to black at their edges, as stitchers do."""
    one = half_panorama()
    edge = np.minimum(np.arange(SIZE), np.arange(SIZE)[::-1])
    light = np.minimum(1.0, edge / 8.0) if faded else 1.0
    return np.concatenate([one * light, other_eye(one) * light], axis=1)


def both_eyes(*, beside: bool) -> np.ndarray:
    """Two full panoramas squeezed into a frame of 2:1."""
    eyes = [panorama(), other_eye(panorama())]
    size = (SIZE, SIZE) if beside else (2 * SIZE, SIZE // 2)
    return np.concatenate([cv2.resize(eye, size, interpolation=cv2.INTER_AREA) for eye in eyes], axis=int(beside))


def in_a_wider_frame() -> np.ndarray:
    """Both circles at the top of a frame of 16:9, as the first dual lenses wrote them."""
    return np.pad(dual_fisheye(SIZE, 200.0)[0], ((0, SIZE // 8), (0, 0)), constant_values=16.0)


PICTURES: list[tuple[Shape, object]] = [
    ("halves", vr180), ("halves", lambda: vr180(faded=True)), ("half", half_panorama),
    ("side by side", lambda: both_eyes(beside=True)), ("one above the other", lambda: both_eyes(beside=False)),
    ("alike circles", lambda: np.tile(one_circle(), 2)), ("circles", in_a_wider_frame),
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


@pytest.mark.parametrize(
    ("picture", "message"),
    [
        (vr180, r"VR180.*crop=iw/2:ih:0:0,pad=2\*iw:ih:iw/2:0 plate_360.png"),
        (lambda: both_eyes(beside=True), 'plate.layout = "left-right" and plate.eye'),
        (lambda: both_eyes(beside=False), 'plate.layout = "top-bottom" and plate.eye'),
    ],
)
def test_check_and_new_say_that_a_frame_of_two_to_one_is_two_pictures(tmp_path, run, picture, message) -> None:
    cv2.imwrite(str(tmp_path / "plate.png"), picture())
    trimesh.creation.box((0.4, 0.4, 0.4)).export(tmp_path / "thing.ply")
    (tmp_path / "scene.toml").write_text('[plate]\npath = "plate.png"\n[water]\ntype = "none"\n')
    code, out, _ = run("check", tmp_path / "scene.toml")
    assert (code, len(re.findall(message, out))) == (0, 1)
    code, out, _ = run("new", tmp_path / "plate.png", tmp_path / "thing.ply", "--backend", "reference")
    assert (code, len(re.findall(message, out))) == (0, 1)
    layout = "plate.layout = " in message
    options = ("--set", "plate.layout=" + message.split('"')[1], "--set", "plate.eye=left") if layout else ()
    code, out, _ = run("check", tmp_path / "scene.toml", *(options or ("--set", 'plate.projection="equirectangular"')))
    assert (code, re.findall(message, out)) == (0, [])


def lenses(*, ahead: bool) -> list[np.ndarray]:
    look, inside = fisheye(SIZE, 200.0, ahead=ahead)
    luma = np.where(inside, textured(look), 16.0)
    return [luma, *(np.full((SIZE // 2, SIZE // 2), 128.0) for _ in range(2))]


def test_one_lens_is_said_by_what_the_file_has(tmp_path, run) -> None:
    """Two tracks of a lens each are joined; one alone is no eye of a stereo pair, whatever is asked for."""
    both = [[lenses(ahead=False)], [lenses(ahead=True)]]
    paired, alone = write_tracks(tmp_path / "clip.mp4", both), write_tracks(tmp_path / "alone.mp4", both[:1])
    camera = write_tracks(tmp_path / "CAM_1.OSV", both)
    for eye in (None, "left"):
        with pytest.raises(VideoError, match=r'circle of one lens, of two: set plate.projection = "dual_fisheye"'):
            open_video(paired, eye=eye)
        with pytest.raises(VideoError, match=r"circle of one lens: give the camera's own file with both \(.insv, .osv"):
            open_video(alone, eye=eye)
    with open_video(camera) as video:
        assert (video.width, video.height) == (2 * SIZE, SIZE)
        assert not any("not copied" in note for note in video.notes)
    trimesh.creation.box((0.4, 0.4, 0.4)).export(tmp_path / "thing.ply")
    code, out, _ = run("new", paired, tmp_path / "thing.ply", "--backend", "reference")
    assert (code, "from dual_fisheye" in out) == (0, True)
    code, _, err = run("new", alone, tmp_path / "thing.ply", "--backend", "reference")
    assert (code, "circle of one lens" in err) == (2, True)


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
