# SPDX-License-Identifier: Apache-2.0
"""What runs and what is left out, and that what is left out changes nothing that can be seen."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from mr360uw.render.loaded import load
from mr360uw.render.plan import ObjectFacts, Plan, make_plan
from tests.scenes import scene_with

OTHER = {"glossy", "track_sun", "track_gain", "lamps", "pattern", "surface", "snow"}


def plan_of(folder: Path, mesh: Path | None, **tables: Any) -> Plan:
    return load(scene_with(folder, mesh, **tables), 128, 64).plan


@pytest.mark.parametrize(
    ("tables", "skipped"),
    [
        ({}, {"shadow", "grain"}),
        ({"receiver": {"height_m": -2.0}}, {"grain"}),
        ({"receiver": {"height_m": -2.0, "shadow": False}}, {"shadow", "grain"}),
        ({"light": {"sun": "none"}, "receiver": {"height_m": -2.0}}, {"sun", "caustics", "shafts", "shadow", "grain"}),
        ({"water": {"type": "none"}}, {"medium", "gain", "caustics", "shafts", "shadow", "blur", "grain"}),
        ({"water": {"gain": [1.0, 1.0, 1.0]}}, {"gain", "shadow", "grain"}),
        ({"water": {"mode": "table"}}, {"shadow", "grain"}),
        ({"caustics": {"enabled": False}}, {"caustics", "shadow", "grain"}),
        ({"camera": {"depth_m": 120.0}, "water": {"type": "5C"}}, {"sun", "caustics", "shafts", "shadow", "grain"}),
        (
            {"object": []},
            {
                "environment",
                "sun",
                "gain",
                "caustics",
                "glossy",
                "shafts",
                "shadow",
                "occlusion",
                "layer",
                "blur",
                "match",
                "grain",
            },
        ),
        ({"draw": {"ambient_occlusion": False}}, {"shadow", "occlusion", "grain"}),
    ],
)
def test_a_stage_runs_where_it_is_needed(
    tables: dict[str, Any], skipped: set[str], tmp_path: Path, whale: Path
) -> None:
    plan = plan_of(tmp_path, None if "object" in tables else whale, **tables)
    assert {name for name, stage in plan.stages.items() if not stage.runs} - OTHER == skipped - OTHER
    assert all(stage.why for stage in plan.stages.values())
    assert plan.track_sun.runs == plan.sun.runs
    assert plan.track_gain.runs == plan.gain.runs


def test_an_object_that_rises_from_the_deep_gets_its_caustics(tmp_path: Path, whale: Path) -> None:
    deep = {"mesh": str(whale), "position_m": [0.0, -180.0, -3.0]}
    assert not plan_of(tmp_path, None, object=[deep]).caustics.runs
    rising = {**deep, "key": [{"time_s": 0.0}, {"time_s": 60.0, "position_m": [0.0, -0.6, -3.0]}]}
    assert plan_of(tmp_path, None, object=[rising]).caustics.runs
    fixed = {**deep, "attach": "camera"}
    track = tmp_path / "up.csv"
    track.write_text("time_s,x,y,z,qx,qy,qz,qw\n0,0,0,0,0,0,0,1\n60,0,180,0,0,0,0,1\n")
    camera = {"depth_m": 185.0, "track": str(track)}
    below = [{**fixed, "position_m": [0.0, -1.0, -3.0]}]
    assert plan_of(tmp_path, None, camera=camera, object=below).caustics.runs
    assert not plan_of(tmp_path, None, camera={"depth_m": 185.0}, object=below).caustics.runs


def test_the_plan_tells_of_the_first_pass(tmp_path: Path, whale: Path) -> None:
    track = tmp_path / "dive.sun.json"
    for light, sun, gain in (
        ({}, "in a first pass", "in a first pass"),
        ({"smooth": False}, "frame by frame", "frame by frame"),
        ({"track": str(track)}, "light.track, dive.sun.json", "in a first pass"),
    ):
        track.touch()
        plan = plan_of(tmp_path, whale, light=light)
        assert sun in plan.track_sun.why
        assert gain in plan.track_gain.why


def test_the_sun_shines_for_the_shallowest_object(tmp_path: Path, whale: Path) -> None:
    loaded = load(scene_with(tmp_path, whale, water={"type": "5C"}), 128, 64)
    assert loaded.surroundings.medium is not None
    table = loaded.surroundings.medium.unit_table
    shallow, deep = (ObjectFacts(depth_m, False, False) for depth_m in (2.0, 150.0))
    assert make_plan(loaded.scene, (shallow, deep), table).sun.runs
    assert not make_plan(loaded.scene, (deep,), table).sun.runs


def test_the_plan_reads_as_a_table(tmp_path: Path, whale: Path) -> None:
    scene = scene_with(tmp_path, whale)
    text = str(make_plan(scene, (ObjectFacts(4.0, True, False),), None))
    assert "glossy       runs     a material is smoother than diffuse" in text
    assert "medium       skipped" in text


@pytest.mark.parametrize(
    ("tables", "runs"),
    [
        ({"receiver": {"height_m": -2.0}}, True),
        ({"receiver": {"height_m": -2.0, "shadow": False}}, False),
        ({"receiver": {"height_m": -2.0}, "water": {"type": "none"}}, False),
        ({}, False),
    ],
)
def test_the_plates_caustics_go_where_a_shadow_falls(
    tables: dict[str, Any], runs: bool, tmp_path: Path, whale: Path
) -> None:
    assert plan_of(tmp_path, whale, **tables).pattern.runs == runs


def test_lamps_of_the_scene_are_in_the_plan(tmp_path: Path, whale: Path) -> None:
    assert plan_of(tmp_path, whale, lamp=[{}]).lamps.runs
    assert not plan_of(tmp_path, whale).lamps.runs
