# SPDX-License-Identifier: Apache-2.0
"""Files of pictures from above, and the command that writes them."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest

from mr360uw import cli, load_aerial
from mr360uw.errors import SceneError, VideoError
from mr360uw.from_above import AerialScene, LoadedAerial, aerial_film
from mr360uw.video import open_video, read_spherical
from mr360uw.video.exr import read_exr

TEXT = """
[camera]
width = 16
height = 8
[sea]
wind_speed = 0.0
resolution = 16
detail_slope = 0.0
[caustics]
size = 16
grid = 16
[water]
type = "none"
[floor]
ground = "even"
[film]
samples = 1
frame_rate = 10
duration_s = 0.3
"""
Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def sea(tmp_path: Path) -> Path:
    """A scene file of tiny pictures."""
    (tmp_path / "sea.toml").write_text(TEXT)
    return tmp_path / "sea.toml"


@pytest.fixture
def aerial(run: Run) -> Run:
    """Run `mr360uw aerial`; return exit code, output and errors."""
    return partial(run, "aerial")


def test_the_command_writes_pictures_and_parts(sea: Path, tmp_path: Path, aerial: Run) -> None:
    code, out, _ = aerial(
        sea, tmp_path / "a_%02d.exr", "--frames", "1:3", "--set", "camera.velocity_m_s=[1.0, 0.0, 0.0]"
    )
    assert code == 0
    assert "2 frames" in out
    assert sorted(p.name for p in tmp_path.glob("a_*")) == ["a_01.exr", "a_02.exr"]
    parts = read_exr(tmp_path / "a_01.exr")
    assert list(parts) == ["beauty", "floor", "reflection", "normal", "bodies", "distance", "water"]
    scene = load_aerial(sea, ["camera.velocity_m_s=[1.0, 0.0, 0.0]"])
    alone = LoadedAerial.of(scene).picture(0.1)
    np.testing.assert_array_equal(parts["beauty"]["RGB"], alone.image_linear)
    np.testing.assert_array_equal(parts["normal"]["N.Y"], alone.normal[..., 1].astype(np.float32))
    np.testing.assert_array_equal(parts["water"]["Z"], alone.in_water_m.astype(np.float32))
    assert aerial(sea, tmp_path / "still.png")[0] == 0
    assert cv2.imread(str(tmp_path / "still.png")).shape == (8, 16, 3)
    code, _, err = aerial(sea, tmp_path / "still.png")
    assert code == 2
    assert "already there" in err
    assert aerial(sea, tmp_path / "still.png", "--overwrite")[0] == 0


def test_videos_are_marked_as_spheres_where_they_are(sea: Path, tmp_path: Path) -> None:
    counted: list[tuple[int, int | None]] = []
    report = aerial_film(load_aerial(sea), tmp_path / "a.mp4", progress=lambda *at: counted.append(at))
    assert (report.frames, counted) == (3, [(1, 3), (2, 3), (3, 3)])
    assert read_spherical(tmp_path / "a.mp4") is None
    data = (tmp_path / "a.mp4").read_bytes()
    assert data.index(b"moov") < data.index(b"mdat")
    with open_video(tmp_path / "a.mp4", equirectangular=False) as video:
        assert (video.width, video.height, video.frame_rate, len(list(video.frames()))) == (16, 8, 10, 3)
    around = load_aerial(sea, ["camera.projection=equirectangular"])
    aerial_film(around, tmp_path / "b.mp4", frames=(0, 1))
    assert read_spherical(tmp_path / "b.mp4") is not None


def test_every_problem_of_a_scene_is_told_at_once(tmp_path: Path, aerial: Run) -> None:
    lines = [
        "[camera]", "position_m = [0.0, -2.0, 0.0]", "fov_deg = 400", "[sea]", "wind_sped = 3.0", "[sky]",
        'kind = "map"', "[floor]", "albedo = 1.5", "[water]", 'mode = "tabel"', "[reflection]", "gain = -1.0",
    ]  # fmt: skip
    (tmp_path / "sea.toml").write_text("\n".join(lines))
    code, _, err = aerial(tmp_path / "sea.toml", tmp_path / "a.png")
    assert code == 2
    for place in (
        "2 camera.position_m - must be over the water", "3 camera.fov_deg - must be in", "5 sea.wind_sped - unknown",
        "6 sky - map - kind map needs a picture", "9 floor.albedo - must lie in [0, 1]", "11 water.mode - must be",
        "13 reflection.gain - must be",
    ):  # fmt: skip
        assert f"sea.toml:{place}" in err
    assert "7 problems" in err
    assert not list(tmp_path.glob("*a.png*"))


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("a.png", ["--frames", "0:2"], "one picture cannot hold several frames"),
        ("a_%d.png", ["--frames", "2:9"], "outside of the film"),
        ("a.mp4", ["--set", "camera.width=15"], "must be even for a video"),
        ("a.xyz", [], "not known"),
        ("nowhere/a.png", [], "folder is missing"),
        ("a.png", ["--set", "camera.projection=equirectangular", "--set", "camera.width=15"], "twice as wide as high"),
        ("a.png", ["--set", "floor.ground=picture", "--set", "floor.picture=nix.png"], "no such file"),
        ("sea.toml", [], "which this run reads"),
    ],
)
def test_bad_input(name: str, options: list[str], message: str, sea: Path, tmp_path: Path, aerial: Run) -> None:
    code, _, err = aerial(sea, tmp_path / name, *options)
    assert code == 2
    assert message in err
    assert [p.name for p in tmp_path.iterdir()] == ["sea.toml"]


def test_inputs_are_kept(sea: Path, tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "ground.png"), np.full((8, 8, 3), 99, np.uint8))
    scene = load_aerial(sea, ["floor.ground=picture", "floor.picture=ground.png"])
    with pytest.raises(VideoError, match="which this run reads"):
        aerial_film(scene, tmp_path / "ground.png", overwrite=True)


def test_a_film_that_fails_leaves_nothing(sea: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object) -> None:
        raise VideoError("no")

    monkeypatch.setattr(LoadedAerial, "picture", fails)
    for name in ("a.mp4", "a_%d.exr", "a_%d.png"):
        with pytest.raises(VideoError, match="no"):
            aerial_film(load_aerial(sea), tmp_path / name)
    assert [p.name for p in tmp_path.iterdir()] == ["sea.toml"]


def test_gerstner_seas_are_chosen_by_name(sea: Path) -> None:
    assert load_aerial(sea).sea.model == "spectral"
    assert AerialScene.model_validate({"sea": {"model": "gerstner", "wind_speed": 3.0}}).sea.model == "gerstner"
    with pytest.raises(SceneError, match=r"--set sea\.wind_speed - must be"):
        load_aerial(sea, ["sea.wind_speed=-1"])


def test_the_schema_of_these_scenes(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(sys, "argv", ["mr360uw", "schema", "--aerial"])
    with pytest.raises(SystemExit):
        cli.main()
    schema = json.loads(capsys.readouterr().out)
    assert schema["properties"].keys() == {field.alias or name for name, field in AerialScene.model_fields.items()}
