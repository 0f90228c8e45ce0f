# SPDX-License-Identifier: Apache-2.0
"""Arguments of the command line, names of files, and environment variables."""

from __future__ import annotations

import os
import socket
from pathlib import Path

import cv2
import numpy as np
import pytest

from mr360uw.base.input_files import LIMITS
from tests.hostile.bench import SCENE, Bench
from tests.video.clips import write_clip

ARGUMENTS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "nothing": (("composite",), ("'scene'",)),
    "no output": (("composite", "scene.toml"), ("'out'",)),
    "unknown command": (("render", "scene.toml"), ("render",)),
    "unknown option": (("composite", "scene.toml", "out.png", "--quality", "5"), ("--quality",)),
    "no scene": (("composite", "none.toml", "out.png"), ("none.toml", "mr360uw new")),
    "scene that is a folder": (("composite", ".", "out.png"), ("is a folder",)),
    "scene that is the plate": (("composite", "plate.png", "out.png"), ("plate.png", "UTF-8")),
    "frames backwards": (("composite", "scene.toml", "out_%04d.png", "--frames", "5:3"), ("--frames", "'5:3'")),
    "frames of nothing": (("composite", "scene.toml", "out_%04d.png", "--frames", "3:3"), ("--frames",)),
    "frames before the first": (("composite", "scene.toml", "out_%04d.png", "--frames=-2:3"), ("--frames",)),
    "frames in words": (("composite", "scene.toml", "out_%04d.png", "--frames", "all"), ("--frames",)),
    "frames of three": (("composite", "scene.toml", "out_%04d.png", "--frames", "1:2:3"), ("--frames",)),
    "frames of a number": (("composite", "scene.toml", "out_%04d.png", "--frames", "0:1e3"), ("--frames",)),
    "frames of many digits": (("composite", "scene.toml", "out_%04d.png", "--frames", "9" * 5000), ("--frames",)),
    "frames without end": (
        ("composite", "scene.toml", "out_%04d.png", "--frames", "0:999999999999"), ("MR360UW_MAX_FRAMES",),
    ),
    "several frames in one still": (
        ("composite", "scene.toml", "out.png", "--frames", "0:3"), ("one picture cannot hold several", "out_%04d.png"),
    ),
    "unknown renderer": (("composite", "scene.toml", "out.png", "--backend", "vulkan"), ("vulkan",)),
    "workers of zero": (("composite", "scene.toml", "out.png", "--workers", "0"), ("--workers",)),
    "workers of less": (("composite", "scene.toml", "out.png", "--workers=-1"), ("--workers",)),
    "workers in words": (("composite", "scene.toml", "out.png", "--workers", "many"), ("--workers",)),
    "layers without number": (("composite", "scene.toml", "out.png", "--layers", "layer.exr"), ("layer.exr",)),
    "layers of PNG": (("composite", "scene.toml", "out.png", "--layers", "l_%04d.png"), ("l_%04d.png",)),
    "layers over the output": (
        ("composite", "scene.toml", "out_%04d.exr", "--layers", "out_%04d.exr"), ("is the name of another output",),
    ),
    "output over the plate": (("composite", "scene.toml", "plate.png", "--overwrite"), ("which this run reads",)),
    "output over the mesh": (("composite", "scene.toml", "mesh.glb", "--overwrite"), ("which this run reads",)),
    "output that is there": (("composite", "scene.toml", "there.png"), ("there.png", "already there")),
    "output that is a folder": (("composite", "scene.toml", "."), ("folder",)),
    "output nowhere": (("composite", "scene.toml", "no/where/out.png"), ("folder is missing",)),
    "output below a file": (("composite", "scene.toml", "plate.png/out.png"), ("plate.png",)),
    "output of no kind": (("composite", "scene.toml", "out"), ("out",)),
    "output of another kind": (("composite", "scene.toml", "out.gif"), ("out.gif",)),
    "output of a long name": (("composite", "scene.toml", "o" * 300 + ".png"), ("name",)),
    "output with a zero": (("composite", "scene.toml", "o\0.png"), ("null",)),
    "output without a name": (("composite", "scene.toml", ""), ("folder",)),
    "report nowhere": (("composite", "scene.toml", "out.png", "--report", "no/where.json"), ("folder is missing",)),
    "report over the plate": (("composite", "scene.toml", "out.png", "--report", "plate.png"), ("already there",)),
    "report over a folder": (("composite", "scene.toml", "out.png", "--report", "."), ("is a folder",)),
    "setting without value": (("composite", "scene.toml", "out.png", "--set", "camera.depth_m"), ("key=value",)),
    "setting without key": (("composite", "scene.toml", "out.png", "--set", "=8"), ("key=value",)),
    "setting of dots": (("composite", "scene.toml", "out.png", "--set", "..=8"), ("unknown key",)),
    "setting of no object": (("composite", "scene.toml", "out.png", "--set", "object[3].scale=2"), ("no such entry",)),
    "setting before the first": (("composite", "scene.toml", "out.png", "--set", "object[-1].scale=2"), ("object",)),
    "setting of a far object": (
        ("composite", "scene.toml", "out.png", "--set", "object[" + "9" * 5000 + "].scale=2"), ("object",),
    ),
    "setting of a strange digit": (("composite", "scene.toml", "out.png", "--set", "object.²=2"), ("object",)),
    "setting of all objects": (("composite", "scene.toml", "out.png", "--set", "object.scale=2"), ("which one",)),
    "setting in brackets": (("composite", "scene.toml", "out.png", "--set", "object[0].scale=0"), ("object[0].scale",)),
    "setting of a word's key": (("composite", "scene.toml", "out.png", "--set", "plate.path.x=2"), ("plate",)),
    "setting that is deep": (("composite", "scene.toml", "out.png", "--set", "a=" + "[" * 5000), ("a",)),
    "setting of two lines": (("composite", "scene.toml", "out.png", "--set", "water.type=1\n[sea]"), ("water.type",)),
    "setting of truth": (("composite", "scene.toml", "out.png", "--set", "camera.depth_m=true"), ("(got true)",)),
    "no video": (("new", "none.mp4", "mesh.glb", "-o", "new.toml"), ("none.mp4",)),
    "no mesh": (("new", "plate.png", "none.glb", "-o", "new.toml"), ("none.glb",)),
    "mesh for video": (("new", "mesh.glb", "plate.png", "-o", "new.toml"), ("mesh.glb",)),
    "new over the old": (("new", "plate.png", "mesh.glb", "-o", "scene.toml"), ("--overwrite",)),
    "new of an axis that is none": (("new", "plate.png", "mesh.glb", "-o", "new.toml", "--up", "w"), ("--up", "-z")),
    "new of another kind": (("new", "plate.png", "mesh.glb", "-o", "new.json"), (".toml",)),
    "new nowhere": (("new", "plate.png", "mesh.glb", "-o", "no/where.toml"), ("folder is missing",)),
    "third eye": (("new", "plate.png", "mesh.glb", "-o", "new.toml", "--eye", "third"), ("third",)),
    "eye of a mono plate": (("new", "plate.png", "mesh.glb", "-o", "new.toml", "--eye", "left"), ("not stereo",)),
    "clean nowhere": (("clean", "nowhere"), ("is no folder",)),
    "clean a file": (("clean", "plate.png"), ("is no folder",)),
    "sample of no width": (("sample", "dive", "--width", "0"), ("width",)),
    "sample of an odd width": (("sample", "dive", "--width", "1023"), ("width",)),
    "sample of less": (("sample", "dive", "--width=-64"), ("width",)),
    "sample of all widths": (("sample", "dive", "--width", "4000000"), ("MR360UW_MAX_PICTURE",)),
    "sample of no frames": (("sample", "dive", "--frames", "0"), ("frames",)),
    "sample of all frames": (("sample", "dive", "--frames", "99999999999"), ("MR360UW_MAX_FRAMES",)),
    "sample of half a frame": (("sample", "dive", "--frames", "1.5"), ("--frames",)),
    "sample of no water": (("sample", "dive", "--water", "mud"), ("mud",)),
    "sample of no depth": (("sample", "dive", "--depth", "nan"), ("depth",)),
    "sample above the water": (("sample", "dive", "--depth=-3"), ("depth",)),
    "sample in the sand": (("sample", "dive", "--floor", "2"), ("floor",)),
    "sample at night": (("sample", "dive", "--sun-elevation=-10"), ("sun_elevation_deg",)),
    "sample without sun": (("sample", "dive", "--sun-azimuth", "nan"), ("sun_azimuth_deg",)),
    "sample in a storm": (("sample", "dive", "--wind", "inf"), ("wind",)),
    "sample at speed": (("sample", "dive", "--speed", "nan"), ("speed",)),
    "sample of a seed below": (("sample", "dive", "--seed=-1"), ("seed",)),
    "sample over a file": (("sample", "plate.png"), ("plate.png",)),
    "analysis of nothing": (("analyse", "none.mp4"), ("none.mp4",)),
    "analysis of another kind": (("analyse", "plate.png", "-o", "page.pdf"), (".html",)),
    "analysis of a folder": (("analyse", "."), (".",)),
    "caustics of no frames": (("caustics", "scene.toml", "maps", "--frames", "0"), ("frames",)),
    "caustics of all frames": (("caustics", "scene.toml", "maps", "--frames", "99999999999"), ("MR360UW_MAX_FRAMES",)),
    "caustics of no time": (("caustics", "scene.toml", "maps", "--loop-s", "0"), ("loop_s",)),
    "caustics of time back": (("caustics", "scene.toml", "maps", "--loop-s=-1"), ("loop_s",)),
    "caustics of nan": (("caustics", "scene.toml", "maps", "--loop-s", "nan"), ("loop_s",)),
    "caustics in the air": (("caustics", "scene.toml", "maps", "--depth-m=-1"), ("depth_m",)),
    "caustics of another kind": (("caustics", "scene.toml", "maps", "--format", "gif"), ("gif",)),
    "caustics over a file": (("caustics", "scene.toml", "plate.png"), ("plate.png",)),
}  # fmt: skip


def test_arguments(bench: Bench, subtests: pytest.Subtests) -> None:
    bench.put("there.png", bench.material.files["plate.png"])
    for name, (arguments, says) in ARGUMENTS.items():
        given = '[light]\nsun = "given"\n[caustics]\nsize = 16\ngrid = 4\n' if arguments[0] == "caustics" else ""
        bench.put("scene.toml", SCENE + given)
        with subtests.test(name):
            bench.refuses(*arguments, says=says)


PLATES = {
    "address": "tcp://127.0.0.1:9/plate.mp4",
    "address of a picture": "http://127.0.0.1:9/plate.png",
    "address of a file": "file:plate.png",
    "pipe of FFmpeg": "pipe:0",
    "several files": "concat:plate.png|plate.png",
    "generated pictures": "testsrc.lavfi",
    "subfile": "subfile,,start,0,end,0,,:plate.png",
    "device of a camera": "/dev/null",
    "endless device": "/dev/zero",
    "folder": ".",
    "nothing": "",
    "nowhere": "no/where.mp4",
    "below a file": "plate.png/plate.png",
    "long name": "p" * 300 + ".png",
    "pattern of nothing": "none_%04d.png",
    "pattern of another kind": "plate_%s.png",
    "wildcard of nothing": "none_*.png",
    "pipe": "pipe.mp4",
    "pipe of pictures": "pipe.png",
    "socket": "socket.png",
    "circle of links": "circle.png",
    "link to nothing": "gone.png",
}


def put_odd_files(bench: Bench) -> None:
    for name in ("pipe.mp4", "pipe.png", "pipe.exr", "pipe.glb", "pipe.csv", "pipe.toml"):
        os.mkfifo(bench.folder / name)
    (bench.folder / "circle.png").symlink_to("circle.png")
    (bench.folder / "gone.png").symlink_to("nowhere.png")
    if not (bench.folder / "socket.png").exists():
        with socket.socket(socket.AF_UNIX) as made:
            made.bind("socket.png")  # relative: its path may be too long else


@pytest.mark.skipif(os.name != "posix", reason="makes pipes and sockets")
def test_plates_that_are_no_files(bench: Bench, subtests: pytest.Subtests) -> None:
    put_odd_files(bench)
    for name, plate in PLATES.items():
        found_later = any(sign in plate for sign in "%*")
        with subtests.test(name):
            bench.refuses_with(f'plate.path="{plate}"', says=(plate if found_later else "--set plate.path - ",))


@pytest.mark.skipif(os.name != "posix", reason="makes pipes and sockets")
def test_other_inputs_that_are_no_files(bench: Bench, subtests: pytest.Subtests) -> None:
    put_odd_files(bench)
    for setting, place in [
        ('object.0.mesh="pipe.glb"', "object[0].mesh"),
        ('object.0.mesh="/dev/zero"', "object[0].mesh"),
        ('object.0.texture="pipe.png"', "object[0].texture"),
        ('object.0.texture="socket.png"', "object[0].texture"),
        ('object.0.texture="circle.png"', "object[0].texture"),
        ('receiver={kind="mesh", path="pipe.glb"}', "receiver.path"),
        ('receiver={kind="height_map", path="pipe.png"}', "receiver.path"),
        ('receiver={kind="distance", path="pipe.exr"}', "receiver.path"),
        ('holdout=[{path="pipe.png"}]', "holdout[0].path"),
        ('camera.track="pipe.csv"', "camera.track"),
        ('camera.gravity="/dev/urandom"', "camera.gravity"),
        ('light.track="pipe.csv"', "light.track"),
        ('water={type="csv", csv="pipe.csv"}', "water.csv"),
        ('water={sensor="pipe.csv"}', "water.sensor"),
    ]:
        with subtests.test(place):
            bench.refuses_with(setting, says=(f"{place} - ",))


@pytest.mark.skipif(os.name != "posix", reason="makes pipes")
@pytest.mark.parametrize(
    "arguments",
    [
        ("composite", "pipe.toml", "out.png"), ("check", "/dev/zero"), ("analyse", "pipe.toml"),
        ("analyse", "pipe.mp4"), ("new", "pipe.mp4", "mesh.glb", "-o", "new.toml"),
        ("new", "plate.png", "pipe.glb", "-o", "new.toml"),
    ],
)  # fmt: skip
def test_arguments_that_are_no_files(arguments: tuple[str, ...], bench: Bench) -> None:
    put_odd_files(bench)
    bench.refuses(*arguments, says=("device, a pipe or",) if "mp4" not in arguments[1] else ("pipe",))


PLAYLISTS = {
    "list.m3u8": "#EXTM3U\n#EXT-X-TARGETDURATION:10\n#EXTINF:10,\nplate.mp4\n#EXT-X-ENDLIST\n",
    "list.mp4": "#EXTM3U\n#EXTINF:10,\nfile:///etc/hostname\n#EXT-X-ENDLIST\n",
    "concat.mp4": "ffconcat version 1.0\nfile plate.mp4\n",
    "concat.txt": "ffconcat version 1.0\nfile /etc/hostname\n",
    "cast.mpd": '<?xml version="1.0"?><MPD xmlns="urn:mpeg:dash:schema:mpd:2011"></MPD>',
    "stream.sdp": "v=0\no=- 0 0 IN IP4 127.0.0.1\ns=x\nc=IN IP4 127.0.0.1\nm=video 9 RTP/AVP 96\n",
    "drawing.svg": '<svg xmlns="http://www.w3.org/2000/svg"><image href="file:///etc/hostname"/></svg>',
}


def test_files_that_name_other_files_are_no_plates(bench: Bench, subtests: pytest.Subtests) -> None:
    for name, text in PLAYLISTS.items():
        with subtests.test(name):
            bench.put(name, text)
            bench.refuses_with(f'plate.path="{name}"', says=(name,))


@pytest.mark.parametrize("name", ["a:b", "50%", "100%d", "file:x", "tcp:x", "a b", "ü", "-", "#1", "'", "x\ty"])
def test_names_with_signs_are_names_like_others(name: str, bench: Bench) -> None:
    plate = bench.put(f"./{name}.png", bench.material.files["plate.png"])
    mesh = bench.put(f"./{name}.glb", bench.material.files["mesh.glb"])
    code, _, err = bench.run("new", f"./{plate.name}", f"./{mesh.name}", "-o", "new.toml")
    assert (code, err) == (0, "")
    code, out, err = bench.run("composite", "new.toml", f"./{name}.out.png", "--explain", "--backend", "reference",
                               "--set", "water.type=none")  # fmt: skip
    assert (code, err) == (0, "")
    assert plate.name in out


@pytest.mark.parametrize("name", ["\x1b[31m", "\x07", "a\nb", "\x7f", '"', "\\", "\u2028", "\x01"])
def test_new_writes_names_with_control_characters_so_that_they_are_read_again(name: str, bench: Bench) -> None:
    from mr360uw.scene.model import load_scene

    plate = bench.put(f"{name}.png", bench.material.files["plate.png"])
    mesh = bench.put(f"{name}.glb", bench.material.files["mesh.glb"])
    code, _, err = bench.run("new", plate, mesh, "-o", "new.toml")
    assert (code, err) == (0, "")
    scene = load_scene("new.toml")
    assert scene.plate.path.resolve() == plate.resolve()
    assert scene.objects[0].mesh.resolve() == mesh.resolve()
    err = (
        bench.refuses("new", plate, f"{name}.none.glb", "-o", "new2.toml", says=(".none.glb",))
        if "\n" not in name
        else ""
    )
    assert all(c.isprintable() or c == "\n" for c in err)


@pytest.mark.skipif(os.name != "posix", reason="file names of bytes")
def test_names_that_are_no_text_are_refused(bench: Bench) -> None:
    name = os.fsdecode(b"\xff\xfe.png")
    (bench.folder / name).write_bytes(bench.material.files["plate.png"])
    before = sorted(os.listdir(bench.folder))  # noqa: PTH208 - names of bytes
    code, _, err = bench.run("new", name, "mesh.glb", "-o", "new.toml")
    assert code == 2
    assert "UTF-8" in err
    assert sorted(os.listdir(bench.folder)) == before  # noqa: PTH208


def test_limits_that_are_no_numbers(bench: Bench, monkeypatch: pytest.MonkeyPatch, subtests: pytest.Subtests) -> None:
    needed = {"DATA": ['camera.track="track.csv"'], "PARTICLES": ['water.type="II"', "snow.amount=1"],
              "PRIMS": ['object.0.mesh="empty.usda"']}  # fmt: skip
    bench.put("track.csv", "time_s\n")
    bench.put("empty.usda", "#usda 1.0\n")
    for number, limit in enumerate(LIMITS):
        kind = limit.variable.removeprefix("MR360UW_MAX_")
        for value in ["many", "-1", "0", "nan", "inf", "1e999"][: None if number == 0 else 1]:  # all are read alike
            with subtests.test(limit.variable, value=value), monkeypatch.context() as patch:
                if kind == "PRIMS":
                    pytest.importorskip("pxr", reason="needs mr360uw[usd]")
                patch.setenv(limit.variable, value)
                settings = [*needed.get(kind, []), 'object.0.texture="plate.png"']
                bench.refuses_with(*settings, says=(limit.variable, f"got '{value}'"))


def test_limits_are_in_the_manual() -> None:
    text = (Path(__file__).parents[2] / "docs" / "running.md").read_text("utf-8")
    for limit in LIMITS:
        assert f"| `{limit.variable}` | {limit.default} million {limit.unit} | {limit.covers} |" in text


@pytest.mark.parametrize(
    ("variable", "value", "setting"),
    [
        ("MR360UW_MAX_PICTURE", "0.001", ""),
        ("MR360UW_MAX_DATA", "0.0001", ""),
        ("MR360UW_MAX_TRIANGLES", "0.000001", ""),
        ("MR360UW_MAX_TEXT", "0.00001", ""),
        ("MR360UW_MAX_DATA", "0.0001", 'receiver={kind="mesh", path="mesh.glb"}'),
        ("MR360UW_MAX_TEXTURE", "0.001", 'object.0.texture="plate.png"'),
        ("MR360UW_MAX_PICTURE", "0.001", 'holdout=[{path="clip.mp4"}]'),
        ("MR360UW_MAX_PICTURE", "0.001", 'receiver={kind="height_map", path="plate.png"}'),
        ("MR360UW_MAX_DATA", "0.01", 'plate.path="plate.exr"'),
        ("MR360UW_MAX_TEXT", "0.0001", 'camera.track="track.csv"'),
        ("MR360UW_MAX_TEXT", "0.0001", 'water={type="csv", csv="track.csv"}'),
    ],
)
def test_limits_are_kept_and_say_how_to_be_raised(
    variable: str, value: str, setting: str, bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(variable, value)
    bench.put("track.csv", "time_s\n" + "0\n" * 100)
    bench.put("plate.exr", bench.material.files["plate.exr"])
    if "clip" in setting:
        cv2.imwrite("plate.png", np.zeros((2, 4, 3), np.uint8))
        write_clip(bench.folder / "clip.mp4", 2)
    says = (f"set {variable} to allow more",)
    bench.refuses_with(*filter(None, [setting]), says=says)


def test_a_cache_that_cannot_be_written_is_done_without(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MR360UW_CACHE", str(bench.folder / "plate.png"))
    code, _, err = bench.run("composite", "scene.toml", "out.png", "--backend", "reference")
    assert code == 0
    assert err.startswith("note      cache - nothing new can be kept in ")
    assert err.count("\n") == 1
