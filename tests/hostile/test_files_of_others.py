# SPDX-License-Identifier: Apache-2.0
"""Pictures of other programs through the command line: numbers, profiles, mattes, and what is said once."""

from __future__ import annotations

import json

import cv2
import numpy as np
from PIL import Image

from tests.hostile.bench import Bench
from tests.video.test_picture_files import EXIF, PROFILES, XMP, fields, light, save

COMPOSITE = ("composite", "scene.toml")
BACKEND = ("--backend", "reference")


def test_a_picture_keeps_its_codes_profile_and_metadata_under_an_object(bench: Bench) -> None:
    codes = np.rint(light() * 255).astype(np.uint8)
    save(bench.folder / "adobe.png", codes, EXIF, XMP, PROFILES["Adobe RGB"][0])
    code, said, _ = bench.run(*COMPOSITE, "out.png", "--set", 'plate.path="adobe.png"', *BACKEND)
    assert code == 0
    assert said.count("states a pose of pitch 12 and roll -8 degrees: the camera is held so") == 1
    assert json.loads((bench.folder / "out.png.json").read_text("utf-8"))["notes"] != []
    assert fields(bench.folder / "out.png") == fields(bench.folder / "adobe.png")
    same = np.all(cv2.imread(str(bench.folder / "out.png"))[..., ::-1] == codes, axis=-1)
    assert 0.5 < same.mean() < 1.0  # all but the object


def test_outputs_and_layers_have_the_numbers_of_the_plate(bench: Bench) -> None:
    for number in (1001, 1002, 1003):
        bench.put(f"p.{number}.png", bench.material.files["plate.png"])
    plate = ("--set", 'plate.path="p.####.png"', *BACKEND)
    code, _, err = bench.run(*COMPOSITE, "o.%04d.png", "--layers", "l.%04d.exr", "--frames", "1002:1004", *plate)
    assert (code, err) == (0, "")
    assert sorted(f.name for f in bench.folder.glob("[ol].*.???")) == [
        "l.1002.exr", "l.1003.exr", "o.1002.png", "o.1003.png"
    ]  # fmt: skip
    bench.refuses(*COMPOSITE, "q.%04d.png", "--frames", "1:3", *plate, says=("numbered 1001 to 1003", "1001:1004"))
    code, said, _ = bench.run("check", "scene.toml", "--set", 'plate.path="p.1002.png"', *BACKEND)
    assert code == 0
    assert said.count("is one of a sequence") == 1


def test_mattes_that_hide_nothing_or_all_are_said_once(bench: Bench) -> None:
    for name, value in (("black", 0), ("white", 255)):
        Image.fromarray(np.full((32, 64), value, np.uint8)).save(bench.folder / f"{name}.png")
    for name, says in (("black", "hides nothing in frame 0"), ("white", "hides 100 % of frame 0")):
        setting = ("--set", f'holdout=[{{path="{name}.png"}}]', *BACKEND)
        code, said, _ = bench.run("check", "scene.toml", *setting)
        assert code == 0
        assert said.count(says) == 1
        assert "set invert = true" in said
