# SPDX-License-Identifier: Apache-2.0
"""Qualities of a scene: what they set, and that values of the scene's own win."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from mr360uw.composite.settings import DrawSettings, Quality
from mr360uw.errors import SceneError
from mr360uw.render.loaded import load
from mr360uw.scene.model import QUALITIES, Scene, load_scene, scene_from_dict, with_quality

TABLES = ("water", "caustics", "shafts", "draw")


def scene_of(folder: Path, **tables: Any) -> Scene:
    (folder / "plate.png").touch()
    return scene_from_dict({"plate": "plate.png"} | tables, folder)


def values(scene: Scene) -> dict[str, dict[str, Any]]:
    """Return every value of the tables that a quality touches, but the quality itself."""
    dumped = {name: getattr(scene, name).model_dump() for name in TABLES}
    dumped["draw"].pop("quality")
    return dumped


def test_final_is_the_defaults(tmp_path: Path) -> None:
    assert QUALITIES["final"] == {}
    assert values(scene_of(tmp_path, draw={"quality": "final"})) == values(scene_of(tmp_path))


@pytest.mark.parametrize("quality", ["draft", "reference"])
def test_a_quality_sets_what_a_scene_leaves_open(quality: Quality, tmp_path: Path) -> None:
    open_, plain = values(scene_of(tmp_path, draw={"quality": quality})), values(scene_of(tmp_path))
    for table in TABLES:
        assert open_[table] == plain[table] | QUALITIES[quality][table], table


def test_values_of_the_scene_win_even_where_they_are_the_default(tmp_path: Path) -> None:
    given = {"draw": {"quality": "draft", "samples": 65}, "caustics": {"size": 512}, "water": {"bands": 3}}
    scene = scene_of(tmp_path, **given)
    assert (scene.draw.samples, scene.caustics.size, scene.water.bands) == (65, 512, 3)
    assert (scene.draw.sun_samples, scene.caustics.planes) == (8, 2)


def test_overrides_of_the_command_line_choose_and_win(tmp_path: Path) -> None:
    (tmp_path / "plate.png").touch()
    path = tmp_path / "scene.toml"
    path.write_text('plate = "plate.png"\n[draw]\nsun_samples = 5\n')
    scene = load_scene(path, ["draw.quality=draft", "draw.samples=29"])
    assert (scene.draw.samples, scene.draw.sun_samples, scene.shafts.slices) == (29, 5, 16)


def test_models_are_filled_as_tables_are(tmp_path: Path) -> None:
    plate = {"path": tmp_path / "plate.png"}
    scene = Scene.model_validate({"plate": plate, "draw": DrawSettings(quality="draft", samples=65)})
    assert (scene.draw.samples, scene.draw.sun_samples, scene.caustics.size) == (65, 8, 256)


def test_reference_is_no_coarser_and_draft_no_finer_than_final() -> None:
    final = {name: Scene.model_fields[name].default for name in TABLES}
    for quality, sign in (("draft", -1), ("reference", 1)):
        for table, knobs in QUALITIES[quality].items():
            for key, value in knobs.items():
                usual = getattr(final[table], key)
                if isinstance(value, int) and usual is not None:
                    assert sign * value > sign * usual, (quality, table, key)


@pytest.mark.parametrize("data", [[], {"draw": 3}, {"draw": {"quality": ["draft"]}}, {"draw": {"quality": "best"}}])
def test_what_is_no_quality_is_left_to_the_models(data: Any) -> None:
    assert with_quality(data) is data


def test_an_unknown_quality_and_a_broken_table_are_reported(tmp_path: Path) -> None:
    (tmp_path / "plate.png").touch()
    with pytest.raises(SceneError, match=r"draw\.quality"):
        scene_from_dict({"plate": "plate.png", "draw": {"quality": "best"}}, tmp_path)
    with pytest.raises(SceneError, match="water"):
        scene_from_dict({"plate": "plate.png", "draw": {"quality": "draft"}, "water": 3}, tmp_path)


def test_the_docs_have_the_values() -> None:
    page = (Path(__file__).resolve().parents[2] / "docs" / "benchmarks.md").read_text("utf-8")
    rows = [line for line in page.partition("## Quality")[2].splitlines() if line.startswith("| `")]
    for quality, column in (("draft", 1), ("reference", 3)):
        for table, knobs in QUALITIES[quality].items():
            for key, value in knobs.items():
                row = next(r for r in rows if f"`{table}.{key}`" in r)
                assert str(value) in row.strip("| ").split(" | ")[column].split(", "), f"{table}.{key}"


def test_the_plan_names_the_quality(tmp_path: Path, whale: Path) -> None:
    objects = [{"mesh": str(whale), "position_m": [0.3, -0.4, -3.0], "rotation_deg": [-60.0, 5.0, 0.0]}]
    scene = scene_of(tmp_path, object=objects, draw={"quality": "draft"}, water={"type": "none"})
    assert "draft quality, 13 samples a pixel" in load(scene, 64, 32).plan.layer.why
