# SPDX-License-Identifier: Apache-2.0
"""Descriptions of controls: every parameter has one, and it says what the parameter's declaration says."""

from __future__ import annotations

import pytest

from mr360uw.base.parameters import stated
from mr360uw.scene.handbook import choices
from mr360uw.scene.model import Scene
from mr360uw.scene.problems import models_of
from mr360uw.tune.fields import FIRST, Field, Group, by_key, groups

GROUPS = {group.key: group for group in groups()}
EVERY = [
    (f"{group.key}.{field.key}", model, field)
    for group in GROUPS.values()
    for model in models_of(next(f for n, f in Scene.model_fields.items() if (f.alias or n) == group.key).annotation)
    for field in group.kinds[model.model_fields[group.tag].default if group.tag else ""]
]


def one(path: str) -> Field:
    return next(field for key, _, field in EVERY if key == path)


@pytest.mark.parametrize(
    ("path", "changes"),
    [("sea.wind_speed", True), ("object.position_m", True), ("object.base_color", True), ("camera.depth_m", False),
     ("sea.tile_m", False), ("sea.seed", False), ("water.type", False), ("plate.frame_rate", False)],
)  # fmt: skip
def test_what_cannot_change_within_a_clip_has_no_keys(path: str, changes: bool) -> None:
    assert one(path).changes is changes


def test_every_parameter_of_every_table_has_a_control() -> None:
    expected = {
        (f"{field.alias or name}.{inner.alias or key}", model.__name__)
        for name, field in Scene.model_fields.items()
        for model in models_of(field.annotation)
        for key, inner in model.model_fields.items()
        if not stated(inner, "internal")
    }
    assert {(key, model.__name__) for key, model, _ in EVERY} == expected
    assert len(expected) > 100
    assert not any(key.startswith("sea.waves_of_wind") for key, _ in expected)


def test_a_control_says_what_the_declaration_says(subtests: pytest.Subtests) -> None:
    for path, model, field in EVERY:
        with subtests.test(path):
            declared = next(f for n, f in model.model_fields.items() if (f.alias or n) == field.key)
            assert field.help == declared.description
            assert field.required == declared.is_required()
            assert field.default == (None if declared.is_required() else declared.default)
            assert field.label
            if field.kind == "choice" and path != "sea.model":
                assert [str(c) for c in field.choices] == choices(declared.annotation)
            if field.kind in ("number", "integer"):
                assert field.span is not None
                low, high = field.span
                assert low < high
                assert field.low is None or low >= field.low
                assert field.high is None or high <= field.high
                assert field.step > 0.0


KINDS = [
    ("camera.depth_m", "number", {"unit": "m", "default": 5.0, "high": 200.0, "label": "Camera depth"}),
    ("caustics.size", "integer", {"default": 512}),
    ("water.type", "choice", {"optional": False}),
    ("plate.transfer", "choice", {"optional": True, "default": None}),
    ("caustics.chromatic", "choice", {"choices": (1, 3)}),
    ("sea.model", "choice", {"choices": ("gerstner", "spectral")}),
    ("object.visible", "switch", {"default": True}),
    ("object.double_sided", "switch", {"optional": True}),
    ("object.position_m", "vector", {"length": 3}),
    ("receiver.range_m", "vector", {"length": 2}),
    ("lamp.color", "colour", {"length": 3}),
    ("object.mesh", "path", {"required": True}),
    ("light.track", "path", {"optional": True}),
    ("water.sensor", "text", {"default": "Insta360 X5"}),
    ("water.gain", "toml", {"default": "auto"}),
    ("object.key", "toml", {"default": ()}),
    ("light.white_cd_m2", "number", {"logarithmic": True, "label": "White"}),
]


def test_kinds(subtests: pytest.Subtests) -> None:
    for path, kind, extra in KINDS:
        with subtests.test(path):
            field = one(path)
            assert field.kind == kind
            assert {name: getattr(field, name) for name in extra} == extra


def test_a_parameter_of_several_kinds_has_the_default_of_the_first() -> None:
    assert by_key(groups())["sea.model"].default_text == '"gerstner"'


def test_the_first_controls_are_parameters() -> None:
    assert set(FIRST) <= {path for path, _, _ in EVERY}


def test_everyday_words_find_a_control() -> None:
    """In the words that the page searches: of the table, the key, the label and the help."""
    texts = [
        " ".join((group.key, group.title, group.help, field.key, field.label, field.help)).lower()
        for group in GROUPS.values()
        for fields in group.kinds.values()
        for field in fields
    ]
    for words in ("brighter", "darker", "exposure", "tint", "haze", "god rays", "sand", "sun azimuth"):
        assert any(all(word in text for word in words.split()) for text in texts), words


def test_lists_and_kinds_of_tables() -> None:
    assert [key for key, group in GROUPS.items() if group.repeated][:3] == ["object", "lamp", "holdout"]
    assert [key for key, group in GROUPS.items() if group.optional] == ["receiver"]
    sea: Group = GROUPS["sea"]
    assert {f.key for f in sea.kinds["spectral"]} > {"spectrum", "wind_speed"}
    assert "steepness" in {f.key for f in sea.kinds["gerstner"]}
