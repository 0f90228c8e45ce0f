# SPDX-License-Identifier: Apache-2.0
"""Pipes, JSON that is none and numbers out of all bounds: refused at once; odd ones that are legal: in silence."""

from __future__ import annotations

import os

import cv2
import numpy as np
import pytest

from mr360uw.base.files import make_work_folder
from mr360uw.runs.work_folder import work_path
from mr360uw.video import write_exr
from tests.composite.gltf_files import one_square
from tests.hostile.bench import Bench
from tests.video.clips import write_clip

DEEP = "[" * 100_000
NO_JSON = {"deep": DEEP, "binary": b"\xff\xfe\x00\x01", "a list": "[]"}
POSES = "time_s,x,y,z,qx,qy,qz,qw\n" + "".join(f"{k / 25},{k / 10},0,0,0,0,0,1\n" for k in range(4))
posix = pytest.mark.skipif(os.name != "posix", reason="makes pipes")


@posix
@pytest.mark.parametrize("more", [(), ("--overwrite",)])
def test_a_pipe_where_the_report_goes_is_refused(more: tuple[str, ...], bench: Bench) -> None:
    os.mkfifo(bench.folder / "out.png.json")
    says = "out.png.json - is a device, a pipe or a socket"
    bench.refuses("composite", "scene.toml", "out.png", "--backend", "reference", *more, says=(says,))


READ_AND_WAITED_FOR = {
    "solved path": ("track", "--from", "pipe", "-o", "o.csv"),
    "mask": ("track", "plate.png", "--mask", "pipe", "-o", "o.csv"),
    "log of depths": ("track", "plate.png", "--depth-log", "pipe", "-o", "o.csv"),
    "track of a floor": ("floor", "pipe", "-o", "o.glb"),
    "track of distances": ("depth", "plate.png", "-o", "maps", "--track", "pipe"),
    "maps of a new scene": ("new", "plate.png", "mesh.glb", "--depth", "pipe", "-o", "new.toml"),
    "earlier measurements": ("bench", "--against", "pipe"),
    "scene from above": ("aerial", "pipe", "o.png"),
}


@posix
def test_pipes_are_refused_before_they_are_opened(bench: Bench, subtests: pytest.Subtests) -> None:
    os.mkfifo(bench.folder / "pipe")
    for name, arguments in READ_AND_WAITED_FOR.items():
        with subtests.test(name):
            bench.refuses(*arguments, says=("pipe - is a device, a pipe or a socket",))


@pytest.mark.parametrize("kind", NO_JSON)
def test_json_that_is_none(kind: str, bench: Bench, subtests: pytest.Subtests) -> None:
    bench.put("no.json", NO_JSON[kind])
    bench.put("no.csv", POSES)
    bench.put("out.png.json", NO_JSON[kind])
    write_clip(bench.folder / "clip.mp4", 4, size=(512, 256))
    (bench.folder / "maps").mkdir()
    bench.put("maps/depth.json", NO_JSON[kind])
    bench.put("maps/depth_00000.exr", b"")
    for name, arguments, says in [
        ("report of another program", ("composite", "scene.toml", "out.png"), "is already there"),
        ("track of a floor", ("floor", "no.json", "-o", "o.glb"), "no.json - "),
        ("solved path", ("track", "--from", "no.json", "-o", "o.csv"), "no.json - "),
        ("floor of a new scene", ("new", "clip.mp4", "mesh.glb", "--track", "no.csv", "-o", "n.toml"), "no.json - "),
        ("note of maps", ("depth", "clip.mp4", "-o", "maps", "--track", "no.csv", "--width", "512"), "maps - holds"),
    ]:
        with subtests.test(name):
            bench.refuses(*arguments, says=(says,))


def test_keys_of_a_stopped_run_that_cannot_be_read_are_those_of_another(bench: Bench) -> None:
    folder = work_path(bench.folder / "out.png")
    make_work_folder(folder)
    (folder / "run.json").write_text(DEEP)
    code, _, err = bench.run("composite", "scene.toml", "out.png", "--backend", "reference")
    assert (code, err) == (0, "")


@pytest.mark.parametrize(
    ("setting", "place"),
    [
        ("object.0.key=[{time_s=-1e308,scale=1.0},{time_s=0,scale=3.0},{time_s=1e308,scale=2.0}]", "key[0].time_s"),
        ('keys=[{parameter="camera.depth_m",time_s=[0,1e308],value=[1,2]}]', "keys[0].time_s"),
        ("lamp=[{power_w=10.0,key=[{time_s=1e308}]}]", "time_s"),
    ],
)
def test_times_that_no_clip_has(setting: str, place: str, bench: Bench) -> None:
    bench.refuses_with(setting, says=(place,))


def test_a_track_with_times_that_no_clip_has(bench: Bench) -> None:
    bench.put("track.csv", POSES + "1e308,0,0,0,0,0,0,1\n")
    bench.refuses_with('camera.track="track.csv"', says=("track.csv time_s - is no time of a clip (got 1e+308 s",))


def test_solved_paths_with_odd_numbers(bench: Bench, subtests: pytest.Subtests) -> None:
    label = "a" + "9" * 400
    for name, text in {
        "images.txt": "1 -- 0 0 0 . 0 0 1 a1.png\n\n",
        "cameras.xml": f'<document><chunk><camera label="{label}"><transform>{"1 0 0 0 0 " * 3}1</transform></camera>'
        "</chunk></document>",
    }.items():
        bench.put(name, text)
        with subtests.test(name):
            err = bench.refuses("track", "--from", name, "-o", "o.csv", "--fps", "25", says=(f"{name} - ",))
            assert "Warning" not in err


@pytest.mark.parametrize("digits", [20, 200])
def test_layers_that_are_numbered_far_apart(digits: int, bench: Bench) -> None:
    for number in ("0", "1" + "0" * digits):
        write_exr(bench.folder / f"l_{number}.exr", {"rgba": {"RGBA": np.zeros((4, 8, 4), np.float32)}})
    bench.refuses("layer", "l_%d.exr", "o.mov", says=("MR360UW_MAX_FRAMES",))


@pytest.mark.parametrize(
    ("name", "says"),
    [("bright.exr", "no light"), ("far.obj", "more than 1e+09 m"), ("dense.csv", "at most 10000")],
)
def test_numbers_that_no_picture_mesh_or_water_has(name: str, says: str, bench: Bench) -> None:
    if name.endswith("exr"):
        write_exr(bench.folder / name, np.full((32, 64, 3), 1e38, np.float32))
        setting = f'plate.path="{name}"'
    elif name.endswith("obj"):
        bench.put(name, "v 0 0 0\nv 1e308 0 0\nv 0 1e308 0\nf 1 2 3\n")
        setting = f'object.0.mesh="{name}"'
    else:
        bench.put(name, "wavelength_nm,absorption,scattering\n400,1e308,0.1\n700,0.1,0.1\n")
        setting = f'water={{type="csv", csv="{name}"}}'
    with np.errstate(all="raise"):
        bench.refuses_with(setting, says=(says,))


def test_an_animation_that_hides_its_body_all_along(bench: Bench) -> None:
    file = one_square()
    file.clip((0, "scale", [0, 1], [[0, 0, 0], [0, 0, 0]]))
    file.write(bench.folder / "mesh.glb")
    code, _, err = bench.run("composite", "scene.toml", "out.png", "--backend", "reference")
    assert (code, err) == (0, "")


@pytest.mark.parametrize("size", [(4, 2), (2, 1)])
def test_plates_of_a_few_pixels(size: tuple[int, int], bench: Bench) -> None:
    cv2.imwrite("plate.png", np.full((size[1], size[0], 3), 90, np.uint8))
    given = ("--set", 'water.type="IB"', "--set", 'receiver={kind="plane"}', "--set", "draw.quality=draft")
    code, _, err = bench.run("composite", "scene.toml", "out.png", "--backend", "reference", *given)
    assert (code, err) == (0, "")


def test_a_damaged_texture_is_refused_without_noise(bench: Bench, recwarn: pytest.WarningsRecorder) -> None:
    bench.put("cut.tif", bench.material.files["plate.tif"][:400])
    bench.refuses_with('object.0.texture="cut.tif"', says=("cut.tif - a texture cannot be read",))
    assert [str(one.message) for one in recwarn] == []
