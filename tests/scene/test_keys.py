# SPDX-License-Identifier: Apache-2.0
"""Parameters over time: their values between keys, the scene at a time, and the words for what is wrong with keys."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mr360uw.base.parameters import Parameters, is_direction, parameter
from mr360uw.errors import SceneError
from mr360uw.scene.key_targets import KeyedParameter
from mr360uw.scene.model import Scene, load_scene, scene_from_dict
from mr360uw.scene.problems import key_lines
from mr360uw.scene.resolved import keyed_in_words, scene_at
from tests.scenes import scene_with


def keyed(folder: Path, *keys: tuple[str, list[float], list[Any], str], **tables: Any) -> Scene:
    entries = [
        {"parameter": name, "time_s": times, "value": values, "interpolation": kind}
        for name, times, values, kind in keys
    ]
    return scene_with(folder, None, object=[{"mesh": str(folder / "plate.png")}], keys=entries, **tables)


@pytest.mark.parametrize(
    ("interpolation", "time_s", "value"),
    [
        ("linear", -1.0, 3.0),
        ("linear", 1.5, 4.125),
        ("linear", 3.0, 5.0),
        ("linear", 9.0, 4.0),
        ("hold", 1.0, 3.0),
        ("hold", 1.999, 3.0),
        ("hold", 2.0, 4.5),
        ("hold", 9.0, 4.0),
        ("smooth", 0.0, 3.0),
        ("smooth", 2.0, 4.5),
        ("smooth", 9.0, 4.0),
    ],
)
def test_values_between_keys(interpolation: Any, time_s: float, value: float) -> None:
    key = KeyedParameter(
        parameter="sea.wind_speed", time_s=(0, 2, 3, 4), value=(3, 4.5, 5, 4), interpolation=interpolation
    )
    assert key.at(time_s) == pytest.approx(value, abs=1e-14)


def test_a_smooth_curve_is_the_monotone_cubic() -> None:
    """Keys 0, 1, 4 at 0, 1, 2 s have the slopes 0, 1.5 (harmonic mean of 1 and 3) and 4 (the one-sided formula)."""
    key = KeyedParameter(parameter="sea.wind_speed", time_s=(0, 1, 2), value=(0, 1, 4), interpolation="smooth")
    t = 0.25
    assert key.at(t) == pytest.approx((3 - 2 * t) * t**2 + 1.5 * t**2 * (t - 1), abs=1e-14)
    assert key.at(1 + t) == pytest.approx(
        1 + 3 * (3 - 2 * t) * t**2 + 1.5 * t * (1 - t) ** 2 + 4.0 * t**2 * (t - 1), abs=1e-14
    )


def test_a_smooth_curve_does_not_overshoot() -> None:
    key = KeyedParameter(parameter="sea.wind_speed", time_s=(0, 1, 2, 3), value=(2, 2, 9, 9), interpolation="smooth")
    values = np.array([key.at(t) for t in np.linspace(0.0, 3.0, 301)])
    assert values.min() == 2.0
    assert values.max() == 9.0
    assert np.all(np.diff(values) >= 0.0)


def test_a_scene_at_a_time_has_the_values_of_that_time(tmp_path: Path) -> None:
    scene = keyed(
        tmp_path,
        ("sea.detail_slope", [1, 3], [0.1, 0.3], "linear"),
        ("object.0.position_m", [1, 3], [[0, 0, -3], [2, 4, -5]], "linear"),
        ("object[0].scale", [0, 2], [1, 3], "hold"),
        ("water.gain", [0, 4], [[1, 1, 1], [2, 1, 3]], "linear"),
    )
    now = scene_at(scene, 2.0)
    assert now.keys == ()
    assert now.sea.detail_slope == pytest.approx(0.2)
    assert now.objects[0].position_m == (1.0, 2.0, -4.0)
    assert now.objects[0].scale == 3.0
    assert now.water.gain == (1.5, 1.0, 2.0)
    assert scene_at(now, 7.0) is now


def test_one_component_of_a_vector_can_be_keyed(tmp_path: Path) -> None:
    scene = keyed(tmp_path, ("object.0.position_m.1", [0, 1], [0, 1], "linear"))
    assert scene_at(scene, 0.5).objects[0].position_m == (0.0, 0.5, -3.0)


@pytest.mark.parametrize(
    ("name", "values", "middle"),
    [
        ("light.sun_azimuth_deg", [350, 10], 0.0),
        ("light.sun_azimuth_deg", [10, -350], 10.0),
        ("light.sun_azimuth_deg", [-170, 170], 180.0),
        ("light.sun_elevation_deg", [0, 90], 45.0),
        ("lamp.0.cone_deg", [10, 350], 180.0),
        ("lamp.0.rotation_deg", [[350, 0, 0], [10, 90, 0]], [0.0, 45.0, 0.0]),
    ],
)
def test_directions_go_the_short_way_round(tmp_path: Path, name: str, values: list[Any], middle: Any) -> None:
    scene = keyed(tmp_path, (name, [0, 1], values, "linear"), lamp=[{}])
    table, *number, field = name.split(".")
    owner: Any = scene_at(scene, 0.5)
    owner = owner.lamps[0] if number else getattr(owner, table)
    turned = np.asarray(getattr(owner, field)) - middle
    whole_turns = 0.0 if field in ("sun_elevation_deg", "cone_deg") else 360.0 * np.round(turned / 360.0)
    np.testing.assert_allclose(turned, whole_turns, atol=1e-9)  # rounding of a sum of angles


def test_directions_stay_in_their_range() -> None:
    """A turn through the end of a range goes on at its other end."""

    class Compass(Parameters):
        heading_deg: float = parameter(0.0, "heading", unit="deg", low=-180.0, high=180.0)
        pitch_deg: float = parameter(0.0, "pitch", unit="deg", low=-90.0, high=90.0)
        cone_deg: float = parameter(1.0, "cone", unit="deg", above=0.0, high=360.0)
        angle_deg: float = parameter(1.0, "angle", unit="deg")

    assert [is_direction(field) for field in Compass.model_fields.values()] == [True, False, False, True]


def test_a_turn_through_the_end_of_a_range_goes_on_at_its_other_end(tmp_path: Path) -> None:
    scene = keyed(tmp_path, ("light.sun_azimuth_deg", [0, 1], [350, 20], "linear"))
    assert scene_at(scene, 0.25).light.sun_azimuth_deg == pytest.approx(357.5)
    assert scene_at(scene, 0.75).light.sun_azimuth_deg == pytest.approx(12.5)


TEXT = """plate = "plate.png"
[[object]]
mesh = "plate.png"
[[object]]
mesh = "plate.png"
[[object.key]]
time_s = 1.0
[[keys]]
"""


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ('parameter = "sea.wind_sped"\ntime_s = [0]\nvalue = [1]',
         "9 keys[0].parameter - unknown parameter (got 'sea.wind_sped') - did you mean 'sea.wind_speed'?"),
        ('parameter = "object.2.scale"\ntime_s = [0]\nvalue = [1]',
         "9 keys[0].parameter - no such entry (got 'object.2.scale') - there are 2, the first is 0"),
        ('parameter = "receiver.height_m"\ntime_s = [0]\nvalue = [1]',
         "9 keys[0].parameter - has no 'height_m' (got 'receiver.height_m') - receiver is not set: set it first"),
        ('parameter = "sea"\ntime_s = [0]\nvalue = [1]',
         "9 keys[0].parameter - is a table (got 'sea') - name a number in it"),
        ('parameter = "water.type"\ntime_s = [0]\nvalue = [1]',
         "9 keys[0].parameter - cannot change within a clip (got 'water.type', a word) - numbers that may be"),
        ('parameter = "sea.seed"\ntime_s = [0]\nvalue = [1]',
         "9 keys[0].parameter - cannot change within a clip (got 'sea.seed', a whole number) - numbers"),
        ('parameter = "draw.ambient_occlusion"\ntime_s = [0]\nvalue = [1]',
         "9 keys[0].parameter - cannot change within a clip (got 'draw.ambient_occlusion', true or false) - "),
        ('parameter = "sea.tile_m"\ntime_s = [0]\nvalue = [8]',
         "9 keys[0].parameter - cannot change within a clip (got 'sea.tile_m') - waves would jump"),
        ('parameter = "plate.scale"\ntime_s = [0]\nvalue = [0.5]',
         "9 keys[0].parameter - cannot change within a clip (got 'plate.scale') - the plate is read in one way"),
        ('parameter = "output.segment_s"\ntime_s = [0]\nvalue = [0.5]',
         "9 keys[0].parameter - cannot change within a clip (got 'output.segment_s') - a clip is encoded in one way"),
        ('parameter = "camera.depth_m"\ntime_s = [0]\nvalue = [5]',
         "9 keys[0].parameter - cannot change within a clip (got 'camera.depth_m') - camera.depth_keys"),
        ('parameter = "sea.wind_speed"\ntime_s = [0, 1]\nvalue = [1, 99]',
         "11 keys[0].value[1] - must be in [0, 40] m/s (got 99.0) - wind speed 10 m above the sea"),
        ('parameter = "sea.wind_speed"\ntime_s = [0, 1]\nvalue = [1]',
         "11 keys[0].value - must have an entry for each time (got 1 for 2) - add or remove entries"),
        ('parameter = "sea.wind_speed"\ntime_s = [1, 1]\nvalue = [1, 2]',
         "10 keys[0].time_s - must ascend (got 1, then 1) - sort the keys, one for each time"),
        ('parameter = "sea.wind_speed"\ntime_s = []\nvalue = []',
         "10 keys[0].time_s - is empty (got []) - give the time of one key at least"),
        ('parameter = "sea.wind_speed"\ntime_s = [0]\nvalue = [[1, 2]]',
         "11 keys[0].value[0] - must be a number (got [1.0, 2.0]) - as sea.wind_speed is"),
        ('parameter = "object.0.position_m"\ntime_s = [0]\nvalue = [[1, 2]]',
         "11 keys[0].value[0] - must be a list of 3 numbers (got [1.0, 2.0]) - as object.0.position_m is"),
        ('parameter = "object.0.position_m"\ntime_s = [0, 1]\nvalue = [[1, 2, 3], 4]',
         "11 keys[0].value - must be all numbers or all vectors of one length (got both) - write them alike"),
        ('parameter = "object.0.base_color"\ntime_s = [0]\nvalue = [[1, -1, 1]]',
         "11 keys[0].value[0] - must be three numbers >= 0 (got [1.0, -1.0, 1.0]) - light cannot be taken away"),
        ('parameter = "object.0.base_color.1"\ntime_s = [0]\nvalue = [1]',
         "9 keys[0].parameter - has no '1' (got 'object.0.base_color.1') - object.0.base_color is not set"),
        ('parameter = "object.1.scale"\ntime_s = [0]\nvalue = [1]',
         "9 keys[0].parameter - has keys of its own (got 'object.1.scale') - remove these, or the [[object.key]]"),
        ('parameter = "object.0.scale"\ntime_s = [0]\nvalue = [1]\n[[keys]]\nparameter = "object[0].scale"\n'
         "time_s = [0]\nvalue = [1]",
         "13 keys[1].parameter - is keyed already (got 'object[0].scale') - keys[0] has it: remove one of them"),
        ('parameter = "object.0.scale"\ntime_s = [0]\nvalue = [1]\ninterpolation = "smoth"',
         "12 keys[0].interpolation - must be 'linear', 'smooth' or 'hold' (got 'smoth') - did you mean 'smooth'?"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_keys_is_said(tmp_path: Path, lines: str, message: str) -> None:
    (tmp_path / "plate.png").touch()
    text = TEXT + lines
    with pytest.raises(SceneError) as caught:
        scene_from_dict(tomllib.loads(text), tmp_path, "s.toml", key_lines(text))
    (problem,) = caught.value.problems
    assert problem.startswith(f"s.toml:{message}")


@pytest.mark.parametrize("name", ["sea.wind_speed", "object[0].scale"])
def test_a_keyed_parameter_cannot_be_overridden(tmp_path: Path, name: str) -> None:
    (tmp_path / "plate.png").touch()
    path = tmp_path / "s.toml"
    path.write_text(TEXT + f'parameter = "{name}"\ntime_s = [0]\nvalue = [1]\n')
    assert load_scene(path, ["sea.steepness=0.5"]).keys
    with pytest.raises(SceneError) as caught:
        load_scene(path, [f"{name.replace('[0]', '.0')}=2"])
    assert caught.value.problems == (
        f"{name.replace('[0]', '.0')} - is keyed: its keys hold at all times - change its [[keys]], or remove them",
    )


def test_all_problems_of_keys_are_said_at_once(tmp_path: Path) -> None:
    with pytest.raises(SceneError) as caught:
        keyed(
            tmp_path,
            ("sea.wind_speed", [0, 1], [3, 50], "linear"),
            ("sea.wind", [0], [3], "linear"),
            ("water.gain", [0], [3], "linear"),
            ("light.peak", [0, 1], [0.5, 2], "linear"),
        )
    assert [problem.split(" - ")[0].split()[-1] for problem in caught.value.problems] == [
        "keys[0].value[1]", "keys[1].parameter", "keys[2].value[0]", "keys[3].value[0]",
    ]  # fmt: skip


def test_the_models_are_asked_about_the_values_together(tmp_path: Path) -> None:
    """Each amplitude is in its range, but at 1 s the waves fold over."""
    wave = {"wave_vector": [2.0, 0.0], "amplitude_m": 0.1, "steepness": 1.0}
    sea = {"explicit_waves": [wave, wave]}
    with pytest.raises(SceneError, match=r"keys\[0\]\.value\[1\] - sea at 1 s: the waves fold over"):
        keyed(
            tmp_path,
            ("sea.explicit_waves.0.amplitude_m", [0, 1], [0.1, 0.4], "linear"),
            ("sea.explicit_waves.1.amplitude_m", [0, 1], [0.1, 0.4], "linear"),
            sea=sea,
        )


def test_keys_in_words(tmp_path: Path) -> None:
    scene = keyed(
        tmp_path,
        ("sea.wind_speed", [0, 2.5], [3, 6], "hold"),
        ("object.0.scale", list(range(9)), [1.5] * 9, "linear"),
    )
    assert keyed_in_words(scene) == [
        "sea.wind_speed: 3, 6 m/s at 0, 2.5 s, hold",
        "object.0.scale: 1.5, 1.5, ..., 1.5, 1.5 at 0, 1, ..., 7, 8 s, linear",
    ]
