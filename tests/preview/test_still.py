# SPDX-License-Identifier: Apache-2.0
"""Single frames, views into them, drafts, and sheets of variants, through the library and the command line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

import mr360uw as uw
from mr360uw.base.sphere import direction_from_angles, directions
from mr360uw.cli import app
from mr360uw.cli.arguments import variants, view_of
from mr360uw.preview.live import LivePreview
from mr360uw.preview.pages import LARGEST_SHEET, still_of
from mr360uw.preview.screen import look, perspective
from mr360uw.sample import SampleDive
from mr360uw.scene.model import Scene, at_scale, load_scene
from mr360uw.scene.resolved import open_plate
from mr360uw.video import VideoFrame
from mr360uw.video.writer import picture_codes

CODE = 1.0 / 255.0


def render_still(scene: Scene, backend: str = "auto", **place: Any) -> VideoFrame:
    with LivePreview(backend) as live:
        return still_of(live, scene, **place)


@pytest.fixture(scope="module")
def scene_file(dive: SampleDive) -> Path:
    return dive.scene


def run(*words: str | Path) -> str:
    done = CliRunner().invoke(app, [str(word) for word in words], catch_exceptions=False)
    assert done.exit_code == 0
    return done.output


# --- views -----------------------------------------------------------------------------------------------------------


def test_a_view_looks_where_it_says() -> None:
    view = perspective(30.0, -20.0, 90.0, 65, 65)
    ray = view.pixel_directions()
    np.testing.assert_allclose(ray[32, 32], direction_from_angles(np.radians(30.0), np.radians(-20.0)), atol=1e-12)
    edge = np.tan(np.radians(45.0)) * 64 / 65  # centre of the outermost pixel
    np.testing.assert_allclose(ray[32, 0] @ ray[32, 64], (1 - edge**2) / (1 + edge**2), atol=1e-12)
    assert ray[0, 32, 1] > ray[64, 32, 1]
    level = perspective(0.0, 0.0, 90.0, 65, 65).pixel_directions()
    assert level[32, 64, 0] > 0.0


@pytest.mark.parametrize("pitch_deg", [0.0, 90.0, -90.0])
def test_a_smooth_panorama_is_seen_through_seam_and_poles(pitch_deg: float) -> None:
    panorama = (0.5 + 0.4 * directions(256, 128)).astype(np.float32)
    view = perspective(180.0, pitch_deg, 100.0, 160, 120)
    # OpenCV places samples to 1/32 pixel, and its cubic filter does not return a slope exactly
    np.testing.assert_allclose(look(panorama, view), 0.5 + 0.4 * view.pixel_directions(), atol=0.25 * CODE)


def test_a_coarse_view_is_the_mean_of_what_it_covers(rng: np.random.Generator) -> None:
    panorama = rng.uniform(0.0, 1.0, (512, 1024, 3)).astype(np.float32)
    seen = look(panorama, perspective(0.0, 0.0, 90.0, 32, 32))
    # about 5 x 5 pixels of deviation 0.29 in each; a point sample would keep 0.29
    assert seen.std() < 0.12


@pytest.mark.parametrize(("text", "size"), [("a,b", "64x32"), ("0,0,60,1", "64x32"), ("0", "64"), ("0,100", "64x32")])
def test_what_is_no_view_is_refused(text: str, size: str) -> None:
    with pytest.raises(uw.ParameterError, match="view"):
        view_of(text, size)


# --- stills and drafts -----------------------------------------------------------------------------------------------


def test_a_still_is_the_frame_that_the_library_renders(scene_file: Path, tmp_path: Path) -> None:
    scene = load_scene(scene_file)
    with open_plate(scene) as video:
        plate = next(iter(video.frames(3, 4)))
    expected = uw.render_frame(plate.image_linear, scene, plate.time_s, "reference", index=3).image_linear
    got = render_still(scene, frame=3, backend="reference")
    assert got.index == 3
    # the still goes through 8-bit planes with chroma of half resolution
    assert np.sqrt(np.mean((got.image_linear - np.clip(expected, 0.0, 1.0)) ** 2)) < CODE
    run("still", scene_file, tmp_path / "s.png", "--time", str(plate.time_s), "--backend", "reference")
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / "s.png"))[..., ::-1], picture_codes(got))


def test_a_draft_is_the_composite_made_smaller(scene_file: Path, tmp_path: Path) -> None:
    scene = load_scene(scene_file)
    whole = render_still(scene, frame=2, backend="reference").image_linear
    small = render_still(at_scale(scene, 0.5), frame=2, backend="reference").image_linear
    reduced = cv2.resize(whole, small.shape[1::-1], interpolation=cv2.INTER_AREA)
    # means of codes are not means of light, and the object's edges fall on other pixels
    assert np.sqrt(np.mean((small - reduced) ** 2)) < 3.0 * CODE
    run("composite", scene_file, tmp_path / "d.mp4", "--scale", "0.5", "--frames", "0:2", "--backend", "reference")
    with uw.open_video(tmp_path / "d.mp4") as video:
        assert (video.width, video.height) == small.shape[1::-1]
        assert video.frame_count == 2


@pytest.mark.parametrize("scale", [0.0, 1.5, 0.01, float("nan")])
def test_a_scale_that_leaves_no_picture_is_refused(scene_file: Path, scale: float) -> None:
    with pytest.raises(uw.ParameterError, match="scale"):
        render_still(at_scale(load_scene(scene_file), scale))


def test_a_view_keeps_the_plates_codes(scene_file: Path, tmp_path: Path) -> None:
    view = ("--view", "0,-10,80", "--size", "96x64", "--backend", "reference")
    run("still", scene_file, tmp_path / "v.png", *view)
    picture = cv2.imread(str(tmp_path / "v.png"), cv2.IMREAD_UNCHANGED)
    assert picture.shape == (64, 96, 3)
    assert picture.dtype == np.uint8
    with pytest.raises(uw.OutputExistsError, match="already"):
        CliRunner().invoke(app, ["still", str(scene_file), str(tmp_path / "v.png")], catch_exceptions=False)


def test_bad_stills_are_refused_before_they_are_rendered(scene_file: Path, tmp_path: Path) -> None:
    scene = load_scene(scene_file)
    with pytest.raises(uw.ParameterError, match="frame, time_s"):
        render_still(scene, frame=1, time_s=1.0)
    with pytest.raises(uw.VideoError, match="outside the clip"):
        render_still(scene, frame=10_000)
    for name in ("s.mp4", "none/s.png"):
        with pytest.raises((uw.ParameterError, uw.VideoError), match=name):
            CliRunner().invoke(app, ["still", str(scene_file), str(tmp_path / name)], catch_exceptions=False)


def test_a_frame_shows_itself_in_a_notebook() -> None:
    light = np.full((600, 1200, 3), 0.2, np.float32)
    frame = uw.FrameResult(light, uw.Layer(600, 1200, ()), None, None, None)
    shown = cv2.imdecode(np.frombuffer(frame._repr_png_(), np.uint8), cv2.IMREAD_COLOR)
    assert shown.shape == (512, 1024, 3)
    assert np.all(shown == round(255.0 * (1.055 * 0.2 ** (1.0 / 2.4) - 0.055)))


# --- sheets ----------------------------------------------------------------------------------------------------------


def test_overrides_make_all_combinations() -> None:
    found = variants(["a.b=1,2", "c.d=[1, 2],[3, 4]"])
    assert found == [("a.b=1", "c.d=[1, 2]"), ("a.b=1", "c.d=[3, 4]"), ("a.b=2", "c.d=[1, 2]"), ("a.b=2", "c.d=[3, 4]")]
    with pytest.raises(uw.ParameterError, match="override"):
        variants(["a.b"])


def test_a_sweep_shows_every_variant_with_its_label(scene_file: Path, tmp_path: Path) -> None:
    out = tmp_path / "sheet.png"
    run("sweep", scene_file, out, "--set", "camera.depth_m=2,4", "--set", "water.type=IB,1C", "--backend", "reference")
    sheet = cv2.imread(str(out))
    with uw.open_video(scene_file.with_name("dive.mp4")) as video:
        assert sheet.shape[1] > 4 * video.width
        cells = [sheet[4 : 4 + video.height, 4 + k * (video.width + 4) :][:, : video.width] for k in range(4)]
    assert all(np.any(cells[0] != other) for other in cells[1:])
    page = out.with_suffix(".html").read_text("utf-8")
    assert page.count("<img") == 4
    assert "camera.depth_m=2  water.type=1C" in page
    assert "http" not in page


def test_a_sweep_is_checked_before_it_is_rendered(scene_file: Path, tmp_path: Path) -> None:
    out = tmp_path / "sheet.png"
    many = ",".join(map(str, range(1, LARGEST_SHEET + 2)))
    for values, error in ((f"camera.depth_m={many}", uw.ParameterError), ("camera.depth_m=4,-1", uw.SceneError)):
        with pytest.raises(error):
            CliRunner().invoke(app, ["sweep", str(scene_file), str(out), "--set", values], catch_exceptions=False)
    assert list(tmp_path.iterdir()) == []
