# SPDX-License-Identifier: Apache-2.0
"""Input that once gave a wrong picture, a traceback or no end: each is refused with its place."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from mr360uw.base.disk_cache import read_arrays
from mr360uw.cli.arguments import frame_range
from mr360uw.errors import ParameterError
from tests.composite.gltf_files import one_square
from tests.hostile.bench import Bench

PLY = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face 2
property list uchar int vertex_indices
end_header
0 0 0
1 0 0
0 1 0
5 5 5
3 0 1 2
3 0 1 {}
"""


def test_faces_name_vertices_that_are_there(bench: Bench) -> None:
    for index, says in ((-1, "got -1 of 4"), (4, "got 4 of 4")):
        bench.put("bad.ply", PLY.format(index))
        bench.refuses_with('object.0.mesh="bad.ply"', says=("bad.ply", says))
    file = one_square()
    indices = file.accessor(np.array([0, 1, -1], np.int16), "i2")
    file.tree["meshes"][0]["primitives"][0]["indices"] = indices
    file.write(bench.folder / "bad.glb")
    bench.refuses_with('object.0.mesh="bad.glb"', says=("bad.glb", "index -1 of 4"))


@pytest.mark.parametrize(
    ("node", "values", "times", "says"),
    [
        (7, [[0, 0, 0], [1, 0, 0]], (0, 1), "index out of range"),
        (0, [[3e38, 0, 0], [-3e38, 0, 0]], (0, 1), "too large (got 3e+38)"),
        (0, [[0, 0, 0], [1, 0, 0]], (0, 3e38), "at no time"),
    ],
)
def test_animations(node: int, values: list[list[float]], times: tuple[float, float], says: str, bench: Bench) -> None:
    file = one_square()
    sampler = {"input": file.accessor(np.array(times)), "output": file.accessor(np.array(values, np.float32))}
    channel = {"sampler": 0, "target": {"node": node, "path": "translation"}}
    file.tree["animations"] = [{"samplers": [sampler], "channels": [channel]}]
    file.write(bench.folder / "moves.glb")
    bench.refuses_with('object.0.mesh="moves.glb"', says=("moves.glb", says))


@pytest.mark.parametrize(
    ("name", "text", "options", "says"),
    [
        ("a.chan", "nan 0 0 0 0 0 0\n2 0 0 -1 0 0 0\n", ("--fps", "24"), "no numbers"),
        ("a.chan", "1 0 0 0 nan 0 0\n2 0 0 -1 0 0 0\n", ("--fps", "24"), "no rotation"),
        ("a.chan", "1 1e300 0 0 0 0 0\n2 0 0 -1 0 0 0\n", ("--fps", "24"), "too far away"),
        ("a.chan", "1 0 0 0 0 0 0\n2 0 0 -1 0 0 0\n", ("--fps", "24", "--scale", "0"), "--scale - must be more"),
        ("a.chan", "1 0 0 0 0 0 0\n2 0 0 -1 0 0 0\n", ("--fps", "24", "--scale", "-1"), "--scale - must be more"),
        ("a.chan", "1 0 0 0 0 0 0\n2 0 0 -1 0 0 0\n", ("--fps", "1e-320"), "--fps - must be more than 0"),
        ("a.json", '{"blender_frames":' + "[" * 100_000 + "]" * 100_000 + "}", (), "no path from Blender"),
    ],
)  # fmt: skip
def test_paths_of_cameras(name: str, text: str, options: tuple[str, ...], says: str, bench: Bench) -> None:
    bench.put(name, text)
    bench.refuses("track", "--from", name, "-o", "t.csv", *options, says=(says,))


@pytest.mark.parametrize(
    ("setting", "says"),
    [
        ("object.0.key=[{time_s=0,position_m=[3e38,0,0]}]", "object[0].key[0].position_m[0] - must be"),
        ("object.0.rotation_deg=[3e38,0,0]", "object[0].rotation_deg[0] - must be"),
        ("object.0.position_m=[0,1e300,0]", "object[0].position_m[1] - must be"),
        ("object.0.scale=1e-300", "object[0].scale - must be"),
        ("sea.explicit_waves=[{wave_vector=[0,0],amplitude_m=0.1}]", "wave_vector - must have a length"),
    ],
)
def test_settings(setting: str, says: str, bench: Bench) -> None:
    bench.refuses_with('water.type="II"', setting, says=(says,))


def test_counts_have_limits_before_memory_is_taken(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MR360UW_MAX_OBJECTS", "0.000002")
    bench.refuses_with('object=[{mesh="mesh.glb"},{mesh="mesh.glb"},{mesh="mesh.glb"}]', says=("MR360UW_MAX_OBJECTS",))
    monkeypatch.delenv("MR360UW_MAX_OBJECTS")
    monkeypatch.setenv("MR360UW_MAX_PARTICLES", "0.000001")
    snow = ("snow.amount=100", "snow.sizes_mm=[0.05, 4]", "snow.range_m=50")
    bench.refuses_with('water.type="II"', *snow, says=("MR360UW_MAX_PARTICLES",))


def test_words_of_the_command_line(bench: Bench) -> None:
    for text in ("", " ", ":0"):
        with pytest.raises(ParameterError, match="--frames"):
            frame_range(text)
    assert frame_range(":") == (0, None)
    for time in ("nan", "inf", "-1"):
        bench.refuses(
            "still", "scene.toml", "out.png", "--time", time, says=(f"time_s - is no time of a clip (got {time}",)
        )
    pytest.importorskip("distributed", reason="needs the extra farm")
    for address in ("ucx://localhost:8786", "inproc://x"):
        bench.refuses("composite", "scene.toml", "out.png", "--dask", address, says=("--dask", address))


def test_a_kept_file_of_another_kind_under_a_right_hash_is_made_anew(tmp_path: Path) -> None:
    import hashlib

    for data in (b"", b"text", b"\x93NUMPY", b"PK\x03\x04 no archive"):
        (tmp_path / "kept.npz").write_bytes(data + hashlib.sha256(data).digest())
        assert read_arrays(tmp_path / "kept.npz") is None


CONFIG = """ocio_profile_version: 2
search_path: .
roles:
  default: lin
  scene_linear: lin
file_rules:
  - !<Rule> {name: Default, colorspace: default}
displays:
  d:
    - !<View> {name: v, colorspace: lin}
colorspaces:
  - !<ColorSpace>
    name: lin
  - !<ColorSpace>
    name: missing
    to_scene_reference: !<FileTransform> {src: none.cube}
  - !<ColorSpace>
    name: device
    to_scene_reference: !<FileTransform> {src: endless.cube}
  - !<ColorSpace>
    name: clamped
    to_scene_reference: !<RangeTransform> {min_in_value: 0.2, max_in_value: 0.4, min_out_value: 0.2, max_out_value: 0.4}
  - !<ColorSpace>
    name: curved
    to_scene_reference: !<ExponentTransform> {value: [2.2, 2.2, 2.2, 1]}
"""


def test_colour_spaces_come_back(bench: Bench) -> None:
    bench.put("a.ocio", CONFIG)
    if os.name == "posix":
        (bench.folder / "endless.cube").symlink_to("/dev/zero")
        (bench.folder / "endless.ocio").symlink_to("/dev/zero")
        bench.refuses_with('plate.ocio={input="lin",working="lin",config="endless.ocio"}', says=("is a device",))
    for space, says in (("missing", "none.cube - no such file"), ("device", "is a device"), ("clamped", "come back")):
        bench.refuses_with(f'plate.ocio={{input="{space}",working="lin",config="a.ocio"}}', says=(says,))
    code, _, err = bench.run("composite", "scene.toml", "out.png", "--backend", "reference", "--set",
                             'plate.ocio={input="curved",working="lin",config="a.ocio"}')  # fmt: skip
    assert (code, err) == (0, "")
