# SPDX-License-Identifier: Apache-2.0
"""Scene files with wrong values, in every field of every table, and text that is no scene."""

from __future__ import annotations

import types
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import pytest

from mr360uw.base.parameters import Parameters
from mr360uw.errors import SceneError
from mr360uw.scene.model import Scene, load_scene
from mr360uw.scene.problems import models_of
from tests.hostile.bench import SCENE, Bench

TABLES = {
    "plate": 'path = "plate.png"', "object": 'mesh = "mesh.glb"', "holdout": 'path = "plate.png"',
    "keys": 'parameter = "sea.wind_speed"\ntime_s = [0.0]\nvalue = [3.0]',
}  # fmt: skip
REPEATED = ("object", "lamp", "holdout", "keys")


def kinds(annotation: Any) -> Iterator[Any]:
    """Yield the plain types and words that a field takes."""
    origin = get_origin(annotation)
    if origin is Annotated:
        yield from kinds(get_args(annotation)[0])
    elif origin in (Union, types.UnionType):
        for part in get_args(annotation):
            yield from kinds(part)
    elif origin is Literal:
        yield from (type(value) for value in get_args(annotation))
    else:
        yield origin or annotation


def wrong_values(field: Any) -> list[str]:
    """Return values, as TOML writes them, that a field must refuse."""
    taken = set(kinds(field.annotation))
    numbers = bool(taken & {int, float})
    values = ["[[[1]]]", "1979-05-27T07:32:00Z", "0x" + "f" * 4000, "{deep = {deep = 1}}"]
    if bool not in taken:
        values += ["true", "[false]"]
    if not numbers:
        values += ["7", "7.5"] if bool not in taken else ["7.5", "2"]
    if not taken & {str, Path}:
        values += ['"wrong"', '""', '"\\u0000"']
    if numbers:
        values += ["nan", "inf", "-inf"]
        for rule in field.metadata:
            values += [repr(rule.ge - 1)] if getattr(rule, "ge", None) is not None else []
            values += [repr(rule.le + 1)] if getattr(rule, "le", None) is not None else []
            values += [repr(rule.gt), "-1e-30"] if getattr(rule, "gt", None) is not None else []
    if tuple in taken:
        values += ["[]" if "Ellipsis" not in repr(field.annotation) and "..." not in repr(field.annotation) else "[[]]"]
    return values


def fields() -> Iterator[tuple[str, str, Any]]:
    """Yield table, key and field of every key of every table."""
    for name, table in Scene.model_fields.items():
        for model in models_of(table.annotation):
            for key, field in model.model_fields.items():
                if not models_of(field.annotation):
                    yield table.alias or name, field.alias or key, (model, field)


FIELDS = [(table, key, *found) for table, key, found in fields()]


def scene_with(table: str, key: str, model: type[Parameters], value: str) -> tuple[str, str]:
    """Return a scene that is good but for one value, and the place of that value."""
    own = [line for line in TABLES.get(table, "").splitlines() if not line.startswith(f"{key} ")]
    own += ['model = "spectral"'] if model.__name__ == "SpectralSea" and key != "model" else []
    header = f"[[{table}]]" if table in REPEATED else f"[{table}]"
    lines = [*([] if table == "plate" else ['plate = "plate.png"']), header, *own, f"{key} = {value}"]
    place = f"{table}[0].{key}" if table in REPEATED else f"{table}.{key}"
    return "\n".join([*lines, ""]), f"scene.toml:{len(lines)} {place}"


def test_wrong_values_name_their_line_and_key(bench: Bench, subtests: pytest.Subtests) -> None:
    for table, key, model, field in FIELDS:
        for value in wrong_values(field):
            text, place = scene_with(table, key, model, value)
            with subtests.test(f"{model.__name__}.{key}", value=value):
                with pytest.raises(SceneError) as caught:
                    load_scene(bench.put("scene.toml", text))
                assert all(place in problem for problem in caught.value.problems), caught.value.problems
        with subtests.test(f"{model.__name__}.{key}, as a user meets it"):
            bench.refuses_scene(text, place)  # the last of them


DEEP = 2000
TEXTS = {
    "nothing": ("", "plate"),
    "no TOML": ("this is no TOML", "is not TOML"),
    "binary": (b"\x00\xff\xfe\x80" * 50, "UTF-8"),
    "UTF-16": ('plate = "plate.png"'.encode("utf-16"), "UTF-8"),
    "a zero": ('plate = "pl\x00ate.png"', "is not TOML"),
    "cut": (SCENE[:-3], "is not TOML"),
    "twice": ('plate = "plate.png"\nplate = "other.png"\n', "is not TOML"),
    "deep lists": ("a = " + "[" * DEEP + "]" * DEEP, "is not TOML"),
    "deep tables": ("a = " + "{a=" * DEEP + "1" + "}" * DEEP, "is not TOML"),
    "deep keys": ('plate = "plate.png"\n' + ".".join("a" * DEEP) + " = 1\n", "too deep"),
    "deep header": ('plate = "plate.png"\n[' + ".".join("a" * DEEP) + "]\n", "too deep"),
    "long integer": ("a = " + "9" * 5000, "is not TOML"),
    "spaces": ('plate = """\n[' + " " * 300_000 + '"""\n', "plate.path - cannot be read"),
    "brackets": ('plate = """\n' + "[" * 300_000 + '"""\n', "plate"),
    "unknown table": (SCENE + "[recevier]\nkind = 'plane'\n", "did you mean 'receiver'?"),
    "one table for several": (SCENE.replace("[[object]]", "[object]"), "double brackets"),
    "several tables for one": (SCENE.replace("[water]", "[[water]]"), "single brackets"),
    "object that is text": ('plate = "plate.png"\nobject = ["mesh.glb"]\n', "object[0]"),
    "plate that is a list": ('plate = ["plate.png"]\n', "plate"),
    "keys that descend": (SCENE + "[[object.key]]\ntime_s = 1\n[[object.key]]\ntime_s = 0\n", "later"),
    "key at no time": (SCENE + "[[object.key]]\ntime_s = true\n", "object[0].key[0].time_s"),
    "key without time": (SCENE + "[[object.key]]\nscale = 2.0\n", "object[0].key[0].time_s"),
    "depths that descend": (SCENE + "[camera]\ndepth_keys = [[1, 5], [0, 5]]\n", "ascend"),
    "two depths at one time": (SCENE + "[camera]\ndepth_keys = [[1, 5], [1, 6]]\n", "ascend"),
    "lamp on nothing": (SCENE + "[[lamp]]\nattach = 1\n", "no such object"),
    "lamp of darkness": (SCENE + "[[lamp]]\ncolor = [-1, 0, 0]\n", "lamp[0].color"),
    "negative base colour": (SCENE + "base_color = [0.5, -0.1, 0.5]\n", "object[0].base_color"),
    "negative gain": (SCENE.replace('"none"', '"IB"\ngain = [1, -1, 1]'), "water.gain"),
    "no size": (SCENE + "[receiver]\nsize_m = [0, 20]\n", "receiver.size_m[0]"),
    "no scale": (SCENE + "scale = 0\n", "object[0].scale"),
    "receiver without file": (SCENE + "[receiver]\nkind = 'mesh'\n", "receiver"),
    "water without file": (SCENE.replace('"none"', '"csv"'), "csv"),
    "caustics of odd size": (SCENE + "[caustics]\nsize = 100\n", "power of two"),
    "no lossless": (SCENE + "[output]\ncodec = 'prores'\nquality = 'lossless'\n", "lossless"),
    "waves that fold": (
        SCENE + "[[sea.explicit_waves]]\nwave_vector = [1, 0]\namplitude_m = 900\n", "sea",
    ),
    "date without time": (SCENE + "[light]\nsun = 'date'\n", "light"),
}  # fmt: skip


def test_texts_that_are_no_scene(bench: Bench, subtests: pytest.Subtests) -> None:
    for name, (text, says) in TEXTS.items():
        with subtests.test(name):
            bench.put("scene.toml", text)
            bench.refuses("composite", "scene.toml", "out.png", says=("scene.toml", says))
            bench.refuses("check", "scene.toml", says=("scene.toml", says))


def test_every_problem_has_one_line(bench: Bench) -> None:
    message = bench.refuses_scene(
        SCENE + "scale = -1\nposition_m = [nan, 0, true]\n[camera]\ndepth_m = 0\nroll = 1\n[draw]\nsamples = 3\n"
    )
    assert "6 problems" in message
    assert len(message.strip().splitlines()) == 7
