# SPDX-License-Identifier: Apache-2.0
"""Scenes that are made, changed and written in Python are those of files, with the same checks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import mr360uw as uw
from tests.composite.gltf_files import one_square

RICH: dict[str, Any] = {
    "water": {"type": "IB", "phase": 0.9},
    "object": [{"position_m": [0.0, -1.0, -4.0]}, {"scale": 2.0, "rotation_deg": [0.0, 30.0, 0.0]}],
    "lamp": [{"attach": 1}],
    "receiver": {"kind": "plane", "height_m": -2.0},
    "sea": {"wind_speed": 3.0},
    "match": {"patch": [{"azimuth_deg": 10.0, "elevation_deg": -20.0, "is": "grey", "distance_m": 2.0}]},
    "keys": [{"parameter": "object.0.scale", "time_s": [0.0, 2.0], "value": [1.0, 3.0]}],
}


@pytest.fixture
def tables(tmp_path: Path) -> dict[str, Any]:
    """Return the tables of a scene whose files are there."""
    (tmp_path / "plate.png").write_bytes(b"a picture that nobody opens")
    mesh = one_square().write(tmp_path / "mesh.glb")
    objects = [{**one, "mesh": str(mesh)} for one in RICH["object"]]
    return {"plate": {"path": str(tmp_path / "plate.png")}, **RICH, "object": objects}


def test_a_written_scene_is_read_as_the_same(tables: dict[str, Any], tmp_path: Path) -> None:
    scene = uw.Scene(**tables)
    (tmp_path / "again.toml").write_text(scene.to_toml(), "utf-8")
    assert uw.load_scene(tmp_path / "again.toml") == scene


def test_a_sea_of_another_kind_stays_one(tables: dict[str, Any], tmp_path: Path) -> None:
    scene = uw.Scene(**(tables | {"sea": uw.caustics.SpectralSea(), "keys": ()}))
    (tmp_path / "again.toml").write_text(scene.to_toml(), "utf-8")
    for again in (uw.load_scene(tmp_path / "again.toml"), scene.with_("camera.depth_m=3")):
        assert again.sea == scene.sea


def test_tables_are_merged_and_lists_replaced(tables: dict[str, Any]) -> None:
    scene = uw.Scene(**tables)
    changed = scene.with_("object.1.scale=3", water={"type": "II"}, lamps=[])
    assert (changed.water.type, changed.water.phase) == ("II", scene.water.phase)
    assert (changed.objects[0], changed.objects[1].scale, changed.lamps) == (scene.objects[0], 3.0, ())
    assert scene.with_(sea=scene.sea, objects=list(scene.objects)) == scene == uw.Scene(**tables)


def test_changes_are_checked_in_the_words_of_files(tables: dict[str, Any]) -> None:
    scene = uw.Scene(**tables)
    with pytest.raises(uw.SceneError, match=r"camera\.depth_m - must be > 0 .* \(got -1.0\)"):
        scene.with_(camera={"depth_m": -1.0})
    with pytest.raises(uw.SceneError, match=r"no such file .*gone\.glb"):
        scene.with_(lamps=[], objects=[{"mesh": "gone.glb"}], keys=[])
    with pytest.raises(uw.SceneError, match=r"wather - unknown key"):
        uw.Scene(plate=scene.plate, wather={})
