# SPDX-License-Identifier: Apache-2.0
"""Words of a place and a size give way to each other; parameters without effect name what leaves them so."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

from mr360uw.tune import fields
from mr360uw.tune.fields import groups

NOW = {
    False: {"position_m": [1.0, 0.5, -2.0], "azimuth_deg": 27.0, "elevation_deg": 12.0, "distance_m": 2.3},
    True: {"position_m": [1.0, 0.5, -2.0], "azimuth_deg": 27.0, "elevation_deg": 12.0, "distance_m": 2.2},
}
PLACED = {"position_m": [1.0, 0.5, -2.0], "scale": 2.0}
POLAR = {"azimuth_deg": 27.0, "distance_m": 2.3, "size_m": 4.0}
STANDING = {"azimuth_deg": 27.0, "distance_m": 2.2, "stand_on": "receiver"}


@pytest.mark.parametrize(
    ("table", "name", "value", "want"),
    [
        (POLAR, "azimuth_deg", 30.0, None),
        (POLAR, "tint", [1.0, 1.0, 0.5], None),
        (PLACED, "azimuth_deg", 30.0, {"azimuth_deg": 30.0, "elevation_deg": 12.0, "distance_m": 2.3,
                                       "position_m": None, "stand_on": None}),
        (POLAR, "position_m", [0.0, 0.5, -2.0], {"position_m": [0.0, 0.5, -2.0], "azimuth_deg": None,
                                                 "distance_m": None}),
        (STANDING, "elevation_deg", 20.0, {"azimuth_deg": 27.0, "elevation_deg": 20.0, "distance_m": 2.3,
                                           "position_m": None, "stand_on": None}),
        (STANDING, "position_m", [2.0, 0.5, -2.0], {"position_m": [2.0, 0.5, -2.0], "azimuth_deg": None,
                                                    "distance_m": None}),
        (STANDING, "position_m", [1.0, 0.9, -2.0], {"position_m": [1.0, 0.9, -2.0], "azimuth_deg": None,
                                                    "distance_m": None, "stand_on": None}),
        (POLAR, "scale", 3.0, {"scale": 3.0, "size_m": None}),
        (PLACED, "size_m", 3.0, {"size_m": 3.0, "scale": None}),
    ],
)  # fmt: skip
def test_a_word_takes_the_place_of_those_that_say_the_same(
    table: Mapping[str, Any], name: str, value: Any, want: dict[str, Any] | None
) -> None:
    assert fields.in_words(table, name, value, lambda level: NOW[level]) == want


def test_first_controls_are_those_that_the_file_uses() -> None:
    assert fields.unsaid(POLAR) == ["position_m", "scale"]
    assert fields.unsaid(PLACED) == ["azimuth_deg", "elevation_deg", "distance_m", "size_m"]


def test_parameters_without_effect_name_the_cause() -> None:
    sun, given, snow = ("detect", "detect"), ("given", "detect"), (0.0, 0.0)
    assert fields.without_effect("light.sun_azimuth_deg", lambda _: sun) == "light.sun"
    assert fields.without_effect("light.sun_azimuth_deg", lambda _: given) == ""
    assert fields.without_effect("snow.exponent", lambda _: snow) == "snow.amount"
    assert fields.without_effect("snow.exponent", lambda _: (1.0, 0.0)) == ""
    assert fields.set_along("light.sun_azimuth_deg", lambda _: sun) == {"light.sun": "given"}
    assert fields.set_along("light.sun_azimuth_deg", lambda _: given) == {}
    assert fields.set_along("snow.exponent", lambda _: snow) == {}  # how much is for the user to say


def test_causes_are_parameters() -> None:
    known = {f"{group.key}.{field.key}" for group in groups() for of in group.kinds.values() for field in of}
    asked: list[str] = []

    def noted(key: str) -> tuple[Any, Any]:
        asked.append(key)
        return None, None

    for key in known:
        fields.without_effect(key, noted)
    assert len(asked) > 15
    assert set(asked) <= known
