# SPDX-License-Identifier: Apache-2.0
"""Keys of parameters in a document."""

from __future__ import annotations

import itertools
from pathlib import Path

import pytest

from mr360uw.errors import ParameterError
from mr360uw.scene.resolved import scene_at
from mr360uw.tune import fields
from mr360uw.tune.document import Document

TEXT = '# dive\nplate = "plate.png"\n\n[[object]]\nmesh = "whale.glb"   # big\nposition_m = [0.0, -1.0, -4.0]\n'


@pytest.fixture
def document(tmp_path: Path) -> Document:
    for name in ("plate.png", "whale.glb"):
        (tmp_path / name).touch()
    (tmp_path / "scene.toml").write_text(TEXT, "utf-8")
    return Document(tmp_path / "scene.toml")


def test_keys_are_set_moved_and_removed_as_steps(document: Document) -> None:
    fields.set_key(document, "sea.wind_speed", 0.0, 2.0)
    fields.set_key(document, "sea.wind_speed", 2.0, 6.0)
    fields.set_key(document, "sea.wind_speed", 1.0, 3.0)
    fields.set_key(document, "sea.wind_speed", 1.0, 5.0)  # in place of the one that is there
    key = fields.keyed_parameters(document)["sea.wind_speed"]
    assert (key.time_s, key.value, key.interpolation) == ((0.0, 1.0, 2.0), (2.0, 5.0, 6.0), "smooth")
    assert fields.values_at(document, 1.0) == {"sea.wind_speed": 5.0}
    assert fields.values_at(document, 0.99999) == {"sea.wind_speed": 5.0}  # a frame's time that was rounded
    assert scene_at(document.scene, 1.0).sea.wind_speed == 5.0
    assert fields.has_key(document, "sea.wind_speed", 1.00001)
    assert not fields.has_key(document, "sea.wind_speed", 1.5)
    for time_s in (0.0, 1.0, 2.0):
        fields.set_key(document, "sea.wind_speed", time_s, None)
    assert document.get("keys") is None
    for _ in range(7):
        document.undo()
    assert document.text == TEXT


def test_a_drag_of_keys_is_one_step(document: Document) -> None:
    for value in (3.0, 4.0, 5.0):
        fields.set_keys(document, "sea.wind_speed", [(0.0, 2.0), (1.0, value)], "linear", group="drag")
    assert fields.keyed_parameters(document)["sea.wind_speed"].value == (2.0, 5.0)
    document.undo()
    assert document.text == TEXT


def test_one_component_of_a_vector_moves_alone(document: Document) -> None:
    name = "object.0.position_m"
    fields.set_key(document, name, 0.0, [0.0, -1.0, -4.0])
    fields.set_key(document, name, 2.0, [2.0, -1.0, -6.0])
    key = fields.keyed_parameters(document)[name]
    moved = fields.with_component(document, key, 1, [(0.0, -3.0), (1.5, -2.0)])
    assert moved == [(0.0, [0.0, -3.0, -4.0]), (1.5, [2.0, -2.0, -6.0])]
    added = fields.with_component(document, key, 0, [(0.0, 0.0), (1.0, 5.0), (2.0, 2.0)])
    assert added == [(0.0, [0.0, -1.0, -4.0]), (1.0, [5.0, -1.0, -5.0]), (2.0, [2.0, -1.0, -6.0])]
    curve = fields.samples(document, key, 2.0, 2)
    assert curve[0] == (0.0, -4.0)
    assert curve[-1] == (2.0, -6.0)
    assert all(b[0] > a[0] and b[1] <= a[1] for a, b in itertools.pairwise(curve))


def test_held_values_go_up_in_steps(document: Document) -> None:
    fields.set_keys(document, "sea.wind_speed", [(0.0, 2.0), (1.0, 6.0)], "hold")
    curve = fields.samples(document, fields.keyed_parameters(document)["sea.wind_speed"], 2.0, None)
    assert {value for _, value in curve} == {2.0, 6.0}
    before = max(time for time, value in curve if value == 2.0)
    assert 0.999 < before < 1.0


def test_what_has_no_value_is_not_keyed(document: Document) -> None:
    assert fields.present_value(document, "object.0.position_m", None) == [0.0, -1.0, -4.0]
    assert fields.present_value(document, "sea.wind_speed", 4.0) == 4.0
    with pytest.raises(ParameterError, match="set one first"):
        fields.present_value(document, "water.visibility_m", None)
