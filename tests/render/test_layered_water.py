# SPDX-License-Identifier: Apache-2.0
"""Scenes whose water changes with depth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mr360uw as uw
from mr360uw.base.color import encode
from mr360uw.match.water_match import WaterPatch, match_water
from mr360uw.medium.lookup import veil_lookup
from mr360uw.scene.model import files_of
from tests.hostile.bench import Bench, make_material
from tests.medium.layered import PROFILES, write_profile
from tests.scenes import gradient_plate, scene_with
from tests.tolerances import AGREEMENT_CODE, AGREEMENT_FRACTION, AGREEMENT_PSNR_DB

HEAD = "depth_m,wavelength_nm,absorption,scattering\n"


def codes(linear: np.ndarray) -> np.ndarray:
    return 255.0 * encode(np.clip(linear, 0.0, 1.0).astype(np.float64), "srgb")


@pytest.mark.usefixtures("gl")
def test_a_body_below_an_interface_is_hidden_by_the_murky_water_there(whale: Path, tmp_path: Path) -> None:
    path = write_profile(tmp_path / "profile.csv", *PROFILES["clear over murky"])
    body = [{"mesh": str(whale), "position_m": [0.3, -4.5, -2.0], "rotation_deg": [-60.0, 5.0, 0.0]}]
    plate, made = gradient_plate(256, 128), {}
    for name, water in (("layers", {"layers": str(path)}), ("clear", {}), ("murky", {"type": "3C"})):
        scene = scene_with(tmp_path, None, rough=True, object=body, camera={"depth_m": 4.0}, water=water)
        made[name] = uw.render_frame(plate, scene, 0.0, "reference")
    other = uw.render_frame(plate, scene_with(
        tmp_path, None, rough=True, object=body, camera={"depth_m": 4.0}, water={"layers": str(path)}
    ), 0.0, "gl")  # fmt: skip
    # The renderers agree
    assert made["layers"].layer.alpha.max() > 0.99
    difference = codes(other.image_linear) - codes(made["layers"].image_linear)
    assert 10.0 * np.log10(255.0**2 / np.mean(difference**2)) >= AGREEMENT_PSNR_DB
    assert np.mean(np.abs(difference) <= AGREEMENT_CODE) >= AGREEMENT_FRACTION
    # The water before the body counts, of which the camera's layer is a part
    tables = {name: frame.medium for name, frame in made.items()}
    s, up = np.array([4.9]), np.array([-0.91])
    veils = {n: veil_lookup(t, s, up)[0, 1] / veil_lookup(t, s, np.zeros(1))[0, 1] for n, t in tables.items() if t}
    assert veils["layers"] > 1.05 * veils["clear"]


def test_water_in_layers_is_not_matched(tmp_path: Path) -> None:
    path = write_profile(tmp_path / "profile.csv", *PROFILES["smooth"])
    scene = scene_with(tmp_path, None, water={"layers": str(path)})
    assert path in files_of(scene)
    assert "has layers" in str(match_water(scene, WaterPatch(0.0, 0.0, 10.0)))


@pytest.mark.parametrize(
    ("text", "more", "says"),
    [
        ("depth_m,wavelength_nm,absorption\n0,400,0.1\n5,400,0.2\n", "", "profile.csv - column scattering is missing"),
        (HEAD + "5,400,0.1,0.1\n5,700,0.1,0.1\n", "", "profile.csv, depth_m - must be two depths or more that ascend"),
        (HEAD + "-1,400,0.1,0.1\n5,400,0.1,0.1\n", "", "profile.csv, depth_m - must be two depths or more that ascend"),
        (HEAD + "0,400,0.1,0.1\n0,400,0.1,0.1\n", "", "profile.csv - every depth needs the same wavelengths"),
        (HEAD + "0,400,0,0.1\n5,400,0.1,0.1\n", "", "profile.csv, layers - absorption must be above"),
        (HEAD + "0,500,0.1,0.1\n5,500,0.1,0.1\n", "", "profile.csv from 0 m, absorption - is known from 500 to 500 nm"),
        (None, "", "water.layers - no such file"),
        (HEAD, ",visibility_m=10.0", "layers - have a visibility of their own (got 10 m)"),
        (HEAD, ',mode="kd"', "layers - need a solved light field (got mode 'kd')"),
    ],
)
def test_layers_that_cannot_be_used_are_refused_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
    text: str | None, more: str, says: str,
) -> None:  # fmt: skip
    folder, good = tmp_path / "bench", tmp_path / "good"
    folder.mkdir()
    good.mkdir()
    monkeypatch.chdir(folder)
    bench = Bench(folder, make_material(good), monkeypatch, capsys)
    if text is not None:
        bench.put("profile.csv", text)
    err = bench.refuses_with(f'water={{layers="profile.csv"{more}}}', says=(says,))
    assert len(err.strip().splitlines()) <= 2, err
