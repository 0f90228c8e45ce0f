# SPDX-License-Identifier: Apache-2.0
"""Paths of other programs against poses that are known in closed form."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mr360uw.base.sphere import yaw_matrix
from mr360uw.composite import read_camera_track
from mr360uw.errors import ParameterError
from mr360uw.track.camera_track import CameraTrack
from mr360uw.track.path_files import blender_script, nuke_chan, read_solved_path, track_of

HALF = np.sqrt(0.5)
ROOT = f"{HALF:.9f}"
# Each file holds the same two poses: frame 1 stands level; by frame 3 the camera has gone 2 ahead, 1 to the right and
# 0.5 up, and has turned a quarter to the right.
COLMAP = f"""# Image list
1 1 0 0 0 -3 4 -5 1 dive_0001.jpg
10 20 -1
2 {ROOT} 0 -{ROOT} 0 7 4.5 -4 1 dive_0003.jpg

"""
"""World axes right, down, ahead; the first camera at (3, -4, 5): t = -R C, the second at (4, -4.5, 7)."""
METASHAPE = """<?xml version="1.0"?><document><chunk label="reef"><sensors/><cameras>
<camera id="0" label="f0001"><transform>1 0 0 3 0 0 1 7 0 -1 0 5 0 0 0 1</transform></camera>
<camera id="1" label="f0002"/>
<camera id="2" label="f0003"><transform>0 0 1 3.5 -1 0 0 8 0 -1 0 5.25 0 0 0 1</transform></camera>
</cameras>
<transform><rotation>1 0 0 0 1 0 0 0 1</rotation><translation>10 20 -5</translation><scale>2</scale></transform>
</chunk></document>"""
"""Chunk axes right, ahead, up, in halves of a metre."""
CHAN = "1 3 4 5 0 0 0 40\n3 4 4.5 3 0 -90 0 40\n"
NUKE_CSV = "frame,tx,ty,tz,rx,ry,rz\n1,3,4,5,0,0,0\n3,4,4.5,3,0,-90,0\n"
BLENDER_CSV = f"""blender_frame,x,y,z,qw,qx,qy,qz
1,3,4,5,{ROOT},{ROOT},0,0
3,4,6,5.5,0.5,0.5,-0.5,-0.5
"""
"""A level camera is turned up by a quarter: (w, x) = (sqrt 1/2, sqrt 1/2)."""
BLENDER = json.dumps({
    "fps": 24, "blender_frames": [
        {"frame": 1, "matrix_world": [[1, 0, 0, 3], [0, 0, -1, 4], [0, 1, 0, 5], [0, 0, 0, 1]]},
        {"frame": 3, "matrix_world": [[0, 0, -1, 4], [-1, 0, 0, 6], [0, 1, 0, 5.5], [0, 0, 0, 1]]},
    ],
})  # fmt: skip
OWN = f"time_s,x,y,z,qx,qy,qz,qw\n0,3,4,5,0,0,0,1\n{2 / 24:.9f},4,4.5,3,0,-{ROOT},0,{ROOT}\n"
FILES = {
    "COLMAP images.txt": COLMAP, "Metashape cameras": METASHAPE, "Nuke or SynthEyes path": CHAN, "Nuke or": NUKE_CSV,
    "Blender": BLENDER_CSV, "Blender path": BLENDER, "mr360uw track": OWN,
}  # fmt: skip


def read(folder: Path, text: str, frame_rate: float | None = 24.0) -> CameraTrack:
    path = folder / "path.txt"
    path.write_text(text, "utf-8")
    return track_of(read_solved_path(path), "path.txt", frame_rate)


@pytest.mark.parametrize("name", FILES)
def test_a_path_is_read(tmp_path: Path, name: str) -> None:
    track = read(tmp_path, FILES[name])
    assert read_solved_path(tmp_path / "path.txt").format.startswith(name)
    np.testing.assert_allclose(track.time_s, [0.0, 2.0 / 24.0], atol=1e-9)
    # nine digits of the quaternions
    np.testing.assert_allclose(track.position, [[0.0, 0.0, 0.0], [1.0, 0.5, -2.0]], atol=1e-7)
    np.testing.assert_allclose(track.rotation, [np.eye(3), yaw_matrix(0.5 * np.pi)], atol=1e-7)


def test_nuke_reads_what_is_written_for_it(tmp_path: Path, rng: np.random.Generator) -> None:
    from scipy.spatial.transform import Rotation

    first = read(tmp_path, OWN)
    turns = Rotation.from_rotvec(rng.normal(size=(2, 3)) * 0.7).as_matrix()
    turns[0] = np.eye(3)
    track = track_of(
        type(read_solved_path(tmp_path / "path.txt"))("x", first.position, turns, time_s=first.time_s), "x", None
    )
    again = read(tmp_path, nuke_chan(track, 24.0))
    up = track.rotation[0][:, 1]  # the file's world is kept upright, the track's first camera is level in it
    np.testing.assert_allclose(up, again.rotation[0][:, 1], atol=1e-7)
    np.testing.assert_allclose(again.rotation, track.rotation, atol=1e-7)  # nine digits of degrees
    np.testing.assert_allclose(again.position, track.position, atol=1e-7)


def test_the_script_for_blender_holds_the_path(tmp_path: Path) -> None:
    script = blender_script(read(tmp_path, OWN), 24.0)
    compile(script, "camera.py", "exec")
    rows = script[script.index("KEYS = [") + 8 : script.index("]\n\ndata")]
    keys = np.array(
        [json.loads(line.rstrip(",")) for line in map(str.strip, rows.splitlines()) if line.startswith("[")]
    )
    np.testing.assert_allclose(keys[0], [1, 0, 0, 0, HALF, HALF, 0, 0], atol=1e-8)
    np.testing.assert_allclose(keys[1], [3, 1, 2, 0.5, 0.5, 0.5, -0.5, -0.5], atol=1e-7)


WRONG = {
    "no path": ("hello\nworld\n", "no path of a camera"),
    "mirrored": (BLENDER.replace("[1, 0, 0, 3]", "[-1, 0, 0, 3]"), "no rotation"),
    "long": (BLENDER_CSV.replace("0.5,0.5,-0.5,-0.5", "1,1,1,1"), "length 1 .got 2 in row 2"),
    "twice": (CHAN.replace("3 4 4.5", "1 4 4.5"), "frame twice"),
    "short": (CHAN + "4 4 4\n", "row 3 - is no row of a path"),
    "columns": ("frame,x,y,z\n1,0,0,0\n2,0,0,0\n", "got no rx, ry, rz"),
    "broken": (METASHAPE[:200], "broken XML"),
    "numbers": (METASHAPE.replace("1 0 0 3 0", "1 0 0 0"), "needs 16 numbers"),
    "unaligned": (METASHAPE.replace("<transform>1", "<x>1").replace("0 1</transform></camera>", "0 1</x></camera>")
                  .replace("<transform>0", "<x>0"), "no solved camera"),
    "names": (COLMAP.replace("_0001", ""), "without a frame number"),
    "entities": ("<!DOCTYPE a [<!ENTITY b 'c'>]>" + METASHAPE[21:], "declares entities"),
    "no frames": (BLENDER.replace("matrix_world", "matrix"), "no path from Blender"),
}  # fmt: skip


@pytest.mark.parametrize("name", sorted(WRONG))
def test_files_that_hold_no_path(tmp_path: Path, name: str) -> None:
    text, words = WRONG[name]
    with pytest.raises(ParameterError, match=words):
        read(tmp_path, text)


def test_the_command_converts(tmp_path: Path, run: Callable[..., tuple[int, str, str]]) -> None:
    path = tmp_path / "path.chan"
    path.write_text(CHAN, "utf-8")
    code, _, errors = run("track", "--from", path, "-o", tmp_path / "track.csv")
    assert (code, "give the clip too, or --fps" in errors) == (2, True)
    code, said, _ = run("track", "--from", path, "--fps", "24", "--scale", "0.1", "-o", tmp_path / "track.csv")
    assert code == 0
    assert "Nuke or SynthEyes path: 2 cameras" in said
    np.testing.assert_allclose(read_camera_track(tmp_path / "track.csv").position[1], [0.1, 0.05, -0.2], atol=1e-9)
    assert run("track", "--from", tmp_path / "track.csv", "-o", tmp_path / "out.chan", "--fps", "24")[0] == 0
    np.testing.assert_allclose(np.loadtxt(tmp_path / "out.chan")[1], [3, 0.1, 0.05, -0.2, 0, -90, 0], atol=1e-6)
    said = run("track", "--from", path, "--fps", "24", "-o", tmp_path / "c.csv", "--json")[1]
    (track,) = json.loads(said)["tracks"]
    assert track["kind"] == "moving"
    assert track["floor"] is None
    code, _, errors = run("track", "--from", path, "--height", "2", "-o", tmp_path / "b.csv")
    assert (code, "leave them out" in errors) == (2, True)
    assert run("track", "-o", tmp_path / "b.csv")[0] == 2
