# SPDX-License-Identifier: Apache-2.0
"""What commands may not do to a user's files: replace what they read or wrote, or remove what they did not make."""

from __future__ import annotations

import json
import os
from typing import Any

import cv2
import numpy as np
import pytest

from tests.hostile.bench import Bench, contents

COMPOSITE = ("composite", "scene.toml", "out.png", "--backend", "reference", "--set", "water.type=none")


def test_reports_replace_nothing(bench: Bench) -> None:
    """The scene file, an input, the output of the same run: never; a file of somebody else's: when asked to."""
    bench.put("notes.json", "mine")
    for report, says in (
        ("notes.json", "already there"),
        ("plate.png", "already there"),
        ("out.png", "another output"),
    ):
        bench.refuses(*COMPOSITE, "--report", report, says=(report, says))
    for report in ("scene.toml", "plate.png", "mesh.glb"):
        bench.refuses(*COMPOSITE, "--report", report, "--overwrite", says=(report, "which this run reads"))
    code, _, err = bench.run(*COMPOSITE, "--report", "notes.json", "--overwrite")
    assert (code, err) == (0, "")
    assert json.loads((bench.folder / "notes.json").read_text("utf-8"))["frames"]["written"] == 1


def test_pages_of_a_benchmark_have_names_of_their_own(bench: Bench) -> None:
    bench.put("before.json", "{}")
    bench.refuses("bench", "--quick", "--json", "x", "--page", "x", says=("another output",))
    bench.refuses("bench", "--quick", "--json", "no/x", says=("folder is missing",))


def test_a_converted_path_does_not_replace_the_one_it_is_made_from(bench: Bench) -> None:
    bench.put("a.chan", "1 0 0 0 0 0 0\n2 0 0 -1 0 0 0\n")
    bench.refuses("track", "--from", "a.chan", "--fps", "24", "-o", "a.chan", "--overwrite", says=("this run reads",))
    code, _, err = bench.run("track", "--from", "a.chan", "--fps", "24", "-o", "b.csv")
    assert (code, err) == (0, "")
    bench.refuses("track", "--from", "b.csv", "-o", "b.json", "--overwrite", says=("b.csv", "this run reads"))


@pytest.mark.parametrize("kind", ["folder", "link to a folder", "link to nothing", "file"])
def test_work_folders_that_others_made_are_left_alone(kind: str, bench: Bench) -> None:
    """Of a composite and of a track; a link is not followed, and files that look like ours are no marker."""
    mine = bench.folder / "mine"
    mine.mkdir()
    bench.put("mine/run.json", "{}")
    for name in ("out.png.mr360uw", "my.track-work"):
        work = bench.folder / name
        if kind == "folder":
            work.mkdir()
            (work / "run.json").write_text("{}")
            (work / "input.json").write_text("mine")
        elif kind == "file":
            work.write_text("mine")
        else:
            work.symlink_to(mine if kind == "link to a folder" else "nothing")
    bench.refuses(*COMPOSITE, says=("out.png.mr360uw",))
    bench.refuses(*COMPOSITE, "--overwrite", "--fresh", says=("out.png.mr360uw",))
    bench.refuses("track", "plate.png", "-o", "my.csv", "--height", "1.5", says=("my.track-work",))
    before = contents(bench.folder)
    code, _, _ = bench.run("clean", ".")
    assert code == 0
    assert contents(bench.folder) == before


def test_links_to_nothing_and_unusable_folders_are_said_before_the_first_frame(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    (bench.folder / "dangling.png").symlink_to("nothing.png")
    bench.refuses("composite", "scene.toml", "dangling.png", "--overwrite", says=("leads to no file",))
    bench.refuses(*COMPOSITE, "--layers", "no/l_%04d.exr", says=("no/l_%04d.exr", "folder is missing"))
    monkeypatch.setattr("os.access", lambda _, mode: not mode & os.W_OK)  # root, who may run this, may write anywhere
    bench.refuses(*COMPOSITE, "--layers", "l_%04d.exr", says=("l_%04d.exr", "may not be written to"))


def test_sizes_that_a_codec_cannot_hold_are_said(bench: Bench) -> None:
    cv2.imwrite(str(bench.folder / "odd.png"), np.full((35, 70, 3), 90, np.uint8))
    bench.refuses_with('plate.path="odd.png"', says=("must be even (got 70x35)",), out="out.mp4")


def test_on_a_full_disk_a_first_scene_is_not_left_alone(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    from mr360uw.first_look import first_scene

    def full(*_: Any) -> bytes:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(first_scene, "screen_picture", full)
    before = contents(bench.folder)
    code, _, err = bench.run("new", "plate.png", "mesh.glb", "-o", "new.toml")
    assert code == 2
    assert "No space left" in err
    assert contents(bench.folder) == before


def test_a_run_that_fails_leaves_no_empty_folder(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    from mr360uw.sample import dive

    def full(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(dive, "record", full)
    before = contents(bench.folder)
    code, _, err = bench.run("sample", "deep/er", "--width", "64", "--frames", "1")
    assert code == 2
    assert "No space left" in err
    assert contents(bench.folder) == before


def test_a_wrong_mask_leaves_no_work(bench: Bench) -> None:
    pytest.importorskip("pycolmap", reason="tracking needs the extra track")
    from fractions import Fraction

    from mr360uw.sample.dive import record

    record(bench.folder / "clip.mp4", iter(np.zeros((4, 64, 128, 3))), Fraction(24), seed=1)
    cv2.imwrite(str(bench.folder / "mask.png"), np.zeros((8, 16), np.uint8))
    for mask, says in (("mask.png", "another size"), ("scene.toml", "scene.toml")):
        bench.refuses("track", "clip.mp4", "-o", "t.csv", "--height", "1", "--mask", mask, says=(says,))


def test_textures_that_only_a_mesh_names_are_inputs_too(bench: Bench) -> None:
    cv2.imwrite(str(bench.folder / "skin.png"), np.full((4, 4, 3), 90, np.uint8))
    bench.put("one.mtl", "newmtl a\nKd 1 1 1\nmap_Kd skin.png\n")
    bench.put("one.obj", "mtllib one.mtl\nusemtl a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n")
    options = ("--set", "object.0.mesh=one.obj", "--backend", "reference", "--overwrite")
    for command in ("composite", "still"):
        bench.refuses(command, "scene.toml", "skin.png", *options, says=("skin.png", "this run reads"))
    bench.refuses(
        "composite", "scene.toml", "out.png", "--report", "one.mtl", *options, says=("one.mtl", "this run reads")
    )


def test_inputs_do_not_lie_in_the_folder_that_a_run_removes(bench: Bench) -> None:
    from mr360uw.base.files import make_work_folder

    make_work_folder(bench.folder / "out.png.mr360uw")
    bench.put("out.png.mr360uw/plate.png", bench.material.files["plate.png"])
    bench.refuses(*COMPOSITE, "--set", 'plate.path="out.png.mr360uw/plate.png"', says=("plate.png", "the run removes"))


def test_check_knows_its_own_scene(bench: Bench) -> None:
    (bench.folder / "link.png").symlink_to("scene.toml")
    bench.refuses("check", "scene.toml", "link.png", says=("link.png", "this run reads"))


def test_a_folder_whose_links_lead_round_in_a_circle_is_refused(bench: Bench) -> None:
    (bench.folder / "one").symlink_to("two", target_is_directory=True)
    (bench.folder / "two").symlink_to("one", target_is_directory=True)
    bench.refuses("composite", "scene.toml", "one/out.png", says=("one/out.png",))
    bench.refuses(*COMPOSITE, "--report", "one/run.json", says=("one/run.json",))
    bench.refuses("still", "scene.toml", "one/out.png", says=("one/out.png",))
    bench.refuses("new", "plate.png", "mesh.glb", "-o", "one/new.toml", says=("one/new.toml",))
    bench.refuses("track", "plate.png", "-o", "one/t.csv", says=("one/t.csv",))


def test_a_report_lies_beside_the_output_and_replaces_only_its_own_kind(bench: Bench) -> None:
    code, _, err = bench.run(*COMPOSITE)
    assert (code, err) == (0, "")
    beside = bench.folder / "out.png.json"
    told = json.loads(beside.read_text("utf-8"))
    assert told["scene"]["water"]["type"] == "none"
    assert {"mr360uw", "packages", "seeds", "inputs"} <= set(told)
    (bench.folder / "out.png").unlink()
    assert bench.run(*COMPOSITE)[0] == 0  # its own report of before is replaced
    (bench.folder / "out.png").unlink()
    bench.put("out.png.json", '{"mine": 1}')
    bench.refuses(*COMPOSITE, says=("out.png.json", "already there"))
    code, _, err = bench.run(*COMPOSITE, "--no-report")
    assert (code, err) == (0, "")
    assert json.loads(beside.read_text("utf-8")) == {"mine": 1}
    (bench.folder / "out.png").unlink()
    bench.refuses(*COMPOSITE, "--no-report", "--report", "a.json", says=("--no-report", "give one of them"))
