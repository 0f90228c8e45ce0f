# SPDX-License-Identifier: Apache-2.0
"""The words for what is wrong with a file of settings, on a small model of every kind of field."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Literal

import pytest
from pydantic import Field, ValidationError

from mr360uw.base.parameters import Parameters, parameter
from mr360uw.errors import SceneError
from mr360uw.scene.model import load_scene
from mr360uw.scene.problems import key_lines, problems


class Calm(Parameters):
    model: Literal["calm"] = "calm"
    height_m: float = parameter(0.1, "height of the waves", unit="m", low=0.0, high=2.0)


class Rough(Parameters):
    model: Literal["rough"] = "rough"
    wind: float = parameter(9.0, "speed of the wind", unit="m/s", above=0.0)


class Fish(Parameters):
    mesh: str = parameter(..., "file of the mesh")
    scale: float = parameter(1.0, "factor on the size", unit="1", above=0.0, high=100.0)
    codec: Literal["libx264", "libx265"] = parameter("libx264", "encoder")


class World(Parameters):
    depth_m: float = parameter(5.0, "depth of the camera", unit="m", low=0.0, high=200.0)
    sea: Annotated[Calm | Rough, Field(discriminator="model")] = Calm()
    fish: tuple[Fish, ...] = ()
    tint: Literal["auto"] | tuple[float, float, float] = parameter("auto", "colour")
    path: tuple[tuple[float, float], ...] = parameter((), "way")
    flag: bool = parameter(False, "mark")
    count: int = parameter(1, "how many")
    name: str = parameter("", "title")


TEXT = """depth_m = -5
[sea]
model = "rough"
wind = "strong"
[[fish]]
mesh = "a.glb"
scael = 2.0
[[fish]]
mehs = "b.glb"
codec = "libx2655"
scale = 1000.0
"""


def messages(text: str) -> list[str]:
    with pytest.raises(ValidationError) as caught:
        World.model_validate(tomllib.loads(text))
    return problems(caught.value, World, "w.toml", key_lines(text))


def test_every_problem_has_its_line_its_value_and_its_remedy() -> None:
    found = messages(TEXT)
    expected = [
        ("w.toml:1 depth_m - must be in [0, 200] m (got -5)", "depth of the camera"),
        ("w.toml:4 sea.wind - ", "(got 'strong') - speed of the wind"),
        ("w.toml:7 fish[0].scael - unknown key (got 2.0)", "did you mean 'scale'?"),
        ("w.toml:9 fish[1].mehs - unknown key (got 'b.glb')", "did you mean 'mesh'?"),
        ("w.toml:10 fish[1].codec - must be 'libx264' or 'libx265' (got 'libx2655')", "did you mean 'libx265'?"),
        ("w.toml:11 fish[1].scale - must be > 0 and <= 100 (got 1000.0)", "factor on the size"),
    ]
    assert len(found) == len(expected)  # the missing mesh is not reported beside its misspelling
    for message, (start, end) in zip(found, expected, strict=True):
        assert message.startswith(start)
        assert end in message


def test_a_missing_key_points_at_its_table_and_says_what_to_give() -> None:
    assert messages("[[fish]]\nscale = 2.0\n") == ["w.toml:1 fish[0].mesh - is missing - give file of the mesh"]


def test_an_unknown_key_without_a_near_miss_lists_the_known_ones() -> None:
    (message,) = messages("[[fish]]\nmesh = 'a'\nxyzzy = 1\n")
    assert message.endswith("known here: mesh, scale, codec")


def test_an_unknown_kind_names_the_kinds() -> None:
    (message,) = messages('[sea]\nmodel = "choppy"\n')
    assert "calm" in message
    assert "rough" in message
    assert "w.toml:2" in message


@pytest.mark.parametrize("value", ["nan", "inf", '"deep"', "[1]"])
def test_numbers_must_be_finite_numbers(value: str) -> None:
    (message,) = messages(f"depth_m = {value}\n")
    assert message.startswith("w.toml:1 depth_m")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[fish]\nmesh = 'a'", "w.toml:1 fish - is one table, where there may be several (got {'mesh': 'a'}) - write "
                               "[[fish]] with double brackets"),
        ("[[sea]]\nheight_m = 1", "w.toml:1 sea - is a list of tables, where there is one (got [{'height_m': 1}]) - "
                                  "write [sea] with single brackets"),
        ("tint = 0.5", "w.toml:1 tint - must be 'auto' or a list of 3 numbers (got 0.5) - colour"),
        ("tint = 'aut'", "w.toml:1 tint - must be 'auto' or a list of 3 numbers (got 'aut') - did you mean 'auto'?"),
        ("tint = [1, 2]", "w.toml:1 tint - must be 'auto' or a list of 3 numbers (got [1, 2]) - colour"),
        ("path = [[0, 1], [2, 'b']]", "w.toml:1 path[1][1] - must be a number (got 'b') - way"),
        ("path = 7", "w.toml:1 path - must be a list of lists of 2 numbers (got 7) - way"),
        ("flag = 'maybe'", "w.toml:1 flag - must be true or false (got 'maybe') - mark"),
        ("count = 2.5", "w.toml:1 count - must be a whole number (got 2.5) - how many"),
        ("name = 3", "w.toml:1 name - must be text in quotes (got 3) - title"),
    ],
)  # fmt: skip
def test_a_value_of_the_wrong_type_is_told_what_it_may_be(text: str, expected: str) -> None:
    assert messages(text) == [expected]


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        ("'no'", "match.black - must be 'auto', a number or a list of 3 numbers (got 'no')"),
        ("-1", "match.black - must be greater than or equal to -0.3 (got -1)"),
        ("[0, 0]", "match.black - must be 'auto', a number or a list of 3 numbers (got [0, 0])"),
        ("[0, 0, 'auto']", "match.black[2] - must be a number (got 'auto')"),
        ("[0, 0, 0.7]", "match.black[2] - must be less than or equal to 0.5 (got 0.7)"),
    ],
)
def test_a_value_of_many_types_has_one_problem(tmp_path: Path, value: str, expected: str) -> None:
    (tmp_path / "plate.png").touch()
    path = tmp_path / "scene.toml"
    path.write_text(f'plate = "plate.png"\n[match]\nblack = {value}\n', "utf-8")
    with pytest.raises(SceneError) as caught:
        load_scene(path)
    (problem,) = caught.value.problems
    assert problem.startswith(f"{path}:3 {expected} - ")


def test_tables_within_tables_of_a_list_have_lines() -> None:
    text = "[[fish]]\nmesh = 'a'\n[[fish]]\nmesh = 'b'\n[[fish.key]]\ntime_s = 0\n[[fish.key]]\ntime_s = 1\n"
    lines = key_lines(text)
    assert lines["fish", 1, "key", 0, "time_s"] == 6
    assert lines["fish", 1, "key", 1] == 7
    assert lines["fish", 1, "key"] == 5


def test_what_the_command_line_sets_is_told_from_what_the_file_says(tmp_path: Path) -> None:
    scene = tmp_path / "scene.toml"
    scene.write_text('[plate]\npath = "dive.mp4"\n[camera]\ndepth_m = 4.0\n[[object]]\nmesh = "a.glb"\nscale = 0.0\n')
    with pytest.raises(SceneError) as error:
        load_scene(scene, ["camera.depth_m=-4", "object[0].unlit=3", "water.tpye=II"])
    text = str(error.value)
    assert "--set camera.depth_m - must be > 0" in text
    assert "--set object[0].unlit - " in text
    assert "--set water.tpye - unknown key (got 'II') - did you mean 'type'?" in text
    assert "scene.toml:7 object[0].scale - must be in [1e-06, 1e+06]" in text
